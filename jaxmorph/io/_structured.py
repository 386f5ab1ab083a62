"""Structured blocks: their cells, their sides, and nodes that several of them share."""

import numpy as np
from scipy import spatial

from .._host.cells.adjacency import parts_of

SIDES = ("imin", "imax", "jmin", "jmax", "kmin", "kmax")
TOLERANCE = 1e-3
"""Distance that two nodes of one place may be apart, as a share of the shortest edge at them."""
COPIES = 12
"""Nodes of one place that are looked for around each."""


def block_ids(shape: tuple[int, ...], first: int) -> np.ndarray:
    """Numbers a block's nodes by i, j[, k] from `first`, i fastest, without axes of one node."""
    ids = first + np.arange(np.prod(shape)).reshape(shape, order="F")
    return ids.reshape([size for size in shape if size > 1])


def block_cells(ids: np.ndarray) -> tuple[str, np.ndarray]:
    """Makes the cells between the nodes of a block, i running fastest: their type and corners."""
    if ids.ndim == 2:
        corners = [ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]]
        return "quad", np.stack([corner.ravel(order="F") for corner in corners], axis=1)
    square = [(slice(-1), slice(-1)), (slice(1, None), slice(-1)), (slice(1, None),) * 2, (slice(-1), slice(1, None))]
    corners = [ids[(*ij, k)] for k in (slice(-1), slice(1, None)) for ij in square]
    return "hexahedron", np.stack([corner.ravel(order="F") for corner in corners], axis=1)


def block_sides(ids: np.ndarray) -> list[np.ndarray]:
    """Makes the faces (edges in 2-D) of each side of a block, in the order of `SIDES`."""
    sides = []
    for axis in range(ids.ndim):
        for at in (0, -1):
            side = ids.take(at, axis=axis)
            if side.ndim == 2:
                sides.append(block_cells(side)[1] if min(side.shape) > 1 else np.zeros((0, 4), ids.dtype))
            else:
                sides.append(np.stack([side[:-1], side[1:]], axis=1))
    return sides


def open_faces(faces: list[np.ndarray], patches: list[np.ndarray], n: int) -> list[np.ndarray]:
    """Selects the faces that are not inside of a patch: where blocks may meet."""
    covered = [np.zeros(len(corners), bool) for corners in faces]
    inside = np.zeros(n, bool)
    for nodes in patches:
        inside[nodes] = True
        for mask, corners in zip(covered, faces, strict=True):
            mask |= inside[corners].all(axis=1)
        inside[nodes] = False
    return [corners[~mask] for corners, mask in zip(faces, covered, strict=True)]


def shared_nodes(points: np.ndarray, faces: list[np.ndarray]) -> np.ndarray:
    """Finds each point's first id at its place, among the nodes of `faces`; else its own.

    Two nodes are at one place when they are closer than a thousandth of the shortest edge of
    `faces` at them.
    """
    n = len(points)
    size = np.full(n, np.inf)
    for corners in faces:
        length = np.linalg.norm(points[corners] - points[np.roll(corners, 1, axis=1)], axis=2)
        length[length == 0] = np.inf
        for column, before in enumerate(np.roll(np.arange(corners.shape[1]), 1)):
            np.minimum.at(size, corners[:, column], length[:, column])
            np.minimum.at(size, corners[:, before], length[:, column])
    nodes = np.flatnonzero(np.isfinite(size))
    if not len(nodes):
        return np.arange(n)
    count = min(COPIES, len(nodes))
    neighbours = spatial.KDTree(points[nodes]).query(points[nodes], k=count)
    distance, nearest = (np.asarray(values).reshape(len(nodes), count) for values in neighbours)
    limit = TOLERANCE * np.minimum(size[nodes][:, None], size[nodes][nearest])
    row, column = np.nonzero(distance <= limit)
    parts = parts_of(row, nearest[row, column], len(nodes))
    _, first = np.unique(parts, return_index=True)
    same = np.arange(n)
    same[nodes] = nodes[first[parts]]
    return same
