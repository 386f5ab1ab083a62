"""What the command line understands, and its pages of help."""

import argparse
import pathlib
import re
import textwrap

METHODS = ("paper", "rbf", "dgm")

_MAIN = """\
examples:
  jaxmorph demo
  jaxmorph info wing.su2
  jaxmorph deform airfoil.su2 rotated.su2 --moving airfoil --fixed farfield \\
      --rotate -5 --about 0.25 0

exit status: 0, 1 when cells are inverted, 2 for bad input"""

_DEFORM = """\
The motion takes the moving nodes, in this order, through the displacement file,
scaling, rotation and translation; scaling and rotation are about the same point.
With --steps N the mesh follows in N steps, each with 1/N of the angle, of the
scaling, of the translation and of the file's displacement.

examples:
  pitch nose-up about the quarter chord, in three steps:
    jaxmorph deform airfoil.su2 pitched.su2 --moving airfoil --fixed farfield \\
        --rotate -15 --about 0.25 0 --steps 3
  new positions of the wall from a file with rows of node id, x, y:
    jaxmorph deform airfoil.su2 bumped.su2 --moving airfoil --fixed farfield \\
        --displacement surface.dat
  the motion from one surface to another of the same triangles:
    jaxmorph deform wing.su2 bent.su2 --moving wing --fixed farfield \\
        --displacement bent.stl --displacement-from straight.stl
  a half wing on its symmetry plane:
    jaxmorph deform wing.su2 bent.su2 --moving wing --fixed farfield \\
        --symmetry symmetry --displacement bending.csv \\
        --displacement-is displacement
  a flap and its slat together, 3-D, hinge line along y:
    jaxmorph deform wing.su2 flaps.vtu --moving flap slat --fixed wing farfield \\
        --rotate 10 --about 0.8 0 0 --axis 0 1 0

exit status: 0; 1 when cells are inverted (OUT is then not written unless
--allow-inverted is given); 2 for bad input"""

_QUALITY = """\
Skewness: 0 ideal, 1 degenerate. Aspect ratio: 1 ideal. Means are weighted by area
or volume. With FILE2, the same mesh with other coordinates, cells count as inverted
when they are so relative to FILE, and ratios are of FILE2 to FILE.

examples:
  jaxmorph quality airfoil.su2
  jaxmorph quality airfoil.su2 pitched.su2

exit status: 0; 1 when cells are inverted; 2 for bad input"""

_INFO = """\
example:
  jaxmorph info airfoil.su2"""

_DEMO = """\
examples:
  jaxmorph demo
  jaxmorph demo agard445 --output results"""

_FILES = "SU2 (.su2), VTK (.vtu, .vtk), gmsh (.msh), CGNS (.cgns), PLOT3D (.xyz, .p3d), or an OpenFOAM case"


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with the arguments, and takes -1e-3 for a number."""

    def __init__(self, **settings):
        super().__init__(**settings, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line; the name of the command is in `command`."""
    top = Parser(prog="jaxmorph", description="Moves meshes with their surfaces, and judges them.", epilog=_MAIN)
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_deform(commands)
    quality = _command(commands, "quality", "quality of a mesh's cells", _QUALITY)
    quality.add_argument("file", metavar="FILE", type=pathlib.Path, help=f"a mesh: {_FILES}")
    quality.add_argument("moved", metavar="FILE2", nargs="?", type=pathlib.Path, help="the same mesh, deformed")
    info = _command(commands, "info", "what a mesh file holds", _INFO)
    info.add_argument("file", metavar="FILE", type=pathlib.Path, help=f"a mesh: {_FILES}")
    demo = _command(commands, "demo", "a test case of the paper: tables, pictures, meshes", _DEMO)
    demo.add_argument("case", metavar="CASE", nargs="?", default="naca0015", help="naca0015 (default) or agard445")
    demo.add_argument(
        *("--output", "-o"),
        metavar="DIR",
        type=pathlib.Path,
        default=pathlib.Path("jaxmorph-demo"),
        help="where to write",
    )
    return top


def _command(commands, name: str, summary: str, epilog: str) -> argparse.ArgumentParser:
    description = textwrap.fill(summary[0].upper() + summary[1:] + ".", 80)
    return commands.add_parser(name, help=summary, description=description, epilog=epilog)


def _add_deform(commands) -> None:
    deform = _command(commands, "deform", "move patches of a mesh, and the mesh with them", _DEFORM)
    deform.add_argument("file", metavar="IN", type=pathlib.Path, help=f"a mesh: {_FILES}")
    deform.add_argument(
        "output",
        metavar="OUT",
        type=pathlib.Path,
        help="where to write it; the ending chooses the format; for a case a new one, or CASE/TIME",
    )
    group = deform.add_argument_group("surface")
    group.add_argument("--moving", metavar="NAME", nargs="+", default=[], help="patches that move")
    group.add_argument("--fixed", metavar="NAME", nargs="+", default=[], help="patches that stay")
    group.add_argument(
        "--symmetry", metavar="NAME", nargs="+", default=[], help="plane patches in which nodes slide (one or two)"
    )
    _add_motion(deform.add_argument_group("motion (one at least)"))
    group = deform.add_argument_group("method")
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
    group.add_argument("--steps", metavar="N", type=int, default=1, help="steps to make the motion in (default 1)")
    group.add_argument("--allow-inverted", action="store_true", help="write OUT even when cells are inverted")


def _add_motion(group) -> None:
    number = {"type": float, "nargs": "+"}
    group.add_argument(
        "--displacement", metavar="FILE", type=pathlib.Path, help="rows of node id, x, y[, z]; or .npz, .stl, .obj"
    )
    group.add_argument(
        "--displacement-from",
        metavar="FILE",
        type=pathlib.Path,
        help="the surface (.stl, .obj, .npz) that --displacement's is the moved one of",
    )
    group.add_argument(
        "--displacement-is",
        choices=("position", "displacement"),
        default="position",
        help="what x, y[, z] of the file are: new positions (default), or displacements",
    )
    group.add_argument("--scale", metavar="S", **number, help="factor, or one for each coordinate")
    group.add_argument(
        "--rotate", metavar="DEG", type=float, help="degrees, counterclockwise; right-handed about --axis"
    )
    group.add_argument(
        "--about", metavar=("X", "Y"), **number, help="point to scale and rotate about; default the origin"
    )
    group.add_argument("--axis", metavar=("X", "Y"), **number, help="axis of the rotation, 3-D only")
    group.add_argument("--translate", metavar=("X", "Y"), **number, help="vector to translate by")
