"""Decisions free of round-off: numbers within `SAME` are equal, and the first of equals is taken.

A mesh with flat sides, even spacings or a plane of symmetry has many equal lengths. Computed
lengths differ in the last bit, and differently on different processors. A plain comparison would
follow that bit.
"""

import numpy as np

from .trees import Tree

SAME = 1e-9
"""Relative difference up to which two numbers count as equal."""

TIES = 4
"""Nearest places that are searched first; if all are equally near, more are searched."""


def roundoff(points: np.ndarray) -> float:
    """Computes the distance below which two points count as one."""
    return 8 * float(np.finfo(points.dtype).eps) * float(np.abs(points).max(initial=0))


def spacing(points: np.ndarray) -> np.ndarray:
    """Measures each point's distance (n,) from its nearest neighbour; infinite for one point."""
    return np.asarray(Tree(points).query(points, k=2)[0])[:, 1]


def ranked(values: np.ndarray, slack: float) -> np.ndarray:
    """Ranks numbers from the least, which has rank 0.

    A number at most `slack` above its predecessor has the predecessor's rank.
    """
    order = np.argsort(values, kind="stable")
    rank = np.zeros(len(values), dtype=np.int64)
    rank[order[1:]] = np.cumsum(np.diff(values[order]) > slack)
    return rank


def distinct(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds places of points: each place's first point (k,), and each point's place (n,)."""
    slack = roundoff(points)
    rows = np.stack([ranked(column, slack) for column in points.T], axis=1)
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, place.ravel()


def first_largest(values: np.ndarray, slack: float | None = None) -> int:
    """Finds the first number within a slack of the largest; by default `SAME` times the largest."""
    top = values.max()
    return int((values >= top - (SAME * abs(top) if slack is None else slack)).argmax())


def nearest_of(points: np.ndarray, chosen: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Finds each point's nearest `chosen` place, as an entry of `ids`; ties go to the first."""
    return ids[nearest_few(points, chosen, 1)[:, 0]]


def nearest_few(points: np.ndarray, chosen: np.ndarray, count: int) -> np.ndarray:
    """Finds each point's `count` nearest `chosen` places (k, count), nearest first, then lowest."""
    return few_by(Tree(chosen), points, count, max(roundoff(points), roundoff(chosen)))


def few_by(tree: Tree, points: np.ndarray, count: int, slack: float) -> np.ndarray:
    """Finds `nearest_few` in a tree of the places; equal distances differ by a `slack` at most."""
    # Distances are ranked: a distance within the slack of the one before has its rank. The sort is
    # by rank, then by number. If the last rank reaches the end of the search, more places are
    # searched.
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
