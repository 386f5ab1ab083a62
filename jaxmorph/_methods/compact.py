"""Radial basis functions of compact support at all nodes of the surface: one sparse system."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from .._host.hierarchy import overlaps, padded
from .._kernels.values import as_jax
from .base import AbstractMethod, Surface
from .basis import WendlandC2
from .cells import NodeFactors, solved_on_host, symmetric_product
from .numbers import length_or_none
from .sparse import InterpolatedField, Reach

NEIGHBOURS = 200
"""Nodes that the automatic radius reaches from half of the moving nodes."""


class CompactIds(eqx.Module):
    """Pairs of the surface's rows within the radius, and the radius."""

    pairs: Int[Array, "e 2"]
    radius: Float[Array, ""]


class CompactRBF(AbstractMethod):
    """Interpolates with a Wendland C2 function at every node of the surface, all of one radius: a sparse system.

    It is exact at the nodes, and zero beyond the radius from all of them. It has no polynomial: alone, not even a translation
    is reproduced; it may be a correction too. Cells fold where the motion is a good part of the radius, so take a radius of
    several times the largest displacement. Memory is that of the pairs of nodes within it.

    **Arguments:**

    - `radius`: in the mesh's units. Default: half of the moving nodes reach 200 nodes of the surface, or all of it.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    radius: Float[Array, ""] | None = eqx.field(converter=length_or_none("radius"), default=None)

    def connect(self, surface: Surface, points):
        nodes = surface.points.astype(float)
        tree = KDTree(nodes)
        if self.radius is None:
            count = min(NEIGHBOURS, len(nodes))
            apart = np.asarray(tree.query(nodes[: surface.moving], k=count)[0]).reshape(surface.moving, -1)
            radius = float(np.median(apart[:, -1]))
        else:
            radius = float(self.radius)
        pairs = np.asarray(tree.query_pairs(radius, output_type="ndarray"), np.int32).reshape(-1, 2)
        near = overlaps(nodes, np.arange(len(nodes)), np.full(len(nodes), radius), points.astype(float))
        reach = Reach(*as_jax(padded(*near, len(points))))
        return CompactIds(*as_jax((pairs, radius))), reach

    def reach(self, ids: CompactIds) -> float:
        return float(ids.radius)

    def fit(self, ids: CompactIds, surface, points):
        radius = ids.radius if self.radius is None else self.radius
        i, j = ids.pairs.T
        values = WendlandC2(radius)(jnp.sum((surface[i] - surface[j]) ** 2, axis=1))
        none = jnp.zeros((len(surface), 0), values.dtype)
        return radius, NodeFactors(values, jnp.ones_like(surface[:, 0]), none[0], none)

    def carry(self, ids, factors, surface, points):
        return factors

    def place(self, x, ids: Reach, factors, surface):
        weights = WendlandC2(factors[0])(jnp.sum((surface[ids.nodes] - x[None]) ** 2, axis=1))
        return ids.weighted(weights)

    def field(self, ids: CompactIds, factors, surface, u):
        matrix = factors[1]

        def product(x):
            return symmetric_product(ids.pairs, matrix.values, matrix.diagonal, x)

        coefficients = solved_on_host(product, ids.pairs, matrix, jnp.ones(u.shape, bool), u)
        return InterpolatedField(self, factors, surface, coefficients)

    def check(self, ids: CompactIds, factors, u):
        if not bool(jnp.isfinite(self.field(ids, factors, u, u).u).all()):
            raise ValueError(
                "the matrix of CompactRBF is not positive, or no solve converged: nodes coincide, or the radius is too large."
            )
