"""The kernel sum as one operation, with a kernel for the GPU.

It is linear in its weights. Its transpose is the sum with points and sources exchanged.

Derivatives with respect to places and constants need more. It is computed block by block.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.interpreters import mlir
from jaxtyping import Array, Float

from ..._host.package.errors import warn
from ..._kernels.compile import is_for_cpu
from ..._kernels.gpu import fused_sum, has_kernels, is_elementwise
from ..._kernels.linear import linear_primitive
from ..._kernels.product import MOST_ROWS, few_rows_times
from ..blocks import fold_rows, map_rows
from .basis import AbstractBasis
from .system import block_size, squared_distances

MOST_FUSED = 48
"""Columns of weights beyond which a product of matrices is faster."""


class Radial(eqx.Module):
    """A basis as a function of squared distances that are in units of the sources' extent."""

    basis: AbstractBasis
    scale: Float[Array, ""]

    def __call__(self, r2: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.basis(r2 if self.basis.scale_free else r2 / self.scale**2)


def is_fused(phi: Radial, dtype: Any) -> bool:
    """Checks whether a weighted sum can be one operation.

    A GPU must be able to run it, and its kernel must be able to contain the function.
    """
    if is_for_cpu() or not has_kernels() or dtype not in (jnp.float32, jnp.float64):
        return False
    return all(jnp.ndim(leaf) == 0 for leaf in jax.tree.leaves(phi)) and is_elementwise(phi, dtype)


def fused(
    phi: Radial, sources: Float[Array, "s d"], weights: Float[Array, "s k"], points: Float[Array, "c d"]
) -> Float[Array, "c k"]:
    """Sums weighted functions at points by one operation. Only where `is_fused`."""
    if not len(points) or not len(sources):
        return jnp.zeros((len(points), weights.shape[1]), points.dtype)
    leaves, structure = jax.tree.flatten(phi)
    return _sum.bind(weights, sources, points, *leaves, structure=structure)


def _by_blocks(weights, sources, points, *leaves, structure):
    phi = jax.tree.unflatten(structure, leaves)
    if len(sources) <= len(points):

        def at_points(part):
            return few_rows_times(weights.T, phi(squared_distances(sources, part))).T

        return map_rows(jax.checkpoint(at_points), points, block_size(len(sources)))

    def of_sources(total, rows):
        places, weights = rows
        return total + few_rows_times(weights.T, phi(squared_distances(places, points)))

    start = jnp.zeros((weights.shape[1], len(points)), points.dtype)
    return fold_rows(jax.checkpoint(of_sources), start, (sources, weights), block_size(len(points))).T


def _in_kernel(weights, sources, points, *leaves, structure):
    columns = weights.shape[1]
    if columns > MOST_FUSED:
        return _by_blocks(weights, sources, points, *leaves, structure=structure)

    def phi(r2, *leaves):
        return jax.tree.unflatten(structure, leaves)(r2)

    groups = [weights[:, start : start + MOST_ROWS] for start in range(0, columns, MOST_ROWS)]
    return jnp.concatenate([fused_sum(phi, group, sources, points, leaves) for group in groups], axis=1)


_sum = linear_primitive(
    "weighted_sum",
    _by_blocks,
    rows=lambda sources, points, *leaves, structure: points.shape[0],
    turned=lambda sources, points, *leaves, structure: ((points, sources, *leaves), {"structure": structure}),
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
    # Pallas is experimental, and the kernel reads JAX's own expressions: whatever another version
    # has changed, loops remain
    try:
        return _lowered_in_kernel(context, *arguments, structure=structure)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        warn(
            f"this version of JAX ({jax.__version__}) does not compile the kernel for the GPU, loops take its place: {reason}"
        )
        return _lowered_by_blocks(context, *arguments, structure=structure)


mlir.register_lowering(_sum, _lowered_for_cuda, platform="cuda")
