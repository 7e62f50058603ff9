"""Ensembles of trajectories to rest: one throw under many parameter vectors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, cast

import numpy as np

from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.inference.fit.result import FitResult
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START_INDEX, before_start
from curlfit.inference.model.problem import LEVEL_AND_STILL, environment_of
from curlfit.inference.model.system import motions, prepare_motions
from curlfit.inference.together.draw import Draw
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
_GRID = np.arange(301.0)  # times of a trajectory, in steps
_GRID_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # s
_WEIGHT_TIMES = 0.2 * _GRID  # s; within a minute every stone of a game is at rest
_MAX_FILLED = 0.8  # fraction of the time grid within which throws come to rest
_MAX_LATE = 0.01  # fraction of the throws that may take longer
_MIN_SPIN = 1e-3  # rad/s of the fitted throw, below which no ratio of spins is formed
_ON_LINE = 1e-3  # m; a stone that rests on a line has not passed it
_AT_START = 0.5  # m; a throw that starts less than this past a line starts on it


class Crossing(NamedTuple):
    """When and how fast each throw crosses a line; NaN where it does not."""

    time: Floats
    """s since the start, shape (paths,)"""
    speed: Floats
    """m/s, shape (paths,)"""


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
    def comes_to_rest(self) -> Booleans:
        """Whether each throw has a trajectory that ends at rest."""
        return self.finite & (self.speed[:, -1] <= 0)

    @property
    def time_of_rest(self) -> Floats:
        """s since the start, shape (paths,)."""
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
        """Trajectories of these throws under additional accelerations, to rest.

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
        speed = self.speed
        mean_speed = self.mean_speed
        step = np.diff(self.t)
        slowing = -np.diff(speed)
        with np.errstate(all="ignore"):
            ratio = np.where(slowing > 0, along * step / slowing, 0.0)  # a/D
            turn_rate = np.where(mean_speed > 0, across / mean_speed, 0.0)
        # The speeds of an interval stay; the time that it takes becomes longer.
        weak = 1 / (1 - np.minimum(ratio, 0.5))
        strong = 2 * np.sqrt(4 * np.maximum(ratio, 0.5) - 1)
        new_step = step * np.where(ratio < 0.5, weak, strong)
        # What the law turns the path and the stone by grows with the time, and what the
        # missing accelerations turn them by is added.
        extension = new_step / np.where(step > 0, step, 1.0) - 1
        heading = np.unwrap(_forward_filled(np.arctan2(vx, vy), speed > 0))
        new_heading = heading + _running_sum(
            extension * np.diff(heading) + turn_rate * new_step
        )
        new_omega = omega + _running_sum(
            extension * np.diff(omega) + angular * new_step
        )

        def displaced(position: Floats, rate: Floats, new_rate: Floats) -> Floats:
            """A coordinate along the new path: its difference from that along the old
            one is summed, so that without accelerations it stays exactly."""
            return position + _running_sum(new_rate * new_step - rate * step)

        course = _means(heading)
        new_course = _means(new_heading)
        vx_mean = mean_speed * np.sin(course)
        vy_mean = mean_speed * np.cos(course)
        new_vx_mean = mean_speed * np.sin(new_course)
        new_vy_mean = mean_speed * np.cos(new_course)
        new_state = [
            displaced(x, vx_mean, new_vx_mean),
            displaced(y, vy_mean, new_vy_mean),
            displaced(phi, _means(omega), _means(new_omega)),
            speed * np.sin(new_heading),
            speed * np.cos(new_heading),
            new_omega,
        ]
        return TrajectoryEnsemble(_running_sum(new_step), np.stack(new_state, 1))

    def positions_at(self, times: Floats) -> Floats:
        """x, y, phi at times since the start, shape (paths, 3, times)."""
        from scipy.interpolate import CubicHermiteSpline  # slow to load

        positions = np.full((len(self.t), 3, len(times)), np.nan)
        for index in np.flatnonzero(self.finite):
            distinct = np.diff(self.t[index], prepend=-1.0) > 0
            t = self.t[index, distinct]
            state = self.state[index][:, distinct]
            path = CubicHermiteSpline(t, state[:3], state[3:], axis=1)
            positions[index] = path(np.minimum(times, t[-1]))
        return positions

    def crossing(self, level: float) -> Crossing:
        """The first crossing of a line across the sheet, at a given y in m.

        A throw that starts within `_AT_START` beyond it is taken to start on it.
        """
        from scipy.interpolate import CubicHermiteSpline  # slow to load
        from scipy.optimize.elementwise import find_root

        # y   after ->  o
        #             /     the line is between two times; a cubic joins them,
        # --level--- x ---  as a function of the part of the interval, 0 to 1
        #          /
        #        o  <- before
        y = self.state[:, 1]
        beyond = (y >= level) & (y[:, -1:] > level + _ON_LINE)
        paths = np.arange(len(self.t))
        after = np.maximum(np.argmax(beyond, 1), 1)
        before = after - 1
        time_before = self.t[paths, before]
        interval = self.t[paths, after] - time_before
        states = self.state[paths, :, [before, after]]  # shape (2, paths, 6)
        positions = states[..., :2]
        rates = states[..., 3:5] * interval[:, None]  # by the part of the interval
        cubic = CubicHermiteSpline([0.0, 1.0], positions, rates)
        height = cubic.c[:, 0, :, 1].copy()  # coefficients of y - level, (4, paths)
        height[-1] -= level
        part = find_root(
            lambda part, *coefficients: np.polyval(coefficients, part),
            (0.0, 1.0),
            args=(*height,),
        ).x
        slopes = cubic.derivative().c[:, 0]  # coefficients, shape (3, paths, 2)
        velocity = np.polyval(slopes, part[:, None]) / interval[:, None]
        crosses = beyond.any(1) & ~beyond[:, 0]
        time = np.where(crosses, time_before + interval * part, np.nan)
        speed = np.where(crosses, np.hypot(*velocity.T), np.nan)

        past = y[:, 0] - level
        forward = self.state[:, 4, 0]
        starts_on_line = (past >= 0) & (past < _AT_START)
        time_at_start = -past / np.where(forward > 0, forward, np.nan)
        return Crossing(
            time=np.where(starts_on_line, time_at_start, time),
            speed=np.where(starts_on_line, self.speed[:, 0], speed),
        )


class ThrowFamily:
    """The throw to be predicted, under many parameter vectors.

    A vector is the parameters of law and conditions, then the initial state.

    Attributes
    ----------
    spin_ratio : ratio of the spin to that of the fitted throw.
    """

    def __init__(self, throw: PlannedThrow) -> None:
        fit = throw.fit
        self.throw = throw
        self.fit = fit
        self.spin_ratio = 1.0
        fitted_spin = fit.parameters["omega0"].value
        if throw.new and abs(fitted_spin) > _MIN_SPIN:
            self.spin_ratio = throw.values["omega0"] / fitted_spin
        self.environment = LEVEL_AND_STILL  # a new throw is not swept
        if not throw.new:
            self.environment = environment_of(
                fit.data.swept, float(fit.observed["t"][0])
            )

    def with_start(
        self,
        values: Floats,
        call: Call = CENTRED,
        random: np.random.Generator | None = None,
    ) -> Floats:
        """Parameter vectors, shape (n, parameters), with the initial state of this
        throw.

        A spin that was not given has the error of the fitted one. Where the call gives
        the time between hog lines, each has the speed at which it takes that time; with
        `random`, time and broom have the thrower's scatter.
        """
        throw = self.throw
        column = START_INDEX
        vectors = values.copy()
        if not throw.new:
            vectors[:, column["x0"]] += throw.shift[0]
            vectors[:, column["y0"]] += throw.shift[1]
            return vectors
        for name, index in column.items():
            vectors[:, index] = throw.values[name]
        if throw.origins["omega0"] != "given":
            fitted_spins = values[:, column["omega0"]]
            vectors[:, column["omega0"]] = self.spin_ratio * fitted_spins
        draw = Draw(self.fit.model, self.fit.stone)
        hog_to_hog: float | Floats | None = call.hog_to_hog
        if random is not None and call.thrower is not None:
            time_sd, broom_sd = call.thrower
            if hog_to_hog is None:
                best = before_start(self.fit.values[None])
                speed = vectors[:1, column["v0"]]
                spin = throw.values["omega0"]
                hog_to_hog = draw.hog_to_hog(best, spin, speed)[0]
            normal = random.standard_normal((2, len(vectors)))
            hog_to_hog = hog_to_hog + time_sd * normal[0]
            # aimed from the hack, where y is 0, at a broom at the far tee
            angle = broom_sd * normal[1] / TEE
            vectors[:, column["x0"]] += angle * vectors[0, column["y0"]]
            vectors[:, column["heading"]] += angle
        if hog_to_hog is not None:
            vectors[:, column["v0"]] = draw.speeds(
                before_start(vectors), vectors[:, column["omega0"]], hog_to_hog
            )
        return vectors

    def varied(self) -> dict[str, Floats]:
        """The best estimate with one component of the initial state changed, by the
        name of the component; a parameter vector each, shape (1, parameters)."""
        vectors = {}
        for name, change in VARIED.items():
            vectors[name] = self.with_start(self.fit.values[None])
            vectors[name][0, START_INDEX[name]] += change
        return vectors

    def null_ends(self) -> list[Floats]:
        """The best estimate moved along each null direction of the fit, either way to
        the first bound of a parameter; for each direction shape (2, parameters)."""
        best = self.fit.values
        parameters = self.fit.parameter_set
        vectors = []
        for direction in self.fit.identifiability.null_directions:
            along = np.array([direction.get(name, 0.0) for name in parameters.names])
            # how far along the direction each parameter is at its bounds
            with np.errstate(all="ignore"):
                to_lower = (parameters.lower - best) / along
                to_upper = (parameters.upper - best) / along
            bounded = (along != 0) & np.isfinite(to_lower) & np.isfinite(to_upper)
            backward = np.minimum(to_lower, to_upper)[bounded]
            forward = np.maximum(to_lower, to_upper)[bounded]
            ends = [max(backward, default=0.0), min(forward, default=0.0)]
            vectors.append(self.with_start(best + np.outer(ends, along)))
        return vectors

    def times_to_rest(self, values: Floats) -> Floats:
        """The finest grid of times within which nearly all throws of some parameter
        vectors come to rest, s since the start."""
        longest = self.simulate(values[:BATCH], _GRID * _GRID_STEPS[-1])
        ends = _MAX_FILLED * _GRID[-1] * np.array(_GRID_STEPS[:-1])
        late = (longest.time_of_rest > ends[:, None]).mean(1)
        too_short = int((late > _MAX_LATE).sum())
        return _GRID * _GRID_STEPS[too_short]

    def simulate(self, values: Floats, t: Floats) -> TrajectoryEnsemble:
        """Trajectories of parameter vectors from `with_start`, at times since
        the start."""
        return simulate_ensemble(
            self.fit.model, values, self.fit.stone, self.environment, t
        )


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
    spin = abs(spin)
    hog = LINES["hog"]
    hog_to_tee_line = TEE - hog
    weights = []
    for name, y in _PLACES.items():
        target = (0.0, TEE + y)
        try:
            clockwise = aimed(fit, target, -spin, start=(0.0, hog))
            counter_clockwise = aimed(fit, target, spin, start=(0.0, hog))
        except InputError:
            continue
        heading = counter_clockwise.heading
        state = (0.0, hog, heading, counter_clockwise.v0, 0.0, spin)
        values = np.array([[*before_start(fit.values), *state]])
        path = simulate_ensemble(
            fit.model, values, fit.stone, LEVEL_AND_STILL, _WEIGHT_TIMES
        )
        hog_to_tee = None
        if y > 0:
            hog_to_tee = float(path.crossing(LINES["far-tee"]).time[0])
        weights.append(
            Weight(
                rests=name,
                y=y,
                hog_to_hog=float(path.crossing(LINES["far-hog"]).time[0]),
                hog_to_tee=hog_to_tee,
                brooms=(
                    math.tan(clockwise.heading) * hog_to_tee_line,
                    math.tan(heading) * hog_to_tee_line,
                ),
            )
        )
    return tuple(weights)


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
