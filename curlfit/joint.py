"""Several throws of one law together: shared coefficients, each throw its own start and noise.

The Jacobian has the shape of an arrow: each throw knows the shared coefficients and its own
parameters. Each throw's rows are reduced to a small triangle by QR before anything is put together,
so that a step for a dozen throws costs little more than their paths. Levenberg and Marquardt's
damping, bounds by `scipy.optimize.lsq_linear`.

How much the throws differ among themselves is judged to first order about the joint optimum: the
estimate that each throw would give alone, against the shared one (Cochran 1954; the spread between
throws by DerSimonian and Laird 1986).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from curlfit import backend  # noqa: F401  (configures JAX before its first use)

# isort: split
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.special import chdtrc

from curlfit.errors import DataError, InputError, UnusableFitError
from curlfit.files import known, read_json, write_json
from curlfit.fitting import bulk_sigma, estimated_sigma, first_sigma, prepared, shifted
from curlfit.friction import Law, Load, check_load, find_law, no_motion_because
from curlfit.identifiability import Combination, analyse
from curlfit.likelihood import Problem, by_lanes, linearised, problem_of, raw_residuals, stacked
from curlfit.parameters import ParameterSet, check_loss
from curlfit.results import Estimate, FitResult, load_fit
from curlfit.slopes import Slopes, judged
from curlfit.solving import Solution
from curlfit.starting import smooth, start_values
from curlfit.stone import Stone
from curlfit.throw import Throw
from curlfit.weighing import Optimum, weighed

Floats = NDArray[np.float64]

SCHEMA = 1

_TOGETHER = 4  # throws are computed in multiples of this many, so that few shapes are compiled
_MOST_STEPS = 60
_FIRST_DAMPING = 1e-3
_LEAST_DAMPING = 1e-12
_TOLERANCE = 1e-9  # relative gain of a step, below which the search ends
_ROUNDS = 4
_SIGNIFICANT = 0.01


@dataclass(frozen=True)
class Difference:
    """How a coefficient, or a combination of coefficients, differs from throw to throw.

    Attributes
    ----------
    expression : what it is about.
    each : estimate and standard error that each throw gives alone, None where it gives none.
    p_value : chance of differences as large as these if there are none (chi squared).
    spread : standard deviation between throws beyond what the errors explain.
    mean, stderr : of the mean over such throws, the spread between them included.
    significant : p_value below 0.01.
    """

    expression: str
    each: tuple[tuple[float, float] | None, ...]
    p_value: float
    spread: float
    mean: float
    stderr: float

    @property
    def significant(self) -> bool:
        """Whether chance hardly explains the differences."""
        return self.p_value < _SIGNIFICANT


@dataclass(frozen=True)
class JointResult:
    """Several throws fitted together.

    Attributes
    ----------
    law, load, share : what was fitted; names of the shared coefficients.
    converged, status, warnings : whether it may be used, and what to mind.
    coefficients : the shared ones, by name.
    combinations : what is determined where single shared coefficients are not.
    rank, parameters : directions that the throws see together, of how many free parameters.
    differences : of each determined shared coefficient or combination.
    throws : a `FitResult` for each throw; its standard errors are those of the joint fit.
    """

    law: str
    load: str
    share: tuple[str, ...]
    converged: bool
    status: str
    warnings: tuple[str, ...]
    coefficients: dict[str, Estimate]
    combinations: tuple[Combination, ...]
    rank: int
    parameters: int
    differences: tuple[Difference, ...]
    throws: tuple[FitResult, ...]

    def to_json(self) -> dict[str, Any]:
        """The record as written to `joint.json`, without the single throws."""
        return {
            "schema": SCHEMA,
            "law": self.law,
            "load": self.load,
            "share": list(self.share),
            "converged": self.converged,
            "status": self.status,
            "warnings": list(self.warnings),
            "coefficients": {name: asdict(item) for name, item in self.coefficients.items()},
            "combinations": [asdict(item) for item in self.combinations],
            "identifiability": {"rank": self.rank, "parameters": self.parameters},
            "differences": [
                asdict(item) | {"significant": item.significant} for item in self.differences
            ],
            "throws": [
                {
                    "file": item.data["file"],
                    "rows": item.data["rows"],
                    "rms": item.rms,
                    "sigma": item.sigma,
                    "parameters": {name: asdict(one) for name, one in item.parameters.items()},
                }
                for item in self.throws
            ],
        }

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, whole or not at all."""
        write_json(self.to_json(), Path(file))


def load_joint(file: str | PathLike[str]) -> JointResult:
    """Read a saved joint fit, by its folder or its `joint.json`, with the single throws beside it.

    Raises
    ------
    DataError : a file is not there, or is not a record that this version can read.
    """
    path = Path(file)
    if path.is_dir():
        path = path / "joint.json"
    found = read_json(path, SCHEMA, {})
    try:
        return JointResult(
            law=found["law"],
            load=found["load"],
            share=tuple(found["share"]),
            converged=found["converged"],
            status=found["status"],
            warnings=tuple(found["warnings"]),
            coefficients={
                name: Estimate.from_json(item) for name, item in found["coefficients"].items()
            },
            combinations=tuple(
                Combination(**known(Combination, item)) for item in found["combinations"]
            ),
            rank=found["identifiability"]["rank"],
            parameters=found["identifiability"]["parameters"],
            differences=tuple(
                Difference(
                    **known(Difference, item)
                    | {"each": tuple(None if one is None else tuple(one) for one in item["each"])}
                )
                for item in found["differences"]
            ),
            throws=tuple(
                load_fit(path.parent / Path(item["file"]).stem) for item in found["throws"]
            ),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(
            f"not a complete joint.json of curlfit ({type(error).__name__}: {error})", file=path
        ) from None


class _Layout(NamedTuple):
    """Where the parameters of each throw lie in the joint vector."""

    places: NDArray[np.int64]
    """shape (throws, parameters of a throw)"""
    names: tuple[str, ...]
    owner: NDArray[np.int64]
    """throw of each joint parameter; -1 for the shared"""


class _Bench:
    """Throws side by side: residuals and Jacobians of all of them at once."""

    def __init__(self, law: type[Law], load: Load, problems: Sequence[Problem]) -> None:
        self.law, self.load, self.count = law, load, len(problems)
        rows = max(problem.observed.shape[0] for problem in problems)
        size = max(problem.observed.shape[1] for problem in problems)
        self.stacked = stacked([_padded(problem, rows, size) for problem in problems])

    def at(self, values: Floats) -> tuple[Floats, Floats]:
        """Residual and Jacobian for values of shape (throws, parameters)."""
        lanes = -(-self.count // _TOGETHER) * _TOGETHER
        program = partial(linearised, self.law, self.load)
        residual, jacobian = by_lanes(program, (values, self.stacked), lanes)
        return residual, jacobian


def _padded(problem: Problem, rows: int, size: int) -> Problem:
    c, n = problem.observed.shape
    pad = ((0, rows - c), (0, size - n))
    return problem._replace(
        times=np.pad(problem.times, (0, size - n), mode="edge"),
        observed=np.pad(problem.observed, pad),
        weight=np.pad(problem.weight, pad),
    )


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
    layout = _layout(jobs[0].parameters.names, shared, len(jobs))
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
    search = _Search(local, layout, progress)
    joint = search.gather(values)
    best = search.run(_Bench(law, checked, problems), joint)
    for kind in ("linear", *[loss] * (_ROUNDS if loss != "linear" else 0)):
        for place, (job, problem) in enumerate(zip(jobs, problems, strict=True)):
            solution, sigma = search.solution(best, place), sigmas[place]
            if kind == "linear":
                shown = _padded(problem, *solution.residual.shape)
                found = estimated_sigma(solution, shown, local[place], sigma)
            else:
                residual = raw_residuals(law, checked, solution.values, problem)
                found = bulk_sigma(job.throw, residual, problem, sigma)
            sigmas[place] = sigma | found
        problems = [
            problem_of(job.throw, job.stone, job.frame, sigma, kind)
            for job, sigma in zip(jobs, sigmas, strict=True)
        ]
        best = search.run(_Bench(law, checked, problems), best.values)
    if not np.isfinite(best.cost):
        raise UnusableFitError(
            f"law {law.name} with {load} load gives no finite path for these throws"
            + no_motion_because(load)
        )
    return _result(law, checked, tuple(shared), jobs, local, layout, problems, sigmas, search, best,
                   loss)  # fmt: skip


def _layout(names: Sequence[str], shared: Sequence[str], count: int) -> _Layout:
    joint = list(shared)
    owner = [-1] * len(shared)
    places = np.zeros((count, len(names)), int)
    for throw in range(count):
        for column, name in enumerate(names):
            if name in shared:
                places[throw, column] = shared.index(name)
            else:
                places[throw, column] = len(joint)
                joint.append(f"{name}[{throw + 1}]")
                owner.append(throw)
    return _Layout(places, tuple(joint), np.array(owner))


class _State(NamedTuple):
    values: Floats
    residual: Floats
    jacobian: Floats
    cost: float
    steps: int
    finished: bool


class _Search:
    """Levenberg and Marquardt on the arrow."""

    def __init__(
        self,
        local: Sequence[ParameterSet],
        layout: _Layout,
        progress: Callable[[int, float], None] | None,
    ) -> None:
        self.layout, self.progress = layout, progress
        self.lower = self._intersected([item.lower for item in local], np.maximum)
        self.upper = self._intersected([item.upper for item in local], np.minimum)
        self.typical = self.gather(np.stack([item.typical for item in local]))
        self.free = self.upper > self.lower

    def _intersected(self, ends: Sequence[Floats], choose: Any) -> Floats:
        found = self.gather(np.stack(ends))
        for throw, own in enumerate(ends):
            places = self.layout.places[throw]
            found[places] = choose(found[places], own)
        return found

    def gather(self, values: Floats) -> Floats:
        """The joint vector from each throw's own; shared parameters are averaged."""
        total = np.zeros(len(self.layout.names))
        count = np.zeros(len(self.layout.names))
        np.add.at(total, self.layout.places, np.where(np.isfinite(values), values, 0.0))
        np.add.at(count, self.layout.places, 1.0)
        found = total / count
        infinite = ~np.isfinite(values)
        found[self.layout.places[infinite]] = values[infinite]
        return found

    def solution(self, state: _State, throw: int) -> Solution:
        """One throw's part of a state."""
        return Solution(
            values=state.values[self.layout.places[throw]],
            residual=state.residual[throw],
            jacobian=state.jacobian[throw],
            steps=state.steps,
            finished=state.finished,
        )

    def compressed(self, state: _State) -> tuple[Floats, Floats]:
        """A small matrix and right side with the same normal equations."""
        count, p = self.layout.places.shape
        matrix = np.zeros((count * (p + 1), len(self.layout.names)))
        right = np.zeros(count * (p + 1))
        for throw in range(count):
            rows = np.concatenate(
                [state.jacobian[throw].reshape(-1, p), state.residual[throw].reshape(-1, 1)], 1
            )
            triangle: Any = np.linalg.qr(rows, mode="r")
            here = slice(throw * (p + 1), throw * (p + 1) + len(triangle))
            matrix[here, self.layout.places[throw]] = triangle[:, :p]
            right[here] = triangle[:, p]
        return matrix, right

    def _at(self, bench: _Bench, values: Floats, steps: int) -> _State:
        residual, jacobian = bench.at(values[self.layout.places])
        cost = float((residual**2).sum())
        if not np.isfinite(jacobian).all():
            cost = np.inf
        return _State(values, residual, jacobian, cost, steps, False)

    def run(self, bench: _Bench, values: Floats) -> _State:
        """The optimum reached from a joint vector."""
        now = self._at(bench, np.clip(values, self.lower, self.upper), 0)
        damping = _FIRST_DAMPING
        for step in range(1, _MOST_STEPS + 1):
            if not np.isfinite(now.cost):
                return now
            trial = self._at(bench, now.values + self._move(now, damping), step)
            if self.progress is not None:
                self.progress(step, min(now.cost, trial.cost))
            gain = now.cost - trial.cost
            small = abs(gain) <= _TOLERANCE * now.cost
            now = trial if gain >= 0 else now
            if small and damping <= _LEAST_DAMPING:
                return now._replace(finished=True)
            if small:
                damping = _LEAST_DAMPING  # damping may be what kept it from going on
            elif gain > 0:
                damping = max(damping / 10, _LEAST_DAMPING)
            else:
                damping *= 10
                if damping > 1e8:
                    return now._replace(finished=True)
        return now

    def _move(self, state: _State, damping: float) -> Floats:
        matrix, right = self.compressed(state)
        matrix = matrix[:, self.free]
        size = np.linalg.norm(matrix, axis=0)
        size = np.maximum(size, 1e-12 * size.max())
        stacked = np.concatenate([matrix / size, np.sqrt(damping) * np.eye(matrix.shape[1])])
        goal = -np.concatenate([right, np.zeros(matrix.shape[1])])
        low = (self.lower - state.values)[self.free] * size
        high = (self.upper - state.values)[self.free] * size
        found = np.linalg.lstsq(stacked, goal, rcond=None)[0]
        if (found < low).any() or (found > high).any():
            found = lsq_linear(stacked, goal, (low, np.maximum(high, low + 1e-300))).x
        move = np.zeros(len(self.lower))
        move[self.free] = np.clip(found, low, high) / size
        return move


def _result(
    law: type[Law],
    load: Load,
    shared: tuple[str, ...],
    jobs: Sequence[Any],
    local: Sequence[ParameterSet],
    layout: _Layout,
    problems: Sequence[Problem],
    sigmas: Sequence[dict[str, float]],
    search: _Search,
    best: _State,
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
        weighed(
            Optimum(
                job.throw, law, load, job.stone, job.until, job.parameters, job.frame,
                _padded(problem, *solution.residual.shape), sigma, solution, 1, loss,
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
    differences = _differences(best, layout, search, coefficients, sees.combinations, shared)
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


def _differences(
    best: _State,
    layout: _Layout,
    search: _Search,
    coefficients: Mapping[str, Estimate],
    combinations: Sequence[Combination],
    shared: tuple[str, ...],
) -> tuple[Difference, ...]:
    """What each throw alone would say of the shared coefficients, to first order."""
    wanted = {
        name: ({name: 1.0}, item.value)
        for name, item in coefficients.items()
        if item.verdict in ("determined", "weak")
    } | {
        item.expression: (item.weights, item.value)
        for item in combinations
        if set(item.weights) <= set(shared)
    }
    found = []
    for expression, (weights, value) in wanted.items():
        each: list[tuple[float, float] | None] = []
        for throw, places in enumerate(layout.places):
            vector = np.array([weights.get(layout.names[place], 0.0) for place in places])
            each.append(_alone(best, search, throw, vector, value))
        usable = np.array([item for item in each if item is not None])
        if len(usable) > 1:
            found.append(_difference(expression, each, usable))
    return tuple(found)


def _alone(
    best: _State, search: _Search, throw: int, vector: Floats, value: float
) -> tuple[float, float] | None:
    places = search.layout.places[throw]
    free, typical = search.free[places], search.typical[places]
    jacobian = best.jacobian[throw].reshape(-1, len(places))[:, free] * typical[free]
    left, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    seen = singular > max(1e-3, 1e-9 * singular[0])
    weights = (vector * typical)[free]
    along = right[seen] @ weights
    if np.linalg.norm(weights - right[seen].T @ along) > 1e-3 * np.linalg.norm(weights):
        return None  # this throw does not see it
    step = -(left[:, seen].T @ best.residual[throw].reshape(-1)) / singular[seen]
    return value + float(along @ step), float(np.linalg.norm(along / singular[seen]))


def _difference(
    expression: str, each: Sequence[tuple[float, float] | None], usable: Floats
) -> Difference:
    estimate, variance = usable[:, 0], usable[:, 1] ** 2
    weight = 1 / variance
    mean = float(weight @ estimate / weight.sum())
    q = float(weight @ (estimate - mean) ** 2)
    degrees = len(usable) - 1
    between = max(0.0, (q - degrees) / (weight.sum() - (weight**2).sum() / weight.sum()))
    total = 1 / (variance + between)
    return Difference(
        expression=expression,
        each=tuple(each),
        p_value=float(chdtrc(degrees, q)),
        spread=float(np.sqrt(between)),
        mean=float(total @ estimate / total.sum()),
        stderr=float(1 / np.sqrt(total.sum())),
    )
