"""Optimal design: the expected errors of planned throws, and the best choice of throws.

Standard errors are the Cramer-Rao bound (J^T W J)^-1 at the assumed values, with a separate initial
state for each throw and common coefficients. They are valid for noise that is independent from row
to row and a correct law; the discrepancy of a law does not average out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.friction import Law, Load, check_load
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import Bounded, Identifiability, analyse, confined
from curlfit.inference.linearized_problem import classify
from curlfit.inference.model import Model
from curlfit.inference.parameters import ParameterSet
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.optimal_design.information import (
    PlannedThrow,
    RecordInformation,
    coefficient_information,
    combined,
    prepare_information,
    record_information,
    standard_error,
)
from curlfit.optimal_design.result import Candidate, Design, ExpectedErrors
from curlfit.optimal_design.selection import (
    CandidateSet,
    a_criterion,
    d_criterion,
    select_design,
)
from curlfit.optimal_design.separability import CoefficientPair, analyse_separation
from curlfit.optimal_design.systematics import scenarios
from curlfit.sheet import LINES, TEE, TEE_TO_BACK
from curlfit.stone import Stone
from curlfit.throws.synthetic import law_with
from curlfit.throws.throw import CHANNELS

SPEEDS = (1.6, 1.9, 2.2)
SPINS = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Default candidates: m/s, and rad/s from a draw to a hard spinner."""
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
"""Noise of a camera above the ice, m and rad."""

_MAX_CANDIDATES = 500
_MAX_THROWS = 1000
_FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # factors on the noise, for the curves
_RATES = (1.0, 3.0, 10.0, 30.0, 100.0)  # Hz
_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)  # throws
_LONGEST_DISTANCE = TEE + TEE_TO_BACK - LINES["hog"]
_POSITION, _ANGLE = ("x", "y", "speed"), ("phi", "omega")


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
    discrepancy: float = 0.0,
    throws: int = 3,
    separate: Sequence[str] | None = None,
    relative_error: float = 0.2,
    progress: Callable[[str], None] | None = None,
) -> Design:
    """The expected errors of the coefficients of a law from planned throws.

    Parameters
    ----------
    law : name or class of the law; or a fit, for its law, coefficients, load and stone.
    coefficients : assumed values, in place of the law's defaults or the fit's values.
    load, stone : "uniform" or "consistent" (eq. 8-9); `Stone()`.
    v0, omega0, rate : speeds (m/s), spins (rad/s) and rows per second: all combinations are
        candidates.
    until : end of the records in s; the time of rest if not given.
    sigma : noise by channel (m, rad, m/s, rad/s) of x, y, phi, speed, omega; other channels are
        not measured. 5 mm and 10 mrad if not given.
    discrepancy : size of the accelerations that the law may lack, relative to the friction, such as
        0.05; they are functions of speed, see `curlfit.inference.noise.accelerations`. Not included
        in the separation of two coefficients.
    throws : number of throws, chosen optimally among the candidates, with repetition.
    separate : two coefficients to be separated; if not given, two of which the candidates under
        uniform load determine only the sum.
    relative_error : required error of their difference, relative to it (or to their mean if they
        are equal).
    progress : called with a description of each step.

    Raises
    ------
    InputError : an invalid value, an unknown law, load, channel or coefficient, or throws that
        determine nothing.

    Examples
    --------
    >>> plan = curlfit.design("front-back", v0=[2.0, 2.2], omega0=[1.0, 5.0])
    >>> len(plan.candidates), plan.rank
    (4, 3)
    """
    progress = progress or (lambda text: None)
    kind, values, load, stone = _assumed(law, coefficients, load, stone)
    sigma = _noise(NOISE if sigma is None else sigma)
    rates = (rate,) if isinstance(rate, int | float) else tuple(rate)
    _check(v0, omega0, rates, until, throws, relative_error)
    free = ParameterSet.build(kind).free[: len(values)]
    pair = None if separate is None else CoefficientPair(kind, values, free, separate)
    candidates = [
        PlannedThrow(float(v), float(w), float(hertz), stone)
        for v, w, hertz in product(v0, omega0, rates)
    ]
    if len(candidates) > _MAX_CANDIDATES:
        raise InputError(
            f"{len(v0)} speeds, {len(omega0)} spins and {len(rates)} rates make {len(candidates)} "
            f"candidates; expected at most {_MAX_CANDIDATES}"
        )
    channels = 5 if {"speed", "omega"} & sigma.keys() else 3
    if not 0 <= discrepancy < math.inf:
        raise InputError(f"discrepancy = {discrepancy:g}; expected 0 or more, over the friction")
    exact: dict[str, Any] = {"until": until, "channels": channels}
    record = exact | {"discrepancy": discrepancy}
    separated = kind.sums or separate
    for one_load in ("uniform", "consistent") if separated else (load,):
        prepare_information(kind, check_load(one_load), values, candidates[0], channels)
    progress("the information of each throw")
    records = record_information(kind, load, values, candidates, **record)
    model = _DesignModel(kind, values, free, sigma)
    factors = [model.factor(one) for one in records]
    candidate_set = CandidateSet.from_factors(factors)
    if not candidate_set.rank:
        raise InputError(f"these throws determine no coefficient of law {kind.name}")
    together = model.identifiability(combined(factors))
    quantities = model.quantities(together)
    best = {}
    for name, criterion in (("D", d_criterion), ("A", a_criterion(candidate_set))):
        indices = select_design(candidate_set, criterion, throws)
        if indices is not None:
            best[name] = model.expected(indices, factors)
    if not best:
        raise InputError(
            f"no {throws} of these throws determine what all of them together do; increase "
            "the number of throws, or give other candidates"
        )
    by_load: dict[str, list[RecordInformation]] = {} if discrepancy else {load: records}
    if pair is None:
        if load == "consistent":
            progress("the directions hidden under uniform load")
            by_load["uniform"] = record_information(kind, "uniform", values, candidates, **exact)
            hidden = [model.factor(one) for one in by_load["uniform"]]
            together = model.identifiability(combined(hidden))
        names = _undetermined_pair(together)
        pair = None if names is None else CoefficientPair(kind, values, free, names)
    progress("errors against noise, rate and number of throws")
    curves = _curves(
        model, candidate_set, factors, records, candidates, best, load, record, quantities
    )
    progress("systematic errors")
    made = next(iter(best.values())).throws
    found = scenarios(
        Model(kind, load), values, [candidates[index] for index in made], free, sigma, quantities,
        record,
    )  # fmt: skip
    separation = None
    if pair is not None:
        separation = analyse_separation(
            pair, candidates, throws, sigma, relative_error, exact, by_load, progress
        )
    return Design(
        law=kind.name,
        load=load,
        stone=stone,
        coefficients=model.named(values),
        symbols={item.name: item.symbol for item in kind.coefficients()},
        units={item.name: item.unit for item in kind.coefficients()},
        typical={item.name: item.typical for item in kind.coefficients()},
        sigma=sigma,
        until=until,
        throws=throws,
        candidates=tuple(
            Candidate(
                planned.v0, planned.omega0, planned.rate, one.rows, one.last, one.rest,
                one.distance, model.errors(factor, quantities),
            )
            for planned, one, factor in zip(candidates, records, factors, strict=True)
        ),
        quantities=quantities,
        rank=candidate_set.rank,
        free=int(free.sum()),
        best=best,
        curves=curves,
        separation=separation,
        notes=_notes(rates, until, records, discrepancy),
        discrepancy=discrepancy,
        scenarios=found,
    )  # fmt: skip


class _DesignModel:
    """Coefficients and noise, and the analysis of information factors for them."""

    def __init__(
        self, law: type[Law], values: Floats, free: Booleans, sigma: dict[str, float]
    ) -> None:
        items = law.coefficients()
        self.law, self.values, self.free, self.sigma = law, values, free, sigma
        self.all = [item.name for item in items]
        self.names = [name for name, take in zip(self.all, free, strict=True) if take]
        self.typical = np.array([item.typical for item in items])[free]
        # A bound beyond which the value lies was not that of its fit.
        lower = [
            item.lower if value > item.lower else -np.inf
            for item, value in zip(items, values, strict=True)
        ]
        upper = [
            item.upper if value < item.upper else np.inf
            for item, value in zip(items, values, strict=True)
        ]
        self.bounded = Bounded(values[free], np.array(lower)[free], np.array(upper)[free])

    def factor(self, one: RecordInformation, **noise: float) -> Floats:
        """R factor of the information on the free coefficients, for noise scaled by channel."""
        sigma = {name: value * noise.get(name, 1.0) for name, value in self.sigma.items()}
        return coefficient_information(self.law, one, sigma, self.free)

    def named(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.all, map(float, values), strict=True))

    def identifiability(self, factor: Floats) -> Identifiability:
        return analyse(
            factor / self.typical, self.names, self.values[self.free], self.typical,
            bounded=self.bounded,
        )  # fmt: skip

    def quantities(self, together: Identifiability) -> dict[str, dict[str, float]]:
        """The determined coefficients and combinations, as weights."""
        found = {
            name: {name: 1.0}
            for name, unseen in zip(self.names, together.unseen, strict=True)
            if not unseen
        }
        return found | {item.expression: item.weights for item in together.combinations}

    def errors(
        self, factor: Floats, quantities: Mapping[str, Mapping[str, float]]
    ) -> dict[str, float | None]:
        factor = confined(factor / self.typical, self.bounded, self.typical) * self.typical
        return {
            name: standard_error(
                factor, np.array([weights.get(name, 0.0) for name in self.names]) * self.typical
            )
            for name, weights in quantities.items()
        }

    def expected(self, indices: Sequence[int], factors: Sequence[Floats]) -> ExpectedErrors:
        found = self.identifiability(combined([factors[index] for index in indices]))
        stderr: dict[str, float | None] = dict.fromkeys(self.all)
        verdicts = dict.fromkeys(self.all, "fixed")
        for index, name in enumerate(self.names):
            stderr[name], verdicts[name] = classify(float(self.typical[index]), False, found, index)
        return ExpectedErrors(
            throws=tuple(indices),
            stderr=stderr | {item.expression: item.stderr for item in found.combinations},
            verdicts=verdicts,
            combinations=found.combinations,
            rank=found.rank,
            singular_values=tuple(map(float, found.singular_values)),
            null_directions=found.null_directions,
        )


def _assumed(
    law: str | type[Law] | FitResult,
    coefficients: Mapping[str, float] | None,
    load: str | None,
    stone: Stone | None,
) -> tuple[type[Law], Floats, Load, Stone]:
    """Assumed law, values of its coefficients, load and stone."""
    fitted = {}
    if isinstance(law, FitResult):
        fitted = {name: item.value for name, item in law.coefficients.items()}
        load, stone = load or law.load, stone or law.stone
        law = law.law_class
    instance = law_with(law, coefficients or {}, others=fitted)
    values = np.array([float(getattr(instance, item.name)) for item in instance.coefficients()])
    return type(instance), values, check_load(load or "uniform"), stone or Stone()


def _noise(sigma: Mapping[str, float]) -> dict[str, float]:
    for name, value in sigma.items():
        if name not in CHANNELS:
            raise InputError(
                f"sigma: no channel {quoted(name)}; the channels are {', '.join(CHANNELS)}"
            )
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"sigma of {name} = {value:g}: expected a positive number")
    if not sigma:
        raise InputError("sigma: nothing is measured; expected the noise of at least one channel")
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
    if isinstance(throws, bool) or not isinstance(throws, int) or not 1 <= throws <= _MAX_THROWS:
        raise InputError(f"throws = {throws}: expected a whole number from 1 to {_MAX_THROWS}")


def _undetermined_pair(found: Identifiability) -> tuple[str, str] | None:
    """Two coefficients of which only the sum is determined, if any."""
    for direction in found.null_directions:
        if len(direction) == 2 and sum(direction.values()) == 0:
            first, second = direction
            return first, second
    return None


def _curves(
    model: _DesignModel,
    candidate_set: CandidateSet,
    factors: Sequence[Floats],
    records: Sequence[RecordInformation],
    candidates: Sequence[PlannedThrow],
    best: Mapping[str, ExpectedErrors],
    load: Load,
    record: Mapping[str, Any],
    quantities: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, list[float | None]]]:
    """Standard errors against noise of position, noise of angle, rate and number of throws."""
    made = next(iter(best.values())).throws

    def series(at: Sequence[float], factors_of: Sequence[Floats]) -> dict[str, list[float | None]]:
        rows = [model.errors(factor, quantities) for factor in factors_of]
        errors = {name: [row[name] for row in rows] for name in quantities}
        return {"at": [*at], **errors}

    found: dict[str, dict[str, list[float | None]]] = {}
    for name, channels in (("place", _POSITION), ("angle", _ANGLE)):
        if not model.sigma.keys() & set(channels):
            continue
        factors_of = [
            combined([model.factor(records[p], **dict.fromkeys(channels, factor)) for p in made])
            for factor in _FACTORS
        ]
        found[name] = series(_FACTORS, factors_of)
    distinct = sorted(set(made))
    factors_of = []
    for rate in _RATES:
        resampled = record_information(
            model.law,
            load,
            model.values,
            [candidates[p]._replace(rate=rate) for p in distinct],
            **record,
        )
        by_index = {
            index: model.factor(one) for index, one in zip(distinct, resampled, strict=True)
        }
        factors_of.append(combined([by_index[index] for index in made]))
    found["rate"] = series(_RATES, factors_of)
    counts, factors_of = [], []
    for count in _COUNTS:
        indices = select_design(candidate_set, d_criterion, count)
        if indices is not None:
            counts.append(float(count))
            factors_of.append(combined([factors[index] for index in indices]))
    found["throws"] = series(counts, factors_of)
    return found


def _notes(
    rates: Sequence[float],
    until: float | None,
    records: Sequence[RecordInformation],
    discrepancy: float,
) -> tuple[str, ...]:
    notes = [
        "these errors hold if the law is correct and noise is independent from row to row; the "
        "discrepancy of a law does not average out: `--discrepancy 0.05` allows for one"
    ]
    if discrepancy:
        notes = [
            "these errors allow for accelerations that the law lacks, of "
            f"{100 * discrepancy:.2g} % of what friction does and independent from throw to "
            "throw; where they recur, more throws help less"
        ]
    if len(rates) > 1:
        notes.append(
            "with independent noise more rows always reduce the errors: the highest rate is chosen"
        )
    if until is not None and (early := sum(one.rest > until for one in records)):
        notes.append(
            f"of {len(records)} records {early} end at {until:g} s, before the stone is at rest"
        )
    far = [one.distance for one in records if one.distance > _LONGEST_DISTANCE]
    if until is None and far:
        notes.append(
            f"{len(far)} of {len(records)} throws go up to {max(far):.1f} m; from the hog line to "
            f"the far back line there are {_LONGEST_DISTANCE:.1f} m"
        )
    return tuple(notes)
