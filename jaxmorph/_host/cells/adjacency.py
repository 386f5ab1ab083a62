"""Neighbours of cells: the cells that share a face, and whether they are numbered alike."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .pairs import columns_of, parts_of, sorted_columns, twins
from .topology import FACES


def neighbours(cells: dict[str, Any], xp: Any = np) -> tuple[Any, Any]:
    """Finds the cell behind each face of each cell.

    Two cells are neighbours when a face of one has the nodes of a face of the other. Sorting the rows of sorted nodes brings
    equal faces together. The sense in which the two run round the face tells whether the cells are numbered alike.

    **Arguments:**

    - `cells`: corner ids (k, corners) by type.
    - `xp`: the array module: NumPy, or `jax.numpy` where the corner ids are traced (all shapes are static).

    **Returns:**

    Two arrays with one entry for each face. Cells are in the order of `cells`, the faces of one cell in that of `FACES`.

    - The id of the neighbour, -1 on the boundary and where more than two cells meet.
    - True where the neighbour is numbered with the other handedness.
    """
    # Each face becomes a row of its sorted nodes, with its cell and the sense in which it runs. `twins` sorts all rows, so
    # that equal faces stand side by side: the twin's cell is the neighbour. Two cells that are numbered alike run round their
    # common face in opposite senses.
    columns, turns, owners, first = [], [], [], 0
    width = max((len(face) for kind in cells for face in FACES[kind]), default=2)
    for kind, corners in cells.items():
        nodes = columns_of(corners) if xp is np else list(corners.T)
        for face in FACES[kind]:
            side = [nodes[corner] for corner in face]
            columns.append(sorted_columns(side, width, xp))
            turns.append(_turns(side, columns[-1], xp))
            owners.append(np.arange(first, first + len(corners), dtype=np.int32))
        first += len(corners)
    if not columns:
        return xp.zeros(0, dtype=np.int32), xp.zeros(0, dtype=bool)
    turn, owner = xp.concatenate(turns), xp.asarray(np.concatenate(owners))
    twin = twins([xp.concatenate(parts) for parts in zip(*columns, strict=True)], xp)
    neighbour, flipped = xp.where(twin < 0, -1, owner[twin]), (twin >= 0) & (turn == turn[twin])
    return _by_cell(neighbour, cells, xp), _by_cell(flipped, cells, xp)


def _turns(nodes: Sequence[Any], ordered: Sequence[Any], xp: Any) -> Any:
    """Finds the sense of each face: whether the lower neighbour follows the lowest node."""
    if len(nodes) == 2:
        return nodes[0] < nodes[1]
    turns = xp.zeros(len(nodes[0]), dtype=bool)
    for corner, node in enumerate(nodes):
        turns = turns | ((node == ordered[0]) & (nodes[(corner + 1) % len(nodes)] < nodes[corner - 1]))
    return turns


def _by_cell(values: Any, cells: dict[str, Any], xp: Any) -> Any:
    """Reorders values that stand face by face, so that all faces of one cell follow each other."""
    parts, first = [], 0
    for kind, corners in cells.items():
        last = first + len(FACES[kind]) * len(corners)
        parts.append(values[first:last].reshape(len(FACES[kind]), len(corners)).T.reshape(-1))
        first = last
    return xp.concatenate(parts)


def handedness(cells: dict[str, Any], neighbour: np.ndarray, flipped: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds the orientation sign of each cell, and the connected part that it belongs to.

    Cells connected through faces have the same sign when their numbering has the same handedness. Ids alone decide it: no
    coordinate enters. A part that cannot be oriented (a Moebius strip) has sign 1 throughout.

    **Arguments:**

    - `cells`: corner ids (k, corners) by type.
    - `neighbour`, `flipped`: what `neighbours` returns for them.

    **Returns:**

    Two arrays with one entry for each cell: its sign, 1 or -1, and the id of its part.
    """
    count = sum(len(corners) for corners in cells.values())
    owner = np.concatenate(
        [np.repeat(np.arange(len(corners)), len(FACES[kind])) + first for (kind, corners), first in _firsts(cells)]
        or [np.zeros(0, dtype=np.int64)]
    )
    inner = (neighbour >= 0) & (owner < neighbour)
    a, b, other = owner[inner], neighbour[inner], flipped[inner] * count
    # two sheets, one for each sign: crossing a face where the numbering turns round changes the sheet
    start = np.concatenate([a, a + count])
    end = np.concatenate([b + other, b + count - other])
    sheet = parts_of(start, end, 2 * count)
    return np.where(sheet[:count] <= sheet[count:], 1, -1), np.minimum(sheet[:count], sheet[count:])


def _firsts(cells: dict[str, Any]) -> list[tuple[tuple[str, Any], int]]:
    """Lists each type with its corner ids, and the id of its first cell."""
    firsts = np.cumsum([0, *(len(corners) for corners in cells.values())])
    return list(zip(cells.items(), firsts.tolist(), strict=False))
