"""Cells from OpenFOAM's faces: which of them are tetrahedra, pyramids, wedges and hexahedra, numbered as VTK numbers them."""

import dataclasses

import numpy as np
from scipy import sparse

BLOCK = 1 << 13
"""Cells looked at together."""

_SHAPES = {"tetra": (4, 4, 0), "pyramid": (5, 4, 1), "wedge": (5, 2, 3), "hexahedron": (6, 0, 6)}
"""Faces of a type, how many of them are triangles, how many have four corners."""

_BASE = {"tetra": 3, "pyramid": 4, "wedge": 3, "hexahedron": 4}
_LAST = {"tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}


@dataclasses.dataclass(frozen=True, eq=False)
class Faces:
    """`labels` of all faces in a row, where each begins (one more `start` at the end), and the cells on their two sides.

    `neighbour` is -1 for an outer face; those at the end may be left out.
    """

    labels: np.ndarray
    starts: np.ndarray
    owner: np.ndarray
    neighbour: np.ndarray

    @property
    def sizes(self) -> np.ndarray:
        return np.diff(self.starts)

    def corners(self, faces: np.ndarray, size: int) -> np.ndarray:
        """Labels (..., size) of faces of that many corners, outward for the cell: `~f` is face f seen by its neighbour."""
        start = self.starts[np.where(faces < 0, ~faces, faces)]
        labels = np.ascontiguousarray(self.labels)
        # a window on the labels for each place at which a face may begin
        kind = np.dtype((np.void, size * labels.itemsize))
        windows = np.ndarray(len(labels) - size + 1, kind, labels, strides=(labels.itemsize,))
        rows = windows[start].view(labels.dtype).reshape(*faces.shape, size)
        return np.where((faces < 0)[..., None], rows[..., ::-1], rows)

    def around(self, faces: np.ndarray, size: int) -> np.ndarray:
        """`corners` of faces (k, m) as (m, size, k), begun anywhere: so each operation runs along the k cells."""
        faces = np.ascontiguousarray(faces.T)
        turned = faces < 0
        start = np.take(self.starts, np.where(turned, ~faces, faces))
        labels = np.empty((len(faces), size, faces.shape[1]), self.labels.dtype)
        for k in range(size):
            labels[:, k] = np.take(self.labels[k:], start)
        swap = np.where(turned, labels[:, 1] ^ labels[:, -1], 0)
        labels[:, 1] ^= swap
        labels[:, -1] ^= swap
        return labels

    def nodes(self, first: int, last: int) -> np.ndarray:
        """The nodes of the faces from `first` up to `last`, as often as they come."""
        return self.labels[self.starts[first] : self.starts[last]]

    def of_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """The faces of each cell in a row, `~f` for one whose neighbour it is, and where each cell begins (one more at the end)."""
        inner = np.flatnonzero(self.neighbour >= 0).astype(np.int32)
        cells = np.concatenate([self.owner, self.neighbour[inner]]).astype(np.int32, copy=False)
        columns = np.arange(len(cells) + 1, dtype=np.int32)
        shape = (int(cells.max(initial=-1)) + 1, len(cells))
        by_cell = sparse.csc_matrix((np.ones(len(cells), np.int8), cells, columns), shape).tocsr()
        del cells, columns
        ids = np.concatenate([np.arange(len(self.owner), dtype=np.int32), ~inner])
        return ids[by_cell.indices], by_cell.indptr.astype(np.int64)


def standard_cells(faces: Faces) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Corner ids (k, corners) and cell ids (k,) by type; the cells of no type are in the second as `polyhedron`."""
    ordered, starts = faces.of_cells()
    counts = np.diff(starts)
    sizes = np.minimum(faces.sizes, 9).astype(np.int8)[np.where(ordered < 0, ~ordered, ordered)]
    triangles, quads = (np.add.reduceat(sizes == size, starts[:-1], dtype=np.int32) for size in (3, 4))
    left = np.ones(len(counts), bool)
    cells, ids = {}, {}
    for kind, (f, t, q) in _SHAPES.items():
        mine = np.flatnonzero((counts == f) & (triangles == t) & (quads == q))
        if len(mine):
            corners, good = _typed(faces, kind, ordered, sizes, starts[mine])
            cells[kind], ids[kind] = (corners, mine) if good.all() else (corners[good], mine[good])
            left[ids[kind]] = False
    if left.any():
        ids["polyhedron"] = np.flatnonzero(left)
    return {kind: corners for kind, corners in cells.items() if len(corners)}, ids


def _typed(faces: Faces, kind: str, ordered: np.ndarray, sizes: np.ndarray, starts: np.ndarray):
    """Corners of the cells whose faces begin at `starts`, and which of them really have the shape of their type."""
    corners = np.empty((len(starts), _LAST[kind]), faces.labels.dtype)
    good = np.empty(len(starts), bool)
    for at in range(0, len(starts), BLOCK):
        block = slice(at, at + BLOCK)
        rows = starts[block, None] + np.arange(_SHAPES[kind][0])
        mine = ordered[rows]
        if kind in ("pyramid", "wedge"):
            first = sizes[rows] if kind == "wedge" else -sizes[rows]
            mine = np.take_along_axis(mine, np.argsort(first, axis=1, kind="stable"), axis=1)
        corners[block], good[block] = _from_base(faces, kind, mine)
    return corners, good


def _from_base(faces: Faces, kind: str, mine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first face, seen from inside, is the base; the other corners stand at the ends of the edges that leave it."""
    c = _BASE[kind]
    base = faces.corners(mine[:, 0], c)[:, ::-1]
    side = 4 if kind in ("wedge", "hexahedron") else 3
    walls = mine[:, 2:] if kind == "wedge" else mine[:, 1:]
    start = faces.around(walls, side)
    corners = np.ascontiguousarray(base.T)
    is_base = np.zeros(start.shape, bool)
    for corner in corners:
        is_base |= start == corner
    # a wall has one edge that leaves the base, the face across from the base none
    leaves = is_base & ~np.roll(is_base, -1, axis=1)
    count = leaves.sum(axis=1, dtype=np.int8)
    foot = np.where(count, (leaves * start).sum(axis=1, dtype=base.dtype), -1)
    head = (leaves * np.roll(start, -1, axis=1)).sum(axis=1, dtype=base.dtype)
    tops, good = [], (count <= 1).all(axis=0)
    for corner in corners:
        hit = foot == corner
        tops.append((hit * head).sum(axis=0, dtype=base.dtype))
        good &= hit.sum(axis=0, dtype=np.int8) == 1
    top = np.stack(tops, axis=1)
    if kind in ("tetra", "pyramid"):
        good &= (top == top[:, :1]).all(axis=1)
        top = top[:, :1]
    else:
        ordered = np.sort(top, axis=1)
        good &= (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    return np.concatenate([base, top], axis=1), good
