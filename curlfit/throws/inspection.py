"""Whether and when a stone comes to rest, from its rows alone."""

from __future__ import annotations

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.throws.channels import scatter

MIN_POSITIONS = 4
"""Positions needed to determine a speed."""
_MIN_REST_ROWS, _MIN_REST_TIME = 4, 0.2  # rows and time (s) at rest needed to detect rest
# m/s; at a deceleration of 0.1 m/s^2 the stone then stops within 0.3 s and 5 mm
_MAX_REST_SPEED = 0.03
_CAMERA_DRIFT = 0.001  # m, in addition to the scatter from row to row
_CONFIDENCE = 3.0  # in standard errors
_END_ROWS, _END_TIME = 6, 1.0  # rows and time (s) from which the final speed is estimated


def first_row_at_rest(t: Floats, positions: Floats) -> int | None:
    """First of those final rows whose regression line excludes all but a negligible speed.

    A slowly moving stone may stay within the noise of its last position, but the line through those
    rows then has a slope, or a standard error that allows for one. Of all numbers of final rows,
    the one with the smallest upper limit on the speed is taken.
    """
    late = t - t[-1]
    position = positions - positions[:, -1:]
    # Sums over the rows from each one to the last.
    n, st, stt, sp, stp, spp = (
        np.cumsum(part[..., ::-1], -1)[..., ::-1]
        for part in (np.ones_like(t), late, late**2, position, late * position, position**2)
    )
    enough = (n >= _MIN_REST_ROWS) & (late < -_MIN_REST_TIME)
    if not enough.any():
        return None
    n, st, stt, sp, stp, spp = (part[..., enough] for part in (n, st, stt, sp, stp, spp))
    spread = stt - st**2 / n
    slope = (stp - st * sp / n) / spread
    variance = np.maximum(spp - sp**2 / n - slope**2 * spread, 0.0) / (n - 2)
    noise = np.maximum(variance, np.reshape(scatter(positions), (2, 1)) ** 2)
    error = np.sqrt(noise / spread + (_CAMERA_DRIFT / late[enough]) ** 2)
    compatible = (np.abs(slope) < _CONFIDENCE * error).all(0)
    limit = np.where(compatible, np.hypot(*(np.abs(slope) + _CONFIDENCE * error)), np.inf)
    best = int(np.argmin(limit))
    return int(np.flatnonzero(enough)[best]) if limit[best] < _MAX_REST_SPEED else None


def final_speed(t: Floats, positions: Floats) -> tuple[float, float]:
    """Speed at the last row and its standard error, from a parabola fitted to the last rows.

    A difference from the speed given by a cubic that noise does not explain adds to the error.
    """
    last = max(min(len(t), _END_ROWS), int((t > t[-1] - _END_TIME).sum()))
    late, positions = t[-last:] - t[-1], positions[:, -last:]
    noise = scatter(positions)
    (velocity, variance), (other, its_variance) = (
        _final_slope(late, positions, min(degree, last - 2), noise) for degree in (2, 3)
    )
    bias = np.maximum((other - velocity) ** 2 - np.maximum(its_variance - variance, 0.0), 0.0)
    speed = float(np.hypot(*velocity))
    along = velocity**2 / speed**2 if speed > 0 else np.full(2, 0.5)
    return speed, float(np.sqrt(along @ (variance + bias) + (_CAMERA_DRIFT / late[0]) ** 2))


def _final_slope(
    late: Floats, positions: Floats, degree: int, noise: Floats
) -> tuple[Floats, Floats]:
    """Slopes of polynomials at 0 and their variances, for noise of at least the given size."""
    powers = np.vander(late, degree + 1, increasing=True)
    found, *_ = np.linalg.lstsq(powers, positions.T, rcond=None)
    residual = ((positions.T - powers @ found) ** 2).sum(0) / (len(late) - degree - 1)
    return found[1], np.linalg.inv(powers.T @ powers)[1, 1] * np.maximum(residual, noise**2)
