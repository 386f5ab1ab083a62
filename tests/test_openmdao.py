"""The component of OpenMDAO, judged by OpenMDAO's own checks."""

import sys
import tracemalloc

import numpy as np
import pytest
from cases import body, motion
from meshes import lattice, write_ring
from runs import runs

import jaxmorph as jm

om = pytest.importorskip("openmdao.api")
pytestmark = [  # OpenMDAO makes folders where it runs
    pytest.mark.filterwarnings("ignore:inverted cells are not seen"),
    pytest.mark.usefixtures("here"),
]


@pytest.fixture(scope="module")
def plan():
    one = body(2)
    return jm.prepare(one.points, one.moving, one.fixed, method=jm.DelaunayGraph())


def given(plan):
    return motion(np.asarray(plan.points)[np.asarray(plan.moving)])


def component(**options):
    from jaxmorph.integrations.openmdao import MeshDeformation

    return MeshDeformation(**options)


@pytest.mark.parametrize("flat", runs([False], nightly=[True]))
def test_partials_pass_openmdaos_check(plan, flat):
    problem = run(plan=plan, flat=flat, units="m")
    np.testing.assert_array_equal(
        problem.get_val("points").ravel(), np.asarray(plan.points).ravel()
    )
    u = given(plan)
    problem.set_val("displacements", u.ravel() if flat else u)
    problem.run_model()
    np.testing.assert_allclose(
        problem.get_val("points").reshape(-1, 2), jm.deform(plan, u), rtol=0, atol=1e-15
    )
    assert problem.get_val("points", units="mm").ravel()[0] == pytest.approx(
        1e3 * np.asarray(jm.deform(plan, u))[0, 0]
    )
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
    points = lattice(x, x)
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


@pytest.mark.filterwarnings("default")
def test_inverted_cells_raise_analysis_error_by_default(tmp_path):
    """By which an optimiser shortens its step. Cells that are inverted from the start do not count."""
    mesh = write_ring(tmp_path / "ring.su2")
    quads = np.array(mesh.cells["quad"])
    quads[0] = quads[0][[1, 0, 2, 3]]  # crossed from the start
    plan = jm.prepare(mesh, "wall", "far", method=jm.DelaunayGraph())
    mesh = jm.Mesh(
        mesh.points,
        {"line": np.stack([np.arange(24), np.arange(1, 25) % 24], axis=1), "quad": quads},
    )
    u = np.tile([0.0, 1.0], (24, 1))
    with pytest.warns(UserWarning, match="inverted cells are not seen: pass the mesh"):
        run(plan=plan)
    for factor in (0.1, 5.0, np.nan):
        report = jm.quality(mesh, jm.deform(plan, factor * u))
        count = int((report.is_inverted & ~report.was_inverted)[24:].sum())  # 24 lines come first
        assert (count > 0) == (factor != 0.1)
        problem = run(plan=plan, mesh=mesh)
        problem.set_val("displacements", factor * u)
        if not count:
            problem.run_model()
            continue
        with pytest.raises(
            om.AnalysisError, match=f"mesh: {count} of 192 cells are inverted, first cell"
        ):
            problem.run_model()
        problem = run(plan=plan, mesh=mesh, raise_if_inverted=False)
        problem.set_val("displacements", factor * u)
        problem.run_model()
    with pytest.raises(ValueError, match=r"shape \(216, 2\); this mesh has \(215, 2\)"):
        run(plan=plan, mesh=jm.Mesh(mesh.points[:-1], {"triangle": [[0, 1, 2]]}))


def run(**options):
    """Runs the undeformed mesh."""
    problem = om.Problem(reports=False)
    problem.model.add_subsystem("mesh", component(**options), promotes=["*"])
    problem.setup()
    problem.run_model()
    return problem


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    monkeypatch.delitem(sys.modules, "jaxmorph.integrations.openmdao", raising=False)
    monkeypatch.setitem(sys.modules, "openmdao.api", None)
    with pytest.raises(ImportError, match=r"needs openmdao: pip install 'jaxmorph\[openmdao\]'"):
        import jaxmorph.integrations.openmdao  # noqa: F401


def bend(x, p):
    """A nonlinear shape of a dict of parameters."""
    from jaxmorph import shapes

    return shapes.rotate(x, p["turn"]["angle"], [0.1, 0.0]) + p["shift"][None, :] * x[:, :1] ** 2


@pytest.mark.slow
def test_a_shape_passes_openmdaos_check_and_moves_the_mesh(plan):
    """In a model with the mesh: displacements, positions, and the gradient of the volume by the shape's parameters."""
    from jaxmorph import shapes
    from jaxmorph.integrations.openmdao import ShapeDisplacement

    shape = shapes.Function(bend, {"turn": {"angle": 0.0}, "shift": np.zeros(2)})
    given = {"turn": {"angle": 0.2}, "shift": np.array([0.05, -0.02])}
    problem = om.Problem(reports=False)
    model = problem.model
    model.add_subsystem("shape", ShapeDisplacement(shape=shape, plan=plan), promotes=["*"])
    model.add_subsystem(
        "wall",
        ShapeDisplacement(shape=bend, plan=plan, parameters=given, positions=True, flat=True),
    )
    model.add_subsystem("mesh", component(plan=plan), promotes=["*"])
    problem.setup()
    np.testing.assert_array_equal(problem.get_val("displacements"), 0)
    problem.set_val("turn:angle", 0.2)
    problem.set_val("shift", given["shift"])
    problem.run_model()
    u = shapes.displacement(shape, plan, given)
    np.testing.assert_allclose(problem.get_val("points"), jm.deform(plan, u), atol=1e-15)
    expected = np.asarray(plan.points)[np.asarray(plan.moving)] + u
    np.testing.assert_allclose(problem.get_val("wall.positions"), np.ravel(expected), atol=1e-15)
    data = problem.check_partials(
        out_stream=None, includes=["shape", "wall"], method="fd", form="central", step=1e-5
    )
    for name, out in (("shape", "displacements"), ("wall", "positions")):
        for entry in (data[name][out, "turn:angle"], data[name][out, "shift"]):
            for mode in ("J_fwd", "J_rev"):
                np.testing.assert_allclose(entry[mode], entry["J_fd"], atol=1e-8)
    bare = om.Problem(reports=False)
    bare.model.add_subsystem("shape", ShapeDisplacement(shape=bend, plan=plan))
    with pytest.raises(ValueError, match="`parameters` is missing"):
        bare.setup()
