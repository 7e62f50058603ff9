"""The structure of a law that compiled programs need: pytree, powers,
dependences, symmetry.

What a law depends on is found by tracing it. XLA calls the library's `pow` for one
number at a time, which takes three times as long as vector instructions; here the
logarithm is computed from exponent and mantissa, by the series of the inverse
hyperbolic tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.friction import Law, Load, LocalLaw, Motion, NetLaw, RingPoint, power
from curlfit.friction.base import arctan, exp, on_new_law
from curlfit.stone import Stone

UNIT_POINT = RingPoint(*(1.0 for _ in RingPoint._fields))
# mantissas lie between this and sqrt(2)
_ROOT_HALF = np.float64(0.5**0.5).view(np.int64)
_MANTISSA_BITS = 52
AnyLaw = TypeVar("AnyLaw", bound=Law)
_TERMS = 11  # of the series: exact to rounding for these mantissas


def _register(law: type[Law]) -> None:
    names = [item.name for item in law.coefficients()]
    # Not `register_dataclass`: jaxlib 0.10 treats the structures of two dataclasses
    # with the same number of fields as equal, so that `jit` may run the program of one
    # law for another.
    jax.tree_util.register_pytree_node(
        law,
        lambda value: ([getattr(value, name) for name in names], None),
        lambda _, values: law(*values),
    )


def _derived(kind: type[Law]) -> set[type[Law]]:
    return {kind}.union(*(_derived(law) for law in kind.__subclasses__()))


for _law in _derived(Law) - {Law}:
    _register(_law)
on_new_law.append(_register)
jax.tree_util.register_dataclass(
    Stone, data_fields=["m", "R", "rho", "h"], meta_fields=[]
)


@jax.custom_jvp
def log(number: Array) -> Array:
    """Natural logarithm of 0 < `number` < inf, else NaN."""
    bits = jax.lax.bitcast_convert_type(number, jnp.int64)
    exponent = (bits - _ROOT_HALF) >> _MANTISSA_BITS
    mantissa = jax.lax.bitcast_convert_type(bits - (exponent << _MANTISSA_BITS), float)
    z = (mantissa - 1) / (mantissa + 1)
    square, series = z * z, jnp.zeros_like(z)
    for n in reversed(range(_TERMS)):
        series = series * square + 2 / (2 * n + 1)
    valid = (number > 0) & (number < jnp.inf)
    return jnp.where(valid, exponent * np.log(2) + z * series, jnp.nan)


@log.defjvp
def _(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Array, Array]:
    (number,), (tangent,) = primals, tangents
    return log(number), tangent / number


@power.register(jax.core.Tracer)
def _(base: Any, exponent: Any) -> Any:
    return jnp.exp(exponent * log(jnp.asarray(base, float)))


arctan.register(jax.core.Tracer, jnp.arctan)
exp.register(jax.core.Tracer, jnp.exp)


def depends_on(function: Callable[..., Any], *inputs: Any) -> list[bool]:
    """Which inputs the outputs of a function depend on."""
    jaxpr = jax.make_jaxpr(function)(*inputs).jaxpr
    used = {id(item) for item in jaxpr.outvars}
    for equation in reversed(jaxpr.eqns):
        if any(id(item) in used for item in equation.outvars):
            used |= {id(item) for item in equation.invars}
    return [id(variable) in used for variable in jaxpr.invars]


def depends_on_load(law: LocalLaw, points: RingPoint) -> bool:
    """Whether the traction per unit load depends on the load."""
    (dependent,) = depends_on(
        lambda load: law.traction(points._replace(load=load)), points.load
    )
    return dependent


def depends_on_turned_and_time(law: Law, stone: Stone) -> list[bool]:
    """Whether friction depends on the angle turned, and on the time since release."""

    def friction(turned: Array, time: Array) -> Any:
        if isinstance(law, NetLaw):
            return law.accelerations(Motion(one, one, turned, time), stone)
        assert isinstance(law, LocalLaw)
        return law.traction(UNIT_POINT._replace(turned=turned, time=time)), law.edges(
            turned
        )

    one = jnp.ones(())
    law = jax.tree.map(lambda leaf: jnp.ones(()), law)
    return depends_on(friction, one, one)


def _is_linear(function: Callable[..., Any], size: int, parameters: int) -> bool:
    """Whether a function is a constant matrix times its first `size` inputs, for all
    values of the other inputs, the parameters."""
    one: Any = np.ones(())
    inputs = (one,) * (size + parameters)

    def derivative(*values: Array) -> Any:
        restricted = lambda *first: function(*first, *values[size:])  # noqa: E731
        return jax.jvp(restricted, values[:size], inputs[:size])[1]

    with jax.ensure_compile_time_eval():
        at_zero = jax.tree.leaves(
            function(*(0 * one for _ in range(size)), *inputs[size:])
        )
        affine = any(float(part) for part in at_zero)
    if affine or any(depends_on(derivative, *inputs)):
        return False
    return not any(depends_on(function, *inputs)[size:])


def example_law(kind: type[AnyLaw]) -> AnyLaw:
    """A law whose coefficients all differ."""
    return kind.from_vector(
        [0.1 + 0.01 * index for index, _ in enumerate(kind.coefficients())]
    )


def has_edges(kind: type[LocalLaw]) -> bool:
    """Whether friction jumps within the halves of the ring."""
    return any(example_law(kind).edges(1.0))


@cache
def sample_points(front: float) -> RingPoint:
    """Points on one half of the ring in several motions, as NumPy arrays; those on the
    other half are their mirror images."""
    v, u = np.array([[1.1], [0.3], [2.3]]), np.array([[-0.6], [0.15], [1.7]])
    angle = (2 * front - 1) * np.linspace(0.2, 2.9, 7)
    xi, eta = np.cos(angle), np.sin(angle)
    slide_xi, slide_eta = -u * eta, v + u * xi
    speed = np.hypot(slide_xi, slide_eta)
    return RingPoint(
        xi,
        eta,
        angle,
        front,
        slide_xi,
        slide_eta,
        speed,
        slide_xi / speed,
        slide_eta / speed,
        np.ones_like(speed),
        v,
        u,
        0.7 * v,
        3.1 * v,
    )


def _close(a: Any, b: Any) -> bool:
    return bool(np.allclose(np.asarray(a), np.asarray(b), rtol=1e-9, atol=1e-12))


@cache
def is_mirror_symmetric(kind: type[LocalLaw], load: Load) -> bool:
    """Whether friction on the back half mirrors that on the front, as under an
    isotropic law."""
    law = example_law(kind)
    if load != Load.UNIFORM or has_edges(kind):
        return False
    names = ("e_xi", "slide_xi", "eta", "angle", "front")  # differ between the halves

    def traction(part: int, *values: Array) -> Any:
        return law.traction(
            UNIT_POINT._replace(**dict(zip(names, values, strict=True)))
        )[part]

    try:
        dependences = depends_on(partial(traction, 1), *(np.ones(()) for _ in names))
        if any(dependences) or not _is_linear(partial(traction, 0), 1, len(names) - 1):
            return False
    except TypeError:  # a law that converts `front` to a Python number
        return False
    with jax.ensure_compile_time_eval():
        front, back = (law.traction(sample_points(half)) for half in (1.0, 0.0))
        return _close(front[0], -np.asarray(back[0])) and _close(front[1], back[1])
