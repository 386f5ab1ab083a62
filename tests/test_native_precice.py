"""The motion solver and what preCICE's adapter asks of it, by a stand-in: there is no package of libprecice."""

import os
import pathlib
import shutil
import subprocess

import foam
import foam_motion
import numpy as np
import pytest

from jaxmorph import native

pytestmark = pytest.mark.nightly

CASE = native.folder / "examples" / "precice" / "perpendicular-flap"
STUB = pathlib.Path(__file__).parent / "precice_stub.C"
LIBRARIES = ("OpenFOAM", "OSspecific/POSIX", "finiteVolume", "meshTools")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of the motion solver's library, and of the stand-in's under the adapter's name."""
    library, _ = foam_motion.build(tmp_path_factory.mktemp("native"))
    source = os.environ["JAXMORPH_OPENFOAM_SOURCE"]
    headers = [f"-I{source}/src/{name}/lnInclude" for name in LIBRARIES]
    flags = ["-std=c++14", "-O1", "-shared", "-fPIC", "-w", "-ftemplate-depth-256"]
    flags += ["-DOPENFOAM=1912", "-DWM_DP", "-DWM_LABEL_SIZE=32", "-DNoRepository"]
    target = library.with_name("libpreciceAdapterFunctionObject.so")
    subprocess.run(["g++", *flags, *headers, str(STUB), "-o", str(target)], check=True)
    return library.parent


def coupled(case, folder, iterations, locations, parallel=()):
    """Runs the example to 0.2 as the page says, in so many iterations a step; what was said."""
    (typed,), _, _ = foam_motion.page_blocks("preCICE")
    assert typed.split("\n")[2:-1] == ["blockMesh", "jaxmorph export . --moving flap", "pimpleFoam"]
    shutil.copytree(CASE, case)
    fluid = case / "fluid-openfoam"
    control, settings = fluid / "system" / "controlDict", fluid / "system" / "preciceDict"
    # the last step of a run goes back too, where the stand-in's solid ends none: one step more
    control.write_text(control.read_text().replace("endTime 5;", "endTime 0.21;"))
    text = settings.read_text().replace("faceCenters", locations)
    settings.write_text(f"{text}iterations {iterations};\n")
    foam.run(fluid, "blockMesh")
    if parallel:
        foam.run(fluid, "decomposePar")
    foam_motion.write_plan(fluid, "--moving", "flap")
    environment = foam.ENVIRONMENT | {"LD_LIBRARY_PATH": str(folder)}
    done = subprocess.run(
        [*parallel, "pimpleFoam", *(["-parallel"] if parallel else [])],
        cwd=fluid,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return fluid, done.stdout


def test_the_adapter_finds_both_displacements(tmp_path, folder):
    fluid, said = coupled(tmp_path / "case", folder, 1, "faceCenters")
    found = "pointVectorField pointDisplacement, volVectorField cellDisplacement, fixedValue"
    assert f"stub: {found}\n" in said
    flap = foam_motion.met(fluid, "flap")
    moved = foam_motion.points_of(fluid, "0.2") - foam_motion.points_of(fluid)
    assert 0.15 < np.linalg.norm(moved[flap], axis=1).max() < 0.25
    assert foam.verdict(fluid, "-time", "0.2") == ["Mesh OK."]
    assert not (fluid / "0.2" / "cellDisplacement").exists()


@pytest.mark.parametrize("locations", ["faceCenters", "faceNodes"])
def test_sub_iterations_end_where_one_would(tmp_path, folder, locations):
    """Three a step, of which two go too far and back, and one: the same bits of all points."""
    one, _ = coupled(tmp_path / "one", folder, 1, locations)
    three, said = coupled(tmp_path / "three", folder, 3, locations)
    assert said.count("mesh moved in") > 60
    for time in ("0.1", "0.2"):
        points = foam_motion.points_of(one, time)
        assert np.abs(points - foam_motion.points_of(one)).max() > 0.05
        np.testing.assert_array_equal(foam_motion.points_of(three, time), points)


def test_two_processes_are_one(tmp_path, folder):
    """Of sub-iterations too, where the adapter writes to points."""
    whole, _ = coupled(tmp_path / "whole", folder, 2, "faceNodes")
    parallel = (*foam.PARALLEL, "2")
    parts, _ = coupled(tmp_path / "parts", folder, 2, "faceNodes", parallel)
    points = foam_motion.whole_points(parts, "0.2")
    np.testing.assert_array_equal(points, foam_motion.points_of(whole, "0.2"))
