"""Skewness, aspect ratio and non-orthogonality from the faces of cells, as OpenFOAM's checkMesh measures them."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.pairs import columns_of, sorted_columns, twins
from .._host.topology import CORNERS, DIMENSION, FACES
from .._mesh.mesh import Mesh
from .._mesh.polyhedra import Polyhedra

Vectors = Float[np.ndarray, "t d"]
Centres = Float[np.ndarray, "cells d"]
FLOOR = 1e-300


@dataclasses.dataclass(frozen=True, eq=False)
class FaceQuality:
    """Measures (k,) of each cell by its faces, in the order of the mesh's cells; faces are edges in 2-D.

    - `skewness`: the distance by which the line between the centres of two cells misses the centre of their face, over the
      face's reach in that direction. It has no upper bound. The reach is at least 0.2 of the line's length; at the boundary
      0.4 of the distance from the cell's centre to the plane of the face.
    - `aspect_ratio`: the faces' areas are summed as seen along each axis; the largest sum over the smallest. In 3-D it is at
      least a sixth of the sums' total over the volume to the power of 2/3. It depends on how a cell lies in the axes.
    - `non_orthogonality`: in degrees, the largest over the inner faces.

    Each piece of a polyhedron has the value of the whole. Boundary elements have 0, and aspect ratio 1.
    """

    skewness: Float[np.ndarray, " k"]
    aspect_ratio: Float[np.ndarray, " k"]
    non_orthogonality: Float[np.ndarray, " k"]


def face_quality(mesh: Mesh, points: Float[Any, "n d"] | None = None) -> FaceQuality:
    """Measures cells by their faces on the host, as OpenFOAM's checkMesh does.

    `quality` has the measures that are traced; of polyhedra it sees the pieces, this the whole. Where no cell is a polyhedron and
    faces are flat, both have one non-orthogonality.

    **Arguments:**

    - `mesh`: cells that fill a region in 2-D or 3-D.
    - `points`: where the nodes are (n, d); None for where the mesh has them.

    **Returns:** a `FaceQuality`.

    **Raises:** `ValueError` for a mesh without cells, for surfaces in 3-D, and for another shape of `points`.
    """
    points = np.asarray(mesh.points if points is None else points, dtype=float)
    if points.shape != tuple(mesh.points.shape):
        raise ValueError(f"`points` has shape {points.shape}; this mesh has {tuple(mesh.points.shape)}.")
    if not any(len(ids) for ids in mesh.cells.values()):
        raise ValueError("the mesh has no cells; its quality is not defined.")
    sides = _standard(mesh) if mesh.polyhedra is None else _whole(mesh.polyhedra)
    if sides.faces.shape[1] < points.shape[1] + (points.shape[1] == 3):
        raise ValueError(
            "OpenFOAM's measures are for meshes that fill a region in 2-D or 3-D, not for surfaces in 3-D."
        )
    corners = sides.corners(points)
    centre, area = _edges(corners) if points.shape[1] == 2 else _polygons(corners, sides.faces >= 0)
    middle, volume = _cell_centres(centre, area, sides)
    return FaceQuality(
        _skewness(sides, corners, centre, area, middle),
        _aspect_ratio(sides, area, volume),
        _non_orthogonality(sides, area, middle),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Sides:
    """Corners of each face of each cell (-1 behind the last), its cell, the same face as its other cell sees it (-1 if none).

    `total` is the number of cells; those of the mesh are `cell` among them.
    """

    faces: Int[np.ndarray, "t c"]
    owner: Int[np.ndarray, " t"]
    behind: Int[np.ndarray, " t"]
    total: int
    cell: Int[np.ndarray, " k"]

    def corners(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "t c d"]:
        """Gathers the coordinates of each side's corners; the first again behind the last."""
        return points[np.where(self.faces < 0, self.faces[:, :1], self.faces)]

    def largest(self, values: Float[np.ndarray, " t"]) -> Float[np.ndarray, " k"]:
        """Takes the largest value over the faces of each cell, at least 0."""
        result = np.zeros(self.total)
        np.maximum.at(result, self.owner, values)
        return result[self.cell]


def _skewness(
    sides: _Sides, corners: Float[np.ndarray, "t c d"], centre: Vectors, area: Vectors, middle: Centres
) -> Float[np.ndarray, " k"]:
    arm = centre - middle[sides.owner]
    inside = sides.behind >= 0
    normal = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), FLOOR)
    across = np.where(inside[:, None], _between(middle, sides), normal * _dot(normal, arm)[:, None])
    along = _dot(area, across)
    along = np.where(along == 0, FLOOR, along)
    by = arm - (_dot(area, arm) / along)[:, None] * across
    size = np.linalg.norm(by, axis=1)
    direction = by / np.maximum(size, FLOOR)[:, None]
    reach = np.abs(np.einsum("td,tcd->tc", direction, corners - centre[:, None])).max(axis=1)
    least = np.where(inside, 0.2, 0.4) * np.linalg.norm(across, axis=1)
    return sides.largest(size / np.maximum(np.maximum(reach, least), FLOOR))


def _aspect_ratio(sides: _Sides, area: Vectors, volume: Float[np.ndarray, " cells"]) -> Float[np.ndarray, " k"]:
    seen = _summed(np.abs(area), sides.owner, sides.total)
    counted = np.bincount(sides.owner, minlength=sides.total) > 0
    ratio = seen.max(axis=1) / np.maximum(seen.min(axis=1), FLOOR)
    if area.shape[1] == 3:
        ratio = np.maximum(ratio, seen.sum(axis=1) / 6 / np.maximum(np.abs(volume) / 3, FLOOR) ** (2 / 3))
    return np.where(counted, ratio, 1.0)[sides.cell]


def _non_orthogonality(sides: _Sides, area: Vectors, middle: Centres) -> Float[np.ndarray, " k"]:
    between = _between(middle, sides)
    sizes = np.linalg.norm(area, axis=1) * np.linalg.norm(between, axis=1)
    cosine = np.clip(_dot(area, between) / np.maximum(sizes, FLOOR), -1, 1)
    return sides.largest(np.where(sides.behind >= 0, np.degrees(np.arccos(cosine)), 0))


def _standard(mesh: Mesh) -> _Sides:
    """Lists the sides of the cells of the highest dimension."""
    highest = max(DIMENSION[kind] for kind, ids in mesh.cells.items() if len(ids))
    width = 2 if highest == 2 else max(CORNERS["quad"], highest)
    faces, owners, first = [np.zeros((0, width), np.int64)], [np.zeros(0, np.int64)], 0
    for kind, ids in mesh.cells.items():
        if DIMENSION[kind] == highest:
            for face in FACES[kind]:
                padded = np.full((len(ids), width), -1)
                padded[:, : len(face)] = np.asarray(ids)[:, face]
                faces.append(padded)
                owners.append(first + np.arange(len(ids)))
        first += len(ids)
    joined = np.concatenate(faces)
    return _Sides(
        joined, np.concatenate(owners), twins(sorted_columns(columns_of(joined), width)), first, np.arange(first)
    )


def _whole(whole: Polyhedra) -> _Sides:
    """Lists the sides of whole polyhedra: faces as their owners see them, then the inner ones as their neighbours do."""
    faces = whole.faces
    count, inner = len(faces.owner), np.flatnonzero(faces.neighbour >= 0)
    signed = np.concatenate([np.arange(count), ~inner])
    sizes = np.concatenate([faces.sizes, faces.sizes[inner]])
    corners = np.full((len(signed), max(4, int(sizes.max()))), -1)
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        corners[rows, :size] = faces.corners(signed[rows], size)
    behind = np.full(len(signed), -1)
    behind[inner], behind[count:] = count + np.arange(len(inner)), inner
    owner = np.concatenate([faces.owner, faces.neighbour[inner]])
    return _Sides(corners, owner, behind, int(owner.max()) + 1, whole.cell)


def _between(centres: Centres, sides: _Sides) -> Vectors:
    """Computes the vector from the centre of each face's cell to that of the cell behind it; anything where there is none."""
    return centres[sides.owner[sides.behind]] - centres[sides.owner]


def _edges(corners: Float[np.ndarray, "t 2 2"]) -> tuple[Vectors, Vectors]:
    along = corners[:, 1] - corners[:, 0]
    return corners.mean(axis=1), np.stack([along[:, 1], -along[:, 0]], axis=1)


def _polygons(corners: Float[np.ndarray, "t c 3"], is_corner: Bool[np.ndarray, "t c"]) -> tuple[Vectors, Vectors]:
    """Computes centres and area vectors, by triangles about the mean of the corners."""
    share = is_corner[..., None] / is_corner.sum(axis=1)[:, None, None]
    middle = (share * corners).sum(axis=1, keepdims=True)
    after = np.roll(corners, -1, axis=1)
    areas = np.cross(after - corners, middle - corners) / 2
    weights = np.linalg.norm(areas, axis=2, keepdims=True)
    total = np.maximum(weights.sum(axis=1), FLOOR)
    return (weights * (corners + after + middle) / 3).sum(axis=1) / total, areas.sum(axis=1)


def _cell_centres(centre: Vectors, area: Vectors, sides: _Sides) -> tuple[Centres, np.ndarray]:
    """Computes centres of mass, and volumes times d, by pyramids (triangles in 2-D) from faces to the mean of their centres."""
    d, owner, total = centre.shape[1], sides.owner, sides.total
    count = np.maximum(np.bincount(owner, minlength=total), 1)[:, None]
    middle = (_summed(centre, owner, total) / count)[owner]
    volume = _dot(area, centre - middle)[:, None]
    moments = _summed(volume * (d * centre + middle) / (d + 1), owner, total)
    volumes = _summed(volume, owner, total)
    return moments / np.where(volumes == 0, FLOOR, volumes), volumes[:, 0]


def _summed(values: Float[np.ndarray, "t k"], owner: Int[np.ndarray, " t"], total: int) -> Float[np.ndarray, "c k"]:
    return np.stack([np.bincount(owner, column, minlength=total) for column in values.T], axis=1)


def _dot(a: Vectors, b: Vectors) -> Float[np.ndarray, " t"]:
    return np.einsum("td,td->t", a, b)
