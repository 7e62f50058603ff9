"""Several throws of one law together: shared coefficients, each throw its own start and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from curlfit.inference.joint.solver import JointSolution, Layout, Progress, minimize_jointly
from curlfit.numerics.compiled import stacked, unstacked

# isort: split
import numpy as np

from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import Law, check_load, find_law, no_motion_because
from curlfit.inference.fit.prepared import PreparedThrow
from curlfit.inference.fit.result import Estimate
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import summarize
from curlfit.inference.identifiability import analyse
from curlfit.inference.initial_values import smooth, start_values
from curlfit.inference.joint.heterogeneity import differences_of
from curlfit.inference.joint.result import JointResult
from curlfit.inference.linearized_problem import LinearizedProblem, classify
from curlfit.inference.model import Model
from curlfit.inference.noise.models import check_loss, check_noise
from curlfit.inference.problem import problem_shape
from curlfit.stone import Stone
from curlfit.throws.throw import Throw


def fit_together(
    throws: Sequence[Throw],
    law: str | type[Law] = "front-back",
    *,
    share: str | Sequence[str] = "all",
    load: str = "uniform",
    stone: Stone | None = None,
    until: float | None = None,
    fix: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    unbounded: bool = False,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    noise: str = "white",
    progress: Progress | None = None,
) -> JointResult:
    """Fit one law to several throws, with some or all of its coefficients in common.

    Parameters
    ----------
    throws : at least two; each has its own start, noise and, where its file says so, stone.
    law, load, stone, until, fix, bounds, unbounded, start, loss, noise : as in `fit`, for all
        throws.
    share : "all" coefficients, or the names of those that the throws have in common; the others
        are each throw's own.
    progress : called with the number of steps done and chi squared.

    Raises
    ------
    InputError : as in `fit`; fewer than two throws; a name that is no coefficient.
    UnusableFitError : some throw has no finite path where its data put the start.
    """
    law = find_law(law) if isinstance(law, str) else law
    checked, loss = check_load(load), check_loss(loss)
    noise = check_noise(noise, loss)
    if len(throws) < 2:
        raise InputError(f"{len(throws)} throw to fit together; expected two or more")
    shared = _shared(law, share)
    prepared = [
        PreparedThrow.of(throw, law, stone, until, fix=fix, bounds=bounds, unbounded=unbounded)
        for throw in throws
    ]
    channels, rows = zip(*(problem_shape(one.throw) for one in prepared), strict=True)
    shape = max(channels), max(rows)
    model = Model(law, checked, prepared[0].parameters.conditions)
    rounds = Rounds(model, prepared, loss=loss, noise=noise, shape=shape)
    local = [one.local_parameters for one in prepared]
    layout = Layout(local, shared)
    initial = []
    for one, parameters, problem in zip(prepared, local, unstacked(rounds.problems), strict=True):
        alone = stacked([problem])
        ends = parameters.lower[None], parameters.upper[None]
        (values,) = start_values(model, alone, smooth(alone), *ends, batch=1)
        initial.append(one.with_start(values, start))
    best = layout.joined(np.stack(initial))
    solution = minimize_jointly(model, rounds.problems, layout, best, progress)
    every = np.arange(len(prepared))
    while np.isfinite(solution.chi_squared) and rounds.revise(every, solution.each):
        best = solution.values
        solution = minimize_jointly(model, rounds.problems, layout, best, progress)
    for failure in rounds.failures.values():
        raise failure
    if not np.isfinite(solution.chi_squared):
        raise UnusableFitError(
            f"law {law.name} with {load} load gives no finite path for these throws"
            + no_motion_because(checked)
        )
    return _result(rounds, layout, shared, solution)


def _shared(law: type[Law], share: str | Sequence[str]) -> tuple[str, ...]:
    """Names of the shared coefficients. Raises `InputError` for one that the law does not have."""
    own = tuple(item.name for item in law.coefficients())
    shared = own if share == "all" else (share,) if isinstance(share, str) else tuple(share)
    for name in shared:
        if name not in own:
            raise InputError(
                f"share: law {law.name} has no coefficient {name!r}; it has {', '.join(own)}"
            )
    return shared


def _result(
    rounds: Rounds, layout: Layout, shared: tuple[str, ...], solution: JointSolution
) -> JointResult:
    bounds, free = layout.bounds, layout.free
    matrix, right = solution.r_factor(layout)
    offset = layout.joined(np.stack([one.offset for one in rounds.throws]))
    linearized = LinearizedProblem(
        right, matrix, solution.values, bounds.lower, bounds.upper, bounds.typical, free
    )
    at_bound = linearized.at_bound()
    open_, slack = linearized.open(at_bound)
    names = np.array(layout.names)
    values = solution.values + offset
    known = analyse(
        matrix[:, open_], list(names[open_]), values[open_], bounds.typical[open_], slack
    )
    single = [
        summarize(rounds.record(throw, one)) for throw, one in enumerate(unstacked(solution.each))
    ]
    index_of = {name: index for index, name in enumerate(known.names)}

    def estimate(item: Estimate, joint: int) -> Estimate:
        if item.verdict == "fixed":
            return item
        index = index_of.get(layout.names[joint], -1)
        stderr, verdict = classify(item.typical, bool(at_bound[joint]), known, index)
        reason = item.reason if verdict == item.verdict else ""
        value = float(values[joint])
        return replace(item, value=value, stderr=stderr, verdict=verdict, reason=reason)

    throws = []
    for throw, result in enumerate(single):
        estimates = {
            name: estimate(item, int(layout.index[throw, column]))
            for column, (name, item) in enumerate(result.parameters.items())
        }
        throws.append(replace(result, parameters=estimates, combinations=known.combinations))
    coefficients = {name: throws[0].parameters[name] for name in shared}
    decrement = linearized.newton_decrement(linearized.movable())
    reduced = solution.chi_squared / solution.each.residual.size
    converged = solution.success and decrement < 0.01 * max(1.0, np.sqrt(reduced))
    warnings = [
        f"{item.data['file']}: {warning}" for item in single for warning in item.warnings
        if "bound" not in warning
    ]  # fmt: skip
    differences = differences_of(solution, layout, coefficients, known.combinations, shared)
    for item in differences:
        if item.significant:
            warnings.insert(
                0,
                f"{item.expression} differs from throw to throw beyond its errors "
                f"(p = {item.p_value:.1g}); its error about the mean of such throws is "
                f"{item.stderr:.2g}, not the one of the shared fit",
            )
    return JointResult(
        law=rounds.model.law.name,
        load=rounds.model.load,
        share=shared,
        converged=bool(converged),
        status=f"{'converged' if converged else 'not converged'} ({solution.steps} steps)",
        warnings=tuple(warnings),
        coefficients=coefficients,
        combinations=tuple(item for item in known.combinations if set(item.weights) <= set(shared)),
        rank=known.rank,
        parameters=int(open_.sum()),
        differences=differences,
        throws=tuple(throws),
    )
