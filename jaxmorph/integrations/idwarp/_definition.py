"""A solver's surface of points and faces, and the linear map from its motion to the wall's."""

import dataclasses
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from .._shared import closest, fans, parts_of

SAME = 1e-12
"""Distance of two points that are one, as a share of the surface's extent."""
AT = 1e-6
"""Distance of a wall node that is a surface point, as a share of the points' spacing."""
NEAR = 0.1
"""Distance of a node that belongs to a face, as a share of its longest edge: facets cut corners."""


@dataclasses.dataclass(frozen=True, eq=False)
class Definition:
    """A surface: points (s, 3) of all processes in turn, and triangles (t, 3) between them."""

    points: Float[np.ndarray, "s 3"]
    triangles: Int[np.ndarray, "t 3"]

    @staticmethod
    def gathered(comm: Any, points: np.ndarray, conn: np.ndarray, sizes: np.ndarray) -> "Definition":
        """Gathers each process' points (k, 3), corners of faces in one list, and their counts."""
        shares = comm.allgather((points, fans(conn, sizes)))
        firsts = np.cumsum([0, *(len(share[0]) for share in shares)])
        corners = [share[1] + first for share, first in zip(shares, firsts, strict=False)]
        return Definition(np.concatenate([share[0] for share in shares]), np.concatenate(corners))

    def weights(self, x: Float[np.ndarray, "k 3"]) -> tuple[Any, np.ndarray, np.ndarray]:
        """Computes sparse weights (k, s) by which the surface's points move nodes `x`.

        A node at a point of the surface moves with it; where several points are at one place, with
        their mean. Another node moves as the closest point of the faces does, or as the three
        nearest points where there are no faces. Rows sum to one.

        **Returns:** the weights, each node's distance (k,) from the surface, and the distance (k,)
        beyond which it is not on it.
        """
        place, at = self._places()
        tree = KDTree(place)
        distance, nearest = (np.reshape(answer, (len(x), -1)) for answer in tree.query(x, k=min(3, len(place))))
        away, limit = distance[:, 0].copy(), _spacing(tree)[nearest[:, 0]]
        columns, shares = _padded(nearest), _padded(_inverse(distance, AT * limit))
        off = np.flatnonzero(away > AT * limit)
        if len(self.triangles):
            corners = at[self.triangles]
            chosen, inside, away[off] = closest(place[corners], x[off])
            columns[off], shares[off] = corners[chosen], inside
            longest = _edges(place[corners]).max(axis=1)
            limit[off] = NEAR * longest[chosen]
        rows = np.repeat(np.arange(len(x)), 3)
        of_places = scipy.sparse.csr_array((shares.ravel(), (rows, columns.ravel())), (len(x), len(place)))
        share = 1 / np.bincount(at)[at]
        means = scipy.sparse.csr_array((share, (at, np.arange(len(at)))), (len(place), len(at)))
        return of_places @ means, away, limit

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Finds the points' places (g, 3), and each point's place (s,): solvers repeat points."""
        place, at = np.unique(self.points, axis=0, return_inverse=True)
        pairs = KDTree(place).query_pairs(SAME * np.ptp(place, axis=0).max(), output_type="ndarray")
        part = parts_of(pairs[:, 0], pairs[:, 1], len(place))
        _, first, part = np.unique(part, return_index=True, return_inverse=True)
        return place[first], part[at.ravel()]


def _spacing(tree: KDTree) -> np.ndarray:
    """Measures the distance of each point from the next one."""
    if tree.n == 1:
        return np.ones(1)
    return np.asarray(tree.query(tree.data, k=2)[0])[:, 1]


def _padded(values: np.ndarray) -> np.ndarray:
    """Widens rows to three columns of zeros."""
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _inverse(distance: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Computes shares by inverse squared distance; all for a point nearer than `least`."""
    shares = 1 / np.maximum(distance, np.finfo(float).tiny ** 0.25) ** 2
    shares = np.where(distance[:, :1] <= least[:, None], np.arange(distance.shape[1]) == 0, shares)
    return shares / shares.sum(axis=1, keepdims=True)


def _edges(corners: np.ndarray) -> np.ndarray:
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
