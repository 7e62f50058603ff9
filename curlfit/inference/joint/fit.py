"""Several throws of one law together: shared coefficients, each throw its own start and noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from curlfit.inference.joint.solver import Bench, Layout, Search, State, layout_of, padded

# isort: split
import numpy as np

from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import Law, Load, check_load, find_law, no_motion_because
from curlfit.inference.fit.fit import bulk_sigma, estimated_sigma, first_sigma, prepared, shifted
from curlfit.inference.fit.result import Estimate
from curlfit.inference.fit.summary import Optimum, summarize
from curlfit.inference.identifiability import analyse
from curlfit.inference.initial_values import smooth, start_values
from curlfit.inference.joint.heterogeneity import differences_of
from curlfit.inference.joint.result import JointResult
from curlfit.inference.likelihood import Problem, problem_of, raw_residuals, stacked
from curlfit.inference.linearized_problem import Slopes, judged
from curlfit.inference.parameters import ParameterSet, check_loss
from curlfit.stone import Stone
from curlfit.throws.throw import Throw

_ROUNDS = 4  # of a robust fit: sigma from the bulk, then the fit


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
    loss: str = "linear",
    progress: Callable[[int, float], None] | None = None,
) -> JointResult:
    """Fit one law to several throws, with some or all of its coefficients in common.

    Parameters
    ----------
    throws : at least two; each has its own start, noise and, where its file says so, stone.
    law, load, stone, until, fix, bounds, unbounded, loss : as in `fit`, for all throws.
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
    if len(throws) < 2:
        raise InputError(f"{len(throws)} throw to fit together; expected two or more")
    own = [item.name for item in law.coefficients()]
    shared = own if share == "all" else [share] if isinstance(share, str) else list(share)
    for name in shared:
        if name not in own:
            raise InputError(f"share: law {law.name} has no coefficient {name!r}; it has "
                             + ", ".join(own))  # fmt: skip
    jobs = [
        prepared(throw, law, stone, until, fix=fix, bounds=bounds, unbounded=unbounded)
        for throw in throws
    ]
    sigmas = [first_sigma(job.throw) for job in jobs]
    local = [shifted(job.parameters, -job.frame.offset(len(job.parameters))) for job in jobs]
    layout = layout_of(jobs[0].parameters.names, shared, len(jobs))
    problems = [
        problem_of(job.throw, job.stone, job.frame, sigma)
        for job, sigma in zip(jobs, sigmas, strict=True)
    ]
    values = np.concatenate(
        [
            start_values(
                law, checked, one, smooth(one), parameters.lower[None], parameters.upper[None],
                lanes=1,
            )
            for one, parameters in zip(map(stacked, zip(problems)), local, strict=True)
        ]
    )  # fmt: skip
    search = Search(local, layout, progress)
    joint = search.gather(values)
    best = search.run(Bench(law, checked, problems), joint)
    for kind in ("linear", *[loss] * (_ROUNDS if loss != "linear" else 0)):
        for place, (job, problem) in enumerate(zip(jobs, problems, strict=True)):
            solution, sigma = search.solution(best, place), sigmas[place]
            if kind == "linear":
                shown = padded(problem, *solution.residual.shape)
                found = estimated_sigma(solution, shown, local[place], sigma)
            else:
                residual = raw_residuals(law, checked, solution.values, problem)
                found = bulk_sigma(job.throw, residual, problem, sigma)
            sigmas[place] = sigma | found
        problems = [
            problem_of(job.throw, job.stone, job.frame, sigma, kind)
            for job, sigma in zip(jobs, sigmas, strict=True)
        ]
        best = search.run(Bench(law, checked, problems), best.values)
    if not np.isfinite(best.cost):
        raise UnusableFitError(
            f"law {law.name} with {load} load gives no finite path for these throws"
            + no_motion_because(load)
        )
    return _result(law, checked, tuple(shared), jobs, local, layout, problems, sigmas, search, best,
                   loss)  # fmt: skip


def _result(
    law: type[Law],
    load: Load,
    shared: tuple[str, ...],
    jobs: Sequence[Any],
    local: Sequence[ParameterSet],
    layout: Layout,
    problems: Sequence[Problem],
    sigmas: Sequence[dict[str, float]],
    search: Search,
    best: State,
    loss: str,
) -> JointResult:
    free = search.free
    matrix, right = search.compressed(best)
    offsets = [job.frame.offset(len(job.parameters)) for job in jobs]
    offset = search.gather(np.stack(offsets))
    slopes = Slopes(right, matrix, best.values, search.lower, search.upper, search.typical, free)
    at_bound = slopes.at_bound()
    open_, slack_columns = slopes.open(at_bound)
    names = np.array(layout.names)
    values = best.values + offset
    sees = analyse(
        matrix[:, open_], list(names[open_]), values[open_], search.typical[open_], slack_columns
    )
    solutions = [search.solution(best, place) for place in range(len(jobs))]
    single = [
        summarize(
            Optimum(
                job.throw, law, load, job.stone, job.until, job.parameters, job.frame,
                padded(problem, *solution.residual.shape), sigma, solution, 1, loss,
            )
        )
        for job, problem, sigma, solution in zip(jobs, problems, sigmas, solutions, strict=True)
    ]  # fmt: skip
    place_of = {name: place for place, name in enumerate(sees.names)}

    def estimate(item: Estimate, joint: int) -> Estimate:
        if item.verdict == "fixed":
            return item
        place = place_of.get(layout.names[joint], -1)
        stderr, verdict = judged(item.typical, bool(at_bound[joint]), sees, place)
        return replace(item, value=float(values[joint]), stderr=stderr, verdict=verdict)

    throws = []
    for throw, result in enumerate(single):
        estimates = {
            name: estimate(item, int(layout.places[throw, column]))
            for column, (name, item) in enumerate(result.parameters.items())
        }
        throws.append(replace(result, parameters=estimates, combinations=sees.combinations))
    coefficients = {name: throws[0].parameters[name] for name in shared}
    left = slopes.distance(slopes.movable())
    converged = best.finished and left < 0.01 * max(1.0, np.sqrt(best.cost / best.residual.size))
    warnings = [
        f"{item.data['file']}: {warning}" for item in single for warning in item.warnings
        if "bound" not in warning
    ]  # fmt: skip
    differences = differences_of(best, layout, search, coefficients, sees.combinations, shared)
    for item in differences:
        if item.significant:
            warnings.insert(
                0,
                f"{item.expression} differs from throw to throw beyond its errors "
                f"(p = {item.p_value:.1g}); its error about the mean of such throws is "
                f"{item.stderr:.2g}, not the one of the shared fit",
            )
    return JointResult(
        law=law.name,
        load=load,
        share=shared,
        converged=bool(converged),
        status=f"{'converged' if converged else 'not converged'} ({best.steps} steps)",
        warnings=tuple(warnings),
        coefficients=coefficients,
        combinations=tuple(item for item in sees.combinations if set(item.weights) <= set(shared)),
        rank=sees.rank,
        parameters=int(open_.sum()),
        differences=differences,
        throws=tuple(throws),
    )
