"""Stacks of records, and the sizes of programs for them."""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np

from curlfit.numerics.batches import BATCH, FEW, in_batches, over_stack, side_by_side


class Pair(NamedTuple):
    left: np.ndarray
    right: np.ndarray


def pairs(count: int) -> Pair:
    values = np.arange(2.0 * count).reshape(2, count, 1)
    return Pair(*values)


def product(pair: Pair, factor):
    return {"product": factor * (pair.left * pair.right).sum()}


def test_a_stack_of_one_is_computed_without_vmap_and_alike():
    factors = np.array([2.0, 3.0])
    expected = factors * np.prod([[0.0, 1.0], [2.0, 3.0]], axis=0)
    stack = pairs(2)
    products = over_stack(product, stack, factors)["product"]
    assert products.tolist() == expected.tolist()
    first = Pair(stack.left[:1], stack.right[:1])
    alone = over_stack(product, first, factors[:1])["product"]
    assert alone.tolist() == expected[:1].tolist()
    batched = []

    @jax.custom_batching.custom_vmap
    def marked(value):
        return value

    @marked.def_vmap
    def _(size, in_batched, value):
        batched.append(size)
        return value, True

    over_stack(marked, factors[:1])
    assert not batched
    over_stack(marked, factors)
    assert batched == [2]


def test_programs_have_few_sizes_and_give_each_record_once():
    sizes = []

    def program(pair: Pair, factors):
        sizes.append(len(factors))
        return jax.vmap(product)(pair, factors)

    for count in (1, FEW, FEW + 1, BATCH, BATCH + 1, 3 * BATCH):
        stack = pairs(count)
        factors = np.arange(1.0 * count)
        products = in_batches(program, (stack, factors), side_by_side(count))["product"]
        expected = factors * stack.left[:, 0] * stack.right[:, 0]
        assert products.tolist() == expected.tolist()
    assert {*sizes} == {FEW, BATCH}
