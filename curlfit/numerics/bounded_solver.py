"""Least squares within bounds: a descent, a search and a solver of optimistix.

Bounds are enforced by projection (Kanzow, Yamashita and Fukushima 2004). Damping is
scaled by the columns of the Jacobian (Marquardt 1963), which makes the steps
independent of units.

A solve has converged when the residual is orthogonal to all changes that a step could
make, by the relative offset of Bates and Watts (1981): the length of the part of the
residual that the next step removes, relative to that of the residual. The reductions of
the last two steps predict that of the next, so the last step needs no evaluation of its
own. Near the end, steps gain less than the rounding error of the loss, which then shows
neither whether a step was good nor when to stop. There, steps are taken as long as they
become shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array

from curlfit.numerics.arrow_matrix import ArrowMatrix, Blocks

# damping, relative to the squared columns (Marquardt)
_LEAST_DAMPING = 1e-12
_MOST_DAMPING = 1e8
_LESS = 0.1  # factor of the damping after a step as predicted
_SLIGHTLY_MORE = 2.0  # largest factor after an accepted step
_MORE = 3.0  # factor after a rejected step ...
_FASTER = 2.0  # ... and of this factor after each further rejection
_ROUNDING = 1e-10  # share of the loss up to which a change may be rounding error
_STEEPER = 30.0  # factor of the damping of a step that leads uphill
_UPHILL = 1e-8  # share of the loss by which a projected step may lead uphill
_HEAVY = 1.0  # damping above which a small reduction says nothing about the optimum
# share of the loss, or of values, left to gain where no trial is accepted
_STALLED = 1e-6
_SMALL = 1e-10  # negligible step, relative to the size of the values
# longest step that is taken without an evaluation, over the size of the values
_UNSEEN_STEP = 0.1
_REGULAR = 1e-14  # damping that keeps the normal matrix nonsingular on an exact ridge
# smallest square of a column over the largest, and by itself, in place of zero
_LEAST_SQUARE = 1e-24
_TINY = 1e-300

Quadratic = Any
"""The Gauss-Newton model of the loss, half the sum of squares, about some values: an
`EvalGradHessian` of optimistix, whose Hessian is an `ArrowMatrix`."""


class BoundedDescent(optx.AbstractDescent):
    """The damped step within the bounds, by active sets.

    A parameter at a bound that is pushed against it is held there. One that would pass
    its bound is set to the bound, and the others are solved for again. A parameter with
    equal bounds is fixed: it is held throughout, and its column of the Jacobian is
    not used.
    """

    lower: Array
    upper: Array
    typical: Array
    """sizes of the parameters"""

    def init(self, y: Array, f_info_struct: Any) -> Any:
        """Required by optimistix."""
        return y, f_info_struct

    def query(self, y: Array, f_info: Quadratic, state: Any) -> Any:
        """The values, and the gradient and Hessian there in parameters over
        typical sizes."""
        return y, f_info.grad * self.typical, f_info.hessian.scaled(self.typical)

    def step(self, step_size: Any, state: Any) -> tuple[Array, Any]:
        """The step whose damping is one over the step size."""
        values, gradient, hessian = state
        # the bounds of the step, over typical sizes
        lower = (self.lower - values) / self.typical
        upper = (self.upper - values) / self.typical
        pushed_to_lower = (lower >= 0) & (gradient >= 0)
        pushed_to_upper = (upper <= 0) & (gradient <= 0)
        held = pushed_to_lower | pushed_to_upper | (lower >= upper)
        square = jnp.where(held, 0.0, hessian.diagonal())
        least_square = _LEAST_SQUARE * square.max() + _TINY
        column_size = jnp.sqrt(jnp.maximum(square, least_square))

        def outside(held: Array, step: Array) -> Array:
            return ~held & ((step < lower) | (step > upper))

        def with_more_held(held: Array, step: Array) -> tuple[Array, Array]:
            """The step of the others, with those outside held at their bounds."""
            held = held | outside(held, step)
            step = jnp.where(held, jnp.clip(step, lower, upper), 0.0)
            scale = jnp.where(held, 0.0, 1 / column_size)
            # Scaled to unit diagonal, so that the damping keeps it nonsingular.
            damping = jnp.where(held, 1.0, 1 / step_size + _REGULAR)
            matrix = hessian.scaled(scale, damping)
            right = -(gradient + hessian.mv(step)) * scale
            return held, jnp.where(held, step, matrix.solve(right) * scale)

        def any_outside(held: Array, step: Array) -> Array:
            return outside(held, step).any()

        start = (held, jnp.zeros_like(values))
        _, step = _repeated(with_more_held, any_outside, start)
        change = jnp.clip(step * self.typical, self.lower - values, self.upper - values)
        return change, optx.RESULTS.successful

    def moved(self, y: Array, change: Array) -> Array:
        """The values after a step, which reaches a bound exactly."""
        at_lower = change <= self.lower - y
        at_upper = change >= self.upper - y
        moved = jnp.where(at_upper, self.upper, y + change)
        return jnp.clip(jnp.where(at_lower, self.lower, moved), self.lower, self.upper)


class Damping(NamedTuple):
    """State of the search."""

    damping: Array
    growth: Array
    """factor of the damping if the trial is rejected"""
    reduction: Array
    """of the loss, predicted for the step to the trial; inf before the first"""


class GainRatio(optx.AbstractSearch):
    """Damping by the ratio of the actual to the predicted reduction (Nielsen 1999)."""

    first: Any
    """damping of the first step"""

    def init(self, y: Array, f_info_struct: Any) -> Damping:
        """Required by optimistix."""
        return Damping(*map(jnp.asarray, (self.first, _MORE, jnp.inf)))

    def predicted(self, change: Array, f_info: Quadratic) -> Array:
        """Reduction of the loss by a step, not as a difference of two losses, which is
        lost to rounding near the optimum."""
        return -(f_info.grad @ change) - f_info.hessian.mv(change) @ change / 2

    def step(
        self,
        first_step: Array,
        y: Array,
        y_eval: Array,
        f_info: Quadratic,
        f_eval_info: Quadratic,
        state: Damping,
    ) -> tuple[Array, Array, Any, Damping]:
        """Judge the trial; the reduction becomes inf where it is rejected."""
        before = f_info.f
        now = f_eval_info.f
        below_rounding = (state.reduction <= _ROUNDING * before) & (
            now <= (1 + _ROUNDING) * before
        )
        accept = (now <= before) | below_rounding
        accept &= jnp.isfinite(now) & f_eval_info.hessian.is_finite()
        # Where the ratio says something; elsewhere the step counts as predicted.
        is_measured = jnp.isfinite(before) & jnp.isfinite(now) & ~below_rounding
        fall = jnp.where(is_measured, before, 1.0) - jnp.where(is_measured, now, 0.0)
        gain = fall / jnp.maximum(state.reduction, _TINY)
        gain = jnp.where(is_measured, gain, 1.0)
        # a tenth at a gain as predicted, 1 at half of it, up to 2 below
        after_accepted = jnp.clip(1 - (2 * gain - 1) ** 3, _LESS, _SLIGHTLY_MORE)
        factor = jnp.where(accept, after_accepted, state.growth)
        search = Damping(
            damping=jnp.maximum(state.damping * factor, _LEAST_DAMPING),
            growth=jnp.where(accept, _MORE, state.growth * _FASTER),
            reduction=jnp.where(accept, state.reduction, jnp.inf),
        )
        return 1 / search.damping, accept, optx.RESULTS.successful, search


class SolverState(eqx.Module):
    """A solve; model, residual and Jacobian are those at the best values."""

    trial: Array
    """where to evaluate next"""
    model: Quadratic
    residual: Array
    jacobian: Array
    """shape (*residual, parameters of a block)"""
    search: Damping
    settled: Array
    """whether the first, least damped step from the best values was predicted
    to gain little"""
    evaluations: Array
    done: Array
    success: Array


class BoundedLeastSquares(optx.AbstractLeastSquaresSolver):
    """The Levenberg-Marquardt method within bounds.

    The Jacobian may consist of blocks of rows, each of which depends on some of the
    parameters, so that one tangent serves a parameter of every block.
    """

    descent: BoundedDescent
    search: GainRatio
    control: Any
    """with `extrapolated`, the share of the loss that the last step, which is not
    evaluated, may gain; `remaining`, the share that the step after it might gain; and
    the `most` evaluations"""
    blocks: Blocks
    penalty: Any
    """adds its `quadratic(values)` to the loss: terms of the loss, of its gradient and
    of the diagonal of its Hessian"""
    rtol: float
    atol: float
    norm: Callable[..., Any]

    def __init__(
        self,
        descent: BoundedDescent,
        search: GainRatio,
        control: Any,
        blocks: Blocks,
        penalty: Any,
    ) -> None:
        self.descent, self.search, self.control = descent, search, control
        self.blocks, self.penalty = blocks, penalty
        self.rtol = self.atol = 0.0  # required by optimistix
        self.norm = optx.max_norm

    def init(
        self,
        fn: Any,
        y: Array,
        args: Any,
        options: Any,
        f_struct: Any,
        aux_struct: Any,
        tags: Any,
    ) -> SolverState:
        """Required by optimistix."""
        count, width = self.blocks.index.shape
        no_hessian = self.blocks.normal(jnp.zeros((count, 0, width)))
        model = _quadratic(jnp.full((), jnp.inf), jnp.zeros_like(y), no_hessian)
        no = jnp.zeros((), bool)
        # not evaluated yet
        rows = jnp.full((*f_struct.shape, 1 + width), jnp.nan)
        return SolverState(
            trial=self.descent.moved(y, jnp.zeros_like(y)),
            model=model,
            residual=rows[..., 0],
            jacobian=rows[..., 1:],
            search=self.search.init(y, model),
            settled=no,
            evaluations=jnp.zeros((), int),
            done=no,
            success=no,
        )

    def step(
        self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any
    ) -> tuple[Array, SolverState, Any]:
        """Evaluate the trial, judge it, and choose the next or the last step."""
        model, residual, jacobian, aux = self._evaluated(
            lambda values: fn(values, args), state.trial
        )
        _, accept, _, search = self.search.step(
            state.evaluations == 0, y, state.trial, state.model, model, state.search
        )
        y, model, residual, jacobian = jax.tree.map(
            lambda new, old: jnp.where(accept, new, old),
            (state.trial, model, residual, jacobian),
            (y, state.model, state.residual, state.jacobian),
        )
        evaluations = state.evaluations + 1
        loss = model.f
        failed = ~jnp.isfinite(loss) | (evaluations >= self.control.most)
        descent = self.descent.query(y, model, None)

        def uphill(damping: Array, _: Array, reduction: Array) -> Array:
            return ~failed & (reduction < -_UPHILL * loss) & (damping <= _MOST_DAMPING)

        def shorter(
            damping: Array, change: Array, reduction: Array
        ) -> tuple[Array, Array, Array]:
            damping = jnp.where(
                uphill(damping, change, reduction), damping * _STEEPER, damping
            )
            change, _ = self.descent.step(1 / damping, descent)
            return damping, change, self.search.predicted(change, model)

        # A step to a bound may lead uphill; a shorter one does not.
        begin = (search.damping, jnp.zeros_like(y), jnp.zeros(()))
        damping, change, reduction = _repeated(shorter, uphill, begin)
        failed |= damping > _MOST_DAMPING

        # The end, first by the reductions: that of the step after this one is
        # extrapolated from their ratio.
        light = damping <= _HEAVY
        previous = search.reduction
        ratio = jnp.where(
            jnp.isfinite(previous), reduction / jnp.maximum(previous, _TINY), 1.0
        )
        after = reduction * jnp.where(ratio < 1, ratio, 1.0)
        last = reduction <= self.control.extrapolated * loss
        last &= (after <= self.control.remaining * loss) & light & ~failed
        not_shrinking = (previous <= _ROUNDING * loss) & (reduction >= previous)
        # by the length of the step
        share = jnp.abs(change) / (self.descent.typical + jnp.abs(y))
        small = (share <= _SMALL).all() & (damping <= self.search.first)
        # If the model is not smooth, trials may be rejected however short
        # the steps are.
        negligible = (reduction <= _STALLED * loss) | (share <= _STALLED).all()
        settled = jnp.where(accept, negligible, state.settled)
        stalled = (damping > _MOST_DAMPING) & settled
        success = (~failed & (last | (not_shrinking & light) | small)) | stalled

        # A far step gains nothing along a level direction, and is not taken unseen.
        step = jnp.where(last & (share <= _UNSEEN_STEP).all(), change, 0.0)
        # of each block, before all of its rows
        step_by_block = step[self.blocks.index].reshape(
            -1, *(1,) * (residual.ndim - 1), jacobian.shape[-1]
        )
        residual = residual + (jacobian * step_by_block).sum(-1)
        state = SolverState(
            trial=self.descent.moved(y, change),
            model=model,
            residual=residual,
            jacobian=jacobian,
            search=Damping(damping, search.growth, reduction),
            settled=settled,
            evaluations=evaluations,
            done=failed | success,
            success=success,
        )
        return self.descent.moved(y, step), state, aux

    def _evaluated(
        self, function: Any, values: Array
    ) -> tuple[Quadratic, Array, Array, Any]:
        """The model of the loss at some values, with residual, Jacobian and what else
        the function returns."""
        index = self.blocks.index
        count, width = index.shape
        # One seed for each place of a parameter in a block: every block moves along its
        # own parameter at this place.
        seeds = jnp.zeros((values.size, width)).at[index, jnp.arange(width)].set(1.0)

        def along(seed: Array) -> Any:
            return jax.jvp(function, (values,), (seed,), has_aux=True)

        residual, jacobian, aux = jax.vmap(along, 1, (None, -1, None))(seeds)
        rows = residual.reshape(count, -1, 1)
        columns = jacobian.reshape(count, -1, width)
        loss = (residual**2).sum() / 2
        gradient = jnp.zeros(values.size).at[index].add((columns.mT @ rows)[..., 0])
        hessian = self.blocks.normal(columns)
        of_loss, of_gradient, of_hessian = self.penalty.quadratic(values)
        hessian = hessian.scaled(jnp.ones_like(values), of_hessian)
        model = _quadratic(loss + of_loss, gradient + of_gradient, hessian)
        return model, residual, jacobian, aux

    def terminate(
        self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        """Required by optimistix."""
        failed = state.done & ~state.success
        result = optx.RESULTS.where(
            failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        return state.done, result

    def postprocess(
        self,
        fn: Any,
        y: Array,
        aux: Any,
        args: Any,
        options: Any,
        state: SolverState,
        tags: Any,
        result: Any,
    ) -> tuple[Array, Any, dict[str, Any]]:
        """Required by optimistix."""
        return y, aux, {}


def _quadratic(loss: Array, gradient: Array, hessian: ArrowMatrix) -> Quadratic:
    return optx.FunctionInfo.EvalGradHessian(loss, gradient, hessian)


def _repeated(
    body: Callable[..., Any], condition: Callable[..., Any], carry: Any
) -> Any:
    """Run the body once, and again as long as the condition holds. The program contains
    the body only once; a first run before the loop would duplicate it."""
    _, carry = jax.lax.while_loop(
        lambda state: state[0] | condition(*state[1]),
        lambda state: (jnp.zeros((), bool), body(*state[1])),
        (jnp.ones((), bool), carry),
    )
    return carry
