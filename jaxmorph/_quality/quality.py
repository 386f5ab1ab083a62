"""Quality of the cells of a mesh, relative to the undeformed one."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Real, Shaped

from .._host.cells.adjacency import handedness, neighbours
from .._host.cells.topology import DIMENSION, FACES
from .._host.package.arguments import checked
from .._kernels.callback import host_call
from .._kernels.compile import compiled
from .._kernels.values import Either, array, as_jax, constant, is_known, namespace, on_host, smallest
from .._mesh.mesh import Mesh
from . import measures
from .batches import in_blocks
from .non_orthogonality import non_orthogonality
from .proof.least import has_least, least_jacobian
from .report import QualityReport
from .vector import Vector, corners, mean, stack

FLAT = 1e-4
"""Sine of a corner's angle up to which it is flat; 3-D: Jacobian over its edges' product."""


@checked
def quality(mesh: Mesh, points: Real[ArrayLike, "n d"] | Sequence[Any] | None = None) -> QualityReport:
    """Measures a mesh's cells at `points`, judged relative to the undeformed `mesh.points`.

    Traced: `jit`, `grad` and `vmap` work over `points`, and over a mesh given as an argument.
    Derivatives are finite on degenerate cells too.

    With `points`, a cell is inverted where its volume, or the Jacobian at one of its corners, has
    lost the sign it had on the undeformed mesh. Curved cells have a lattice of places, and the
    place where bounds on their Jacobian find it least, instead of corners. So a curved cell that
    folds anywhere is found. A linear hexahedron that folds between its corners is not: `proof`
    finds it. Cells of mixed handedness are fine. So are corners
    that had no sign, or the wrong one (a quad not convex from the start). A corner has no sign
    within the round-off of the coordinates. One of a cell that is no simplex has none either where
    it is flat or collapsed: its Jacobian is 1e-4 of the product of its edges or less.

    Without `points`, the mesh is judged by itself. Cells numbered the other way round than their
    neighbours (a matter of ids, not of coordinates) are turned. A cell is then inverted where its
    volume or a corner's Jacobian has another sign than the volume that the connected part of the
    mesh encloses. For cells that are themselves traced (a mesh given to `jit` as an argument)
    numbering is taken as it is.

    Neighbours are found on the host from the ids, under `jit` when it traces: 0.2 s for 350,000
    tetrahedra. With traced cells the device finds them, which takes ten times longer on a CPU:
    close over the mesh instead.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`. Default: none, the
      mesh is judged by itself.

    **Returns:** a `QualityReport` of arrays, one entry for each cell, in the dtype of `points`.

    **Raises:** `ValueError` for a mesh without cells, and when the shape of `points` differs from
    that of `mesh.points`.
    """
    current = places(mesh, points)
    kinds, cells = tuple(mesh.cells), tuple(mesh.cells.values())
    # what is known when a caller traces is computed there and then, not folded into the caller's
    # program
    with jax.ensure_compile_time_eval():
        links = link(mesh.cells, signs=points is None)
        standards = None if points is None else standards_of(mesh, current.dtype)
    if on_host(cells, links, current, standards):
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():  # cells may have no size
            columns = _columns(kinds, *jax.tree.map(np.asarray, (cells, links, current, standards)))
            columns = as_jax(columns)
    else:
        columns = _measured(kinds, cells, links, current, jax.tree.map(jnp.asarray, standards))
    types = tuple((kind, len(ids)) for kind, ids in zip(kinds, cells, strict=True))
    return QualityReport(**columns, types=types, relative=standards is not None)


@checked
def inverted(mesh: Mesh, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> Bool[Array, " k"]:
    """Marks the inverted cells at `points`: a cheaper `quality(mesh, points).is_inverted`.

    Traced, and cheapest in a `jit` that closes over the mesh: the undeformed mesh is then measured
    once.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`.

    **Returns:** one flag for each cell (k,), one type of cells after another, as in `mesh.cells`.

    **Raises:** `ValueError` as `quality` does.
    """
    current, kinds, cells = places(mesh, points), tuple(mesh.cells), tuple(mesh.cells.values())
    with jax.ensure_compile_time_eval():
        standards = standards_of(mesh, current.dtype)
    if on_host(cells, current, standards):
        with np.errstate(all="ignore"), jax.ensure_compile_time_eval():
            return jnp.asarray(_flags(kinds, *jax.tree.map(np.asarray, (cells, current, standards))))
    return _flagged(kinds, cells, current, jax.tree.map(jnp.asarray, standards))


def places(
    mesh: Mesh, points: Real[ArrayLike, "n d"] | Sequence[Any] | None, name: str = "points"
) -> Float[Array, "n d"]:
    """Returns the points to judge: `points`, or the mesh's; `name` is the argument's."""
    if not isinstance(mesh, Mesh):
        raise ValueError(f"the first argument must be a Mesh: quality(mesh, points), not {type(mesh).__name__}.")
    if not sum(len(corners) for corners in mesh.cells.values()):
        raise ValueError("the mesh has no cells; its quality is not defined.")
    current = array(mesh.points if points is None else points)
    if current.shape != tuple(mesh.points.shape):
        raise ValueError(f"`{name}` has shape {current.shape}; this mesh has {tuple(mesh.points.shape)}.")
    return current if jnp.issubdtype(current.dtype, jnp.floating) else current.astype(float)


class Links(NamedTuple):
    """Holds ids: the cell behind each face, and how the cells are numbered."""

    neighbour: Any
    sign: Any
    part: Any


def link(cells: dict[str, Any], signs: bool) -> Links:
    if not is_known(*cells.values()):

        def behind(*corners):
            return neighbours(dict(zip(cells, corners, strict=True)))[0]

        faces = sum(len(FACES[kind]) * len(corners) for kind, corners in cells.items())
        found = host_call(behind, jax.ShapeDtypeStruct((faces,), np.int32), *cells.values())
        return Links(found, None, None)
    cells = {kind: np.asarray(corners) for kind, corners in cells.items()}
    neighbour, flipped = neighbours(cells)
    return Links(neighbour, *(handedness(cells, neighbour, flipped) if signs else (None, None)))


def own_signs(mesh: Mesh) -> dict[str, np.ndarray]:
    """Finds on the host the sign that each cell's volume should have, by numbering alone."""
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    points = np.asarray(mesh.points, dtype=float)
    volumes = {kind: in_blocks(np, functools.partial(_volume, kind, points), ids.T) for kind, ids in cells.items()}
    return _enclosed_signs(volumes, link(cells, signs=True), points.shape[1])


class Standard(NamedTuple):
    """Holds the state of the cells of one type on the undeformed mesh, by which they are judged."""

    sign: Int[Either, " k"]
    volume: Float[Either, " k"]
    is_flat: Bool[Either, " k"]
    jacobian: Float[Either, " k"]
    is_judged: Bool[Either, "s k"]
    is_degenerate: Bool[Either, " k"]


def standards_of(mesh: Mesh, dtype: Any) -> tuple[Standard, ...]:
    """Computes the undeformed state, one `Standard` a type of cells, in precision `dtype`."""
    kinds, cells, points = tuple(mesh.cells), tuple(mesh.cells.values()), jnp.asarray(mesh.points, dtype)
    if not on_host(cells, points):
        return _standards(kinds, cells, points)
    with np.errstate(all="ignore"):
        return _standards_by(np, kinds, *jax.tree.map(np.asarray, (cells, points)))


@compiled
def _standards(kinds: tuple[str, ...], cells: tuple[Any, ...], points: Float[Either, "n d"]) -> tuple[Standard, ...]:
    return _standards_by(jnp, kinds, cells, points)


def _standards_by(xp: Any, kinds, cells, points) -> tuple[Standard, ...]:
    pairs = zip(kinds, cells, strict=True)
    return tuple(in_blocks(xp, functools.partial(_standard, kind, points), ids.T) for kind, ids in pairs)


def _standard(kind: str, points: Float[Either, "n d"], ids: Shaped[Either, "c k"]) -> Standard:
    xp, (volume, jacobians, noise) = namespace(points), _sizes(kind, corners(points, ids.T))
    sign = xp.where(volume < 0, -1, 1).astype(np.int8)  # a factor that keeps float32
    openings = _with_largest(measures.openings(kind, corners(points, ids.T)), len(jacobians))
    judged = sign[None] * jacobians > xp.maximum(noise, FLAT * openings)
    none = ~xp.any(judged, axis=0)
    least = _least(jacobians, sign, judged)
    flat = math.factorial(DIMENSION[kind]) * xp.abs(volume) <= xp.max(noise, axis=0)
    return Standard(sign, xp.where(flat, 1, volume), flat, xp.where(none, 1, least), judged, none)


def _least(jacobians: Float[Either, "s k"], sign: Either, judged: Bool[Either, "s k"]) -> Float[Either, " k"]:
    """Computes the least Jacobian, in the cell's handedness, of the corners judged."""
    xp = namespace(jacobians)
    return smallest(xp.where(judged, sign[None] * jacobians, xp.inf))


def _columns(
    kinds: tuple[str, ...],
    cells: tuple[Any, ...],
    links: Links,
    points: Float[Either, "n d"],
    standards: tuple[Standard, ...] | None,
) -> dict[str, Either]:
    xp = namespace(points)
    rows = {kind: ids.T for kind, ids in zip(kinds, cells, strict=True)}
    if standards is None:
        volumes = {kind: in_blocks(xp, functools.partial(_volume, kind, points), ids) for kind, ids in rows.items()}
        by_kind: dict[str, Any] = _enclosed_signs(volumes, links, points.shape[1])
        signs = by_kind
    else:
        by_kind = dict(zip(kinds, standards, strict=True))
        signs = {kind: standard.sign for kind, standard in by_kind.items()}
    columns = [
        in_blocks(xp, functools.partial(_judged, kind, points), ids, by_kind[kind]) for kind, ids in rows.items()
    ]
    joined = jax.tree.map(lambda *parts: xp.concatenate(parts, axis=-1), *columns)
    joined["centroid"] = joined["centroid"].T
    return joined | {"non_orthogonality": non_orthogonality(points, rows, signs, links.neighbour)}


_measured = compiled(_columns)


def _flags(
    kinds: tuple[str, ...], cells: tuple[Any, ...], points: Float[Either, "n d"], standards: tuple[Standard, ...]
) -> Bool[Either, " k"]:
    xp = namespace(points)

    def judged(kind, ids, standard):
        return _judge(*_sizes(kind, corners(points, ids.T))[:2], standard)["is_inverted"]

    triples = zip(kinds, cells, standards, strict=True)
    return xp.concatenate(
        [in_blocks(xp, functools.partial(judged, kind), ids.T, standard) for kind, ids, standard in triples]
    )


_flagged = compiled(_flags)


def _volume(kind: str, points: Float[Either, "n d"], ids: Shaped[Either, "c k"]) -> Float[Either, " k"]:
    return measures.volume(kind, measures.relative_corners(corners(points, ids.T))[0])


def _judged(
    kind: str, points: Float[Either, "n d"], ids: Shaped[Either, "c k"], standard: "Standard | Either"
) -> dict[str, Either]:
    """Measures cells by a standard, or by the sign that each cell should have."""
    x = corners(points, ids.T)
    sizes = _sizes(kind, x)
    judged = _judge(*sizes[:2], standard) if isinstance(standard, Standard) else _judge_alone(*sizes, standard)
    return judged | _shape(kind, x)


def _sizes(kind: str, x: list[Vector]) -> tuple[Either, Either, Either]:
    """Computes the volume (k,), the Jacobians (s, k), and the round-off error of each Jacobian.

    The last Jacobian of a curved cell is its least one, wherever it is.
    """
    rounding = 8 * float(jnp.finfo(x[0][0].dtype).eps) * measures.reach(x)
    relative, _ = measures.relative_corners(x)
    jacobians, spread = measures.jacobians(kind, relative)
    if has_least(kind, len(x[0])):
        least = least_jacobian(kind, list(stack(relative).components))
        jacobians = namespace(least).concatenate([jacobians, least[None]])
    noise = rounding[None] * constant(_with_largest(spread, len(jacobians)))
    return measures.volume(kind, relative), jacobians, noise


def _with_largest(values: Float[Either, "s k"], rows: int) -> Float[Either, "rows k"]:
    """Returns values of samples; the least Jacobian, if it has a row, gets the largest."""
    if len(values) == rows:
        return values
    return namespace(values).concatenate([values, values.max(axis=0, keepdims=True)])


def _shape(kind: str, x: list[Vector]) -> dict[str, Either]:
    """Computes the measures without a unit, and the place."""
    relative, size = measures.relative_corners(x)
    shape = measures.scaled(relative, size)
    return {
        "skewness": measures.skewness(kind, shape),
        "aspect_ratio": measures.aspect_ratio(kind, shape),
        "centroid": namespace(size).stack(mean(x).components),
    }


def _enclosed_signs(volumes: dict[str, Either], links: Links, d: int) -> dict[str, Either]:
    """Takes each cell's sign from the volume of its part of the mesh, fixed by the boundary.

    Cells of less than d dimensions are measured without a sign.
    """
    xp = namespace(next(iter(volumes.values())))
    volume = xp.concatenate(list(volumes.values()))
    if links.sign is None:
        signs = xp.where(xp.sum(volume) < 0, -1, 1) * xp.ones(len(volume), dtype=int)
    elif xp is np:
        enclosed = np.bincount(links.part, links.sign * volume, len(volume))
        signs = links.sign * np.where(enclosed < 0, -1, 1)[links.part]
    else:
        enclosed = jax.ops.segment_sum(links.sign * volume, links.part, num_segments=len(volume))
        signs = links.sign * jnp.where(enclosed < 0, -1, 1)[links.part]
    ends = np.cumsum([len(part) for part in volumes.values()])[:-1]
    parts = zip(volumes, xp.split(signs.astype(np.int8), ends), strict=True)
    return {kind: part if DIMENSION[kind] == d else xp.ones_like(part) for kind, part in parts}


def _judge(volume: Either, jacobians: Either, standard: Standard) -> dict[str, Either]:
    """Judges cells relative to the undeformed mesh, by corners with their cell's sign there."""
    xp = namespace(volume)
    volume_ratio = xp.where(standard.is_flat, 1, volume) / standard.volume
    least = _least(jacobians, standard.sign, standard.is_judged)
    jacobian_ratio = xp.where(standard.is_degenerate, 1, least) / standard.jacobian
    return {
        "volume": volume,
        "jacobian": smallest(standard.sign[None] * jacobians),
        "volume_ratio": volume_ratio,
        "jacobian_ratio": jacobian_ratio,
        "is_inverted": ~((volume_ratio > 0) & (jacobian_ratio > 0)),
        "is_degenerate": standard.is_degenerate,
    }


def _judge_alone(volume: Either, jacobians: Either, noise: Either, sign: Either) -> dict[str, Either]:
    """Judges cells without an undeformed mesh, by the sign that they should have."""
    xp, turned = namespace(volume), sign[None] * jacobians
    return {
        "volume": volume,
        "jacobian": smallest(turned),
        "volume_ratio": xp.ones_like(volume),
        "jacobian_ratio": xp.ones_like(volume),
        "is_inverted": ~xp.all(turned >= -noise, axis=0),
        "is_degenerate": xp.all(xp.abs(turned) <= noise, axis=0),
    }
