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
import math
from typing import Any

import numpy as np
from jaxtyping import Float

from .._host.cells.lagrange import lagrange_types, shape_values
from .._host.linear import products
from .._host.tolerances import OFF_APEX
from .._kernels.values import Either, namespace
from . import bernstein
from .bernstein import Space

Lattice = Float[np.ndarray, "f k"]
FormColumns = list[list[Either]]
FormValues = Float[Either, " k"]

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
EXACT = 3 * 6**6  # entries of control tables are multiples of one over it


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
        return _space_of_product(*self.spaces)

    def with_time(self) -> "JacobianForm":
        """The form of cells whose nodes move straight: all tables at the start and at the end."""
        return JacobianForm(
            shape=self.shape,
            spaces=tuple((TIME, *space) for space in self.spaces),
            matrices=tuple(np.kron(np.eye(2), matrix) for matrix in self.matrices),
            map_space=(TIME, *self.map_space),
            control=np.kron(np.eye(2), self.control),
            has_time=True,
        )

    def columns(self, x: list[Either]) -> FormColumns:
        """Scaled coefficients of the columns of J: a list of components (nodes, k)."""
        matrices = [matrix.astype(x[0].dtype) for matrix in self.matrices]
        return [[bernstein.contracted(matrix, component) for component in x] for matrix in matrices]

    def determinant(self, columns: FormColumns) -> Float[Either, "n k"]:
        space = self.spaces[0]
        product = columns[0]
        steps = zip(self.spaces[1:], columns[1:], (products.cross, _dot_product), strict=False)
        for factor, column, multiply in steps:
            product = bernstein.multiplied(space, factor, product, column, multiply)
            space = _space_of_product(space, factor)
        return product[0] / bernstein.multinomials(space).astype(product[0].dtype)[:, None]

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
        others = sum(math.prod(lengths[:i] + lengths[i + 1 :]) for i in range(len(lengths)))
        terms = (
            len(x[0])
            + sum(map(bernstein.count_coefficients, self.spaces))
            + 16 * len(self.space)
            + 16
        )
        return 4 * terms * np.finfo(float).eps * (math.prod(lengths) + error * others)

    @functools.cached_property
    def _growth(self) -> float:
        pairs = zip(self.spaces, self.matrices, strict=True)
        rows = [
            np.abs(matrix).sum(axis=1) / bernstein.multinomials(space) for space, matrix in pairs
        ]
        return float(max(row.max() for row in rows))

    def mean(self, coefficients: Either) -> FormValues:
        """det J's mean over the reference cell: the ratio of the cells' volumes."""
        counts = [len(bernstein.indices(*factor)) for factor in self.space]
        shares = [np.full(count, 1 / count) for count in counts]
        if self.shape == "pyramid":  # a layer at t has the share 3 (1 - t)^2
            q = self.space[-1][1]
            above = np.arange(q, -1, -1)
            shares[-1] = 3 * (above + 2) * (above + 1) / ((q + 3) * (q + 2) * (q + 1))
        weights = functools.reduce(np.kron, shares)
        return bernstein.contracted(weights[None].astype(coefficients.dtype), coefficients)[0]

    def places(self, x: list[np.ndarray], at: Lattice) -> Float[np.ndarray, "k d"]:
        """Maps places among the factors of k cells to space."""
        weights = bernstein.functions(self.map_space, at)
        return np.stack(
            [((self.control @ component) * weights).sum(axis=0) for component in x], axis=1
        )

    def values(self, columns: FormColumns, at: Float[Either, "f k"]) -> FormValues:
        pairs = zip(self.spaces, columns, strict=True)
        weights = [(bernstein.terms(space, at), column) for space, column in pairs]
        return products.determinant(
            [[(b * weight).sum(axis=0) for b in column] for weight, column in weights]
        )

    def inside(self, at: Lattice) -> Lattice:
        """Moves places off a pyramid's apex, where det J has directions, by a millionth."""
        is_last = np.arange(len(at)) == len(at) - 1
        return np.where(
            (self.shape == "pyramid") & is_last[:, None], np.minimum(at, 1 - OFF_APEX), at
        )

    def reference(self, places: Lattice) -> Float[np.ndarray, "d k"]:
        places = places[1:] if self.has_time else places
        if self.shape != "pyramid":
            return places
        return np.concatenate([places[:2] * (1 - places[2:]), places[2:]])


@functools.cache
def form_of(kind: str, has_time: bool = False) -> JacobianForm:
    if has_time:
        return form_of(kind).with_time()
    cell = lagrange_types()[kind]
    space = tuple((m, cell.order) for m in FACTORS[cell.shape])
    at = bernstein.bernstein_lattice(space)
    control = np.linalg.solve(bernstein.functions(space, at).T, shape_values(kind, at.T))
    control = np.round(control * EXACT) / EXACT
    columns = [
        _derivative(space, control, f, i) for f, (m, _) in enumerate(space) for i in range(m)
    ]
    if cell.shape == "pyramid":
        columns[:2] = [_divide_by_layer(*column) for column in columns[:2]]
    spaces, matrices = zip(*columns, strict=True)
    return JacobianForm(
        shape=cell.shape, spaces=spaces, matrices=matrices, map_space=space, control=control
    )


def _space_of_product(*spaces: Space) -> Space:
    return tuple(
        (factors[0][0], sum(degree for _, degree in factors))
        for factors in zip(*spaces, strict=True)
    )


def _dot_product(a: list[Either], b: list[Either]) -> list[Either]:
    return [products.dot(a, b)]


def _derivative(
    space: Space, control: np.ndarray, factor: int, axis: int
) -> tuple[Space, np.ndarray]:
    # A coefficient is the difference of two control points: a step along the axis, from corner 0.
    m, degree = space[factor]
    lower = (*space[:factor], (m, degree - 1), *space[factor + 1 :])
    step = tuple((m, int(k == factor)) for k, (m, _) in enumerate(space))
    rows = bernstein.rows_of_products(lower, step)
    difference = control[rows[axis + 1]] - control[rows[0]]
    return lower, degree * bernstein.multinomials(lower)[:, None] * difference


def _divide_by_layer(space: Space, matrix: np.ndarray) -> tuple[Space, np.ndarray]:
    """Divides a polynomial of scaled coefficients by 1 - t; t is the last factor's coordinate."""
    *others, (m, degree) = space
    lower = (*others, (m, degree - 1))
    layer = (*((m, 0) for m, _ in others), (1, 1))
    return lower, matrix[bernstein.rows_of_products(lower, layer)[0]]


def nodes_of(ids: Any, *ends: Any) -> list[Any]:
    """Components (nodes, k) relative to the first node; of the `ends` (n, d) of a motion, all."""
    xp = namespace(ends[0])
    axes = range(ends[0].shape[1])
    return [
        xp.concatenate([end[:, axis][ids] - end[:, axis][ids[:1]] for end in ends]) for axis in axes
    ]
