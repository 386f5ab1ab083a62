"""Cells of high order: their nodes, the order in which a cell lists them, and shape functions.

A cell of order p has nodes on a lattice of step 1 / p in a reference cell, with corners at 0 and 1:
unit interval, square, cube. Triangle and tetrahedron have the origin and the unit vectors. The
wedge is the triangle times the unit interval, the pyramid the unit square and the apex (0, 0, 1)
above corner 0. In the canonical order corners come first, then inner nodes of the `EDGES`, from
first to second corner. Those of the `FACES` go in rows along the first edge, from the first corner
towards the last. At the end come inner nodes of the cell, the first coordinate fastest. The shape
functions are polynomials whose exponents are the lattice; for a pyramid the space of Bergot et al.
(J. Sci. Comput. 42, 2010), polynomials in (x / (1 - z), y / (1 - z), 1 - z). They take a place in a
pyramid as x / (1 - z), y / (1 - z), z, by which its apex has directions.
"""

import dataclasses
import functools
import itertools
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from .topology import CORNERS, DIMENSION, EDGES, FACES, SIDE_TYPES, numbers

ORDERS = (1, 2, 3, 4)

PLACES = {
    "line": numbers("0 1"),
    "triangle": numbers("00 10 01"),
    "quad": numbers("00 10 11 01"),
    "tetra": numbers("000 100 010 001"),
    "pyramid": numbers("000 100 110 010 001"),
    "wedge": numbers("000 100 010 001 101 011"),
    "hexahedron": numbers("000 100 110 010 001 101 111 011"),
}
"""Corners of the reference cells."""


@dataclasses.dataclass(frozen=True, eq=False)
class Lagrange:
    """A type of cells: where the nodes are that a `Mesh` lists for each cell of it.

    - `shape`: type of the linear cell with the same corners; `order`: of the edges, 1 to 4.
    - `lattice` (k, d): place of each node in the reference cell, times `order`.
    - `is_complete`: False without nodes inside of faces and of the cell (serendipity).
    """

    shape: str
    order: int
    lattice: np.ndarray
    is_complete: bool = True

    @property
    def name(self) -> str:
        """The type's name, as the keys of `Mesh.cells` are: `quad9`."""
        return self.shape if self.order == 1 else f"{self.shape}{len(self.lattice)}"

    @property
    def corners(self) -> int:
        """Number of corners, which are the first nodes."""
        return CORNERS[self.shape]

    @property
    def dimension(self) -> int:
        """1 for lines, 2 for faces, 3 for what fills the space."""
        return DIMENSION[self.shape]

    @property
    def reference(self) -> np.ndarray:
        """The place (k, d) of each node in the reference cell."""
        return self.lattice / self.order

    @property
    def place(self) -> dict[tuple[int, ...], int]:
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
        """The type with all lattice nodes, and the matrix (nodes, k) that makes them. The cell
        keeps its curved shape: a missing node is where the serendipity functions put it.
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
    """Steps (k,) of lattice places (k, d) from the nearest side; negative outside."""
    beyond = at
    if shape in ("triangle", "tetra"):
        beyond = at.sum(axis=1, keepdims=True)
    elif shape == "wedge":
        beyond = np.column_stack([at[:, :2].sum(axis=1), at[:, 2]])
    elif shape == "pyramid":
        beyond = at[:, :2].max(axis=1, keepdims=True) + at[:, 2:]
    return np.minimum(at.min(axis=1), order - beyond.max(axis=1))


def inner_places(shape: str, order: int) -> np.ndarray:
    """The inner lattice (k, d) of a shape, the first coordinate fastest."""
    grid = np.indices((order + 1,) * DIMENSION[shape]).reshape(DIMENSION[shape], -1)[::-1].T
    return grid[depth(shape, order, grid) > 0]


def lattice(shape: str, order: int, is_complete: bool, edges=EDGES, faces=FACES, inner=inner_places) -> np.ndarray:
    """The places (k, d) of nodes: corners, then the inner ones of edges, faces, cell."""
    corners, t = np.array(PLACES[shape]), np.arange(1, order)[:, None]
    nodes = [order * corners]
    for first, second in edges.get(shape, EDGES[shape]):
        nodes.append((order - t) * corners[first] + t * corners[second])
    if is_complete and shape != "line":
        for face in faces.get(shape, FACES[shape]) if corners.shape[1] == 3 else ():
            along = corners[[face[1], face[-1]]] - corners[face[0]]
            nodes.append(order * corners[face[0]] + inner(SIDE_TYPES[len(face)], order) @ along)
        nodes.append(inner(shape, order))
    return np.concatenate(nodes)


@functools.cache
def of_order(shape: str, order: int, is_complete: bool = True) -> Lagrange:
    return Lagrange(shape, order, lattice(shape, order, is_complete), is_complete)


@functools.cache
def lagrange_types() -> dict[str, Lagrange]:
    """Lists all types by name: linear, orders 2 to 4 complete, order 2 with nodes on edges."""
    cells = [of_order(shape, order) for shape in PLACES for order in ORDERS]
    partial = [of_order(shape, 2, False) for shape in ("quad", "pyramid", "wedge", "hexahedron")]
    return {cell.name: cell for cell in (*cells, *partial)}


@functools.cache
def derivatives_at_nodes(kind: str) -> np.ndarray:
    """Derivatives (s, nodes, d) of the shape functions at the nodes of a type."""
    return derivatives(kind, collapsed(kind, lagrange_types()[kind].reference))


@functools.cache
def jacobian_samples(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Shape function derivatives (s, nodes, d) where det J is measured, and weights (s,). Places
    are a lattice of half the step, of weight 0, and Gauss points of the exact volume.
    """
    cell = lagrange_types()[kind]
    d, fine = cell.dimension, 2 * cell.order
    grid = np.indices((fine + 1,) * d).reshape(d, -1).T
    if cell.shape != "pyramid":  # a pyramid has a lattice in its own coordinates
        grid = grid[depth(cell.shape, fine, grid) >= 0]
    nodes, weights = np.polynomial.legendre.leggauss(-(-d * cell.order // 2))
    cube = np.array(list(itertools.product((nodes + 1) / 2, repeat=d)))
    weight = np.array(list(itertools.product(weights / 2, repeat=d))).prod(axis=1)
    places, factor = _of_cube(cell.shape, cube)
    every = np.concatenate([grid / fine, places])
    return derivatives(kind, every), np.concatenate([np.zeros(len(grid)), weight * factor])


def derivatives(kind: str, places: np.ndarray) -> np.ndarray:
    """Derivatives (s, nodes, d) of the shape functions of a type at places (s, d)."""
    (_, slopes), inverse, completion = _expanded(kind, places)
    return np.einsum("skd,kn,nm->smd", slopes, inverse, completion, optimize=True)


def values(kind: str, places: np.ndarray) -> np.ndarray:
    (at_places, _), inverse, completion = _expanded(kind, places)
    return at_places @ inverse @ completion


def _expanded(kind: str, places: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    at_nodes, _ = _basis(complete, collapsed(name, complete.reference))
    return _basis(complete, places), np.linalg.inv(at_nodes), completion


def _basis(cell: Lagrange, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, powers = cell.order, cell.lattice
    one = legendre.legvander(2 * places - 1, p)  # (s, d, p + 1)
    slope = np.stack([legendre.legval(2 * places - 1, legendre.legder(row) * 2) for row in np.eye(p + 1)], axis=2)
    if cell.shape == "pyramid":
        return _pyramid(one, slope, places, powers)
    picked = [one[:, axis, powers[:, axis]] for axis in range(cell.dimension)]
    slopes = [
        np.prod([*picked[:axis], slope[:, axis, powers[:, axis]], *picked[axis + 1 :]], axis=0)
        for axis in range(cell.dimension)
    ]
    return np.prod(picked, axis=0), np.stack(slopes, axis=2)


def _pyramid(
    one: np.ndarray, slope: np.ndarray, places: np.ndarray, powers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A pyramid's basis f(a) g(b) c^n with c = 1 - z, a = x / c, b = y / c, n at least their
    degrees.
    """
    f, g = one[:, 0, powers[:, 0]], one[:, 1, powers[:, 1]]
    df, dg = slope[:, 0, powers[:, 0]], slope[:, 1, powers[:, 1]]
    n = powers[:, :2].max(axis=1) + powers[:, 2]
    a, b, c = places[:, :1], places[:, 1:2], 1 - places[:, 2:]
    less = c ** np.maximum(n - 1, 0)
    slopes = np.stack([df * g * less, f * dg * less, (a * df * g + b * f * dg - n * f * g) * less], axis=2)
    return f * g * c**n, slopes


def collapsed(kind: str, places: np.ndarray) -> np.ndarray:
    """Maps reference places to arguments of the basis; a pyramid's apex is seen from the middle."""
    if lagrange_types()[kind].shape != "pyramid":
        return places
    c = 1 - places[:, 2:]
    return np.concatenate([np.where(c > 0, places[:, :2] / np.where(c > 0, c, 1), 0.5), places[:, 2:]], axis=1)


def _of_cube(shape: str, cube: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Maps places of a square or cube to a shape: places (s, d), and the volume's factor (s,)."""
    if shape in ("line", "quad", "hexahedron"):
        return cube, np.ones(len(cube))
    u, v = cube[:, 0], cube[:, 1]
    if shape == "pyramid":
        return cube, (1 - cube[:, 2]) ** 2
    if shape == "tetra":
        w = cube[:, 2]
        return np.stack([u * (1 - v) * (1 - w), v * (1 - w), w], axis=1), (1 - v) * (1 - w) ** 2
    return np.column_stack([u * (1 - v), v, cube[:, 2:]]), 1 - v


def node_keys(ids: np.ndarray, cell: Lagrange) -> np.ndarray:
    """Ascending corners and weights in turn (k, new, 16) of new nodes; zeros in front."""
    weights = _weights(cell)
    weights = weights // np.gcd.reduce(weights, axis=1)[:, None]  # alike in cells of all types that share a face
    order = np.argsort(np.where(weights[None] > 0, ids[:, None], -1), axis=2, kind="stable")
    weights = np.take_along_axis(np.broadcast_to(weights, (len(ids), *weights.shape)), order, axis=2)
    corners = np.where(
        weights > 0, np.take_along_axis(np.repeat(ids[:, None], weights.shape[1], axis=1), order, axis=2), 0
    )
    keys = np.zeros((*weights.shape[:2], 16), np.int64)
    width = 2 * weights.shape[2]
    keys[:, :, 16 - width :] = np.stack([corners, weights], axis=3).reshape(*weights.shape[:2], width)
    return keys


def _weights(cell: Lagrange) -> np.ndarray:
    """Integer weights (new, corners) of corners at new nodes: 12^3 linear shape functions."""
    places = collapsed(cell.shape, cell.reference[cell.corners :])
    return np.rint(12**3 * values(cell.shape, places)).astype(np.int64)
