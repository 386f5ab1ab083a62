"""How far cells are from target shapes: an energy that stays finite, with a useful gradient, on inverted cells.

At each corner of a cell (and at the centre of a hexahedron) the edges that leave it are the columns of A, those of the target
cell the columns of W, and T = A W^-1 takes the target to the cell: the target-matrix paradigm (Knupp, Algebraic mesh quality
metrics, SIAM J. Sci. Comput. 23, 2001). The determinant in the denominators is regularised as in Garanzha et al.,
Foldover-free maps in 50 lines of code, ACM Trans. Graph. 40, 2021.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.topology import CORNERS, DIMENSION, FRAMES
from .._mesh.mesh import Mesh
from . import measures
from .quality import places
from .smooth import positive_part
from .vector import Vector, corners, cross, dot

Scalar = Float[Array, "s k"]

_ROOT_3, _THIRD = 3**0.5, 3**-0.5
IDEAL = {
    "triangle": ((0, 0), (1, 0), (0.5, _ROOT_3 / 2)),
    "quad": ((0, 0), (1, 0), (1, 1), (0, 1)),
    "tetra": ((0, 0, 0), (1, 0, 0), (0.5, _ROOT_3 / 2, 0), (0.5, _THIRD / 2, (2 / 3) ** 0.5)),
    "pyramid": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 0.5**0.5)),
    "wedge": (
        *((0, 0, 0), (1, 0, 0), (0.5, _ROOT_3 / 2, 0)),
        *((0, 0, 1), (1, 0, 1), (0.5, _ROOT_3 / 2, 1)),
    ),
    "hexahedron": (
        *((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
        *((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
    ),
}
"""Corners of the ideal cell of each type, edges of length one."""


class Target(NamedTuple):
    """Inverse target matrices W^-1, row by row, and which samples count: those with a sign beyond round-off."""

    inverse: tuple[tuple[Scalar, ...], ...]
    determinant: Scalar
    counts: Scalar


def target(kind: str, x: list[Vector], ideal: bool) -> Target:
    """From the corners of undeformed cells; `ideal`: of cells of ideal shape, with their volume and handedness."""
    edges, noise = measures.frames(kind, x), _noise(kind, x)
    volume = measures.volume(kind, [corner - x[0] for corner in x])
    sign = jnp.where(volume < 0, -1.0, 1.0)
    counts = sign * _determinant(edges) > noise
    if ideal:
        shape = [Vector([jnp.full_like(volume, c) for c in corner]) for corner in IDEAL[kind]]
        size = jnp.abs(volume) / jnp.abs(measures.volume(kind, shape))
        size = jnp.where(size > 0, size, 1) ** (1 / DIMENSION[kind])
        # the mirror image of the ideal cell, where cells are numbered left-handed
        edges = measures.frames(kind, [Vector([c[0] * sign, *c.components[1:]]) * size for c in shape])
    determinant = jnp.where(counts, _determinant(edges), 1)
    rows = [row * (1 / determinant) for row in _adjugate(edges)]
    inverse = tuple(tuple(jnp.where(counts, c, 0) for c in row.components) for row in rows)
    return Target(inverse, 1 / determinant, counts.astype(determinant.dtype))


def _noise(kind: str, x: list[Vector]) -> Scalar:
    reach = jnp.max(jnp.stack([jnp.abs(component) for corner in x for component in corner.components]), axis=0)
    return 8 * float(jnp.finfo(x[0][0].dtype).eps) * reach * measures.jacobians(kind, [c - x[0] for c in x])[1]


def _determinant(edges: list[Vector]) -> Scalar:
    return cross(*edges)[0] if len(edges) == 2 else dot(cross(edges[0], edges[1]), edges[2])


def _adjugate(edges: list[Vector]) -> list[Vector]:
    """Rows of the inverse of the matrix with these columns, times its determinant."""
    if len(edges) == 2:
        a, b = edges
        return [Vector((b[1], -b[0])), Vector((-a[1], a[0]))]
    a, b, c = edges
    return [cross(b, c), cross(c, a), cross(a, b)]


def samples(kind: str, x: list[Vector], of: Target) -> tuple[Scalar, Scalar]:
    """|T|^2 / d and det T at each sample."""
    edges = measures.frames(kind, x)
    d = len(edges)
    squared = jnp.zeros_like(of.determinant)
    for row in range(d):
        for column in range(d):
            entry = edges[0][row] * of.inverse[0][column]
            for edge, inverse in zip(edges[1:], of.inverse[1:], strict=True):
                entry = entry + edge[row] * inverse[column]
            squared = squared + entry**2
    return squared / d, _determinant(edges) * of.determinant


def energy(squared: Scalar, tau: Scalar, softness: Any, size: float, dimension: int) -> Scalar:
    """0 for the target cell; without bound as det T falls to zero, large where it is negative.

    (1 - size) |T|^2 / (d chi^(2/d)) + size (1 + det T^2) / (2 chi) - 1, with chi(det T) > 0 the regularised determinant.
    """
    chi = positive_part(tau, softness)
    shape = squared / (chi if dimension == 2 else jnp.cbrt(chi) ** 2)
    return (1 - size) * shape + size * (1 + tau**2) / (2 * chi) - 1


def energy_of_cells(kind: str, x: list[Vector], of: Target, softness: Any, size: float) -> Float[Array, " k"]:
    """Mean of the energy over the samples of each cell."""
    squared, tau = samples(kind, x, of)
    return jnp.mean(of.counts * energy(squared, tau, softness, size, len(of.inverse)), axis=0)


def node_scales(kinds: dict[str, Any], targets: dict[str, Target], n: int) -> Float[Array, " n"]:
    """How far a node moves to change the energy by about one: the inverse root of its diagonal entry of the Hessian."""
    stiffness = jnp.zeros(n)
    for kind, ids in kinds.items():
        of, frames = targets[kind], np.array(FRAMES[kind])
        rows = [Vector([c[: len(frames)] for c in row]) for row in of.inverse]  # without the centre of a hexahedron
        whole = functools.reduce(Vector.__add__, rows)
        for end, row in enumerate([whole, *rows]):
            stiffness = stiffness.at[ids[:, frames[:, end]].T].add(dot(row, row) / len(frames))
    return jnp.where(stiffness > 0, jnp.where(stiffness > 0, stiffness, 1) ** -0.5, 0)


def solid(cells: dict[str, Any], dimension: int) -> dict[str, Any]:
    """The cells that fill the space: boundary elements have no target of their own."""
    return {kind: ids for kind, ids in cells.items() if DIMENSION[kind] == dimension and len(ids) and CORNERS[kind] > 2}


def distortion(
    mesh: Mesh,
    points: Float[Any, "n d"] | None = None,
    *,
    ideal: bool = False,
    size_weight: float = 0.5,
    softness: float = 1e-3,
) -> Float[Array, " k"]:
    """Measures the distortion of each cell, in the order of `mesh.cells`: what `improve` sums, smooth everywhere.

    0 for a cell like its target: the undeformed one of `mesh.points`, or with `ideal=True` the equilateral one. With
    `size_weight=0` it is the mean over the corners of 1 / mean ratio - 1. With `size_weight=1` it is a barrier on the corner
    Jacobians relative to the target's; between them a blend. On inverted cells it is finite, with a derivative that turns
    them round again, and large: as (1 / softness)^2 in 2-D. Traced in `points`.

    Raises `ValueError` for a mesh without cells of its own dimension, and when the shape of `points` differs from that of
    `mesh.points`.
    """
    d = mesh.points.shape[1]
    kinds = solid(mesh.cells, d)
    if not kinds:
        raise ValueError(f"the mesh has no cells that fill {d}-D space; their distortion is not defined.")
    current = places(mesh, points)
    reference = jnp.asarray(mesh.points, current.dtype)
    parts = []
    for kind, ids in kinds.items():
        of = target(kind, corners(reference, ids), ideal)
        parts.append(energy_of_cells(kind, corners(current, ids), of, softness, size_weight))
    return jnp.concatenate(parts)
