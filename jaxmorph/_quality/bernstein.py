"""Bernstein form of polynomials on products of simplices: a square is a product of two lines.

On a simplex with barycentric coordinates lambda, a polynomial of degree q is the sum over |alpha| =
q of b_alpha multinomial(alpha) lambda^alpha. The terms are positive and add up to 1. So the
polynomial lies between its least and its largest coefficient, and the coefficients at corners are
its values there. A space is a tuple with (dimension, degree) of each factor. Coefficients of a
product are in C order of its factors' indices. Scaled coefficients are b_alpha multinomial(alpha):
they multiply as coefficients of ordinary polynomials do.
"""

import functools
import itertools
import math
from typing import Any

import jax
import numpy as np

from .._kernels.values import Either, namespace
from .vector import contracted

Space = tuple[tuple[int, int], ...]


@functools.cache
def indices(dimension: int, degree: int) -> np.ndarray:
    """The multi-indices (n, dimension + 1) of one factor, the corner of lambda_0 first."""
    rows = itertools.product(range(degree, -1, -1), repeat=dimension + 1)
    return np.array([row for row in rows if sum(row) == degree])


def count_coefficients(space: Space) -> int:
    return math.prod(len(indices(*factor)) for factor in space)


@functools.cache
def multinomials(space: Space) -> np.ndarray:
    """Factors (n,) from coefficients to scaled ones."""
    factors = [
        [
            math.factorial(degree) // math.prod(map(math.factorial, row))
            for row in indices(dimension, degree).tolist()
        ]
        for dimension, degree in space
    ]
    return functools.reduce(np.kron, factors, np.ones(1))


@functools.cache
def rows_of_products(first: Space, second: Space) -> np.ndarray:
    """The product space's row for each product of terms: (second's, first's)."""
    table = np.zeros((1, 1), dtype=np.int64)
    for (dimension, low), (_, high) in zip(first, second, strict=True):
        place = {tuple(row): i for i, row in enumerate(indices(dimension, low + high).tolist())}
        sums = indices(dimension, high)[:, None] + indices(dimension, low)[None]
        rows = np.array([[place[tuple(row)] for row in line] for line in sums.tolist()])
        outer = table[:, None, :, None] * len(place) + rows[None, :, None, :]
        table = outer.reshape(len(table) * len(rows), -1)
    return table


@functools.cache
def corners(space: Space) -> np.ndarray:
    """The rows of the coefficients at corners, in C order of the factors' corners."""
    rows = np.zeros(1, dtype=np.int64)
    for factor in space:
        own = np.argsort(-indices(*factor), axis=0, kind="stable")[0]
        rows = (rows[:, None] * len(indices(*factor)) + own[None]).ravel()
    return rows


def terms(space: Space, places: Either) -> Either:
    """lambda^alpha (n, k) at places (d, k): the factors of scaled coefficients."""
    xp = namespace(places)
    first = 0
    product = xp.ones((1, places.shape[1]), places.dtype)
    for dimension, degree in space:
        local = places[first : first + dimension]
        barycentric = xp.concatenate([1 - local.sum(axis=0, keepdims=True), local])
        own = (
            (barycentric[None] ** indices(dimension, degree)[:, :, None])
            .prod(axis=1)
            .astype(places.dtype)
        )
        product = (product[:, None] * own[None]).reshape(-1, places.shape[1])
        first = first + dimension
    return product


def functions(space: Space, places: Either) -> Either:
    """The Bernstein polynomials (n, k) at places (d, k): they weigh coefficients."""
    return terms(space, places) * multinomials(space)[:, None]


@functools.cache
def bernstein_lattice(space: Space) -> np.ndarray:
    """The places (d, n) at even steps that belong to the coefficients."""
    places = np.zeros((0, 1))
    for dimension, degree in space:
        own = indices(dimension, degree)[:, 1:].T / max(degree, 1)
        places = np.concatenate(
            [np.repeat(places, own.shape[1], axis=1), np.tile(own, places.shape[1])]
        )
    return places


@functools.cache
def children(dimension: int) -> np.ndarray:
    """The corners (2^dimension, corners, corners) of a simplex's parts, barycentric. The parts have
    half its edges: one at each corner, and four tetrahedra in the octahedron inside.
    """
    unit = np.eye(dimension + 1)
    own = [[(unit[i] + unit[j]) / 2 for j in range(dimension + 1)] for i in range(dimension + 1)]
    if dimension == 2:
        own.append([own[0][1], own[0][2], own[1][2]])
    if dimension == 3:
        diagonal = own[0][2], own[1][3]
        around = (own[0][1], own[0][3], own[2][3], own[1][2])
        own += [[*diagonal, a, b] for a, b in zip(around, (*around[1:], around[0]), strict=True)]
    return np.array(own)


@functools.cache
def halving(dimension: int, degree: int) -> np.ndarray:
    """The matrix (2^dimension n, n) from a factor's coefficients to its parts', by interpolation.
    No entry is negative, each row adds up to 1, and all are multiples of 2^-degree: rounding makes
    them exact.
    """
    space = ((dimension, degree),)
    own = np.concatenate(
        [1 - bernstein_lattice(space).sum(axis=0, keepdims=True), bernstein_lattice(space)]
    )
    places = np.einsum("cn,pcd->dpn", own, children(dimension)).reshape(dimension + 1, -1)
    halves = functions(space, places[1:]).T.reshape(2**dimension, own.shape[1], -1)
    exact = np.linalg.solve(functions(space, bernstein_lattice(space)).T, halves)
    return (np.round(exact * 2**degree) / 2**degree).reshape(-1, own.shape[1])


def halved(space: Space, coefficients: Either) -> Either:
    """Coefficients on a cell's 2^d parts: (n, k) to (n, 2^d k), part after part."""
    xp = namespace(coefficients)
    k = coefficients.shape[-1]
    values = coefficients.reshape(*(len(indices(*factor)) for factor in space), k)
    for axis, factor in enumerate(space):
        matrix = halving(*factor).astype(values.dtype)
        values = xp.moveaxis(contracted(matrix, values, axis), 0, axis)
    shape = [size for factor in space for size in (2 ** factor[0], len(indices(*factor)))]
    values = values.reshape(*shape, k)
    axes = range(2 * len(space))
    return values.transpose(*axes[1::2], *axes[::2], len(axes)).reshape(coefficients.shape[0], -1)


def multiplied(first: Space, second: Space, a: list[Any], b: list[Any], product: Any) -> list[Any]:
    """Multiplies polynomials (n, k), one array a component, by a bilinear `product` of lists."""
    table = rows_of_products(first, second)
    xp = namespace(a[0])

    def add(sums, step):
        rows, factor = step
        parts = zip(sums, product(a, [component[None] for component in factor]), strict=True)
        if xp is not np:
            return [total.at[rows].add(part, unique_indices=True) for total, part in parts], None
        for total, part in parts:
            total[rows] += part
        return sums, None

    one = product(a, [component[:1] for component in b])
    zeros = [xp.zeros((int(table.max()) + 1, part.shape[-1]), part.dtype) for part in one]
    if xp is np:
        steps = zip(table, zip(*b, strict=True), strict=True)
        return functools.reduce(lambda sums, step: add(sums, step)[0], steps, zeros)
    return jax.lax.scan(add, zeros, (table, b))[0]
