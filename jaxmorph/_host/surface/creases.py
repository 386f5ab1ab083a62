"""Faces of a surface: cut into simplices, turned to one sense, and the edges at which they turn."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from ..cells.adjacency import handedness, neighbours, parts_of
from ..cells.topology import Pair
from ..linear.products import normals, row_lengths, unit_rows
from ..package.arguments import as_array, rows_of
from ..package.rounding import canonical_order, roundoff
from ..rows import first_of_equals
from ..tolerances import SAME


class Creased(NamedTuple):
    """Faces (k, c) of one sense, and what hangs together; all ids are rows of the points.

    - `beside` (k, c): the face beyond each edge (2-D: end) that is not sharp, else the face itself.
    - `corners` (k, c): as `faces`, numbered apart on the sides of sharp edges; `origins` (v,): the
      point of each number.
    - `part` (k,): numbers of parts. `sharp` (s, e), `rim` (r, e): edges (2-D: vertices) between
      faces that turn, and of one face.
    """

    faces: ndarray
    beside: ndarray
    corners: ndarray
    origins: ndarray
    part: ndarray
    sharp: ndarray
    rim: ndarray

    @classmethod
    def none(cls, faces: ndarray) -> "Creased":
        """Takes faces as they are, each on its own."""
        nothing = np.zeros(0, int)
        return cls(faces, faces, faces, nothing, nothing, nothing[:, None], nothing[:, None])

    @classmethod
    def of(
        cls,
        faces: ndarray,
        points: ndarray,
        welded: ndarray,
        angle: float,
        is_feature: Callable[[ndarray], ndarray] | None = None,
    ) -> "Creased":
        """Finds the edges of faces; `welded` (n,) is the vertex of each point.

        `is_feature` marks places on the sharp edges, if a model tells these and no angle does.
        """
        _, sign, part = _neighbours_of(welded[faces])
        sign = sign * _sense(sign, part, points[faces])
        faces = np.where(sign[:, None] < 0, faces[:, ::-1], faces)
        vertices = welded[faces]
        beside = _neighbours_of(vertices)[0]
        is_sharp = np.zeros(beside.shape, bool)  # no angle tells the sides of curves in 3-D apart
        if is_feature is not None:
            is_sharp = _on_features(_sides_of(vertices), points, is_feature)
        elif vertices.shape[1] == points.shape[1]:
            unit = unit_rows(normals(points[vertices]))
            is_sharp = np.sum(unit[:, None] * unit[beside], axis=2) < np.cos(angle)
        sharp, rim = _borders(vertices, beside, is_sharp)
        is_smooth = (beside >= 0) & ~is_sharp
        corners, origins = _split(vertices, beside, is_smooth)
        own = np.arange(len(beside))[:, None]
        return cls(faces, np.where(is_smooth, beside, own), corners, origins, part, sharp, rim)


def cut_faces(faces: Any, points: ndarray) -> ndarray:
    """Cuts one array of faces, or several, into triangles, in 2-D segments (k, c)."""
    several = isinstance(faces, list | tuple) and len(faces) and np.ndim(faces[0]) == 2
    found = [
        _cut_quads(as_array("faces", given), points) for given in (faces if several else [faces])
    ]
    if not sum(map(len, found)) or len({ids.shape[1] for ids in found}) > 1:
        raise ValueError(
            f"`faces` holds {[ids.shape for ids in found]}; expected triangles and quads, or "
            "segments."
        )
    return np.concatenate(found)


def with_extent(faces: ndarray, welded: ndarray) -> ndarray:
    """Leaves out the faces that have two corners at one place."""
    count = len(faces)
    faces = faces[np.diff(np.sort(welded[faces], axis=1), axis=1).all(axis=1)]
    if not len(faces):
        raise ValueError(
            f"each of the {count} `faces` has two corners at one place: the surface has no extent."
        )
    return faces


def _cut_quads(ids: ndarray, points: ndarray) -> ndarray:
    """Cuts quads along the shorter diagonal; leaves triangles and segments.

    Of equal diagonals it is the one from the corner that comes first by place.
    """
    if ids.ndim != 2 or ids.shape[1] not in ((2,) if points.shape[1] == 2 else (2, 3, 4)):
        raise ValueError(
            f"`faces` has shape {ids.shape}; expected (k, 2) in 2-D, (k, 3) or (k, 4) in 3-D."
        )
    ids = rows_of("faces` of `points", ids.ravel(), len(points)).reshape(*ids.shape)
    if ids.shape[1] < 4:
        return ids
    rank = np.argsort(canonical_order(points))
    start = rank[ids].argmin(axis=1)[:, None] + np.arange(4)
    ids = np.take_along_axis(ids, start % 4, axis=1)
    first, second = (row_lengths(points[ids[:, k + 2]] - points[ids[:, k]]) for k in (0, 1))
    is_longer = first > second * (1 + SAME) + roundoff(points)
    ids = np.where(is_longer[:, None], np.roll(ids, -1, axis=1), ids)
    return np.concatenate([ids[:, [0, 1, 2]], ids[:, [0, 2, 3]]])


def _sense(sign: ndarray, part: ndarray, corners: ndarray) -> ndarray:
    """The sense (1 or -1) by which each face's part is as most of its area is listed.

    A tie goes to the sense of the face whose middle comes first by place.
    """
    edges = corners[:, 1:] - corners[:, :1]
    size = np.sqrt(np.linalg.det(edges @ edges.swapaxes(1, 2)).clip(0))
    votes = np.bincount(part, sign * size)
    order = canonical_order(corners.mean(axis=1))
    first = order[np.unique(part[order], return_index=True)[1]]
    is_tie = np.abs(votes) <= SAME * np.bincount(part, size)
    return np.sign(np.where(is_tie, sign[first], votes)).astype(int)[part]


def _neighbours_of(vertices: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Finds the face (k, c) beyond each edge (2-D: corner) or -1, the sense and the part (k,)."""
    if vertices.shape[1] == 3:
        cells = {"triangle": vertices}
        columns = [0, 1, 2]
    else:  # a segment is a strip of one quad, whose sides are its ends
        cells = {"quad": np.concatenate([vertices, vertices[:, ::-1] + vertices.max() + 1], axis=1)}
        columns = [3, 1]
    neighbour, flipped = neighbours(cells)
    sign, part = handedness(cells, neighbour, flipped)
    beside = neighbour.reshape(len(vertices), -1)[:, columns]
    return beside, sign, first_of_equals(part)[1]


def _sides_of(vertices: ndarray) -> ndarray:
    return np.stack([vertices, np.roll(vertices, -1, axis=1)][: vertices.shape[1] - 1], axis=2)


def _borders(vertices: ndarray, beside: ndarray, is_sharp: ndarray) -> Pair:
    edges = np.sort(_sides_of(vertices), axis=2)
    sharp = np.unique(edges[(beside >= 0) & is_sharp], axis=0)
    single, count = np.unique(edges[beside < 0], axis=0, return_counts=True)
    return np.concatenate([sharp, single[count > 1]]), single[count == 1]


def _on_features(
    sides: ndarray, points: ndarray, is_feature: Callable[[ndarray], ndarray]
) -> ndarray:
    """Marks sides (k, c, 2) of faces of which both ends, and the middle, are on sharp edges."""
    found = np.all(is_feature(points)[sides], axis=2)
    found[found] = is_feature(points[sides[found]].mean(axis=1))
    return found


def _split(vertices: ndarray, beside: ndarray, is_smooth: ndarray) -> Pair:
    # Two faces share a corner where they meet smoothly; corners that hang together are one vertex.
    face, edge = np.nonzero(is_smooth)
    other = beside[face, edge]
    pairs = []
    for nodes in _sides_of(vertices)[face, edge].T:
        for rows in (face, other):
            column = np.argmax(vertices[rows] == nodes[:, None], axis=1)
            pairs.append(rows * vertices.shape[1] + column)
    first = np.concatenate(pairs[::2])
    second = np.concatenate(pairs[1::2])
    number = parts_of(first, second, vertices.size)
    origins = np.zeros(number.max() + 1, int)
    origins[number] = vertices.ravel()
    return number.reshape(vertices.shape), origins
