"""Centres of mass of cells, from their corners."""

import functools
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from .._kernels.values import Either, namespace
from . import measures
from .vector import Vector, cross, divide, dot, mean, stack

Scalar = Float[Either, " k"]


def centre_of_mass(kind: str, x: Sequence[Vector]) -> Vector:
    """Computes a cell's centre of mass by triangles or tetrahedra.

    They lie between the sides, the means of the sides and the first corner.

    It is OpenFOAM's cell centre, for faces in a plane.
    """
    if kind in ("line", "triangle", "tetra"):
        return mean(x)
    if kind == "quad":
        return _centre_of_quad(x)
    xp, parts, stacked = namespace(x[0][0]), [], stack(x)
    for group in measures.faces_by_size(kind):

        def face(sums, corners):
            return tuple(a + b for a, b in zip(sums, _moments(stacked, corners), strict=True)), None

        zero, faces = xp.zeros_like(x[0][0]), np.array(group)
        if xp is np:
            parts.append(functools.reduce(lambda sums, corners: face(sums, corners)[0], faces, (zero,) * 4))
        else:  # a program of one face is several times shorter to compile
            parts.append(jax.lax.scan(face, (zero,) * 4, faces)[0])
    whole, *moment = (functools.reduce(xp.add, part) for part in zip(*parts, strict=True))
    return Vector(moment) * divide(xp.full_like(whole, 0.25), whole, 0.0)


def _moments(x: Vector, corners: Int[Either, " c"]) -> list[Scalar]:
    """Computes six volumes and 24 first moments of tetrahedra.

    They lie between one face and the first corner.
    """
    around = [x.row(corner) for corner in corners]
    middle = mean(around)
    pairs = [(around[i - 1], corner) for i, corner in enumerate(around)]
    volumes = [dot(cross(a, b), middle) for a, b in pairs]
    moment = _sum([(a + b + middle) * weight for (a, b), weight in zip(pairs, volumes, strict=True)])
    return [functools.reduce(namespace(middle[0]).add, volumes), *moment.components]


def _centre_of_quad(corners: Sequence[Vector]) -> Vector:
    """Computes a quad's centre of mass by triangles, with their projected areas.

    They lie between the sides and the mean of the corners.
    """
    xp, middle, normal = namespace(corners[0][0]), mean(corners), measures.area_vector(corners)
    spokes = [corner - middle for corner in corners]
    pairs = [(spokes[i - 1], spoke) for i, spoke in enumerate(spokes)]
    weights = [dot(cross(a, b), normal) for a, b in pairs]
    moment = _sum([(a + b) * weight for (a, b), weight in zip(pairs, weights, strict=True)])
    whole = functools.reduce(xp.add, weights)
    return middle + moment * divide(xp.full_like(whole, 1 / 3), whole, 0.0)


def _sum(vectors: list[Vector]) -> Vector:
    return functools.reduce(Vector.__add__, vectors)
