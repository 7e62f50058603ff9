"""Friction as a polynomial in the position on the ring, found by evaluating the law
with symbols.

A law is arithmetic, so it accepts polynomials in place of numbers. Where its traction
is then a polynomial in `xi` and `eta` times the direction, or the velocity, of sliding,
the sum over the ring has a closed form (`elliptic`). Any other operation, such as a
root or a comparison, raises `TypeError`, and the law is summed by quadrature.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from math import prod
from typing import Any, NamedTuple

import numpy as np

from curlfit.dynamics.elliptic import MEAN_PLACES
from curlfit.friction import Load, LocalLaw, RingPoint

_SAMPLES = 16  # of coefficients and motions, for which terms must cancel
_LARGE = 1e3  # bound on the sampled coefficients
_FARTHEST = (np.pi, 40.0)  # rad, of the sampled angles turned: half a turn, a long draw
_ANGLES = 60  # on half a ring, at which friction between edges must be the same
_ROUNDING = 1e-12  # of a term of the moment over the largest, by which terms cancel
_DIRECTIONS = {(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 0, 1), (0, 1, 1)}
"""Powers of e_xi, e_eta and speed of the terms that have a mean: of a push, a direction
of sliding and a velocity"""
_MEANS = {(0, 0): "one", (1, 0): "xi", (2, 0): "xi_xi", (0, 1): "eta", (1, 1): "xi_eta"}


class Powers(NamedTuple):
    """Exponents of a term."""

    xi: int = 0
    eta: int = 0
    e_xi: int = 0
    e_eta: int = 0
    speed: int = 0
    load: int = 0


class Polynomial:
    """A sum of terms, each a coefficient times powers; `eta^2` is written
    as `1 - xi^2`.

    Coefficients are numbers or arrays. Speed and load may have negative exponents.
    """

    __array_ufunc__ = None  # makes NumPy defer to the operators below
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, terms: dict[Powers, Any]) -> None:
        self.terms = terms

    @classmethod
    def of(cls, value: Any) -> Polynomial:
        """A polynomial, or a number as one."""
        if isinstance(value, Polynomial):
            return value
        if value is None or (isinstance(value, np.ndarray) and value.dtype.hasobject):
            raise TypeError("expected a number")
        # Only a zero written in the law itself vanishes; a coefficient may have
        # other values.
        vanishes = type(value) in (int, float) and value == 0
        return cls({} if vanishes else {Powers(): value})

    def __add__(self, other: Any) -> Polynomial:
        terms = dict(self.terms)
        for powers, value in Polynomial.of(other).terms.items():
            terms[powers] = terms[powers] + value if powers in terms else value
        return Polynomial(terms)

    def __mul__(self, other: Any) -> Polynomial:
        total = Polynomial({})
        for left, a in self.terms.items():
            for right, b in Polynomial.of(other).terms.items():
                exponents = (i + j for i, j in zip(left, right, strict=True))
                total += _term(Powers(*exponents), a * b)
        return total

    def __truediv__(self, other: Any) -> Polynomial:
        if not isinstance(other, Polynomial):
            return self * (1 / other)
        if len(other.terms) == 1:
            powers, value = next(iter(other.terms.items()))
            if powers == Powers(speed=powers.speed, load=powers.load):
                inverse = Powers(speed=-powers.speed, load=-powers.load)
                return self * Polynomial({inverse: 1 / value})
        raise TypeError("a polynomial can be divided by a speed or a load only")

    def __pow__(self, exponent: int) -> Polynomial:
        if not isinstance(exponent, int):
            raise TypeError("expected a whole number as the exponent of a polynomial")
        product = Polynomial.of(1.0)
        for _ in range(abs(exponent)):
            product = product * self
        return product if exponent >= 0 else 1.0 / product

    def __neg__(self) -> Polynomial:
        return self * -1.0

    def __sub__(self, other: Any) -> Polynomial:
        return self + -Polynomial.of(other)

    def __rsub__(self, other: Any) -> Polynomial:
        return -self + other

    def __rtruediv__(self, other: Any) -> Polynomial:
        return Polynomial.of(other) / self

    __radd__ = __add__
    __rmul__ = __mul__

    def _undecided(self, *_: Any) -> Any:
        raise TypeError("a polynomial has no value")

    __eq__ = __ne__ = __bool__ = __array__ = _undecided


def _term(powers: Powers, value: Any) -> Polynomial:
    """A term as a polynomial in which eta has no higher power than the first."""
    if powers.eta < 2:
        return Polynomial({powers: value})
    # eta^n = eta^(n-2) (1 - xi^2)
    lower = powers._replace(eta=powers.eta - 2)
    return _term(lower, value) + _term(lower._replace(xi=lower.xi + 2), -value)


def _symbol(**powers: int) -> Polynomial:
    return Polynomial({Powers(**powers): 1.0})


XI = _symbol(xi=1)
ETA = _symbol(eta=1)
_LOAD = _symbol(load=1)


class Force(NamedTuple):
    """Force to the right, force forward and moment on half a ring, as polynomials."""

    xi: Polynomial
    eta: Polynomial
    moment: Polynomial

    @classmethod
    def of(cls, xi: Polynomial, eta: Polynomial) -> Force:
        """A force with its moment (eq. 2)."""
        return cls(xi, eta, XI * eta - ETA * xi)

    def under(self, load: Any, constant: bool = True) -> Force:
        """The force under a load, 1 or a polynomial in the position; `constant`:
        whether to include terms independent of it."""
        return Force(*(_with_load(part, load, constant) for part in self))


def _with_load(part: Polynomial, load: Any, constant: bool) -> Polynomial:
    """A polynomial with a load in place of its symbol."""
    total = Polynomial({})
    for powers, value in part.terms.items():
        term = Polynomial({powers._replace(load=0): value})
        if powers.load:
            total += term * load
        elif constant:
            total += term
    return total


def traction(
    law: LocalLaw, load: Load, front: float, angle: Any, motion: tuple[Any, ...]
) -> tuple[Polynomial, Polynomial]:
    """Traction on one half in a motion (v, u, turned, time); between two edges of
    a law, `angle` is any angle between them. Raises some exception where it is not
    a polynomial."""
    v, u, turned, time = motion
    normal_load = 1.0 if load == Load.UNIFORM else _LOAD
    point = RingPoint(
        xi=XI,
        eta=ETA,
        angle=angle,
        front=front,
        slide_xi=_symbol(e_xi=1, speed=1),
        slide_eta=_symbol(e_eta=1, speed=1),
        speed=_symbol(speed=1),
        e_xi=_symbol(e_xi=1),
        e_eta=_symbol(e_eta=1),
        load=normal_load,
        v=v,
        u=u,
        turned=turned,
        time=time,
    )
    across, along = law.traction(point)  # per unit load
    return Polynomial.of(across) * normal_load, Polynomial.of(along) * normal_load


def has_mean(powers: Powers) -> bool:
    """Whether the mean of a term over half a ring has a closed form here."""
    return (powers.xi, powers.eta) in _MEANS and powers[2:5] in _DIRECTIONS


def mean(part: Polynomial, mean_of_term: Callable[[Powers], Any]) -> Any:
    """Mean over a part of the ring, from the terms that have one; the others cancel (in
    the moment of `radial`, by `xi^2 + eta^2 = 1`)."""
    return sum(
        value * mean_of_term(powers)
        for powers, value in part.terms.items()
        if has_mean(powers)
    )


def mean_of_half(means: Any, front: float, powers: Powers) -> Any:
    """Mean of a term over a half of the ring.

    Parameters
    ----------
    means : means of the directions and of the velocities of sliding on the front half,
        each to the right and forward (`elliptic.Means`).
    """
    components = MEAN_PLACES
    if powers.e_xi or powers.e_eta:
        components = means[powers.speed][powers.e_eta]
    mean_in_front = getattr(components, _MEANS[powers.xi, powers.eta])
    # The mirror eta -> -eta takes the front half to the back half, which slides to the
    # opposite side: of (xi, eta, e_xi, e_eta), eta and e_xi change their signs.
    mirrored = (powers.eta + powers.e_xi) % 2 == 1 and not front
    return -mean_in_front if mirrored else mean_in_front


def at_points(point: RingPoint, powers: Powers) -> Any:
    """A term of position and sliding at the points of a part."""
    sliding = (point.e_xi, point.e_eta)
    if powers.speed:
        sliding = (point.slide_xi, point.slide_eta)
    factors = [point.xi] * powers.xi
    factors += [point.eta] * powers.eta
    factors += [sliding[0]] * powers.e_xi
    factors += [sliding[1]] * powers.e_eta
    return prod(factors)


@cache
def has_closed_form(kind: type[LocalLaw], load: Load) -> bool:
    """Whether the sum of a law over the ring has a closed form.

    The law may have edges if its friction is one polynomial between any two of them.
    """
    random = np.random.default_rng(0)
    with suppress(Exception):  # a law may do anything with the symbols
        for farthest in _FARTHEST * (_SAMPLES // len(_FARTHEST)):
            values = []
            for coefficient in kind.coefficients():
                lower = max(coefficient.lower, -_LARGE)
                upper = min(coefficient.upper, _LARGE)
                values.append(random.uniform(lower, upper, 1)[0])
            # v (m/s), R omega (m/s), angle turned (rad), time (s)
            lowest = (0.1, -1.0, -farthest, 0.0)
            highest = (3.0, 1.0, farthest, 40.0)
            motion = random.uniform(lowest, highest)
            _check(kind.from_vector(values), load, tuple(motion))
        return True
    return False


def _check(law: LocalLaw, load: Load, motion: tuple[float, ...]) -> None:
    """Raise TypeError where the force or the moment needs a mean that has no
    closed form."""
    jumps = law.edges(motion[2])
    for front in (1.0, 0.0):
        if not any(jumps):
            across, along = traction(law, load, front, None, motion)
            _check_means(across, along, load)
            continue
        angles = np.linspace(0, np.pi, _ANGLES + 2)[1:-1]
        edges = np.sort(jumps.front if front else jumps.back)
        traction_by_part: dict[int, Any] = {}
        for angle in angles if front else -angles:
            components_here = traction(law, load, front, angle, motion)
            part = int(np.searchsorted(edges, angle))
            first = traction_by_part.setdefault(part, components_here)
            for component, component_here in zip(first, components_here, strict=True):
                if component.terms != component_here.terms:
                    raise TypeError("friction varies between two edges")
        for across, along in traction_by_part.values():
            _check_means(across, along, load)


def _check_means(across: Polynomial, along: Polynomial, load: Load) -> None:
    """Raise TypeError where a traction has a term without a mean in closed form."""
    for part in (across, along):
        if any(powers.load not in (0, 1) for powers in part.terms):
            raise TypeError("expected a load that is linear in n")
    # the loads of which a consistent one is a sum (eq. 9)
    loads = (1.0,) if load == Load.UNIFORM else (1.0, XI, ETA)
    for normal_load in loads:
        force = Force.of(across, along).under(normal_load)
        size = max(map(abs, force.moment.terms.values()), default=0.0)
        for part in force:
            for powers, value in part.terms.items():
                cancels = part is force.moment and abs(value) <= _ROUNDING * size
                if not (cancels or has_mean(powers)):
                    raise TypeError("a term has no mean in closed form")
