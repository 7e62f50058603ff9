"""The trajectory of eq. 12, and isotropic friction with the load that it causes: eq.
13-17, Prop. 1-5.

Prop. 1-4 are tested on a grid of speeds, spins of both senses and coefficients, under
the dynamically consistent load. States where no load with n >= 0 balances the friction
(the stone would tip) are excluded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations_under, contact_of
from curlfit.dynamics.quadrature import panels
from curlfit.dynamics.ring_forces import ring_forces
from curlfit.dynamics.ring_sum import balanced_tilt
from curlfit.friction import LAWS, Law, Load, LocalLaw, RingPoint, coefficient
from curlfit.friction.family import family_of
from curlfit.friction.isotropic import Coulomb, Power, Stribeck
from curlfit.friction.sums import Sum
from curlfit.inference.model import Model
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import in_batches
from curlfit.numerics.compiled import compiled
from curlfit.paper.claim import Judged, judged
from curlfit.paper.printed import RADIUS, Configuration, eq_12
from curlfit.stone import GRAVITY, Stone

TIMES = np.arange(201) / 10
_SAMPLES = (20, 110)
"""Two of the times, from which coefficients and exponents are computed."""

STONE = Stone(R=RADIUS, h=0.057)
BATCH = 4096
"""States in one call of the compiled program."""
SPEEDS = np.geomspace(0.05, 4.0, 16)
"""m/s"""
SPINS = np.concatenate(
    [-np.geomspace(0.02, 200.0, 28)[::-1], np.geomspace(0.02, 200.0, 28)]
)
"""1/s"""
EXPONENTS = (-3.0, -2.0, -1.5, -1.1, -0.9, -0.5, -0.25, 0.5, 1.0, 2.0)
CASES = {
    "i": [(a, b) for a in (0.002, 0.01, 0.03) for b in (0.0005, 0.002, 0.01)],
    "ii": [(a, -b) for a in (0.005, 0.01, 0.02, 0.05) for b in (0.0002, 0.001, 0.004)],
    "iii": [(-a, b) for a in (0.001, 0.005, 0.01) for b in (0.002, 0.01, 0.03)],
}
"""(mu0, mu1) of the cases of Prop. 4, mu1 in s/m."""
CURVES: list[tuple[str, type[LocalLaw], tuple[float, ...]]] = [
    (r"$\mu = 0.01$", Coulomb, (0.01,)),
    (r"$\mu = 0.008\,|v|^{-0.5}$ (Penner)", Power, (0.008, -0.5)),
    (r"$\mu = 0.008\,|v|^{-1.5}$", Power, (0.008, -1.5)),
    (r"(i) $\mu = 0.01 + 0.002\,|v|\,n_0/n$", Stribeck, (0.01, 0.002)),
    (r"(ii) $\mu = 0.02 - 0.004\,|v|\,n_0/n$", Stribeck, (0.02, -0.004)),
    (r"(iii) $\mu = -0.01 + 0.01\,|v|\,n_0/n$", Stribeck, (-0.01, 0.01)),
]


class Motion(NamedTuple):
    """Motion by eq. 12 at times of shape (n,)."""

    t: Floats
    curvature: Floats
    """omega/v in 1/m: eps is R times it"""
    xi: Floats
    """acceleration to the right of the motion, m/s^2 (a left side of eq. 24)"""
    eta: Floats
    """acceleration along the motion, m/s^2"""
    angular: Floats
    """rad/s^2"""


@compiled()
def _derivatives(t: Array) -> list[Configuration]:
    def derivative(
        of: Callable[[Array], Configuration],
    ) -> Callable[[Array], Configuration]:
        return lambda t: jax.jvp(of, (t,), (jnp.ones_like(t),))[1]

    first = derivative(eq_12)
    second = derivative(first)
    return [first(t), second(t), derivative(second)(t)]


@cache
def derivatives() -> list[Configuration]:
    """Of eq. 12 with respect to time, of order 1 to 3, every 0.1 s on
    0..20 s, by JAX."""
    return jax.tree.map(np.asarray, _derivatives(TIMES))


def as_printed(t: Floats) -> tuple[Floats, Floats]:
    """Eq. 14 as printed: d2x/dt2 and d2y/dt2 in m/s^2, at times in s."""
    rest = 1 - t / 23
    return -(0.008 + 0.0035 * rest**-0.57), -0.08 * rest**-0.013


def motion(until: float = 20.0, *, printed: str = "") -> Motion:
    """Motion by eq. 12; the accelerations named in `printed` are those of eq. 14.

    `printed` is "", "x" (the wrong sign) or "xy" (also the wrong exponent).
    """
    first, second, _ = derivatives()
    ax, ay = (
        of_print if name in printed else right
        for name, of_print, right in zip("xy", as_printed(TIMES), second, strict=False)
    )
    beta = np.arctan2(first.x, first.y)
    xi, eta = (
        ax * np.cos(beta) - ay * np.sin(beta),
        ax * np.sin(beta) + ay * np.cos(beta),
    )
    rows = slice(round(10 * until) + 1)
    found = TIMES, first.phi / np.hypot(first.x, first.y), xi, eta, second.phi
    return Motion(*(values[rows] for values in found))


def _exponent(values: Floats, scale: float) -> float:
    """Exponent p of values that go as (1 - t/scale)^p."""
    rest, some = 1 - TIMES[[*_SAMPLES]] / scale, values[[*_SAMPLES]]
    return float(np.log(some[1] / some[0]) / np.log(rest[1] / rest[0]))


def study_path() -> SimpleNamespace:
    """Derivatives of eq. 12, beside those printed and by hand, and the direction
    of the force."""
    t, now, (_, second, third) = TIMES, motion(), derivatives()
    rest, left, k = 1 - t / 23, 1 - t / 24, _SAMPLES[0]
    by_hand = (
        -(0.008 - 2.98 * 1.43 * 0.43 / 23**2 * rest**-0.57),
        -25 * 1.897 * 0.897 / 23**2 * rest**-0.103,
        -16.58 * 1.455 * 0.455 / 24**2 * left**-0.545,
    )
    errors = (
        np.abs(one - by_jax).max() / np.abs(one).max()
        for one, by_jax in zip(by_hand, second, strict=True)
    )
    # d2x/dt2 = -(c + k (1 - t/23)^p), whose derivative is a pure power; d2y/dt2
    # is one itself.
    px, py = _exponent(third.x, 23) + 1, _exponent(second.y, 23)
    kx = 23 * third.x[k] / (px * rest[k] ** (px - 1))
    c = -second.x[k] - kx * rest[k] ** px
    ax_printed, ay_printed = as_printed(t)
    epsilon = RADIUS * now.curvature
    return SimpleNamespace(
        t=t,
        ax=second.x,
        ay=second.y,
        ax_printed=ax_printed,
        ay_printed=ay_printed,
        by_hand=max(errors),
        x_form=(c, kx, px),
        y_form=(-second.y[k] / rest[k] ** py, py),
        sign_change=23 * (1 - (-c / kx) ** (1 / px)),
        ratio=now.xi / now.eta,
        limit=epsilon / np.sqrt(1 - epsilon**2),
    )


def eq_13(_found: Any) -> Judged:
    """Start and end of eq. 12."""
    dx, dy, omega = (float(part[0]) for part in derivatives()[0])
    x, y, phi = eq_12(23.0)
    turns, surplus = phi / (2 * np.pi), dy / 2 - 1
    start = (round(dx, 1), round(dy), round(omega)) == (0, 2, 1)
    return judged(
        start and (round(-x, 2), round(turns, 1)) == (0.84, 2.6),
        corrected=surplus > 0.01,
        dx=dx,
        dy=dy,
        omega=omega,
        y=y,
        left=-x,
        turns=turns,
        more=100 * surplus,
    )


def eq_14_x(found: Any) -> Judged:
    """The acceleration across the sheet."""
    c, k, _ = found.path.x_form
    holds = abs(k + 0.0035) < 1e-4 and abs(c - 0.008) < 1e-6
    return judged(holds, corrected=True, sign="-" if k < 0 else "+", size=abs(k))


def eq_14_y(found: Any) -> Judged:
    """The acceleration along the sheet."""
    path, (k, p) = found.path, found.path.y_form
    apart = 100 * abs(path.ay[-1] / path.ay_printed[-1] - 1)
    return judged(
        round(k, 2) == 0.08 and round(p, 3) == -0.103, corrected=True, apart=apart
    )


def prop_5(found: Any) -> Judged:
    """No isotropic law causes eq. 12."""
    path = found.path
    least = (path.ax_printed / path.ay_printed).min()
    return judged(
        (path.ratio > path.limit).all(),
        corrected=True,
        ice=path.ax / path.ay,
        least=least,
    )


def eq_15_to_17(_found: Any) -> Judged:
    """Sliding directions on the ring, in the ice frame (dx(A)/dy(A)) and in the
    moving frame."""
    first, angle = derivatives()[0], np.linspace(-np.pi, np.pi, 721)
    spin, epsilon = RADIUS * first.phi[:, None], RADIUS * motion().curvature[:, None]
    ice = (first.x[:, None] - spin * np.sin(angle)) / (
        first.y[:, None] + spin * np.cos(angle)
    )
    moving = (-epsilon * np.sin(angle) / (1 + epsilon * np.cos(angle))).max(1)
    size = spin[0, 0] / first.y[0]
    by_spin, by_speed = _exponent(first.phi, 24), -_exponent(first.y, 23)
    bound = size * (1 - TIMES / 24) ** by_spin * (1 - TIMES / 23) ** by_speed
    holds = (ice.max(1) <= bound).all() and bound.max() <= 0.09 and moving.min() > 0.01
    return judged(
        holds,
        corrected=True,
        size=size,
        by_spin=by_spin,
        by_speed=by_speed,
        bound=bound[-1],
        moving=moving,
        least=moving.min(),
    )


class SpeedMixture(LocalLaw):
    """Friction as a function of the sliding speed, not necessarily monotonic.

    For the "any function" of Prop. 3; without a name, so that it is not among the
    laws of curlfit.
    """

    level: float = coefficient(0.01, "constant part")
    rise: float = coefficient(0.0, "growth with the speed", unit="s/m")
    drop: float = coefficient(0.0, "part that decays with the speed")
    hump: float = coefficient(0.0, "part that rises and then decays")
    scale: float = coefficient(0.5, "speed of the decay", unit="m/s")

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        """Friction opposite to the sliding velocity, with mu a function
        of the speed."""
        s = point.speed / self.scale
        decay = jnp.exp(-s)
        mu = (
            self.level
            + self.rise * point.speed
            + (self.drop + self.hump * s**2) * decay
        )
        return -mu * point.e_xi, -mu * point.e_eta


_LOCAL = [
    law
    for law in LAWS.values()
    if issubclass(law, LocalLaw) and "Ivanov" in law.source and not issubclass(law, Sum)
]
"""The laws of the ring that the paper has or cites."""
_FAMILY = family_of([*_LOCAL, SpeedMixture])  # one compiled program serves them all


class RingStates(NamedTuple):
    """The ring under consistent load, by state of motion; NaN where no such
    load exists."""

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
    least: Any
    """smallest coefficient of friction on the ring"""

    @property
    def exists(self) -> Booleans:
        """Where a consistent load exists."""
        return np.isfinite(self.t_xi)

    @property
    def right(self) -> Floats:
        """Force to the right of a counter-clockwise stone; mirrored for a
        clockwise one."""
        return self.t_xi * np.sign(self.omega)


@compiled("law")
def _ring(law: type[Law], values: Array, v: Array, omega: Array) -> RingStates:
    def state(values: Array, v: Array, omega: Array) -> RingStates:
        contact = contact_of(law.from_vector(values), STONE, Load.CONSISTENT, v, omega)
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

        force = motion.xi / GRAVITY, motion.eta / GRAVITY
        return RingStates(
            v, omega, *force, motion.angular, n1, n2, contact.of_law(least_friction)
        )

    return jax.vmap(state)(values, v, omega)


def ring_states(
    law: type[LocalLaw], values: Floats, v: Floats, omega: Floats
) -> RingStates:
    """The ring in each of n states: a local law with coefficients of shape (n,
    coefficients), speed (m/s) and spin (1/s) of shape (n,)."""
    model = Model(law, Load.CONSISTENT).within(_FAMILY)
    program = partial(_ring, model.of_program.law)
    return in_batches(program, (model.vector(values), v, omega), BATCH)


def grid_states(
    law: type[LocalLaw],
    coefficients: Sequence[Sequence[float]],
    v: Floats = SPEEDS,
    omega: Floats = SPINS,
) -> tuple[RingStates, Floats]:
    """RingStates for every set of coefficients, speed and spin, and the
    coefficients of each."""
    sets, speeds, spins = (
        grid.ravel()
        for grid in np.meshgrid(range(len(coefficients)), v, omega, indexing="ij")
    )
    values = np.array(coefficients, float)[sets]
    return ring_states(law, values, speeds, spins), values


def _random_mixtures(n: int) -> tuple[RingStates, Floats]:
    """Random functions of the speed at random speeds and spins of both senses."""
    random = np.random.default_rng(1)
    level = 10 ** random.uniform(-4, -2, n)
    others = 10 ** random.uniform(-4, -1.5, (3, n)) * (random.random((3, n)) < 0.6)
    values = np.stack([level, *others, 10 ** random.uniform(-1, 0.5, n)], 1)
    v = 10 ** random.uniform(-1, 0.6, n)
    omega = 10 ** random.uniform(-1, 2.3, n) * random.choice([-1.0, 1.0], n)
    return ring_states(SpeedMixture, values, v, omega), values


def _counts(states: RingStates, where: Any = True) -> SimpleNamespace:
    """Numbers of existing states: all, deviating to the left (for counter-clockwise
    spin), slow (|eps| < 1, the instant centre of velocities outside the base), speeding
    up, and as the remark on Prop. 3 says."""
    sense = np.sign(states.omega)
    every = states.exists & where
    left, speeds_up = every & (states.right < 0), every & (states.t_eta > 0)
    slow = every & (STONE.R * np.abs(states.omega) / states.v < 1)
    tilted = (states.n1 * sense > 0) & (states.n2 < 0) & (states.spin_up * sense < 0)
    rows = {
        "states": every,
        "left": left,
        "slow": slow,
        "slow_left": slow & left,
        "speeds_up": speeds_up,
        "remark": left & speeds_up & tilted,
    }
    return SimpleNamespace(**{name: int(chosen.sum()) for name, chosen in rows.items()})


def _leftmost(
    law: type[LocalLaw], states: RingStates, values: Floats, where: Any = True
) -> SimpleNamespace:
    """The state of a counter-clockwise stone with the largest force to the left."""
    use = states.exists & where & (states.omega > 0)
    row = int(np.argmin(np.where(use, states.t_xi, np.inf)))
    names = [item.name for item in law.coefficients()]
    return SimpleNamespace(
        coefficients=dict(zip(names, map(float, values[row]), strict=True)),
        **{name: float(series[row]) for name, series in states._asdict().items()},
    )


def study_isotropic() -> SimpleNamespace:
    """Test Prop. 2-4 on their grids, with curves of the force against the
    spin at 2 m/s."""
    coulomb, _ = grid_states(Coulomb, [(mu,) for mu in (0.002, 0.01, 0.05, 0.2)])
    powers = {
        k: grid_states(Power, [(mu, k) for mu in (0.002, 0.01, 0.03)])
        for k in EXPONENTS
    }
    power = {k: _counts(states) for k, (states, _) in powers.items()}
    left = [k for k, counts in power.items() if counts.left]
    mixture, mixture_values = _random_mixtures(2 * BATCH)
    cases = {name: grid_states(Stribeck, sets) for name, sets in CASES.items()}
    omega = np.union1d(
        np.geomspace(0.3, 200, 120), [1.0, 10.0, *np.linspace(29, 50, 211), 100.0]
    )
    curves = []
    for label, law, values in CURVES:
        states, _ = grid_states(law, [values], np.array([2.0]), omega)
        curves.append((label, omega, states.t_xi, states.t_eta, states.least))
    right = coulomb.right[coulomb.exists]
    return SimpleNamespace(
        speeds=SPEEDS,
        spins=SPINS,
        cases=CASES,
        curves=curves,
        coulomb=_counts(coulomb),
        coulomb_range=(right.min(), right.max()),
        power=power,
        left_powers=left,
        right_powers=[k for k in EXPONENTS if k not in left],
        mixture=_counts(mixture),
        stribeck={
            name: _counts(states, states.least > 0)
            for name, (states, _) in cases.items()
        },
        negative={
            name: _counts(states, states.least <= 0)
            for name, (states, _) in cases.items()
        },
        power_example=_leftmost(Power, *powers[max(left)]),
        mixture_example=_leftmost(SpeedMixture, mixture, mixture_values),
        stribeck_example=_leftmost(
            Stribeck, *cases["ii"], where=cases["ii"][0].least > 0
        ),
    )


def prop_1(_found: Any) -> Judged:
    """The force T and the moment M_N of the load, for every law that acts
    on the ring."""
    triples = []
    for law in _LOCAL:
        states, _ = grid_states(law, [[item.default for item in law.coefficients()]])
        triples.append(np.stack(states)[:, states.exists])
    n0_xi, n0_eta, n1, n2 = np.concatenate(triples, axis=1)[[2, 3, 5, 6]]
    # rad; the sum of a linear load is exact
    angle = 2 * np.pi * np.arange(16)[:, None] / 16
    load = 1 + n1 * np.cos(angle) + n2 * np.sin(angle)
    # eq. 2: r x k n, over the weight
    moment = STONE.R * np.stack([load * np.sin(angle), -load * np.cos(angle)]).mean(1)
    force = np.stack([n0_xi, n0_eta])
    size, arm = np.hypot(*force), np.hypot(*moment)
    cosine = (np.abs((force * moment).sum(0)) / (size * arm)).max()
    turn = ((force[0] * moment[1] - force[1] * moment[0]) / (size * arm)).min()
    error = np.abs(arm / (STONE.h * size) - 1).max()
    return judged(
        cosine < 1e-8 and turn > 1 - 1e-8 and error < 1e-8,
        cosine=cosine,
        states=len(n1),
        laws=len(_LOCAL),
        error=error,
    )


def prop_2(found: Any) -> Judged:
    """Constant mu."""
    c, (least, _) = found.isotropic.coulomb, found.isotropic.coulomb_range
    return judged(c.left == 0 and least > 0, right=c.states - c.left)


def prop_3(found: Any) -> Judged:
    """Any function of the sliding speed: powers, and random mixtures."""
    all_counts = [*found.isotropic.power.values(), found.isotropic.mixture]
    states, slow, left, slow_left, remark = (
        sum(getattr(counts, name) for counts in all_counts)
        for name in ("states", "slow", "left", "slow_left", "remark")
    )
    to_left, to_right = (
        ", ".join(f"{k:g}" for k in exponents)
        for exponents in (found.isotropic.left_powers, found.isotropic.right_powers)
    )
    return judged(
        slow_left == 0 and 0 < left == remark,
        slow=slow,
        faster=states - slow,
        left=left,
        to_left=to_left,
        to_right=to_right,
    )


def _prop_4_holds(one: Any, two: Any, three: Any) -> bool:
    left = one.left == two.slow_left == 0 < two.left == two.remark == two.speeds_up
    return bool(left and three.left == three.states and three.speeds_up == 0)


def prop_4(found: Any) -> Judged:
    """The cases of eq. 11."""
    one, two, three = found.isotropic.stribeck.values()
    below = found.isotropic.negative["iii"]
    return judged(
        _prop_4_holds(one, two, three),
        one=one.states - one.left,
        two=two.slow - two.slow_left,
        below=below.states - below.left,
    )


def stribeck(found: Any) -> Judged:
    """The remark on Prop. 4."""
    one, two, three = found.isotropic.stribeck.values()
    # the line of eq. 11 meets mu = 0 at v/n = -mu0/mu1
    crossing = {
        name for name, sets in CASES.items() if all(-a / b > 0 for a, b in sets)
    }
    holds = _prop_4_holds(one, two, three) and crossing == {"ii", "iii"}
    return judged(holds, corrected=True, two=two.slow - two.slow_left)
