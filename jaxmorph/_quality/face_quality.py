"""Quality of cells from their faces, as OpenFOAM's checkMesh measures it."""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Float

from .._host.cells.adjacency import handedness, neighbours
from .._host.package.arguments import checked
from .._mesh.mesh import Mesh
from .block_measures import FLOOR, fill, of_faces, pyramids
from .face_report import FaceQuality
from .sides import Group, Sides


@checked
def face_quality(mesh: Mesh, points: Float[Any, "n d"] | None = None) -> FaceQuality:
    """Measures cells by their faces on the host, as OpenFOAM's checkMesh does.

    `quality` has the measures that are traced; of polyhedra it sees the pieces, this the whole.
    Where no cell is a polyhedron and faces are flat, both have one non-orthogonality. What is an
    inverted cell differs: `quality` takes the Jacobians at the corners, as finite elements need
    them, this the volumes and the pyramids of faces, as finite volumes do.

    **Arguments:**

    - `mesh`: cells that fill a region in 2-D or 3-D.
    - `points`: where the nodes are (n, d); None for where the mesh has them.

    **Returns:** a `FaceQuality`.

    **Raises:** `ValueError` for a mesh without cells, for surfaces in 3-D, and for another shape of
    `points`.
    """
    return measured(mesh, Sides.listed(mesh), points)


def measured(
    mesh: Mesh, sides: Sides, points: Float[Any, "n d"] | None, undeformed: FaceQuality | None = None
) -> FaceQuality:
    """Measures cells as `face_quality` does, with `sides` and `undeformed` quality found before."""
    points = np.asarray(mesh.points if points is None else points, dtype=float)
    if points.shape != tuple(mesh.points.shape):
        raise ValueError(f"`points` has shape {points.shape}; this mesh has {tuple(mesh.points.shape)}.")
    is_turned = mesh.polyhedra is None and mesh.between is None
    with np.errstate(all="ignore"):  # points may be NaN
        shape, base = _Shape.measured(sides, points), np.asarray(mesh.points, dtype=float)
        if np.array_equal(points, base):
            old = shape.volume.copy()
        elif undeformed is None or is_turned:
            old = _Shape.measured(sides, base).volume
        else:
            old = undeformed.volume * points.shape[1]
        if is_turned:
            sign = _turns(mesh, old)
            shape.turn(sign)
            old = old if sign is None else old * sign
        return _of_shape(sides, shape, points, old)


@dataclasses.dataclass(eq=False)
class _Shape:
    """Faces of groups with centres and area vectors (d, f), middles of cells, d volumes (k,)."""

    faces: list[tuple[Group, np.ndarray, np.ndarray]]
    middle: Float[np.ndarray, "d k"]
    volume: Float[np.ndarray, " k"]

    @classmethod
    def measured(cls, sides: Sides, points: Float[np.ndarray, "n d"]) -> "_Shape":
        """Measures by pyramids (triangles in 2-D) from faces to the mean of their centres."""
        d, columns = points.shape[1], np.ascontiguousarray(points.T)
        faces, sums = [], np.zeros((d, sides.total))
        for group in sides.groups:
            centre, area = np.empty((2, d, len(group.owner)))
            for block, _ in group.measured(functools.partial(fill, centre=centre, area=area, points=columns)):
                for _, cells in block.views:
                    for total, component in zip(sums, centre[:, block.rows], strict=True):
                        np.add.at(total, cells, component)
            faces.append((group, centre, area))
        sums /= np.maximum(sides.counts, 1)
        moments, volumes = np.zeros_like(sums), np.zeros(sides.total)
        for group, centres, areas in faces:
            measure = functools.partial(pyramids, centres=centres, areas=areas, means=sums)
            for block, parts in group.measured(measure):
                for (_, cells), (volume, first) in zip(block.views, parts, strict=True):
                    np.add.at(volumes, cells, volume)
                    for total, component in zip(moments, first, strict=True):
                        np.add.at(total, cells, component)
        moments /= np.where(volumes == 0, FLOOR, volumes)
        return cls(faces, moments, volumes)

    def turn(self, sign: Float[np.ndarray, " k"] | None) -> None:
        """Turns the faces and volumes of cells by their sign."""
        if sign is not None:
            self.volume *= sign
            for group, _, area in self.faces:
                area *= sign[group.owner]


def _of_shape(
    sides: Sides, shape: _Shape, points: Float[np.ndarray, "n d"], old: Float[np.ndarray, " k"]
) -> FaceQuality:
    """Makes the report of a shape; `old` are the undeformed volumes, times `d`."""
    columns, (d, total) = np.ascontiguousarray(points.T), shape.middle.shape
    counts, noise = sides.counts, 8 * np.finfo(float).eps * np.abs(points).max()
    is_wrong, cosine, skewness = np.zeros(total, dtype=bool), np.ones(total), np.zeros(total)
    least, heights, seen = np.full(total, np.inf), np.zeros(total), np.zeros((d, total))
    cosines = np.zeros(2)  # their sum and their number
    for group, centres, areas in shape.faces:
        measure = functools.partial(of_faces, centres=centres, areas=areas, middle=shape.middle, points=columns)
        for block, found in group.measured(measure):
            cosines += len(block.views) * found.cosines
            for (_, cells), height in zip(block.views, found.heights, strict=True):
                is_wrong[cells[~(height >= -noise * found.size)]] = True
                np.minimum.at(least, cells, height)
                np.add.at(heights, cells, np.abs(height))
                np.minimum.at(cosine, cells, found.cosine)
                np.maximum.at(skewness, cells, found.skewness)
                for column, component in zip(seen, found.area, strict=True):
                    np.add.at(column, cells, component)
    counted = counts > 0
    pyramid = least / np.maximum(heights / np.maximum(counts, 1), FLOOR)
    return FaceQuality(
        shape.volume / d,
        np.where(counted, pyramid, 1.0),
        counted & (~(shape.volume > 0) | is_wrong),
        skewness,
        np.where(counted, _aspect_ratio(seen, shape.volume), 1.0),
        np.degrees(np.arccos(cosine)),
        shape.middle.T.copy(),
        counted,
        float(np.degrees(np.arccos(np.clip(cosines[0] / cosines[1], -1, 1)))) if cosines[1] else 0.0,
        np.where(old == 0, 1.0, shape.volume / np.where(old == 0, 1.0, old)),
    )


def _aspect_ratio(seen: Float[np.ndarray, "d k"], volume: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    ratio = seen.max(axis=0) / np.maximum(seen.min(axis=0), FLOOR)
    if len(seen) == 2:
        return ratio
    return np.maximum(ratio, seen.sum(axis=0) / 6 / np.maximum(np.abs(volume) / 3, FLOOR) ** (2 / 3))


def _turns(mesh: Mesh, volume: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"] | None:
    """Finds the sign that makes the undeformed volumes positive.

    It follows from neighbours, and from the volume that they enclose.

    None where all are. A motion that turns a part of the mesh inside out leaves no neighbour to
    tell so.
    """
    if not (volume < 0).any():
        return None
    turn = np.ones(len(volume))
    cells = {kind: np.asarray(corners) for kind, corners in mesh.cells.items()}
    sign, part = handedness(cells, *neighbours(cells))
    sign, part, ids = np.asarray(sign), np.asarray(part), mesh.cell_ids
    enclosed = np.bincount(part, sign * volume[ids])
    turn[ids] = sign * np.where(enclosed < 0, -1, 1)[part]
    return turn
