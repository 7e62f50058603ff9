"""The motion of a stone from its rows alone, without a model: velocities from straight
lines through blocks of rows, mean friction, curl, rotation, the largest jump in
velocity, and rest."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.numerics.arrays import Floats
from curlfit.stone import GRAVITY
from curlfit.throws.channels import median
from curlfit.throws.throw import Throw, scatter

_JUMP = 0.15  # m/s; largest abrupt change of a velocity, apart from friction
SURE = 6.0
"""Number of standard errors required for a finding."""
FEWEST = 10
"""Smallest number of positions from which a motion is estimated."""
# Jumps of the position (position_jump). Of 4,700 simulated throws with noise of 1 to
# 100 mm, collisions and at most one outlier in ten, two are said to have one, with one
# in five 21 of 1,200; jumps of 2 m are found in all throws of 10 rows or more.
_MOVED = 0.5  # m; the smallest
_BESIDE = 7  # rows on either side
# m, and fraction of outliers, above which jumps are not told from outliers
_NOISY, _OUTLYING = 0.2, 0.15
_BRAKING = 0.3  # m/s^2; three times the deceleration by friction on ice
_BLOCKS = 24
# m/s; at a deceleration of 0.1 m/s^2 the stone then stops within 0.3 s and 5 mm
_REST = 0.03
MIN_POSITIONS = 4
"""Positions needed to determine a speed."""
# rows and time (s) at rest needed to detect rest
_MIN_REST_ROWS, _MIN_REST_TIME = 4, 0.2
_CAMERA_DRIFT = 0.001  # m, in addition to the scatter from row to row
_CONFIDENCE = 3.0  # in standard errors
_TURNED = 2.5  # rad, from the first angle; the stone is then turning freely
_HELD, _ONSET = 0.4, 0.4  # s; shortest time in the hand, longest onset of the spin
_STILL = 0.15  # ratio of the spin in the hand to that after the release
# rows and time (s) from which the final speed is estimated
_END_ROWS, _END_TIME = 6, 1.0


class MeasuredMotion(NamedTuple):
    """Velocities of a throw, from straight lines through blocks of rows.

    Attributes
    ----------
    t, begin, end : middle, first and last time of each block in s, shape (k,).
    speed, error : speed and its standard error in m/s, shape (k,).
    velocity : in m/s, shape (2, k).
    rows : number of rows with both x and y; some may be outliers.
    times, positions : of the others, shape (n,) in s and (2, n) in m.
    noise : standard deviations of x and y from row to row in m, shape (2,).
    length : extent of the path, m. friction, friction_error : mean deceleration over g,
        and its standard error.
    curl, curl_error : deviation at the end from the initial direction in m, positive to
        the left of the motion in right-handed axes, and its standard error. direction :
        unit vector (x, y) of the motion.
    """

    t: Floats
    begin: Floats
    end: Floats
    speed: Floats
    error: Floats
    velocity: Floats
    rows: int
    times: Floats
    positions: Floats
    noise: Floats
    length: float
    friction: float
    friction_error: float
    curl: float
    curl_error: float
    direction: tuple[float, float]

    @property
    def fastest(self) -> float:
        """Highest speed, m/s."""
        return float(self.speed.max())


def path_of(throw: Throw) -> tuple[Floats, Floats]:
    """Times and positions, shape (n,) and (2, n), of the rows that have
    both x and y."""
    complete = np.isfinite(throw.x) & np.isfinite(throw.y)
    return throw.t[complete], np.stack([throw.x, throw.y])[:, complete]


def motion_of(throw: Throw) -> MeasuredMotion | None:
    """The motion of a throw; None if there are too few positions."""
    every, places = path_of(throw)
    if len(every) < FEWEST:
        return None
    noise = scatter(places)
    t, positions = _without_outliers(every, places, noise)
    if len(t) < len(every):
        noise = scatter(positions)
    begin, end, middle, velocity, error = _block_slopes(t, positions, noise)
    speed = np.hypot(*velocity)
    if len(speed) >= 8:  # noise correlated from row to row shows up from block to block
        rough = np.abs(speed[2:] - 2 * speed[1:-1] + speed[:-2])
        error = np.maximum(error, float(median(rough)) / (0.6745 * math.sqrt(6)))
    length = float(np.hypot(*np.ptp(positions, axis=1)))
    friction, (curl, off, direction) = (
        _friction(middle, speed, error),
        _curl(t, positions),
    )
    return MeasuredMotion(
        middle,
        begin,
        end,
        speed,
        error,
        velocity,
        len(every),
        t,
        positions,
        noise,
        length,
        *friction,
        curl,
        off,
        direction,
    )


def _without_outliers(
    t: Floats, positions: Floats, noise: Floats
) -> tuple[Floats, Floats]:
    """Rows as near the running median of five as noise and friction explain."""
    five = np.stack([positions[:, k : len(t) - 4 + k] for k in range(5)], axis=-1)
    five.sort(axis=-1)
    bend = 0.5 * _BRAKING * (2 * float(median(np.diff(t)))) ** 2
    limit = 0.02 + bend + 6 * noise[:, None]
    near = np.ones(len(t), bool)
    near[2:-2] = (np.abs(positions[:, 2:-2] - five[..., 2]) < limit).all(0)
    return (t, positions) if near.all() else (t[near], positions[:, near])


def _block_slopes(t: Floats, values: Floats, noise: Floats) -> tuple[Floats, ...]:
    """First, last and mean time, slopes, and the standard error of their
    magnitude, by block; `noise` of the values is the least that counts."""
    blocks = max(min(4, len(t) // 2), min(_BLOCKS, len(t) // 5))
    first = np.arange(blocks) * len(t) // blocks
    last = np.append(first[1:], len(t)) - 1
    count = last - first + 1
    owner = np.repeat(np.arange(blocks), count)
    middle = np.add.reduceat(t, first) / count
    at = t - middle[owner]
    spread = np.add.reduceat(at**2, first)
    slopes = np.add.reduceat(values * at, first, axis=1) / spread
    mean = np.add.reduceat(values, first, axis=1) / count
    residual = values - mean[:, owner] - slopes[:, owner] * at
    own = np.add.reduceat((residual**2).sum(0), first) / np.maximum(count - 2, 1)
    variance = np.maximum(own, float((noise**2).sum()))
    return t[first], t[last], middle, slopes, np.sqrt(variance / spread)


def _friction(t: Floats, speed: Floats, error: Floats) -> tuple[float, float]:
    """Mean deceleration over g while the stone moves, and its standard error."""
    moving = speed > np.maximum(_REST, 0.03 * speed.max())
    if speed.max() < 2 * _REST:  # perhaps in other units
        moving = speed > 0.2 * speed.max()
    if moving.sum() < 3:
        return math.nan, math.inf
    at = t[moving] - t[moving].mean()
    spread = float(at @ at)
    slope = float(speed[moving] @ at) / spread
    rest = speed[moving] - speed[moving].mean() - slope * at
    noise = max(
        float(median(error[moving])),
        float(np.sqrt((rest @ rest) / max(len(at) - 2, 1))),
    )
    return -slope / GRAVITY, noise / math.sqrt(spread) / GRAVITY


def _curl(t: Floats, positions: Floats) -> tuple[float, float, tuple[float, float]]:
    """Deviation from the initial direction, its standard error, and the direction
    of the motion.

    The initial direction is the tangent, at the first rows, to a parabola fitted to the
    first half of the path; the end is a mean over a fortieth of the rows, since the
    curl grows fastest there.
    """
    few = max(2, len(t) // 10)
    begin, end = positions[:, :few].mean(1), positions[:, -few:].mean(1)
    length = float(np.hypot(*(end - begin)))
    if length == 0:
        return 0.0, math.inf, (math.nan, math.nan)
    along_x, along_y = (end - begin) / length
    x, y = positions - begin[:, None]
    along, left = (along_x * x + along_y * y) / length, along_x * y - along_y * x
    near = along < 0.5
    if near.sum() < FEWEST // 2:
        near[:] = True
    powers = np.stack([np.ones_like(along), along, along**2])[:, near]
    inverse = np.linalg.pinv(powers @ powers.T)
    found = inverse @ (powers @ left[near])
    residual = left[near] - found @ powers
    variance = float(residual @ residual) / max(int(near.sum()) - 3, 1)
    last = max(2, len(t) // 40)
    first, end_along = float(along[:last].mean()), float(along[-last:].mean())
    tangent = np.array([1.0, end_along, first * (2 * end_along - first)])
    return (
        float(left[-last:].mean() - tangent @ found),
        math.sqrt(variance * (float(tangent @ inverse @ tangent) + 1 / last)),
        (float(along_x), float(along_y)),
    )


def turning(throw: Throw) -> tuple[float, float]:
    """Angle turned in rad and mean rate in rad/s over all rows, in motion or at rest;
    NaN if there are too few angles and spins."""
    for name in ("phi", "omega"):
        values = getattr(throw, name)
        seen = np.isfinite(values)
        if seen.sum() < 4:
            continue
        t, values = throw.t[seen], values[seen]
        if name == "phi":
            few = max(1, min(len(t) // 10, 5))
            turned = float(median(values[-few:]) - median(values[:few]))
        else:
            turned = float(np.trapezoid(values, t))
        return turned, turned / float(t[-1] - t[0])
    return math.nan, math.nan


def release(throw: Throw) -> float | None:
    """Time of the first row after the release by a hand that kept the stone from
    turning; None if the stone turns from the beginning, or too few angles are measured.

    The spin is 0, then grows linearly in an onset of up to `_ONSET`, and is a linear
    function of time after that. Of the releases that least squares allow, within two
    standard errors, the last one is taken: what is left out too much is hardly missed.
    """
    seen = np.isfinite(throw.phi)
    if seen.sum() < 4 * FEWEST:
        return None
    t, phi = throw.t[seen], throw.phi[seen]
    turned = np.abs(phi - median(phi[:5])) > _TURNED
    n = int(np.argmax(turned)) + 1
    held = max(int(np.searchsorted(t, t[0] + _HELD)), FEWEST)
    t, phi = t[:n], phi[:n]
    if not turned.any() or held > n - 2 * FEWEST:
        return None
    spin = _slope(t[-held:], phi[-held:])
    if abs(_slope(t[:held], phi[:held])) > _STILL * abs(spin):
        return None
    squares = np.array([_misfit(t, phi, start, 0.0) for start in t[:-FEWEST]])
    best = int(squares.argmin())
    if best < held or squares[0] < 2 * squares[best]:
        return None
    if abs(_slope(t[:best], phi[:best])) > _STILL * abs(spin):
        return None
    ends = np.array(
        [
            (start + onset, _misfit(t, phi, start, onset))
            for onset in np.linspace(0, _ONSET, 9)
            for start in t[np.abs(t + onset / 2 - t[best]) < _ONSET]
        ]
    )
    least = ends[:, 1].min()
    end = ends[ends[:, 1] <= least * (1 + 4 / n) + 1e-12, 0].max()
    return float(throw.t[throw.t > end + 1e-9][0])


def _misfit(t: Floats, phi: Floats, start: float, onset: float) -> float:
    """Residual sum of squares of an angle whose spin sets in from a start on."""
    after = np.maximum(t - start, 0.0)
    turning = np.where(after < onset, after**2 / (2 * onset or 1.0), after - onset / 2)
    basis = np.stack([np.ones_like(t), turning, np.maximum(after - onset, 0.0) ** 2], 1)
    off = phi - basis @ np.linalg.lstsq(basis, phi, rcond=None)[0]
    return float(off @ off)


def _slope(t: Floats, values: Floats) -> float:
    at = t - t.mean()
    return float(values @ at / (at @ at))


def velocity_jump(throw: Throw, motion: MeasuredMotion) -> tuple[float, float] | None:
    """Time in s and size in m/s of the largest jump in velocity; None if there is none.

    At a jump, the slopes of straight lines through some rows before and after it differ
    by more than noise and friction explain. If no velocity changes that much from block
    to block, none does from row to row.
    """
    velocity = motion.velocity
    if not np.hypot(*(velocity[:, 2:] - velocity[:, :-2])).max(initial=0.0) > _JUMP:
        return None
    t, positions = path_of(throw)
    if len(t) < 20:
        return None
    noise = float(np.hypot(*scatter(positions)))
    dt = float(median(np.diff(t)))
    # as many rows m as make the error of a slope about 0.03 m/s: its variance is 12
    # s^2/(m^3 dt^2)
    rows = int(
        np.clip(math.ceil((12 * (noise / (0.03 * dt)) ** 2) ** (1 / 3)), 5, len(t) // 3)
    )
    every = np.vstack([t, positions])
    every = np.lib.stride_tricks.sliding_window_view(every, rows, axis=1)
    mean = every.mean(-1)
    at, *parts = every - mean[..., None]
    spread = (at**2).sum(1)
    slope = np.stack([(part * at).sum(1) / spread for part in parts])
    change = slope[:, rows:] - slope[:, :-rows]
    elapsed = mean[0, rows:] - mean[0, :-rows]
    error = noise * np.sqrt(1 / spread[rows:] + 1 / spread[:-rows])
    size = np.hypot(*change) - SURE * error - _BRAKING * elapsed
    # An outlier tilts a line, which then does not fit its own rows.
    residual = np.abs(np.stack(parts) - slope[..., None] * at).max((0, 2))
    straight = (
        residual < 0.02 + 6 * noise + 0.5 * _BRAKING * (at[:, -1] - at[:, 0]) ** 2 / 4
    )
    size[~(straight[rows:] & straight[:-rows])] = -math.inf
    # During a pause anything may have happened.
    gap = t[rows : rows + len(size)] - t[rows - 1 : rows - 1 + len(size)]
    size[gap > 5 * dt] = -math.inf
    best = int(np.argmax(size)) if len(size) else 0
    if not len(size) or not size[best] > _JUMP:
        return None
    return float(t[best + rows]), float(np.hypot(*change[:, best]))


def position_jump(motion: MeasuredMotion) -> tuple[float, float, float] | None:
    """Times in s before and after the largest jump of the position, and its size in m;
    None if there is none.

    From one row to the next a stone moves with a velocity between those before and
    after, whatever hits it; what is beyond that is a jump, if most of some rows before
    and after it lie on straight lines.
    """
    t = motion.times
    positions = motion.positions
    noise = float(np.hypot(*motion.noise))
    if noise > _NOISY or len(t) < (1 - _OUTLYING) * motion.rows:
        return None
    last = np.arange(2, len(t) - 3)  # row before a jump
    jumps = _beyond_motion(t, positions, last)
    size = np.hypot(*jumps)
    braked = 0.5 * _BRAKING * (t[last + 1] - t[last]) ** 2
    sure = []
    for jump in np.flatnonzero(size - SURE * 2 * noise - braked > _MOVED):
        after = last[jump] + 1
        until, since = np.s_[:after], np.s_[after:]
        if _is_straight(
            -t[until][::-1], positions[:, until][:, ::-1], noise
        ) and _is_straight(t[since], positions[:, since], noise):
            sure.append(jump)
    if not sure:
        return None
    largest = sure[int(np.argmax(size[sure]))]
    there_and_back = float(np.hypot(*jumps[:, sure].sum(1))) < 0.5 * size[largest]
    if there_and_back:
        return None
    row = last[largest]
    return float(t[row]), float(t[row + 1]), float(size[largest])


def _beyond_motion(t: Floats, positions: Floats, last: NDArray[np.int64]) -> Floats:
    """What of the way from a row to the next is not that of a velocity between those
    of three rows before and three rows after, shape (2, len(last))."""
    dt = t[last + 1] - t[last]
    way = positions[:, last + 1] - positions[:, last]
    before, after = (
        (positions[:, first + 2] - positions[:, first]) / (t[first + 2] - t[first])
        for first in (last - 2, last + 1)
    )
    change = after - before
    # the velocity between them, as a part of the change, that comes nearest
    along = ((way - dt * before) * change).sum(0)
    part = np.clip(along / np.maximum((change**2).sum(0) * dt, 1e-12), 0, 1)
    return way - dt * (before + part * change)


def _is_straight(t: Floats, positions: Floats, noise: float) -> bool:
    """Whether the second row and most of the first few lie on the line through the
    first and the third."""
    since = t[:_BESIDE] - t[0]
    moved = positions[:, :_BESIDE] - positions[:, :1]
    off = np.hypot(*(moved - moved[:, 2:3] * since / since[2]))
    near = off < 0.02 + 6 * noise + 0.5 * _BRAKING * since**2
    return bool(near[1] and near.mean() > 0.5)


def first_row_at_rest(t: Floats, positions: Floats) -> int | None:
    """First of those final rows whose regression line excludes all but a
    negligible speed.

    A slowly moving stone may stay within the noise of its last position, but the line
    through those rows then has a slope, or a standard error that allows for one. Of all
    numbers of final rows, the one with the smallest upper limit on the speed is taken.
    """
    late = t - t[-1]
    position = positions - positions[:, -1:]
    # Sums over the rows from each one to the last.
    n, st, stt, sp, stp, spp = (
        np.cumsum(part[..., ::-1], -1)[..., ::-1]
        for part in (
            np.ones_like(t),
            late,
            late**2,
            position,
            late * position,
            position**2,
        )
    )
    enough = (n >= _MIN_REST_ROWS) & (late < -_MIN_REST_TIME)
    if not enough.any():
        return None
    n, st, stt, sp, stp, spp = (
        part[..., enough] for part in (n, st, stt, sp, stp, spp)
    )
    spread = stt - st**2 / n
    slope = (stp - st * sp / n) / spread
    variance = np.maximum(spp - sp**2 / n - slope**2 * spread, 0.0) / (n - 2)
    noise = np.maximum(variance, np.reshape(scatter(positions), (2, 1)) ** 2)
    error = np.sqrt(noise / spread + (_CAMERA_DRIFT / late[enough]) ** 2)
    compatible = (np.abs(slope) < _CONFIDENCE * error).all(0)
    limit = np.where(
        compatible, np.hypot(*(np.abs(slope) + _CONFIDENCE * error)), np.inf
    )
    best = int(np.argmin(limit))
    return int(np.flatnonzero(enough)[best]) if limit[best] < _REST else None


def final_speed(t: Floats, positions: Floats) -> tuple[float, float]:
    """Speed at the last row and its standard error, from a parabola fitted to
    the last rows.

    A difference from the speed given by a cubic that noise does not explain adds
    to the error.
    """
    last = max(min(len(t), _END_ROWS), int((t > t[-1] - _END_TIME).sum()))
    late, positions = t[-last:] - t[-1], positions[:, -last:]
    noise = scatter(positions)
    (velocity, variance), (other, its_variance) = (
        _final_slope(late, positions, min(degree, last - 2), noise) for degree in (2, 3)
    )
    bias = np.maximum(
        (other - velocity) ** 2 - np.maximum(its_variance - variance, 0.0), 0.0
    )
    speed = float(np.hypot(*velocity))
    along = velocity**2 / speed**2 if speed > 0 else np.full(2, 0.5)
    return speed, float(
        np.sqrt(along @ (variance + bias) + (_CAMERA_DRIFT / late[0]) ** 2)
    )


def _final_slope(
    late: Floats, positions: Floats, degree: int, noise: Floats
) -> tuple[Floats, Floats]:
    """Slopes of polynomials at 0 and their variances, for noise of at least
    the given size."""
    powers = np.vander(late, degree + 1, increasing=True)
    found, *_ = np.linalg.lstsq(powers, positions.T, rcond=None)
    residual = ((positions.T - powers @ found) ** 2).sum(0) / (len(late) - degree - 1)
    return found[1], np.linalg.inv(powers.T @ powers)[1, 1] * np.maximum(
        residual, noise**2
    )
