"""Decisions free of round-off, by which many lengths of a regular mesh differ; orders of points."""

import itertools
from typing import Any

import numpy as np
from numpy import ndarray

from ..cells.topology import Pair
from ..rows import first_of_equals
from ..tolerances import NEAR_ZERO, SAME
from .cores import cores

TIES = 4  # nearest places that are searched first; if all are equally near, more are searched
FEW_POINTS = 4096  # points of a search up to which threads cost more than they gain


class Tree:
    """SciPy's k-d tree, searched with all cores. The answers do not depend on their number."""

    def __init__(self, points: Any, **options: Any):
        from scipy.spatial import KDTree  # 0.2 s, which reading and writing of meshes do not need

        # XLA's programs, and callbacks of them, flush numbers below the smallest normal one to
        # zero. SciPy would step from zero to the next number, and never get there.
        points = np.asarray(points, dtype=float)
        self._tree = KDTree(np.where(np.abs(points) < NEAR_ZERO, NEAR_ZERO, points), **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tree, name)

    def query(self, x: Any, *arguments: Any, **keywords: Any) -> tuple[Any, Any]:
        return self._tree.query(
            x, *arguments, **{"workers": cores() if len(x) > FEW_POINTS else 1} | keywords
        )

    def within(self, x: ndarray, radius: ndarray) -> Pair:
        """Pairs of a row of `x` (k, d) and a point within its radius (k,), by row, then point."""
        around = self.query_ball_point(x, radius, return_sorted=True)
        rows = np.repeat(np.arange(len(x)), [len(ids) for ids in around])
        return rows, np.fromiter(itertools.chain.from_iterable(around), np.int64, len(rows))

    def close_pairs(self, radius: float) -> ndarray:
        """Pairs (p, 2) of points within a distance of each other, first ones first."""
        pairs = self.query_pairs(radius, output_type="ndarray")
        return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def extent_of(points: Any) -> Any:
    """The largest extent of points along an axis."""
    return np.ptp(points, axis=0).max()


def roundoff(points: ndarray) -> float:
    return 8 * float(np.finfo(points.dtype).eps) * float(np.abs(points).max(initial=0))


def resolution(points: ndarray) -> float:
    """Returns the difference up to which two coordinates of points (n, d) count as equal."""
    return max(SAME * float(np.ptp(points, axis=0).max(initial=0)), roundoff(points))


def spacing(points: ndarray) -> ndarray:
    """Each point's distance (n,) from its nearest neighbour; infinite for one point."""
    return np.asarray(Tree(points).query(points, k=2)[0])[:, 1]


def ranked(values: ndarray, slack: float) -> ndarray:
    """Ranks numbers from 0; one at most `slack` above its predecessor has the same rank."""
    order = np.argsort(values, kind="stable")
    rank = np.zeros(len(values), dtype=np.int64)
    rank[order[1:]] = np.cumsum(np.diff(values[order]) > slack)
    return rank


def distinct_places(points: ndarray) -> Pair:
    """Each place's first point (k,), and each point's place (n,)."""
    slack = roundoff(points)
    rows = np.stack([ranked(column, slack) for column in points.T], axis=1)
    return first_of_equals(rows)


def first_largest(values: ndarray, slack: float | None = None) -> int:
    """The first number within a slack of the largest; by default `SAME` times the largest."""
    top = values.max()
    return int((values >= top - (SAME * abs(top) if slack is None else slack)).argmax())


def nearest_of(points: ndarray, chosen: ndarray, ids: ndarray) -> ndarray:
    """Each point's nearest `chosen` place, as an entry of `ids`; ties go to the first."""
    return ids[nearest_few(points, chosen, 1)[:, 0]]


def nearest_few(points: ndarray, chosen: ndarray, count: int) -> ndarray:
    """Each point's `count` nearest `chosen` places (k, count), nearest first, then lowest."""
    return few_by(Tree(chosen), points, count, max(roundoff(points), roundoff(chosen)))


def few_by(tree: Tree, points: ndarray, count: int, slack: float) -> ndarray:
    """`nearest_few` in a tree of the places; equal distances differ by a `slack` at most."""
    # If all distances from the last wanted one on are equal, more places are searched.
    nearest = np.zeros((len(points), count), dtype=np.int64)
    left = np.arange(len(points))
    looked = min(count - 1 + TIES, tree.n)
    while left.size:
        distance, places = tree.query(points[left], k=range(1, looked + 1))
        is_more = np.diff(distance, axis=1) > SAME * distance[:, :-1] + slack
        nearest[left] = lowest_of_equals(places, is_more)[:, :count]
        left = left[~is_more[:, count - 1 :].any(axis=1)] if looked < tree.n else left[:0]
        looked = min(4 * looked, tree.n)
    return nearest


def lowest_of_equals(places: ndarray, is_more: ndarray) -> ndarray:
    """Sorts rows of places (k, c), nearest first, by number where a distance is not `is_more` than
    the one before it (k, c - 1).
    """
    # Rank and number are one key, rank in the upper bits.
    rank = np.cumsum(np.pad(is_more, ((0, 0), (1, 0))), axis=1)
    return np.take_along_axis(places, np.argsort((rank << 32) + places, axis=1), axis=1)


# place of the borders of Morton's cells, relative to their size: off structured grids
BETWEEN = 0.618


def canonical_order(points: ndarray) -> ndarray:
    """Sorts points by their coordinates, so that results do not depend on the order given."""
    slack = resolution(points)
    return np.lexsort([ranked(column, slack) for column in points.T[::-1]])


def morton_order(points: ndarray) -> ndarray:
    """Sorts points along Morton's curve, so that successive points are close to each other."""
    # A point has an integer coordinate on every axis. The key interleaves their bits: bit 0 of x, y
    # and z, then bit 1 of x, y and z. Points with equal upper bits lie in one box. A table moves
    # bit k of ten bits to place k times the dimension, as the digits of another base.
    dimension = points.shape[1]
    table = np.array([int(f"{i:b}", 2**dimension) for i in range(1024)], dtype=np.uint64)
    words = 6 // dimension  # of ten bits, for each axis
    low = points.min(axis=0)
    extent = extent_of(points) or 1.0
    key = np.zeros(len(points), dtype=np.uint64)
    for axis in range(dimension):
        grid = ((points[:, axis] - low[axis]) / extent * (1024**words - 2) + BETWEEN).astype(
            np.int64
        )
        for word in range(words):
            key |= table[grid >> 10 * word & 1023] << np.uint64(10 * dimension * word + axis)
    return np.argsort(key, kind="stable")
