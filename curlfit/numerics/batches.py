"""Records of equal shapes: stacked, and computed many at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, TypeVar

import jax
import numpy as np

BATCH = 64
"""Throws or vectors in one call of a program: few enough for a processor's cache,
enough to amortize the cost of a pass."""
FEW = 16
"""The same where there are few, and a program compiled quickly is better
than a fast one."""

Record = TypeVar("Record")


def side_by_side(count: int) -> int:
    """How many of `count` problems are best solved side by side: those of a batch end
    together, and one that is not full costs as much as a full one."""
    return FEW if count <= BATCH else BATCH


def stacked(records: Sequence[Record]) -> Record:
    """Records of equal shapes as one record, stacked along the first axis
    of each array."""
    record: Record = jax.tree.map(lambda *leaves: np.stack(leaves), *records)
    return record


def unstacked(stack: Any) -> list[Any]:
    """The records of a stack."""
    leaves, tree = jax.tree.flatten(stack)
    return [jax.tree.unflatten(tree, parts) for parts in zip(*leaves, strict=True)]


def at(stack: Any, which: Any) -> Any:
    """The record of a stack at an index, or a stack of those at several."""
    return jax.tree.map(itemgetter(which), stack)


def in_batches(
    program: Callable[..., Any], stacks: tuple[Any, ...], batch: int = BATCH
) -> Any:
    """Apply a program for `batch` records to the arrays of any number of records."""
    count = len(jax.tree.leaves(stacks)[0])
    rows = np.minimum(np.arange(-(-count // batch) * batch), count - 1)
    parts = [
        program(
            *jax.tree.map(lambda leaf, rows=rows[k : k + batch]: leaf[rows], stacks)
        )
        for k in range(0, count, batch)
    ]
    return jax.tree.map(
        lambda *leaves: (
            np.concatenate(leaves) if parts[1:] else np.asarray(leaves[0])
        )[:count],
        *parts,
    )
