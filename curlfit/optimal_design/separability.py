"""Separability of two coefficients of which a trajectory determines the sum.

For `mu1_eta` and `mu2_eta` of the front-back law this is the question that Ivanov and
Shuvalov (2012) leave open. Under uniform load no throw separates them: see `HIDDEN`.
Under the consistent load (eq. 8-9) the front carries more, so the difference changes
the deceleration slightly, and a change of the sum compensates nearly all of it. The
remainder depends on the spin, and on how much this compensation differs between two
throws: it differs for two stones with different heights of the centre of mass, which
together separate the coefficients. (A non-uniform load fixed to the stone would rotate
with it; it is not modelled.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import jax
import numpy as np
from jax import Array

from curlfit.dynamics.contact import accelerations
from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.friction import Law, Load
from curlfit.numerics.arrays import Floats
from curlfit.numerics.compiled import compiled
from curlfit.optimal_design.information import Assumptions, PlannedThrow
from curlfit.optimal_design.result import LoadScenario, Proof, Separation, StoneChange
from curlfit.optimal_design.selection import (
    CandidateSet,
    combined,
    error_criterion,
    select_design,
    standard_error,
)
from curlfit.stone import GRAVITY, Stone

HIDDEN = (
    "Why (eq. 16, 25-26): the ring points at alpha and -alpha, one in front and "
    "one behind, have the same xi = R cos(alpha), the same v_eta = v + omega "
    "xi and the same sliding speed, and under uniform load the same weight. "
    "So int v_eta/|v| dalpha (in T_eta) and int xi v_eta/|v| dalpha (in M) are equal "
    "over both halves, whatever v and omega are, and multiply only mu1_eta + mu2_eta; "
    "T_xi contains neither. The motion is the same for every division of that sum, "
    "and no precision, no number of throws and no R, rho or h changes this"
)
_STATES = 400
_SLOWEST, _FASTEST, _MAX_SPIN = 0.01, 4.0, 60.0  # m/s, m/s, rad/s of the random states
_PROOF = tuple(
    (v0, omega0) for v0 in (1.5, 2.0, 2.5) for omega0 in (-1.0, 0.5, 3.0, 10.0)
)
_PROOF_RATE = 10.0  # Hz
_ORDINARY = (2.0, 1.0)  # m/s, rad/s: a draw
_ROUNDING = 1e-9  # of the largest singular value: an undetermined direction
# relative difference below which the compensations of two throws are equal
_EQUAL_RATIOS = 1e-9
_NO_EFFECT = 1e-12  # relative to the effect of the sum: rounding error
_CHANGES = (
    ("h", 0.5),
    ("h", 1.5),
    ("h", 2.0),
    ("h", 3.0),
    ("R", 0.75),
    ("R", 1.25),
    ("rho", 0.75),
    ("rho", 1.25),
)


class CoefficientPair:
    """Two coefficients of a law that are to be separated, with their sum
    and difference.

    Raises
    ------
    InputError : a name that is not of a free coefficient, equal names, different units,
        or both values zero.
    """

    def __init__(self, assumed: Assumptions, pair: Sequence[str]) -> None:
        law, items = assumed.law, assumed.law.coefficients()
        values = dict(
            zip([item.name for item in items], assumed.values.tolist(), strict=True)
        )
        units = {item.name: item.unit for item in items if item.name in assumed.names}
        if len(pair) != 2 or pair[0] == pair[1]:
            raise InputError(
                "separate: expected two different coefficients, such as mu1_eta,mu2_eta"
            )
        for name in pair:
            if name not in units:
                raise InputError(
                    f"separate: law {law.name} has no free coefficient "
                    f"{quoted(name)}; it has " + ", ".join(units)
                )
        self.names = one, other = pair[0], pair[1]
        if units[one] != units[other]:
            raise InputError(
                f"separate: {one} ({units[one]}) and {other} ({units[other]}) have "
                "different units, and no difference"
            )
        self.difference = assumed.weights({one: 1.0, other: -1.0})
        self.sum = assumed.weights({one: 1.0, other: 1.0})
        a, b = values[one], values[other]
        self.total, differ = a + b, abs(a - b) > 1e-9 * (abs(a) + abs(b))
        self.of, self.size = (
            ("difference", abs(a - b)) if differ else ("mean", abs(a + b) / 2)
        )
        if not self.size > 0:
            raise InputError(
                f"separate: {one} and {other} are both zero; --set them, "
                "so that an error can be relative to them"
            )

    def tolerated_change(
        self, factors: Sequence[Floats], required: float
    ) -> float | None:
        """Relative change of the sum between throws with the same effect as the
        required error of the difference; None if no change has it."""
        _, singular, right = np.linalg.svd(np.stack(factors))
        if (singular[:, -1] < _ROUNDING * singular[:, 0]).any():
            return None
        # the change of the sum that compensates a unit difference, from a column of
        # the covariance
        column = (((right @ self.difference) / singular**2)[:, None] @ right)[:, 0]
        ratios = (column @ self.sum) / (column @ self.difference)
        spread = float(np.ptp(ratios))
        if spread < _EQUAL_RATIOS * np.abs(ratios).max():
            return None
        return spread * required * self.size / abs(self.total)


@compiled("law")
def _force_derivative(
    law: type[Law],
    coefficients: Array,
    along: Array,
    stone: Stone,
    v: Array,
    omega: Array,
) -> Any:
    """Derivative of force and moment along a direction of the coefficients,
    uniform load."""

    def force(coefficients: Array) -> Any:
        return accelerations(law.from_vector(coefficients), stone, "uniform", v, omega)

    return jax.jvp(force, (coefficients,), (along,))[1]


def prove_unidentifiable(
    assumed: Assumptions, pair: CoefficientPair, stone: Stone, factors: Sequence[Floats]
) -> Proof:
    """The largest effects of difference and sum under uniform load.

    Parameters
    ----------
    factors : R factors of the information of various throws under uniform load.
    """
    random = np.random.default_rng(2012)
    v = random.uniform(_SLOWEST, _FASTEST, _STATES)
    omega = random.uniform(-_MAX_SPIN, _MAX_SPIN, _STATES)
    units = np.array([1.0, 1.0, stone.rho**2 / stone.R]) / GRAVITY
    bodies = jax.tree.map(lambda value: np.asarray(float(value)), stone)

    def largest(weights: Floats) -> tuple[float, ...]:
        along = np.zeros_like(assumed.values)
        along[assumed.free] = weights / assumed.typical
        found = _force_derivative(assumed.law, assumed.values, along, bodies, v, omega)
        return tuple((units * np.abs(found).max(1)).tolist())

    by_difference, by_sum, whole = (
        largest(pair.difference),
        largest(pair.sum),
        combined(factors),
    )
    hidden = max(by_difference) < _NO_EFFECT * max(by_sum)
    hidden &= standard_error(whole, pair.difference) is None
    is_front_back = assumed.law.name == "front-back" and set(pair.names) == {
        "mu1_eta",
        "mu2_eta",
    }
    singular = np.linalg.svd(whole, compute_uv=False).tolist()
    return Proof(
        _STATES,
        by_difference,
        by_sum,
        len(factors),
        tuple(singular),
        hidden,
        HIDDEN if is_front_back and hidden else "",
    )


def analyse_separation(
    by_load: Mapping[Load, Assumptions],
    pair: CoefficientPair,
    candidates: Sequence[PlannedThrow],
    throws: int,
    required: float,
) -> Separation:
    """What it takes to separate two coefficients.

    Parameters
    ----------
    by_load : an exact law under each load.
    candidates, throws : candidates, and number of throws.
    required : relative error.
    """
    stone = candidates[0].stone
    varied = [PlannedThrow(v0, omega0, _PROOF_RATE, stone) for v0, omega0 in _PROOF]
    uniform, consistent = by_load["uniform"], by_load["consistent"]
    proof = prove_unidentifiable(uniform, pair, stone, uniform.factors(varied))
    scenarios = []
    for load, assumed in by_load.items():
        factors = assumed.factors(candidates)
        scenarios.append(_load_scenario(pair, load, factors, throws, required))

    def strangeness(one: PlannedThrow) -> float:
        v0, omega0 = _ORDINARY
        return abs(math.log(one.v0 / v0)) + abs(abs(one.omega0) - omega0)

    ordinary = min(candidates, key=strangeness)
    best = scenarios[-1].throws
    changes = []
    for name, factor in _CHANGES if best is not None else ():
        value = factor * getattr(stone, name)
        other = stone.with_values({name: value})
        made = [*(candidates[index] for index in best or ()), ordinary]
        modified = [throw._replace(stone=other) for throw in made]
        errors: tuple[float | None, ...] = (None,) * 3
        with suppress(InputError):  # no motion
            *found, draw = consistent.factors(modified)
            both = [*consistent.factors([ordinary]), draw]
            errors = (
                standard_error(combined(found), pair.difference),
                standard_error(combined(both) * math.sqrt(throws / 2), pair.difference),
                pair.tolerated_change(both, required),
            )
        changes.append(StoneChange(name, value, *errors))
    return Separation(
        pair.names,
        pair.size,
        pair.of,
        required,
        proof,
        tuple(scenarios),
        candidates.index(ordinary),
        tuple(changes),
    )


def _load_scenario(
    pair: CoefficientPair,
    load: Load,
    factors: Sequence[Floats],
    throws: int,
    required: float,
) -> LoadScenario:
    each, best = (
        tuple(standard_error(factor, pair.difference) for factor in factors),
        None,
    )
    candidates = CandidateSet.from_factors(factors)
    if standard_error(combined(factors), pair.difference) is not None:
        best = select_design(
            candidates, error_criterion(candidates, pair.difference), throws
        )
    if best is None:
        return LoadScenario(load, each, None, None, None)
    stderr = standard_error(candidates.together(best), pair.difference)
    steady = pair.tolerated_change([factors[index] for index in best], required)
    return LoadScenario(load, each, best, stderr, steady)
