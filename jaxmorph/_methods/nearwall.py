"""A correction that keeps the boundary layer together on walls that are not convex."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._host.package.rounding import first_largest, nearest_of
from .._host.surface.neighbours import digest, near_walls
from .._kernels.values import Either, as_jax, namespace, norm, root
from .base import AbstractField, AbstractMethod, AbstractPlacing, carry, carry_place, check_kind, length_or_none, place
from .blocks import map_points
from .delaunay import DelaunayGraph
from .rbf.basis import WendlandC2
from .sparse import InterpolatedField, Interpolation
from .surface import Surface

NEIGHBOURS = 6  # wall nodes that a point averages; one more node sets the distance at which weights vanish
REACH = 0.5  # width of the layer, relative to the largest distance from a wall's node to its nearest source
CHORD = 0.25  # width of the layer of a wall without matched sources, relative to its mean chord
SLIGHTLY = 1e-6  # relative difference that keeps the maximum of equal lengths from having a kink


class NearWall(AbstractPlacing):
    """Replaces a correction near the wall by the displacement of the wall itself.

    u = chi u_wall + (1 - chi) u_correction. Here chi is Wendland's C2 function of the distance to
    the wall over `width`. The displacement u_wall is a mean over the nearest wall nodes, weighted
    by inverse distance (Franke and Little's weights, which end continuously). A Delaunay graph lays
    chords over a concave or flat wall. Points above a chord then move differently from wall nodes
    under it, by more than the thickness of a boundary layer's first cell. Points that follow the
    nearest wall keep their place in the layer. The map is one fixed sparse operator, exact at the
    surface's nodes.

    **Arguments:**

    - `correction`: any method. Default `DelaunayGraph()`.
    - `width`: width of the layer in the mesh's units. It ends before half of the gap to another
      wall. Default None: for each wall half of the largest distance from one of its nodes to the
      nearest matched node, a source that the coarse field reproduces. A wall without matched nodes
      has a quarter of its mean chord: of half of its length, in 3-D half of its area over its span.
    """

    correction: AbstractMethod = eqx.field(default_factory=DelaunayGraph)
    width: Float[Array, ""] | None = eqx.field(default=None, converter=length_or_none("width"))

    def __check_init__(self):
        check_kind(self.correction, AbstractMethod, "correction", "jm.DelaunayGraph()")

    @property
    def exact(self) -> bool:
        return self.correction.exact

    @property
    def needs_cells(self) -> bool:
        return self.correction.needs_cells

    @property
    def linear(self) -> bool:
        return self.correction.linear

    def connect(self, surface: Surface, points):
        extent = Extent.seen(surface)
        width = layer_width(self.width, jax.tree.map(np.asarray, extent), np.asarray(surface.points))
        row_of_point = surface.rows(len(points))
        reached = row_of_point < len(surface.points)
        inside = np.flatnonzero(~reached)
        wall = np.asarray(extent.wall)
        near, rows = near_walls(surface.points, wall, 1.25 * width, points[inside], NEIGHBOURS + 1, surface.once)
        correction, correction_at_points = self.correction.connect(surface, points)
        # a node of the surface has itself alone
        nodes = np.where(reached, row_of_point, 0)[:, None].repeat(NEIGHBOURS + 2, axis=1)
        nodes[inside[near]], reached[inside[near]] = rows, True
        return Layered(correction, extent), Layered(correction_at_points, WallRow(*as_jax((nodes, reached))))

    def fit(self, ids, surface, points):
        width = layer_width(self.width, ids.wall, surface)
        return Layered(self.correction.fit(ids.correction, surface, points), width)

    def carry(self, ids, factors, surface, points):
        correction = carry(self.correction, ids.correction, factors.correction, surface, points)
        return Layered(correction, factors.wall)

    def place(self, x, ids, factors, surface):
        correction = place(self.correction, x, ids.correction, factors.correction, surface)
        return WallPlace(correction, *_blend(x, ids.wall, factors.wall, surface))

    def carry_place(self, x, ids, factors, surface, placed):
        correction = carry_place(self.correction, x, ids.correction, factors.correction, surface, placed.correction)
        return WallPlace(correction, *_blend(x, ids.wall, factors.wall, surface))

    def field(self, ids, factors, surface, u):
        correction = self.correction.field(ids.correction, factors.correction, surface, u)
        return NearWallField(correction, InterpolatedField(u))

    def check(self, ids, factors, u):
        self.correction.check(ids.correction, factors.correction, u)


class Layered(eqx.Module):
    """Ids or factors of the correction, and those of the wall: `Extent`, `WallRow`, or widths."""

    correction: PyTree
    wall: PyTree


class WallPlace(eqx.Module):
    """A point's place in the correction, the wall's part of its motion, and the share outside."""

    correction: PyTree
    wall: Interpolation
    outside: Float[Array, "*n"]


class Extent(eqx.Module):
    """Walls, as rows of the surface."""

    wall: Int[Array, " b"]  # each row's wall
    matched: Int[Array, " b"]  # each row's nearest matched row of its wall, or itself
    ends: Int[Array, "w 2"]  # two ends of each wall
    widest: Int[Array, " w"]  # each wall's row that is farthest from its matched row
    share: Float[Array, " w"]  # each wall's mean chord, relative to the distance of its ends; zero with matched rows

    @classmethod
    def seen(cls, surface: Surface) -> "Extent":
        return surface.once(("extent", digest(surface.matched)), lambda: cls._searched(surface))

    @classmethod
    def _searched(cls, surface: Surface) -> "Extent":
        wall, ends, share = surface.walls
        share, points = share.copy(), surface.points
        matched, widest = np.arange(len(wall)), np.zeros(len(ends), dtype=np.int64)
        for label in np.unique(wall):
            here, chosen = np.flatnonzero(wall == label), surface.matched[wall[surface.matched] == label]
            if len(chosen):
                matched[here] = nearest_of(points[here], points[chosen], chosen)
                share[label] = 0
            widest[label] = here[first_largest(np.linalg.norm(points[here] - points[matched[here]], axis=1))]
        return cls(*as_jax([*(ids.astype(np.int32) for ids in (wall, matched, ends, widest)), share]))


def layer_width(width: Float[Either, ""] | None, extent: Extent, surface: Float[Either, "b d"]) -> Float[Either, " b"]:
    xp = namespace(surface)
    if width is not None:
        return xp.full(len(surface), xp.asarray(width, surface.dtype))
    gap = norm(surface - surface[extent.matched])
    if xp is np:
        widest = np.full(len(extent.ends), -np.inf)
        np.maximum.at(widest, extent.wall, gap)
    else:
        widest = jax.ops.segment_max(gap, extent.wall, len(extent.ends))
    widest = xp.maximum((1 - SLIGHTLY) * widest, gap[extent.widest])
    span = norm(surface[extent.ends[:, 0]] - surface[extent.ends[:, 1]])
    return xp.maximum(REACH * widest, CHORD * extent.share.astype(surface.dtype) * span)[extent.wall]


class WallRow(eqx.Module):
    """Wall nodes of a point near a wall: nearest nodes in order, then one of another wall."""

    nodes: Int[Array, "*n k"]
    reached: Bool[Array, "*n"]


class NearWallField(AbstractField):
    correction: AbstractField
    wall: InterpolatedField

    @property
    def block_size(self) -> None:
        return None  # the correction makes its own blocks

    def __call__(self, x, ids: WallPlace):
        return self.wall(x, ids.wall) + ids.outside * self.correction(x, ids.correction)

    def evaluate(self, points, ids: WallPlace):
        correction = map_points(self.correction, points, ids.correction)
        return map_points(self.wall, points, ids.wall) + ids.outside[:, None] * correction


def _blend(
    x: Float[Array, " d"], row: WallRow, width: Float[Array, " b"], surface: Float[Array, "b d"]
) -> tuple[Interpolation, Float[Array, ""]]:
    """Returns the wall's part at x, chi u_wall, and 1 - chi."""
    nearest, other = row.nodes[:-1], row.nodes[-1]
    distance = norm(surface[nearest] - x[None])
    # the last node was the farthest when it was found: of nodes as far as it is, it alone decides,
    # so there is no kink
    reach = jnp.maximum(distance[-1], (1 - SLIGHTLY) * distance.max()) * (1 + 2 * SLIGHTLY)
    at_node = distance[0] == 0
    safe = jnp.where(at_node, 1, distance)
    weights = jnp.where(at_node, 0, (reach - safe) * (safe[0] / safe)) ** 2  # Franke and Little, times safe[0]
    weights = jnp.where(at_node, jnp.zeros_like(weights).at[0].set(1), weights)[:-1]
    layer = jnp.where(width[nearest[0]] > 0, width[nearest[0]], 1)
    gap = norm(surface[other] - x)
    alone = (other == nearest[0]) | (gap == 0)
    halfway = jnp.where(alone, 0, 2 * distance[0] / (distance[0] + jnp.where(alone, 1, gap)))  # 1 between two walls
    # the layer ends at its width or half way, whichever is nearer, without a kink
    fourth = (distance[0] / layer) ** 4 + halfway**4
    chi = jnp.where(row.reached & (width[nearest[0]] > 0), WendlandC2(1.0)(root(fourth)), 0)
    return Interpolation(nearest[:-1], chi * (weights / weights.sum()), row.reached), 1 - chi
