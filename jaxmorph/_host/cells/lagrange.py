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
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy import ndarray
from numpy.polynomial import legendre

from .topology import CORNERS, DIMENSION, EDGES, FACES, SIDE_TYPES, Pair, numbers_by_name

ORDERS = (1, 2, 3, 4)

PLACES = numbers_by_name(
    {  # corners of the reference cells
        "line": "0 1",
        "triangle": "00 10 01",
        "quad": "00 10 11 01",
        "tetra": "000 100 010 001",
        "pyramid": "000 100 110 010 001",
        "wedge": "000 100 010 001 101 011",
        "hexahedron": "000 100 110 010 001 101 111 011",
    }
)


@dataclasses.dataclass(frozen=True, eq=False)
class Lagrange:
    """A type of cells: where the nodes are that a `Mesh` lists for each cell of it.

    - `shape`: type of the linear cell with the same corners; `order`: of the edges, 1 to 4.
    - `lattice` (k, d): place of each node in the reference cell, times `order`.
    - `is_complete`: False without nodes inside of faces and of the cell (serendipity).
    """

    shape: str
    order: int
    lattice: ndarray
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
    def reference(self) -> ndarray:
        """The place (k, d) of each node in the reference cell."""
        return self.lattice / self.order

    def nodes_at(self, places: ndarray) -> ndarray:
        """The nodes at places (..., d) of the lattice; -1 for none."""
        table = np.full((self.order + 1,) * self.dimension, -1)
        table[tuple(self.lattice.T)] = np.arange(len(self.lattice))
        return table[tuple(np.moveaxis(places, -1, 0))]

    @property
    def edges(self) -> ndarray:
        """Nodes (edges, order + 1) of each edge of `EDGES`: first, second, inner nodes."""
        ends = np.array(EDGES[self.shape])
        inner = self.corners + np.arange(len(ends) * (self.order - 1)).reshape(
            len(ends), self.order - 1
        )
        return np.concatenate([ends, inner], axis=1)

    @property
    def sides(self) -> list[tuple[str, ndarray]]:
        """Type of each face of `FACES` (2-D: edge), and its nodes in that type's own order."""
        corners = np.array(PLACES[self.shape])
        sides = []
        for face in FACES[self.shape]:
            side = of_order(SIDE_TYPES[len(face)], self.order, self.is_complete)
            along = corners[[face[1], face[-1]][: side.dimension]] - corners[face[0]]
            at = self.order * corners[face[0]] + side.lattice @ along
            sides.append((side.name, self.nodes_at(at)))
        return sides

    def side(self, corners: Iterable[int]) -> ndarray:
        """Finds the nodes of the face between some corners."""
        faces = [{*face} for face in FACES[self.shape]]
        return self.sides[faces.index({*corners})][1]

    def completion(self) -> tuple[str, ndarray]:
        """The type with all lattice nodes, and the matrix (nodes, k) that makes them. The cell
        keeps its curved shape: a missing node is where the serendipity functions put it.
        """
        complete = of_order(self.shape, self.order)
        matrix = np.zeros((len(complete.lattice), len(self.lattice)))
        matrix[complete.nodes_at(self.lattice), np.arange(len(self.lattice))] = 1
        middles = iter(np.flatnonzero(~matrix.any(axis=1)))
        for side, nodes in (
            self.sides if self.dimension == 3 else [(self.name, np.arange(len(self.lattice)))]
        ):
            # in its middle functions of corners are -1/4, functions of edges 1/2
            if side == "quad8":
                matrix[next(middles), nodes] = np.repeat([-0.25, 0.5], 4)
        for row in middles:  # of a hexahedron
            matrix[row] = np.repeat([-0.25, 0.25], [8, 12])
        return complete.name, matrix


def depth(shape: str, order: int, at: ndarray) -> Any:
    """Steps (k,) of lattice places (k, d) from the nearest side; negative outside."""
    beyond = at
    if shape in ("triangle", "tetra"):
        beyond = at.sum(axis=1, keepdims=True)
    elif shape == "wedge":
        beyond = np.column_stack([at[:, :2].sum(axis=1), at[:, 2]])
    elif shape == "pyramid":
        beyond = at[:, :2].max(axis=1, keepdims=True) + at[:, 2:]
    return np.minimum(at.min(axis=1), order - beyond.max(axis=1))


def inner_places(shape: str, order: int) -> ndarray:
    """The inner lattice (k, d) of a shape, the first coordinate fastest."""
    grid = np.indices((order + 1,) * DIMENSION[shape]).reshape(DIMENSION[shape], -1)[::-1].T
    return grid[depth(shape, order, grid) > 0]


def lattice(
    shape: str, order: int, is_complete: bool, edges=EDGES, faces=FACES, inner=inner_places
) -> ndarray:
    """The places (k, d) of nodes: corners, then the inner ones of edges, faces, cell."""
    corners = np.array(PLACES[shape])
    t = np.arange(1, order)[:, None]
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
def derivatives_at_nodes(kind: str) -> ndarray:
    """Derivatives (s, nodes, d) of the shape functions at the nodes of a type."""
    return derivatives(kind, collapsed(kind, lagrange_types()[kind].reference))


@functools.cache
def jacobian_samples(kind: str) -> Pair:
    """Shape function derivatives (s, nodes, d) where det J is measured, and weights (s,). Places
    are a lattice of half the step, of weight 0, and Gauss points of the exact volume.
    """
    cell = lagrange_types()[kind]
    d = cell.dimension
    fine = 2 * cell.order
    grid = np.indices((fine + 1,) * d).reshape(d, -1).T
    if cell.shape != "pyramid":  # a pyramid has a lattice in its own coordinates
        grid = grid[depth(cell.shape, fine, grid) >= 0]
    nodes, weights = legendre.leggauss(-(-d * cell.order // 2))
    pairs = zip((nodes + 1) / 2, weights / 2, strict=True)
    places, factors = np.moveaxis(np.array(list(itertools.product(pairs, repeat=d))), 2, 0)
    weight = factors.prod(axis=1)
    # Of a square or cube, coordinates shrink towards an edge, a corner or an apex.
    for axis in range(1, {"triangle": 2, "wedge": 2, "tetra": 3}.get(cell.shape, 1)):
        places[:, :axis] *= 1 - places[:, axis, None]
        weight *= (1 - places[:, axis]) ** axis
    if cell.shape == "pyramid":
        weight *= (1 - places[:, 2]) ** 2
    return derivatives(kind, np.concatenate([grid / fine, places])), np.concatenate(
        [np.zeros(len(grid)), weight]
    )


def derivatives(kind: str, places: ndarray) -> ndarray:
    """Derivatives (s, nodes, d) of the shape functions of a type at places (s, d)."""
    (_, slopes), inverse, completion = _expand(kind, places)
    return np.einsum("skd,kn,nm->smd", slopes, inverse, completion, optimize=True)


def shape_values(kind: str, places: ndarray) -> ndarray:
    (at_places, _), inverse, completion = _expand(kind, places)
    return at_places @ inverse @ completion


def _expand(kind: str, places: ndarray) -> tuple[Pair, ndarray, ndarray]:
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    at_nodes, _ = _basis(complete, collapsed(name, complete.reference))
    return _basis(complete, places), np.linalg.inv(at_nodes), completion


def _basis(cell: Lagrange, places: ndarray) -> Pair:
    """The basis (s, k) at places, and its derivatives (s, k, d)."""
    # A function is a product of Legendre polynomials, one a coordinate; a derivative has the slope
    # of one factor in its place.
    t = 2 * places - 1
    powers = cell.lattice
    is_pyramid = cell.shape == "pyramid"
    axes = range(2 if is_pyramid else cell.dimension)
    polynomials = legendre.legvander(t, cell.order)  # (s, d, p + 1)
    slope = legendre.legvander(t, cell.order - 1) @ legendre.legder(2 * np.eye(cell.order + 1))
    factors = [polynomials[:, axis, powers[:, axis]] for axis in axes]
    basis = np.prod(factors, axis=0)
    slopes = np.zeros((*basis.shape, cell.dimension))
    for axis in axes:
        others = [factor for other, factor in enumerate(factors) if other != axis]
        slopes[:, :, axis] = np.prod([slope[:, axis, powers[:, axis]], *others], axis=0)
    if not is_pyramid:
        return basis, slopes
    # f(a) g(b) c^n with c = 1 - z, a = x / c, b = y / c, n at least their degrees
    n = powers[:, :2].max(axis=1) + powers[:, 2]
    c = 1 - places[:, 2:]
    slopes[:, :, 2] = (slopes[:, :, :2] * places[:, None, :2]).sum(axis=2) - n * basis
    return basis * c**n, slopes * (c ** np.maximum(n - 1, 0))[:, :, None]


def collapsed(kind: str, places: ndarray) -> ndarray:
    """Maps reference places to arguments of the basis; a pyramid's apex is seen from the middle."""
    if lagrange_types()[kind].shape != "pyramid":
        return places
    c = 1 - places[:, 2:]
    return np.concatenate(
        [np.where(c > 0, places[:, :2] / np.where(c > 0, c, 1), 0.5), places[:, 2:]], axis=1
    )


def node_keys(ids: ndarray, cell: Lagrange) -> ndarray:
    """Ascending corners and weights in turn (k, s, 16) of a cell's nodes; zeros in front."""
    places = collapsed(cell.shape, cell.reference)
    corners = shape_values(cell.shape, places)  # of the linear cell
    weights = np.rint(12**3 * corners).astype(np.int64)
    # alike in cells of all types that share a face
    weights = weights // np.gcd.reduce(weights, axis=1)[:, None]
    corners = np.where(weights > 0, ids[:, None], -1)
    order = np.argsort(corners, axis=2, kind="stable")
    both = np.stack([np.maximum(corners, 0), np.broadcast_to(weights, corners.shape)], axis=3)
    pairs = np.take_along_axis(both, order[:, :, :, None], axis=2).reshape(
        *corners.shape[:2], 2 * ids.shape[1]
    )
    return np.pad(pairs, ((0, 0), (0, 0), (16 - pairs.shape[2], 0)))
