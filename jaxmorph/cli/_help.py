"""The pages of help: what stands above and below the flags."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Page:
    """Help of one command: summary, usage, and the text below its flags.

    `long` stands on the long page, `short` on the short one; an empty `short` means that there is only the long page.
    """

    summary: str
    usage: str
    long: str
    short: str = ""


MAIN = """\
examples:
  jaxmorph demo
  jaxmorph info wing.su2
  jaxmorph deform airfoil.su2 rotated.su2 --moving airfoil --fixed farfield \\
      --rotate -5 --about 0.25 0

exit status: 0; 1 when a motion inverts cells or a gate fails; 2 for bad input;
130 when interrupted"""

DEFORM = """\
Each --moving begins a motion of its own; the flags after it, up to the next,
say which. The nodes go, in this order, through the displacement file and the
modes, box, scaling, twisting, bending, rotation and translation. Patches named
again by another --moving go on from there. With --steps N the mesh follows in N
steps, each with 1/N of every angle, factor, translation and displacement.

NAME is a patch, a regular expression for the whole of a name ("motorBike.*"),
or a group that the file has (inGroups of an OpenFOAM case). A patch with faces
that are not named as moving, fixed, symmetry, sliding, periodic or free is an
error: its nodes would follow like inner ones, and may leave the boundary.
With --decomposed the parts processor* of an OpenFOAM case go one by one, under
mpiexec (jaxmorph[mpi]) several at a time; OUT has them all, or is not written.
With --ranges N an SU2 or CGNS file goes by ranges of N nodes and N cells:
memory is that of the surface and of one range.

Cyclic patches of an OpenFOAM case, and periodic interfaces of a CGNS file, are
periodic where no flag names them. Likewise nodes of a case's symmetry and
symmetryPlane patches, and of the axis between wedges, stay in their plane.
--fixed may be left out where no patch is left to stay.

A box is a TOML file: low and high (two corners), points (how many control
points each way), and for each that moves a [[moved]] with at (its numbers, from
0) and by (its displacement). It may have degree (of B-splines) and continuity
(k holds the k + 1 outer layers). Nodes outside of it stay.

Instead of low and high it may have corners, eight in the order of a cell (in 2-D
four). Bumps of Hicks and Henne are such a file with upper and lower, lists of
[centre, height], and width (3); class and shape functions (CST) have lists of
weights and the ordinate of the edge, and exponents. Both are added across the
chord, which is found in 2-D, or is given by nose, tail and up.

A job is a TOML file with the names of the flags: file, output, fixed, ..., and
a [[moving]] (patches, rotate, about, ...) for each motion; in it modes are
[["FILE", AMPLITUDE], ...], a box a file or a table. Paths in it are relative to
its folder. Flags beside --job win.

Design variables are the numbers of the motions, in the units of the flags:
displacement, mode[0], box[1,2,0], hicks-henne.upper[0], cst.lower[1], scale,
twist, bend, rotate, translate[0].
--set gives them other values; a whole list is NAME=NUMBER,NUMBER. Where several
motions have one of the name, begin with the motion's: flap.rotate=5. A job may
have a table set.

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
  a half wing on its symmetry plane, twisted and bent along its span y:
    jaxmorph deform wing.su2 bent.su2 --moving wing --fixed farfield \\
        --symmetry symmetry --along 0 1 0 --axis 1 0 0 --twist -3 --bend 8 \\
        --picture bent.html
  a blade between the sides of its passage, which repeat each other:
    jaxmorph deform cascade.su2 pitched.su2 --moving blade --rotate 10 \\
        --fixed inlet outlet --periodic lower upper
  a flap and a slat, each about its hinge, judged by checkMesh's limits:
    jaxmorph deform wing.su2 flaps.vtu --fixed wing farfield \\
        --moving flap --rotate 10 --about 0.8 0 0 --axis 0 1 0 \\
        --moving slat --rotate -5 --about 0.1 0 0 --axis 0 1 0 \\
        --preset checkmesh --save-job flaps.toml
  the same from its job, in four steps:
    jaxmorph deform --job flaps.toml --steps 4
  the same with another angle of the flap:
    jaxmorph deform --job flaps.toml --set flap.rotate=12

exit status: 0; 1 when the motion inverts cells or a gate fails (OUT is then not
written unless --allow-inverted is given); 2 for bad input"""

DEFORM_SHORT = """\
Scaling, twists, bends, modes, free-form boxes, design variables; free, sliding
and periodic patches; methods, quality limits, jobs: jaxmorph deform --help-all

examples:
  jaxmorph deform airfoil.su2 pitched.su2 --moving airfoil --fixed farfield \\
      --rotate -15 --about 0.25 0 --steps 3
  jaxmorph deform airfoil.su2 bumped.su2 --moving airfoil --fixed farfield \\
      --displacement surface.dat
  jaxmorph deform wing.su2 up.su2 --moving wing --fixed farfield \\
      --symmetry symmetry --rotate 2 --axis 0 1 0 --picture up.html

exit status: 0; 1 when the motion inverts cells or a gate fails; 2 for bad input"""

MODES = """\
Every mode file at every amplitude, through one plan, several at a time. Times
of a series are the amplitudes where one mode's go up, else the cases' numbers.

examples:
  the first mode of a wing at five amplitudes, for ParaView:
    jaxmorph modes wing.su2 flutter.pvd --moving wing --fixed farfield \\
        --symmetry symmetry --mode mode1.csv --amplitude -0.2 -0.1 0 0.1 0.2
  a mesh for each of twenty design variables, shapes_0001.su2 and so on:
    jaxmorph modes airfoil.su2 shapes.su2 --moving airfoil --fixed farfield \\
        --mode bumps/*.npz --amplitude 0.01

exit status: 0; 1 when a motion inverts cells or a gate fails (its mesh is then
not written unless --allow-inverted is given); 2 for bad input"""

MODES_SHORT = """\
Other methods, limits of quality, output for machines: jaxmorph modes --help-all

examples:
  jaxmorph modes wing.su2 flutter.pvd --moving wing --fixed farfield \\
      --symmetry symmetry --mode mode1.csv --amplitude -0.2 -0.1 0 0.1 0.2
  jaxmorph modes airfoil.su2 shapes.su2 --moving airfoil --fixed farfield \\
      --mode bumps/*.npz --amplitude 0.01

exit status: 0; 1 when a motion inverts cells or a gate fails; 2 for bad input"""

_SENSITIVITY_EXAMPLES = """\
examples:
  SU2's volume sensitivities to those of the wall's nodes:
    jaxmorph sensitivity airfoil.su2 volume_sens.csv wall_sens.csv \\
        --moving airfoil --fixed farfield
  on to twist, box and all else that a job moves by:
    jaxmorph sensitivity --job wing.toml volume_sens.csv variables.json

exit status: 0; 2 for bad input"""

SENSITIVITY = (
    """\
The transpose of deform, at the mesh as it is, for the same patches and method.
Rows of OUT have the node ids of IN.

With --job it goes on to the design variables that deform's --set names: OUT has
the name, value and derivative of each, per degree for angles. SENS then belongs
to the mesh that the job writes.

"""
    + _SENSITIVITY_EXAMPLES
)

SENSITIVITY_SHORT = (
    """\
Methods, other values of design variables, output for machines:
jaxmorph sensitivity --help-all

"""
    + _SENSITIVITY_EXAMPLES
)

SU2 = """\
Design variables, markers, steps and file names are those of the config file:
DV_KIND, DV_PARAM, DV_VALUE, DV_MARKER, MARKER_SYM, DEFORM_NONLINEAR_ITER,
FFD_*, MESH_FILENAME, MESH_OUT_FILENAME. Markers in neither list stay. Options
of flow solvers are not looked at; a kind that is not taken is an error.

def writes the mesh, and with it the boxes of the file with their control points
moved; DV_KIND= FFD_SETTING writes the boxes of FFD_DEFINITION into it. dot
writes GRAD_OBJFUNC_FILENAME: the derivatives at the mesh as it is, from the
first file that is there of SOLUTION_ADJ_FILENAME, VOLUME_SENS_FILENAME and
SURFACE_SENS_FILENAME.

examples:
  jaxmorph su2 def config.cfg
  jaxmorph su2 dot config.cfg
  jaxmorph su2 dot --definition config.cfg --sensitivity restart_adj_cd.csv

exit status: 0; 1 when the motion inverts cells (the mesh is then not written
unless --allow-inverted is given); 2 for bad input"""

QUALITY = """\
Skewness: 0 ideal, 1 degenerate. Aspect ratio: 1 ideal. Means are weighted by
area or volume. With FILE2, the same mesh with other coordinates, cells count as
inverted when they are so relative to FILE, and ratios are of FILE2 to FILE.

examples:
  jaxmorph quality airfoil.su2
  jaxmorph quality airfoil.su2 pitched.su2 --max-non-orthogonality 70

exit status: 0; 1 when FILE2 inverts cells, FILE alone has inverted ones, or a
gate fails; 2 for bad input"""

INFO = """\
example:
  jaxmorph info airfoil.su2"""

DEMO = """\
examples:
  jaxmorph demo
  jaxmorph demo agard445 --output results"""

PAGES = {
    "deform": Page(
        "move patches of a mesh, and the mesh with them",
        """IN OUT --moving NAME ... MOTION ... [--moving ...]
           --fixed NAME ... [--symmetry NAME ...] [METHOD ...] [GATE ...]
       jaxmorph deform --job FILE""",
        DEFORM,
        DEFORM_SHORT,
    ),
    "modes": Page(
        "move a mesh by many shapes or amplitudes at once",
        """IN OUT --moving NAME ... --fixed NAME ... --mode FILE ...
           [--amplitude A ...] [--symmetry NAME ...] [METHOD ...] [GATE ...]""",
        MODES,
        MODES_SHORT,
    ),
    "sensitivity": Page(
        "pull an adjoint solver's dJ/d(volume nodes) back to the moving nodes",
        """IN SENS OUT --moving NAME ... --fixed NAME ...
           [--symmetry NAME ...] [METHOD ...]
       jaxmorph sensitivity --job FILE SENS OUT""",
        SENSITIVITY,
        SENSITIVITY_SHORT,
    ),
    "su2": Page(
        "do what SU2_DEF and SU2_DOT do, from SU2's config file",
        """def CONFIG [METHOD ...]
       jaxmorph su2 dot CONFIG [--sensitivity SENS]""",
        SU2,
    ),
    "quality": Page("quality of a mesh's cells", "FILE [FILE2] [GATE ...]", QUALITY),
    "info": Page("what a mesh file holds", "FILE", INFO),
    "demo": Page("a test case of the paper: tables, pictures, meshes", "[CASE] [-o DIR]", DEMO),
}
"""By the name of the command."""
