"""Centres of mass of cells, from their corners."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from . import measures
from .vector import Vector, cross, divide, dot, mean, stack

Scalar = Float[Array, " k"]


def centre_of_mass(kind: str, x: Sequence[Vector]) -> Vector:
    """Computes the centre of mass of the triangles or tetrahedra between the sides, their means and the first corner.

    It is OpenFOAM's cell centre, for faces in a plane.
    """
    if kind in ("line", "triangle", "tetra"):
        return mean(x)
    if kind == "quad":
        return _centre_of_quad(x)
    parts, stacked = [], stack(x)
    for group in measures.faces_by_size(kind):

        def face(sums, corners):
            return tuple(a + b for a, b in zip(sums, _moments(stacked, corners), strict=True)), None

        zero = jnp.zeros_like(x[0][0])
        parts.append(jax.lax.scan(face, (zero,) * 4, np.array(group))[0])
    whole, *moment = (functools.reduce(jnp.add, part) for part in zip(*parts, strict=True))
    return Vector(moment) * divide(jnp.full_like(whole, 0.25), whole, 0.0)


def _moments(x: Vector, corners: Int[Array, " c"]) -> list[Scalar]:
    """Computes six volumes, and 24 first moments, of the tetrahedra between one face and the first corner."""
    around = [x.row(corner) for corner in corners]
    middle = mean(around)
    pairs = [(around[i - 1], corner) for i, corner in enumerate(around)]
    volumes = [dot(cross(a, b), middle) for a, b in pairs]
    moment = _sum([(a + b + middle) * weight for (a, b), weight in zip(pairs, volumes, strict=True)])
    return [functools.reduce(jnp.add, volumes), *moment.components]


def _centre_of_quad(corners: Sequence[Vector]) -> Vector:
    """Computes the centre of mass of the triangles between the sides and the mean of the corners, by their projected areas."""
    middle, normal = mean(corners), measures.area_vector(corners)
    spokes = [corner - middle for corner in corners]
    pairs = [(spokes[i - 1], spoke) for i, spoke in enumerate(spokes)]
    weights = [dot(cross(a, b), normal) for a, b in pairs]
    moment = _sum([(a + b) * weight for (a, b), weight in zip(pairs, weights, strict=True)])
    whole = functools.reduce(jnp.add, weights)
    return middle + moment * divide(jnp.full_like(whole, 1 / 3), whole, 0.0)


def _sum(vectors: list[Vector]) -> Vector:
    return functools.reduce(Vector.__add__, vectors)
