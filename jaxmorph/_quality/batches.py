"""Measures of many cells, some at a time."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

BLOCK = 1 << 16
"""Cells that are measured together."""

CACHED = 1 << 13
"""Cells that NumPy measures together: intermediate values stay in the processor's cache."""


def in_blocks(xp: Any, function: Callable, *rows: Any, size: int | None = None) -> Any:
    """Applies `function`, of NumPy or `jax.numpy`, to blocks of cells: memory is that of one.

    The last axis of each of `rows` runs over cells, and so does that of what `function` returns.
    Reverse mode computes each block anew. A block has `size` cells. By default it has `CACHED` for
    NumPy and `BLOCK` for JAX, fewer of cells with many values.
    """
    leaves = jax.tree.leaves(rows)
    width = max(math.prod(leaf.shape[:-1]) for leaf in leaves)  # many values a cell, fewer cells
    k, block = leaves[0].shape[-1], size or max((CACHED if xp is np else BLOCK) * 9 // max(width, 9), 64)
    if k <= block:
        return function(*rows)

    def one(picked):
        return function(*jax.tree.map(lambda x: x[..., picked], rows))

    blocks = -(-k // block)
    if xp is np:
        # no threads: between operations on so few cells they wait for Python's lock
        results = [one(slice(i * block, (i + 1) * block)) for i in range(blocks)]
        return jax.tree.map(lambda *parts: np.concatenate(parts, axis=-1), *results)
    every = jnp.minimum(jnp.arange(blocks * block), k - 1)  # the last cell fills the last block
    results = jax.lax.map(jax.checkpoint(one), every.reshape(blocks, block))
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)[..., :k], results)
