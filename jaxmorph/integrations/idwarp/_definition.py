"""A solver's surface of points and faces, and the linear map from its motion to the wall's."""

import dataclasses
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph
from scipy.spatial import KDTree

SAME = 1e-12
"""Distance of two points that are one, as a share of the surface's extent."""
AT = 1e-6
"""Distance of a wall node that is a surface point, as a share of the points' spacing."""
NEAR = 0.1
"""Distance of a node that belongs to a face, as a share of its longest edge: facets cut corners."""
MOST = 1 << 12
"""Nodes whose candidates among the faces are looked at together."""


@dataclasses.dataclass(frozen=True, eq=False)
class Definition:
    """A surface: points (s, 3) of all processes in turn, and triangles (t, 3) between them."""

    points: Float[np.ndarray, "s 3"]
    triangles: Int[np.ndarray, "t 3"]

    @staticmethod
    def gathered(comm: Any, points: np.ndarray, conn: np.ndarray, sizes: np.ndarray) -> "Definition":
        """Gathers each process' points (k, 3), corners of faces in one list, and their counts."""
        shares = comm.allgather((points, _triangles(conn, sizes)))
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
            chosen, inside, away[off] = _closest(x[off], place[corners])
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
        ones = np.ones(len(pairs), bool)
        graph = scipy.sparse.coo_array((ones, (pairs[:, 0], pairs[:, 1])), (len(place),) * 2)
        part = csgraph.connected_components(graph, directed=False)[1]
        _, first, part = np.unique(part, return_index=True, return_inverse=True)
        return place[first], part[at.ravel()]


def _triangles(conn: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Cuts faces into triangles (t, 3) about their first corners."""
    begins = np.cumsum(sizes) - sizes
    count = sizes - 2
    face = np.repeat(np.arange(len(sizes)), count)
    turn = 1 + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    first = begins[face]
    return np.stack([conn[first], conn[first + turn], conn[first + turn + 1]], axis=1).reshape(-1, 3)


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


def _closest(x: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds the closest triangle (k,) of `corners` (t, 3, 3) for `x`, weights (k, 3), distance.

    Triangles of like size are looked at together, so that a few long ones do not make candidates of
    all.
    """
    bound = np.asarray(KDTree(corners.reshape(-1, 3)).query(x)[0])
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    size = np.floor(np.log2(np.maximum(radius, np.finfo(float).tiny)))
    chosen, weights, distance = np.zeros(len(x), int), np.zeros((len(x), 3)), np.full(len(x), np.inf)
    for kind in np.unique(size):
        rows = np.flatnonzero(size == kind)
        tree, reach = KDTree(middle[rows]), radius[rows].max()
        for start in range(0, len(x), MOST):
            part = np.arange(start, min(start + MOST, len(x)))
            near = tree.query_ball_point(x[part], (np.minimum(bound, distance)[part] + reach) * (1 + 1e-9))
            counts = np.array([len(ids) for ids in near])
            node = np.repeat(part, counts)
            triangle = rows[np.concatenate([np.asarray(ids, int) for ids in near])]
            share, away = _on_triangles(x[node], corners[triangle])
            order = np.lexsort((triangle, away, node))
            best = order[np.unique(node[order], return_index=True)[1]]
            best = best[away[best] < distance[node[best]]]
            at = node[best]
            chosen[at], weights[at], distance[at] = triangle[best], share[best], away[best]
    return chosen, weights, distance


def _on_triangles(x: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes weights (k, 3) of each triangle's closest point to `x`, and its distance (k,)."""
    a, b, c = (corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    squared = np.sum(normal**2, axis=1)
    safe = np.where(squared > 0, squared, 1)
    of_b = np.sum(np.cross(x - a, c - a) * normal, axis=1) / safe
    of_c = np.sum(np.cross(b - a, x - a) * normal, axis=1) / safe
    inside = np.stack([1 - of_b - of_c, of_b, of_c], axis=1)
    trials = [np.where(((inside >= 0).all(axis=1) & (squared > 0))[:, None], inside, np.nan)]
    for k, other in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, other] - corners[:, k]
        length = np.sum(edge**2, axis=1)
        share = np.sum((x - corners[:, k]) * edge, axis=1) / np.where(length > 0, length, 1)
        share = np.clip(share, 0, 1)
        trials.append((1 - share)[:, None] * np.eye(3)[k] + share[:, None] * np.eye(3)[other])
    distances = [np.linalg.norm(np.einsum("kc,kcd->kd", trial, corners) - x, axis=1) for trial in trials]
    best = np.argmin(np.nan_to_num(distances, nan=np.inf), axis=0)
    at = np.arange(len(x))
    return np.stack(trials)[best, at], np.stack(distances)[best, at]
