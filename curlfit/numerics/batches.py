"""Records of equal shapes: stacked, and computed many at a time.

Here it is decided in which sizes programs are made. A stack has a first axis, also that
of one record, and a program takes one, `FEW` or `BATCH` records of it:

- one, where all that is asked for is one throw: its program has no `vmap`, under which
  both branches of each condition are computed (four times slower for one throw);
- `FEW`, where their number is small or not known when the program is made;
- `BATCH`, where there are more. Only there a faster program is worth a longer
  compilation.
"""

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


def is_worth_optimizing(throws: int) -> bool:
    """Whether a fast program for so many throws is better than one compiled quickly."""
    return throws > FEW


def over_stack(function: Callable[..., Any], *stacks: Any) -> Any:
    """The results of a traced function of one record for each of a stack."""
    if len(jax.tree.leaves(stacks)[0]) > 1:
        return jax.vmap(function)(*stacks)
    result = function(*at(stacks, 0))
    return jax.tree.map(lambda leaf: leaf[None], result)


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
