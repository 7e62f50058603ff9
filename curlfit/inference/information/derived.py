"""Quantities derived from the parameters of a fit, with errors to first order.

Where the values that fit lie on a curve, the ridge of the fit, a quantity is followed
along it: what moves there is as uncertain as it moves, and what is constant there is
determined, whatever its form. The product of a coefficient and the spin may be known
though neither is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.directions import wide_errors
from curlfit.inference.information.expression import CONSTANTS, Expression, parse
from curlfit.inference.information.intervals import WithInterval
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.thresholds import (
    INTERVAL,
    LITTLE,
    STRETCHED,
    UNKNOWN,
    WEAK_ERROR,
    WIDE,
)
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.output.text import sided
from curlfit.records import ADDED, Names
from curlfit.stone import UNITS as STONE_UNITS

LEVELS = ("2.5", "16", "50", "84", "97.5")
"""Quantiles in percent."""
Quantiles = Annotated[dict[str, float], Names(LEVELS)]
# share of a gradient along null directions below which it counts as zero
_NO_PART = 1e-3
_TRIES = 4  # further points along null directions at which the gradient is checked
_FOLLOWED = 0.5
"""Share of what a parameter may be, by its standard error and bounds, that the ridge
has followed: it may end early where no path was found."""

_LARGEST = 1e100  # of a value or a slope, so that its square is finite


@dataclass(frozen=True)
class Derived(WithInterval):
    """A quantity derived from the parameters of a fit.

    Attributes
    ----------
    expression : arithmetic of the parameters, or the name of a quantity of the path.
    value : at the estimates.
    stderr : standard error, from the covariance to first order, or what the ridge of
        the fit demands; None where the quantity is not determined, or depends on a
        parameter at its bound.
    verdict : "determined"; "prior" (it rests on priors); "weak" (its standard error is
        more than half of what typical sizes of its parameters imply, or it moves along
        the ridge by more than a quarter of that); "not identifiable" (it depends on a
        direction that the path does not determine); "at bound" or "fixed".
    systematic : error due to the conditions that the fit holds fixed; None where
        there is none, or where it is not known.
    dof : degrees of freedom of `stderr`, the smallest of its parameters'; None where
        sigma was given.
    quantiles : of the posterior, "2.5" to "97.5"; empty without a chain.
    meaning : of a quantity of the path; of a product that the fit derives, how its
        factors change along the ridge.
    unit : of a quantity of the path.
    reason : of one that moves along the ridge, the values that fit nearly as well.
    """

    expression: str
    value: float
    stderr: float | None
    verdict: Verdict
    systematic: float | None = None
    dof: float | None = None
    quantiles: Quantiles = field(default_factory=dict)
    meaning: str = ""
    unit: str = ""
    reason: str = field(default="", metadata=ADDED)


def scaled(item: Derived, factor: float) -> Derived:
    """The quantity times a factor."""

    def times(value: float | None) -> float | None:
        return None if value is None else value * abs(factor)

    quantiles = sorted(value * factor for value in item.quantiles.values())
    return replace(
        item,
        value=item.value * factor,
        stderr=times(item.stderr),
        systematic=times(item.systematic),
        quantiles=dict(zip(item.quantiles, quantiles, strict=True)),
    )


def to_its_side(item: Derived) -> Derived:
    """A signed quantity as a positive one, with its side in words."""
    meaning, sign = sided(item.meaning, item.value)
    return scaled(replace(item, meaning=meaning), sign) if sign < 0 else item


class AlongRidge(NamedTuple):
    """What the ridge of a fit says of a quantity."""

    error: float
    """standard error by its profile, infinite where it is not determined"""
    size: float
    """the smallest, along the ridge, of what typical sizes of the parameters imply"""
    held: frozenset[str]
    """the parameters that were held"""
    reason: str


class FirstOrder(NamedTuple):
    """What a fit says about its parameters, to first order."""

    parameters: Mapping[str, Any]
    """an `Estimate` each (`curlfit.inference.fit.estimates`)"""
    covariance: NamedMatrix
    """of the parameters that can move"""
    null_directions: Sequence[Mapping[str, float]]
    combinations: Sequence[Combination]
    widths: Mapping[str, float]
    """standard uncertainties of the conditions that the fit holds fixed"""
    shifts: Mapping[str, Mapping[str, float]]
    """by determined parameter, combination or product, and by condition"""
    stone: Mapping[str, float]
    ridge: Sequence[Any] = ()
    """a `RidgePoint` each (`curlfit.inference.fit.estimates`)"""
    products: Sequence[str] = ()
    """expressions of products that are determined along the ridge"""

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that can move."""
        return self.covariance.names

    @property
    def values(self) -> dict[str, float]:
        """The estimates of all parameters."""
        return {name: item.value for name, item in self.parameters.items()}

    @property
    def points(self) -> list[dict[str, float]]:
        """Values of all parameters along the ridge."""
        return [
            dict(zip(self.parameters, point.values, strict=True))
            for point in self.ridge
        ]

    def vector(self, weights: Mapping[str, float]) -> Floats:
        """Weights in the order of the parameters that can move."""
        return np.array([weights.get(name, 0.0) for name in self.names])

    def stderr(self, gradient: Mapping[str, float]) -> float:
        """Standard error of a quantity with this gradient; null directions
        are ignored."""
        row = self.vector(gradient)
        return math.sqrt(max(float(row @ self.covariance.matrix @ row), 0.0))

    def size(self, gradient: Mapping[str, float]) -> float:
        """The change of a quantity that typical sizes of the parameters imply."""
        typical = [
            slope * self.parameters[name].typical for name, slope in gradient.items()
        ]
        return math.hypot(*typical)

    def null_space(self) -> Floats:
        """Orthonormal null directions in units of typical sizes, shape
        (directions, parameters)."""
        rows = [self.vector(item) / self._typical for item in self.null_directions]
        rows = [row for row in rows if row.any()]
        if not rows:
            return np.zeros((0, len(self.names)))
        _, size, basis = np.linalg.svd(np.array(rows), full_matrices=False)
        return np.asarray(basis[size > 1e-9 * size[0]])

    @property
    def _typical(self) -> Floats:
        return np.array([self.parameters[name].typical for name in self.names])

    def sees(self, gradient: Mapping[str, float]) -> bool:
        """Whether the data determine a quantity with this gradient."""
        row = self.vector(gradient) * self._typical
        size = float(np.linalg.norm(row))
        return not np.linalg.norm(self.null_space() @ row) > _NO_PART * size

    def follow(self, name: str) -> Floats:
        """How the parameters change with one of them, to first order: along the null
        direction in which it takes part, or as the others are refitted; 0 of one that
        does not move."""
        index = self.names.index(name)
        in_space = self.null_space()[:, index]
        if np.linalg.norm(in_space) > _NO_PART:
            follow = (in_space @ self.null_space()) * self._typical
        else:
            follow = self.covariance.matrix[:, index]
        if follow[index] == 0.0:
            return np.zeros(len(follow))
        return np.asarray(follow / follow[index])

    def holding(self, name: str) -> FirstOrder:
        """The same while a parameter is held at its estimate."""
        if name not in self.names:
            return self
        index = self.names.index(name)
        hold = np.eye(len(self.names))
        hold[:, index] -= self.follow(name)
        matrix = hold @ self.covariance.matrix @ hold.T
        space = self.null_space()
        in_space = space[:, index]
        if np.linalg.norm(in_space) > _NO_PART:
            # turned so that the parameter takes part in the first direction alone
            _, _, turned = np.linalg.svd(in_space[None])
            space = turned[1:] @ space
        null_directions = [
            dict(zip(self.names, (row * self._typical).tolist(), strict=True))
            for row in space
        ]
        covariance = NamedMatrix(self.names, matrix)
        return self._replace(covariance=covariance, null_directions=null_directions)

    def across(self, gradient: Mapping[str, float], shift: Floats) -> float:
        """The part across the ridge of the change of a quantity with this gradient, for
        a shift of the parameters that can move: while that parameter is held which
        leaves the least error."""
        row = self.vector(gradient)
        errors = {}
        for name in {point.held for point in self.ridge} & set(self.names):
            others = self.holding(name)
            if others.sees(gradient):
                errors[name] = others.stderr(gradient)
        if errors:
            held = min(errors, key=lambda name: errors[name])
            shift = shift - self.follow(held) * shift[self.names.index(held)]
        return float(row @ shift)

    def _sums(self) -> dict[str, Mapping[str, float]]:
        """Combinations and products whose shifts are known, to first order, with their
        weights."""
        weights: dict[str, Mapping[str, float]] = {
            item.expression: item.weights for item in self.combinations
        }
        weights |= {text: gradient_of(self, text) for text in self.products}
        return {text: row for text, row in weights.items() if text in self.shifts}

    def _shifted(self) -> Floats:
        """Which parameters have shifts of their own, and not those of products alone,
        shape (parameters,)."""
        in_products = {
            name for text in self.products for name in gradient_of(self, text)
        }
        return np.array(
            [name in self.shifts and name not in in_products for name in self.names]
        )

    def shift(self, condition: str) -> Floats:
        """Shift from the estimates to the true values if a condition is off by
        one width, along the determined directions, in the order of the parameters
        that can move."""
        shifted = self._shifted()
        shift = shifted * self.vector(
            {name: by.get(condition, 0.0) for name, by in self.shifts.items()}
        )
        sums = self._sums()
        hidden = np.logical_not(shifted)
        if hidden.any() and sums:
            rows = np.array([self.vector(weights) for weights in sums.values()])
            right = [self.shifts[text].get(condition, 0.0) for text in sums]
            rest = np.array(right) - rows @ shift
            shift[hidden] = np.linalg.lstsq(rows[:, hidden], rest, rcond=None)[0]
        return shift

    def knows_shift(self, gradient: Mapping[str, float]) -> bool:
        """Whether a quantity depends on parameters without shifts of their own only as
        combinations and products do."""
        hidden = np.logical_not(self._shifted())
        scaled = self._typical * hidden
        row = self.vector(gradient) * scaled
        rows = [self.vector(weights) * scaled for weights in self._sums().values()]
        if not rows:
            return not row.any()
        along, *_ = np.linalg.lstsq(np.array(rows).T, row, rcond=None)
        rest = row - along @ np.array(rows)
        return not np.linalg.norm(rest) > _NO_PART * np.linalg.norm(row)

    def assess(
        self,
        name: str,
        value: float,
        gradient: Mapping[str, float],
        changes: Mapping[str, float],
        *,
        seen: bool = True,
        held_counts: bool = True,
        along: AlongRidge | None = None,
    ) -> Derived:
        """The quantity with its errors.

        Parameters
        ----------
        gradient : by the parameters. changes : for one width of each condition, at
            fixed parameters.
        seen : whether it is determined elsewhere along straight null directions as
            well.
        held_counts : whether dependence on a parameter at its bound leaves it
            without an error.
        along : what the ridge of the fit says of it, if there is one.
        """
        used = {key: self.parameters[key] for key, slope in gradient.items() if slope}
        free = [key for key, item in used.items() if item.verdict.is_free]
        if not free:
            return Derived(name, value, None, Verdict.FIXED)
        on_tangent = seen and self.sees(gradient)
        stuck = {key for key in free if key not in self.names}
        if along is not None and stuck:
            on_tangent = False
            stuck -= along.held
        if along is None and not on_tangent:
            return Derived(name, value, None, Verdict.NOT_IDENTIFIABLE)
        if held_counts and stuck:
            return Derived(name, value, None, Verdict.AT_BOUND)
        stderr = self.stderr(gradient) if on_tangent else math.inf
        size = self.size({key: gradient[key] for key in free if key in self.names})
        stretch = 1.0
        spoiled = False
        if along is not None:
            stretch = along.error / stderr if stderr > 0 else math.inf
            spoiled = stretch < 1 / LITTLE
            if spoiled or stretch > LITTLE:
                stderr = along.error
            size = min(along.size, size)
        reason = "" if along is None else along.reason
        if math.isinf(stderr):
            return Derived(name, value, None, Verdict.NOT_IDENTIFIABLE, reason=reason)
        verdict = Verdict.DETERMINED
        if any(used[key].verdict == Verdict.PRIOR for key in free):
            verdict = Verdict.PRIOR
        if stderr >= WEAK_ERROR * size or (
            along is not None and stretch > STRETCHED and stderr > WIDE * size
        ):
            verdict = Verdict.WEAK
        if verdict == Verdict.WEAK and not on_tangent:
            return Derived(name, value, None, Verdict.NOT_IDENTIFIABLE, reason=reason)
        hidden = {key for key in free if used[key].verdict == Verdict.NOT_IDENTIFIABLE}
        sums = [item for item in self.combinations if hidden & set(item.weights)]
        dof = [*(used[key].dof for key in free), *(item.dof for item in sums)]
        if spoiled:  # of parameters that have no error of their own
            dof += [item.dof for item in self.parameters.values()]
        known = [one for one in dof if one is not None]
        row = self.vector(gradient)
        by_condition = [
            float(row @ self.shift(condition)) + changes.get(condition, 0.0)
            for condition in self.widths
        ]
        systematic = math.hypot(*by_condition) if by_condition else None
        if spoiled and not self.knows_shift(gradient):
            systematic = None
        return Derived(
            name,
            value,
            stderr,
            verdict,
            systematic,
            dof=min(known) if known else None,
            reason=reason if verdict == Verdict.WEAK else "",
        )


def gradient_of(known: FirstOrder, product: str) -> dict[str, float]:
    """The gradient of a product of parameters at the estimates, by their names."""
    return parse(product, known.values, {}).gradient(known.values)


def check_derived(texts: Sequence[str], names: Sequence[str]) -> None:
    """Raise `InputError`, before a fit, for an expression that is not valid for
    its parameters."""
    for text in texts:
        parse(
            text,
            (*names, *(key for key in (*STONE_UNITS, *CONSTANTS) if key not in names)),
            {},
        )


def derive(
    known: FirstOrder, text: str, samples: Mapping[str, Floats] | None = None
) -> Derived:
    """A derived quantity from its expression.

    Parameters
    ----------
    text : arithmetic of parameters, determined combinations, the stone's R, rho, h and
        m, g and pi.
    samples : of the posterior, by parameter.

    Raises
    ------
    InputError : it is not arithmetic of such names, or has no finite value or
        derivative at the estimates.
    """
    constants = {**CONSTANTS, **known.stone}
    values = {name: item.value for name, item in known.parameters.items()}
    constants = {name: value for name, value in constants.items() if name not in values}
    sums = {item.expression: item.weights for item in known.combinations}
    expression = parse(text, (*values, *constants), sums)
    at = {**constants, **values}
    value, gradient = float(expression.of(at)), expression.gradient(at)
    own = {name: slope for name, slope in gradient.items() if name in values}
    for sound, fault in (
        (abs(value) < _LARGEST, "it has no finite value at the estimates"),
        (
            all(abs(slope) < _LARGEST for slope in gradient.values()),
            "it has no derivative at the estimates",
        ),
        (
            own,
            "it contains no parameter of the fit; the parameters are "
            + ", ".join(values),
        ),
    ):
        if not sound:
            raise InputError(f"derive {quoted(expression.text)}: {fault}")
    changes = {
        name: slope * known.widths[name]
        for name, slope in gradient.items()
        if name not in values and name in known.widths
    }

    def slopes(moved: Mapping[str, float]) -> dict[str, float]:
        found = expression.gradient({**constants, **moved})
        return {name: slope for name, slope in found.items() if name in values}

    seen = _seen_along_null_directions(known, values, slopes)
    along = None
    if known.ridge:
        along = _along_ridge(known, partial(_value, expression, constants), slopes)
    found = known.assess(expression.text, value, own, changes, seen=seen, along=along)
    if along is not None:
        found = _as_the_fit_says(known, found)
    if samples is None:
        return found
    return with_quantiles(found, expression.of({**constants, **samples}))


def _value(
    expression: Expression, constants: Mapping[str, float], point: Mapping[str, float]
) -> float:
    """An expression at values of the parameters."""
    return float(expression.of({**constants, **point}))


def _as_the_fit_says(known: FirstOrder, quantity: Derived) -> Derived:
    """The quantity with the error and verdict of the parameter or combination that it
    is, if it is one."""
    estimate = known.parameters.get(quantity.expression)
    if estimate is not None:
        stderr = estimate.stderr
        verdict = estimate.verdict
        systematic = quantity.systematic if stderr is not None else None
        return replace(
            quantity,
            stderr=stderr,
            verdict=verdict,
            systematic=systematic,
            reason=estimate.reason,
        )
    for combination in known.combinations:
        if combination.expression == quantity.expression:
            return replace(
                quantity, stderr=combination.stderr, verdict=Verdict.DETERMINED
            )
    return quantity


def with_quantiles(quantity: Derived, samples: Floats) -> Derived:
    """The quantity with the quantiles of its finite samples."""
    known = samples[np.isfinite(samples)]
    return replace(quantity, quantiles=quantiles_of(known)) if len(known) else quantity


def quantiles_of(samples: Floats) -> dict[str, float]:
    """Quantiles of samples, by `LEVELS`."""
    found = np.quantile(samples, [float(level) / 100 for level in LEVELS])
    return dict(zip(LEVELS, map(float, found), strict=True))


def _along_ridge(
    known: FirstOrder,
    value_at: Callable[[Mapping[str, float]], float],
    slopes: Callable[[Mapping[str, float]], dict[str, float]],
) -> AlongRidge:
    """What the ridge says of a quantity, from its value and gradient at a point."""
    values = known.values
    points = known.points
    estimate = value_at(values)
    along = np.array([value_at(point) for point in points])
    gradients = [slopes(point) for point in (values, *points)]
    sizes = [known.size(gradient) for gradient in gradients]
    held = frozenset(point.held for point in known.ridge if point.held is not None)
    errors = [math.inf]
    for name in held:
        if _is_followed(known, name):
            others = known.holding(name)
            if _seen_along_null_directions(others, values, slopes) and others.sees(
                gradients[0]
            ):
                errors.append(others.stderr(gradients[0]))
    demanded = [min(errors)]
    near = [estimate]
    for point, value, gradient in zip(known.ridge, along, gradients[1:], strict=True):
        moved = abs(value - estimate)
        error = _error_at(known, point, gradient, held)
        demanded.append(_demanded(moved, error, max(point.rise, 0.0)))
        if point.rise <= INTERVAL:
            near.append(value)
    reason = ""
    if np.isfinite(near).all():
        reason = f"values from {min(near):.3g} to {max(near):.3g} fit nearly as well"
    return AlongRidge(
        error=float(np.nan_to_num(demanded, nan=math.inf, posinf=math.inf).max()),
        size=float(np.nan_to_num(sizes, nan=math.inf, posinf=math.inf).min()),
        held=held,
        reason=reason,
    )


def _demanded(moved: float, error: float, rise: float) -> float:
    """The standard error that a point of the ridge demands of a quantity.

    By its profile: where chi squared has risen by k^2 in all, by `rise` along the ridge
    and by the rest across it, the quantity is off by moved + error sqrt(k^2 - rise),
    which is at most k standard errors. Of all k from 1 up, the largest of these counts.

    Parameters
    ----------
    moved : distance of its value at the point from the estimate.
    error : its standard error across the ridge, at the point.
    rise : of chi squared at the point.
    """
    if not math.isfinite(moved + error):
        return math.inf
    # the k at which it is largest: sqrt(rise) hypot(...) / moved
    at_largest = math.hypot(moved, math.sqrt(rise) * error)
    if at_largest * math.sqrt(rise) < moved:
        return moved + error * math.sqrt(1.0 - rise)
    return at_largest / math.sqrt(rise) if rise > 0.0 else error


def _error_at(
    known: FirstOrder, point: Any, gradient: Mapping[str, float], held: Collection[str]
) -> float:
    """Standard error of a quantity at a point of the ridge with a parameter held: that
    of the point, or of another solution the one that leaves the least."""
    names = list(known.parameters)
    row = np.array([[gradient.get(name, 0.0) for name in names]])
    if not np.isfinite(row).all():
        return math.inf
    free = [item.verdict.is_free for item in known.parameters.values()]
    typical = np.array([item.typical for item in known.parameters.values()]) * free
    errors = [math.inf]
    for name in held if point.held is None else (point.held,):
        sizes = typical.copy()
        sizes[names.index(name)] = 0.0
        (error,) = wide_errors(np.array(point.slopes) * sizes, row * sizes)
        errors.append(float(error))
    return min(errors)


def _is_followed(known: FirstOrder, name: str) -> bool:
    """Whether the ridge has followed a parameter over what its standard error and its
    bounds leave open."""
    item = known.parameters[name]
    along = [known.values[name], *(point[name] for point in known.points)]
    open_ = min(item.upper - item.lower, UNKNOWN * item.typical)
    if name in known.names and known.sees({name: 1.0}):
        open_ = min(open_, known.stderr({name: 1.0}))
    return max(along) - min(along) >= _FOLLOWED * open_


def _seen_along_null_directions(
    known: FirstOrder,
    values: Mapping[str, float],
    slopes: Callable[[Mapping[str, float]], dict[str, float]],
) -> bool:
    """Whether the gradient vanishes along the null directions elsewhere along them as
    well: that of a product a b vanishes along a - b only where a = b."""
    space = known.null_space()
    if not len(space):
        return True
    random = np.random.default_rng(0)
    for step in random.standard_normal((_TRIES, len(space))) @ space:
        moved = dict(values)
        for name, by in zip(known.names, step, strict=True):
            item = known.parameters[name]
            ends = max(item.lower, -1e300), min(item.upper, 1e300)
            moved[name] = min(max(values[name] + by * item.typical, ends[0]), ends[1])
        gradient = slopes(moved)
        if all(map(math.isfinite, gradient.values())) and not known.sees(gradient):
            return False
    return True
