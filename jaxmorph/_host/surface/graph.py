"""The Delaunay graph of a surface, and the simplex that holds each point (section 2.3 of the paper, steps 1 and 2).

Real surfaces are full of cospherical and coplanar nodes, which qhull turns into simplices without volume. The coordinates
that qhull sees are therefore moved by 1e-8 of the local spacing, by a fixed function of place. All that is computed from
the answer uses the true coordinates, and every weight is checked against them.
"""

import contextlib
import dataclasses
import functools

import numpy as np
from scipy.spatial import Delaunay, KDTree, QhullError

from ..package.errors import MeshError
from ..package.rounding import roundoff, spacing
from ..sources.reduction import canonical_order
from .simplices import cofactors, normals, smallest_height, smallest_weight

JITTER = 1e-8
"""Relative to the distance of the nearest node: at 1e-9 location is five times slower, at 1e-7 weights go wrong."""

SNAP = 2e-9
"""Coordinates that Qhull gets are rounded to about this, relative to the distance of the nearest node; well below `JITTER`."""

TRIALS = 4
"""Jitters that are tried before a graph is given up: Qhull ends with a precision error now and then, though nodes are good."""

FLAT = 64
"""A simplex lower than this times the round-off of the coordinates holds no point."""

BETWEEN = 0.618
"""Place of the borders of Morton's cells, relative to their size: off the numbers of a structured grid."""

TOLERANCE = 1e-6
"""A point whose smallest weight is below minus this is looked at again."""


@dataclasses.dataclass(frozen=True)
class Location:
    """Holds the place of each point in the graph.

    - `vertices`: ids (w, d + 1) of the surface nodes whose simplex holds the point.
    - `repaired`: how many answers of the search were repaired.
    - `outside`: how many points lie outside of all simplices, by no more than round-off.
    """

    vertices: np.ndarray
    repaired: int
    outside: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Graph:
    """The Delaunay graph of a surface, in which any number of points can be located. `graph_of` makes it.

    - `unit` (b, d): the surface's nodes from `centre` on, over `size`; `unique` are the distinct ones, `nodes` their places.
    - `delaunay`: the simplices between these.
    - `flat`: the height below which a simplex holds no point; `slack`: round-off of the coordinates.
    """

    centre: np.ndarray
    size: float
    unit: np.ndarray
    unique: np.ndarray
    nodes: np.ndarray
    delaunay: Delaunay
    flat: float
    slack: float


def graph_of(surface: np.ndarray) -> Graph:
    """Builds the Delaunay graph of a surface (b, d). Raises `ValueError` for one without extent in some direction."""
    dimension, slack = surface.shape[1], roundoff(surface)
    surface = surface.astype(np.float64, copy=False)
    centre, size = surface.min(axis=0), np.ptp(surface, axis=0).max() or 1.0
    unit = (surface - centre) / size
    unique = _without_coincident(unit, roundoff(surface) / size)
    nodes = unit[unique]
    if len(nodes) <= dimension:
        raise ValueError(
            f"a Delaunay graph in {dimension}-D needs {dimension + 1} distinct surface nodes, got {len(nodes)}."
        )
    flat = FLAT * roundoff(surface) / size
    return Graph(centre, size, unit, unique, nodes, _graph(nodes, flat), flat, slack)


def locate(
    surface: np.ndarray | Graph,
    points: np.ndarray,
    wanted: np.ndarray,
    near: tuple[np.ndarray, np.ndarray] | None = None,
) -> Location:
    """Finds the surface nodes whose simplex holds each of the `wanted` points.

    Coordinates in single precision are taken for exact numbers, except for points on the hull.

    **Arguments:**

    - `surface`: the surface nodes (b, d), or their graph.
    - `points`: all points (n, d).
    - `wanted`: ids (w,) of the points to locate.
    - `near`: ids of points near a wall, and the surface node nearest to each. Location is then faster.

    **Raises:** `MeshError` for points outside of the surface's convex hull, with their count, the worst one and its distance.
    `ValueError` for a surface without extent in some direction.
    """
    made = surface if isinstance(surface, Graph) else graph_of(surface)
    graph, nodes, flat, size, slack = made.delaunay, made.nodes, made.flat, made.size, made.slack
    points = points.astype(np.float64, copy=False)
    targets = (points[wanted] - made.centre) / size
    order = morton_order(targets)
    if near is not None:
        order = _inwards(order, *_among(wanted, *near, len(points)), targets, made.unit)
    simplex = np.empty(len(targets), dtype=np.int64)
    simplex[order] = graph.find_simplex(targets[order])
    smallest = smallest_weight(nodes, graph.simplices, simplex, targets, flat)
    poor = np.flatnonzero(~(smallest >= -TOLERANCE))
    outside = 0
    if poor.size:
        simplex[poor], smallest[poor] = _repair(graph, nodes, targets[poor], simplex[poor], flat)
        still = poor[~(smallest[poor] >= -TOLERANCE)]
        _check_inside(points, wanted[still], _beyond_hull(graph, nodes, targets[still], flat) * size - slack)
        simplex[still], beyond = _search(graph, nodes, targets[still], simplex[still], flat)
        _check_inside(points, wanted[still], np.where(beyond > flat + JITTER, beyond, 0) * size - slack)
        outside = int((beyond > 0).sum())
    return Location(made.unique[graph.simplices[simplex]].astype(np.int32), len(poor), outside)


class _Graph(Delaunay):
    """Replaces SciPy's barycentric transforms by a closed form.

    SciPy calls LAPACK for each simplex, whose threads cost twenty times more than the work. It gives up on the flattest
    simplices, for which `find_simplex` then searches through all of them.
    """

    @functools.cached_property
    def transform(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Inverse of the edges from the last corner, and that corner: (k, d + 1, d)."""
        corners = self.points[self.simplices]
        last = corners[:, -1]
        edges = [corners[:, i] - last for i in range(self.ndim)]
        rows = cofactors(edges)
        volume = np.einsum("kd,kd->k", rows[0], edges[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([*(row / volume[:, None] for row in rows), last], axis=1)


def _graph(nodes: np.ndarray, flat: float) -> Delaunay:
    graph, snapped = None, _snapped(nodes)
    for phase in range(TRIALS):
        with contextlib.suppress(QhullError):
            graph = _Graph(_jittered(snapped, phase))
            break
    if graph is None or not (smallest_height(nodes[graph.simplices]) > flat).any():
        raise ValueError(
            f"the {len(nodes)} surface nodes lie in one {'line' if nodes.shape[1] == 2 else 'plane'}, so no Delaunay graph "
            "spans the mesh. Add the other boundaries (far field, walls) as fixed nodes."
        )
    return graph


def morton_order(points: np.ndarray) -> np.ndarray:
    """Sorts points along Morton's curve: a permutation in which neighbours are close to each other."""
    dimension = points.shape[1]
    bits = 62 // dimension
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max() or 1.0
    key = np.zeros(len(points), dtype=np.uint64)
    for axis in range(dimension):
        grid = ((points[:, axis] - low[axis]) / extent * (2**bits - 2) + BETWEEN).astype(np.uint64)
        key |= _spread(grid, dimension) << np.uint64(axis)
    return np.argsort(key, kind="stable")


def _spread(grid: np.ndarray, dimension: int) -> np.ndarray:
    """Moves bit k of each number to place k times `dimension`: blocks of bits are halved until each holds one."""
    for half in (16, 8, 4, 2, 1):
        bits = sum((2**half - 1) << place for place in range(0, 64, half * dimension)) % 2**64
        grid = (grid | grid << np.uint64(half * (dimension - 1))) & np.uint64(bits)
    return grid


def _among(wanted: np.ndarray, ids: np.ndarray, nodes: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Finds the `wanted` points that are among the `ids`: their places in `wanted`, and their nodes."""
    node = np.full(n, -1, dtype=np.int64)
    node[ids] = nodes
    place = np.flatnonzero(node[wanted] >= 0)
    return place, node[wanted[place]]


def _inwards(
    order: np.ndarray, near: np.ndarray, nodes: np.ndarray, points: np.ndarray, surface: np.ndarray
) -> np.ndarray:
    """Moves the points `near` walls to the end of an order: one node's after the other's, and each node's from afar to the wall.

    A search begins in the simplex of the point before. Along a wall it passes through all flat simplices in between: from the
    outside it takes half as long.
    """
    height = np.linalg.norm(points[near] - surface[nodes], axis=1)
    rank = np.empty(len(surface), dtype=np.int64)
    rank[morton_order(surface)] = np.arange(len(surface))
    far = np.ones(len(order), dtype=bool)
    far[near] = False
    return np.concatenate([order[far[order]], near[np.lexsort((-height, rank[nodes]))]])


def _without_coincident(unit: np.ndarray, closest: float) -> np.ndarray:
    """Lists the ids of distinct nodes in canonical order. Of coincident ones it keeps the first, which is the moving one."""
    groups = KDTree(unit).query_pairs(closest, output_type="ndarray")
    keep = np.ones(len(unit), dtype=bool)
    keep[groups.max(axis=1) if len(groups) else []] = False
    rows = np.flatnonzero(keep)
    return rows[canonical_order(unit[rows])]


def _snapped(nodes: np.ndarray) -> np.ndarray:
    """Rounds coordinates to about `SNAP` of the distance of the nearest node.

    Qhull then gets the same bits whatever the last one of the mesh is. Jitter alone separates nodes on one sphere by no more
    than Qhull's own round-off.
    """
    step = 2 ** np.floor(np.log2(SNAP * spacing(nodes)) + BETWEEN)[:, None]
    return np.floor(nodes / step + BETWEEN) * step


def _jittered(nodes: np.ndarray, phase: int) -> np.ndarray:
    """Moves each node by `JITTER` of the distance of its nearest one, by a function of place alone.

    The function is a sine of very short wave length. Unlike random numbers it gives the same perturbation for the same mesh
    in any order, unit or place.
    """
    dimension = nodes.shape[1]
    waves = 1e6 * np.sqrt(np.array([[2.0, 3.0, 5.0], [7.0, 11.0, 13.0], [17.0, 19.0, 23.0]]))[:dimension, :dimension]
    angle = sum(
        column[:, None] * wave for column, wave in zip(nodes.T, waves, strict=True)
    )  # the same bits on every processor
    return nodes + JITTER * spacing(nodes)[:, None] * np.sin(angle + np.arange(dimension) + phase)


def _repair(
    graph: Delaunay, nodes: np.ndarray, points: np.ndarray, simplex: np.ndarray, flat: float
) -> tuple[np.ndarray, np.ndarray]:
    """Finds better simplices for points that the search missed: their ids, and the smallest weight in each."""
    # A point is inside of a simplex if its smallest weight is not negative, so the best simplex has the largest one. First
    # each point moves a little towards the middle, out of the flat simplices that line a plane side of the hull, and is
    # searched again. Then each point without a good simplex walks from simplex to neighbour as long as its weight grows.
    simplex = np.maximum(simplex, 0)
    best = smallest_weight(nodes, graph.simplices, simplex, points, flat)
    middle = nodes.mean(axis=0)
    for step in (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        left = np.flatnonzero(~(best >= -TOLERANCE))
        if not left.size:
            return simplex, best
        candidate = graph.find_simplex(points[left] + step * (middle - points[left]))
        weight = smallest_weight(nodes, graph.simplices, candidate, points[left], flat)
        better = weight > best[left]
        simplex[left[better]], best[left[better]] = candidate[better], weight[better]
    active = np.flatnonzero(~(best >= -TOLERANCE))
    for _ in range(32):
        if not active.size:
            break
        around = graph.neighbors[simplex[active]]
        rings = np.concatenate([around, graph.neighbors[around].reshape(len(active), -1)], axis=1)
        repeated = np.repeat(points[active], rings.shape[1], axis=0)
        weight = smallest_weight(nodes, graph.simplices, rings.ravel(), repeated, flat).reshape(rings.shape)
        pick = weight.argmax(axis=1)
        value = weight[np.arange(len(active)), pick]
        better = value > best[active]
        simplex[active[better]] = rings[np.flatnonzero(better), pick[better]]
        best[active[better]] = value[better]
        active = active[better & (value < -1e-12)]
    return simplex, best


def _search(
    graph: Delaunay, nodes: np.ndarray, points: np.ndarray, simplex: np.ndarray, flat: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tries all simplices for each of a few points: the best one, and how far the point lies beyond its sides.

    Between the flat simplices that nodes in one plane give, the walk from neighbour to neighbour of `_repair` may end early.
    """
    heights = smallest_height(nodes[graph.simplices])
    sound = np.flatnonzero(heights > flat)
    corners = nodes[graph.simplices[sound]]
    low, high = corners.min(axis=1) - 2 * JITTER - flat, corners.max(axis=1) + 2 * JITTER + flat
    simplex, beyond = simplex.copy(), np.full(len(points), np.inf)
    for i, point in enumerate(points):
        near = sound[((point >= low) & (point <= high)).all(axis=1)]
        near = near if near.size else sound
        weight = smallest_weight(nodes, graph.simplices, near, np.broadcast_to(point, (len(near), len(point))), flat)
        best = weight.argmax()
        simplex[i], beyond[i] = near[best], -weight[best] * heights[near[best]]
    return simplex, beyond


def _beyond_hull(graph: Delaunay, nodes: np.ndarray, targets: np.ndarray, flat: float) -> np.ndarray:
    """Measures how far each point surely lies beyond the plane of one of the hull's facets: 0 or less inside.

    A small facet says little about a distant point: the jitter and round-off may have turned it.
    """
    corners = nodes[graph.convex_hull]
    height = smallest_height(corners)
    corners, height = corners[height > flat], height[height > flat]
    outward, anchors = normals(corners), corners[:, 0]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    outward *= np.sign(np.einsum("fd,fd->f", outward, anchors - nodes.mean(axis=0)))[:, None]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    offsets = np.einsum("fd,fd->f", outward, anchors) + 4 * (JITTER * longest + flat) * np.maximum(1, 1 / height)
    parts = np.array_split(targets, 1 + len(targets) // 512)
    return np.concatenate([(part @ outward.T - offsets).max(axis=1) for part in parts])


def _check_inside(points: np.ndarray, ids: np.ndarray, beyond: np.ndarray) -> None:
    """Raises `MeshError` for points outside of the hull; points on it, within round-off, pass."""
    outside = beyond > 0
    if outside.any():
        worst_first = ids[outside][np.argsort(-beyond[outside], kind="stable")]
        place = ", ".join(f"{x:.6g}" for x in points[worst_first[0]])
        raise MeshError(
            f"{outside.sum()} of {len(points)} points lie outside of the convex hull of the moving and fixed nodes; the worst is "
            f"node {{node}} at ({place}), {beyond.max():.3g} beyond it. Add the boundary that was left out (outlet, "
            "inlet, far field, channel wall) as fixed nodes.",
            worst_first,
        )
