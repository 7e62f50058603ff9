"""Motion of a stone by numpy and scipy alone, for comparison with that of curlfit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

G = 9.81


class Ring(NamedTuple):
    """Points of the ring, lengths over R: what a law of the tests is given."""

    alpha: np.ndarray
    xi: np.ndarray
    eta: np.ndarray
    v_xi: np.ndarray
    v_eta: np.ndarray
    speed: np.ndarray
    weight: np.ndarray
    turned: float
    time: float


Traction = Callable[[Ring, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Force per unit normal load (right, forward), from the points and the load n/n0."""


def front_back(
    mu1_xi: float,
    mu2_xi: float,
    mu1_eta: float,
    mu2_eta: float,
) -> Traction:
    def traction(ring: Ring, _: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        front = ring.eta > 0
        mu_xi = np.where(front, mu1_xi, mu2_xi)
        mu_eta = np.where(front, mu1_eta, mu2_eta)
        return -mu_xi * ring.v_xi / ring.speed, -mu_eta * ring.v_eta / ring.speed

    return traction


Rates = Callable[[float, float, float, float], Sequence[float]]
"""Accelerations (right, forward, angular) from speed, spin, angle turned and time."""

Phases = Sequence[tuple[Rates, Callable[[float, float], float] | None]]
"""Accelerations, and the function of (spin, angle turned) that passes zero where they
end."""


class Start(NamedTuple):
    """A state of the stone, its fields named as those of `curlfit.InitialState`."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    v: float = 0.0
    phi: float = 0.0
    omega: float = 0.0


class Accuracy(NamedTuple):
    """Tolerances of a step, and what counts as rest.

    With a relative tolerance of 1e-11 a step over |epsilon| = 1, where friction has a
    kink, may pass for exact and be off by 1e-7, this or that way by the rounding of the
    machine's matrix products.
    """

    relative: float = 1e-13
    absolute: float = 1e-15
    rest: float = 1e-9
    """m/s"""


EXACT = Accuracy()


class Motion(NamedTuple):
    """The motion of a stone until rest: a dense solution for each phase."""

    start: Any
    phases: list[Any]

    @property
    def end(self) -> float:
        """The time of rest, or the last time of the integration."""
        return float(self.phases[-1].t[-1])

    def at(self, times: np.ndarray) -> np.ndarray:
        """x, y, phi, shape (3, n); held after rest."""
        start = np.array([self.start.x, self.start.y, self.start.phi])
        path = np.repeat(start[:, None], len(times), 1)
        for phase in self.phases:
            later = times >= phase.t[0]
            if not later.any():
                break
            inside = np.minimum(times[later], phase.t[-1])
            path[:, later] = phase.sol(inside)[[0, 1, 4]]
        return path


def integrated(
    start: Any,
    until: float,
    phases: Phases,
    inertia: float | None,
    accuracy: Accuracy = EXACT,
) -> Motion:
    """The motion from a start, which has the fields of `Start`.

    Without `inertia` (the radius of gyration) the stone rests when it stops sliding,
    though it may still spin.
    """
    state = np.array([start.x, start.y, start.v, start.heading, start.phi, start.omega])
    now = 0.0
    solutions: list[Any] = []
    for accelerations, end in phases:

        def rates(
            t: float,
            state: np.ndarray,
            accelerations: Rates = accelerations,
        ) -> list[float]:
            _, _, v, beta, phi, omega = state
            a_xi, a_eta, angular = accelerations(v, omega, phi - start.phi, t)
            return [v * np.sin(beta), v * np.cos(beta), a_eta, a_xi / v, omega, angular]

        def rest(_: float, state: np.ndarray) -> float:
            v = state[2]
            if inertia is None:
                return float(v - accuracy.rest)
            u = inertia * abs(state[5])
            moving = np.hypot(v, u) - 100 * accuracy.rest
            # or all but at rest, on the spot, where a heading has no meaning
            elsewhere = max(v - accuracy.rest, u - 2000 * accuracy.rest)
            return float(min(moving, elsewhere))

        def over(
            _: float,
            state: np.ndarray,
            end: Callable[[float, float], float] | None = end,
        ) -> float:
            return 1.0 if end is None else end(state[5], state[4] - start.phi)

        rest.terminal = over.terminal = True  # type: ignore[attr-defined]
        solution = solve_ivp(
            rates,
            (now, until),
            state,
            method="DOP853",
            rtol=accuracy.relative,
            atol=accuracy.absolute,
            events=(rest, over),
            dense_output=True,
        )
        assert solution.success
        solutions.append(solution)
        now = solution.t[-1]
        state = solution.y[:, -1]
        if not len(solution.t_events[1]):
            break
    return Motion(start, solutions)


def follow(
    start: Any,
    times: np.ndarray,
    phases: Phases,
    inertia: float | None,
) -> np.ndarray:
    """x, y, phi at the times, shape (3, n); held after rest (see `integrated`)."""
    return integrated(start, times[-1], phases, inertia).at(times)


_TRIALS = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])  # of the load


@dataclass
class Reference:
    """A local law on a dense ring, in plain numpy, for scipy's order-8 integrator.

    The ring is cut where the law jumps: between the halves and at the polar angles in
    `edges`. Each piece has `nodes` Gauss points crowded by a cubic map toward the place
    where sliding stops. `corner` is the angle turned at which friction changes its
    course.
    """

    traction: Traction
    R: float = 0.054
    rho: float = 0.1
    h: float | None = None
    edges: Callable[[float], Sequence[float]] = lambda turned: ()
    corner: float | None = None
    nodes: int = 200
    accuracy: Accuracy = EXACT

    def __post_init__(self) -> None:
        s, w = np.polynomial.legendre.leggauss(self.nodes)
        self.s = (s + 1) / 2
        self.w = w / 2
        self.points = lru_cache(self.points)  # type: ignore[method-assign]

    def points(self, slow: float, edges: tuple[float, ...]) -> tuple[np.ndarray, ...]:
        """Polar angles, their cosines and sines, and weights."""
        alpha = []
        weight = []
        for half in (1, -1):
            gaps = [abs(abs(edge) - slow) for edge in edges if edge * half > 0]
            # |alpha| is pi s^3 away from the slow place
            ends = [0.0, *sorted((gap / np.pi) ** (1 / 3) for gap in gaps), 1.0]
            for low, high in pairwise(ends):
                s = low + (high - low) * self.s
                alpha.append(half * np.abs(slow - np.pi * s**3))
                weight.append((high - low) * self.w * 3 * s**2 / 2)
        a = np.concatenate(alpha)
        w = np.concatenate(weight)
        return a, np.cos(a), np.sin(a), w

    def ring(self, v: float, u: float, turned: float = 0.0, time: float = 0.0) -> Ring:
        slow = np.pi if u >= 0 else 0.0
        a, xi, eta, w = self.points(slow, tuple(self.edges(turned)))
        v_xi = -u * eta
        v_eta = v + u * xi
        speed = np.hypot(v_xi, v_eta)
        return Ring(a, xi, eta, v_xi, v_eta, speed, w, turned, time)

    def force(
        self,
        v: float,
        u: float,
        turned: float = 0.0,
        time: float = 0.0,
    ) -> np.ndarray:
        """Force over m g (right, forward) and moment over m g R.

        The load (p, q) = -2 (h/R) T of eq. 8-9 is found by Newton's method from
        differences.
        """
        ring = self.ring(v, u, turned, time)
        tilt = np.zeros(2)
        if self.h is None:
            return self.net(ring, tilt)
        size = -2 * self.h / self.R
        force, *moved = self.net(ring, _TRIALS)
        change_of_force = np.array([(other - force)[:2] for other in moved])
        slope = change_of_force.T * (size / _TRIALS[1, 0])
        inverse = np.linalg.inv(np.eye(2) - slope)
        for _ in range(100):
            change = inverse @ (size * force[:2] - tilt)
            if np.abs(change).max() < 1e-14:
                return force
            tilt = tilt + change
            force = self.net(ring, tilt)
        raise AssertionError("the load does not settle")

    def net(self, ring: Ring, tilt: np.ndarray) -> np.ndarray:
        """The same under the load 1 + p xi + q eta, of one or many (p, q) on the last
        axis."""
        p = tilt[..., :1]
        q = tilt[..., 1:]
        load = 1 + p * ring.xi + q * ring.eta
        t_xi, t_eta = self.traction(ring, load)
        n_xi = load * t_xi
        n_eta = load * t_eta
        moment = ring.xi * n_eta - ring.eta * n_xi
        parts = [n_xi @ ring.weight, n_eta @ ring.weight, moment @ ring.weight]
        return np.array(parts).T

    def motion(self, start: Any, until: float) -> Motion:
        """The motion from a start, which has the fields of `Start`."""

        def accelerations(
            v: float,
            omega: float,
            turned: float,
            time: float,
        ) -> Sequence[float]:
            a_xi, a_eta, moment = G * self.force(v, self.R * omega, turned, time)
            return a_xi, a_eta, moment * self.R / self.rho**2

        phases: list = [(accelerations, None)]
        if self.corner is not None:
            corner = self.corner
            phases.insert(0, (accelerations, lambda _, turned: corner - abs(turned)))
        return integrated(start, until, phases, self.rho, self.accuracy)

    def path(self, start: Any, times: np.ndarray) -> np.ndarray:
        """x, y, phi at the times, shape (3, n); held after rest."""
        return self.motion(start, times[-1]).at(times)
