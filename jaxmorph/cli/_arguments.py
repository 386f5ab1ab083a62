"""What the command line understands."""

import argparse
import pathlib
import textwrap
from typing import Any

from . import _help
from ._gates import GATES, PRESETS
from ._groups import Job, Moving, Part
from ._parser import Parser

METHODS = ("paper", "rbf", "dgm")

_FILES = "SU2 (.su2), VTK (.vtu, .vtk), gmsh (.msh), CGNS (.cgns), PLOT3D (.xyz, .p3d), or an OpenFOAM case"

_DEFORM = """IN OUT --moving NAME ... MOTION ... [--moving ...]
           --fixed NAME ... [--symmetry NAME ...] [METHOD ...] [GATE ...]
       jaxmorph deform --job FILE"""

_MODES = """IN OUT --moving NAME ... --fixed NAME ... --mode FILE ...
           [--amplitude A ...] [--symmetry NAME ...] [METHOD ...] [GATE ...]"""

_SENSITIVITY = """IN SENS OUT --moving NAME ... --fixed NAME ...
           [--symmetry NAME ...] [METHOD ...]"""


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line; the name of the command is in `command`."""
    top = Parser(prog="jaxmorph", description="Moves meshes with their surfaces, and judges them.", epilog=_help.MAIN)
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_deform(commands)
    _add_modes(commands)
    _add_sensitivity(commands)
    quality = _command(commands, "quality", "quality of a mesh's cells", _help.QUALITY, "FILE [FILE2] [GATE ...]")
    quality.add_argument("file", metavar="FILE", type=pathlib.Path, help=f"a mesh: {_FILES}")
    quality.add_argument("moved", metavar="FILE2", nargs="?", type=pathlib.Path, help="the same mesh, deformed")
    _add_gates(quality)
    _add_speech(quality)
    info = _command(commands, "info", "what a mesh file holds", _help.INFO, "FILE")
    info.add_argument("file", metavar="FILE", type=pathlib.Path, help=f"a mesh: {_FILES}")
    _add_speech(info)
    demo = _command(
        commands, "demo", "a test case of the paper: tables, pictures, meshes", _help.DEMO, "[CASE] [-o DIR]"
    )
    demo.add_argument("case", metavar="CASE", nargs="?", default="naca0015", help="naca0015 (default) or agard445")
    demo.add_argument(
        *("--output", "-o"),
        metavar="DIR",
        type=pathlib.Path,
        default=pathlib.Path("jaxmorph-demo"),
        help="where to write",
    )
    return top


def _command(commands, name: str, summary: str, epilog: str, usage: str, **short: Any) -> argparse.ArgumentParser:
    description = textwrap.fill(summary[0].upper() + summary[1:] + ".", 80)
    usage = f"jaxmorph {name} {usage}"
    return commands.add_parser(name, help=summary, description=description, epilog=epilog, usage=usage, **short)


def _add_deform(commands) -> None:
    short = {"everyday": _help.DEFORM_EVERYDAY, "short_epilog": _help.DEFORM_SHORT}
    what = "move patches of a mesh, and the mesh with them"
    deform = _command(commands, "deform", what, _help.DEFORM, _DEFORM, **short)
    _add_input(deform)
    deform.add_argument(
        "output",
        metavar="OUT",
        type=pathlib.Path,
        help="where to write it; the ending chooses the format; for a case a new one, or CASE/TIME",
    )
    deform.add_argument("--job", metavar="FILE", type=pathlib.Path, action=Job, help="read the flags from a TOML file")
    deform.add_argument("--save-job", metavar="FILE", type=pathlib.Path, help="write such a file of this run")
    what = "draw before and after (.png), in 3-D also a page to turn and deform it (.html)"
    deform.add_argument("--picture", metavar="FILE", type=pathlib.Path, help=what)
    group = deform.add_argument_group("surface")
    group.add_argument("--moving", metavar="NAME", nargs="+", action=Moving, help="patches that move")
    _add_fixed(group)
    group = deform.add_argument_group("motion of the patches of the last --moving (one at least)")
    _add_files(group)
    _add_motion(group)
    method = _add_method(deform)
    method.add_argument("--steps", metavar="N", type=int, default=1, help="steps to make the motion in (default 1)")
    what = "prepare and move N points at a time: less memory until the cells are judged, some more time, the same mesh"
    method.add_argument("--chunk", metavar="N", type=int, help=what)
    _add_gates(deform)
    group = deform.add_argument_group("when cells are bad")
    group.add_argument(
        "--allow-inverted", action="store_true", help="write OUT even when cells are inverted or a gate fails"
    )
    group.add_argument(
        "--no-dry-run", action="store_false", dest="dry_run", help="do not try more sources and steps for advice"
    )
    _add_speech(deform)


def _add_modes(commands) -> None:
    short = {"everyday": _help.MODES_EVERYDAY, "short_epilog": _help.MODES_SHORT}
    what = "move a mesh by many shapes or amplitudes at once"
    modes = _command(commands, "modes", what, _help.MODES, _MODES, **short)
    _add_input(modes)
    what = "a time series, OUT.xdmf with OUT.h5, or OUT.pvd of .vtu files; else files OUT_0001, OUT_0002, ... of its ending"
    modes.add_argument("output", metavar="OUT", type=pathlib.Path, help=what)
    _add_surface(modes)
    group = modes.add_argument_group("shapes")
    group.add_argument(
        "--mode",
        metavar="FILE",
        type=pathlib.Path,
        nargs="+",
        required=True,
        help="displacements of the moving nodes: rows of node id, x, y[, z], or .npz",
    )
    group.add_argument(
        "--amplitude", metavar="A", type=float, nargs="+", default=[1.0], help="factors for each of them (default 1)"
    )
    _add_method(modes)
    _add_gates(modes)
    modes.add_argument("--allow-inverted", action="store_true", help="write bad meshes too")
    _add_speech(modes)


def _add_sensitivity(commands) -> None:
    what = "pull an adjoint solver's dJ/d(volume nodes) back to the moving nodes"
    command = _command(commands, "sensitivity", what, _help.SENSITIVITY, _SENSITIVITY)
    _add_input(command)
    what = "dJ/d(points) of all nodes: SU2's, OpenFOAM's, rows of node id and dJ/dx, dJ/dy[, dJ/dz], or .npz"
    command.add_argument("sensitivity", metavar="SENS", type=pathlib.Path, help=what)
    command.add_argument("output", metavar="OUT", type=pathlib.Path, help="where to write it: .csv or .npz")
    _add_surface(command)
    _add_method(command)
    _add_speech(command)


def _add_input(command: argparse.ArgumentParser) -> None:
    command.add_argument("file", metavar="IN", type=pathlib.Path, help=f"a mesh: {_FILES}")


def _add_surface(command: argparse.ArgumentParser) -> None:
    """For one motion of all moving patches; those of `deform` have one each."""
    group = command.add_argument_group("surface")
    group.add_argument("--moving", metavar="NAME", nargs="+", default=[], help="patches that move")
    _add_fixed(group)


def _add_fixed(group) -> None:
    group.add_argument("--fixed", metavar="NAME", nargs="+", default=[], help="patches that stay")
    group.add_argument(
        "--symmetry", metavar="NAME", nargs="+", default=[], help="plane patches in which nodes slide (one or two)"
    )


def _add_method(command: argparse.ArgumentParser):
    group = command.add_argument_group("method")
    group.add_argument(
        "--method",
        choices=METHODS,
        default="paper",
        help=(
            "paper (default): reduced radial basis functions, corrected by Delaunay graph mapping; "
            "rbf: all surface nodes as sources; dgm: Delaunay graph mapping alone"
        ),
    )
    group.add_argument(
        "--sources", metavar="N", type=int, help="about how many nodes of the moving patches are sources"
    )
    group.add_argument(
        "--dtype",
        choices=("float64", "float32"),
        default="float64",
        help="precision of the calculation; float32 takes half the memory, and is too coarse for boundary layers",
    )
    return group


def _add_files(group) -> None:
    group.add_argument(
        "--displacement",
        metavar="FILE",
        type=pathlib.Path,
        action=Part,
        help="rows of node id, x, y[, z]; or .npz, .stl, .obj",
    )
    group.add_argument(
        "--displacement-from",
        metavar="FILE",
        type=pathlib.Path,
        action=Part,
        help="the surface (.stl, .obj, .npz) that --displacement's is the moved one of",
    )
    group.add_argument(
        "--displacement-is",
        choices=("position", "displacement"),
        action=Part,
        help="what x, y[, z] of the file are: new positions (default), or displacements",
    )
    group.add_argument(
        "--mode",
        metavar=("FILE", "AMPLITUDE"),
        nargs=2,
        action=Part,
        help="a file of displacements, times a number; may come several times",
    )
    group.add_argument("--box", metavar="FILE", action=Part, help="a free-form deformation box, see below")


def _add_motion(group) -> None:
    numbers: dict[str, Any] = {"type": float, "nargs": "+", "action": Part}
    group.add_argument("--scale", metavar="S", **numbers, help="factor, or one for each coordinate")
    for name, what in (
        ("twist", "degrees by which the end of the line along --along is turned about it, 3-D only"),
        ("bend", "degrees by which that line becomes an arc, towards the cross product of --axis and --along"),
        ("rotate", "degrees, counterclockwise; right-handed about --axis"),
    ):
        group.add_argument(f"--{name}", metavar="DEG", type=float, action=Part, help=what)
    group.add_argument("--translate", metavar=("X", "Y"), **numbers, help="vector to translate by")
    group.add_argument(
        "--about", metavar=("X", "Y"), **numbers, help="point to scale, twist, bend, rotate about (the origin)"
    )
    group.add_argument("--axis", metavar=("X", "Y"), **numbers, help="axis of rotation and bending, 3-D only")
    group.add_argument("--along", metavar=("X", "Y"), **numbers, help="line from --about of twisting and bending")
    group.add_argument(
        "--length", metavar="L", type=float, action=Part, help="its length; default as far as the patches reach"
    )


def _add_gates(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("quality gates")
    for name, what in GATES.items():
        group.add_argument(f"--{name.replace('_', '-')}", metavar="X", type=float, help=what)
    group.add_argument(
        "--preset",
        choices=tuple(PRESETS),
        help="limits of OpenFOAM's checkMesh, by its own measures: aspect ratio 1000, 70 degrees, skewness 4",
    )


def _add_speech(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("output")
    group.add_argument("--json", action="store_true", help="one JSON object on standard output in place of text")
    group.add_argument("--verbose", action="store_true", help="how long each stage took")
