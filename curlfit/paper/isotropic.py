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
from curlfit.inference.model.model import Model
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import in_batches
from curlfit.numerics.compiled import compiled
from curlfit.paper.claim import Judged, judged
from curlfit.paper.printed import RADIUS, Configuration, Counts, eq_12
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
        function: Callable[[Array], Configuration],
    ) -> Callable[[Array], Configuration]:
        return lambda t: jax.jvp(function, (t,), (jnp.ones_like(t),))[1]

    first = derivative(eq_12)
    second = derivative(first)
    third = derivative(second)
    return [first(t), second(t), third(t)]


@cache
def derivatives() -> list[Configuration]:
    """First to third derivative of eq. 12 with respect to time, every 0.1 s on
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
    ax_printed, ay_printed = as_printed(TIMES)
    ax = ax_printed if "x" in printed else second.x
    ay = ay_printed if "y" in printed else second.y
    heading = np.arctan2(first.x, first.y)
    throughout = Motion(
        t=TIMES,
        curvature=first.phi / np.hypot(first.x, first.y),
        xi=ax * np.cos(heading) - ay * np.sin(heading),
        eta=ax * np.sin(heading) + ay * np.cos(heading),
        angular=second.phi,
    )
    rows = round(10 * until) + 1
    return Motion(*(series[:rows] for series in throughout))


def _exponent(values: Floats, scale: float) -> float:
    """Exponent p of values that go as (1 - t/scale)^p."""
    first, second = _SAMPLES
    rest = 1 - TIMES / scale
    return float(
        np.log(values[second] / values[first]) / np.log(rest[second] / rest[first])
    )


def study_path() -> SimpleNamespace:
    """Derivatives of eq. 12, beside those printed and by hand, and the direction
    of the force."""
    t = TIMES
    _, second, third = derivatives()
    rest = 1 - t / 23
    by_hand = Configuration(
        x=-(0.008 - 2.98 * 1.43 * 0.43 / 23**2 * rest**-0.57),
        y=-25 * 1.897 * 0.897 / 23**2 * rest**-0.103,
        phi=-16.58 * 1.455 * 0.455 / 24**2 * (1 - t / 24) ** -0.545,
    )
    relative_errors = [
        np.abs(series - by_jax).max() / np.abs(series).max()
        for series, by_jax in zip(by_hand, second, strict=True)
    ]
    # d2x/dt2 = -(c + kx rest^px): its derivative kx px/23 rest^(px - 1) is a pure
    # power; d2y/dt2 = -ky rest^py is one itself.
    k = _SAMPLES[0]
    px = _exponent(third.x, 23) + 1
    kx = 23 * third.x[k] / (px * rest[k] ** (px - 1))
    c = -second.x[k] - kx * rest[k] ** px
    py = _exponent(second.y, 23)
    ky = -second.y[k] / rest[k] ** py
    ax_printed, ay_printed = as_printed(t)
    moving_frame = motion()
    epsilon = RADIUS * moving_frame.curvature
    return SimpleNamespace(
        t=t,
        ax=second.x,
        ay=second.y,
        ax_printed=ax_printed,
        ay_printed=ay_printed,
        by_hand=max(relative_errors),
        x_form=(c, kx, px),
        y_form=(ky, py),
        sign_change=23 * (1 - (-c / kx) ** (1 / px)),
        ratio=moving_frame.xi / moving_frame.eta,
        limit=epsilon / np.sqrt(1 - epsilon**2),
    )


def eq_13(_studies: Any) -> Judged:
    """Start and end of eq. 12."""
    dx, dy, omega = (float(rate[0]) for rate in derivatives()[0])
    x, y, phi = eq_12(23.0)
    turns = phi / (2 * np.pi)
    surplus = dy / 2 - 1  # of the printed speed, 2 m/s
    start_holds = (round(dx, 1), round(dy), round(omega)) == (0, 2, 1)
    end_holds = (round(-x, 2), round(turns, 1)) == (0.84, 2.6)
    return judged(
        start_holds and end_holds,
        corrected=surplus > 0.01,
        dx=dx,
        dy=dy,
        omega=omega,
        y=y,
        left=-x,
        turns=turns,
        more=100 * surplus,
    )


def eq_14_x(studies: Any) -> Judged:
    """The acceleration across the sheet."""
    c, k, _ = studies.path.x_form
    holds = abs(k + 0.0035) < 1e-4 and abs(c - 0.008) < 1e-6
    return judged(holds, corrected=True, sign="-" if k < 0 else "+", size=abs(k))


def eq_14_y(studies: Any) -> Judged:
    """The acceleration along the sheet."""
    path = studies.path
    k, p = path.y_form
    difference = 100 * abs(path.ay[-1] / path.ay_printed[-1] - 1)  # %, at the end
    holds = round(k, 2) == 0.08 and round(p, 3) == -0.103
    return judged(holds, corrected=True, apart=difference)


def prop_5(studies: Any) -> Judged:
    """No isotropic law causes eq. 12."""
    path = studies.path
    return judged(
        (path.ratio > path.limit).all(),
        corrected=True,
        ice=path.ax / path.ay,
        least=(path.ax_printed / path.ay_printed).min(),
    )


def eq_15_to_17(_studies: Any) -> Judged:
    """Sliding directions on the ring, in the ice frame (dx(A)/dy(A)) and in the
    moving frame."""
    # rows are times, columns points of the ring
    rates = derivatives()[0]
    vx = rates.x[:, None]
    vy = rates.y[:, None]
    spin = RADIUS * rates.phi[:, None]  # speed of rotation, m/s
    epsilon = RADIUS * motion().curvature[:, None]
    angle = np.linspace(-np.pi, np.pi, 721)
    ice = (vx - spin * np.sin(angle)) / (vy + spin * np.cos(angle))
    moving = (-epsilon * np.sin(angle) / (1 + epsilon * np.cos(angle))).max(1)
    size = spin[0, 0] / rates.y[0]
    by_spin = _exponent(rates.phi, 24)
    by_speed = -_exponent(rates.y, 23)
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
        decaying = (self.drop + self.hump * s**2) * decay
        mu = self.level + self.rise * point.speed + decaying
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

        def least_friction(kind: type[LocalLaw], own: tuple[Array, ...]) -> Array:
            friction = kind.from_vector(own)
            least = jnp.asarray(jnp.inf)
            for points, _ in panels(friction, *contact.motion, contact.clustering):
                load = 1 + n1 * points.xi + n2 * points.eta
                right, forward = friction.traction(points._replace(load=load))
                mu = -(right * points.e_xi + forward * points.e_eta)
                least = jnp.minimum(least, mu.min())
            return least

        return RingStates(
            v=v,
            omega=omega,
            t_xi=motion.xi / GRAVITY,
            t_eta=motion.eta / GRAVITY,
            spin_up=motion.angular,
            n1=n1,
            n2=n2,
            least=contact.of_law(least_friction),
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
    rows = np.arange(len(coefficients))
    sets, speeds, spins = np.meshgrid(rows, v, omega, indexing="ij")
    values = np.array(coefficients, float)[sets.ravel()]
    return ring_states(law, values, speeds.ravel(), spins.ravel()), values


def _random_mixtures(n: int) -> tuple[RingStates, Floats]:
    """Random functions of the speed at random speeds and spins of both senses."""
    random = np.random.default_rng(1)
    level = 10 ** random.uniform(-4, -2, n)
    # rise, drop and hump: each absent from two mixtures of five
    parts = 10 ** random.uniform(-4, -1.5, (3, n)) * (random.random((3, n)) < 0.6)
    scale = 10 ** random.uniform(-1, 0.5, n)
    values = np.stack([level, *parts, scale], 1)
    v = 10 ** random.uniform(-1, 0.6, n)
    omega = 10 ** random.uniform(-1, 2.3, n) * random.choice([-1.0, 1.0], n)
    return ring_states(SpeedMixture, values, v, omega), values


def _counts(states: RingStates, where: Any = True) -> Counts:
    """Numbers of states, of those that `where` selects."""
    sense = np.sign(states.omega)
    counted = states.exists & where
    left = counted & (states.right < 0)
    slow = counted & (STONE.R * np.abs(states.omega) / states.v < 1)
    speeds_up = counted & (states.t_eta > 0)
    tilted = (states.n1 * sense > 0) & (states.n2 < 0) & (states.spin_up * sense < 0)
    return Counts(
        states=int(counted.sum()),
        left=int(left.sum()),
        slow=int(slow.sum()),
        slow_left=int((slow & left).sum()),
        speeds_up=int(speeds_up.sum()),
        remark=int((left & speeds_up & tilted).sum()),
    )


def _leftmost(
    law: type[LocalLaw], states: RingStates, values: Floats, where: Any = True
) -> SimpleNamespace:
    """The state of a counter-clockwise stone with the largest force to the left."""
    candidates = states.exists & where & (states.omega > 0)
    row = int(np.argmin(np.where(candidates, states.t_xi, np.inf)))
    names = [coefficient.name for coefficient in law.coefficients()]
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
    # rad/s; dense where the force changes its sign, near eps = 1
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


def prop_1(_studies: Any) -> Judged:
    """The force T and the moment M_N of the load, for every law that acts
    on the ring."""
    grids = []
    for law in _LOCAL:
        defaults = [coefficient.default for coefficient in law.coefficients()]
        states, _ = grid_states(law, [defaults])
        grids.append(np.stack(states)[:, states.exists])
    states = RingStates(*np.concatenate(grids, axis=1))
    # rad; the sum of a linear load is exact
    angle = 2 * np.pi * np.arange(16)[:, None] / 16
    load = 1 + states.n1 * np.cos(angle) + states.n2 * np.sin(angle)
    # eq. 2: r x k n, over the weight
    moment = STONE.R * np.stack([load * np.sin(angle), -load * np.cos(angle)]).mean(1)
    force = np.stack([states.t_xi, states.t_eta])
    force_size = np.hypot(*force)
    moment_size = np.hypot(*moment)
    product = force_size * moment_size
    cosine = (np.abs((force * moment).sum(0)) / product).max()
    sine = ((force[0] * moment[1] - force[1] * moment[0]) / product).min()
    error = np.abs(moment_size / (STONE.h * force_size) - 1).max()
    return judged(
        cosine < 1e-8 and sine > 1 - 1e-8 and error < 1e-8,
        cosine=cosine,
        states=len(states.n1),
        laws=len(_LOCAL),
        error=error,
    )


def prop_2(studies: Any) -> Judged:
    """Constant mu."""
    counts = studies.isotropic.coulomb
    least, _ = studies.isotropic.coulomb_range
    return judged(counts.left == 0 and least > 0, right=counts.states - counts.left)


def prop_3(studies: Any) -> Judged:
    """Any function of the sliding speed: powers, and random mixtures."""
    isotropic = studies.isotropic
    counts_by_law = [*isotropic.power.values(), isotropic.mixture]
    counts = Counts(*(sum(numbers) for numbers in zip(*counts_by_law, strict=True)))
    return judged(
        counts.slow_left == 0 and 0 < counts.left == counts.remark,
        slow=counts.slow,
        faster=counts.states - counts.slow,
        left=counts.left,
        to_left=", ".join(f"{k:g}" for k in isotropic.left_powers),
        to_right=", ".join(f"{k:g}" for k in isotropic.right_powers),
    )


def _prop_4_holds(cases: dict[str, Counts]) -> bool:
    """Whether case (i) deviates to the right, (ii) to the left only where fast, then
    speeding up, and (iii) to the left, slowing down."""
    first = cases["i"]
    second = cases["ii"]
    third = cases["iii"]
    return (
        first.left == 0
        and second.slow_left == 0
        and 0 < second.left == second.remark == second.speeds_up
        and third.left == third.states
        and third.speeds_up == 0
    )


def prop_4(studies: Any) -> Judged:
    """The cases of eq. 11."""
    cases = studies.isotropic.stribeck
    negative = studies.isotropic.negative["iii"]
    return judged(
        _prop_4_holds(cases),
        one=cases["i"].states - cases["i"].left,
        two=cases["ii"].slow - cases["ii"].slow_left,
        below=negative.states - negative.left,
    )


def stribeck(studies: Any) -> Judged:
    """The remark on Prop. 4."""
    cases = studies.isotropic.stribeck
    # the line of eq. 11 meets mu = 0 at v/n = -mu0/mu1
    crossing = {
        name
        for name, lines in CASES.items()
        if all(-mu0 / mu1 > 0 for mu0, mu1 in lines)
    }
    holds = _prop_4_holds(cases) and crossing == {"ii", "iii"}
    slow_to_right = cases["ii"].slow - cases["ii"].slow_left
    return judged(holds, corrected=True, two=slow_to_right)
