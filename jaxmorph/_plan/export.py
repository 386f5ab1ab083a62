"""Plans in files for programs without JAX: `native/jmplan.h` moves a mesh by them."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Int, Integer
from scipy.sparse import eye_array

from .._boundary.images import Images
from .._boundary.periodic import Pairing
from .._host.package.arguments import checked, rows_of, shown
from .._host.package.files import PathLike, complete, output_path
from .._methods.blocks import without_tables
from .._methods.tape import POINTS, Field, Places, SurfaceRows, Tape, U, record
from .plan import Guide, Plan, VolumePart

MAGIC = b"JMPLAN\r\n"
JMPLAN_VERSION = 1
HEADER_WORDS = 18
STEP_WORDS = 9
KIND_NUMBERS = {"<f8": 1, "<i8": 2, "<i4": 3}
PLANE_AXES = [["0", "1"], ["0", "2"], ["1", "2"]]


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
        if (
            not isinstance(self.axes, tuple | list)
            or sorted(map(repr, self.axes)) not in PLANE_AXES
        ):
            raise ValueError(f"`axes` must be two of 0, 1, 2, not {shown(self.axes)}.")


@checked
def export(
    plan: Plan,
    path: PathLike,
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
    _check_exportable(plan)
    chosen = _chosen_points(nodes, len(plan.points))
    place = np.full(int(np.asarray(plan.surface.nodes).max(initial=0)) + len(plan.points) + 1, -1)
    place[chosen] = np.arange(len(chosen))
    tape = Tape(plan.points.shape[1])
    for rows in (plan.n_moving, len(chosen)):  # of the registers U and POINTS
        tape.register(rows)
    volume = jax.tree.map(lambda leaf: np.asarray(leaf)[chosen], without_tables(plan.volume))
    first = _record_plan(tape, plan, volume, place)
    arrays = [first, tape.array(volume.points), tape.array(place[np.asarray(plan.moving)], "i8")]
    own = [-1, 0, 1]
    if layer is not None:
        if tape.dimension != 2:
            raise ValueError("`layer` is for the plan of a plane; this plan is in 3-D.")
        own = [tape.array(rows_of("layer.points", layer.points, len(chosen))), *layer.axes]
    sizes = [tape.dimension, len(chosen), plan.n_moving]
    _write_tape(
        path, tape, [*sizes, *map(len, (tape.arrays, tape.rows, tape.steps)), *arrays, *own]
    )


def _chosen_points(nodes: Any, count: int) -> np.ndarray:
    chosen = np.arange(count) if nodes is None else rows_of("nodes", nodes, count)
    if not len(chosen):
        raise ValueError("`nodes` is empty: a process without points needs no plan.")
    twice = len(chosen) - len(np.unique(chosen))
    if twice:
        raise ValueError(f"`nodes` names {twice} points more than once.")
    return chosen


def _check_exportable(plan: Plan) -> None:
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


def _record_plan(tape: Tape, plan: Plan, volume: VolumePart, place: np.ndarray) -> int:
    """Records the plan; returns the number of the first step on the points."""
    surface = plan.surface
    guide = surface.guide
    count = len(surface.nodes)
    own = tape.sparse(U, eye_array(count, plan.n_moving))  # as `constrain(plan, extended(plan, u))`
    if guide is not None:
        own = _guide(tape, guide, own)
    _keep(tape, own, plan.images)
    field = _field(tape, plan, own)
    assigned = _assign(tape, plan, own)
    first = len(tape.steps)
    field(POINTS, Places(volume.points, volume.placed))
    _keep_on_planes(tape, POINTS, plan.images, volume.on_plane)
    if volume.rests is not None:
        tape.rows_in_place("turn", POINTS, volume.rests, np.zeros((tape.dimension,) * 2))
    tape.step("shift", POINTS, -1, volume.points)
    rows = np.arange(count)
    if not plan.method.exact:
        rows = rows[:0] if guide is None else np.asarray(guide.rows)
    at = place[np.asarray(surface.nodes)[rows]]
    order = np.argsort(at)
    order = order[at[order] >= 0]
    if len(order):
        tape.step("put", POINTS, assigned, at[order], rows[order])
    return first


def _keep(tape: Tape, own: int, images: Images) -> None:
    _keep_on_planes(tape, own, images, images.on_plane)
    _keep_alike(tape, own, images.pairings)


def _keep_on_planes(tape: Tape, rows: int, images: Images, on_plane: Any) -> None:
    for is_on, normal in images.normals_of(on_plane):
        tape.rows_in_place("plane", rows, np.asarray(is_on), np.asarray(normal))


def _keep_alike(tape: Tape, rows: int, pairings: Sequence[Pairing]) -> None:
    for pairing in pairings:
        tape.step("pair", rows, -1, pairing.first, pairing.second, pairing.matrix)
        is_alone = np.isin(np.arange(tape.rows[rows]), np.asarray(pairing.alone))
        tape.rows_in_place("turn", rows, is_alone, pairing.keeps)


def _keep_on_walls(tape: Tape, rows: int, guide: Guide) -> None:
    for track in guide.tracks:
        off = np.asarray(track.off(guide.plan.points))[0]
        is_on = np.isin(np.arange(tape.rows[rows]), np.asarray(track.rows))
        tape.rows_in_place("turn", rows, is_on, np.eye(tape.dimension) - off)


def _guide(tape: Tape, guide: Guide, vectors: int) -> int:
    """Displacements of the own rows by the guide, as `Guide.__call__`."""
    plan = guide.plan
    every = tape.rows[vectors]
    first = eye_array(len(plan.surface.nodes), every)
    u = tape.sparse(vectors, first.T @ first)
    _keep(tape, u, plan.images)
    _keep_on_walls(tape, u, guide)
    known = tape.sparse(u, first)
    _keep(tape, known, plan.images)
    volume = jax.tree.map(np.asarray, without_tables(plan.volume))
    moved = tape.register(every)
    _field(tape, plan, known)(moved, Places(volume.points, volume.placed))
    _keep_on_planes(tape, moved, plan.images, volume.on_plane)
    # the known rows move by `u`, all others by the field
    is_known = np.arange(every) < tape.rows[known]
    tape.rows_in_place("turn", moved, is_known, np.zeros((tape.dimension,) * 2))
    tape.step("add", u, moved, number=1)
    _keep_alike(tape, u, guide.pairings)
    if guide.tracks:
        _keep_on_walls(tape, u, guide)
        _keep_alike(tape, u, guide.pairings)
    return u


def _field(tape: Tape, plan: Plan, own: int) -> Field:
    images = jax.tree.map(np.asarray, plan.images)
    u = tape.take(own, images.rows)
    for kind, matrix in enumerate(images.matrices[1:], start=1):
        tape.rows_in_place("turn", u, images.kind == kind, matrix)
    points, ids, factors = jax.tree.map(
        np.asarray, (plan.surface.points, plan.surface.ids, plan.surface.factors)
    )
    return record(plan.method, tape, ids, factors, SurfaceRows(u, points))


def _assign(tape: Tape, plan: Plan, own: int) -> int:
    """Places of the own rows; periodic pairs that match bit for bit still do afterwards."""
    base = np.asarray(plan.surface_points)
    places = tape.copy(own)
    tape.step("shift", places, -1, base)
    for pairing in plan.surface.pairings:
        first, second, shift = map(np.asarray, (pairing.first, pairing.second, pairing.shift))
        matched = (base[first] + shift == base[second]).all(axis=1) & (not pairing.is_rotation)
        tape.step("copy", places, -1, first[matched], second[matched], shift)
    return places


def _write_tape(path: Path, tape: Tape, counts: Sequence[int]) -> None:
    # Words of 64 bits: header, a row (kind, count, offset) for each array, rows of registers,
    # steps. Arrays follow, each filled up to whole words. The sums are over all words after them.
    tables = HEADER_WORDS + 3 * len(tape.arrays) + len(tape.rows) + STEP_WORDS * len(tape.steps)
    ends = 8 * (tables + np.cumsum([0, *(-(-array.nbytes // 8) for array in tape.arrays)]))
    words = np.zeros(ends[-1] // 8, "<u8")
    table = [
        (KIND_NUMBERS[array.dtype.str], array.size, offset)
        for array, offset in zip(tape.arrays, ends[:-1], strict=True)
    ]
    integers = np.concatenate([np.ravel(each) for each in (table, tape.rows, tape.steps)])
    words[HEADER_WORDS:tables] = integers.astype("<i8").view("<u8")
    words[5 : 5 + len(counts)] = np.asarray(counts, "<i8").view("<u8")
    for array, (_, _, offset) in zip(tape.arrays, table, strict=True):
        words.view(np.uint8)[offset : offset + array.nbytes] = array.view(np.uint8)
    rest = words[5:]
    words[1] = JMPLAN_VERSION
    words[2] = words.nbytes
    words[3] = rest.sum()
    words[4] = (rest * np.arange(1, len(rest) + 1, dtype=np.uint64)).sum()
    with complete(path) as partial, partial.open("wb") as file:
        file.write(MAGIC)
        words[1:].tofile(file)
