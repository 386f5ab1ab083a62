"""A correction without a graph: compact functions, from the largest scale to the smallest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.sources.hierarchy import Share, farthest_first, overlaps, padded, sweeps
from .._kernels.values import as_jax, jax_arrays
from .base import AbstractMethod, AbstractPlacing, Rows, or_one
from .corrections import DelaunayGraph, NearWall
from .inverse_distance import InverseDistance
from .rbf.basis import WendlandC2
from .rbf.fitted import FittedRBF
from .rbf.rbf import RBF
from .reconstruction import SurfaceReconstruction
from .sparse import InterpolatedField, Reach
from .surface import Surface


class Multiscale(AbstractPlacing):
    """Interpolates with a Wendland C2 function of its own radius at each surface node.

    The nodes are put in an order: the next node is the farthest from all nodes before it, and its
    distance from these is the radius of its function. So a function vanishes at every node before
    its own. The system is triangular and sparse, and its solution a forward substitution (Kedward,
    Allen and Rendall, J. Comput. Phys. 345, 2017, the second stage). The field is exact at the
    surface's nodes, has continuous derivatives, and is zero beyond the radii. Points may lie
    anywhere: there is no graph, and no hull. The order of the nodes is discontinuous in their
    coordinates. Distances within a relative 1e-9 are equal, and the first node in the order of
    coordinates counts, so round-off decides nothing. As a correction, the sources of the coarse
    field come before all other nodes. Alone, the first function reaches across the whole surface,
    and not even a translation is reproduced: `Multiscale.whole` adds the first stage.
    """

    @staticmethod
    def whole(radius, fraction: float = 0.05) -> SurfaceReconstruction:
        """Returns the method with both stages: a dense system for some nodes, this for the rest.

        `radius` is that of the first stage's Wendland C2 functions, in the mesh's units: the size
        of the body or larger. `fraction`, from 0 to 1, is the share of the nodes in the first
        stage, spread evenly over the surface.

        **Raises:** `ValueError` for numbers outside of these ranges.
        """
        base = RBF(
            WendlandC2(radius),
            reduction=Share(fraction),
            fixed_reduction=Share(fraction),
            degree=None,
        )
        return SurfaceReconstruction(base, Multiscale())

    def connect(self, surface: Surface, points):
        nodes = surface.points.astype(float)
        order, nearest = farthest_first(nodes, surface.matched, surface.images)
        radius = np.linalg.norm(nodes - nodes[nearest], axis=1)
        rank = np.zeros(len(nodes), dtype=np.int64)
        rank[order] = np.arange(len(order))
        row, column = overlaps(nodes, order, radius, nodes)
        below = (radius[row] > 0) & (rank[row] > rank[column])
        row = row[below]
        column = column[below]
        forward, backward = (Sweep(*as_jax(sweep)) for sweep in sweeps(row, column, len(nodes)))
        reach = padded(*overlaps(nodes, order, radius, points.astype(float)), len(points))
        ids = jax_arrays(nearest=nearest, row=row, column=column)
        return Hierarchy(**ids, forward=forward, backward=backward), Reach(*as_jax(reach))

    def fit(self, ids: "Hierarchy", surface, points):
        squared = _squared(surface - surface[ids.nearest])
        entries = _wendland(_squared(surface[ids.row] - surface[ids.column]), squared[ids.column])
        return MultiscaleFactors(squared, entries)

    def carry(self, ids, factors, surface, points):
        return factors

    def place(self, x, ids: Reach, factors: "MultiscaleFactors", surface):
        return ids.weighted(
            _wendland(_squared(surface[ids.nodes] - x[None]), factors.squared[ids.nodes])
        )

    def field(self, ids: "Hierarchy", factors: "MultiscaleFactors", surface, u):
        has_function = ids.nearest != jnp.arange(len(ids.nearest))
        return InterpolatedField(ids.solve(factors.entries, jnp.where(has_function[:, None], u, 0)))


class Sweep(eqx.Module):
    entries: Int[Array, "s r w"]
    owner: Int[Array, "s r"]

    def substituted(
        self, source: Int[Array, " e"], entries: Float[Array, " e"], values: Rows
    ) -> Rows:
        used = self.entries >= 0
        weights = jnp.where(used, entries[self.entries], 0)
        nodes = jnp.where(used, source[self.entries], 0)

        def step(c, rows):
            nodes, weights, owner = rows
            known = sum(weights[:, k, None] * c[nodes[:, k]] for k in range(nodes.shape[1]))
            return c.at[owner].add(-known), None

        return jax.lax.scan(step, values, (nodes, weights, self.owner))[0]


class Hierarchy(eqx.Module):
    """The nearest node before each node, itself without a function; and entries (row, column)."""

    nearest: Int[Array, " b"]
    row: Int[Array, " e"]
    column: Int[Array, " e"]
    forward: Sweep
    backward: Sweep

    def solve(self, entries: Float[Array, " e"], values: Rows) -> Rows:
        def product(c):
            reached = entries[:, None] * c[self.column]
            return c + jax.ops.segment_sum(reached, self.row, len(c), indices_are_sorted=True)

        return jax.lax.custom_linear_solve(
            product,
            values,
            lambda _, values: self.forward.substituted(self.column, entries, values),
            lambda _, values: self.backward.substituted(self.row, entries, values),
        )


class MultiscaleFactors(eqx.Module):
    squared: Float[Array, " b"]
    entries: Float[Array, " e"]


def _wendland(
    squared_distance: Float[Array, "..."], squared_radius: Float[Array, "..."]
) -> Float[Array, "..."]:
    return WendlandC2(1.0)(squared_distance / or_one(squared_radius))


def _squared(vectors: Float[Array, "*n d"]) -> Float[Array, "*n"]:
    return jnp.sum(vectors**2, axis=-1)


def carrying() -> AbstractMethod:
    """Returns IDWarp's method, for a body whose grid nothing holds, as an overset grid."""
    return InverseDistance(rotations=True)


def guiding(method: AbstractMethod) -> AbstractMethod:
    """Returns the method that guides nodes along boundaries: the coarse field of `method`, with a
    `Multiscale` correction. Such nodes lie outside of the hull of moving and fixed nodes, where no
    graph reaches, and have no cells among themselves. Near moving and fixed nodes they follow
    exactly.
    """
    coarse = method.coarse if isinstance(method, SurfaceReconstruction) else method
    if coarse.needs_cells or isinstance(coarse, DelaunayGraph | NearWall):
        coarse = FittedRBF()
    if coarse is method and coarse.exact:
        return coarse
    correction = method.correction if isinstance(method, SurfaceReconstruction) else None
    if isinstance(correction, NearWall):
        return SurfaceReconstruction(coarse, NearWall(Multiscale(), correction.width))
    return SurfaceReconstruction(coarse, Multiscale())
