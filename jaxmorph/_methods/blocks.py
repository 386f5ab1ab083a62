"""Fields and places of a method over many points, block by block."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .._kernels.compile import is_for_cpu
from .base import POINT_BLOCK, AbstractField, AbstractMethod, AbstractPlacing, Points, Rows
from .sparse import Interpolation

# factor of a block's size off the CPU: a GPU wants many elements at once, and few launches
WIDER = 256
PLACES_TOGETHER = 4096  # in a block: their memory is little, and few need no loop
FEW_BLOCKS = 64  # most blocks of a single program on any platform; two programs are traced for more


def map_points(field: AbstractField, points: Points, ids: PyTree) -> Points:
    """Evaluates the field at every point; derivatives compute blocks anew and store none."""
    if field.block_size is None:
        return field.evaluate(points, ids)
    return map_rows(
        jax.checkpoint(lambda part: field.evaluate(*part)), (points, ids), field.block_size
    )


def place_points(
    method: AbstractMethod,
    points: Points,
    ids: PyTree,
    factors: PyTree,
    surface: Rows,
    placed: PyTree = None,
) -> PyTree:
    """Computes every point's place; or changes places `placed` after a step of `march`."""
    if not isinstance(method, AbstractPlacing) or not jax.tree.leaves(ids):
        return ids

    def place(x, ids, *placed):
        change = method.carry_place if placed else method.place
        return change(x, ids, factors, surface, *placed)

    every = jax.checkpoint(jax.vmap(place))
    rows = (points, ids) if placed is None else (points, ids, without_tables(placed))
    return map_rows(lambda rows: every(*rows), rows, PLACES_TOGETHER)


def map_rows(function: Callable[[PyTree], PyTree], rows: PyTree, block: int) -> PyTree:
    """Maps blocks of rows to as many rows; GPUs get larger blocks."""

    # The last block begins so early that it is whole: the program has the function once. Its first
    # rows are those of the block before, too, and come from there.
    def mapped(rows, block):
        count = len(jax.tree.leaves(rows)[0])
        if count <= block:
            return function(rows)
        blocks = -(-count // block)
        before = (blocks - 1) * block

        def stacked(leaf):
            parts = [leaf[:before], leaf[count - block :]]
            return jnp.concatenate(parts).reshape(blocks, block, *leaf.shape[1:])

        def joined(leaf):
            every = leaf.reshape(-1, *leaf.shape[2:])
            return jnp.concatenate([every[:before], every[before + blocks * block - count :]])

        return jax.tree.map(joined, jax.lax.map(function, jax.tree.map(stacked, rows)))

    return sized_by_platform(mapped, rows, block)


def fold_rows(
    function: Callable[[PyTree, PyTree], PyTree], start: PyTree, rows: PyTree, block: int
) -> PyTree:
    """Folds blocks of rows into one result: `function(result so far, rows)`, from `start` on."""

    def folded(rows, block):
        blocks, rest = _split_rows(rows, block)
        result = function(start, rest)
        if blocks is None:
            return result
        return jax.lax.scan(lambda so_far, part: (function(so_far, part), None), result, blocks)[0]

    return sized_by_platform(folded, rows, block)


def _split_rows(rows: PyTree, block: int) -> tuple[PyTree | None, PyTree]:
    """Cuts rows into whole blocks, stacked along a first axis, and a rest that is not empty."""
    full = (len(jax.tree.leaves(rows)[0]) - 1) // block * block
    rest = jax.tree.map(lambda leaf: leaf[full:], rows)
    if full == 0:
        return None, rest
    return jax.tree.map(lambda leaf: leaf[:full].reshape(-1, block, *leaf.shape[1:]), rows), rest


def sized_by_platform(
    function: Callable[[PyTree, int], PyTree], rows: PyTree, block: int
) -> PyTree:
    if len(jax.tree.leaves(rows)[0]) <= FEW_BLOCKS * block or is_for_cpu():
        return function(rows, block)
    return jax.lax.platform_dependent(
        rows,
        cpu=lambda rows: function(rows, block),
        default=lambda rows: function(rows, WIDER * min(block, POINT_BLOCK)),
    )


def is_rows(leaf: object) -> bool:
    return isinstance(leaf, Interpolation)


def with_tables(placed: PyTree, count: int, parts: int = 1) -> PyTree:
    return _map_rows_of(lambda rows: rows.with_table(count, parts), placed)


def without_tables(placed: PyTree) -> PyTree:
    return _map_rows_of(lambda rows: rows.without_table(), placed)


def with_tables_of(old: PyTree, placed: PyTree) -> PyTree:
    return _map_rows_of(lambda rows, before: rows.with_table_of(before), placed, old)


def _map_rows_of(function: Callable, *trees: PyTree) -> PyTree:
    return jax.tree.map(
        lambda *leaves: function(*leaves) if is_rows(leaves[0]) else leaves[0],
        *trees,
        is_leaf=is_rows,
    )
