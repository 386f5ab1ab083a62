"""Distance of cells from target shapes, as an energy that is finite and useful on inverted cells.

At each corner of a cell, and at the centre of a hexahedron, the edges that leave it are the columns
of A. Those of the target cell are the columns of W, and T = A W^-1 takes the target to the cell:
the target-matrix paradigm (Knupp, Algebraic mesh quality metrics, SIAM J. Sci. Comput. 23, 2001).
The determinant in the denominators is regularised as in Garanzha et al., Foldover-free maps in 50
lines of code, ACM Trans. Graph. 40, 2021.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.cells.lagrange import PLACES
from .._host.cells.pieces import linear_cells, owners
from .._host.cells.topology import DIMENSION, FRAMES, solid
from .._host.linear.products import cofactors
from .._host.package.arguments import between, checked
from .._kernels.values import is_known
from .._mesh.mesh import Mesh, PointsLike
from . import measures
from .quality import check_solid, places, sizes_of, standards_of, volume_of
from .smooth_quality import positive_part
from .vector import ValuesByType, Vector, corner_points, determinant_of, dot, total

AtSamples = Float[Array, "s k"]
DistortionOfCells = Float[Array, " k"]
Some = Float[Array, "*shape"]

_HEIGHT = 3**0.5 / 2
_AXES = {
    "triangle": ((1, 0), (0.5, _HEIGHT)),
    "quad": ((1, 0), (0, 1)),
    "tetra": ((1, 0, 0), (0.5, _HEIGHT, 0), (0.5, _HEIGHT / 3, (2 / 3) ** 0.5)),
    "pyramid": ((1, 0, 0), (0, 1, 0), (0.5, 0.5, 0.5**0.5)),
    "wedge": ((1, 0, 0), (0.5, _HEIGHT, 0), (0, 0, 1)),
    "hexahedron": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
IDEAL = {kind: (np.array(PLACES[kind]) @ np.array(axes)).tolist() for kind, axes in _AXES.items()}
"""Corners of the ideal cell of each type, edges of length one."""


NEAR_AFFINE = 0.1  # least volume of an affine target cell, over that of an ideal cell


class Target(NamedTuple):
    """Inverse target matrices W^-1 by row, and samples that count: a sign beyond round-off."""

    inverse: tuple[tuple[AtSamples, ...], ...]
    determinant: AtSamples
    counts: AtSamples


def target_cells(
    cells: ValuesByType, points: Float[Array, "n d"], signs: ValuesByType, ideal: bool
) -> dict[str, Target]:
    volumes = {
        kind: jnp.abs(volume_of(kind, corner_points(points, ids))) for kind, ids in cells.items()
    }
    sums = jnp.zeros((2, len(points)), points.dtype)
    for kind, ids in cells.items():
        sums = sums.at[0, ids].add(volumes[kind][:, None]).at[1, ids].add(1)
    around = sums[0] / jnp.maximum(sums[1], 1)
    return {
        kind: target(
            kind, corner_points(points, ids), ideal, signs[kind], jnp.mean(around[ids], axis=1)
        )
        for kind, ids in cells.items()
    }


def target(kind: str, x: Vector, ideal: bool, sign: Any = None, around: Any = None) -> Target:
    """Makes targets of the corners of undeformed cells.

    With `ideal` the targets are cells of ideal shape with the volume and handedness of the
    undeformed ones. So are the targets of cells with a folded corner, with the volume of the cells
    `around`. An affine image of the ideal cell that is near, such as a parallelogram, is preferred.
    Without a `sign` each cell has its own handedness.
    """
    edges = _stack_frames(kind, x)
    volume, jacobians, noise = sizes_of(kind, x)
    d = DIMENSION[kind]
    sign = jnp.where(volume < 0 if sign is None else sign < 0, -1.0, 1.0).astype(volume.dtype)
    content = sign[None] * jacobians
    folded = jnp.any(content < -noise, axis=0)
    size = jnp.abs(volume)
    if around is not None:
        size = jnp.where(folded, around, size)
    # frames of ideal cells of this size; left-handed ones are their mirror images
    cell = Vector(np.array(IDEAL[kind]).T[:, :, None])
    unit = np.array(measures.frames(kind, cell))  # (edges, axes, samples, 1)
    length = size / np.abs(measures.measure_volume(kind, cell))
    length = jnp.where(length > 0, length, 1) ** (1 / d)
    mirror = jnp.ones((d, len(length)), length.dtype).at[0].set(sign)
    right = (unit * (mirror * length[None])[None, :, None]).astype(edges.dtype)
    if ideal:
        edges = right
    else:
        # frames of the image of the ideal cell by the mean of the corners' affine maps
        frames = unit[..., 0].transpose(2, 0, 1)
        share = np.linalg.inv(frames) / len(frames)
        axes = jnp.einsum("sab,bcsk->ack", share, edges, precision="highest").astype(edges.dtype)
        affine = jnp.einsum("sba,ack->bcsk", frames, axes, precision="highest").astype(edges.dtype)
        nearness = sign[None] * determinant_of(affine) / jnp.abs(determinant_of(right))
        is_near = jnp.min(nearness, axis=0) > NEAR_AFFINE
        edges = jnp.where(folded, jnp.where(is_near, affine, right), edges)
    counts = (content > noise) | folded[None]
    inverse = 1 / jnp.where(counts, determinant_of(edges), 1)
    rows = [[jnp.where(counts, c * inverse, 0) for c in row] for row in cofactors(list(edges))]
    rows = tuple(map(tuple, rows))
    return Target(rows, inverse, counts.astype(inverse.dtype))


def _stack_frames(kind: str, x: Vector) -> Float[Array, "e d s k"]:
    return jnp.stack([jnp.stack(edge) for edge in measures.frames(kind, x)])


def stretch(kind: str, x: Vector, goal: Target) -> list[Vector]:
    """The columns of T = A W^-1 at each sample."""
    edges = measures.frames(kind, x)
    return [
        total(edge * row[b] for edge, row in zip(edges, goal.inverse, strict=True))
        for b in range(len(edges))
    ]


def samples(kind: str, x: Vector, goal: Target) -> tuple[AtSamples, AtSamples]:
    """|T|^2 / d and det T at each sample."""
    columns = stretch(kind, x, goal)
    squared: Any = sum(dot(column, column) for column in columns)
    return squared / len(columns), determinant_of(measures.frames(kind, x)) * goal.determinant


def energy(squared: Some, tau: Some, softness: Any, size: float, dimension: int) -> Some:
    """(1 - size) |T|^2 / (d chi^(2/d)) + size (1 + det T^2) / (2 chi) - 1, with the regularised
    determinant chi(det T) > 0: 0 for the target cell, large where det T is not positive.
    """
    chi = positive_part(tau, softness)
    shape = squared / (chi if dimension == 2 else jnp.cbrt(chi) ** 2)
    return (1 - size) * shape + size * (1 + tau**2) / (2 * chi) - 1


class Bounds(NamedTuple):
    stiffness: Any
    least: Any = 0.0


def stiffened(energy: Some, tau: Some, bounds: Bounds) -> Some:
    """energy / ((1 - stiffness energy) (1 - least / tau)): infinite at both bounds. Without `least`
    it is that of Garanzha et al., In the Quest for Scale-optimal Mappings, ACM Trans. Graph. 43,
    2024, but for a constant and a factor. The second bound keeps small cells, whose distortion may
    be below that of cells that have lost their shape.
    """
    first = 1 - bounds.stiffness * energy
    is_large = (bounds.least <= 0) | (tau > bounds.least)
    second = jnp.where(
        bounds.least > 0, 1 - bounds.least / jnp.where(is_large & (tau != 0), tau, 1), 1
    )
    room = first * second
    has_room = is_large & (first > 0) & (second > 0)
    return jnp.where(has_room, energy / jnp.where(has_room, room, 1), jnp.inf)


def energy_of_cells(
    kind: str, x: Vector, goal: Target, softness: Any, size: float, bounds: Bounds | None = None
) -> DistortionOfCells:
    squared, tau = samples(kind, x, goal)
    values = energy(squared, tau, softness, size, len(goal.inverse))
    if bounds is None:
        return jnp.mean(goal.counts * values, axis=0)
    return jnp.mean(jnp.where(goal.counts > 0, stiffened(values, tau, bounds), 0), axis=0)


def node_scales(kinds: dict[str, Any], targets: dict[str, Target], n: int) -> Float[Array, " n"]:
    """Lengths by which nodes move to change the energy by one, by the Hessian's diagonal."""
    stiffness = jnp.zeros(n)
    for kind, ids in kinds.items():
        goal = targets[kind]
        frames = np.array(FRAMES[kind])
        rows = [
            Vector(c[: len(frames)] for c in row) for row in goal.inverse
        ]  # without the centre of a hexahedron
        whole = total(rows)
        for end, row in enumerate([whole, *rows]):
            stiffness = stiffness.at[ids[:, frames[:, end]].T].add(dot(row, row) / len(frames))
    return jnp.where(stiffness > 0, jnp.where(stiffness > 0, stiffness, 1) ** -0.5, 0)


def signs_of_pieces(mesh: Mesh) -> dict[str, Any]:
    dtype = jax.dtypes.canonicalize_dtype(mesh.points.dtype)
    with jax.ensure_compile_time_eval():
        signs = jnp.concatenate([standard.sign for standard in standards_of(mesh, dtype).values()])
    return {kind: signs[cell] for kind, cell in owners(mesh.cells).items()}


@checked
def distortion(
    mesh: Mesh,
    points: PointsLike | None = None,
    *,
    ideal: bool = False,
    size_weight: float = 0.5,
    softness: float = 1e-3,
) -> DistortionOfCells:
    """Measures the distortion of each cell that fills the space, the term of `improve`'s sum.

    It is 0 for a cell like its target, and finite on inverted cells. Traced in `points`. The target
    of a cell that is folded on the undeformed mesh is the nearest parallelogram or parallelepiped,
    else the equilateral cell of the size around. A curved cell has the mean of its linear pieces.

    **Arguments:**

    - `mesh`: the mesh; `mesh.points` is undeformed.
    - `points`: where the nodes are (n, d). Default: `mesh.points`.
    - `ideal`: False (default) compares with the undeformed cell, True with the equilateral cell.
    - `size_weight`: the weight of size against shape, 0 to 1, default 0.5.
    - `softness`: width of the regularisation of det T, without unit, default 1e-3.

    **Returns:** an array (k,), the cells in the order of `mesh.cells`. **Raises:** `ValueError` for
    a mesh without cells of its own dimension, and another shape of `points`.
    """
    check_solid(mesh, "distortion is not defined for others")
    cells = solid(mesh.cells, mesh.points.shape[1])
    if is_known(size_weight):
        between("size_weight", size_weight, 0, 1, "[]")
    if is_known(softness):
        between("softness", softness, 0)
    current = places(mesh, points)
    linear = linear_cells(cells, jnp.concatenate)
    with jax.ensure_compile_time_eval():  # not folded into a caller's program
        goals = target_cells(
            linear, jnp.asarray(mesh.points, current.dtype), signs_of_pieces(mesh), ideal
        )
    parts = [
        energy_of_cells(kind, corner_points(current, ids), goals[kind], softness, size_weight)
        for kind, ids in linear.items()
    ]
    if not mesh.is_curved:
        return jnp.concatenate(parts)
    owner = np.concatenate(list(owners(cells).values()))
    count = np.bincount(owner)
    return jax.ops.segment_sum(jnp.concatenate(parts), owner, len(count)) / count
