"""Plans in files for programs without JAX: `native/jmplan.h` moves a mesh by them."""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int, Integer
from scipy.sparse import eye

from .._boundary.images import Images
from .._boundary.periodic import Pairing
from .._boundary.tracks import Track
from .._host.package.arguments import checked, rows_of, shown
from .._host.package.files import complete, output_path
from .._methods.blocks import without_tables
from .._methods.tape import POINTS, Field, Places, SurfaceRows, Tape, U, recorded
from .plan import Guide, Plan, VolumePart

MAGIC, VERSION, HEAD, WORDS = (
    b"JMPLAN\r\n",
    1,
    18,
    9,
)  # begin and version of a file; words of its header, and of a step
KINDS = {"<f8": 1, "<i8": 2, "<i4": 3}  # of arrays in a file
PLANES = [["0", "1"], ["0", "2"], ["1", "2"]]


@dataclasses.dataclass(frozen=True)
class Layer:
    """The nodes of a mesh of one layer of cells, whose plane a 2-D plan moves.

    - `points` (k,): the plan's point of each node of the mesh in space.
    - `axes`: the two coordinates of space that are the plane's.
    """

    points: Int[np.ndarray, " k"]
    axes: tuple[int, int]

    def __post_init__(self):
        rows_of("points", self.points, 2**31)
        if not isinstance(self.axes, tuple | list) or sorted(map(repr, self.axes)) not in PLANES:
            raise ValueError(f"`axes` must be two of 0, 1, 2, not {shown(self.axes)}.")


@checked
def export(
    plan: Plan,
    path: str | os.PathLike[str],
    *,
    nodes: Integer[np.ndarray, " k"] | Sequence[int] | None = None,
    layer: Layer | None = None,
) -> None:
    """Writes a plan to a file that `jmplan.h` opens: C, C++ and Fortran move the mesh, without JAX.

    The folder of the header is `jaxmorph.native.folder`; `jaxmorph native` prints it. The header
    moves points as `deform` does, and pulls sensitivities back as `pullback` does. Nothing is known
    here of the motions to come: whether walls cross, or cells fold, `inspect` tells of each.

    **Arguments:**

    - `plan`: a linear plan in double precision: of the default, `published`, `RBF`, `FittedRBF`,
      `InverseDistance`, `DelaunayGraph`, `NearWall`, `LocalCorrection`, `Multiscale`, with symmetry
      planes, periodic pairs, and flat sliding walls.
    - `path`: the file. It has a temporary name until it is complete.
    - `nodes`: ids (k,) of the plan's points that the file has, in its order, as of one process of a
      solver. `u` stays that of all moving nodes. Default None: all points.
    - `layer`: the mesh in space that a 2-D plan moves. Default None.

    **Raises:** `ValueError` for a plan that is not linear, or is of another method or basis, and
    for one in single precision or laid over devices. Also for ids that are no points.
    """
    path = output_path(path)
    _check(plan)
    count = len(plan.points)
    chosen = np.arange(count) if nodes is None else rows_of("nodes", nodes, count)
    if not len(chosen):
        raise ValueError("`nodes` is empty: a process without points needs no plan.")
    if len(np.unique(chosen)) < len(chosen):
        raise ValueError(
            f"`nodes` names {len(chosen) - len(np.unique(chosen))} points more than once."
        )
    place = np.full(int(np.asarray(plan.surface.nodes).max(initial=0)) + count + 1, -1)
    place[chosen] = np.arange(len(chosen))
    tape = Tape(plan.points.shape[1])
    for rows in (plan.n_moving, len(chosen)):  # of the registers U and POINTS
        tape.register(rows)
    volume = jax.tree.map(lambda leaf: np.asarray(leaf)[chosen], without_tables(plan.volume))
    first = _recorded(tape, plan, volume, place)
    moving = tape.array(place[np.asarray(plan.moving)], "i8")
    rest = tape.array(volume.points)
    own = [-1, 0, 1]
    if layer is not None:
        if tape.dimension != 2:
            raise ValueError("`layer` is for the plan of a plane; this plan is in 3-D.")
        own = [tape.array(rows_of("layer.points", layer.points, len(chosen))), *layer.axes]
    sizes = (
        tape.dimension,
        len(chosen),
        plan.n_moving,
        len(tape.arrays),
        len(tape.rows),
        len(tape.steps),
    )
    _write(path, tape, [*sizes, first, rest, moving, *own])


def _check(plan: Plan) -> None:
    if plan.layout is not None:
        raise ValueError("this plan is laid over devices: export the plan that `prepare` returned.")
    if not plan.is_linear:
        what = (
            type(plan.method).__name__
            if not plan.method.linear
            else "a plan with curved sliding walls"
        )
        raise ValueError(
            f"{what} is not linear in u: a plan in a file is one linear map. Take plan.is_linear "
            "plans."
        )
    if plan.points.dtype != np.float64:
        raise ValueError(
            f"this plan is in {plan.points.dtype}; solvers compute in double precision. Call "
            'jax.config.update("jax_enable_x64", True) before `prepare`.'
        )


def _recorded(tape: Tape, plan: Plan, volume: VolumePart, place: np.ndarray) -> int:
    """Records the plan; returns the number of the first step on the points."""
    own, guide = (
        tape.register(len(plan.surface.nodes)),
        plan.surface.guide,
    )  # as `kept(plan, extended(plan, u))`
    tape.sparse(own, U, eye(tape.rows[own], tape.rows[U]))
    if guide is not None:
        own = _guided(tape, guide, own)
    _kept(tape, own, plan.images)
    field = _field(tape, plan, own)
    assigned = _assigned(tape, plan, own)
    first = len(tape.steps)
    field(tape, POINTS, Places(tape.array(volume.points), volume.placed))
    _keep(tape, POINTS, plan.images, volume.on_plane)
    if volume.rests is not None:
        tape.rows_in_place("turn", POINTS, volume.rests, np.zeros((tape.dimension,) * 2))
    tape.step("shift", POINTS, -1, tape.array(volume.points))
    rows = (
        np.arange(tape.rows[own])
        if plan.method.exact
        else np.asarray([] if guide is None else guide.rows, int)
    )
    at = place[np.asarray(plan.surface.nodes)[rows]]
    rows = rows[at >= 0]
    at = at[at >= 0]
    order = np.argsort(at)
    if len(rows):
        tape.step("put", POINTS, assigned, tape.array(at[order]), tape.array(rows[order]))
    return first


def _kept(tape: Tape, own: int, images: Images) -> None:
    _keep(tape, own, images, images.on_plane)
    _alike(tape, own, images.pairings)


def _keep(tape: Tape, rows: int, images: Images, on_plane: Any) -> None:
    for is_on, normal in images.normals_of(on_plane):
        tape.rows_in_place("plane", rows, np.asarray(is_on), np.asarray(normal))


def _alike(tape: Tape, rows: int, pairings: Sequence[Pairing]) -> None:
    for pairing in pairings:
        first = tape.array(pairing.first)
        second = tape.array(pairing.second)
        tape.step("pair", rows, -1, first, second, tape.array(pairing.matrix))
        is_alone = np.isin(np.arange(tape.rows[rows]), np.asarray(pairing.alone))
        tape.rows_in_place("turn", rows, is_alone, pairing.keeps)


def _on_walls(tape: Tape, rows: int, tracks: Sequence[Track], points: np.ndarray) -> None:
    for track in tracks:
        off = np.asarray(track.off(jnp.asarray(points)))[0]
        is_on = np.isin(np.arange(tape.rows[rows]), np.asarray(track.rows))
        tape.rows_in_place("turn", rows, is_on, np.eye(tape.dimension) - off)


def _guided(tape: Tape, guide: Guide, vectors: int) -> int:
    """Displacements of the own rows by the guide, as `Guide.__call__`."""
    plan = guide.plan
    points = np.asarray(guide.plan.points)
    known = len(plan.surface.nodes)
    every = tape.rows[vectors]
    first = eye(known, every)
    u, led, moved = (tape.register(rows) for rows in (every, known, every))
    tape.sparse(u, vectors, first.T @ first)
    _kept(tape, u, plan.images)
    _on_walls(tape, u, guide.tracks, points)
    tape.sparse(led, u, first)
    _kept(tape, led, plan.images)
    volume = jax.tree.map(np.asarray, without_tables(plan.volume))
    _field(tape, plan, led)(tape, moved, Places(tape.array(points), volume.placed))
    _keep(tape, moved, plan.images, volume.on_plane)
    tape.rows_in_place("turn", moved, np.arange(every) < known, np.zeros((tape.dimension,) * 2))
    tape.step("add", u, moved, number=1)  # the known rows move by `u`, all others by the field
    _alike(tape, u, guide.pairings)
    if guide.tracks:
        _on_walls(tape, u, guide.tracks, points)
        _alike(tape, u, guide.pairings)
    return u


def _field(tape: Tape, plan: Plan, own: int) -> Field:
    images = plan.images
    surface = plan.surface
    u = tape.register(len(images.rows))
    tape.step("take", u, own, tape.array(images.rows))
    for kind, matrix in enumerate(np.asarray(images.matrices)[1:], start=1):
        tape.rows_in_place("turn", u, np.asarray(images.kind) == kind, matrix)
    rows = SurfaceRows(u, tape.array(surface.points), tape.rows[u])
    return recorded(
        plan.method, tape, *jax.tree.map(np.asarray, (surface.ids, surface.factors)), rows
    )


def _assigned(tape: Tape, plan: Plan, own: int) -> int:
    """Places of the own rows; periodic pairs that match bit for bit still do afterwards."""
    places = tape.register(tape.rows[own])
    base = np.asarray(plan.surface_points)
    tape.step("add", places, own, number=1)
    tape.step("shift", places, -1, tape.array(base))
    for pairing in plan.surface.pairings:
        first, second, shift = map(np.asarray, (pairing.first, pairing.second, pairing.shift))
        matched = (base[first] + shift == base[second]).all(axis=1) & (not pairing.is_rotation)
        rows = tape.array(first[matched]), tape.array(second[matched])
        tape.step("copy", places, -1, *rows, tape.array(shift))
    return places


def _write(path: Path, tape: Tape, counts: Sequence[int]) -> None:
    # Words of 64 bits: header, a row (kind, count, offset) for each array, rows of registers,
    # steps. Arrays follow, each filled up to whole words. The sums are over all words after them.
    tables = HEAD + 3 * len(tape.arrays) + len(tape.rows) + WORDS * len(tape.steps)
    sizes = [-(-array.nbytes // 8) for array in tape.arrays]
    offsets = 8 * (tables + np.cumsum([0, *sizes[:-1]]))
    table = [
        (KINDS[array.dtype.str], array.size, offset)
        for array, offset in zip(tape.arrays, offsets, strict=True)
    ]
    words = np.zeros(tables + sum(sizes), "<u8")
    integers = np.concatenate([np.ravel(each) for each in (table, tape.rows, tape.steps)])
    words[HEAD:tables] = integers.astype("<i8").view("<u8")
    words[5 : 5 + len(counts)] = np.asarray(counts, "<i8").view("<u8")
    for array, offset in zip(tape.arrays, offsets, strict=True):
        words.view(np.uint8)[offset : offset + array.nbytes] = array.view(np.uint8)
    words[1], words[2] = VERSION, words.nbytes
    rest = words[5:]
    words[3], words[4] = rest.sum(), (rest * np.arange(1, len(rest) + 1, dtype=np.uint64)).sum()
    with complete(path) as partial, partial.open("wb") as file:
        file.write(MAGIC)
        words[1:].tofile(file)
