"""Linear pieces of cells of high order, between all of their nodes; and faces of such cells.

The pieces of two neighbours meet in equal faces, and each piece of a straight cell is right-handed.
One exception: of a 3-D cell with nodes on edges alone, two inner quadrilaterals are cut in two.
"""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from ..rows import mark
from .adjacency import columns_of, is_single, sorted_columns, unpaired
from .lagrange import collapsed, depth, lagrange_types, of_order, shape_values
from .topology import CORNERS, NODES, SHAPES, ByType, Pair, digits, numbers_by_name


def linear_cells(cells: Mapping[str, Any], join: Any = np.concatenate) -> dict[str, Any]:
    """Cuts cells into linear pieces; a cell's pieces are consecutive within their type."""
    result: dict[str, list[Any]] = {}
    for kind, ids in cells.items():
        for shape, rows in pieces_of(kind).items():
            result.setdefault(shape, []).append(
                ids if kind == shape else ids[:, rows].reshape(-1, rows.shape[1])
            )
    return {shape: parts[0] if len(parts) == 1 else join(parts) for shape, parts in result.items()}


def owners(cells: Mapping[str, Any]) -> dict[str, ndarray]:
    """The cell of each of the `linear_cells`, by type; cells are numbered as in `cells`."""
    nodes = {}
    first = 0
    for kind, ids in cells.items():
        nodes[kind] = np.repeat(np.arange(first, first + len(ids))[:, None], NODES[kind], axis=1)
        first += len(ids)
    return {shape: corners[:, 0] for shape, corners in linear_cells(nodes).items()}


def outer_pieces(cells: ByType, n: int, among: ndarray | None = None) -> dict[str, ndarray]:
    return linear_cells({kind: ids for kind, (ids, _) in owned_sides(cells, n, among).items()})


def owned_sides(cells: ByType, n: int, among: ndarray | None = None) -> dict[str, Pair]:
    """Finds faces (f, nodes) that belong to one cell only (2-D: edges), by type, with all of their
    nodes, counterclockwise as seen from outside. Also returns the cell (f,) of each, numbered as in
    `cells`, node ids (k, nodes) by type below `n`. All nodes of a face are `among` these ids.
    """
    is_candidate = mark(n, *[] if among is None else [among])
    found: dict[str, list[tuple[list[ndarray], ndarray]]] = {}
    first = 0
    for kind, ids in cells.items():
        nodes = columns_of(ids)
        every = np.arange(first, first + len(ids))
        for side, rows in lagrange_types()[kind].sides:
            columns = [nodes[row] for row in rows]
            owner = every
            if among is not None:
                # both copies of an inner face pass or fail together
                here = np.flatnonzero(
                    np.logical_and.reduce([is_candidate[column] for column in columns])
                )
                columns = [column[here] for column in columns]
                owner = every[here]
            found.setdefault(side, []).append((columns, owner))
        first += len(ids)
    sides = sorted(found, key=lambda side: (CORNERS[SHAPES[side]], NODES[side]))
    return {side: _keep_single(found[side], n) for side in sides}


def _keep_single(parts: list[tuple[list[ndarray], ndarray]], n: int) -> Pair:
    """Finds unique faces and their cells, from faces by column, and their cells."""
    rows = unpaired([columns for columns, _ in parts], n)
    columns = [
        [column[left] for column in part] for (part, _), left in zip(parts, rows, strict=True)
    ]
    owner = np.concatenate([cells[left] for (_, cells), left in zip(parts, rows, strict=True)])
    joined = [np.concatenate(column) for column in zip(*columns, strict=True)]
    single = is_single(sorted_columns(joined, len(joined)))
    return np.stack([column[single] for column in joined], axis=1).astype(np.int64), owner[single]


@functools.cache
def pieces_of(kind: str) -> dict[str, ndarray]:
    """The pieces of a type: their nodes, as rows of the cell's nodes, by their own type."""
    if kind in ON_EDGES:
        return {shape: np.array(rows) for shape, rows in ON_EDGES[kind].items()}
    return steps_of(SHAPES[kind], lagrange_types()[kind].order)


@functools.cache
def places_of(kind: str, m: int) -> ndarray:
    """The shape functions (s, nodes) of a type at a lattice of m steps."""
    return shape_values(kind, collapsed(kind, of_order(SHAPES[kind], m).reference))


@functools.cache
def steps_of(shape: str, m: int) -> dict[str, ndarray]:
    """The linear pieces of a lattice of m steps, as rows of it, by type."""
    cell = of_order(shape, m)
    pieces = {}
    starts = np.indices((m + 1,) * cell.dimension).reshape(cell.dimension, -1)[::-1].T
    if shape in ("triangle", "tetra"):  # by sums of the last coordinates
        starts = starts[:, ::-1].copy()
        starts[:, :-1] -= starts[:, 1:]
    for piece, units in UNITS[shape].items():
        every = np.concatenate([starts[:, None] + digits(unit) for unit in units])
        is_inside = (
            (depth(shape, m, every.reshape(-1, cell.dimension)) >= 0)
            .reshape(every.shape[:2])
            .all(axis=1)
        )
        if is_inside.any():
            pieces[piece] = cell.nodes_at(every[is_inside])
    return pieces


ON_EDGES = {
    "quad8": numbers_by_name({"triangle": "047 154 265 376", "quad": "4567"}),
    "pyramid13": numbers_by_name(
        {
            "tetra": "0589 165a 276b 387c ab69 bc79 65a9 76b9 87c9",
            "pyramid": "9abc4 56789",
        }
    ),
    "wedge15": numbers_by_name(
        {
            "tetra": "068c 176d 287e 3b9c 49ad 5abe 678a 68ca 76da 87ea b9ca",
            "pyramid": "c9d6a ebc8a",
        }
    ),
    "hexahedron20": numbers_by_name(
        {
            "tetra": "08bg 198h 2a9i 3baj 4fcg 5cdh 6dei 7efj 8bge 98he a9ie baje fcge cdhe",
            "pyramid": "89abe gch8e hdi9e jfgbe",
        }
    ),
}
"""Pieces of cells without inner nodes; a is node 10. Each corner is cut off, with the middles of
its edges. The rest goes from one of its nodes to its sides: inner polygons of the faces, and
triangles at the corners.
"""

UNITS = {
    "line": {"line": ("0 1",)},
    "triangle": {"triangle": ("00 10 01", "10 11 01")},
    "quad": {"quad": ("00 10 11 01",)},
    "tetra": {
        "tetra": (
            *("000 100 010 001", "010 110 011 101", "100 010 101 110"),
            *("100 010 001 101", "010 001 101 011", "110 101 111 011"),
        )
    },
    "pyramid": {
        "pyramid": ("000 100 110 010 001", "001 011 111 101 110"),
        "tetra": ("100 110 001 101", "010 001 110 011"),
    },
    "wedge": {"wedge": ("000 100 010 001 101 011", "100 110 010 101 111 011")},
    "hexahedron": {"hexahedron": ("000 100 110 010 001 101 111 011",)},
}
"""Corners of the pieces that begin at a place of the lattice, by shape and type of piece."""
