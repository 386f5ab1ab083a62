"""The largest step that keeps a bound, and velocities of the mesh."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from meshes import bricks, filled, reflected, with_folds, write_ring
from runs import over

import jaxmorph as jm
from jaxmorph._advice.largest_step import first_roots


def ring(tmp_path):
    mesh = write_ring(tmp_path / "ring.su2")
    plan = jm.prepare(mesh.points, mesh.patch("wall"), mesh.patch("far"), method=jm.DelaunayGraph())
    rng = np.random.default_rng(0)
    return mesh, plan, rng.normal(size=(24, 2)), rng.normal(size=(24, 2))


def test_roots_are_those_of_numpy():
    coefficients = np.random.default_rng(0).normal(size=(4, 300))
    coefficients[0] = np.abs(coefficients[0])
    coefficients[2:, 100:200] = 0
    coefficients[3, 200:] = 0
    for row, root in zip(coefficients.T, first_roots(coefficients), strict=True):
        every = np.roots(np.trim_zeros(row[::-1], "f"))
        real = every.real[np.abs(every.imag) < 1e-12]
        inside = real[(real > 0) & (real < 1)]
        np.testing.assert_allclose(root, inside.min() if len(inside) else np.inf, rtol=1e-7)


@pytest.mark.parametrize("bound", [0.0, 0.3])
def test_the_bound_is_met_exactly_in_the_cell_that_is_told(tmp_path, bound):
    mesh, plan, u, direction = ring(tmp_path)
    u = 0.01 * u
    result = jm.largest_step(plan, u, direction, mesh, min_jacobian_ratio=bound)
    assert 0 < result.step < 1
    ratios = np.asarray(
        jm.quality(mesh, jm.deform(plan, u + result.step * direction)).jacobian_ratio
    )
    assert ratios.min() == pytest.approx(bound, abs=1e-9)
    assert ratios.argmin() == result.cell
    for share in np.linspace(0, 0.999, 8):
        assert (
            jm.quality(
                mesh, jm.deform(plan, u + share * result.step * direction)
            ).jacobian_ratio.min()
            > bound
        )


@over("kind", ["triangle", "quad"], slow=["tetra", "wedge", "pyramid", "hexahedron", "triangle6"])
@pytest.mark.parametrize("bound", [0.0, 0.2])
def test_the_step_that_is_proven_proves(kind, bound):
    """However cells are numbered. A step a little longer breaks the bound: nothing is given away."""
    mesh = filled(kind)
    points, d = np.asarray(mesh.points), mesh.points.shape[1]
    moving, turned = np.flatnonzero(points[:, 0] == 0), reflected(mesh)
    fixed = np.setdiff1d(mesh.patch("boundary"), moving)
    for seed in range(3):
        plan = jm.prepare(points, moving, fixed, method=jm.DelaunayGraph())
        direction = 3 * np.random.default_rng(seed).normal(size=(len(moving), d))
        result = jm.largest_step(
            plan, 0 * direction, direction, turned, min_jacobian_ratio=bound, proven=True
        )
        assert 0 < result.step < 1
        at = jm.deform(plan, result.step * direction)
        report = jm.proof(turned, at)
        assert report.valid == report.count
        shorter = jm.deform(plan, result.step * (1 - 1e-9) * direction)
        assert jm.proof(turned, shorter, base=points).valid == report.count
        if (
            mesh.points.shape[1] == len(mesh.cells[kind][0]) - 1
        ):  # of a simplex the margin is the ratio
            margin = np.asarray(jm.proven_margin(turned, at))
            assert margin.min() >= bound
            assert margin.min() == pytest.approx(bound, abs=1e-9)
            assert margin.argmin() == result.cell
            longer = jm.proven_margin(turned, jm.deform(plan, result.step * (1 + 1e-6) * direction))
            assert longer.min() < bound
        corners = jm.largest_step(plan, 0 * direction, direction, mesh, min_jacobian_ratio=bound)
        assert 0.5 * corners.step < result.step <= corners.step


def test_cells_that_arrive_folded_end_no_step_and_are_no_proof():
    """A folded triangle that the motion unfolds breaks no bound by that."""
    mesh = filled("triangle")
    mesh = reflected(mesh.moved(with_folds(mesh)))
    points = np.asarray(mesh.points)
    moving = np.flatnonzero(points[:, 0] == 0)
    plan = jm.prepare(points, moving, np.flatnonzero(points[:, 0] == 1), method=jm.RBF())
    u = np.tile([0.01, 0.0], (len(moving), 1))
    assert jm.largest_step(plan, 0 * u, u, mesh) == jm.LargestStep(1.0, -1)
    words = (
        r"\d of \d+ cells of the undeformed mesh are not proven valid, first cell \d+.*proven=False"
    )
    with pytest.raises(ValueError, match=words):
        jm.largest_step(plan, 0 * u, u, mesh, proven=True)
    with pytest.raises(ValueError, match="of the undeformed mesh are not proven valid"):
        jm.DesignedMesh(plan, mesh, lambda y: y, proven=True)


@pytest.mark.slow
def test_a_plan_that_is_not_linear_is_refused_and_judged_step_by_step(tmp_path):
    """Its cells invert elsewhere than on straight lines: `largest_step` would promise what the mesh does not keep."""
    mesh = write_ring(tmp_path / "ring.su2")
    plan = jm.prepare(mesh, "wall", "far", method=jm.InverseDistance(rotations=True))
    base = np.asarray(plan.moving_points)
    u = np.asarray(jm.shapes.rotate(base, np.deg2rad(170), [0.0, 0.0])) - base
    with pytest.raises(
        ValueError, match=r"InverseDistance is not\. Its nodes leave straight lines.*fewest_steps"
    ):
        jm.largest_step(plan, 0 * u, u, mesh)
    curved = jm.prepare(mesh, "wall", sliding="far")
    assert not curved.is_linear
    with pytest.raises(ValueError, match="nodes slide along curved walls"):
        jm.largest_step(curved, 0 * u, u, mesh)
    search = jm.ValidSteps(jm.DesignedMesh(plan, mesh, lambda step: step * u))
    for step in (0.1, 0.3, 0.5, 0.7):
        assert bool(search.holds(jnp.array(step))) == (
            int(jm.quality(mesh, jm.deform(plan, step * u)).inverted) == 0
        )


@pytest.mark.slow
def test_in_3d_and_where_nothing_limits_the_step():
    mesh = bricks()
    top = np.flatnonzero(mesh.points[:, 2] == 1)
    plan = jm.prepare(mesh.points, top, mesh.patch("floor"), method=jm.SurfaceReconstruction())
    down = np.tile([0.0, 0.0, -1.0], (len(top), 1))
    result = jm.largest_step(plan, 0 * down, down, mesh, min_jacobian_ratio=0.25, max_step=3.0)
    assert result.step == pytest.approx(0.75, abs=1e-9)  # every cell is squeezed alike
    assert jm.largest_step(plan, 0 * down, -down, mesh, max_step=2.0) == jm.LargestStep(2.0, -1)
    assert jm.largest_step(plan, 1.1 * down, down, mesh).step == 0


def test_velocity_satisfies_the_geometric_conservation_law(tmp_path):
    """Cell areas change at the rate of the flux of the nodes' velocity through their edges."""
    mesh, plan, u, u_dot = ring(tmp_path)
    quads = np.asarray(mesh.cells["quad"])
    v = np.asarray(jm.velocity(plan, 0.02 * u, u_dot))
    x = np.asarray(jm.deform(plan, 0.02 * u))

    def areas(u):
        corners = jm.deform(plan, u)[quads]
        after = jnp.roll(corners, -1, axis=1)
        return 0.5 * jnp.sum(
            corners[..., 0] * after[..., 1] - corners[..., 1] * after[..., 0], axis=1
        )

    rate = jax.jvp(areas, (0.02 * u,), (u_dot,))[1]
    edge = np.roll(x[quads], -1, axis=1) - x[quads]
    middle = 0.5 * (np.roll(v[quads], -1, axis=1) + v[quads])
    flux = np.sum(edge[..., 1] * middle[..., 0] - edge[..., 0] * middle[..., 1], axis=1)
    np.testing.assert_allclose(rate, flux, atol=1e-13)
    np.testing.assert_array_equal(v[mesh.patch("far")], 0)
    np.testing.assert_allclose(v[mesh.patch("wall")], u_dot, atol=1e-15)


@pytest.mark.parametrize(
    "solver",
    [
        pytest.param(optx.BFGS(1e-9, 1e-9), marks=pytest.mark.slow),
        optx.GradientDescent(1.0, 1e-9, 1e-9),
    ],
)
def test_a_search_of_optimistix_shortens_steps_and_solves_no_flow_on_broken_meshes(
    tmp_path, solver
):
    """The objective's optimum inverts cells; every mesh that the flow met keeps the bound, and the way ends near it."""
    mesh, plan, _, direction = ring(tmp_path)
    fields, met = jnp.stack([direction, jnp.roll(direction, 5, axis=0)]), []
    motion = lambda y: jnp.tensordot(y, fields, 1)  # noqa: E731
    search = jm.ValidSteps(jm.DesignedMesh(plan, mesh, motion, min_jacobian_ratio=0.2))

    def flow(y, args):
        jax.debug.callback(lambda y: met.append(y), y)
        return jnp.sum((y - jnp.array([1.0, 0.4])) ** 2)

    solver = eqx.tree_at(lambda solver: solver.search, solver, search)
    result = optx.minimise(search.guarded(flow), solver, jnp.zeros(2), max_steps=40, throw=False)
    jax.effects_barrier()
    ratios = [
        float(jm.quality(mesh, jm.deform(plan, search.mesh.displacement(y))).min_jacobian_ratio)
        for y in met
    ]
    assert len(ratios) > 3
    assert min(ratios) >= 0.2
    assert min(ratios) < 0.35
    assert flow(result.value, None) < 0.9 * flow(jnp.zeros(2), None)
