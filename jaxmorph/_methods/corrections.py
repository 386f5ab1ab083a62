"""Corrections of a coarse field: a graph of the surface, a layer over walls, the nearest node."""

from concurrent.futures import Future

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._host.linear.products import cofactors, dot
from .._host.package.cores import beside
from .._host.package.rounding import Tree, first_largest, nearest_of
from .._host.surface.graph import Graph, graph_of, locate
from .._host.surface.neighbours import digest, near_walls
from .._kernels.values import Either, as_jax, at_rows, jax_arrays, namespace, norm, root
from .base import (
    AbstractField,
    AbstractMethod,
    AbstractPlacing,
    AbstractWhole,
    Control,
    Flag,
    Point,
    Rows,
    Scalar,
    check_kind,
    number_or_none,
    or_one,
)
from .blocks import map_points
from .rbf.basis import WendlandC2
from .sparse import InterpolatedField, Interpolation, NodeSearch, Reach, is_lost, squared_distance
from .surface import Surface
from .turn import WallTurn, WallTurnIds, risen


class DelaunayGraph(AbstractPlacing):
    """Moves each point with the simplex of surface nodes that holds it (eq. 8).

    The graph stands on the undeformed surface and carries displacements, so that the map is one
    linear operator for any motion. A surface node follows itself alone; the first of duplicate
    nodes (moving before fixed) stands in the graph. The graph is discontinuous in the base
    coordinates: nodes on one circle or sphere can be joined in several ways. Coordinates are
    rounded first, far below the distance of nodes, so that round-off does not choose.

    **Raises:** `prepare` raises a `ValueError` for points outside of the surface's convex hull.
    """

    def connect(self, surface: Surface, points):
        rows = surface.rows(len(points))
        vertices = np.repeat(
            rows[:, None], points.shape[1] + 1, axis=1
        )  # a node of the surface: itself, d + 1 times
        inside = np.flatnonzero(rows == len(surface.points))
        if inside.size:
            vertices[inside] = locate(begun_graph(surface).result(), points, inside)
        return None, vertices

    def fit(self, ids, surface, points):
        return None

    def place(self, x, ids, factors, surface):
        e = barycentric(x, list(at_rows(surface, ids)), ids[0] == ids[1])
        return Interpolation(ids, jnp.stack(e))

    def field(self, ids, factors, surface, u):
        return InterpolatedField(u)


def begun_graph(surface: Surface) -> Future[Graph]:
    """Starts the graph of a surface in the background, once."""
    return surface.once("graph", lambda: beside(graph_of, surface.points))


def barycentric(x: Point, corners: list[Point], at_node) -> list[Scalar]:
    edges = [corner - corners[0] for corner in corners[1:]]
    rows = cofactors(edges)
    whole = jnp.where(at_node, 1, dot(rows[0], edges[0]))
    parts = [jnp.where(at_node, 0, dot(row, x - corners[0]) / whole) for row in rows]
    return [1 - sum(parts, start=jnp.zeros_like(whole)), *parts]


# wall nodes that a point averages; one more node sets the distance at which weights vanish
NEIGHBOURS = 6
CHORD = 0.4  # width of the layer, relative to the wall's mean chord
SLIGHTLY = 1e-6  # relative difference that keeps the maximum of equal lengths from having a kink


class NearWall(AbstractPlacing):
    """Replaces a correction near the wall by the displacement of the wall itself.

    u = chi u_wall + (1 - chi) u_correction. Here chi is Wendland's C2 function of the distance to
    the wall over `width`. The displacement u_wall is a mean over the nearest wall nodes, weighted
    by inverse distance (Franke and Little's weights, which end continuously). A Delaunay graph lays
    chords over a concave or flat wall. Points above a chord then move differently from wall nodes
    under it, by more than the thickness of a boundary layer's first cell. Points that follow the
    nearest wall keep their place in the layer. The map is linear in the displacement, and exact at
    the surface's nodes.

    Where walls have faces, the layer carries the wall's slope, too: first grid lines turn with the
    wall. At the distance d along the normal n, r of the layer's end, u gets (1 - r^2)^2 h tanh(d /
    h) g, with g = - sum_t t (n . du/dt) - dc/dn + a n. The field c is the coarse one, and the wall
    as a whole grows by a. The height h is small on thin bodies, at noses and in gaps, and zero at
    sharp edges. The formula is this library's own.

    **Arguments:**

    - `correction`: any method. Default `DelaunayGraph()`.
    - `width`: width of the layer in the mesh's units. It ends before half of the gap to another
      wall. Default None: 0.4 of each wall's mean chord, which is half of its length, in 3-D half of
      its area over its span.
    """

    correction: AbstractMethod = eqx.field(default_factory=DelaunayGraph)
    width: Scalar | None = eqx.field(default=None, converter=number_or_none("width", 0))

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
        width = layer_width(
            self.width, jax.tree.map(np.asarray, extent), np.asarray(surface.points, float)
        )
        row_of_point = surface.rows(len(points))
        reached = row_of_point < len(surface.points)
        inside = np.flatnonzero(~reached)
        wall = np.asarray(extent.wall)
        near, rows = near_walls(
            surface.points, wall, 1.25 * width, points[inside], NEIGHBOURS + 1, surface.once
        )
        correction, correction_at_points = self.correction.connect(surface, points)
        # a node of the surface has itself alone
        nodes = np.where(reached, row_of_point, 0)[:, None].repeat(NEIGHBOURS + 2, axis=1)
        nodes[inside[near]] = rows
        reached[inside[near]] = True
        turn = surface.once(
            ("turn", digest(width)), lambda: WallTurnIds.found(surface, width.astype(float))
        )
        of_points = Layered(correction_at_points, WallRow(*as_jax((nodes, reached))))
        return Layered(correction, extent, turn), of_points

    def fit(self, ids, surface, points):
        width = layer_width(self.width, ids.wall, surface)
        correction = self.correction.fit(ids.correction, surface, points)
        return Layered(correction, width, _wall_turn(ids, surface, width))

    def carry(self, ids, factors, surface, points):
        correction = self.correction.carry(ids.correction, factors.correction, surface, points)
        return Layered(correction, factors.wall, _wall_turn(ids, surface, factors.wall))

    def place(self, x, ids, factors, surface):
        correction = self.correction.place(x, ids.correction, factors.correction, surface)
        return _placed(x, correction, ids.wall, factors, surface)

    def carry_place(self, x, ids, factors, surface, placed):
        correction = self.correction.carry_place(
            x, ids.correction, factors.correction, surface, placed.correction
        )
        return _placed(x, correction, ids.wall, factors, surface)

    def field(self, ids, factors, surface, u):
        turn = None
        if ids.turn is not None:
            rest = jnp.zeros_like(u)
            turn = factors.turn.turned(ids.turn, u, rest, rest)
        return self._layer(ids, factors, surface, u, turn)

    def correct(self, ids, factors, surface, left):
        if left.coarse is None or ids.turn is None:
            return self.field(ids, factors, surface, left.offset)
        near = left.u - left.offset
        far = map_points(left.coarse, factors.turn.probes, None)
        turn = factors.turn.turned(ids.turn, left.u, near, far)
        return self._layer(ids, factors, surface, left.offset, turn)

    def _layer(self, ids, factors, surface, offset: Rows, turn: Rows | None) -> "NearWallField":
        correction = self.correction.field(ids.correction, factors.correction, surface, offset)
        values = offset if turn is None else jnp.concatenate([offset, turn], axis=1)
        return NearWallField(correction, InterpolatedField(values))

    def check(self, ids, factors, u):
        self.correction.check(ids.correction, factors.correction, u)


class Layered(eqx.Module):
    """Ids or factors of the correction, and those of the wall: `Extent`, `WallRow`, or widths; and
    what turns, `WallTurnIds` or a `WallTurn`, where the walls have faces.
    """

    correction: PyTree
    wall: PyTree
    turn: PyTree = None


class WallPlace(eqx.Module):
    """A point's place in the correction, the wall nodes it follows, the wall's share in its motion,
    and the height by which the wall's slope counts, where it does.
    """

    correction: PyTree
    wall: Interpolation
    share: Float[Array, "*n"]
    rise: Float[Array, "*n"] | None = None


def _wall_turn(ids: Layered, surface: Rows, width: Float[Array, " b"]) -> WallTurn | None:
    return None if ids.turn is None else WallTurn.made(ids.turn, surface, width)


def _placed(
    x: Point, correction: PyTree, row: "WallRow", factors: Layered, surface: Rows
) -> WallPlace:
    wall, ratio = _blend(x, row, factors.wall, surface)
    share = WendlandC2(1.0)(ratio)
    turn = factors.turn
    if turn is None:
        return WallPlace(correction, wall, share)
    normals = at_rows(turn.normal, wall.nodes)
    above = jnp.sum((x[None] - at_rows(surface, wall.nodes)) * normals, axis=1)
    rise = risen(
        jnp.maximum(jnp.sum(wall.weights * above), 0),
        jnp.sum(wall.weights * at_rows(turn.height, wall.nodes)),
    )
    # the slope fades more evenly than the share: what turns near the wall turns back above
    return WallPlace(correction, wall, share, rise * jnp.maximum(1 - ratio, 0) ** 2)


class Extent(eqx.Module):
    """Walls, as rows of the surface."""

    # each row's wall
    wall: Int[Array, " b"]
    # each wall's two ends, and its mean chord, relative to their distance
    ends: Int[Array, "w 2"]
    chord: Float[Array, " w"]

    @classmethod
    def seen(cls, surface: Surface) -> "Extent":
        def found():
            wall, ends, chord = surface.walls
            return cls(**jax_arrays(wall=wall, ends=ends, chord=chord))

        return surface.once("extent", found)


class Missed(eqx.Module):
    """How far walls are from the rows that are matched."""

    # each wall's row that is farthest from the matched ones, with the nearest of these
    pairs: Int[Array, "w 2"]
    # `chord` of a wall without matched rows, else 0
    share: Float[Array, " w"]

    @classmethod
    def searched(cls, surface: Surface) -> "Missed":
        wall, ends, chord = surface.walls
        share = chord.copy()
        points = surface.points
        pairs = 0 * ends
        for label in np.unique(wall):
            here = np.flatnonzero(wall == label)
            chosen = surface.matched[wall[surface.matched] == label]
            matched = nearest_of(points[here], points[chosen], chosen) if len(chosen) else here
            farthest = first_largest(np.linalg.norm(points[here] - points[matched], axis=1))
            pairs[label] = here[farthest], matched[farthest]
            share[label] = 0 if len(chosen) else share[label]
        return cls(**jax_arrays(pairs=pairs, share=share))


def layer_width(
    width: Float[Either, ""] | None, extent: Extent, surface: Float[Either, "b d"]
) -> Float[Either, " b"]:
    xp = namespace(surface)
    if width is not None:
        return xp.full(len(surface), xp.asarray(width, surface.dtype))
    ends = at_rows(surface, extent.ends)
    span = norm(ends[:, 0] - ends[:, 1])
    return at_rows(CHORD * extent.chord.astype(surface.dtype) * span, extent.wall)


class WallRow(eqx.Module):
    """Wall nodes of a point near a wall: nearest nodes in order, then one of another wall."""

    nodes: Int[Array, "*n k"]
    reached: Bool[Array, "*n"]


class NearWallField(AbstractWhole):
    correction: AbstractField
    wall: InterpolatedField

    def __call__(self, x, ids: WallPlace):
        wall = self.wall(x, ids.wall)
        moved = ids.share * wall[: len(x)]
        if ids.rise is not None:
            moved = moved + ids.rise * wall[len(x) :]
        return moved + (1 - ids.share) * self.correction(x, ids.correction)

    def evaluate(self, points, ids: WallPlace):
        correction = map_points(self.correction, points, ids.correction)
        value, *slope = jnp.split(self.wall.evaluate(points, ids.wall), [points.shape[1]], axis=1)
        moved = ids.share[:, None] * value
        if ids.rise is not None:
            moved = moved + ids.rise[:, None] * slope[0]
        return moved + (1 - ids.share)[:, None] * correction


def _blend(
    x: Point, row: WallRow, width: Float[Array, " b"], surface: Rows
) -> tuple[Interpolation, Scalar]:
    """Returns the wall nodes that x follows, and its squared distance relative to the layer's end:
    from 0 at the wall to 1 or more where the layer has ended.
    """
    nearest = row.nodes[:-1]
    other = row.nodes[-1]
    away = norm(at_rows(surface, row.nodes) - x[None])
    distance = away[:-1]
    # the last node was the farthest when it was found: of nodes as far as it is, it alone decides,
    # so there is no kink
    reach = jnp.maximum(distance[-1], (1 - SLIGHTLY) * distance.max()) * (1 + 2 * SLIGHTLY)
    at_node = distance[0] == 0
    safe = jnp.where(at_node, 1, distance)
    weights = (
        jnp.where(at_node, 0, (reach - safe) * (safe[0] / safe)) ** 2
    )  # Franke and Little, times safe[0]
    first = jnp.arange(len(weights)) == 0
    weights = jnp.where(at_node, first.astype(weights.dtype), weights)[:-1]
    whole = at_rows(width, nearest[0])
    layer = or_one(whole)
    gap = away[-1]
    alone = (other == nearest[0]) | (gap == 0)
    halfway = jnp.where(
        alone, 0, 2 * distance[0] / (distance[0] + jnp.where(alone, 1, gap))
    )  # 1 between two walls
    # the layer ends at its width or half way, whichever is nearer, without a kink
    fourth = (distance[0] / layer) ** 4 + halfway**4
    ratio = jnp.where(row.reached & (whole > 0), root(fourth), 1)
    return Interpolation(nearest[:-1], weights / weights.sum(), row.reached), ratio


# search distance in radii: beyond 1 another node may come nearer than the nearest node
SEARCHED = 1.25
HALF = 0.5  # the radius at a wall without matched sources, relative to its mean chord


class LocalIds(eqx.Module):
    extent: Extent
    missed: Missed
    search: NodeSearch


class LocalFactors(eqx.Module):
    radius: Float[Array, " b"]
    is_certain: Flag


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

    radius: Scalar | None = eqx.field(default=None, converter=number_or_none("radius", 0))

    def connect(self, surface: Surface, points):
        extent = Extent.seen(surface)
        missed = Missed.searched(surface)
        walls, sources = jax.tree.map(np.asarray, (extent, missed))
        places = np.asarray(surface.points, float)
        distance = SEARCHED * self._radius(walls, sources, places).max()
        to_surface = Tree(surface.points).query(points, distance_upper_bound=distance or np.inf)[0]
        reached = np.isfinite(to_surface)
        nodes = np.zeros(len(points), dtype=np.int32)
        nodes[reached] = nearest_of(points[reached], surface.points, np.arange(len(surface.points)))
        rows = surface.rows(len(points))
        on_surface = rows < len(surface.points)
        nodes[on_surface] = rows[on_surface]
        search = NodeSearch(*as_jax((points, surface.points, np.asarray(distance))))
        return LocalIds(extent, missed, search), Reach(
            *as_jax((nodes[:, None], (reached | on_surface)[:, None]))
        )

    def control(self, ids):
        return Control() if self.radius is None else Control(reach=float(self.radius))

    def fit(self, ids: LocalIds, surface, points):
        radius = self._radius(ids.extent, ids.missed, surface)
        return LocalFactors(radius, ids.search.is_certain(radius.max(), surface, points))

    def carry(self, ids, factors, surface, points):
        return factors

    def place(self, x, ids: Reach, factors: LocalFactors, surface):
        radius = factors.radius[ids.nodes]
        fades = radius > 0

        def look():
            squared = squared_distance(x[None], surface)
            reaches = jax.lax.stop_gradient(factors.radius)
            nearest = jnp.where(
                squared < reaches**2, jnp.sqrt(squared) + (SEARCHED - 1) * reaches, jnp.inf
            ).min()
            listed = jnp.sqrt(squared_distance(x[None], surface[ids.nodes]))[0]
            return nearest < jnp.where(ids.reached[0], listed, jnp.inf)

        lost = is_lost(factors.is_certain, look)
        squared = jnp.sum((surface[ids.nodes] - x[None]) ** 2, axis=1)
        weights = WendlandC2(1.0)(squared / jnp.where(fades, radius, 1) ** 2)
        return ids.weighted(jnp.where(fades, weights, 0), lost)

    def field(self, ids, factors, surface, u):
        return InterpolatedField(u)

    def _radius(self, extent: Extent, missed: Missed, surface):
        xp = namespace(surface)
        if self.radius is not None:
            return xp.full(len(surface), xp.asarray(self.radius, surface.dtype))
        distance = norm(surface[missed.pairs[:, 0]] - surface[missed.pairs[:, 1]])
        span = norm(surface[extent.ends[:, 0]] - surface[extent.ends[:, 1]])
        alone = HALF * missed.share.astype(surface.dtype) * span
        return xp.maximum(distance, alone)[extent.wall]
