"""Forces, load and friction of the ring under consistent load, for arrays of states of motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations_under, contact_of
from curlfit.dynamics.quadrature import panels
from curlfit.dynamics.ring_forces import ring_forces
from curlfit.dynamics.ring_sum import balanced_tilt
from curlfit.friction import Law, LocalLaw
from curlfit.friction.family import LawFamily
from curlfit.inference.model import Model
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import compiled
from curlfit.stone import GRAVITY, Stone

STONE = Stone(R=0.065, h=0.057)
BATCH = 4096
"""States in one call of the compiled program."""

_ANGLES = 2 * np.pi * np.arange(16) / 16  # rad; the sum of a linear load is exact


class RingStates(NamedTuple):
    """The ring under consistent load, by state of motion; NaN where no such load exists."""

    v: Any
    """speed of the centre, m/s"""
    omega: Any
    """spin, 1/s"""
    t_xi: Any
    """force to the right over the weight"""
    t_eta: Any
    """force along the motion over the weight"""
    spin_up: Any
    """angular acceleration, rad/s^2"""
    n1: Any
    """load slope to the right times R over n0 (eq. 9)"""
    n2: Any
    """load slope forward times R over n0"""
    m_xi: Any
    """moment M_N of the load about the axis to the right, over the weight, m"""
    m_eta: Any
    """M_N about the axis along the motion, over the weight, m"""
    least: Any
    """smallest coefficient of friction on the ring"""

    @property
    def exists(self) -> Booleans:
        """Where a consistent load exists."""
        return np.isfinite(self.t_xi)

    @property
    def right(self) -> Floats:
        """Force to the right of a counter-clockwise stone; mirrored for a clockwise one."""
        return self.t_xi * np.sign(self.omega)

    @property
    def epsilon(self) -> Floats:
        """`R |omega|/v`."""
        return STONE.R * np.abs(self.omega) / self.v


@compiled("law")
def _ring(law: type[Law], values: Array, v: Array, omega: Array) -> RingStates:
    def state(values: Array, v: Array, omega: Array) -> RingStates:
        contact = contact_of(law.from_vector(values), STONE, "consistent", v, omega)
        forces = ring_forces(contact)
        motion = accelerations_under(forces, STONE)
        n1, n2 = balanced_tilt(forces, contact.lever)

        def least_friction(law: type[LocalLaw], own: tuple[Array, ...]) -> Array:
            one, least = law.from_vector(own), jnp.asarray(jnp.inf)
            for points, _ in panels(one, *contact.motion, contact.clustering):
                load = 1 + n1 * points.xi + n2 * points.eta
                along_xi, along_eta = one.traction(points._replace(load=load))
                mu = -(along_xi * points.e_xi + along_eta * points.e_eta)
                least = jnp.minimum(least, mu.min())
            return least

        least = contact.of_law(least_friction)
        load = 1 + n1 * np.cos(_ANGLES) + n2 * np.sin(_ANGLES)
        m_xi = STONE.R * (load * np.sin(_ANGLES)).mean()  # eq. 2: r x k n
        m_eta = -STONE.R * (load * np.cos(_ANGLES)).mean()
        return RingStates(
            v, omega, motion.xi / GRAVITY, motion.eta / GRAVITY, motion.angular, n1, n2,
            m_xi, m_eta, least,
        )  # fmt: skip

    return jax.vmap(state)(values, v, omega)


def ring_states(
    law: type[LocalLaw], values: Floats, v: Floats, omega: Floats,
    family: type[LawFamily] | None = None,
) -> RingStates:  # fmt: skip
    """The ring in each of n states.

    Parameters
    ----------
    law : a local law. values : its coefficients, shape (n, coefficients).
    v, omega : speed (m/s) and spin (1/s), shape (n,).
    family : a family that contains the law; its compiled program is then used.
    """
    n, model = len(v), Model(law, "consistent").within(family)
    kind, values = model.of_program.law, model.vector(values)
    batches = []
    for begin in range(0, n, BATCH):
        rows = np.minimum(np.arange(begin, begin + BATCH), n - 1)  # equal shapes, one program
        batches.append(
            [np.asarray(item) for item in _ring(kind, values[rows], v[rows], omega[rows])]
        )
    return RingStates(*(np.concatenate(parts)[:n] for parts in zip(*batches, strict=True)))


def grid_states(
    law: type[LocalLaw],
    coefficients: Sequence[Sequence[float]],
    v: Floats,
    omega: Floats,
    family: type[LawFamily] | None = None,
) -> tuple[RingStates, Floats]:
    """RingStates for every set of coefficients, speed and spin, and the coefficients of each."""
    rows = len(v) * len(omega)
    speeds = np.tile(np.repeat(v, len(omega)), len(coefficients))
    spins = np.tile(omega, len(v) * len(coefficients))
    values = np.repeat(np.array(coefficients, float), rows, axis=0)
    return ring_states(law, values, speeds, spins, family), values
