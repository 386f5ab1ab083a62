"""The component of OpenMDAO, judged by OpenMDAO's own checks."""

import sys
import tracemalloc

import numpy as np
import pytest
from cases import body, motion

import jaxmorph as jm

om = pytest.importorskip("openmdao.api")


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch, tmp_path):
    """OpenMDAO makes folders where it runs."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def plan():
    one = body(2)
    return jm.prepare(one.points, one.moving, one.fixed, method=jm.DelaunayGraph())


def given(plan):
    return motion(np.asarray(plan.points)[np.asarray(plan.moving)])


def component(**options):
    from jaxmorph.integrations.openmdao import MeshDeformation

    return MeshDeformation(**options)


@pytest.mark.parametrize("flat", [False, True])
def test_partials_pass_openmdaos_check(plan, flat):
    problem = om.Problem(reports=False)
    problem.model.add_subsystem("mesh", component(plan=plan, flat=flat, units="m"), promotes=["*"])
    problem.setup()
    np.testing.assert_array_equal(problem.get_val("points").ravel(), np.asarray(plan.points).ravel())
    u = given(plan)
    problem.set_val("displacements", u.ravel() if flat else u)
    problem.run_model()
    np.testing.assert_array_equal(problem.get_val("points").reshape(-1, 2), jm.deform(plan, u))
    assert problem.get_val("points", units="mm").ravel()[0] == pytest.approx(1e3 * np.asarray(jm.deform(plan, u))[0, 0])
    # the map is linear: a large step loses nothing, and rounding is all that is left
    data = problem.check_partials(out_stream=None, compact_print=True, step=1.0)
    found = data["mesh"]["points", "displacements"]
    for mode in ("J_fwd", "J_rev"):
        assert found[mode].shape == (plan.points.size, u.size)
        np.testing.assert_allclose(found[mode], found["J_fd"], atol=1e-12)
    assert np.abs(found["J_fd"]).max() == pytest.approx(1)


def test_no_matrix_is_set_aside():
    """A mesh of 64,764 nodes with 16,230 on its wing would need 70 GiB."""
    x = np.linspace(0, 1, 41)
    points = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    inner = ((points > 0) & (points < 1)).all(axis=1)
    moving = np.flatnonzero(inner)[::3]
    plan = jm.prepare(points, moving, np.flatnonzero(~inner), method=jm.DelaunayGraph())
    problem = om.Problem(reports=False)
    problem.model.add_subsystem("mesh", component(plan=plan), promotes=["*"])
    tracemalloc.start()
    problem.setup()
    problem.final_setup()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * points.size * 2 * len(moving) / 4


@pytest.mark.parametrize("mode", ["fwd", "rev"])
def test_totals_through_a_model(plan, mode):
    """dJ/da of J = sum of w * points for displacements a * u, by both products, beside the linear map itself."""
    u, weights = given(plan), np.random.default_rng(0).normal(size=plan.points.shape)
    problem = om.Problem(reports=False)
    problem.model.add_subsystem(
        "bump", om.ExecComp("u = a * form", form={"val": u}, u={"shape": u.shape}), promotes=["a"]
    )
    problem.model.add_subsystem("mesh", component(plan=plan))
    objective = om.ExecComp("J = sum(w * x)", w={"val": weights}, x={"shape": weights.shape})
    problem.model.add_subsystem("objective", objective, promotes=["J"])
    problem.model.connect("bump.u", "mesh.displacements")
    problem.model.connect("mesh.points", "objective.x")
    problem.setup(mode=mode)
    problem.set_val("a", 0.7)
    problem.run_model()
    expected = np.vdot(weights, jm.deform(plan, u) - plan.points)
    np.testing.assert_allclose(problem.compute_totals("J", "a")["J", "a"].item(), expected, rtol=1e-10)


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.delitem(sys.modules, "jaxmorph.integrations.openmdao", raising=False)
    monkeypatch.setitem(sys.modules, "openmdao.api", None)
    with pytest.raises(ImportError, match=r"needs openmdao: pip install 'jaxmorph\[openmdao\]'"):
        import jaxmorph.integrations.openmdao  # noqa: F401
