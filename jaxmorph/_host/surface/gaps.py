"""Gaps between walls: distances of nodes from the nearest faces of other walls."""

import numpy as np

from ..package.trees import Tree
from .neighbours import nearest_boxes_first, searched_together

CLOSEST = 12
"""Faces of other walls to which a node's distance is measured: the faces of nearest middles."""


def share_left(
    before: np.ndarray, after: np.ndarray, wall: np.ndarray, faces: np.ndarray, touching: float
) -> np.ndarray:
    """Measures the share (b,) of the gap at every row that a motion leaves; infinite without a gap.

    The gap before is the smaller of two: at the row, and at the corners of the face that is nearest
    afterwards. So walls that slide along each other keep their gap. Distances up to `touching`
    count as no gap.
    """
    first, second = gaps(before, wall, faces)[0], gaps(after, wall, faces)
    narrowest = np.minimum(first, first[second[1]].min(axis=1))
    known = np.isfinite(second[0]) & (narrowest > touching)
    return np.where(known, second[0] / np.where(known, narrowest, 1), np.inf)


def gaps(points: np.ndarray, wall: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds the nearest face (b, d) of another wall for each of `points`, and its distance (b,).

    The distance is infinite without other walls. `wall` (b,) numbers the walls; `faces` are rows of
    `points`, segments (f, 2) in 2-D and triangles (f, 3) in 3-D. A face between two walls does not
    count.
    """
    labels = wall[faces]
    whole = (labels == labels[:, :1]).all(axis=1)
    faces, labels = faces[whole], labels[whole, 0]
    distance, nearest = np.full(len(points), np.inf), np.zeros((len(points), faces.shape[1]), dtype=np.int64)
    middles = points[faces].mean(axis=1)
    trees = [(rows, Tree(middles[rows])) for rows in searched_together(labels, np.arange(len(faces)))]
    for label in np.unique(wall):
        here, others = np.flatnonzero(wall == label), np.flatnonzero(labels != label)
        if len(others):
            of_others = [(rows, tree) for rows, tree in trees if labels[rows[0]] != label] if len(trees) > 1 else []
            near = _closest(points[here], of_others or [(others, Tree(middles[others]))])
            distances = np.stack([_distance(points[here], points[faces[column]]) for column in near.T], axis=1)
            closest, row = distances.argmin(axis=1), np.arange(len(here))
            distance[here], nearest[here] = distances[row, closest], faces[near[row, closest]]
    return distance, nearest


def _closest(points: np.ndarray, trees: list[tuple[np.ndarray, Tree]]) -> np.ndarray:
    """Finds faces (k, c) with middles nearest to points (k, d), by trees with their face rows."""
    count = min(CLOSEST, sum(len(rows) for rows, _ in trees))
    distance, near = np.full((len(points), count), np.inf), np.zeros((len(points), count), dtype=np.int64)
    for k, wanted in nearest_boxes_first(points, [tree for _, tree in trees], distance[:, -1]):
        if not len(wanted):
            continue
        rows, tree = trees[k]
        found, row = tree.query(points[wanted], k=range(1, min(count, len(rows)) + 1))
        distances = np.concatenate([distance[wanted], found], axis=1)
        order = np.argsort(distances, axis=1, kind="stable")[:, :count]
        faces = np.concatenate([near[wanted], rows[row]], axis=1)
        distance[wanted] = np.take_along_axis(distances, order, axis=1)
        near[wanted] = np.take_along_axis(faces, order, axis=1)
    return near


def _distance(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Measures distances (k,) of points (k, d) from their segments or triangles (k, d, d)."""
    count = corners.shape[1]
    sides = [(corners[:, k], corners[:, (k + 1) % count]) for k in range(count if count > 2 else 1)]
    nearest = np.min([distance_from_segment(x, *side) for side in sides], axis=0)
    if count == 2:
        return nearest
    first, one, other = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    size = np.maximum(np.einsum("kd,kd->k", normal, normal), 1e-300)
    arm = x - first
    u = np.einsum("kd,kd->k", np.cross(arm, other), normal) / size
    v = np.einsum("kd,kd->k", np.cross(one, arm), normal) / size
    above = np.abs(np.einsum("kd,kd->k", arm, normal)) / np.sqrt(size)
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1), above, nearest)


def distance_from_segment(x: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Measures distances (k,) of points (k, d) from segments, one for all or one a point."""
    along = np.broadcast_to(end - start, x.shape)
    squared = np.maximum(np.einsum("kd,kd->k", along, along), 1e-300)
    share = np.clip(np.einsum("kd,kd->k", x - start, along) / squared, 0, 1)
    return np.linalg.norm(x - start - share[:, None] * along, axis=1)
