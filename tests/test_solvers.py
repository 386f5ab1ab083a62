"""The interpolation system by iterations: against the dense solve, where surfaces are flat, and where nothing converges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, iterative, motion, moved_by, planned
from meshes import lattice
from runs import over

import jaxmorph as jm
from jaxmorph._host.sources.farthest import far_to_near
from jaxmorph._methods.rbf import rbf as rbf_module


def classic(solver=None, basis=None, **options):
    every = jm.AllPoints()
    return jm.RBF(jm.ThinPlateSpline() if basis is None else basis, every, every, solver=solver, **options)


def box(side):
    """The surface of a cube in a lattice, most neighbours of a node in one plane with it; then nodes around it."""
    line = np.linspace(-0.5, 0.5, side)
    nodes = lattice(line, line, line)
    wall = nodes[(np.abs(nodes) == 0.5).any(axis=1)]
    outer = 4 * nodes[::7] + 0.01
    return np.concatenate([wall, outer]), np.arange(len(wall))


def test_neighbours_are_the_nearest_of_those_before():
    points = np.random.default_rng(0).normal(size=(200, 3)) ** 3
    order, earlier = far_to_near(points, 20, 9)
    assert sorted(order) == list(range(200))
    assert earlier.shape == (180, 9)
    points = points[order]
    exact = 0
    for place, row in zip(range(20, 200), earlier, strict=True):
        apart = np.linalg.norm(points[:place] - points[place], axis=1)
        assert row[0] == place
        assert (row[1:] < place).all()
        assert len(set(row)) == 9
        exact += set(row[1:]) == set(np.argsort(apart)[:8])
    assert exact > 160
    shuffled = np.random.default_rng(1).permutation(200)
    again = far_to_near(points[shuffled], 20, 9)
    np.testing.assert_array_equal(points[shuffled][again[0]], points)
    np.testing.assert_array_equal(again[1], earlier)


def test_every_point_has_neighbours_where_all_near_ones_come_later():
    """A small body in a wide far field: the far nodes stand first, and then the body's, one beside the other."""
    rng = np.random.default_rng(2)
    points = np.concatenate([1e-3 * rng.normal(size=(300, 2)), rng.normal(size=(100, 2))])
    _, earlier = far_to_near(points, 90, 10)
    assert all(len(set(row)) == 10 for row in earlier)


@pytest.mark.nightly
def test_the_default_tolerance_against_the_dense_solve_on_flat_sides():
    points, moving = box(9)
    u = motion(points[moving])
    weights = np.random.default_rng(0).normal(size=points.shape)
    solvers, fixed = (jm.Direct(), jm.Iterative(neighbours=20, dense=40)), np.arange(len(moving), len(points))
    plans = [jm.prepare(points, moving, fixed, method=classic(solver)) for solver in solvers]
    exact, found = (np.asarray(jm.deform(plan, u)) for plan in plans)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9 * np.abs(u).max())
    exact, found = (np.asarray(jm.pullback(plan, u, weights)) for plan in plans)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())


@over(
    "basis options",
    nightly=[
        (jm.WendlandC4(1.5), {"degree": None}),
        (jm.ThinPlateSpline(), {"ridge": 1e-3}),
        (jm.LinearSpline(), {"degree": 0}),
        (jm.CubicSpline(), {}),
        (jm.Multiquadric(0.15), {"degree": 0}),
    ],
)
def test_bases_against_the_dense_solve(basis, options):
    mesh = body(3)
    u = motion(mesh.points[mesh.moving])
    methods = classic(jm.Direct(), basis, **options), iterative(basis, **options)
    plans = [planned(mesh, method) for method in methods]
    exact, found = (np.asarray(jm.deform(plan, u)) for plan in plans)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)

    def gradient(plan):
        return jax.grad(lambda points: jnp.sum(jnp.sin(3 * jm.deform(jm.refit(plan, points), u))))(plan.points)

    exact, found = map(gradient, plans)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())


def test_many_sources_are_solved_by_iterations(monkeypatch, tmp_path):
    """Beyond a number, here a small one; the plan can be saved."""
    mesh = body(2)
    u = motion(mesh.points[mesh.moving])
    dense = moved_by(mesh, classic(), u)
    monkeypatch.setattr(rbf_module, "MANY", 50)
    plan = planned(mesh, classic())
    assert plan.surface.factors.cardinals is not None
    np.testing.assert_array_equal(np.sort(plan.sources), np.sort(mesh.boundary))
    np.testing.assert_allclose(jm.deform(plan, u), dense, rtol=0, atol=1e-10)
    jm.save(tmp_path / "plan.npz", plan)
    assert (jm.deform(jm.load(tmp_path / "plan.npz"), u) == jm.deform(plan, u)).all()


@pytest.mark.slow
def test_what_does_not_converge_is_told():
    mesh = body(2)
    u = motion(mesh.points[mesh.moving])
    with pytest.raises(ValueError, match=r"62 sources is too ill-conditioned for Iterative.*Try a smaller `radius`"):
        planned(mesh, iterative(jm.Gaussian(30.0), degree=None))
    plan = planned(mesh, iterative(jm.ThinPlateSpline()))
    flat = mesh.points.copy()
    flat[mesh.boundary] = flat[mesh.boundary[0]]  # all sources at one place: no such system has a solution
    with pytest.raises(ValueError, match="the plan's solve is not finite at the new base points"):
        jm.refit(plan, flat)
    moved = np.asarray(jax.jit(lambda base: jm.deform(jm.refit(plan, base), u))(flat))
    assert np.isnan(moved[mesh.inner]).all()


def test_a_fit_is_solved_directly():
    with pytest.raises(ValueError, match="solver=Iterative"):
        jm.FittedRBF(jm.RBF(solver=jm.Iterative()))


@pytest.mark.nightly
def test_single_precision_has_a_tolerance_that_it_can_reach():
    mesh, moving = box(7)
    points, wall = mesh.astype(np.float32), np.arange(len(moving))
    u = (0.1 * np.sin(3 * mesh[wall][:, [1, 2, 0]])).astype(np.float32)
    near = [
        np.asarray(jm.deform(jm.prepare(points, wall, np.arange(len(wall), len(mesh) - 3), method=classic(solver)), u))
        for solver in (jm.Iterative(dense=50), jm.Direct())
    ]
    np.testing.assert_allclose(near[0], near[1], atol=1e-4)


@pytest.mark.slow
def test_one_source_is_solved_as_the_dense_solve_does():
    points = np.array([[0.0, 0], [1, 0], [0, 1], [0.3, 0.4]])
    methods = [classic(solver, jm.WendlandC2(2.0), degree=0) for solver in (jm.Iterative(), jm.Direct())]
    moved = [jm.deform(jm.prepare(points, [0], method=method), [[0.1, 0.2]]) for method in methods]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-14)
