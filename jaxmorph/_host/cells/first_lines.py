"""First grid lines off a wall: each wall node's edge nearest to the wall's normal."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..linear.products import cross
from .topology import DIMENSION, EDGES, FACES


class Lines(NamedTuple):
    """First grid lines of w wall nodes, and the faces of the wall.

    - `nodes`, `ends`, `beside` (w,): ids of the wall nodes, of the other ends of their lines, and
      of neighbours on the wall.
    - `faces` (f, c): sides of cells on the wall; a triangle repeats its last corner.
    - `rows` (f, c): the corners as rows of `nodes`; w for a repeated corner, which does not count.
    - `sign` (f,): 1 or -1. An area vector times its sign points into the mesh.
    """

    nodes: np.ndarray
    ends: np.ndarray
    beside: np.ndarray
    faces: np.ndarray
    rows: np.ndarray
    sign: np.ndarray

    def directions(self, x: Any) -> Any:
        """Computes the first grid lines (w, d). NumPy or JAX."""
        return x[self.ends] - x[self.nodes]

    def areas(self, x: Any) -> list[tuple[np.ndarray, Any]]:
        """Lists rows (e,) of wall nodes, with the area vectors (e, d) of the faces there."""
        area = areas(x[self.faces]) * self.sign[:, None].astype(x.dtype)
        return [(rows, area) for rows in self.rows.T]


def first_lines(cells: Mapping[str, np.ndarray], points: np.ndarray, wall: np.ndarray) -> Lines:
    """Picks, for every wall node, the edge off the wall that is nearest to the wall's normal.

    Raises `ValueError` if no boundary side of a cell has all corners among the wall nodes.
    """
    on_wall = np.zeros(len(points), dtype=bool)
    on_wall[wall] = True
    cells = {kind: np.asarray(ids) for kind, ids in cells.items() if DIMENSION[kind] == points.shape[1]}
    faces, apexes = _sides(cells, on_wall)
    if not len(faces):
        raise ValueError(
            f"no cell has a boundary side whose corners are all among the {len(wall)} wall nodes: name the nodes of a patch."
        )
    area = areas(points[faces])
    sign = np.where(np.sum(area * (points[apexes] - points[faces[:, 0]]), axis=1) < 0, -1, 1)
    counted = np.ones(faces.shape, dtype=bool)
    counted[:, -1] = faces[:, -1] != faces[:, -2]
    normal, beside = np.zeros(points.shape), np.full(len(points), -1)
    for corner in range(faces.shape[1]):
        is_corner = counted[:, corner]
        np.add.at(normal, faces[is_corner, corner], (sign[:, None] * area)[is_corner])
        beside[faces[is_corner, corner]] = faces[is_corner, corner - 1]
    start, end = _edges_off(cells, on_wall)
    start, end = start[beside[start] >= 0], end[beside[start] >= 0]
    along = points[end] - points[start]
    size = np.linalg.norm(along, axis=1)
    steepness = np.sum(along * normal[start], axis=1) / np.where(size > 0, size, 1)
    order = np.lexsort((end, -steepness, start))
    nodes, first = np.unique(start[order], return_index=True)
    place = np.full(len(points), len(nodes))
    place[nodes] = np.arange(len(nodes))
    return Lines(nodes, end[order][first], beside[nodes], faces, np.where(counted, place[faces], len(nodes)), sign)


def areas(x: Any) -> Any:
    """Computes area vectors (f, d) of faces (f, c, d), 2-D: of the edge's length. NumPy or JAX."""
    if x.shape[2] == 2:
        along = x[:, 1] - x[:, 0]
        return along[:, ::-1] * np.array([[-1.0, 1.0]], dtype=x.dtype)
    columns = cross((x[:, 2] - x[:, 0]).T, (x[:, 3] - x[:, 1]).T)
    units = np.eye(3, dtype=x.dtype) / 2
    return sum(column[:, None] * unit[None] for column, unit in zip(columns, units, strict=True))


def _sides(cells: Mapping[str, np.ndarray], on_wall: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lists sides of single cells with all corners on the wall, and a cell corner off the side."""
    faces, apexes = [], []
    width = {2: 2, 3: 4}[max((DIMENSION[kind] for kind in cells), default=2)]
    for kind, corners in cells.items():
        for side in FACES[kind]:
            rows = np.flatnonzero(on_wall[corners[:, side]].all(axis=1))
            padded = (*side, *side[-1:] * (width - len(side)))
            faces.append(corners[rows][:, np.array(padded)])
            apexes.append(corners[rows, min(set(range(corners.shape[1])) - set(side))])
    if not faces:
        return np.zeros((0, width), dtype=np.int64), np.zeros(0, dtype=np.int64)
    joined, apex = np.concatenate(faces), np.concatenate(apexes)
    _, first, count = np.unique(np.sort(joined, axis=1), axis=0, return_index=True, return_counts=True)
    single = np.sort(first[count == 1])
    return joined[single], apex[single]


def _edges_off(cells: Mapping[str, np.ndarray], on_wall: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lists edges of cells from the wall to a node off the wall: start and end."""
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for kind, corners in cells.items():
        near = corners[on_wall[corners].any(axis=1)]
        for edge in EDGES[kind]:
            for ends in (edge, edge[::-1]):
                ids = near[:, ends]
                pairs.append(ids[on_wall[ids[:, 0]] & ~on_wall[ids[:, 1]]])
    start, end = np.concatenate(pairs).T
    return start, end
