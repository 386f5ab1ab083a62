"""The demo of the paper's airfoil: on a small mesh in full, on the paper's against its numbers (slow)."""

import pathlib
import sys

import matplotlib.image
import meshio
import numpy as np
import pytest
from runs import runs

import jaxmorph as jm
from jaxmorph import cases, io
from jaxmorph._demo import _airfoil, _terminal, run

# Mean and largest skewness at 15 degrees, change at the wall; a prototype's values.
EXPECTED = {
    "full RBF, 166 + 566": (0.0932, 0.2570, 0.008),
    "DGM, ids kept": (0.0733, 0.4144, 0.155),
    "DGM, ids found again": (0.0723, 0.4109, 0.155),
    "reduced RBF, 4 + 6": (0.0912, 0.280, 0.057),
    "reduced RBF, 8 + 6": (0.0925, 0.2702, 0.035),
    "reduced RBF, 16 + 6": (0.0934, 0.2643, 0.023),
    "reduced RBF, 32 + 6": (0.0937, 0.2646, 0.018),
}


def turned(points, degrees):
    """Nose up about the quarter chord, by complex numbers."""
    z = (points[:, 0] + 1j * points[:, 1] - 0.25) * np.exp(-1j * np.deg2rad(degrees)) + 0.25
    return np.column_stack([z.real, z.imag])


def turned_airfoil(points):
    return turned(points, 15)


def bent_wing(points):
    return points + cases.agard445_mode(points, 1, 0.5)


DEMOS = {
    "naca0015": (2000, "airfoil", turned_airfoil, "skewness", ("full-rbf", "dgm", "reduced-rbf")),
    "agard445": (6500, "wing", bent_wing, "aspect_ratio", ("dgm", "reduced-rbf", "default")),
}
"""Nodes, patch, its motion, the measure that is drawn, and the methods, of each demo."""
SAID = {
    "naca0015": ("reduced RBF, 4 + ", "DGM, ids found again"),
    "agard445": ("mode 1, 0.75", "mode 2, 0.3", "reduced RBF", "default", "6592 points"),
}


@pytest.mark.parametrize("name", runs(slow=["naca0015"], nightly=["agard445"]))
def test_the_demo_leaves_tables_pictures_and_meshes(name, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(_airfoil, "LEAVES", (1,))
    count, patch, motion, measure, methods = DEMOS[name]
    output = tmp_path / "made" / "for it"
    assert run(name, output, points=count) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert max(map(len, said.out.split("\nwrote")[0].splitlines())) <= 80
    for words in SAID[name]:
        assert words in said.out
    written = [pathlib.Path(line.strip()) for line in said.out.split("\nwrote")[1].strip().splitlines()]
    assert sorted(written) == sorted(output.iterdir())
    for file in output.glob("*.png"):
        picture = matplotlib.image.imread(file)
        assert picture.shape[1] == 1999
        assert picture[..., :3].std() > 0.05
        red, _, blue = np.moveaxis(picture[..., :3], -1, 0)
        assert name == "naca0015" or (red - blue > 0.3).mean() > 0.01, "no cell is coloured"
    assert len(list(output.glob("*.png"))) == 2
    start = getattr(cases, name)(points=count)
    wall, far = start.patch(patch), start.patch("farfield")
    d = start.points.shape[1]
    for method in methods:
        moved = io.read(output / f"{name}-{method}.su2")
        np.testing.assert_array_equal(moved.patch(patch), wall)
        np.testing.assert_array_equal(moved.points[far], start.points[far])
        np.testing.assert_allclose(moved.points[wall], motion(start.points[wall]), atol=1e-14)
        to_look_at = meshio.read(output / f"{name}-{method}.vtu")
        np.testing.assert_array_equal(to_look_at.points[:, :d], moved.points)
        displacement = moved.points - start.points
        np.testing.assert_allclose(to_look_at.point_data["displacement"][:, :d], displacement, atol=1e-15)
        expected = np.asarray(getattr(jm.quality(start, moved.points), measure))
        np.testing.assert_allclose(to_look_at.cell_data[measure][0], expected, rtol=1e-9, atol=1e-9)


def test_rotation_is_nose_up():
    nose, tail = np.array([[0.0, 0.0]]), np.array([[1.0, 0.0]])
    assert _airfoil.rotation(nose, 15.0)[0, 1] > 0 > _airfoil.rotation(tail, 15.0)[0, 1]
    points = np.random.default_rng(1).normal(size=(9, 2))
    np.testing.assert_allclose(points + _airfoil.rotation(points, 15.0), turned(points, 15), atol=1e-14)


def test_cells_next_to_the_wall():
    mesh = cases.naca0015()
    expected = (np.arange(60)[:, None] * 260 + np.arange(50, 210)).ravel()
    np.testing.assert_array_equal(_airfoil.near_wall(mesh), expected)
    small = cases.naca0015(points=3000)
    near = np.unique(small.cells["quad"][_airfoil.near_wall(small)])
    base = small.points[:, 0].max()  # wall nodes between the corners of the base touch no such cell
    wall = small.patch("airfoil")
    blunt = small.points[wall, 0] >= small.points[wall, 0].max() - 1e-12
    assert np.isin(wall[~blunt], near).all()
    assert small.points[near, 0].max() < base / 2


def test_an_unknown_case_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"'wing'.*there are: naca0015"):
        run("wing", tmp_path)


def test_table_aligns_columns():
    text = _terminal.table([("method", "mean")], [("a", "0.1"), ("a longer one", "22.25")])
    lines = text.splitlines()
    assert lines == ["method         mean", "-------------------", "a               0.1", "a longer one  22.25"]


def test_progress_speaks_on_a_terminal_alone(capsys, monkeypatch):
    with _terminal.progress(2) as say:
        say("first")
    assert capsys.readouterr() == ("", "")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    with _terminal.progress(2) as say:
        say("the first step")
        say("the second step")
    said = capsys.readouterr()
    assert "the second step" in said.err
    assert said.out == ""


@pytest.mark.nightly
def test_figure_6_of_the_paper():
    mesh = cases.naca0015()
    start = jm.quality(mesh)
    found = {study.name: _airfoil.measure(mesh, start, study) for study in _airfoil.compare(mesh)}
    assert list(found) == list(EXPECTED)
    for name, (mean, largest, change) in EXPECTED.items():
        outcome, within = found[name], 0.001 if name.startswith("full") else 0.003
        np.testing.assert_allclose((*outcome.skewness[-1], outcome.change), (mean, largest, change), atol=within)
        assert outcome.inverted == 0
        assert outcome.error < 1e-14
    full, dgm, reduced = (found[name].skewness for name in list(EXPECTED)[:4] if name != "DGM, ids found again")
    for at_full, at_dgm, at_reduced in zip(full, dgm, reduced, strict=True):
        assert at_dgm[0] < at_reduced[0] < at_full[0]
        assert at_full[1] < at_reduced[1] < at_dgm[1]
