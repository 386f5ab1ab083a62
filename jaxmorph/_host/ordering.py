"""Orders for sparse approximate inverses: points from far apart to close, and for each the nearest of those before it."""

import numpy as np
from scipy.spatial import KDTree

from .farthest import farthest
from .reduction import canonical_order


def far_to_near(points: np.ndarray, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Orders points (n, d) such that each is far from those before it, and finds `count` neighbours of all but the `first` ones.

    Returns ids (n,), and places in that order (n - first, count). A row begins with the point's own place. The nearest of the
    places before it follow; where there are no more, its own stands again. The result depends on the set of points,
    not on their order.
    """
    canonical = canonical_order(points)
    order = canonical[farthest(points[canonical], len(points), 0.0)]
    points, n = points[order], len(points)
    earlier = np.repeat(np.arange(min(first, n), n, dtype=np.int32)[:, None], count, axis=1)
    start = first
    while start < n:
        end = min(
            n, start + start // 4 + 1
        )  # one tree for a quarter more points: most of what it gives stands before them
        candidates = min(end, 2 * count)
        nearest = np.asarray(KDTree(points[:end]).query(points[start:end], k=candidates)[1]).reshape(-1, candidates)
        place = np.arange(start, end)[:, None]
        is_before = nearest < place
        best = np.argsort(~is_before, axis=1, kind="stable")[:, : count - 1]
        chosen = np.where(np.take_along_axis(is_before, best, axis=1), np.take_along_axis(nearest, best, axis=1), place)
        earlier[start - first : end - first, 1 : 1 + chosen.shape[1]] = chosen
        start = end
    return order, earlier
