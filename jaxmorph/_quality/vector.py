"""Vectors of two or three components: arrays with the cells on the last axis, for fast loops.

The corners of k cells are one vector, each of whose components has a row for each corner (c, k).
"""

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Num, Shaped

from .._host.linear import products
from .._host.linear.products import Components, dot
from .._kernels.values import Either, namespace, root

Scalar = Float[Either, "*rows k"]
PerCell = Float[Either, " k"]
Marks = Bool[Either, " k"]
Ids = Int[Either, " k"]
Samples = Float[Either, "s k"]
Points = Float[Either, "n d"]

ValuesByType = dict[str, Any]


class Vector(tuple):
    __slots__ = ()

    def __add__(self, other: "Vector") -> "Vector":  # pyright: ignore[reportIncompatibleMethodOverride]
        return Vector(a + b for a, b in zip(self, other, strict=True))

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(a - b for a, b in zip(self, other, strict=True))

    def __mul__(self, factor: Num[Either, "*rows k"] | float | int) -> "Vector":  # pyright: ignore[reportIncompatibleMethodOverride]
        return Vector(a * factor for a in self)

    def at(self, rows: Any) -> "Vector":
        return Vector(a[rows] for a in self)


def corner_points(points: Points, ids: Shaped[Either, "k c"]) -> Vector:
    rows = ids.T.copy()  # so that values of all cells stand side by side in NumPy's arrays
    return Vector(points[:, axis][rows] for axis in range(points.shape[1]))


def columns(x: Vector, table: Iterable[Sequence[int]]) -> list[Vector]:
    """A vector for each column of a table of rows: every face's first corner, second, ..."""
    xp = namespace(x[0])
    return [
        Vector(xp.stack([a[i] for i in column]) for a in x) for column in zip(*table, strict=True)
    ]


def combined(table: np.ndarray, x: Vector) -> Vector:
    return Vector(contracted(table.astype(a.dtype), a) for a in x)


def contracted(matrix: np.ndarray, values: Either, axis: int = 0) -> Either:
    """Multiplies values by a matrix along an axis, which comes first; in full precision."""
    if namespace(values) is np:
        return np.tensordot(matrix, values, (1, axis))
    return jnp.tensordot(matrix, values, (1, axis), precision="highest")


def cross_product(a: Vector, b: Vector) -> Vector:
    return Vector(products.cross(a, b))


def determinant_of(columns: Components) -> Scalar:
    return products.determinant([*columns[2:], *columns[:2]])


def length_of(a: Vector) -> Scalar:
    """The length; its derivative at zero is zero."""
    return root(dot(a, a))


def unit_of(a: Vector) -> Vector:
    """Divides by the length; zero where there is none."""
    return a * divide(namespace(a[0]).ones_like(a[0]), length_of(a), 0.0)


def join(vectors: Iterable[Vector]) -> Vector:
    return Vector(namespace(parts[0]).concatenate(parts) for parts in zip(*vectors, strict=True))


def total(vectors: Iterable[Vector]) -> Vector:
    return functools.reduce(Vector.__add__, vectors)


def mean(vectors: Sequence[Vector]) -> Vector:
    return total(vectors) * (1 / len(vectors))


def middle(x: Vector) -> Vector:
    return Vector(a.mean(axis=0) for a in x)


def divide(a: Scalar, b: Scalar, otherwise: float) -> Scalar:
    """a / b, or `otherwise`, without a derivative, where b is so small that it overflows."""
    xp = namespace(b)
    none = xp.abs(b) <= float(jnp.finfo(b.dtype).tiny) ** 0.4
    return xp.where(none, otherwise, a / xp.where(none, 1, b))


def angle(a: Vector, b: Vector) -> Scalar:
    """The angle in radians; 0, without a derivative, for a vector of no length."""
    xp = namespace(a[0])
    sine = length_of(cross_product(a, b))
    cosine = dot(a, b)
    none = sine**2 + cosine**2 <= float(jnp.finfo(sine.dtype).tiny) ** 0.8
    return xp.where(none, 0, xp.arctan2(sine, xp.where(none, 1, cosine)))


VALUES_OF_BLOCK = 1 << 16  # cells in a block
CACHED = 1 << 13  # cells in a block of NumPy: intermediate values stay in the processor's cache


def in_blocks(xp: Any, function: Callable, *rows: Any, size: int | None = None) -> Any:
    """Applies `function`, of NumPy or `jax.numpy`, to blocks of cells: memory is that of one. Cells
    run along the last axis of `rows` and of the result. Reverse mode computes each block anew. A
    block has `size` cells: by default `CACHED` for NumPy and `VALUES_OF_BLOCK` for JAX, fewer of
    cells with many values.
    """
    leaves = jax.tree.leaves(rows)
    width = max(math.prod(leaf.shape[:-1]) for leaf in leaves)  # many values a cell, fewer cells
    k = leaves[0].shape[-1]
    block = size or max((CACHED if xp is np else VALUES_OF_BLOCK) * 9 // max(width, 9), 64)
    if k <= block:
        return function(*rows)

    def one(picked):
        return function(*jax.tree.map(lambda x: x[..., picked], rows))

    blocks = -(-k // block)
    if xp is np:
        # no threads: between operations on so few cells they wait for Python's lock
        results = [one(slice(i * block, (i + 1) * block)) for i in range(blocks)]
        return jax.tree.map(lambda *parts: np.concatenate(parts, axis=-1), *results)
    every = jnp.minimum(jnp.arange(blocks * block), k - 1)  # the last cell fills the last block
    results = jax.lax.map(jax.checkpoint(one), every.reshape(blocks, block))
    return jax.tree.map(
        lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)[..., :k], results
    )


def by_type(
    function: Callable, points: Points, cells: ValuesByType, *others: ValuesByType
) -> ValuesByType:
    """Applies `function(kind, corners, ...)` to blocks of each type's cells, and of `others`."""

    def measured(kind: str, ids: Int[Either, "c k"], *rows: Any) -> Any:
        return function(kind, corner_points(points, ids.T), *rows)

    parts = {}
    for kind, ids in cells.items():
        function_of_kind = functools.partial(measured, kind)
        rows = [other[kind] for other in others]
        parts[kind] = in_blocks(namespace(points), function_of_kind, ids.T, *rows)
    return parts


def join_values(xp: Any, parts: ValuesByType) -> Any:
    return jax.tree.map(lambda *rows: xp.concatenate(rows, axis=-1), *parts.values())
