"""The commands and their flags."""

import argparse
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import _help
from ._groups import Job, Moving, Part
from ._parser import Parser, meant

METHODS = (
    *("default", "published", "rbf", "graph"),
    *("elasticity", "laplacian", "biharmonic", "springs", "torsional", "inverse-distance", "compact"),
)
RENAMED = {"paper": "default", "dgm": "graph"}
"""Methods by the names that they had."""

GATES = {
    "max_aspect_ratio": "largest aspect ratio",
    "max_non_orthogonality": "largest non-orthogonality in degrees",
    "max_skewness": "largest skewness of a cell, 0 to 1",
    "max_face_skewness": "largest skewness of a face, as checkMesh's",
    "max_face_aspect_ratio": "largest aspect ratio from areas of faces, as checkMesh's",
    "min_jacobian_ratio": "smallest corner Jacobian over its initial value",
}
"""Quality gates, by the names of their flags."""

PRESETS = {"checkmesh": {"max_face_aspect_ratio": 1000.0, "max_non_orthogonality": 70.0, "max_face_skewness": 4.0}}
"""OpenFOAM's checkMesh: `primitiveMesh::aspectThreshold_`, `nonOrthThreshold_`, `skewThreshold_`."""

_MESH = "a mesh: SU2 (.su2), VTK (.vtu, .vtk), gmsh (.msh), CGNS (.cgns), PLOT3D (.xyz, .p3d), or an OpenFOAM case"

Add = Callable[..., argparse.Action]


def parser(*, is_short: bool = True) -> tuple[Parser, dict[str, Parser]]:
    """Builds the parser of the whole command line, and a dict with the parser of each command.

    The command's name is parsed as `command`. `is_short` leaves rare flags out of the pages of help.
    """
    top = Parser(prog="jaxmorph", description="Moves meshes with their surfaces, and judges them.", epilog=_help.MAIN)
    top.section()("--version", everyday=True, action=Version, nargs=0, help="show the versions of all that computes")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=Parser)
    parsers = {}
    for name, fill in COMMANDS.items():
        page = _help.PAGES[name]
        is_brief = is_short and bool(page.short)
        description = textwrap.fill(page.summary[0].upper() + page.summary[1:] + ".", 80)
        parsers[name] = commands.add_parser(
            name,
            help=page.summary,
            description=description,
            usage=f"jaxmorph {name} {page.usage}",
            epilog=page.short if is_brief else page.long,
            is_short=is_brief,
        )
        if page.short:
            parsers[name].section()("--help-all", everyday=True, action="help", help="show all flags and more examples")
        fill(parsers[name])
    return top, parsers


class Version(argparse.Action):
    """Prints versions, and ends."""

    def __call__(self, parser, namespace, values, option_string=None):
        from importlib.metadata import version
        from platform import python_version

        import jaxmorph

        others = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
        print(f"jaxmorph {jaxmorph.__version__} ({others}, Python {python_version()})")
        parser.exit()


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


def _deform(command: Parser) -> None:
    add = command.section()
    _input(add)
    what = "where to write it; the ending chooses the format; for a case a new one, or CASE/TIME"
    add("output", everyday=True, metavar="OUT", type=_output, help=what)
    what = "IN is a decomposed OpenFOAM case: take its folders processor* part by part, under mpiexec several at a time"
    add("--decomposed", action="store_true", help=what)
    what = "never hold the whole of an SU2 or CGNS file: read, move, judge and write it by ranges of N nodes, and of N cells"
    add("--ranges", metavar="N", type=int, help=what)
    add("--job", metavar="FILE", type=Path, action=Job, help="read the flags from a TOML file")
    add("--save-job", metavar="FILE", type=_output, help="write such a file of this run")
    what = "draw before and after (.png), in 3-D also a page to turn and deform it (.html)"
    add("--picture", everyday=True, metavar="FILE", type=_output, help=what)
    add = command.section("surface")
    what = 'patches that move: names, or patterns as "wing.*"'
    add("--moving", everyday=True, metavar="NAME", nargs="+", action=Moving, help=what)
    _fixed(add)
    add = command.section("motion of the patches of the last --moving (one at least)")
    _files(add)
    _motion(add)
    _set(command.section("design variables"))
    add = _method(command)
    add("--steps", everyday=True, metavar="N", type=int, default=1, help="steps to make the motion in (default 1)")
    what = "prepare and move N points at a time: less memory until the cells are judged, some more time, the same mesh"
    add("--chunk", metavar="N", type=int, help=what)
    _gates(command)
    add = command.section("when cells are bad")
    add("--allow-inverted", action="store_true", help="write OUT even when cells are inverted or a gate fails")
    what = "do not try more sources and steps for advice"
    add("--no-dry-run", action="store_false", dest="dry_run", help=what)
    _speech(command)


def _modes(command: Parser) -> None:
    add = command.section()
    _input(add)
    what = "a time series, OUT.xdmf with OUT.h5, or OUT.pvd of .vtu files; else files OUT_0001, OUT_0002, ... of its ending"
    add("output", everyday=True, metavar="OUT", type=_output, help=what)
    _surface(command)
    add = command.section("shapes")
    what = "displacements of the moving nodes: rows of node id, x, y[, z], or .npz"
    add("--mode", everyday=True, metavar="FILE", type=Path, nargs="+", required=True, help=what)
    what = "factors for each of them (default 1)"
    add("--amplitude", everyday=True, metavar="A", type=float, nargs="+", default=[1.0], help=what)
    _method(command)
    _gates(command)
    add = command.section("when cells are bad")
    add("--allow-inverted", action="store_true", help="write bad meshes too")
    _speech(command)


def _sensitivity(command: Parser) -> None:
    add = command.section()
    _input(add)
    what = "dJ/d(points) of all nodes: SU2's, OpenFOAM's, rows of node id and dJ/dx, dJ/dy[, dJ/dz], or .npz"
    add("sensitivity", everyday=True, metavar="SENS", type=Path, help=what)
    what = "where to write it: .csv or .npz; with --job .csv or .json"
    add("output", everyday=True, metavar="OUT", type=_output, help=what)
    what = "a job of deform: go on to its design variables (IN is then its file)"
    add("--job", everyday=True, metavar="FILE", type=Path, help=what)
    _set(add)
    _surface(command)
    _method(command)
    _speech(command)


def _su2(command: Parser) -> None:
    add = command.section()
    what = "def moves the mesh as SU2_DEF does, dot projects sensitivities onto design variables as SU2_DOT does"
    add("action", metavar="ACTION", choices=("def", "dot"), help=what)
    add("file", metavar="CONFIG", type=Path, help="SU2's config file; the files it names are relative to its folder")
    what = "dot: dJ/d(nodes) of the volume or of the wall (default: the file that the config names)"
    add("--sensitivity", metavar="SENS", type=Path, help=what)
    add("--output", "-o", metavar="OUT", type=_output, help="where to write (default as the config file says)")
    add("--definition", action="store_true", help="the design variables of DEFINITION_DV in place of DV_KIND")
    _method(command)
    add = command.section("when cells are bad")
    add("--allow-inverted", action="store_true", help="write OUT even when cells are inverted")
    _speech(command)


def _quality(command: Parser) -> None:
    add = command.section()
    add("file", metavar="FILE", type=Path, help=_MESH)
    add("moved", metavar="FILE2", nargs="?", type=Path, help="the same mesh, deformed")
    _gates(command)
    _speech(command)


def _info(command: Parser) -> None:
    command.section()("file", metavar="FILE", type=Path, help=_MESH)
    _speech(command)


def _demo(command: Parser) -> None:
    add = command.section()
    add("case", metavar="CASE", nargs="?", default="naca0015", help="naca0015 (default) or agard445")
    folder = Path("jaxmorph-demo")
    add("--output", "-o", metavar="DIR", type=Path, default=folder, help="where to write (default jaxmorph-demo)")


COMMANDS = {
    "deform": _deform,
    "modes": _modes,
    "sensitivity": _sensitivity,
    "su2": _su2,
    "quality": _quality,
    "info": _info,
    "demo": _demo,
}
"""Functions that add the flags of each command."""


def _input(add: Add) -> None:
    add("file", everyday=True, metavar="IN", type=Path, help=_MESH)


def _surface(command: Parser) -> None:
    """Adds the flags of patches that share one motion; `deform` has a motion for each group."""
    add = command.section("surface")
    what = 'patches that move: names, or patterns as "wing.*"'
    add("--moving", everyday=True, metavar="NAME", nargs="+", default=[], help=what)
    _fixed(add)


def _fixed(add: Add) -> None:
    add("--fixed", everyday=True, metavar="NAME", nargs="+", default=[], help="patches that stay")
    what = "plane patches in which nodes slide"
    add("--symmetry", everyday=True, metavar="NAME", nargs="+", default=[], help=what)
    what = "patches whose nodes move along their faces"
    add("--sliding", metavar="NAME", nargs="+", action="extend", default=[], help=what)
    what = "pairs of patches of which the second repeats the first, one name after the other"
    add("--periodic", metavar="NAME", nargs="+", action="extend", default=[], help=what)
    what = "patches that may leave their place: their nodes follow like inner ones"
    add("--free", metavar="NAME", nargs="+", action="extend", default=[], help=what)


def _method(command: Parser) -> Add:
    add = command.section("method")
    what = (
        "default: reduced radial basis functions, corrected near the wall; published: corrected by Delaunay graph mapping, "
        "as in the paper; rbf: all surface nodes as sources; graph: Delaunay graph mapping alone; elasticity, laplacian, "
        "biharmonic, springs, torsional: solved on the cells; inverse-distance; compact: radial basis functions of compact support"
    )
    add("--method", metavar="NAME", choices=METHODS, type=_method_name, default="default", help=what)
    what = "about how many nodes of the moving patches are sources"
    add("--sources", everyday=True, metavar="N", type=int, help=what)
    what = "precision of the calculation; float32 takes half the memory, and is too coarse for boundary layers"
    add("--dtype", choices=("float64", "float32"), default="float64", help=what)
    return add


def _method_name(word: str) -> str:
    if word in RENAMED:
        raise argparse.ArgumentTypeError(f"{word!r} is now called {RENAMED[word]!r}")
    if word not in METHODS:
        raise argparse.ArgumentTypeError(
            f"there is no method {word!r}{meant(word, METHODS)} (methods: {', '.join(METHODS)})"
        )
    return word


def _files(add: Add) -> None:
    what = "rows of node id, x, y[, z]; or .npz, .stl, .obj"
    add("--displacement", everyday=True, metavar="FILE", type=Path, action=Part, help=what)
    what = "the surface (.stl, .obj, .npz) that --displacement's is the moved one of"
    add("--displacement-from", metavar="FILE", type=Path, action=Part, help=what)
    what = "what x, y[, z] of the file are: new positions (default), or displacements"
    add("--displacement-is", choices=("position", "displacement"), action=Part, help=what)
    what = "a file of displacements, times a number; may come several times"
    add("--mode", metavar=("FILE", "AMPLITUDE"), nargs=2, action=Part, help=what)
    add("--box", metavar="FILE", action=Part, help="a free-form deformation box, see below")
    what = "bumps of Hicks and Henne on an airfoil's sides, see below"
    add("--hicks-henne", metavar="FILE", action=Part, help=what)
    add("--cst", metavar="FILE", action=Part, help="class and shape functions to add to its sides, see below")
    what = "its lattice for ParaView, before and after: FILE_before.vts, FILE_after.vts"
    add("--lattice", metavar="FILE.vts", type=Path, action=Part, help=what)


def _motion(add: Add) -> None:
    numbers: dict[str, Any] = {"type": float, "nargs": "+", "action": Part}
    angle: dict[str, Any] = {"metavar": "DEG", "type": float, "action": Part}
    vector: dict[str, Any] = {"metavar": ("X", "Y"), **numbers}
    add("--scale", metavar="S", **numbers, help="factor, or one for each coordinate")
    add("--twist", **angle, help="degrees by which the end of the line along --along is turned about it, 3-D only")
    what = "degrees by which that line becomes an arc, towards the cross product of --axis and --along"
    add("--bend", **angle, help=what)
    add("--rotate", everyday=True, **angle, help="degrees, counterclockwise; right-handed about --axis")
    add("--translate", everyday=True, **vector, help="vector to translate by")
    add("--about", everyday=True, **vector, help="point to scale, twist, bend, rotate about (the origin)")
    add("--axis", everyday=True, **vector, help="axis of rotation and bending, 3-D only")
    add("--along", **vector, help="line from --about of twisting and bending")
    what = "its length; default as far as the patches reach"
    add("--length", metavar="L", type=float, action=Part, help=what)
    add("--name", metavar="NAME", action=Part, help="what --set calls this motion (default its patches)")


def _set(add: Add) -> None:
    what = "other numbers for named parts of the motion, such as twist=2 or 'box[1,2,0]=0.1'"
    add("--set", metavar="NAME=NUMBER[,...]", nargs="+", action="extend", type=_change, default=[], help=what)


def _change(word: str) -> tuple[str, tuple[float, ...]]:
    name, _, numbers = word.rpartition("=")
    try:
        values = tuple(map(float, numbers.split(",")))
    except ValueError:
        values = ()
    if not name or not values:
        raise argparse.ArgumentTypeError(f"{word!r} is not NAME=NUMBER or NAME=NUMBER,NUMBER,...")
    return name, values


def _gates(command: Parser) -> None:
    add = command.section("quality gates")
    for name, what in GATES.items():
        add(f"--{name.replace('_', '-')}", metavar="X", type=float, help=what)
    what = "limits of OpenFOAM's checkMesh, by its own measures: aspect ratio 1000, 70 degrees, skewness 4"
    add("--preset", choices=tuple(PRESETS), help=what)


def _speech(command: Parser) -> None:
    add = command.section("output")
    add("--json", action="store_true", help="one JSON object on standard output in place of text")
    add("--verbose", action="store_true", help="how long each stage took")
