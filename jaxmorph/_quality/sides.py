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

    @property
    def counts(self) -> Int[np.ndarray, " k"]:
        """Number of faces of each cell."""
        counts = np.zeros(self.total, dtype=np.int64)
        for group in self.groups:
            for cells in (group.owner, group.behind[: group.shared]):
                counts += np.bincount(cells, minlength=self.total)
        return counts


def _standard(mesh: Mesh, highest: int) -> Sides:
    """Pairs the faces of cells of the standard types."""
    listed: dict[int, list[tuple[list[np.ndarray], np.ndarray]]] = {}
    first, cell = 0, mesh.cell_ids
    for kind, ids in mesh.cells.items():
        last = first + len(ids)
        if DIMENSION[kind] == highest:
            columns, owner = columns_of(np.asarray(ids)), cell[first:last].astype(np.int32)
            for face in FACES[kind]:
                listed.setdefault(len(face), []).append(([columns[corner] for corner in face], owner))
        first = last
    groups = []
    for parts in listed.values():
        columns = [np.concatenate(column) for column in zip(*(columns for columns, _ in parts), strict=True)]
        groups.append(_paired(mesh, columns, np.concatenate([owner for _, owner in parts])))
    return Sides(tuple(groups), first)


def _paired(mesh: Mesh, columns: list[np.ndarray], owner: Int[np.ndarray, " t"]) -> Group:
    """Joins two outer faces with equal nodes to one shared face."""
    partner = twins(sorted_columns(columns, len(columns))).astype(np.int32)
    first = np.flatnonzero(partner > np.arange(len(partner), dtype=np.int32)).astype(np.int32)
    second = partner[first]
    is_same = np.empty(len(first), dtype=bool)

    def compare(rows: slice) -> None:
        pairs = ([column[side[rows]] for column in columns] for side in (first, second))
        is_same[rows] = _is_reversed(*pairs)

    by_blocks(compare, len(first))
    is_alone = np.ones(len(owner), dtype=bool)
    is_alone[first[is_same]] = is_alone[second[is_same]] = False
    rows = np.concatenate([first[is_same], np.flatnonzero(is_alone).astype(np.int32)])
    corners, beyond = np.stack(list(in_order(lambda column: column[rows], columns))), partner[rows]
    behind = np.where(beyond < 0, np.int32(-1), owner[beyond])
    shared = int(is_same.sum())
    return Group(corners, owner[rows], behind, shared, _to_others(mesh, corners, shared))


def _is_reversed(a: list[np.ndarray], b: list[np.ndarray]) -> Bool[np.ndarray, " f"]:
    """Marks the pairs of faces that run round equal corners in opposite senses.

    `a` and `b` are the faces' corners by column.
    """
    is_reversed = np.zeros(len(a[0]), dtype=bool)
    for start in range(len(b)):
        same = a[0] == b[start]
        for step in range(1, len(b)):
            same &= a[step] == b[start - step]
        is_reversed |= same
    return is_reversed


def _whole(mesh: Mesh, faces: Faces) -> Sides:
    """Takes the faces of a file that lists them."""
    sizes, groups = faces.sizes, []
    neighbour = np.full(len(faces.owner), -1, faces.neighbour.dtype)
    neighbour[: len(faces.neighbour)] = faces.neighbour
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        is_inner = neighbour[rows] >= 0
        rows, shared = np.concatenate([rows[is_inner], rows[~is_inner]]), int(is_inner.sum())
        corners = np.ascontiguousarray(faces.corners(rows, size).T)
        groups.append(Group(corners, faces.owner[rows], neighbour[rows], shared, _to_others(mesh, corners, shared)))
    total = int(max(faces.owner.max(), neighbour.max())) + 1
    return Sides(tuple(groups), total)


def _to_others(mesh: Mesh, corners: Int[np.ndarray, "c f"], shared: int) -> Bool[np.ndarray, " f"]:
    marked = np.zeros(corners.shape[1], dtype=bool)
    if mesh.between is not None:
        marked[shared:] = is_among(corners[:, shared:].T, mesh.between)
    return marked
