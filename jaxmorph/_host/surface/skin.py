"""The skin of the moving walls: the edges between its nodes, and the size of the bodies."""

from collections.abc import Mapping

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..package.orders import canonical_order, morton_order
from ..package.rounding import SAME, distinct, first_largest, nearest_few, nearest_of, ranked, roundoff
from ..package.trees import Tree
from ..sources.farthest import farthest
from .walls import outward

FacesByType = Mapping[str, np.ndarray] | None

RINGS, BEYOND = (40, 80), 1.1
"""Radii of rings at which a body's field comes to rest.

They are relative to the distance of the body's ends from its middle. A far field has rings if it is
`BEYOND` times as far away as the last ring.
"""

SIDES = 64
"""Largest sides of the surface's hull on which free nodes are searched."""

APART = {2: 0.6, 3: 0.8}
"""Distance of the points of a ring, relative to its radius: about 8 on a circle."""


def edges(points: np.ndarray, moving: int, faces: FacesByType = None) -> np.ndarray:
    """Lists pairs (e, 2) of neighbouring rows among the first `moving` surface rows, each once.

    Pairs are the sides of the `faces`; without faces, neighbours by distance. Pairs that coincide
    are left out.
    """
    pairs = _sides(faces, moving)
    if not len(pairs):
        pairs = _neighbours(points[:moving])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    length = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1)
    return pairs[length > roundoff(points)]


def _sides(faces: FacesByType, moving: int) -> np.ndarray:
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for corners in (faces or {}).values():
        inside = corners[(corners < moving).all(axis=1)]
        sides = 1 if corners.shape[1] == 2 else corners.shape[1]
        pairs += [np.stack([inside[:, k], inside[:, (k + 1) % corners.shape[1]]], axis=1) for k in range(sides)]
    return np.concatenate(pairs)


def _neighbours(points: np.ndarray) -> np.ndarray:
    """Pairs a node with its nearest and the nearest behind it (2-D), or its six nearest (3-D)."""
    first = distinct(points)[0]
    unique = points[first]
    count = min(6, len(unique) - 1)
    if count < 1:
        return np.zeros((0, 2), dtype=np.int64)
    nearest = nearest_few(unique, unique, count + 1)[:, 1:]
    start = np.arange(len(unique))
    if points.shape[1] == 3:
        return first[np.stack([np.repeat(start, count), nearest.ravel()], axis=1)]
    arm = unique[nearest] - unique[:, None]
    behind = np.einsum("kcd,kd->kc", arm, arm[:, 0]) < -SAME * (arm[:, :1] ** 2).sum(axis=2)
    other = np.where(behind.any(axis=1), nearest[start, behind.argmax(axis=1)], nearest[:, 0])
    return first[np.concatenate([np.stack([start, end], axis=1) for end in (nearest[:, 0], other)])]


def thinned(places: np.ndarray, most: int) -> np.ndarray:
    """Picks the ids of at most `most` places, spread like all places."""
    if len(places) <= most:
        return np.arange(len(places))
    canonical = canonical_order(places)
    order = canonical[morton_order(places[canonical])]
    return np.sort(order[np.linspace(0, len(order) - 1, most).astype(np.int64)])


def chords(points: np.ndarray, wall: np.ndarray, faces: FacesByType = None) -> tuple[np.ndarray, np.ndarray]:
    """Finds two distant nodes of every wall (w, 2), and measures its mean chord (w,).

    In 2-D the mean chord is half of the wall's length. In 3-D it is half of the wall's area over
    the distance of the two nodes: a wing's chord, and about the diameter of a sphere or a fuselage.
    """
    count = int(wall.max(initial=-1)) + 1
    size, ends = np.zeros(count), np.zeros((count, 2), dtype=np.int32)
    np.add.at(size, wall, _shares(points, faces))
    order = canonical_order(points)
    by_wall = order[np.argsort(wall[order], kind="stable")]
    for label, members in enumerate(np.split(by_wall, np.cumsum(np.bincount(wall, minlength=count))[:-1])):
        if len(members):
            first = members[first_largest(((points[members] - points[members].mean(axis=0)) ** 2).sum(axis=1))]
            ends[label] = first, members[first_largest(((points[members] - points[first]) ** 2).sum(axis=1))]
    span = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    safe = np.where(span > 0, span, 1)
    return ends, size / (2 * safe ** (points.shape[1] - 1))


def thicknesses(points: np.ndarray, wall: np.ndarray, faces: FacesByType, ends: np.ndarray) -> np.ndarray:
    """Measures relative thickness (w,) of walls in 2-D: 2 area / length, over the `ends`' distance.

    It is infinite for a wall that is not closed, and without faces.
    """
    count = len(ends)
    area, length, gap = np.zeros(count), np.zeros(count), np.zeros((count, 2))
    lines = (faces or {}).get("line", np.zeros((0, 2), dtype=np.int64))
    start, along = points[lines[:, 0]], points[lines[:, 1]] - points[lines[:, 0]]
    for total, part in (
        (area, (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / 2),
        (length, np.linalg.norm(along, axis=1)),
        (gap, along),
    ):
        np.add.at(total, wall[lines[:, 0]], part)
    is_closed = (length > 0) & (np.linalg.norm(gap, axis=1) <= 1e-6 * length)
    span = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    safe = np.where(is_closed & (span > 0), length * span / 2, 1)
    return np.where(is_closed, np.abs(area) / safe, np.inf)


def _shares(points: np.ndarray, faces: FacesByType) -> np.ndarray:
    """Measures the length (2-D) or area (3-D) of the surface around every node (b,).

    It is exact with faces, and an estimate from the distances of neighbours without faces.
    """
    share = np.zeros(len(points))
    for corners in (faces or {}).values():
        for column in corners.T:
            np.add.at(share, column, np.linalg.norm(outward(points[corners]), axis=1) / corners.shape[1])
    left = np.flatnonzero(share == 0)
    count = min(2 if points.shape[1] == 2 else 6, len(points) - 1)
    if not left.size or count < 1:
        return share
    distance = np.asarray(Tree(points).query(points[left], k=count + 1)[0])[:, 1:]
    share[left] = distance.mean(axis=1) if points.shape[1] == 2 else np.pi * distance[:, -1] ** 2 / (count + 0.5)
    return share


def nearest_held(points: np.ndarray, moving: int, wall: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Finds each edge's (e,) nearest row fixed or on another wall; else the edge's first row."""
    middle = points[pairs].mean(axis=1)
    nearest = pairs[:, 0].copy()
    label_of_edge = wall[pairs[:, 0]]
    for label in np.unique(label_of_edge):
        here = np.flatnonzero(label_of_edge == label)
        others = np.flatnonzero((wall != label) | (np.arange(len(wall)) >= moving))
        if others.size:
            nearest[here] = nearest_of(middle[here], points[others], others)
    return nearest


def drawn_in(surface: np.ndarray, moving: np.ndarray, fixed: np.ndarray, images: np.ndarray) -> tuple:
    """Finds distant fixed sources, and shares of the way to them where the field comes to rest.

    The way begins at the middle of the moving sources. Few directions, with their mirror images,
    are enough.
    """
    centre = surface[moving].mean(axis=0)
    rings = np.array(RINGS)[:, None] * np.linalg.norm(surface[moving] - centre, axis=1).max()
    way = np.linalg.norm(surface - centre, axis=1)
    # one moving node has no size, and no rings
    far = fixed[(images[fixed] == fixed) & (way[fixed] > BEYOND * (1 + SAME) * rings.max()) & (rings.max() > 0)]
    if len(far):
        far = far[canonical_order(surface[far])]
        far = far[farthest(surface[far], len(far), 0.0, reach=APART[surface.shape[1]] * way[far])]
    far = fixed[np.isin(images[fixed], far)]
    return np.tile(far, len(rings)), (rings / way[far]).ravel()


def has_free_sides(surface: np.ndarray, is_free: np.ndarray, points: np.ndarray) -> bool:
    """Checks whether a flat side of the surface's hull holds points that are not on the surface.

    `surface` (b, d) has the images in symmetry planes; `is_free` (n,) marks the `points` (n, d)
    that are not on the surface.
    """
    try:
        hull = ConvexHull(surface)
    except QhullError:
        return False
    size = np.linalg.norm(outward(surface[hull.simplices]), axis=1)
    # Facets of one plane have equal rounded equations. Their areas add up to a side's, and only the
    # largest sides are looked at.
    plane = np.unique(np.round(hull.equations, 6), axis=0, return_inverse=True)[1].ravel()
    area = np.bincount(plane, size)
    largest = np.argsort(ranked(-area, SAME * area.max()), kind="stable")[:SIDES]
    slack, free = 1e-8 * float(np.ptp(surface, axis=0).max()), points[is_free]
    for label in largest:
        facets = np.flatnonzero(plane == label)
        *normal, offset = hull.equations[facets[size[facets].argmax()]]
        if (free @ np.array(normal) + offset > -slack).sum() > 1:
            return True
    return False


def has_free_faces(points: np.ndarray, faces: Mapping[str, np.ndarray], is_held: np.ndarray) -> bool:
    """Checks whether boundary faces have corners that are not held (n,).

    Coincident faces, the sides of a cut, do not count.
    """
    free = [corners[~is_held[corners].all(axis=1)] for corners in faces.values()]
    middles = np.concatenate([points[corners].mean(axis=1) for corners in free])
    distance = np.full(len(middles), np.inf)
    if len(middles) > 1:
        distance = np.asarray(Tree(middles).query(middles, k=2)[0])[:, 1]
    return bool((distance > 1e-9 * np.ptp(points, axis=0).max()).any())
