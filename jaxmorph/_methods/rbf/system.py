"""Parts of the interpolation system (eq. 3): distances, polynomial, kernel sums.

On a GPU a kernel sum is one operation, linear in its weights; its transpose exchanges points and
sources. Derivatives by places and constants are computed block by block.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import mlir
from jaxtyping import Array, Float

from ..._host.package.errors import warn
from ..._kernels.compile import is_for_cpu
from ..._kernels.gpu import fused_sum, has_kernels, is_elementwise
from ..._kernels.linear import (
    MOST_ROWS,
    few_rows_times,
    few_rows_times_transposed,
    linear_primitive,
)
from ..base import POINT_BLOCK, Scalar, matmul
from ..blocks import fold_rows, map_rows
from .basis import AbstractBasis, Columns, Sources, Squared, Weights

KERNEL_BLOCK = (
    2**17
)  # elements of the kernel in a block of points: 1 MiB in float64, for a core's own cache
# columns of weights beyond which a product of matrices is faster than the GPU's kernel
MOST_FUSED = 48
SQUARE = 256  # sources along each side of a block of the symmetric product: 512 KiB in float64


def polynomial(points: Float[Array, "k d"], degree: int | None) -> Float[Array, "k p"]:
    """The monomials of eq. (1) at each point: none, 1, or 1, x1, x2(, x3)."""
    one = jnp.ones((len(points), 1), points.dtype)
    return {None: one[:, :0], 0: one, 1: jnp.concatenate([one, points], axis=1)}[degree]


def squared_distances(a: Float[Array, "k d"], b: Sources) -> Weights:
    return sum((a[:, None, k] - b[None, :, k]) ** 2 for k in range(a.shape[1]))  # pyright: ignore[reportReturnType]


def block_size(count: int) -> int:
    return min(POINT_BLOCK, max(64, KERNEL_BLOCK // count // 64 * 64))


def in_rows(points: Float[Array, "c d"], scale: Scalar) -> Float[Array, "d c"]:
    """Scales points, and lays each coordinate in a row of its own, for `kernel_sum`."""
    # A product of matrices, which the compiler does not merge into the loop along the points, as it
    # would a transposition. The barrier keeps it from making the transposed product of it in
    # programs for several devices.
    matrix = scale * jnp.eye(points.shape[1], dtype=points.dtype)
    return jax.lax.optimization_barrier(matmul(matrix, points.T))


def kernel_sum(
    phi: Callable, sources: Sources, weights: Weights, points: Float[Array, "d c"]
) -> Float[Array, "k c"]:
    """Sums weighted functions at points that `in_rows` laid out; `phi` takes squared distances."""
    # one loop along the points for distances and kernel, then a product with the weights; the
    # compiler makes vector instructions of it only if each coordinate lies in a row of its own
    return few_rows_times(weights, phi(squared_distances(sources, points.T)))


def symmetric_kernel_sum(phi: Callable, sources: Sources, weights: Weights) -> Weights:
    # The sources are padded to whole blocks by copies of the last one, which have the weight 0. A
    # scan goes over the blocks (i, j) with i <= j: a block gives sums of columns j and, transposed,
    # of columns i.
    count = len(sources)
    columns = len(weights)
    one = jnp.ones((), sources.dtype)
    side = min(SQUARE, count)
    blocks = -(-count // side)
    more = blocks * side - count
    sources = jnp.concatenate([sources, jnp.broadcast_to(sources[-1:], (more, sources.shape[1]))])
    split = jnp.pad(weights, ((0, 0), (0, more))).reshape(columns, blocks, side)
    places = sources.reshape(blocks, side, -1)

    def step(total, pair):
        i, j = pair
        # laid out here: a loop that picks its rows from all rows takes four times as long in a
        # caller's `jit`
        kernel = phi(squared_distances(places[i], in_rows(places[j], one).T))
        there = few_rows_times(split[:, i], kernel)
        back = jnp.where(i == j, 0, few_rows_times_transposed(split[:, j], kernel))
        return total.at[:, j].add(there).at[:, i].add(back), None

    pairs = tuple(jnp.asarray(ids, jnp.int32) for ids in np.triu_indices(blocks))
    total, _ = jax.lax.scan(step, jnp.zeros_like(split), pairs)
    return total.reshape(columns, -1)[:, :count]


class Radial(eqx.Module):
    basis: AbstractBasis
    scale: Scalar

    def __call__(self, r2: Squared) -> Squared:
        return self.basis(r2 if self.basis.scale_free else r2 / self.scale**2)


def is_fused(phi: Radial, dtype: Any) -> bool:
    if is_for_cpu() or not has_kernels() or dtype not in (jnp.float32, jnp.float64):
        return False
    return all(jnp.ndim(leaf) == 0 for leaf in jax.tree.leaves(phi)) and is_elementwise(phi, dtype)


def fused(
    phi: Radial, sources: Sources, weights: Columns, points: Float[Array, "c d"]
) -> Float[Array, "c k"]:
    if not len(points) or not len(sources):
        return jnp.zeros((len(points), weights.shape[1]), points.dtype)
    leaves, structure = jax.tree.flatten(phi)
    return _sum.bind(weights, sources, points, *leaves, structure=structure)


def _by_blocks(weights, sources, points, *leaves, structure):
    phi = jax.tree.unflatten(structure, leaves)

    def at_points(part):
        return few_rows_times(weights.T, phi(squared_distances(sources, part))).T

    def of_sources(total, rows):
        places, weights = rows
        return total + few_rows_times(weights.T, phi(squared_distances(places, points)))

    if len(sources) <= len(points):
        return map_rows(jax.checkpoint(at_points), points, block_size(len(sources)))
    start = jnp.zeros((weights.shape[1], len(points)), points.dtype)
    return fold_rows(
        jax.checkpoint(of_sources), start, (sources, weights), block_size(len(points))
    ).T


def _in_kernel(weights, sources, points, *leaves, structure):
    if weights.shape[1] > MOST_FUSED:
        return _by_blocks(weights, sources, points, *leaves, structure=structure)

    def phi(r2, *leaves):
        return jax.tree.unflatten(structure, leaves)(r2)

    groups = [
        weights[:, start : start + MOST_ROWS] for start in range(0, weights.shape[1], MOST_ROWS)
    ]
    return jnp.concatenate(
        [fused_sum(phi, group, sources, points, leaves) for group in groups], axis=1
    )


_sum = linear_primitive(
    "weighted_sum",
    _by_blocks,
    rows=lambda sources, points, *leaves, structure: points.shape[0],
    turned=lambda sources, points, *leaves, structure: (
        (points, sources, *leaves),
        {"structure": structure},
    ),
)
_lowered_by_blocks = mlir.lower_fun(_by_blocks, multiple_results=False)
_lowered_in_kernel = mlir.lower_fun(_in_kernel, multiple_results=False)


def _lowered_for_cuda(context, *arguments, structure):
    """Gives loops to a program that is exported: JAX promises no stable kernels."""
    # `lowering_parameters` is a private name. Without it the export itself says that it takes no
    # kernel.
    parameters = getattr(context.module_context, "lowering_parameters", None)
    if getattr(parameters, "for_export", False):
        return _lowered_by_blocks(context, *arguments, structure=structure)
    # Pallas is experimental: whatever another version has changed, loops remain
    try:
        return _lowered_in_kernel(context, *arguments, structure=structure)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        warn(
            f"this version of JAX ({jax.__version__}) does not compile the kernel for the GPU, "
            f"loops take its place: {reason}"
        )
        return _lowered_by_blocks(context, *arguments, structure=structure)


mlir.register_lowering(_sum, _lowered_for_cuda, platform="cuda")
