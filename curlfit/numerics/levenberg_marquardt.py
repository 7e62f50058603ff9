"""The Levenberg-Marquardt method with bounds: one step, for one problem or for many.

`advance` is the entire method: whether a trial is accepted, the damping, the next trial and when to
stop. It takes NumPy arrays, with many problems along the leading axes, and traced JAX arrays alike.
optimistix does not support bounds; `bounded_solver` makes this method one of its solvers.

Bounds are enforced by projection (Kanzow, Yamashita and Fukushima 2004). Damping is scaled by the
columns of the Jacobian (Marquardt 1963), which makes the steps independent of units.

A search has converged when the residual is orthogonal to all changes that a step could make, by the
relative offset of Bates and Watts (1981): the length of the part of the residual that the next step
removes, relative to that of the residual. The reductions of the last two steps predict that of the
next, so the last step needs no evaluation of its own. Near the end, steps gain less than the
rounding error of chi squared, which then shows neither whether a step was good nor when to stop.
There, steps are taken as long as they become shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from curlfit.numerics.namespace import namespace

MOST_EVALUATIONS = 200
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e8  # relative to the squared columns (Marquardt)
_LESS, _MORE = 0.1, 3.0  # factors of the damping after a step as predicted, and a rejected one ...
_FASTER = 2.0  # ... and of that factor after each further rejection
_ROUNDING = 1e-10  # share of chi squared up to which a change may be rounding error
_STEEPER = 30.0  # factor of the damping of a step that leads uphill
_UPHILL = 1e-8  # share of chi squared by which a projected step may lead uphill
_HEAVY = 1.0  # damping above which a small reduction says nothing about the optimum
_STALLED = 1e-6  # share of chi squared, or of values, left to gain where no trial is accepted
_SMALL = 1e-10  # negligible step, relative to the size of the values
_REGULAR = 1e-14  # damping that keeps the normal matrix nonsingular on an exact ridge


class Control(NamedTuple):
    """How a search begins, and when it has converged."""

    damping: float
    """of the first step, relative to the squared columns: the larger, the more cautious"""
    extrapolated: float
    """share of chi squared that the last step, which is not evaluated, may gain"""
    remaining: float
    """share of chi squared that the step after it might gain"""


class Bounds(NamedTuple):
    """Bounds of the parameters, and the typical sizes that scale their steps."""

    lower: Any
    upper: Any
    typical: Any


class QuadraticModel(NamedTuple):
    """Gauss-Newton model of chi squared about some values, in parameters over typical sizes."""

    chi_squared: Any
    """shape (...)"""
    gradient: Any
    """half the gradient, shape (..., parameters)"""
    hessian: Any
    """half the Hessian, J^T J, shape (..., parameters, parameters)"""


class Search(NamedTuple):
    """The state of one search, or of many along the leading axes."""

    values: Any
    """the best so far, shape (..., parameters)"""
    trial: Any
    """where to evaluate next"""
    model: QuadraticModel
    """at the best values"""
    damping: Any
    growth: Any
    """factor of the damping if the trial is rejected"""
    reduction: Any
    """of chi squared, predicted for the step to the trial; inf before the first"""
    settled: Any
    """whether the first, least damped step from the best values was predicted to gain little"""
    evaluations: Any
    done: Any
    success: Any


class Outcome(NamedTuple):
    """What `advance` did."""

    accepted: Any
    """whether the trial became the best values"""
    extrapolation: Any
    """the last step, taken without an evaluation; 0 where there was none"""


def quadratic_model(residual: Any, jacobian: Any, typical: Any) -> QuadraticModel:
    """The model from residuals (..., n) and their Jacobian (..., n, parameters)."""
    column = residual[..., None]
    return QuadraticModel(
        chi_squared=(column.mT @ column)[..., 0, 0],
        gradient=(jacobian.mT @ column)[..., 0] * typical,
        hessian=jacobian.mT @ jacobian * (typical[..., :, None] * typical[..., None, :]),
    )


def begin(values: Any, bounds: Bounds, control: Control) -> Search:
    """A search from values of shape (..., parameters)."""
    xp = namespace(values)
    start = xp.clip(values, bounds.lower, bounds.upper)
    each = start.shape[:-1]
    return Search(
        values=start,
        trial=xp.array(start),
        model=QuadraticModel(
            xp.full(each, xp.inf), xp.zeros(start.shape), xp.zeros((*start.shape, start.shape[-1]))
        ),
        damping=xp.full(each, control.damping),
        growth=xp.full(each, _MORE),
        reduction=xp.full(each, xp.inf),
        settled=xp.zeros(each, bool),
        evaluations=xp.zeros(each, int),
        done=xp.zeros(each, bool),
        success=xp.zeros(each, bool),
    )


def advance(
    search: Search, at_trial: QuadraticModel, bounds: Bounds, control: Control
) -> tuple[Search, Outcome]:
    """Judge the trial by the model there, and choose the next."""
    xp = namespace(search.values)
    before = search.model.chi_squared
    rounding = (search.reduction <= _ROUNDING * before) & (
        at_trial.chi_squared <= (1 + _ROUNDING) * before
    )
    accepted = (at_trial.chi_squared <= before) | rounding
    accepted &= xp.isfinite(at_trial.chi_squared) & xp.isfinite(at_trial.hessian).all((-1, -2))
    values = xp.where(accepted[..., None], search.trial, search.values)
    model = QuadraticModel(
        xp.where(accepted, at_trial.chi_squared, before),
        xp.where(accepted[..., None], at_trial.gradient, search.model.gradient),
        xp.where(accepted[..., None, None], at_trial.hessian, search.model.hessian),
    )
    # Nielsen (1999): by the ratio of the actual to the predicted reduction.
    known = xp.isfinite(before) & xp.isfinite(at_trial.chi_squared) & ~rounding
    fall = xp.where(known, before, 1.0) - xp.where(known, at_trial.chi_squared, 0.0)
    gain = xp.where(known, fall / xp.maximum(search.reduction, 1e-300), 1.0)
    factor = xp.where(accepted, xp.clip(1 - (2 * gain - 1) ** 3, _LESS, 2.0), search.growth)
    damping = xp.maximum(search.damping * factor, _LEAST_DAMPING)
    growth = xp.where(accepted, _MORE, search.growth * _FASTER)
    last_reduction = xp.where(accepted, search.reduction, xp.inf)
    return _proposed(
        search._replace(
            values=values, model=model, damping=damping, growth=growth, reduction=last_reduction,
            evaluations=search.evaluations + 1,
        ),
        bounds, control, accepted,
    )  # fmt: skip


def reweighted(
    search: Search, model: QuadraticModel, bounds: Bounds, control: Control
) -> tuple[Search, Outcome]:
    """Continue from the best values under other weights, with the model there."""
    xp = namespace(search.values)
    first = xp.full(search.damping.shape, control.damping * _LESS)
    anew = search._replace(
        model=model, damping=first, growth=xp.full(first.shape, _MORE),
        reduction=xp.full(first.shape, xp.inf), evaluations=xp.ones(first.shape, int),
    )  # fmt: skip
    return _proposed(anew, bounds, control, xp.ones(first.shape, bool))


def _proposed(
    search: Search, bounds: Bounds, control: Control, accepted: Any
) -> tuple[Search, Outcome]:
    """The search with its next trial, or done; `search.reduction` is that of the previous step."""
    xp = namespace(search.values)
    values, model, before = search.values, search.model, search.reduction
    chi_squared = model.chi_squared
    failed = ~xp.isfinite(chi_squared) | (search.evaluations >= MOST_EVALUATIONS)

    def uphill(carry: tuple[Any, Any, Any]) -> Any:
        damping, _, reduction = carry
        return ~failed & (reduction < -_UPHILL * chi_squared) & (damping <= _MOST_DAMPING)

    def shorter(carry: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        damping = xp.where(uphill(carry), carry[0] * _STEEPER, carry[0])
        return damping, *_bounded_step(values, model, damping, bounds)

    # A step to a bound may lead uphill; a shorter one does not.
    carry = (search.damping, values, xp.zeros_like(chi_squared))
    damping, trial, reduction = _repeat(lambda carry: uphill(carry).any(), shorter, carry)
    failed |= damping > _MOST_DAMPING

    lightly_damped = damping <= _HEAVY
    ratio = xp.where(xp.isfinite(before), reduction / xp.maximum(before, 1e-300), 1.0)
    after = reduction * xp.where(ratio < 1, ratio, 1.0)
    last = reduction <= control.extrapolated * chi_squared
    last &= (after <= control.remaining * chi_squared) & lightly_damped & ~failed
    not_shrinking = (before <= _ROUNDING * chi_squared) & (reduction >= before) & lightly_damped
    step = xp.abs(trial - values) / (bounds.typical + xp.abs(values))
    small = (step <= _SMALL).all(-1) & (damping <= control.damping)
    # If the model is not smooth, trials may be rejected however short the steps are.
    negligible = (reduction <= _STALLED * chi_squared) | (step <= _STALLED).all(-1)
    settled = xp.where(accepted, negligible, search.settled)
    stalled = (damping > _MOST_DAMPING) & settled
    success = (~failed & (last | not_shrinking | small)) | stalled
    extrapolation = xp.where(last[..., None], trial - values, 0.0)
    found = search._replace(
        values=values + extrapolation, trial=trial, damping=damping, reduction=reduction,
        settled=settled, done=failed | success, success=success,
    )  # fmt: skip
    return found, Outcome(accepted, extrapolation)


def _bounded_step(values: Any, model: QuadraticModel, damping: Any, bounds: Bounds) -> Any:
    """The damped step within the bounds: the trial, and the predicted reduction of chi squared.

    A parameter at a bound that is pushed against it is held there. One that would pass its bound
    is set to the bound, and the others are solved for again (active sets).
    """
    xp = namespace(values)
    gradient, hessian = model.gradient, model.hessian
    lower, upper = ((end - values) / bounds.typical for end in (bounds.lower, bounds.upper))
    held = (lower >= 0) & (gradient >= 0) | (upper <= 0) & (gradient <= 0) | (lower >= upper)
    square = xp.where(held, 0.0, xp.diagonal(hessian, axis1=-2, axis2=-1))
    size = xp.sqrt(xp.maximum(square, 1e-24 * square.max(-1, keepdims=True) + 1e-300))

    def solved(held: Any, step: Any) -> Any:
        free = xp.where(held, 0.0, 1 / size)
        # Scaled to unit diagonal, so that the damping keeps it nonsingular.
        matrix = hessian * free[..., :, None] * free[..., None, :]
        diagonal = xp.where(held, 1.0, damping[..., None] + _REGULAR)
        matrix = matrix + xp.eye(values.shape[-1]) * diagonal[..., None]
        right = -(gradient + _product(hessian, step)) * free
        return xp.where(held, step, _solution(matrix, right) * free)

    def outside(carry: tuple[Any, Any]) -> Any:
        held, step = carry
        return ~held & ((step < lower) | (step > upper))

    def narrower(carry: tuple[Any, Any]) -> tuple[Any, Any]:
        held, step = carry[0] | outside(carry), xp.clip(carry[1], lower, upper)
        return held, solved(held, xp.where(held, step, 0.0))

    _, step = _repeat(lambda carry: outside(carry).any(), narrower, (held, xp.zeros_like(values)))
    trial = xp.clip(values + step * bounds.typical, bounds.lower, bounds.upper)
    step = (trial - values) / bounds.typical
    # Not as the difference of two chi squared, which is lost to rounding near the optimum.
    return trial, -2 * (gradient * step).sum(-1) - (step * _product(hessian, step)).sum(-1)


def _solution(matrix: Any, right: Any) -> Any:
    """Solution of a positive-definite system. A compiled program eliminates without pivoting, as
    such a matrix allows: LAPACK, which it would otherwise call, takes a tenth of a second to load.
    """
    if not isinstance(matrix, jax.core.Tracer):
        return np.linalg.solve(matrix, right[..., None])[..., 0]
    count = matrix.shape[-1]

    def eliminated(k: Any, system: Any) -> Any:
        row = jax.lax.dynamic_index_in_dim(system, k, -2)
        row = row / jax.lax.dynamic_index_in_dim(row, k, -1)
        rest = system - jax.lax.dynamic_index_in_dim(system, k, -1) * row
        return jnp.where(jnp.arange(count)[:, None] == k, row, rest)

    system = jnp.concatenate([matrix, right[..., None]], -1)
    return jax.lax.fori_loop(0, count, eliminated, system)[..., -1]


def _product(matrix: Any, vector: Any) -> Any:
    return (matrix @ vector[..., None])[..., 0]


def _repeat(condition: Callable[..., Any], body: Callable[..., Any], carry: tuple[Any, ...]) -> Any:
    """Run the body once, and again as long as the condition holds. A compiled program contains the
    body only once; a first run before the loop would duplicate it."""
    if isinstance(carry[0], jax.core.Tracer):
        _, carry = jax.lax.while_loop(
            lambda state: state[0] | condition(state[1]),
            lambda state: (jnp.zeros((), bool), body(state[1])),
            (jnp.ones((), bool), carry),
        )
        return carry
    carry = body(carry)
    while condition(carry):
        carry = body(carry)
    return carry
