"""Nodes of MFEM's curved cells: their numbers, their order in files, and their places."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre

from jaxmorph._host.cells.lagrange import Lagrange, lagrange_types, of_order

from ..._host.cells.lagrange import node_keys, values

EDGES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)),
    "hexahedron": ((0, 1), (1, 2), (3, 2), (0, 3), (4, 5), (5, 6), (7, 6), (4, 7), (0, 4), (1, 5), (2, 6), (3, 7)),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
}
FACES = {
    "tetra": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": ((3, 2, 1, 0), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
}
"""Edges and faces in the order in which MFEM numbers them; a face has its first cell's corners."""


@dataclasses.dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one type: corners (k, c), their rows in the file, and their attributes."""

    kind: str
    corners: np.ndarray
    rows: np.ndarray
    attributes: np.ndarray


def numbered(
    cells: list[Elements], sides: list[Elements], order: int, count: int
) -> tuple[dict[str, np.ndarray], list[np.ndarray], int]:
    """Numbers the nodes as H1 does: vertices, edges, faces, inside of cells, in the file's order.

    `order` is the order of the cells, `count` the number of vertices. Returns the nodes of the
    cells by type, the nodes of the sides, and the number of all nodes.
    """
    edges, faces = np.sort(_sides(cells, EDGES)[:, :2], axis=1), _sides(cells, FACES)
    is_triangle = faces[:, 3:].ravel() < 0
    groups = [
        [("line", edges, np.arange(len(edges)))],
        [
            ("triangle", faces[is_triangle, :3], np.flatnonzero(is_triangle)),
            ("quad", faces[~is_triangle], np.flatnonzero(~is_triangle)),
        ],
        [(element.kind, element.corners, element.rows) for element in cells],
    ]
    keys = [np.zeros((0, 16), np.int64)]
    for group in groups:  # an entity's nodes are consecutive, and entities of several types take turns
        inner = [_inner(corners, of_order(kind, order)) for kind, corners, _ in group]
        places = [np.repeat(rows, part.shape[1]) for (_, _, rows), part in zip(group, inner, strict=True)]
        joined = np.concatenate([part.reshape(-1, 16) for part in inner])
        keys.append(joined[np.argsort(np.concatenate(places), kind="stable")])
    known = np.concatenate(keys)
    all_keys = [node_keys(element.corners, of_order(element.kind, order)) for element in (*cells, *sides)]
    same = np.unique(
        np.concatenate([known, *(keys.reshape(-1, 16) for keys in all_keys)]), axis=0, return_inverse=True
    )[1]
    number = np.full(same.max(initial=-1) + 1, -1)
    number[same.ravel()[: len(known)]] = count + np.arange(len(known))
    nodes, first = [], len(known)
    for element, own in zip((*cells, *sides), all_keys, strict=True):
        new = number[same.ravel()[first : first + own.shape[0] * own.shape[1]]].reshape(own.shape[:2])
        nodes.append(np.concatenate([element.corners, new], axis=1))
        first += new.size
    by_type = {of_order(element.kind, order).name: ids for element, ids in zip(cells, nodes, strict=False)}
    return by_type, nodes[len(cells) :], count + len(known)


def _sides(cells: list[Elements], table: dict[str, tuple[tuple[int, ...], ...]]) -> np.ndarray:
    """Lists edges or faces (k, 4), -1 behind the last corner, in the order of first appearance."""
    parts, places = [np.zeros((0, 4), np.int64)], [np.zeros(0, np.int64)]
    for element in cells:
        for local, side in enumerate(table.get(element.kind, ())):
            part = np.full((len(element.rows), 4), -1)
            part[:, : len(side)] = element.corners[:, side]
            parts.append(part)
            places.append(16 * element.rows + local)
    sides = np.concatenate(parts)[np.argsort(np.concatenate(places))]
    return sides[np.sort(np.unique(np.sort(sides, axis=1), axis=0, return_index=True)[1])]


def _inner(corners: np.ndarray, cell: Lagrange) -> np.ndarray:
    """Returns the keys of the nodes inside of a line, a face or a cell, not on its sides."""
    p, at = cell.order, cell.lattice[cell.corners :]
    if cell.shape in ("triangle", "tetra"):
        inside = (at > 0).all(axis=1) & (at.sum(axis=1) < p)
    elif cell.shape == "wedge":
        inside = (at > 0).all(axis=1) & (at[:, :2].sum(axis=1) < p) & (at[:, 2] < p)
    else:
        inside = ((at > 0) & (at < p)).all(axis=1)
    return node_keys(corners, cell)[:, inside]


def lexicographic(cells: list[Elements], nodes: dict[str, np.ndarray]) -> np.ndarray:
    """Lists the nodes of L2's coordinates: cell by cell, the first reference coordinate fastest."""
    parts, places = [], []
    for element, (name, ids) in zip(cells, nodes.items(), strict=True):
        order = np.lexsort(lagrange_types()[name].lattice.T)
        parts.append(ids[:, order].ravel())
        places.append(np.repeat(element.rows, ids.shape[1]))
    return np.concatenate(parts)[np.argsort(np.concatenate(places), kind="stable")]


def at_places(cells: dict[str, np.ndarray], points: np.ndarray, matrix: Callable[[str], np.ndarray]) -> np.ndarray:
    """Computes the nodes of cells at other places, cell by cell."""
    moved = points.copy()
    for kind, ids in cells.items():
        moved[ids] = np.einsum("mn,knd->kmd", matrix(kind), points[ids])
    return moved


@functools.cache
def to_lobatto(kind: str) -> np.ndarray:
    """Returns the matrix from nodes at equal steps to nodes at Gauss-Lobatto places."""
    cell = lagrange_types()[kind]
    p, at = cell.order, cell.lattice
    inner = legendre.legroots(legendre.legder(np.eye(p + 1)[p]))
    line = np.concatenate([[0], (np.sort(inner) + 1) / 2, [1]])
    places = line[at]
    simplex = {"triangle": 2, "wedge": 2, "tetra": 3}.get(cell.shape, 0)
    if simplex:
        rest = line[p - at[:, :simplex].sum(axis=1)]
        places[:, :simplex] /= (places[:, :simplex].sum(axis=1) + rest)[:, None]
    return values(kind, places)


@functools.cache
def from_lobatto(kind: str) -> np.ndarray:
    return np.linalg.inv(to_lobatto(kind))
