"""The paper's C-grid: its counts, its quality as VTK measures it, and the closed forms that it is made of."""

import numpy as np
import pytest
from oracles import check_geometry, polydata
from runs import over
from scipy.spatial import cKDTree

import jaxmorph as jm
from jaxmorph import cases


@pytest.fixture(scope="module")
def mesh() -> jm.Mesh:
    return cases.naca0015()


def test_counts(mesh):
    assert mesh.points.shape == (39_666, 2)
    assert mesh.points.dtype == np.float64
    assert {kind: ids.shape for kind, ids in mesh.cells.items()} == {"quad": (39_300, 4)}
    assert len(mesh.patch("farfield")) == 566
    assert len(mesh.patch("airfoil")) == 166


def test_geometry(mesh):
    check_geometry(mesh)


def test_skewness_is_the_papers(mesh):
    quality = polydata(mesh).cell_quality(["skew", "area"])
    skew, area = quality["skew"], quality["area"]
    assert np.sum(skew * area) / np.sum(area) == pytest.approx(0.0710, abs=5e-4)
    assert skew.max() == pytest.approx(0.1750, abs=1e-3)


def test_wall_is_the_section(mesh):
    x, y = mesh.points[mesh.patch("airfoil")].T
    expected = 0.75 * (
        0.2969 * np.sqrt(x) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4
    )
    on_base = (x == 1) & (np.abs(y) < expected - 1e-9)
    assert on_base.sum() == 5
    np.testing.assert_allclose(np.abs(y)[~on_base], expected[~on_base], atol=1e-15)
    assert x.min() == 0
    np.testing.assert_allclose(np.sort(y[x == 1]), np.linspace(-0.001575, 0.001575, 7), atol=1e-15)


def test_spacings(mesh):
    rays = mesh.points[: 151 * 261].reshape(151, 261, 2)
    along = np.linalg.norm(np.diff(rays[0], axis=0), axis=1)
    # Vinokur's closed form meets the spacings it is given to first order in the step
    np.testing.assert_allclose(along[[129, 130]], 0.003, rtol=0.06)
    np.testing.assert_allclose(along[[50, 209]], 1.05e-3, rtol=0.06)
    np.testing.assert_allclose(along[[49, 210]], 1.05e-3, rtol=1e-9)
    wake = along[210:]
    np.testing.assert_allclose(wake[1:] / wake[:-1], wake[1] / wake[0], rtol=1e-9)
    normal = np.linalg.norm(np.diff(rays, axis=0), axis=2)
    np.testing.assert_allclose(normal[0, 50:211], 1e-5, rtol=1e-9)
    np.testing.assert_allclose(normal[0, [0, -1]], 0.108 * 1e-5 + 0.892 * 1e-3, rtol=1e-9)
    np.testing.assert_allclose(normal.sum(axis=0), 15, rtol=1e-12)


def test_symmetric_about_the_chord(mesh):
    distance, _ = cKDTree(mesh.points).query(mesh.points * [1, -1])
    assert distance.max() < 1e-9


@over("points", [300, 700, 2_000], nightly=[10_000, 150_000])
def test_other_numbers_of_points(points):
    mesh = cases.naca0015(points=points)
    assert len(mesh.points) == pytest.approx(points, rel=0.05 if points >= 2_000 else 0.15)
    check_geometry(mesh)


@pytest.mark.nightly
def test_a_million_points():
    mesh = cases.naca0015(points=1_000_000)
    assert len(mesh.points) == pytest.approx(1_000_000, rel=0.01)
    assert polydata(mesh).cell_quality("scaled_jacobian")["scaled_jacobian"].min() > 0
