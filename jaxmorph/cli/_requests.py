"""The request of each command: its flags as fields."""

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any, ClassVar

import jaxmorph as jm

from ._names import completer
from ._parser import Angle, Fields, flag, one_of, part, positional, several, switch

MESH = "a mesh file (.su2, .vtu, .vtk, .msh, .cgns, .med, .exo, .e, .xyz, .p3d ...) or an OpenFOAM case"
ZONE = "of an SU2 file with several zones the zone IZONE= N alone; all others are written as they are"
WHAT_MOVES = 'patches that move: names, or patterns as "wing.*"'
NAMES, DEMOS = [*jm.METHODS], ["naca0015"]

AUTO = "auto"  # as many steps as it takes
BAD, OUTPUT = "when cells are bad", ("--output", "-o")
SHAPES: dict[str, Any] = {"section": "shapes", "everyday": True}

Table = dict[str, Any]


def table(word: str) -> Path | Table:
    try:
        return json.loads(word) if word.lstrip().startswith("{") else Path(word)
    except (json.JSONDecodeError, RecursionError) as error:
        raise argparse.ArgumentTypeError(f"not a table in JSON ({error})") from None


def steps(word: str) -> int | str:
    try:
        return AUTO if word == AUTO else int(word)
    except ValueError:
        raise argparse.ArgumentTypeError(f"steps are a whole number or {AUTO}, found {word!r}") from None


def _output(name: str) -> Path:
    path = Path(name)  # which forgets a slash at the end
    if name.endswith("/") and path.suffix.strip(".0123456789") and not path.is_dir():
        raise argparse.ArgumentTypeError(f"{name}: ends as a folder does, but a file is written. Remove the /.")
    return path


PICTURE: dict[str, Any] = {"type": _output, "everyday": True}


def _change(word: str) -> tuple[str, tuple[float, ...]]:
    name, _, numbers = word.rpartition("=")
    try:
        values = tuple(map(float, numbers.split(",")))
    except ValueError:
        values = ()
    if not name or not values:
        raise argparse.ArgumentTypeError(f"{word!r} is not NAME=NUMBER or NAME=NUMBER,NUMBER,...")
    return name, values


TABLE: dict[str, Any] = {"type": table, "metavar": "FILE"}
CHANGES: dict[str, Any] = {
    "default": (),
    "metavar": "NAME=NUMBER[,...]",
    "nargs": "+",
    "action": "extend",
    "type": _change,
}
CHANGES_HELP = "new values of design variables, such as twist=2 or 'box[1,2,0]=0.1'"


def _patches(what: str, *names: str, **settings: Any) -> Any:
    several = {"default": (), "metavar": "NAME", "nargs": "+", "action": "extend", "completer": completer}
    return flag(what, *names, **several | settings)


class InGroup(argparse.Action):
    """Sets a field of the last group; motion flags before the first `--moving` belong to it."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        groups = namespace.groups = getattr(namespace, "groups", [])
        if not groups or (self.dest == "patches" and groups[-1].patches):
            groups.append(MotionFlags())
        group = groups[-1]
        if self.dest in group.flags:
            parser.error(f"{option_string} twice for one --moving. Begin another motion of the patches by --moving.")
        if self.dest == "mode":
            values = (*group.mode, _mode(parser, *values))
        else:
            group.flags.add(self.dest)
        setattr(group, self.dest, tuple(values) if self.dest == "patches" else values)


def _mode(parser: argparse.ArgumentParser, file: str, amplitude: str) -> tuple[str, float]:
    try:
        return file, float(amplitude)
    except ValueError:
        parser.error(f"argument --mode: the amplitude of {file} is a number, found {amplitude!r}.")


@dataclasses.dataclass
class MotionFlags:
    """Patches that move and their motion: `--moving` and the flags after it."""

    SECTION: ClassVar = "motion of the patches of the last --moving (at least one flag)"
    SETTINGS: ClassVar = {"action": InGroup}

    patches: tuple[str, ...] = _patches(WHAT_MOVES, "--moving", section="surface", everyday=True, action=InGroup)
    displacement: Path | None = flag("new positions: node id, x, y[, z]; .npz, .stl, .obj", everyday=True)
    displacement_from: Path | None = flag("the undeformed surface (.stl, .obj, .npz) of a deformed one")
    displacement_is: str = flag(
        "whether x, y[, z] of the file are new positions (default) or displacements",
        choices=("position", "displacement"),
        default="position",
    )
    mode: tuple[tuple[str, float], ...] = flag(
        "a file of displacements, and a factor; may be repeated", metavar=("FILE", "AMPLITUDE"), nargs=2, default=()
    )
    box: Path | Table | None = flag("a free-form deformation box, see below", **TABLE)
    hicks_henne: Path | Table | None = flag("bumps of Hicks and Henne on an airfoil's sides, see below", **TABLE)
    cst: Path | Table | None = flag("class and shape functions to add to its sides, see below", **TABLE)
    lattice: Path | None = flag("the box's lattice for ParaView: FILE_before.vts, FILE_after.vts", metavar="FILE.vts")
    scale: list[float] | None = flag("factor, or a factor for each coordinate", metavar="S")
    twist: Angle | None = flag("degrees by which the end of the line --along turns about the line, 3-D only")
    bend: Angle | None = flag("degrees of the arc of the line --along, towards the cross product of --axis and --along")
    rotate: Angle | None = flag("degrees, counterclockwise; right-handed about --axis", everyday=True)
    translate: list[float] | None = flag("vector to translate by", everyday=True)
    about: list[float] | None = flag("centre of scaling, twist, bend, rotation (the origin)", everyday=True)
    axis: list[float] | None = flag("axis of rotation and bend, 3-D only", everyday=True)
    along: list[float] | None = flag("direction of the line from --about, for twist and bend")
    length: float | None = flag("length of the line (default: up to the end of the patches)", metavar="L")
    name: str | None = flag("name of this motion for --set (default: its patches)", metavar="NAME")
    flags: set[str] = dataclasses.field(default_factory=set, repr=False, compare=False)

    @property
    def title(self) -> str:
        return ", ".join(self.patches)


MOTIONS = ("rotate", "translate", "scale", "bend", "twist", "mode", "displacement", "box", "hicks_henne", "cst")
"""The fields of a group that move something."""


@dataclasses.dataclass(frozen=True)
class BoundaryFlags:
    """Patches by what they do: names, patterns or groups."""

    SECTION: ClassVar = "surface"

    fixed: tuple[str, ...] = _patches("patches that stay", everyday=True)
    symmetry: tuple[str, ...] = _patches("plane patches in which nodes slide", everyday=True)
    sliding: tuple[str, ...] = _patches("patches whose nodes slide along their faces")
    periodic: tuple[str, ...] = _patches("pairs of patches that repeat each other, one name after the other")
    free: tuple[str, ...] = _patches("patches whose nodes follow like inner nodes")


@dataclasses.dataclass(frozen=True)
class MethodFlags:
    """The method's name, its number of sources (None: its own default), and the precision."""

    SECTION: ClassVar = "method"

    method: str = flag(
        "one of the methods listed below",
        metavar="NAME",
        choices=NAMES,
        type=one_of("method", NAMES),
        default="default",
    )
    sources: int | None = flag("about how many nodes of the moving patches are sources", everyday=True)
    dtype: str = flag(
        "precision of the calculation; float32 takes half the memory, and is too coarse for boundary layers",
        choices=("float64", "float32"),
        default="float64",
    )


@dataclasses.dataclass(frozen=True)
class Gates:
    SECTION: ClassVar = "quality gates"

    max_aspect_ratio: float | None = flag("largest aspect ratio")
    max_non_orthogonality: float | None = flag("largest non-orthogonality in degrees")
    max_skewness: float | None = flag("largest skewness of a cell, 0 to 1")
    max_face_skewness: float | None = flag("largest skewness of a face, as checkMesh measures it")
    max_face_aspect_ratio: float | None = flag("largest aspect ratio from areas of faces, as checkMesh measures it")
    min_jacobian_ratio: float | None = flag("smallest corner Jacobian over its initial value")
    proven: bool = switch(
        "every cell is proven to fold nowhere inside, by bounds on det J: during the whole motion, or in a mesh alone"
    )
    preset: str | None = flag(
        "limits of OpenFOAM's checkMesh, by its own measures: aspect ratio 1000, 70 degrees, skewness 4",
        choices=("checkmesh",),
    )

    @property
    def limits(self) -> "jm.Limits":
        flags = {name: limit for name, limit in vars(self).items() if name != "preset" and limit not in (None, False)}
        return dataclasses.replace(jm.Limits.checkmesh() if self.preset else jm.Limits(), **flags)


LIMITS = tuple(field.name for field in dataclasses.fields(Gates) if field.type == float | None)


@dataclasses.dataclass(frozen=True)
class Speech:
    SECTION: ClassVar = "output"

    json: bool = switch("print one JSON object in place of text")
    verbose: bool = switch("print how long each stage took")


@dataclasses.dataclass(frozen=True)
class Deform:
    file: Path = positional(MESH, "IN")
    output: Path = positional(
        "the new mesh, in the format of its ending; for a case a new folder, or CASE/TIME", "OUT", type=_output
    )
    decomposed: bool = switch("IN is a decomposed OpenFOAM case: move its parts one by one, or under mpiexec several")
    job: Path | None = flag("read the flags from a TOML file")
    save_job: Path | None = flag("write a TOML file with the flags of this run", type=_output)
    picture: Path | None = flag("draw the mesh before and after: .png, in 3-D also a page (.html)", **PICTURE)
    zone: int | None = flag(ZONE)
    groups: tuple[MotionFlags, ...] = several(MotionFlags)
    boundary: BoundaryFlags = part(BoundaryFlags)
    set: tuple[tuple[str, tuple[float, ...]], ...] = flag(CHANGES_HELP, section="design variables", **CHANGES)
    method: MethodFlags = part(MethodFlags)
    steps: int | str = flag(
        "steps (default 1), or auto: the fewest without folds",
        default=1,
        metavar="N",
        type=steps,
        section="method",
        everyday=True,
    )
    chunk: int | None = flag(
        "prepare and move N points at a time: less memory before cells are judged, more time", section="method"
    )
    gates: Gates = part(Gates)
    allow_inverted: bool = switch("write OUT even when cells are inverted or a gate fails", section=BAD)
    dry_run: bool = switch("do not try other flags for advice", "--no-dry-run", default=True, section=BAD)
    speech: Speech = part(Speech)

    @property
    def step_count(self) -> int:
        """Steps; 1 until their number is sought."""
        return 1 if isinstance(self.steps, str) else self.steps

    @property
    def moving(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for group in self.groups for name in group.patches))


@dataclasses.dataclass(frozen=True)
class ModesRequest:
    file: Path = positional(MESH, "IN")
    output: Path = positional(
        "a time series OUT.pvd of .vtu files; else one file a case, OUT_0001, ...", "OUT", type=_output
    )
    moving: tuple[str, ...] = _patches(WHAT_MOVES, section="surface", everyday=True)
    boundary: BoundaryFlags = part(BoundaryFlags)
    mode: tuple[Path, ...] = flag(
        "displacements of the moving nodes: rows of node id, x, y[, z], or .npz", required=True, **SHAPES
    )
    amplitude: tuple[float, ...] = flag("factors for each mode (default 1)", metavar="A", default=(1.0,), **SHAPES)
    method: MethodFlags = part(MethodFlags)
    gates: Gates = part(Gates)
    allow_inverted: bool = switch("write bad meshes too", section=BAD)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class SensitivityRequest:
    """Request of `jaxmorph sensitivity`; with a job the result is by design variables."""

    file: Path = positional(MESH, "IN")
    sensitivity: Path = positional(
        "dJ/d(points): SU2's, OpenFOAM's, rows of node id, dJ/dx, dJ/dy[, dJ/dz], or .npz", "SENS"
    )
    output: Path = positional("dJ/d(moving nodes), .csv or .npz; with --job .csv or .json", "OUT", type=_output)
    job: Path | None = flag("a job of deform: derivatives by its design variables (leave IN out)", everyday=True)
    set: tuple[tuple[str, tuple[float, ...]], ...] = flag(CHANGES_HELP, **CHANGES)
    moving: tuple[str, ...] = _patches(WHAT_MOVES, section="surface", everyday=True)
    boundary: BoundaryFlags = part(BoundaryFlags)
    method: MethodFlags = part(MethodFlags)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class ExportRequest:
    file: Path = positional(MESH, "IN")
    output: Path | None = positional("the plan; not given for an OpenFOAM case", "OUT", nargs="?", type=_output)
    zone: int | None = flag("of an SU2 file with several zones the zone IZONE= N")
    moving: tuple[str, ...] = _patches(WHAT_MOVES, section="surface", everyday=True)
    boundary: BoundaryFlags = part(BoundaryFlags)
    method: MethodFlags = part(MethodFlags)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class NativeRequest:
    """Request of `jaxmorph native`, which has no flags."""


@dataclasses.dataclass(frozen=True)
class SU2:
    """Request of `jaxmorph su2`: `action` is `def` or `dot`."""

    action: str = positional("def moves the mesh, dot projects sensitivities", "ACTION", choices=("def", "dot"))
    file: Path = positional("SU2's config file; the files it names are relative to its folder", "CONFIG")
    sensitivity: Path | None = flag(
        "dot: dJ/d(nodes) of the volume or wall (default as the config file says)", metavar="SENS"
    )
    output: Path | None = flag("where to write (default as the config file says)", *OUTPUT, metavar="OUT", type=_output)
    definition: bool = switch("the design variables of DEFINITION_DV in place of DV_KIND")
    zone: int | None = flag(ZONE)
    picture: Path | None = flag("def: draw the mesh before and after: .png, in 3-D also .html", **PICTURE)
    method: MethodFlags = part(MethodFlags)
    allow_inverted: bool = switch("write OUT even when cells are inverted", section=BAD)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Quality:
    """Request of `jaxmorph quality`. `moved` is the file of the moved mesh."""

    file: Path = positional(MESH, "FILE")
    moved: Path | None = positional("the same mesh, deformed", "FILE2", nargs="?")
    proof: bool = switch("prove that cells fold nowhere inside, or show where they do")
    zone: int | None = flag("of SU2 files with several zones the zone IZONE= N")
    picture: Path | None = flag("draw the mesh by its skewness: .png, in 3-D also a page (.html)", **PICTURE)
    gates: Gates = part(Gates)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Info:
    file: Path = positional(MESH, "FILE")
    picture: Path | None = flag("draw the mesh by its skewness: .png, in 3-D also a page (.html)", **PICTURE)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Convert:
    file: Path = positional(MESH, "IN")
    output: Path = positional("the same mesh, in the format of its ending", "OUT", type=_output)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Demo:
    case: str = positional(
        "naca0015 (default)", "CASE", nargs="?", default="naca0015", choices=DEMOS, type=one_of("demo", DEMOS)
    )
    output: Path = flag("where to write (default jaxmorph-demo)", *OUTPUT, metavar="DIR", default=Path("jaxmorph-demo"))


Request = (
    Deform | ModesRequest | SensitivityRequest | ExportRequest | NativeRequest | SU2 | Quality | Info | Convert | Demo
)

COMMANDS: dict[str, Fields] = {
    fields.__name__.removesuffix("Request").lower(): fields
    for fields in (
        Deform,
        ModesRequest,
        SensitivityRequest,
        ExportRequest,
        NativeRequest,
        SU2,
        Quality,
        Info,
        Convert,
        Demo,
    )
}
