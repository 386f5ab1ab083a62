"""The simplex of a surface's graph that holds a point (section 2.3 of the paper, step 2)."""

import dataclasses

import numpy as np

from ..package.cores import by_blocks
from ..package.errors import MeshError, place_of, worst_first
from ..package.orders import morton_order
from .graph import JITTER, Graph, graph_of
from .simplices import normals, smallest_height

TOLERANCE = 1e-6
"""A point whose smallest weight is below minus this is searched again."""


@dataclasses.dataclass(frozen=True)
class Location:
    """The places of points in the graph.

    - `vertices`: ids (w, d + 1) of the surface nodes whose simplex holds the point.
    - `repaired`: number of answers of the search that were repaired.
    - `outside`: number of points outside of all simplices, by no more than round-off.
    """

    vertices: np.ndarray
    repaired: int
    outside: int = 0


def locate(
    surface: np.ndarray | Graph,
    points: np.ndarray,
    wanted: np.ndarray,
    near: tuple[np.ndarray, np.ndarray] | None = None,
) -> Location:
    """Finds the surface nodes whose simplex holds a point, for all `wanted` points.

    Coordinates in single precision count as exact numbers, except for points on the hull.

    **Arguments:**

    - `surface`: the surface nodes (b, d), or their graph.
    - `points`: all points (n, d).
    - `wanted`: ids (w,) of the points to locate.
    - `near`: ids of points near a wall, and their nearest surface nodes. Location is then faster.

    **Raises:** `MeshError` for points outside of the surface's convex hull, with their number, the
    worst point and its distance. `ValueError` for a surface without extent in some direction.
    """
    graph = surface if isinstance(surface, Graph) else graph_of(surface)
    points = points.astype(np.float64, copy=False)
    targets = (points[wanted] - graph.centre) / graph.size
    order = morton_order(targets)
    if near is not None:
        order = _inwards(order, *_among(wanted, *near, len(points)), targets, graph.unit)
    simplex = np.empty(len(targets), dtype=np.int64)

    def find(part: slice) -> None:  # parts do not follow the cores: a point on a face may have several answers
        simplex[order[part]] = graph.delaunay.find_simplex(targets[order[part]])

    by_blocks(find, len(targets))
    smallest = graph.smallest_weight(simplex, targets)
    poor = np.flatnonzero(~(smallest >= -TOLERANCE))
    outside = 0
    if poor.size:
        simplex[poor], smallest[poor] = _repair(graph, targets[poor], simplex[poor])
        still = poor[~(smallest[poor] >= -TOLERANCE)]
        _check_inside(points, wanted[still], _beyond_hull(graph, targets[still]) * graph.size - graph.slack)
        simplex[still], beyond = _search(graph, targets[still], simplex[still])
        beyond_sides = np.where(beyond > graph.flat + JITTER, beyond, 0)
        _check_inside(points, wanted[still], beyond_sides * graph.size - graph.slack)
        outside = int((beyond > 0).sum())
    vertices = graph.unique.astype(np.int32)[graph.delaunay.simplices]
    return Location(vertices[simplex], len(poor), outside)


def _among(wanted: np.ndarray, ids: np.ndarray, nodes: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Finds the `wanted` points among the `ids`: their places in `wanted`, and their nodes."""
    node = np.full(n, -1, dtype=np.int64)
    node[ids] = nodes
    place = np.flatnonzero(node[wanted] >= 0)
    return place, node[wanted[place]]


def _inwards(
    order: np.ndarray, near: np.ndarray, nodes: np.ndarray, points: np.ndarray, surface: np.ndarray
) -> np.ndarray:
    """Moves the points `near` walls to the end of an order: by node, from afar to the wall."""
    # A search begins in the simplex of the point before. A walk along a wall would pass through all
    # flat simplices in between; a walk from outside takes half as long.
    height = np.linalg.norm(points[near] - surface[nodes], axis=1)
    rank = np.empty(len(surface), dtype=np.int64)
    rank[morton_order(surface)] = np.arange(len(surface))
    far = np.ones(len(order), dtype=bool)
    far[near] = False
    return np.concatenate([order[far[order]], near[np.lexsort((-height, rank[nodes]))]])


def _repair(graph: Graph, points: np.ndarray, simplex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds better simplices for points that the search missed: ids, and smallest weights."""
    # A point is inside of a simplex if its smallest weight is not negative, so that the best
    # simplex has the largest one. First a point moves a little towards the middle, out of the flat
    # simplices along a plane side of the hull, and is searched again. Then a point without a good
    # simplex walks from simplex to neighbour as long as its weight grows.
    simplex = np.maximum(simplex, 0)
    best = graph.smallest_weight(simplex, points)
    middle = graph.nodes.mean(axis=0)
    for step in (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        left = np.flatnonzero(~(best >= -TOLERANCE))
        if not left.size:
            return simplex, best
        candidate = graph.delaunay.find_simplex(points[left] + step * (middle - points[left]))
        weight = graph.smallest_weight(candidate, points[left])
        better = weight > best[left]
        simplex[left[better]], best[left[better]] = candidate[better], weight[better]
    active, neighbors = np.flatnonzero(~(best >= -TOLERANCE)), graph.delaunay.neighbors
    for _ in range(32):
        if not active.size:
            break
        around = neighbors[simplex[active]]
        rings = np.concatenate([around, neighbors[around].reshape(len(active), -1)], axis=1)
        repeated = np.repeat(points[active], rings.shape[1], axis=0)
        weight = graph.smallest_weight(rings.ravel(), repeated).reshape(rings.shape)
        pick = weight.argmax(axis=1)
        value = weight[np.arange(len(active)), pick]
        better = value > best[active]
        simplex[active[better]] = rings[np.flatnonzero(better), pick[better]]
        best[active[better]] = value[better]
        active = active[better & (value < -1e-12)]
    return simplex, best


def _search(graph: Graph, points: np.ndarray, simplex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tries all simplices for a few points: the best ones, and the points' distances beyond them.

    Between flat simplices of nodes in one plane, the walk of `_repair` may end early.
    """
    heights = smallest_height(graph.nodes[graph.delaunay.simplices])
    sound = np.flatnonzero(heights > graph.flat)
    corners, margin = graph.nodes[graph.delaunay.simplices[sound]], 2 * JITTER + graph.flat
    low, high = corners.min(axis=1) - margin, corners.max(axis=1) + margin
    simplex, beyond = simplex.copy(), np.full(len(points), np.inf)
    for i, point in enumerate(points):
        near = sound[((point >= low) & (point <= high)).all(axis=1)]
        near = near if near.size else sound
        weight = graph.smallest_weight(near, np.broadcast_to(point, (len(near), len(point))))
        best = weight.argmax()
        simplex[i], beyond[i] = near[best], -weight[best] * heights[near[best]]
    return simplex, beyond


def _beyond_hull(graph: Graph, targets: np.ndarray) -> np.ndarray:
    """Measures how far points surely lie beyond the plane of a facet of the hull: 0 or less inside.

    A small facet says little about a distant point: jitter and round-off may have turned it.
    """
    corners = graph.nodes[graph.delaunay.convex_hull]
    height = smallest_height(corners)
    corners, height = corners[height > graph.flat], height[height > graph.flat]
    outward, anchors = normals(corners), corners[:, 0]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    outward *= np.sign(np.einsum("fd,fd->f", outward, anchors - graph.nodes.mean(axis=0)))[:, None]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    slack = 4 * (JITTER * longest + graph.flat) * np.maximum(1, 1 / height)
    offsets = np.einsum("fd,fd->f", outward, anchors) + slack
    parts = np.array_split(targets, 1 + len(targets) // 512)
    return np.concatenate([(part @ outward.T - offsets).max(axis=1) for part in parts])


def _check_inside(points: np.ndarray, ids: np.ndarray, beyond: np.ndarray) -> None:
    """Raises `MeshError` for points outside of the hull; points on it, within round-off, pass."""
    outside = ids[worst_first(beyond, 0)]
    if outside.size:
        raise MeshError(
            f"{len(outside)} of {len(points)} points lie outside of the convex hull of the moving and fixed nodes; the worst is "
            f"node {{node}} at ({place_of(points[outside[0]])}), {beyond.max():.3g} beyond it. Add the missing boundary "
            "(outlet, inlet, far field, channel wall) as fixed nodes, or take a method without a graph, such as jm.RBF().",
            outside,
        )
