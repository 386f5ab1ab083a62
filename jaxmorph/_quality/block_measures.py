"""Measures of a block of faces, which one core computes."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._host.linear.products import cross, dot
from .sides import Block

Columns = Any
"""Components of vectors: a sequence of columns, or an array whose first axis runs over them."""

FLOOR = 1e-300
"""Least number by which anything is divided."""


def fill(block: Block, centre: Columns, area: Columns, points: Columns) -> None:
    """Computes the rows of a block: centres and area vectors (d, f) of faces."""
    x = _corners(points, block)
    centre[:, block.rows], area[:, block.rows] = _edge(x) if len(points) == 2 else _polygon(x)


def pyramids(block: Block, centres: Columns, areas: Columns, means: Columns) -> list[tuple[Columns, Columns]]:
    """Computes d volumes (b,) and first moments (d, b) of pyramids, as each view sees the faces."""
    d, parts = len(means), []
    centre, area = centres[:, block.rows], areas[:, block.rows]
    for sign, cells in block.views:
        middle = [mean.take(cells) for mean in means]
        volume = sign * dot(area, [c - m for c, m in zip(centre, middle, strict=True)])
        share = volume / (d + 1)
        parts.append((volume, [share * (d * c + m) for c, m in zip(centre, middle, strict=True)]))
    return parts


class OfFaces(NamedTuple):
    """Holds measures of a block of faces, and the heights of cells' middles below them, by view."""

    size: np.ndarray
    skewness: np.ndarray
    cosine: np.ndarray
    cosines: np.ndarray
    area: np.ndarray
    heights: list[np.ndarray]


def of_faces(block: Block, centres: Columns, areas: Columns, middle: Columns, points: Columns) -> OfFaces:
    """Measures a block of faces between cells with given middles."""
    centre, area = centres[:, block.rows], areas[:, block.rows]
    skewness, cosine = _across(block, centre, area, middle, points)
    inner = cosine[block.behind >= 0]
    heights = [sign * dot(area, _arm(centre, middle, cells)) for sign, cells in block.views]
    return OfFaces(_size(area), skewness, cosine, np.array([inner.sum(), len(inner)]), np.abs(area), heights)


def _across(
    block: Block, centre: Columns, area: Columns, middle: Columns, points: Columns
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"]]:
    """Computes the skewness of faces, and cosines of area vectors with lines of centres."""
    owner, behind = block.owner, block.behind
    arm, size = _arm(centre, middle, owner), _size(area)
    across = [m.take(behind) - m.take(owner) for m in middle]  # anything where there is no cell behind
    cosine = np.clip(dot(area, across) / np.maximum(size * _size(across), FLOOR), -1, 1)
    inside = True
    if not block.is_shared:
        inside = behind >= 0
        cosine = np.where(inside, cosine, 1)
        normal = [a / np.maximum(size, FLOOR) for a in area]
        height = dot(normal, arm)
        across = [np.where(inside, a, height * n) for a, n in zip(across, normal, strict=True)]
    along = dot(area, across)
    share = dot(area, arm) / np.where(along == 0, FLOOR, along)
    by = [a - share * b for a, b in zip(arm, across, strict=True)]
    miss = _size(by)
    corners, reach = _corners(points, block), 0.0
    for k in range(len(block.group.corners)):
        arms = [x[k] - c for x, c in zip(corners, centre, strict=True)]
        reach = np.maximum(reach, np.abs(dot(by, arms)))
    least = np.where(inside, 0.2, 0.4) * _size(across)
    skewness = miss / np.maximum(np.maximum(reach / np.maximum(miss, FLOOR), least), FLOOR)
    return np.where(block.group.is_between[block.rows], 0, skewness), cosine


def _arm(centre: Columns, middle: Columns, cells: np.ndarray) -> Columns:
    return [c - m.take(cells) for c, m in zip(centre, middle, strict=True)]


def _size(vectors: Columns) -> Float[np.ndarray, " b"]:
    return np.sqrt(dot(vectors, vectors))


def _corners(points: Columns, block: Block) -> list[list[Float[np.ndarray, " b"]]]:
    """Gathers the coordinates of the faces' corners: by axis, then by corner."""
    corners = block.corners
    return [[column.take(ids) for ids in corners] for column in points]


def _edge(x: Sequence[Columns]) -> tuple[Columns, Columns]:
    """Computes the middles of edges, and their area vectors: as long as the edge."""
    along = [last - first for first, last in x]
    return [(first + last) / 2 for first, last in x], [along[1], -along[0]]


def _polygon(x: Sequence[Columns]) -> tuple[Columns, Columns]:
    """Computes centres and area vectors, by triangles about the mean of the corners."""
    count, mean = len(x[0]), [sum(corners) / len(corners) for corners in x]
    arms = [[m - corners[k] for m, corners in zip(mean, x, strict=True)] for k in range(count)]
    area, moment, total = [0.0] * 3, [0.0] * 3, FLOOR
    for k, arm in enumerate(arms):
        after = arms[(k + 1) % count]
        normal = cross(arm, after)
        weight = _size(normal)
        total = total + weight
        area = [a + n for a, n in zip(area, normal, strict=True)]
        moment = [m + weight * (a + b) for m, a, b in zip(moment, arm, after, strict=True)]
    return [m - first / (3 * total) for m, first in zip(mean, moment, strict=True)], [a / 2 for a in area]
