"""Many throws, one law: each fitted by itself, many at a time.

Throws go through the steps of `fitting.fit`, side by side (see `lockstep.py`). One whose first
start leads nowhere good is fitted again alone, with all the starts that `fit` would try, so that
it holds up none of its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike
from typing import Any

import numpy as np

from curlfit.errors import CurlfitError
from curlfit.fitting import Job, estimated_sigma, first_sigma, fit, prepared, shifted
from curlfit.friction import Law, check_load
from curlfit.likelihood import Problem, problem_of, reweighed
from curlfit.lockstep import Task, solve_many
from curlfit.plan import Plan, columns
from curlfit.readers import load_throw
from curlfit.results import FitResult
from curlfit.solving import Solution, poor
from curlfit.starting import Smooth, smooth, start_values
from curlfit.stone import Stone
from curlfit.throw import Throw
from curlfit.weighing import Optimum, weighed_together

_WEIGHED = 128  # optima that wait to be weighed together


def fit_files(files: Sequence[str | PathLike[str]], plan: Plan) -> list[dict[str, Any]]:
    """One row for each file, in their order, with the keys of `columns`.

    The status is "ok", "not usable" (the data were read, and the fit did not converge) or "failed";
    `reason` says why. Values of a failed throw are missing.

    Raises
    ------
    InputError : the plan itself cannot be carried out.
    """
    throws: list[Throw | str] = []
    for file in files:
        try:
            throws.append(load_throw(file, **plan.how).with_sigma(dict(plan.sigma)))
        except CurlfitError as error:
            throws.append(str(error))
    rows = []
    for file, throw, result in zip(files, throws, fit_throws(throws, plan), strict=True):
        row: dict[str, Any] = dict.fromkeys(columns(plan))
        row["file"] = str(file)
        if isinstance(result, str):
            row |= {"status": "failed", "reason": result.removeprefix(f"{file}: ")}
        else:
            assert isinstance(throw, Throw)
            row |= _row(result, plan)
        rows.append(row)
    return rows


def fit_throws(throws: Iterable[Throw | str], plan: Plan) -> list[FitResult | str]:
    """The fit of each throw, or why there is none; a text in place of a throw is passed on."""
    law = plan.checked()
    found: dict[int, FitResult | str] = {}
    runs: dict[int, _Run] = {}
    for place, throw in enumerate(throws):
        if isinstance(throw, str):
            found[place] = throw
            continue
        try:
            runs[place] = _Run(law, plan, throw)
        except CurlfitError as error:
            found[place] = str(error)
    by_shape: dict[tuple[int, ...], list[int]] = {}
    for place, run in runs.items():
        by_shape.setdefault(run.problem.observed.shape, []).append(place)
    for places in by_shape.values():
        tasks = (runs[place].task(place) for place in places)
        again = lambda place, solution: runs[place].again(place, solution)  # noqa: E731
        optima: dict[int, Optimum] = {}
        for place, solution in solve_many(law, check_load(plan.load), tasks, again):
            optimum = runs[place].optimum(solution)
            if optimum is not None:
                optima[place] = optimum
                if len(optima) == _WEIGHED:
                    found |= _weighed(optima)
                    optima.clear()
                continue
            try:
                found[place] = runs[place].alone()
            except CurlfitError as error:
                found[place] = str(error)
        found |= _weighed(optima)
    return [found[place] for place in sorted(found)]


def _weighed(optima: dict[int, Optimum]) -> dict[int, FitResult]:
    return dict(zip(optima, weighed_together(list(optima.values())), strict=True))


class _Run:
    """A throw on its way through the steps of a fit."""

    def __init__(self, law: type[Law], plan: Plan, throw: Throw) -> None:
        own = Stone().with_values(throw.defaults.get("stone", {}))
        self.law, self.plan, self.throw = law, plan, throw
        self.choices: dict[str, Any] = {
            "fix": dict(plan.fix),
            "bounds": dict(plan.bounds),
            "unbounded": plan.unbounded,
        }
        self.stone = own.with_values(dict(plan.stone))
        self.job: Job = prepared(throw, law, self.stone, plan.until, **self.choices)
        frame, parameters = self.job.frame, self.job.parameters
        self.local = shifted(parameters, -frame.offset(len(parameters)))
        self.sigma = first_sigma(self.job.throw)
        self.estimate = bool(self.sigma)
        self.problem: Problem = problem_of(self.job.throw, self.stone, frame, self.sigma)
        self.path: Smooth = smooth(self.problem)
        self.poor = False

    def task(self, place: int) -> Task[int]:
        start = start_values(
            self.law, check_load(self.plan.load), self.problem, self.path, self.local
        )
        return Task(place, self.problem, start, self.local)

    def again(self, place: int, solution: Solution) -> Task[int] | None:
        """The second fit, with the sigma that the first one found."""
        if not self.estimate:
            return None
        self.poor = poor(solution, self.path, self.problem)
        if self.poor:
            return None
        self.estimate = False
        job = self.job
        self.sigma = estimated_sigma(
            job.throw, solution, self.problem, self.local, list(self.sigma)
        )
        before = np.where(self.problem.weight > 0, self.problem.weight, 1.0)
        self.problem = reweighed(self.problem, self.sigma)
        # Another sigma is another scale of what is known already.
        scale = self.problem.weight / before
        known = scale * solution.residual, scale[..., None] * solution.jacobian
        return Task(place, self.problem, solution.values, self.local, known)

    def optimum(self, solution: Solution | None) -> Optimum | None:
        """Where it ended; None where that is not good enough."""
        if solution is None or not solution.finished or self.poor:
            return None
        job = self.job
        return Optimum(
            job.throw, self.law, check_load(self.plan.load), self.stone, job.until, job.parameters,
            job.frame, self.problem, self.sigma, solution, 1, "linear",
        )  # fmt: skip

    def alone(self) -> FitResult:
        """The fit by itself, with all the starts that `fit` would try."""
        return fit(
            self.throw, self.law, load=self.plan.load, stone=self.stone, until=self.plan.until,
            **self.choices,
        )  # fmt: skip


def _row(result: FitResult, plan: Plan) -> dict[str, Any]:
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
    if plan.posterior and result.converged:
        from curlfit.sampling import sample

        sampled, _ = sample(result, seed=plan.seed)
        assert sampled.posterior is not None
        for name, quantiles in sampled.posterior.quantiles.items():
            row |= {f"{name}_{q}": quantiles[q] for q in ("16", "50", "84")}
    return row
