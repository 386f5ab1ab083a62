"""Distances of nodes from faces: gaps between walls, and the closest places of a surface."""

import numpy as np
from scipy import spatial

from ..package.rounding import Tree
from .neighbours import nearest_boxes_first, searched_together

CLOSEST = 12  # faces of other walls, of nearest middles, to which a node's distance is measured


def share_left(
    before: np.ndarray, after: np.ndarray, wall: np.ndarray, faces: np.ndarray, touching: float
) -> np.ndarray:
    """Share (b,) of the gap at every row that a motion leaves; infinite without a gap. The gap
    before is the smaller of those at the row and at the corners of the face that is nearest
    afterwards: sliding walls keep their gap. Distances up to `touching` count as no gap.
    """
    first, second = gaps(before, wall, faces)[0], gaps(after, wall, faces)
    narrowest = np.minimum(first, first[second[1]].min(axis=1))
    known = np.isfinite(second[0]) & (narrowest > touching)
    return np.where(known, second[0] / np.where(known, narrowest, 1), np.inf)


def gaps(points: np.ndarray, wall: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each point's distance (b,) from other walls, else infinite, and the face (b, d) there. `wall`
    (b,) numbers the walls; `faces` are rows of `points`, segments (f, 2) or triangles (f, 3). A
    face between two walls does not count.
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
            distances = np.stack([_places(points[faces[column]], points[here])[1] for column in near.T], axis=1)
            closest, row = distances.argmin(axis=1), np.arange(len(here))
            distance[here], nearest[here] = distances[row, closest], faces[near[row, closest]]
    return distance, nearest


def _closest(points: np.ndarray, trees: list[tuple[np.ndarray, Tree]]) -> np.ndarray:
    """Faces (k, c) with middles nearest to points (k, d), by trees with their face rows."""
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


def distance_from_segment(x: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distances (k,) of points (k, d) from a segment."""
    return _places(np.broadcast_to(np.stack([start, end]), (len(x), 2, x.shape[1])), x)[1]


BLOCK = 1 << 12

NEAR = 8  # nearest simplices that bound the distance to all others


def fans(ids: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Cuts polygons, of `counts` corners in `ids`, into triangles (t, 3) about first corners."""
    first = np.cumsum(counts) - counts
    owner = np.repeat(np.arange(len(counts)), counts - 2)
    turn = 1 + np.arange(len(owner)) - np.repeat(np.cumsum(counts - 2) - counts + 2, counts - 2)
    return np.stack([ids[first[owner]], ids[first[owner] + turn], ids[first[owner] + turn + 1]], axis=1)


def closest(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds the first simplex (m,) of `corners` (t, c, d) that is closest to each of `x` (m, d).
    Returns its number, the weights (m, c) of its corners at its closest place, and the distance.
    """
    # Simplices of one size are searched together: one ball around a point holds all that can be
    # closest, and a few long ones do not make candidates of all.
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    level = np.floor(np.log2(np.maximum(radius, max(radius.max() * 1e-9, np.finfo(float).tiny))))
    groups = [np.flatnonzero(level == value) for value in np.unique(level)]
    trees = [(group, spatial.KDTree(centre[group]), radius[group].max()) for group in groups]
    chosen, weights, distance = np.zeros(len(x), int), np.zeros((len(x), corners.shape[1])), np.zeros(len(x))
    for at in range(0, len(x), BLOCK):
        block = slice(at, at + BLOCK)
        rows, simplices = _candidates(trees, corners, x[block])
        share, away = _places(corners[simplices], x[block][rows])
        order = np.lexsort((simplices, away, rows))
        best = order[np.unique(rows[order], return_index=True)[1]]
        chosen[block], weights[block], distance[block] = simplices[best], share[best], away[best]
    return chosen, weights, distance


def _candidates(trees: list, corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bound = np.full(len(x), np.inf)
    for group, tree, _ in trees:
        count = min(NEAR, len(group))
        near = group[np.asarray(tree.query(x, k=count)[1]).reshape(len(x), count)]
        rows = np.repeat(np.arange(len(x)), count)
        distance = _places(corners[near.ravel()], x[rows])[1].reshape(len(x), count)
        bound = np.minimum(bound, distance.min(axis=1))
    rows, simplices = [], []
    for group, tree, radius in trees:
        balls = tree.query_ball_point(x, (bound + radius) * (1 + 1e-9))
        rows.append(np.repeat(np.arange(len(x)), [len(ball) for ball in balls]))
        simplices.append(group[np.concatenate([np.zeros(0, np.int64), *map(np.asarray, balls)]).astype(np.int64)])
    return np.concatenate(rows), np.concatenate(simplices)


def _places(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, c) of corners (m, c, d) at places closest to `x`, and distances."""
    if corners.shape[1] == 2:
        weights = _on_segment(corners[:, 0], corners[:, 1], x)
        return weights, np.linalg.norm(np.einsum("mc,mcd->md", weights, corners) - x, axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    choices = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        weights = np.zeros((len(x), 3))
        weights[:, [i, j]] = _on_segment(corners[:, i], corners[:, j], x)
        choices.append(weights)
    u, v, w = b - a, c - a, x - a
    uu, uv, vv, wu, wv = (np.einsum("md,md->m", p, q) for p, q in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = uu * vv - uv**2
    size = np.where(area > 0, area, 1)
    s, t = (vv * wu - uv * wv) / size, (uu * wv - uv * wu) / size
    inside = (area > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    choices.append(np.where(inside[:, None], np.stack([1 - s - t, s, t], axis=1), choices[0]))
    stacked = np.stack(choices)
    distance = np.linalg.norm(np.einsum("emc,mcd->emd", stacked, corners) - x, axis=2)
    best = distance.argmin(axis=0), np.arange(len(x))
    return stacked[best], distance[best]


def _on_segment(a: np.ndarray, b: np.ndarray, x: np.ndarray) -> np.ndarray:
    along = b - a
    length = np.einsum("md,md->m", along, along)
    t = np.einsum("md,md->m", x - a, along) / np.where(length > 0, length, 1)
    t = np.clip(t, 0, 1)
    return np.stack([1 - t, t], axis=1)
