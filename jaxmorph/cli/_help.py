"""The pages of help: what stands above and below the flags."""

import dataclasses

from jaxmorph import METHODS

EXAMPLES = "examples:\n"


@dataclasses.dataclass(frozen=True)
class Page:
    """Help of one command: summary, usage, and the text below its flags.

    The short page names what `more` there is, and has the first `few` lines of the examples.
    Without `more` there is only the long page.
    """

    summary: str
    usage: str
    text: str
    more: str = ""
    few: int = 0

    def below(self, is_short: bool) -> str:
        above, _, below = self.text.partition(EXAMPLES)
        if not is_short and "[METHOD ...]" not in self.usage:
            return self.text
        if not is_short:
            lines = [
                f"  {name + ' *' * entry.needs_cells:<17} {entry.sentence}"
                for name, entry in METHODS.items()
            ]
            return "\n".join(
                [f"{above}methods (* is solved on the cells):", *lines, "", EXAMPLES + below]
            )
        examples, _, status = below.partition("\n\n")
        few = "\n".join(examples.split("\n")[: self.few])
        return f"{self.more}\n\n{EXAMPLES}{few}\n\n{status}"


MAIN = """\
examples:
  jaxmorph demo
  jaxmorph info wing.su2
  jaxmorph deform airfoil.su2 rotated.su2 --moving airfoil --fixed farfield \\
      --rotate -5 --about 0.25 0

exit status: 0; 1 when a motion inverts cells or a gate fails; 2 for bad input;
130 when interrupted"""

PAGES = {
    "deform": Page(
        "move patches of a mesh, and the mesh with them",
        """IN OUT --moving NAME ... MOTION ... [--moving ...]
           --fixed NAME ... [--symmetry NAME ...] [METHOD ...] [GATE ...]
       jaxmorph deform --job FILE""",
        """\
Each --moving begins a motion; the flags after it, up to the next --moving,
describe that motion. The order is fixed: displacement file, onto, modes, box,
scaling, twist, bend, rotation, translation. A patch named by several --moving
gets the motions in turn. A node of several patches moves once, and they must
agree there. With --steps N the mesh follows in N steps, each with 1/N of every
angle, factor, translation and displacement; where a displacement file turns the
patches, they turn on the way. --steps auto seeks the fewest steps, up to 16,
that invert no cell, nor go below --min-jacobian-ratio. With --remesh, where the
steps do not keep the cells, the motion is made in N moves (--steps, else 20),
and gmsh replaces worn cells before they break. Layers at patches that only turn
and shift go along. OUT is then a new file: SU2, gmsh, VTK, CGNS, or a new
OpenFOAM case.

NAME is a patch, a regular expression for a whole name ("motorBike.*"), or a
group of the file (inGroups of an OpenFOAM case). Every patch with boundary
faces must be moving, fixed, symmetry, sliding, periodic or free. Nodes of a
free patch follow like inner nodes, and may leave the boundary. --fixed may be
left out if no patch stays.

Cyclic patches of an OpenFOAM case, periodic interfaces of a CGNS file and
groups that gmsh pairs are periodic unless a flag names them. Nodes of an
OpenFOAM case's symmetry and symmetryPlane patches, and of the axis between
wedges, stay in their plane.

--decomposed needs jaxmorph[mpi] for several processes. OUT gets all parts, or
is not written.

A box is a TOML file: low and high (two corners), points (number of control
points in each direction), and a [[moved]] for each control point that moves:
at (its indices, from 0) and by (its displacement). Optional are degree (of
B-splines) and continuity (k keeps the k + 1 outer layers in place). Nodes
outside of the box stay. Corners (eight in the order of a cell, in 2-D four) may
stand in place of low and high.

A job is a TOML file with the flags by name: file, output, fixed, ..., and a
[[moving]] (patches, rotate, about, ...) for each motion. There mode is
[["FILE", AMPLITUDE], ...], and box is a file or a table. Paths are relative to
the folder of the job. Flags on the command line win.

--set changes design variables, the numbers of the motions in the units of the
flags: displacement, mode[0], box[1,2,0], scale, twist, bend, rotate,
translate[0]. NAME=NUMBER,NUMBER changes a whole list. If several motions have a
variable of the name, put the motion's name first: flap.rotate=5. In a job, set
is a table.

The table of quality ends with the first grid line at the moving wall: the
degrees by which its direction to the wall has changed, and the height of its
cells over the undeformed one. Overshoot is the largest motion of an inner node
over the largest motion of the wall; beyond a wall that turns nodes swing wider,
and it is above 1.

--onto takes the patches onto a surface, such as a scan: sharp edges go onto
sharp edges, the border in a symmetry patch onto the surface's section, and the
table tells the distance before and after. Each --moving may have its own.
--onto-features has pairs of curves that belong together, lists of node ids and
of the surface's points: [[[0, 1], [5, 6]], ...].

examples:
  pitch nose-up about the quarter chord, in three steps:
    jaxmorph deform airfoil.su2 pitched.su2 --moving airfoil --fixed farfield \\
        --rotate -15 --about 0.25 0 --steps 3
  new positions of the wall from a file with rows of node id, x, y:
    jaxmorph deform airfoil.su2 bumped.su2 --moving airfoil --fixed farfield \\
        --displacement surface.dat
  a half wing on its symmetry plane, twisted and bent along its span y:
    jaxmorph deform wing.su2 bent.su2 --moving wing --fixed farfield \\
        --symmetry symmetry --along 0 1 0 --axis 1 0 0 --twist -3 --bend 8 \\
        --picture bent.png
  a blade between the sides of its passage, which repeat each other:
    jaxmorph deform cascade.su2 pitched.su2 --moving blade --rotate 10 \\
        --fixed inlet outlet --periodic lower upper
  a flap and a slat, each about its hinge, judged by checkMesh's limits:
    jaxmorph deform wing.su2 flaps.vtu --fixed wing farfield \\
        --moving flap --rotate 10 --about 0.8 0 0 --axis 0 1 0 \\
        --moving slat --rotate -5 --about 0.1 0 0 --axis 0 1 0 \\
        --preset checkmesh --save-job flaps.toml
  a wing in metres onto a scan in millimetres with some noise:
    jaxmorph deform wing.su2 as_built.su2 --moving wing --fixed farfield \\
        --symmetry symmetry --onto scan.stl --onto-scale 0.001 --onto-length 0.1
  that motion from its job, in four steps:
    jaxmorph deform --job flaps.toml --steps 4
  that motion with another angle of the flap:
    jaxmorph deform --job flaps.toml --set flap.rotate=12

exit status: 0; 1 when the motion inverts cells or a gate fails; 2 for bad input""",
        """Scaling, twists, bends, modes, free-form boxes, design variables; free, sliding
and periodic patches; methods, quality limits, jobs: jaxmorph deform --help-all""",
        6,
    ),
    "modes": Page(
        "move a mesh by many shapes or amplitudes at once",
        """IN OUT --moving NAME ... --fixed NAME ... --mode FILE ...
           [--amplitude A ...] [--symmetry NAME ...] [METHOD ...] [GATE ...]""",
        """\
Moves the mesh by every mode file at every amplitude. The times of a series are
the amplitudes if there is one mode and they increase, else 1, 2, 3, ...

examples:
  the first mode of a wing at five amplitudes, for ParaView:
    jaxmorph modes wing.su2 flutter.pvd --moving wing --fixed farfield \\
        --symmetry symmetry --mode mode1.csv --amplitude -0.2 -0.1 0 0.1 0.2
  a mesh for each of twenty design variables, shapes_0001.su2 and so on:
    jaxmorph modes airfoil.su2 shapes.su2 --moving airfoil --fixed farfield \\
        --mode bumps/*.npz --amplitude 0.01

exit status: 0; 1 when a motion inverts cells or a gate fails; 2 for bad input""",
        "Other methods, limits of quality, output for machines: jaxmorph modes --help-all",
        6,
    ),
    "sensitivity": Page(
        "take dJ/d(volume nodes) of an adjoint solver to the moving nodes",
        """IN SENS OUT --moving NAME ... --fixed NAME ...
           [--symmetry NAME ...] [METHOD ...]
       jaxmorph sensitivity --job FILE SENS OUT""",
        """\
The transpose of deform, at the undeformed mesh. Name the patches and the method
as for deform. Rows of OUT have the node ids of IN.

With --job the derivatives go on to the design variables that --set of deform
names. OUT has the name, value and derivative of every variable, per degree for
angles.
SENS must be of the mesh that the job writes.

examples:
  SU2's volume sensitivities to sensitivities of the wall's nodes:
    jaxmorph sensitivity airfoil.su2 volume_sens.csv wall_sens.csv \\
        --moving airfoil --fixed farfield
  derivatives by twist, box and all other design variables of a job:
    jaxmorph sensitivity --job wing.toml volume_sens.csv variables.json

exit status: 0; 2 for bad input""",
        """Methods, other values of design variables, output for machines:
jaxmorph sensitivity --help-all""",
        5,
    ),
    "export": Page(
        "write a plan that moves the mesh inside a running solver",
        """IN OUT --moving NAME ... --fixed NAME ...
           [--symmetry NAME ...] [METHOD ...]
       jaxmorph export CASE [--moving NAME ...] [--fixed NAME ...]""",
        """\
Name the patches and the method as for deform. jmplan.h opens OUT and moves the
mesh by it, from C, C++ and Fortran; jaxmorph native shows its folder. In an
OpenFOAM case the plan is constant/jaxmorph.plan, and each processor* gets one;
a patch that no flag names is what its type in pointDisplacement says.
The method must be linear in the displacement, and not solved on cells.

examples:
  jaxmorph export wing.su2 wing.plan --moving wing --fixed farfield
  jaxmorph export case
  jaxmorph export case --moving flap   # which preCICE moves

exit status: 0; 2 for bad input""",
    ),
    "native": Page(
        "show the folder of jmplan.h and of the motion solver for OpenFOAM",
        "",
        """\
example:
  cc -O3 -I$(jaxmorph native) solver.c -lm""",
    ),
    "su2": Page(
        "do what SU2_DEF and SU2_DOT do, from SU2's config file",
        """def CONFIG [METHOD ...]
       jaxmorph su2 dot CONFIG [--sensitivity SENS]
       jaxmorph su2 shims FOLDER""",
        """\
The config file gives design variables, markers, steps and file names:
DV_KIND, DV_PARAM, DV_VALUE, DV_MARKER, MARKER_SYM, DEFORM_NONLINEAR_ITER,
FFD_*, MESH_FILENAME, MESH_OUT_FILENAME. Markers that neither DV_MARKER nor
MARKER_SYM names stay. Options of flow solvers are not read. A DV_KIND that
jaxmorph does not know is an error.

def writes the mesh, and with it the boxes of the file with their control points
moved; DV_KIND= FFD_SETTING writes the boxes of FFD_DEFINITION into it. dot
writes GRAD_OBJFUNC_FILENAME: the derivatives at the mesh as it is, from the
first file that is there of SOLUTION_ADJ_FILENAME, VOLUME_SENS_FILENAME,
SURFACE_SENS_FILENAME and RESTART_ADJ_FILENAME.

shims writes a folder for SU2_RUN: shape_optimization.py and other scripts then
run jaxmorph where they call SU2_DEF, SU2_DOT and SU2_DOT_AD. All else in
SU2_RUN, or beside SU2_CFD, is linked.

examples:
  jaxmorph su2 def config.cfg --picture moved.png
  jaxmorph su2 dot config.cfg
  jaxmorph su2 dot --definition config.cfg --sensitivity restart_adj_cd.csv
  jaxmorph su2 shims su2_run && export SU2_RUN=$PWD/su2_run

exit status: 0; 1 when the motion inverts cells (the mesh is then not written
unless --allow-inverted is given); 2 for bad input""",
    ),
    "quality": Page(
        "measure the quality of a mesh's cells",
        "FILE [FILE2] [GATE ...]",
        """\
Skewness: 0 ideal, 1 degenerate. Aspect ratio: 1 ideal. Means are weighted by
area or volume. FILE2 is the mesh of FILE with other coordinates: inverted cells
and ratios are then relative to FILE.

examples:
  jaxmorph quality airfoil.su2 --picture airfoil.png
  jaxmorph quality airfoil.su2 pitched.su2 --max-non-orthogonality 70
  jaxmorph quality wing.su2 --proof

exit status: 0; 1 when FILE2 inverts cells, FILE alone has inverted ones, or a
gate fails; 2 for bad input""",
    ),
    "info": Page(
        "show what a mesh file holds",
        "FILE",
        """\
example:
  jaxmorph info airfoil.su2""",
    ),
    "convert": Page(
        "write a mesh in another format",
        "IN OUT",
        """\
What IN knows and OUT will not is told. SU2, gmsh and VTK files are written from
any mesh; other formats take back only their own.

examples:
  jaxmorph convert elbow.msh elbow.su2
  jaxmorph convert case mesh.vtu""",
    ),
    "demo": Page(
        "run a test case of the paper: tables, pictures, meshes",
        "[CASE] [-o DIR]",
        """\
examples:
  jaxmorph demo
  jaxmorph demo --output results""",
    ),
}
