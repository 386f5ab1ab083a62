"""Structured blocks and zones joined to one mesh, and the way back to the file's nodes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from jaxmorph._mesh.exchange import Parts, checked_parts, gathered

from .._host.cells.adjacency import columns_of, is_single, parts_of, sorted_columns
from .._host.package.errors import check_all_finite
from .._host.package.rounding import Tree
from .._host.ragged import Ragged

BLOCK_SIDES = ("imin", "imax", "jmin", "jmax", "kmin", "kmax")
FaceTables = list[ndarray]
"""Faces (k, corners) of one shape each."""
NODE_TOLERANCE = 1e-3
"""Distance between duplicates of a node, as a share of the shortest edge at them."""
COPIES = 12
"""Duplicates of a node that are looked for."""


def number_block(shape: tuple[int, ...], first: int) -> ndarray:
    """Numbers a block's nodes by i, j[, k] from `first`, i fastest, without axes of one node."""
    ids = first + np.arange(np.prod(shape)).reshape(shape, order="F")
    return ids.reshape([size for size in shape if size > 1])


def join_rows(parts: Sequence[Ragged]) -> Ragged:
    values = np.concatenate([part.values for part in parts])
    return Ragged.of(values, np.concatenate([part.sizes for part in parts]))


def make_block_cells(ids: ndarray) -> tuple[str, ndarray]:
    """Makes the cells between the nodes of a block, i running fastest: their type and corners."""
    square = [
        (slice(-1), slice(-1)),
        (slice(1, None), slice(-1)),
        (slice(1, None),) * 2,
        (slice(-1), slice(1, None)),
    ]
    levels = [()] if ids.ndim == 2 else [(slice(-1),), (slice(1, None),)]
    corners = [ids[(*ij, *k)].ravel(order="F") for k in levels for ij in square]
    return "quad" if ids.ndim == 2 else "hexahedron", np.stack(corners, axis=1)


def make_block_sides(ids: ndarray) -> FaceTables:
    """Makes the faces (edges in 2-D) of each side of a block, in the order of `BLOCK_SIDES`."""
    sides = []
    for axis in range(ids.ndim):
        for at in (0, -1):
            side = ids.take(at, axis=axis)
            if side.ndim == 2:
                sides.append(
                    make_block_cells(side)[1]
                    if min(side.shape) > 1
                    else np.zeros((0, 4), ids.dtype)
                )
            else:
                sides.append(np.stack([side[:-1], side[1:]], axis=1))
    return sides


def select_open_faces(faces: FaceTables, patches: list[ndarray], n: int) -> FaceTables:
    """Selects the faces that are not inside of a patch: where blocks may meet."""
    covered = [np.zeros(len(corners), bool) for corners in faces]
    inside = np.zeros(n, bool)
    for nodes in patches:
        inside[nodes] = True
        for mask, corners in zip(covered, faces, strict=True):
            mask |= inside[corners].all(axis=1)
        inside[nodes] = False
    return [corners[~mask] for corners, mask in zip(faces, covered, strict=True)]


def find_shared_nodes(points: ndarray, faces: FaceTables) -> ndarray:
    """Finds each point's first duplicate (see `NODE_TOLERANCE`) on `faces`; else its own id."""
    n = len(points)
    size = np.full(n, np.inf)
    for corners in faces:
        length = np.linalg.norm(points[corners] - points[np.roll(corners, 1, axis=1)], axis=2)
        length[length == 0] = np.inf
        np.minimum.at(size, corners, np.minimum(length, np.roll(length, -1, axis=1)))
    nodes = np.flatnonzero(np.isfinite(size))
    if not len(nodes):
        return np.arange(n)
    count = min(COPIES, len(nodes))
    neighbours = Tree(points[nodes]).query(points[nodes], k=count)
    distance, nearest = (np.asarray(values).reshape(len(nodes), count) for values in neighbours)
    limit = NODE_TOLERANCE * np.minimum(size[nodes][:, None], size[nodes][nearest])
    row, column = np.nonzero(distance <= limit)
    parts = parts_of(row, nearest[row, column], len(nodes))
    _, first = np.unique(parts, return_index=True)
    same = np.arange(n)
    same[nodes] = nodes[first[parts]]
    return same


def join_zones(
    points: ndarray,
    cells: Iterable[tuple[str, ndarray]],
    patches: Mapping[str, Sequence[ndarray]],
    faces: FaceTables,
    names: Sequence[str] = (),
) -> tuple[Parts, ndarray]:
    """Joins zones to one mesh in the file's node order, 2-D if z is constant; with its nodes (N,).

    `points` are all nodes of a file, zone after zone, with cells and patches of their ids. Where no
    other zone meets the outer `faces`, they become patches by their `names`. Without names these
    are the patch `unnamed`, or `boundary` where there is no other. Where the file has a patch
    `unnamed` they are `unnamed_faces`.

    It raises `ValueError` for coordinates that are not finite.
    """
    check_all_finite(points)
    faces = select_open_faces(
        faces, [nodes for parts in patches.values() for nodes in parts], len(points)
    )
    node = np.unique(find_shared_nodes(points, faces), return_inverse=True)[1]
    first = np.unique(node, return_index=True)[1]
    d = 3 if points.shape[1] == 3 and np.ptp(points[:, 2]) else 2
    whole = gathered((kind, node[corners]) for kind, corners in cells)
    own = [(name, node[nodes]) for name, parts in patches.items() for nodes in parts]
    found = gathered([*own, *_name_rest([node[corners] for corners in faces], names, patches)])
    return checked_parts(np.ascontiguousarray(points[first, :d]), whole, found), node


def _name_rest(
    faces: FaceTables, names: Sequence[str], patches: Mapping[str, Any]
) -> Iterator[tuple[str, ndarray]]:
    """Yields names and nodes of faces that no other zone meets."""
    rest = "unnamed" if patches else "boundary"
    while rest in patches:
        rest += "_faces"
    for name, corners, mask in zip(
        names or [rest] * len(faces), faces, _mark_single(faces), strict=True
    ):
        if mask.any():
            yield name, corners[mask].ravel()


def _mark_single(faces: FaceTables) -> FaceTables:
    """Finds faces that come once and are not shrunk to a line or point: a mask for each array."""
    width = max((corners.shape[1] for corners in faces), default=0)
    columns = [sorted_columns(columns_of(corners), width) for corners in faces]
    once = (
        is_single([np.concatenate(parts) for parts in zip(*columns, strict=True)])
        if faces
        else np.zeros(0, bool)
    )
    masks = []
    for corners, mask in zip(
        faces, np.split(once, np.cumsum([*map(len, faces)])[:-1]), strict=False
    ):
        distinct = 1 + np.count_nonzero(np.diff(np.sort(corners, axis=1), axis=1), axis=1)
        masks.append(mask & (distinct >= min(corners.shape[1], 3)))
    return masks
