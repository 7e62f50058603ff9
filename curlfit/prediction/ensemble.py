"""Ensembles of trajectories to rest: one throw under many parameter vectors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from curlfit.dynamics.trajectory import simulate
from curlfit.environment import Environment
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL, environment_of
from curlfit.inference.system import System
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import BATCH, in_batches
from curlfit.numerics.compiled import compiled
from curlfit.prediction.request import ThrowStart
from curlfit.stone import Stone

VARIED = {"v0": 0.01, "omega0": 0.1}
"""Changes of the initial state for the sensitivity of the resting position, in m/s and rad/s."""
_GRID_TIMES = 301
_GRID_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # s between times
_MAX_FILLED = 0.8  # fraction of the time grid within which throws come to rest
_MAX_LATE = 0.01  # fraction of the throws that may take longer
_MIN_SPIN = 1e-3  # rad/s of the fitted throw, below which no ratio of spins is formed
_ON_LINE = 1e-3  # m; a stone that rests on a line has not passed it
_AT_START = 0.5  # m; a throw that starts less than this past a line starts on it


@dataclass(frozen=True, eq=False)
class TrajectoryEnsemble:
    """Trajectories to rest on a common grid of times.

    Attributes
    ----------
    t : the grid in s since the start, shape (times,).
    state : x, y, phi, vx, vy, omega, shape (paths, 6, times). good : whether a throw comes to rest.
    rest : time of rest in s, shape (paths,).
    """

    t: Floats
    state: Floats
    good: Booleans
    rest: Floats

    @classmethod
    def of(cls, t: Floats, state: Floats) -> TrajectoryEnsemble:
        """The ensemble of these states."""
        speed = np.hypot(state[:, 3], state[:, 4])
        good = np.isfinite(state).all((1, 2)) & (speed[:, -1] <= 0) & (state[:, 5, -1] == 0)
        return cls(t, state, good, _rest_times(t, state, speed))

    @cached_property
    def clock(self) -> Floats:
        """`t` up to `rest`, then constant, shape (paths, times)."""
        return np.minimum(self.t, self.rest[:, None])

    def __len__(self) -> int:
        return len(self.state)

    def select(self, which: Any) -> TrajectoryEnsemble:
        """The selected trajectories."""
        return replace(self, state=self.state[which], good=self.good[which], rest=self.rest[which])

    def mean_speeds(self) -> Floats:
        """Mean speed in each interval of the grid, shape (paths, times - 1)."""
        speed = np.hypot(self.state[:, 3], self.state[:, 4])
        found: Floats = (speed[:, 1:] + speed[:, :-1]) / 2
        return found

    def with_accelerations(self, missing: Floats) -> TrajectoryEnsemble:
        """The same throws under additional accelerations, to rest.

        The friction is taken as a function of speed: a stone passes through the same speeds at
        different times. A deceleration D becomes D - a down to D/2, and D/(2 sqrt(4 a/D - 1)) below
        that, since friction does not accelerate. The last time of the grid represents rest.

        Parameters
        ----------
        missing : accelerations to the right of the velocity, along it, and angular, at the speed
            of each interval, shape (paths, 3, times - 1).
        """
        across, along, angular = missing.swapaxes(0, 1)
        x, y, phi, vx, vy, omega = self.state.swapaxes(0, 1)
        speed, mean_speed = np.hypot(vx, vy), self.mean_speeds()
        step = np.diff(self.clock)
        loss = -np.diff(speed)
        with np.errstate(all="ignore"):
            ratio = np.where(loss > 0, along * step / loss, 0.0)
            turn_rate = np.where(mean_speed > 0, across / mean_speed, 0.0)
        low, high = np.minimum(ratio, 0.5), np.maximum(ratio, 0.5)
        new_step = step * np.where(ratio < 0.5, 1 / (1 - low), 2 * np.sqrt(4 * high - 1))
        heading = np.unwrap(_forward_filled(np.arctan2(vx, vy), speed > 0))
        extension = new_step / np.where(step > 0, step, 1.0) - 1
        new_heading = heading + _running_sum(extension * np.diff(heading) + turn_rate * new_step)
        spin = omega + _running_sum(extension * np.diff(omega) + angular * new_step)

        def mean(values: Floats) -> Floats:
            return (values[:, 1:] + values[:, :-1]) / 2

        def displacement(component: Any) -> Floats:
            """Change of a coordinate relative to this path, summed over the intervals."""
            new, old = component(mean(new_heading)) * new_step, component(mean(heading)) * step
            return _running_sum(mean_speed * (new - old))

        positions = np.stack([
            x + displacement(np.sin), y + displacement(np.cos),
            phi + _running_sum(mean(spin) * new_step - mean(omega) * step),
        ], 1)  # fmt: skip
        rates = np.stack([speed * np.sin(new_heading), speed * np.cos(new_heading), spin], 1)
        clocks = _running_sum(new_step)
        state = np.full_like(self.state, np.nan)
        for index in np.flatnonzero(np.isfinite(self.state).all((1, 2))):
            clock, position, rate = clocks[index], positions[index], rates[index]
            distinct = np.flatnonzero(np.diff(clock, prepend=-1.0) > 0)
            times = np.minimum(np.append(self.t[:-1], np.inf), clock[-1])
            moving = times < clock[-1] if speed[index, -1] <= 0 else True
            own, place, slope = clock[distinct], position[:, distinct], rate[:, distinct]
            k = np.clip(np.searchsorted(own, times, side="right"), 1, len(own) - 1)
            step = own[k] - own[k - 1]
            state[index, :3] = _cubic(
                place[:, k - 1], place[:, k], slope[:, k - 1] * step, slope[:, k] * step,
                (times - own[k - 1]) / step,
            )  # fmt: skip
            state[index, 3:] = [np.interp(times, clock, values) * moving for values in rate]
        return replace(self, state=state, rest=clocks[:, -1])

    def interpolate(self, k: NDArray[np.int64], part: Floats) -> tuple[Floats, Floats]:
        """x, y, phi and their rates at a fraction of interval k (from k - 1 to k), by cubics."""
        rows = np.arange(len(self))
        step = (self.clock[rows, k] - self.clock[rows, k - 1])[:, None]
        a, b = self.state[rows, :3, k - 1], self.state[rows, :3, k]
        slope_a, slope_b = self.state[rows, 3:, k - 1] * step, self.state[rows, 3:, k] * step
        s = part[:, None]
        value = _cubic(a, b, slope_a, slope_b, s)
        rate = (
            6 * s * (1 - s) * (b - a) + slope_a * (1 - s) * (1 - 3 * s) + slope_b * s * (3 * s - 2)
        ) / np.where(step > 0, step, 1.0)
        return value, rate

    def crossing(self, level: float) -> tuple[Floats, Floats]:
        """Time and speed at which each throw first crosses a given y; NaN where it does not.

        A throw that starts within `_AT_START` beyond it is taken to start on it.
        """
        y = self.state[:, 1]
        beyond = y >= level
        beyond &= (y[:, -1] > level + _ON_LINE)[:, None]
        k = np.argmax(beyond, 1)
        low, high = np.zeros(len(self)), np.ones(len(self))
        crossing = beyond.any(1) & (k > 0)
        inside = np.maximum(k, 1)
        for _ in range(50):
            middle = (low + high) / 2
            short = self.interpolate(inside, middle)[0][:, 1] < level
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        rows = np.arange(len(self))
        before, after = self.clock[rows, inside - 1], self.clock[rows, inside]
        time = before + (after - before) * high
        speed = np.hypot(*self.interpolate(inside, high)[1][:, :2].T)
        since = y[:, 0] - level
        on_it = (since >= 0) & (since < _AT_START)
        first = np.hypot(self.state[:, 3, 0], self.state[:, 4, 0])
        ahead = np.where(self.state[:, 4, 0] > 0, self.state[:, 4, 0], np.nan)
        time = np.where(on_it, -since / ahead, np.where(crossing, time, np.nan))
        return time, np.where(on_it, first, np.where(crossing, speed, np.nan))

    def positions_at(self, times: Floats) -> Floats:
        """x, y, phi at times since the start, shape (paths, 3, times)."""
        found = np.empty((len(self), 3, len(times)))
        for index, time in enumerate(times):
            k = int(np.clip(np.searchsorted(self.t, time), 1, len(self.t) - 1))
            before, after = self.clock[:, k - 1], self.clock[:, k]
            step = np.where(after > before, after - before, 1.0)
            part = np.clip((np.minimum(time, self.rest) - before) / step, 0.0, 1.0)
            found[:, :, index] = self.interpolate(np.full(len(self), k), part)[0]
        return found


class ThrowFamily:
    """The throw to be predicted, under many parameter vectors.

    Attributes
    ----------
    spin_ratio : ratio of the spin to that of the fitted throw.
    """

    def __init__(self, fit: FitResult, start: ThrowStart, new: bool) -> None:
        self.fit, self.start, self.new = fit, start, new
        self._first = len(fit.parameters) - len(START)
        fitted_spin = fit.parameters["omega0"].value
        known = new and abs(fitted_spin) > _MIN_SPIN
        self.spin_ratio = start.values["omega0"] / fitted_spin if known else 1.0
        self._grid: Floats | None = None

    def with_start(self, values: Floats) -> Floats:
        """Parameter vectors with the initial state of this throw."""
        own = values.copy()
        if self.new:
            own[:, self._first :] = [self.start.values[item.name] for item in START]
        else:
            own[:, self._first : self._first + 2] += self.start.shift
        return own

    def probes(self) -> dict[str, Floats]:
        """The best estimate varied in speed, in spin, and to both ends of each null direction."""
        best, names = self.fit.values, list(self.fit.parameters)
        found = {}
        for name, by in VARIED.items():
            found[name] = self.with_start(best[None])
            found[name][0, names.index(name)] += by
        parameters = self.fit.parameter_set
        for index, direction in enumerate(self.fit.null_directions):
            along = np.array([direction.get(name, 0.0) for name in names])
            with np.errstate(all="ignore"):
                ends = np.stack([parameters.lower - best, parameters.upper - best]) / along
            ends = np.sort(ends[:, (along != 0) & np.isfinite(ends).all(0)], axis=0)
            limits = [max(ends[0], default=0.0), min(ends[1], default=0.0)]
            found[f"null {index}"] = self.with_start(best + np.outer(limits, along))
        return found

    def simulate(self, values: Floats) -> TrajectoryEnsemble:
        """Trajectories of parameter vectors from `with_start`, on the same grid in all calls."""
        # A new throw is not swept.
        environment = LEVEL_AND_STILL if self.new else fitted_environment(self.fit)

        def on_grid(t: Floats) -> TrajectoryEnsemble:
            return simulate_ensemble(self.fit.model, values, self.fit.stone, environment, t)

        if self._grid is not None:
            return on_grid(self._grid)
        duration = self._estimated_duration()
        for step in _GRID_STEPS:
            grid: Floats = step * np.arange(_GRID_TIMES, dtype=np.float64)
            if grid[-1] < duration:
                continue
            ensemble = on_grid(grid)
            late = ~ensemble.good | (ensemble.rest > _MAX_FILLED * grid[-1])
            if (late & np.isfinite(ensemble.state).all((1, 2))).mean() < _MAX_LATE:
                break
        self._grid = grid
        return ensemble

    def _estimated_duration(self) -> float:
        """Approximate duration of the throw in s, from the deceleration of the fitted one."""
        t, speed = self.fit.observed["t"], self.fit.fitted["speed"]
        deceleration = max((speed[0] - speed[-1]) / (t[-1] - t[0]), 1e-4)
        return min(
            float(1.2 * self.start.values["v0"] / deceleration), _GRID_STEPS[-1] * (_GRID_TIMES - 1)
        )


def fitted_environment(fit: FitResult) -> Environment:
    """Assumed environment of the fitted throw, whose first row is at time 0."""
    return environment_of(fit.data["swept"], float(fit.observed["t"][0]))


def prepare_ensemble(fit: FitResult) -> None:
    """Begin compiling the program for the trajectories of parameter vectors."""
    values = np.zeros((BATCH, len(fit.values)))
    _propagated.prepare(fit.model, values, fit.stone, LEVEL_AND_STILL, np.zeros(_GRID_TIMES))


def simulate_ensemble(
    model: Model, values: Floats, stone: Stone, environment: Environment, t: Floats
) -> TrajectoryEnsemble:
    """The trajectories of parameter vectors, at evenly spaced times from 0."""
    # In batches of one size, so that any number of throws runs the same program.
    return TrajectoryEnsemble.of(
        t, in_batches(lambda some: _propagated(model, some, stone, environment, t), (values,))
    )


def _cubic(a: Floats, b: Floats, slope_a: Floats, slope_b: Floats, s: Floats) -> Floats:
    """Cubic Hermite interpolation from a to b at a fraction s; slopes with respect to s."""
    return (
        a * (1 + 2 * s) * (1 - s) ** 2 + b * s**2 * (3 - 2 * s)
        + slope_a * s * (1 - s) ** 2 - slope_b * s**2 * (1 - s)
    )  # fmt: skip


def _running_sum(steps: Floats) -> Floats:
    """Running sum along the last axis, from zero."""
    return np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, 1)], 1)


def _forward_filled(values: Floats, known: Booleans) -> Floats:
    """Values with each unknown one replaced by the last known one before it."""
    last = np.maximum.accumulate(np.where(known, np.arange(values.shape[1]), 0), 1)
    return np.take_along_axis(values, last, 1)


def _rest_times(t: Floats, state: Floats, speed: Floats) -> Floats:
    """Time of rest of each throw.

    Near rest a rate v is proportional to a power q of the remaining time tau, so that the remaining
    distance is s = v tau/(1 + q), proportional to v^(1 + 1/q); q follows from two times. The
    rotation is used, since its angle is monotonic, or the position if the stone does not rotate or
    its rotation does not end with the sliding.
    """
    last = np.maximum((speed > 0).sum(1) - 1, 1)
    rows, step = np.arange(len(state)), t[1] - t[0]

    def remaining_time(distance: list[Floats], rate: list[Floats]) -> Floats:
        with np.errstate(all="ignore"):
            power = np.log(distance[0] / distance[1]) / np.log(rate[0] / rate[1])
            tau = distance[1] / rate[1] * power / (power - 1)
        return np.where((tau >= 0) & (tau <= step) & (power > 1.1), tau, np.nan)

    times = (last - 1, last)
    distance = [np.hypot(*(state[:, :2, -1] - state[rows, :2, k]).T) for k in times]
    angle = [np.abs(state[:, 2, -1] - state[rows, 2, k]) for k in times]
    sliding = remaining_time(distance, [speed[rows, k] for k in times])
    turning = remaining_time(angle, [np.abs(state[rows, 5, k]) for k in times])
    tau = np.where(np.isnan(turning), sliding, turning)
    return cast(Floats, t[last] + np.where(np.isnan(tau), step / 2, tau))


@compiled("model")
def _propagated(
    model: Model, values: Array, stone: Stone, environment: Environment, times: Array
) -> Array:
    def one(values: Array) -> Array:
        system = System.of(model, values, stone, environment)
        path = simulate(
            system.law, system.stone, system.start, times, load=model.load, t0=0.0,
            environment=system.environment,
        )  # fmt: skip
        return jnp.stack([path.x, path.y, path.phi, path.vx, path.vy, path.omega])

    return jax.vmap(one)(values)
