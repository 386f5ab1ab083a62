"""Quality of the cells of a mesh, relative to the undeformed one."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Real

from .._host.adjacency import handedness, neighbours
from .._host.topology import DIMENSION
from .._kernels.values import is_known
from .._mesh.mesh import Mesh
from . import measures
from .blocks import in_blocks
from .non_orthogonality import non_orthogonality
from .report import QualityReport
from .vector import Vector, corners, mean


def quality(mesh: Mesh, points: Real[ArrayLike, "n d"] | Sequence[Any] | None = None) -> QualityReport:
    """Measures every cell of a mesh at `points`, judged relative to the undeformed mesh, `mesh.points`.

    Traced: `jit`, `grad` and `vmap` work over `points`, and over a mesh given as an argument. Derivatives are finite on
    degenerate cells too.

    With `points`, a cell is inverted where its volume, or the Jacobian at one of its corners, has lost the sign it had
    on the undeformed mesh. Cells of mixed handedness are fine. So are corners that had no sign (within the round-off of
    the coordinates), or the wrong one (a quad not convex from the start).

    Without `points`, the mesh is judged by itself. Cells numbered the other way round than their neighbours (a matter
    of ids, not of coordinates) are turned. A cell is then inverted where its volume or a corner's Jacobian has another
    sign than the volume that the connected part of the mesh encloses. For cells that are themselves traced (a mesh
    given to `jit` as an argument) numbering is taken as it is.

    Neighbours are found on the host from the ids, under `jit` when it traces: 0.2 s for 350,000 tetrahedra. With traced
    cells the device finds them, which takes ten times longer on a CPU: close over the mesh instead.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`. Default: none, the mesh is judged by
      itself.

    **Returns:** a `QualityReport` of arrays, one entry for each cell, in the dtype of `points`.

    **Raises:** `ValueError` for a mesh without cells, and when the shape of `points` differs from that of
    `mesh.points`.
    """
    current = places(mesh, points)
    kinds, cells, reference = tuple(mesh.cells), tuple(mesh.cells.values()), mesh.points
    # what is known when a caller traces is computed there and then, not folded into the caller's program
    with jax.ensure_compile_time_eval():
        links = link(mesh.cells, signs=points is None)
        standard = None if points is None else standards_of(kinds, cells, jnp.asarray(reference, dtype=current.dtype))
    return _measure(kinds, cells, links, current, standard)


def places(mesh: Mesh, points: Real[ArrayLike, "n d"] | Sequence[Any] | None) -> Float[Array, "n d"]:
    """Returns the points at which cells are judged: `points`, or where the mesh has them."""
    if not isinstance(mesh, Mesh):
        raise ValueError(f"the first argument must be a Mesh: quality(mesh, points), not {type(mesh).__name__}.")
    if not sum(len(corners) for corners in mesh.cells.values()):
        raise ValueError("the mesh has no cells; its quality is not defined.")
    current = jnp.asarray(mesh.points if points is None else points)
    if current.shape != tuple(mesh.points.shape):
        raise ValueError(f"`points` has shape {current.shape}; this mesh has {tuple(mesh.points.shape)}.")
    return current if jnp.issubdtype(current.dtype, jnp.floating) else current.astype(float)


class Links(NamedTuple):
    """Holds ids: the cell behind each face, and how the cells are numbered."""

    neighbour: Any
    sign: Any
    part: Any


def link(cells: dict[str, Any], signs: bool) -> Links:
    if not is_known(*cells.values()):
        return Links(neighbours(cells, jnp)[0], None, None)
    cells = {kind: np.asarray(corners) for kind, corners in cells.items()}
    neighbour, flipped = neighbours(cells)
    return Links(neighbour, *(handedness(cells, neighbour, flipped) if signs else (None, None)))


class Standard(NamedTuple):
    """Holds the state of the cells of one type on the undeformed mesh, by which they are judged."""

    sign: Int[Array, " k"]
    volume: Float[Array, " k"]
    is_flat: Bool[Array, " k"]
    jacobian: Float[Array, " k"]
    is_judged: Bool[Array, "s k"]
    is_degenerate: Bool[Array, " k"]


@functools.partial(jax.jit, static_argnums=0)
def standards_of(kinds: tuple[str, ...], cells: tuple[Array, ...], points: Float[Array, "n d"]) -> list[Standard]:
    return [
        in_blocks(functools.partial(_standard, kind, points), ids.T) for kind, ids in zip(kinds, cells, strict=True)
    ]


def _standard(kind: str, points: Float[Array, "n d"], ids: Int[Array, "c k"]) -> Standard:
    volume, jacobians, noise = _sizes(kind, corners(points, ids.T))
    sign = jnp.where(volume < 0, -1, 1)
    judged = sign[None] * jacobians > noise
    none = ~jnp.any(judged, axis=0)
    least = _least(jacobians, sign, judged)
    flat = math.factorial(DIMENSION[kind]) * jnp.abs(volume) <= jnp.max(noise, axis=0)
    return Standard(sign, jnp.where(flat, 1, volume), flat, jnp.where(none, 1, least), judged, none)


def _least(jacobians: Float[Array, "s k"], sign: Array, judged: Bool[Array, "s k"]) -> Float[Array, " k"]:
    """Computes the smallest Jacobian, in the cell's own handedness, among the corners that are judged."""
    return jnp.min(jnp.where(judged, sign[None] * jacobians, jnp.inf), axis=0)


@functools.partial(jax.jit, static_argnums=0)
def _measure(
    kinds: tuple[str, ...],
    cells: tuple[Array, ...],
    links: Links,
    points: Float[Array, "n d"],
    standards: list[Standard] | None,
) -> QualityReport:
    rows = {kind: ids.T for kind, ids in zip(kinds, cells, strict=True)}
    if standards is None:
        volumes = {kind: in_blocks(functools.partial(_volume, kind, points), ids) for kind, ids in rows.items()}
        by_kind: dict[str, Any] = _enclosed_signs(volumes, links)
        signs = by_kind
    else:
        by_kind = dict(zip(kinds, standards, strict=True))
        signs = {kind: standard.sign for kind, standard in by_kind.items()}
    columns = [in_blocks(functools.partial(_judged, kind, points), ids, by_kind[kind]) for kind, ids in rows.items()]
    joined = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=-1), *columns)
    joined["centroid"] = joined["centroid"].T
    angles = non_orthogonality(points, rows, signs, links.neighbour)
    types = tuple((kind, len(ids)) for kind, ids in zip(kinds, cells, strict=True))
    return QualityReport(**joined, non_orthogonality=angles, types=types, relative=standards is not None)


def _volume(kind: str, points: Float[Array, "n d"], ids: Int[Array, "c k"]) -> Float[Array, " k"]:
    return _sizes(kind, corners(points, ids.T))[0]


def _judged(
    kind: str, points: Float[Array, "n d"], ids: Int[Array, "c k"], standard: "Standard | Array"
) -> dict[str, Array]:
    """Measures cells by a standard, or by the sign that each cell should have."""
    x = corners(points, ids.T)
    sizes = _sizes(kind, x)
    judged = _judge(*sizes[:2], standard) if isinstance(standard, Standard) else _judge_alone(*sizes, standard)
    return judged | _shape(kind, x)


def _sizes(kind: str, x: list[Vector]) -> tuple[Array, Array, Array]:
    """Computes the volume (k,), the Jacobians (s, k), and the round-off error of each Jacobian."""
    rounding = 8 * float(jnp.finfo(x[0][0].dtype).eps) * measures.reach(x)
    relative, _ = measures.relative_corners(x)
    jacobians, spread = measures.jacobians(kind, relative)
    return measures.volume(kind, relative), jacobians, rounding[None] * jax.lax.stop_gradient(spread)


def _shape(kind: str, x: list[Vector]) -> dict[str, Array]:
    """Computes the measures without a unit, and the place."""
    relative, size = measures.relative_corners(x)
    shape = measures.scaled(relative, size)
    return {
        "skewness": measures.skewness(kind, shape),
        "aspect_ratio": measures.aspect_ratio(kind, shape),
        "centroid": jnp.stack(mean(x).components),
    }


def _enclosed_signs(volumes: dict[str, Array], links: Links) -> dict[str, Array]:
    """Takes the sign of each cell from the volume that its part of the mesh encloses, which no inner node can change."""
    volume = jnp.concatenate(list(volumes.values()))
    if links.sign is None:
        signs = jnp.where(jnp.sum(volume) < 0, -1, 1) * jnp.ones(len(volume), dtype=int)
    else:
        enclosed = jax.ops.segment_sum(links.sign * volume, links.part, num_segments=len(volume))
        signs = links.sign * jnp.where(enclosed < 0, -1, 1)[links.part]
    ends = np.cumsum([len(part) for part in volumes.values()])[:-1]
    return dict(zip(volumes, jnp.split(signs, ends), strict=True))


def _judge(volume: Array, jacobians: Array, standard: Standard) -> dict[str, Array]:
    """Judges cells relative to the undeformed mesh, by the corners that had the sign of their cell there."""
    volume_ratio = jnp.where(standard.is_flat, 1, volume) / standard.volume
    least = _least(jacobians, standard.sign, standard.is_judged)
    jacobian_ratio = jnp.where(standard.is_degenerate, 1, least) / standard.jacobian
    return {
        "volume": volume,
        "jacobian": jnp.min(standard.sign[None] * jacobians, axis=0),
        "volume_ratio": volume_ratio,
        "jacobian_ratio": jacobian_ratio,
        "is_inverted": ~((volume_ratio > 0) & (jacobian_ratio > 0)),
        "is_degenerate": standard.is_degenerate,
    }


def _judge_alone(volume: Array, jacobians: Array, noise: Array, sign: Array) -> dict[str, Array]:
    """Judges cells without an undeformed mesh, by the sign that they should have."""
    turned = sign[None] * jacobians
    return {
        "volume": volume,
        "jacobian": jnp.min(turned, axis=0),
        "volume_ratio": jnp.ones_like(volume),
        "jacobian_ratio": jnp.ones_like(volume),
        "is_inverted": ~jnp.all(turned >= -noise, axis=0),
        "is_degenerate": jnp.all(jnp.abs(turned) <= noise, axis=0),
    }
