"""Cyclic patches of OpenFOAM cases, and cases that are decomposed: what a motion breaks is told."""

import re

import foam
import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph import cases, io


def turned(points):
    """The brick from 1 to 2 bent to a quarter of a ring: a rotation leads from one end to the other."""
    x, y, z = points.T
    return np.stack([(1 + y) * np.cos(np.pi / 2 * x), (1 + y) * np.sin(np.pi / 2 * x), z], axis=1)


@pytest.fixture(params=["translation", "rotation"])
def case(request, tmp_path):
    """Bricks in the unit cube, cyclic from x = 0 to x = 1, straight or bent."""
    mesh = cases.bricks(cells=3)
    flat = np.asarray(mesh.points)
    cells = foam.hexahedra(mesh.cells["hexahedron"])

    def at(x):
        return lambda face: bool(np.allclose(flat[face, 0], x))

    patches = [("in", "cyclic", at(0)), ("out", "cyclic", at(1)), ("walls", "wall", lambda face: True)]
    points = flat if request.param == "translation" else turned(flat)
    foam.write_case(tmp_path / "case", points, cells, patches)
    boundary = tmp_path / "case" / "constant" / "polyMesh" / "boundary"
    text = boundary.read_text()
    for name, other in (("in", "out"), ("out", "in")):
        text = re.sub(rf'("{name}"\s*\{{)', rf"\1 neighbourPatch {other};", text)
    boundary.write_text(text)
    return tmp_path / "case", flat, points, request.param


def test_patches_that_move_alike_match(case, tmp_path):
    folder, flat, points, kind = case
    mesh = io.read(folder)
    bumped = flat.copy()
    bumped[:, 2] += 0.1 * np.sin(2 * np.pi * flat[:, 0]) + 0.1 * flat[:, 1] ** 2
    moved = bumped if kind == "translation" else turned(bumped)
    io.write(tmp_path / "alike", mesh.moved(moved))
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    if kind == "rotation":
        io.write(tmp_path / "rigid", mesh.moved(points @ turn.T + 1))


def test_patches_that_drift_apart_are_an_error(case, tmp_path):
    """One patch's inner face grows by a known way: a node of it moves by 0.02, a face's middle by a quarter of that."""
    folder, flat, points, _ = case
    mesh = io.read(folder)
    here = np.flatnonzero(np.all(np.isclose(flat, [0, 1 / 3, 1 / 3]), axis=1))
    moved = points.copy()
    moved[here, 2] += 0.02
    told = r"'in' and 'out' no longer match: \d of 9 pairs.*Hold both patches fixed"
    with pytest.raises(ValueError, match=told) as error:
        io.write(tmp_path / "apart", mesh.moved(moved))
    assert float(re.findall(r"up to ([\d.]+) of", str(error.value))[0]) == pytest.approx(0.02 / 4 / (1 / 3), rel=1.3)
    assert not (tmp_path / "apart").exists()
    with pytest.raises(ValueError, match="no longer match"):
        io.write(folder / "1", mesh.moved(moved))


@pytest.mark.slow
def test_cyclic_patches_are_periodic(case, tmp_path):
    """The file's own pairs, held as such: walls that move in any way leave a mesh that matches."""
    folder, _, points, _ = case
    mesh = io.read(folder)
    (pair,) = io.periodic(mesh)
    assert (pair.patch, pair.partner) == ("in", "out")
    assert io.periodic(mesh.moved(points))
    assert not io.periodic(cases.bricks(cells=3))
    plan = jm.prepare(mesh, "walls", periodic=pair, method=jm.RBF.classic(jm.ThinPlateSpline()))
    u = 0.05 * np.random.default_rng(0).normal(size=(plan.n_moving, 3))
    moved = np.asarray(jm.deform(plan, u))
    assert np.abs(moved - points)[mesh.patch("in", "out")].max() > 0.01
    io.write(tmp_path / "moved", mesh.moved(moved))


def test_a_decomposed_case_is_warned_of(case, tmp_path):
    folder, _, points, _ = case
    mesh = io.read(folder)
    for k in range(2):
        (folder / f"processor{k}").mkdir()
    with pytest.warns(UserWarning, match=r"2 folders processor\* are not copied. Run decomposePar"):
        io.write(tmp_path / "new", mesh.moved(points + 1))
    with pytest.warns(UserWarning, match=r"2 folders processor\* keep the old points"):
        io.write(folder / "1", mesh.moved(points + 1))
