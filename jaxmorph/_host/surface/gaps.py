"""Distances of nodes from faces: gaps between walls, and the closest places of a surface."""

import itertools

import numpy as np

from ..linear.products import cross_rows
from ..package.rounding import Tree

CLOSEST = 12  # faces of other walls, of nearest middles, to which a node's distance is measured

BLOCK = 1 << 12  # points of a block

NEAR = 8  # nearest simplices that bound the distance to all others


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
    faces = faces[(wall[faces] == wall[faces[:, :1]]).all(axis=1)]
    distance, nearest = np.full(len(points), np.inf), np.zeros((len(points), faces.shape[1]), dtype=np.int64)
    for label in np.unique(wall):
        here, others = np.flatnonzero(wall == label), faces[wall[faces[:, 0]] != label]
        if len(others):
            tree = Tree(points[others].mean(axis=1), leafsize=32, balanced_tree=False, compact_nodes=False)
            near = others[tree.query(points[here], k=range(1, min(CLOSEST, len(others)) + 1))[1]].swapaxes(0, 1)
            away = np.stack([_places(points[candidates], points[here])[1] for candidates in near])
            best = away.argmin(axis=0), np.arange(len(here))
            distance[here], nearest[here] = away[best], near[best]
    return distance, nearest


def fans(ids: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Cuts polygons, of `counts` corners in `ids`, into triangles (t, 3) about first corners."""
    last = np.cumsum(counts) - 1
    first = last - counts + 1
    inner = np.delete(np.arange(len(ids)), np.concatenate([first, last]))
    return ids[np.stack([np.repeat(first, counts - 2), inner, inner + 1], axis=1)]


def closest(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds the first simplex (m,) of `corners` (t, c, d) that is closest to each of `x` (m, d).
    Returns its number, the weights (m, c) of its corners at its closest place, and the distance.
    """
    # Simplices of one size are searched together: one ball around a point holds all that can be
    # closest, and a few long ones do not make candidates of all.
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    size = np.frexp(np.maximum(radius, 1e-9 * radius.max()))[1]
    groups = [np.flatnonzero(size == exponent) for exponent in np.unique(size)]
    trees = [(group, Tree(centre[group]), radius[group].max()) for group in groups]
    blocks = [_closest(trees, corners, x[at : at + BLOCK]) for at in range(0, max(len(x), 1), BLOCK)]
    chosen, weights, distance = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return chosen, weights, distance


def _closest(trees: list, corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    bound, rows, simplices = np.full(len(x), np.inf), [], []
    for group, tree, _ in trees:
        near = group[tree.query(x, k=range(1, min(NEAR, len(group)) + 1))[1]]
        distance = _places(corners[near.ravel()], np.repeat(x, near.shape[1], axis=0))[1]
        bound = np.minimum(bound, distance.reshape(near.shape).min(axis=1))
    for group, tree, radius in trees:
        row, member = tree.within(x, (bound + radius) * (1 + 1e-9))
        rows.append(row)
        simplices.append(group[member])
    row, simplex = np.concatenate(rows), np.concatenate(simplices)
    weights, distance = _places(corners[simplex], x[row])
    order = np.lexsort((simplex, distance, row))
    best = order[np.unique(row[order], return_index=True)[1]]
    return simplex[best], weights[best], distance[best]


def _places(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, c) of corners (m, c, d) at places closest to `x`, and distances."""
    choices = []
    for i, j in itertools.combinations(range(corners.shape[1]), 2):
        along, weights = corners[:, j] - corners[:, i], np.zeros(corners.shape[:2])
        length = np.einsum("md,md->m", along, along)
        share = np.einsum("md,md->m", x - corners[:, i], along) / np.where(length > 0, length, 1)
        weights[:, j] = np.clip(share, 0, 1)
        weights[:, i] = 1 - weights[:, j]
        choices.append(weights)
    if corners.shape[1] == 3:  # the foot of the perpendicular, if it is inside
        a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal, arm = cross_rows(u, v), x - a
        area = np.einsum("md,md->m", normal, normal)
        turned = np.stack([cross_rows(arm, v), cross_rows(u, arm)], axis=1)
        shares = np.einsum("mcd,md->mc", turned, normal) / np.where(area > 0, area, 1)[:, None]
        weights = np.column_stack([1 - shares.sum(axis=1), shares])
        inside = (area > 0) & (weights >= 0).all(axis=1)
        choices.append(np.where(inside[:, None], weights, choices[0]))
    places = np.einsum("emc,mcd->emd", choices, corners)
    distance = np.linalg.norm(places - x, axis=2)
    best = distance.argmin(axis=0), np.arange(len(x))
    return np.stack(choices)[best], distance[best]
