"""Optimal design: the expected errors of planned throws, and the best choice of throws.

Standard errors are the Cramer-Rao bound (J^T W J)^-1 at the assumed values, with a separate initial
state for each throw and common coefficients. They are valid for noise that is independent from row
to row and a correct law; the discrepancy of a law does not average out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.friction import Law, Load, check_load
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import Identifiability, analyse, classify
from curlfit.numerics.arrays import Floats
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    RecordInformation,
    combined,
    marginal_factor,
    prepare_information,
    record_information,
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
    assumed = Assumptions(kind, values, sigma, until, discrepancy)
    pair = None if separate is None else CoefficientPair(assumed, separate)
    candidates = [
        PlannedThrow(float(v), float(w), float(hertz), stone)
        for v, w, hertz in product(v0, omega0, rates)
    ]
    if len(candidates) > _MAX_CANDIDATES:
        raise InputError(
            f"{len(v0)} speeds, {len(omega0)} spins and {len(rates)} rates make {len(candidates)} "
            f"candidates; expected at most {_MAX_CANDIDATES}"
        )
    if not 0 <= discrepancy < math.inf:
        raise InputError(f"discrepancy = {discrepancy:g}; expected 0 or more, over the friction")
    for one_load in ("uniform", "consistent") if kind.sums or separate else (load,):
        prepare_information(assumed, check_load(one_load), candidates[0])
    progress("the information of each throw")
    records = record_information(assumed, load, candidates)
    factors = [marginal_factor(assumed, one) for one in records]
    candidate_set = CandidateSet.from_factors(factors)
    if not candidate_set.rank:
        raise InputError(f"these throws determine no coefficient of law {kind.name}")
    together = _identifiability(assumed, factors)
    # The determined coefficients and combinations.
    quantities = {
        name: {name: 1.0}
        for name, unseen in zip(assumed.names, together.unseen, strict=True)
        if not unseen
    } | {item.expression: item.weights for item in together.combinations}
    best = {}
    for name, criterion in (("D", d_criterion), ("A", a_criterion(candidate_set))):
        indices = select_design(candidate_set, criterion, throws)
        if indices is not None:
            best[name] = _expected(assumed, indices, factors)
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
            hidden = record_information(exact, "uniform", candidates)
            by_load["uniform"] = [marginal_factor(exact, one) for one in hidden]
            together = _identifiability(assumed, by_load["uniform"])
        names = _undetermined_pair(together)
        pair = None if names is None else CoefficientPair(exact, names)
    progress("errors against noise, rate and number of throws")
    made = next(iter(best.values())).throws
    curves = _curves(assumed, load, candidates, records, made, quantities)
    progress("systematic errors")
    found = scenarios(assumed, load, [candidates[index] for index in made], quantities)
    separation = None
    if pair is not None:
        separation = analyse_separation(
            exact, pair, candidates, throws, relative_error, by_load, progress
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
                planned.v0, planned.omega0, planned.rate, one.rows, one.last, one.rest,
                one.distance, assumed.errors(factor, quantities),
            )
            for planned, one, factor in zip(candidates, records, factors, strict=True)
        ),
        quantities=quantities,
        rank=candidate_set.rank,
        free=len(assumed.free),
        best=best,
        curves=curves,
        separation=separation,
        notes=_notes(rates, until, records, discrepancy),
        discrepancy=discrepancy,
        scenarios=found,
    )  # fmt: skip


def _identifiability(assumed: Assumptions, factors: Sequence[Floats]) -> Identifiability:
    """What some throws together determine."""
    return analyse(
        combined(factors) / assumed.typical, assumed.names, assumed.bounded.values,
        assumed.typical, bounded=assumed.bounded,
    )  # fmt: skip


def _expected(
    assumed: Assumptions, indices: Sequence[int], factors: Sequence[Floats]
) -> ExpectedErrors:
    found = _identifiability(assumed, [factors[index] for index in indices])
    every = [item.name for item in assumed.law.coefficients()]
    judged = dict.fromkeys(every, (None, "fixed")) | {
        name: classify(float(assumed.typical[index]), False, found, index)
        for index, name in enumerate(assumed.names)
    }
    stderr = {name: error for name, (error, _) in judged.items()}
    return ExpectedErrors(
        throws=tuple(indices),
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
    load: Load,
    candidates: Sequence[PlannedThrow],
    records: Sequence[RecordInformation],
    made: Sequence[int],
    quantities: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, list[float | None]]]:
    """Standard errors against noise of position, noise of angle, rate and number of throws."""

    def together(assumed: Assumptions, records: Mapping[int, RecordInformation]) -> Floats:
        """The information of the throws that are made."""
        return combined([marginal_factor(assumed, records[index]) for index in made])

    def series(at: Iterable[float], factors: Iterable[Floats]) -> dict[str, list[float | None]]:
        rows = [assumed.errors(factor, quantities) for factor in factors]
        return {"at": list[float | None](at)} | {
            name: [row[name] for row in rows] for name in quantities
        }

    known = dict(enumerate(records))
    found = {}
    for name, channels in (("place", _POSITION), ("angle", _ANGLE)):
        if noisy := assumed.sigma.keys() & channels:
            others = (assumed.noisier(noisy, factor) for factor in _FACTORS)
            found[name] = series(_FACTORS, [together(other, known) for other in others])
    at_rate = []
    for rate in _RATES:
        distinct = {index: candidates[index]._replace(rate=rate) for index in made}
        resampled = record_information(assumed, load, list(distinct.values()))
        at_rate.append(together(assumed, dict(zip(distinct, resampled, strict=True))))
    found["rate"] = series(_RATES, at_rate)
    factors = [marginal_factor(assumed, one) for one in records]
    candidate_set = CandidateSet.from_factors(factors)
    chosen = {float(n): select_design(candidate_set, d_criterion, n) for n in _COUNTS}
    chosen = {count: indices for count, indices in chosen.items() if indices is not None}
    found["throws"] = series(
        chosen,
        [combined([factors[index] for index in indices or ()]) for indices in chosen.values()],
    )
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
