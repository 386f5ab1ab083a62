"""Pairs of equal faces: faces with equal nodes in any order. Also parts connected by pairs."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def sorted_columns(nodes: Sequence[Any], width: int, xp: Any = np) -> list[Any]:
    """Sorts the nodes of each face: first nodes (f,), second nodes (f,), ... in, `width` such columns out.

    Columns behind the last node hold -1.
    """
    columns = list(nodes)
    # neighbouring columns swap until every row ascends: for few columns several times faster than a sort of each row
    for sweep in range(len(columns)):
        for low in range(sweep % 2, len(columns) - 1, 2):
            a, b = columns[low], columns[low + 1]
            columns[low], columns[low + 1] = xp.minimum(a, b), xp.maximum(a, b)
    return columns + [xp.full_like(columns[0], -1)] * (width - len(columns))


def columns_of(corners: np.ndarray) -> list[np.ndarray]:
    """Splits corner ids (k, c) into c columns (k,): contiguous, in 32 bits where the ids fit."""
    dtype = np.int32 if corners.max(initial=0) < 2**31 else np.int64
    return [np.ascontiguousarray(corners[:, column], dtype) for column in range(corners.shape[1])]


def twins(columns: Sequence[Any], xp: Any = np) -> Any:
    """Finds for each face the other face with the same nodes: its row, -1 where there is none or more than one.

    **Arguments:**

    - `columns`: the nodes of the faces, sorted (see `sorted_columns`).
    - `xp`: the array module: NumPy, or `jax.numpy` where the nodes are traced.
    """
    order, same = _ordered(columns, xp)
    no = xp.zeros(1, dtype=bool)
    with_next, with_last = xp.concatenate([same, no]), xp.concatenate([no, same])
    crowded = with_next & with_last
    crowded = crowded | (with_next & xp.roll(crowded, -1)) | (with_last & xp.roll(crowded, 1))
    partner = xp.where(with_next, xp.roll(order, -1), xp.where(with_last, xp.roll(order, 1), -1))
    partner = xp.where(crowded, -1, partner)
    return partner[xp.argsort(order)] if xp is not np else _scatter(order, partner)


def is_single(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Finds the faces that no other face equals: a mask (f,). `columns` are their nodes, sorted."""
    order, same = _ordered(columns, np)
    repeated = np.zeros(len(order), bool)
    repeated[1:] |= same
    repeated[:-1] |= same
    return _scatter(order, ~repeated)


def unpaired(parts: Sequence[Sequence[np.ndarray]], n: int) -> list[list[np.ndarray]]:
    """Drops faces that surely come twice: faces whose first node has only pairs of equal faces.

    A mesh has few others, so what looks at the rest is fast. Each part has the nodes of its faces by column; there are n nodes.
    """
    # faces have random numbers by their nodes, whatever the order; those of two equal faces cancel each other
    random = np.random.default_rng(n).integers(0, 2**64, n, dtype=np.uint64)
    left, firsts = np.zeros(n, np.uint64), []
    for columns in parts:
        firsts.append(functools.reduce(np.minimum, columns))
        number = functools.reduce(np.add, (random[column] for column in columns))
        np.bitwise_xor.at(left, firsts[-1], number * (number | np.uint64(1)))
    kept = [left[first] != 0 for first in firsts]
    return [[column[keep] for column in columns] for columns, keep in zip(parts, kept, strict=True)]


def is_among(faces: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Marks (f,) the faces (f, c) whose nodes are the nodes of one of the `others` (k, e).

    No face of `others` comes twice; rows are filled up by -1.
    """
    width = max(faces.shape[1], others.shape[1])
    both = np.full((len(faces) + len(others), width), -1, np.int64)
    both[: len(faces), : faces.shape[1]], both[len(faces) :, : others.shape[1]] = faces, others
    return twins(sorted_columns(columns_of(both), width))[: len(faces)] >= len(faces)


def _ordered(columns: Sequence[Any], xp: Any) -> tuple[Any, Any]:
    """Brings equal faces side by side: the order, and whether each face of it equals the next one."""
    if xp is not np:
        order = xp.lexsort(tuple(reversed(columns)))
        return order, _equals_next(columns, order, xp)
    keys = _keys(columns)
    order = np.argsort(keys)
    same = _equals_next(columns, order, xp)
    if not np.array_equal(same, _equals_next([keys], order, xp)):  # different faces share a key: the slow way is exact
        order = np.lexsort(tuple(reversed(columns)))
        same = _equals_next(columns, order, xp)
    return order, same


def _equals_next(columns: Sequence[Any], order: Any, xp: Any) -> Any:
    same = xp.ones(max(len(order) - 1, 0), dtype=bool)
    for column in columns:
        ordered = column[order]
        same = same & (ordered[1:] == ordered[:-1])
    return same


def _keys(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Packs each face into one integer: its first node in the upper bits, a hash of the others in the lower ones.

    One sort of integers then replaces a sort by columns. Keys of a mesh ascend almost as its faces do, which makes the sort
    fast. Faces with the same key are equal, except by an accident that `_ordered` sees.
    """
    first = columns[0].astype(np.int64)
    digest = np.zeros(len(first), np.uint64)
    for column in columns[1:]:
        digest = (digest ^ column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)  # odd, bits without a pattern
        digest ^= digest >> np.uint64(29)
    free = 63 - int(first.max(initial=0)).bit_length()
    return (first << free) | (digest >> np.uint64(64 - free)).astype(np.int64)


def _scatter(order: np.ndarray, values: np.ndarray) -> np.ndarray:
    result = np.empty_like(values)
    result[order] = values
    return result


def parts_of(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Numbers the connected part (count,) of each node; `first` (e,) and `second` (e,) are connected."""
    graph = coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
