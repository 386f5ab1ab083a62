"""The motion solver for OpenFOAM: compiled here, and run by OpenFOAM's programs beside OpenFOAM's own movers."""

import os
import re
import shutil
import subprocess
import sys

import foam
import foam_motion
import numpy as np
import pytest
from documents import ROOT

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return foam_motion.build(tmp_path_factory.mktemp("native"))


@pytest.fixture(scope="module")
def library(built):
    return built[0]


def test_it_compiles_without_a_warning(built):
    assert "-Wall -Wextra" in built[1]
    assert "warning" not in built[1]


def faults(case):
    """What checkMesh finds at each time beyond what it finds in the undeformed mesh."""
    before = foam.verdict(case, "-time", "0")
    return [
        [line for line in foam.verdict(case, "-time", time) if line not in before]
        for time in times(case)
    ]


def times(case):
    found = [
        folder.name
        for folder in case.iterdir()
        if re.fullmatch(r"[\d.]+", folder.name) and folder.name != "0"
    ]
    return sorted(found, key=float)


AIRFOIL = foam_motion.AIRFOIL
OTHERS = ("displacementLaplacian", "displacementSBRStress")
"""OpenFOAM's movers, solved until their residuals stand still."""


def test_an_airfoil_turns_by_60_degrees(tmp_path, library):
    """All ten meshes are sound; by OpenFOAM's movers none is, and all but the first have negative volumes."""
    own = foam_motion.airfoil(tmp_path / "jaxmorph", "jaxmorph", library, 60)
    assert faults(foam_motion.moved(own, AIRFOIL)) == [[]] * 10
    for mover in OTHERS:
        found = faults(foam_motion.moved(foam_motion.airfoil(tmp_path / mover, mover, library, 60)))
        assert len(found) == 10
        assert all(found)
        assert all("negative cell volume" in first for first, *_ in found[1:])


def test_a_wing_bends_by_30_percent(tmp_path, library):
    """In three steps, each a run of its own."""
    for mover in ("jaxmorph", *OTHERS):
        case = foam_motion.wing(tmp_path / mover, mover, library)
        assert foam.verdict(case) == ["Mesh OK."]
        if mover == "jaxmorph":
            foam_motion.write_plan(case, *foam_motion.WING)
        for step, rise in enumerate((0.1, 0.2, 0.3)):
            foam_motion.bend(case, rise, str(step))
            foam_motion.write_control(case, end=step + 1, delta=1)
            foam.run(case, "moveDynamicMesh")
        found = faults(case)
        if mover == "jaxmorph":
            assert found == [[]] * 3
        else:
            assert len(found) == 3
            assert all("negative cell volume" in " ".join(each) for each in found)


def half_moved(case, library):
    """A box of which one of two patches of the floor moves."""
    return foam_motion.box(
        case, library, foam_motion.FLOORS | {"ahead": foam_motion.STILL}, end=0.1
    )


CASES = {
    "airfoil": (
        lambda case, library: foam_motion.airfoil(case, "jaxmorph", library, 30, end=0.2),
        AIRFOIL,
    ),
    "strip": (foam_motion.strip, foam_motion.STRIP),
    "wing": (lambda case, library: foam_motion.wing(case, "jaxmorph", library), foam_motion.WING),
    "box": (lambda case, library: foam_motion.box(case, library, end=0.1), foam_motion.BOX),
    "channel": (foam_motion.channel, foam_motion.CHANNEL),
    "half": (half_moved, ("--moving", "behind", "--fixed", "ahead", "sides")),
}


@pytest.mark.parametrize("name", CASES)
def test_parts_are_the_whole(tmp_path, library, name):
    """Three processes give each point the place that one gives it, to the last bit.

    So it is where two patches, in different processes, give other displacements to points that they share, and where a
    process has points of a wall, but none of its faces.
    """
    make, plan = CASES[name]
    whole = foam_motion.moved(make(tmp_path / "whole", library), plan)
    parts = foam_motion.moved_in_parts(make(tmp_path / "parts", library), plan)
    end = times(whole)[-1]
    points = foam_motion.points_of(whole, end)
    assert np.abs(points - foam_motion.points_of(whole)).max() > 0.02
    np.testing.assert_array_equal(foam_motion.whole_points(parts, end), points)


def test_points_of_few_digits_move_as_far(tmp_path, library):
    """decomposePar writes ten digits as text: parts begin there, and go as far as the whole."""
    case = foam_motion.wing(tmp_path / "case", "jaxmorph", library)
    exact = foam_motion.points_of(case)
    foam_motion.write_control(case, delta=1, digits=6, form="ascii")
    foam.run(case, "decomposePar")
    first = foam_motion.whole_points(case, "constant")
    assert 1e-9 < np.abs(first - exact).max() < 1e-7
    foam_motion.write_control(case, delta=1)
    foam_motion.write_plan(case, *foam_motion.WING)
    foam.run(case, *foam.PARALLEL, "3", "moveDynamicMesh", "-parallel")
    moved = foam_motion.whole_points(case, "1")
    whole = foam_motion.points_of(foam_motion.moved(case, foam_motion.WING), "1")
    np.testing.assert_allclose(moved - first, whole - exact, rtol=0, atol=1e-13)
    assert (moved == first).all(axis=1).sum() == 560  # the far field, and the wing's root


def test_a_run_that_begins_again_is_one_run(tmp_path, library):
    """Stopped half way, in one process and in three: the same bits at the end."""
    straight = foam_motion.moved(
        foam_motion.airfoil(tmp_path / "a", "jaxmorph", library, 30, end=0.4), AIRFOIL
    )
    case = foam_motion.moved(
        foam_motion.airfoil(tmp_path / "b", "jaxmorph", library, 30, end=0.2), AIRFOIL
    )
    foam_motion.write_control(case, end=0.4)
    foam.run(case, "decomposePar", "-latestTime")
    foam_motion.write_plan(case, *AIRFOIL)
    foam.run(case, "moveDynamicMesh")
    foam.run(case, *foam.PARALLEL, "3", "moveDynamicMesh", "-parallel")
    points = foam_motion.points_of(straight, "0.4")
    assert np.abs(points - foam_motion.points_of(case, "0.2")).max() > 0.1
    np.testing.assert_array_equal(foam_motion.points_of(case, "0.4"), points)
    np.testing.assert_array_equal(foam_motion.whole_points(case, "0.4"), points)


def test_the_wall_is_where_its_displacement_says(tmp_path, library):
    """A node of two patches follows the one that moves as a whole, and of two such the later one in the mesh."""
    for make, ahead, between in (
        (CASES["box"], [0, 0, 0.05], [0, 0, 0.05]),
        (CASES["half"], [0, 0, 0], [0, 0.03, 0.1]),
    ):
        case = foam_motion.moved(make[0](tmp_path / f"{between[1]}", library), make[1])
        before, after = foam_motion.points_of(case), foam_motion.points_of(case, "0.1")
        x, floor = before[:, 0], before[:, 2] == 0
        for at, u in (
            (x < 0.6, ahead),
            ((x > 0.6) & (x < 0.7), between),
            (x > 0.7, [0, 0.03, 0.1]),
        ):
            np.testing.assert_array_equal(after[at & floor], before[at & floor] + u)


@pytest.mark.parametrize("normal", range(3))
def test_a_layer_across_any_axis(tmp_path, library, normal):
    """Its points stay in their planes; pairs stay pairs, to the last bit, and the wall is where it should be."""
    case = foam_motion.moved(
        foam_motion.strip(tmp_path / "case", library, normal), foam_motion.STRIP
    )
    before, after = foam_motion.points_of(case), foam_motion.points_of(case, "1")
    np.testing.assert_array_equal(after[:, normal], before[:, normal])
    plane = [axis for axis in range(3) if axis != normal]
    wall = np.linalg.norm(before[:, plane], axis=1) < 1.1
    np.testing.assert_array_equal(
        after[wall][:, plane], before[wall][:, plane] + np.array([0.05, 0.03, 0.02])[plane]
    )
    order = [points[np.lexsort(before.T[plane])][:, plane] for points in (before, after)]
    for points in order:
        np.testing.assert_array_equal(points[::2], points[1::2])
    assert foam.verdict(case, "-time", "1") == ["Mesh OK."]


def refused(case, *words):
    """What moveDynamicMesh says of an error that ends it."""
    parallel = [*foam.PARALLEL, "3"] if words else []
    command = [*parallel, "moveDynamicMesh", *words]
    done = subprocess.run(
        command, cwd=case, env=foam.ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    return " ".join((done.stdout + done.stderr).partition("FOAM FATAL ERROR")[2].split())


def test_another_plan_is_refused(tmp_path, library):
    """None, a cut one, one of another mesh with fewer points or with other ones, and of another part."""
    box = foam_motion.box(tmp_path / "box", library)
    plan = box / "constant" / "jaxmorph.plan"
    assert "jaxmorph.plan" in refused(box)
    foam_motion.write_plan(box, *foam_motion.BOX)
    whole = plan.read_bytes()
    plan.write_bytes(whole[:-8])
    assert "jaxmorph.plan" in refused(box)
    plan.write_bytes(whole)
    wing = foam_motion.wing(tmp_path / "wing", "jaxmorph", library)
    shutil.copy(plan, wing / "constant")
    said = refused(wing)
    assert "is of 441 points, the mesh has 10920" in said
    assert "jaxmorph export CASE" in said
    foam.run(box, "decomposePar")
    foam_motion.write_plan(box, *foam_motion.BOX)
    first, _, last = (part / "constant" / "jaxmorph.plan" for part in foam_motion.parts_of(box))
    shutil.copy(first, last)
    assert re.search(
        r"\[2\] .* is of another mesh: points are up to 0.6", refused(box, "-parallel")
    )
    foam.run(box, "transformPoints", "-scale", "(1 1 1.0009765625)")
    said = refused(box)
    assert re.search(
        r"is of another mesh: points are up to 0.0009765625 apart, .* at \(\S+ \S+ 1.0009765625\)",
        said,
    )


@pytest.mark.parametrize("parallel", [(), ("-parallel",)], ids=["whole", "parts"])
def test_a_boundary_that_contradicts_the_plan_is_refused(tmp_path, library, parallel):
    """A wall without values, and a displacement of what the plan holds; the patch is named."""
    box, still = foam_motion.box(tmp_path / "box", library), foam_motion.STILL
    for boundary, message in (
        (
            {"sides": still, "ahead": "type slip;", "behind": still},
            "15 of the 49 points .*: ahead, of type slip Give",
        ),
        (
            foam_motion.FLOORS | {"sides": "type fixedValue; value uniform (0 0 1e-6);"},
            r"by up to 9.9\d*e-07 on patch sides",
        ),
    ):
        foam_motion.write_displacement(box, boundary)
        if parallel:
            foam.run(box, "decomposePar", "-force")
        foam_motion.write_plan(box, *foam_motion.BOX)
        assert re.search(message, refused(box, *parallel))


def test_the_mover_takes_little_of_a_step(tmp_path, library):
    """Of pimpleFoam's, which turns airFoil2D by 30 degrees in 20 steps."""
    case = foam_motion.airfoil(
        tmp_path / "a", "jaxmorph", library, 30, end=0.1, delta=0.005, interval=1000
    )
    foam_motion.write_plan(case, *AIRFOIL)
    said = foam.run(case, "pimpleFoam")
    spent = list(map(float, re.findall(r"mesh moved in (\S+) s", said)))
    assert len(spent) == 20
    total = np.diff(list(map(float, re.findall(r"ExecutionTime = (\S+) s", said))))
    assert sum(spent[1:]) < 0.02 * sum(total)


def test_what_the_page_says_works(tmp_path, library):
    """Its commands and dictionaries, on airFoil2D, in a shell with OpenFOAM's environment."""
    (typed,), (dictionary,), (boundary,) = foam_motion.page_blocks("From a case to a run")
    case = foam_motion.airfoil(tmp_path / "case", "jaxmorph", library, 30, end=0.01, delta=0.005)
    (case / "constant" / "dynamicMeshDict").write_text(dictionary)
    foam_motion.write_boundary(case, boundary)
    shell = f'. "$JAXMORPH_OPENFOAM_SOURCE/etc/bashrc"\njaxmorph() {{ "{sys.executable}" -m jaxmorph "$@"; }}\n'
    environment = os.environ | {"HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    command = ["bash", "-c", f"{shell}set -e\n{typed}"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    assert "moving walls" in done.stdout
    assert done.stdout.count("mesh moved in") == 2
    assert done.stdout.split()[-1] == "End"
