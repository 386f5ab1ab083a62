"""Vectors of two or three components, each an array whose last axis runs over the cells.

Loops over many cells then run along the arrays, where the machine is fast, and nothing is laid out
anew. An axis before it runs over the corners, edges or faces of one cell.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Num, Shaped

from .._host.linear import products
from .._kernels.compile import Function, compiled
from .._kernels.values import Either, namespace, on_host, root

Scalar = Float[Either, "*rows k"]


class Vector:
    """Holds the components of a vector, with the arithmetic it needs; immutable."""

    __slots__ = ("components",)

    def __init__(self, components: Sequence[Scalar]):
        self.components = tuple(components)

    def __getitem__(self, i: int) -> Scalar:
        return self.components[i]

    def rows(self, ids: Sequence[int]) -> "Vector":
        xp = namespace(self.components[0])
        return Vector([xp.stack([component[i] for i in ids]) for component in self.components])

    def row(self, i: int | Int[Either, ""] | np.integer) -> "Vector":
        return Vector([component[i] for component in self.components])

    def unstack(self) -> "list[Vector]":
        return [self.row(i) for i in range(self.components[0].shape[0])]

    def __len__(self) -> int:
        return len(self.components)

    def __add__(self, other: "Vector") -> "Vector":
        return Vector([a + b for a, b in zip(self.components, other.components, strict=True)])

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector([a - b for a, b in zip(self.components, other.components, strict=True)])

    def __mul__(self, factor: Num[Either, "*rows k"] | float | int) -> "Vector":
        return Vector([a * factor for a in self.components])


def corners(points: Float[Either, "n d"], ids: Shaped[Either, "k c"]) -> list[Vector]:
    """Gathers one vector for each corner of k cells."""
    axes = [points[:, axis] for axis in range(points.shape[1])]
    return [Vector([axis[ids[:, corner]] for axis in axes]) for corner in range(ids.shape[1])]


def dot(a: Vector, b: Vector) -> Scalar:
    return products.dot(a.components, b.components)


def cross(a: Vector, b: Vector) -> Vector:
    """Computes the cross product; in 2-D its one component."""
    return Vector(products.cross(a.components, b.components))


def determinant(columns: Sequence[Vector]) -> Scalar:
    """Computes the determinant of a matrix, with three columns as (a x b) . c."""
    return products.determinant([column.components for column in (*columns[2:], *columns[:2])])


def cofactors(columns: Sequence[Vector]) -> list[Vector]:
    """Computes the rows of the inverse of a matrix, times its determinant."""
    return [Vector(row) for row in products.cofactors([column.components for column in columns])]


def norm(a: Vector) -> Scalar:
    """Computes the length; its derivative at zero is zero."""
    return root(dot(a, a))


def stack(vectors: Sequence[Vector]) -> Vector:
    """Stacks vectors as rows of one."""
    xp = namespace(vectors[0][0])
    return Vector([xp.stack(rows) for rows in zip(*(a.components for a in vectors), strict=True)])


def mean(vectors: Sequence[Vector]) -> Vector:
    return functools.reduce(Vector.__add__, vectors) * (1 / len(vectors))


def divide(a: Scalar, b: Scalar, otherwise: float) -> Scalar:
    """Divides a by b; `otherwise` where b is so small that the derivative overflows.

    The result has no derivative there.
    """
    xp = namespace(b)
    none = xp.abs(b) <= float(jnp.finfo(b.dtype).tiny) ** 0.4
    return xp.where(none, otherwise, a / xp.where(none, 1, b))


def angle(a: Vector, b: Vector) -> Scalar:
    """Computes the angle in radians, 0 to pi.

    Where a vector has no length it is 0, without a derivative.
    """
    xp, sine, cosine = namespace(a[0]), norm(cross(a, b)), dot(a, b)
    none = sine**2 + cosine**2 <= float(jnp.finfo(sine.dtype).tiny) ** 0.8
    return xp.where(none, 0, xp.arctan2(sine, xp.where(none, 1, cosine)))


BLOCK = 1 << 16
"""Cells that are measured together."""

CACHED = 1 << 13
"""Cells that NumPy measures together: intermediate values stay in the processor's cache."""


def by_place(function: Function) -> Function:
    """Makes a function that runs by NumPy where its arrays are in the host's memory, else compiled.

    Its first argument is static. A program would take longer to compile than NumPy takes for all.
    """
    program = compiled(function)

    @functools.wraps(function)
    def call(static: Any, *arrays: Any) -> Any:
        if not on_host(arrays):
            return program(static, *jax.tree.map(jnp.asarray, arrays))
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():  # cells may have no size
            return function(static, *jax.tree.map(np.asarray, arrays))

    return call  # pyright: ignore[reportReturnType]


def in_blocks(xp: Any, function: Callable, *rows: Any, size: int | None = None) -> Any:
    """Applies `function`, of NumPy or `jax.numpy`, to blocks of cells: memory is that of one.

    The last axis of each of `rows` runs over cells, and so does that of what `function` returns.
    Reverse mode computes each block anew. A block has `size` cells. By default it has `CACHED` for
    NumPy and `BLOCK` for JAX, fewer of cells with many values.
    """
    leaves = jax.tree.leaves(rows)
    width = max(math.prod(leaf.shape[:-1]) for leaf in leaves)  # many values a cell, fewer cells
    k, block = leaves[0].shape[-1], size or max((CACHED if xp is np else BLOCK) * 9 // max(width, 9), 64)
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
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)[..., :k], results)
