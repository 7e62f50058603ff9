"""Many paths to rest at once: the throw asked for, under many parameter vectors."""

from __future__ import annotations

from typing import Any, cast

from curlfit.dynamics.trajectory import simulate

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from curlfit.friction import Law, Load, check_load
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import split
from curlfit.inference.parameters import START
from curlfit.numerics.compiled import compiled
from curlfit.prediction.request import Begun
from curlfit.stone import Stone

Floats = NDArray[np.float64]

VARIED = {"v0": 0.01, "omega0": 0.1}
"""By how much a start is varied to tell how the resting place follows, in m/s and rad/s."""
_TIMES = 301
_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # s between times
_FILLED = 0.8  # share of the grid of times within which paths come to rest
_FEW = 0.01  # share of paths that may take longer
_LEAST_SPIN = 1e-3  # rad/s of the fitted throw, below which another's is not compared with it
_ON_LINE = 1e-3  # m; a stone that rests on a line has not passed it
_AT_START = 0.5  # m past a line within which a throw counts as beginning on it


class Paths:
    """Many paths to rest on one grid of times.

    Attributes
    ----------
    t : the grid in s since the start, shape (times,).
    state : x, y, phi, vx, vy, omega, shape (paths, 6, times). good : whether a path comes to rest.
    rest : time at rest in s, shape (paths,). clock : `t`, stopped there, shape (paths, times).
    """

    def __init__(self, t: Floats, state: Floats) -> None:
        self.t, self.state = t, state
        speed = np.hypot(state[:, 3], state[:, 4])
        turning = np.abs(state[:, 5])
        self.good = np.isfinite(state).all((1, 2)) & (speed[:, -1] <= 0) & (turning[:, -1] <= 0)
        self.rest = _rest_times(t, state, speed)
        self.clock = np.minimum(t, self.rest[:, None])

    def __len__(self) -> int:
        return len(self.state)

    def of(self, which: Any) -> Paths:
        """Some of the paths."""
        found = object.__new__(Paths)
        found.t, found.state = self.t, self.state[which]
        for name in ("good", "rest", "clock"):
            setattr(found, name, getattr(self, name)[which])
        return found

    def mean_speeds(self) -> Floats:
        """Of each interval of the grid, shape (paths, times - 1)."""
        speed = np.hypot(self.state[:, 3], self.state[:, 4])
        found: Floats = (speed[:, 1:] + speed[:, :-1]) / 2
        return found

    def under(self, missing: Floats) -> Paths:
        """The same throws under further accelerations, to rest.

        The law is taken to go by speed: a stone loses the same speeds, in other times. A
        deceleration D becomes D - a as far as D/2, and from there D/(2 sqrt(4 a/D - 1)): friction
        does not push. The last of the times stands for rest, whenever that is.

        Parameters
        ----------
        missing : accelerations to the right of the velocity, along it, and in turning, at the
            speed that the path has in each interval, shape (paths, 3, times - 1).
        """
        right, ahead, turning = missing.swapaxes(0, 1)
        x, y, phi, vx, vy, omega = self.state.swapaxes(0, 1)
        speed, middle = np.hypot(vx, vy), self.mean_speeds()
        step = np.diff(self.clock)
        loss = -np.diff(speed)
        with np.errstate(all="ignore"):
            ratio = np.where(loss > 0, ahead * step / loss, 0.0)
            veer = np.where(middle > 0, right / middle, 0.0)
        little, much = np.minimum(ratio, 0.5), np.maximum(ratio, 0.5)
        longer = step * np.where(ratio < 0.5, 1 / (1 - little), 2 * np.sqrt(4 * much - 1))
        heading = np.unwrap(_held(np.arctan2(vx, vy), speed > 0))
        more = longer / np.where(step > 0, step, 1.0) - 1
        turned = _sum(more * np.diff(heading) + veer * longer)
        faster = _sum(more * np.diff(omega) + turning * longer)
        new, spin = heading + turned, omega + faster

        def mean(values: Floats) -> Floats:
            return (values[:, 1:] + values[:, :-1]) / 2

        def moved(way: Any) -> Floats:
            """What the same sum over the intervals makes of this path and of the other."""
            there, here = way(mean(new)) * longer, way(mean(heading)) * step
            return _sum(middle * (there - here))

        places = np.stack([x + moved(np.sin), y + moved(np.cos),
                           phi + _sum(mean(spin) * longer - mean(omega) * step)], 1)  # fmt: skip
        rates = np.stack([speed * np.sin(new), speed * np.cos(new), spin], 1)
        times = _sum(longer)
        found = self.of(slice(None))
        found.state, found.rest = np.full_like(self.state, np.nan), times[:, -1]
        for one in np.flatnonzero(np.isfinite(self.state).all((1, 2))):
            clock, place, rate = times[one], places[one], rates[one]
            kept = np.flatnonzero(np.diff(clock, prepend=-1.0) > 0)
            at = np.minimum(np.append(self.t[:-1], np.inf), clock[-1])
            path = CubicHermiteSpline(clock[kept], place[:, kept], rate[:, kept], axis=1)
            moving = at < clock[-1] if speed[one, -1] <= 0 else True
            found.state[one, :3] = path(at)
            found.state[one, 3:] = [np.interp(at, clock, way) * moving for way in rate]
        found.clock = np.minimum(self.t, found.rest[:, None])
        return found

    def at(self, k: NDArray[np.int64], part: Floats) -> tuple[Floats, Floats]:
        """x, y, phi and their rates in interval k (k - 1 to k), at a part 0..1 of it, by cubics."""
        rows = np.arange(len(self))
        step = (self.clock[rows, k] - self.clock[rows, k - 1])[:, None]
        a, b = self.state[rows, :3, k - 1], self.state[rows, :3, k]
        slope_a, slope_b = self.state[rows, 3:, k - 1] * step, self.state[rows, 3:, k] * step
        s = part[:, None]
        value = (
            a * (1 + 2 * s) * (1 - s) ** 2 + b * s**2 * (3 - 2 * s)
            + slope_a * s * (1 - s) ** 2 - slope_b * s**2 * (1 - s)
        )  # fmt: skip
        rate = (
            6 * s * (1 - s) * (b - a) + slope_a * (1 - s) * (1 - 3 * s) + slope_b * s * (3 * s - 2)
        ) / np.where(step > 0, step, 1.0)
        return value, rate

    def passing(self, level: float) -> tuple[Floats, Floats]:
        """Time and speed at which each path first passes a y; NaN where it does not.

        A path that starts within `_AT_START` beyond it counts as starting on it.
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
            under = self.at(inside, middle)[0][:, 1] < level
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        rows = np.arange(len(self))
        before, after = self.clock[rows, inside - 1], self.clock[rows, inside]
        time = before + (after - before) * high
        speed = np.hypot(*self.at(inside, high)[1][:, :2].T)
        since = y[:, 0] - level
        on_it = (since >= 0) & (since < _AT_START)
        first = np.hypot(self.state[:, 3, 0], self.state[:, 4, 0])
        ahead = np.where(self.state[:, 4, 0] > 0, self.state[:, 4, 0], np.nan)
        time = np.where(on_it, -since / ahead, np.where(crossing, time, np.nan))
        return time, np.where(on_it, first, np.where(crossing, speed, np.nan))

    def when(self, times: Floats) -> Floats:
        """x, y, phi at times since the start, shape (paths, 3, times)."""
        found = np.empty((len(self), 3, len(times)))
        for place, time in enumerate(times):
            k = int(np.clip(np.searchsorted(self.t, time), 1, len(self.t) - 1))
            before, after = self.clock[:, k - 1], self.clock[:, k]
            step = np.where(after > before, after - before, 1.0)
            part = np.clip((np.minimum(time, self.rest) - before) / step, 0.0, 1.0)
            found[:, :, place] = self.at(np.full(len(self), k), part)[0]
        return found


class Family:
    """The throw asked for, under many parameter vectors.

    Attributes
    ----------
    spin : over that of the fitted throw.
    """

    def __init__(self, fit: FitResult, begun: Begun, new: bool) -> None:
        self.fit, self.begun, self.new = fit, begun, new
        self._first = len(fit.parameters) - len(START)
        spin = fit.parameters["omega0"].value
        known = new and abs(spin) > _LEAST_SPIN
        self.spin = begun.values["omega0"] / spin if known else 1.0
        self._grid: Floats | None = None
        self._size = 0

    def begin(self, values: Floats) -> Floats:
        """Parameter vectors with the start of this throw."""
        own = values.copy()
        if self.new:
            own[:, self._first :] = [self.begun.values[item.name] for item in START]
        else:
            own[:, self._first : self._first + 2] += self.begun.shift
        return own

    def probes(self) -> dict[str, Floats]:
        """The best estimate varied: in speed, in spin, and to both ends of unseen directions."""
        best, names = self.fit.values, list(self.fit.parameters)
        found = {}
        for name, by in VARIED.items():
            found[name] = self.begin(best[None])
            found[name][0, names.index(name)] += by
        parameters = self.fit.parameter_set
        for place, direction in enumerate(self.fit.null_directions):
            along = np.array([direction.get(name, 0.0) for name in names])
            with np.errstate(all="ignore"):
                ends = np.stack([parameters.lower - best, parameters.upper - best]) / along
            ends = np.sort(ends[:, (along != 0) & np.isfinite(ends).all(0)], axis=0)
            room = [max(ends[0], default=0.0), min(ends[1], default=0.0)]
            found[f"unseen {place}"] = self.begin(best + np.outer(room, along))
        return found

    def follow(self, own: Floats) -> Paths:
        """The paths of vectors that `begin` gave, on one grid for all calls."""
        self._size = max(self._size, len(own))
        every = np.concatenate([own, np.repeat(own[:1], self._size - len(own), 0)])
        law, load = self.fit.law_class, check_load(self.fit.load)

        def on(t: Floats) -> Paths:
            return followed(law, load, every, self.fit.stone, t)

        if self._grid is not None:
            return on(self._grid).of(slice(0, len(own)))
        guess = self._guess()
        for step in _STEPS:
            grid: Floats = step * np.arange(_TIMES, dtype=np.float64)
            if grid[-1] < guess:
                continue
            paths = on(grid)
            late = ~paths.good | (paths.rest > _FILLED * grid[-1])
            if (late & np.isfinite(paths.state).all((1, 2))).mean() < _FEW:
                break
        self._grid = grid
        return paths.of(slice(0, len(own)))

    def _guess(self) -> float:
        """About how long the throw takes, in s, from how the fitted one slowed."""
        t, speed = self.fit.observed["t"], self.fit.fitted["speed"]
        slowing = max((speed[0] - speed[-1]) / (t[-1] - t[0]), 1e-4)
        return min(float(1.2 * self.begun.values["v0"] / slowing), _STEPS[-1] * (_TIMES - 1))


def followed(law: type[Law], load: Load, values: Floats, stone: Stone, t: Floats) -> Paths:
    """The paths of parameter vectors, at evenly spaced times from 0."""
    return Paths(t, np.asarray(_carried(law, load, values, stone, t)))


def _sum(steps: Floats) -> Floats:
    """Running sum along the last axis, from zero."""
    return np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, 1)], 1)


def _held(values: Floats, known: NDArray[np.bool_]) -> Floats:
    """Values, each unknown one being the last known before it."""
    last = np.maximum.accumulate(np.where(known, np.arange(values.shape[1]), 0), 1)
    return np.take_along_axis(values, last, 1)


def _rest_times(t: Floats, state: Floats, speed: Floats) -> Floats:
    """When each path comes to rest.

    Toward rest a rate v goes as a power q of the time left, so that the way left, s, tells that
    time: s = v tau/(1 + q); and two moments tell q, for s goes as v to the power 1 + 1/q. It is
    taken from the turning, which has no loops, and from the place where the stone does not turn or
    its turning does not die away with the sliding.
    """
    last = np.maximum((speed > 0).sum(1) - 1, 1)
    rows, step = np.arange(len(state)), t[1] - t[0]

    def wait(way: list[Floats], rate: list[Floats]) -> Floats:
        with np.errstate(all="ignore"):
            power = np.log(way[0] / way[1]) / np.log(rate[0] / rate[1])
            found = way[1] / rate[1] * power / (power - 1)
        return np.where((found >= 0) & (found <= step) & (power > 1.1), found, np.nan)

    moments = (last - 1, last)
    place = [np.hypot(*(state[:, :2, -1] - state[rows, :2, k]).T) for k in moments]
    angle = [np.abs(state[:, 2, -1] - state[rows, 2, k]) for k in moments]
    sliding = wait(place, [speed[rows, k] for k in moments])
    turning = wait(angle, [np.abs(state[rows, 5, k]) for k in moments])
    left = np.where(np.isnan(turning), sliding, turning)
    return cast(Floats, t[last] + np.where(np.isnan(left), step / 2, left))


@compiled("law", "load")
def _carried(law: type[Law], load: Load, values: Array, stone: Stone, times: Array) -> Array:
    def one(values: Array) -> Array:
        friction, start = split(law, values)
        path = simulate(friction, stone, start, times, load=load, t0=0.0)
        return jnp.stack([path.x, path.y, path.phi, path.vx, path.vy, path.omega])

    return jax.vmap(one)(values)
