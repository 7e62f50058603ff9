"""A matrix whose rows and columns are parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.records import Entry, Matrix


@dataclass(frozen=True, eq=False)
class NamedMatrix(Entry):
    """A symmetric matrix of some parameters.

    Attributes
    ----------
    names : of the parameters, in the order of rows and columns.
    matrix : shape (parameters, parameters).
    """

    names: tuple[str, ...]
    matrix: Matrix

    def __post_init__(self) -> None:
        """Protect the numbers of a record from a computation in place."""
        object.__setattr__(self, "matrix", read_only(self.matrix))

    def among(self, names: Sequence[str]) -> Floats:
        """The matrix of some of its parameters, in their order."""
        indices = [self.names.index(name) for name in names]
        block: Floats = self.matrix[np.ix_(indices, indices)]
        return block


def read_only(array: Floats) -> Floats:
    """A copy of an array that cannot be changed."""
    copy: Floats = np.array(array, float)
    copy.setflags(write=False)
    return copy
