"""Cells made of OpenFOAM's faces: tetrahedra, pyramids, wedges, hexahedra, in VTK's node order.

OpenFOAM's files hold polygons and the two cells beside them. The type of a cell follows from the
counts of its faces and corners, its numbering from one face, the base, and the edges that leave it.
"""

import dataclasses

import numpy as np

from .._host.cells.adjacency import columns_of, sorted_columns, twins
from .._host.cells.topology import CORNERS, FACES, Pair
from .._host.ragged import Ragged

CELLS_OF_BLOCK = 1 << 13

_FACES_OF_SHAPE = {
    "tetra": (4, 4, 0),
    "pyramid": (5, 4, 1),
    "wedge": (5, 2, 3),
    "hexahedron": (6, 0, 6),
}
"""Numbers of faces, of triangles and of quads by type."""


@dataclasses.dataclass(frozen=True, eq=False)
class Faces:
    """Polygons, and the cells on their two sides.

    - `labels`, `starts`: node ids of all faces in a row; where faces begin in them, and the end.
    - `owner`: the cell from which a face points outward.
    - `neighbour`: the cell on the other side, -1 for an outer face. Outer faces at the end may be
      missing.
    """

    labels: np.ndarray
    starts: np.ndarray
    owner: np.ndarray
    neighbour: np.ndarray

    @property
    def rows(self) -> Ragged:
        return Ragged(self.labels, self.starts)

    @property
    def sizes(self) -> np.ndarray:
        return np.diff(self.starts)

    @property
    def count(self) -> int:
        """How many cells there are: one more than the last one's number."""
        return int(max(self.owner.max(initial=-1), self.neighbour.max(initial=-1))) + 1

    def renumbered(self, first: int) -> "Faces":
        """Counts the cells from `first` on."""
        return Faces(
            self.labels,
            self.starts,
            self.owner + first,
            np.where(self.neighbour < 0, -1, self.neighbour + first),
        )

    def after(self, values: np.ndarray) -> np.ndarray:
        """Returns at each corner the value (k, ...) of the next corner of its face."""
        return following(values, self.starts)

    def all_neighbours(self) -> np.ndarray:
        return np.append(
            self.neighbour, np.full(len(self.owner) - len(self.neighbour), -1, self.neighbour.dtype)
        )

    def corners(self, faces: np.ndarray, size: int) -> np.ndarray:
        """Gathers ids (..., size) of faces of `size` corners; `~f` is f seen by its neighbour."""
        rows = self.rows.table(np.where(faces < 0, ~faces, faces), size)
        return np.where((faces < 0)[..., None], rows[..., ::-1], rows)

    def padded(self, faces: np.ndarray) -> np.ndarray:
        """Gathers node ids (k, c) of faces of several sizes, with -1 behind the last corner."""
        return self.rows.take(faces).padded(-1, 4)

    def nodes(self, first: int, last: int) -> np.ndarray:
        return self.labels[self.starts[first] : self.starts[last]]

    def of_cells(self) -> Pair:
        """Lists faces cell by cell, `~f` for the neighbour; where cells begin, and the end."""
        # A sparse matrix sorts the sides of faces by cell: its columns are sides, its rows cells.
        # The conversion from columns to rows is a counting sort in linear time.
        from scipy import sparse  # 0.1 s, which a mesh without polyhedra does not need

        inner = np.flatnonzero(self.neighbour >= 0).astype(np.int32)
        cells = np.concatenate([self.owner, self.neighbour[inner]]).astype(np.int32, copy=False)
        columns = np.arange(len(cells) + 1, dtype=np.int32)
        shape = (int(cells.max(initial=-1)) + 1, len(cells))
        by_cell = sparse.csc_matrix((np.ones(len(cells), np.int8), cells, columns), shape).tocsr()
        del cells, columns
        ids = np.concatenate([np.arange(len(self.owner), dtype=np.int32), ~inner])
        return ids[by_cell.indices], by_cell.indptr.astype(np.int64)


def following(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Returns the next of the values (k, ...) of each row, its first behind its last."""
    after = np.roll(values, -1, axis=0)
    after[starts[1:] - 1] = values[starts[:-1]]
    return after


def faces_of_cells(kind: str, corners: np.ndarray, cell: np.ndarray) -> Faces:
    """Lists faces of cells of one type; inner faces come twice, until `joined_faces` pairs them."""
    parts = [corners[:, list(face)] for face in FACES[kind]]
    labels = np.concatenate([part.ravel() for part in parts])
    sizes = np.repeat([part.shape[1] for part in parts], len(corners))
    starts = Ragged.of(labels, sizes).starts
    return Faces(labels, starts, np.tile(cell, len(parts)), np.full(len(sizes), -1))


def joined_faces(parts: list[Faces]) -> Faces:
    """Joins faces whose cells are numbered throughout: two equal outer faces are an inner one."""
    # Outer faces are padded to one width, so that `twins` pairs them. The first of two equal faces
    # stays, with the owner of the second as its neighbour.
    fields = ("labels", "sizes", "owner", "neighbour")
    labels, sizes, owner, neighbour = (
        np.concatenate([getattr(part, name) for part in parts]) for name in fields
    )
    faces = Faces(labels, Ragged.of(labels, sizes).starts, owner, neighbour)
    outer = np.flatnonzero(neighbour < 0)
    width = int(sizes.max())
    groups = [outer[sizes[outer] == size] for size in np.unique(sizes[outer]).tolist()]
    columns = [
        sorted_columns(columns_of(faces.corners(rows, int(sizes[rows[0]]))), width)
        for rows in groups
    ]
    rows = np.concatenate(groups)
    other = twins([np.concatenate(column) for column in zip(*columns, strict=True)])
    first = (other >= 0) & (np.arange(len(rows)) < other)
    neighbour[rows[first]] = owner[rows[other[first]]]
    is_first = np.ones(len(owner), bool)
    is_first[rows[other[first]]] = False
    left = faces.rows.take(np.flatnonzero(is_first))
    return Faces(left.values, left.starts, owner[is_first], neighbour[is_first])


def standard_cells(faces: Faces) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Finds tetrahedra, pyramids, wedges and hexahedra: corners (k, c) and cell ids (k,) by type.
    The entry `polyhedron` lists other cells. Counts of faces, triangles and quads select
    candidates; `_typed` numbers their corners and refuses cells with other connections.
    """
    ordered, starts = faces.of_cells()
    counts = np.diff(starts)
    sizes = np.minimum(faces.sizes, 9).astype(np.int8)[np.where(ordered < 0, ~ordered, ordered)]
    triangles, quads = (
        np.add.reduceat(sizes == size, starts[:-1], dtype=np.int32) for size in (3, 4)
    )
    left = np.ones(len(counts), bool)
    cells = {}
    ids = {}
    for kind, (f, t, q) in _FACES_OF_SHAPE.items():
        candidates = np.flatnonzero((counts == f) & (triangles == t) & (quads == q))
        if len(candidates):
            corners, good = _typed(faces, kind, ordered, sizes, starts[candidates])
            cells[kind], ids[kind] = (
                (corners, candidates) if good.all() else (corners[good], candidates[good])
            )
            left[ids[kind]] = False
    if left.any():
        ids["polyhedron"] = np.flatnonzero(left)
    return {kind: corners for kind, corners in cells.items() if len(corners)}, ids


def open_cells(faces: Faces) -> np.ndarray:
    """Finds cells that are not closed: an edge belongs to an odd number of their faces."""
    # A node has a random number. An edge has the squared difference of its two numbers, which is
    # zero if a corner comes twice. In a closed cell every edge comes an even number of times, so
    # that an "exclusive or" over the edges of its faces leaves zero.
    number = np.random.default_rng(0).integers(
        2**64, size=int(faces.labels.max(initial=0)) + 1, dtype=np.uint64
    )
    of_face = np.empty(len(faces.owner), np.uint64)
    for at in range(0, len(of_face), CELLS_OF_BLOCK):
        starts = faces.starts[at : at + CELLS_OF_BLOCK + 1]
        here = number[faces.labels[starts[0] : starts[-1]]]
        starts = starts - starts[0]
        of_face[at : at + CELLS_OF_BLOCK] = np.bitwise_xor.reduceat(
            (here - following(here, starts)) ** 2, starts[:-1]
        )
    inner = np.flatnonzero(faces.neighbour >= 0)
    left = np.zeros(faces.count, np.uint64)
    np.bitwise_xor.at(left, faces.owner, of_face)
    np.bitwise_xor.at(left, faces.neighbour[inner], of_face[inner])
    return np.flatnonzero(left)


def _typed(faces: Faces, kind: str, ordered: np.ndarray, sizes: np.ndarray, starts: np.ndarray):
    """Numbers corners of cells whose faces begin at `starts`; marks cells shaped as their type."""
    # Blocks of cells keep memory small. The faces of a pyramid or a wedge are sorted so that the
    # base comes first: the quad of a pyramid, a triangle of a wedge.
    corners = np.empty((len(starts), CORNERS[kind]), faces.labels.dtype)
    good = np.empty(len(starts), bool)
    for at in range(0, len(starts), CELLS_OF_BLOCK):
        block = slice(at, at + CELLS_OF_BLOCK)
        rows = starts[block, None] + np.arange(_FACES_OF_SHAPE[kind][0])
        around = ordered[rows]
        if kind in ("pyramid", "wedge"):
            first = sizes[rows] if kind == "wedge" else -sizes[rows]
            around = np.take_along_axis(around, np.argsort(first, axis=1, kind="stable"), axis=1)
        corners[block], good[block] = _from_base(faces, kind, around)
    return corners, good


def _from_base(faces: Faces, kind: str, around: np.ndarray) -> Pair:
    """Numbers cells from their first face, seen from inside; marks cells shaped as their type."""
    # A wall, another face that touches the base, shares an edge with it. On a walk round the wall,
    # exactly one edge leaves the base: its foot is a corner of the base, its head the corner above.
    # A cell has the shape of its type if every corner of the base has exactly one head, and the
    # heads are one apex or all different.
    c = 4 if kind in ("pyramid", "hexahedron") else 3
    base = faces.corners(around[:, 0], c)[:, ::-1]
    side = 4 if kind in ("wedge", "hexahedron") else 3
    walls = around[:, 2:] if kind == "wedge" else around[:, 1:]
    start = np.ascontiguousarray(
        np.moveaxis(faces.corners(walls, side), 0, 2)
    )  # operations then run along cells
    corners = np.ascontiguousarray(base.T)
    is_base = (start == corners[:, None, None]).any(axis=0)
    # A wall has one edge that leaves the base; the face opposite to the base has none.
    leaves = is_base & ~np.roll(is_base, -1, axis=1)
    count = leaves.sum(axis=1, dtype=np.int8)
    foot = np.where(count, (leaves * start).sum(axis=1, dtype=base.dtype), -1)
    head = (leaves * np.roll(start, -1, axis=1)).sum(axis=1, dtype=base.dtype)
    hit = foot == corners[:, None]
    top = (hit * head).sum(axis=1, dtype=base.dtype).T
    good = (count <= 1).all(axis=0) & (hit.sum(axis=1, dtype=np.int8) == 1).all(axis=0)
    if kind in ("tetra", "pyramid"):
        good &= (top == top[:, :1]).all(axis=1)
        top = top[:, :1]
    else:
        ordered = np.sort(top, axis=1)
        good &= (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    return np.concatenate([base, top], axis=1), good
