"""Mapping over points: fields and places of a method, block by block."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from .._kernels.compile import is_for_cpu
from .base import BLOCK, AbstractField, AbstractMethod, AbstractPlacing
from .sparse import Interpolation

WIDER = 256
"""Factor of the size of blocks on platforms that are no CPU.

A GPU wants millions of elements at once, and few launches.
"""

FEW = 64
"""Blocks that are few enough for any platform. Two programs are traced for more."""


def map_points(field: AbstractField, points: Float[Array, "n d"], ids: PyTree) -> Float[Array, "n d"]:
    """Evaluates the field at every point, block by block.

    For derivatives each block is computed again, not stored.
    """
    if field.block_size is None:
        return field.evaluate(points, ids)
    return map_rows(jax.checkpoint(lambda part: field.evaluate(*part)), (points, ids), field.block_size)


def place_points(
    method: AbstractMethod, points: Float[Array, "n d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]
) -> PyTree:
    """Computes every point's place by the method's `place`."""
    if not isinstance(method, AbstractPlacing) or not jax.tree.leaves(ids):
        return ids
    return _mapped(lambda x, ids: method.place(x, ids, factors, surface), (points, ids))


def carry_points(
    method: AbstractMethod,
    rows: tuple[Float[Array, "n d"], PyTree, PyTree],
    factors: PyTree,
    surface: Float[Array, "b d"],
) -> PyTree:
    """Changes every point's place by the method's `carry_place`."""
    points, ids, placed = rows
    if not isinstance(method, AbstractPlacing) or not jax.tree.leaves(ids):
        return placed
    carried = _mapped(
        lambda x, ids, placed: method.carry_place(x, ids, factors, surface, placed),
        (points, ids, without_tables(placed)),
    )
    return with_tables_of(placed, carried)


def _mapped(function: Callable[..., PyTree], rows: tuple) -> PyTree:
    place = jax.checkpoint(jax.vmap(function))
    return by_platform(lambda rows, block: _placed(place, rows, block), rows, BLOCK)


def _placed(place: Callable, rows: tuple, block: int) -> PyTree:
    n = len(rows[0])
    block = min(block, n)
    # the last block begins within the one before, so that all have one shape
    starts = jnp.minimum(jnp.arange(0, n, block), n - block)

    def of_block(start):
        return place(*jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, block), rows))

    def put_together(leaf):
        rows = leaf.reshape(-1, *leaf.shape[2:])
        return jnp.concatenate([rows[: n - block], leaf[-1]])

    return jax.tree.map(put_together, jax.lax.map(of_block, starts))


def map_rows(function: Callable[[PyTree], PyTree], rows: PyTree, block: int) -> PyTree:
    """Applies a function to blocks of `block` rows, and joins the results.

    A result has as many rows as its block.

    Each block adds its rows to one array of zeros, in place; the last block may be shorter. Nothing
    is padded. Blocks are larger on a platform that is no CPU.
    """
    return by_platform(lambda rows, block: _joined(function, rows, block), rows, block)


def fold_rows(function: Callable[[PyTree, PyTree], PyTree], start: PyTree, rows: PyTree, block: int) -> PyTree:
    """Folds blocks of rows into one result from `start` on: `function(result so far, rows)`."""
    return by_platform(lambda rows, block: _folded(function, start, rows, block), rows, block)


def _folded(function: Callable[[PyTree, PyTree], PyTree], start: PyTree, rows: PyTree, block: int) -> PyTree:
    full = (len(jax.tree.leaves(rows)[0]) - 1) // block * block
    result = function(start, jax.tree.map(lambda leaf: leaf[full:], rows))
    if full == 0:
        return result
    blocks = jax.tree.map(lambda leaf: leaf[:full].reshape(-1, block, *leaf.shape[1:]), rows)
    return jax.lax.scan(lambda so_far, part: (function(so_far, part), None), result, blocks)[0]


def by_platform(function: Callable[[PyTree, int], PyTree], rows: PyTree, block: int) -> PyTree:
    """Calls `function(rows, block)` with the size of blocks for the program's platform."""
    if len(jax.tree.leaves(rows)[0]) <= FEW * block or is_for_cpu():
        return function(rows, block)
    return jax.lax.platform_dependent(
        rows, cpu=lambda rows: function(rows, block), default=lambda rows: function(rows, WIDER * block)
    )


def _joined(function: Callable[[PyTree], PyTree], rows: PyTree, block: int) -> PyTree:
    n = len(jax.tree.leaves(rows)[0])
    full = (n - 1) // block * block
    last = function(jax.tree.map(lambda leaf: leaf[full:], rows))
    if full == 0:
        return last

    def add(whole, part, start):
        return jax.tree.map(lambda a, b: _add_rows(a, b, start), whole, part)

    def step(whole, start_and_part):
        start, part = start_and_part
        return add(whole, function(part), start), None

    blocks = jax.tree.map(lambda leaf: leaf[:full].reshape(-1, block, *leaf.shape[1:]), rows)
    zeros = jax.tree.map(lambda leaf: jnp.zeros((n, *leaf.shape[1:]), leaf.dtype), last)
    whole, _ = jax.lax.scan(step, zeros, (jnp.arange(0, full, block), blocks))
    return add(whole, last, jnp.asarray(full))


def _add_rows(whole: Array, part: Array, start: Int[Array, ""]) -> Array:
    window = jax.lax.ScatterDimensionNumbers(
        update_window_dims=tuple(range(part.ndim)), inserted_window_dims=(), scatter_dims_to_operand_dims=(0,)
    )
    return jax.lax.scatter_add(
        whole,
        start[None],
        part,
        window,
        indices_are_sorted=True,
        unique_indices=True,
        mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )


def is_rows(leaf: object) -> bool:
    return isinstance(leaf, Interpolation)


def with_tables(placed: PyTree, count: int, parts: int = 1) -> PyTree:
    """Gives each operator in `placed` a table of its transpose, on the host."""
    return _map_rows_of(lambda rows: rows.with_table(count, parts), placed)


def without_tables(placed: PyTree) -> PyTree:
    """Drops the tables, so that every leaf has one row a point."""
    return _map_rows_of(lambda rows: rows.without_table(), placed)


def with_tables_of(old: PyTree, placed: PyTree) -> PyTree:
    """Gives the operators in `placed` the tables of `old` operators with equal ids. Traced."""
    return _map_rows_of(lambda rows, before: rows.with_table_of(before), placed, old)


def _map_rows_of(function: Callable, *trees: PyTree) -> PyTree:
    return jax.tree.map(lambda *leaves: function(*leaves) if is_rows(leaves[0]) else leaves[0], *trees, is_leaf=is_rows)
