"""Vector algebra in closed form: of components (numbers, NumPy or JAX), and of rows (k, d)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray

# a sequence of numbers or arrays: a tuple, a list, or an array whose first axis runs over them
Components = Any


def dot(a: Components, b: Components) -> Any:
    first, *others = [p * q for p, q in zip(a, b, strict=True)]
    for other in others:
        first = first + other
    return first


def cross(a: Components, b: Components) -> list[Any]:
    pairs = ((0, 1),) if len(a) == 2 else ((1, 2), (2, 0), (0, 1))
    return [a[i] * b[j] - a[j] * b[i] for i, j in pairs]


def determinant(columns: Sequence[Components]) -> Any:
    """a . (b x c), by the first column; 2 by 2 or 3 by 3."""
    first, *others = columns
    return cross(first, *others)[0] if len(columns) == 2 else dot(cross(*others), first)


def cofactors(columns: Sequence[Components]) -> list[list[Any]]:
    if len(columns) == 2:
        a, b = columns
        return [[b[1], -b[0]], [-a[1], a[0]]]
    a, b, c = columns
    return [cross(b, c), cross(c, a), cross(a, b)]


def row_lengths(vectors: Any) -> Any:
    return np.linalg.norm(vectors, axis=1)


def dot_rows(a: Any, b: Any) -> Any:
    return np.sum(a * b, axis=1)


def edges_of(corners: ndarray) -> list[ndarray]:
    """Edges, each (k, d), from the first corner of simplices (k, c, d) to the others."""
    return list((corners[:, 1:] - corners[:, :1]).swapaxes(0, 1))


def smallest_height(corners: ndarray) -> ndarray:
    """Least heights (k,) of simplices (k, d + 1, d)."""
    edges = edges_of(corners)
    # area vectors of all sides but the first, whose area vector is minus their sum
    rows = cofactor_rows(edges)
    largest = np.max([row_lengths(side) for side in (*rows, sum(rows))], axis=0)
    return np.abs(np.einsum("kd,kd->k", rows[0], edges[0])) / np.where(largest > 0, largest, 1)


def normals(corners: ndarray) -> ndarray:
    """Normals (k, d) of segments or triangles (k, d, d), of length or twice the area."""
    first, *second = edges_of(corners)
    return cross_rows(first, *second) if second else first[:, ::-1] * [1, -1]


def cofactor_rows(edges: list[ndarray]) -> list[ndarray]:
    """Rows of the adjugate of the matrix whose columns are the edges, each (k, d)."""
    return [np.stack(row, axis=1) for row in cofactors([edge.T for edge in edges])]


def cross_rows(a: ndarray, b: ndarray) -> ndarray:
    """Cross products of rows; `numpy.cross` is slow for many short vectors."""
    return np.stack(cross(a.T, b.T), axis=1)


def unit_rows(vectors: ndarray) -> ndarray:
    """Divides vectors (..., d) by their lengths; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def outward(corners: ndarray) -> ndarray:
    """Outward normals (k, d) of faces (k, corners, d), as long as the area (2-D: edge)."""
    if corners.shape[1] == 2:
        return normals(corners)
    return np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]) / 2
