"""Quality of cells from their faces, as checkMesh measures it; components of vectors come first."""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.cells.adjacency import columns_of, is_among
from .._host.cells.topology import DIMENSION, FACES
from .._host.linear.products import cross, dot
from .._host.package.arguments import checked
from .._host.package.cores import in_order
from .._host.tolerances import LEAST_DIVISOR
from .._mesh.faces import Faces
from .._mesh.mesh import Mesh
from .quality import signs_of
from .report import Report

FaceVectors = Float[np.ndarray, "_d _f"]
FacePoints = Float[np.ndarray, "n d"]
FaceValues = Float[np.ndarray, " k"]
FaceMask = Bool[np.ndarray, " k"]


FACE_MEASURES = (
    "skewness",
    "aspect_ratio",
    "non_orthogonality",
    "volume",
    "pyramid",
    "volume_ratio",
)


@dataclasses.dataclass(frozen=True, eq=False)
class FaceQuality(Report):
    """Measures (k,) of each cell by its faces; faces are edges in 2-D.

    The cells are those of the file in its order, polyhedra and polygons whole: see `Mesh.cell_ids`.

    - `volume`: the sum of the pyramids between the faces and a point inside; in 2-D the area.
    - `pyramid`: the smallest pyramid (2-D: triangle) between a face and the cell's centre, over
      their mean; 1 for a regular cell, negative where a face is seen from behind.
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
    of the inner faces' cosines. All else is as in `QualityReport`.
    """

    rule = "volumes and face pyramids"
    measures = FACE_MEASURES
    rank = "pyramid"

    volume: FaceValues
    pyramid: FaceValues
    is_inverted: FaceMask
    skewness: FaceValues
    aspect_ratio: FaceValues
    non_orthogonality: FaceValues
    centroid: Float[np.ndarray, "k d"]
    counted: FaceMask
    mean_non_orthogonality: float
    volume_ratio: FaceValues

    @checked
    def mean(self, name: str, *, weighted: bool = True) -> float:
        """Averages a measure by area or volume; non-orthogonality as checkMesh does."""
        is_of_faces = name == "non_orthogonality" and weighted
        return self.mean_non_orthogonality if is_of_faces else super().mean(name, weighted=weighted)

    def __repr__(self) -> str:
        return f"FaceQuality({self.count} cells)"

    def __str__(self) -> str:
        return self._table(f"{self.count} cells: {self.inverted} inverted", FACE_MEASURES[:-1])


@checked
def face_quality(mesh: Mesh, points: Float[Any, "n d"] | None = None) -> FaceQuality:
    """Measures cells by their faces on the host, as OpenFOAM's checkMesh does.

    The `mesh` fills a region in 2-D or 3-D; `points` (n, d) are by default its own. `quality` has
    the traced measures; of polyhedra it sees the pieces, this the whole. Without polyhedra and with
    flat faces, both have one non-orthogonality. Inverted cells differ: `quality` takes the
    Jacobians at the corners, for finite elements, this the volumes and the pyramids of faces, for
    finite volumes.

    **Raises:** `ValueError` for a mesh without cells, surfaces in 3-D, and another shape of
    `points`.
    """
    return measured(mesh, Sides.listed(mesh), points)


def measured(mesh: Mesh, sides: "Sides", points: Float[Any, "n d"] | None) -> FaceQuality:
    base = sides.base
    points = base if points is None else np.asarray(points, dtype=float)
    if points.shape != base.shape:
        raise ValueError(f"`points` has shape {points.shape}; this mesh has {base.shape}.")
    with np.errstate(all="ignore"):  # points may be NaN
        shape = _shape_of(sides, points)
        if np.array_equal(points, base):
            vars(sides)["volume"] = shape.volume  # the property's value
        old = sides.volume
        if mesh.polyhedra is None and mesh.between is None and (old < 0).any():
            # makes undeformed volumes positive, by neighbours: a motion may turn a part inside out
            sign = np.ones(len(old))
            sign[mesh.cell_ids] = np.concatenate(list(signs_of(mesh).values()))
            for block in sides.blocks:
                shape.area[:, block.rows] *= sign[block.owner]
            old = sign * old
            shape = shape._replace(volume=sign * shape.volume)
        return _quality_of(sides, shape, points, old)


Result = TypeVar("Result")
Cells = Int[np.ndarray, " b"]

FACES_AT_ONCE = 1 << 14  # faces in a block: their columns stay in a core's cache


class _Faces(NamedTuple):
    """Faces with equal numbers of corners, and the cells beside them, as in `FaceBlock`."""

    corners: Int[np.ndarray, "c f"]
    owner: Int[np.ndarray, " f"]
    behind: Int[np.ndarray, " f"]
    is_shared: Bool[np.ndarray, " f"]


@dataclasses.dataclass(frozen=True, eq=False)
class FaceBlock:
    """Some faces with equal numbers of corners: edges have two.

    - `corners`: node ids (c, b), in the sense in which the owner sees the face from outside.
    - `owner`, `behind`: the cells (b,) beside the face; `behind` is -1 where there is none.
    - `is_between`: marks (b,) faces to other parts of the mesh.
    - `is_shared`: the faces stand for both cells. Others stand for their owner: outer faces, and
      pairs of which one is not its partner seen from behind.
    - `rows`: numbers of the faces.
    """

    corners: Int[np.ndarray, "c b"]
    owner: Cells
    behind: Cells
    is_between: Bool[np.ndarray, " b"]
    is_shared: bool
    rows: slice

    @property
    def views(self) -> tuple[tuple[int, Cells], ...]:
        """The cells that the faces stand for: 1 with the owners, and -1 with the cells behind."""
        views = (1, self.owner.astype(np.intp)), (-1, self.behind.astype(np.intp))
        return views if self.is_shared else views[:1]


@dataclasses.dataclass(frozen=True, eq=False)
class Sides:
    """The faces of `total` cells of a mesh, and its undeformed points (n, d)."""

    blocks: tuple[FaceBlock, ...]
    total: int
    base: FacePoints

    @classmethod
    def listed(cls, mesh: Mesh) -> "Sides":
        """Lists the faces of the cells of the highest dimension, polyhedra and polygons whole.
        Raises `ValueError` for a mesh without cells, or whose cells do not fill its dimension.
        """
        if mesh.is_curved:
            raise ValueError(
                "OpenFOAM's measures are for linear cells; `quality` measures curved cells."
            )
        highest = max((DIMENSION[kind] for kind, ids in mesh.cells.items() if len(ids)), default=0)
        if not highest:
            raise ValueError("the mesh has no cells; its quality is not defined.")
        if highest != mesh.points.shape[1]:
            raise ValueError(
                "OpenFOAM's measures are for meshes that fill a region in 2-D or 3-D, not for "
                "surfaces in 3-D."
            )
        if mesh.polyhedra is None:
            groups = _faces_of_types(mesh)
            total = sum(map(len, mesh.cells.values()))
        else:
            groups = _faces_of_polyhedra(mesh.polyhedra.faces)
            total = mesh.polyhedra.faces.count
        base = np.asarray(mesh.points, dtype=float)
        return cls(tuple(_cut_into_blocks(groups, mesh.between)), total, base)

    @functools.cached_property
    def volume(self) -> FaceValues:
        """The cells' volumes on the undeformed mesh, times its dimension."""
        return _shape_of(self, self.base).volume

    def map(self, function: Callable[[FaceBlock], Result]) -> Iterator[tuple[FaceBlock, Result]]:
        """Yields all blocks in order, each with its `function`, which all cores compute."""
        return in_order(lambda block: (block, function(block)), self.blocks)

    @functools.cached_property
    def counts(self) -> Int[np.ndarray, " k"]:
        counts = np.zeros(self.total, int)
        for block in self.blocks:
            for _, cells in block.views:
                np.add.at(counts, cells, 1)
        return counts


def _faces_of_types(mesh: Mesh) -> Iterator[_Faces]:
    """Lists each inner face once, with the first of its two cells, and each outer face."""
    neighbour, is_turned = mesh.topology.neighbours
    numbers = np.append(mesh.cell_ids, -1).astype(np.int32)  # -1, for none, is the last
    parts: dict[int, list[_Faces]] = {}
    cells = 0
    sides = 0
    for kind, ids in mesh.cells.items():
        columns = columns_of(np.asarray(ids))
        own = np.arange(cells, cells + len(ids))
        number = len(FACES[kind])
        for k, face in enumerate(FACES[kind] if DIMENSION[kind] == mesh.points.shape[1] else ()):
            every = slice(sides + k, sides + number * len(ids), number)  # this face of each cell
            behind = neighbour[every]
            is_shared = (behind >= 0) & ~is_turned[every]
            rows = np.flatnonzero(~is_shared | (own < behind))
            corners = np.stack([columns[corner][rows] for corner in face])
            found = _Faces(corners, numbers[own[rows]], numbers[behind[rows]], is_shared[rows])
            parts.setdefault(len(face), []).append(found)
        cells = cells + len(ids)
        sides = sides + number * len(ids)
    for group in parts.values():
        yield _Faces(*(np.concatenate(column, axis=-1) for column in zip(*group, strict=True)))


def _faces_of_polyhedra(faces: Faces) -> Iterator[_Faces]:
    neighbour = faces.all_neighbours()
    for size in np.unique(faces.sizes).tolist():
        rows = np.flatnonzero(faces.sizes == size)
        behind = neighbour[rows]
        yield _Faces(faces.corners(rows, size).T, faces.owner[rows], behind, behind >= 0)


def _cut_into_blocks(groups: Iterable[_Faces], between: np.ndarray | None) -> Iterator[FaceBlock]:
    first = 0
    for *columns, is_shared in groups:
        for flag in (True, False):
            corners, owner, behind = (
                np.ascontiguousarray(column[..., is_shared == flag]) for column in columns
            )
            is_between = np.zeros(len(owner), bool)
            if between is not None and not flag:
                is_between = is_among(corners.T, between)
            for at in range(0, len(owner), FACES_AT_ONCE):
                some = slice(at, at + FACES_AT_ONCE)
                yield FaceBlock(
                    corners=corners[:, some],
                    owner=owner[some],
                    behind=behind[some],
                    is_between=is_between[some],
                    is_shared=flag,
                    rows=slice(first + at, first + at + len(owner[some])),
                )
            first = first + len(owner)


class _Shape(NamedTuple):
    """Centres and area vectors (d, f) of faces, middles (d, k) and d volumes (k,) of cells."""

    centre: FaceVectors
    area: FaceVectors
    middle: FaceVectors
    volume: FaceValues


def _shape_of(sides: Sides, points: FacePoints) -> _Shape:
    """Measures by pyramids (triangles in 2-D) from faces to the mean of their centres."""
    d = points.shape[1]
    columns = np.ascontiguousarray(points.T)
    centre, area = np.empty((2, d, sides.blocks[-1].rows.stop))
    means = np.zeros((d, sides.total))
    sums = np.zeros((d + 1, sides.total))  # d volumes, and first moments
    for block, (own_centre, own_area) in sides.map(functools.partial(_centre_and_area, columns)):
        centre[:, block.rows] = own_centre
        area[:, block.rows] = own_area
        for _, cells in block.views:
            _add(means, cells, own_centre)
    means /= np.maximum(sides.counts, 1)
    for block, parts in sides.map(functools.partial(_pyramids, centre, area, means)):
        for (_, cells), part in zip(block.views, parts, strict=True):
            _add(sums, cells, part)
    volume, *moment = sums
    return _Shape(centre, area, moment / np.where(volume == 0, LEAST_DIVISOR, volume), volume)


def _add(sums: FaceVectors, cells: np.ndarray, vectors: FaceVectors) -> None:
    for total, component in zip(sums, vectors, strict=True):
        np.add.at(total, cells, component)


def _quality_of(sides: Sides, shape: _Shape, points: FacePoints, old: FaceValues) -> FaceQuality:
    d, total = shape.middle.shape
    noise = 8 * np.finfo(float).eps * np.abs(points).max()
    lowest = np.full(total, np.inf)  # pyramid of a cell, and that with its round-off
    highest = np.full(total, np.inf)
    heights = np.zeros(total)
    cosine = np.ones(total)
    skewness = np.zeros(total)
    seen = np.zeros((d, total))
    cosines = np.zeros(2)  # their sum and their number
    columns = np.ascontiguousarray(points.T)
    for block, found in sides.map(functools.partial(_measure_across, shape, columns)):
        inner = found.cosine[block.behind >= 0]
        cosines += len(block.views) * np.array([inner.sum(), len(inner)])
        for (_, cells), height in zip(block.views, found.heights, strict=True):
            np.minimum.at(lowest, cells, height)
            np.minimum.at(highest, cells, height + noise * found.size)
            np.minimum.at(cosine, cells, found.cosine)
            np.maximum.at(skewness, cells, found.skewness)
            np.add.at(heights, cells, np.abs(height))
            _add(seen, cells, np.abs(shape.area[:, block.rows]))
    counted = sides.counts > 0
    pyramid = lowest / np.maximum(heights / np.maximum(sides.counts, 1), LEAST_DIVISOR)
    aspect = seen.max(axis=0) / np.maximum(seen.min(axis=0), LEAST_DIVISOR)
    if d == 3:
        size = np.maximum(np.abs(shape.volume) / 3, LEAST_DIVISOR)
        aspect = np.maximum(aspect, seen.sum(axis=0) / 6 / size ** (2 / 3))
    mean = np.clip(cosines[0] / cosines[1], -1, 1) if cosines[1] else 1.0
    return FaceQuality(
        volume=shape.volume / d,
        pyramid=np.where(counted, pyramid, 1.0),
        is_inverted=counted & ~((shape.volume > 0) & (highest >= 0)),
        skewness=skewness,
        aspect_ratio=np.where(counted, aspect, 1.0),
        non_orthogonality=np.degrees(np.arccos(cosine)),
        centroid=shape.middle.T.copy(),
        counted=counted,
        mean_non_orthogonality=float(np.degrees(np.arccos(mean))),
        volume_ratio=np.where(old == 0, 1.0, shape.volume / np.where(old == 0, 1.0, old)),
    )


def _centre_and_area(points: FaceVectors, block: FaceBlock) -> tuple[FaceVectors, FaceVectors]:
    """Centres and area vectors of faces; an edge is its own area, turned."""
    x = points.take(block.corners, axis=1)  # (d, corners, f)
    if len(points) == 2:
        along = x[:, 1] - x[:, 0]
        return (x[:, 0] + x[:, 1]) / 2, np.stack([along[1], -along[0]])
    middle = x.mean(axis=1)
    arms = middle[:, None] - x
    after = np.roll(arms, -1, axis=1)
    normals = np.stack(cross(arms, after))  # of triangles about the mean of the corners
    weights = _lengths(normals)
    moment = (weights * (arms + after)).sum(axis=1)
    centre = middle - moment / (3 * np.maximum(weights.sum(axis=0), LEAST_DIVISOR))
    return centre, normals.sum(axis=1) / 2


def _pyramids(
    centres: FaceVectors, areas: FaceVectors, means: FaceVectors, block: FaceBlock
) -> list[FaceVectors]:
    """d volumes and first moments (d + 1, b) of pyramids, as each view sees the faces."""
    d = len(means)
    parts = []
    centre = centres[:, block.rows]
    area = areas[:, block.rows]
    for sign, cells in block.views:
        middle = means.take(cells, axis=1)
        volume = sign * dot(area, centre - middle)
        parts.append(np.vstack([volume[None], volume / (d + 1) * (d * centre + middle)]))
    return parts


class _Across(NamedTuple):
    size: np.ndarray
    skewness: np.ndarray
    cosine: np.ndarray
    heights: list[np.ndarray]


def _measure_across(shape: _Shape, points: FaceVectors, block: FaceBlock) -> _Across:
    """Measures the line between the cells of each face: from its owner to the cell behind, else
    along the normal to the face.
    """
    inside = block.behind >= 0
    centre = shape.centre[:, block.rows]
    area = shape.area[:, block.rows]
    size = _lengths(area)
    middle = shape.middle.take(block.owner, axis=1)
    other = shape.middle.take(block.behind, axis=1)  # anything without a cell behind
    arm = centre - middle
    across = other - middle
    heights = [dot(area, arm)]
    if block.is_shared:
        heights.append(dot(area, other - centre))
    else:
        normal = area / np.maximum(size, LEAST_DIVISOR)
        across = np.where(inside, across, dot(normal, arm) * normal)
    along = dot(area, across)
    cosine = np.clip(along / np.maximum(size * _lengths(across), LEAST_DIVISOR), -1, 1)
    by = arm - heights[0] / np.where(along == 0, LEAST_DIVISOR, along) * across
    miss = _lengths(by)
    x = points.take(block.corners, axis=1) - centre[:, None]
    reach = np.abs(dot(by[:, None], x)).max(axis=0) / np.maximum(miss, LEAST_DIVISOR)
    least = np.where(inside, 0.2, 0.4) * _lengths(across)
    skewness = miss / np.maximum(np.maximum(reach, least), LEAST_DIVISOR)
    return _Across(
        size=size,
        skewness=np.where(block.is_between, 0, skewness),
        cosine=np.where(inside, cosine, 1),
        heights=heights,
    )


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(dot(vectors, vectors))
