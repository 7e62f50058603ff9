"""A fitted path to first order: its changes with the parameters and with
missing accelerations.

Identification. The amplitudes of a discrepancy are conditioned to leave the
least-squares estimates of the law's coefficients unchanged (as in Plumlee 2017, Journal
of the American Statistical Association 112, 1274), while those of the initial state
would adjust. A fit reports the path of the law nearest to the data; that adjustment is
part of the error of its initial state.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import cho_solve, solve_triangular

from curlfit.inference.information.directions import directions_of_squares
from curlfit.inference.noise.accelerations import amplitude_root
from curlfit.noises import Filter, Noise
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import compiled
from curlfit.throws.channels import CHANNELS

_FEWEST = 20  # values of a channel, at least, for its noise to be estimated
_ROUNDING = 1e-13  # of the sum of the eigenvalues of a matrix of products
_NOTHING = 1e-9  # singular value over the largest, below which it is rounding error


class Linearized(NamedTuple):
    """A fitted path and what can change it, to first order; SI, shapes
    (channels, n, ...)."""

    gaps: Any
    """time to the next row, s, shape (n,)"""
    weight: Any
    """1/sigma, 0 where nothing was observed"""
    residual: Any
    """measured - fitted, 0 where nothing was observed"""
    jacobian: Any
    """derivatives by the directions of the parameters, in units of their
    standard errors"""
    responses: Any
    """derivatives by the amplitudes of missing accelerations; none without
    a discrepancy"""
    from_standard: Any
    """from directions to parameters, shape (parameters, directions)"""
    to_standard: Any
    held: Any
    """directions of the coefficients among all, as orthonormal rows"""
    span: Any
    """time after the first row during which the stone moves, s"""

    @classmethod
    def of(
        cls,
        times: Floats,
        weight: Floats,
        residual: Floats,
        jacobian: Floats,
        typical: Floats,
        adjustable: Booleans,
        coefficients: int,
    ) -> Self:
        """From the derivatives by all parameters; without a discrepancy, of a stone
        that moves up to the last row.

        Parameters
        ----------
        times : of the rows, s, shape (n,).
        jacobian : derivatives of the path by the parameters.
        typical : sizes of the parameters, the law's coefficients first; their number is
            `coefficients`.
        adjustable : which parameters are neither fixed nor at a bound.
        """
        own = (weight[..., None] * jacobian * adjustable).reshape(-1, len(typical))
        rows, singular, _ = directions_of_squares(own.T @ own, typical)
        missing = ((0, 0), (0, len(typical) - len(rows)))
        from_standard = np.pad(typical[:, None] * rows.T / singular, missing)
        to_standard = np.pad((singular[:, None] * rows / typical).T, missing).T
        law = from_standard[:coefficients] / typical[:coefficients, None]
        _, sizes, held = np.linalg.svd(law, full_matrices=False)
        held = np.where((sizes > _NOTHING * sizes.max(initial=0.0))[:, None], held, 0.0)
        return cls(
            np.diff(times, append=times[-1]),
            weight,
            residual,
            jacobian @ from_standard,
            jacobian[..., :0],
            from_standard,
            to_standard,
            held,
            np.asarray(times[-1] - times[0]),
        )

    @property
    def columns(self) -> Any:
        """Directions, amplitudes and, last, the residual, over sigma."""
        parts = self.jacobian, self.responses, self.residual[..., None]
        return self.weight[..., None] * jnp.concatenate(parts, -1)

    def first(self, channels: int) -> Self:
        """Of the first channels alone."""
        parts = self.weight, self.residual, self.jacobian, self.responses
        weight, residual, jacobian, responses = (part[:channels] for part in parts)
        return self._replace(
            weight=weight, residual=residual, jacobian=jacobian, responses=responses
        )

    @property
    def enough(self) -> Booleans:
        """Which channels have enough values for their noise to be estimated."""
        found: Booleans = (self.weight > 0).sum(1) >= _FEWEST
        found[len(CHANNELS) :] = False
        return found

    @property
    def coupling(self) -> Any:
        """Change of the least-squares estimates of the directions for
        each amplitude."""
        rows = self.weight[..., None] ** 2 * self.responses
        return (self.jacobian.mT @ rows).sum(0)

    @property
    def paid(self) -> Any:
        """Derivatives of the path by the amplitudes while the parameters adjust."""
        return self.responses - self.jacobian @ self.coupling

    def regression(self, noise: Filter, scale: Any) -> Regression:
        """After a filter of the noise, with sigma times `scale` by channel."""
        p, columns = (
            len(self.held.T),
            noise.innovations(self.columns) / scale[:, None, None],
        )
        columns = columns.reshape(-1, columns.shape[-1])
        own, others = columns[:, :p], columns[:, p:]
        precision = own.T @ own
        precision += jnp.diag(jnp.where(jnp.diag(precision) > 0, 0.0, 1.0))
        # The products of what is left, not a difference of products: rounding keeps
        # it positive.
        left = others - own @ cho_solve(
            (jnp.linalg.cholesky(precision), True), own.T @ others
        )
        return Regression(left.T @ left, precision, self.held @ self.coupling)

    def covariance(self, noise: Noise, times: Floats, scale: Floats) -> Floats:
        """Of the least-squares estimates of the directions under noise with sigma
        times `scale`."""
        found = np.zeros((len(self.held.T),) * 2)
        correlated = noise.correlated
        for row, (weight, factor) in enumerate(zip(self.weight, scale, strict=True)):
            name = [*CHANNELS, ""][row]
            seen = weight > 0
            rows = factor * weight[seen, None] * self.jacobian[row, seen]
            if name in correlated:
                found += rows.T @ noise.covariance(name, times[seen]) @ rows
            else:
                found += rows.T @ rows
        return found


class Regression(NamedTuple):
    """Regression of amplitudes' columns and residual on the parameters, over
    independent values."""

    left: Any
    """products of what is left of these columns"""
    precision: Any
    """of the directions"""
    held: Any
    """combinations of amplitudes that are zero"""

    def log_likelihood(self, sizes: Any) -> Array:
        """Restricted log-likelihood of the sizes of a discrepancy, up to a constant."""
        spent = jnp.linalg.slogdet(self.precision)[1] / 2
        if not len(sizes):
            return -spent - self.left[-1, -1] / 2
        lower, white, _ = self.posterior(sizes)
        return (
            -spent
            - jnp.log(jnp.diag(lower)).sum()
            - (self.left[-1, -1] - white @ white) / 2
        )

    def posterior(self, sizes: Any) -> tuple[Array, Array, Array]:
        """Of z, where the amplitudes are F z: the Cholesky factor L of its precision,
        L^T times its mean, and F."""
        found: tuple[Array, Array, Array] = _posterior(self, sizes)
        return found

    def mean(self, sizes: Any) -> Floats:
        """Mean of the amplitudes given the residuals, for NumPy."""
        lower, white, root = map(np.asarray, self.posterior(sizes))
        found: Floats = root @ np.linalg.solve(lower.T, white)
        return found


@compiled()
def _posterior(regression: Regression, sizes: Array) -> tuple[Array, Array, Array]:
    root = amplitude_root(sizes, regression.held)
    sums = root.T @ regression.left[:-1, :-1] @ root
    # sums of tiny noise have rounding errors above 1
    floor = 1 + _ROUNDING * jnp.trace(sums)
    lower = jnp.linalg.cholesky(floor * jnp.eye(len(root)) + sums)
    return (
        lower,
        solve_triangular(lower, root.T @ regression.left[:-1, -1], lower=True),
        root,
    )


regression_of = compiled()(Linearized.regression)
