"""Optimal design: the expected errors of planned throws, and the best choice of throws.

Standard errors are the Cramer-Rao bound (J^T W J)^-1 at the assumed values, with a
separate initial state for each throw and common coefficients. They are valid for noise
that is independent from row to row and a correct law; the discrepancy of a law does not
average out.

Where the ice slopes, throws with opposite spins or in opposite directions are affected
in opposite ways. For throws as planned, and with equal shares of them thrown otherwise,
the shift of the coefficients by each condition is that of the joint least-squares fit,
to first order (`curlfit.inference.fit.systematics`).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from curlfit.errors import InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import quoted
from curlfit.friction import Law, Load, check_load
from curlfit.inference.fit.departures import Departures
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.information.directions import r_factor, standard_error
from curlfit.inference.information.identifiability import Identifiability
from curlfit.inference.information.thresholds import WEAK_ERROR
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.optimal_design.departures import errors_along, expected_departures
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    record_information,
)
from curlfit.optimal_design.result import (
    Candidate,
    Design,
    ExpectedErrors,
    LoadScenario,
    Scenario,
    Separation,
    difference_of,
)
from curlfit.optimal_design.selection import (
    CandidateSet,
    Criterion,
    combined,
    d_criterion,
    error_criterion,
    select_design,
)
from curlfit.stone import Stone
from curlfit.throws.channels import CHANNELS
from curlfit.throws.synthetic import law_with

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
# abscissas of the curves
_FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # on the noise
_RATES = (1.0, 3.0, 10.0, 30.0, 100.0)  # Hz
_COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)  # throws
_POSITION = {"x", "y", "speed"}
_ANGLE = {"phi", "omega"}


def design(
    law: str | type[Law] | FitResult = "front-back",
    *,
    coefficients: Mapping[str, float] | None = None,
    load: str | None = None,
    stone: Stone | None = None,
    v0: Sequence[float] = SPEEDS,
    omega0: Sequence[float] = SPINS,
    rate: float = 30.0,
    until: float | None = None,
    sigma: Mapping[str, float] | None = None,
    discrepancy: float = 0.0,
    throws: int = 3,
    separate: Sequence[str] | None = None,
) -> Design:
    """The expected errors of the coefficients of a law from planned throws.

    Parameters
    ----------
    law : name or class of the law; or a fit, for its law, coefficients, load and stone.
    coefficients : assumed values, in place of the law's defaults or the fit's values.
    load, stone : "uniform" or "consistent" (eq. 8-9); `Stone()`.
    v0, omega0 : speeds (m/s) and spins (rad/s): all combinations are candidates.
    rate : rows per second.
    until : end of the records in s; the time of rest if not given.
    sigma : noise by channel (m, rad, m/s, rad/s) of x, y, phi, speed, omega; other
        channels are not measured. 5 mm and 10 mrad if not given.
    discrepancy : size of the accelerations that the law may lack, relative to the
        friction, such as 0.05; they are functions of speed, see
        `curlfit.inference.noise.accelerations`.
    throws : number of throws, chosen optimally among the candidates, with repetition.
    separate : two coefficients, of whose difference the throws are to have the least
        standard error, as a further criterion; if not given, two of which the
        candidates under uniform load determine only the sum.

    Raises
    ------
    InputError : an invalid value, an unknown law, load, channel or coefficient, or
        throws that determine nothing.

    Examples
    --------
    >>> plan = curlfit.design("front-back", v0=[2.0, 2.2], omega0=[1.0, 5.0])
    >>> len(plan.candidates), plan.rank
    (4, 3)
    """
    assumed, planned = planned_throws(
        law,
        coefficients=coefficients,
        load=load,
        stone=stone,
        v0=v0,
        omega0=omega0,
        rate=rate,
        sigma=sigma,
        until=until,
        throws=throws,
    )
    pair = None
    if separate is not None:
        pair = _checked_pair(assumed, separate)
    if not 0 <= discrepancy < math.inf:
        raise InputError(
            f"discrepancy = {discrepancy:g}; expected 0 or more, over the friction"
        )
    assumed = replace(assumed, discrepancy=discrepancy)
    return _designed(assumed, pair, planned, throws)


def _checked_pair(assumed: Assumptions, separate: Sequence[str]) -> tuple[str, str]:
    """Two different free coefficients of one unit. Raises `InputError` for others."""
    if len(separate) != 2 or separate[0] == separate[1]:
        raise InputError(
            "separate: expected two different coefficients, such as mu1_eta,mu2_eta"
        )
    units = {
        coefficient.name: coefficient.unit
        for coefficient in assumed.law.coefficients()
        if coefficient.name in assumed.names
    }
    for name in separate:
        if name not in units:
            raise InputError(
                f"separate: law {assumed.law.name} has no free coefficient "
                f"{quoted(name)}; it has {', '.join(units)}"
            )
    first, second = separate
    if units[first] != units[second]:
        raise InputError(
            f"separate: {first} ({units[first]}) and {second} ({units[second]}) have "
            "different units, and no difference"
        )
    return first, second


def _designed(
    assumed: Assumptions,
    pair: tuple[str, str] | None,
    planned: Sequence[PlannedThrow],
    throws: int,
) -> Design:
    """The design of throws among planned ones."""
    law = assumed.law
    records = assumed.records(planned)
    factors = assumed.factors(planned)
    candidates = CandidateSet.from_factors(factors)
    if not candidates.rank:
        raise InputError(f"these throws determine no coefficient of law {law.name}")
    factor_of_all = combined(factors)
    if pair is None:
        pair = _undetermined_pair(assumed, planned)
    difference = {} if pair is None else _difference(assumed, pair, factor_of_all)
    selections = _selections(assumed, candidates, difference, throws)
    plans = [[planned[index] for index in indices] for indices in selections.values()]
    singles = [[throw] for throw in planned]
    departures = expected_departures(assumed, [*plans, *singles])
    departures_of_plans = departures[: len(plans)]
    departures_of_throws = departures[len(plans) :]
    best = {}
    for (criterion, indices), departures_of_plan in zip(
        selections.items(), departures_of_plans, strict=True
    ):
        best[criterion] = _expected(
            assumed,
            indices,
            candidates.together(indices),
            departures_of_plan,
            difference,
        )
    identifiability = Identifiability.of(assumed.information(factor_of_all))
    quantities = _quantities(assumed, identifiability, best.values()) | difference
    throws_alone = []
    for throw, record, factor, departures_of_throw in zip(
        planned, records, factors, departures_of_throws, strict=True
    ):
        throw_alone = Candidate(
            v0=throw.v0,
            omega0=throw.omega0,
            rate=throw.rate,
            rows=record.rows,
            last=record.last,
            rest=record.rest.time,
            distance=record.rest.distance,
            stderr=errors_along(assumed, factor, quantities, departures_of_throw),
        )
        throws_alone.append(throw_alone)
    separation = None
    if pair is not None:
        separation = _separation(assumed, pair, planned, throws, best)
    coefficients = law.coefficients()
    names = [coefficient.name for coefficient in coefficients]
    return Design(
        law=law.name,
        load=assumed.load,
        stone=planned[0].stone,
        coefficients=dict(zip(names, assumed.values.tolist(), strict=True)),
        symbols={coefficient.name: coefficient.symbol for coefficient in coefficients},
        units={coefficient.name: coefficient.unit for coefficient in coefficients},
        typical={coefficient.name: coefficient.typical for coefficient in coefficients},
        sigma=dict(assumed.sigma),
        until=assumed.until,
        throws=throws,
        candidates=tuple(throws_alone),
        quantities=quantities,
        rank=candidates.rank,
        free=len(assumed.free),
        best=best,
        curves=_curves(assumed, plans[0], candidates, quantities),
        separation=separation,
        notes=_notes(assumed, planned, separation),
        discrepancy=assumed.discrepancy,
        scenarios=_scenarios(assumed, plans[0], quantities),
    )


def _quantities(
    assumed: Assumptions,
    identifiability: Identifiability,
    best: Iterable[ExpectedErrors],
) -> dict[str, dict[str, float]]:
    """What all candidates determine, as weights: coefficients, and combinations that
    hold for the best throws too."""
    names = itertools.compress(assumed.names, ~identifiability.unseen)
    quantities = {name: {name: 1.0} for name in names}
    errors_of_best = [errors.stderr for errors in best]
    for combination in identifiability.combinations:
        if all(combination.expression in stderr for stderr in errors_of_best):
            quantities[combination.expression] = combination.weights
    return quantities


def _difference(
    assumed: Assumptions, pair: tuple[str, str], factor: Floats
) -> dict[str, dict[str, float]]:
    """The difference of two coefficients, by name, as weights; nothing where an R
    factor of information does not determine it."""
    first, second = pair
    weights = {first: 1.0, second: -1.0}
    if standard_error(factor, assumed.weights(weights)) is None:
        return {}
    return {difference_of(pair): weights}


def _selections(
    assumed: Assumptions,
    candidates: CandidateSet,
    difference: Mapping[str, Mapping[str, float]],
    throws: int,
) -> dict[str, tuple[int, ...]]:
    """Indices of the optimal throws by criterion."""
    criteria: dict[str, Criterion] = {
        "D": d_criterion,
        "A": error_criterion(candidates, np.eye(len(candidates.basis))),
    }
    for weights in difference.values():
        criteria["C"] = error_criterion(candidates, assumed.weights(weights))
    selections = {}
    for name, criterion in criteria.items():
        indices = select_design(candidates, criterion, throws)
        if indices is not None:
            selections[name] = indices
    if not selections:
        raise InputError(
            f"no {throws} of these throws determine what all of them together do; "
            "increase the number of throws, or give other candidates"
        )
    return selections


def _separation(
    assumed: Assumptions,
    pair: tuple[str, str],
    planned: Sequence[PlannedThrow],
    throws: int,
    best: Mapping[str, ExpectedErrors],
) -> Separation:
    """The throws with the least standard error of a difference, under each load."""
    ways = []
    for load in Load:
        scenario = LoadScenario(load, None, None)
        if load != assumed.load:
            under_load = replace(assumed, load=load)
            scenario = _least_error(under_load, pair, planned, throws)
        elif "C" in best:
            stderr = best["C"].stderr[difference_of(pair)]
            if stderr is not None:
                scenario = LoadScenario(load, best["C"].throws, stderr)
        ways.append(scenario)
    return Separation(pair, tuple(ways))


def _least_error(
    assumed: Assumptions,
    pair: tuple[str, str],
    planned: Sequence[PlannedThrow],
    throws: int,
) -> LoadScenario:
    """The throws with the least standard error of a difference, and this error to first
    order, under the load that is assumed."""
    undetermined = LoadScenario(assumed.load, None, None)
    factors = assumed.factors(planned)
    difference = _difference(assumed, pair, combined(factors))
    if not difference:
        return undetermined
    candidates = CandidateSet.from_factors(factors)
    weights = assumed.weights(difference[difference_of(pair)])
    indices = select_design(candidates, error_criterion(candidates, weights), throws)
    if indices is None:
        return undetermined
    errors = assumed.errors(candidates.together(indices), difference)
    stderr = errors[difference_of(pair)]
    if stderr is None:
        return undetermined
    return LoadScenario(assumed.load, indices, stderr)


def _expected(
    assumed: Assumptions,
    indices: tuple[int, ...],
    factor: Floats,
    departures: Departures,
    difference: Mapping[str, Mapping[str, float]],
) -> ExpectedErrors:
    """The errors expected from some candidates, with their information together."""
    identifiability = Identifiability.of(assumed.information(factor))
    combinations = tuple(departures.kept(identifiability.combinations))
    stderr: dict[str, float | None] = {}
    verdicts: dict[str, Verdict] = {}
    for coefficient in assumed.law.coefficients():
        name = coefficient.name
        error: float | None = None
        verdict = Verdict.FIXED
        if name in assumed.names:
            index = assumed.names.index(name)
            typical = float(assumed.typical[index])
            error, verdict = identifiability.classified(index)
            # along the ridge
            error, verdict, _ = departures.judged(name, error, verdict, typical)
        stderr[name] = error
        verdicts[name] = verdict
    for name, error in errors_along(assumed, factor, difference, departures).items():
        typical_sizes = dict(zip(assumed.names, assumed.typical, strict=True))
        smallest = min(typical_sizes[coefficient] for coefficient in difference[name])
        stderr[name] = error
        verdicts[name] = _verdict(error, smallest)
    for combination in combinations:
        stderr[combination.expression] = combination.stderr
    return ExpectedErrors(
        throws=indices,
        stderr=stderr,
        verdicts=verdicts,
        combinations=combinations,
        rank=identifiability.rank,
        singular_values=tuple(identifiability.singular_values.tolist()),
        null_directions=identifiability.null_directions,
    )


def _verdict(stderr: float | None, typical: float) -> Verdict:
    """Whether an expected error is small enough, as for a coefficient."""
    if stderr is None:
        return Verdict.NOT_IDENTIFIABLE
    return Verdict.DETERMINED if stderr < WEAK_ERROR * typical else Verdict.WEAK


def planned_throws(
    law: str | type[Law] | FitResult,
    *,
    coefficients: Mapping[str, float] | None,
    load: str | None,
    stone: Stone | None,
    v0: Sequence[float],
    omega0: Sequence[float],
    rate: float,
    sigma: Mapping[str, float] | None,
    until: float | None,
    throws: int,
    both_senses: bool = False,
) -> tuple[Assumptions, list[PlannedThrow]]:
    """What is assumed, and the candidates; parameters as in `design`.

    Parameters
    ----------
    both_senses : add to each spin that of the other sense.

    Raises
    ------
    InputError : noise, candidates, records or a number of throws that cannot be.
    """
    if sigma is None:
        sigma = NOISE
    values_of_fit = {}
    if isinstance(law, FitResult):
        values_of_fit = {name: fit.value for name, fit in law.coefficients.items()}
        load = load or law.load
        stone = stone or law.stone
        law = law.law_class
    exact = law_with(law, coefficients or {}, others=values_of_fit)
    unknown = [name for name in sigma if name not in CHANNELS]
    if not sigma or unknown:
        what = f"no channel {quoted(unknown[0])}" if sigma else "nothing is measured"
        raise InputError(
            f"sigma: {what}; expected noise of some of {', '.join(CHANNELS)}"
        )
    _require_positive("v0", v0)
    _require_positive("rate", rate)
    if until is not None:
        _require_positive("until", until)
    for name, size in sigma.items():
        _require_positive(f"sigma of {name}", size)
    if not omega0 or not all(map(math.isfinite, omega0)):
        raise InputError("omega0: expected finite numbers")
    count = len(v0) * len(omega0)
    if count > _MAX_CANDIDATES:
        raise InputError(
            f"{len(v0)} speeds and {len(omega0)} spins make {count} candidates; "
            f"expected at most {_MAX_CANDIDATES}"
        )
    if (
        isinstance(throws, bool)
        or not isinstance(throws, int)
        or not 1 <= throws <= _MAX_THROWS
    ):
        raise InputError(
            f"throws = {throws}: expected a whole number from 1 to {_MAX_THROWS}"
        )
    names = [coefficient.name for coefficient in exact.coefficients()]
    values = np.array([float(getattr(exact, name)) for name in names])
    measured = {name: float(sigma[name]) for name in CHANNELS if name in sigma}
    spins = [float(spin) for spin in omega0]
    if both_senses:
        reversed_spins = [-spin for spin in spins]
        spins = sorted(
            {*spins, *reversed_spins}, key=lambda spin: (abs(spin), spin < 0)
        )
    planned = [
        PlannedThrow(float(speed), spin, float(rate), stone or Stone())
        for speed, spin in itertools.product(v0, spins)
    ]
    checked_load = check_load(load or "uniform")
    return Assumptions(type(exact), checked_load, values, measured, until), planned


def _require_positive(name: str, value: float | Sequence[float]) -> None:
    """Raise `InputError` for a number, or numbers, that are not positive."""
    values = np.atleast_1d(np.array(value, float))
    if not len(values) or not ((values > 0) & (values < math.inf)).all():
        shown = ",".join(f"{number:g}" for number in values)
        kind = "positive numbers" if np.ndim(value) else "a positive number"
        raise InputError(f"{name} = {shown}: expected {kind}")


def _undetermined_pair(
    assumed: Assumptions, planned: Sequence[PlannedThrow]
) -> tuple[str, str] | None:
    """Two coefficients of which planned throws determine only the sum under uniform
    load, if any."""
    uniform = assumed.by_load[Load.UNIFORM]
    factor = combined(uniform.factors(planned))
    identifiability = Identifiability.of(uniform.information(factor))
    for direction in identifiability.null_directions:
        if len(direction) == 2 and sum(direction.values()) == 0:
            first, second = direction
            return first, second
    return None


def _curves(
    assumed: Assumptions,
    throws: Sequence[PlannedThrow],
    candidates: CandidateSet,
    quantities: Mapping[str, Mapping[str, float]],
) -> dict[str, dict[str, list[float | None]]]:
    """Standard errors of throws against noise of position, noise of angle and rate; and
    those of the best of the candidates against their number."""
    records = assumed.records(throws)
    # R factor of the information at each abscissa, by curve
    factors: dict[str, dict[float, Floats]] = {}
    for name, channels in (("place", _POSITION), ("angle", _ANGLE)):
        noisy = assumed.sigma.keys() & channels
        if noisy:
            factors[name] = {}
            for multiple in _FACTORS:
                noisier = assumed.noisier(noisy, multiple)
                marginals = [noisier.marginal(record) for record in records]
                factors[name][multiple] = combined(marginals)
    factors["rate"] = {}
    for rate in _RATES:
        at_rate = [throw._replace(rate=rate) for throw in throws]
        factors["rate"][rate] = combined(assumed.factors(at_rate))
    factors["throws"] = {}
    for count in _COUNTS:
        indices = select_design(candidates, d_criterion, count)
        if indices is not None:
            factors["throws"][float(count)] = candidates.together(indices)
    curves = {}
    for name, factor_by_abscissa in factors.items():
        curve: dict[str, list[float | None]] = {"at": [*factor_by_abscissa]}
        curve |= {quantity: [] for quantity in quantities}
        for factor in factor_by_abscissa.values():
            for quantity, error in assumed.errors(factor, quantities).items():
                curve[quantity].append(error)
        curves[name] = curve
    return curves


def _notes(
    assumed: Assumptions,
    planned: Sequence[PlannedThrow],
    separation: Separation | None,
) -> tuple[Finding, ...]:
    """The load under which throws separate two coefficients, if those of this load do
    not, and what the errors assume of the law."""
    notes = []
    if separation is not None and separation.scenario(assumed.load).throws is None:
        for scenario in separation.ways:
            if scenario.throws is not None:
                notes.append(_other_load(planned, separation.pair, scenario))
    if assumed.discrepancy:
        percent = 100 * assumed.discrepancy
        notes.append(Finding.note("design-with-discrepancy", percent=percent))
    else:
        remedy = Remedy("allow-for-discrepancy", Option("discrepancy", "0.05"))
        notes.append(Finding.note("design-without-discrepancy", remedy))
    return tuple(notes)


def _other_load(
    planned: Sequence[PlannedThrow], pair: tuple[str, str], scenario: LoadScenario
) -> Finding:
    """A note on the throws that separate two coefficients under another load than the
    assumed one."""
    throws = [
        {"count": count, "v0": planned[index].v0, "omega0": planned[index].omega0}
        for index, count in Counter(scenario.throws).items()
    ]
    return Finding.note(
        "other-load-separates",
        Remedy("assume-load", Option("load", scenario.load)),
        load=scenario.load,
        throws=throws,
        pair=[*pair],
        stderr=scenario.stderr,
    )


def _scenarios(
    assumed: Assumptions,
    throws: Sequence[PlannedThrow],
    quantities: Mapping[str, Mapping[str, float]],
) -> tuple[Scenario, ...]:
    """Expected errors of throws as planned, and with equal shares of them
    thrown otherwise.

    Parameters
    ----------
    quantities : coefficients and combinations as weights.
    """
    number_by_throw = Counter(throws)
    widths = widths_of(assumed.model)
    all_ways = SCENARIOS["both spins and directions"]
    thrown_otherwise = [
        throw._replace(omega0=sense * throw.omega0, heading=heading)
        for throw in number_by_throw
        for sense, heading in all_ways
    ]
    # the conditions come after the parameters
    columns = np.append(assumed.free, len(assumed.parameters) + np.arange(len(widths)))
    records = record_information(assumed, thrown_otherwise, widths)
    factors = np.array([assumed.marginal(record, columns) for record in records])
    factors = factors.reshape(len(number_by_throw), len(all_ways), *factors.shape[1:])
    numbers = np.array([*number_by_throw.values()])
    expected = []
    for name, ways in SCENARIOS.items():
        indices = [all_ways.index(way) for way in ways]
        # the factor is a root of the information, of which each way has a share
        shares = np.sqrt(numbers / len(indices))[:, None, None, None]
        rows = (shares * factors[:, indices]).reshape(-1, len(columns))
        expected.append(_scenario(assumed, name, r_factor(rows), [*widths], quantities))
    return tuple(expected)


def _scenario(
    assumed: Assumptions,
    name: str,
    factor: Floats,
    conditions: Sequence[str],
    quantities: Mapping[str, Mapping[str, float]],
) -> Scenario:
    """Expected errors of throws, and their shifts by conditions.

    Parameters
    ----------
    factor : R factor of the information on the free coefficients over their typical
        sizes and, in the columns after these, on the conditions over their widths.
    """
    free = len(assumed.free)
    of_coefficients = factor[:, :free]
    information = assumed.information(of_coefficients)
    gradients = of_coefficients.T @ factor[:, free:] / assumed.typical[:, None]
    scaled_shifts = {
        condition: information.response(gradient) / assumed.typical
        for condition, gradient in zip(conditions, gradients.T, strict=True)
    }
    stderr = {}
    shifts = {}
    for quantity, combination in quantities.items():
        weights = assumed.weights(combination)
        stderr[quantity] = standard_error(of_coefficients, weights)
        shifts[quantity] = {
            condition: float(weights @ shift)
            for condition, shift in scaled_shifts.items()
        }
    return Scenario(name, stderr, shifts)
