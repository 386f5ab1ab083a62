"""Angles between the faces of a mesh and the lines between its cells' centres."""

import functools
from collections.abc import Callable

from jaxtyping import Bool, Float, Shaped

from .._host.cells.topology import CORNERS, DIMENSION, FACES, SHAPES
from .._kernels.values import Either, largest, namespace
from . import measures
from .batches import in_blocks
from .centres import centre_of_mass
from .vector import Vector, corners


def largest_inner(degrees: Float[Either, "f k"], is_inner: Bool[Either, "f k"]) -> Float[Either, " k"]:
    return largest(namespace(degrees).where(is_inner, degrees, 0))


def non_orthogonality(
    points: Float[Either, "n d"],
    cells: dict[str, Shaped[Either, "c k"]],
    signs: dict[str, Either],
    neighbour: Either,
    maximum: Callable = largest_inner,
) -> Either:
    """Computes the largest angle over the inner faces of each cell, 0 for a cell without any.

    `maximum` may be a smooth stand-in. Centres are kept relative to the first corner of their cell,
    so that their differences do not lose digits.
    """
    xp = namespace(points)
    cells = {kind: ids[: CORNERS[SHAPES[kind]]] for kind, ids in cells.items()}  # of a curved cell the corners
    placed = [in_blocks(xp, functools.partial(_centres, kind, points), ids) for kind, ids in cells.items()]
    origins, centres = (Vector(list(xp.concatenate(parts, axis=1))) for parts in zip(*placed, strict=True))
    angles, first, used = [], 0, 0
    for kind, ids in cells.items():
        k, f = ids.shape[1], len(FACES[kind])
        if f:
            behind = neighbour[used : used + f * k].reshape(k, f).T
            angles_of_block = functools.partial(_angles, kind, points, (origins, centres), maximum)
            angles.append(in_blocks(xp, angles_of_block, ids, signs[kind], behind, xp.arange(first, first + k)))
        else:
            angles.append(xp.zeros(k, points.dtype))
        first, used = first + k, used + f * k
    return xp.concatenate(angles)


def _centres(kind: str, points: Float[Either, "n d"], ids: Shaped[Either, "c k"]) -> tuple[Either, Either]:
    """Computes the first corner, and the centre relative to it, (d, k) each."""
    xp, x = namespace(points), corners(points, ids.T)
    return xp.stack(x[0].components), xp.stack(centre_of_mass(SHAPES[kind], measures.relative_corners(x)[0]).components)


def _angles(
    kind: str, points: Either, places: tuple[Vector, Vector], maximum: Callable, ids, sign, behind, here
) -> Either:
    origins, centres = places
    relative, size = measures.relative_corners(corners(points, ids.T))
    other = namespace(points).where(behind < 0, here, behind)
    here = here[None]
    between = (_at(origins, other) - _at(origins, here)) + (_at(centres, other) - _at(centres, here))
    areas = measures.face_areas(SHAPES[kind], measures.scaled(relative, size)) * sign[None]
    degrees = measures.non_orthogonality(areas, between * (1 / size)[None], DIMENSION[kind] < len(areas))
    return maximum(degrees, behind >= 0)


def _at(a: Vector, ids: Either) -> Vector:
    return Vector([component[ids] for component in a.components])
