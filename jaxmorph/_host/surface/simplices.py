"""Closed-form geometry of simplices: a LAPACK call for each one takes twenty times longer."""

import numpy as np

from ..linear import products
from ..package.cores import by_blocks


def smallest_weight(
    nodes: np.ndarray, simplices: np.ndarray, simplex: np.ndarray, points: np.ndarray, flat: float
) -> np.ndarray:
    """Computes the smallest barycentric coordinate of every point in its simplex.

    It is -inf where the simplex is -1 or not higher than `flat`. Blocks of points keep memory
    small.
    """
    smallest = np.empty(len(points))

    def weigh(part: slice) -> None:
        corners = nodes[simplices[simplex[part]]]
        edges = [corners[:, i] - corners[:, -1] for i in range(points.shape[1])]
        rows = cofactors(edges)
        volume = np.einsum("kd,kd->k", rows[0], edges[0])
        inner = points[part] - corners[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = [np.einsum("kd,kd->k", row, inner) / volume for row in rows]
            least = np.minimum(np.min(weights, axis=0), 1 - np.sum(weights, axis=0))
        sound = (simplex[part] >= 0) & (smallest_height(corners) > flat)
        smallest[part] = np.where(sound, least, -np.inf)

    by_blocks(weigh, len(points))
    return smallest


def smallest_height(corners: np.ndarray) -> np.ndarray:
    """Computes least heights (k,) of simplices (k, c, d): content over the largest side's content.

    The result does not depend on which corner comes first.
    """
    count = corners.shape[1]
    sides = [_content([corners[:, i] for i in range(count) if i != corner]) for corner in range(count)]
    largest = np.max(sides, axis=0)
    return _content([corners[:, i] for i in range(count)]) / np.where(largest > 0, largest, 1)


def _content(corners: list[np.ndarray]) -> np.ndarray:
    """Computes lengths, twice areas or six times volumes from corners (k, d); 1 for points."""
    edges = [corner - corners[0] for corner in corners[1:]]
    if not edges:
        return np.ones(len(corners[0]))
    if len(edges) == edges[0].shape[1]:
        return np.abs(np.einsum("kd,kd->k", cofactors(edges)[0], edges[0]))
    normal = edges[0] if len(edges) == 1 else cross(*edges)
    return np.sqrt(np.einsum("kd,kd->k", normal, normal))


def normals(corners: np.ndarray) -> np.ndarray:
    """Computes normals (k, d) of segments or triangles (k, d, d), of length or twice the area."""
    edges = corners[:, 1:] - corners[:, :1]
    return edges[:, 0, ::-1] * [1, -1] if edges.shape[1] == 1 else cross(edges[:, 0], edges[:, 1])


def cofactors(edges: list[np.ndarray]) -> list[np.ndarray]:
    """Computes the rows of the adjugate of the matrix whose columns are the edges, each (k, d)."""
    return [np.stack(row, axis=1) for row in products.cofactors([edge.T for edge in edges])]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Computes cross products of rows; `numpy.cross` is slow for many short vectors."""
    return np.stack(products.cross(a.T, b.T), axis=1)
