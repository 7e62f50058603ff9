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
from curlfit.throws.channels import median, scatter, slope
from curlfit.throws.throw import Throw

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
# Above this noise (m) or this fraction of outliers, a jump and an outlier look alike.
_NOISY = 0.2
_OUTLYING = 0.15
_BRAKING = 0.3  # m/s^2; three times the deceleration by friction on ice
_STRAIGHT = 0.02  # m; how far a row may be off a straight line without any noise
_BLOCKS = 24
# m/s; at a deceleration of 0.1 m/s^2 the stone then stops within 0.3 s and 5 mm
_REST = 0.03
MIN_POSITIONS = 4
"""Positions needed to determine a speed."""
MIN_RATES = 4
"""Angles, spins or speeds needed to compare a rate with another."""
_MIN_REST_ROWS = 4  # needed to detect rest
_MIN_REST_TIME = 0.2  # s; likewise
_CAMERA_DRIFT = 0.001  # m, in addition to the scatter from row to row
_CONFIDENCE = 3.0  # in standard errors
_TURNED = 2.5  # rad, from the first angle; the stone is then turning freely
_HELD = 0.4  # s; shortest time in the hand
_ONSET = 0.4  # s; longest onset of the spin
_STILL = 0.15  # ratio of the spin in the hand to that after the release
# The final speed is estimated from the rows of this time (s), and at least so many.
_END_ROWS = 6
_END_TIME = 1.0
# Of a normal distribution the median of |v| is so many standard deviations.
_MEDIAN_OF_NORMAL = 0.6745


class MeasuredMotion(NamedTuple):
    """Velocities of a throw, from straight lines through blocks of rows.

    Attributes
    ----------
    t, begin, end : middle, first and last time of each block in s, shape (k,).
    speed, error : speed and its standard error in m/s, shape (k,).
    velocity : in m/s, shape (2, k).
    rows : number of rows with both x and y; some may be outliers.
    times, positions : of the rows that are no outliers, shape (n,) in s and (2, n) in
        m.
    noise : standard deviations of x and y from row to row in m, shape (2,).
    length : extent of the path, m.
    friction, friction_error : mean deceleration over g, and its standard error.
    curl, curl_error : deviation at the end from the initial direction in m, positive to
        the left of the motion in right-handed axes, and its standard error.
    direction : unit vector (x, y) of the motion.
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
    complete_times, complete_positions = path_of(throw)
    rows = len(complete_times)
    if rows < FEWEST:
        return None
    noise = scatter(complete_positions)
    t, positions = _without_outliers(complete_times, complete_positions, noise)
    if len(t) < rows:
        noise = scatter(positions)
    begin, end, middle, velocity, error = _block_slopes(t, positions, noise)
    speed = np.hypot(*velocity)
    if len(speed) >= 8:  # noise correlated from row to row shows up from block to block
        rough = np.abs(speed[2:] - 2 * speed[1:-1] + speed[:-2])
        # The variance of a second difference is 1 + 4 + 1 times that of a speed.
        from_blocks = float(median(rough)) / (_MEDIAN_OF_NORMAL * math.sqrt(6))
        error = np.maximum(error, from_blocks)
    friction, friction_error = _friction(middle, speed, error)
    curl, curl_error, direction = _curl(t, positions)
    return MeasuredMotion(
        t=middle,
        begin=begin,
        end=end,
        speed=speed,
        error=error,
        velocity=velocity,
        rows=rows,
        times=t,
        positions=positions,
        noise=noise,
        length=float(np.hypot(*np.ptp(positions, axis=1))),
        friction=friction,
        friction_error=friction_error,
        curl=curl,
        curl_error=curl_error,
        direction=direction,
    )


def _without_outliers(
    t: Floats, positions: Floats, noise: Floats
) -> tuple[Floats, Floats]:
    """Rows as near the running median of five as noise and friction explain."""
    five = np.stack([positions[:, k : len(t) - 4 + k] for k in range(5)], axis=-1)
    five.sort(axis=-1)
    bend = 0.5 * _BRAKING * (2 * float(median(np.diff(t)))) ** 2
    limit = _STRAIGHT + bend + 6 * noise[:, None]
    near = np.ones(len(t), bool)
    near[2:-2] = (np.abs(positions[:, 2:-2] - five[..., 2]) < limit).all(0)
    if near.all():
        return t, positions
    return t[near], positions[:, near]


def _block_slopes(
    t: Floats, values: Floats, noise: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """First, last and mean time of each block of rows, the slopes of the regression
    lines through its values, and the standard error of the magnitude of these slopes.

    Parameters
    ----------
    values : shape (2, n). noise : of both, the least that counts, shape (2,).
    """
    blocks = max(min(4, len(t) // 2), min(_BLOCKS, len(t) // 5))
    first = np.arange(blocks) * len(t) // blocks
    last = np.append(first[1:], len(t)) - 1
    count = last - first + 1
    block_of = np.repeat(np.arange(blocks), count)
    middle = np.add.reduceat(t, first) / count
    centred = t - middle[block_of]
    spread = np.add.reduceat(centred**2, first)
    slopes = np.add.reduceat(values * centred, first, axis=1) / spread
    mean = np.add.reduceat(values, first, axis=1) / count
    residual = values - mean[:, block_of] - slopes[:, block_of] * centred
    squares = np.add.reduceat((residual**2).sum(0), first)
    variance = squares / np.maximum(count - 2, 1)
    variance = np.maximum(variance, float((noise**2).sum()))
    return t[first], t[last], middle, slopes, np.sqrt(variance / spread)


def _friction(t: Floats, speed: Floats, error: Floats) -> tuple[float, float]:
    """Mean deceleration over g while the stone moves, and its standard error."""
    # Blocks at rest, or nearly so, say nothing of the deceleration.
    fastest = speed.max()
    moving = speed > np.maximum(_REST, 0.03 * fastest)
    if fastest < 2 * _REST:  # perhaps in other units
        moving = speed > 0.2 * fastest
    if moving.sum() < 3:
        return math.nan, math.inf
    # The slope of the regression line of the speed over time.
    t = t[moving]
    speed = speed[moving]
    centred = t - t.mean()
    spread = float(centred @ centred)
    acceleration = float(speed @ centred) / spread
    residual = speed - speed.mean() - acceleration * centred
    variance = (residual @ residual) / max(len(t) - 2, 1)
    noise = max(float(median(error[moving])), float(np.sqrt(variance)))
    return -acceleration / GRAVITY, noise / math.sqrt(spread) / GRAVITY


def _curl(t: Floats, positions: Floats) -> tuple[float, float, tuple[float, float]]:
    """Deviation from the initial direction, its standard error, and the direction
    of the motion.

    The initial direction is the tangent, at the first rows, to a parabola fitted to the
    first half of the path; the end is a mean over a fortieth of the rows, since the
    curl grows fastest there.
    """
    few = max(2, len(t) // 10)
    begin = positions[:, :few].mean(1)
    way = positions[:, -few:].mean(1) - begin
    length = float(np.hypot(*way))
    if length == 0:
        return 0.0, math.inf, (math.nan, math.nan)
    direction_x, direction_y = way / length
    x, y = positions - begin[:, None]
    along = (direction_x * x + direction_y * y) / length
    left = direction_x * y - direction_y * x
    first_half = along < 0.5
    if first_half.sum() < FEWEST // 2:
        first_half[:] = True
    powers = np.stack([np.ones_like(along), along, along**2])[:, first_half]
    inverse = np.linalg.pinv(powers @ powers.T)
    parabola = inverse @ (powers @ left[first_half])
    residual = left[first_half] - parabola @ powers
    degrees_of_freedom = max(int(first_half.sum()) - 3, 1)
    variance = float(residual @ residual) / degrees_of_freedom
    last = max(2, len(t) // 40)
    first_along = float(along[:last].mean())
    end_along = float(along[-last:].mean())
    # The tangent to the parabola at `first_along`, at `end_along`: its value is linear
    # in the coefficients of the parabola, with these factors.
    tangent = np.array([1.0, end_along, first_along * (2 * end_along - first_along)])
    curl = float(left[-last:].mean() - tangent @ parabola)
    error = math.sqrt(variance * (float(tangent @ inverse @ tangent) + 1 / last))
    return curl, error, (float(direction_x), float(direction_y))


def turning(throw: Throw) -> tuple[float, float]:
    """Angle turned in rad and mean rate in rad/s over all rows, in motion or at rest,
    from the angles or else from the spins; NaN if there are too few of both."""
    has_angle = np.isfinite(throw.phi)
    has_spin = np.isfinite(throw.omega)
    if has_angle.sum() >= MIN_RATES:
        t = throw.t[has_angle]
        phi = throw.phi[has_angle]
        few = max(1, min(len(t) // 10, 5))
        turned = float(median(phi[-few:]) - median(phi[:few]))
    elif has_spin.sum() >= MIN_RATES:
        t = throw.t[has_spin]
        turned = float(np.trapezoid(throw.omega[has_spin], t))
    else:
        return math.nan, math.nan
    return turned, turned / float(t[-1] - t[0])


def release(throw: Throw) -> float | None:
    """Time of the first row after the release by a hand that kept the stone from
    turning; None if the stone turns from the beginning, or too few angles are measured.

    The spin is 0, then grows linearly in an onset of up to `_ONSET`, and is a linear
    function of time after that. Of the releases that least squares allow, within two
    standard errors, the last one is taken: what is left out too much is hardly missed.
    """
    measured = np.isfinite(throw.phi)
    if measured.sum() < 4 * FEWEST:
        return None
    t = throw.t[measured]
    phi = throw.phi[measured]
    turns_freely = np.abs(phi - median(phi[:5])) > _TURNED
    if not turns_freely.any():
        return None
    n = int(np.argmax(turns_freely)) + 1
    fewest_held = max(int(np.searchsorted(t, t[0] + _HELD)), FEWEST)
    if fewest_held > n - 2 * FEWEST:
        return None
    t = t[:n]
    phi = phi[:n]
    free_spin = slope(t[-fewest_held:], phi[-fewest_held:])

    def turns_in_the_hand(rows: int) -> bool:
        return abs(slope(t[:rows], phi[:rows])) > _STILL * abs(free_spin)

    if turns_in_the_hand(fewest_held):
        return None
    # First the row of a sudden onset. A spin from the first row on must fit at least
    # twice as badly.
    squares = np.array([_misfit(t, phi, start, 0.0) for start in t[:-FEWEST]])
    best = int(squares.argmin())
    if best < fewest_held or squares[0] < 2 * squares[best]:
        return None
    if turns_in_the_hand(best):
        return None
    # Then the ends of all onsets about it.
    ends = []
    misfits = []
    for onset in np.linspace(0, _ONSET, 9):
        for start in t[np.abs(t + onset / 2 - t[best]) < _ONSET]:
            ends.append(start + onset)
            misfits.append(_misfit(t, phi, start, onset))
    # Two standard errors are a chi squared of 4, of n rows with a variance of least/n.
    allowed = min(misfits) * (1 + 4 / n) + 1e-12
    end = max(
        end for end, misfit in zip(ends, misfits, strict=True) if misfit <= allowed
    )
    return float(throw.t[throw.t > end + 1e-9][0])


def _misfit(t: Floats, phi: Floats, start: float, onset: float) -> float:
    """Residual sum of squares of an angle whose spin sets in from a start on.

    Least squares of a constant, of the angle turned at a spin that grows linearly to 1
    within the onset, and of the square of the time since the onset, by which the spin
    decreases.
    """
    after = np.maximum(t - start, 0.0)
    in_onset = after**2 / (2 * onset or 1.0)
    turned = np.where(after < onset, in_onset, after - onset / 2)
    braked = np.maximum(after - onset, 0.0) ** 2
    basis = np.stack([np.ones_like(t), turned, braked], 1)
    residual = phi - basis @ np.linalg.lstsq(basis, phi, rcond=None)[0]
    return float(residual @ residual)


def velocity_jump(throw: Throw, motion: MeasuredMotion) -> tuple[float, float] | None:
    """Time in s and size in m/s of the largest jump in velocity; None if there is none.

    At a jump, the slopes of straight lines through some rows before and after it differ
    by more than noise and friction explain. If no velocity changes that much from block
    to block, none does from row to row.
    """
    over_two_blocks = motion.velocity[:, 2:] - motion.velocity[:, :-2]
    if not np.hypot(*over_two_blocks).max(initial=0.0) > _JUMP:
        return None
    t, positions = path_of(throw)
    if len(t) < 20:
        return None
    noise = float(np.hypot(*scatter(positions)))
    dt = float(median(np.diff(t)))
    # As many rows m as make the error of a slope about 0.03 m/s: its variance is
    # 12 noise^2/(m^3 dt^2).
    enough = math.ceil((12 * (noise / (0.03 * dt)) ** 2) ** (1 / 3))
    rows = int(np.clip(enough, 5, len(t) // 3))
    # Lines through all runs of so many rows; those before and after the row `rows + k`
    # begin at the rows k and `rows + k`.
    series = np.vstack([t, positions])
    windows = np.lib.stride_tricks.sliding_window_view(series, rows, axis=1)
    mean = windows.mean(-1)
    centred = windows - mean[..., None]
    time = centred[0]
    offsets = centred[1:]  # of x and y
    spread = (time**2).sum(1)
    velocity = (offsets * time).sum(2) / spread
    change = velocity[:, rows:] - velocity[:, :-rows]
    elapsed = mean[0, rows:] - mean[0, :-rows]
    error = noise * np.sqrt(1 / spread[rows:] + 1 / spread[:-rows])
    excess = np.hypot(*change) - SURE * error - _BRAKING * elapsed
    # An outlier tilts a line, which then does not fit its own rows.
    residual = np.abs(offsets - velocity[..., None] * time).max((0, 2))
    duration = time[:, -1] - time[:, 0]
    straight = residual < _STRAIGHT + 6 * noise + 0.5 * _BRAKING * duration**2 / 4
    excess[~(straight[rows:] & straight[:-rows])] = -math.inf
    # During a pause anything may have happened.
    jumps = len(excess)
    gap = t[rows : rows + jumps] - t[rows - 1 : rows - 1 + jumps]
    excess[gap > 5 * dt] = -math.inf
    if not jumps:
        return None
    largest = int(np.argmax(excess))
    if not excess[largest] > _JUMP:
        return None
    return float(t[largest + rows]), float(np.hypot(*change[:, largest]))


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
        # The rows before a jump lie on a line as seen from it, back in time.
        backward = _is_straight(-t[:after][::-1], positions[:, :after][:, ::-1], noise)
        if backward and _is_straight(t[after:], positions[:, after:], noise):
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

    def velocity(first: NDArray[np.int64]) -> Floats:
        """Over three rows, shape (2, len(last))."""
        way = positions[:, first + 2] - positions[:, first]
        return way / (t[first + 2] - t[first])

    dt = t[last + 1] - t[last]
    way = positions[:, last + 1] - positions[:, last]
    before = velocity(last - 2)
    change = velocity(last + 1) - before
    # The velocity between both that comes nearest, as a part of their change.
    along = ((way - dt * before) * change).sum(0)
    part = np.clip(along / np.maximum((change**2).sum(0) * dt, 1e-12), 0, 1)
    return way - dt * (before + part * change)


def _is_straight(t: Floats, positions: Floats, noise: float) -> bool:
    """Whether the second row and most of the first few lie on the line through the
    first and the third."""
    since = t[:_BESIDE] - t[0]
    moved = positions[:, :_BESIDE] - positions[:, :1]
    off = np.hypot(*(moved - moved[:, 2:3] * since / since[2]))
    near = off < _STRAIGHT + 6 * noise + 0.5 * _BRAKING * since**2
    return bool(near[1] and near.mean() > 0.5)


def first_row_at_rest(t: Floats, positions: Floats) -> int | None:
    """First of those final rows whose regression line excludes all but a
    negligible speed.

    A slowly moving stone may stay within the noise of its last position, but the line
    through those rows then has a slope, or a standard error that allows for one. Of all
    numbers of final rows, the one with the smallest upper limit on the speed is taken.
    """
    late = t - t[-1]
    to_last = positions - positions[:, -1:]

    def to_the_end(values: Floats) -> Floats:
        """Sums over the rows from each one to the last."""
        return np.cumsum(values[..., ::-1], -1)[..., ::-1]

    rows = to_the_end(np.ones_like(t))
    enough = (rows >= _MIN_REST_ROWS) & (late < -_MIN_REST_TIME)
    if not enough.any():
        return None
    # The regression lines, by the row with which each begins.
    n = rows[enough]
    sum_t = to_the_end(late)[enough]
    sum_tt = to_the_end(late**2)[enough]
    sum_p = to_the_end(to_last)[:, enough]
    sum_tp = to_the_end(late * to_last)[:, enough]
    sum_pp = to_the_end(to_last**2)[:, enough]
    spread = sum_tt - sum_t**2 / n
    velocity = (sum_tp - sum_t * sum_p / n) / spread
    squares = np.maximum(sum_pp - sum_p**2 / n - velocity**2 * spread, 0.0)
    variance = squares / (n - 2)
    variance = np.maximum(variance, np.reshape(scatter(positions), (2, 1)) ** 2)
    error = np.sqrt(variance / spread + (_CAMERA_DRIFT / late[enough]) ** 2)
    compatible = (np.abs(velocity) < _CONFIDENCE * error).all(0)
    highest_speed = np.hypot(*(np.abs(velocity) + _CONFIDENCE * error))
    limit = np.where(compatible, highest_speed, np.inf)
    best = int(np.argmin(limit))
    return int(np.flatnonzero(enough)[best]) if limit[best] < _REST else None


def final_speed(t: Floats, positions: Floats) -> tuple[float, float]:
    """Speed at the last row and its standard error, from a parabola fitted to
    the last rows.

    A difference from the speed given by a cubic that noise does not explain adds
    to the error.
    """
    last = max(min(len(t), _END_ROWS), int((t > t[-1] - _END_TIME).sum()))
    late = t[-last:] - t[-1]
    positions = positions[:, -last:]
    noise = scatter(positions)
    velocity, variance = _final_slope(late, positions, min(2, last - 2), noise)
    of_cubic, variance_of_cubic = _final_slope(late, positions, min(3, last - 2), noise)
    by_noise = np.maximum(variance_of_cubic - variance, 0.0)
    bias = np.maximum((of_cubic - velocity) ** 2 - by_noise, 0.0)
    speed = float(np.hypot(*velocity))
    along = velocity**2 / speed**2 if speed > 0 else np.full(2, 0.5)
    square = along @ (variance + bias) + (_CAMERA_DRIFT / late[0]) ** 2
    return speed, float(np.sqrt(square))


def _final_slope(
    late: Floats, positions: Floats, degree: int, noise: Floats
) -> tuple[Floats, Floats]:
    """Slopes of polynomials at 0 and their variances, for noise of at least
    the given size."""
    powers = np.vander(late, degree + 1, increasing=True)
    coefficients, *_ = np.linalg.lstsq(powers, positions.T, rcond=None)
    squares = ((positions.T - powers @ coefficients) ** 2).sum(0)
    variance = np.maximum(squares / (len(late) - degree - 1), noise**2)
    inverse = np.linalg.inv(powers.T @ powers)
    return coefficients[1], inverse[1, 1] * variance
