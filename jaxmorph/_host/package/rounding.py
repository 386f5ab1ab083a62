"""Decisions free of round-off, by which many lengths of a regular mesh differ; orders of points."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from .cores import cores

SAME = 1e-9  # relative difference up to which two numbers count as equal
TIES = 4  # nearest places that are searched first; if all are equally near, more are searched
FEW = 4096  # points of a search up to which threads cost more than they gain


class Tree(KDTree):
    """A k-d tree that is searched with all cores. The answers do not depend on their number."""

    def query(self, x: Any, *arguments: Any, **keywords: Any) -> tuple[Any, Any]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return super().query(x, *arguments, **{"workers": cores() if len(x) > FEW else 1} | keywords)


def roundoff(points: np.ndarray) -> float:
    return 8 * float(np.finfo(points.dtype).eps) * float(np.abs(points).max(initial=0))


def spacing(points: np.ndarray) -> np.ndarray:
    """Each point's distance (n,) from its nearest neighbour; infinite for one point."""
    return np.asarray(Tree(points).query(points, k=2)[0])[:, 1]


def ranked(values: np.ndarray, slack: float) -> np.ndarray:
    """Ranks numbers from 0; one at most `slack` above its predecessor has the same rank."""
    order = np.argsort(values, kind="stable")
    rank = np.zeros(len(values), dtype=np.int64)
    rank[order[1:]] = np.cumsum(np.diff(values[order]) > slack)
    return rank


def distinct(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each place's first point (k,), and each point's place (n,)."""
    slack = roundoff(points)
    rows = np.stack([ranked(column, slack) for column in points.T], axis=1)
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, place.ravel()


def first_largest(values: np.ndarray, slack: float | None = None) -> int:
    """The first number within a slack of the largest; by default `SAME` times the largest."""
    top = values.max()
    return int((values >= top - (SAME * abs(top) if slack is None else slack)).argmax())


def nearest_of(points: np.ndarray, chosen: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Each point's nearest `chosen` place, as an entry of `ids`; ties go to the first."""
    return ids[nearest_few(points, chosen, 1)[:, 0]]


def nearest_few(points: np.ndarray, chosen: np.ndarray, count: int) -> np.ndarray:
    """Each point's `count` nearest `chosen` places (k, count), nearest first, then lowest."""
    return few_by(Tree(chosen), points, count, max(roundoff(points), roundoff(chosen)))


def few_by(tree: Tree, points: np.ndarray, count: int, slack: float) -> np.ndarray:
    """`nearest_few` in a tree of the places; equal distances differ by a `slack` at most."""
    # A distance within the slack of the one before has its rank. The sort is by rank, then by
    # number. If the last rank reaches the end of the search, more places are searched.
    nearest, left = np.zeros((len(points), count), dtype=np.int64), np.arange(len(points))
    looked = min(count - 1 + TIES, tree.n)
    while left.size:
        found = tree.query(points[left], k=looked)
        distance, places = (np.asarray(table).reshape(len(left), looked) for table in found)
        is_more = np.diff(distance, axis=1) > SAME * distance[:, :-1] + slack
        rank = np.cumsum(is_more, axis=1)
        rank = np.concatenate([np.zeros((len(left), 1), dtype=np.int64), rank], axis=1)
        order = np.argsort(rank * tree.n + places, axis=1)[:, :count]
        nearest[left] = np.take_along_axis(places, order, axis=1)
        left = left[rank[:, -1] == rank[:, count - 1]] if looked < tree.n else left[:0]
        looked = min(4 * looked, tree.n)
    return nearest


BETWEEN = 0.618  # place of the borders of Morton's cells, relative to their size: off structured grids


def canonical_order(points: np.ndarray) -> np.ndarray:
    """Sorts points by their coordinates, so that results do not depend on the order given."""
    slack = SAME * float(np.ptp(points, axis=0).max())
    return np.lexsort([ranked(column, slack) for column in points.T[::-1]])


def rows_in(ids: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The row in `ids` (k,) of each of `wanted`, which are all among them."""
    order = np.argsort(ids, kind="stable")
    return order[np.searchsorted(ids[order], wanted)]


def morton_order(points: np.ndarray) -> np.ndarray:
    """Sorts points along Morton's curve, so that successive points are close to each other."""
    # A point has an integer coordinate on every axis. The key interleaves their bits: bit 0 of x, y
    # and z, then bit 1 of x, y and z. Points with equal upper bits lie in one box.
    dimension = points.shape[1]
    bits = 62 // dimension
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max() or 1.0
    key = np.zeros(len(points), dtype=np.uint64)
    for axis in range(dimension):
        grid = ((points[:, axis] - low[axis]) / extent * (2**bits - 2) + BETWEEN).astype(np.uint64)
        key |= _spread(grid, dimension) << np.uint64(axis)
    return np.argsort(key, kind="stable")


def _spread(grid: np.ndarray, dimension: int) -> np.ndarray:
    """Moves bit k of all numbers to place k times `dimension`, by halving blocks of bits."""
    for half in (16, 8, 4, 2, 1):
        bits = sum((2**half - 1) << place for place in range(0, 64, half * dimension)) % 2**64
        grid = (grid | grid << np.uint64(half * (dimension - 1))) & np.uint64(bits)
    return grid
