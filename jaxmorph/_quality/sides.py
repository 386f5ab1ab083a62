"""Faces of a mesh, and the cells beside them, for measures by faces."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Int

from .._host.cells.adjacency import columns_of, is_among, neighbours
from .._host.cells.topology import DIMENSION, FACES
from .._host.package.cores import in_order
from .._mesh.faces import Faces
from .._mesh.mesh import Mesh

T = TypeVar("T")
Cells = Int[np.ndarray, " b"]

BLOCK = 1 << 14  # faces in a block: their columns stay in a core's cache


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
    blocks: tuple[FaceBlock, ...]
    total: int

    @classmethod
    def listed(cls, mesh: Mesh) -> "Sides":
        """Lists the faces of the cells of the highest dimension, polyhedra and polygons whole.
        Raises `ValueError` for a mesh without cells, or whose cells do not fill its dimension.
        """
        if mesh.is_curved:
            raise ValueError("OpenFOAM's measures are for linear cells; `quality` measures curved cells.")
        highest = max((DIMENSION[kind] for kind, ids in mesh.cells.items() if len(ids)), default=None)
        if highest is None:
            raise ValueError("the mesh has no cells; its quality is not defined.")
        if highest != mesh.points.shape[1]:
            raise ValueError(
                "OpenFOAM's measures are for meshes that fill a region in 2-D or 3-D, not for surfaces in 3-D."
            )
        return _standard(mesh, highest) if mesh.polyhedra is None else _whole(mesh.polyhedra.faces, mesh.between)

    def measured(self, function: Callable[[FaceBlock], T]) -> Iterator[tuple[FaceBlock, T]]:
        """Yields all blocks in order, each with its `function`, which all cores compute."""
        return in_order(lambda block: (block, function(block)), self.blocks)

    @functools.cached_property
    def counts(self) -> Int[np.ndarray, " k"]:
        counts = np.zeros(self.total, int)
        for block in self.blocks:
            for _, cells in block.views:
                np.add.at(counts, cells, 1)
        return counts


def _standard(mesh: Mesh, highest: int) -> Sides:
    solids = {kind: np.asarray(ids) for kind, ids in mesh.cells.items() if DIMENSION[kind] == highest}
    counts = list(map(len, mesh.cells.values()))
    numbers = mesh.cell_ids[np.repeat([kind in solids for kind in mesh.cells], counts)].astype(np.int32)
    (neighbour, flipped), faces, first, used = neighbours(solids), {}, 0, 0
    for kind, ids in solids.items():
        columns, own, end = columns_of(ids), np.arange(first, first + len(ids)), used + len(FACES[kind]) * len(ids)
        beyond, turned = (rows[used:end].reshape(len(ids), -1).T for rows in (neighbour, flipped))
        for face, behind, is_turned in zip(FACES[kind], beyond, turned, strict=True):
            is_shared = (behind >= 0) & ~is_turned
            rows = np.flatnonzero(~is_shared | (own < behind))
            corners = np.stack([columns[corner][rows] for corner in face])
            faces.setdefault(len(face), []).append((corners, own[rows], behind[rows], is_shared[rows]))
        first, used = first + len(ids), end
    groups = []
    for parts in faces.values():
        corners, owner, behind, is_shared = (np.concatenate(rows, axis=-1) for rows in zip(*parts, strict=True))
        groups.append((corners, numbers[owner], np.where(behind < 0, -1, numbers[behind]), is_shared))
    return Sides(tuple(_blocks(groups, mesh.between)), sum(counts))


def _whole(faces: Faces, between: np.ndarray | None) -> Sides:
    neighbour, groups = faces.all_neighbours(), []
    for size in np.unique(faces.sizes).tolist():
        rows = np.flatnonzero(faces.sizes == size)
        groups.append((faces.corners(rows, size).T, faces.owner[rows], neighbour[rows], neighbour[rows] >= 0))
    return Sides(tuple(_blocks(groups, between)), faces.count)


def _blocks(groups: list[tuple[np.ndarray, ...]], between: np.ndarray | None) -> Iterator[FaceBlock]:
    first = 0
    for *columns, is_shared in groups:
        for flag in (True, False):
            corners, owner, behind = (np.ascontiguousarray(column[..., is_shared == flag]) for column in columns)
            is_outer = np.zeros(len(owner), bool) if flag or between is None else is_among(corners.T, between)
            for at in range(0, len(owner), BLOCK):
                some = slice(at, at + BLOCK)
                rows = slice(first, first + len(owner[some]))
                yield FaceBlock(corners[:, some], owner[some], behind[some], is_outer[some], flag, rows)
                first = rows.stop
