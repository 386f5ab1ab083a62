"""The boundary of a mesh whose cells are read some at a time."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from jaxmorph._host.cells.pairs import columns_of, sorted_columns
from jaxmorph._host.cells.topology import FACES, boundary_faces

Cells = Callable[[], Iterator[Mapping[str, np.ndarray]]]
"""Reads all cells anew, a block at a time: corners (k, corners) by type."""


def outer_faces(cells: Cells, n: int, patches: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Finds the faces of one cell only between `n` nodes, by type. Memory is that of the boundary and of one block.

    Nodes of `patches` are looked at first. Where they are not the whole boundary, the cells are read twice more, and all
    nodes have 8 bytes.
    """
    held = np.zeros(n, dtype=bool)
    for nodes in patches.values():
        held[nodes] = True
    faces, is_whole = _between(cells, held)
    return faces if is_whole else _between(cells, _on_boundary(cells, n))[0]


def _between(cells: Cells, held: np.ndarray) -> tuple[dict[str, np.ndarray], bool]:
    """Finds the outer faces between marked nodes, and whether there are no others."""
    kept: dict[str, list[np.ndarray]] = {}
    left = np.uint64(0)
    for block in cells():
        for kind, corners in block.items():
            columns, inside = columns_of(corners), held[corners]
            for side in FACES[kind]:
                left ^= np.bitwise_xor.reduce(_numbers(_sides(columns, side)))
            # both cells of an inner face between marked nodes are kept: what is left single is the boundary
            has_side = np.logical_or.reduce([inside[:, list(side)].all(axis=1) for side in FACES[kind]])
            kept.setdefault(kind, []).append(corners[has_side])
    tables = {kind: np.concatenate(each) for kind, each in sorted(kept.items())}
    nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(each.ravel() for each in tables.values())]))
    local = {kind: np.searchsorted(nodes, each) for kind, each in tables.items()}
    outer = boundary_faces(local, len(nodes), np.flatnonzero(held[nodes]))
    faces = {kind: nodes[each] for kind, each in outer.items() if len(each)}
    for each in faces.values():
        left ^= np.bitwise_xor.reduce(_numbers(sorted_columns(columns_of(each), each.shape[1])))
    return faces, not left


def _on_boundary(cells: Cells, n: int) -> np.ndarray:
    """Marks the nodes (n,) of outer faces: at each the numbers of faces of two cells cancel."""
    left = np.zeros(n, np.uint64)
    for block in cells():
        for kind, corners in block.items():
            columns = columns_of(corners)
            for side in FACES[kind]:
                nodes = _sides(columns, side)
                number = _numbers(nodes)
                for place, column in enumerate(nodes):  # a face may have a node twice
                    np.bitwise_xor.at(left, column, number * np.uint64(2 * place + 1))
    return left != 0


def _sides(columns: Sequence[np.ndarray], side: Sequence[int]) -> list[np.ndarray]:
    return sorted_columns([columns[corner] for corner in side], len(side))


def _numbers(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Gives each face a random number (k,) by its nodes, sorted: those of a face that is there twice cancel in bitwise sums."""
    mixed = np.zeros(len(columns[0]), np.uint64)
    for column in columns:  # splitmix64, arithmetic modulo 2^64
        mixed += column.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
    return mixed
