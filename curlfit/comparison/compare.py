"""Many laws on one throw: each is fitted, and they are ranked.

Every law is fitted with its own bounds. Where a coefficient then sits at zero and the law does not
follow the path, it is fitted once more with either sign allowed, to show what it would need; such
a fit is listed and not ranked.

Information criteria count what the path determines, not what the law has: the rank of the
Jacobian, and one for each noise that was estimated. Where the residuals of the law that fits best
are correlated from row to row, the log-likelihood of each channel counts by its effective number of
values over the number of its rows (the variance inflation of QAICc: Burnham and Anderson 2002,
sect. 2.5), for all laws alike. That is an approximation, and the report says so.

Under a robust loss the likelihood is that of the noise which the loss stands for, at its likeliest
sigma (see `losses.log_density`); all laws are fitted and ranked under the same. How large
residuals are is said by their bulk, and the path to be explained is seen through a running median:
outliers are no law's fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from curlfit.comparison.result import PLACE, Candidate, Comparison
from curlfit.dynamics.contact import accelerations
from curlfit.dynamics.quadrature import panels

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import Polynomial
from scipy.ndimage import median_filter

from curlfit.errors import UnusableFitError
from curlfit.friction import LAWS, Law, LocalLaw, NetLaw, find_law
from curlfit.inference.conditions import ALL
from curlfit.inference.fit.fit import fit
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import SIGMA_FLOOR
from curlfit.inference.noise.correlated import whitener_of
from curlfit.inference.noise.losses import likeliest_sigma, log_density, robust_sigma
from curlfit.inference.noise.models import Noise
from curlfit.inference.parameters import options_of, require_known
from curlfit.inference.priors import Prior
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone
from curlfit.throws.throw import CHANNELS, Throw, scatter

_FOLLOWS = 0.1  # rms of a residual over what there is to explain, up to which a law follows a path
_MEDIAN = 5  # rows of a running median that takes out single outliers
_NOISE = 1.5  # rms of a residual over the noise of the data, up to which it does in any case
_UNCLEAR = 3.0  # the same, up to which correlated noise may explain it
_DEGREE = 5  # of a polynomial in time from which noise is told


def plan(laws: Sequence[str | type[Law]] | None, load: str) -> list[tuple[type[Law], str]]:
    """Laws and loads to be fitted; `load` may be "both".

    Where no law is named, all of curlfit's own but those that approximate another. A law without
    a ring has no load and comes once. Raises `InputError` for an unknown name.
    """
    wanted = laws or [law for law in LAWS.values() if law.shipped() and not law.approximates]
    chosen = [find_law(law) if isinstance(law, str) else law for law in wanted]
    loads = ("uniform", "consistent") if load == "both" else (load,)
    return [
        (law, one)
        for law in dict.fromkeys(chosen)
        for one in (loads[:1] if issubclass(law, NetLaw) else loads)
    ]


def compare(
    throw: Throw,
    laws: Sequence[str | type[Law]] | None = None,
    *,
    load: str = "uniform",
    stone: Stone | None = None,
    until: float | None = None,
    fix: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    unbounded: bool = False,
    free: Sequence[str] = (),
    priors: Mapping[str, str | Prior] | None = None,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    noise: str = "white",
    progress: Callable[[str, int, int], None] | None = None,
) -> Comparison:
    """Fit each law to a throw and rank them by BIC.

    Parameters
    ----------
    throw, stone, until, loss, noise : as in `fit`; noise is estimated for each law anew.
    laws : names or classes; where not given, curlfit's own but those that approximate another.
    load : "uniform", "consistent" or "both".
    fix, bounds, free, priors, start : as in `fit`, for those of the laws that have such a
        parameter.
    unbounded : let the coefficients of all laws be negative, and rank them all the same.
    progress : called with what is being fitted, how many are done, and of how many.

    Raises
    ------
    InputError : an unknown law, load, loss or noise; a name that no law has; or a throw that cannot
        be fitted by any.
    """
    todo = plan(laws, load)
    options: dict[str, Mapping[str, Any]] = {
        "fix": fix or {}, "bounds": bounds or {}, "start": start or {},
        "free": dict.fromkeys(free, True), "priors": priors or {},
    }  # fmt: skip
    require_known([law for law, _ in todo], options)
    found: list[tuple[Candidate, FitResult | None]] = []
    for done, (law, one_load) in enumerate(todo):
        if progress is not None:
            progress(law.name, done, len(todo))
        choices: dict[str, Any] = {
            "load": one_load, "stone": stone, "until": until, "unbounded": unbounded,
            "loss": loss, "noise": noise, "systematics": {ALL: 0.0}, **options_of(law, options),
        }  # fmt: skip
        candidate, result = _candidate(throw, law, choices, signs_free=False)
        found.append((candidate, result))
        at_zero = result is not None and any(
            item.verdict == "at bound" and item.lower == 0 and item.value < 1e-6 * item.typical
            for item in result.coefficients.values()
        )
        if at_zero and not candidate.follows and not unbounded:
            again = _candidate(throw, law, choices | {"unbounded": True}, signs_free=True)
            if again[0].negative:
                found.append(again)
    if progress is not None:
        progress("", len(todo), len(todo))
    return _ranked(found)


def _noise_parameters(noise: Noise) -> int:
    """Parameters of a noise model beside sigma: each memory of "ar1", the one size of "gp"."""
    return len(noise.memory) + bool(noise.sizes)


def _candidate(
    throw: Throw, law: type[Law], choices: dict[str, Any], *, signs_free: bool
) -> tuple[Candidate, FitResult | None]:
    load = "-" if issubclass(law, NetLaw) else choices["load"]
    blank = Candidate(
        law=law.name, load=load, isotropic=_opposes_sliding(law), signs_free=signs_free, status=""
    )
    try:
        result = fit(throw, law, **choices)
    except UnusableFitError as error:
        return replace(blank, status=str(error)), None
    coefficients = result.coefficients
    signed = {item.name for item in law.coefficients() if item.signed}
    explained, follows = _followed(result)
    return (
        replace(
            blank,
            status=result.status,
            converged=result.converged,
            coefficients={
                name: {
                    "value": item.value,
                    "stderr": item.stderr,
                    "verdict": item.verdict,
                    "unit": item.unit,
                }
                for name, item in coefficients.items()
            },
            combinations=tuple(
                {"expression": item.expression, "value": item.value, "stderr": item.stderr}
                for item in result.combinations
            ),
            n_parameters=result.rank + len(result.sigma) + _noise_parameters(result.noise),
            rms=result.rms,
            bulk=None if result.loss == "linear" else _sizes(result, _residuals(result)),
            curl_explained=explained,
            follows=follows,
            log_likelihood=sum(_log_likelihood(result).values()),
            sides=_sides(law, choices["load"], result),
            negative=_needed_negative(result, signed),
            at_bound=_with_verdict(result, "at bound"),
            not_identifiable=_with_verdict(result, "not identifiable"),
            warnings=result.warnings,
            fitted={name: result.fitted[name].tolist() for name in PLACE},
        ),
        result,
    )


def _needed_negative(result: FitResult, signed: set[str]) -> tuple[str, ...]:
    """Coefficients below zero at that point of the optimum, which may be a ridge, which has least
    of them below."""
    from scipy.optimize import linprog

    names = [name for name in result.coefficients if name not in signed]
    value = np.array([result.parameters[name].value for name in names])
    typical = np.array([result.parameters[name].typical for name in names])
    ridge = np.array([[row.get(name, 0.0) for row in result.null_directions] for name in names])
    if ridge.size:
        # least sum of s >= 0 with s >= -(value + ridge step)/typical
        p, d = ridge.shape
        found = linprog(
            np.concatenate([np.zeros(d), np.ones(p)]),
            A_ub=np.hstack([-ridge / typical[:, None], -np.eye(p)]),
            b_ub=value / typical,
            bounds=[(None, None)] * d + [(0, None)] * p,
        )
        value = value + ridge @ found.x[:d]
    return tuple(name for name, low in zip(names, value < -1e-6 * typical, strict=True) if low)


def _with_verdict(result: FitResult, verdict: str) -> tuple[str, ...]:
    return tuple(name for name, item in result.coefficients.items() if item.verdict == verdict)


def _opposes_sliding(law: type[Law]) -> bool:
    """Whether friction is opposite to sliding round the ring, whatever the coefficients."""
    if not issubclass(law, LocalLaw):
        return False
    # With coefficients that are all different, which excludes special cases of the law.
    general = law.from_vector(
        [item.default + 0.1 * (j + 1) * item.typical for j, item in enumerate(law.coefficients())]
    )
    zero, one = jnp.zeros(()), jnp.ones(())
    for points, _ in panels(general, one, 0.1 * one, one, zero):
        xi, eta = general.traction(points)
        if not np.allclose(xi * points.e_eta, eta * points.e_xi, rtol=0, atol=1e-9):
            return False
    return True


def _residuals(result: FitResult) -> dict[str, Floats]:
    """Measured - fitted by channel, where measured."""
    found = {name: result.observed[name] - result.fitted[name] for name in result.rms}
    return {name: values[np.isfinite(values)] for name, values in found.items()}


def _sizes(result: FitResult, residuals: dict[str, Floats]) -> dict[str, float]:
    """rms, or the same of the bulk where the loss is robust."""
    size = _rms if result.loss == "linear" else robust_sigma
    return {name: size(values) for name, values in residuals.items()}


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _log_likelihood(result: FitResult) -> dict[str, float]:
    """At the fit, by channel, of noise as the loss or the noise model has it; an estimated sigma is
    at its most likely value."""
    if result.noise.kind != "white":
        return _log_likelihood_of_correlated(result)
    found = {}
    for name, residual in _residuals(result).items():
        given = result.observed.get(f"sigma_{name}")
        sigma: Floats | float = (
            likeliest_sigma(residual, result.loss)
            if given is None
            else given[np.isfinite(result.observed[name])]
        )
        found[name] = float((log_density(residual / sigma, result.loss) - np.log(sigma)).sum())
    return found


def _log_likelihood_of_correlated(result: FitResult) -> dict[str, float]:
    """The same of Gaussian noise that is correlated as the fit has it."""
    t = result.observed["t"]
    weight, residual = np.zeros((2, len(CHANNELS), len(t)))
    for row, name in enumerate(CHANNELS):
        if name in result.rms:
            there = np.isfinite(result.observed[name])
            sigma = result.observed.get(f"sigma_{name}")
            weight[row, there] = 1 / (result.sigma[name] if sigma is None else sigma[there])
            off = result.observed[name] - result.fitted[name]
            residual[row] = np.where(there, off, 0.0) * weight[row]
    whitener = whitener_of(result.noise, t - t[0], weight)
    assert whitener is not None
    white = np.asarray(whitener.whiten(jnp.asarray(residual)))
    determinant = whitener.log_determinant()
    found = {}
    for row, name in enumerate(CHANNELS):
        if name in result.rms:
            there = weight[row] > 0
            scale = likeliest_sigma(white[row, there], "linear") if name in result.sigma else 1.0
            density = log_density(white[row, there] / scale, "linear")
            found[name] = float((density + np.log(weight[row, there] / scale)).sum())
            found[name] += float(determinant[row])
    return found


def _effective(result: FitResult) -> dict[str, float]:
    """Effective number of values of the channels whose residuals are correlated from row to row.

    n (1 - r)/(1 + r) (Bayley and Hammersley 1946). A fit of p parameters to n rows makes the
    correlation r of neighbours smaller by (2 r + p (1 + r))/n (Marriott and Pope 1954, for a mean).
    """
    found, p = {}, result.rank / len(result.rms)
    for name, residual in _residuals(result).items():
        item, n = result.independence.get(name), len(residual)
        if item is not None and item.doubtful and result.rms[name] > 10 * SIGMA_FLOOR:
            r = (item.lag1 + p / n) / (1 - (2 + p) / n)
            found[name] = max(n * (1 - r) / (1 + r), 1.0)
    return found


def _with_criteria(
    candidate: Candidate, result: FitResult, effective: Mapping[str, float]
) -> Candidate:
    """AICc (Hurvich and Tsai 1989) and BIC (Schwarz 1978) by the effective number of values."""
    k, n = candidate.n_parameters or 0, result.n_observations
    values = {name: len(residual) for name, residual in _residuals(result).items()}
    counted = {name: effective.get(name, float(values[name])) for name in values}
    twice = 2 * sum(
        part * counted[name] / values[name] for name, part in _log_likelihood(result).items()
    )
    return replace(
        candidate,
        aicc=2 * k - twice + 2 * k * (k + 1) / max(n - k - 1, 1),
        bic=k * float(np.log(sum(counted.values()))) - twice,
    )


def _followed(result: FitResult) -> tuple[float | None, bool | None]:
    """Share of the curl explained, and whether the law follows the path."""
    t = result.observed["t"]
    x, y, phi = (result.observed[name] for name in PLACE)
    place = np.isfinite(x) & np.isfinite(y)
    given = np.stack([_seen(values[place], result.loss) for values in (x, y)], 1)
    along, across, curl = _bend(*given.T)
    off = np.stack([(x - result.fitted["x"])[place], (y - result.fitted["y"])[place]], 1)
    residuals = {"across": off @ across, "along": off @ along}
    raw = np.stack([x[place], y[place]], 1)
    noise = {
        name: _noise(t[place], raw @ axis, result.loss)
        for name, axis in (("across", across), ("along", along))
    }
    wanted = {"across": curl, "along": _uneven(t[place], given @ along)}
    turned = np.isfinite(phi)
    if turned.sum() > 3:
        residuals["phi"] = (phi - result.fitted["phi"])[turned]
        noise["phi"] = _noise(t[turned], phi[turned], result.loss)
        wanted["phi"] = _uneven(t[turned], _seen(phi[turned], result.loss))
    size = _sizes(result, residuals)
    correlated = result.noise.kind == "ar1" or any(
        item.doubtful for item in result.independence.values()
    )
    answers = []
    for name in residuals:
        answer: bool | None = size[name] <= max(_FOLLOWS * wanted[name], _NOISE * noise[name])
        if not answer and correlated and size[name] <= _UNCLEAR * noise[name]:
            answer = None
        answers.append(answer)
    follows = False if False in answers else None if None in answers else True
    if curl <= 3 * noise["across"]:
        return None, follows
    missed = max(size["across"] ** 2 - noise["across"] ** 2, 0.0)
    return float(1 - missed / (curl**2 - noise["across"] ** 2)), follows


def _seen(values: Floats, loss: str) -> Floats:
    """What there is to explain of a series: without its outliers, where the loss is robust."""
    return values if loss == "linear" else median_filter(values, _MEDIAN, mode="nearest")


def _noise(t: Floats, values: Floats, loss: str) -> float:
    """Standard deviation of the noise on a smooth series: of its scatter from row to row, or about
    a polynomial in time where that is larger, which correlated noise makes it."""
    by_row = float(scatter(values))
    if len(values) <= 3 * _DEGREE:
        return by_row
    fitted = Polynomial.fit(t, _seen(values, loss), _DEGREE)
    size = _rms if loss == "linear" else robust_sigma
    free = 1 - (_DEGREE + 1) / len(values)
    return max(by_row, size(values - fitted(t)) / math.sqrt(free))


def _bend(x: Floats, y: Floats) -> tuple[Floats, Floats, float]:
    """Unit vectors along and across (to the right of) the path, and its rms departure sideways."""
    points = np.stack([x, y], 1)
    along = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][0]
    along = along if along @ (points[-1] - points[0]) > 0 else -along
    across = np.array([along[1], -along[0]])
    return along, across, float((points @ across).std())


def _uneven(t: Floats, values: Floats) -> float:
    """rms departure from even motion."""
    return float(np.std(values - np.polyval(np.polyfit(t, values, 1), t)))


def _sides(law: type[Law], load: str, result: FitResult) -> tuple[str, ...]:
    """Sides to which the law can curl a counter-clockwise stone that it slows, within bounds."""
    items = result.coefficients.values()
    steps = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])
    ranges = [
        np.unique(np.clip(steps * item.typical, item.lower, item.upper))
        if item.verdict != "fixed"
        else np.array([item.value])
        for item in items
    ]
    grid = np.array(list(product(*ranges)))
    if len(grid) > 500:
        grid = grid[np.random.default_rng(0).choice(len(grid), 500, replace=False)]
    v = float(np.median(result.fitted["speed"]))
    omega = float(np.median(np.abs(result.fitted["omega"])))
    xi, eta, _ = _over_coefficients(law, load, grid, result.stone, v, omega)
    sideways = np.where(eta < 0, xi / np.where(eta < 0, -eta, 1.0), 0.0)
    found = [("left", (sideways < -1e-9).any()), ("right", (sideways > 1e-9).any())]
    return tuple(side for side, possible in found if possible)


def _over_coefficients(
    law: type[Law], load: str, grid: Floats, stone: Stone, v: float, omega: float
) -> tuple[Floats, ...]:
    def one(coefficients: Any) -> Any:
        # half a radian after release, where a law that depends on the angle still does
        return accelerations(law.from_vector(coefficients), stone, load, v, omega, 0.5)  # type: ignore[arg-type]

    return tuple(np.asarray(item) for item in jax.jit(jax.vmap(one))(grid))


def _ranked(found: list[tuple[Candidate, FitResult | None]]) -> Comparison:
    fits = [result for _, result in found if result is not None]
    if not fits:
        raise UnusableFitError("; ".join(item.status for item, _ in found))

    def order(pair: tuple[Candidate, FitResult | None]) -> tuple[bool, bool, bool, float]:
        item = pair[0]
        # Differences below a tenth mean nothing: the order of the request is kept.
        return item.bic is None, item.signs_free, not item.converged, round(item.bic or 0.0, 1)

    # The count of values is that of the law that fits best, among those that may be ranked.
    usable = [pair for pair in found if pair[0].converged and not pair[0].signs_free] or found
    best = max(usable, key=lambda pair: pair[0].log_likelihood or -math.inf)[1] or fits[0]
    effective = _effective(best)
    found = [
        (item if result is None else _with_criteria(item, result, effective), result)
        for item, result in found
    ]
    found = sorted(found, key=order)
    ranked = [item for item, _ in found if _counts(item)] or [found[0][0]]
    least = {name: min(getattr(item, name) for item in ranked) for name in ("aicc", "bic")}
    candidates, rank = [], 0
    for item, _ in found:
        if item.bic is not None and item.aicc is not None:
            item = replace(
                item,
                delta_aicc=item.aicc - least["aicc"],
                delta_bic=item.bic - least["bic"],
            )
        if _counts(item):
            rank += 1
            item = replace(item, rank=rank)
        candidates.append(item)
    first = fits[0]
    x, y = first.observed["x"], first.observed["y"]
    place = np.isfinite(x) & np.isfinite(y)
    points = np.stack([_seen(values[place], first.loss) for values in (x, y)], 1)
    along, across, curl = _bend(*points.T)
    bend = np.polyfit(points @ along, points @ across, 2)[0]
    noise = _noise(
        first.observed["t"][place], np.stack([x[place], y[place]], 1) @ across, first.loss
    )
    return Comparison(
        data=first.data,
        stone=first.stone,
        curl=curl,
        side=None if curl <= 3 * noise else ("right" if bend > 0 else "left"),
        candidates=tuple(candidates),
        observed={name: first.observed[name].tolist() for name in ("t", *PLACE)},
        fits=tuple(result for _, result in found),
        loss=first.loss,
        noise=first.noise.kind,
        effective=effective,
    )


def _counts(item: Candidate) -> bool:
    """Whether a candidate is ranked."""
    return item.bic is not None and item.converged and not item.signs_free
