"""Before measuring: what would a measurement tell, and which throws would tell most?

Standard errors are those of least squares at the truth, (J^T W J)^-1 (Cramer and Rao: no unbiased
estimate has smaller ones), each throw with a start of its own, the coefficients in common. They
hold where noise is independent from row to row and the law is right; what a law misses does not
average out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)
from curlfit.optimal_design.result import Candidate, Design, Expected

# isort: split
import numpy as np

from curlfit.errors import InputError
from curlfit.friction import Law, Load, check_load
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import Identifiability, analyse
from curlfit.inference.linearized_problem import classify
from curlfit.inference.parameters import ParameterSet
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.optimal_design.information import (
    Told,
    Trial,
    about_coefficients,
    error_of,
    joined,
    told,
)
from curlfit.optimal_design.selection import Field, by_mean_error, by_volume, chosen, field_of
from curlfit.optimal_design.separability import Split, separation
from curlfit.sheet import LINES, TEE, TEE_TO_BACK
from curlfit.stone import Stone
from curlfit.throws.synthetic import law_with
from curlfit.throws.throw import CHANNELS

SPEEDS = (1.6, 1.9, 2.2)
SPINS = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Throws that are considered where none are named: m/s, and rad/s from a draw to a hard spinner."""
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
"""Noise of a camera over the ice, m and rad."""

_MOST_CANDIDATES = 500
_MOST_THROWS = 1000
_FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # on the noise, for the curves
_RATES = (1.0, 3.0, 10.0, 30.0, 100.0)  # Hz
_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)  # throws
_LONGEST_WAY = TEE + TEE_TO_BACK - LINES["hog"]
_PLACE, _ANGLE = ("x", "y", "speed"), ("phi", "omega")


def design(
    law: str | type[Law] | FitResult = "front-back",
    *,
    coefficients: Mapping[str, float] | None = None,
    load: str | None = None,
    stone: Stone | None = None,
    v0: Sequence[float] = SPEEDS,
    omega0: Sequence[float] = SPINS,
    rate: float | Sequence[float] = 30.0,
    until: float | None = None,
    sigma: Mapping[str, float] | None = None,
    throws: int = 3,
    separate: Sequence[str] | None = None,
    relative_error: float = 0.2,
    progress: Callable[[str], None] | None = None,
) -> Design:
    """What throws would tell of the coefficients of a law, before they are made.

    Parameters
    ----------
    law : name or class of the law; or a fit, whose law, coefficients, load and stone are taken.
    coefficients : what is taken to be true, over the law's defaults or the fit's values.
    load, stone : "uniform" or "consistent" (eq. 8-9); `Stone()`.
    v0, omega0, rate : speeds (m/s), spins (rad/s) and rows a second: every combination of these is
        a candidate.
    until : end of the records in s; when the stone has come to rest if not given.
    sigma : noise by channel (m, rad, m/s, rad/s) of x, y, phi, speed, omega; what is not named is
        not measured. 5 mm and 10 mrad if not given.
    throws : how many throws are made: the best of the candidates, each as often as is best.
    separate : two coefficients that are to be told apart; if not given, two of which the candidates
        under uniform load determine the sum alone.
    relative_error : of their difference (or of their mean where they are equal) that is wanted.
    progress : called with what is being done.

    Raises
    ------
    InputError : a value that makes no throw, an unknown law, load, channel or coefficient, or
        throws that determine nothing.
    """
    say = progress or (lambda text: None)
    kind, values, load, stone = _truth(law, coefficients, load, stone)
    sigma = _noise(NOISE if sigma is None else sigma)
    rates = (rate,) if isinstance(rate, int | float) else tuple(rate)
    _check(v0, omega0, rates, until, throws, relative_error)
    free = ParameterSet.build(kind).free[: len(values)]
    split = None if separate is None else Split(kind, values, free, separate)
    trials = [
        Trial(float(v), float(w), float(hertz), stone) for v, w, hertz in product(v0, omega0, rates)
    ]
    if len(trials) > _MOST_CANDIDATES:
        raise InputError(
            f"{len(v0)} speeds, {len(omega0)} spins and {len(rates)} rates make {len(trials)} "
            f"throws to choose from; expected at most {_MOST_CANDIDATES}"
        )
    channels = 5 if {"speed", "omega"} & sigma.keys() else 3
    record: dict[str, Any] = {"until": until, "channels": channels}
    say("what each throw would tell")
    known_by = told(kind, load, values, trials, **record)
    plan = _Planned(kind, values, free, sigma)
    roots = [plan.root(one) for one in known_by]
    field = field_of(roots)
    if not field.rank:
        raise InputError(f"these throws determine no coefficient of law {kind.name}")
    whole = plan.seen(joined(roots))
    quantities = plan.quantities(whole)
    best = {}
    for name, criterion in (("D", by_volume(field)), ("A", by_mean_error(field))):
        places = chosen(field, criterion, throws)
        if places is not None:
            best[name] = plan.expected(places, roots)
    if not best:
        raise InputError(
            f"no {throws} of these throws determine what all of them together do; ask for more "
            "throws, or offer others"
        )
    by_load: dict[str, list[Told]] = {load: known_by}
    if split is None:
        if load == "consistent":
            say("what would be hidden under uniform load")
            by_load["uniform"] = told(kind, "uniform", values, trials, **record)
            whole = plan.seen(joined([plan.root(one) for one in by_load["uniform"]]))
        pair = _open_pair(whole)
        split = None if pair is None else Split(kind, values, free, pair)
    say("errors against noise, rate and number of throws")
    curves = _curves(plan, field, roots, known_by, trials, best, load, record, quantities)
    parted = None
    if split is not None:
        parted = separation(split, trials, throws, sigma, relative_error, record, by_load, say)
    return Design(
        law=kind.name,
        load=load,
        stone=stone,
        coefficients=plan.named(values),
        symbols={item.name: item.symbol for item in kind.coefficients()},
        units={item.name: item.unit for item in kind.coefficients()},
        typical={item.name: item.typical for item in kind.coefficients()},
        sigma=sigma,
        until=until,
        throws=throws,
        candidates=tuple(
            Candidate(
                trial.v0, trial.omega0, trial.rate, one.rows, one.last, one.rest, one.distance,
                plan.errors(root, quantities),
            )
            for trial, one, root in zip(trials, known_by, roots, strict=True)
        ),
        quantities=quantities,
        rank=field.rank,
        free=int(free.sum()),
        best=best,
        curves=curves,
        separation=parted,
        notes=_notes(rates, until, known_by),
    )  # fmt: skip


class _Planned:
    """The coefficients and the noise, and what roots of information say of them."""

    def __init__(
        self, law: type[Law], values: Floats, free: Booleans, sigma: dict[str, float]
    ) -> None:
        items = law.coefficients()
        self.law, self.values, self.free, self.sigma = law, values, free, sigma
        self.all = [item.name for item in items]
        self.names = [name for name, take in zip(self.all, free, strict=True) if take]
        self.typical = np.array([item.typical for item in items])[free]

    def root(self, one: Told, **factors: float) -> Floats:
        """Of the information on the free coefficients; factors on the noise by channel."""
        sigma = {name: value * factors.get(name, 1.0) for name, value in self.sigma.items()}
        return about_coefficients(self.law, one, sigma, self.free)

    def named(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.all, map(float, values), strict=True))

    def seen(self, root: Floats) -> Identifiability:
        return analyse(root / self.typical, self.names, self.values[self.free], self.typical)

    def quantities(self, whole: Identifiability) -> dict[str, dict[str, float]]:
        """What is determined, one by one and together."""
        found = {
            name: {name: 1.0}
            for name, unseen in zip(self.names, whole.unseen, strict=True)
            if not unseen
        }
        return found | {item.expression: item.weights for item in whole.combinations}

    def errors(
        self, root: Floats, quantities: Mapping[str, Mapping[str, float]]
    ) -> dict[str, float | None]:
        return {
            name: error_of(
                root, np.array([weights.get(name, 0.0) for name in self.names]) * self.typical
            )
            for name, weights in quantities.items()
        }

    def expected(self, places: Sequence[int], roots: Sequence[Floats]) -> Expected:
        found = self.seen(joined([roots[place] for place in places]))
        stderr: dict[str, float | None] = dict.fromkeys(self.all)
        verdicts = dict.fromkeys(self.all, "fixed")
        for place, name in enumerate(self.names):
            stderr[name], verdicts[name] = classify(float(self.typical[place]), False, found, place)
        return Expected(
            throws=tuple(places),
            stderr=stderr | {item.expression: item.stderr for item in found.combinations},
            verdicts=verdicts,
            combinations=found.combinations,
            rank=found.rank,
            singular_values=tuple(map(float, found.singular_values)),
            null_directions=found.null_directions,
        )


def _truth(
    law: str | type[Law] | FitResult,
    coefficients: Mapping[str, float] | None,
    load: str | None,
    stone: Stone | None,
) -> tuple[type[Law], Floats, Load, Stone]:
    """What is taken to be true: law, values of its coefficients, load and stone."""
    fitted = {}
    if isinstance(law, FitResult):
        fitted = {name: item.value for name, item in law.coefficients.items()}
        load, stone = load or law.load, stone or law.stone
        law = law.law_class
    made = law_with(law, coefficients or {}, others=fitted)
    values = np.array([float(getattr(made, item.name)) for item in made.coefficients()])
    return type(made), values, check_load(load or "uniform"), stone or Stone()


def _noise(sigma: Mapping[str, float]) -> dict[str, float]:
    for name, value in sigma.items():
        if name not in CHANNELS:
            raise InputError(f"sigma: no channel {name!r}; the channels are {', '.join(CHANNELS)}")
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"sigma of {name} = {value:g}: expected a positive number")
    if not sigma:
        raise InputError("sigma: nothing is measured; expected the noise of a channel at least")
    return {name: float(sigma[name]) for name in CHANNELS if name in sigma}


def _check(
    v0: Sequence[float],
    omega0: Sequence[float],
    rates: Sequence[float],
    until: float | None,
    throws: int,
    relative_error: float,
) -> None:
    for name, values in (("v0", v0), ("rate", rates)):
        if not values or any(not (math.isfinite(one) and one > 0) for one in values):
            shown = ",".join(f"{one:g}" for one in values)
            raise InputError(f"{name} = {shown}: expected positive numbers")
    if not omega0 or not all(map(math.isfinite, omega0)):
        raise InputError("omega0: expected finite numbers")
    for name, value in (("until", until), ("relative error", relative_error)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} = {value:g}: expected a positive number")
    if isinstance(throws, bool) or not isinstance(throws, int) or not 1 <= throws <= _MOST_THROWS:
        raise InputError(f"throws = {throws}: expected a whole number from 1 to {_MOST_THROWS}")


def _open_pair(found: Identifiability) -> tuple[str, str] | None:
    """Two coefficients of which only the sum is determined, if there are such."""
    for direction in found.null_directions:
        if len(direction) == 2 and sum(direction.values()) == 0:
            first, second = direction
            return first, second
    return None


def _curves(
    plan: _Planned,
    field: Field,
    roots: Sequence[Floats],
    known_by: Sequence[Told],
    trials: Sequence[Trial],
    best: Mapping[str, Expected],
    load: Load,
    record: Mapping[str, Any],
    quantities: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, list[float | None]]]:
    """Standard errors against noise of place, noise of angle, rate and number of throws."""
    made = next(iter(best.values())).throws

    def series(at: Sequence[float], each: Sequence[Floats]) -> dict[str, list[float | None]]:
        rows = [plan.errors(root, quantities) for root in each]
        errors = {name: [row[name] for row in rows] for name in quantities}
        return {"at": [*at], **errors}

    found: dict[str, dict[str, list[float | None]]] = {}
    for name, channels in (("place", _PLACE), ("angle", _ANGLE)):
        if not plan.sigma.keys() & set(channels):
            continue
        each = [
            joined([plan.root(known_by[p], **dict.fromkeys(channels, factor)) for p in made])
            for factor in _FACTORS
        ]
        found[name] = series(_FACTORS, each)
    kinds = sorted(set(made))
    each = []
    for rate in _RATES:
        again = told(
            plan.law, load, plan.values, [trials[p]._replace(rate=rate) for p in kinds], **record
        )
        own = {place: plan.root(one) for place, one in zip(kinds, again, strict=True)}
        each.append(joined([own[place] for place in made]))
    found["rate"] = series(_RATES, each)
    counts, each = [], []
    for count in _COUNTS:
        places = chosen(field, by_volume(field), count)
        if places is not None:
            counts.append(float(count))
            each.append(joined([roots[place] for place in places]))
    found["throws"] = series(counts, each)
    return found


def _notes(
    rates: Sequence[float], until: float | None, known_by: Sequence[Told]
) -> tuple[str, ...]:
    notes = [
        "these errors hold if the law is right and noise is independent from row to row; what a "
        "law misses does not average out"
    ]
    if len(rates) > 1:
        notes.append(
            "with independent noise more rows always tell more, so the highest rate is chosen"
        )
    if until is not None and (early := sum(one.rest > until for one in known_by)):
        notes.append(
            f"of {len(known_by)} records {early} end at {until:g} s, before the stone is at rest"
        )
    far = [one.distance for one in known_by if one.distance > _LONGEST_WAY]
    if until is None and far:
        notes.append(
            f"{len(far)} of {len(known_by)} throws go up to {max(far):.1f} m; from the hog line to "
            f"the far back line there are {_LONGEST_WAY:.1f} m"
        )
    return tuple(notes)
