"""The sparse system of a method that solves for nodes: ids, matrix, solve on the host."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._host.linear import systems
from ..._kernels.callback import host_call


class CellIds(eqx.Module):
    """Ids of k cells of one type.

    - `corners`: node ids.
    - `entry`: for each pair of corners its number in the list of pairs. It is the number of pairs
      where the two corners are one node.
    - `flipped`: True where the pair's first corner is the entry's second node.
    """

    corners: Int[Array, "k c"]
    entry: Int[Array, "k p"]
    flipped: Bool[Array, "k p"]


class NodeIds(eqx.Module):
    """Ids of a mesh's n nodes for a solve.

    - `cells`: by type.
    - `pairs` (e, 2): nodes that share an entry of the matrix, the smaller id first.
    - `frame` (d, d): axes in its columns, of which each symmetry plane has one as its normal.
    - `free` (n, d): unknowns, by node and axis of the frame.
    - `wall` (n,): for each node the nearest moving node.
    - `rows`, `nodes` (r,): rows of the surface that are nodes of the mesh, and the nodes.
    """

    cells: dict[str, CellIds]
    pairs: Int[Array, "e 2"]
    frame: Float[Array, "d d"]
    free: Bool[Array, "n d"]
    wall: Int[Array, " n"]
    rows: Int[Array, " r"]
    nodes: Int[Array, " r"]


class NodeFactors(eqx.Module):
    """The matrix as `systems.solve` takes it, and the nodes' places in the frame."""

    values: Float[Array, "e ..."]
    diagonal: Float[Array, "n ..."]
    masses: Float[Array, " q"]
    places: Float[Array, "n d"]


def product(ids: NodeIds, factors: NodeFactors, x: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """Multiplies by the matrix."""
    once = symmetric_product(ids.pairs, factors.values, factors.diagonal, x)
    if not len(factors.masses):
        return once
    return symmetric_product(ids.pairs, factors.values, factors.diagonal, once / factors.masses[:, None])


def symmetric_product(pairs, values, diagonal, x: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """Multiplies by a symmetric matrix of numbers or blocks. Traced.

    The matrix has an entry for each pair of nodes, and an entry for each node.
    """
    i, j = pairs.T

    def scaled(a, b):
        return a[:, None] * b if a.ndim == 1 else jnp.einsum("eab,eb->ea", a, b, precision="highest")

    turned = values if values.ndim == 1 else jnp.swapaxes(values, 1, 2)
    there = jax.ops.segment_sum(scaled(values, x[j]), i, len(x)) + jax.ops.segment_sum(scaled(turned, x[i]), j, len(x))
    return scaled(diagonal, x) + there


def solve(ids: NodeIds, factors: NodeFactors, right: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """Solves for the free unknowns on the host."""
    free = ids.free

    def times(x):
        return jnp.where(free, product(ids, factors, jnp.where(free, x, 0)), x)

    return solved_on_host(times, ids.pairs, factors, free, jnp.where(free, right, 0))


def solved_on_host(times, pairs, factors: NodeFactors, free, right: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """Solves a symmetric system on the host; `times` multiplies by its matrix. Traced."""
    leaves = (pairs, factors.values, factors.diagonal, factors.masses, free)

    def on_host(*system):
        return systems.solve(*system, multigrid=factors.places.shape[1] > 0)

    def solve(_, right):
        shape = jax.ShapeDtypeStruct(right.shape, right.dtype)
        return host_call(on_host, shape, *jax.lax.stop_gradient(leaves), right)

    return jax.lax.custom_linear_solve(times, right, solve, symmetric=True)
