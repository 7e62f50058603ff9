"""Joint fit of several throws: shared coefficients, own initial states and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from curlfit.errors import InputError, UnusableFitError, require_kind
from curlfit.foreign import quoted
from curlfit.friction import Law, find_law, no_motion_because
from curlfit.inference.derived import check_derived
from curlfit.inference.fit.advice import curl_warnings
from curlfit.inference.fit.prepared import PreparedThrow
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import Estimate, FitResult, Systematics
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import IMPLAUSIBLE, summarize_many
from curlfit.inference.fit.systematics import calibrations_of, widths_of
from curlfit.inference.identifiability import Combination, expression
from curlfit.inference.joint.analysis import JointAnalysis, differences_of
from curlfit.inference.joint.result import Difference, JointResult
from curlfit.inference.joint.solver import Layout, Progress, minimize_jointly
from curlfit.inference.model import Model
from curlfit.inference.problem import problem_shape
from curlfit.numerics.arrays import Booleans
from curlfit.numerics.batches import unstacked
from curlfit.settings.choices import Fitting, takes
from curlfit.throws.throw import Throw, require_throw


@takes(Fitting, "law", "load")
def fit_together(
    throws: Sequence[Throw],
    law: str | type[Law] | None = None,
    *,
    share: str | Sequence[str] = "all",
    load: str | None = None,
    progress: Progress | None = None,
    **choices: Any,
) -> JointResult:
    """Fit one law to several throws that share some or all of its coefficients.

    The choices hold for all throws; where one is not given, each throw's own applies. The prior of
    a shared parameter counts once.

    Parameters
    ----------
    throws : at least two; each has its own initial state, noise and, if its file says so, stone.
    law, load : as in `fit`; the defaults of the throws must agree.
    share : "all" coefficients, or the names of those that the throws share; each throw has its own
        values of the others. Conditions, such as the slope of the ice, are always shared.
    progress : called with the number of steps done and chi squared.
    {choices}

    Raises
    ------
    InputError : as in `fit`; fewer than two throws; a name that is not a coefficient.
    UnusableFitError : a throw has no finite path from the initial values found from its data.

    Examples
    --------
    >>> joint = curlfit.fit_together([throw, throw])
    >>> joint.converged, joint.share
    (True, ('mu1_xi', 'mu2_xi', 'mu1_eta', 'mu2_eta'))
    """
    require_kind(throws, Sequence, "throws", "a list of throws")
    for throw in throws:
        require_throw(throw)
    if len(throws) < 2:
        raise InputError(f"{len(throws)} throw to fit together; expected two or more")
    law = find_law(_common(throws, "law", "front-back") if law is None else law)
    load = _common(throws, "load", "uniform") if load is None else load
    given = {**choices, "law": law, "load": load}
    chosen = [Fitting.of(throw.settings, **given) for throw in throws]
    common = chosen[0]
    shared = _shared(law, share)
    check_derived(common.derive, [item.name for item in law.coefficients()])
    any_swept = any(one.swept is not None for one in chosen)
    prepared = [
        PreparedThrow.of(throw, one, others_swept=any_swept)
        for throw, one in zip(throws, chosen, strict=True)
    ]
    shared = (*shared, *prepared[0].parameters.conditions)
    channels, rows = zip(*(problem_shape(one.throw) for one in prepared), strict=True)
    shape = max(channels), max(rows)
    model = Model(law, common.load, prepared[0].parameters.conditions)
    rounds = Rounds(model, prepared, loss=common.loss, noise=common.noise, shape=shape)
    layout = Layout([one.local_parameters for one in prepared], shared)
    first = Layout([one.first_parameters for one in prepared], shared)
    initial = [
        one.with_start(values, common.start)
        for one, values in zip(prepared, rounds.starts()[1][0], strict=True)
    ]
    best = layout.joined(np.stack(initial))
    solution = minimize_jointly(model, rounds.problems, first, best, progress)
    every = np.arange(len(prepared))
    while np.isfinite(solution.chi_squared) and len(rounds.revise(every, solution.each)):
        best = solution.values
        solution = minimize_jointly(model, rounds.problems, layout, best, progress)
    for failure in rounds.failures.values():
        raise failure
    if not np.isfinite(solution.chi_squared):
        raise UnusableFitError(
            f"law {law.name} with {common.load} load gives no finite path for these throws"
            + no_motion_because(common.load)
        )
    analysis = JointAnalysis(rounds, layout, solution)
    errors = calibrations_of(rounds.throws, jointly=True).shape[1]
    result = _result(analysis, shared, widths_of(model, common.systematics, errors))
    return result.with_derived(common.derive)


def _differs_by_spin(item: Difference, counter_clockwise: Booleans) -> bool:
    """Whether throws of the same sense of spin agree much better than all throws do."""
    known = np.array([one is not None for one in item.each])
    value, error = np.array([one for one in item.each if one is not None]).T
    sense = counter_clockwise[known]

    def chi_squared(rows: Booleans) -> float:
        if not rows.any():
            return 0.0
        mean = np.average(value[rows], weights=error[rows] ** -2)
        return float((((value[rows] - mean) / error[rows]) ** 2).sum())

    within = chi_squared(sense) + chi_squared(~sense)
    return within < chi_squared(np.ones_like(sense)) / 2


def _common(throws: Sequence[Throw], name: str, default: str) -> str:
    """The law or load that the throws state. Raises `InputError` where they differ."""
    first = throws[0].defaults.get(name, default)
    for throw in throws:
        own = throw.defaults.get(name, default)
        if own != first:
            raise InputError(
                f"{throws[0].name} and {throw.name} state different values of {name}, {first} and "
                f"{own}; give the one for this fit"
            )
    return str(first)


def _shared(law: type[Law], share: str | Sequence[str]) -> tuple[str, ...]:
    """Names of the shared coefficients. Raises `InputError` for one that the law does not have."""
    own = tuple(item.name for item in law.coefficients())
    shared = own if share == "all" else (share,) if isinstance(share, str) else tuple(share)
    for name in shared:
        if name not in own:
            raise InputError(
                f"share: law {law.name} has no coefficient {quoted(name)}; it has {', '.join(own)}"
            )
    return shared


def _result(
    analysis: JointAnalysis, shared: tuple[str, ...], widths: Mapping[str, float]
) -> JointResult:
    rounds, layout, known = analysis.rounds, analysis.layout, analysis.identifiability
    solutions = unstacked(analysis.solution.each)
    fits = [rounds.record(throw, solution) for throw, solution in enumerate(solutions)]
    single = [summarize_many([fit], 1, bounds=False)[0] for fit in fits]
    systematic = analysis.shifts(widths)
    throws = [_of_throw(analysis, *one, widths, systematic) for one in enumerate(single)]
    coefficients = {name: throws[0].parameters[name] for name in shared}
    combinations = tuple(item for item in known.combinations if set(item.weights) <= set(shared))
    plain = rounds.loss == "linear" and rounds.noises[0].kind == "white"
    differences = differences_of(
        analysis.solution, layout, coefficients, combinations, rounds.problems,
        rounds.unknown & plain,
    )  # fmt: skip
    among = {item.expression: item for item in differences if item.significant}
    implausible = [
        f"{item.data['file']}: {item.status}"
        for item in single
        if item.status.startswith(IMPLAUSIBLE)
    ]
    warnings = [
        *_heterogeneity_warnings(differences, throws, rounds),
        *curl_warnings(throws),
        *analysis.covariance.bound_warnings(*layout.bounds[:2]),
        *(f"{item.data['file']}: {warning}" for item in single for warning in item.warnings),
    ]
    of_shared = {
        name: systematic[name]
        for name in (*shared, *(item.expression for item in known.combinations))
        if name in systematic
    }
    return JointResult(
        law=rounds.model.law.name,
        load=rounds.model.load,
        share=shared,
        converged=analysis.converged and not implausible,
        status=". ".join(implausible) or analysis.status,
        warnings=tuple(warnings),
        coefficients={name: _among(item, among.get(name)) for name, item in coefficients.items()},
        combinations=tuple(_among(item, among.get(item.expression)) for item in combinations),
        rank=known.rank,
        parameters=int(analysis.covariance.open.sum()),
        differences=differences,
        throws=tuple(throws),
        systematics=Systematics(dict(widths), of_shared),
    )


_Shared = TypeVar("_Shared", Estimate, Combination)


def _among(item: _Shared, difference: Difference | None) -> _Shared:
    """A shared estimate with its error as that of the mean over throws that differ in it."""
    if difference is None:
        return item
    throws = sum(one is not None for one in difference.each)
    return replace(item, stderr=difference.shared_stderr, dof=float(throws - 1))


def _of_throw(
    analysis: JointAnalysis,
    throw: int,
    single: FitResult,
    widths: Mapping[str, float],
    systematic: Mapping[str, dict[str, float]],
) -> FitResult:
    """The record of a throw with the estimates, errors and information of the joint fit."""
    layout, known = analysis.layout, analysis.identifiability
    index = layout.index[throw]
    estimates = {
        name: analysis.estimate(item, int(joint))
        for joint, (name, item) in zip(index, single.parameters.items(), strict=True)
    }
    named = dict(zip((layout.names[joint] for joint in index), estimates, strict=True))
    shifts = {name: systematic[joint] for joint, name in named.items() if joint in systematic}
    combinations = []
    for item in known.combinations:
        if set(item.weights) <= named.keys():  # not of what other throws have for themselves
            weights = {named[joint]: weight for joint, weight in item.weights.items()}
            combinations.append(replace(item, expression=expression(weights), weights=weights))
            shifts[combinations[-1].expression] = systematic[item.expression]
    result = single
    prior = analysis.rounds.throws[throw].local_parameters.penalty
    if prior is not None:  # including the priors of shared parameters
        own = float(prior.chi_squared(analysis.solution.each.values[throw]))
        result = replace(result, prior_chi_squared=own)
    if not result.status.startswith(IMPLAUSIBLE):
        # The search was for all throws together: chi squared of each has a slope at its end.
        same = analysis.converged and result.status.startswith("converged")
        status = result.status if same else analysis.status
        result = replace(result, converged=analysis.converged, status=status)
    result = replace(
        result,
        parameters=estimates,
        combinations=tuple(combinations),
        systematics=Systematics(dict(widths), shifts),
        **analysis.of_throw(throw, tuple(estimates)),
        information=result.information | analysis.information(index[layout.free[index]]),
    )
    return replace(result, quantities=quantities_of(result))


def _heterogeneity_warnings(
    differences: Sequence[Difference], throws: Sequence[FitResult], rounds: Rounds
) -> list[str]:
    """Warnings about shared coefficients that differ from throw to throw."""
    significant = [item for item in differences if item.significant]
    warnings = [
        f"{item.expression} varies between throws by more than its errors ({item.p_text}); "
        "its standard error is that of the mean over such throws, and large residuals of single "
        "throws may be due to the common value rather than to their data"
        for item in reversed(significant)
    ]
    # For a throw without a path the curl is at most one number, which the heading absorbs.
    paths = any(one.throw.has_path for one in rounds.throws)
    senses = np.array([one.parameters["omega0"].value > 0 for one in throws])
    differ = any(_differs_by_spin(item, senses) for item in significant)
    if differ and paths and not rounds.model.has_slope:
        warnings.insert(
            0,
            "throws of opposite spins differ, as they do on ice that is not level; `--free "
            "slope_x` fits a common slope",
        )
    return warnings
