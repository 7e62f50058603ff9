"""What is wrong with a user's law, said before it is used.

A law is evaluated with its defaults at a few points; then, in many motions and with
coefficients near the defaults, its sum over the ring and over steps in time is compared
with that over many more points.
"""

from __future__ import annotations

import inspect
import traceback
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from curlfit.errors import DataError, warn_once
from curlfit.friction.base import (
    Law,
    LocalLaw,
    Motion,
    NetLaw,
    RingPoint,
    ring_points,
)
from curlfit.friction.sampled import STONE, Conditions, Sampled, sample
from curlfit.numerics.arrays import Floats

_MOTIONS_OF_DEFAULTS = [
    Motion(speed=2.0, omega=1.0, turned=0.0, time=0.0),
    Motion(speed=2.0, omega=-1.0, turned=-0.5, time=1.0),
    Motion(speed=0.3, omega=2.0, turned=6.0, time=10.0),
    Motion(speed=0.02, omega=1.0, turned=9.0, time=20.0),
]
"""Motions in which a law is evaluated with its defaults."""
_ANGLES = np.linspace(-np.pi, np.pi, 24, endpoint=False) + np.pi / 24
_ROUNDING = 1e-12  # m/s, of a power per unit load
_USE_JAX = (
    "a law is compiled, which numpy, math and `if` cannot be; expected functions "
    "of jax.numpy (`import jax.numpy as jnp`, jnp.sqrt for np.sqrt) and "
    "jnp.where(condition, a, b) for `if`"
)
_MOTIONS = 256  # in which the sum over the ring is checked
_SECTIONS = 20  # of each half, or part between edges, each with the points of a fit
_SMALL_ERROR = 1e-5
"""Of the sum over the ring, relative to friction: a hundredth of the standard error of
a coefficient in a good measurement."""
# The error of a sum by 20 points, measured: laws of curlfit 3e-15; c |xi| 0.5 %,
# c (1 - |xi|) 0.9 %, c max(xi - 0.6, 0) 1.5 %, c |xi|^0.5 1.9 %; friction that grows
# and falls by its own size within 0.2 rad 0.04 %, 0.1 rad 1.2 %, 0.05 rad 2.6 %; that
# jumps at any two angles by 1 % 0.03 %, by 5 % 0.2 %, by 20 % 0.6 %, by 100 % 3 %.
_LARGEST_ERROR = 0.02
"""Of the sum over the ring, relative: laws with a kink pass."""
# The excess of the largest step, measured: laws of curlfit 2e-4, kinks at most 0.001,
# c |xi|^0.5 0.002; jumps at any two angles by 1 % at least 0.0086, by 5 % 0.048, by
# 20 % 0.18.
_JUMP = 0.004
"""Step of friction, relative, beyond the steps beside it, that is a jump."""
_STEPS = 400  # of each half, or part between edges, among which a jump is looked for
_BESIDE = 1e-6  # rad, from the ends, where friction may jump
_MOST_NAMED = 4  # jumps in a message
_DURATION = 25.0  # s, in which changes are looked for
_INTERVAL = 0.01  # s, between the times at which it is evaluated
_SPEED = 2.0  # m/s, of the motion meanwhile
_SPINS = 1.5, -1.5  # rad/s
_LARGEST_SHIFT = 1e-4  # m, of the path, if the steps in time are too long for a change
_STEP_RATES = 0.8, 7.1
"""Inverse length of a step in 1/s, and its increase per 1/s of `quickness`, at the
release of such a stone (`dynamics.equations.step_size`)"""
_RATES = 0.3, 1.0, 3.0, 10.0  # 1/s, of a quickness that a message may recommend
_SUDDEN = 0.3  # of all change, within one interval
_COURSES = 4  # sets of coefficients, the defaults first

_EDGES = (
    "declare these angles in `def edges(self, turned)`, which returns "
    "Edges(front=(ANGLE, ...), back=(ANGLE, ...)) of curlfit.friction"
)
_GRADUAL = (
    "make the change gradual, as (1 + jnp.tanh((a - b) / width)) / 2 in place of "
    "the condition a > b"
)

_CHECKED: set[type[Law]] = set()


def checked(law: type[Law], file: str = "") -> type[Law]:
    """The law, registered under its name, or that of its class if it has none.

    Parameters
    ----------
    file : where the law is, for messages; by default the file of its code.

    Raises
    ------
    DataError : the law cannot be evaluated or compiled, drives the stone, jumps at
        angles that it does not declare, changes too quickly, or has the name of a law
        of curlfit.
    """
    if law.shipped() or law in _CHECKED:
        return law
    import jax  # only for user-defined laws

    check = Check(law, file)
    with jax.ensure_compile_time_eval():  # also while another function is traced
        check.values()
        check.sums()
        check.changes()
    try:
        law.register(law.name or law.__name__)
    except TypeError as error:
        check.refuse(str(error))
    _CHECKED.add(law)
    return law


class Step(NamedTuple):
    """The change of friction between two neighbouring polar angles.

    `excess` is how much larger it is than the changes beside it, `bend` its distance
    from what they lead to expect, both relative to friction.
    """

    excess: float
    bend: float
    begin: float
    end: float


class Check:
    """The checks of one law, which raise DataError."""

    def __init__(self, law: type[Law], file: str = "") -> None:
        self.law = law
        method: Any = getattr(law, "traction", None) or getattr(
            law, "accelerations", None
        )
        code = getattr(inspect.unwrap(method), "__code__", None)
        self.path = Path(code.co_filename if code else "")
        self.file = file or str(self.path)
        self.sampled = Sampled(law)

    def refuse(self, message: str, line: int | None = None) -> NoReturn:
        """Raise DataError for the law."""
        raise DataError(message, file=self.file, line=line) from None

    def values(self) -> None:
        """Evaluate the law with its defaults, both on numbers and traced."""
        local = issubclass(self.law, LocalLaw)
        names = ["to the right", "forward"]
        if not local:
            names.append("angular")
        for motion in _MOTIONS_OF_DEFAULTS:
            speed, omega, turned, time = motion
            point = ring_points(_ANGLES, speed, STONE.R * omega, turned, time)
            result = self._evaluated(point if local else motion)
            if not isinstance(result, tuple):
                self._refuse_result(f"a value of type {type(result).__name__}", names)
            if len(result) != len(names):
                self._refuse_result(f"{len(result)} values", names)
            conditions = f"with its defaults, at {speed:g} m/s and {omega:g} rad/s"
            if not all(np.isfinite(np.asarray(part, float)).all() for part in result):
                self.refuse(f"{self.law.__name__} {conditions}, gives {result!r}")
            if local:
                power = result[0] * point.slide_xi + result[1] * point.slide_eta
            else:
                power = speed * result[1] + STONE.rho**2 * omega * result[2]
            self._opposes(power, conditions)

    def _refuse_result(self, result: str, names: list[str]) -> NoReturn:
        self.refuse(
            f"{self.law.__name__} gives {result}; expected {len(names)}: "
            f"({', '.join(names)})"
        )

    def _evaluated(self, argument: RingPoint | Motion) -> Any:
        """Friction with the default coefficients; refuse a law that cannot be traced
        or evaluated."""
        import jax

        defaults = np.array([c.default for c in self.law.coefficients()])

        def evaluate(values: Any, argument: Any) -> Any:
            friction = self.law.from_vector(values)
            if isinstance(friction, LocalLaw):
                return friction.traction(argument)
            assert isinstance(friction, NetLaw)
            return friction.accelerations(argument, STONE)

        try:
            jax.eval_shape(evaluate, defaults, argument)
            return evaluate(defaults, argument)
        except (
            jax.errors.ConcretizationTypeError,
            jax.errors.TracerArrayConversionError,
            jax.errors.TracerIntegerConversionError,
        ) as error:
            self.refuse(_USE_JAX, last_line(self.path, error))
        except Exception as error:
            self.refuse(first_line(error), last_line(self.path, error))

    def _opposes(self, power: Any, conditions: str) -> None:
        """Refuse a law whose friction does not oppose the motion; warn of one that
        drives some points of the ring."""
        direction = "motion"
        if issubclass(self.law, LocalLaw):
            direction = "sliding, as -mu * point.e_xi, -mu * point.e_eta"
        if np.sum(power) > _ROUNDING:
            self.refuse(
                f"{self.law.__name__} {conditions}, drives the stone; "
                f"expected a force against the {direction}"
            )
        if np.max(power) > _ROUNDING:
            warn_once(
                f"{self.file}: {self.law.__name__} {conditions}, drives some points "
                "of the ring; friction opposes sliding at each of them"
            )

    def sums(self) -> None:
        """Compare the sum over the ring by the points of a fit with one by 20 times as
        many; refuse a law that jumps at angles that it does not declare, and warn of
        one with a kink."""
        if not issubclass(self.law, LocalLaw):
            return
        name = self.law.__name__
        sampled = self.sampled
        conditions = sampled.usable(sample(self.law, _MOTIONS, seed=0))
        change = sampled.net(conditions) - sampled.net(conditions, _SECTIONS)
        errors = np.abs(change).max(0) / sampled.size(conditions)
        error = errors.max(initial=0.0)
        if not error > _SMALL_ERROR:
            return
        steps = self._steps(conditions.take([errors.argmax()]))
        jumps = [step for step in steps if step.excess > _JUMP]
        roughest = max(steps, key=lambda step: step.bend)
        ranges = [
            f"between {step.begin:.4f} and {step.end:.4f} rad"
            for step in jumps[:_MOST_NAMED] or [roughest]
        ]
        region = f"{', '.join(ranges)} (error of its sum over the ring: {error:.2%})"
        if jumps or error > _LARGEST_ERROR:
            self.refuse(
                f"{name}: friction jumps, or changes within a narrow range, "
                f"{region}; {_EDGES}; if they depend on the speed, the load or the "
                f"time, {_GRADUAL}"
            )
        warn_once(
            f"{self.file}: {name}: friction has a kink, or changes within a narrow "
            f"range, {region}; {_EDGES}"
        )

    def _steps(self, condition: Conditions) -> list[Step]:
        """Steps of friction around the ring, in one condition."""
        steps = []
        size = self.sampled.size(condition)
        for low, high in pairwise(self.sampled.ends(condition)[0]):
            if high - low < 2 * _BESIDE:  # an edge at the end of a half
                continue
            angles = np.linspace(low + _BESIDE, high - _BESIDE, _STEPS + 1)
            friction = self.sampled.at_angles(condition, angles[None])[:, 0] / size
            # the first and the last have a neighbour on one side, taken for both
            changes = np.pad(np.diff(friction), ((0, 0), (1, 1)), mode="reflect")
            before = changes[:, :-2]
            change = changes[:, 1:-1]
            after = changes[:, 2:]
            # At a kink a change lies between its neighbours, at a jump beyond both.
            excess = np.abs(change) - np.maximum(np.abs(before), np.abs(after))
            bend = np.abs(change - (before + after) / 2)
            rows = zip(excess.max(0), bend.max(0), angles, angles[1:], strict=False)
            steps += [Step(*map(float, row)) for row in rows]
        return steps

    def changes(self) -> None:
        """Compare friction summed over steps in time with that over many
        more points."""
        rows = sample(self.law, _COURSES, seed=2).coefficients
        rows[0] = [c.default for c in self.law.coefficients()]
        for coefficients in rows:
            for spin in _SPINS:
                course = _course(coefficients, spin)
                if not self._is_constant(course):
                    self._check_course(course)

    def _is_constant(self, course: Conditions) -> bool:
        """Whether friction is the same all along a motion."""
        friction = self.sampled.at_angles(course, _ANGLES[None, ::3])
        return bool(np.allclose(friction, friction[:, :1], rtol=1e-9, atol=0))

    def _check_course(self, course: Conditions) -> None:
        """Refuse a law whose change the steps in time do not resolve."""
        net = self.sampled.net(course)
        law = self.law.from_vector(course.coefficients[0])
        spin = course.omega[0]
        shift, time = _shift(net, law, spin)
        if not shift > _LARGEST_SHIFT:
            return
        not_turned = self.sampled.net(course._replace(turned=0 * course.turned))
        shift_by_time, _ = _shift(not_turned, law, spin)
        if shift_by_time > _LARGEST_SHIFT:
            instant = f"{time:.3g} s after release"
        else:
            instant = f"an angle turned of {spin * time:.3g} rad"
        largest_share = np.abs(np.diff(net)).max() / np.ptp(net, axis=1).max()
        sufficient_rates = [
            rate for rate in _RATES if _shift(net, law, spin, rate)[0] <= _LARGEST_SHIFT
        ]
        if largest_share > _SUDDEN or not sufficient_rates:
            remedy = _GRADUAL
        else:
            remedy = (
                "declare its rate in 1/s in `def quickness(self, time)`; "
                f"{sufficient_rates[0]:g} would do"
            )
        self.refuse(
            f"{self.law.__name__}: friction changes too quickly for the steps in "
            f"time, at {instant} (error of the path about {1000 * shift:.2g} mm); "
            f"{remedy}"
        )


def _course(coefficients: Floats, spin: float) -> Conditions:
    """A motion at constant speed and spin."""
    time = np.arange(0.0, _DURATION, _INTERVAL)
    ones = np.ones_like(time)
    zeros = np.zeros_like(time)
    repeated = np.broadcast_to(coefficients, (len(time), len(coefficients)))
    return Conditions(
        repeated, _SPEED * ones, spin * ones, spin * time, time, zeros, zeros
    )


def _shift(
    net: Floats, law: Law, spin: float, more: float = 0.0
) -> tuple[float, float]:
    """Error of a path in m whose steps in time are those of `dynamics.equations`, with
    `more` quickness than the law declares, and the time at which most of it arises.

    Parameters
    ----------
    net : friction of the stone at the times of `_course`, shape (3, n).
    """
    time = np.arange(net.shape[1]) * _INTERVAL
    ends = _steps(law, spin, more)
    low = time[ends[:-1]]
    high = time[ends[1:]]
    # three Gauss points a step, a rule of the order of the integrator
    nodes, weights = np.polynomial.legendre.leggauss(3)
    instants = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * nodes
    friction = np.array([np.interp(instants, time, part) for part in net])
    by_steps = friction @ weights / 2 * (high - low)
    intervals = (net[:, 1:] + net[:, :-1]) / 2 * _INTERVAL
    by_intervals = np.add.reduceat(intervals, ends[:-1], axis=1)
    error = by_steps - by_intervals
    # as a time of mean friction, in which the stone moves at this speed
    shift = _SPEED * np.abs(np.cumsum(error, 1)).max() / np.abs(net).mean(1).max()
    worst = np.abs(error).max(0).argmax()
    within_worst = net[:, ends[worst] : ends[worst + 1] + 1]
    changes = np.abs(np.diff(within_worst)).max(0)
    return float(shift), float(low[worst] + (changes.argmax() + 1) * _INTERVAL)


def _steps(law: Law, spin: float, more: float) -> list[int]:
    """Ends of the steps, as numbers of times of `_course`."""
    time = np.arange(0.0, _DURATION, _INTERVAL)
    corners = [int(np.ceil(angle / spin / _INTERVAL)) for angle in law.corners]
    turning = abs(spin) * (np.arange(len(time)) < max(corners, default=0))
    rate = _STEP_RATES[0] + _STEP_RATES[1] * (law.quickness(time) + turning + more)
    sizes = np.maximum((1 / rate / _INTERVAL).astype(int), 1)
    last = len(time) - 1
    ends = [0]
    while ends[-1] < last:
        begin = ends[-1]
        corners_ahead = [corner for corner in corners if corner > begin]
        ends.append(min(begin + int(sizes[begin]), last, *corners_ahead))
    return ends


def last_line(path: Path, error: Exception) -> int | None:
    """Number of the last line of the user's file in a traceback."""
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename) == path
    ]
    return lines[-1] if lines else None


def first_line(error: Exception) -> str:
    """An error of the user's code, in one line."""
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}{': ' + text[0] if text else ''}"
