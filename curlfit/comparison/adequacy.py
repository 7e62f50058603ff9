"""Whether a law follows the path, how much of its curl it explains, and what
a law can do.

The size of residuals is their rms; under a robust loss it is the scale of their bulk,
and the path to be explained is filtered by a running median, since no law has to
explain outliers.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from curlfit.comparison.result import PLACE
from curlfit.dynamics.law_structure import sample_points
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.curl import law_in_general
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.result import FitResult
from curlfit.inference.initial_values import POINTS, accelerations_along
from curlfit.inference.model import Model
from curlfit.inference.verdict import Verdict
from curlfit.losses import LOSSES, Loss
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import in_batches, stacked
from curlfit.throws.throw import scatter

_MOST = 500
"""Largest number of coefficient vectors for which a law is evaluated."""
# rms of a residual over what is to be explained, up to which a law follows a path
_FOLLOWS = 0.1
_MEDIAN = 5  # rows of a running median that removes single outliers
# rms of a residual over the noise of the data, up to which it follows in any case
_NOISE = 1.5
_UNCLEAR = 3.0  # the same, up to which correlated noise may explain the residual
_DEGREE = 5  # of the polynomial in time that separates motion from noise


class Adequacy(NamedTuple):
    """How well a fit describes a path."""

    explained: float | None
    """fraction of the curl; None where there is none beyond the noise"""
    follows: bool | None
    """None where correlated noise may explain the residuals"""
    curl: float
    """rms departure of the path from a straight line, m"""
    side: str | None
    """to which the path bends, if it bends by more than its noise"""


def adequacy(result: FitResult) -> Adequacy:
    """Whether the law follows the path, and what part of its curl it explains."""
    t, x, y, phi = (result.observed[name] for name in ("t", *PLACE))
    loss = LOSSES[result.loss]
    off = {name: result.observed[name] - result.fitted[name] for name in PLACE}
    place, turned = np.isfinite(x) & np.isfinite(y), np.isfinite(phi)
    measured, missed = (
        np.stack([x, y], 1)[place],
        np.stack([off["x"], off["y"]], 1)[place],
    )
    seen = np.stack([_seen(values, loss) for values in measured.T], 1)
    along = np.linalg.svd(seen - seen.mean(0), full_matrices=False)[2][0]
    along = along if along @ (seen[-1] - seen[0]) > 0 else -along
    across = np.array([along[1], -along[0]])  # to the right
    curl = float((seen @ across).std())
    series = [
        (t[place], measured @ across, missed @ across, curl),
        (t[place], measured @ along, missed @ along, _uneven(t[place], seen @ along)),
    ]
    if turned.sum() > 3:
        uneven = _uneven(t[turned], _seen(phi[turned], loss))
        series.append((t[turned], phi[turned], off["phi"][turned], uneven))
    correlated = bool(result.noise.correlated) or any(
        item.doubtful for item in result.independence.values()
    )
    sizes = [(loss.size(one[2]), _noise(one[0], one[1], loss)) for one in series]
    follows: bool | None = True
    for (size, noise), (*_, wanted) in zip(sizes, series, strict=True):
        if not size <= max(_FOLLOWS * wanted, _NOISE * noise):
            unclear = correlated and size <= _UNCLEAR * noise
            follows = None if unclear and follows is not False else False
    (size, noise), *_ = sizes
    if curl <= 3 * noise:
        return Adequacy(None, follows, curl, None)
    unexplained = max(size**2 - noise**2, 0.0) / (curl**2 - noise**2)
    curvature = np.polyfit(seen @ along, seen @ across, 2)[0]
    side = "right" if curvature > 0 else "left"
    return Adequacy(float(1 - unexplained), follows, curl, side)


def _seen(values: Floats, loss: Loss) -> Floats:
    """The part of a series to be explained: without outliers where the
    loss is robust."""
    if not loss.is_robust:
        return values
    from scipy.ndimage import median_filter  # slow to load

    filtered: Floats = median_filter(values, _MEDIAN, mode="nearest")
    return filtered


def _noise(t: Floats, values: Floats, loss: Loss) -> float:
    """Standard deviation of the noise on a smooth series: that of its scatter from
    row to row, or about a polynomial in time where that is larger, as with
    correlated noise."""
    by_row = float(scatter(values))
    if len(values) <= 3 * _DEGREE:
        return by_row
    fitted = Polynomial.fit(t, _seen(values, loss), _DEGREE)
    free = 1 - (_DEGREE + 1) / len(values)
    return max(by_row, loss.size(values - fitted(t)) / math.sqrt(free))


def _uneven(t: Floats, values: Floats) -> float:
    """rms departure from uniform motion."""
    return float(np.std(values - np.polyval(np.polyfit(t, values, 1), t)))


def opposes_sliding(law: type[Law]) -> bool:
    """Whether friction opposes sliding all around the ring, whatever the
    coefficients."""
    if not issubclass(law, LocalLaw):
        return False
    general = law_in_general(law)
    points = [sample_points(half) for half in (1.0, 0.0)]
    tractions = [(*general.traction(one), one.e_xi, one.e_eta) for one in points]
    return all(
        np.allclose(xi * e_eta, eta * e_xi, rtol=0, atol=1e-9)
        for xi, eta, e_xi, e_eta in tractions
    )


def sides_of_curl(
    law: type[Law], load: Load, result: FitResult, family: type[LawFamily] | None = None
) -> tuple[str, ...]:
    """Sides to which the law can curl a counter-clockwise stone that it slows,
    within bounds.

    A law of a family is evaluated by the family's program.
    """
    steps = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])
    ranges = [
        [item.value]
        if item.verdict == Verdict.FIXED
        else np.unique(np.clip(steps * item.typical, item.lower, item.upper))
        for item in result.coefficients.values()
    ]
    grid = np.array(list(product(*ranges)))
    if len(grid) > _MOST:
        grid = grid[np.random.default_rng(0).choice(len(grid), _MOST, replace=False)]
    v = float(np.median(result.fitted["speed"]))
    omega = float(np.median(np.abs(result.fitted["omega"])))
    # half a radian and a second after release, where laws that depend on these push
    # to their side
    state = np.tile(np.array([v, omega, 0.5, 1.0])[:, None], POINTS)
    model = Model(law, load).within(family)
    stones = stacked([result.stone])

    def accelerations(part: Floats) -> Floats:
        """In this state for each coefficient vector, shape (POINTS, 3)."""
        return accelerations_along(model, part[None], stones, state[None], batch=1)[0].T

    xi, eta = in_batches(accelerations, (grid,), POINTS)[:, :2].T
    sideways = np.where(eta < 0, xi / np.where(eta < 0, -eta, 1.0), 0.0)
    found = [("left", (sideways < -1e-9).any()), ("right", (sideways > 1e-9).any())]
    return tuple(side for side, possible in found if possible)
