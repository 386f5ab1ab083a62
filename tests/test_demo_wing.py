"""The demo of the paper's wing: on a small mesh (slow), on the paper's against measured numbers (by hand)."""

import re

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxmorph as jm
from jaxmorph import cases, plot
from jaxmorph._demo import _wing, _wing_pictures, run

# Mean and largest aspect ratio, smallest V/V0: reduced RBF, 269 + 917 sources, and graph mapping alone.
EXPECTED = {
    (1, 0.0735): ((1.5285, 7.189, 0.982), (1.5285, 7.151, 0.895)),
    (1, 0.1): ((1.5301, 7.211, 0.975), (1.5302, 7.159, 0.857)),
    (1, 0.25): ((1.5480, 7.416, 0.937), (1.5487, 7.289, 0.642)),
    (1, 0.5): ((1.6080, 8.040, 0.875), (1.6109, 8.618, 0.284)),
    (1, 0.75): ((1.7018, 8.950, 0.812), (1.7092, 78.4, -0.074)),
    (2, 0.2): ((1.6272, 11.05, 0.845), (1.6006, 15.31, 0.277)),
    (2, 0.3): ((1.7429, 16.11, 0.767), (1.6888, 212.1, -0.084)),
}


def check_pictures(output):
    for name in ("agard445-surface.png", "agard445-cut.png"):
        picture = matplotlib.image.imread(output / name)
        assert picture.shape[1] == 1999
        assert picture[..., :3].std() > 0.05
        red, _, blue = np.moveaxis(picture[..., :3], -1, 0)
        assert (red - blue > 0.3).mean() > 0.01, "no cell is coloured"


@pytest.mark.nightly
def test_sources_are_counted():
    mesh = cases.agard445(points=6_500)
    wing, far = mesh.patch("wing"), mesh.patch("farfield")
    counts = {}
    for study in _wing.compare():
        plan = jm.prepare(mesh.points, wing, far, method=study.method)
        counts[study.name] = _wing._sources(plan)
        if study.name != "DGM":
            assert sum(counts[study.name]) == len(plan.sources)
    assert counts["DGM"] == (0, 0)
    assert counts["reduced RBF"][1] == len(far)


@pytest.mark.nightly
def test_the_camera_has_the_wing_in_sight_whole():
    """White all round, and not much of it."""
    mesh = cases.agard445(points=6_500)
    camera, half = _wing_pictures.whole(mesh.points[mesh.patch("wing")], _wing_pictures.ABOVE)
    axis = Figure().subplots()
    _wing_pictures._show(axis, plot.surface(mesh, patch="wing"), camera, half, "")
    drawn = (np.asarray(axis.images[0].get_array())[..., :3] < 250).any(axis=2)
    for rows in (drawn, drawn.T):
        first, last = np.flatnonzero(rows.any(axis=1))[[0, -1]] / len(rows)
        assert 0.01 < first < 0.03
        assert 0.97 < last < 0.99


@pytest.mark.full
def test_the_papers_mesh(tmp_path, capsys):
    assert run("agard445", tmp_path) == 0
    check_pictures(tmp_path)
    said = capsys.readouterr().out
    numbers = r"\s+([0-9.]+)\s+([0-9.]+)\s+(-?[0-9.]+)\s+(\d+)"
    rows = re.findall(rf"(?:DGM|reduced RBF|default){numbers}\n", said)
    found = np.array(rows, dtype=float).reshape(len(EXPECTED), 3, 4)
    for (reduced, graph), by_method in zip(EXPECTED.values(), found, strict=True):
        assert by_method[0, 2] == pytest.approx(graph[2], abs=0.005)
        for method in (1, 2):
            assert (np.abs(by_method[method, :3] - reduced) < (0.001, 0.1, 0.005)).all()
            assert by_method[method, 3] == 0
