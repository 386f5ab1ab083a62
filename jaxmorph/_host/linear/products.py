"""Products of vectors given by their components: numbers, or arrays of NumPy or JAX."""

from collections.abc import Sequence
from typing import Any

Components = Any
"""A sequence of numbers or arrays: a tuple, a list, or an array whose first axis runs over them."""


def dot(a: Components, b: Components) -> Any:
    first, *others = [p * q for p, q in zip(a, b, strict=True)]
    for other in others:
        first = first + other
    return first


def cross(a: Components, b: Components) -> list[Any]:
    """Computes the cross product; in 2-D its one component."""
    pairs = ((0, 1),) if len(a) == 2 else ((1, 2), (2, 0), (0, 1))
    return [a[i] * b[j] - a[j] * b[i] for i, j in pairs]


def determinant(columns: Sequence[Components]) -> Any:
    """Computes the determinant of a 2 by 2 or 3 by 3 matrix by its first column: a . (b x c)."""
    first, *others = columns
    return cross(first, *others)[0] if len(columns) == 2 else dot(cross(*others), first)


def cofactors(columns: Sequence[Components]) -> list[list[Any]]:
    """Computes the rows of the inverse of a matrix, times its determinant."""
    if len(columns) == 2:
        a, b = columns
        return [[b[1], -b[0]], [-a[1], a[0]]]
    a, b, c = columns
    return [cross(b, c), cross(c, a), cross(a, b)]
