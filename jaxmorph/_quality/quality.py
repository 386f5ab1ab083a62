"""Quality of the cells of a mesh, relative to the undeformed one."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.cells.topology import CORNERS, DIMENSION, FACES, HIGH_ORDER, SHAPES, solid
from .._host.package.arguments import checked
from .._host.tolerances import FLAT_CORNER
from .._kernels.callback import host_call
from .._kernels.compile import by_place
from .._kernels.values import (
    Either,
    array,
    as_jax,
    constant,
    is_known,
    largest,
    namespace,
    smallest,
)
from .._mesh.mesh import Mesh, PointsLike
from .._mesh.topology import Topology
from . import measures
from .bounds import least_jacobian
from .report import QualityReport
from .vector import (
    Ids,
    Marks,
    PerCell,
    Points,
    Samples,
    ValuesByType,
    Vector,
    by_type,
    join_values,
    middle,
)


@checked
def quality(mesh: Mesh, points: PointsLike | None = None) -> QualityReport:
    """Measures a mesh's cells at `points`, judged relative to the undeformed `mesh.points`.

    Traced: `jit`, `grad` and `vmap` work over `points`, and over a mesh given as an argument.
    Derivatives are finite on degenerate cells too. A volume should have the sign of the mesh,
    whichever way round its cells are numbered. Cells numbered the other way round than their
    neighbours (a matter of ids, not of coordinates) are turned. The sign is then that of the volume
    which the connected part of the mesh encloses. So a cell on the wrong side of a face that it
    shares is folded, and cells of mixed handedness are fine. `inverted`, `smooth_quality`, `proof`,
    `proven_margin`, `distortion`, `improve` and `largest_step` take the same sign. A cell is
    inverted where its volume, or the Jacobian at one of its corners, has not the sign of the
    undeformed mesh. Without `points`, the mesh is judged by itself, by its own sign. Instead of
    corners, curved cells have a lattice of places, and the place where bounds on their Jacobian
    find it least: a fold anywhere is found. A linear hexahedron that folds between its corners is
    not: `proof` finds it. A cell that is folded on the undeformed mesh is inverted until a motion
    unfolds it, and counts in `from_start`. Not judged are corners that had no sign, or the wrong
    one in a cell that was not folded, as in a quad not convex from the start. A corner has no sign
    within the round-off of the coordinates. One of a cell that is no simplex has none either where
    its Jacobian is 1e-4 of the product of its edges or less: flat or collapsed. A folded piece of a
    polyhedron is fine where the polyhedron as a whole is not folded. Neighbours are found on the
    host from the ids, under `jit` when it traces. For traced cells (a mesh given to `jit` as an
    argument) that is in each call: close over the mesh instead.

    **Arguments:**

    - `mesh`: the mesh with its cells; `mesh.points` is undeformed.
    - `points`: where the nodes are now (n, d), in the unit of `mesh.points`. Default: none.

    **Returns:** a `QualityReport` of arrays, one entry for each cell, in the dtype of `points`.
    **Raises:** `ValueError` for a mesh without cells, and another shape of `points`.
    """
    current = places(mesh, points)
    # computed when a caller traces, not folded into the caller's program
    with jax.ensure_compile_time_eval():
        links = link(mesh)
        standards = None if points is None else standards_of(mesh, current.dtype, links)
    types = tuple((kind, len(ids)) for kind, ids in mesh.cells.items())
    columns = as_jax(_judge_all(mesh.cells, links, current, standards))
    return QualityReport(**columns, types=types, relative=standards is not None)


@checked
def inverted(mesh: Mesh, points: PointsLike) -> Bool[Array, " k"]:
    """Marks the inverted cells at `points`: a cheaper `quality(mesh, points).is_inverted`.

    Traced, and cheapest in a `jit` that closes over the mesh: the undeformed mesh is then measured
    once. Arguments and errors as `quality`.

    **Returns:** a mask of the cells (k,), one type after another, as in `mesh.cells`.
    """
    current = places(mesh, points)
    with jax.ensure_compile_time_eval():
        standards = standards_of(mesh, current.dtype)
    return jnp.asarray(_mark_inverted(mesh.cells, current, standards))


def places(mesh: Mesh, points: PointsLike | None, name: str = "points") -> Float[Array, "n d"]:
    if not isinstance(mesh, Mesh):
        raise ValueError(
            f"the first argument must be a Mesh: quality(mesh, points), not {type(mesh).__name__}."
        )
    if not sum(len(corners) for corners in mesh.cells.values()):
        raise ValueError("the mesh has no cells; its quality is not defined.")
    current = array(mesh.points if points is None else points)
    if current.shape != tuple(mesh.points.shape):
        raise ValueError(
            f"`{name}` has shape {current.shape}; this mesh has {tuple(mesh.points.shape)}."
        )
    return current if jnp.issubdtype(current.dtype, jnp.floating) else current.astype(float)


def check_solid(mesh: Mesh, reason: str) -> None:
    d = mesh.points.shape[1]
    if not any(map(len, solid(mesh.cells, d).values())):
        types = ", ".join(mesh.cells) or "none"
        raise ValueError(f"the mesh has no cells that fill {d}-D space (cells: {types}): {reason}.")


class Links(NamedTuple):
    neighbour: Int[Either, " f"]
    sign: Ids
    part: Ids


def link(mesh: Mesh) -> Links:
    def linked(topology: Topology) -> tuple[np.ndarray, ...]:
        return topology.neighbours[0], *topology.handedness

    cells = mesh.cells
    if is_known(*cells.values()):
        return Links(*linked(mesh.topology))
    n, d = mesh.points.shape
    faces = sum(len(FACES[kind]) * len(ids) for kind, ids in cells.items())
    count = sum(map(len, cells.values()))

    def on_host(*corners: np.ndarray) -> np.ndarray:
        return np.concatenate(linked(Topology(dict(zip(cells, corners, strict=True)), n, d)))

    structure = jax.ShapeDtypeStruct((faces + 2 * count,), np.int32)
    return Links(*jnp.split(host_call(on_host, structure, *cells.values()), (faces, faces + count)))


def signs_of(mesh: Mesh, links: Links | None = None) -> dict[str, Ids]:
    return _signs_by_type(mesh.cells, links or link(mesh), mesh.points)


@by_place
def _signs_by_type(cells: ValuesByType, links: Links, points: Points) -> ValuesByType:
    """The sign of each cell by the volume of its part of the mesh; none in lower dimension."""
    xp = namespace(points)
    volumes = by_type(volume_of, points, cells)
    volume = join_values(xp, volumes)
    if xp is np:
        enclosed = np.bincount(links.part, links.sign * volume, len(volume))
    else:
        enclosed = jax.ops.segment_sum(links.sign * volume, links.part, num_segments=len(volume))
    parts = _split_by_type(
        (links.sign * xp.where(enclosed < 0, -1, 1)[links.part]).astype(np.int8), volumes
    )
    return {
        k: part if DIMENSION[k] == points.shape[1] else xp.ones_like(part)
        for k, part in parts.items()
    }


class Standard(NamedTuple):
    """Cells of one type on the undeformed mesh, by which they are judged. `sign` is that of the
    mesh, `is_folded` marks cells whose volume has another one, `was_inverted` also those of which a
    corner has.
    """

    sign: Ids
    volume: PerCell
    is_flat: Marks
    jacobian: PerCell
    is_judged: Bool[Either, "s k"]
    is_degenerate: Marks
    is_folded: Marks
    was_inverted: Marks


def standards_of(mesh: Mesh, dtype: Any, links: Links | None = None) -> dict[str, Standard]:
    signs = signs_of(mesh, links)
    if mesh.polyhedra is not None:
        # pieces keep the signs that they have, where the whole polyhedron or polygon is not folded
        volumes = by_type(volume_of, jnp.asarray(mesh.points), mesh.cells)
        volume = join_values(jnp, volumes)
        sign = join_values(jnp, signs)
        ids = mesh.cell_ids
        whole = jax.ops.segment_sum(sign * volume, ids, num_segments=int(ids.max()) + 1)[ids]
        is_sound = np.isin(ids, mesh.polyhedra.cut) & (whole > 0)
        sign = jnp.where(is_sound, jnp.where(volume < 0, -1, 1), sign).astype(jnp.int8)
        signs = _split_by_type(sign, volumes)
    return _standards(mesh.cells, jnp.asarray(mesh.points, dtype), signs)


@by_place
def _standards(cells: ValuesByType, points: Points, signs: ValuesByType) -> dict[str, Standard]:
    return by_type(_standard, points, cells, signs)


def _standard(kind: str, x: Vector, sign: Ids) -> Standard:
    xp = namespace(x[0])
    volume, jacobians, noise = sizes_of(kind, x)
    openings = _with_largest(measures.openings(kind, x), len(jacobians))
    flat = math.factorial(DIMENSION[kind]) * xp.abs(volume) <= xp.max(noise, axis=0)
    folded = ~flat & (sign * volume < 0)
    sizes = xp.where(
        folded, xp.abs(jacobians), sign[None] * jacobians
    )  # of a folded cell all corners count
    judged = sizes > xp.maximum(noise, FLAT_CORNER * openings)
    none = ~xp.any(judged, axis=0)
    least = smallest(xp.where(judged, sizes, xp.inf))
    size = xp.where(flat, 1, sign * xp.abs(volume))
    return Standard(
        sign=sign,
        volume=size,
        is_flat=flat,
        jacobian=xp.where(none, 1, least),
        is_judged=judged,
        is_degenerate=none,
        is_folded=folded,
        was_inverted=~xp.all(sign[None] * jacobians >= -noise, axis=0),
    )


@by_place
def _judge_all(
    cells: ValuesByType, links: Links, points: Points, standards: dict[str, Standard] | None
) -> dict[str, Either]:
    if standards is None:
        signs = _signs_by_type(cells, links, points)
        columns = by_type(_judge_alone, points, cells, signs)
    else:
        signs = {kind: standard.sign for kind, standard in standards.items()}
        columns = by_type(_judge_moved, points, cells, standards)
    columns = join_values(namespace(points), columns)
    angles = non_orthogonality(points, cells, signs, links.neighbour)
    return columns | {"non_orthogonality": angles, "centroid": columns["centroid"].T}


@by_place
def _mark_inverted(cells: ValuesByType, points: Points, standards: dict[str, Standard]) -> Marks:
    def is_inverted(kind: str, x: Vector, standard: Standard) -> Marks:
        return _judge_sizes(*sizes_of(kind, x), standard)["is_inverted"]

    return join_values(namespace(points), by_type(is_inverted, points, cells, standards))


def _split_by_type(values: Either, like: ValuesByType) -> ValuesByType:
    ends = np.cumsum([len(part) for part in like.values()])[:-1]
    return dict(zip(like, namespace(values).split(values, ends), strict=True))


def volume_of(kind: str, x: Vector) -> PerCell:
    return measures.measure_volume(kind, measures.relative_corners(x)[0])


def sizes_of(kind: str, x: Vector) -> tuple[Either, Either, Either]:
    """The volume (k,), the Jacobians (s, k), and the round-off error of each Jacobian. The last
    Jacobian of a curved cell is its least one, wherever it is.
    """
    rounding = 8 * float(jnp.finfo(x[0].dtype).eps) * measures.reach(x)
    relative, _ = measures.relative_corners(x)
    jacobians, spread = measures.jacobians(kind, relative)
    if kind in HIGH_ORDER and DIMENSION[kind] == len(x):
        least = least_jacobian(kind, list(relative))
        jacobians = namespace(least).concatenate([jacobians, least[None]])
    noise = rounding[None] * constant(_with_largest(spread, len(jacobians)))
    return measures.measure_volume(kind, relative), jacobians, noise


def _with_largest(values: Samples, rows: int) -> Float[Either, "rows k"]:
    """Returns values of samples; the least Jacobian, if it has a row, gets the largest."""
    if len(values) == rows:
        return values
    return namespace(values).concatenate([values, values.max(axis=0, keepdims=True)])


def _measure_shape(kind: str, x: Vector) -> dict[str, Either]:
    relative, size = measures.relative_corners(x)
    shape = measures.scaled(relative, size)
    return {
        "skewness": measures.skewness(kind, shape),
        "aspect_ratio": measures.aspect_ratio(kind, shape),
        "centroid": namespace(size).stack(middle(x)),
    }


def _judge_moved(kind: str, x: Vector, standard: Standard) -> dict[str, Either]:
    return _judge_sizes(*sizes_of(kind, x), standard) | _measure_shape(kind, x)


def _judge_sizes(
    volume: Either, jacobians: Either, noise: Either, standard: Standard
) -> dict[str, Either]:
    """Judges cells relative to the undeformed mesh, by corners with their cell's sign there."""
    xp = namespace(volume)
    volume_ratio = xp.where(standard.is_flat, 1, volume) / standard.volume
    turned = standard.sign[None] * jacobians
    least = smallest(xp.where(standard.is_judged, turned, xp.inf))
    jacobian_ratio = xp.where(standard.is_degenerate, 1, least) / standard.jacobian
    is_inverted = ~((volume_ratio > 0) & (jacobian_ratio > 0))
    by_itself = ~xp.all(turned >= -noise, axis=0)
    return {
        "volume": volume,
        "jacobian": smallest(turned),
        "volume_ratio": volume_ratio,
        "jacobian_ratio": jacobian_ratio,
        "is_inverted": is_inverted,
        "is_folded": xp.where(standard.was_inverted, by_itself, is_inverted),
        "is_degenerate": standard.is_degenerate,
        "was_inverted": standard.was_inverted,
    }


def _judge_alone(kind: str, x: Vector, sign: Ids) -> dict[str, Either]:
    volume, jacobians, noise = sizes_of(kind, x)
    xp = namespace(volume)
    turned = sign[None] * jacobians
    is_inverted = ~xp.all(turned >= -noise, axis=0)
    return {
        "volume": volume,
        "jacobian": smallest(turned),
        "volume_ratio": xp.ones_like(volume),
        "jacobian_ratio": xp.ones_like(volume),
        "is_inverted": is_inverted,
        "is_folded": is_inverted,
        "is_degenerate": xp.all(xp.abs(turned) <= noise, axis=0),
        "was_inverted": xp.zeros_like(volume, dtype=bool),
    } | _measure_shape(kind, x)


def largest_inner(degrees: Float[Either, "f k"], is_inner: Bool[Either, "f k"]) -> PerCell:
    return largest(namespace(degrees).where(is_inner, degrees, 0))


def non_orthogonality(
    points: Points,
    cells: ValuesByType,
    signs: ValuesByType,
    neighbour: Either,
    maximum: Callable = largest_inner,
) -> PerCell:
    """The largest angle over the inner faces of each cell, 0 for a cell without any; `maximum` may
    be a smooth stand-in. Centres are relative to the first corner of their cell: their differences
    do not lose digits.
    """
    xp = namespace(points)
    cells = {
        kind: ids[:, : CORNERS[SHAPES[kind]]] for kind, ids in cells.items()
    }  # of a curved cell the corners
    origins, centres = map(Vector, join_values(xp, by_type(_centre, points, cells)))

    def angles(kind: str, x: Vector, sign: Either, behind: Int[Either, "f k"], here: Ids) -> Either:
        if not FACES[kind]:
            return xp.zeros_like(x[0][0])
        relative, size = measures.relative_corners(x)
        other = xp.where(behind < 0, here, behind)
        here = here[None]
        between = (origins.at(other) - origins.at(here)) + (centres.at(other) - centres.at(here))
        areas = measures.face_areas(SHAPES[kind], measures.scaled(relative, size)) * sign[None]
        degrees = measures.measure_non_orthogonality(
            areas, between * (1 / size)[None], DIMENSION[kind] < len(areas)
        )
        return maximum(degrees, behind >= 0)

    # Cells, and the faces of each, stand one type after another.
    ends = np.cumsum([len(FACES[kind]) * len(ids) for kind, ids in cells.items()])[:-1]
    sides = dict(zip(cells, xp.split(neighbour, ends), strict=True))
    behind = {k: sides[k].reshape(len(ids), len(FACES[k])).T for k, ids in cells.items()}
    here = _split_by_type(xp.arange(len(origins[0])), cells)
    return join_values(xp, by_type(angles, points, cells, signs, behind, here))


def _centre(kind: str, x: Vector) -> tuple[tuple, tuple]:
    return tuple(x.at(0)), tuple(
        measures.centre_of_mass(SHAPES[kind], measures.relative_corners(x)[0])
    )
