"""The request of each command: its flags as fields."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any, ClassVar

from ._groups import WHAT_MOVES, Group, Job
from ._parser import Fields, flag, part, positional, several, switch
from ._parts import SEVERAL, Boundary, Gates, Method, Speech

MESH = "a mesh file (.su2, .vtu, .vtk, .msh, .cgns, .med, .exo, .e, .xyz, .p3d ...) or an OpenFOAM case"
ZONE = "of an SU2 file with several zones the zone IZONE= N alone; all others are written as they are"


def _output(name: str) -> Path:
    """Reads the name of an output.

    A path forgets the slash at its end, which the name of a file does not have.
    """
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


CHANGES: dict[str, Any] = {
    "metavar": "NAME=NUMBER[,...]",
    "nargs": "+",
    "action": "extend",
    "type": _change,
    "default": (),
}
CHANGES_HELP = "new values of design variables, such as twist=2 or 'box[1,2,0]=0.1'"


@dataclasses.dataclass(frozen=True)
class Deform:
    """Request of `jaxmorph deform`; `set` are changes to the motion, by name."""

    file: Path = positional(MESH, "IN", type=Path)
    output: Path = positional(
        "the new mesh, in the format of its ending; for an OpenFOAM case a new folder, or CASE/TIME",
        "OUT",
        type=_output,
    )
    decomposed: bool = switch(
        "IN is a decomposed OpenFOAM case: move its folders processor* one by one, or several at a time under mpiexec"
    )
    job: Path | None = flag("read the flags from a TOML file", metavar="FILE", type=Path, action=Job)
    save_job: Path | None = flag("write a TOML file with the flags of this run", metavar="FILE", type=_output)
    picture: Path | None = flag(
        "draw the mesh before and after (.png); in 3-D also as a page to turn and deform (.html)",
        metavar="FILE",
        type=_output,
        everyday=True,
    )
    zone: int | None = flag(ZONE, metavar="N", type=int)
    groups: tuple[Group, ...] = several(Group)
    boundary: Boundary = part(Boundary)
    set: tuple[tuple[str, tuple[float, ...]], ...] = flag(CHANGES_HELP, section="design variables", **CHANGES)
    method: Method = part(Method)
    steps: int = flag("number of steps (default 1)", metavar="N", type=int, default=1, section="method", everyday=True)
    chunk: int | None = flag(
        "prepare and move N points at a time: less memory until the cells are judged, a little more time",
        metavar="N",
        type=int,
        section="method",
    )
    gates: Gates = part(Gates)
    allow_inverted: bool = switch(
        "write OUT even when cells are inverted or a gate fails", section="when cells are bad"
    )
    dry_run: bool = switch(
        "do not try other flags for advice", "--no-dry-run", default=True, section="when cells are bad"
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
        "a time series OUT.pvd of .vtu files; with another ending one file a case, OUT_0001, OUT_0002, ...",
        "OUT",
        type=_output,
    )
    moving: tuple[str, ...] = flag(WHAT_MOVES, section="surface", everyday=True, action="extend", **SEVERAL)
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
        "factors for each mode (default 1)",
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
    """Request of `jaxmorph sensitivity`; with a job the result is by design variables."""

    run: ClassVar = "_sensitivity.sensitivity"

    file: Path = positional(MESH, "IN", type=Path)
    sensitivity: Path = positional(
        "dJ/d(points) of all nodes: SU2's, OpenFOAM's, rows of node id and dJ/dx, dJ/dy[, dJ/dz], or .npz",
        "SENS",
        type=Path,
    )
    output: Path = positional(
        "where to write dJ/d(moving nodes): .csv or .npz; with --job .csv or .json", "OUT", type=_output
    )
    job: Path | None = flag(
        "a job of deform: take derivatives by its design variables (leave IN out)",
        metavar="FILE",
        type=Path,
        everyday=True,
    )
    set: tuple[tuple[str, tuple[float, ...]], ...] = flag(CHANGES_HELP, **CHANGES)
    moving: tuple[str, ...] = flag(WHAT_MOVES, section="surface", everyday=True, action="extend", **SEVERAL)
    boundary: Boundary = part(Boundary)
    method: Method = part(Method)
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class SU2:
    """Request of `jaxmorph su2`: `action` is `def` or `dot`."""

    run: ClassVar = "_su2.run"

    action: str = positional(
        "def moves the mesh as SU2_DEF does, dot projects sensitivities onto design variables as SU2_DOT does",
        "ACTION",
        choices=("def", "dot"),
    )
    file: Path = positional("SU2's config file; the files it names are relative to its folder", "CONFIG", type=Path)
    sensitivity: Path | None = flag(
        "dot: dJ/d(nodes) of the volume or of the wall (default: the file that the config names)",
        metavar="SENS",
        type=Path,
    )
    output: Path | None = flag(
        "where to write (default as the config file says)", "--output", "-o", metavar="OUT", type=_output
    )
    definition: bool = switch("the design variables of DEFINITION_DV in place of DV_KIND")
    method: Method = part(Method)
    allow_inverted: bool = switch("write OUT even when cells are inverted", section="when cells are bad")
    speech: Speech = part(Speech)


@dataclasses.dataclass(frozen=True)
class Quality:
    """Request of `jaxmorph quality`. `moved` is the file of the moved mesh."""

    run: ClassVar = "_inspect.quality"

    file: Path = positional(MESH, "FILE", type=Path)
    moved: Path | None = positional("the same mesh, deformed", "FILE2", nargs="?", type=Path)
    proof: bool = switch("prove that cells fold nowhere inside, or show where they do")
    zone: int | None = flag("of SU2 files with several zones the zone IZONE= N", metavar="N", type=int)
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

    case: str = positional("naca0015 (default)", "CASE", nargs="?", default="naca0015")
    output: Path = flag(
        "where to write (default jaxmorph-demo)",
        "--output",
        "-o",
        metavar="DIR",
        type=Path,
        default=Path("jaxmorph-demo"),
    )


Request = Deform | Modes | Sensitivity | SU2 | Quality | Info | Demo

COMMANDS: dict[str, Fields] = {
    "deform": Deform,
    "modes": Modes,
    "sensitivity": Sensitivity,
    "su2": SU2,
    "quality": Quality,
    "info": Info,
    "demo": Demo,
}
"""Requests by the name of their command."""
