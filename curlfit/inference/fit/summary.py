"""From an optimum to the record of a fit: what it determines, and what to be warned of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from curlfit.inference.likelihood import (
    LANES,
    SIGMA_FLOOR,
    Frame,
    Problem,
    misfits,
    stacked,
    traced,
)

# isort: split
import jax
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from curlfit.friction import Law, Load
from curlfit.inference.fit.result import Estimate, FitResult
from curlfit.inference.identifiability import Identifiability, analyse_many, few_rows, grouped
from curlfit.inference.least_squares import Solution
from curlfit.inference.linearized_problem import Slopes, judged
from curlfit.inference.noise.correlated import Colour, Smooth
from curlfit.inference.noise.losses import BULK, precision, robust_sigma, steepness
from curlfit.inference.noise.models import Independence, independences, lag1_of
from curlfit.inference.parameters import ParameterSet
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS, Throw

Floats = NDArray[np.float64]

_CURVED = 0.003  # typical sizes of a standard error, below which chi squared is quadratic
_UNKNOWN = 3.0  # the same, above which nothing is known anyway
_QUADRATIC = 0.5  # how far the rise of chi squared at one standard error may be from one
_MISLEADING = 4.0  # factor by which that rise is off where the standard error is by two
_FEWEST = 10  # values of a channel in which outliers are looked for
_FEW = 50  # values that one of them pulls the fit of
_BY_CHANCE = 1e-3  # share of throws that may have one by chance
_MEDIAN_EFFICIENCY = 0.37  # of a sigma from the median size, for Gaussian noise (Huber 1981)
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


def summarize(optimum: Optimum) -> FitResult:
    """The record of a fit from its optimum."""
    (found,) = summarize_many([optimum], lanes=1)
    return found


def summarize_many(
    optima: Sequence[Optimum], lanes: int = 4 * LANES, *, curves: bool = True
) -> list[FitResult]:
    """The same for fits of one law under one load, to problems of one shape.

    Parameters
    ----------
    lanes : paths that are followed side by side.
    curves : whether the records shall hold the fitted curves. Only white noise and least squares
        do without.
    """
    if not optima:
        return []
    problems = stacked([optimum.problem for optimum in optima])
    solutions = stacked([optimum.solution for optimum in optima])
    law, load = optima[0].law, optima[0].load
    paths = traced(law, load, solutions.values, problems, lanes) if curves else None
    survey = _surveyed(problems, solutions, paths)
    # from the problems' coordinates to the data's
    offset = np.stack([item.frame.offset(len(item.parameters)) for item in optima])
    drafts = _drafted(optima, survey, solutions.values + offset)
    around = _at_one_error(optima, drafts, solutions.values, offset)
    of_owners = jax.tree.map(lambda leaf: leaf[around.owner], problems)
    least = (solutions.residual**2).sum((1, 2))
    raised = misfits(law, load, around.point, of_owners, lanes) - least[around.owner]
    nonquadratic = _nonquadratic(drafts, around, raised)
    surveys = map(_Survey, [None] * len(optima) if paths is None else paths, *survey[1:])
    return list(map(_recorded, optima, surveys, drafts, nonquadratic))


class _Survey(NamedTuple):
    """What is left of a throw's data at its optimum; or of many, along the first axis of each."""

    path: Floats | None
    """in the problem's frame, shape (5, n); None where the record shall not have it"""
    residual: Floats
    """data less path, 0 where nothing was seen, shape (channels, n)"""
    few: Floats
    """residual over its sigma, and its Jacobian before it, as few rows as columns"""
    number: NDArray[np.int64]
    """of the values of each channel, shape (channels,)"""
    rms: Floats
    lag1: Floats
    apart: Any
    """how far the residuals over their sigma are from independent, an `Independence` a channel"""


def _surveyed(problems: Problem, solutions: Solution, paths: Floats | None) -> _Survey:
    seen = problems.weight > 0
    count = seen.sum(-1)
    if paths is None:
        residual = -solutions.residual / np.where(seen, problems.weight, 1.0)
    else:
        residual = np.where(seen, problems.observed - paths[:, : seen.shape[1]], 0.0)
    rms = np.sqrt((residual**2).sum(-1) / np.maximum(count, 1))
    # What was seen, without the gaps.
    order = np.argsort(~seen, -1, kind="stable")
    lag1 = lag1_of(np.take_along_axis(residual, order, -1), count)
    apart = independences(np.take_along_axis(solutions.residual, order, -1), count)
    few = few_rows(solutions.jacobian, solutions.residual)
    return _Survey(paths, residual, few, count, rms, lag1, apart)


class _Draft(NamedTuple):
    """The answer but for the last look around the optimum."""

    values: Floats
    """in the data's coordinates"""
    known: Identifiability
    at_bound: NDArray[np.bool_]
    open: NDArray[np.bool_]
    slack: Floats
    """what parameters at a bound add to the spread of the open ones, see `Slopes.open`"""
    left: float
    """standard errors to the optimum, as far as the slopes tell"""
    variance: Floats
    """the covariance's part from each channel's noise, shape (channels, open, open)"""
    dof: Floats
    """degrees of freedom of each channel's sigma; infinite where it was given"""
    leverage: Floats
    """of each value on its own fitted one, 0 to 1, shape (channels, n)"""

    def degrees_of_freedom(self, weights: Floats) -> float | None:
        """Of the variance of a weighted sum of the open parameters (Satterthwaite 1946, eq. 17);
        None where all sigmas were given."""
        parts = np.einsum("i,cij,j->c", weights, self.variance, weights)
        inverse = float((parts**2 / self.dof).sum())
        return float(parts.sum()) ** 2 / inverse if inverse > 0 else None


def _drafted(optima: Sequence[Optimum], survey: _Survey, values: Floats) -> list[_Draft]:
    """Those of one set of open parameters are looked into together."""
    sets = [optimum.parameters for optimum in optima]
    slopes = Slopes(
        survey.few[..., -1], survey.few[..., :-1], values,
        *(np.stack([getattr(item, name) for item in sets])
          for name in ("lower", "upper", "typical", "free")),
    )  # fmt: skip
    at_bound = slopes.at_bound()
    number = np.maximum(survey.number.sum(-1), 1)
    misfit = (slopes.residual**2).sum(-1) / number
    left = slopes.distance(slopes.movable()) / np.sqrt(np.maximum(misfit, 1.0))
    held = [
        Slopes(*one).open(stuck)
        for one, stuck in zip(zip(*slopes, strict=True), at_bound, strict=True)
    ]
    drafts: dict[int, _Draft] = {}
    estimated = np.array([[name in item.sigma for name in CHANNELS] for item in optima])
    efficiency = 1.0 if optima[0].loss == "linear" else _MEDIAN_EFFICIENCY
    for places in grouped((stuck, open_) for stuck, (open_, _) in zip(at_bound, held, strict=True)):
        first, (open_, _) = sets[places[0]], held[places[0]]
        jacobians = [
            _effective_jacobian(optima[place], survey.residual[place], survey.few[place])
            for place in places
        ]
        slack = np.stack([held[place][1] for place in places])
        found = analyse_many(
            np.stack(jacobians)[..., open_], first.names_where(open_), values[places][:, open_],
            first.typical[open_], slack,
        )  # fmt: skip
        by_channel = np.stack([optima[place].solution.jacobian[..., open_] for place in places])
        covariance = np.stack([item.covariance for item in found])[:, None]
        covariance = covariance - (slack @ slack.mT)[:, None]
        part = covariance @ (by_channel.mT @ by_channel)
        leverage = ((by_channel @ covariance) * by_channel).sum(-1)
        # n - p by channel, p the parameters that it pays for itself
        dof = np.maximum(survey.number[places] - leverage.sum(-1), 1.0)
        dof = np.where(estimated[places, : dof.shape[1]], efficiency * dof, np.inf)
        for row, place in enumerate(places):
            drafts[place] = _Draft(
                values[place], found[row], at_bound[place], open_, slack[row], float(left[place]),
                part[row] @ covariance[row], dof[row], leverage[row],
            )  # fmt: skip
    return [drafts[place] for place in range(len(optima))]


def _recorded(
    optimum: Optimum, survey: _Survey, draft: _Draft, nonquadratic: dict[str, float]
) -> FitResult:
    throw, law, load, stone, until, parameters, frame, problem, sigma, solution, tried, loss = (
        optimum
    )
    known, at_bound = draft.known, draft.at_bound
    n = len(throw)
    curves = {}
    if survey.path is not None:
        curves = dict(zip(CHANNELS, survey.path[:, :n] + frame.place[:, None], strict=True))
    counted = [(row, name) for row, name in enumerate(CHANNELS[: len(survey.number)])]
    rms = {name: float(survey.rms[row]) for row, name in counted if survey.number[row]}
    lag1 = {name: float(survey.lag1[row]) for row, name in counted if survey.number[row] > 3}
    apart = {name: survey.apart[row] for row, name in counted if survey.number[row] > 3}
    converged, status, warnings = _judge(
        law, solution, draft.left, parameters, at_bound, known.names, tried,
        dict(zip(CHANNELS, survey.number, strict=False)), rms, apart, problem.colour,
    )  # fmt: skip
    if nonquadratic:
        warnings.append(
            f"chi squared is not quadratic within a standard error of {', '.join(nonquadratic)}: "
            "these standard errors are rough; use the profile likelihood or the posterior"
        )
    outliers = _outliers(throw, survey.residual, lag1, draft, loss)
    if outliers and loss == "linear":
        warnings.append(_about_outliers(outliers))
    if loss == "linear" and problem.colour is None:
        warnings += _about_given_sigma(throw, solution.residual[:, :n], outliers)
    kept = [name for name in CHANNELS if name in throw.seen or name in ("x", "y", "phi")]
    observed = {name: getattr(throw, name) for name in ("t", *kept)}
    observed |= {f"sigma_{name}": series for name, series in throw.sigma.items()}
    free = parameters.free
    slope, few = survey.few[:, -1], survey.few[:, :-1][:, free]
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
            "sigma": {name: "estimated" if name in sigma else "given" for name in rms},
            "notes": list(throw.notes),
        },
        converged=converged,
        status=status,
        warnings=tuple(warnings),
        n_observations=throw.n_observations,
        rms=rms,
        sigma=sigma,
        lag1=lag1,
        parameters=_estimates(parameters, draft, nonquadratic),
        combinations=tuple(
            replace(
                item,
                dof=draft.degrees_of_freedom(
                    np.array([item.weights.get(name, 0.0) for name in known.names])
                ),
            )
            for item in known.combinations
        ),
        rank=known.rank,
        singular_values=tuple(map(float, known.singular_values)),
        null_directions=known.null_directions,
        covariance={"names": list(known.names), "matrix": known.covariance.tolist()},
        information={
            "gradient": (-slope @ few).tolist(),
            "names": parameters.names_where(free),
            "matrix": (few.T @ few).tolist(),
        },
        reference=throw.reference if throw.reference and throw.reference.law == law.name else None,
        observed=observed,
        fitted=curves,
        loss=loss,
        independence=apart,
        outliers=outliers,
    )  # fmt: skip


def _effective_jacobian(optimum: Optimum, residual: Floats, few: Floats) -> Floats:
    """Jacobian of the residuals over their sigma, each channel by what a robust loss makes of it.

    The covariance of an M-estimator is that of least squares over `precision` (Huber 1981).
    """
    problem, loss = optimum.problem, optimum.loss
    if loss == "linear":
        return few[:, :-1]
    jacobian = optimum.solution.jacobian.copy()
    for row, weight in enumerate(problem.weight):
        r = -residual[row] * weight
        jacobian[row] /= steepness(r, loss)[:, None]
        jacobian[row] *= np.sqrt(precision(r[weight > 0], loss))
    return jacobian.reshape(-1, jacobian.shape[-1])


class _Around(NamedTuple):
    """Places one standard error off along the axes of the covariances, along the first axis."""

    owner: NDArray[np.intp]
    """whose place it is"""
    point: Floats
    """shape (places, parameters)"""
    along: Floats
    """the axis, in typical sizes; 0 for parameters that are not open"""


def _at_one_error(
    optima: Sequence[Optimum], drafts: Sequence[_Draft], values: Floats, offset: Floats
) -> _Around:
    sets, typical = [optimum.parameters for optimum in optima], optima[0].parameters.typical
    lower, upper = (
        np.stack([getattr(item, name) for item in sets]) - offset for name in ("lower", "upper")
    )
    found = []
    for places in grouped((draft.open,) for draft in drafts):
        open_ = np.flatnonzero(drafts[places[0]].open)
        # That of the open parameters alone: those at a bound stay where they are.
        covariance = np.stack(
            [drafts[k].known.covariance - drafts[k].slack @ drafts[k].slack.T for k in places]
        )
        squares, axes = np.linalg.eigh(covariance / np.outer(typical[open_], typical[open_]))
        some = (squares > _CURVED**2) & (squares < _UNKNOWN**2)
        along = np.zeros((*squares.shape, 2, len(typical)))
        along[..., open_] = axes.mT[:, :, None]
        size = np.sqrt(np.where(some, squares, 0.0))[..., None, None] * [[1.0], [-1.0]]
        points = values[places][:, None, None] + size * along * typical
        low, high = lower[places][:, None, None], upper[places][:, None, None]
        inside = some[..., None] & ((points >= low) & (points <= high)).all(-1)
        owner = np.array(places)[np.nonzero(inside)[0]]
        found.append(_Around(owner, points[inside], along[inside]))
    return _Around(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _nonquadratic(
    drafts: Sequence[_Draft], around: _Around, raised: Floats
) -> list[dict[str, float]]:
    """Parameters along which one standard error does not raise chi squared by about one, and the
    largest factor by which it is more or less."""
    off = ~(np.abs(raised - 1) < _QUADRATIC)
    rise = np.maximum(np.nan_to_num(raised, nan=np.inf), 1e-300)
    factor = np.maximum(rise, 1 / rise)
    found: list[dict[str, float]] = [{} for _ in drafts]
    for owner in np.unique(around.owner[off]):
        mine = off & (around.owner == owner)
        size = np.abs(around.along[mine])
        large = (size > 0.3 * size.max(1, keepdims=True))[:, drafts[owner].open]
        most = np.where(large, factor[mine, None], 0.0).max(0)
        names = drafts[owner].known.names
        found[owner] = {name: float(f) for name, f in zip(names, most, strict=True) if f > 0}
    return found


def _outliers(
    throw: Throw, residual: Floats, lag1: dict[str, float], draft: _Draft, loss: str
) -> tuple[dict[str, Any], ...]:
    """Values farther off than noise goes, where what is left looks like noise.

    Either more than 5 + 30/(n - 6) sigmas of the bulk, a limit that Gaussian noise in three
    channels of n values passes in one of 1,000 throws, for n from 12 to 400 (Hampel's identifier,
    its constants simulated as by Davies and Gather 1993); or, since a value pulls the fit of few
    rows toward itself, an externally studentized residual beyond the same chance (Cook and
    Weisberg 1982, sect. 2.2).
    """
    found = []
    for row, name in enumerate(CHANNELS[: len(residual)]):
        seen = np.flatnonzero(throw.finite[row])
        if len(seen) < _FEWEST or lag1.get(name, 1.0) > _SMOOTH:
            continue
        limit = 5 + 30 / (len(seen) - 6)
        series = throw.sigma.get(name)
        size = np.abs(residual[row, seen])
        dof = draft.dof[row]
        studentized = len(seen) < _FEW and loss == "linear" and series is None and dof > 2
        if not studentized and 2 * (size > size.max() / (limit * BULK)).sum() > len(seen):
            continue  # the median size is so large that none is far
        bulk = max(robust_sigma(residual[row, seen]), SIGMA_FLOOR)
        sigma = np.full(len(throw), bulk) if series is None else np.maximum(series, bulk)
        far = size > limit * sigma[seen]
        if studentized:
            free = np.maximum(1 - draft.leverage[row, seen], 1e-6)
            others = np.maximum((size**2).sum() - size**2 / free, SIGMA_FLOOR**2) / (dof - 1)
            chance = _BY_CHANCE / (2 * residual.shape[0] * len(seen))
            far |= size > -stdtrit(dof - 1, chance) * np.sqrt(free * others)
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
    many = "one outlier" if len(outliers) == 1 else f"{len(outliers)} outliers, the farthest"
    return (
        f"{many}: {first['channel']} at t = {first['t']:g} s{place}, {first['sigmas']:.2g} sigma "
        "off; --loss student is robust to outliers"
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


def _estimates(
    parameters: ParameterSet, draft: _Draft, nonquadratic: dict[str, float]
) -> dict[str, Estimate]:
    """By name; see `Estimate` for the verdicts."""
    found = {}
    place, unit = np.cumsum(draft.open) - 1, np.eye(int(draft.open.sum()))
    for row, item in enumerate(parameters.parameters):
        stderr, verdict = (
            (None, "fixed")
            if item.name in parameters.fixed
            else judged(item.typical, bool(draft.at_bound[row]), draft.known, int(place[row]))
        )
        reason = ""
        if verdict == "weak":
            reason = f"its standard error is no smaller than its typical size, {item.typical:g}"
        elif verdict == "determined" and nonquadratic.get(item.name, 1.0) > _MISLEADING:
            verdict, reason = "weak", "chi squared is far from quadratic within its standard error"
        found[item.name] = Estimate(
            value=float(draft.values[row]),
            stderr=stderr,
            dof=None if stderr is None else draft.degrees_of_freedom(unit[place[row]]),
            verdict=verdict,
            reason=reason,
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
    colour: Colour,
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
                    else f"the data favour values outside {within}"
                )
            )
    together = {
        name: item
        for name, item in apart.items()
        if item.doubtful and count[name] > 20 and rms[name] > 10 * SIGMA_FLOOR
    }
    if together:
        warnings.append(_about_correlation(together, count, colour))
    return converged, status, warnings


def _about_correlation(
    together: dict[str, Independence], count: dict[str, int], colour: Colour
) -> str:
    listed = ", ".join(f"{item.lag1:.2f} in {name}" for name, item in together.items())
    if isinstance(colour, Smooth):
        return (
            f"noise gp does not describe these residuals, which stay correlated from row to row "
            f"(lag-1 correlation {listed}); it takes noise of short memory for a discrepancy of "
            "the law, and standard errors are then several times too large; fit with --noise ar1"
        )
    if colour is not None:
        return (
            f"noise ar1 does not describe these residuals, which stay correlated from row to row "
            f"(lag-1 correlation {listed}); standard errors are too small; fit with --noise gp"
        )
    effective = ", ".join(
        f"{item.effective:.0f} of {count[name]} in {name}" for name, item in together.items()
    )
    smooth = max(item.lag1 for item in together.values()) > _SMOOTH
    kind = "are smooth" if smooth else "are correlated from row to row"
    cause = ", as a model discrepancy or slow noise leaves them" if smooth else ""
    return (
        f"the residuals {kind} (lag-1 correlation {listed}){cause}; standard errors, which assume "
        f"independent noise, are too small (effective number of values: {effective}); fit with "
        f"--noise {'gp' if smooth else 'ar1'}, or compare both models"
    )
