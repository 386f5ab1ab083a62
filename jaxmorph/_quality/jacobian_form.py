"""The Bernstein form of det J: tables, by type of cells, that turn nodes into coefficients.

A cell is the image of a product of simplices. The columns of J are derivatives of that map, with
Bernstein coefficients that are differences of control points. Coefficients of det J are mixed
determinants of these differences, with positive weights. A pyramid is taken as the image of a cube
whose top face shrinks to the apex: (r, s, t) to (r (1 - t), s (1 - t), t). There its functions are
polynomials (Bergot, Cohen, Durufle, J. Sci. Comput. 42, 2010). Two columns have the factor 1 - t,
which is divided out: the rest is det J in the reference pyramid. Source: Johnen, Remacle, Geuzaine,
Geometrical validity of curvilinear finite elements, J. Comput. Phys. 233, 2013.
"""

import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Float

from .._host.cells.lagrange import lagrange_types, values
from .._host.linear import products
from .._kernels.values import Either, namespace
from . import bernstein
from .bernstein import Space

Places = Float[np.ndarray, "f k"]
Columns = list[list[Either]]
Values = Float[Either, " k"]

FACTORS = {
    "line": (1,),
    "triangle": (2,),
    "quad": (1, 1),
    "tetra": (3,),
    "pyramid": (1, 1, 1),
    "wedge": (2, 1),
    "hexahedron": (1, 1, 1),
}
"""Dimensions of simplices whose product is the reference cell; a pyramid is a collapsed cube."""

TIME = (1, 1)


@dataclasses.dataclass(frozen=True, eq=False)
class JacobianForm:
    """Tables of one type of cells; with a time, tables of cells whose nodes move straight.

    - `shape`: the type of the linear cell.
    - `spaces`: the space of each column of J; `matrices` make its scaled coefficients of the nodes.
    - `map_space`: the space of the cell's map; `control` makes its control points of the nodes.
    - `space`: the space of det J.
    - `has_time`: whether time is the first factor; nodes are then given at start and end.
    """

    shape: str
    spaces: tuple[Space, ...]
    matrices: tuple[np.ndarray, ...]
    map_space: Space
    control: np.ndarray
    has_time: bool = False

    @functools.cached_property
    def space(self) -> Space:
        return tuple(
            (factors[0][0], sum(degree for _, degree in factors))
            for factors in zip(*self.spaces, strict=True)
        )

    def columns(self, x: list[Either]) -> Columns:
        """Scaled coefficients of the columns of J: a list of components (nodes, k)."""
        matrices = [matrix.astype(x[0].dtype) for matrix in self.matrices]
        return [[bernstein.contracted(matrix, component) for component in x] for matrix in matrices]

    def determinant(self, columns: Columns) -> Float[Either, "n k"]:
        a, b, *rest = columns
        first, second, *last = self.spaces
        product = bernstein.multiplied(first, second, a, b, products.cross)
        if rest:
            both = tuple((m, p + q) for (m, p), (_, q) in zip(first, second, strict=True))
            product = bernstein.multiplied(
                both, last[0], product, rest[0], lambda u, v: [products.dot(u, v)]
            )
        return product[0] / bernstein.multinomials(self.space).astype(product[0].dtype)[:, None]

    def coefficients(self, x: list[Either]) -> Float[Either, "n k"]:
        return self.determinant(self.columns(x))

    def round_off(
        self, x: list[np.ndarray], columns: list[list[np.ndarray]]
    ) -> Float[np.ndarray, " k"]:
        """Bounds the round-off of all coefficients of det J, and of what `halved` makes of them. A
        coefficient is a mean of determinants |a| |b| |c| at most. Each column has the error of a
        difference of nodes, in which the cell's reach counts, and each of the sums below has one
        ulp for each of its terms.
        """
        lengths = []
        for space, column in zip(self.spaces, columns, strict=True):
            squares = products.dot(column, column) / bernstein.multinomials(space)[:, None] ** 2
            lengths.append(np.sqrt(squares.max(axis=0)))
        reach = np.sqrt(len(x)) * np.max([np.abs(component).max(axis=0) for component in x], axis=0)
        error = self._growth * reach
        whole = functools.reduce(np.multiply, lengths)
        others = [
            functools.reduce(np.multiply, lengths[:i] + lengths[i + 1 :])
            for i in range(len(lengths))
        ]
        terms = len(x[0]) + sum(map(bernstein.count, self.spaces)) + 16 * len(self.space) + 16
        return 4 * terms * np.finfo(float).eps * (whole + error * functools.reduce(np.add, others))

    @functools.cached_property
    def _growth(self) -> float:
        pairs = zip(self.spaces, self.matrices, strict=True)
        rows = [
            np.abs(matrix).sum(axis=1) / bernstein.multinomials(space) for space, matrix in pairs
        ]
        return float(max(row.max() for row in rows))

    def mean(self, coefficients: Either) -> Values:
        """det J's mean over the reference cell: the ratio of the cells' volumes."""
        shares = np.full(bernstein.count(self.space), 1 / bernstein.count(self.space))
        if self.shape == "pyramid":  # a layer at t has the share 3 (1 - t)^2
            below, ((_, q), n) = (
                bernstein.count(self.space[:-1]),
                (self.space[-1], self.space[-1][1] + 1),
            )
            layers = [
                3 * (q - i + 2) * (q - i + 1) / ((q + 3) * (q + 2) * (q + 1)) for i in range(n)
            ]
            shares = np.kron(np.full(below, 1 / below), layers)
        return bernstein.contracted(shares[None].astype(coefficients.dtype), coefficients)[0]

    def places(self, x: list[np.ndarray], at: Places) -> Float[np.ndarray, "k d"]:
        """Maps places among the factors of k cells to space."""
        weights = bernstein.functions(self.map_space, at)
        return np.stack(
            [((self.control @ component) * weights).sum(axis=0) for component in x], axis=1
        )

    def values(self, columns: Columns, at: Float[Either, "f k"]) -> Values:
        pairs = zip(self.spaces, columns, strict=True)
        weights = [(bernstein.terms(space, at), column) for space, column in pairs]
        return products.determinant(
            [[(b * weight).sum(axis=0) for b in column] for weight, column in weights]
        )

    def inside(self, at: Places) -> Places:
        """Moves places off a pyramid's apex, where det J has directions, by a millionth."""
        is_last = np.arange(len(at)) == len(at) - 1
        return np.where((self.shape == "pyramid") & is_last[:, None], np.minimum(at, 1 - 1e-6), at)

    def reference(self, places: Places) -> Float[np.ndarray, "d k"]:
        places = places[1:] if self.has_time else places
        if self.shape != "pyramid":
            return places
        return np.concatenate([places[:2] * (1 - places[2:]), places[2:]])


@functools.cache
def form_of(kind: str, has_time: bool = False) -> JacobianForm:
    if has_time:
        form = form_of(kind)
        spaces = tuple((TIME, *space) for space in form.spaces)
        *matrices, control = (
            np.kron(np.eye(2), matrix) for matrix in (*form.matrices, form.control)
        )
        return JacobianForm(
            form.shape, spaces, tuple(matrices), (TIME, *form.map_space), control, True
        )
    cell = lagrange_types()[kind]
    space = tuple((m, cell.order) for m in FACTORS[cell.shape])
    at = bernstein.lattice(space)
    # all entries are multiples of 1 / 3 / 6^6, so that rounding makes them exact
    control = np.round(
        3 * 6**6 * np.linalg.solve(bernstein.functions(space, at).T, values(kind, at.T))
    ) / (3 * 6**6)
    columns = [
        _derivative(space, control, f, i) for f, (m, _) in enumerate(space) for i in range(m)
    ]
    if cell.shape == "pyramid":
        columns = [*(_divided(*column) for column in columns[:2]), columns[2]]
    spaces, matrices = zip(*columns, strict=True)
    return JacobianForm(cell.shape, spaces, matrices, space, control)


def _derivative(
    space: Space, control: np.ndarray, factor: int, axis: int
) -> tuple[Space, np.ndarray]:
    (m, degree), zeros = space[factor], [(m, 0) for m, _ in space]
    lower = (*space[:factor], (m, degree - 1), *space[factor + 1 :])
    step = (*zeros[:factor], (m, 1), *zeros[factor + 1 :])
    rows = bernstein.rows_of_products(lower, step)
    return lower, degree * bernstein.multinomials(lower)[:, None] * (
        control[rows[axis + 1]] - control[rows[0]]
    )


def _divided(space: Space, matrix: np.ndarray) -> tuple[Space, np.ndarray]:
    """Divides a polynomial of scaled coefficients by 1 - t; t is the last factor's coordinate."""
    *others, (m, degree) = space
    lower = (*others, (m, degree - 1))
    return lower, matrix[
        bernstein.rows_of_products(lower, (*((m, 0) for m, _ in others), (1, 1)))[0]
    ]


def nodes_of(ids: Any, *ends: Any) -> list[Any]:
    """Components (nodes, k) relative to the first node; of the `ends` (n, d) of a motion, all."""
    xp = namespace(ends[0])
    axes = range(ends[0].shape[1])
    return [
        xp.concatenate([end[:, axis][ids] - end[:, axis][ids[:1]] for end in ends]) for axis in axes
    ]
