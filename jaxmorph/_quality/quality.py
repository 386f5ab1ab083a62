"""Quality of the cells of a mesh, relative to the undeformed one."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Real, Shaped

from .._host.cells.adjacency import handedness, neighbours
from .._host.cells.topology import CORNERS, DIMENSION, FACES, SHAPES
from .._host.package.arguments import checked
from .._kernels.callback import host_call
from .._kernels.values import Either, array, as_jax, constant, is_known, largest, namespace, smallest
from .._mesh.mesh import Mesh
from . import measures
from .proof.search import has_least, least_jacobian
from .report import QualityReport
from .vector import Vector, by_place, corners, in_blocks, mean, stack

FLAT = 1e-4
"""Sine of a corner's angle up to which it is flat; 3-D: Jacobian over its edges' product."""


@checked
def quality(mesh: Mesh, points: Real[ArrayLike, "n d"] | Sequence[Any] | None = None) -> QualityReport:
    """Measures a mesh's cells at `points`, judged relative to the undeformed `mesh.points`.

    Traced: `jit`, `grad` and `vmap` work over `points`, and over a mesh given as an argument.
    Derivatives are finite on degenerate cells too.

    The sign that a volume should have is that of the mesh, whichever way round its cells are
    numbered. Cells numbered the other way round than their neighbours (a matter of ids, not of
    coordinates) are turned. The sign is then that of the volume which the connected part of the
    mesh encloses. So a cell on the wrong side of a face that it shares is folded, and cells of
    mixed handedness are fine. `inverted`, `smooth_quality`, `proof`, `proven_margin`, `distortion`,
    `improve` and `largest_step` take the same sign. A part of a single cell has that cell's own.

    With `points`, a cell is inverted where its volume, or the Jacobian at one of its corners, has
    not the sign of the undeformed mesh. Curved cells have a lattice of places, and the place where
    bounds on their Jacobian find it least, instead of corners. So a curved cell that folds anywhere
    is found. A linear hexahedron that folds between its corners is not: `proof` finds it. A cell
    that is folded on the undeformed mesh already is inverted until a motion unfolds it, and counts
    in `from_start`. Not judged are corners that had no sign, or had the wrong one in a cell that
    was not folded, as in a quad not convex from the start. Without `points` that quad is inverted.
    A corner has no sign within the round-off of the coordinates. One of a cell that is no simplex
    has none either where it is flat or collapsed: its Jacobian is 1e-4 of the product of its edges
    or less. A folded piece of a polyhedron is fine where the polyhedron as a whole is not folded.

    Without `points`, the mesh is judged by itself. A cell is then inverted where its volume or a
    corner's Jacobian has not the sign of the mesh.

    Neighbours are found on the host from the ids, under `jit` when it traces: 0.2 s for 350,000
    tetrahedra. For traced cells (a mesh given to `jit` as an argument) the host finds them in each
    call: close over the mesh instead.

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
        links = link(mesh.cells)
        standards = None if points is None else standards_of(mesh, current.dtype, links)
    columns = as_jax(_columns(kinds, cells, links, current, standards))
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
    return jnp.asarray(_flags(kinds, cells, current, standards))


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
    """Holds ids: the cell behind each face, each cell's sign by numbering, and its part."""

    neighbour: Int[Either, " f"]
    sign: Int[Either, " k"]
    part: Int[Either, " k"]


def link(cells: dict[str, Any]) -> Links:
    def linked(*corners: np.ndarray) -> list[np.ndarray]:
        known = dict(zip(cells, corners, strict=True))
        found = neighbours(known)
        return [found[0], *handedness(known, *found)]

    if is_known(*cells.values()):
        return Links(*linked(*(np.asarray(corners) for corners in cells.values())))
    faces, count = sum(len(FACES[kind]) * len(ids) for kind, ids in cells.items()), sum(map(len, cells.values()))
    structure = jax.ShapeDtypeStruct((faces + 2 * count,), np.int32)
    found = host_call(lambda *corners: np.concatenate(linked(*corners)), structure, *cells.values())
    return Links(*jnp.split(found, (faces, faces + count)))


def signs_of(mesh: Mesh, links: Links | None = None) -> dict[str, Int[Either, " k"]]:
    """Finds the sign that each cell's volume should have, by type; see `quality`."""
    return _signs(tuple(mesh.cells), tuple(mesh.cells.values()), links or link(mesh.cells), mesh.points)


@by_place
def _signs(kinds: tuple[str, ...], cells: tuple[Any, ...], links: Links, points: Float[Either, "n d"]) -> dict:
    return _enclosed_signs(_volumes(kinds, cells, points), links, points.shape[1])


class Standard(NamedTuple):
    """Holds the state of the cells of one type on the undeformed mesh, by which they are judged.

    `sign` is that of the mesh, `is_folded` marks cells whose volume has another one.
    """

    sign: Int[Either, " k"]
    volume: Float[Either, " k"]
    is_flat: Bool[Either, " k"]
    jacobian: Float[Either, " k"]
    is_judged: Bool[Either, "s k"]
    is_degenerate: Bool[Either, " k"]
    is_folded: Bool[Either, " k"]


def standards_of(mesh: Mesh, dtype: Any, links: Links | None = None) -> tuple[Standard, ...]:
    """Computes the undeformed state, one `Standard` a type of cells, in precision `dtype`."""
    kinds, cells, points = tuple(mesh.cells), tuple(mesh.cells.values()), jnp.asarray(mesh.points, dtype)
    signs = signs_of(mesh, links)
    if mesh.polyhedra is not None:
        signs = _of_pieces(mesh, signs, mesh.polyhedra.cut)
    return _standards(kinds, cells, points, signs)


@by_place
def _standards(kinds, cells, points, signs) -> tuple[Standard, ...]:
    pairs = zip(kinds, cells, strict=True)
    return tuple(
        in_blocks(namespace(points), functools.partial(_standard, kind, points), ids.T, signs[kind])
        for kind, ids in pairs
    )


def _of_pieces(mesh: Mesh, signs: dict[str, Any], cut: np.ndarray) -> dict[str, Any]:
    """Takes the signs that pieces have, where the whole polyhedron or polygon is not folded."""
    volumes = _volumes(tuple(mesh.cells), tuple(mesh.cells.values()), jnp.asarray(mesh.points))
    volume, sign = (jnp.concatenate([part[kind] for kind in volumes]) for part in (volumes, signs))
    ids = mesh.cell_ids
    whole = jax.ops.segment_sum(sign * volume, ids, num_segments=int(ids.max()) + 1)[ids]
    is_sound = np.isin(ids, cut) & (whole > 0)
    return _split(jnp.where(is_sound, jnp.where(volume < 0, -1, 1), sign).astype(jnp.int8), volumes)


def _standard(kind: str, points: Float[Either, "n d"], ids: Shaped[Either, "c k"], sign: Int[Either, " k"]) -> Standard:
    xp, (volume, jacobians, noise) = namespace(points), _sizes(kind, corners(points, ids.T))
    openings = _with_largest(measures.openings(kind, corners(points, ids.T)), len(jacobians))
    flat = math.factorial(DIMENSION[kind]) * xp.abs(volume) <= xp.max(noise, axis=0)
    folded = ~flat & (sign * volume < 0)
    sizes = xp.where(folded, xp.abs(jacobians), sign[None] * jacobians)  # of a folded cell all corners count
    judged = sizes > xp.maximum(noise, FLAT * openings)
    none, least = ~xp.any(judged, axis=0), smallest(xp.where(judged, sizes, xp.inf))
    size = xp.where(flat, 1, sign * xp.abs(volume))
    return Standard(sign, size, flat, xp.where(none, 1, least), judged, none, folded)


@by_place
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
        by_kind: dict[str, Any] = _enclosed_signs(_volumes(kinds, cells, points), links, points.shape[1])
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


@by_place
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


def _volumes(kinds: tuple[str, ...], cells: tuple[Any, ...], points: Float[Either, "n d"]) -> dict[str, Either]:
    def volume(kind: str, ids: Shaped[Either, "c k"]) -> Float[Either, " k"]:
        return measures.volume(kind, measures.relative_corners(corners(points, ids.T))[0])

    pairs = zip(kinds, cells, strict=True)
    return {kind: in_blocks(namespace(points), functools.partial(volume, kind), ids.T) for kind, ids in pairs}


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
    if xp is np:
        enclosed = np.bincount(links.part, links.sign * volume, len(volume))
    else:
        enclosed = jax.ops.segment_sum(links.sign * volume, links.part, num_segments=len(volume))
    parts = _split((links.sign * xp.where(enclosed < 0, -1, 1)[links.part]).astype(np.int8), volumes)
    return {kind: part if DIMENSION[kind] == d else xp.ones_like(part) for kind, part in parts.items()}


def _split(values: Either, by_kind: dict[str, Either]) -> dict[str, Either]:
    ends = np.cumsum([len(part) for part in by_kind.values()])[:-1]
    return dict(zip(by_kind, namespace(values).split(values, ends), strict=True))


def _judge(volume: Either, jacobians: Either, standard: Standard) -> dict[str, Either]:
    """Judges cells relative to the undeformed mesh, by corners with their cell's sign there."""
    xp = namespace(volume)
    volume_ratio = xp.where(standard.is_flat, 1, volume) / standard.volume
    least = smallest(xp.where(standard.is_judged, standard.sign[None] * jacobians, xp.inf))
    jacobian_ratio = xp.where(standard.is_degenerate, 1, least) / standard.jacobian
    return {
        "volume": volume,
        "jacobian": smallest(standard.sign[None] * jacobians),
        "volume_ratio": volume_ratio,
        "jacobian_ratio": jacobian_ratio,
        "is_inverted": ~((volume_ratio > 0) & (jacobian_ratio > 0)),
        "is_degenerate": standard.is_degenerate,
        "was_inverted": standard.is_folded,
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
        "was_inverted": xp.zeros_like(volume, dtype=bool),
    }


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
    return xp.stack(x[0].components), xp.stack(
        measures.centre_of_mass(SHAPES[kind], measures.relative_corners(x)[0]).components
    )


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
