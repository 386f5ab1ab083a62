"""The Delaunay graph of a surface, and the simplex that holds a point (paper, section 2.3).

Of cospherical and coplanar nodes qhull makes simplices without volume. So the coordinates for qhull
are moved by 1e-8 of the local spacing, by a fixed function of place. All that is computed from the
graph uses the true coordinates.
"""

import contextlib
import dataclasses
import functools

import numpy as np
from numpy import ndarray
from scipy.spatial import Delaunay, QhullError

from ..cells.topology import Pair
from ..linear.products import cofactor_rows, normals, row_lengths, smallest_height, unit_rows
from ..package.cores import over_blocks
from ..package.errors import MeshError, place_of, worst_first
from ..package.rounding import BETWEEN, canonical_order, extent_of, morton_order, roundoff, spacing
from ..sources.reduction import drop_close
from ..tolerances import JITTER, OUTSIDE_WEIGHT, SNAP

TRIALS = 4  # most jitters tried: qhull now and then ends with a precision error on good nodes

# SciPy's of qhull, but for a last check of outer planes, which simplices do not use
QHULL_OPTIONS = "Qbb Qc Qz Q12 Q5"
FLAT_HEIGHT = 64  # a simplex lower than this times the round-off of the coordinates holds no point


@dataclasses.dataclass(frozen=True, eq=False)
class Graph:
    """The Delaunay graph of a surface, in which any number of points can be located."""

    centre: ndarray
    size: float
    unique: ndarray  # (k,) ids of the distinct nodes
    nodes: ndarray  # (k, d) their places relative to `centre`, over `size`
    delaunay: Delaunay  # the simplices between the distinct nodes
    flat: float  # the height below which a simplex holds no point
    slack: float  # round-off of the coordinates

    def smallest_weight(self, simplex: ndarray, points: ndarray) -> ndarray:
        """Least barycentric coordinates (k,) of points in simplices; -inf in -1 or flat ones."""
        smallest = np.empty(len(points))

        def weigh(part: slice) -> None:
            corners = self.nodes[self.delaunay.simplices[simplex[part]]]
            inverse = _invert_edges(corners)
            with np.errstate(invalid="ignore"):
                weights = np.einsum("kij,kj->ki", inverse[:, :-1], points[part] - inverse[:, -1])
                least = np.minimum(weights.min(axis=1), 1 - weights.sum(axis=1))
            sound = (simplex[part] >= 0) & (smallest_height(corners) > self.flat)
            smallest[part] = np.where(sound, least, -np.inf)

        over_blocks(weigh, len(points))
        return smallest


def graph_of(surface: ndarray) -> Graph:
    """Builds the Delaunay graph of a surface (b, d). Raises `ValueError` for a flat one."""
    dimension = surface.shape[1]
    slack = roundoff(surface)
    surface = surface.astype(np.float64, copy=False)
    centre = surface.min(axis=0)
    size = extent_of(surface) or 1.0
    unit = (surface - centre) / size
    # of coincident nodes a moving one
    unique = drop_close(unit, np.arange(len(unit)), roundoff(surface) / size)
    unique = unique[canonical_order(unit[unique])]
    nodes = unit[unique]
    if len(nodes) <= dimension:
        raise ValueError(
            f"a Delaunay graph in {dimension}-D needs {dimension + 1} distinct surface nodes, got "
            f"{len(nodes)}."
        )
    flat = FLAT_HEIGHT * roundoff(surface) / size
    return Graph(centre, size, unique, nodes, _triangulate(nodes, flat), flat, slack)


class _Graph(Delaunay):
    """A triangulation with a closed form of the barycentric transforms. SciPy calls LAPACK for
    every simplex, at twenty times the cost. It fails for flat simplices, and then `find_simplex`
    searches through all simplices.
    """

    @functools.cached_property
    def transform(self) -> ndarray:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The inverse of the edges from the last corner, and that corner: (k, d + 1, d)."""
        transform = np.empty((len(self.simplices), self.ndim + 1, self.ndim))

        def invert(part: slice) -> None:
            transform[part] = _invert_edges(self.points[self.simplices[part]])

        over_blocks(invert, len(transform))
        return transform


def _invert_edges(corners: ndarray) -> ndarray:
    edges = list((corners[:, :-1] - corners[:, -1:]).swapaxes(0, 1))
    rows = cofactor_rows(edges)
    volume = np.einsum("kd,kd->k", rows[0], edges[0])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([*(row / volume for row in rows), corners[:, -1]], axis=1)


def _triangulate(nodes: ndarray, flat: float) -> Delaunay:
    # Coordinates are rounded to about `SNAP` of the nearest distance: qhull sees no last bits.
    step = 2 ** np.floor(np.log2(SNAP * spacing(nodes)) + BETWEEN)[:, None]
    graph = None
    snapped = np.floor(nodes / step + BETWEEN) * step
    for phase in range(TRIALS):
        with contextlib.suppress(QhullError):
            graph = _Graph(_jitter(snapped, phase), qhull_options=QHULL_OPTIONS)
            break
    if graph is None or not (smallest_height(nodes[graph.simplices]) > flat).any():
        raise ValueError(
            f"the {len(nodes)} surface nodes lie in one "
            f"{'line' if nodes.shape[1] == 2 else 'plane'}, so no Delaunay graph "
            "spans the mesh. Add the other boundaries (far field, walls) as fixed nodes."
        )
    return graph


def _jitter(nodes: ndarray, phase: int) -> ndarray:
    """Moves nodes by `JITTER` of the distance of their nearest nodes, by a function of place alone.
    Unlike random numbers, a sine of very short wave length does not depend on the order of nodes.
    """
    dimension = nodes.shape[1]
    waves = (
        1e6
        * np.sqrt(np.array([[2.0, 3.0, 5.0], [7.0, 11.0, 13.0], [17.0, 19.0, 23.0]]))[
            :dimension, :dimension
        ]
    )
    # a sum of products has equal bits on every processor, a product of matrices has not
    angle = sum(column[:, None] * wave for column, wave in zip(nodes.T, waves, strict=True))
    return nodes + JITTER * spacing(nodes)[:, None] * np.sin(angle + np.arange(dimension) + phase)


def locate(graph: Graph, points: ndarray, wanted: ndarray) -> ndarray:
    """Finds the ids (w, d + 1) of the surface nodes whose simplex holds each `wanted` point.
    Coordinates in single precision count as exact numbers, except for points on the hull. `points`
    (n, d) are all points, and `wanted` (w,) the ids of those to locate. Raises `MeshError` for
    points outside of the surface's convex hull.
    """
    points = points.astype(np.float64, copy=False)
    targets = (points[wanted] - graph.centre) / graph.size
    order = morton_order(targets)
    simplex = np.empty(len(targets), dtype=np.int64)

    def find(
        part: slice,
    ) -> None:  # parts do not follow the cores: a point on a face may have several answers
        simplex[order[part]] = graph.delaunay.find_simplex(targets[order[part]])

    over_blocks(find, len(targets))
    smallest = graph.smallest_weight(simplex, targets)
    poor = np.flatnonzero(~(smallest >= -OUTSIDE_WEIGHT))
    if poor.size:
        simplex[poor], smallest[poor] = _repair(graph, targets[poor], simplex[poor])
        still = poor[~(smallest[poor] >= -OUTSIDE_WEIGHT)]
        _check_inside(
            points,
            wanted[still],
            _measure_beyond_hull(graph, targets[still]) * graph.size - graph.slack,
        )
        simplex[still], beyond = _search_all(graph, targets[still])
        beyond[beyond <= graph.flat + JITTER] = 0
        _check_inside(points, wanted[still], beyond * graph.size - graph.slack)
    return graph.unique.astype(np.int32)[graph.delaunay.simplices][simplex]


def _repair(graph: Graph, points: ndarray, simplex: ndarray) -> Pair:
    # A point moves a little towards the middle, out of the flat simplices along a plane side of the
    # hull, and is searched again. The best simplex has the largest smallest weight.
    simplex = np.maximum(simplex, 0)
    best = graph.smallest_weight(simplex, points)
    middle = graph.nodes.mean(axis=0)
    for step in (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        left = np.flatnonzero(~(best >= -OUTSIDE_WEIGHT))
        if not left.size:
            break
        candidate = graph.delaunay.find_simplex(points[left] + step * (middle - points[left]))
        weight = graph.smallest_weight(candidate, points[left])
        better = weight > best[left]
        simplex[left[better]] = candidate[better]
        best[left[better]] = weight[better]
    return simplex, best


def _search_all(graph: Graph, points: ndarray) -> Pair:
    heights = smallest_height(graph.nodes[graph.delaunay.simplices])
    sound = np.flatnonzero(heights > graph.flat)
    corners = graph.nodes[graph.delaunay.simplices[sound]]
    margin = 2 * JITTER + graph.flat
    low = corners.min(axis=1) - margin
    high = corners.max(axis=1) + margin
    simplex = np.zeros(len(points), dtype=np.int64)
    beyond = np.zeros(len(points))
    for i, point in enumerate(points):
        near = sound[((point >= low) & (point <= high)).all(axis=1)]
        near = near if near.size else sound
        weight = graph.smallest_weight(near, np.broadcast_to(point, (len(near), len(point))))
        best = weight.argmax()
        simplex[i] = near[best]
        beyond[i] = -weight[best] * heights[near[best]]
    return simplex, beyond


def _measure_beyond_hull(graph: Graph, targets: ndarray) -> ndarray:
    """Measures how far points surely lie beyond the plane of a facet of the hull: 0 or less inside.
    A small facet says little about a distant point: jitter and round-off may have turned it.
    """
    corners = graph.nodes[graph.delaunay.convex_hull]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = row_lengths(normals(corners)) / longest ** (graph.delaunay.ndim - 2)
    corners, longest, height = (
        values[height > graph.flat] for values in (corners, longest, height)
    )
    outward = unit_rows(normals(corners))
    anchors = corners[:, 0]
    outward *= np.sign(np.einsum("fd,fd->f", outward, anchors - graph.nodes.mean(axis=0)))[:, None]
    slack = 4 * (JITTER * longest + graph.flat) * np.maximum(1, 1 / height)
    offsets = np.einsum("fd,fd->f", outward, anchors) + slack
    parts = np.array_split(targets, 1 + len(targets) // 512)
    return np.concatenate([(part @ outward.T - offsets).max(axis=1) for part in parts])


def _check_inside(points: ndarray, ids: ndarray, beyond: ndarray) -> None:
    """Raises `MeshError` for points outside of the hull; points on it, within round-off, pass."""
    outside = ids[worst_first(beyond, 0)]
    if outside.size:
        raise MeshError(
            f"{len(outside)} of {len(points)} points lie outside of the convex hull of the moving "
            "and fixed nodes; the worst is "
            f"node {{node}} at ({place_of(points[outside[0]])}), {beyond.max():.3g} beyond it. "
            "Add the missing boundary "
            "(outlet, inlet, far field, channel wall) as fixed nodes, or take a method without a "
            "graph, such as jm.RBF().",
            outside,
        )
