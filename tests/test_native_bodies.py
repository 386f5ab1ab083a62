"""The motion solver beside others of OpenFOAM: rigid bodies by its libraries, and a zone that rotates."""

import re
import subprocess

import foam
import foam_motion
import numpy as np
import pytest
from foam_motion import STILL

import jaxmorph as jm
from jaxmorph import io

pytestmark = pytest.mark.nightly

ZERO = "uniform (0 0 0)"
FREE, DRIVEN = "uncoupledSixDoFRigidBodyDisplacement", "sixDoFRigidBodyDisplacement"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return foam_motion.build(tmp_path_factory.mktemp("native"))[0]


def written(case, library, dictionary, boundary, **control):
    """A tank with the dictionary and boundary of a page; the library's name becomes its place."""
    text = dictionary.replace("libjaxmorphMotion.so", str(library))
    (case / "constant" / "dynamicMeshDict").write_text(text)
    foam_motion.write_boundary(case, boundary)
    foam_motion.write_control(case, **control)
    return case


def turn(angle, axis=2):
    """The matrix of a turn about an axis."""
    first, second = [k for k in range(3) if k != axis]
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[second, first] = np.sin(angle) * (-1) ** (axis == 1)
    matrix[first, second] = -matrix[second, first]
    return matrix


def number(text, name):
    """The numbers after a name in a dictionary."""
    found = re.search(rf"{name} \(?([^;()]+)\)?;", text)[1]
    return np.array(found.split(), float)


@pytest.mark.parametrize("axis", [2, 0])
def test_a_body_free_in_six_degrees_moves_exactly(tmp_path, library, axis):
    """The page's text, by copy and paste; and with the body's axes turned, so that it spins about x."""
    _, dictionaries, boundaries = foam_motion.page_blocks("A body with six degrees of freedom")
    text = boundaries[0]
    assert f"type {FREE};" in text
    if axis == 0:
        text = text.replace("mass 2;", "mass 2; orientation (0 0 1 0 1 0 -1 0 0);")
    case = written(foam_motion.tank(tmp_path / "case"), library, dictionaries[0], text)
    foam_motion.moved(case, ())
    rest = foam_motion.points_of(case)
    hull = foam_motion.met(case, "hull")
    middle, velocity = number(text, "centreOfMass"), number(text, "velocity")
    spin = number(text, "angularMomentum")[2] / number(text, "momentOfInertia")[2]
    for k in range(1, 11):
        name = f"{k / 10:g}"
        exact = middle + velocity * k / 10 + (rest[hull] - middle) @ turn(spin * k / 10, axis).T
        found = foam_motion.points_of(case, name)
        np.testing.assert_allclose(found[hull], exact, rtol=0, atol=1e-12)
        assert foam.verdict(case, "-time", name) == ["Mesh OK."]
    assert np.linalg.norm(exact - rest[hull], axis=1).min() > 0.1


def test_a_stream_moves_a_body(tmp_path, library):
    """By two of OpenFOAM's libraries, which agree: of one body, and of bodies with joints."""
    _, dictionaries, boundaries = foam_motion.page_blocks("A body with six degrees of freedom")
    assert f"type {DRIVEN};" in boundaries[1]
    still = f"tank {{ {STILL} }}\n"
    control = {"end": 0.5, "delta": 0.05}
    ends = []
    for name, dictionary, hull in (
        ("six", dictionaries[0], boundaries[1]),
        ("joints", dictionaries[1], f"hull {{ {STILL} }}\n"),
    ):
        case = foam_motion.tank(tmp_path / name)
        written(case, library, dictionary, hull + still, **control)
        foam_motion.write_flow(case)
        foam_motion.write_plan(case, "--moving", "hull")
        foam.run(case, "pimpleFoam")
        hull = foam_motion.met(case, "hull")
        ends.append((foam_motion.points_of(case, "0.5") - foam_motion.points_of(case))[hull])
    assert ends[0][:, 0].min() > 0.1
    assert np.ptp(ends[0], axis=0).max() < 1e-5
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-5)
    assert (ends[1][:, 2] == 0).all()


BODY = "mass 15; momentOfInertia (0.36 0.43 0.16); centreOfMass (0.5 0.45 0.35);"
FLOATING = {
    "given": f"type oscillatingDisplacement; amplitude (0.02 0 0.03); omega 6; value {ZERO};",
    "driven": f"type {DRIVEN}; {BODY} solver {{ type Newmark; }} value {ZERO};",
}


@pytest.mark.parametrize("name", FLOATING)
def test_three_outer_correctors_take_little_of_a_step(tmp_path, library, name):
    """Of interFoam's: a rigid body's walls cost no solve after the first one, and standing walls nothing."""
    case = foam_motion.floating(tmp_path / "case", library, FLOATING[name], end=0.04)
    foam_motion.write_plan(case, "--moving", "floatingObject")
    said = foam.run(case, "interFoam")
    spent = list(map(float, re.findall(r"mesh moved in (\S+) s", said)))
    assert len(spent) == 60
    total = np.diff(list(map(float, re.findall(r"ExecutionTime = (\S+) s", said))))
    assert sum(spent[3:]) < 0.02 * sum(total)


def test_a_rigid_motion_is_the_plan_s(tmp_path, library):
    """Sums of a few fields: the points of `deform`, walls to the last bit; three processes are one."""
    _, dictionaries, boundaries = foam_motion.page_blocks("A body with six degrees of freedom")
    case = written(foam_motion.tank(tmp_path / "case"), library, dictionaries[0], boundaries[0])
    foam.run(case, "decomposePar")
    foam_motion.moved(case, ())
    mesh = io.read(case)
    plan = jm.prepare(mesh, "hull", "tank")
    moving = np.asarray(plan.moving)
    found, rest = foam_motion.points_of(case, "1"), foam_motion.points_of(case)
    u = (found - rest)[moving]
    points = np.asarray(jm.deform(plan, u))
    assert np.abs(u).max() > 0.5
    np.testing.assert_allclose(found, points, rtol=0, atol=1e-12)
    foam.run(case, *foam.PARALLEL, "3", "moveDynamicMesh", "-parallel")
    np.testing.assert_array_equal(foam_motion.whole_points(case, "1"), found)


def test_a_calculated_wall_is_told_which_types_move_a_body(tmp_path, library):
    _, dictionaries, _ = foam_motion.page_blocks("A body with six degrees of freedom")
    boundary = f"hull {{ type calculated; }}\ntank {{ {STILL} }}\n"
    case = written(foam_motion.tank(tmp_path / "case"), library, dictionaries[0], boundary)
    foam_motion.write_plan(case, "--moving", "hull")
    done = subprocess.run(
        ["moveDynamicMesh"],
        cwd=case,
        env=foam.ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    said = " ".join(done.stderr.split())
    assert "hull, of type calculated" in said
    for name in (FREE, DRIVEN, "rigidBodyMotionSolver", "preCICE"):
        assert name in said


def test_a_body_deforms_in_a_zone_that_rotates(tmp_path, library):
    """x -> R (x + field(R^T u)) in the zone; outside the field alone; three processes have the same bits."""
    _, (frame,), _ = foam_motion.page_blocks("A body in a rotating zone")
    rate = 0.8
    frame = frame.replace("omega 10", f"omega {rate}")
    head = foam_motion.HEAD.format("dictionary", "dynamicMeshDict")
    dictionary = f'{head}dynamicFvMesh dynamicMotionSolverFvMesh; motionSolverLibs ("libjaxmorphMotion.so");\n{frame}'
    case = foam_motion.tank(tmp_path / "case", is_cut=True)
    rest = foam_motion.points_of(case)
    hull = foam_motion.met(case, "hull")
    u = np.zeros_like(rest)
    u[hull] = 0.1 * np.sin(3 * rest[hull][:, [1, 2, 0]])
    rows = "\n".join(f"({' '.join(map(repr, row))})" for row in np.round(u[hull], 9).tolist())
    u = np.round(u, 9)
    boundary = (
        f"hull {{ type fixedValue; value nonuniform List<vector> {len(hull)}\n(\n{rows}\n); }}\n"
    )
    boundary += f'".*" {{ {STILL} }}\n'
    written(case, library, dictionary, boundary, end=0.5)
    foam.run(case, "decomposePar")
    foam_motion.moved(case, ())
    mesh = io.read(case)
    plan = jm.prepare(mesh, "hull", ["tank", "rotorSide", "statorSide"])
    inside = np.zeros(len(rest), bool)
    sides = mesh.patch("rotorSide")
    inside[np.abs(rest).max(axis=1) < foam_motion.ROTOR - 1e-9] = True
    inside[sides] = True
    for name in ("0.1", "0.5"):
        rotation = turn(rate * float(name))
        still = np.asarray(jm.deform(plan, (u @ rotation)[np.asarray(plan.moving)]))
        exact = np.where(inside[:, None], still @ rotation.T, still)
        found = foam_motion.points_of(case, name)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-13)
    assert np.abs(found - rest)[inside].max() > 0.5
    foam.run(case, *foam.PARALLEL, "3", "moveDynamicMesh", "-parallel")
    np.testing.assert_array_equal(foam_motion.whole_points(case, "0.5"), found)
