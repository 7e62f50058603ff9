"""The answer weighed: what an optimum determines, and what the reader has to mind."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.friction import Law, Load
from curlfit.identifiability import Identifiability, analyse, slack, triangle, visible
from curlfit.likelihood import (
    LANES,
    SIGMA_FLOOR,
    Frame,
    Problem,
    residuals_from,
    stacked,
    trace,
    traces,
)
from curlfit.losses import precision, robust_sigma, signed_root, steepness
from curlfit.noise import Independence, independence, lag1_of
from curlfit.parameters import LOSSES, ParameterSet
from curlfit.results import Estimate, FitResult
from curlfit.solving import Solution
from curlfit.stone import Stone
from curlfit.throw import CHANNELS, Throw

Floats = NDArray[np.float64]

_LOOSE = 0.1  # typical sizes a parameter may be inside its bound before it counts as held by it
_NEAR = 1e-6  # typical sizes from its bound within which a parameter is at it
_PUSHED = 10.0  # times the slope along those inside that a parameter at a bound is pushed with ...
_LEAST_PUSH, _CLEAR_PUSH = 1e-6, 1e-3  # ... within these limits, half chi squared a typical size
_CURVED = 0.003  # typical sizes of a standard error, below which the misfit is a parabola
_UNKNOWN = 3.0  # the same, above which nothing is known anyway
_PARABOLA = 0.5  # how far chi squared may be from one higher at one standard error
_FAR = 5.0  # sigma from which a value is called an outlier
_MUCH = 1.5  # times the sigma given, above which residuals are called too large ...
_NOT_BY_CHANCE = 5.0  # ... where chi squared is so many of its own standard deviations too high
_SMOOTH = 0.5  # lag-1 correlation of residuals from which they are called smooth


class Optimum(NamedTuple):
    """What a fit ended with, and what it was asked."""

    throw: Throw
    law: type[Law]
    load: Load
    stone: Stone
    until: float | None
    parameters: ParameterSet
    frame: Frame
    problem: Problem
    sigma: dict[str, float]
    """of the channels whose own was not given"""
    solution: Solution
    tried: int
    """starts that led to it"""
    loss: str


_Weighing = Generator[Floats, Floats, FitResult]
"""Asks for the paths of parameter vectors and is sent those, until it has the answer."""


def weighed(optimum: Optimum) -> FitResult:
    """The record of a fit from its optimum."""
    law, load, problem = optimum.law, optimum.load, optimum.problem
    work = _weighing(optimum)
    wanted = next(work)
    while True:
        paths = [np.asarray(trace(law, load, values, problem)) for values in wanted]
        try:
            wanted = work.send(np.array(paths))
        except StopIteration as done:
            return done.value


def weighed_together(optima: Sequence[Optimum]) -> list[FitResult]:
    """The same for fits of one law under one load, to problems of one shape, side by side."""
    works = dict(enumerate(map(_weighing, optima)))
    wanted = {place: next(work) for place, work in works.items()}
    found: dict[int, FitResult] = {}
    while works:
        paths = _traces(optima, wanted)
        for place, work in list(works.items()):
            try:
                wanted[place] = work.send(paths[place])
            except StopIteration as done:
                found[place] = done.value
                del works[place], wanted[place]
    return [found[place] for place in range(len(optima))]


def _traces(optima: Sequence[Optimum], wanted: Mapping[int, Floats]) -> dict[int, Floats]:
    """The paths of each optimum's vectors, `LANES` at a time."""
    owners = [place for place, vectors in wanted.items() for _ in vectors]
    if not owners:
        return {place: np.zeros((0, 0, 0)) for place in wanted}
    fill = -len(owners) % LANES
    vectors = np.concatenate([item for item in wanted.values() if len(item)])
    vectors = np.concatenate([vectors, np.repeat(vectors[-1:], fill, 0)])
    problems = [optima[place].problem for place in [*owners, *[owners[-1]] * fill]]
    law, load = optima[0].law, optima[0].load
    parts = [
        np.asarray(traces(law, load, vectors[k : k + LANES], stacked(problems[k : k + LANES])))
        for k in range(0, len(vectors), LANES)
    ]
    paths = np.concatenate(parts)
    ends = np.cumsum([len(item) for item in wanted.values()])
    return dict(zip(wanted, np.split(paths[: ends[-1]], ends[:-1]), strict=True))


def _weighing(optimum: Optimum) -> _Weighing:
    throw, law, load, stone, until, parameters, frame, problem, sigma, solution, tried, loss = (
        optimum
    )
    n = len(throw)
    offset = frame.offset(len(parameters))
    values = solution.values + offset
    seen = np.isfinite(throw.observed)
    (path,) = yield solution.values[None]
    curves = path[:, :n] + frame.place[:, None]
    residual = throw.observed - curves
    squares = np.where(seen, residual**2, 0.0).sum(1)
    count = seen.sum(1)
    rms = np.sqrt(squares / np.maximum(count, 1))

    free = parameters.free
    slopes = Slopes(
        solution.residual.reshape(-1), solution.jacobian.reshape(-1, len(parameters)), values,
        parameters.lower, parameters.upper, parameters.typical, free,
    )  # fmt: skip
    at_bound = slopes.at_bound()
    open_, slack_columns = slopes.open(at_bound)
    jacobian = _effective_jacobian(solution, residual, problem, loss)
    known = analyse(
        jacobian[:, :n, open_].reshape(-1, int(open_.sum())),
        parameters.names_where(open_),
        values[open_],
        parameters.typical[open_],
        slack_columns,
    )
    rms_by = {name: float(rms[row]) for row, name in enumerate(CHANNELS) if count[row]}
    lag1 = {
        name: lag1_of(residual[row][seen[row]])
        for row, name in enumerate(CHANNELS)
        if count[row] > 3
    }
    apart = {
        name: independence(solution.residual[row, :n][seen[row]])
        for row, name in enumerate(CHANNELS)
        if count[row] > 3
    }
    left = slopes.distance(slopes.movable()) / max(1.0, float(np.sqrt(np.mean(slopes.residual**2))))
    converged, status, warnings = _judge(
        law, solution, left, parameters, at_bound, known.names, tried,
        dict(zip(CHANNELS, count, strict=True)), rms_by, apart, white=problem.colour is None,
    )  # fmt: skip
    points, along = _at_one_error(solution, parameters, offset, known, open_)
    bent = _bent(problem, solution, known, along, (yield points))
    if bent:
        warnings.append(
            f"the misfit is no parabola within a standard error of {', '.join(bent)}; these errors "
            "are rough, the posterior tells more"
        )
    outliers = _outliers(throw, residual, lag1)
    if outliers and loss == "linear":
        warnings.append(_about_outliers(outliers))
    if loss == "linear" and problem.colour is None:
        warnings += _about_given_sigma(throw, solution.residual[:, :n], outliers)
    kept = [name for name in CHANNELS if name in throw.seen or name in ("x", "y", "phi")]
    observed = {name: getattr(throw, name) for name in ("t", *kept)}
    observed |= {f"sigma_{name}": series for name, series in throw.sigma.items()}
    fitted = dict(zip(CHANNELS, curves, strict=True))
    return FitResult(
        law=law.name,
        load=load,
        stone=stone,
        data={
            "file": throw.name,
            "law_file": law.origin or None,
            "rows": n,
            "from": float(throw.t[0]),
            "to": float(throw.t[-1]),
            "until": until,
            "sigma": {name: "estimated" if name in sigma else "given" for name in rms_by},
            "notes": list(throw.notes),
        },
        converged=converged,
        status=status,
        warnings=tuple(warnings),
        n_observations=throw.n_observations,
        rms=rms_by,
        sigma=sigma,
        lag1=lag1,
        parameters=_estimates(parameters, values, known, open_, at_bound, bent),
        combinations=known.combinations,
        rank=known.rank,
        singular_values=tuple(map(float, known.singular_values)),
        null_directions=known.null_directions,
        covariance={"names": list(known.names), "matrix": known.covariance.tolist()},
        information={
            "gradient": (
                -np.einsum("cn,cni->i", solution.residual, solution.jacobian)[free]
            ).tolist(),
            "names": parameters.names_where(free),
            "matrix": np.einsum("cni,cnj->ij", *[solution.jacobian[:, :, free]] * 2).tolist(),
        },
        reference=throw.reference if throw.reference and throw.reference.law == law.name else None,
        observed=observed,
        fitted=fitted,
        loss=loss,
        independence=apart,
        outliers=outliers,
    )


def _effective_jacobian(
    solution: Solution, residual: Floats, problem: Problem, loss: str
) -> Floats:
    """Jacobian of the residuals over their sigma, each channel by what the loss makes of it.

    The covariance of an M-estimator is that of least squares over `precision` (Huber 1981).
    """
    if loss == "linear":
        return solution.jacobian
    n = residual.shape[1]
    jacobian = solution.jacobian.copy()
    for row in range(len(jacobian)):
        r = np.nan_to_num(-residual[row]) * problem.weight[row, :n]
        jacobian[row, :n] /= steepness(r, loss)[:, None]
        jacobian[row] *= np.sqrt(precision(r[problem.weight[row, :n] > 0], loss))
    return jacobian


def _at_one_error(
    solution: Solution,
    parameters: ParameterSet,
    offset: Floats,
    known: Identifiability,
    open_: NDArray[np.bool_],
) -> tuple[Floats, list[Floats]]:
    """Places one standard error off along each axis of the covariance, and these axes."""
    points: list[Floats] = []
    along: list[Floats] = []
    if known.names:
        typical = parameters.typical[open_]
        squares, axes = np.linalg.eigh(known.covariance / np.outer(typical, typical))
        lower, upper = parameters.lower - offset, parameters.upper - offset
        for square, axis in zip(squares, axes.T, strict=True):
            if not _CURVED**2 < square < _UNKNOWN**2:
                continue
            for sense in (1.0, -1.0):
                values = solution.values.copy()
                values[open_] += sense * np.sqrt(square) * axis * typical
                if ((values >= lower) & (values <= upper)).all():
                    points.append(values)
                    along.append(axis)
    return np.array(points).reshape(-1, len(parameters)), along


def _bent(
    problem: Problem,
    solution: Solution,
    known: Identifiability,
    along: list[Floats],
    paths: Floats,
) -> list[str]:
    """Parameters along which one standard error does not raise chi squared by about one."""
    least = float((solution.residual**2).sum())
    found: set[str] = set()
    for axis, path in zip(along, paths, strict=True):
        residual = residuals_from(path, problem)
        if LOSSES[int(problem.loss)] != "linear":
            residual = np.asarray(signed_root(residual, problem.loss))
        if not abs(float((residual**2).sum()) - least - 1) < _PARABOLA:
            large = np.abs(axis) > 0.3 * np.abs(axis).max()
            found |= {name for name, take in zip(known.names, large, strict=True) if take}
    return [name for name in known.names if name in found]


def _outliers(throw: Throw, residual: Floats, lag1: dict[str, float]) -> tuple[dict[str, Any], ...]:
    """Values farther off than noise goes, where what is left looks like noise."""
    found = []
    for row, name in enumerate(CHANNELS):
        seen = np.flatnonzero(np.isfinite(residual[row]))
        if len(seen) < 10 or lag1.get(name, 1.0) > _SMOOTH:
            continue
        series = throw.sigma.get(name)
        bulk = max(robust_sigma(residual[row, seen]), SIGMA_FLOOR)
        sigma = np.full(len(throw), bulk) if series is None else np.maximum(series, bulk)
        far = np.abs(residual[row, seen]) > _FAR * sigma[seen]
        for place in seen[far]:
            found.append(
                {
                    "channel": name,
                    "t": float(throw.t[place]),
                    "line": None if throw.lines is None else int(throw.lines[place]),
                    "off": float(residual[row, place]),
                    "sigmas": float(abs(residual[row, place]) / sigma[place]),
                }
            )
    return tuple(sorted(found, key=lambda item: -item["sigmas"]))


def _about_outliers(outliers: tuple[dict[str, Any], ...]) -> str:
    first = outliers[0]
    place = f" (line {first['line']})" if first["line"] is not None else ""
    many = "one value lies" if len(outliers) == 1 else f"{len(outliers)} values lie"
    return (
        f"{many} more than {_FAR:g} sigma off, the farthest {first['channel']} at "
        f"t = {first['t']:g} s{place}; --loss student keeps such values from pulling"
    )


def _about_given_sigma(
    throw: Throw, residual: Floats, outliers: tuple[dict[str, Any], ...]
) -> list[str]:
    """Channels whose residuals, outliers apart, are far larger than the sigma they were given."""
    aside = {(item["channel"], item["t"]) for item in outliers}
    found = {}
    for row, name in enumerate(CHANNELS):
        if name not in throw.sigma:
            continue
        seen = np.flatnonzero(np.isfinite(throw.observed[row]))
        kept = [place for place in seen if (name, float(throw.t[place])) not in aside]
        if not kept:
            continue
        square = float(np.mean(residual[row, kept] ** 2))
        by_chance = 1 + _NOT_BY_CHANCE * np.sqrt(2 / len(kept))  # chi squared over its number
        if square > max(by_chance, _MUCH**2):
            found[name] = float(np.sqrt(square))
    if not found:
        return []
    listed = ", ".join(f"{times:.2g} times in {name}" for name, times in found.items())
    return [
        f"the residuals are far larger than the sigma given ({listed}): that is too small, or the "
        "law or a fixed value is wrong; standard errors are too small by as much or more"
    ]


class Slopes(NamedTuple):
    """An optimum of one throw or of several, as the linear problem it is close by."""

    residual: Floats
    """over its sigma, shape (rows,)"""
    jacobian: Floats
    """shape (rows, parameters)"""
    values: Floats
    lower: Floats
    upper: Floats
    typical: Floats
    free: NDArray[np.bool_]

    def at_bound(self) -> NDArray[np.bool_]:
        """Free parameters at a bound that the data push against it, be it ever so little.

        Along a valley that falls without end the push may be tiny. It is told from the end of an
        exact ridge, which is none, by what is left of the slope along the other parameters.
        """
        push, low, high = self._pushes()
        rest = np.abs(push[self.free & ~low & ~high]).max(initial=0.0)
        least = np.clip(_PUSHED * rest, _LEAST_PUSH, _CLEAR_PUSH)
        return low & (push > least) | high & (push < -least)

    def movable(self) -> NDArray[np.bool_]:
        """Free parameters but those that only a bound keeps from moving on, however little."""
        push, low, high = self._pushes()
        return self.free & ~(low & (push > 0)) & ~(high & (push < 0))

    def _pushes(self) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
        """The push against lower bounds, and which parameters are at a lower, an upper bound."""
        near = _NEAR * self.typical
        return (
            self.residual @ self.jacobian * self.typical,
            self.free & (self.values <= self.lower + near),
            self.free & (self.values >= self.upper - near),
        )

    def open(self, at_bound: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Floats]:
        """The parameters that can move, and what those held at a bound add to their spread.

        A parameter that the data hardly push against its bound is not held by it: it is at the
        end of a ridge, and counts as open.
        """
        if not at_bound.any():
            return self.free, np.zeros((int(self.free.sum()), 0))
        push = np.abs(self.residual @ self.jacobian)
        room = self.upper - self.lower
        held = at_bound.copy()
        for _ in range(2):
            open_ = self.free & ~held
            found = slack(
                self.jacobian[:, open_], self.jacobian[:, held], push[held], self.typical[held],
                room[held],
            )  # fmt: skip
            loose = found.distance > _LOOSE * self.typical[held]
            if not loose.any():
                break
            held[held] = ~loose
        return open_, found.columns

    def distance(self, where: NDArray[np.bool_]) -> float:
        """Length of the Gauss-Newton step that is left, in sigmas, along what is seen.

        A direction that counts as unseen would have to be followed over a thousand typical sizes.
        """
        jacobian = (self.jacobian * self.typical)[:, where]
        few = triangle(np.column_stack([jacobian, self.residual]))
        left, singular, _ = np.linalg.svd(few[:, :-1], full_matrices=False)
        return float(np.linalg.norm(left[:, visible(singular)].T @ few[:, -1]))


def judged(
    typical: float, at_bound: bool, known: Identifiability, place: int
) -> tuple[float | None, str]:
    """Standard error, where there is one, and verdict of a free parameter; its place in `known`."""
    if at_bound:
        return None, "at bound"
    if known.unseen[place]:
        return None, "not identifiable"
    stderr = float(np.sqrt(known.covariance[place, place]))
    return stderr, "determined" if stderr < typical else "weak"


def _estimates(
    parameters: ParameterSet,
    values: Floats,
    known: Identifiability,
    open_: NDArray[np.bool_],
    at_bound: NDArray[np.bool_],
    bent: list[str],
) -> dict[str, Estimate]:
    """By name; what lies along a bent valley is not determined, however sharp it looks there."""
    found = {}
    place = np.cumsum(open_) - 1
    for row, item in enumerate(parameters.parameters):
        stderr, verdict = (
            (None, "fixed")
            if item.name in parameters.fixed
            else judged(item.typical, bool(at_bound[row]), known, int(place[row]))
        )
        if verdict == "determined" and item.name in bent:
            verdict = "weak"
        found[item.name] = Estimate(
            value=float(values[row]),
            stderr=stderr,
            verdict=verdict,
            unit=item.unit,
            symbol=item.symbol,
            meaning=item.meaning,
            lower=item.lower,
            upper=item.upper,
            typical=item.typical,
        )
    return found


def _judge(
    law: type[Law],
    solution: Solution,
    left: float,
    parameters: ParameterSet,
    at_bound: NDArray[np.bool_],
    open_names: tuple[str, ...],
    tried: int,
    count: dict[str, int],
    rms: dict[str, float],
    apart: dict[str, Independence],
    *,
    white: bool,
) -> tuple[bool, str, list[str]]:
    """Converged or not (`left` standard errors from it), the same in words, and what to mind."""
    converged = bool(left < 0.01)
    steps = f"{int(solution.steps)} steps" + (f", best of {tried} starts" if tried > 1 else "")
    if converged:
        status = f"converged ({steps})"
    else:
        status = (
            f"not converged: the next step would still gain {left:.2g} standard errors ({steps})"
        )
    warnings = []
    fault = law.from_vector(solution.values).fault()
    if fault is not None:
        warnings.append(f"{fault}; the fitted coefficients make no law of friction")
    for item, stuck in zip(parameters.parameters, at_bound, strict=True):
        if stuck:
            within = f"{item.lower:g}..{item.upper:g}"
            warnings.append(
                f"{item.name} sits at its bound; "
                + (
                    f"the data hardly tell this from other values within {within}"
                    if item.name in open_names
                    else f"the data would rather have it outside {within}"
                )
            )
    together = {
        name: item
        for name, item in apart.items()
        if item.doubtful and count[name] > 20 and rms[name] > 10 * SIGMA_FLOOR
    }
    if together:
        warnings.append(_about_correlation(together, count, white=white))
    return converged, status, warnings


def _about_correlation(
    together: dict[str, Independence], count: dict[str, int], *, white: bool
) -> str:
    listed = ", ".join(f"{item.lag1:.2f} in {name}" for name, item in together.items())
    if not white:
        return (
            f"what the noise model leaves still goes together from row to row (lag-1 correlation "
            f"{listed}): standard errors are too small"
        )
    worth = ", ".join(
        f"{item.effective:.0f} of {count[name]} in {name}" for name, item in together.items()
    )
    if max(item.lag1 for item in together.values()) > _SMOOTH:
        return (
            f"the residuals are smooth (lag-1 correlation {listed}): they show what the law "
            "misses, not noise, and standard errors, which assume independent noise, are too small "
            f"(values worth as much as independent ones: {worth}); --noise gp carries it"
        )
    return (
        f"the residuals go together from row to row (lag-1 correlation {listed}): standard errors, "
        f"which assume independent noise, are too small (values worth as much as independent ones: "
        f"{worth}); --noise ar1 or gp carries it"
    )
