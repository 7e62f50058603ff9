"""What it would take to tell two coefficients apart, which the path knows together.

For `mu1_eta` and `mu2_eta` of the front-back law this is the question that Ivanov and Shuvalov
(2012) leave open. Under uniform load no throw can: see `HIDDEN`. Under the consistent load
(eq. 8-9) the front carries more, so the difference changes the braking a little, and the sum makes
up for nearly all of it. What is left depends on the spin (the share of the braking that the ring's
turning takes away), and on how far two throws differ in that share: two stones whose weight lies at
different heights make up for it by different sums, and together they tell. (A load made uneven on
purpose would turn with the stone; there is no such load here.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from curlfit.dynamics.contact import accelerations
from curlfit.optimal_design.result import Change, Proof, Separation, Way

# isort: split
import jax
import numpy as np
from jaxtyping import Array

from curlfit.errors import InputError
from curlfit.friction import Law, Load
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import compiled
from curlfit.optimal_design.information import (
    Told,
    Trial,
    about_coefficients,
    error_of,
    joined,
    told,
)
from curlfit.optimal_design.selection import by_error, chosen, field_of
from curlfit.stone import GRAVITY, Stone

HIDDEN = (
    "Why (eq. 16, 25-26): the ring points at alpha and -alpha, one in front and one behind, have "
    "the same xi = R cos(alpha), the same v_eta = v + omega xi and the same sliding speed, and "
    "under uniform load the same weight. So int v_eta/|v| dalpha (in T_eta) and "
    "int xi v_eta/|v| dalpha (in M) are equal over both halves, whatever v and omega are, and "
    "stand before mu1_eta + mu2_eta alone; T_xi has neither. The motion is the same for every "
    "split of that sum, and no precision, no number of throws and no R, rho or h changes this"
)
_STATES = 400
_SLOWEST, _FASTEST, _MOST_SPIN = 0.01, 4.0, 60.0  # m/s, m/s, rad/s of the states tried
_PROOF = tuple((v0, omega0) for v0 in (1.5, 2.0, 2.5) for omega0 in (-1.0, 0.5, 3.0, 10.0))
_PROOF_RATE = 10.0  # Hz
_ORDINARY = (2.0, 1.0)  # m/s, rad/s: a draw
_ROUNDING = 1e-9  # of the largest singular value, below which a direction is not seen
_ALIKE = 1e-9  # relative difference of two throws in how the sum hides the difference
_NOTHING = 1e-12  # of what the sum does: rounding
_CHANGES = (
    ("h", 0.5), ("h", 1.5), ("h", 2.0), ("h", 3.0), ("R", 0.75), ("R", 1.25), ("rho", 0.75),
    ("rho", 1.25),
)  # fmt: skip


class Split:
    """Two coefficients of a law that are to be told apart, and how what is known of them is read.

    Raises
    ------
    InputError : a name that is no free coefficient of the law, twice the same, different units, or
        both values zero.
    """

    def __init__(self, law: type[Law], values: Floats, free: Booleans, pair: Sequence[str]) -> None:
        items = law.coefficients()
        names = [item.name for item, take in zip(items, free, strict=True) if take]
        if len(pair) != 2 or pair[0] == pair[1]:
            raise InputError(
                "separate: expected two different coefficients, such as mu1_eta,mu2_eta"
            )
        for name in pair:
            if name not in names:
                raise InputError(
                    f"separate: law {law.name} has no free coefficient {name!r}; it has "
                    + ", ".join(names)
                )
        units = {item.name: item.unit for item in items}
        if units[pair[0]] != units[pair[1]]:
            raise InputError(
                f"separate: {pair[0]} ({units[pair[0]]}) and {pair[1]} ({units[pair[1]]}) have "
                "different units, and no difference"
            )
        self.law, self.values, self.free = law, values, free
        self.pair = (pair[0], pair[1])
        typical = np.array([item.typical for item in items])
        self.first, self.second = (
            np.array([float(item.name == name) for item in items]) for name in pair
        )
        self.difference = ((self.first - self.second) * typical)[free]
        self.sum = ((self.first + self.second) * typical)[free]
        a, b = float(self.first @ values), float(self.second @ values)
        self.total = a + b
        self.of = "difference" if abs(a - b) > 1e-9 * (abs(a) + abs(b)) else "mean"
        self.size = abs(a - b) if self.of == "difference" else abs(a + b) / 2
        if not self.size > 0:
            raise InputError(
                f"separate: {pair[0]} and {pair[1]} are both zero; --set them, so that an error "
                "can be relative to them"
            )

    def steady(self, roots: Sequence[Floats], wanted: float) -> float | None:
        """Relative change of the sum, from one part of some throws to the others, that would be
        taken for the wanted error of the difference; None where no such change is."""
        hides = [self._made_up_for(root) for root in roots]
        seen = [one for one in hides if one is not None]
        if len(seen) < len(hides) or max(seen) - min(seen) < _ALIKE * max(map(abs, seen)):
            return None
        return (max(seen) - min(seen)) * wanted * self.size / abs(self.total)

    def _made_up_for(self, root: Floats) -> float | None:
        """By how much the sum changes to hide a unit of the difference; None if it is not seen."""
        _, singular, right = np.linalg.svd(root)
        if singular[-1] < _ROUNDING * singular[0]:
            return None
        spread = right.T @ ((right @ self.difference) / singular**2)
        return float(self.sum @ spread / (self.difference @ spread))


@compiled("law")
def _pull(
    law: type[Law], coefficients: Array, along: Array, stone: Stone, v: Array, omega: Array
) -> Any:
    """Change of force and moment by the coefficients along a direction, under uniform load."""

    def force(coefficients: Array) -> Any:
        return accelerations(law.from_vector(coefficients), stone, "uniform", v, omega)

    return jax.jvp(force, (coefficients,), (along,))[1]


def proof(split: Split, stone: Stone, roots: Sequence[Floats]) -> Proof:
    """The largest effects of difference and sum under uniform load.

    Parameters
    ----------
    roots : of the information of many throws under uniform load.
    """
    random = np.random.default_rng(2012)
    v = random.uniform(_SLOWEST, _FASTEST, _STATES)
    omega = random.uniform(-_MOST_SPIN, _MOST_SPIN, _STATES)
    units = np.array([1.0, 1.0, stone.rho**2 / stone.R]) / GRAVITY
    bodies = jax.tree.map(lambda value: np.asarray(float(value)), stone)

    def largest(along: Floats) -> tuple[float, ...]:
        found = _pull(split.law, split.values, along, bodies, v, omega)
        return tuple(
            float(unit * np.abs(part).max()) for unit, part in zip(units, found, strict=True)
        )

    by_difference = largest(split.first - split.second)
    by_sum = largest(split.first + split.second)
    whole = joined(roots)
    singular = np.linalg.svd(whole, compute_uv=False)
    hidden = max(by_difference) < _NOTHING * max(by_sum)
    hidden &= error_of(whole, split.difference) is None
    own = split.law.name == "front-back" and set(split.pair) == {"mu1_eta", "mu2_eta"}
    return Proof(
        states=_STATES,
        by_difference=by_difference,
        by_sum=by_sum,
        throws=len(roots),
        singular_values=tuple(map(float, singular)),
        hidden=bool(hidden),
        because=HIDDEN if own and hidden else "",
    )


def separation(
    split: Split,
    trials: Sequence[Trial],
    throws: int,
    sigma: Mapping[str, float],
    wanted: float,
    record: Mapping[str, Any],
    by_load: dict[str, list[Told]],
    say: Callable[[str], None],
) -> Separation:
    """How two coefficients are to be told apart.

    Parameters
    ----------
    trials, throws : candidates, and how many of them are made.
    wanted : relative error.
    record : `until` and `channels` of `told`.
    by_load : what the trials tell under the loads already computed.
    say : told what is being done.
    """

    def roots(load: Load, trials: Sequence[Trial], have: list[Told] | None = None) -> list[Floats]:
        found = told(split.law, load, split.values, trials, **record) if have is None else have
        return [about_coefficients(split.law, one, sigma, split.free) for one in found]

    stone = trials[0].stone
    say("the proof for the uniform load")
    many = [Trial(v0, omega0, _PROOF_RATE, stone) for v0, omega0 in _PROOF]
    shown = proof(split, stone, roots("uniform", many))
    ways, own = [], {}
    loads: tuple[Load, ...] = ("uniform", "consistent")
    for load in loads:
        say(f"the candidates under {load} load")
        own[load] = roots(load, trials, by_load.get(load))
        ways.append(_way(split, load, own[load], throws, wanted))
    ordinary = min(
        range(len(trials)),
        key=lambda place: (
            abs(math.log(trials[place].v0 / _ORDINARY[0]))
            + abs(abs(trials[place].omega0) - _ORDINARY[1]),
            -trials[place].rate,
        ),
    )
    way = ways[-1]
    changes = []
    for name, factor in _CHANGES if way.throws is not None else ():
        value = factor * getattr(stone, name)
        say(f"the stone with {name} = {value:.3g} m")
        other = stone.with_values({name: value})
        places = [*(way.throws or ()), ordinary]
        asked = [trials[place]._replace(stone=other) for place in places]
        try:
            *found, draw = roots("consistent", asked)
        except InputError:  # no motion
            changes.append(Change(name, value, None, None, None))
            continue
        both = [own["consistent"][ordinary], draw]
        changes.append(
            Change(
                name,
                value,
                error_of(joined(found), split.difference),
                error_of(joined(both) * math.sqrt(throws / 2), split.difference),
                split.steady(both, wanted),
            )
        )
    return Separation(
        pair=split.pair,
        size=split.size,
        of=split.of,
        wanted=wanted,
        proof=shown,
        ways=tuple(ways),
        ordinary=ordinary,
        changes=tuple(changes),
    )


def _way(split: Split, load: Load, roots: Sequence[Floats], throws: int, wanted: float) -> Way:
    each = tuple(error_of(root, split.difference) for root in roots)
    best = None
    if error_of(joined(roots), split.difference) is not None:
        field = field_of(roots)
        best = chosen(field, by_error(field, split.difference), throws)
    if best is None:
        return Way(load, each, None, None, None)
    made = [roots[place] for place in best]
    return Way(
        load, each, best, error_of(joined(made), split.difference), split.steady(made, wanted)
    )
