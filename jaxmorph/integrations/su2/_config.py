"""A config file and its mesh as a shape, and sensitivities as SU2's adjoint solvers leave them."""

import dataclasses
import functools
import pathlib
import re
from collections.abc import Collection, Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from jaxmorph import Mesh, io, shapes
from jaxmorph.extend import (
    PathLike,
    as_jax,
    checked,
    complete,
    finite_array,
    input_path,
    output_path,
    warn,
)

from ._boxes import BoxPart, box_parts, boxes_of
from ._motion import AbstractPart, DesignVariables, PatchNamesOfMotion, wall_parts
from ._options import VARIABLE_KINDS, Options, Variable, read_options, read_variables

LARGE = 0.5
"""Motion of a wall over its own length that counts as a mistake."""

RIGID = {"TRANSLATION", "ROTATION", "SCALE"}
"""Kinds that may move a wall far."""

FILE_OPTIONS = {
    "SOLUTION_ADJ_FILENAME": "solution_adj",
    "VOLUME_SENS_FILENAME": "volume_sens",
    "SURFACE_SENS_FILENAME": "surface_sens",
    "RESTART_ADJ_FILENAME": "restart_adj",
}
"""Options that name a file of sensitivities, and SU2's default names."""

EXTENSIONS = {
    "DRAG": "cd",
    "LIFT": "cl",
    "SIDEFORCE": "csf",
    "EFFICIENCY": "eff",
    "THRUST": "ct",
    "TORQUE": "cq",
    **{f"MOMENT_{axis}": f"cm{axis.lower()}" for axis in "XYZ"},
    **{f"FORCE_{axis}": f"cf{axis.lower()}" for axis in "XYZ"},
    "EQUIVALENT_AREA": "ea",
    "NEARFIELD_PRESSURE": "nfp",
    "FIGURE_OF_MERIT": "merit",
    "INVERSE_DESIGN_PRESSURE": "invpress",
    "INVERSE_DESIGN_HEAT": "invheat",
    "MAXIMUM_HEATFLUX": "maxheat",
    "TOTAL_HEATFLUX": "totheat",
    "BUFFET": "buffet",
    "SURFACE_TOTAL_PRESSURE": "pt",
    "SURFACE_STATIC_PRESSURE": "pe",
    "SURFACE_MASSFLOW": "mfr",
    "SURFACE_MACH": "mach",
    "SURFACE_UNIFORMITY": "uniform",
    "SURFACE_SECONDARY": "second",
    "SURFACE_MOM_DISTORTION": "distort",
    "SURFACE_SECOND_OVER_UNIFORM": "sou",
    "SURFACE_PRESSURE_DROP": "dp",
    "CUSTOM_OBJFUNC": "custom",
}
"""SU2's suffixes of an adjoint file's name, by the objective."""

NORMAL_COLUMNS = ("surface_sensitivity", "sensitivity")
"""Columns of the continuous adjoint's derivative by a motion into the body."""


@dataclasses.dataclass(frozen=True, eq=False)
class Config:
    """A config file and its mesh: the shape that moves the wall, and the patches.

    - `mesh`, `output`: the mesh of `MESH_FILENAME`, and the file of `MESH_OUT_FILENAME`.
    - `shape`, `parameters`: moves the nodes `mesh.patch(*moving)` by values (n,); at
      `shape.neutral()` nothing moves.
    - `moving`, `symmetry`, `fixed`: names of patches, `DV_MARKER`, `MARKER_SYM`, and all others but
      `MARKER_INTERNAL`. A design variable such as `SCALE_GRID` moves all of them.
    - `steps`: of `DEFORM_NONLINEAR_ITER`.
    - `boxes`: free-form boxes of the mesh, or of `FFD_DEFINITION` where `DV_KIND` is `FFD_SETTING`
      or the mesh has none.
    - `names`: of the design variables.
    - `options`: the options as text, by name.
    """

    mesh: Mesh
    output: pathlib.Path
    shape: DesignVariables
    parameters: Float[ndarray, " n"]
    moving: tuple[str, ...]
    symmetry: tuple[str, ...]
    fixed: tuple[str, ...]
    steps: int
    boxes: tuple[io.Box, ...]
    options: Options

    @property
    def names(self) -> tuple[str, ...]:
        return self.shape.names

    @property
    def angles(self) -> list[int]:
        """Places of the angles of attack among the design variables: no wall moves by them."""
        return [k for k, name in enumerate(self.names) if _sort(name) == "flow"]

    @property
    def constants(self) -> list[str]:
        """Names of design variables that move the wall whatever their value is."""
        return [name for name in self.names if _sort(name) == "constant"]

    @functools.cached_property
    def path(self) -> Float[ndarray, "k m d"]:
        """Total displacements of the moving nodes in equal steps, as `jm.march` takes them."""
        u = np.asarray(jax.jit(self.shape)(self._wall, self.parameters)) - self._wall
        return np.stack([u * (k + 1) / self.steps for k in range(self.steps)])

    @property
    def _wall(self) -> Float[ndarray, "m d"]:
        return np.asarray(self.mesh.points)[self.mesh.patch(*self.moving)]

    @property
    def largest(self) -> float:
        """Largest displacement of a moving node."""
        return float(np.linalg.norm(self.path[-1], axis=1).max(initial=0))

    @property
    def share(self) -> float:
        """`largest` over the length of the moving patches: for an airfoil, in chords."""
        length = np.ptp(self._wall, axis=0).max() if len(self._wall) else 0
        return float(self.largest / length) if length else 0.0

    @property
    def moved_boxes(self) -> tuple[io.Box, ...]:
        """The boxes with the control points where the parameters put them."""
        changes = {}
        values = jnp.asarray(self.parameters) * self.shape.scales
        for part in self.shape.parts:
            if isinstance(part, BoxPart):
                changes[part.variables[0].box] = np.asarray(
                    part.change(values[np.array(part.rows, int)])
                )
        return tuple(
            dataclasses.replace(box, control=box.control + changes.get(box.name, 0))
            for box in self.boxes
        )


@checked
def read_config(path: PathLike, *, definition: bool = False, zone: int | None = None) -> Config:
    """Reads a config file of SU2, and the mesh that it names.

        config = su2.read_config("inv_NACA0012.cfg")
        plan = jm.prepare(config.mesh, config.moving, config.fixed, symmetry=config.symmetry)
        u = shapes.displacement(config.shape, plan, config.parameters)

    **Arguments:**

    - `path`: the config file; names of files in it are relative to its folder.
    - `definition`: True takes the design variables of `DEFINITION_DV`, with its scales, at the
      values of `DV_VALUE_NEW` (else all at rest). Default: the variables of `DV_KIND`.
    - `zone`: the zone `IZONE= N` of a mesh with several. Default: the mesh has one.

    **Raises:** `ValueError` for unsupported kinds, words and numbers, each with its option.

    **Warns:** of ignored options that SU2 would honour, markers that the mesh lacks, surplus
    numbers of `DV_PARAM`, and a wall that moves by more than half of its length.
    """
    options = read_options(pathlib.Path(path))
    listed, markers = read_variables(options, definition)
    mesh = _read_mesh(options, zone)
    kinds = {variable.kind for variable in listed}
    sorts = {VARIABLE_KINDS[kind].sort for kind in kinds}
    is_setting = "FFD_SETTING" in kinds
    is_whole = "mesh" in sorts
    is_moving = is_setting or not sorts <= {"nothing", "flow"}
    moving = tuple(mesh.patches)
    if not is_whole:
        moving = _markers_present(options, mesh, "DV_MARKER", markers, is_moving)
    planes = _markers_present(options, mesh, "MARKER_SYM", options.words("MARKER_SYM"))
    inner = _markers_present(options, mesh, "MARKER_INTERNAL", options.words("MARKER_INTERNAL"))
    try:
        boxes = boxes_of(options, mesh, moving, is_setting)
        parts = wall_parts(options, listed, mesh, moving)
        parts += box_parts(options, listed, mesh, moving, boxes)
    except ValueError as error:
        raise ValueError(
            f"{options.path}: {str(error).removeprefix(f'{options.path}: ')}"
        ) from None
    free = _free_coordinates(mesh, moving, () if is_whole else planes)
    shape = _make_shape(options, listed, parts, free)
    config = Config(
        mesh=mesh,
        output=options.output,
        shape=shape,
        parameters=_read_values(options, shape, definition),
        moving=moving,
        symmetry=_names_without(planes, moving),
        fixed=_names_without(mesh.patches, (*moving, *planes, *inner)),
        steps=options.whole("DEFORM_NONLINEAR_ITER"),
        boxes=boxes,
        options=options,
    )
    _warn_of_results(config, listed)
    return config


def _read_mesh(options: Options, zone: int | None) -> Mesh:
    if not options.mesh_file.exists():
        told = options.error("MESH_FILENAME", f"there is no file {options.mesh_file}")
        raise FileNotFoundError(str(told))
    if zone is None:
        return io.read(options.mesh_file)
    zones = io.read_zones(options.mesh_file)
    if not 1 <= zone <= len(zones):
        raise options.error(
            "MESH_FILENAME", f"{options.mesh_file} has {len(zones)} zones, not the zone {zone}"
        )
    return zones[zone - 1]


def _names_without(names: Iterable[str], others: Collection[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name not in others)


def _sort(name: str) -> str:
    return VARIABLE_KINDS[name.partition("[")[0]].sort


def _markers_present(
    options: Options, mesh: Mesh, name: str, markers: PatchNamesOfMotion, is_needed: bool = False
) -> tuple[str, ...]:
    present = []
    absent = []
    for marker in markers:
        try:
            present += mesh.patch_names(marker)
        except ValueError:
            absent.append(marker)
    if is_needed and not present:
        there = ", ".join(mesh.patches)
        raise options.error(
            name, f"names no marker of the mesh, so nothing would move; it has {there}"
        )
    if absent:
        warn(f"{options.path}: {name}= the mesh has no marker {', '.join(absent)}; left out.")
    return tuple(dict.fromkeys(present))


def _warn_of_results(config: Config, listed: list[Variable]) -> None:
    options = config.options
    kinds = dict.fromkeys(variable.kind for variable in listed)
    for kind in filter(lambda kind: VARIABLE_KINDS[kind].sort == "flow", kinds):
        warn(f"{kind} is left alone: it is the flow solver's, no wall moves by it.")
    if left_out := options.left_out():
        warn(
            f"{options.path}: not honoured here, though SU2's result depends on it: "
            f"{', '.join(left_out)}."
        )
    if "MARKER_PERIODIC" in options:
        pairs = " ".join(options.periodic)
        warn(f"{options.path}: jaxmorph deform moves periodic patches alike by --periodic {pairs}.")
    relaxed = options.relaxation
    cause = (
        "check DV_VALUE"
        if relaxed == 1
        else f"OPT_RELAX_FACTOR= {relaxed:g} multiplies DV_VALUE, as in SU2"
    )
    suspect = {kind for kind in kinds if VARIABLE_KINDS[kind].sort in ("wall", "box")} - (
        RIGID if relaxed == 1 else set()
    )
    if config.share > LARGE and suspect:
        warn(f"{options.path}: the wall moves by {config.share:.3g} times its own length: {cause}.")


def _read_values(
    options: Options, shape: DesignVariables, definition: bool
) -> Float[ndarray, " n"]:
    """Reads the value of each design variable; without `DV_VALUE_NEW` of them all are at rest."""
    name = "DV_VALUE_NEW" if definition else "DV_VALUE"
    rest = np.asarray(shape.rest)
    values = options.numbers(name) if name in options else []
    if not len(rest) or (definition and len(values) != len(rest)):
        return rest
    if len(values) != len(rest):
        raise options.error(
            name, f"{len(rest)} values expected, one for each number, found {len(values)}"
        )
    return np.array(values)


def _make_shape(
    options: Options, listed: list[Variable], parts: Sequence[AbstractPart], free: ndarray
) -> DesignVariables:
    names = []
    scales = []
    rest = []
    for k, own in enumerate(listed):
        # SU2 relaxes amplitudes, not the vectors of control points without a direction, nor camber
        is_relaxed = own.size == 1 and own.kind != "HICKS_HENNE_CAMBER"
        scale = own.scale * (options.relaxation if is_relaxed else 1)
        names += [
            f"{own.kind}[{k}]" + (f"[{part}]" if own.size > 1 else "") for part in range(own.size)
        ]
        scales += [scale] * own.size
        rest += [1 / scale if own.kind.startswith("SCALE") else 0.0] * own.size
    return DesignVariables(
        names=tuple(names),
        parts=tuple(parts),
        scales=as_jax(np.array(scales, float)),
        rest=as_jax(np.array(rest, float)),
        free=as_jax(free),
    )


def _free_coordinates(
    mesh: Mesh, moving: PatchNamesOfMotion, planes: PatchNamesOfMotion
) -> Bool[ndarray, "m d"]:
    """Marks coordinates that may change: on `planes` all but that across the patch."""
    nodes = mesh.patch(*moving) if moving else np.zeros(0, int)
    points = np.asarray(mesh.points, float)
    free = np.ones((len(nodes), points.shape[1]), bool)
    for name in planes:
        own = mesh.patch(name)
        axis = np.argmin(np.sum((points[own] - points[own[0]]) ** 2, axis=0))
        free[np.isin(nodes, own), axis] = False
    return free


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of an objective from a file.

    - `path`: the file.
    - `by_nodes`: by the positions of all nodes (n, d), or of the moving ones (m, d).
    - `by_angle`: by the angle of attack, None where the file does not say.
    """

    path: pathlib.Path
    by_nodes: Float[ndarray, "k d"]
    by_angle: float | None


@checked
def read_sensitivity(config: Config, path: PathLike | None = None) -> Sensitivity:
    """Reads the sensitivities that a config file is about.

        sensitivity = su2.read_sensitivity(su2.read_config("config.cfg"))

    A discrete adjoint gives sensitivities of all nodes, or of the surface's nodes after SU2_DOT.
    With `MATH_PROBLEM= CONTINUOUS_ADJOINT` the column `Surface_Sensitivity` is a derivative along
    the wall's normals.

    **Arguments:**

    - `config`: what `read_config` returned.
    - `path`: the file. Default: the first existing one of `SOLUTION_ADJ_FILENAME`,
      `VOLUME_SENS_FILENAME`, `SURFACE_SENS_FILENAME` and `RESTART_ADJ_FILENAME`, or
      `SURFACE_ADJ_FILENAME` of a continuous adjoint.
      Endings, and SU2's suffix of the objective (`_cd`), may be missing in the name.

    **Raises:** `ValueError` for no file, and as `io.read_sensitivity` does.
    """
    is_normal = config.options.text("MATH_PROBLEM").upper() == "CONTINUOUS_ADJOINT"
    file = input_path(path) if path is not None else _find_file(config.options, is_normal)
    by_nodes = _by_normals(config, file) if is_normal else None
    if by_nodes is None:
        by_nodes = io.read_sensitivity(file, config.mesh, moving=config.mesh.patch(*config.moving))
    return Sensitivity(file, by_nodes, _by_angle(file))


def _find_file(options: Options, is_normal: bool) -> pathlib.Path:
    objective = options.text("OBJECTIVE_FUNCTION", "DRAG")
    kind = "combo" if "," in objective else EXTENSIONS.get(objective.strip("() "), "*")
    defaults = {"SURFACE_ADJ_FILENAME": "surface_adjoint"} if is_normal else FILE_OPTIONS
    names = {
        option: options.path.parent / options.text(option, default)
        for option, default in defaults.items()
    }
    for name in names.values():
        if found := _find_existing(name, kind):
            return found
    tried = ", ".join(f"{option}= {name.name}" for option, name in names.items())
    raise ValueError(
        f"{options.path}: no file of sensitivities is there ({tried}), with _{kind} or without: "
        "give --sensitivity."
    )


def _find_existing(name: pathlib.Path, kind: str) -> pathlib.Path | None:
    """Finds the file of a name, with or without the objective and an ending; one alone for `*`."""
    is_full = name.suffix in (".dat", ".csv")
    stem, ending = (name.stem, name.suffix) if is_full else (name.name, ".dat")
    endings = dict.fromkeys([ending, ".csv", ".dat"])
    for pattern in (f"{stem}_{kind}", stem):
        found = [file for ending in endings for file in sorted(name.parent.glob(pattern + ending))]
        if len(found) == 1 or (found and "*" not in pattern):
            return found[0]
    return None


def _by_normals(config: Config, file: pathlib.Path) -> Float[ndarray, "m d"] | None:
    """Reads derivatives along the wall's normals, which point into the flow; None without them."""
    with file.open("rb") as stream:
        names = [
            name.strip(b"\"' \r\n\t").decode(errors="replace").lower()
            for name in stream.readline().split(b",")
        ]
    column = next((names.index(name) for name in NORMAL_COLUMNS if name in names), None)
    if column is None:
        return None
    try:
        rows = np.loadtxt(file, delimiter=",", skiprows=1, usecols=(0, column), ndmin=2)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    if not np.isfinite(rows).all():
        raise ValueError(f"{file}: values that are not finite.")
    nodes = config.mesh.patch(*config.moving)
    missing = np.setdiff1d(nodes, rows[:, 0])
    if len(missing):
        raise ValueError(
            f"{file}: {len(missing)} of {len(nodes)} nodes of DV_MARKER are missing, first "
            f"{missing[0]}."
        )
    normals = shapes.wall_normals(config.mesh, *config.moving)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    slopes = dict(rows.tolist())
    values = np.array([slopes[node] for node in nodes.tolist()])
    return -values[:, None] * normals / np.where(length > 0, length, 1)


def _by_angle(file: pathlib.Path) -> float | None:
    """Finds the derivative by the angle of attack: behind the rows, or in the file .meta beside."""
    sizes = np.fromfile(file, "<i4", count=5)
    is_restart = len(sizes) == 5 and sizes[0] == 535532
    begin = 20 + 33 * int(sizes[1]) + 8 * int(sizes[1]) * int(sizes[2]) if is_restart else -1
    if begin > 0 and file.stat().st_size == begin + 4 + 64:
        fifth = np.fromfile(file, "<f8", count=8, offset=begin + 4)[4]
        return float(fifth)
    for text in (file, file.with_suffix(".meta")):
        if not text.is_file() or (text == file and begin > 0):
            continue
        if found := re.search(rb"SENS_AOA\s*=\s*([-+.\deE]+)", text.read_bytes()):
            return float(found[1])
    return None


@checked
def write_gradient(path: PathLike, gradient: Float[ndarray, " n"], objective: str = "DRAG") -> None:
    """Writes a derivative a line below a line with the name of the objective: `of_grad.dat`.

    **Arguments:**

    - `path`: the file.
    - `gradient`: (n,), in the order of the design variables.
    - `objective`: its name, as `OBJECTIVE_FUNCTION` has it.

    **Raises:** `ValueError` for values that are not finite, and a missing folder.
    """
    values = finite_array("gradient", gradient, (None,))
    lines = [f"{objective} gradient ", *map(repr, values.astype(float).tolist()), ""]
    with complete(output_path(path)) as partial:
        partial.write_text("\n".join(lines), encoding="utf-8")
