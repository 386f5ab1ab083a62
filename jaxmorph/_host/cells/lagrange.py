"""Cells of high order: where their nodes are, and in which order a cell lists them.

A cell of order p has nodes on a lattice of step 1 / p in a reference cell. The reference cells have
corners at 0 and 1:

- triangle and tetrahedron: the origin and the unit vectors; quadrilateral and hexahedron: the unit
  square and cube;
- wedge: the triangle times the unit interval; pyramid: the unit square, and its apex (0, 0, 1)
  above corner 0.

In the canonical order corners come first, as in the linear cell. Inner nodes of the edges follow,
edge by edge as `EDGES` lists them, from the edge's first corner to its second. Then come inner
nodes of the faces, face by face as `FACES` lists them. They go in rows along the face's first edge,
from its first corner towards its last one. At the end come inner nodes of the cell, the first
coordinate fastest.
"""

import dataclasses
import functools
import itertools
from typing import Any

import numpy as np

from .topology import CORNERS, DIMENSION, EDGES, FACES, SIDE_TYPES

ORDERS = (1, 2, 3, 4)
"""Orders of cells that are known."""

PLACES = {
    "line": ((0,), (1,)),
    "triangle": ((0, 0), (1, 0), (0, 1)),
    "quad": ((0, 0), (1, 0), (1, 1), (0, 1)),
    "tetra": ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "pyramid": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)),
    "wedge": ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)),
    "hexahedron": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
}
"""Corners of the reference cells."""


@dataclasses.dataclass(frozen=True, eq=False)
class Lagrange:
    """Describes the cells of one type.

    - `shape`, `order`: the type of its linear cell, and the order of its edges.
    - `lattice`: whole numbers (k, d), the place of each node in the reference cell times `order`.
    - `is_complete`: False where nodes of the lattice inside of faces and of the cell are left out
      (serendipity).
    """

    shape: str
    order: int
    lattice: np.ndarray
    is_complete: bool = True

    @property
    def name(self) -> str:
        """The name of the type.

        It is meshio's, or the shape and the number of nodes; a linear cell's has no number.
        """
        return self.shape if self.order == 1 else f"{self.shape}{len(self.lattice)}"

    @property
    def corners(self) -> int:
        """The number of corners, which are the first nodes."""
        return CORNERS[self.shape]

    @property
    def dimension(self) -> int:
        """The dimension of the reference cell."""
        return DIMENSION[self.shape]

    @property
    def reference(self) -> np.ndarray:
        """The place (k, d) of each node in the reference cell."""
        return self.lattice / self.order

    @property
    def place(self) -> dict[tuple[int, ...], int]:
        """The node at each place of the lattice."""
        return {tuple(at): node for node, at in enumerate(self.lattice.tolist())}

    @property
    def edges(self) -> np.ndarray:
        """Nodes (edges, order + 1) of each edge of `EDGES`: first, second, inner nodes."""
        ends = np.array(EDGES[self.shape])
        inner = self.corners + np.arange(len(ends) * (self.order - 1)).reshape(len(ends), self.order - 1)
        return np.concatenate([ends, inner], axis=1)

    @property
    def sides(self) -> list[tuple[str, np.ndarray]]:
        """Type of each face of `FACES` (2-D: edge), and its nodes in that type's own order."""
        place, corners, sides = self.place, np.array(PLACES[self.shape]), []
        for face in FACES[self.shape]:
            side = of_order(SIDE_TYPES[len(face)], self.order, self.is_complete)
            along = corners[[face[1], face[-1]][: side.dimension]] - corners[face[0]]
            at = self.order * corners[face[0]] + side.lattice @ along
            sides.append((side.name, np.array([place[tuple(position)] for position in at.tolist()])))
        return sides

    def completion(self) -> tuple[str, np.ndarray]:
        """Returns the type with all lattice nodes, and the matrix (nodes, k) that makes them.

        The cell keeps its curved shape: a missing node is where the serendipity functions put it.
        """
        complete, place, missing = of_order(self.shape, self.order), self.place, []
        matrix = np.zeros((len(complete.lattice), len(self.lattice)))
        for row, at in enumerate(complete.lattice.tolist()):
            if tuple(at) in place:
                matrix[row, place[tuple(at)]] = 1
            else:
                missing.append(row)
        middles = iter(missing)
        for side, nodes in self.sides if self.dimension == 3 else [(self.name, np.arange(len(self.lattice)))]:
            if side == "quad8":  # in its middle functions of corners are -1/4, functions of edges 1/2
                matrix[next(middles), nodes] = np.repeat([-0.25, 0.5], 4)
        for row in middles:  # of a hexahedron
            matrix[row] = np.repeat([-0.25, 0.25], [8, 12])
        return complete.name, matrix


def depth(shape: str, order: int, at: np.ndarray) -> Any:
    """Counts the steps (k,) of lattice places (k, d) from the nearest side; negative outside."""
    beyond = at
    if shape in ("triangle", "tetra"):
        beyond = at.sum(axis=1, keepdims=True)
    elif shape == "wedge":
        beyond = np.column_stack([at[:, :2].sum(axis=1), at[:, 2]])
    elif shape == "pyramid":
        beyond = at[:, :2].max(axis=1, keepdims=True) + at[:, 2:]
    return np.minimum(at.min(axis=1), order - beyond.max(axis=1))


@functools.cache
def of_order(shape: str, order: int, is_complete: bool = True) -> Lagrange:
    """Describes the type with the shape of a linear cell, and an order."""
    corners, nodes = np.array(PLACES[shape]), [tuple(order * np.array(at)) for at in PLACES[shape]]
    for first, second in EDGES[shape]:
        nodes += [tuple((order - t) * corners[first] + t * corners[second]) for t in range(1, order)]
    if is_complete:
        for face in FACES[shape] if DIMENSION[shape] == 3 else ():
            u, v = corners[face[1]] - corners[face[0]], corners[face[-1]] - corners[face[0]]
            for t, s in itertools.product(range(1, order), repeat=2):
                if len(face) == 4 or s + t < order:
                    nodes.append(tuple(order * corners[face[0]] + s * u + t * v))
        grid = np.array(list(itertools.product(range(order + 1), repeat=DIMENSION[shape])))[:, ::-1]
        present = {tuple(map(int, at)) for at in nodes}
        nodes += [at for at in map(tuple, grid[depth(shape, order, grid) >= 0].tolist()) if at not in present]
    return Lagrange(shape, order, np.array(nodes, dtype=np.int64), is_complete)


@functools.cache
def lagrange_types() -> dict[str, Lagrange]:
    """Lists all types by name: linear, orders 2 to 4 complete, order 2 with nodes on edges."""
    cells = [of_order(shape, order) for shape in PLACES for order in ORDERS]
    partial = [of_order(shape, 2, False) for shape in ("quad", "pyramid", "wedge", "hexahedron")]
    return {cell.name: cell for cell in (*cells, *partial)}
