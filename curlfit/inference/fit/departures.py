"""How chi squared departs from its quadratic about an optimum, and what that makes of
what the optimum determines to first order.

Probes are points at which chi squared is compared with its quadratic: they cost a path
each. Where it departs, the ridge is followed (`curlfit.inference.fit.ridge`), and what
is said of a parameter or combination is what the ridge says.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from curlfit.inference.fit.ridge import Point, Ridge
from curlfit.inference.information.bounds import Bounded
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.covariance import Covariance
from curlfit.inference.information.directions import (
    inverted,
    standard_error,
    visible,
)
from curlfit.inference.information.thresholds import (
    CONVERGED,
    LITTLE,
    STRETCHED,
    UNKNOWN,
    WEAK_ERROR,
    WIDE,
)
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Floats

_PROBED = 2.0
"""Standard errors from an estimate at which chi squared is compared with its
quadratic: about those of a 95 % interval."""
_QUADRATIC = 0.02
"""Step over typical size below which chi squared is quadratic: two standard errors of a
hundredth of it."""
_ABOUT = 2.0
"""Factor within which a rise of chi squared is about that of the quadratic."""
_LEVEL = 1.0
"""Rise of chi squared up to which a direction is level, along which the quadratic does
not rise."""
_MISLEADING = 4.0
"""Factor of this rise where a standard error is off by two."""
_FAINT = 0.5
"""Standard error over typical size above which a direction is hardly determined."""
_TAKES_PART = 0.05
"""Component over the largest, above which a parameter takes part in a direction."""
_NARROW = 0.02
"""Error over the typical size, beyond which sums along a curve are given up where only
the tangent is known: 0.008 of the sum for eq. 12 under consistent load, 0.03 and more
of false sums under `front-back+sideways`."""
KNOWN_TO = {"omega0": 0.05, "v0": 0.01}
"""Standard error of a measured initial spin and speed, rad/s and m/s."""
_OTHERS_KNOWN_TO = 0.1
"""The same of any other parameter, over its typical size."""
UNITS = {"omega0": "rad/s", "v0": "m/s"}
_LOWER = 0.1
"""Fall of chi squared along a ridge below which its optimum is as good as any."""
_NO_SPIN = 3.0
"""Standard errors of the spin within which a stone may not have spun."""


class Probe(NamedTuple):
    """A point about an optimum at which chi squared is compared with its quadratic."""

    point: Floats
    expected: float
    """rise of chi squared from the optimum to this point to first order"""
    parameters: tuple[str, ...]
    """those that the point tells about"""
    statement: str = ""
    """the parameter or combination whose error leads to the point; empty of a point
    along a direction that is hardly determined"""
    rise: float = math.nan
    """the rise that was computed"""

    def with_rise(self, rise: float) -> Self:
        """The probe with the rise that was computed, infinite if there is no path."""
        return self._replace(rise=rise if math.isfinite(rise) else math.inf)

    @property
    def departs(self) -> bool:
        """Whether chi squared is not near its quadratic at this point."""
        if self.statement:
            return not 1 / _ABOUT < self.rise / self.expected < _ABOUT
        return not abs(self.rise - self.expected) < _LEVEL

    @property
    def misleads(self) -> bool:
        """Whether an error that leads to this point is wrong by a factor of two."""
        if not self.statement:
            return False
        return not 1 / _MISLEADING < self.rise / self.expected < _MISLEADING


class KnownCondition(NamedTuple):
    """What a parameter would have to be known to, so that others are determined."""

    parameter: str
    unit: str
    near: float
    """its value there"""
    known_to: float
    stderr: dict[str, float]
    """that the others then have"""


class Departures(NamedTuple):
    """How chi squared departs from its quadratic about an optimum."""

    stretched: dict[str, float]
    """of parameters and combinations, how many times as far they move along the ridge
    as first order says"""
    lost: set[str]
    """those of which the fit therefore says nothing"""
    intervals: dict[str, tuple[float, float]]
    """of parameters, between values that fit as well"""
    released: frozenset[str] = frozenset()
    """parameters at a bound from which values far away fit as well"""
    remedy: KnownCondition | None = None
    distance: float | None = None
    """to the optimum, standard errors: along the ridge, where there is no lower point,
    the quadratic says nothing of it"""
    lower: Point | None = None
    """where chi squared is lower, if the ridge leads there"""
    ridge: Ridge | None = None
    """None where it was not followed"""

    def judged(
        self, name: str, stderr: float | None, verdict: Verdict, typical: float
    ) -> tuple[float | None, Verdict, str]:
        """Standard error and verdict of an estimate along the ridge, and the reason of
        the verdict, empty if there is none to give.

        Parameters
        ----------
        stderr, verdict : to first order.
        typical : size of the parameter.
        """
        stderr = self.widened(stderr, name)
        if stderr is not None and math.isinf(stderr):
            return None, Verdict.NOT_IDENTIFIABLE, self.range_of(name)
        if name in self.lost:
            return stderr, Verdict.WEAK, self.range_of(name)
        if name in self.released:
            return None, Verdict.NOT_IDENTIFIABLE, self.range_of(name)
        is_wide = stderr is not None and stderr >= WEAK_ERROR * typical
        if verdict == Verdict.DETERMINED and is_wide:
            verdict = Verdict.WEAK
        reason = ""
        if verdict == Verdict.WEAK:
            reason = (
                f"its standard error is more than half its typical size, {typical:g}"
            )
        elif verdict == Verdict.PRIOR:
            reason = "without the priors the data do not determine it"
        elif verdict == Verdict.NOT_IDENTIFIABLE and name in self.intervals:
            reason = self.range_of(name)
        return stderr, verdict, reason

    def range_of(self, name: str) -> str:
        """Why a parameter is not determined."""
        if name not in self.intervals:
            return "values that fit nearly as well are more than its typical size apart"
        low, high = self.intervals[name]
        return f"values from {low:.3g} to {high:.3g} fit nearly as well"

    def kept(self, combinations: Iterable[Combination]) -> list[Combination]:
        """Combinations that are determined along the ridge, with their errors there."""
        return [
            replace(
                combination,
                stderr=self.widened(combination.stderr, combination.expression),
            )
            for combination in combinations
            if combination.expression not in self.lost
        ]

    def widened(self, stderr: float | None, name: str) -> float | None:
        """The standard error of a parameter or combination along the ridge."""
        return None if stderr is None else stderr * self.stretched.get(name, 1.0)

    def error_along(self, weights: Floats, stderr: float, sizes: Floats) -> float:
        """The standard error along the ridge of any weighted sum of the parameters.

        Parameters
        ----------
        weights, sizes : of the parameters, as in `Ridge.stretches`.
        stderr : to first order at the optimum.
        """
        if self.ridge is None or not self.ridge.points:
            return stderr
        (stretch,) = self.ridge.stretches(weights[None], np.array([stderr]), sizes)
        return stderr * float(stretch) if stretch > LITTLE else stderr


NO_DEPARTURES = Departures({}, set(), {})
"""Of chi squared that is a quadratic, or is taken for one."""


class _LooseDirection(NamedTuple):
    """A direction along which hardly anything is determined."""

    direction: Floats
    """unit vector of all parameters in typical sizes"""
    singular: float
    """singular value of the direction, 0 of a null direction"""


def probes_about(covariance: Covariance) -> list[Probe]:
    """Points about the optimum that show whether chi squared is a quadratic: beside
    each parameter and combination that is determined, and along what is hardly
    determined."""
    determined = covariance.identifiability.weights_of_determined()
    steps = _steps_of(covariance, determined)
    loose_directions = _loose_directions(covariance)
    null_directions = [
        loose.direction for loose in loose_directions if loose.singular == 0.0
    ]
    return [
        *_probes_of_sums_elsewhere(covariance, steps, null_directions),
        *_probes_of_statements(covariance, determined, steps),
        *_probes_along(covariance, loose_directions),
    ]


def _probes_of_statements(
    covariance: Covariance,
    determined: Mapping[str, Floats],
    steps: Mapping[str, Floats],
) -> list[Probe]:
    """Two standard errors from the estimate of each parameter and combination that is
    determined, to either side, where the others follow to first order, if these points
    are within the bounds."""
    bounded = covariance.information.bounded
    probes = []
    for statement, weights in determined.items():
        step = steps[statement]
        if np.abs(step / covariance.typical).max() < _QUADRATIC:
            continue
        names = _names_at(covariance, np.flatnonzero(covariance.in_all(weights)))
        for point in (bounded.values + step, bounded.values - step):
            if ((point >= bounded.lower) & (point <= bounded.upper)).all():
                probes.append(Probe(point, _PROBED**2, names, statement))
    return probes


def _probes_along(
    covariance: Covariance, loose_directions: Sequence[_LooseDirection]
) -> list[Probe]:
    """One standard error from the optimum along each direction that is hardly
    determined, or three typical sizes if that is less, to either side, whatever the
    bounds."""
    values = covariance.values
    probes = []
    for direction, singular in loose_directions:
        length = UNKNOWN if singular == 0 else min(1 / singular, UNKNOWN)
        expected = (length * singular) ** 2
        names = _taking_part(covariance, direction)
        step = length * direction * covariance.typical
        for point in (values + step, values - step):
            probes.append(Probe(point, expected, names))
    return probes


def _probes_of_sums_elsewhere(
    covariance: Covariance,
    steps: Mapping[str, Floats],
    null_directions: Sequence[Floats],
) -> list[Probe]:
    """Two standard errors from combinations, three typical sizes along the null
    directions in which their parameters take part, or as far as the bounds leave: where
    only a ratio is known, a sum is known the worse the larger its parameters are."""
    bounded = covariance.information.bounded
    probes = []
    for direction in null_directions:
        names = _taking_part(covariance, direction)
        far = UNKNOWN * direction * covariance.typical
        for combination in covariance.identifiability.combinations:
            if not combination.weights.keys() & set(names):
                continue
            expression = combination.expression
            across = steps[expression]
            for along in (far, -far):
                point = bounded.values + _room_for(bounded, along) * along + across
                probes.append(Probe(point, _PROBED**2, names, expression))
    return probes


def _room_for(bounded: Bounded, step: Floats) -> float:
    """How much of a step the bounds leave."""
    end = np.where(step > 0.0, bounded.upper, bounded.lower)
    moves = step != 0.0
    return min(1.0, float(((end - bounded.values)[moves] / step[moves]).min()))


def _steps_of(
    covariance: Covariance, weights: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Changes of the parameters along which weighted sums of the open ones change by
    two standard errors, the others following to first order; zero of a sum that has no
    error."""
    sums = np.array([*weights.values()]).reshape(-1, int(covariance.open.sum()))
    follow = sums @ covariance.conditional_matrix
    errors = np.sqrt(np.maximum((sums * follow).sum(1), 0.0))
    per_error = inverted(errors, errors > 0.0)
    steps = np.zeros((len(sums), len(covariance.typical)))
    steps[:, covariance.open] = _PROBED * follow * per_error[:, None]
    return dict(zip(weights, steps, strict=True))


def _taking_part(covariance: Covariance, direction: Floats) -> tuple[str, ...]:
    """The parameters that take part in a direction."""
    size = np.abs(direction)
    return _names_at(covariance, np.flatnonzero(size > _TAKES_PART * size.max()))


def _names_at(covariance: Covariance, indices: NDArray[np.int64]) -> tuple[str, ...]:
    return tuple(covariance.names[index] for index in indices.tolist())


def to_be_held(
    covariance: Covariance, probes: Iterable[Probe], coefficients: int
) -> list[int]:
    """Indices of the parameters along which the ridge is to be followed:

    - those that probes tell about at which chi squared departs from its quadratic;
    - where the search has not ended, those that are hardly determined;
    - those that the data hardly push against their bound;
    - a spin that is not known, on whose square friction depends, or is at its bound;
    - of a stone that may not have spun, the coefficients too, since the force on it
      depends on the sense of the spin;
    - if there are any of these, all that are weak.

    Parameters
    ----------
    probes : all of `probes_about`, with their rises.
    coefficients : number of them; they are the first parameters.
    """
    has_ended = covariance.distance < CONVERGED
    names: set[str] = set()
    for probe in probes:
        is_along_loose_direction = not probe.statement
        if probe.departs or (is_along_loose_direction and not has_ended):
            names.update(probe.parameters)
    held = {index for index, name in enumerate(covariance.names) if name in names}
    held.update(np.flatnonzero(covariance.at_bound & covariance.open).tolist())
    held.update(_held_for_the_spin(covariance, coefficients))
    if held:
        for index in np.flatnonzero(covariance.open).tolist():
            error = covariance.error_of(index)
            if WEAK_ERROR * covariance.typical[index] <= error < math.inf:
                held.add(index)
    return sorted(held)


def _held_for_the_spin(covariance: Covariance, coefficients: int) -> set[int]:
    """The spin, where it is weak or at its bound; and of a stone that may not have
    spun, it and the open coefficients."""
    spin = _spin_of(covariance)
    if spin is None:
        return set()
    error = covariance.error_of(spin)  # infinite unless the spin is open
    may_be_zero = abs(covariance.values[spin]) < _NO_SPIN * error < math.inf
    is_weak = error >= WEAK_ERROR * covariance.typical[spin]
    held = set()
    if covariance.at_bound[spin] or (covariance.open[spin] and is_weak) or may_be_zero:
        held.add(spin)
    if may_be_zero:
        open_indices = np.flatnonzero(covariance.open).tolist()
        held.update(index for index in open_indices if index < coefficients)
    return held


def departures_along(covariance: Covariance, ridge: Ridge, usual: Floats) -> Departures:
    """What the ridge says of the parameters and combinations that are determined to
    first order.

    Parameters
    ----------
    usual : coefficients of the law, the first parameters.
    """
    knows_spin = _knows_spin(covariance)
    stretched, lost = _stretched_and_lost(covariance, ridge, knows_spin=knows_spin)
    intervals = {
        covariance.names[index]: ends for index, ends in ridge.intervals.items()
    }
    fall = -float(ridge.rises.min(initial=0.0))
    distance = covariance.distance
    if intervals and fall < _LOWER:
        distance = min(distance, covariance.distance_beside(ridge.intervals))
    # A search that has not ended goes on from any lower point.
    has_lower = fall > (0.0 if covariance.distance >= CONVERGED else _LOWER)
    return Departures(
        stretched,
        lost,
        intervals,
        released=frozenset() if knows_spin else _released(covariance, intervals),
        remedy=_remedy(covariance, lost, ridge, usual),
        distance=distance,
        lower=ridge.lowest() if has_lower else None,
        ridge=ridge,
    )


def _stretched_and_lost(
    covariance: Covariance, ridge: Ridge, *, knows_spin: bool
) -> tuple[dict[str, float], set[str]]:
    """What is determined to first order and less so along the ridge: how many times as
    far it moves there, and of what nothing is known."""
    statements = covariance.identifiability.weights_of_determined()
    stretched: dict[str, float] = {}
    lost: set[str] = set()
    if not (ridge.points and statements):
        return stretched, lost
    weights = np.array([covariance.in_all(row) for row in statements.values()])
    errors = np.array([covariance.stderr(row) for row in statements.values()])
    sizes = covariance.in_all(covariance.typical[covariance.open])
    stretches = ridge.stretches(weights, errors, sizes)
    typical = np.abs(weights * covariance.typical).max(axis=1)
    relative_errors = np.maximum(stretches, 1.0) * errors / typical
    rooms = covariance.rooms()
    for name, stretch, relative_error in zip(
        statements, stretches.tolist(), relative_errors.tolist(), strict=True
    ):
        if stretch > LITTLE:
            stretched[name] = stretch
        if name in covariance.names:
            # Where the spin is not known, that is no error: the bounds limit it.
            if relative_error > rooms[name] and not knows_spin:
                stretched[name] = math.inf
            is_lost = relative_error >= WEAK_ERROR
        else:
            most = WIDE if stretch > STRETCHED else WEAK_ERROR
            is_lost = relative_error > most
        if is_lost:
            lost.add(name)
    return stretched, lost


def _spin_of(covariance: Covariance) -> int | None:
    """Index of the spin; None among the coefficients of several throws."""
    names = list(covariance.names)
    return names.index("omega0") if "omega0" in names else None


def _knows_spin(covariance: Covariance) -> bool:
    """Whether the spin is a parameter that is fixed or known."""
    spin = _spin_of(covariance)
    if spin is None:
        return False
    known_to = WEAK_ERROR * covariance.typical[spin]
    return not covariance.free[spin] or covariance.error_of(spin) < known_to


def _released(
    covariance: Covariance, intervals: Mapping[str, tuple[float, float]]
) -> frozenset[str]:
    """Parameters at a bound that fit as well more than their typical size from there:
    without the spin, a coefficient is at its bound by chance."""
    names = []
    for index in np.flatnonzero(covariance.at_bound).tolist():
        name = covariance.names[index]
        if name in intervals:
            low, high = intervals[name]
            if high - low > covariance.typical[index]:
                names.append(name)
    return frozenset(names)


def departures_together(
    covariance: Covariance, ridge: Ridge, usual: Floats
) -> Departures:
    """What the ridge of all throws that are fitted together says of one of them, in
    whose record no points are kept: to know a parameter of one throw determines little
    of what all have in common."""
    departures = departures_along(covariance, ridge, usual)
    return departures._replace(remedy=None, lower=None, ridge=None)


def departures_nearby(covariance: Covariance, probes: Iterable[Probe]) -> Departures:
    """What is said of parameters and combinations where the ridge is not followed.

    A sum of parameters along a direction that is hardly determined is lost where
    the values that fit leave the tangent by much.

    Parameters
    ----------
    probes : with their rises.
    """
    departing = [probe for probe in probes if probe.departs]
    lost = {probe.statement for probe in departing if probe.misleads}
    weights = covariance.identifiability.weights_of_determined()
    for combination in covariance.identifiability.combinations:
        row = weights[combination.expression]
        size = np.abs(row * covariance.typical[covariance.open]).max()
        stderr = covariance.stderr(row)
        for probe in departing:
            if probe.statement or not combination.weights.keys() & {*probe.parameters}:
                continue
            aside = stderr * math.sqrt(1 + max(probe.rise, 0.0))
            if aside > _NARROW * size:
                lost.add(combination.expression)
    return Departures({}, lost, {})


def _remedy(
    covariance: Covariance, lost: set[str], ridge: Ridge, usual: Floats
) -> KnownCondition | None:
    """What would determine coefficients that the ridge leaves open: another
    parameter along it, known as well as it is usually measured. That depends on the
    place along the ridge: it is told of the most usual coefficients."""
    if not ridge.points:
        return None
    identifiability = covariance.identifiability
    unseen = itertools.compress(identifiability.names, identifiability.unseen)
    left_open = lost.union(unseen)
    coefficients = covariance.names[: len(usual)]
    point = ridge.nearest(usual, covariance.typical[: len(usual)])
    for index in sorted(ridge.intervals, reverse=True):
        if not covariance.open[index]:
            continue
        name = covariance.names[index]
        known_to = KNOWN_TO.get(
            name, _OTHERS_KNOWN_TO * float(covariance.typical[index])
        )
        wanted = [
            coefficient
            for coefficient in coefficients
            if coefficient in left_open and coefficient != name
        ]
        errors = _errors_where_known(covariance, point, index, known_to, wanted)
        if errors:
            near = float(point.values[index])
            return KnownCondition(name, UNITS.get(name, "1"), near, known_to, errors)
    return None


def _errors_where_known(
    covariance: Covariance,
    point: Point,
    index: int,
    known_to: float,
    wanted: Sequence[str],
) -> dict[str, float]:
    """Standard errors of the wanted parameters that are determined at a point of the
    ridge, if the parameter with this index is known with the error `known_to`."""
    sizes = covariance.typical[covariance.open]
    names = list(covariance.identifiability.names)
    # Rows, in typical sizes, of what the data say and of what is known besides.
    rows = point.slopes[:, covariance.open] * sizes
    measured = np.zeros(len(names))
    column = names.index(covariance.names[index])
    measured[column] = covariance.typical[index] / known_to
    rows = np.vstack([rows, measured])
    errors = {}
    for name in wanted:
        column = names.index(name)
        unit = np.zeros(len(names))
        unit[column] = 1.0
        error = standard_error(rows, unit)
        if error is not None and error < WEAK_ERROR:
            errors[name] = error * float(sizes[column])
    return errors


def _loose_directions(covariance: Covariance) -> list[_LooseDirection]:
    """Directions along which hardly anything is determined, those of singular values
    first and then the null directions."""
    sizes = covariance.typical[covariance.open]
    scaled = covariance.unconfined.scaled[:, covariance.open]
    _, singular, rows = np.linalg.svd(scaled, full_matrices=False)
    is_weak = visible(singular) & (singular < 1 / _FAINT)
    loose = []
    for row, value in zip(rows[is_weak], singular[is_weak].tolist(), strict=True):
        loose.append(_LooseDirection(covariance.in_all(row), value))
    names = covariance.identifiability.names
    for weights in covariance.identifiability.null_directions:
        row = np.array([weights.get(name, 0.0) for name in names]) / sizes
        direction = covariance.in_all(row / np.linalg.norm(row))
        loose.append(_LooseDirection(direction, 0.0))
    return loose
