"""The correction of Rendall and Allen: the nearest node's offset, fading with distance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._host.package.rounding import Tree, nearest_of
from .._kernels.values import as_jax
from .base import AbstractPlacing, Control, length_or_none
from .nearwall import Extent, layer_width
from .rbf.basis import WendlandC2
from .sparse import InterpolatedField, Reach, Searched, squared_distance
from .surface import Surface

REACH = 1.25  # search distance in radii: beyond 1 another node may come nearer than the nearest node
SPACING = 2.0  # the automatic radius, relative to the width of the layer of `NearWall`


class LocalIds(eqx.Module):
    extent: Extent
    searched: Searched


class LocalFactors(eqx.Module):
    radius: Float[Array, " b"]
    is_certain: Bool[Array, ""]


class LocalCorrection(AbstractPlacing):
    """Moves a point with the nearest surface node, by a share that fades with distance.

    u(x) = psi(|x - x_k| / R) u_k, with the nearest node k and Wendland's C2 function psi. So
    Rendall and Allen correct what a reduced set of sources misses on the surface (Journal of
    Computational Physics 228 and 229, 2009 and 2010). The field is exact at the surface's nodes. It
    needs no system and no graph, so the mesh may reach beyond the hull of its boundary. The field
    jumps where the nearest node changes, by as much as the offsets of two neighbours differ. Of
    nodes that are equally near the first counts. Between two walls closer than twice the radius it
    may tear cells; `NearWall` does not. Alone it reproduces no polynomial, and cells fold where the
    offset is a good part of the radius. The `radius` R is in the mesh's units. By default it is for
    each wall the largest distance from one of its nodes to the nearest source, or half of the mean
    chord of a wall without sources. Rendall and Allen take a multiple of the largest offset, which
    would not be linear in `u`.

    **Raises:** `ValueError` for a radius that is not positive and finite. `refit` raises it where
    another node has come within the radius of a point, and is nearer than the point's own node by a
    quarter of the radius. Traced code answers NaN there.
    """

    radius: Float[Array, ""] | None = eqx.field(default=None, converter=length_or_none("radius"))

    def connect(self, surface: Surface, points):
        extent = Extent.seen(surface)
        distance = REACH * self._radius(jax.tree.map(np.asarray, extent), np.asarray(surface.points)).max()
        to_surface = Tree(surface.points).query(points, distance_upper_bound=distance or np.inf)[0]
        reached, nodes = np.isfinite(to_surface), np.zeros(len(points), dtype=np.int32)
        nodes[reached] = nearest_of(points[reached], surface.points, np.arange(len(surface.points)))
        rows = surface.rows(len(points))
        on_surface = rows < len(surface.points)
        nodes[on_surface] = rows[on_surface]
        searched = Searched(*as_jax((points, surface.points, np.asarray(distance))))
        return LocalIds(extent, searched), Reach(*as_jax((nodes[:, None], (reached | on_surface)[:, None])))

    def control(self, ids):
        return Control() if self.radius is None else Control(reach=float(self.radius))

    def fit(self, ids: LocalIds, surface, points):
        radius = self._radius(ids.extent, surface)
        return LocalFactors(radius, ids.searched.certain(radius.max(), surface, points))

    def carry(self, ids, factors, surface, points):
        return factors

    def place(self, x, ids: Reach, factors: LocalFactors, surface):
        radius = factors.radius[ids.nodes]
        fades = radius > 0

        def is_lost():
            squared, reaches = squared_distance(x[None], surface), jax.lax.stop_gradient(factors.radius)
            nearest = jnp.where(squared < reaches**2, jnp.sqrt(squared) + (REACH - 1) * reaches, jnp.inf).min()
            listed = jnp.sqrt(squared_distance(x[None], surface[ids.nodes]))[0]
            return nearest < jnp.where(ids.reached[0], listed, jnp.inf)

        lost = jax.lax.cond(factors.is_certain, lambda: jnp.array(False), is_lost)
        squared = jnp.sum((surface[ids.nodes] - x[None]) ** 2, axis=1)
        weights = WendlandC2(1.0)(squared / jnp.where(fades, radius, 1) ** 2)
        return ids.weighted(jnp.where(fades, weights, 0), lost)

    def field(self, ids, factors, surface, u):
        return InterpolatedField(u)

    def _radius(self, extent: Extent, surface):
        width = layer_width(self.radius, extent, surface)
        return width if self.radius is not None else SPACING * width
