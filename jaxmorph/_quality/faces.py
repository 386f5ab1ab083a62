"""Volumes, pyramids, skewness, aspect ratio and non-orthogonality from the faces of cells, as OpenFOAM's checkMesh has them."""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.adjacency import handedness, neighbours
from .._host.door import checked
from .._host.pairs import columns_of, is_among, sorted_columns, twins
from .._host.topology import CORNERS, DIMENSION, FACES
from .._mesh.faces import Faces
from .._mesh.mesh import Mesh

Vectors = Float[np.ndarray, "t d"]
Centres = Float[np.ndarray, "cells d"]
FLOOR = 1e-300


@dataclasses.dataclass(frozen=True, eq=False)
class FaceQuality:
    """Measures (k,) of each cell by its faces; faces are edges in 2-D.

    The cells are those of the file, polyhedra and polygons whole, in the file's order: see `Mesh.cell_ids`.

    - `volume`: the sum of the pyramids between the faces and a point inside; in 2-D the area.
    - `pyramid`: the smallest pyramid between a face and the cell's centre, over the mean of them. 1 for a regular cell, negative
      where a face is seen from behind. In 2-D a triangle.
    - `is_inverted`: the volume or a pyramid is negative beyond round-off, as checkMesh tests cells of finite volumes. NaN counts.
      Cells that the mesh numbers the other way round are turned first, as `quality(mesh)` does; not in a part of a mesh.
    - `skewness`: the distance by which the line between the centres of two cells misses the centre of their face, over the
      face's reach in that direction. It has no upper bound. The reach is at least 0.2 of the line's length; at the boundary
      0.4 of the distance from the cell's centre to the plane of the face. Faces to other parts (`Mesh.between`) do not count.
    - `aspect_ratio`: the faces' areas are summed as seen along each axis; the largest sum over the smallest. In 3-D it is at
      least a sixth of the sums' total over the volume to the power of 2/3. It depends on how a cell lies in the axes.
    - `non_orthogonality`: in degrees, the largest over the inner faces.
    - `centroid`: the centre of mass (k, d).
    - `counted`: False for boundary elements. They have 0, and aspect ratio and pyramid 1.

    `mean_non_orthogonality` is checkMesh's average, one number: the angle whose cosine is the mean of the inner faces' cosines.
    """

    volume: Float[np.ndarray, " k"]
    pyramid: Float[np.ndarray, " k"]
    is_inverted: Bool[np.ndarray, " k"]
    skewness: Float[np.ndarray, " k"]
    aspect_ratio: Float[np.ndarray, " k"]
    non_orthogonality: Float[np.ndarray, " k"]
    centroid: Float[np.ndarray, "k d"]
    counted: Bool[np.ndarray, " k"]
    mean_non_orthogonality: float


@checked
def face_quality(mesh: Mesh, points: Float[Any, "n d"] | None = None) -> FaceQuality:
    """Measures cells by their faces on the host, as OpenFOAM's checkMesh does.

    `quality` has the measures that are traced; of polyhedra it sees the pieces, this the whole. Where no cell is a polyhedron and
    faces are flat, both have one non-orthogonality. What is an inverted cell differs: `quality` takes the Jacobians at the
    corners, as finite elements need them, this the volumes and the pyramids of faces, as finite volumes do.

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
    sides = _standard(mesh) if mesh.polyhedra is None else _whole(mesh, mesh.polyhedra.faces)
    if sides.faces.shape[1] < points.shape[1] + (points.shape[1] == 3):
        raise ValueError(
            "OpenFOAM's measures are for meshes that fill a region in 2-D or 3-D, not for surfaces in 3-D."
        )
    with np.errstate(all="ignore"):  # points may be NaN
        return _measured(mesh, sides, points)


def _measured(mesh: Mesh, sides: "_Sides", points: Float[np.ndarray, "n d"]) -> FaceQuality:
    corners = sides.corners(points)
    centre, area = _edges(corners) if points.shape[1] == 2 else _polygons(corners, sides.faces >= 0)
    middle, volume = _cell_centres(centre, area, sides)
    if mesh.polyhedra is None and mesh.between is None:
        turn = _turns(mesh, sides, points, volume)
        area, volume = area * turn[sides.owner][:, None], volume * turn
    cosine = _cosines(sides, area, middle)
    inner = cosine[sides.behind >= 0]
    average = float(np.degrees(np.arccos(np.clip(inner.mean(), -1, 1)))) if len(inner) else 0.0
    angles = sides.largest(np.where(sides.behind >= 0, np.degrees(np.arccos(cosine)), 0))
    pyramid, is_wrong = _pyramids(sides, points, centre, area, middle)
    return FaceQuality(
        volume / points.shape[1],
        pyramid,
        sides.counted & (~(volume > 0) | is_wrong),
        _skewness(sides, corners, centre, area, middle),
        _aspect_ratio(sides, area, volume),
        angles,
        middle,
        sides.counted,
        average,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Sides:
    """Corners of each face of each cell (-1 behind the last), its cell, the same face as its other cell sees it (-1 if none).

    `total` is the number of cells, and `is_between` marks faces to other parts of the mesh.
    """

    faces: Int[np.ndarray, "t c"]
    owner: Int[np.ndarray, " t"]
    behind: Int[np.ndarray, " t"]
    total: int
    is_between: Bool[np.ndarray, " t"]

    @functools.cached_property
    def counts(self) -> Int[np.ndarray, " k"]:
        """Number of faces of each cell."""
        return np.bincount(self.owner, minlength=self.total)

    @property
    def counted(self) -> Bool[np.ndarray, " k"]:
        return self.counts > 0

    def corners(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "t c d"]:
        """Gathers the coordinates of each side's corners; the first again behind the last."""
        return points[np.where(self.faces < 0, self.faces[:, :1], self.faces)]

    def largest(self, values: Float[np.ndarray, " t"], start: float = 0.0) -> Float[np.ndarray, " k"]:
        """Takes the largest value over the faces of each cell, at least `start`."""
        result = np.full(self.total, start)
        np.maximum.at(result, self.owner, values)
        return result


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
    return sides.largest(np.where(sides.is_between, 0, size / np.maximum(np.maximum(reach, least), FLOOR)))


def _aspect_ratio(sides: _Sides, area: Vectors, volume: Float[np.ndarray, " cells"]) -> Float[np.ndarray, " k"]:
    seen = _summed(np.abs(area), sides.owner, sides.total)
    ratio = seen.max(axis=1) / np.maximum(seen.min(axis=1), FLOOR)
    if area.shape[1] == 3:
        ratio = np.maximum(ratio, seen.sum(axis=1) / 6 / np.maximum(np.abs(volume) / 3, FLOOR) ** (2 / 3))
    return np.where(sides.counted, ratio, 1.0)


def _cosines(sides: _Sides, area: Vectors, middle: Centres) -> Float[np.ndarray, " t"]:
    """Computes the cosine of the angle between each face's area vector and the line to the centre of the cell behind it."""
    between = _between(middle, sides)
    sizes = np.linalg.norm(area, axis=1) * np.linalg.norm(between, axis=1)
    return np.clip(_dot(area, between) / np.maximum(sizes, FLOOR), -1, 1)


def _pyramids(
    sides: _Sides, points: Float[np.ndarray, "n d"], centre: Vectors, area: Vectors, middle: Centres
) -> tuple[Float[np.ndarray, " k"], Bool[np.ndarray, " k"]]:
    """Finds the smallest pyramid of each cell over the mean one, and the cells with one that is negative beyond round-off."""
    height = _dot(area, centre - middle[sides.owner])
    noise = 8 * np.finfo(float).eps * np.abs(points).max() * np.linalg.norm(area, axis=1)
    is_wrong = np.bincount(sides.owner, ~(height >= -noise), minlength=sides.total) > 0
    least = -sides.largest(-height, start=-np.inf)
    mean = np.bincount(sides.owner, np.abs(height), minlength=sides.total) / np.maximum(sides.counts, 1)
    return np.where(sides.counted, least / np.maximum(mean, FLOOR), 1.0), is_wrong


def _turns(
    mesh: Mesh, sides: _Sides, points: Float[np.ndarray, "n d"], volume: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " k"]:
    """Finds the sign that makes cells positive where the mesh has them: by neighbours, and by the volume that they enclose.

    A motion that turns a part of the mesh inside out leaves no neighbour to tell so.
    """
    if points is not mesh.points and not np.array_equal(points, np.asarray(mesh.points)):
        corners = sides.corners(np.asarray(mesh.points, dtype=float))
        centre, area = _edges(corners) if points.shape[1] == 2 else _polygons(corners, sides.faces >= 0)
        volume = _cell_centres(centre, area, sides)[1]
    turn = np.ones(len(volume))
    if not (volume < 0).any():
        return turn
    cells = {kind: np.asarray(corners) for kind, corners in mesh.cells.items()}
    sign, part = handedness(cells, *neighbours(cells))
    sign, part, ids = np.asarray(sign), np.asarray(part), mesh.cell_ids
    enclosed = np.bincount(part, sign * volume[ids])
    turn[ids] = sign * np.where(enclosed < 0, -1, 1)[part]
    return turn


def _standard(mesh: Mesh) -> _Sides:
    """Lists the sides of the cells of the highest dimension."""
    highest = max(DIMENSION[kind] for kind, ids in mesh.cells.items() if len(ids))
    width = 2 if highest == 2 else max(CORNERS["quad"], highest)
    faces, owners, first, cell = [np.zeros((0, width), np.int64)], [np.zeros(0, np.int64)], 0, mesh.cell_ids
    for kind, ids in mesh.cells.items():
        if DIMENSION[kind] == highest:
            for face in FACES[kind]:
                padded = np.full((len(ids), width), -1)
                padded[:, : len(face)] = np.asarray(ids)[:, face]
                faces.append(padded)
                owners.append(cell[first : first + len(ids)])
        first += len(ids)
    joined = np.concatenate(faces)
    behind = twins(sorted_columns(columns_of(joined), width))
    return _Sides(joined, np.concatenate(owners), behind, first, _to_others(mesh, joined))


def _to_others(mesh: Mesh, sides: Int[np.ndarray, "t c"]) -> Bool[np.ndarray, " t"]:
    return np.zeros(len(sides), dtype=bool) if mesh.between is None else is_among(sides, mesh.between)


def _whole(mesh: Mesh, faces: Faces) -> _Sides:
    """Lists the sides of whole cells: faces as their owners see them, then the inner ones as their neighbours do."""
    count, inner = len(faces.owner), np.flatnonzero(faces.neighbour >= 0)
    signed = np.concatenate([np.arange(count), ~inner])
    sizes = np.concatenate([faces.sizes, faces.sizes[inner]])
    width = int(sizes.max())
    corners = np.full((len(signed), width if width == 2 else max(4, width)), -1)
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        corners[rows, :size] = faces.corners(signed[rows], size)
    behind = np.full(len(signed), -1)
    behind[inner], behind[count:] = count + np.arange(len(inner)), inner
    owner = np.concatenate([faces.owner, faces.neighbour[inner]])
    return _Sides(corners, owner, behind, int(owner.max()) + 1, _to_others(mesh, corners))


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
