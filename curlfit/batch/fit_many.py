"""Many throws, one law: each fitted by itself, many at a time.

Throws go through the steps of `fitting.fit`, side by side (see `lockstep.py`). One whose first
start leads nowhere good is fitted again alone, with all the starts that `fit` would try, so that
it holds up none of its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice
from operator import itemgetter
from os import PathLike
from typing import Any, NamedTuple

from curlfit.inference.likelihood import LANES, SIGMA_FLOOR, Problem, problem_of, stacked, unstacked

# isort: split
import jax
import numpy as np
from numpy.typing import NDArray

from curlfit.batch.settings import CHUNK, QUANTILES, Plan, columns
from curlfit.errors import CurlfitError
from curlfit.friction import Law, check_load
from curlfit.inference.batched_least_squares import Places, Tasks, run_of, solve_many
from curlfit.inference.fit.fit import Job, first_sigma, fit, prepared
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.summary import Optimum, summarize_many
from curlfit.inference.initial_values import smooth, start_values
from curlfit.inference.least_squares import Solution, poor, residual_sigma
from curlfit.numerics.compiled import unswept
from curlfit.stone import Stone
from curlfit.throws.readers import Part, load_throws
from curlfit.throws.throw import CHANNELS, Throw

Floats = NDArray[np.float64]

_ROWS = CHUNK * 256  # of throws that are fitted together, for the sake of memory


def fit_files(files: Sequence[str | PathLike[str]], plan: Plan) -> list[dict[str, Any]]:
    """One row for each throw in the files, in their order, with the keys of `columns`.

    The status is "ok", "not usable" (the data were read, and no usable fit came of them) or
    "failed" (they could not be read); `reason` says why. Values that there are none of are missing.

    Raises
    ------
    InputError : the plan itself cannot be carried out.
    """
    rows, names, parts = [], columns(plan), _read(files, plan)
    throws = [
        str(part.throw) if isinstance(part.throw, CurlfitError) else part.throw for _, part in parts
    ]
    results = fit_throws(throws, plan, curves=False)
    sums = tuple(plan.sums())
    for (file, part), throw, result in zip(parts, throws, results, strict=True):
        row: dict[str, Any] = dict.fromkeys(names)
        row |= {"file": file, "shot": part.shot, "stone_index": part.stone_index}
        if isinstance(result, str):
            row["status"] = "failed" if isinstance(throw, str) else "not usable"
            row["reason"] = result.removeprefix(f"{file}: ")
        else:
            row |= _row(result, plan, sums)
        rows.append(row)
    return rows


@unswept()
def _read(files: Sequence[str | PathLike[str]], plan: Plan) -> list[tuple[str, Part]]:
    """Every throw in the files, beside the name of its file."""
    found = []
    for file in map(str, files):
        try:
            parts = load_throws(file, **plan.how)
        except CurlfitError as error:
            parts = [Part(None, None, error)]
        for part in parts:
            if isinstance(part.throw, Throw):
                part = part._replace(throw=part.throw.with_sigma(dict(plan.sigma)))
            found.append((file, part))
    return found


@unswept()
def fit_throws(
    throws: Iterable[Throw | str], plan: Plan, *, curves: bool = True
) -> list[FitResult | str]:
    """The fit of each throw, or why there is none; a text in place of a throw is passed on.

    Parameters
    ----------
    curves : whether the fits shall hold the fitted curves.
    """
    law = plan.checked()
    found: dict[int, FitResult | str] = {}
    by_shape: dict[tuple[int, ...], dict[int, _Entry]] = {}
    for place, throw in enumerate(throws):
        if isinstance(throw, str):
            found[place] = throw
            continue
        try:
            entry = _entered(law, plan, throw)
        except CurlfitError as error:
            found[place] = str(error)
        else:
            by_shape.setdefault(entry.problem.observed.shape, {})[place] = entry
    for (_, rows), entries in by_shape.items():
        rest = iter(entries.items())
        while part := dict(islice(rest, max(LANES, _ROWS // rows))):
            fits = _fitted(law, plan, list(part.values()), curves)
            found |= zip(part, fits, strict=True)
    return [found[place] for place in sorted(found)]


class _Entry(NamedTuple):
    """A throw ready to be fitted beside others."""

    given: Throw
    job: Job
    sigma: dict[str, float]
    """of the first fit, for the channels whose own is unknown"""
    problem: Problem


def _entered(law: type[Law], plan: Plan, throw: Throw) -> _Entry:
    own = Stone().with_values(throw.defaults.get("stone", {}))
    stone = own.with_values(dict(plan.stone))
    job = prepared(throw, law, stone, plan.until, **_choices(plan))
    sigma = first_sigma(job.throw)
    return _Entry(throw, job, sigma, problem_of(job.throw, stone, job.frame, sigma))


def _choices(plan: Plan) -> dict[str, Any]:
    return {"fix": dict(plan.fix), "bounds": dict(plan.bounds), "unbounded": plan.unbounded}


def _fitted(
    law: type[Law], plan: Plan, entries: list[_Entry], curves: bool
) -> list[FitResult | str]:
    """The fits of throws of one shape, side by side."""
    load = check_load(plan.load)
    problems = stacked([entry.problem for entry in entries])
    sets = [entry.job.parameters for entry in entries]
    offset = np.stack([entry.job.frame.offset(len(entry.job.parameters)) for entry in entries])
    lower = np.stack([item.lower for item in sets]) - offset
    upper = np.stack([item.upper for item in sets]) - offset
    free = np.stack([item.free for item in sets])
    channels = CHANNELS[: problems.observed.shape[1]]
    unknown = np.array([[name in entry.sigma for name in channels] for entry in entries])
    sigma = np.zeros(unknown.shape)
    failed = np.zeros(len(entries), bool)
    paths = smooth(problems)

    def again(which: Places, found: Solution) -> tuple[Places, Floats]:
        """The second fit, with the sigma that the first one found, where it was not given."""
        here = itemgetter(run_of(which))
        estimated = unknown[which].any(1)
        paths_, problems_ = jax.tree.map(here, (paths, problems))
        failed[which] = estimated & poor(found, paths_, problems_)
        on = estimated & ~failed[which]
        if not on.all():
            which = which[on]
            if not len(which):
                return which, problems.weight[which]
            found, problems_ = jax.tree.map(itemgetter(on), (found, problems_))
        sigma[which] = residual_sigma(found, problems_, free[which]) + SIGMA_FLOOR
        change = unknown[which][..., None] & (problems_.weight > 0)
        weight = np.where(change, 1 / sigma[which][..., None], problems_.weight)
        problems.weight[which] = weight
        return which, weight

    start = start_values(law, load, problems, paths, lower, upper)
    tasks = Tasks(problems, start, lower, upper, sets[0].typical)
    solutions = solve_many(law, load, tasks, again)
    optima: dict[int, Optimum] = {}
    each = unstacked((problems, solutions))
    for place in np.flatnonzero(solutions.finished & ~failed):
        entry, job, (problem, solution) = entries[place], entries[place].job, each[place]
        used = {
            name: float(value) for name, value in zip(channels, sigma[place], strict=True)
            if name in entry.sigma
        }  # fmt: skip
        optima[int(place)] = Optimum(
            job.throw, law, load, job.stone, job.until, job.parameters, job.frame, problem, used,
            solution, 1, "linear",
        )  # fmt: skip
    found = dict(zip(optima, summarize_many(list(optima.values()), curves=curves), strict=True))
    return [found.get(place) or _alone(law, plan, entry) for place, entry in enumerate(entries)]


def _alone(law: type[Law], plan: Plan, entry: _Entry) -> FitResult | str:
    """The fit of one throw, with all the starts that `fit` would try."""
    try:
        return fit(
            entry.given, law, load=plan.load, stone=entry.job.stone, until=plan.until,
            **_choices(plan),
        )  # fmt: skip
    except CurlfitError as error:
        return str(error)


def _row(result: FitResult, plan: Plan, sums: Sequence[str]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "status": "ok" if result.converged else "not usable",
        "reason": None if result.converged else result.status,
        "n_observations": result.n_observations,
        "combinations": "; ".join(
            f"{item.expression} = {item.value!r}"
            + ("" if item.stderr is None else f" +- {item.stderr!r}")
            for item in result.combinations
        ),
        "warnings": "; ".join(result.warnings),
    }
    row |= {f"rms_{name}": result.rms.get(name) for name in ("x", "y", "phi")}
    for name, item in result.parameters.items():
        row |= {name: item.value, f"{name}_stderr": item.stderr, f"{name}_verdict": item.verdict}
    for combination in result.combinations:
        name = combination.expression
        if name in sums:
            row |= {name: combination.value, f"{name} stderr": combination.stderr}
    if plan.posterior and result.converged:
        from curlfit.inference.mcmc.sampler import sample

        sampled, _ = sample(result, seed=plan.seed)
        assert sampled.posterior is not None
        for name, quantiles in sampled.posterior.quantiles.items():
            if name in sums:
                row |= {f"{name} {q}": quantiles[q] for q in QUANTILES}
            elif name in result.parameters:
                row |= {f"{name}_{q}": quantiles[q] for q in QUANTILES}
    return row
