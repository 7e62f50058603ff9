"""Each law: its path by an independent integration, its derivatives, its closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import G, Reference, follow, front_back

from curlfit import LAWS, Start, Stone, simulate
from curlfit.contact import accelerations, consistent_load

STONE = Stone(R=0.065, rho=0.1, h=0.057)


def against(mu):
    """Friction against sliding, its coefficient a function of the ring and the load."""

    def traction(ring, load):
        over = mu(ring, load) / ring.speed
        return -over * ring.v_xi, -over * ring.v_eta

    return traction


def debris(mu_clean, mu_dirty, tau=0.0):
    def mu(ring, _):
        # Turned back to where the front half was at release, then round with the stone.
        round_ = np.mod(ring.alpha if ring.turned >= 0 else np.pi - ring.alpha, 2 * np.pi)
        fouled = round_ < np.pi + abs(ring.turned)
        share = 1 - np.exp(-ring.time / tau) if tau > 0 else 1.0
        return np.where(fouled, mu_clean + share * (mu_dirty - mu_clean), mu_clean)

    return against(mu)


def radial(mu1, mu2, mu3, mu4):
    def traction(ring, _):
        # v = a n + b tau, n = (cos, sin), tau = (-sin, cos)
        c, s = ring.xi, ring.eta
        a, b = ring.v_xi * c + ring.v_eta * s, ring.v_eta * c - ring.v_xi * s
        a = np.where(s > 0, mu1, mu2) * a
        b = np.where(s > 0, mu3, mu4) * b
        return -(a * c - b * s) / ring.speed, -(a * s + b * c) / ring.speed

    return traction


def tensor(b11, b22, b12):
    def traction(ring, _):
        force = -np.array([[b11, b12], [b12, b22]]) @ np.stack([ring.v_xi, ring.v_eta])
        return force / ring.speed

    return traction


FORMULAS = {
    "coulomb": lambda mu: against(lambda ring, load: mu),
    "power": lambda c, k: against(lambda ring, load: c * (ring.speed**2 + 1e-6) ** (k / 2)),
    "pressure": lambda mu0, k: against(lambda ring, load: mu0 / load**k),
    "angular": lambda mu0, f0: against(lambda ring, load: mu0 * (1 - f0 * np.sin(ring.alpha))),
    "stribeck": lambda mu0, mu1: against(lambda ring, load: mu0 + mu1 * ring.speed / load),
    "debris": debris,
    "radial": radial,
    "tensor": tensor,
    "front-back": front_back,
}


def reference(name, values, load, stone=STONE):
    more = {}
    if name == "debris":
        more["edges"] = lambda turned: (
            () if abs(turned) >= np.pi else (turned - np.pi if turned >= 0 else turned,)
        )
        more["corner"] = np.pi
    return Reference(
        FORMULAS[name](*values), stone.R, stone.rho, stone.h if load == "consistent" else None,
        **more,
    )  # fmt: skip


def places(path):
    return np.stack([path.x, path.y, path.phi])


def semi_empirical_path(values, start, times):
    a, c, p, q, r = values
    sense = np.sign(start.omega)

    def spinning(v, *_):
        v = abs(v)
        return -a * sense, -c * v**p, -q * v**r * sense

    def sliding(v, *_):
        return 0.0, -c * abs(v) ** p, 0.0

    return follow(start, times, [(spinning, lambda omega, _: omega * sense), (sliding, None)], None)
