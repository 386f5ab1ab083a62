"""Many cells, some at a time."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

BLOCK = 1 << 16
"""Cells that are measured together."""


def in_blocks(function: Callable, *rows: Any) -> Any:
    """`function` of arrays whose last axis runs over cells, `BLOCK` of them at a time: memory is that of one block.

    What it returns has the cells last, too. Reverse mode computes each block anew.
    """
    k = jax.tree.leaves(rows)[0].shape[-1]
    if k <= BLOCK:
        return function(*rows)

    def one(picked):
        return function(*jax.tree.map(lambda x: x[..., picked], rows))

    blocks = -(-k // BLOCK)
    every = jnp.minimum(jnp.arange(blocks * BLOCK), k - 1)  # the last cell fills the last block
    found = jax.lax.map(jax.checkpoint(one), every.reshape(blocks, BLOCK))
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)[..., :k], found)
