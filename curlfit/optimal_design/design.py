"""Optimal design: the expected errors of planned throws, and the best choice of throws.

Standard errors are the Cramer-Rao bound (J^T W J)^-1 at the assumed values, with a separate initial
state for each throw and common coefficients. They are valid for noise that is independent from row
to row and a correct law; the discrepancy of a law does not average out.

Where the ice slopes, throws with opposite spins or in opposite directions are affected in opposite
ways. For throws as planned, and with equal shares of them thrown otherwise, the shift of the
coefficients by each condition is that of the joint least-squares fit, to first order
(`curlfit.inference.fit.systematics`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.friction import Law, Load, check_load
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.systematics import shifts, widths_of
from curlfit.inference.identifiability import Identifiability, analyse, classify
from curlfit.inference.parameters import START
from curlfit.numerics.arrays import Floats
from curlfit.optimal_design.information import (
    Assumptions,
    CandidateSet,
    PlannedThrow,
    RecordInformation,
    combined,
    d_criterion,
    error_criterion,
    marginal_factor,
    marginal_factors,
    prepare_information,
    record_information,
    select_design,
    standard_error,
)
from curlfit.optimal_design.result import Candidate, Design, ExpectedErrors, Scenario
from curlfit.optimal_design.separability import CoefficientPair, analyse_separation
from curlfit.sheet import LINES, TEE, TEE_TO_BACK
from curlfit.stone import Stone
from curlfit.throws.synthetic import law_with
from curlfit.throws.throw import CHANNELS

SPEEDS = (1.6, 1.9, 2.2)
SPINS = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Default candidates: m/s, and rad/s from a draw to a hard spinner."""
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
"""Noise of a camera above the ice, m and rad."""

SCENARIOS = {
    "as planned": ((1, 0.0),),
    "both spins": ((1, 0.0), (-1, 0.0)),
    "both directions": ((1, 0.0), (1, math.pi)),
    "both spins and directions": ((1, 0.0), (-1, 0.0), (1, math.pi), (-1, math.pi)),
}
"""Sense of spin and heading (rad) of equal shares of the throws."""
_MAX_CANDIDATES = 500
_MAX_THROWS = 1000
_FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # factors on the noise, for the curves
_RATES = (1.0, 3.0, 10.0, 30.0, 100.0)  # Hz
_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)  # throws
_LONGEST_DISTANCE = TEE + TEE_TO_BACK - LINES["hog"]
_POSITION, _ANGLE = {"x", "y", "speed"}, {"phi", "omega"}


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
    assumed = Assumptions(kind, load, values, sigma, until, discrepancy)
    pair = None if separate is None else CoefficientPair(assumed, separate)
    planned = [
        PlannedThrow(float(v), float(w), float(hertz), stone)
        for v, w, hertz in product(v0, omega0, rates)
    ]
    if len(planned) > _MAX_CANDIDATES:
        raise InputError(
            f"{len(v0)} speeds, {len(omega0)} spins and {len(rates)} rates make {len(planned)} "
            f"candidates; expected at most {_MAX_CANDIDATES}"
        )
    if not 0 <= discrepancy < math.inf:
        raise InputError(f"discrepancy = {discrepancy:g}; expected 0 or more, over the friction")
    for one_load in ("uniform", "consistent") if kind.sums or separate else (load,):
        prepare_information(replace(assumed, load=check_load(one_load)), planned[0])
    progress("the information of each throw")
    records = record_information(assumed, planned)
    factors = [marginal_factor(assumed, one) for one in records]
    candidates = CandidateSet.from_factors(factors)
    if not candidates.rank:
        raise InputError(f"these throws determine no coefficient of law {kind.name}")
    together = _identifiability(assumed, combined(factors))
    # The determined coefficients and combinations.
    quantities = {
        name: {name: 1.0}
        for name, unseen in zip(assumed.names, together.unseen, strict=True)
        if not unseen
    } | {item.expression: item.weights for item in together.combinations}
    a_criterion = error_criterion(candidates, np.eye(len(assumed.free)))
    best = {
        name: _expected(assumed, indices, candidates.together(indices))
        for name, criterion in (("D", d_criterion), ("A", a_criterion))
        if (indices := select_design(candidates, criterion, throws)) is not None
    }
    if not best:
        raise InputError(
            f"no {throws} of these throws determine what all of them together do; increase "
            "the number of throws, or give other candidates"
        )
    exact = replace(assumed, discrepancy=0.0)
    by_load: dict[Load, list[Floats]] = {} if discrepancy else {load: factors}
    if pair is None:
        if load == "consistent":
            progress("the directions hidden under uniform load")
            by_load["uniform"] = marginal_factors(replace(exact, load="uniform"), planned)
            together = _identifiability(assumed, combined(by_load["uniform"]))
        names = _undetermined_pair(together)
        pair = None if names is None else CoefficientPair(exact, names)
    progress("errors against noise, rate and number of throws")
    made = next(iter(best.values())).throws
    curves = _curves(assumed, planned, records, candidates, made, quantities)
    progress("systematic errors")
    found = scenarios(assumed, [planned[index] for index in made], quantities)
    separation = None
    if pair is not None:
        separation = analyse_separation(
            exact, pair, planned, throws, relative_error, by_load, progress
        )
    items = {item.name: item for item in kind.coefficients()}
    return Design(
        law=kind.name,
        load=load,
        stone=stone,
        coefficients=dict(zip(items, values.tolist(), strict=True)),
        symbols={name: item.symbol for name, item in items.items()},
        units={name: item.unit for name, item in items.items()},
        typical={name: item.typical for name, item in items.items()},
        sigma=sigma,
        until=until,
        throws=throws,
        candidates=tuple(
            Candidate(
                *throw[:3], one.rows, one.last, one.rest, one.distance,
                assumed.errors(factor, quantities),
            )
            for throw, one, factor in zip(planned, records, factors, strict=True)
        ),
        quantities=quantities,
        rank=candidates.rank,
        free=len(assumed.free),
        best=best,
        curves=curves,
        separation=separation,
        notes=_notes(rates, until, records, discrepancy),
        discrepancy=discrepancy,
        scenarios=found,
    )  # fmt: skip


def _identifiability(assumed: Assumptions, factor: Floats) -> Identifiability:
    """What an R factor of information determines."""
    return analyse(
        factor / assumed.typical, assumed.names, assumed.bounded.values, assumed.typical,
        bounded=assumed.bounded,
    )  # fmt: skip


def _expected(assumed: Assumptions, indices: tuple[int, ...], factor: Floats) -> ExpectedErrors:
    """The errors expected from some candidates, with their information together."""
    found = _identifiability(assumed, factor)
    every = [item.name for item in assumed.law.coefficients()]
    judged = dict.fromkeys(every, (None, "fixed")) | {
        name: classify(float(assumed.typical[index]), False, found, index)
        for index, name in enumerate(assumed.names)
    }
    stderr = {name: error for name, (error, _) in judged.items()}
    return ExpectedErrors(
        throws=indices,
        stderr=stderr | {item.expression: item.stderr for item in found.combinations},
        verdicts={name: verdict for name, (_, verdict) in judged.items()},
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
    assumed: Assumptions,
    planned: Sequence[PlannedThrow],
    records: Sequence[RecordInformation],
    candidates: CandidateSet,
    made: Sequence[int],
    quantities: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, list[float | None]]]:
    """Standard errors against noise of position, noise of angle, rate and number of throws."""

    def series(at: Iterable[float], factors: Iterable[Floats]) -> dict[str, list[float | None]]:
        rows = [assumed.errors(factor, quantities) for factor in factors]
        return {"at": list[float | None](at)} | {
            name: [row[name] for row in rows] for name in quantities
        }

    def together(other: Assumptions) -> Floats:
        return combined([marginal_factor(other, records[index]) for index in made])

    found = {}
    for name, channels in (("place", _POSITION), ("angle", _ANGLE)):
        if noisy := assumed.sigma.keys() & channels:
            others = (assumed.noisier(noisy, factor) for factor in _FACTORS)
            found[name] = series(_FACTORS, map(together, others))
    at_rate = []
    for rate in _RATES:
        distinct = {index: planned[index]._replace(rate=rate) for index in made}
        factors = marginal_factors(assumed, list(distinct.values()))
        known = dict(zip(distinct, factors, strict=True))
        at_rate.append(combined([known[index] for index in made]))
    found["rate"] = series(_RATES, at_rate)
    chosen = {
        float(count): indices
        for count in _COUNTS
        if (indices := select_design(candidates, d_criterion, count)) is not None
    }
    found["throws"] = series(chosen, map(candidates.together, chosen.values()))
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


def scenarios(
    assumed: Assumptions,
    throws: Sequence[PlannedThrow],
    quantities: Mapping[str, Mapping[str, float]],
) -> tuple[Scenario, ...]:
    """Expected errors of throws as planned, and with equal shares of them thrown otherwise.

    `quantities` are coefficients and combinations as weights.
    """
    typical, n = assumed.typical, len(assumed.free)
    rows = {name: assumed.weights(weights) for name, weights in quantities.items()}
    count, widths = Counter(throws), widths_of(assumed.model)
    ways = SCENARIOS["both spins and directions"]
    varied = [
        one._replace(omega0=sense * one.omega0, heading=heading)
        for one in count
        for sense, heading in ways
    ]
    records = record_information(assumed, varied, widths)
    conditions = len(assumed.values) + len(START) + np.arange(len(widths))
    columns = np.concatenate([assumed.free, conditions])
    factors = [marginal_factor(assumed, one, columns) for one in records]
    found = []
    for name, chosen in SCENARIOS.items():
        whole = combined(
            [
                factors[len(ways) * index + ways.index(way)] * math.sqrt(number / len(chosen))
                for index, number in enumerate(count.values())
                for way in chosen
            ]
        )
        factor = whole[:, :n]
        gradients = {
            condition: factor.T @ whole[:, n + k] / typical for k, condition in enumerate(widths)
        }
        by_condition = shifts(factor / typical, gradients, typical)
        by_quantity = {
            quantity: {
                condition: float(row @ (shift / typical))
                for condition, shift in by_condition.items()
            }
            for quantity, row in rows.items()
        }
        stderr = {quantity: standard_error(factor, row) for quantity, row in rows.items()}
        found.append(Scenario(name, stderr, by_quantity))
    return tuple(found)
