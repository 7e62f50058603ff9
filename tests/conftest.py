"""The shipped data, its fit, and an integration that shares no code with the program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import curlfit

DATA = Path(__file__).parent.parent / "data" / "jensen_shegelski_2004.csv"
G = 9.81


@pytest.fixture(scope="session")
def eq12() -> curlfit.Throw:
    return curlfit.load_throw(DATA)


@pytest.fixture(scope="session")
def eq12_fit(eq12: curlfit.Throw) -> curlfit.FitResult:
    return curlfit.fit(eq12)


@pytest.fixture(scope="session")
def eq12_posterior(eq12_fit: curlfit.FitResult) -> tuple[curlfit.FitResult, curlfit.Chain]:
    return curlfit.sample(eq12_fit, seed=1)


@dataclass
class Reference:
    """Front-back law on a dense ring, in plain numpy, for scipy's order-8 integrator.

    The ring is cut where the law jumps and where sliding stops, and each piece has `nodes` Gauss
    points crowded toward that place by a cubic map.
    """

    mu: tuple[float, float, float, float]
    R: float = 0.054
    rho: float = 0.1
    h: float | None = None
    nodes: int = 200

    def __post_init__(self) -> None:
        s, w = np.polynomial.legendre.leggauss(self.nodes)
        s, w = (s + 1) / 2, w / 2
        # alpha = pi - pi s^3 on the front half: dense about alpha = pi, where sliding stops
        front = np.pi * (1 - s**3)
        self.alpha = np.concatenate([front, -front])
        self.weight = np.tile(w * 3 * np.pi * s**2, 2) / (2 * np.pi)

    def force(self, v: float, u: float) -> np.ndarray:
        """Force over m g (right, forward) and moment over m g R."""
        alpha = self.alpha if u >= 0 else np.pi - self.alpha
        c, s = np.cos(alpha), np.sin(alpha)
        v_xi, v_eta = -u * s, v + u * c
        speed = np.hypot(v_xi, v_eta)
        front = s > 0
        mu_xi = np.where(front, self.mu[0], self.mu[1])
        mu_eta = np.where(front, self.mu[2], self.mu[3])
        t_xi, t_eta = -mu_xi * v_xi / speed, -mu_eta * v_eta / speed

        def net(load: np.ndarray) -> np.ndarray:
            w = self.weight * load
            return np.array([w @ t_xi, w @ t_eta, w @ (c * t_eta - s * t_xi)])

        if self.h is None:
            return net(np.ones_like(c))
        # eq. 8-9: load 1 + p c + q s with (p, q) = -2 (h/R) T, linear in (p, q)
        even, by_p, by_q = net(np.ones_like(c)), net(c), net(s)
        k = 2 * self.h / self.R
        matrix = np.eye(2) + k * np.stack([by_p[:2], by_q[:2]], 1)
        p, q = np.linalg.solve(matrix, -k * even[:2])
        return even + p * by_p + q * by_q

    def path(self, start: curlfit.Start, times: np.ndarray) -> np.ndarray:
        """x, y, phi at the times, shape (3, n); held after rest."""

        def rates(_: float, state: np.ndarray) -> list[float]:
            _, _, v, beta, _, omega = state
            a_xi, a_eta, moment = G * self.force(v, self.R * omega)
            return [
                v * np.sin(beta), v * np.cos(beta), a_eta, a_xi / v, omega,
                moment * self.R / self.rho**2,
            ]  # fmt: skip

        def rest(_: float, state: np.ndarray) -> float:
            return float(np.hypot(state[2], self.rho * state[5])) - 1e-7

        rest.terminal = True  # type: ignore[attr-defined]
        first = [start.x, start.y, start.v, start.heading, start.phi, start.omega]
        found = solve_ivp(
            rates, (0, times[-1]), first, method="DOP853", rtol=1e-11, atol=1e-13,
            events=rest, dense_output=True,
        )  # fmt: skip
        states = found.sol(np.minimum(times, found.t[-1]))
        return states[[0, 1, 4]]
