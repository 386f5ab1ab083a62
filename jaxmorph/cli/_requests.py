"""What each command is asked for: its flags as fields. The parser, job files and pages of help are built from them."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any, ClassVar

from jaxmorph._advice.methods import METHODS

from ._groups import SEVERAL, WHAT_MOVES, Group, Job
from ._parser import Fields, flag, flag_of, one_of, part, positional, several, switch

MESH = "a mesh: SU2 (.su2), VTK (.vtu, .vtk), gmsh (.msh), CGNS (.cgns), PLOT3D (.xyz, .p3d), or an OpenFOAM case"

PRESETS = {"checkmesh": {"max_face_aspect_ratio": 1000.0, "max_non_orthogonality": 70.0, "max_face_skewness": 4.0}}
"""OpenFOAM's checkMesh: `primitiveMesh::aspectThreshold_`, `nonOrthThreshold_`, `skewThreshold_`."""

NAMES = [entry.name for entry in METHODS]


def _output(name: str) -> Path:
    """Reads the name of what is written. A path forgets the slash at its end, which the name of a file does not have."""
    path = Path(name)
    if name.endswith("/") and path.suffix.strip(".0123456789") and not path.is_dir():
        from jaxmorph._host.package.files import file_path

        try:
            file_path(name)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None
    return path


def _change(word: str) -> tuple[str, tuple[float, ...]]:
    name, _, numbers = word.rpartition("=")
    try:
        values = tuple(map(float, numbers.split(",")))
    except ValueError:
        values = ()
    if not name or not values:
        raise argparse.ArgumentTypeError(f"{word!r} is not NAME=NUMBER or NAME=NUMBER,NUMBER,...")
    return name, values


@dataclasses.dataclass(frozen=True)
class Boundary:
    """Patches that stay, lie in a plane, slide, repeat, and follow like inner nodes: names, patterns or groups."""

    SECTION: ClassVar = "surface"

    fixed: tuple[str, ...] = flag("patches that stay", everyday=True, **SEVERAL)
    symmetry: tuple[str, ...] = flag("plane patches in which nodes slide", everyday=True, **SEVERAL)
    sliding: tuple[str, ...] = flag("patches whose nodes move along their faces", action="extend", **SEVERAL)
    periodic: tuple[str, ...] = flag(
        "pairs of patches of which the second repeats the first, one name after the other", action="extend", **SEVERAL
    )
    free: tuple[str, ...] = flag(
        "patches that may leave their place: their nodes follow like inner ones", action="extend", **SEVERAL
    )


@dataclasses.dataclass(frozen=True)
class Method:
    """The method by its name, how many sources it has on the moving patches (None: its own choice), and the precision."""

    SECTION: ClassVar = "method"

    method: str = flag(
        "a method of the list below (default default)",
        metavar="NAME",
        choices=NAMES,
        type=one_of("method", NAMES),
        default="default",
    )
    sources: int | None = flag(
        "about how many nodes of the moving patches are sources", metavar="N", type=int, everyday=True
    )
    dtype: str = flag(
        "precision of the calculation; float32 takes half the memory, and is too coarse for boundary layers",
        choices=("float64", "float32"),
        default="float64",
    )


@dataclasses.dataclass(frozen=True)
class Gates:
    """Limits of quality, by the names of their flags."""

    SECTION: ClassVar = "quality gates"

    max_aspect_ratio: float | None = flag("largest aspect ratio", metavar="X", type=float)
    max_non_orthogonality: float | None = flag("largest non-orthogonality in degrees", metavar="X", type=float)
    max_skewness: float | None = flag("largest skewness of a cell, 0 to 1", metavar="X", type=float)
    max_face_skewness: float | None = flag("largest skewness of a face, as checkMesh's", metavar="X", type=float)
    max_face_aspect_ratio: float | None = flag(
        "largest aspect ratio from areas of faces, as checkMesh's", metavar="X", type=float
    )
    min_jacobian_ratio: float | None = flag("smallest corner Jacobian over its initial value", metavar="X", type=float)
    preset: str | None = flag(
        "limits of OpenFOAM's checkMesh, by its own measures: aspect ratio 1000, 70 degrees, skewness 4",
        choices=tuple(PRESETS),
    )

    def __post_init__(self):
        wrong = [name for name, limit in self.limits.items() if limit != limit]
        if wrong:
            raise ValueError(f"{flag_of(wrong[0])} needs a number, found nan.")

    @property
    def limits(self) -> dict[str, float]:
        """Limits by the names of their flags: those of the preset, and of flags, which win."""
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "preset"}
        limits = PRESETS.get(self.preset or "", {}) | {name: limit for name, limit in own.items() if limit is not None}
        return {name: limits[name] for name in own if name in limits}


@dataclasses.dataclass(frozen=True)
class Speech:
    """How a command speaks."""

    SECTION: ClassVar = "output"

    json: bool = switch("one JSON object on standard output in place of text")
    verbose: bool = switch("how long each stage took")


CHANGES: dict[str, Any] = {
    "metavar": "NAME=NUMBER[,...]",
    "nargs": "+",
    "action": "extend",
    "type": _change,
    "default": (),
}
CHANGES_HELP = "other numbers for named parts of the motion, such as twist=2 or 'box[1,2,0]=0.1'"


@dataclasses.dataclass(frozen=True)
class Deform:
    """Request of `jaxmorph deform`; `set` are changes to the motion, by name."""

    file: Path = positional(MESH, "IN", type=Path)
    output: Path = positional(
        "where to write it; the ending chooses the format; for a case a new one, or CASE/TIME", "OUT", type=_output
    )
    decomposed: bool = switch(
        "IN is a decomposed OpenFOAM case: take its folders processor* part by part, under mpiexec several at a time"
    )
    job: Path | None = flag("read the flags from a TOML file", metavar="FILE", type=Path, action=Job)
    save_job: Path | None = flag("write such a file of this run", metavar="FILE", type=_output)
    picture: Path | None = flag(
        "draw before and after (.png), in 3-D also a page to turn and deform it (.html)",
        metavar="FILE",
        type=_output,
        everyday=True,
    )
    groups: tuple[Group, ...] = several(Group)
    boundary: Boundary = part(Boundary)
    set: tuple[tuple[str, tuple[float, ...]], ...] = flag(CHANGES_HELP, section="design variables", **CHANGES)
    method: Method = part(Method)
    steps: int = flag(
        "steps to make the motion in (default 1)", metavar="N", type=int, default=1, section="method", everyday=True
    )
    chunk: int | None = flag(
        "prepare and move N points at a time: less memory until the cells are judged, some more time, the same mesh",
        metavar="N",
        type=int,
        section="method",
    )
    gates: Gates = part(Gates)
    allow_inverted: bool = switch(
        "write OUT even when cells are inverted or a gate fails", section="when cells are bad"
    )
    dry_run: bool = switch(
        "do not try more sources and steps for advice", "--no-dry-run", default=True, section="when cells are bad"
    )
    speech: Speech = part(Speech)

    @property
    def run(self) -> str:
        return "_decomposed.deform_parts" if self.decomposed else "_deform.deform"

    @property
    def moving(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for group in self.groups for name in group.patches))


@dataclasses.dataclass(frozen=True)
class Modes:
    """Request of `jaxmorph modes`."""

    run: ClassVar = "_modes.modes"

    file: Path = positional(MESH, "IN", type=Path)
    output: Path = positional(
        "a time series, OUT.pvd of .vtu files; else files OUT_0001, OUT_0002, ... of its ending", "OUT", type=_output
    )
    moving: tuple[str, ...] = flag(WHAT_MOVES, section="surface", everyday=True, **SEVERAL)
    boundary: Boundary = part(Boundary)
    mode: tuple[Path, ...] = flag(
        "displacements of the moving nodes: rows of node id, x, y[, z], or .npz",
        metavar="FILE",
        type=Path,
        nargs="+",
        required=True,
        default=(),
        section="shapes",
        everyday=True,
    )
    amplitude: tuple[float, ...] = flag(
        "factors for each of them (default 1)",
        metavar="A",
        type=float,
        nargs="+",
        default=(1.0,),
        section="shapes",
        everyday=True,
    )
    method: Method = part(Method)
    gates: Gates = part(Gates)
    allow_inverted: bool = switch("write bad meshes too", section="when cells are bad")
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Request of `jaxmorph sensitivity`; with a job on to what it moves by."""

    run: ClassVar = "_sensitivity.sensitivity"

    file: Path = positional(MESH, "IN", type=Path)
    sensitivity: Path = positional(
        "dJ/d(points) of all nodes: SU2's, OpenFOAM's, rows of node id and dJ/dx, dJ/dy[, dJ/dz], or .npz",
        "SENS",
        type=Path,
    )
    output: Path = positional("where to write it: .csv or .npz; with --job .csv or .json", "OUT", type=_output)
    job: Path | None = flag(
        "a job of deform: go on to its design variables (IN is then its file)",
        metavar="FILE",
        type=Path,
        everyday=True,
    )
    set: tuple[tuple[str, tuple[float, ...]], ...] = flag(CHANGES_HELP, **CHANGES)
    moving: tuple[str, ...] = flag(WHAT_MOVES, section="surface", everyday=True, **SEVERAL)
    boundary: Boundary = part(Boundary)
    method: Method = part(Method)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Quality:
    """Request of `jaxmorph quality`. `moved` is the file of the same mesh, moved."""

    run: ClassVar = "_inspect.quality"

    file: Path = positional(MESH, "FILE", type=Path)
    moved: Path | None = positional("the same mesh, deformed", "FILE2", nargs="?", type=Path)
    gates: Gates = part(Gates)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Info:
    """Request of `jaxmorph info`."""

    run: ClassVar = "_inspect.info"

    file: Path = positional(MESH, "FILE", type=Path)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Demo:
    """Request of `jaxmorph demo`."""

    run: ClassVar = "_inspect.demo"

    case: str = positional("naca0015 (default) or agard445", "CASE", nargs="?", default="naca0015")
    output: Path = flag(
        "where to write (default jaxmorph-demo)",
        "--output",
        "-o",
        metavar="DIR",
        type=Path,
        default=Path("jaxmorph-demo"),
    )


Request = Deform | Modes | Sensitivity | Quality | Info | Demo

COMMANDS: dict[str, Fields] = {
    "deform": Deform,
    "modes": Modes,
    "sensitivity": Sensitivity,
    "quality": Quality,
    "info": Info,
    "demo": Demo,
}
"""Requests by the name of their command."""
