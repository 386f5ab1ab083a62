"""Quality of the cells of a mesh, relative to the undeformed one."""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from . import _cells
from ._centres import centre_of_mass
from ._host.adjacency import handedness, neighbours
from ._host.topology import DIMENSION, FACES
from ._mesh import Mesh
from ._report import QualityReport
from ._vector import Vector, corners, mean


def quality(mesh: Mesh, points: Float[Any, "n d"] | None = None) -> QualityReport:
    """Measures of every cell of `mesh` at `points`, judged relative to the undeformed mesh, `mesh.points`.

    Traced: `jit`, `grad` and `vmap` work over `points`, with finite derivatives on degenerate cells too, and over a mesh
    given as an argument. Shapes, units and definitions are in `QualityReport`. The dtype is that of `points`.

    With `points`, a cell is inverted where its volume, or the Jacobian at one of its corners, has lost the sign it had
    on the undeformed mesh: cells of mixed handedness are fine, and so are corners that had no sign (within the round-off of the
    coordinates) or the wrong one (a quad not convex from the start).

    Without `points`, the mesh is judged by itself: a cell is inverted where its volume or a corner's Jacobian has another
    sign than the volume that the connected part of the mesh encloses, after cells numbered the other way round than
    their neighbours (a matter of ids, not of coordinates) are turned. For cells that are themselves traced (a mesh
    given to `jit` as an argument) numbering is taken as it is.

    Which cells are neighbours is found on the host from the ids, 0.2 s for 350,000 tetrahedra; under `jit` when it
    traces. With traced cells the device finds it, which takes ten times longer on a CPU: close over the mesh instead.

    Raises `ValueError` for a mesh without cells and when the shape of `points` differs from that of `mesh.points`.
    """
    if not sum(len(corners) for corners in mesh.cells.values()):
        raise ValueError("the mesh has no cells; its quality is not defined.")
    kinds, cells, reference = tuple(mesh.cells), tuple(mesh.cells.values()), mesh.points
    current = jnp.asarray(reference if points is None else points)
    if current.shape != tuple(reference.shape):
        raise ValueError(f"`points` has shape {current.shape}; this mesh has {tuple(reference.shape)}.")
    if not jnp.issubdtype(current.dtype, jnp.floating):
        current = current.astype(float)
    # what is known when a caller traces is computed there and then, not folded into the caller's program
    with jax.ensure_compile_time_eval():
        links = connect(mesh.cells, signs=points is None)
        standard = None if points is None else standards_of(kinds, cells, jnp.asarray(reference, dtype=current.dtype))
    return _measure(kinds, cells, links, current, standard)


class Links(NamedTuple):
    """Ids: the cell behind each face, and how the cells are numbered."""

    neighbour: Any
    sign: Any
    part: Any


def connect(cells: dict[str, Any], signs: bool) -> Links:
    if any(isinstance(corners, Tracer) for corners in cells.values()):
        return Links(neighbours(cells, jnp)[0], None, None)
    cells = {kind: np.asarray(corners) for kind, corners in cells.items()}
    neighbour, flipped = neighbours(cells)
    return Links(neighbour, *(handedness(cells, neighbour, flipped) if signs else (None, None)))


class Standard(NamedTuple):
    """What the cells of one type are judged by: their state on the undeformed mesh."""

    sign: Int[Array, " k"]
    volume: Float[Array, " k"]
    is_flat: Bool[Array, " k"]
    jacobian: Float[Array, " k"]
    is_judged: Bool[Array, "s k"]
    is_degenerate: Bool[Array, " k"]


@functools.partial(jax.jit, static_argnums=0)
def standards_of(kinds: tuple[str, ...], cells: tuple[Array, ...], points: Float[Array, "n d"]) -> list[Standard]:
    standards = []
    for kind, ids in zip(kinds, cells, strict=True):
        x = corners(points, ids)
        volume, jacobians, noise = _sizes(kind, x)
        sign = jnp.where(volume < 0, -1, 1)
        judged = sign * jacobians > noise
        none = ~jnp.any(judged, axis=0)
        least = _least(jacobians, sign, judged)
        flat = math.factorial(DIMENSION[kind]) * jnp.abs(volume) <= jnp.max(noise, axis=0)
        standards.append(Standard(sign, jnp.where(flat, 1, volume), flat, jnp.where(none, 1, least), judged, none))
    return standards


def _least(jacobians: Float[Array, "s k"], sign: Array, judged: Bool[Array, "s k"]) -> Float[Array, " k"]:
    """Smallest Jacobian, in the cell's own handedness, among the corners that are judged."""
    return jnp.min(jnp.where(judged, sign * jacobians, jnp.inf), axis=0)


@functools.partial(jax.jit, static_argnums=0)
def _measure(
    kinds: tuple[str, ...],
    cells: tuple[Array, ...],
    links: Links,
    points: Float[Array, "n d"],
    standards: list[Standard] | None,
) -> QualityReport:
    placed = {kind: corners(points, ids) for kind, ids in zip(kinds, cells, strict=True)}
    sizes = {kind: _sizes(kind, x) for kind, x in placed.items()}
    if standards is None:
        signs = _enclosed_signs({kind: volume for kind, (volume, _, _) in sizes.items()}, links)
        judged = {kind: _judge_alone(*sizes[kind], signs[kind]) for kind in kinds}
    else:
        of = dict(zip(kinds, standards, strict=True))
        signs = {kind: standard.sign for kind, standard in of.items()}
        judged = {kind: _judge(*sizes[kind][:2], of[kind]) for kind in kinds}
    columns = [judged[kind] | _shape(kind, placed[kind]) for kind in kinds]
    joined = jax.tree.map(lambda *parts: jnp.concatenate(parts), *columns)
    angles = non_orthogonality(placed, signs, links.neighbour)
    types = tuple((kind, len(ids)) for kind, ids in zip(kinds, cells, strict=True))
    return QualityReport(**joined, non_orthogonality=angles, types=types, relative=standards is not None)


def relative_corners(x: list[Vector]) -> tuple[list[Vector], Float[Array, " k"]]:
    """Corners relative to the first, and the cell's size, which is not differentiated."""
    relative = [corner - x[0] for corner in x]
    size = _reach(relative)
    return relative, jnp.where(size > 0, size, 1)


def scaled(x: list[Vector], size: Float[Array, " k"]) -> list[Vector]:
    return [corner * (1 / size) for corner in x]


def _reach(x: list[Vector]) -> Float[Array, " k"]:
    components = [jnp.abs(component) for corner in x for component in corner.components]
    return jax.lax.stop_gradient(functools.reduce(jnp.maximum, components))


def _sizes(kind: str, x: list[Vector]) -> tuple[Array, Array, Array]:
    """Volume (k,), Jacobians (s, k), and what of each Jacobian is round-off of the coordinates."""
    rounding = 8 * float(jnp.finfo(x[0][0].dtype).eps) * _reach(x)
    relative, _ = relative_corners(x)
    jacobians, spread = _cells.jacobians(kind, relative)
    return _cells.volume(kind, relative), jacobians, rounding * jax.lax.stop_gradient(spread)


def _shape(kind: str, x: list[Vector]) -> dict[str, Array]:
    """The measures without a unit, and the place."""
    relative, size = relative_corners(x)
    shape = scaled(relative, size)
    return {
        "skewness": _cells.skewness(kind, shape),
        "aspect_ratio": _cells.aspect_ratio(kind, shape),
        "centroid": jnp.stack(mean(x).components, axis=1),
    }


def _enclosed_signs(volumes: dict[str, Array], links: Links) -> dict[str, Array]:
    """Sign of each cell from the volume its part of the mesh encloses, which no inner node can change."""
    volume = jnp.concatenate(list(volumes.values()))
    if links.sign is None:
        signs = jnp.where(jnp.sum(volume) < 0, -1, 1) * jnp.ones(len(volume), dtype=int)
    else:
        enclosed = jax.ops.segment_sum(links.sign * volume, links.part, num_segments=len(volume))
        signs = links.sign * jnp.where(enclosed < 0, -1, 1)[links.part]
    ends = np.cumsum([len(part) for part in volumes.values()])[:-1]
    return dict(zip(volumes, jnp.split(signs, ends), strict=True))


def _judge(volume: Array, jacobians: Array, standard: Standard) -> dict[str, Array]:
    """Relative to the undeformed mesh, by the corners that had the sign of their cell there."""
    volume_ratio = jnp.where(standard.is_flat, 1, volume) / standard.volume
    least = _least(jacobians, standard.sign, standard.is_judged)
    jacobian_ratio = jnp.where(standard.is_degenerate, 1, least) / standard.jacobian
    return {
        "volume": volume,
        "jacobian": jnp.min(standard.sign * jacobians, axis=0),
        "volume_ratio": volume_ratio,
        "jacobian_ratio": jacobian_ratio,
        "is_inverted": ~((volume_ratio > 0) & (jacobian_ratio > 0)),
        "is_degenerate": standard.is_degenerate,
    }


def _judge_alone(volume: Array, jacobians: Array, noise: Array, sign: Array) -> dict[str, Array]:
    """Without an undeformed mesh: by the sign that the cell should have."""
    turned = sign * jacobians
    return {
        "volume": volume,
        "jacobian": jnp.min(turned, axis=0),
        "volume_ratio": jnp.ones_like(volume),
        "jacobian_ratio": jnp.ones_like(volume),
        "is_inverted": ~jnp.all(turned >= -noise, axis=0),
        "is_degenerate": jnp.all(jnp.abs(turned) <= noise, axis=0),
    }


def largest_inner(degrees: Float[Array, "f k"], is_inner: Bool[Array, "f k"]) -> Float[Array, " k"]:
    return jnp.max(jnp.where(is_inner, degrees, 0), axis=0)


def non_orthogonality(
    corners: dict[str, list[Vector]], signs: dict[str, Array], neighbour: Array, largest: Callable = largest_inner
) -> Array:
    """Largest angle over the inner faces of each cell, 0 for a cell without any; `largest` may be a smooth stand-in.

    Centres are kept relative to the first corner of their cell, so that their differences do not lose digits.
    """
    shapes = {kind: relative_corners(x) for kind, x in corners.items()}
    own = [centre_of_mass(kind, relative) for kind, (relative, _) in shapes.items()]
    origins, centres = _joined([x[0] for x in corners.values()]), _joined(own)
    angles, first, used = [], 0, 0
    for kind, (relative, size) in shapes.items():
        k, f = len(size), len(FACES[kind])
        if f:
            behind = neighbour[used : used + f * k].reshape(k, f).T
            here = jnp.arange(first, first + k)
            ids = jnp.where(behind < 0, here, behind)
            between = (_at(origins, ids) - _at(origins, here)) + (_at(centres, ids) - _at(centres, here))
            areas = _cells.face_areas(kind, scaled(relative, size)) * signs[kind]
            degrees = _cells.non_orthogonality(areas, between * (1 / size), DIMENSION[kind] < len(areas))
            angles.append(largest(degrees, behind >= 0))
        else:
            angles.append(jnp.zeros_like(size))
        first, used = first + k, used + f * k
    return jnp.concatenate(angles)


def _joined(parts: list[Vector]) -> Vector:
    return Vector([jnp.concatenate(components) for components in zip(*(p.components for p in parts), strict=True)])


def _at(a: Vector, ids: Array) -> Vector:
    return Vector([component[ids] for component in a.components])
