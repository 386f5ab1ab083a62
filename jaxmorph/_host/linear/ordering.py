"""Orders for sparse approximate inverses: points from far to close, with near predecessors."""

import numpy as np

from ..package.orders import canonical_order
from ..package.trees import Tree
from ..sources.farthest import farthest


def far_to_near(points: np.ndarray, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Orders points (n, d) so that each is far from its predecessors, and finds near predecessors.

    Returns ids (n,), and places in their order (n - first, count). A row begins with the point's
    own place. The nearest earlier places follow; its own place fills up the row. The result depends
    on the set of points, not on their order.
    """
    canonical = canonical_order(points)
    order = canonical[farthest(points[canonical], len(points), 0.0)]
    points, n = points[order], len(points)
    earlier = np.repeat(np.arange(min(first, n), n, dtype=np.int32)[:, None], count, axis=1)
    start = first
    while start < n:
        end = min(n, start + start // 4 + 1)  # one tree for a quarter more points: most it gives are earlier
        earlier[start - first : end - first, 1:] = _before(points[:end], start, count - 1)
        start = end
    return order, earlier


def _before(points: np.ndarray, start: int, count: int) -> np.ndarray:
    """Finds, for the points from `start` on, `count` near earlier places.

    A point's own place fills up its row. The places are the nearest, unless most neighbours of a
    point are later ones. Then some places between `start` and the point may be missed.
    """
    place = np.arange(start, len(points))[:, None]
    distance, nearest = _query(points, points[start:], min(len(points), 2 * count + 2))
    distance = np.where(nearest < place, distance, np.inf)
    short = np.flatnonzero((distance < np.inf).sum(axis=1) < count)
    best, chosen = _smallest(distance, nearest, count)
    if short.size:
        distances = np.where(nearest[short] >= start, distance[short], np.inf)
        more, older = _query(points[:start], points[start + short], min(start, count))
        candidates = np.concatenate([distances, more], axis=1), np.concatenate([nearest[short], older], axis=1)
        best[short], chosen[short] = _smallest(*candidates, count)
    return np.where(best < np.inf, chosen, place)


def _query(points: np.ndarray, at: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    distance, nearest = Tree(points).query(at, k=count)
    return np.asarray(distance).reshape(len(at), count), np.asarray(nearest).reshape(len(at), count)


def _smallest(distance: np.ndarray, ids: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Selects each row's `count` nearest ids, nearest first; infinite distances fill up a row."""
    columns = np.argsort(distance, axis=1, kind="stable")[:, :count]
    missing = ((0, 0), (0, count - columns.shape[1]))
    best = np.pad(np.take_along_axis(distance, columns, axis=1), missing, constant_values=np.inf)
    return best, np.pad(np.take_along_axis(ids, columns, axis=1), missing)
