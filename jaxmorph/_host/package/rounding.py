"""Decisions on computed numbers that round-off does not make: what is equal to `SAME` counts as equal, and the first is taken.

A mesh with flat sides, even spacings or a plane of symmetry has many lengths that are equal in truth. Compared as they are
computed, their last bit decides, and differs from one processor to the next.
"""

import numpy as np

from .cores import Tree

SAME = 1e-9
"""Relative difference up to which two numbers are equal."""

TIES = 4
"""Nearest places that are looked at first; more are looked at where all of these are equal."""


def roundoff(points: np.ndarray) -> float:
    """Returns the distance below which two points are taken to coincide."""
    return 8 * float(np.finfo(points.dtype).eps) * float(np.abs(points).max(initial=0))


def ranked(values: np.ndarray, slack: float) -> np.ndarray:
    """Ranks numbers from the least, which has rank 0.

    A number at most `slack` above its predecessor has the predecessor's rank.
    """
    order = np.argsort(values, kind="stable")
    rank = np.zeros(len(values), dtype=np.int64)
    rank[order[1:]] = np.cumsum(np.diff(values[order]) > slack)
    return rank


def distinct(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds the first point (k,) of each place, in canonical order, and each point's place (n,)."""
    slack = roundoff(points)
    rows = np.stack([ranked(column, slack) for column in points.T], axis=1)
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, place.ravel()


def first_largest(values: np.ndarray, slack: float | None = None) -> int:
    """Finds the first number within a slack of the largest; by default `SAME` times the largest."""
    top = values.max()
    return int((values >= top - (SAME * abs(top) if slack is None else slack)).argmax())


def nearest_of(points: np.ndarray, chosen: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Finds the id of the nearest `chosen` place for each point, out of `ids`; ties go to the first."""
    return ids[nearest_few(points, chosen, 1)[:, 0]]


def nearest_few(points: np.ndarray, chosen: np.ndarray, count: int) -> np.ndarray:
    """Finds the `count` nearest of the `chosen` places (k, count) for each point, nearest first.

    Of places that are equally near, the first comes first.
    """
    tree, slack = Tree(chosen), max(roundoff(points), roundoff(chosen))
    nearest, left = np.zeros((len(points), count), dtype=np.int64), np.arange(len(points))
    looked = min(count - 1 + TIES, len(chosen))
    while left.size:
        distance, places = (np.asarray(each).reshape(len(left), looked) for each in tree.query(points[left], k=looked))
        is_more = np.diff(distance, axis=1) > SAME * distance[:, :-1] + slack
        rank = np.cumsum(is_more, axis=1)
        rank = np.concatenate([np.zeros((len(left), 1), dtype=np.int64), rank], axis=1)
        order = np.argsort(rank * len(chosen) + places, axis=1)[:, :count]
        nearest[left] = np.take_along_axis(places, order, axis=1)
        left = left[rank[:, -1] == rank[:, count - 1]] if looked < len(chosen) else left[:0]
        looked = min(4 * looked, len(chosen))
    return nearest
