"""Quality of cells from their faces, as OpenFOAM's checkMesh measures it."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._host.cells.adjacency import handedness, neighbours
from .._host.linear.products import cross, dot
from .._host.package.arguments import checked
from .._mesh.mesh import Mesh
from .report import Report
from .sides import Block, Group, Sides

Columns = Any
"""Components of vectors: a sequence of columns, or an array whose first axis runs over them."""

FLOOR = 1e-300
"""Least number by which anything is divided."""

MEASURES = ("skewness", "aspect_ratio", "non_orthogonality", "volume", "pyramid", "volume_ratio")


@dataclasses.dataclass(frozen=True, eq=False)
class FaceQuality(Report):
    """Measures (k,) of each cell by its faces; faces are edges in 2-D.

    The cells are the file's cells, polyhedra and polygons whole, in the file's order: see
    `Mesh.cell_ids`.

    - `volume`: the sum of the pyramids between the faces and a point inside; in 2-D the area.
    - `pyramid`: the smallest pyramid between a face and the cell's centre, over the mean of them. 1
      for a regular cell, negative where a face is seen from behind. In 2-D a triangle.
    - `is_inverted`: the volume or a pyramid is negative beyond round-off, as checkMesh tests cells
      of finite volumes. NaN counts. Cells that the mesh numbers the other way round are turned
      first, as `quality(mesh)` does; not in a part of a mesh.
    - `skewness`: the distance by which the line between the centres of two cells misses the centre
      of their face, over the face's reach in that direction. It has no upper bound. The reach is at
      least 0.2 of the line's length; at the boundary 0.4 of the distance from the cell's centre to
      the plane of the face. Faces to other parts (`Mesh.between`) do not count.
    - `aspect_ratio`: the faces' areas are summed as seen along each axis; the largest sum over the
      smallest. In 3-D it is at least a sixth of the sums' total over the volume to the power of
      2/3. It depends on how a cell lies in the axes.
    - `non_orthogonality`: in degrees, the largest over the inner faces.
    - `centroid`: the centre of mass (k, d).
    - `counted`: False for boundary elements. They have 0, and aspect ratio, pyramid and volume
      ratio 1.
    - `volume_ratio`: volume over undeformed volume; 1 where that was zero.

    `mean_non_orthogonality` is checkMesh's average, one number: the angle whose cosine is the mean
    of the inner faces' cosines. `min`, `mean`, `max` of a measure, `worst` and `raise_if_inverted`
    are as in `QualityReport`, over the cells that count. Other means are weighted by volume.
    `str(measured)` is a table.
    """

    rule: ClassVar[str] = "volumes and face pyramids"
    measures: ClassVar[tuple[str, ...]] = MEASURES
    rank: ClassVar[str] = "pyramid"

    volume: Float[np.ndarray, " k"]
    pyramid: Float[np.ndarray, " k"]
    is_inverted: Bool[np.ndarray, " k"]
    skewness: Float[np.ndarray, " k"]
    aspect_ratio: Float[np.ndarray, " k"]
    non_orthogonality: Float[np.ndarray, " k"]
    centroid: Float[np.ndarray, "k d"]
    counted: Bool[np.ndarray, " k"]
    mean_non_orthogonality: float
    volume_ratio: Float[np.ndarray, " k"]

    @checked
    def mean(self, name: str, *, weighted: bool = True) -> float:
        """Averages a measure by area or volume; non-orthogonality as checkMesh does."""
        is_of_faces = name == "non_orthogonality" and weighted
        return self.mean_non_orthogonality if is_of_faces else super().mean(name, weighted=weighted)

    def __repr__(self) -> str:
        return f"FaceQuality({self.count} cells)"

    def __str__(self) -> str:
        return self._table(f"{self.count} cells: {self.inverted} inverted", MEASURES[:-1])


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


def fill(block: Block, centre: Columns, area: Columns, points: Columns) -> None:
    """Computes the rows of a block: centres and area vectors (d, f) of faces."""
    x = _corners(points, block)
    centre[:, block.rows], area[:, block.rows] = _edge(x) if len(points) == 2 else _polygon(x)


def pyramids(block: Block, centres: Columns, areas: Columns, means: Columns) -> list[tuple[Columns, Columns]]:
    """Computes d volumes (b,) and first moments (d, b) of pyramids, as each view sees the faces."""
    d, parts = len(means), []
    centre, area = centres[:, block.rows], areas[:, block.rows]
    for sign, cells in block.views:
        middle = [mean.take(cells) for mean in means]
        volume = sign * dot(area, [c - m for c, m in zip(centre, middle, strict=True)])
        share = volume / (d + 1)
        parts.append((volume, [share * (d * c + m) for c, m in zip(centre, middle, strict=True)]))
    return parts


class OfFaces(NamedTuple):
    """Holds measures of a block of faces, and the heights of cells' middles below them, by view."""

    size: np.ndarray
    skewness: np.ndarray
    cosine: np.ndarray
    cosines: np.ndarray
    area: np.ndarray
    heights: list[np.ndarray]


def of_faces(block: Block, centres: Columns, areas: Columns, middle: Columns, points: Columns) -> OfFaces:
    centre, area = centres[:, block.rows], areas[:, block.rows]
    skewness, cosine = _across(block, centre, area, middle, points)
    inner = cosine[block.behind >= 0]
    heights = [sign * dot(area, _arm(centre, middle, cells)) for sign, cells in block.views]
    return OfFaces(_size(area), skewness, cosine, np.array([inner.sum(), len(inner)]), np.abs(area), heights)


def _across(
    block: Block, centre: Columns, area: Columns, middle: Columns, points: Columns
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"]]:
    owner, behind = block.owner, block.behind
    arm, size = _arm(centre, middle, owner), _size(area)
    across = [m.take(behind) - m.take(owner) for m in middle]  # anything where there is no cell behind
    cosine = np.clip(dot(area, across) / np.maximum(size * _size(across), FLOOR), -1, 1)
    inside = True
    if not block.is_shared:
        inside = behind >= 0
        cosine = np.where(inside, cosine, 1)
        normal = [a / np.maximum(size, FLOOR) for a in area]
        height = dot(normal, arm)
        across = [np.where(inside, a, height * n) for a, n in zip(across, normal, strict=True)]
    along = dot(area, across)
    share = dot(area, arm) / np.where(along == 0, FLOOR, along)
    by = [a - share * b for a, b in zip(arm, across, strict=True)]
    miss = _size(by)
    corners, reach = _corners(points, block), 0.0
    for k in range(len(block.group.corners)):
        arms = [x[k] - c for x, c in zip(corners, centre, strict=True)]
        reach = np.maximum(reach, np.abs(dot(by, arms)))
    least = np.where(inside, 0.2, 0.4) * _size(across)
    skewness = miss / np.maximum(np.maximum(reach / np.maximum(miss, FLOOR), least), FLOOR)
    return np.where(block.group.is_between[block.rows], 0, skewness), cosine


def _arm(centre: Columns, middle: Columns, cells: np.ndarray) -> Columns:
    return [c - m.take(cells) for c, m in zip(centre, middle, strict=True)]


def _size(vectors: Columns) -> Float[np.ndarray, " b"]:
    return np.sqrt(dot(vectors, vectors))


def _corners(points: Columns, block: Block) -> list[list[Float[np.ndarray, " b"]]]:
    """Gathers the coordinates of the faces' corners: by axis, then by corner."""
    corners = block.corners
    return [[column.take(ids) for ids in corners] for column in points]


def _edge(x: Sequence[Columns]) -> tuple[Columns, Columns]:
    """Computes the middles of edges, and their area vectors: as long as the edge."""
    along = [last - first for first, last in x]
    return [(first + last) / 2 for first, last in x], [along[1], -along[0]]


def _polygon(x: Sequence[Columns]) -> tuple[Columns, Columns]:
    """Computes centres and area vectors, by triangles about the mean of the corners."""
    count, mean = len(x[0]), [sum(corners) / len(corners) for corners in x]
    arms = [[m - corners[k] for m, corners in zip(mean, x, strict=True)] for k in range(count)]
    area, moment, total = [0.0] * 3, [0.0] * 3, FLOOR
    for k, arm in enumerate(arms):
        after = arms[(k + 1) % count]
        normal = cross(arm, after)
        weight = _size(normal)
        total = total + weight
        area = [a + n for a, n in zip(area, normal, strict=True)]
        moment = [m + weight * (a + b) for m, a, b in zip(moment, arm, after, strict=True)]
    return [m - first / (3 * total) for m, first in zip(mean, moment, strict=True)], [a / 2 for a in area]
