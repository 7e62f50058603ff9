"""Normal equations of blocks of residuals that have some parameters in common."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray


class ArrowMatrix(NamedTuple):
    """A symmetric matrix of the shape of an arrow: nothing stands between the own
    parameters of two blocks, so that all that is done with it costs as much for each
    further block."""

    corner: Array
    """of the common parameters"""
    edges: Array
    """between the own parameters of each block and the common ones, shape (blocks,
    own, common)"""
    diagonals: Array
    """of the own parameters of each block"""

    def split(self, vector: Array) -> tuple[Array, Array]:
        """The part of the common parameters, and that of each block."""
        count, own, common = self.edges.shape
        return vector[:common], vector[common:].reshape(count, own)

    def is_finite(self) -> Array:
        """Whether all of it is."""
        return jnp.stack([jnp.isfinite(part).all() for part in self]).all()

    def diagonal(self) -> Array:
        """Its diagonal."""
        own = jnp.diagonal(self.diagonals, axis1=1, axis2=2)
        return jnp.concatenate([jnp.diagonal(self.corner), own.ravel()])

    def mv(self, vector: Array) -> Array:
        """Its product with a vector."""
        common, own = self.split(vector)
        first = self.corner @ common + jnp.einsum("boc,bo->c", self.edges, own)
        other = self.edges @ common + jnp.einsum("bio,bo->bi", self.diagonals, own)
        return jnp.concatenate([first, other.ravel()])

    def scaled(self, by: Array, added: Array | float = 0.0) -> ArrowMatrix:
        """Rows and columns multiplied by a vector, and another one added to
        the diagonal."""
        common, own = self.split(by)
        to_common, to_own = self.split(added + jnp.zeros_like(by))
        return ArrowMatrix(
            self.corner * (common[:, None] * common) + jnp.diag(to_common),
            self.edges * (own[..., None] * common),
            self.diagonals * (own[..., None] * own[:, None])
            + to_own[..., None] * jnp.eye(own.shape[1]),
        )

    def solve(self, right: Array) -> Array:
        """Solution of the system of this matrix, positive definite, by
        block elimination."""
        common, own = self.split(right)
        columns = jnp.concatenate([self.edges, own[..., None]], -1)
        inverse = jax.vmap(_solutions)(self.diagonals, columns) if own.size else columns
        reduced = jnp.einsum("boi,boj->ij", self.edges, inverse)
        left, found = self.corner - reduced[:, :-1], common - reduced[:, -1]
        found = _solutions(left, found[:, None])[:, 0]
        other = inverse[..., -1] - inverse[..., :-1] @ found
        return jnp.concatenate([found, other.ravel()])


class Blocks(NamedTuple):
    """Which parameters each block of residuals depends on: some that all have
    in common, which are the first of the vector, and its own, which follow
    block by block."""

    index: Any
    """in the vector, shape (blocks, parameters of a block)"""
    common: Any
    """places of the common parameters among those of a block"""
    own: Any
    """the other places"""

    @classmethod
    def of(cls, common: NDArray[np.bool_], count: int = 1) -> Blocks:
        """Of `count` blocks; `common` says which parameters of a block
        are in common."""
        own = np.flatnonzero(~common)
        shape, places = (count, len(common)), np.flatnonzero(common)
        index = np.zeros(shape, int)
        index[:, places] = np.arange(len(places))
        index[:, own] = len(places) + np.arange(count * len(own)).reshape(count, -1)
        return cls(index, places, own)

    def normal(self, columns: Array) -> ArrowMatrix:
        """J^T J from the Jacobian of each block, shape (blocks, rows, parameters
        of a block)."""
        square = columns.mT @ columns
        beside = square[:, self.own]
        corner = square[:, self.common][..., self.common].sum(0)
        return ArrowMatrix(corner, beside[..., self.common], beside[..., self.own])


def _solutions(matrix: Array, right: Array) -> Array:
    """Solutions of a positive-definite system, one a column, by elimination
    without pivoting: LAPACK, which JAX would otherwise call, takes a tenth of a
    second to load."""

    def eliminated(k: Any, system: Array) -> Array:
        row = jax.lax.dynamic_index_in_dim(system, k, -2)
        row = row / jax.lax.dynamic_index_in_dim(row, k, -1)
        rest = system - jax.lax.dynamic_index_in_dim(system, k, -1) * row
        return jnp.where(jnp.arange(len(matrix))[:, None] == k, row, rest)

    system = jnp.concatenate([matrix, right], -1)
    return jax.lax.fori_loop(0, len(matrix), eliminated, system)[:, len(matrix) :]
