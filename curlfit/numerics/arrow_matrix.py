"""Normal equations of blocks of residuals that have some parameters in common."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray


class ArrowMatrix(NamedTuple):
    """A symmetric matrix of the shape of an arrow, by the parameters that all blocks
    have in common and the own ones of each block.

    It is zero between the own parameters of two blocks, so that the cost of all
    operations is linear in the number of blocks.
    """

    corner: Array
    """of the common parameters"""
    edges: Array
    """between the own parameters of each block and the common ones, shape (blocks,
    own, common)"""
    diagonals: Array
    """of the own parameters of each block"""

    def split(self, vector: Array) -> tuple[Array, Array]:
        """The part of the common parameters of a vector, and that of each block, shape
        (blocks, own)."""
        count, own, common = self.edges.shape
        return vector[:common], vector[common:].reshape(count, own)

    def is_finite(self) -> Array:
        """Whether all numbers of the matrix are finite."""
        return jnp.stack([jnp.isfinite(part).all() for part in self]).all()

    def diagonal(self) -> Array:
        """The diagonal of the matrix."""
        of_blocks = jnp.diagonal(self.diagonals, axis1=1, axis2=2)
        return jnp.concatenate([jnp.diagonal(self.corner), of_blocks.ravel()])

    def mv(self, vector: Array) -> Array:
        """The product of the matrix and a vector."""
        common, own = self.split(vector)
        to_common = self.corner @ common + jnp.einsum("boc,bo->c", self.edges, own)
        to_own = self.edges @ common + jnp.einsum("bio,bo->bi", self.diagonals, own)
        return jnp.concatenate([to_common, to_own.ravel()])

    def scaled(self, by: Array, added: Array | float = 0.0) -> ArrowMatrix:
        """The matrix with rows and columns multiplied by a vector, and another vector
        added to the diagonal."""
        common, own = self.split(by)
        added_to_common, added_to_own = self.split(added + jnp.zeros_like(by))
        return ArrowMatrix(
            self.corner * (common[:, None] * common) + jnp.diag(added_to_common),
            self.edges * (own[..., None] * common),
            self.diagonals * (own[..., None] * own[:, None])
            + added_to_own[..., None] * jnp.eye(own.shape[1]),
        )

    def solve(self, right: Array) -> Array:
        """Solution of the system of this matrix, positive definite, by
        block elimination."""
        common, own = self.split(right)
        # The own parameters as a linear function of the common ones; the last column
        # is their value where those are zero.
        columns = jnp.concatenate([self.edges, own[..., None]], -1)
        solved = jax.vmap(_solutions)(self.diagonals, columns) if own.size else columns
        # what is left for the common parameters (Schur's complement)
        eliminated = jnp.einsum("boi,boj->ij", self.edges, solved)
        left_matrix = self.corner - eliminated[:, :-1]
        left_right = common - eliminated[:, -1]
        common = _solutions(left_matrix, left_right[:, None])[:, 0]
        own = solved[..., -1] - solved[..., :-1] @ common
        return jnp.concatenate([common, own.ravel()])


class Blocks(NamedTuple):
    """Which parameters each block of residuals depends on: the common ones, which are
    the first of the vector, and its own, which follow block by block."""

    index: Any
    """of the parameters in the vector, shape (blocks, parameters of a block)"""
    common: Any
    """places of the common parameters among those of a block"""
    own: Any
    """the other places"""

    @classmethod
    def of(cls, common: NDArray[np.bool_], count: int = 1) -> Blocks:
        """`count` blocks, of whose parameters `common` says which are in common."""
        common_places = np.flatnonzero(common)
        own_places = np.flatnonzero(~common)
        own_index = np.arange(count * len(own_places)).reshape(count, -1)
        index = np.zeros((count, len(common)), int)
        index[:, common_places] = np.arange(len(common_places))
        index[:, own_places] = len(common_places) + own_index
        return cls(index, common_places, own_places)

    def normal(self, columns: Array) -> ArrowMatrix:
        """J^T J from the Jacobian of each block, shape (blocks, rows, parameters
        of a block)."""
        products = columns.mT @ columns
        of_own = products[:, self.own]
        corner = products[:, self.common][..., self.common].sum(0)
        return ArrowMatrix(corner, of_own[..., self.common], of_own[..., self.own])


def _solutions(matrix: Array, right: Array) -> Array:
    """Solutions of a positive-definite system, one a column, by the elimination of
    Gauss and Jordan without pivoting: LAPACK, which JAX would otherwise call, takes a
    tenth of a second to load."""

    def eliminated(k: Any, system: Array) -> Array:
        """The system with column k of the matrix made that of the identity."""
        row = jax.lax.dynamic_index_in_dim(system, k, -2)
        row = row / jax.lax.dynamic_index_in_dim(row, k, -1)
        other_rows = system - jax.lax.dynamic_index_in_dim(system, k, -1) * row
        return jnp.where(jnp.arange(len(matrix))[:, None] == k, row, other_rows)

    system = jnp.concatenate([matrix, right], -1)
    return jax.lax.fori_loop(0, len(matrix), eliminated, system)[:, len(matrix) :]
