"""With OpenFOAM itself: its tutorials morph, checkMesh says of them what it said before, its solvers run on them.

`.ci/run` installs OpenFOAM and sets JAXMORPH_OPENFOAM=required, so that nothing here is skipped there.
"""

import gzip
import json
import re
import shutil

import foam
import numpy as np
import pytest
from foam import PATCHES, mixed
from runs import runs

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.cli import main

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def openfoam():
    foam.need_openfoam()


def tutorial(case, name):
    """A copy, fields unpacked; a mesh without settings gets some that every program can read."""
    source = foam.EXAMPLES / name
    shutil.copytree(source, case if (source / "system").is_dir() else case / "constant")
    for file in case.rglob("*.gz"):
        if "polyMesh" not in str(file):
            file.with_suffix("").write_bytes(gzip.decompress(file.read_bytes()))
    if not (case / "system").exists():
        foam.write_case(case.parent / "settings", *mixed(), PATCHES)
        shutil.copytree(case.parent / "settings" / "system", case / "system")
    return case


MEASURES = {
    "max_face_aspect_ratio": r"Max aspect ratio[ =:]+([\d.e+-]+)",
    "max_non_orthogonality": r"non-orthogonality Max: ([\d.e+-]+)",
    "max_face_skewness": r"Max skewness = ([\d.e+-]+)",
}


def assert_measured_alike(case, capsys):
    """The gates of the preset measure what checkMesh does."""
    said = foam.run(case, "checkMesh", "-constant")
    capsys.readouterr()
    main(["quality", str(case), "--preset", "checkmesh", "--json"])
    found = {gate["gate"]: gate["after"] for gate in json.loads(capsys.readouterr().out)["gates"]}
    for name, pattern in MEASURES.items():
        assert found[name] == pytest.approx(float(re.findall(pattern, said)[0]), rel=2e-5), name


INCOMPRESSIBLE = {
    "simpleFoam/airFoil2D": ("walls", ["--rotate", "5"]),
    "adjointOptimisationFoam/resources/meshes/naca0012": ("pressure suction", ["--rotate", "5"]),
    "adjointOptimisationFoam/resources/meshes/sbend": ("lower", ["--translate", "0", "-0.01"]),
}

OFTEN = "adjointOptimisationFoam/resources/meshes/naca0012"


@pytest.mark.parametrize(
    "name", runs([OFTEN], nightly=[each for each in INCOMPRESSIBLE if each != OFTEN])
)
def test_tutorials_in_2d(tmp_path, capsys, name):
    moving, motion = INCOMPRESSIBLE[name]
    case, new = tutorial(tmp_path / "case", f"incompressible/{name}"), tmp_path / "new"
    fixed = [patch for patch in io.read(case).patches if patch not in moving.split()]
    flags = ["--moving", *moving.split(), "--fixed", *fixed, *motion]
    before = foam.verdict(case, "-constant")
    for target in (new, case / "0.5"):
        assert main(["deform", str(case), str(target), *flags]) == 0
    assert foam.verdict(new, "-constant") == foam.verdict(case, "-time", "0.5") == before
    assert_measured_alike(new, capsys)
    if name.endswith("airFoil2D"):
        with (new / "system" / "fvSolution").open("a") as file:
            file.write(
                "solvers { Phi { solver PCG; preconditioner DIC; tolerance 1e-6; relTol 0.01; } }\n"
            )
            file.write("potentialFlow { nNonOrthogonalCorrectors 2; }\n")
        said = foam.run(new, "potentialFoam")
        assert said.split()[-1] == "End"
        assert float(re.findall(r"Continuity error = (\S+)", said)[-1]) < 1e-4


@pytest.mark.nightly
def test_a_tutorial_in_3d(tmp_path, capsys):
    """A square duct with a bend of 180 degrees, 112,000 hexahedra: its walls pushed aside at the bend."""
    case = tutorial(tmp_path / "case", "compressible/rhoSimpleFoam/squareBend")
    foam.run(case, "blockMesh")
    mesh = io.read(case)
    assert {kind: len(ids) for kind, ids in mesh.cells.items()} == {"hexahedron": 112_000}
    plan = jm.prepare(mesh.points, mesh.patch("walls"), mesh.patch("inlet", "outlet"))
    wall = mesh.points[plan.moving]
    push = 0.01 * np.exp(-(((wall[:, 0] - 0.05) / 0.03) ** 2))
    points = np.asarray(jm.deform(plan, push[:, None] * np.array([0.5, 0, 1])))
    assert int(jm.quality(mesh, points).inverted) == 0
    io.write(tmp_path / "new", mesh.moved(points))
    assert foam.verdict(tmp_path / "new") == foam.verdict(case) == ["Mesh OK."]
    assert_measured_alike(tmp_path / "new", capsys)


@pytest.mark.nightly
def test_a_solver_runs_on_a_moved_cyclic_channel(tmp_path):
    """The floor rises and falls along a channel that repeats both ways. Its cyclic sides move with it, and pimpleFoam runs."""
    case = tutorial(tmp_path / "case", "incompressible/pimpleFoam/LES/channel395")
    mesh_file, control = (case / "system" / name for name in ("blockMeshDict", "controlDict"))
    mesh_file.write_text(mesh_file.read_text().replace("(40 25 30)", "(16 8 6)"))
    text = control.read_text().partition("functions")[0]
    text = re.sub(r"(endTime|deltaT)( +)[\d.]+;", r"\1\2 0.01;", text)
    control.write_text(text.replace("writeInterval   200", "writeInterval 1"))
    shutil.rmtree(case / "0")
    (case / "0.orig").rename(case / "0")
    foam.run(case, "blockMesh")
    mesh = io.read(case)
    assert len(io.periodic(mesh)) == 4
    plan = jm.prepare(mesh, "bottomWall", "topWall", periodic=io.periodic(mesh))
    floor = np.asarray(mesh.points)[plan.moving]
    u = np.zeros_like(floor)
    u[:, 1] = 0.2 * np.cos(np.pi / 2 * floor[:, 0]) * np.cos(np.pi * floor[:, 2])
    moved = np.asarray(jm.deform(plan, u))
    assert np.abs(moved - mesh.points)[mesh.patch("inout1_half0")].max() > 0.1
    new = tmp_path / "new"
    io.write(new, mesh.moved(moved))
    assert foam.verdict(new, "-constant") == foam.verdict(case, "-constant") == ["Mesh OK."]
    said = foam.run(new, "pimpleFoam")
    assert said.split()[-1] == "End"
    assert abs(float(re.findall(r"sum local = ([\d.e+-]+)", said)[-1])) < 1e-6
    assert np.isfinite(
        list(map(float, re.findall(r"Courant Number mean: \S+ max: (\S+)", said)))
    ).all()


@pytest.mark.nightly
@pytest.mark.parametrize("form", [name for name in foam.FORMS if "big-endian" not in name])
def test_openfoam_reads_the_forms_that_the_tests_write(tmp_path, form):
    """So that what jaxmorph reads of them is what OpenFOAM would; it reads no other byte order than its machine's."""
    foam.write_case(tmp_path / "a", *mixed(), PATCHES, foam.FORMS[form])
    assert foam.verdict(tmp_path / "a") == ["Mesh OK."]


BLOCK = """FoamFile { version 2.0; format ascii; class dictionary; object blockMeshDict; }
vertices ((0 0 0)(2 0 0)(2 1.2 0)(0 1 0)(0 0 1)(2 0.1 1)(2 1 1)(0 1 1.3));
blocks ( hex (0 1 2 3 4 5 6 7) (10 8 6) simpleGrading (1 3 1) );
edges ();
boundary ( floor {type wall; faces ((0 1 5 4));} roof {type wall; faces ((3 7 6 2));}
    sides {type patch; faces ((0 4 7 3)(2 6 5 1)(0 3 2 1)(4 5 6 7));} );
"""


@pytest.mark.parametrize("settings", ["ascii", "binary", "ascii; writeCompression on"])
def test_polyhedra_made_by_openfoam(tmp_path, capsys, settings):
    """The dual of a block: five kinds of polyhedra, and hexahedra."""
    case = tmp_path / "a"
    foam.write_case(case, *mixed(), PATCHES)
    shutil.rmtree(case / "constant" / "polyMesh")
    (case / "system" / "blockMeshDict").write_text(BLOCK)
    with (case / "system" / "controlDict").open("a") as file:
        file.write(f"writeFormat {settings}; writePrecision 15;\n")
    foam.run(case, "blockMesh")
    assert_measured_alike(case, capsys)
    foam.run(case, "polyDualMesh", "60", "-overwrite")
    for file in case.glob("*.obj"):
        file.unlink()
    shutil.rmtree(case / "0", ignore_errors=True)
    mesh = io.read(case)
    report = jm.quality(mesh)
    assert int(report.inverted) == 0
    total = foam.run(case, "checkMesh", "-constant").partition("Total volume = ")[2].split(". ")[0]
    np.testing.assert_allclose(np.asarray(report.volume).sum(), float(total), rtol=1e-3)
    io.write(tmp_path / "same", mesh)
    assert foam.tree(tmp_path / "same") == foam.tree(case)
    arguments = [
        "deform",
        str(case),
        str(tmp_path / "b"),
        "--moving",
        "floor",
        "--fixed",
        "roof",
        "sides",
    ]
    assert main([*arguments, "--translate", "0", "-0.02", "0"]) == 0
    assert foam.verdict(tmp_path / "b", "-constant") == foam.verdict(case, "-constant")
    assert_measured_alike(case, capsys)
    assert_measured_alike(tmp_path / "b", capsys)
