"""The structure of a law that compiled programs need: pytree, powers,
dependences, symmetry.

What a law depends on is found by tracing it. XLA calls the library's `pow` for one
number at a time, which takes three times as long as vector instructions; here the
logarithm is computed from exponent and mantissa, by the series of the inverse
hyperbolic tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.friction import Law, Load, LocalLaw, Motion, NetLaw, RingPoint, power
from curlfit.friction.base import arctan, exp, on_new_law, ring_points
from curlfit.stone import Stone

AnyLaw = TypeVar("AnyLaw", bound=Law)
UNIT_POINT = RingPoint(*(1.0 for _ in RingPoint._fields))
# the bits of sqrt(1/2), between which and sqrt(2) mantissas lie
_ROOT_HALF = np.float64(0.5**0.5).view(np.int64)
_MANTISSA_BITS = 52
_TERMS = 11  # of the series: exact to rounding for these mantissas


def _register(law: type[Law]) -> None:
    """Make a law a pytree of its coefficients."""
    names = [coefficient.name for coefficient in law.coefficients()]
    # Not `register_dataclass`: jaxlib 0.10 treats the structures of two dataclasses
    # with the same number of fields as equal, so that `jit` may run the program of one
    # law for another.
    jax.tree_util.register_pytree_node(
        law,
        lambda value: ([getattr(value, name) for name in names], None),
        lambda _, values: law(*values),
    )


def _with_subclasses(kind: type[Law]) -> set[type[Law]]:
    return {kind}.union(*(_with_subclasses(law) for law in kind.__subclasses__()))


for _law in _with_subclasses(Law) - {Law}:
    _register(_law)
on_new_law.append(_register)
jax.tree_util.register_dataclass(
    Stone, data_fields=["m", "R", "rho", "h"], meta_fields=[]
)


@jax.custom_jvp
def log(number: Array) -> Array:
    """Natural logarithm of 0 < `number` < inf, else NaN."""
    # The bits of a float are those of its exponent before those of its mantissa, so
    # that the exponent counts the powers of 2 between the number and sqrt(1/2).
    bits = jax.lax.bitcast_convert_type(number, jnp.int64)
    exponent = (bits - _ROOT_HALF) >> _MANTISSA_BITS
    mantissa = jax.lax.bitcast_convert_type(bits - (exponent << _MANTISSA_BITS), float)
    # log(mantissa) = 2 artanh(z) = 2 (z + z^3/3 + z^5/5 + ...), DLMF 4.6.4
    z = (mantissa - 1) / (mantissa + 1)
    square = z * z
    series = jnp.zeros_like(z)
    for n in reversed(range(_TERMS)):
        series = series * square + 2 / (2 * n + 1)
    valid = (number > 0) & (number < jnp.inf)
    return jnp.where(valid, exponent * np.log(2) + z * series, jnp.nan)


@log.defjvp
def _(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Array, Array]:
    number = primals[0]
    return log(number), tangents[0] / number


@power.register(jax.core.Tracer)
def _(base: Any, exponent: Any) -> Any:
    return jnp.exp(exponent * log(jnp.asarray(base, float)))


arctan.register(jax.core.Tracer, jnp.arctan)
exp.register(jax.core.Tracer, jnp.exp)


def depends_on(function: Callable[..., Any], *inputs: Any) -> list[bool]:
    """Which inputs the outputs of a function depend on."""
    jaxpr = jax.make_jaxpr(function)(*inputs).jaxpr
    # From the outputs back through the operations; variables by identity, since
    # literals among them cannot be hashed.
    used = {id(variable) for variable in jaxpr.outvars}
    for equation in reversed(jaxpr.eqns):
        if any(id(variable) in used for variable in equation.outvars):
            used |= {id(variable) for variable in equation.invars}
    return [id(variable) in used for variable in jaxpr.invars]


def depends_on_load(law: LocalLaw, points: RingPoint) -> bool:
    """Whether the traction per unit load depends on the load."""

    def traction(load: Array) -> Any:
        return law.traction(points._replace(load=load))

    return depends_on(traction, points.load)[0]


def depends_on_turned_and_time(law: Law, stone: Stone) -> list[bool]:
    """Whether friction depends on the angle turned, and on the time since release."""
    unit = jnp.ones(())
    law = jax.tree.map(lambda coefficient: unit, law)

    def friction(turned: Array, time: Array) -> Any:
        if isinstance(law, NetLaw):
            return law.accelerations(Motion(unit, unit, turned, time), stone)
        assert isinstance(law, LocalLaw)
        point = UNIT_POINT._replace(turned=turned, time=time)
        return law.traction(point), law.edges(turned)

    return depends_on(friction, unit, unit)


def _is_proportional(function: Callable[..., Any], parameters: int) -> bool:
    """Whether a function of numbers is a constant times its first input, whatever the
    other inputs, of which there are `parameters`."""
    unit: Any = np.ones(())
    other_inputs = (unit,) * parameters

    def derivative(first: Array, *others: Array) -> Any:
        return jax.jvp(lambda value: function(value, *others), (first,), (unit,))[1]

    with jax.ensure_compile_time_eval():
        at_zero = float(function(0 * unit, *other_inputs))
    if at_zero != 0 or any(depends_on(derivative, unit, *other_inputs)):
        return False
    return not any(depends_on(function, unit, *other_inputs)[1:])


def example_law(kind: type[AnyLaw]) -> AnyLaw:
    """A law whose coefficients all differ."""
    count = len(kind.coefficients())
    return kind.from_vector([0.1 + 0.01 * index for index in range(count)])


def has_edges(kind: type[LocalLaw]) -> bool:
    """Whether friction jumps within the halves of the ring."""
    return any(example_law(kind).edges(1.0))


@cache
def sample_points(front: float) -> RingPoint:
    """Points on one half of the ring in several motions, as NumPy arrays; those on the
    other half are their mirror images."""
    v = np.array([[1.1], [0.3], [2.3]])
    u = np.array([[-0.6], [0.15], [1.7]])
    angle = (2 * front - 1) * np.linspace(0.2, 2.9, 7)
    return ring_points(angle, v, u, 0.7 * v, 3.1 * v, front=front)


def _close(a: Any, b: Any) -> bool:
    return bool(np.allclose(np.asarray(a), np.asarray(b), rtol=1e-9, atol=1e-12))


@cache
def is_mirror_symmetric(kind: type[LocalLaw], load: Load) -> bool:
    """Whether friction on the back half mirrors that on the front, as under an
    isotropic law."""
    law = example_law(kind)
    if load != Load.UNIFORM or has_edges(kind):
        return False
    # The variables that differ between the halves. The force along the motion must
    # not depend on them, and that across be proportional to e_xi alone.
    names = ("e_xi", "slide_xi", "eta", "angle", "front")

    def traction_at(values: Sequence[Array]) -> tuple[Any, Any]:
        point = UNIT_POINT._replace(**dict(zip(names, values, strict=True)))
        return law.traction(point)

    def across(*values: Array) -> Any:
        return traction_at(values)[0]

    def along(*values: Array) -> Any:
        return traction_at(values)[1]

    try:
        if any(depends_on(along, *(np.ones(()) for _ in names))):
            return False
        if not _is_proportional(across, len(names) - 1):
            return False
    except TypeError:  # a law that converts `front` to a Python number
        return False
    with jax.ensure_compile_time_eval():
        front_xi, front_eta = law.traction(sample_points(1.0))
        back_xi, back_eta = law.traction(sample_points(0.0))
        return _close(front_xi, -np.asarray(back_xi)) and _close(front_eta, back_eta)
