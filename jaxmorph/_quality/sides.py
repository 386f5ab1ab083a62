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

BLOCK = 1 << 14  # faces in a block: their columns stay in a core's cache


@dataclasses.dataclass(frozen=True, eq=False)
class Group:
    """Faces with equal numbers of corners: edges have two.

    - `corners`: node ids (c, f), in the sense in which the owner sees the face from outside.
    - `owner`, `behind`: the cells (f,) beside the face; `behind` is -1 where there is none.
    - `shared`: the number of faces at the beginning that stand for both cells. Others stand for
      their owner: outer faces, and pairs of which one is not its partner seen from behind.
    - `is_between`: marks (f,) faces to other parts of the mesh.
    """

    corners: Int[np.ndarray, "c f"]
    owner: Int[np.ndarray, " f"]
    behind: Int[np.ndarray, " f"]
    shared: int
    is_between: Bool[np.ndarray, " f"]

    def blocks(self) -> Iterator["FaceBlock"]:
        """Yields all faces, some at a time; a block has only shared faces or none."""
        count = len(self.owner)
        for start, end in ((0, self.shared), (self.shared, count)):
            for at in range(start, end, BLOCK):
                yield FaceBlock(self, slice(at, min(at + BLOCK, end)), end <= self.shared)

    def measured(self, function: Callable[["FaceBlock"], T]) -> Iterator[tuple["FaceBlock", T]]:
        """Yields all blocks in order, each with its `function`, which all cores compute."""
        return in_order(lambda block: (block, function(block)), self.blocks())


@dataclasses.dataclass(frozen=True, eq=False)
class FaceBlock:
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
    groups: tuple[Group, ...]
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
        return _standard(mesh, highest) if mesh.polyhedra is None else _whole(mesh, mesh.polyhedra.faces)

    @functools.cached_property
    def counts(self) -> Int[np.ndarray, " k"]:
        cells = [part for group in self.groups for part in (group.owner, group.behind[: group.shared])]
        return np.sum([np.bincount(part, minlength=self.total) for part in cells], axis=0)


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
        groups.append(_group(mesh, corners, numbers[owner], np.where(behind < 0, -1, numbers[behind]), is_shared))
    return Sides(tuple(groups), sum(counts))


def _whole(mesh: Mesh, faces: Faces) -> Sides:
    sizes, groups = faces.sizes, []
    neighbour = np.full(len(faces.owner), -1, faces.neighbour.dtype)
    neighbour[: len(faces.neighbour)] = faces.neighbour
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        corners, behind = faces.corners(rows, size).T, neighbour[rows]
        groups.append(_group(mesh, corners, faces.owner[rows], behind, behind >= 0))
    return Sides(tuple(groups), int(max(faces.owner.max(), neighbour.max())) + 1)


def _group(
    mesh: Mesh, corners: Int[np.ndarray, "c f"], owner: np.ndarray, behind: np.ndarray, is_shared: np.ndarray
) -> Group:
    order, shared = np.argsort(~is_shared, kind="stable"), int(is_shared.sum())
    corners, is_between = np.ascontiguousarray(corners[:, order]), np.zeros(len(order), dtype=bool)
    if mesh.between is not None:
        is_between[shared:] = is_among(corners[:, shared:].T, mesh.between)
    return Group(corners, owner[order], behind[order], shared, is_between)
