"""The Delaunay graph of a surface, and which of its simplices holds each point (section 2.3 of the paper, steps 1 and 2).

Real surfaces are full of cospherical and coplanar nodes, which qhull turns into simplices without volume. The coordinates
that qhull sees are therefore moved by 1e-8 of the local spacing, by a fixed function of place; everything that is computed
from the answer uses the true coordinates, and every weight is checked against them.
"""

import dataclasses

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from .reduction import canonical_order, roundoff

JITTER = 1e-8
"""Relative to the distance of the nearest node: at 1e-9 location is five times slower, at 1e-7 weights go wrong."""

TOLERANCE = 1e-6
"""A point whose smallest weight is below minus this is looked at again."""


@dataclasses.dataclass(frozen=True)
class Location:
    """Where points lie in the graph: `vertices` (w, d + 1) ids of surface nodes, and how many answers were repaired."""

    vertices: np.ndarray
    repaired: int


def locate(surface: np.ndarray, points: np.ndarray, wanted: np.ndarray) -> Location:
    """Ids of the surface nodes whose simplex holds each of the `wanted` points.

    `surface` is (b, d), `points` (n, d), `wanted` (w,) ids among them. Raises `ValueError` for points outside of the surface's convex hull, with their
    count, the worst one and its distance, and for a surface without extent in some direction.
    """
    dimension = surface.shape[1]
    centre, size = surface.min(axis=0), np.ptp(surface, axis=0).max() or 1.0
    unit, targets = (surface - centre) / size, (points[wanted] - centre) / size
    unique = _without_coincident(unit, roundoff(surface) / size)
    nodes = unit[unique]
    if len(nodes) <= dimension:
        raise ValueError(
            f"a Delaunay graph in {dimension}-D needs {dimension + 1} distinct surface nodes, got {len(nodes)}."
        )
    try:
        graph = Delaunay(_jittered(nodes))
    except QhullError:
        raise ValueError(
            f"the {len(nodes)} surface nodes lie in one {'line' if dimension == 2 else 'plane'}, so no Delaunay graph spans the "
            "mesh. Add the other boundaries (far field, walls) as fixed nodes."
        ) from None
    order = morton_order(targets)
    simplex = np.empty(len(targets), dtype=np.int64)
    simplex[order] = graph.find_simplex(targets[order])
    smallest = np.full(len(targets), -np.inf)
    held = np.flatnonzero(simplex >= 0)
    smallest[held] = smallest_weight(nodes, graph.simplices[simplex[held]], targets[held])
    poor = np.flatnonzero(~(smallest >= -TOLERANCE))
    if poor.size:
        simplex[poor], smallest[poor] = _repair(graph, nodes, targets[poor], simplex[poor])
        still = poor[~(smallest[poor] >= -TOLERANCE)]
        beyond = _beyond_hull(graph, nodes, targets[still])
        _check_inside(points, wanted[still], beyond * size, roundoff(surface) + 1e-9 * size)
    return Location(unique[graph.simplices[simplex]].astype(np.int32), len(poor))


def smallest_weight(nodes: np.ndarray, simplices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The smallest barycentric coordinate of each point in its simplex; -inf where the simplex has no volume."""
    corners = nodes[simplices]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
    volume = np.linalg.det(edges)
    scale = np.prod(np.linalg.norm(edges, axis=1), axis=1)
    sound = np.abs(volume) > 1e-12 * scale
    edges[~sound] = np.eye(nodes.shape[1])
    inner = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
    return np.where(sound, np.minimum(inner.min(axis=1), 1 - inner.sum(axis=1)), -np.inf)


def morton_order(points: np.ndarray) -> np.ndarray:
    """A permutation that sorts points along Morton's curve: neighbours in it are neighbours in space."""
    dimension = points.shape[1]
    bits = 62 // dimension if dimension == 2 else 20
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max() or 1.0
    grid = ((points - low) / extent * (2**bits - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for axis in range(dimension):
        key |= _spread(grid[:, axis], dimension) << np.uint64(axis)
    return np.argsort(key, kind="stable")


def _spread(x: np.ndarray, dimension: int) -> np.ndarray:
    """Puts dimension - 1 zero bits between the bits of x."""
    steps = (
        [
            (16, 0x0000FFFF0000FFFF),
            (8, 0x00FF00FF00FF00FF),
            (4, 0x0F0F0F0F0F0F0F0F),
            (2, 0x3333333333333333),
            (1, 0x5555555555555555),
        ]
        if dimension == 2
        else [
            (32, 0x001F00000000FFFF),
            (16, 0x001F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ]
    )
    for shift, mask in steps:
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


def _without_coincident(unit: np.ndarray, closest: float) -> np.ndarray:
    """Ids of distinct nodes in canonical order; of coincident ones the first, which is the moving one."""
    groups = cKDTree(unit).query_pairs(closest, output_type="ndarray")
    keep = np.ones(len(unit), dtype=bool)
    keep[groups.max(axis=1) if len(groups) else []] = False
    kept = np.flatnonzero(keep)
    return kept[canonical_order(unit[kept])]


def _jittered(nodes: np.ndarray) -> np.ndarray:
    """Nodes moved by `JITTER` of the distance of their nearest one, by a function of place alone.

    A sine of very short wave length: unlike random numbers it gives the same perturbation for the same mesh in any order,
    unit or place.
    """
    spacing = cKDTree(nodes).query(nodes, k=2)[0][:, 1]
    dimension = nodes.shape[1]
    waves = 1e6 * np.sqrt(np.array([[2.0, 3.0, 5.0], [7.0, 11.0, 13.0], [17.0, 19.0, 23.0]]))[:dimension, :dimension]
    return nodes + JITTER * spacing[:, None] * np.sin(nodes @ waves + np.arange(dimension))


def _repair(
    graph: Delaunay, nodes: np.ndarray, points: np.ndarray, simplex: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The best simplex for points that the search missed: of several the one with the largest smallest weight."""
    lost = np.flatnonzero(simplex < 0)
    simplex = simplex.copy()
    if lost.size:
        simplex[lost] = _from_inside(graph, nodes, points[lost])
    best = smallest_weight(nodes, graph.simplices[simplex], points)
    best_simplex = simplex.copy()
    active = np.arange(len(points))
    for _ in range(32):  # breadth first over the neighbours, keeping the best simplex met
        around = graph.neighbors[best_simplex[active]]
        rings = np.concatenate([around, graph.neighbors[around].reshape(len(active), -1)], axis=1)
        valid = rings >= 0
        rings = np.where(valid, rings, 0)
        weight = smallest_weight(
            nodes, graph.simplices[rings.ravel()], np.repeat(points[active], rings.shape[1], axis=0)
        )
        weight = np.where(valid, weight.reshape(rings.shape), -np.inf)
        pick = weight.argmax(axis=1)
        value = weight[np.arange(len(active)), pick]
        better = value > best[active]
        best_simplex[active[better]] = rings[np.flatnonzero(better), pick[better]]
        best[active[better]] = value[better]
        active = active[better & (value < -1e-12)]
        if not active.size:
            break
    return best_simplex, best


def _from_inside(graph: Delaunay, nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A simplex near each point that lies on the hull or outside of it: move it inwards until one is found."""
    middle = nodes.mean(axis=0)
    found = np.full(len(points), -1)
    for step in (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1):
        left = np.flatnonzero(found < 0)
        if not left.size:
            break
        found[left] = graph.find_simplex(points[left] + step * (middle - points[left]))
    left = np.flatnonzero(found < 0)
    if left.size:
        centres = nodes[graph.simplices].mean(axis=1)
        found[left] = cKDTree(centres).query(points[left])[1]
    return found


def _beyond_hull(graph: Delaunay, nodes: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """How far each point lies beyond the planes of the hull's facets, negative inside."""
    corners = nodes[graph.convex_hull]
    edges = corners[:, 1:] - corners[:, :1]
    if nodes.shape[1] == 2:
        normals = np.stack([edges[:, 0, 1], -edges[:, 0, 0]], axis=1)
    else:
        normals = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normals, axis=1)
    sound = length > 1e-12 * np.prod(np.linalg.norm(edges, axis=2), axis=1)
    normals, anchors = normals[sound] / length[sound, None], corners[sound, 0]
    normals *= np.sign(np.einsum("fd,fd->f", normals, anchors - nodes.mean(axis=0)))[:, None]
    offsets = np.einsum("fd,fd->f", normals, anchors)
    parts = np.array_split(targets, 1 + len(targets) // 512)
    return np.concatenate([(part @ normals.T - offsets).max(axis=1) for part in parts])


def _check_inside(points: np.ndarray, ids: np.ndarray, beyond: np.ndarray, allowed: float) -> None:
    """Raises for points truly outside of the hull; those on it within round-off pass."""
    outside = beyond > allowed
    if outside.any():
        worst = ids[np.argmax(beyond)]
        place = ", ".join(f"{x:.6g}" for x in points[worst])
        raise ValueError(
            f"{outside.sum()} of {len(points)} points lie outside of the convex hull of the moving and fixed nodes; the worst is "
            f"node {worst} at ({place}), {beyond.max():.3g} beyond it. Add the boundary that was left out (outlet, "
            "inlet, far field, channel wall) as fixed nodes."
        )
