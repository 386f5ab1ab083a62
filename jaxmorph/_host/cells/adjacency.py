"""Neighbours of cells, the handedness of their numbering, and parts that pairs connect."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .pairs import columns_of, sorted_columns, twins
from .topology import FACES


def neighbours(cells: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Finds the cell behind every face of all cells.

    Two cells are neighbours if a face of one has the nodes of a face of the other.

    **Arguments:**

    - `cells`: corner ids (k, corners) by type.

    **Returns:**

    Two arrays with one entry a face: cells in the order of `cells`, faces of a cell in the order of
    `FACES`.

    - The id of the neighbour, -1 on the boundary and where more than two cells meet. Also -1 at a
      face that repeats nodes until it has no extent, as at the pole of a grid of hexahedra.
    - True where the neighbour is numbered with the opposite handedness.
    """
    # A face becomes a row of its sorted nodes, with its cell and its sense of rotation. `twins`
    # sorts all rows, so that equal faces stand side by side: the twin's cell is the neighbour. Two
    # cells of one handedness run round their common face in opposite senses.
    columns, turns, owners, first = [], [], [], 0
    width = max((len(face) for kind in cells for face in FACES[kind]), default=2)
    for kind, corners in cells.items():
        nodes = columns_of(corners)
        for face in FACES[kind]:
            side = [nodes[corner] for corner in face]
            columns.append(sorted_columns(side, width))
            turns.append(_turns(side, columns[-1]))
            owners.append(np.arange(first, first + len(corners), dtype=np.int32))
        first += len(corners)
    if not columns:
        return np.zeros(0, dtype=np.int32), np.zeros(0, dtype=bool)
    turn, owner = np.concatenate(turns), np.concatenate(owners)
    rows = [np.concatenate(parts) for parts in zip(*columns, strict=True)]
    twin = np.where(_has_extent(rows), twins(rows), -1)
    neighbour, flipped = np.where(twin < 0, -1, owner[twin]), (twin >= 0) & (turn == turn[twin])
    return _by_cell(neighbour, cells), _by_cell(flipped, cells)


def _turns(nodes: Sequence[np.ndarray], ordered: Sequence[np.ndarray]) -> np.ndarray:
    """Finds the sense of faces: True if the lower neighbour follows the lowest node."""
    if len(nodes) == 2:
        return nodes[0] < nodes[1]
    turns = np.zeros(len(nodes[0]), dtype=bool)
    for corner, node in enumerate(nodes):
        after, before = nodes[(corner + 1) % len(nodes)], nodes[corner - 1]
        before = np.where(before == node, nodes[corner - 2], before)  # the lowest node may be repeated
        turns |= (node == ordered[0]) & (after != node) & (after < before)
    return turns


def _has_extent(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Marks faces of three different nodes or more, edges of two: their sorted nodes by column."""
    steps = [(a != b) & (b >= 0) for a, b in itertools.pairwise(rows)]
    return np.sum(steps, axis=0, dtype=np.int8) >= np.where(rows[2] < 0, 1, 2) if len(rows) > 2 else steps[0]


def _by_cell(values: np.ndarray, cells: Mapping[str, np.ndarray]) -> np.ndarray:
    """Reorders values that stand face by face, so that all faces of one cell follow each other."""
    parts, first = [], 0
    for kind, corners in cells.items():
        last = first + len(FACES[kind]) * len(corners)
        parts.append(values[first:last].reshape(len(FACES[kind]), len(corners)).T.reshape(-1))
        first = last
    return np.concatenate(parts)


def handedness(
    cells: Mapping[str, np.ndarray], neighbour: np.ndarray, flipped: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the orientation sign of all cells, and their connected parts.

    Cells that faces connect have equal signs if their numbering has one handedness. Ids alone
    decide, no coordinates. A part that cannot be oriented (a Moebius strip) has sign 1 throughout.

    **Arguments:**

    - `cells`: corner ids (k, corners) by type.
    - `neighbour`, `flipped`: what `neighbours` returns for them.

    **Returns:**

    Two arrays with one entry a cell: its sign, 1 or -1, and the id of its part.
    """
    count = sum(len(corners) for corners in cells.values())
    faces = [np.full(len(corners), len(FACES[kind])) for kind, corners in cells.items()]
    owner = np.repeat(np.arange(count), np.concatenate([np.zeros(0, dtype=int), *faces]))
    inner = (neighbour >= 0) & (owner < neighbour)
    a, b, other = owner[inner], neighbour[inner], flipped[inner] * count
    if not other.any():
        return np.ones(count, dtype=int), parts_of(a, b, count)
    # A cell stands on two sheets, one for each sign. A face between cells of opposite handedness
    # connects different sheets. The sheets of an orientable part stay two parts.
    start = np.concatenate([a, a + count])
    end = np.concatenate([b + other, b + count - other])
    sheet = parts_of(start, end, 2 * count)
    return np.where(sheet[:count] <= sheet[count:], 1, -1), np.minimum(sheet[:count], sheet[count:])


def parts_of(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Numbers connected parts of nodes (count,); `first` (e,) and `second` (e,) are connected."""
    graph = coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
