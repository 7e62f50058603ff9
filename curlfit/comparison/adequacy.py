"""Whether a law follows the path, how much of its curl it explains, and what
a law can do.

The size of residuals is their rms; under a robust loss it is the scale of their bulk,
and the path to be explained is filtered by a running median, since no law has to
explain outliers.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial import Polynomial

from curlfit.comparison.result import PLACE
from curlfit.dynamics.law_structure import sample_points
from curlfit.friction import Law, Load, LocalLaw
from curlfit.friction.curl import law_in_general
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.model import Model
from curlfit.inference.solve.initial_values import POINTS, accelerations_along
from curlfit.losses import LOSSES, Loss
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import in_batches, stacked
from curlfit.throws.channels import scatter

_MOST = 500  # coefficient vectors for which a law is evaluated
_FOLLOWS = 0.1
"""rms of a residual over what is to be explained, up to which a law follows a path."""
_NOISE = 1.5
"""rms of a residual over the noise, up to which a law follows in any case."""
_UNCLEAR = 3.0
"""rms of a residual over the noise, up to which correlated noise may explain it."""
_SEEN = 3.0
"""rms departure from a straight line over the noise, up to which no curl is seen."""
_ROUNDING = 1e-9
"""Friction across the motion over that along it, up to which there is none."""
_MEDIAN = 5  # rows of a running median that removes single outliers
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


class _Misfit(NamedTuple):
    """What a fit misses of a component of the path, m or rad."""

    size: float
    """of the residuals"""
    noise: float
    """standard deviation of that of the data"""
    deviation: float
    """rms departure of the path from uniform straight motion, to be explained"""

    @classmethod
    def of(
        cls, t: Floats, measured: Floats, residual: Floats, deviation: float, loss: Loss
    ) -> Self:
        """From a component of the path at its times."""
        return cls(loss.size(residual), _noise(t, measured, loss), deviation)

    def follows(self, *, correlated: bool) -> bool | None:
        """Whether the fit follows this component; None where noise that is
        correlated may explain the residuals."""
        if self.size <= max(_FOLLOWS * self.deviation, _NOISE * self.noise):
            return True
        if correlated and self.size <= _UNCLEAR * self.noise:
            return None
        return False


def adequacy(result: FitResult) -> Adequacy:
    """Whether the law follows the path, and what part of its curl it explains."""
    loss = LOSSES[result.loss]
    observed = result.observed
    residual = {name: observed[name] - result.fitted[name] for name in PLACE}
    located = np.isfinite(observed["x"]) & np.isfinite(observed["y"])
    t = observed["t"][located]
    positions = np.stack([observed["x"], observed["y"]], 1)[located]
    missed = np.stack([residual["x"], residual["y"]], 1)[located]
    bulk = np.stack([_without_outliers(values, loss) for values in positions.T], 1)

    # the straight line next to the path: its first principal axis, along the motion
    along = np.linalg.svd(bulk - bulk.mean(0), full_matrices=False)[2][0]
    if along @ (bulk[-1] - bulk[0]) <= 0:
        along = -along
    across = np.array([along[1], -along[0]])  # to the right
    curl = float((bulk @ across).std())
    uneven = _unevenness(t, bulk @ along)
    sideways = _Misfit.of(t, positions @ across, missed @ across, curl, loss)
    lengthwise = _Misfit.of(t, positions @ along, missed @ along, uneven, loss)
    misfits = [sideways, lengthwise]
    turned = np.isfinite(observed["phi"])
    if turned.sum() > 3:
        phi = observed["phi"][turned]
        t_of_phi = observed["t"][turned]
        uneven = _unevenness(t_of_phi, _without_outliers(phi, loss))
        angular = _Misfit.of(t_of_phi, phi, residual["phi"][turned], uneven, loss)
        misfits.append(angular)

    correlated = bool(result.noise.correlated) or any(
        independence.doubtful for independence in result.independence.values()
    )
    verdicts = [misfit.follows(correlated=correlated) for misfit in misfits]
    follows: bool | None = True
    if False in verdicts:
        follows = False
    elif None in verdicts:
        follows = None
    noise = sideways.noise
    if curl <= _SEEN * noise:
        return Adequacy(None, follows, curl, None)
    unexplained = max(sideways.size**2 - noise**2, 0.0) / (curl**2 - noise**2)
    curvature = np.polyfit(bulk @ along, bulk @ across, 2)[0]
    side = "right" if curvature > 0 else "left"
    return Adequacy(float(1 - unexplained), follows, curl, side)


def _without_outliers(values: Floats, loss: Loss) -> Floats:
    """The part of a series to be explained: all of it, or under a robust loss what a
    running median leaves."""
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
    fitted = Polynomial.fit(t, _without_outliers(values, loss), _DEGREE)
    free = 1 - (_DEGREE + 1) / len(values)
    return max(by_row, loss.size(values - fitted(t)) / math.sqrt(free))


def _unevenness(t: Floats, values: Floats) -> float:
    """rms departure from uniform motion."""
    return float(np.std(values - np.polyval(np.polyfit(t, values, 1), t)))


def opposes_sliding(law: type[Law]) -> bool:
    """Whether friction opposes sliding all around the ring, whatever the
    coefficients."""
    if not issubclass(law, LocalLaw):
        return False
    general = law_in_general(law)
    for half in (1.0, 0.0):
        point = sample_points(half)
        xi, eta = general.traction(point)
        if not np.allclose(xi * point.e_eta, eta * point.e_xi, rtol=0, atol=_ROUNDING):
            return False
    return True


def sides_of_curl(
    law: type[Law], load: Load, result: FitResult, family: type[LawFamily] | None = None
) -> tuple[str, ...]:
    """Sides to which the law can curl a counter-clockwise stone that it slows,
    within bounds.

    A law of a family is evaluated by the family's program.
    """
    multiples = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])  # of the typical size
    ranges = []
    for coefficient in result.coefficients.values():
        values = np.array([coefficient.value])
        if coefficient.verdict != Verdict.FIXED:
            steps = multiples * coefficient.typical
            values = np.unique(np.clip(steps, coefficient.lower, coefficient.upper))
        ranges.append(values)
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

    def accelerations(coefficients: Floats) -> Floats:
        """In this state for each of POINTS coefficient vectors, shape (POINTS, 3)."""
        # the points along the path of one throw serve as as many vectors
        return accelerations_along(
            model, coefficients[None], stones, state[None], batch=1
        )[0].T

    xi, eta = in_batches(accelerations, (grid,), POINTS)[:, :2].T
    slows = eta < 0
    sideways = np.where(slows, xi / np.where(slows, -eta, 1.0), 0.0)
    sides = []
    if (sideways < -_ROUNDING).any():
        sides.append("left")
    if (sideways > _ROUNDING).any():
        sides.append("right")
    return tuple(sides)
