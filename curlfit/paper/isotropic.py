"""Claims about isotropic friction and the load that it causes: Prop. 1-4.

Each is tested on a grid of speeds, spins of both senses and coefficients, under the dynamically
consistent load. States where no load with n >= 0 balances the friction (the stone would tip) are
excluded.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from curlfit.dynamics import law_structure  # noqa: F401  (configures JAX before its first use)
from curlfit.friction import LAWS, LocalLaw, RingPoint, coefficient
from curlfit.friction.family import LawFamily, family_of
from curlfit.friction.isotropic import Coulomb, Power, Stribeck
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.paper.claim import Claim
from curlfit.paper.findings import Curve, DeviationCounts, Example, IsotropicFindings
from curlfit.paper.ring_states import BATCH, STONE, RingStates, grid_states, ring_states


class SpeedMixture(LocalLaw):
    """Friction as a function of the sliding speed, not necessarily monotonic.

    For the "any function" of Prop. 3; without a name, so that it is not among the laws of curlfit.
    """

    level: float = coefficient(0.01, "constant part")
    rise: float = coefficient(0.0, "growth with the speed", unit="s/m")
    drop: float = coefficient(0.0, "part that decays with the speed")
    hump: float = coefficient(0.0, "part that rises and then decays")
    scale: float = coefficient(0.5, "speed of the decay", unit="m/s")

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        """Friction opposite to the sliding velocity, with mu a function of the speed."""
        s = point.speed / self.scale
        decay = jnp.exp(-s)
        mu = self.level + self.rise * point.speed + (self.drop + self.hump * s**2) * decay
        return -mu * point.e_xi, -mu * point.e_eta


Family = type[LawFamily] | None

SPEEDS = np.geomspace(0.05, 4.0, 16)
"""m/s"""
SPINS = np.concatenate([-np.geomspace(0.02, 200.0, 28)[::-1], np.geomspace(0.02, 200.0, 28)])
"""1/s"""
EXPONENTS = (-3.0, -2.0, -1.5, -1.1, -0.9, -0.5, -0.25, 0.5, 1.0, 2.0)
CASES = {
    "i": [(a, b) for a in (0.002, 0.01, 0.03) for b in (0.0005, 0.002, 0.01)],
    "ii": [(a, -b) for a in (0.005, 0.01, 0.02, 0.05) for b in (0.0002, 0.001, 0.004)],
    "iii": [(-a, b) for a in (0.001, 0.005, 0.01) for b in (0.002, 0.01, 0.03)],
}
"""(mu0, mu1) of the cases of Prop. 4, mu1 in s/m."""


def study_isotropic() -> IsotropicFindings:
    """Test Prop. 1-4 on their grids."""
    laws = [law for law in LAWS.values() if issubclass(law, LocalLaw) and law.shipped()]
    family = family_of([*laws, SpeedMixture])
    states_of = partial(grid_states, v=SPEEDS, omega=SPINS, family=family)
    triples = []
    for law in laws:
        defaults = tuple(item.default for item in law.coefficients())
        triples.append(states_of(law, [defaults])[0])
    cosine, handedness, arm = zip(*map(_triple_errors, triples), strict=True)

    coulomb, _ = states_of(Coulomb, [(mu,) for mu in (0.002, 0.01, 0.05, 0.2)])
    powers = {k: states_of(Power, [(mu, k) for mu in (0.002, 0.01, 0.03)]) for k in EXPONENTS}
    largest_exponent = max(k for k, (states, _) in powers.items() if (states.right < 0).any())
    mixture, mixture_values = _random_mixtures(2 * BATCH, family)
    cases = {name: states_of(Stribeck, sets) for name, sets in CASES.items()}
    positive = {name: states.least > 0 for name, (states, _) in cases.items()}
    return IsotropicFindings(
        laws=len(laws),
        triple_states=sum(int(states.exists.sum()) for states in triples),
        orthogonality=max(cosine),
        handedness=min(handedness),
        arm=max(arm),
        coulomb=DeviationCounts.of(coulomb),
        power={k: DeviationCounts.of(states) for k, (states, _) in powers.items()},
        power_example=_leftmost(Power, *powers[largest_exponent]),
        mixture=DeviationCounts.of(mixture),
        mixture_example=_leftmost(SpeedMixture, mixture, mixture_values),
        stribeck={
            name: DeviationCounts.of(states, positive[name]) for name, (states, _) in cases.items()
        },
        negative={
            name: DeviationCounts.of(states, ~positive[name])
            for name, (states, _) in cases.items()
            if (states.exists & ~positive[name]).any()
        },
        stribeck_example=_leftmost(Stribeck, *cases["ii"], where=positive["ii"]),
        curves=_curves(family),
    )


def _triple_errors(states: RingStates) -> tuple[float, float, float]:
    """Largest |cos(T, M_N)|, smallest sine of the angle from T to M_N, error of |M_N| = h |T|."""
    use = states.exists
    t = np.stack([states.t_xi, states.t_eta])[:, use]
    m = np.stack([states.m_xi, states.m_eta])[:, use]
    size, moment = np.hypot(*t), np.hypot(*m)
    cosine = np.abs((t * m).sum(0)) / (size * moment)
    turn = (t[0] * m[1] - t[1] * m[0]) / (size * moment)
    arm = np.abs(moment / (STONE.h * size) - 1)
    return float(cosine.max()), float(turn.min()), float(arm.max())


def _random_mixtures(n: int, family: Family) -> tuple[RingStates, Floats]:
    """Random functions of the speed at random speeds and spins of both senses."""
    random = np.random.default_rng(1)
    level = 10 ** random.uniform(-4, -2, n)
    others = 10 ** random.uniform(-4, -1.5, (3, n)) * (random.random((3, n)) < 0.6)
    values = np.stack([level, *others, 10 ** random.uniform(-1, 0.5, n)], 1)
    v = 10 ** random.uniform(-1, 0.6, n)
    omega = 10 ** random.uniform(-1, 2.3, n) * random.choice([-1.0, 1.0], n)
    return ring_states(SpeedMixture, values, v, omega, family), values


def _leftmost(
    law: type[LocalLaw],
    states: RingStates,
    values: Floats,
    where: Booleans | None = None,
) -> Example:
    """The state of a counter-clockwise stone with the largest force to the left."""
    use = states.exists & (states.omega > 0) if where is None else states.exists & where
    row = int(np.argmin(np.where(use & (states.omega > 0), states.t_xi, np.inf)))
    names = [item.name for item in law.coefficients()]
    return Example(
        dict(zip(names, map(float, values[row]), strict=True)),
        *(
            float(item[row])
            for item in (states.v, states.omega, states.t_xi, states.t_eta, states.least)
        ),
    )


def _curves(family: Family) -> tuple[Curve, ...]:
    sign_changes = np.linspace(29, 50, 211)
    omega = np.union1d(np.geomspace(0.3, 200, 120), [1.0, 10.0, *sign_changes, 100.0])
    selected: list[tuple[str, type[LocalLaw], tuple[float, ...]]] = [
        ("mu = 0.01", Coulomb, (0.01,)),
        ("mu = 0.008 |v|^{-0.5} (Penner)", Power, (0.008, -0.5)),
        ("mu = 0.008 |v|^{-1.5}", Power, (0.008, -1.5)),
        ("(i) mu = 0.01 + 0.002 |v| n0/n", Stribeck, (0.01, 0.002)),
        ("(ii) mu = 0.02 - 0.004 |v| n0/n", Stribeck, (0.02, -0.004)),
        ("(iii) mu = -0.01 + 0.01 |v| n0/n", Stribeck, (-0.01, 0.01)),
    ]
    curves = []
    for label, law, values in selected:
        states, _ = grid_states(law, [values], np.array([2.0]), omega, family)
        curves.append(Curve(label, omega, states.t_xi, states.t_eta, states.least))
    return tuple(curves)


def isotropic_claims(found: IsotropicFindings) -> dict[str, Claim]:
    """Prop. 1-4 and the remark on the last, by id."""
    prop1_holds = found.orthogonality < 1e-8 and found.handedness > 1 - 1e-8 and found.arm < 1e-8
    c = found.coulomb
    n_power, n_slow, n_left = found.power_total
    left_exponents = [k for k, counts in found.power.items() if counts.left]
    right_exponents = [k for k, counts in found.power.items() if not counts.left]
    mixed = found.mixture
    slow_left = sum(counts.slow_left for counts in found.power.values()) + mixed.slow_left
    remark = sum(counts.remark for counts in found.power.values()) + mixed.remark
    left = n_left + mixed.left
    example, other = found.power_example, found.stribeck_example
    one, two, three = (found.stribeck[name] for name in ("i", "ii", "iii"))
    below = found.negative["iii"]
    # the line of eq. 11 meets mu = 0 at v/n = -mu0/mu1
    crossing = {name for name, sets in CASES.items() if all(-a / b > 0 for a, b in sets)}
    prop4_holds = (
        one.left == 0
        and two.slow_left == 0
        and 0 < two.left == two.remark == two.speeds_up
        and three.left == three.states
        and three.speeds_up == 0
    )
    claims = [
        Claim(
            "prop1",
            "T, M_N, k are a right triple; |M_N| = h |T|",
            "for any friction law",
            f"|cos(T, M_N)| <= {found.orthogonality:.0e}, right-handed in all of "
            f"{found.triple_states} states of {found.laws} laws; |M_N|/(h |T|) = 1 within "
            f"{found.arm:.0e}",
            "holds" if prop1_holds else "does not hold",
            "The balance of moments (eq. 8) determines the load; the remainder is the precision of "
            "the solution.",
        ),
        Claim(
            "prop2",
            "constant mu",
            "deviates to the right",
            f"right in {c.states - c.left} of {c.states} states, T_xi = {c.range[0]:.1e} .. "
            f"{c.range[1]:.1e} of the weight",
            "holds" if c.left == 0 and c.range[0] > 0 else "does not hold",
            "Friction loads the front more (n2 > 0), where a counter-clockwise ring slides to "
            "the left and is pushed right; mu from 0.002 to 0.2, spins to 200 1/s of both senses.",
        ),
        Claim(
            "prop3",
            "mu any function of v(A)",
            "right while |eps| < 1; left possible for fast spin, then n1 > 0, n2 < 0, sliding "
            "speeds up",
            f"right in all {n_slow + mixed.slow} states with |eps| < 1; of "
            f"{n_power + mixed.states - n_slow - mixed.slow} faster ones {left} left, all with "
            "n1 > 0, n2 < 0, speeding up",
            "holds" if slow_left == 0 and 0 < left == remark else "does not hold",
            f"Among powers of v, exponents {_comma_separated(left_exponents)} deviate to the left "
            f"beyond |eps| = 1 and {_comma_separated(right_exponents)} never do; so at "
            f"v^{example.coefficients['k']:g}, v = {example.v:.2g} m/s, "
            f"omega = {example.omega:.2g} 1/s: T_xi = {example.t_xi:.1e}, "
            f"T_eta = {example.t_eta:+.1e} of the weight.",
        ),
        Claim(
            "prop4",
            "mu = mu0 + mu1 v/n, eq. 11",
            "(i) right; (ii) right, or left with speeding up if fast; (iii) left, slowing down",
            f"(i) right in {one.states - one.left} of {one.states}; (ii) right in "
            f"{two.slow - two.slow_left} of {two.slow} with |eps| < 1, left in {two.left} faster "
            f"ones, {two.speeds_up} speed up; (iii) left and slowing in {three.left} of "
            f"{three.states}",
            "holds" if prop4_holds else "does not hold",
            "It needs mu > 0 on the whole ring, as in the states counted; where (iii) makes mu "
            f"negative somewhere, {below.states - below.left} of {below.states} states deviate to "
            f"the right; a case of (ii): mu0 = {other.coefficients['mu0']:g}, "
            f"mu1 = {other.coefficients['mu1']:g} s/m, v = {other.v:.2g} m/s, "
            f"omega = {other.omega:.0f} 1/s.",
        ),
        Claim(
            "stribeck",
            "regions of the Stribeck curve, remark on Prop. 4",
            "boundary and EHD friction are cases (i) or (iii), mixed friction (ii); left if the "
            "line of eq. 11 meets mu = 0 at v/n > 0",
            f"lines that meet mu = 0 at v/n > 0: (iii), left in {three.left} of {three.states}, "
            f"but also (ii), right in {two.slow - two.slow_left} of {two.slow} with |eps| < 1",
            "holds with a correction" if prop4_holds and crossing == {"ii", "iii"}
            else "does not hold",
            "The line must also rise: that of mixed friction falls and meets mu = 0 at v/n > 0 as "
            "well. Boundary friction, positive down to v/n = 0, has mu0 > 0 and is case (i); only "
            "EHD friction can be case (iii).",
        ),
    ]  # fmt: skip
    return {claim.id: claim for claim in claims}


def _comma_separated(numbers: list[float]) -> str:
    return ", ".join(f"{number:g}" for number in numbers)
