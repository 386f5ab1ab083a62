"""The guard of an optimisation: a smooth constraint on cells, the rows of those that bind, and the history of iterations."""

import json
import re

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import scipy.optimize
from meshes import bricks
from runs import over

import jaxmorph as jm
from jaxmorph import cases, plot, shapes


@pytest.fixture(scope="module")
def airfoil():
    """A NACA0015, ten bumps on each side, and the area within it."""
    mesh = cases.naca0015(points=800)
    plan = jm.prepare(mesh, "airfoil", "farfield", method=jm.RBF.classic())
    wall = np.asarray(mesh.points)[plan.moving]
    upper = shapes.wall_normals(mesh, "airfoil")[:, 1] > 0
    bump = shapes.HicksHenne(np.linspace(0.05, 0.95, 10))
    sides = [
        jax.jacfwd(shapes.Part(bump, kept).at(wall))(jnp.zeros(10)) for kept in (upper, ~upper)
    ]
    weights = jnp.concatenate(sides, axis=2)
    ring = np.searchsorted(plan.moving, shapes.wall_loop(mesh, "airfoil"))
    motion = lambda p: weights @ p  # noqa: E731
    area = jax.jit(jax.value_and_grad(lambda p: shapes.area(wall + motion(p), ring)))
    return mesh, plan, motion, area


@pytest.mark.nightly
def test_the_constraint_is_below_the_smallest_ratio_and_its_derivatives_are_differences(airfoil):
    mesh, plan, motion, _ = airfoil
    design = jm.DesignedMesh(plan, mesh, motion, min_jacobian_ratio=0.2)
    guard = shapes.MeshGuard(design, sharpness=80.0)
    p = 0.004 * np.random.default_rng(0).normal(size=20)
    report = jm.quality(mesh, jm.deform(plan, motion(p)))
    smallest = float(report.jacobian_ratio.min())
    np.testing.assert_allclose(guard.smallest(p), smallest, rtol=1e-9)
    corners = 4 * len(mesh.cells["quad"])
    assert smallest - 0.2 - np.log(corners) / 80 <= guard.value(p) <= smallest - 0.2
    step = 1e-6 * np.random.default_rng(1).normal(size=20)
    difference = guard.value(p + step) - guard.value(p - step)
    np.testing.assert_allclose(2 * guard.gradient(p) @ step, difference, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(guard.value(p), float(jax.jit(guard)(p)), rtol=1e-9)


@over("count", [7], nightly=[30])
def test_rows_are_the_smallest_corners_and_their_slopes(airfoil, count):
    mesh, plan, motion, _ = airfoil
    guard = shapes.MeshGuard(jm.DesignedMesh(plan, mesh, motion, min_jacobian_ratio=0.1))
    p = 0.004 * np.random.default_rng(0).normal(size=20)
    rows = guard.quality_rows(p, count)
    report = jm.quality(mesh, jm.deform(plan, motion(p)))
    assert (np.diff(rows.values) >= 0).all()
    np.testing.assert_allclose(rows.values[0], report.jacobian_ratio.min() - 0.1, rtol=1e-9)
    assert rows.cells[0] == int(np.argmin(report.jacobian_ratio))
    below = np.flatnonzero(report.jacobian_ratio < rows.values[-1] + 0.1)
    assert set(below) <= set(rows.cells)
    h = 1e-6
    for k in (0, 7, 19):
        step = h * np.eye(20)[k]
        first, other = (guard.quality_rows(p + s * step, count) for s in (1, -1))
        np.testing.assert_allclose(
            (first.values - other.values) / (2 * h), rows.matrix[:, k], rtol=1e-3, atol=1e-3
        )


@pytest.mark.nightly
def test_cells_in_3d_count_by_their_corners():
    mesh = bricks(2)
    far = np.flatnonzero(np.asarray(mesh.points)[:, 2] == 1)
    plan = jm.prepare(mesh.points, mesh.patch("floor"), far, method=jm.RBF.classic())
    guard = shapes.MeshGuard(
        jm.DesignedMesh(plan, mesh, lambda p: jnp.zeros((len(plan.moving), 3)).at[:, 2].set(p[0]))
    )
    moved = jm.deform(plan, np.tile([0, 0, 0.3], (9, 1)))
    np.testing.assert_allclose(
        guard.smallest([0.3]), jm.quality(mesh, moved).jacobian_ratio.min(), rtol=1e-9
    )
    assert guard.smallest([1.5]) < 0
    assert guard.quality_rows([0.3], 72).values.shape == (
        72,
    )  # eight corners and the centre of eight cells
    with pytest.raises(ValueError, match="72 Jacobians"):
        guard.quality_rows([0.3], 73)


@over("count", [20], nightly=[None])
def test_an_optimiser_thins_an_airfoil_and_no_flow_sees_a_broken_mesh(airfoil, count):
    mesh, plan, motion, area = airfoil
    guard = shapes.MeshGuard(jm.DesignedMesh(plan, mesh, motion, min_jacobian_ratio=0.1))
    designs = []

    def objective(p):
        designs.append(np.array(p))
        value, slope = area(p)
        return float(value), np.asarray(slope)

    settings = {
        "jac": True,
        "method": "SLSQP",
        "bounds": [(-0.04, 0.04)] * 20,
        "options": {"maxiter": 12},
    }
    scipy.optimize.minimize(objective, np.zeros(20), **settings)
    assert min(guard.smallest(p) for p in designs) < 0  # without a guard cells invert at once
    designs.clear()
    given, kept = [], []
    keep = guard.callback(kept.append)
    result = scipy.optimize.minimize(
        guard.guarded(objective),
        np.zeros(20),
        constraints=guard.constraint(count),
        callback=lambda p: (given.append(p), keep(p)),
        **settings,
    )
    assert min(guard.smallest(p) for p in given) < 0 <= 0.1 <= min(guard.smallest(p) for p in kept)
    assert len(kept) == len(given)  # a history goes on from valid designs, one for each iteration
    assert min(guard.smallest(p) for p in designs) >= 0.1
    assert result.fun < 0.75 * area(np.zeros(20))[0]
    assert guard.smallest(result.x) >= 0.1 - 1e-6


def test_a_history_goes_on_after_a_kill(tmp_path):
    file = tmp_path / "wing.jsonl"
    history = shapes.History(file)
    assert len(history) == 0
    history.add(
        [0.0, 1.0], 2.0, constraints={"lift": 0.5, "thickness": [0.1, 0.2]}, measures={"ratio": 0.9}
    )
    history.add(
        np.array([0.5, 1.5]), np.float64(1.5), constraints={"lift": 0.4}, measures={"ratio": np.nan}
    )
    with file.open("a") as stream:
        stream.write('{"design": [0.1, 0')  # what a kill leaves
    again = shapes.History(file)
    np.testing.assert_array_equal(again.designs, [[0, 1], [0.5, 1.5]])
    np.testing.assert_array_equal(again.values, [2.0, 1.5])
    np.testing.assert_array_equal(again.column("lift"), [0.5, 0.4])
    np.testing.assert_array_equal(again.column("thickness"), [[0.1, 0.2], [np.nan, np.nan]])
    np.testing.assert_array_equal(again.column("ratio"), [0.9, np.nan])
    again.add([1.0, 2.0], np.inf)
    assert [json.loads(line)["value"] for line in file.read_text().splitlines()] == [2.0, 1.5, None]
    assert len(shapes.History(file)) == 3


def test_each_iteration_is_a_line_and_the_first_compiles(tmp_path, capsys):
    history = shapes.History(tmp_path / "wing.jsonl")
    history.add(
        [0.0], 0.25, constraints={"lift": 0.5, "thickness": [0.3, 0.1]}, measures={"ratio": np.nan}
    )
    history.add([0.5], np.inf)
    first, second = capsys.readouterr().err.splitlines()
    assert re.fullmatch(
        r"iteration 0: 0\.25, lift 0\.5, thickness 0\.1 to 0\.3, ratio nan \([\d.e-]+ s, with compiling\)",
        first,
    )
    assert re.fullmatch(r"iteration 1: nan \([\d.e-]+ s\)", second)


@pytest.mark.parametrize("is_given", [False, True])
def test_what_an_optimisation_did_has_a_panel_and_a_scale_for_each(tmp_path, is_given):
    history = shapes.History(tmp_path / "wing.jsonl")
    for k in range(4):
        history.add(
            [k], 1e-3 * k, constraints={"lift": 0.5 + 1e-3 * k, "thickness": [0.1, 0.2 * k]}
        )
    given = plt.subplots(1, 2)[1][1] if is_given else None
    first = plot.convergence(history, bounds={"lift": (0.45, np.inf)}, ax=given)
    assert given in (None, first)
    panels = first.figure.axes[is_given:]
    assert [panel.get_title(loc="left") for panel in panels] == ["objective", "lift", "thickness"]
    lines = [[line.get_ydata() for line in panel.lines] for panel in panels]
    np.testing.assert_array_equal(lines[0], [history.values])
    np.testing.assert_array_equal(lines[1][0], history.column("lift"))
    np.testing.assert_array_equal(lines[1][1], [0.45, 0.45])
    np.testing.assert_array_equal(lines[2], history.column("thickness").T)
    assert panels[0].get_ylim()[1] < 0.01 < panels[1].get_ylim()[0] < 0.45  # the bound is in view
    assert panels[1].get_position().y1 < panels[0].get_position().y0
    first.figure.canvas.draw()
    for panel in panels:  # numbers are whole: nothing stands in the title's place
        assert not panel.yaxis.get_offset_text().get_text()
        shown = [label.get_text() for label in panel.get_yticklabels()]
        assert len({*shown}) == len(shown)
    with pytest.raises(
        ValueError, match="no iteration has `name` 'drag'; there are: lift, thickness"
    ):
        plot.convergence(history, bounds={"drag": (0.0, 1.0)})
    with pytest.raises(ValueError, match="in no grid"):
        plot.convergence(history, ax=plt.figure().add_axes((0, 0, 1, 1)))


def test_what_is_no_history_is_told(tmp_path):
    file = tmp_path / "a.jsonl"
    file.write_text("nonsense\n")
    with pytest.raises(ValueError, match=r"a\.jsonl, line 1: no iteration"):
        shapes.History(file)
    assert file.read_text() == "nonsense\n"
    history = shapes.History(tmp_path / "b.jsonl")
    history.add([1.0], 1.0)
    with pytest.raises(ValueError, match=r"2 variables; .* has 1"):
        history.add([1.0, 2.0], 1.0)
    with pytest.raises(ValueError, match="no iteration has `name` 'drag'"):
        history.column("drag")
    with pytest.raises(ValueError, match="no iteration yet"):
        plot.convergence(shapes.History(tmp_path / "c.jsonl"))
