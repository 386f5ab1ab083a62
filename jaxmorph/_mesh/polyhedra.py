"""Polyhedra and polygons: whole, and cut into tetrahedra and triangles between their own nodes."""

import dataclasses

import numpy as np

from .._host.cells.topology import Pair
from .._host.package.rounding import canonical_order
from .._host.ragged import Ragged
from .._host.rows import join_ids, mark
from .._host.tolerances import LEAST_PIECE, SAME
from .faces import CELLS_OF_BLOCK, Faces, open_cells, standard_cells

GOOD_APEX = 0.05  # share of the mean piece that ends the search for an apex


@dataclasses.dataclass(frozen=True, eq=False)
class Polyhedra:
    """Whole cells of a mesh: all faces (2-D: edges), ids of cut cells; see `Mesh.cell_ids`."""

    faces: Faces
    cut: np.ndarray

    def middles(self, points: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Computes the middles of the `wanted` cells' faces, in a table (cells, d) of all cells."""
        faces = self.faces
        neighbour = faces.all_neighbours()
        is_wanted = mark(int(max(faces.owner.max(), neighbour.max())) + 2, wanted)
        rows = np.flatnonzero(is_wanted[faces.owner] | is_wanted[neighbour])
        own = faces.rows.take(rows)
        sides = np.concatenate([faces.owner[rows], neighbour[rows]])
        table = []
        for column in points[own.values].T:
            centre = np.bincount(own.row, column) / own.sizes
            # the last row takes what has no neighbour, number -1
            table.append(np.bincount(sides % len(is_wanted), np.tile(centre, 2), len(is_wanted)))
        count = np.bincount(sides % len(is_wanted), minlength=len(is_wanted))
        return np.stack(table, axis=1) / np.maximum(count, 1)[:, None]


def cells_of_faces(
    faces: Faces, points: np.ndarray, numbers: np.ndarray | None = None
) -> tuple[list[tuple[str, np.ndarray, np.ndarray]], Polyhedra]:
    """Makes standard cells of cells by their faces, and tetrahedra between own nodes of all others.
    Returns types, corners (k, corners) and cells (k,) of each, and whole cells. Raises `ValueError`
    for cells that do not close, the first one by its number in `numbers`.
    """
    ajar = open_cells(faces)
    if len(ajar):
        first = ajar[0] if numbers is None else numbers[ajar[0]]
        raise ValueError(
            f"{len(ajar)} cells do not close, first cell {first}: their faces are damaged"
        )
    typed, ids = standard_cells(faces)
    cut = ids.pop("polyhedron", np.zeros(0, np.int64))
    blocks = [(kind, corners.astype(np.int64), ids[kind]) for kind, corners in typed.items()]
    if len(cut):
        blocks.append(("tetra", *tetrahedra(faces, cut, points)))
    return blocks, Polyhedra(faces, cut)


def triangles(faces: Faces, chosen: np.ndarray, points: np.ndarray) -> Pair:
    """Cuts the faces `chosen` into triangles (t, 3), with each one's place in `chosen`. Triangles
    have the sense of their face. A face is a fan about the corner that makes its smallest triangle
    largest; of equal corners, the first by place. So both cells see equal triangles.
    """
    sizes = faces.sizes[chosen]
    parts = []
    owners = []
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        corners = faces.corners(chosen[rows], size)
        x = points[corners]
        normal = np.cross(x - x[:, :1], np.roll(x, -1, axis=1) - x[:, :1]).sum(axis=1)
        least = np.stack(
            [_least(np.roll(x, -turn, axis=1), normal) for turn in range(size)], axis=1
        )
        top = least.max(axis=1, keepdims=True)
        best = _first_by_place(x, least >= top - SAME * np.abs(top))
        corners = np.take_along_axis(corners, (best[:, None] + np.arange(size)) % size, axis=1)
        fan = np.stack([corners[:, [0, i, i + 1]] for i in range(1, size - 1)], axis=1)
        parts.append(fan.reshape(-1, 3))
        owners.append(np.repeat(rows, size - 2))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(parts)[order], np.concatenate(owners)[order]


def _first_by_place(x: np.ndarray, is_allowed: np.ndarray) -> np.ndarray:
    """Finds the allowed corner (f,) of faces (f, c, d) that comes first in lexical order."""
    slack = SAME * np.ptp(x, axis=1).max(axis=1, keepdims=True)
    is_first = is_allowed
    for axis in range(x.shape[2]):
        along = np.where(is_first, x[..., axis], np.inf)
        is_first = is_first & (along <= along.min(axis=1, keepdims=True) + slack)
    return is_first.argmax(axis=1)


def _least(x: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Computes the smallest fan area about the first corner, times the face normal's length."""
    arms = x[:, 1:] - x[:, :1]
    return np.einsum("fti,fi->ft", np.cross(arms[:, :-1], arms[:, 1:]), normal).min(axis=1)


def tetrahedra(faces: Faces, cells: np.ndarray, points: np.ndarray) -> Pair:
    """Cuts cells into tetrahedra (t, 4) between an apex node and triangles of faces away from it.
    Also returns the cell of each. The apex is the first node whose smallest piece is no sliver, or
    else the node whose smallest piece is largest.
    """
    ordered, starts = faces.of_cells()
    parts = []
    owners = []
    for at in range(0, len(cells), CELLS_OF_BLOCK):
        block = cells[at : at + CELLS_OF_BLOCK]
        sides = Ragged(ordered, starts).take(block)
        pieces = _Pieces.around(faces, sides.values, sides.row, points)
        corners, cell = pieces.tetrahedra(pieces.best_apex())
        parts.append(corners)
        owners.append(block[cell])
    return join_ids(parts).reshape(-1, 4), join_ids(owners)


@dataclasses.dataclass(frozen=True, eq=False)
class _Pieces:
    """Triangles around cells, counterclockwise from inside, with their cells and faces."""

    points: np.ndarray
    corners: np.ndarray
    cell: np.ndarray
    face: np.ndarray

    @classmethod
    def around(
        cls, faces: Faces, signed: np.ndarray, cell: np.ndarray, points: np.ndarray
    ) -> "_Pieces":
        chosen, which = np.unique(np.where(signed < 0, ~signed, signed), return_inverse=True)
        corners, owner = triangles(faces, chosen, points)
        own = Ragged.of(corners, np.bincount(owner, minlength=len(chosen))).take(which)
        face = own.row
        triangle = own.values
        return cls(
            points,
            np.where((signed < 0)[face, None], triangle, triangle[:, ::-1]),
            cell[face],
            face,
        )

    def volumes(self, apex: np.ndarray, rows: np.ndarray) -> Pair:
        """Computes six volumes of tetrahedra below `apex`, one a cell; marks faces away from it."""
        tip = apex[self.cell[rows]]
        a, b, c = (self.points[self.corners[rows, i]] - self.points[tip] for i in range(3))
        face = self.face[rows]
        begins = np.flatnonzero(np.diff(face, prepend=-1))
        touches = np.logical_or.reduceat((self.corners[rows] == tip[:, None]).any(axis=1), begins)
        away = ~np.repeat(touches, np.diff(begins, append=len(face)))
        return -np.einsum("ti,ti->t", np.cross(a, b), c), away

    def best_apex(self) -> np.ndarray:
        # The nodes of all cells are sorted by cell, then by place. Round `turn` tries node number
        # `turn` of every cell whose best node is not yet good enough.
        count = int(self.cell[-1]) + 1
        nodes, corners = np.unique(self.corners, return_inverse=True)
        order = canonical_order(self.points[nodes])
        pairs = np.unique(
            np.stack([np.repeat(self.cell, 3), np.argsort(order)[corners.ravel()]], axis=1), axis=0
        )
        pairs[:, 1] = nodes[order[pairs[:, 1]]]
        first = np.searchsorted(pairs[:, 0], np.arange(count + 1))
        apex = pairs[first[:-1], 1]
        best = np.full(count, -np.inf)
        for turn in range(int(np.diff(first).max())):
            open_cells = (best < GOOD_APEX) & (np.diff(first) > turn)
            if not open_cells.any():
                break
            tried = pairs[np.minimum(first[:-1] + turn, first[1:] - 1), 1]
            share = self._least(tried, np.flatnonzero(open_cells[self.cell]), count)
            better = open_cells & (share - SAME > best)
            apex = np.where(better, tried, apex)
            best = np.where(better, share, best)
        return apex

    def _least(self, apex: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
        """Computes the smallest piece of a cell over its mean piece, for all cells."""
        volume, away = self.volumes(apex, rows)
        cell = self.cell[rows[away]]
        volume = volume[away]
        least = np.full(count, np.inf)
        np.minimum.at(least, cell, volume)
        mean = np.bincount(cell, volume, count) / np.maximum(np.bincount(cell, minlength=count), 1)
        return np.where(mean > 0, least / np.where(mean > 0, mean, 1), -np.inf)

    def tetrahedra(self, apex: np.ndarray) -> Pair:
        volume, away = self.volumes(apex, np.arange(len(self.cell)))
        size = np.where(away, np.abs(volume), 0)
        mean = np.bincount(self.cell, size) / np.maximum(np.bincount(self.cell, away), 1)
        used = away & (size > LEAST_PIECE * mean[self.cell])
        return np.column_stack([self.corners[used], apex[self.cell[used]]]), self.cell[used]
