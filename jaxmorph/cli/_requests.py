"""The request of each command: its flags as fields."""

import argparse
import contextlib
import dataclasses
import json
import re
import reprlib
from pathlib import Path
from typing import Any, ClassVar, get_args

import jaxmorph as jm
from jaxmorph.extend import decoded

from ._parser import (
    BAD,
    MOTION,
    Angle,
    ConfigFile,
    Fields,
    Folder,
    MeshFile,
    NewMesh,
    Picture,
    Settings,
    Written,
    flag,
    nest,
    number,
    positional,
    positive,
    switch,
)

MESH = (
    "a mesh file (.su2, .vtu, .vtk, .msh, .cgns, .med, .exo, .e, .xyz, .p3d ...) or an OpenFOAM "
    "case"
)
ZONE = (
    "of an SU2 file with several zones the zone IZONE= N alone; all others are written as they are"
)
WHAT_MOVES = 'patches that move: names, or patterns as "wing.*"'
BY_SKEWNESS = "draw the mesh by its skewness: .png"

AUTO = "auto"  # as many steps as it takes
OUTPUT = ("--output", "-o")
SHAPE_FLAGS: Settings = {"section": "shapes", "everyday": True}
SEVERAL: Settings = {"default": (), "nargs": "+", "action": "extend"}

Table = dict[str, Any]
Ids = tuple[int, ...]
Pairs = tuple[tuple[Ids, Ids], ...]
"""Nodes of a wall, and points of the surface onto which they go."""
Names = tuple[str, ...]
"""Several names, above all of patches."""
Change = tuple[str, tuple[float, ...]]
"""A design variable's name, and its new numbers."""
TAG = re.compile(rb"(?m)^[ \t]*MARKER_?TAG[ \t]*=[ \t]*([^%\r\n]*)")


def list_markers(file: Path) -> list[str]:
    """Lists the names of patches in an SU2 file, without reading the mesh."""
    return [decoded(name.strip()) for name in TAG.findall(file.read_bytes())]


def _completer(prefix: str, parsed_args: argparse.Namespace, **_: object) -> list[str]:
    """Lists patches and groups of the mesh that the words before name; none for what is no mesh."""
    with contextlib.suppress(Exception):  # the shell's line is no place for a fault
        if parsed_args.file.suffix.lower() == ".su2":
            return list_markers(parsed_args.file)
        from jaxmorph import io

        mesh = io.read(parsed_args.file, tags=parsed_args.tags)
        return [*mesh.patches, *mesh.groups]
    return []


def table(word: str) -> Path | Table:
    try:
        return json.loads(word) if word.lstrip().startswith("{") else Path(word)
    except (json.JSONDecodeError, RecursionError) as error:
        raise argparse.ArgumentTypeError(f"not a table in JSON ({error})") from None


def pairs(word: str) -> Pairs:
    try:
        found = tuple((tuple(own), tuple(other)) for own, other in json.loads(word))
    except (ValueError, TypeError, RecursionError):
        found = None
    if found is None or not all(
        type(node) is int for pair in found for ids in pair for node in ids
    ):
        raise argparse.ArgumentTypeError(
            f"pairs of lists of ids, [[[0, 1], [5, 6]], ...], expected, found {reprlib.repr(word)}"
        )
    return found


def steps(word: str) -> int | str:
    return AUTO if word == AUTO else positive(word)


def _change(word: str) -> Change:
    name, _, numbers = word.rpartition("=")
    try:
        return name, tuple(map(number, numbers.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{word!r} is not NAME=NUMBER or NAME=NUMBER,NUMBER,..."
        ) from None


TABLE: Settings = {"type": table, "metavar": "FILE"}
CHANGES = SEVERAL | {"metavar": "NAME=NUMBER[,...]", "type": _change}
CHANGES_HELP = "new values of design variables, such as twist=2 or 'box[1,2,0]=0.1'"


def _patch_flag(what: str, *names: str, **settings: Any) -> Any:
    return flag(what, *names, **SEVERAL | {"metavar": "NAME", "completer": _completer} | settings)


class InGroup(argparse.Action):
    """Sets a field of the last group; motion flags before the first `--moving` belong to it."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        groups = namespace.groups = getattr(namespace, "groups", [])
        if not groups or (self.dest == "patches" and groups[-1].patches):
            groups.append(MotionFlags())
        group = groups[-1]
        if self.dest in group.flags:
            parser.error(
                f"{option_string} twice for one --moving. Begin another motion of the patches by "
                "--moving."
            )
        group.flags |= {self.dest} - {"mode"}  # which may be repeated
        if self.dest == "mode":
            try:
                values = (*group.mode, (Path(values[0]), number(values[1])))
            except ValueError:
                parser.error(
                    f"argument --mode: the amplitude of {values[0]} is a number, found "
                    f"{values[1]!r}"
                )
        setattr(group, self.dest, tuple(values) if self.dest == "patches" else values)


@dataclasses.dataclass
class MotionFlags:
    """Patches that move and their motion: `--moving` and the flags after it."""

    SECTION: ClassVar = MOTION
    SETTINGS: ClassVar = {"action": InGroup}

    patches: Names = _patch_flag(
        WHAT_MOVES, "--moving", section="surface", everyday=True, action=InGroup
    )
    displacement: Path | None = flag(
        "new positions: node id, x, y[, z]; .npz, .stl, .obj", everyday=True
    )
    displacement_is: str = flag(
        "whether x, y[, z] of the file are new positions (default) or displacements",
        choices=("position", "displacement"),
        default="position",
    )
    onto: Path | None = flag("a surface to go onto: .stl, .step, .obj, .npz, a mesh", everyday=True)
    onto_scale: float | None = flag(
        "factor of that surface's coordinates: 0.001 for millimetres where the mesh is in metres"
    )
    onto_length: float | None = flag(
        "stay near that surface, without waves shorter than L: for a scan with noise, or one that "
        "is cut off (a twentieth of the patches' length, say)",
        metavar="L",
    )
    onto_angle: Angle | None = flag(
        "degrees by which faces turn at a sharp edge, and edges go onto edges (60)"
    )
    onto_features: Pairs | None = flag(
        "pairs of curves that go onto each other, in JSON: [[[node, ...], [point of the surface, "
        "...]], ...]",
        type=pairs,
        metavar="PAIRS",
    )
    mode: tuple[tuple[Path, float], ...] = flag(
        "a file of displacements, and a factor; may be repeated",
        metavar=("FILE", "AMPLITUDE"),
        nargs=2,
        default=(),
    )
    box: Path | Table | None = flag("a free-form deformation box, see below", **TABLE)
    scale: list[float] | None = flag("factor, or a factor for each coordinate", metavar="S")
    twist: Angle | None = flag(
        "degrees by which the end of the line --along turns about the line, 3-D only"
    )
    bend: Angle | None = flag(
        "degrees of the arc of the line --along, towards the cross product of --axis and --along"
    )
    rotate: Angle | None = flag(
        "degrees, counterclockwise; right-handed about --axis", everyday=True
    )
    translate: list[float] | None = flag("vector to translate by", everyday=True)
    about: list[float] | None = flag(
        "centre of scaling, twist, bend, rotation (the origin)", everyday=True
    )
    axis: list[float] | None = flag("axis of rotation and bend, 3-D only", everyday=True)
    along: list[float] | None = flag("direction of the line from --about, for twist and bend")
    length: float | None = flag(
        "length of the line (default: up to the end of the patches)", metavar="L"
    )
    name: str | None = flag("name of this motion for --set (default: its patches)", metavar="NAME")
    flags: set[str] = dataclasses.field(default_factory=set, repr=False, compare=False)

    @property
    def title(self) -> str:
        return ", ".join(self.patches)


MOTIONS = (
    "rotate",
    "translate",
    "scale",
    "bend",
    "twist",
    "mode",
    "displacement",
    "onto",
    "box",
)
"""The fields of a group that move something."""


@dataclasses.dataclass(frozen=True)
class BoundaryFlags:
    SECTION: ClassVar = "surface"

    fixed: Names = _patch_flag("patches that stay", everyday=True)
    symmetry: Names = _patch_flag("plane patches in which nodes slide", everyday=True)
    sliding: Names = _patch_flag("patches whose nodes slide along their faces")
    periodic: Names = _patch_flag(
        "pairs of patches that repeat each other, one name after the other"
    )
    free: Names = _patch_flag("patches whose nodes follow like inner nodes")


@dataclasses.dataclass(frozen=True)
class MethodFlags:
    SECTION: ClassVar = "method"

    method: str = flag(
        "one of the methods listed below", metavar="NAME", choices=[*jm.METHODS], default="default"
    )
    sources: int | None = flag(
        "about how many nodes of the moving patches are sources", everyday=True
    )
    dtype: str = flag(
        "precision of the calculation; float32 takes half the memory, and is too coarse for "
        "boundary layers",
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
    max_face_aspect_ratio: float | None = flag(
        "largest aspect ratio from areas of faces, as checkMesh measures it"
    )
    min_jacobian_ratio: float | None = flag("smallest corner Jacobian over its initial value")
    proven: bool = switch(
        "every cell is proven to fold nowhere inside, by bounds on det J: during the whole "
        "motion, or in a mesh alone"
    )
    preset: str | None = flag(
        "limits of OpenFOAM's checkMesh, by its own measures: aspect ratio 1000, 70 degrees, "
        "skewness 4",
        choices=("checkmesh",),
    )

    @property
    def limits(self) -> "jm.Limits":
        flags = {
            name: limit
            for name, limit in vars(self).items()
            if name != "preset" and limit not in (None, False)
        }
        return dataclasses.replace(jm.Limits.checkmesh() if self.preset else jm.Limits(), **flags)


@dataclasses.dataclass(frozen=True)
class Speech:
    SECTION: ClassVar = "output"

    json: bool = switch("print one JSON object in place of text")
    verbose: bool = switch("print how long each stage took")


@dataclasses.dataclass(frozen=True)
class Spoken:
    speech: Speech = nest(Speech)


@dataclasses.dataclass(frozen=True)
class Meshed(Spoken):
    tags: Path | None = flag("an XDMF file of numbered facets of an XDMF mesh: its patches")


@dataclasses.dataclass(frozen=True)
class Planned(Meshed):
    file: MeshFile = positional(MESH, "IN")
    moving: Names = _patch_flag(WHAT_MOVES, section="surface", everyday=True)
    boundary: BoundaryFlags = nest(BoundaryFlags)
    method: MethodFlags = nest(MethodFlags)


@dataclasses.dataclass(frozen=True)
class Deform(Meshed):
    file: MeshFile = positional(MESH, "IN")
    output: NewMesh = positional(
        "the new mesh, in the format of its ending; for a case a new folder, or CASE/TIME", "OUT"
    )
    decomposed: bool = switch(
        "IN is a decomposed OpenFOAM case: move its parts one by one, or under mpiexec several"
    )
    job: Path | None = flag("read the flags from a TOML file")
    save_job: Written | None = flag("write a TOML file with the flags of this run")
    picture: Picture | None = flag("draw the mesh before and after: .png", everyday=True)
    zone: int | None = flag(ZONE)
    groups: tuple[MotionFlags, ...] = dataclasses.field(
        default=(), metadata={"fields": MotionFlags}
    )
    boundary: BoundaryFlags = nest(BoundaryFlags)
    set: tuple[Change, ...] = flag(CHANGES_HELP, section="design variables", **CHANGES)
    method: MethodFlags = nest(MethodFlags)
    steps: int | str = flag(
        "steps (default 1), or auto: the fewest without folds",
        default=1,
        metavar="N",
        type=steps,
        section="method",
        everyday=True,
    )
    chunk: int | None = flag(
        "prepare and move N points at a time: less memory before cells are judged, more time",
        section="method",
    )
    remesh: bool = switch(
        "where the steps do not keep the cells, go on with worn cells replaced by gmsh's",
        section="method",
    )
    gates: Gates = nest(Gates)
    allow_inverted: bool = switch(
        "write OUT even when cells are inverted or a gate fails", section=BAD
    )
    dry_run: bool = switch(
        "do not try other flags for advice", "--no-dry-run", default=True, section=BAD
    )

    @property
    def step_count(self) -> int:
        """Steps; 1 until their number is sought."""
        return 1 if isinstance(self.steps, str) else self.steps

    @property
    def moving(self) -> Names:
        return tuple(dict.fromkeys(name for group in self.groups for name in group.patches))


@dataclasses.dataclass(frozen=True)
class ModesRequest(Planned):
    output: NewMesh = positional(
        "a time series OUT.pvd of .vtu files; else one file a case, OUT_0001, ...", "OUT"
    )
    mode: tuple[Path, ...] = flag(
        "displacements of the moving nodes: rows of node id, x, y[, z], or .npz",
        required=True,
        **SHAPE_FLAGS,
    )
    amplitude: tuple[float, ...] = flag(
        "factors for each mode (default 1)", metavar="A", default=(1.0,), **SHAPE_FLAGS
    )
    gates: Gates = nest(Gates)
    allow_inverted: bool = switch("write bad meshes too", section=BAD)


@dataclasses.dataclass(frozen=True)
class SensitivityRequest(Planned):
    sensitivity: Path = positional(
        "dJ/d(points): SU2's, OpenFOAM's, rows of node id, dJ/dx, dJ/dy[, dJ/dz], or .npz", "SENS"
    )
    output: Written = positional(
        "dJ/d(moving nodes), .csv or .npz; with --job .csv or .json", "OUT"
    )
    job: Path | None = flag(
        "a job of deform: derivatives by its design variables (leave IN out)", everyday=True
    )
    set: tuple[Change, ...] = flag(CHANGES_HELP, **CHANGES)


@dataclasses.dataclass(frozen=True)
class ExportRequest(Planned):
    output: Written | None = positional(
        "the plan; not given for an OpenFOAM case", "OUT", nargs="?"
    )
    zone: int | None = flag("of an SU2 file with several zones the zone IZONE= N")


@dataclasses.dataclass(frozen=True)
class NativeRequest:
    """Request of `jaxmorph native`, which has no flags."""


@dataclasses.dataclass(frozen=True)
class SU2(Spoken):
    action: str = positional(
        "def moves the mesh, dot projects sensitivities, shims is for SU2's own scripts",
        "ACTION",
        choices=("def", "dot", "shims"),
    )
    file: ConfigFile = positional(
        "SU2's config file, with files relative to its folder; shims: the new folder", "CONFIG"
    )
    sensitivity: Path | None = flag(
        "dot: dJ/d(nodes) of the volume or wall (default as the config file says)", metavar="SENS"
    )
    output: Written | None = flag(
        "where to write (default as the config file says)", *OUTPUT, metavar="OUT"
    )
    definition: bool = switch("the design variables of DEFINITION_DV in place of DV_KIND")
    zone: int | None = flag(ZONE)
    picture: Picture | None = flag("def: draw the mesh before and after: .png", everyday=True)
    method: MethodFlags = nest(MethodFlags)
    allow_inverted: bool = switch("write OUT even when cells are inverted", section=BAD)


@dataclasses.dataclass(frozen=True)
class Quality(Meshed):
    file: MeshFile = positional(MESH, "FILE")
    moved: MeshFile | None = positional("the same mesh, deformed", "FILE2", nargs="?")
    proof: bool = switch("prove that cells fold nowhere inside, or show where they do")
    zone: int | None = flag("of SU2 files with several zones the zone IZONE= N")
    picture: Picture | None = flag(BY_SKEWNESS, everyday=True)
    gates: Gates = nest(Gates)


@dataclasses.dataclass(frozen=True)
class Info(Meshed):
    file: MeshFile = positional(MESH, "FILE")
    picture: Picture | None = flag(BY_SKEWNESS, everyday=True)


@dataclasses.dataclass(frozen=True)
class Convert(Meshed):
    file: MeshFile = positional(MESH, "IN")
    output: NewMesh = positional("the same mesh, in the format of its ending", "OUT")


@dataclasses.dataclass(frozen=True)
class Demo:
    case: str = positional(
        "naca0015 (default)", "CASE", nargs="?", default="naca0015", choices=["naca0015"]
    )
    output: Folder = flag(
        "where to write (default jaxmorph-demo)",
        *OUTPUT,
        metavar="DIR",
        default=Path("jaxmorph-demo"),
    )


Request = (
    Deform
    | ModesRequest
    | SensitivityRequest
    | ExportRequest
    | NativeRequest
    | SU2
    | Quality
    | Info
    | Convert
    | Demo
)

COMMANDS: dict[str, Fields] = {
    fields.__name__.removesuffix("Request").lower(): fields for fields in get_args(Request)
}
