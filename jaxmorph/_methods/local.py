"""The correction of Rendall and Allen: what a reduced field misses at the nearest node of the surface, fading with the distance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from .._host.rounding import nearest_of
from .._kernels.values import as_jax
from .base import AbstractMethod, Surface
from .basis import WendlandC2
from .nearwall import Extent, layer_width
from .numbers import length_or_none
from .sparse import InterpolatedField, Reach

SPACING = 2.0
"""The automatic radius, relative to the width of the layer of `NearWall`."""


class LocalCorrection(AbstractMethod):
    """Moves a point along with the nearest node of the surface, by a share that fades with the distance to it.

    u(x) = psi(|x - x_k| / R) u_k, with the nearest node k and Wendland's C2 function psi. Rendall and Allen correct so what a
    reduced set of sources misses on the surface (Journal of Computational Physics 228 and 229, 2009 and 2010). It is exact at
    the surface's nodes, solves no system and needs no graph, so the mesh may reach beyond the hull of its boundary.

    The field jumps where the nearest node changes, by as much as the offsets of two neighbours differ. Of nodes that are equally
    near the first counts. Between two walls closer than twice the radius it may tear cells: `NearWall` does not. Alone it
    reproduces no polynomial, and cells fold where the offset is a good part of the radius.

    **Arguments:**

    - `radius`: R, in the mesh's units. Default None: for each wall the largest distance from one of its nodes to the nearest
      source, or half of the mean chord of a wall without sources. Rendall and Allen take a multiple of the largest offset,
      which would not be linear in the displacement.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    radius: Float[Array, ""] | None = eqx.field(default=None, converter=length_or_none("radius"))

    def connect(self, surface: Surface, points):
        extent = Extent.seen(surface)
        radius = self._radius(jax.tree.map(np.asarray, extent), np.asarray(surface.points))
        apart = KDTree(surface.points).query(points, distance_upper_bound=1.25 * radius.max() or np.inf)[0]
        reached, nearest = np.isfinite(apart), np.zeros(len(points), dtype=np.int64)
        nearest[reached] = nearest_of(points[reached], surface.points, np.arange(len(surface.points)))
        row_of_point = surface.rows(len(points))
        on_surface = row_of_point < len(surface.points)
        nodes = np.where(on_surface, row_of_point, nearest).astype(np.int32)
        return extent, Reach(*as_jax((nodes[:, None], (reached | on_surface)[:, None])))

    def reach(self, ids: Extent) -> float:
        return float("inf") if self.radius is None else float(self.radius)

    def fit(self, ids: Extent, surface, points):
        return self._radius(ids, surface)

    def carry(self, ids, factors, surface, points):
        return factors

    def place(self, x, ids: Reach, factors, surface):
        radius = factors[ids.nodes]
        fades = radius > 0
        apart = surface[ids.nodes] - x[None]
        weights = WendlandC2(1.0)(jnp.sum(apart**2, axis=1) / jnp.where(fades, radius, 1) ** 2)
        return ids.weighted(jnp.where(fades, weights, 0))

    def field(self, ids, factors, surface, u):
        return InterpolatedField(self, factors, surface, u)

    def _radius(self, extent: Extent, surface):
        """Computes the radius of each surface node."""
        width = layer_width(self.radius, extent, surface)
        return width if self.radius is not None else SPACING * width
