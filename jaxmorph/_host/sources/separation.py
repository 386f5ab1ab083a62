"""Least distances of sources: which of the points that are too close to each other stay."""

import numpy as np

from ..package.rounding import SAME, roundoff
from ..package.trees import Tree


def least_distance(points: np.ndarray, separation: float) -> float:
    """Computes `separation` times the diagonal of all points, but at least round-off."""
    if len(points) == 0:
        return 0.0
    return max(separation * float(np.linalg.norm(np.ptp(points, axis=0))), roundoff(points))


def drop_close(points: np.ndarray, ids: np.ndarray, closest: float) -> np.ndarray:
    """Drops ids of points within `closest` of an earlier point that stays; the order stays."""
    if len(ids) < 2:
        return ids
    ids = ids[np.sort(np.unique(ids, return_index=True)[1])]
    pairs = Tree(points[ids]).query_pairs(closest * (1 + SAME), output_type="ndarray")
    keep = np.ones(len(ids), dtype=bool)
    for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:  # pairs come as first < second
        if keep[first]:
            keep[second] = False
    return ids[keep]


def drop_near(points: np.ndarray, ids: np.ndarray, others: np.ndarray, closest: float) -> np.ndarray:
    """Drops ids of points within `closest` of one of the `others`; the order stays."""
    if len(ids) == 0 or len(others) == 0:
        return ids
    return ids[Tree(points[others]).query(points[ids])[0] > closest * (1 + SAME)]
