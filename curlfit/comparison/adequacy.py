"""Whether a law follows the path, how much of its curl it explains, and what a law can do.

The size of residuals is their rms; under a robust loss it is the scale of their bulk, and the path
to be explained is filtered by a running median, since no law has to explain outliers.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from curlfit.comparison.result import PLACE
from curlfit.dynamics.law_structure import law_in_general, sample_points
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.result import FitResult
from curlfit.inference.initial_values import POINTS, accelerations_along
from curlfit.inference.model import Model
from curlfit.inference.noise.losses import robust_sigma
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import in_batches, stacked
from curlfit.throws.throw import scatter

_MOST = 500
"""Largest number of coefficient vectors for which a law is evaluated."""
_FOLLOWS = 0.1  # rms of a residual over what is to be explained, up to which a law follows a path
_MEDIAN = 5  # rows of a running median that removes single outliers
_NOISE = 1.5  # rms of a residual over the noise of the data, up to which it follows in any case
_UNCLEAR = 3.0  # the same, up to which correlated noise may explain the residual
_DEGREE = 5  # of the polynomial in time that separates motion from noise


def adequacy(result: FitResult) -> tuple[float | None, bool | None]:
    """Fraction of the curl explained, and whether the law follows the path."""
    path, loss = _Path.of(result), result.loss
    off = {name: result.observed[name] - result.fitted[name] for name in PLACE}
    aside = np.stack([off["x"], off["y"]], 1)[path.place]
    series = {
        name: (path.t, path.measured @ axis, aside @ axis)
        for name, axis in (("across", path.across), ("along", path.along))
    }
    wanted = {"across": path.curl, "along": _uneven(path.t, path.seen @ path.along)}
    turned = np.isfinite(result.observed["phi"])
    if turned.sum() > 3:
        t, phi = result.observed["t"][turned], result.observed["phi"][turned]
        series["phi"], wanted["phi"] = (t, phi, off["phi"][turned]), _uneven(t, _seen(phi, loss))
    noise = {name: _noise(t, values, loss) for name, (t, values, _) in series.items()}
    size = sizes(result, {name: residual for name, (*_, residual) in series.items()})
    correlated = any(result.noise.memory.values()) or any(
        item.doubtful for item in result.independence.values()
    )
    follows: bool | None = True
    for name in series:
        if not size[name] <= max(_FOLLOWS * wanted[name], _NOISE * noise[name]):
            unclear = correlated and size[name] <= _UNCLEAR * noise[name]
            follows = None if unclear and follows is not False else False
    if path.curl <= 3 * noise["across"]:
        return None, follows
    missed = max(size["across"] ** 2 - noise["across"] ** 2, 0.0)
    return float(1 - missed / (path.curl**2 - noise["across"] ** 2)), follows


def bend(result: FitResult) -> tuple[float, str | None]:
    """rms departure of the path from a straight line, m, and the side to which it bends, if it
    bends by more than its noise."""
    path = _Path.of(result)
    if path.curl <= 3 * _noise(path.t, path.measured @ path.across, result.loss):
        return path.curl, None
    curvature = np.polyfit(path.seen @ path.along, path.seen @ path.across, 2)[0]
    return path.curl, "right" if curvature > 0 else "left"


class _Path(NamedTuple):
    """The rows whose position was measured."""

    t: Floats
    place: Booleans
    """which rows they are"""
    measured: Floats
    seen: Floats
    """the part of it to be explained"""
    along: Floats
    across: Floats
    """unit vectors; across is to the right"""
    curl: float
    """rms lateral departure"""

    @classmethod
    def of(cls, result: FitResult) -> _Path:
        x, y = result.observed["x"], result.observed["y"]
        place = np.isfinite(x) & np.isfinite(y)
        measured = np.stack([x[place], y[place]], 1)
        seen = np.stack([_seen(values, result.loss) for values in measured.T], 1)
        along = np.linalg.svd(seen - seen.mean(0), full_matrices=False)[2][0]
        along = along if along @ (seen[-1] - seen[0]) > 0 else -along
        across = np.array([along[1], -along[0]])
        curl = float((seen @ across).std())
        return cls(result.observed["t"][place], place, measured, seen, along, across, curl)


def _seen(values: Floats, loss: str) -> Floats:
    """The part of a series to be explained: without outliers where the loss is robust."""
    if loss == "linear":
        return values
    from scipy.ndimage import median_filter  # slow to load

    filtered: Floats = median_filter(values, _MEDIAN, mode="nearest")
    return filtered


def _noise(t: Floats, values: Floats, loss: str) -> float:
    """Standard deviation of the noise on a smooth series: that of its scatter from row to row, or
    about a polynomial in time where that is larger, as with correlated noise."""
    by_row = float(scatter(values))
    if len(values) <= 3 * _DEGREE:
        return by_row
    fitted = Polynomial.fit(t, _seen(values, loss), _DEGREE)
    size = _rms if loss == "linear" else robust_sigma
    free = 1 - (_DEGREE + 1) / len(values)
    return max(by_row, size(values - fitted(t)) / math.sqrt(free))


def _uneven(t: Floats, values: Floats) -> float:
    """rms departure from uniform motion."""
    return float(np.std(values - np.polyval(np.polyfit(t, values, 1), t)))


def sizes(result: FitResult, residuals: dict[str, Floats]) -> dict[str, float]:
    """rms of residuals, or the scale of their bulk where the loss is robust."""
    size = _rms if result.loss == "linear" else robust_sigma
    return {name: size(values) for name, values in residuals.items()}


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def opposes_sliding(law: type[Law]) -> bool:
    """Whether friction opposes sliding all around the ring, whatever the coefficients."""
    if not issubclass(law, LocalLaw):
        return False
    general = law_in_general(law)
    for half in (1.0, 0.0):
        points = sample_points(half)
        xi, eta = general.traction(points)
        if not np.allclose(xi * points.e_eta, eta * points.e_xi, rtol=0, atol=1e-9):
            return False
    return True


def sides_of_curl(
    law: type[Law], load: Load, result: FitResult, family: type[LawFamily] | None = None
) -> tuple[str, ...]:
    """Sides to which the law can curl a counter-clockwise stone that it slows, within bounds.

    A law of a family is evaluated by the family's program.
    """
    items = result.coefficients.values()
    steps = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])
    ranges = [
        np.unique(np.clip(steps * item.typical, item.lower, item.upper))
        if item.verdict != "fixed"
        else np.array([item.value])
        for item in items
    ]
    grid = np.array(list(product(*ranges)))
    if len(grid) > _MOST:
        grid = grid[np.random.default_rng(0).choice(len(grid), _MOST, replace=False)]
    v = float(np.median(result.fitted["speed"]))
    omega = float(np.median(np.abs(result.fitted["omega"])))
    # half a radian after release, where a law that depends on the angle still depends on it
    state = np.tile(np.array([v, omega, 0.5, 0.0])[:, None], POINTS)
    model = Model(law, load).within(family)
    stones = stacked([result.stone])

    def accelerations(part: Floats) -> Floats:
        """In this state for each coefficient vector, shape (POINTS, 3)."""
        return accelerations_along(model, part[None], stones, state[None], batch=1)[0].T

    xi, eta = in_batches(accelerations, (grid,), POINTS)[:, :2].T
    sideways = np.where(eta < 0, xi / np.where(eta < 0, -eta, 1.0), 0.0)
    found = [("left", (sideways < -1e-9).any()), ("right", (sideways > 1e-9).any())]
    return tuple(side for side, possible in found if possible)
