"""Measures of many cells, some at a time."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

BLOCK = 1 << 16
"""Cells that are measured together."""


def in_blocks(function: Callable, *rows: Any) -> Any:
    """Applies `function` to `BLOCK` cells at a time: memory is that of one block.

    The last axis of each of `rows` runs over cells, and so does that of what `function` returns. Reverse mode computes
    each block anew.
    """
    k = jax.tree.leaves(rows)[0].shape[-1]
    if k <= BLOCK:
        return function(*rows)

    def one(picked):
        return function(*jax.tree.map(lambda x: x[..., picked], rows))

    blocks = -(-k // BLOCK)
    every = jnp.minimum(jnp.arange(blocks * BLOCK), k - 1)  # the last cell fills the last block
    results = jax.lax.map(jax.checkpoint(one), every.reshape(blocks, BLOCK))
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)[..., :k], results)
