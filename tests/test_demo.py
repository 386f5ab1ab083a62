"""The paper's two cases from one command each: on small meshes in full, on the paper's against its numbers (by hand the wing)."""

import os
import pathlib
import re
import subprocess
import sys

import matplotlib.image
import meshio
import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph import _demo, cases, io

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

# Mean and largest aspect ratio, smallest V/V0: reduced RBF, 269 + 917 sources, and graph mapping alone.
WING = {
    (1, 0.0735): ((1.5285, 7.189, 0.982), (1.5285, 7.151, 0.895)),
    (1, 0.1): ((1.5301, 7.211, 0.975), (1.5302, 7.159, 0.857)),
    (1, 0.25): ((1.5480, 7.416, 0.937), (1.5487, 7.289, 0.642)),
    (1, 0.5): ((1.6080, 8.040, 0.875), (1.6109, 8.618, 0.284)),
    (1, 0.75): ((1.7018, 8.950, 0.812), (1.7092, 78.4, -0.074)),
    (2, 0.2): ((1.6272, 11.05, 0.845), (1.6006, 15.31, 0.277)),
    (2, 0.3): ((1.7429, 16.11, 0.767), (1.6888, 212.1, -0.084)),
}

ROOT = pathlib.Path(__file__).parents[1]


def turned(points, degrees):
    """Nose up about the quarter chord, by complex numbers."""
    z = (points[:, 0] + 1j * points[:, 1] - 0.25) * np.exp(-1j * np.deg2rad(degrees)) + 0.25
    return np.column_stack([z.real, z.imag])


def check_files(output, said, start, patch, motion, measure, methods):
    """Pictures and meshes in a folder: all that were announced, coloured, moved as told, the measure of each cell beside."""
    written = [pathlib.Path(line.strip()) for line in said.split("\nwrote")[1].strip().splitlines()]
    assert sorted(written) == sorted(output.iterdir())
    pictures = list(output.glob("*.png"))
    assert len(pictures) == 2
    for file in pictures:
        picture = matplotlib.image.imread(file)
        assert picture.shape[1] in (1100, 1999)
        assert picture[..., :3].std() > 0.05
        red, _, blue = np.moveaxis(picture[..., :3], -1, 0)
        assert file.name == "figure6.png" or (red - blue > 0.3).mean() > 0.01, "no cell is coloured"
    wall, far = start.patch(patch), start.patch("farfield")
    d, name = start.points.shape[1], next(output.glob("*-undeformed.su2")).name.split("-")[0]
    for method in methods:
        moved = io.read(output / f"{name}-{method}.su2")
        np.testing.assert_array_equal(moved.patch(patch), wall)
        np.testing.assert_array_equal(moved.points[far], start.points[far])
        np.testing.assert_allclose(moved.points[wall], motion(start.points[wall]), atol=1e-14)
        to_look_at = meshio.read(output / f"{name}-{method}.vtu")
        np.testing.assert_array_equal(to_look_at.points[:, :d], moved.points)
        displacement = moved.points - start.points
        np.testing.assert_allclose(
            to_look_at.point_data["displacement"][:, :d], displacement, atol=1e-15
        )
        expected = np.asarray(getattr(jm.quality(start, moved.points), measure))
        np.testing.assert_allclose(to_look_at.cell_data[measure][0], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_the_demo_leaves_tables_pictures_and_meshes(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(_demo, "TREES", (1,))
    output = tmp_path / "made" / "for it"
    assert _demo.run_paper_case(output, points=2000) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert max(map(len, said.out.split("\nwrote")[0].splitlines())) <= 80
    assert "reduced RBF, 4 + " in said.out
    assert "DGM, ids found again" in said.out
    start, methods = cases.naca0015(points=2000), ("full-rbf", "dgm", "reduced-rbf")
    check_files(output, said.out, start, "airfoil", lambda x: turned(x, 15), "skewness", methods)


@pytest.mark.parametrize(
    "points",
    [pytest.param(6_500, marks=pytest.mark.nightly), pytest.param(64_943, marks=pytest.mark.full)],
)
def test_the_wing_leaves_tables_pictures_and_meshes(tmp_path, points):
    agard445 = pytest.importorskip("benchmarks.agard445")
    command = [
        sys.executable,
        ROOT / "benchmarks/wing.py",
        "--points",
        str(points),
        "--output",
        tmp_path / "wing",
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    start = agard445.mesh(points)
    methods = ("dgm", "reduced-rbf", "default")
    check_files(
        tmp_path / "wing",
        done.stdout,
        start,
        "wing",
        lambda x: x + agard445.mode(x, 1, 0.5),
        "aspect_ratio",
        methods,
    )
    _, far = re.search(r"reduced RBF +(\d+) +(\d+) ", done.stdout).groups()
    assert int(far) == len(start.patch("farfield"))
    numbers = r"\s+([0-9.]+)\s+([0-9.]+)\s+(-?[0-9.]+)\s+(\d+)"
    rows = re.findall(rf"(?:DGM|reduced RBF|default){numbers}\n", done.stdout)
    found = np.array(rows, dtype=float).reshape(len(WING), 3, 4)
    assert not found[:, 1:, 3].any(), "cells are inverted"
    if points == 64_943:
        for (reduced, graph), by_method in zip(WING.values(), found, strict=True):
            assert by_method[0, 2] == pytest.approx(graph[2], abs=0.005)
            for method in (1, 2):
                assert (np.abs(by_method[method, :3] - reduced) < (0.001, 0.1, 0.005)).all()


def test_cells_next_to_the_wall():
    mesh = cases.naca0015()
    expected = (np.arange(60)[:, None] * 260 + np.arange(50, 210)).ravel()
    np.testing.assert_array_equal(_demo.near_wall(mesh), expected)
    small = cases.naca0015(points=3000)
    near = np.unique(small.cells["quad"][_demo.near_wall(small)])
    base = small.points[:, 0].max()  # wall nodes between the corners of the base touch no such cell
    wall = small.patch("airfoil")
    blunt = small.points[wall, 0] >= small.points[wall, 0].max() - 1e-12
    assert np.isin(wall[~blunt], near).all()
    assert small.points[near, 0].max() < base / 2


def test_progress_is_for_a_terminal_alone(capsys, monkeypatch):
    _demo.say("first")
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    _demo.say("the second step")
    assert capsys.readouterr() == ("", "the second step ...\n")


@pytest.mark.nightly
def test_figure_6_of_the_paper():
    mesh = cases.naca0015()
    start = jm.quality(mesh)
    found = {study.name: _demo.outcome_of(mesh, start, study) for study in _demo.studies_of(mesh)}
    assert list(found) == list(EXPECTED)
    for name, (mean, largest, change) in EXPECTED.items():
        outcome, within = found[name], 0.001 if name.startswith("full") else 0.003
        np.testing.assert_allclose(
            (*outcome.skewness[-1], outcome.change), (mean, largest, change), atol=within
        )
        assert outcome.inverted == 0
        assert outcome.error < 1e-14
    full, dgm, reduced = (
        found[name].skewness for name in list(EXPECTED)[:4] if name != "DGM, ids found again"
    )
    for at_full, at_dgm, at_reduced in zip(full, dgm, reduced, strict=True):
        assert at_dgm[0] < at_reduced[0] < at_full[0]
        assert at_full[1] < at_reduced[1] < at_dgm[1]
