"""Parts of the interpolation system (eq. 3): distances, polynomial, kernel sums."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._kernels.product import few_rows_times, few_rows_times_transposed
from ..base import BLOCK

KERNEL_BLOCK = 2**17
"""Elements of the kernel in a block of points: 1 MiB in float64, for a core's own cache."""

SQUARE = 256
"""Sources along each side of a block of the symmetric product: 512 KiB in float64."""


def polynomial(points: Float[Array, "k d"], degree: int | None) -> Float[Array, "k p"]:
    """Evaluates the monomials of eq. (1) at each point: none, 1, or 1, x1, x2(, x3)."""
    one = jnp.ones((len(points), 1), points.dtype)
    return {None: one[:, :0], 0: one, 1: jnp.concatenate([one, points], axis=1)}[degree]


def squared_distances(a: Float[Array, "k d"], b: Float[Array, "s d"]) -> Float[Array, "k s"]:
    """Computes squared distances by differences."""
    return sum((a[:, None, k] - b[None, :, k]) ** 2 for k in range(a.shape[1]))  # pyright: ignore[reportReturnType]


def block_size(count: int) -> int:
    """Returns how many points make a block of the kernel with `count` sources."""
    return min(BLOCK, max(64, KERNEL_BLOCK // count // 64 * 64))


def in_rows(points: Float[Array, "c d"], scale: Float[Array, ""]) -> Float[Array, "d c"]:
    """Scales points, and lays each coordinate in a row of its own, for `kernel_sum`.

    A product of matrices does it. The compiler does not merge it into the loop along the points, as
    it would a transposition. The barrier keeps it from making the transposed product of it, which
    it does in programs for several devices.
    """
    matrix = scale * jnp.eye(points.shape[1], dtype=points.dtype)
    return jax.lax.optimization_barrier(jnp.matmul(matrix, points.T, precision="highest"))


def kernel_sum(
    phi: Callable, sources: Float[Array, "s d"], weights: Float[Array, "k s"], points: Float[Array, "d c"]
) -> Float[Array, "k c"]:
    """Sums weighted functions at points that `in_rows` laid out; `phi` takes squared distances.

    It computes distances and kernel in one loop along the points, then a product with the weights.
    The compiler makes vector instructions of the loop only if each coordinate lies in a row of its
    own.
    """
    return few_rows_times(weights, phi(squared_distances(sources, points.T)))


def symmetric_kernel_sum(
    phi: Callable, sources: Float[Array, "s d"], weights: Float[Array, "k s"]
) -> Float[Array, "k s"]:
    """Sums weighted functions at the sources themselves.

    Each block of the kernel is made once, and serves for its mirror image too.
    """
    # The sources are padded to whole blocks by copies of the last one, which have the weight 0. A
    # scan goes over the blocks (i, j) with i <= j: a block gives sums of columns j and, transposed,
    # of columns i.
    count, columns, dimension = len(sources), len(weights), sources.shape[1]
    side = min(SQUARE, count)
    blocks = -(-count // side)
    more = blocks * side - count
    sources = jnp.concatenate([sources, jnp.broadcast_to(sources[-1:], (more, dimension))])
    rows = in_rows(sources, jnp.ones((), sources.dtype)).reshape(dimension, blocks, side)
    split = jnp.pad(weights, ((0, 0), (0, more))).reshape(columns, blocks, side)
    places = sources.reshape(blocks, side, dimension)

    def step(total, pair):
        i, j = pair
        kernel = phi(squared_distances(places[i], rows[:, j].T))
        there = few_rows_times(split[:, i], kernel)
        back = jnp.where(i == j, 0, few_rows_times_transposed(split[:, j], kernel))
        return total.at[:, j].add(there).at[:, i].add(back), None

    pairs = tuple(jnp.asarray(ids, jnp.int32) for ids in np.triu_indices(blocks))
    total, _ = jax.lax.scan(step, jnp.zeros_like(split), pairs)
    return total.reshape(columns, -1)[:, :count]
