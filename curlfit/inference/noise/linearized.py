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

import jax
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
# names of the rows of values; those of the last, the events, have independent noise
CHANNELS_AND_EVENTS = (*CHANNELS, "")


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
    """from parameters to directions, shape (directions, parameters)"""
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
        columns = (weight[..., None] * jacobian * adjustable).reshape(-1, len(typical))
        rows, singular, _ = directions_of_squares(columns.T @ columns, typical)
        # zeros in place of directions that are not determined
        undetermined = ((0, 0), (0, len(typical) - len(rows)))
        from_standard = np.pad(typical[:, None] * rows.T / singular, undetermined)
        to_standard = np.pad((singular[:, None] * rows / typical).T, undetermined).T
        of_law = from_standard[:coefficients] / typical[:coefficients, None]
        _, sizes, held = np.linalg.svd(of_law, full_matrices=False)
        is_varied = sizes > _NOTHING * sizes.max(initial=0.0)
        return cls(
            gaps=np.diff(times, append=times[-1]),
            weight=weight,
            residual=residual,
            jacobian=jacobian @ from_standard,
            responses=jacobian[..., :0],
            from_standard=from_standard,
            to_standard=to_standard,
            held=np.where(is_varied[:, None], held, 0.0),
            span=np.asarray(times[-1] - times[0]),
        )

    @property
    def columns(self) -> Any:
        """Derivatives by directions and amplitudes and, last, the residual, over
        sigma."""
        columns = (self.jacobian, self.responses, self.residual[..., None])
        return self.weight[..., None] * jnp.concatenate(columns, -1)

    def first(self, channels: int) -> Self:
        """The path in the first channels alone."""
        return self._replace(
            weight=self.weight[:channels],
            residual=self.residual[:channels],
            jacobian=self.jacobian[:channels],
            responses=self.responses[:channels],
        )

    @property
    def enough(self) -> Booleans:
        """Which channels have enough values for their noise to be estimated."""
        has_enough: Booleans = (self.weight > 0).sum(1) >= _FEWEST
        has_enough[len(CHANNELS) :] = False
        return has_enough

    @property
    def coupling(self) -> Any:
        """Change of the least-squares estimates of the directions for
        each amplitude."""
        rows = self.weight[..., None] ** 2 * self.responses
        return (self.jacobian.mT @ rows).sum(0)

    @property
    def adjusted_responses(self) -> Any:
        """Derivatives of the path by the amplitudes while the parameters adjust."""
        return self.responses - self.jacobian @ self.coupling

    def regression(self, noise: Filter, scale: Any) -> Regression:
        """The regression after a filter of the noise, with sigma times `scale` by
        channel."""
        columns = noise.innovations(self.columns) / scale[:, None, None]
        columns = columns.reshape(-1, columns.shape[-1])
        directions = len(self.held.T)
        by_direction = columns[:, :directions]
        other_columns = columns[:, directions:]
        precision = by_direction.T @ by_direction
        # 1 of directions that are not determined, whose columns are zero
        precision += jnp.diag(jnp.where(jnp.diag(precision) > 0, 0.0, 1.0))
        factor = (jnp.linalg.cholesky(precision), True)
        # The products of what is left, not a difference of products: rounding keeps
        # it positive.
        left = other_columns - by_direction @ cho_solve(
            factor, by_direction.T @ other_columns
        )
        return Regression(left.T @ left, precision, self.held @ self.coupling)

    def covariance(self, noise: Noise, times: Floats, scale: Floats) -> Floats:
        """Covariance of the least-squares estimates of the directions under noise with
        sigma times `scale`."""
        directions = len(self.held.T)
        covariance = np.zeros((directions, directions))
        correlated = noise.correlated
        for row, (weight, factor) in enumerate(zip(self.weight, scale, strict=True)):
            channel = CHANNELS_AND_EVENTS[row]
            measured = weight > 0
            columns = factor * weight[measured, None] * self.jacobian[row, measured]
            if channel in correlated:
                of_noise = noise.covariance(channel, times[measured])
                covariance += columns.T @ of_noise @ columns
            else:
                covariance += columns.T @ columns
        return covariance


class Regression(NamedTuple):
    """Regression of amplitudes' columns and residual on the parameters, over
    independent values."""

    products: Any
    """of what is left of these columns when the parameters are fitted to them"""
    precision: Any
    """of the directions"""
    held: Any
    """combinations of amplitudes that are zero"""

    def log_likelihood(self, sizes: Any) -> Array:
        """Restricted log-likelihood of the sizes of a discrepancy, up to a constant."""
        by_parameters = jnp.linalg.slogdet(self.precision)[1] / 2
        chi_squared = self.products[-1, -1]
        if not len(sizes):
            return -by_parameters - chi_squared / 2
        lower, white, _ = self.posterior(sizes)
        by_amplitudes = jnp.log(jnp.diag(lower)).sum()
        return -by_parameters - by_amplitudes - (chi_squared - white @ white) / 2

    def posterior(self, sizes: Any) -> tuple[Array, Array, Array]:
        """Posterior of z, where the amplitudes are F z: the Cholesky factor L of its
        precision, L^T times its mean, and F."""
        posterior: tuple[Array, Array, Array] = _posterior(self, sizes)
        return posterior

    def mean(self, sizes: Any) -> Floats:
        """Mean of the amplitudes given the residuals, for NumPy."""
        lower, white, root = jax.device_get(self.posterior(sizes))
        mean: Floats = root @ np.linalg.solve(lower.T, white)
        return mean


@compiled()
def _posterior(regression: Regression, sizes: Array) -> tuple[Array, Array, Array]:
    root = amplitude_root(sizes, regression.held)
    products = root.T @ regression.products[:-1, :-1] @ root
    # the prior precision of z; products of tiny noise have rounding errors above 1
    floor = 1 + _ROUNDING * jnp.trace(products)
    lower = jnp.linalg.cholesky(floor * jnp.eye(len(root)) + products)
    right = root.T @ regression.products[:-1, -1]
    return lower, solve_triangular(lower, right, lower=True), root


regression_of = compiled()(Linearized.regression)
