"""Neighbours of cells, the handedness of their numbering, and parts that pairs connect."""

import functools
import itertools
from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from ..package.cores import in_order, over_blocks
from .topology import FACES, ByType, Pair


def neighbours(cells: ByType) -> Pair:
    """Finds the cell behind every face of `cells`, corner ids (k, corners) by type. Returns two
    arrays with one entry a face, by cell, faces in the order of `FACES`. The first has the id of
    the neighbour. It is -1 on the boundary, where more than two cells meet, and at a face without
    extent, as at a grid's pole. The second is True where the neighbour is numbered with the
    opposite handedness.
    """
    # A face becomes a row of its sorted nodes, with its cell and its sense of rotation. `twins`
    # sorts all rows: equal faces are neighbours. Two cells of one handedness run round their common
    # face in opposite senses.
    columns = []
    turns = []
    owners = []
    slots = []
    first = 0
    slot = 0
    width = max((len(face) for kind in cells for face in FACES[kind]), default=2)
    for kind, corners in cells.items():
        nodes = columns_of(corners)
        faces = FACES[kind]
        for number, face in enumerate(faces):
            side = [nodes[corner] for corner in face]
            columns.append(sorted_columns(side, width))
            turns.append(_senses(side, columns[-1]))
            owners.append(np.arange(first, first + len(corners), dtype=np.int32))
            slots.append(np.arange(slot + number, slot + len(faces) * len(corners), len(faces)))
        first = first + len(corners)
        slot = slot + len(faces) * len(corners)
    neighbour = np.empty(slot, dtype=np.int32)
    flipped = np.empty(slot, dtype=bool)
    if slot:
        turn, owner, place = (np.concatenate(parts) for parts in (turns, owners, slots))
        rows = [np.concatenate(parts) for parts in zip(*columns, strict=True)]
        twin = np.where(_has_extent(rows), twins(rows), -1)
        neighbour[place] = np.where(twin < 0, -1, owner[twin])
        flipped[place] = (twin >= 0) & (turn == turn[twin])
    return neighbour, flipped


def _senses(nodes: Sequence[ndarray], ordered: Sequence[ndarray]) -> ndarray:
    if len(nodes) == 2:
        return nodes[0] < nodes[1]
    here = np.stack(nodes)
    after, before, opposite = (np.roll(here, shift, axis=0) for shift in (-1, 1, 2))
    before = np.where(before == here, opposite, before)  # the lowest node may be repeated
    return ((here == ordered[0]) & (after != here) & (after < before)).any(axis=0)


def _has_extent(rows: Sequence[ndarray]) -> ndarray:
    """Marks faces of three different nodes or more, edges of two: their sorted nodes by column."""
    steps = [(a != b) & (b >= 0) for a, b in itertools.pairwise(rows)]
    return (
        np.sum(steps, axis=0, dtype=np.int8) >= np.where(rows[2] < 0, 1, 2)
        if len(rows) > 2
        else steps[0]
    )


def handedness(cells: ByType, neighbour: ndarray, flipped: ndarray) -> Pair:
    """Returns each cell's orientation sign, 1 or -1, and the id of its connected part, from
    `neighbour` and `flipped` of `neighbours`: ids alone decide, no coordinates. A part that cannot
    be oriented (a Moebius strip) has sign 1 throughout.
    """
    sizes = np.array(
        [(len(FACES[kind]), len(corners)) for kind, corners in cells.items()], int
    ).reshape(-1, 2)
    count = int(sizes[:, 1].sum())
    faces = np.repeat(sizes[:, 0], sizes[:, 1])
    owner = np.repeat(np.arange(count), faces)
    inner = (neighbour >= 0) & (owner < neighbour)
    a = owner[inner]
    b = neighbour[inner]
    other = flipped[inner] * count
    if not other.any():
        return np.ones(count, dtype=int), parts_of(a, b, count)
    # A cell stands on two sheets, one for each sign. A face between cells of opposite handedness
    # connects different sheets. The sheets of an orientable part stay two parts.
    start = np.concatenate([a, a + count])
    end = np.concatenate([b + other, b + count - other])
    sheet = parts_of(start, end, 2 * count)
    return np.where(sheet[:count] <= sheet[count:], 1, -1), np.minimum(sheet[:count], sheet[count:])


def parts_of(first: ndarray, second: ndarray, count: int) -> ndarray:
    """Connected parts of nodes (count,); `first` (e,) and `second` (e,) are connected."""
    # 0.2 s, which few commands need
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def sorted_columns(nodes: Sequence[ndarray], width: int) -> list[ndarray]:
    """Sorts nodes of faces, by columns (f,); columns of -1 follow, up to the `width`."""
    columns = [np.empty_like(column) for column in nodes]

    def sort(rows: slice) -> None:
        # Neighbouring columns swap entries until every row ascends: for few columns several times
        # faster than a sort of rows.
        parts = [column[rows] for column in nodes]
        for sweep in range(len(parts)):
            for low in range(sweep % 2, len(parts) - 1, 2):
                a = parts[low]
                b = parts[low + 1]
                parts[low] = np.minimum(a, b)
                parts[low + 1] = np.maximum(a, b)
        for column, part in zip(columns, parts, strict=True):
            column[rows] = part

    over_blocks(sort, len(columns[0]))
    return columns + [np.full_like(columns[0], -1)] * (width - len(columns))


def columns_of(corners: ndarray) -> list[ndarray]:
    """Splits corner ids (k, c) into c columns (k,): contiguous, in 32 bits where the ids fit."""
    dtype = np.int32 if corners.max(initial=0) < 2**31 else np.int64
    return [np.ascontiguousarray(corners[:, column], dtype) for column in range(corners.shape[1])]


def twins(columns: Sequence[ndarray]) -> ndarray:
    """The row of the other face with equal nodes (f,); -1 for none or several."""
    order, first, size = _groups(columns)
    one = order[first[size == 2]]
    other = order[first[size == 2] + 1]
    partner = np.full(len(order), -1)
    partner[one] = other
    partner[other] = one
    return partner


def is_single(columns: Sequence[ndarray]) -> ndarray:
    """Marks (f,) the faces that equal no other face, by their sorted nodes."""
    order, first, size = _groups(columns)
    single = np.zeros(len(order), dtype=bool)
    single[order[first[size == 1]]] = True
    return single


def _groups(columns: Sequence[ndarray]) -> tuple[ndarray, ndarray, ndarray]:
    """Brings equal faces side by side: their order, where each group begins, and its size."""
    keys = list(columns)
    if columns[0].dtype == np.int32:  # two nodes make one key; -1 stays the least
        both = itertools.zip_longest(
            columns[::2], columns[1::2], fillvalue=np.zeros_like(columns[0])
        )
        keys = [(first.astype(np.int64) << 32) + second for first, second in both]
    order = np.lexsort(keys[::-1])
    begins = np.ones(len(order), dtype=bool)
    begins[1:] = np.logical_or.reduce([np.diff(key[order]) != 0 for key in keys])
    first = np.flatnonzero(begins)
    return order, first, np.diff(first, append=len(order))


def unpaired(parts: Sequence[Sequence[ndarray]], n: int) -> list[ndarray]:
    """The rows of each part, columns of nodes below n, without most faces that come twice."""
    # A face has a random number, made of its nodes in any order. The numbers of two equal faces
    # cancel each other in an "exclusive or" over all faces of their first node. Few faces of a mesh
    # are left for exact work.
    random = np.random.default_rng(n).integers(0, 2**64, n, dtype=np.uint64)
    left = np.zeros(n, np.uint64)
    firsts = []

    def numbered(columns: Sequence[ndarray]) -> Pair:
        number = functools.reduce(np.add, (random[column] for column in columns))
        return functools.reduce(np.minimum, columns), number * (number | np.uint64(1))

    for first, number in in_order(numbered, parts):
        np.bitwise_xor.at(left, first, number)
        firsts.append(first)
    return list(in_order(lambda first: np.flatnonzero(left[first]), firsts))


def is_among(faces: ndarray, others: ndarray) -> ndarray:
    """Marks (f,) the faces (f, c) that equal one of the `others` (k, e), which are distinct."""
    width = max(faces.shape[1], others.shape[1])
    first, second = (sorted_columns(columns_of(table), width) for table in (faces, others))
    twin = twins([np.concatenate(both) for both in zip(first, second, strict=True)])
    return twin[: len(faces)] >= len(faces)


def repeated_cells(corners: ndarray) -> ndarray:
    """Rows, ascending, of cells (k, corners) with the nodes of another cell in any order."""
    return np.flatnonzero(~is_single(sorted_columns(columns_of(corners), corners.shape[1])))
