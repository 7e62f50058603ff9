"""Ensembles of trajectories to rest: one throw under many parameter vectors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np

from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.joint.draw import Draw
from curlfit.inference.model import Model
from curlfit.inference.parameters import START
from curlfit.inference.problem import LEVEL_AND_STILL, environment_of
from curlfit.inference.system import motions, prepare_motions
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import BATCH
from curlfit.prediction.request import GUARD, PlannedThrow, aimed
from curlfit.prediction.result import CENTRED, Call, Weight
from curlfit.sheet import HOUSE, LINES, TEE, TEE_TO_HACK
from curlfit.stone import Stone

VARIED = {"v0": 0.01, "omega0": 0.1}
"""Changes of the initial state for the sensitivity of the resting position, in
m/s and rad/s."""
_PLACES = {
    "guard": GUARD,
    "front of the house": -HOUSE,
    "tee": 0.0,
    "back of the house": HOUSE,
    "hack": TEE_TO_HACK,
}
_GRID = np.arange(301.0)
_GRID_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # s between times
_MAX_FILLED = 0.8  # fraction of the time grid within which throws come to rest
_MAX_LATE = 0.01  # fraction of the throws that may take longer
_MIN_SPIN = 1e-3  # rad/s of the fitted throw, below which no ratio of spins is formed
_ON_LINE = 1e-3  # m; a stone that rests on a line has not passed it
_AT_START = 0.5  # m; a throw that starts less than this past a line starts on it


class TrajectoryEnsemble(NamedTuple):
    """Trajectories to rest, each at times of its own."""

    t: Floats
    """s since the start, constant from the time of rest on, shape (paths, times)"""
    state: Floats
    """x, y, phi, vx, vy, omega, shape (paths, 6, times)"""

    @property
    def finite(self) -> Booleans:
        """Whether each throw has a trajectory."""
        return cast(Booleans, np.isfinite(self.state).all((1, 2)))

    @property
    def good(self) -> Booleans:
        """Whether each throw comes to rest."""
        return self.finite & (self.speed[:, -1] <= 0)

    @property
    def rest(self) -> Floats:
        """Time of rest in s, shape (paths,)."""
        return self.t[:, -1]

    @property
    def end(self) -> Floats:
        """x, y and phi at rest, shape (paths, 3)."""
        return self.state[:, :3, -1]

    @property
    def speed(self) -> Floats:
        """Speed of the centre in m/s, shape (paths, times)."""
        return np.hypot(self.state[:, 3], self.state[:, 4])

    @property
    def mean_speed(self) -> Floats:
        """Mean speed in each interval of the times, shape (paths, times - 1)."""
        return _means(self.speed)

    def select(self, which: Any) -> TrajectoryEnsemble:
        """The selected trajectories."""
        return TrajectoryEnsemble(self.t[which], self.state[which])

    def with_accelerations(self, missing: Floats) -> TrajectoryEnsemble:
        """The same throws under additional accelerations, to rest.

        The friction is taken as a function of speed: a stone passes through the same
        speeds at different times. A deceleration D becomes D - a down to D/2, and D/(2
        sqrt(4 a/D - 1)) below that, since friction does not accelerate.

        Parameters
        ----------
        missing : accelerations to the right of the velocity, along it, and angular, at
            the speed of each interval, shape (paths, 3, times - 1).
        """
        across, along, angular = missing.swapaxes(0, 1)
        x, y, phi, vx, vy, omega = self.state.swapaxes(0, 1)
        speed, mean_speed = self.speed, self.mean_speed
        step, loss = np.diff(self.t), -np.diff(speed)
        with np.errstate(all="ignore"):
            ratio = np.where(loss > 0, along * step / loss, 0.0)
            turn_rate = np.where(mean_speed > 0, across / mean_speed, 0.0)
        low, high = np.minimum(ratio, 0.5), np.maximum(ratio, 0.5)
        new_step = step * np.where(
            ratio < 0.5, 1 / (1 - low), 2 * np.sqrt(4 * high - 1)
        )
        heading = np.unwrap(_forward_filled(np.arctan2(vx, vy), speed > 0))
        extension = new_step / np.where(step > 0, step, 1.0) - 1
        new_heading = heading + _running_sum(
            extension * np.diff(heading) + turn_rate * new_step
        )
        spin = omega + _running_sum(extension * np.diff(omega) + angular * new_step)

        def displaced(position: Floats, rate: Floats, new_rate: Floats) -> Floats:
            """A coordinate, changed relative to this path by the sum over
            the intervals."""
            return position + _running_sum(new_rate * new_step - rate * step)

        old, new = _means(heading), _means(new_heading)
        state = np.stack(
            [
                displaced(x, mean_speed * np.sin(old), mean_speed * np.sin(new)),
                displaced(y, mean_speed * np.cos(old), mean_speed * np.cos(new)),
                displaced(phi, _means(omega), _means(spin)),
                speed * np.sin(new_heading),
                speed * np.cos(new_heading),
                spin,
            ],
            1,
        )
        return TrajectoryEnsemble(_running_sum(new_step), state)

    def positions_at(self, times: Floats) -> Floats:
        """x, y, phi at times since the start, shape (paths, 3, times)."""
        from scipy.interpolate import CubicHermiteSpline  # slow to load

        found = np.full((len(self.t), 3, len(times)), np.nan)
        for index in np.flatnonzero(self.finite):
            distinct = np.diff(self.t[index], prepend=-1.0) > 0
            t, state = self.t[index, distinct], self.state[index][:, distinct]
            path = CubicHermiteSpline(t, state[:3], state[3:], axis=1)
            found[index] = path(np.minimum(times, t[-1]))
        return found

    def crossing(self, level: float) -> tuple[Floats, Floats]:
        """Time and speed at which each throw first crosses a given y; NaN where
        it does not.

        A throw that starts within `_AT_START` beyond it is taken to start on it.
        """
        from scipy.interpolate import CubicHermiteSpline  # slow to load
        from scipy.optimize.elementwise import find_root

        y, rows = self.state[:, 1], np.arange(len(self.t))
        beyond = (y >= level) & (y[:, -1:] > level + _ON_LINE)
        k = np.maximum(np.argmax(beyond, 1), 1)
        ends = self.state[rows, :, [k - 1, k]]
        step = self.t[rows, k] - self.t[rows, k - 1]
        path = CubicHermiteSpline(
            [0.0, 1.0], ends[..., :2], ends[..., 3:5] * step[:, None]
        )
        height, rates = path.c[:, 0, :, 1], path.derivative().c[:, 0]
        height[-1] -= level
        part = find_root(
            lambda s, *cubic: np.polyval(cubic, s), (0.0, 1.0), args=(*height,)
        ).x
        velocity = np.polyval(rates, part[:, None]) / step[:, None]
        crosses = beyond.any(1) & ~beyond[:, 0]
        time = np.where(crosses, self.t[rows, k - 1] + step * part, np.nan)
        speed = np.where(crosses, np.hypot(*velocity.T), np.nan)
        since, ahead = y[:, 0] - level, self.state[:, 4, 0]
        on_it = (since >= 0) & (since < _AT_START)
        before = -since / np.where(ahead > 0, ahead, np.nan)
        return np.where(on_it, before, time), np.where(on_it, self.speed[:, 0], speed)


class ThrowFamily:
    """The throw to be predicted, under many parameter vectors.

    Attributes
    ----------
    t : times since the start in s, at which those of `simulate` are.
    spin_ratio : ratio of the spin to that of the fitted throw.
    """

    t: Floats = np.zeros(0)

    def __init__(self, throw: PlannedThrow) -> None:
        self.throw, self.fit, fit = throw, throw.fit, throw.fit
        self._first = len(fit.parameters) - len(START)
        fitted_spin = fit.parameters["omega0"].value
        known = throw.new and abs(fitted_spin) > _MIN_SPIN
        self.spin_ratio = throw.values["omega0"] / fitted_spin if known else 1.0
        self.environment = LEVEL_AND_STILL  # a new throw is not swept
        if not throw.new:
            self.environment = environment_of(
                fit.data["swept"], float(fit.observed["t"][0])
            )

    def with_start(
        self, values: Floats, call: Call = CENTRED, random: Any = None
    ) -> Floats:
        """Parameter vectors with the initial state of this throw.

        A spin that was not given has the error of the fitted one. Where the call gives
        the time between hog lines, each has the speed at which it takes that time; with
        `random`, time and broom have the thrower's scatter.
        """
        own, throw = values.copy(), self.throw
        if throw.new:
            own[:, self._first :] = [throw.values[item.name] for item in START]
            if throw.origins["omega0"] != "given":
                own[:, -1] = self.spin_ratio * values[:, -1]
            time, draw = call.hog_to_hog, Draw(self.fit.model, self.fit.stone)
            scatter = call.thrower if random is not None else None
            if scatter is not None:
                if time is None:
                    speed = own[:1, self._first + 3]
                    best = self.fit.values[None, : self._first]
                    time = draw.hog_to_hog(best, throw.values["omega0"], speed)[0]
                normal = random.standard_normal((2, len(own)))
                time = time + scatter[0] * normal[0]
                off = scatter[1] * normal[1] / TEE
                own[:, self._first] += off * own[0, self._first + 1]
                own[:, self._first + 2] += off
            if time is not None:
                own[:, self._first + 3] = draw.speeds(
                    own[:, : self._first], own[:, -1], time
                )
        else:
            own[:, self._first : self._first + 2] += throw.shift
        return own

    def probes(self) -> dict[str, Floats]:
        """The best estimate varied in speed, in spin, and to both ends of each
        null direction."""
        best, names = self.fit.values, list(self.fit.parameters)
        found = {}
        for name, by in VARIED.items():
            found[name] = self.with_start(best[None])
            found[name][0, names.index(name)] += by
        parameters = self.fit.parameter_set
        for index, direction in enumerate(self.fit.null_directions):
            along = np.array([direction.get(name, 0.0) for name in names])
            with np.errstate(all="ignore"):
                ends = (
                    np.stack([parameters.lower - best, parameters.upper - best]) / along
                )
            ends = np.sort(ends[:, (along != 0) & np.isfinite(ends).all(0)], axis=0)
            limits = [max(ends[0], default=0.0), min(ends[1], default=0.0)]
            found[f"null {index}"] = self.with_start(best + np.outer(limits, along))
        return found

    def simulate(self, values: Floats) -> TrajectoryEnsemble:
        """Trajectories of parameter vectors from `with_start`, at the same times
        in all calls."""

        def at(t: Floats, values: Floats) -> TrajectoryEnsemble:
            return simulate_ensemble(
                self.fit.model, values, self.fit.stone, self.environment, t
            )

        if not len(self.t):
            rest = at(_GRID * _GRID_STEPS[-1], values[:BATCH]).rest
            ends = _MAX_FILLED * _GRID[-1] * np.array(_GRID_STEPS[:-1])
            late = (rest > ends[:, None]).mean(1) > _MAX_LATE
            self.t = _GRID * _GRID_STEPS[int(late.sum())]
        return at(self.t, values)


def prepare_ensemble(fit: FitResult) -> None:
    """Begin compiling the program for the trajectories of parameter vectors."""
    prepare_motions(
        fit.model, len(fit.values), fit.stone, LEVEL_AND_STILL, np.zeros(len(_GRID))
    )


def simulate_ensemble(
    model: Model, values: Floats, stone: Stone, environment: Environment, t: Floats
) -> TrajectoryEnsemble:
    """The trajectories of parameter vectors, at increasing times from 0."""
    state, rest = motions(model, values, stone, environment, t)
    return TrajectoryEnsemble(np.minimum(t, rest[:, None]), state)


def weights_of(fit: FitResult, spin: float) -> tuple[Weight, ...]:
    """What to throw for places from guard to hack, with a spin in rad/s of either
    sense, on the ice of a fit. A place that no throw reaches is left out."""
    spin, start, found = abs(spin), LINES["hog"], []
    for name, y in _PLACES.items():
        try:
            throws = [
                aimed(fit, (0.0, TEE + y), omega, start=(0.0, start))
                for omega in (-spin, spin)
            ]
        except InputError:
            continue
        right, left = (math.tan(one.heading) * (TEE - start) for one in throws)
        state = 0.0, start, throws[1].heading, throws[1].v0, 0.0, spin
        values = np.array([[*fit.values[: -len(START)], *state]])
        path = simulate_ensemble(
            fit.model, values, fit.stone, LEVEL_AND_STILL, 0.2 * _GRID
        )
        hog, tee = (
            float(path.crossing(LINES[line])[0][0]) for line in ("far-hog", "far-tee")
        )
        found.append(Weight(name, y, hog, tee if y > 0 else None, (right, left)))
    return tuple(found)


def _means(values: Floats) -> Floats:
    """Means of neighbours along the last axis."""
    return (values[:, 1:] + values[:, :-1]) / 2


def _running_sum(steps: Floats) -> Floats:
    """Running sum along the last axis, from zero."""
    return np.pad(np.cumsum(steps, 1), ((0, 0), (1, 0)))


def _forward_filled(values: Floats, known: Booleans) -> Floats:
    """Values with each unknown one replaced by the last known one before it."""
    last = np.maximum.accumulate(np.where(known, np.arange(values.shape[1]), 0), 1)
    return np.take_along_axis(values, last, 1)
