"""Methods compared on a family of motions: each row is what its plan does, and the best comes first."""

import math
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial
from meshes import ring, unit_box

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._advice.methods import MOST_POINTS


@pytest.fixture(scope="module")
def problem():
    mesh = cases.naca0015(points=1200)
    return jm.Boundary(mesh, "airfoil", "farfield"), mesh.points[mesh.patch("airfoil")]


def test_rows_say_what_the_plans_do_and_the_best_comes_first():
    """With a symmetry plane, a motion that folds cells and a method that is refused."""
    mesh = ring()
    boundary = jm.Boundary(mesh, "wall", "far")
    base = np.asarray(mesh.points)[boundary.moving]
    motions = np.stack([0.4 * np.sin(k * base[:, ::-1]) for k in (1, 4)])
    none = jm.RBF(reduction=jm.FarthestPoints(1), fixed_reduction=jm.FarthestPoints(1))
    methods = {
        "one source": none,
        "graph": jm.DelaunayGraph(),
        "default": jm.SurfaceReconstruction(),
    }
    methods |= {"springs": jm.SpringAnalogy(), "distance": jm.InverseDistance()}
    found = jm.compare(boundary, motions, methods)
    assert sorted(row.method for row in found.rows) == sorted(methods)
    for row, plan in zip(found.rows[:-1], found.plans[:-1], strict=True):
        assert type(plan.method) is type(methods[row.method])
        points = [jm.deform(plan, u) for u in motions]
        reports = [jm.quality(mesh, x) for x in points]
        assert row.inverted == sum(int(report.inverted) for report in reports)
        assert row.ratio == min(float(report.min_jacobian_ratio) for report in reports)
        angles = [float(jm.wall_quality(mesh, "wall", x).mean_angle) for x in points]
        np.testing.assert_allclose(row.angle, np.mean(angles), rtol=1e-12)
        assert row.seconds >= 0
        assert row.sources == (len(plan.sources) or None)
    keys = [(row.inverted, -row.ratio) for row in found.rows[:-1]]
    assert keys == sorted(keys)
    assert keys[-1][0] > 0
    assert found.rows[-1].method == "one source"
    assert found.plans[-1] is None
    assert math.isnan(found.rows[-1].ratio)
    text = str(found).splitlines()
    names = [row.method.split()[0] for row in found.rows]
    assert [line.split()[0] for line in text[1 : 1 + len(methods)]] == names
    assert text[-1].startswith("one source: ")


def test_a_boundary_keeps_its_planes():
    mesh = unit_box()
    boundary = jm.Boundary(mesh, "z1", "z0", symmetry="x0", free=["x1", "y0", "y1"])
    u = np.full((1, len(boundary.moving), 3), 0.01)
    plan = jm.compare(boundary, u, {"graph": jm.Multiscale()}).plans[0]
    assert plan.images is not None
    np.testing.assert_array_equal(
        jm.deform(plan, u[0]), jm.deform(jm.prepare(boundary, method=plan.method), u[0])
    )


@pytest.mark.parametrize("name", jm.METHODS)
def test_the_list_says_of_a_method_what_the_method_says_of_itself(name):
    entry = jm.METHODS[name]
    method = entry.make(1.0)
    assert isinstance(method, jm.AbstractMethod)
    assert entry.needs_cells == method.needs_cells
    if entry.sources == "some":
        coarse = method.coarse.rbf if isinstance(method.coarse, jm.FittedRBF) else method.coarse
        assert isinstance(coarse, jm.RBF)


def test_titles_of_methods_are_unique():
    assert len({entry.title or name for name, entry in jm.METHODS.items()}) == len(jm.METHODS)


@pytest.mark.nightly
def test_camber_asks_for_the_cells(problem, monkeypatch):
    """Elastic and torsional cells turn with the wall."""
    boundary, base = problem
    camber = 0.2 * (base[:, :1] - base[:, :1] ** 2) * [0, 1]
    first = jm.compare(boundary, jnp.asarray(camber[None]))
    names = {
        "default",
        "interpolated",
        *(name for name, entry in jm.METHODS.items() if entry.is_tried),
    }
    assert {row.method for row in first.rows} == names
    angles = {row.method: row.angle for row in first.rows}
    assert (
        max(angles["elasticity"], angles["torsional"]) < angles["default"] < angles["interpolated"]
    )
    assert angles["elasticity"] < angles["graph"]
    assert all(row.seconds > 0 for row in first.rows)
    monkeypatch.setitem(MOST_POINTS, 2, 1000)
    skipped = jm.compare(boundary, camber[None])
    assert "elasticity: skipped: 1279 points" in str(skipped)
    assert not any(plan.method.needs_cells for plan in skipped.plans if plan is not None)


def test_where_sources_determine_no_field_other_methods_are_left():
    """Two nodes span no plane, four nodes around them hold one more inside."""
    points = np.random.default_rng(0).random((12, 2))
    mesh = jm.Mesh(points, {"triangle": scipy.spatial.Delaunay(points).simplices})
    motions = np.full((1, 1, 2), 1e-3)
    methods = {"default": jm.SurfaceReconstruction(), "by distance": jm.InverseDistance()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of faces in no list
        boundary = jm.Boundary(mesh, [0], [1])
        found = jm.compare(boundary, motions, methods)
        assert isinstance(found.plans[0].method, jm.InverseDistance)
        assert "do not span 2 dimensions" in found.rows[1].refused
        del methods["by distance"]
        with pytest.raises(
            ValueError, match=r"every method is refused\. default: .*do not span 2 dimensions"
        ):
            jm.compare(boundary, motions, methods)
