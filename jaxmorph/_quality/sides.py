"""Faces of a mesh, and the cells beside them: what measures by faces need of the ids."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Int

from .._host.cells.adjacency import columns_of, is_among, sorted_columns, twins
from .._host.cells.topology import DIMENSION, FACES
from .._host.package.cores import by_blocks, in_order
from .._mesh.faces import Faces
from .._mesh.mesh import Mesh

T = TypeVar("T")

BLOCK = 1 << 14
"""Faces measured together: their columns stay in a core's cache."""


@dataclasses.dataclass(frozen=True, eq=False)
class Group:
    """Faces with equal numbers of corners: edges have two.

    - `corners`: node ids (c, f), in the sense in which the owner sees the face from outside.
    - `owner`, `behind`: the cells (f,) beside the face; `behind` is -1 where there is none.
    - `shared`: the number of faces at the beginning that stand for both cells. All further faces
      stand for their owner: outer faces, and pairs of faces of which one is not its partner seen
      from behind.
    - `is_between`: marks (f,) faces to other parts of the mesh.
    """

    corners: Int[np.ndarray, "c f"]
    owner: Int[np.ndarray, " f"]
    behind: Int[np.ndarray, " f"]
    shared: int
    is_between: Bool[np.ndarray, " f"]

    def blocks(self) -> Iterator["Block"]:
        """Yields all faces, some at a time; a block has only shared faces or none."""
        count = len(self.owner)
        for start, end in ((0, self.shared), (self.shared, count)):
            for at in range(start, end, BLOCK):
                yield Block(self, slice(at, min(at + BLOCK, end)), end <= self.shared)

    def measured(self, function: Callable[["Block"], T]) -> Iterator[tuple["Block", T]]:
        """Yields all blocks in order, each with its `function`, which all cores compute."""
        return in_order(lambda block: (block, function(block)), self.blocks())


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Holds some faces of a group: the `rows` of the group, all shared or none."""

    group: Group
    rows: slice
    is_shared: bool

    @property
    def corners(self) -> Int[np.ndarray, "c b"]:
        return self.group.corners[:, self.rows].astype(np.intp)

    @functools.cached_property
    def owner(self) -> Int[np.ndarray, " b"]:
        return self.group.owner[self.rows].astype(np.intp)

    @functools.cached_property
    def behind(self) -> Int[np.ndarray, " b"]:
        return self.group.behind[self.rows].astype(np.intp)

    @property
    def views(self) -> tuple[tuple[int, Int[np.ndarray, " b"]], ...]:
        """The cells that the faces stand for: 1 with the owners, and -1 with the cells behind."""
        return ((1, self.owner), (-1, self.behind)) if self.is_shared else ((1, self.owner),)


@dataclasses.dataclass(frozen=True, eq=False)
class Sides:
    """Holds all faces by their number of corners, and the number of cells, `total`."""

    groups: tuple[Group, ...]
    total: int

    @classmethod
    def listed(cls, mesh: Mesh) -> "Sides":
        """Lists the faces of the cells of the highest dimension, polyhedra and polygons whole.

        Raises `ValueError` where cells do not fill the mesh's dimension, and for a mesh without
        cells.
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
        return _standard(mesh, highest) if mesh.polyhedra is None else _whole(mesh, mesh.polyhedra.faces)

    @functools.cached_property
    def counts(self) -> Int[np.ndarray, " k"]:
        """Number of faces of each cell."""
        cells = [part for group in self.groups for part in (group.owner, group.behind[: group.shared])]
        return np.sum([np.bincount(part, minlength=self.total) for part in cells], axis=0)


def _standard(mesh: Mesh, highest: int) -> Sides:
    """Pairs the faces of cells of the standard types."""
    faces: dict[int, list[list[np.ndarray]]] = {}  # by number of corners: columns of corners, and the owner
    first = 0
    for kind, ids in mesh.cells.items():
        last = first + len(ids)
        if DIMENSION[kind] == highest:
            columns, owner = columns_of(np.asarray(ids)), mesh.cell_ids[first:last].astype(np.int32)
            for face in FACES[kind]:
                faces.setdefault(len(face), []).append([*(columns[corner] for corner in face), owner])
        first = last
    groups = (_paired(mesh, *map(np.concatenate, zip(*parts, strict=True))) for parts in faces.values())
    return Sides(tuple(groups), first)


def _paired(mesh: Mesh, *faces: Int[np.ndarray, " t"]) -> Group:
    """Joins two outer faces, by column and owner, that run round equal nodes in opposite senses."""
    *columns, owner = faces
    partner = twins(sorted_columns(columns, len(columns))).astype(np.int32)
    first = np.flatnonzero(partner > np.arange(len(partner), dtype=np.int32)).astype(np.int32)
    is_same = np.empty(len(first), dtype=bool)

    def compare(rows: slice) -> None:
        a, b = (np.stack([column[side[rows]] for column in columns]) for side in (first, partner[first]))
        turned = (np.roll(b[::-1], start, axis=0) for start in range(len(b)))
        is_same[rows] = np.any([(a == other).all(axis=0) for other in turned], axis=0)

    by_blocks(compare, len(first))
    first = first[is_same]
    is_alone = np.ones(len(owner), dtype=bool)
    is_alone[first] = is_alone[partner[first]] = False
    rows = np.concatenate([first, np.flatnonzero(is_alone).astype(np.int32)])
    beyond = partner[rows]
    corners = np.stack(list(in_order(lambda column: column[rows], columns)))
    return _group(mesh, corners, owner[rows], np.where(beyond < 0, np.int32(-1), owner[beyond]), len(first))


def _whole(mesh: Mesh, faces: Faces) -> Sides:
    """Takes the faces of a file that lists them."""
    sizes, groups = faces.sizes, []
    neighbour = np.full(len(faces.owner), -1, faces.neighbour.dtype)
    neighbour[: len(faces.neighbour)] = faces.neighbour
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        is_inner = neighbour[rows] >= 0
        rows = np.concatenate([rows[is_inner], rows[~is_inner]])
        corners = np.ascontiguousarray(faces.corners(rows, size).T)
        groups.append(_group(mesh, corners, faces.owner[rows], neighbour[rows], int(is_inner.sum())))
    return Sides(tuple(groups), int(max(faces.owner.max(), neighbour.max())) + 1)


def _group(mesh: Mesh, corners: Int[np.ndarray, "c f"], owner: np.ndarray, behind: np.ndarray, shared: int) -> Group:
    is_between = np.zeros(corners.shape[1], dtype=bool)
    if mesh.between is not None:
        is_between[shared:] = is_among(corners[:, shared:].T, mesh.between)
    return Group(corners, owner, behind, shared, is_between)
