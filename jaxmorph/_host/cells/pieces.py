"""Linear pieces of cells of high order, between all of their nodes; and faces of such cells.

The pieces of two neighbours meet in faces that are equal, and each piece of a straight cell is
right-handed. What needs walls, neighbours and edges so takes nodes of high order as the corners
that they are of pieces. One exception: of a 3-D cell with nodes on edges alone, two inner
quadrilaterals are cut in two.
"""

import functools
import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from .adjacency import columns_of, is_single, sorted_columns, unpaired
from .lagrange import PLACES, Lagrange, collapsed, depth, lagrange_types, of_order, values
from .topology import CORNERS, EDGES, FACES, FRAMES, NODES, SHAPES


def linear_cells(cells: Mapping[str, Any], join: Any = np.concatenate) -> dict[str, Any]:
    """Cuts cells into linear pieces; a cell's pieces are consecutive within their type."""
    result: dict[str, list[Any]] = {}
    for kind, ids in cells.items():
        for shape, rows in pieces_of(kind).items():
            result.setdefault(shape, []).append(ids if kind == shape else ids[:, rows].reshape(-1, rows.shape[1]))
    return {shape: parts[0] if len(parts) == 1 else join(parts) for shape, parts in result.items()}


def owners(cells: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Finds the cell of each of the `linear_cells`, by type; cells are numbered as in `cells`."""
    ids = np.cumsum([0, *map(len, cells.values())])
    numbered = {kind: np.arange(first, first + len(cells[kind])) for kind, first in zip(cells, ids, strict=False)}
    nodes = {kind: np.repeat(ids[:, None], NODES[kind], axis=1) for kind, ids in numbered.items()}
    return {shape: corners[:, 0] for shape, corners in linear_cells(nodes).items()}


def boundary_faces(cells: Mapping[str, np.ndarray], n: int, among: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Finds the linear faces that belong to one cell only (edges of 2-D cells), by type.

    A face of a cell of high order is cut into pieces. The arguments are as in `boundary_sides`.
    """
    return linear_cells(boundary_sides(cells, n, among))


def boundary_sides(cells: Mapping[str, np.ndarray], n: int, among: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Finds faces, with all of their nodes, that belong to one cell only (2-D: edges), by type.

    **Arguments:**

    - `cells`: node ids (k, nodes) by type.
    - `n`: how many nodes the mesh has.
    - `among`: node ids. With them, only faces all of whose nodes are among them are returned.

    **Returns:**

    Node ids (f, nodes) of the faces by type, each seen counterclockwise from outside.
    """
    return {side: ids for side, (ids, _) in owned_sides(cells, n, among).items()}


def owned_sides(
    cells: Mapping[str, np.ndarray], n: int, among: np.ndarray | None = None
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Finds the `boundary_sides`, and the cell (f,) of each; cells are numbered as in `cells`."""
    is_candidate = None
    if among is not None:
        is_candidate = np.zeros(n, bool)
        is_candidate[among] = True
    found: dict[str, list[tuple[list[np.ndarray], int, np.ndarray | None]]] = {}
    first = 0
    for kind, ids in cells.items():
        nodes = columns_of(ids)
        for side, rows in sides_of(kind):
            columns, here = [nodes[row] for row in rows], None
            if is_candidate is not None:
                # both copies of an inner face pass or fail together, so that counting candidates is
                # counting all
                here = np.flatnonzero(np.logical_and.reduce([is_candidate[column] for column in columns]))
                columns = [column[here] for column in columns]
            found.setdefault(side, []).append((columns, first, here))
        first += len(ids)
    return {
        side: _single(found[side], n) for side in sorted(found, key=lambda side: (CORNERS[SHAPES[side]], NODES[side]))
    }


def _single(parts: list[tuple[list[np.ndarray], int, np.ndarray | None]], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Finds the faces without an equal, and their cells.

    A part has faces by column, the number of the first cell, and the rows of the cells (None: all).
    """
    columns, owner = [], []
    for (part, first, here), rows in zip(parts, unpaired([part for part, *_ in parts], n), strict=True):
        columns.append([column[rows] for column in part])
        owner.append(first + (rows if here is None else here[rows]))
    joined = [np.concatenate(column) for column in zip(*columns, strict=True)]
    single = is_single(sorted_columns(joined, len(joined)))
    return np.stack([column[single] for column in joined], axis=1).astype(np.int64), np.concatenate(owner)[single]


def sides_of(kind: str) -> list[tuple[str, np.ndarray]]:
    """Lists the type of each face of a cell, and its nodes as rows of the cell; none for a line."""
    return [] if SHAPES[kind] == "line" else lagrange_types()[kind].sides


@functools.cache
def pieces_of(kind: str) -> dict[str, np.ndarray]:
    """Returns the pieces of a type: their nodes, as rows of the cell's nodes, by their own type."""
    cell = lagrange_types()[kind]
    if cell.order == 1:
        return {cell.shape: np.arange(cell.corners)[None]}
    pieces = _of_lattice(cell) if cell.is_complete else _of_edges(cell)
    return {shape: np.array(rows) for shape, rows in pieces.items() if len(rows)}


@functools.cache
def places_of(kind: str, m: int) -> np.ndarray:
    """Returns the shape functions (s, nodes) of a type at a lattice of m steps."""
    return values(kind, collapsed(kind, of_order(SHAPES[kind], m).reference))


@functools.cache
def steps_of(shape: str, m: int) -> dict[str, np.ndarray]:
    """Returns the linear pieces of a lattice of m steps, as rows of it, by type."""
    return {piece: np.array(rows) for piece, rows in _of_lattice(of_order(shape, m)).items() if len(rows)}


def _of_lattice(cell: Lagrange) -> dict[str, list]:
    place, p, shape = cell.place, cell.order, cell.shape

    def rows(corners: np.ndarray, starts: np.ndarray) -> list[list[int]]:
        every = starts[:, None] + corners
        inside = (depth(shape, p, every.reshape(-1, corners.shape[1])).reshape(every.shape[:2]) >= 0).all(axis=1)
        return [[place[tuple(at)] for at in piece] for piece in every[inside].tolist()]

    starts = np.indices((p,) * cell.dimension).reshape(cell.dimension, -1)[::-1].T
    if shape in ("line", "quad", "hexahedron"):
        return {shape: rows(np.array(PLACES[shape]), starts)}
    if shape == "wedge":
        up, down = np.array([(0, 0), (1, 0), (0, 1)]), np.array([(1, 0), (1, 1), (0, 1)])
        triangles = [np.concatenate([np.column_stack([base, np.full(3, z)]) for z in (0, 1)]) for base in (up, down)]
        return {shape: [row for corners in triangles for row in rows(corners, starts)]}
    if shape == "pyramid":
        return _of_pyramid(rows, starts)
    # sums of the last coordinates turn the simplex into p >= y1 >= y2 >= ... >= 0, which paths
    # along the axes fill
    back = np.linalg.inv(np.triu(np.ones((cell.dimension,) * 2)))
    pieces, starts = [], np.indices((p + 1,) * cell.dimension).reshape(cell.dimension, -1).T
    for axes in itertools.permutations(range(cell.dimension)):
        path = np.concatenate([np.zeros((1, cell.dimension)), np.cumsum(np.eye(cell.dimension)[list(axes)], axis=0)])
        corners = np.rint(path @ back.T).astype(np.int64)
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners[[-1, -2]] = corners[[-2, -1]]
        pieces += rows(corners, np.rint(starts @ back.T).astype(np.int64))
    return {shape: pieces}


def _of_pyramid(rows, starts: np.ndarray) -> dict[str, list]:
    upright = np.array(PLACES["pyramid"])
    turned = np.array([(0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 0, 1), (1, 1, 0)])
    along = np.array([(1, 0, 0), (1, 1, 0), (0, 0, 1), (1, 0, 1)])
    across = np.array([(0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1)])
    return {
        "pyramid": [*rows(upright, starts), *rows(turned, starts)],
        "tetra": [*rows(along, starts), *rows(across, starts)],
    }


def _of_edges(cell: Lagrange) -> dict[str, list]:
    """Cuts a cell of order 2 with nodes on its edges alone.

    Each corner is cut off, with the middles of its edges. What is left goes from one of its nodes
    to its sides: inner polygons of the faces, and triangles where corners were.
    """
    middle = {frozenset(ends): cell.corners + k for k, ends in enumerate(EDGES[cell.shape])}
    pieces: dict[str, list] = {"triangle": [], "quad": [], "tetra": [], "pyramid": []}
    if cell.dimension == 2:
        middles = [middle[frozenset(edge)] for edge in FACES[cell.shape]]
        pieces["triangle"] = [(corner, middles[corner], middles[corner - 1]) for corner in range(cell.corners)]
        return pieces | {"quad": [tuple(middles)]}
    sides = [
        tuple(middle[frozenset((corner, face[k - 1]))] for k, corner in enumerate(face)) for face in FACES[cell.shape]
    ]
    for corner, *ends in FRAMES[cell.shape]:
        a, b, c = (middle[frozenset((corner, end))] for end in ends)
        pieces["tetra"].append((corner, a, b, c))
        sides.append((a, c, b))
    if cell.shape == "pyramid":
        top = tuple(middle[frozenset((corner, 4))] for corner in range(4))
        pieces["pyramid"].append((*top, 4))
        sides.append(top)
    node = sides[-1][0]
    for side in sides:
        if node not in side:
            pieces["tetra" if len(side) == 3 else "pyramid"].append((side[0], *side[:0:-1], node))
    return pieces
