"""A direct call on a CPU in slabs of points, which all cores compute beside each other.

XLA splits the loop over a program's blocks among threads operation by operation, and they wait for
each other at each. Programs of one slab each have nothing to wait for. XLA runs the programs that
one thread begins one after the other, so a thread for each core begins them.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from .._host.package.cores import Beside, cores
from .._kernels.compile import compiled, float64_mode, is_direct
from .._methods.blocks import is_rows

T = TypeVar("T")

LEAST = 2**16
"""Points of a slab below which a program of its own costs more than it gains."""

MOST = 64
"""Slabs of all points, and shares of a sum: more cores than these would not make a call faster."""

STEP = 1536
"""Slabs begin at multiples of this, as blocks do: a block's size changes its last bits."""


def slabs(count: int, *arguments: Any) -> list[tuple[np.ndarray, int]]:
    """Divides points into slabs: first rows and counts; none for traced calls or few points.

    All have one size, and so one program; some overlap. The number of cores does not change them:
    results have equal bits.
    """
    if count < 2 * LEAST or not is_direct(arguments):
        return []
    # Every slab ends with the points that are left over when all are divided into steps, as the
    # last slab has to. The rows that a slab shares with the next slab are cut off.
    rest, number = count % STEP, min(MOST, count // LEAST // 2 * 2)
    stride = -(-(count - rest) // (number * STEP)) * STEP
    size = stride + rest
    return [(np.asarray(start, np.int32), size) for start in [*range(0, count - size, stride), count - size]]


def shares(plan: Any, *arguments: Any) -> int:
    """Counts shares of a plan's points in a sum, for any number of cores; 1 if traced."""
    surface = len(plan.surface.points)  # each share has a sum for all of it
    number = min(MOST, len(plan.points) // max(LEAST, 2 * surface)) // 2 * 2
    return number if number and is_direct(plan, arguments) else 1


def on_all_cores(program: Callable[[Any], T], pieces: list[Any]) -> tuple[T, ...]:
    """Begins a program for each piece, in a thread for each core. The first call compiles."""
    number, results = min(cores(), len(pieces)), {0: program(pieces[0])}
    is_wide = jax.dtypes.canonicalize_dtype(np.float64) == np.float64

    def begin(places: range) -> None:
        with float64_mode(is_wide):  # a setting of the thread
            results.update((k, program(pieces[k])) for k in places)

    threads = [Beside(begin, range(first, len(pieces), number)) for first in range(1, number)]
    begin(range(number, len(pieces), number))
    for thread in threads:
        thread.result()
    return tuple(results[k] for k in range(len(pieces)))


def share_of(rows: PyTree, k: Any, start: Any, size: int, number: int) -> PyTree:
    """Cuts share `k` out of leaves with a row a point, and out of tables in `number` parts."""

    def cut(leaf: Any) -> Any:
        if not is_rows(leaf):
            return jax.lax.dynamic_slice_in_dim(leaf, start, size)
        table, bare = leaf.table, jax.tree.map(cut, leaf.without_table())
        length = len(table.owner) // number
        table = jax.tree.map(lambda part: jax.lax.dynamic_slice_in_dim(part, k * length, length), table)
        return eqx.tree_at(lambda rows: rows.table, bare, table, is_leaf=lambda leaf: leaf is None)

    return jax.tree.map(cut, rows, is_leaf=is_rows)


def joined(parts: tuple[Float[Array, "s d"], ...], count: int) -> Float[Array, "n d"]:
    """Joins the results of slabs of `count` points."""
    return parts[0] if len(parts) == 1 else _joined(parts, count)


@compiled
def _joined(parts: tuple[Float[Array, "s d"], ...], count: int) -> Float[Array, "n d"]:
    *others, last = parts
    stride, before = len(last) - count % STEP, count - len(last)
    return jnp.concatenate([*(part[: min(stride, before - k * stride)] for k, part in enumerate(others)), last])
