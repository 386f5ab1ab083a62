"""Angles between the faces of a mesh and the lines between its cells' centres."""

import functools
from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._host.topology import DIMENSION, FACES
from . import measures
from .blocks import in_blocks
from .centres import centre_of_mass
from .vector import Vector, corners


def largest_inner(degrees: Float[Array, "f k"], is_inner: Bool[Array, "f k"]) -> Float[Array, " k"]:
    return jnp.max(jnp.where(is_inner, degrees, 0), axis=0)


def non_orthogonality(
    points: Float[Array, "n d"],
    cells: dict[str, Int[Array, "c k"]],
    signs: dict[str, Array],
    neighbour: Array,
    largest: Callable = largest_inner,
) -> Array:
    """Computes the largest angle over the inner faces of each cell, 0 for a cell without any.

    `largest` may be a smooth stand-in. Centres are kept relative to the first corner of their cell, so that their
    differences do not lose digits.
    """
    placed = [in_blocks(functools.partial(_centres, kind, points), ids) for kind, ids in cells.items()]
    origins, centres = (Vector(list(jnp.concatenate(parts, axis=1))) for parts in zip(*placed, strict=True))
    angles, first, used = [], 0, 0
    for kind, ids in cells.items():
        k, f = ids.shape[1], len(FACES[kind])
        if f:
            behind = neighbour[used : used + f * k].reshape(k, f).T
            angles_of_block = functools.partial(_angles, kind, points, (origins, centres), largest)
            angles.append(in_blocks(angles_of_block, ids, signs[kind], behind, jnp.arange(first, first + k)))
        else:
            angles.append(jnp.zeros(k, points.dtype))
        first, used = first + k, used + f * k
    return jnp.concatenate(angles)


def _centres(kind: str, points: Float[Array, "n d"], ids: Int[Array, "c k"]) -> tuple[Array, Array]:
    """Computes the first corner, and the centre relative to it, (d, k) each."""
    x = corners(points, ids.T)
    return jnp.stack(x[0].components), jnp.stack(centre_of_mass(kind, measures.relative_corners(x)[0]).components)


def _angles(
    kind: str, points: Array, places: tuple[Vector, Vector], largest: Callable, ids, sign, behind, here
) -> Array:
    origins, centres = places
    relative, size = measures.relative_corners(corners(points, ids.T))
    other = jnp.where(behind < 0, here, behind)
    here = here[None]
    between = (_at(origins, other) - _at(origins, here)) + (_at(centres, other) - _at(centres, here))
    areas = measures.face_areas(kind, measures.scaled(relative, size)) * sign[None]
    degrees = measures.non_orthogonality(areas, between * (1 / size)[None], DIMENSION[kind] < len(areas))
    return largest(degrees, behind >= 0)


def _at(a: Vector, ids: Array) -> Vector:
    return Vector([component[ids] for component in a.components])
