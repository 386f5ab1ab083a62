"""Cases of OpenFOAM whose walls move while it runs, by its movers and by jaxmorph's, which is compiled here."""

import functools
import os
import pathlib
import re
import shutil
import subprocess

import foam
import meshes
import numpy as np
import pytest
from documents import ROOT

from jaxmorph import native
from jaxmorph.cli import main
from jaxmorph.io.openfoam.file import load_file, read_patches


def build(folder):
    """Compiles the motion solver for Debian's OpenFOAM, as users do; returns the library, and what was said.

    JAXMORPH_OPENFOAM_SOURCE is a folder that native/openfoam/debian_headers.sh has filled.
    """
    foam.need_openfoam()
    source = os.environ.get("JAXMORPH_OPENFOAM_SOURCE")
    if not source:
        message = "JAXMORPH_OPENFOAM_SOURCE is not set: .ci/nightly fetches OpenFOAM's headers"
        if os.environ.get("JAXMORPH_OPENFOAM") == "required":
            pytest.fail(message)
        pytest.skip(message)
    shutil.copytree(native.folder, folder / "native")
    script = '. "$0/etc/bashrc"; FOAM_USER_LIBBIN=$PWD wmake libso native/openfoam 2>&1'
    done = subprocess.run(
        ["bash", "-c", script, source], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-3000:]
    return folder / "libjaxmorphMotion.so", done.stdout


def write_plan(case, *flags):
    """Writes the plan of a case and of its parts."""
    assert main(["export", str(case), *flags]) == 0


AIRFOIL = ("--moving", "walls", "--fixed", "inlet", "outlet")
WING = ("--moving", "wing", "--fixed", "farfield", "--symmetry", "root", "tip")
BOX = ("--moving", "ahead", "behind", "--fixed", "sides")
CHANNEL = ("--moving", "bottomWall", "--fixed", "topWall")
STRIP = ("--moving", "hole", "--fixed", "far")
"""What moves in the cases below, and what is fixed."""


def moved(case, plan=None):
    """Writes the plan of a case, if it has one, and moves the mesh to the end; returns the case."""
    if plan is not None:
        write_plan(case, *plan)
    foam.run(case, "moveDynamicMesh")
    return case


def moved_in_parts(case, plan):
    """The same in three processes."""
    foam.run(case, "decomposePar")
    write_plan(case, *plan)
    foam.run(case, *foam.PARALLEL, "3", "moveDynamicMesh", "-parallel")
    return case


MOVERS = {
    "jaxmorph": "",
    "displacementLaplacian": "diffusivity quadratic inverseDistance ({walls});",
    "displacementSBRStress": "diffusivity quadratic inverseDistance ({walls});",
}
HEAD = "FoamFile {{ version 2.0; format ascii; class {}; object {}; }}\n"
SCHEMES = """ddtSchemes { default Euler; } gradSchemes { default cellLimited Gauss linear 1; }
divSchemes
{
    default none; div(phi,U) Gauss linearUpwind grad(U); div(phi,nuTilda) Gauss upwind; div(sigmaD) Gauss linear;
    div((nuEff*dev2(T(grad(U))))) Gauss linear;
}
laplacianSchemes { default Gauss linear limited corrected 0.5; } interpolationSchemes { default linear; }
snGradSchemes { default limited corrected 0.5; } wallDist { method meshWave; }
"""
SOLUTION = """solvers
{
    cellDisplacement { solver GAMG; smoother GaussSeidel; tolerance 1e-12; relTol 0; minIter 40; maxIter 60; }
    "(p|pFinal|pcorr.*)" { solver GAMG; smoother GaussSeidel; tolerance 1e-8; relTol 0; }
    "(U|nuTilda)(|Final)" { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-8; relTol 0; }
}
PIMPLE { correctPhi yes; nOuterCorrectors 2; nCorrectors 2; nNonOrthogonalCorrectors 1; }
relaxationFactors { equations { ".*" 1; } }
"""
CONTROL = """application pimpleFoam; startFrom latestTime; startTime 0; stopAt endTime; endTime {end}; deltaT {delta};
writeControl timeStep; writeInterval {interval}; writeFormat {form}; writePrecision {digits}; timePrecision 6;
runTimeModifiable no;
"""
PARTS = "numberOfSubdomains 3; method hierarchical; hierarchicalCoeffs { n (3 1 1); delta 0.001; order xyz; }\n"
STILL = "type fixedValue; value uniform (0 0 0);"


def write_dictionary(case, name, text, kind="dictionary"):
    path = case / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(HEAD.format(kind, path.name) + text)


def write_displacement(case, boundary, time="0"):
    """Writes pointDisplacement: `boundary` names an entry's text for each patch."""
    entries = "".join(f'    "{patch}" {{ {text} }}\n' for patch, text in boundary.items())
    write_boundary(case, entries, time)


def write_boundary(case, entries, time="0"):
    """Writes pointDisplacement with this text between the braces of boundaryField."""
    text = f"dimensions [0 1 0 0 0 0 0]; internalField uniform (0 0 0);\nboundaryField\n{{\n{entries}}}\n"
    write_dictionary(case, f"{time}/pointDisplacement", text, "pointVectorField")


def page_blocks(section):
    """The commands, dictionaries and other blocks in a section of the page on OpenFOAM."""
    page = (ROOT / "docs" / "pages" / "openfoam.md").read_text()
    text = page.partition(f"\n## {section}\n")[2].partition("\n## ")[0]
    assert text
    blocks = re.findall(r"^```(\S*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return [[block for kind, block in blocks if kind == mine] for mine in ("sh", "c++", "")]


def write_motion(case, mover, library, walls="walls"):
    """Writes which mover moves the mesh."""
    text = (
        f'dynamicFvMesh dynamicMotionSolverFvMesh;\nmotionSolverLibs ("libfvMotionSolvers.so" "{library}");\n'
        f"motionSolver {mover};\n{mover}Coeffs {{ {MOVERS[mover].format(walls=walls)} }}\n"
    )
    write_dictionary(case, "constant/dynamicMeshDict", text)


def write_control(case, end=1, delta=0.1, form="binary", digits=17, interval=1):
    """Writes settings with which moveDynamicMesh and pimpleFoam run."""
    control = CONTROL.format(end=end, delta=delta, form=form, digits=digits, interval=interval)
    write_dictionary(case, "system/controlDict", control)
    write_dictionary(case, "system/fvSchemes", SCHEMES)
    write_dictionary(case, "system/fvSolution", SOLUTION)
    write_dictionary(case, "system/decomposeParDict", PARTS)


def swing(degrees):
    """The boundary of airFoil2D: the wall has turned by this angle at the time 1, about a quarter of its chord."""
    motion = f"axis (0 0 -1); origin (-8.75 0 0); angle0 0; amplitude {np.radians(degrees)}; omega {np.pi / 2}"
    return {
        "walls": f"type angularOscillatingDisplacement; {motion}; value uniform (0 0 0);",
        "inlet|outlet": STILL,
        "frontAndBack": "type empty;",
    }


def airfoil(case, mover, library, degrees, **control):
    """OpenFOAM's airFoil2D, 10,720 cells, swung by a mover."""
    shutil.copytree(foam.EXAMPLES / "incompressible/simpleFoam/airFoil2D", case)
    write_control(case, **control)
    write_motion(case, mover, library)
    write_displacement(case, swing(degrees))
    return case


def points_of(case, time="constant"):
    """The points of a time."""
    return load_file(pathlib.Path(case, time, "polyMesh"), "points").numbers("scalar", 3)


def whole_points(case, time):
    """The points of a decomposed case, after those of each part are found equal bit for bit where it shares them."""
    files = [
        load_file(part / "constant" / "polyMesh", "pointProcAddressing") for part in parts_of(case)
    ]
    ids = [file.numbers("label").ravel() for file in files]
    points = np.full((max(map(np.max, ids)) + 1, 3), np.nan)
    for part, mine in zip(parts_of(case), ids, strict=True):
        here = points_of(part, time)
        seen = ~np.isnan(points[mine, 0])
        np.testing.assert_array_equal(points[mine][seen], here[seen])
        points[mine] = here
    assert sum(map(len, ids)) > len(points)
    assert not np.isnan(points).any()
    return points


def parts_of(case):
    return sorted(pathlib.Path(case).glob("processor*"))


def wing(case, mover, library):
    """An elliptic wing in 9,600 hexahedra between two symmetry planes, to be bent."""
    layers = np.arctanh(0.12) + 5e-3 * (1.3 ** np.arange(21) - 1) / 0.3
    section = np.cosh(
        layers[:, None] - 1j * np.pi / 20 * np.arange(40)
    )  # confocal ellipses, from 12 % of the chord
    stations = np.linspace(0, SPAN, 13)[:, None, None]
    points = np.stack(np.broadcast_arrays(section.real, stations, section.imag), axis=-1)
    ids = np.arange(points[..., 0].size).reshape(points.shape[:3])
    points, closed = points.reshape(-1, 3), np.concatenate([ids, ids[:, :, :1]], axis=2)
    ends = {"wing": ids[:, 0], "farfield": ids[:, -1], "root": ids[0], "tip": ids[-1]}
    tests = [
        (name, KINDS[name], functools.partial(_all_in, set(nodes.flat)))
        for name, nodes in ends.items()
    ]
    foam.write_case(case, points, foam.hexahedra(meshes.blocks(closed)), tests)
    write_control(case, delta=1)
    write_motion(case, mover, library, walls="wing")
    bend(case, 0.3)
    return case


def bend(case, rise, time="0"):
    """Bends the wing to a parabola in the step after a time: its tip is up by this part of its span.

    In nine digits, which decomposePar keeps: the last bit of a wall moves points of the inside by 1e-12.
    """
    eta = points_of(case)[met(case, "wing"), 1] / SPAN
    values = "\n".join(f"(0 0 {value!r})" for value in np.round(SPAN * rise * eta**2, 9).tolist())
    boundary = {name: f"type {kind};" for name, kind in KINDS.items()} | {"farfield": STILL}
    boundary["wing"] = f"type fixedValue; value nonuniform List<vector> {len(eta)}\n(\n{values}\n);"
    write_displacement(case, boundary, time)


SPAN = 6.0
KINDS = {"wing": "wall", "farfield": "patch", "root": "symmetry", "tip": "symmetry"}


def _all_in(nodes, face):
    return nodes.issuperset(face)


FLOORS = {
    "ahead": "type fixedValue; value uniform (0 0 0.05);",
    "behind": "type fixedValue; value uniform (0 0.03 0.1);",
}


def box(case, library, boundary=FLOORS, **control):
    """A unit box of 288 bricks, its floor in two patches of other displacements, which share nodes at x = 2/3."""
    places = np.linspace(0, 1, 7), np.linspace(0, 1, 7), np.linspace(0, 1, 9)
    points, ids = meshes.lattice(*places), np.arange(7 * 7 * 9).reshape(7, 7, 9)
    tests = [
        (
            "behind",
            "wall",
            lambda face: bool((points[face, 2] == 0).all() and (points[face, 0] > 0.6).all()),
        ),
        ("ahead", "wall", lambda face: bool((points[face, 2] == 0).all())),
        ("sides", "patch", lambda face: True),
    ]
    foam.write_case(case, points, foam.hexahedra(meshes.blocks(ids)), tests)
    write_control(case, **control)
    write_motion(case, "jaxmorph", library)
    write_displacement(case, {"sides": STILL, **boundary})
    return case


PLACES = np.array([-3, -2.2, -1.6, -1.1, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1.1, 1.6, 2.2, 3])
"""Of the lattice in a tank: the hull is a cube of side 1 in the middle."""
ROTOR = 1.6
"""Half the side of the zone around the hull."""


def tank(case, *, is_cut=False):
    """A cube, the hull, in the middle of a tank of 2,680 bricks.

    A cut at the rotor's side gives both sides nodes of their own, and the cells inside are the zone rotor.
    """
    points, ids = meshes.lattice(PLACES, PLACES, PLACES), np.arange(15**3).reshape(15, 15, 15)
    cells = np.asarray(meshes.blocks(ids))
    away = np.abs(points[cells].mean(axis=1)).max(axis=1)
    cells, away = cells[away > 0.5], away[away > 0.5]
    order = np.argsort(away > ROTOR, kind="stable")
    cells, inside = cells[order], int((away < ROTOR).sum())
    if is_cut:
        rows = np.arange(len(points))
        rows[np.abs(np.abs(points).max(axis=1) - ROTOR) < 1e-9] += len(points)
        points = np.concatenate([points, points])
        cells[inside:] = rows[cells[inside:]]
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(-1, 8)
    shared = set(cells[:inside].flat) if is_cut else set()
    size = np.abs(points).max(axis=1)
    tests = [
        ("hull", "wall", lambda face: bool((size[face] < 0.51).all())),
        ("rotorSide", "patch", lambda face: shared.issuperset(face)),
        ("statorSide", "patch", lambda face: bool((size[face] < 2).all())),
        ("tank", "patch", lambda face: True),
    ]
    foam.write_case(case, points, foam.hexahedra(cells), tests if is_cut else [*tests[::3]])
    labels = "\n".join(map(str, range(inside)))
    zone = f"rotor {{ type cellZone; cellLabels List<label> {inside}\n(\n{labels}\n); }}"
    write_dictionary(case, "constant/polyMesh/cellZones", f"1 ( {zone} )\n", "regIOobject")
    return case


def write_flow(case):
    """Fields for pimpleFoam: a stream along x through the tank."""
    stream = "tank { type freestreamVelocity; freestreamValue uniform (1 0 0); }"
    wall = "hull { type movingWallVelocity; value uniform (0 0 0); }"
    text = f"dimensions [0 1 -1 0 0 0 0]; internalField uniform (1 0 0); boundaryField {{ {wall} {stream} }}\n"
    write_dictionary(case, "0/U", text, "volVectorField")
    sides = (
        "hull { type zeroGradient; } tank { type freestreamPressure; freestreamValue uniform 0; }"
    )
    text = f"dimensions [0 2 -2 0 0 0 0]; internalField uniform 0; boundaryField {{ {sides} }}\n"
    write_dictionary(case, "0/p", text, "volScalarField")
    write_dictionary(case, "constant/transportProperties", "transportModel Newtonian; nu 0.01;\n")
    write_dictionary(case, "constant/turbulenceProperties", "simulationType laminar;\n")


def floating(case, library, hull, end):
    """OpenFOAM's floatingObject, 11,640 cells, three outer correctors a step; `hull` is its wall's entry."""
    shutil.copytree(foam.EXAMPLES / "multiphase/interFoam/RAS/floatingObject", case)
    shutil.copytree(case / "0.orig", case / "0")
    control = case / "system" / "controlDict"
    text = re.sub(r"(endTime|deltaT|adjustTimeStep) .*", r"// \1", control.read_text())
    control.write_text(f"{text}\nendTime {end}; deltaT 0.002; adjustTimeStep no;\n")
    foam.run(case, "blockMesh")
    foam.run(case, "topoSet")
    foam.run(case, "subsetMesh", "-overwrite", "c0", "-patch", "floatingObject")
    foam.run(case, "setFields")
    libraries = f'"libfvMotionSolvers.so" "libsixDoFRigidBodyMotion.so" "{library}"'
    text = f"dynamicFvMesh dynamicMotionSolverFvMesh; motionSolver jaxmorph; motionSolverLibs ({libraries});\n"
    write_dictionary(case, "constant/dynamicMeshDict", text)
    write_displacement(case, {"stationaryWalls|atmosphere": STILL, "floatingObject": hull})
    return case


def strip(case, library, normal=1):
    """A flat ring in one layer of cells across an axis, its points in any order, its hole pushed aside."""
    foam.write_case(case, *foam.strip(normal))
    write_control(case, delta=1)
    write_motion(case, "jaxmorph", library)
    push = "type fixedValue; value uniform (0.05 0.03 0.02);"
    write_displacement(case, {"sides": "type empty;", "far": STILL, "hole": push})
    return case


def channel(case, library):
    """OpenFOAM's channel395 in 768 bricks, cyclic along and across, its floor pushed up and aside."""
    shutil.copytree(
        foam.EXAMPLES / "incompressible/pimpleFoam/LES/channel395/system", case / "system"
    )
    dictionary = case / "system" / "blockMeshDict"
    dictionary.write_text(dictionary.read_text().replace("(40 25 30)", "(16 8 6)"))
    write_control(case, delta=1)
    foam.run(case, "blockMesh")
    write_motion(case, "jaxmorph", library)
    push = "type fixedValue; value uniform (0.1 0.05 0.02);"
    write_displacement(case, {"bottomWall": push, "topWall": STILL, ".*half[01]": "type cyclic;"})
    return case


def met(case, patch):
    """The points of a patch in OpenFOAM's order: as they are met in its faces."""
    folder = case / "constant" / "polyMesh"
    (entry,) = (
        entry for entry in read_patches(load_file(folder, "boundary")) if entry.name == patch
    )
    used = load_file(folder, "faces").faces().take(entry.faces).values
    return used[np.sort(np.unique(used, return_index=True)[1])]
