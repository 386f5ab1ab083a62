"""Which cells share a face, and which of them are numbered the other way round."""

from typing import Any

import numpy as np
from scipy import sparse

from .topology import FACES


def neighbours(cells: dict[str, Any], xp: Any = np) -> tuple[Any, Any]:
    """The cell behind each face of each cell.

    `cells` maps a type to its corner ids (k, corners). Both arrays returned have one entry for each face, cells in the
    order of `cells`, the faces of one cell in that of `FACES`: the id of the neighbour, -1 on the boundary and where
    more than two cells meet; and whether the neighbour is numbered with the other handedness.

    `xp` is the array module: NumPy, or `jax.numpy` where the corner ids are traced (all shapes are static).
    """
    rows, turns, owners, first = [], [], [], 0
    width = max((len(face) for kind in cells for face in FACES[kind]), default=2)
    for kind, corners in cells.items():
        k = len(corners)
        if FACES[kind]:
            if xp is np and k and corners.max() < 2**31:
                corners = corners.astype(np.int32)  # half the memory of the tables of faces
            sides = [_side(corners[:, np.array(face)], width, xp) for face in FACES[kind]]
            rows.append(xp.stack([row for row, _ in sides], axis=1).reshape(-1, width))
            turns.append(xp.stack([turn for _, turn in sides], axis=1).reshape(-1))
            owners.append(np.repeat(np.arange(first, first + k, dtype=np.int32), len(FACES[kind])))
        first += k
    if not rows:
        return xp.zeros(0, dtype=np.int32), xp.zeros(0, dtype=bool)
    return _pair(xp.concatenate(rows), xp.concatenate(turns), np.concatenate(owners), xp)


def _side(face: Any, width: int, xp: Any) -> tuple[Any, Any]:
    """Sorted corners of one face of many cells, padded with -1; and the sense in which they run."""
    corners = face.shape[1]
    ids = xp.sort(face, axis=1)
    ids = xp.concatenate([ids, xp.full((len(ids), width - corners), -1, dtype=ids.dtype)], axis=1)
    if corners == 2:
        return ids, face[:, 0] < face[:, 1]
    lowest = xp.argmin(face, axis=1)[:, None]
    after = xp.take_along_axis(face, (lowest + 1) % corners, axis=1)
    before = xp.take_along_axis(face, (lowest - 1) % corners, axis=1)
    return ids, (after < before)[:, 0]


def _pair(rows: Any, turns: Any, owners: np.ndarray, xp: Any) -> tuple[Any, Any]:
    """Equal rows find each other by sorting."""
    order = _order(rows, xp)
    same = xp.ones(max(len(rows) - 1, 0), dtype=bool)
    for column in range(rows.shape[1]):
        ordered = rows[order, column]
        same = same & (ordered[1:] == ordered[:-1])
    no = xp.zeros(1, dtype=bool)
    with_next, with_last = xp.concatenate([same, no]), xp.concatenate([no, same])
    crowded = with_next & with_last
    crowded = crowded | (with_next & xp.roll(crowded, -1)) | (with_last & xp.roll(crowded, 1))
    partner = xp.where(with_next, xp.roll(order, -1), xp.where(with_last, xp.roll(order, 1), -1))
    partner = xp.where(crowded, -1, partner)
    twin = partner[xp.argsort(order)] if xp is not np else _scatter(order, partner)
    owners = xp.asarray(owners)
    neighbour = xp.where(twin < 0, -1, owners[twin])
    return neighbour, (twin >= 0) & (turns == turns[twin])


def _order(rows: Any, xp: Any) -> Any:
    if xp is not np:
        return xp.lexsort(tuple(rows[:, column] for column in reversed(range(rows.shape[1]))))
    key, base = rows[:, 0].astype(np.int64), int(rows.max()) + 2
    keys, room = [], base
    for column in range(1, rows.shape[1]):
        if room > 2**62 // base:
            keys.append(key)
            key, room = np.zeros(len(rows), dtype=np.int64), 1
        key, room = key * base + (rows[:, column] + 1), room * base
    keys.append(key)
    return np.argsort(keys[0]) if len(keys) == 1 else np.lexsort(keys[::-1])


def _scatter(order: np.ndarray, values: np.ndarray) -> np.ndarray:
    result = np.empty_like(values)
    result[order] = values
    return result


def handedness(cells: dict[str, Any], neighbour: np.ndarray, flipped: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which cells of one connected part are numbered alike: a sign for each cell, and the id of its part.

    Cells connected through faces have the same sign when their numbering has the same handedness. It is a statement
    about ids alone: no coordinate enters. A part that cannot be oriented (a Moebius strip) has sign 1 throughout.
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
    graph = sparse.coo_matrix((np.ones(len(start), dtype=bool), (start, end)), shape=(2 * count, 2 * count))
    _, sheet = sparse.csgraph.connected_components(graph, directed=False)
    return np.where(sheet[:count] <= sheet[count:], 1, -1), np.minimum(sheet[:count], sheet[count:])


def _firsts(cells: dict[str, Any]) -> list[tuple[tuple[str, Any], int]]:
    """Each type with its corner ids, and the id of its first cell."""
    firsts = np.cumsum([0, *(len(corners) for corners in cells.values())])
    return list(zip(cells.items(), firsts.tolist(), strict=False))
