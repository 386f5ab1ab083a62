"""Radial basis functions, solved densely and by iterations, against SciPy and NumPy; inverse distances against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, full, iterative, motion, moved_by, planned, surface_values
from meshes import lattice, turn
from oracles import dense, wendland
from runs import over
from scipy.interpolate import RBFInterpolator
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.sources.farthest import far_to_near
from jaxmorph._methods.rbf import rbf as rbf_module

SCIPY = [  # SciPy writes phi(epsilon r), with epsilon = 1 / R, and its multiquadric with the other sign
    (jm.ThinPlateSpline(), 1, {"kernel": "thin_plate_spline", "degree": 1}, 2),
    (jm.ThinPlateSpline(), 1, {"kernel": "thin_plate_spline", "degree": 1}, 3),
    (jm.Gaussian(0.15), None, {"kernel": "gaussian", "epsilon": 1 / 0.15, "degree": -1}, 2),
    (jm.Gaussian(0.15), 0, {"kernel": "gaussian", "epsilon": 1 / 0.15, "degree": 0}, 2),
    (jm.Gaussian(0.4), 1, {"kernel": "gaussian", "epsilon": 1 / 0.4, "degree": 1}, 3),
    (jm.Multiquadric(0.15), 0, {"kernel": "multiquadric", "epsilon": 1 / 0.15, "degree": 0}, 2),
    (jm.Multiquadric(0.15), 1, {"kernel": "multiquadric", "epsilon": 1 / 0.15, "degree": 1}, 3),
]


@over(
    "basis degree options dimension",
    [SCIPY[0], SCIPY[2], SCIPY[6]],
    nightly=[SCIPY[1], *SCIPY[3:6]],
)
def test_full_interpolation_equals_scipys(basis, degree, options, dimension):
    mesh = body(dimension)
    u, values = surface_values(mesh)
    moved = moved_by(mesh, full(basis, degree), u)
    expected = RBFInterpolator(mesh.points[mesh.boundary], values, smoothing=0, **options)(
        mesh.points
    )
    np.testing.assert_allclose(moved - mesh.points, expected, rtol=0, atol=1e-11)


@over("degree", [0], nightly=[None, 1])
def test_wendland_equals_a_dense_solve(degree):
    mesh = body(2)
    u, values = surface_values(mesh)
    moved = moved_by(mesh, full(jm.WendlandC2(1.7), degree), u)
    expected = dense(
        mesh.points, mesh.points[mesh.boundary], values, lambda r: wendland(r, 1.7), degree
    )
    np.testing.assert_allclose(moved - mesh.points, expected, rtol=0, atol=1e-11)


@over("steps", [1], nightly=[20])
def test_refitted_steps_equal_dense_solves_on_the_moved_mesh(steps):
    """Wendland C2 without polynomial, each step fitted anew on the points that the last one left."""
    mesh = body(2)
    u, values = surface_values(mesh)
    path = np.linspace(0, 1, steps + 1)[1:, None, None] * 5 * u
    plan = planned(mesh, full(jm.WendlandC2(1.7), None))
    _, moved = jm.march(plan, path)
    expected = mesh.points
    for _ in range(steps):
        step = dense(
            expected, expected[mesh.boundary], 5 * values / steps, lambda r: wendland(r, 1.7), None
        )
        expected = expected + step
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-10)


def test_a_reduced_interpolation_is_one_of_its_sources():
    """Sources are what the reductions choose, moving and fixed apart; SciPy interpolates those same ones."""
    mesh = body(3)
    u, values = surface_values(mesh)
    moving, fixed = jm.KDTree(3), jm.KDTree(2, jm.GaussPoints())
    moved = moved_by(mesh, jm.RBF(reduction=moving, fixed_reduction=fixed), u)
    chosen = np.concatenate(
        [moving(mesh.points[mesh.moving]), len(mesh.moving) + fixed(mesh.points[mesh.fixed])]
    )
    assert 8 < len(chosen) < len(mesh.boundary) / 2
    sources = mesh.points[mesh.boundary][chosen]
    expected = RBFInterpolator(sources, values[chosen], kernel="thin_plate_spline", degree=1)(
        mesh.points
    )
    np.testing.assert_allclose(moved - mesh.points, expected, rtol=0, atol=1e-11)


def test_far_from_the_origin_and_in_other_units():
    mesh = body(2)
    u, _ = surface_values(mesh)
    method = full(jm.ThinPlateSpline(), 1)
    near = moved_by(mesh, method, u) - mesh.points
    for length, shift, allowed in ((1, 1e6, 1e-8), (1e-4, 0, 1e-12), (1e5, 3e5, 1e-12)):
        points = mesh.points * length + shift
        moved = (
            jm.deform(jm.prepare(points, mesh.moving, mesh.fixed, method=method), u * length)
            - points
        )
        np.testing.assert_allclose(moved / length, near, rtol=0, atol=allowed)


def test_coincident_nodes_do_not_make_the_system_singular():
    """A wake cut: the first moving nodes once more, at the same place, moving alike. The interpolation does not notice."""
    mesh = body(2)
    u, _ = surface_values(mesh)
    points = np.concatenate([mesh.points, mesh.points[mesh.moving[:4]]])
    again = np.arange(len(mesh.points), len(points))
    method = full(jm.ThinPlateSpline(), 1)
    doubled = jm.prepare(points, np.concatenate([mesh.moving, again]), mesh.fixed, method=method)
    moved = jm.deform(doubled, np.concatenate([u, u[:4]]))
    plain = moved_by(mesh, method, u)
    np.testing.assert_allclose(moved[: len(plain)], plain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(moved[len(plain) :], plain[mesh.moving[:4]], rtol=0, atol=1e-12)


@over("dimension", [3], nightly=[2])
def test_sources_that_do_not_span_space(dimension):
    """All in one plane (a line, in 2-D), rotated so that no coordinate is constant."""
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    flat = rng.normal(size=(40, dimension)) * ([1] * (dimension - 1) + [0])
    points = np.concatenate([flat @ turn, rng.normal(size=(10, dimension))])
    with pytest.raises(ValueError, match=rf"40 sources do not span {dimension} dimensions"):
        jm.prepare(points, np.arange(40), method=full(jm.ThinPlateSpline(), 1))
    plan = jm.prepare(
        points, np.arange(40), method=full(jm.WendlandC2(3.0), 0)
    )  # a constant needs no span
    np.testing.assert_allclose(jm.deform(plan, np.ones((40, dimension))), points + 1, atol=1e-10)


def test_a_degree_that_does_not_exist_or_does_not_suffice():
    with pytest.raises(ValueError, match="None, 0 or 1, not 2"):
        jm.RBF(degree=2)
    with pytest.warns(UserWarning, match="ThinPlateSpline without a polynomial of degree 1"):
        jm.RBF(degree=0)


@pytest.mark.parametrize(("far", "near"), [(3, 5), (2.5, 4.2)])
def test_the_weights_are_lukes(far, near):
    mesh, rng = body(2), np.random.default_rng(0)
    plan = jm.prepare(
        mesh.points, mesh.moving, mesh.fixed, method=jm.InverseDistance(float(far), float(near))
    )
    u = rng.normal(size=(len(mesh.moving), 2))
    surface = mesh.points[mesh.boundary]
    length = np.linalg.norm(surface - mesh.points[mesh.moving].mean(axis=0), axis=1).max()
    apart = np.linalg.norm(mesh.points[mesh.inner][:, None] - surface[None], axis=2)
    weights = (length / apart) ** far + (0.25 * length / apart) ** near
    expected = (
        weights @ np.concatenate([u, np.zeros((len(mesh.fixed), 2))]) / weights.sum(axis=1)[:, None]
    )
    moved = jm.deform(plan, u) - mesh.points
    np.testing.assert_allclose(moved[mesh.inner], expected, rtol=0, atol=1e-12)


@over("dimension", [3], nightly=[2])
def test_a_turning_body_turns_the_points_near_it(dimension):
    """Each of a body's nodes says the same rigid motion, so the mean is that motion; in 3-D about an axis across its normals."""
    mesh = cases.naca0015(points=1200) if dimension == 2 else cases.bricks("hexahedron", cells=3)
    base, moving = mesh.points, mesh.patch("airfoil" if dimension == 2 else "floor")
    matrix = turn(-0.8, 2) if dimension == 2 else Rotation.from_rotvec([0.8, 0, 0]).as_matrix()
    motion = base @ matrix.T - base
    miss = []
    for rotations in (True, False):
        method = jm.InverseDistance(rotations=rotations)
        plan = jm.prepare(mesh, moving, method=method, free=np.arange(len(base)))
        miss.append(np.abs(jm.deform(plan, motion[moving]) - base - motion).max())
    assert miss[0] < 1e-9 < 0.1 < miss[1]
    assert not jm.InverseDistance(rotations=True).linear


@pytest.mark.slow
def test_derivatives_of_turning_nodes_at_rest():
    """The part of the derivative that rotations give is there at u = 0 too."""
    mesh = cases.naca0015(points=1200)
    plan = jm.prepare(mesh, "airfoil", "farfield", method=jm.InverseDistance(rotations=True))
    rng = np.random.default_rng(1)
    v, w = rng.normal(size=(plan.n_moving, 2)), rng.normal(size=mesh.points.shape)
    for u in (np.zeros_like(v), 0.003 * v):
        difference = (jm.deform(plan, u + 1e-7 * v) - jm.deform(plan, u - 1e-7 * v)) / 2e-7
        pushed = jax.jvp(lambda u: jm.deform(plan, u), (jnp.asarray(u),), (jnp.asarray(v),))[1]
        np.testing.assert_allclose(pushed, difference, rtol=0, atol=1e-5 * np.abs(difference).max())
        np.testing.assert_allclose(
            np.vdot(pushed, w), np.vdot(v, jm.pullback(plan, u, w)), rtol=1e-9
        )
    assert (jm.deform(plan, 0 * v) == mesh.points).all()


def test_wrong_arguments_are_told():
    mesh = body(2)
    with pytest.raises(ValueError, match=r"needs the boundary faces: pass the mesh"):
        jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.InverseDistance(rotations=True))


def test_steep_weights_stay_finite_in_float32():
    mesh = body(2)
    points = np.concatenate([mesh.points, mesh.points[mesh.moving[:1]] + 1e-9]).astype(np.float32)
    plan = jm.prepare(points, mesh.moving, mesh.fixed, method=jm.InverseDistance(3.0, 9.0))
    u = np.ones((len(mesh.moving), 2), np.float32)
    assert np.isfinite(jm.pullback(plan, u, np.ones_like(points))).all()
    np.testing.assert_allclose((jm.deform(plan, u) - points)[-1], 1, rtol=1e-4)


def classic(solver=None, basis=None, **options):
    every = jm.AllPoints()
    return jm.RBF(
        jm.ThinPlateSpline() if basis is None else basis, every, every, solver=solver, **options
    )


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
    solvers, fixed = (
        (jm.Direct(), jm.Iterative(neighbours=20, dense=40)),
        np.arange(len(moving), len(points)),
    )
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
        return jax.grad(lambda points: jnp.sum(jnp.sin(3 * jm.deform(jm.refit(plan, points), u))))(
            plan.points
        )

    exact, found = map(gradient, plans)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())


@pytest.mark.slow
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
    with pytest.raises(
        ValueError, match=r"62 sources is too ill-conditioned for Iterative.*Try a smaller `radius`"
    ):
        planned(mesh, iterative(jm.Gaussian(30.0), degree=None))
    plan = planned(mesh, iterative(jm.ThinPlateSpline()))
    flat = mesh.points.copy()
    flat[mesh.boundary] = flat[
        mesh.boundary[0]
    ]  # all sources at one place: no such system has a solution
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
        np.asarray(
            jm.deform(
                jm.prepare(
                    points, wall, np.arange(len(wall), len(mesh) - 3), method=classic(solver)
                ),
                u,
            )
        )
        for solver in (jm.Iterative(dense=50), jm.Direct())
    ]
    np.testing.assert_allclose(near[0], near[1], atol=1e-4)


@pytest.mark.slow
def test_one_source_is_solved_as_the_dense_solve_does():
    points = np.array([[0.0, 0], [1, 0], [0, 1], [0.3, 0.4]])
    methods = [
        classic(solver, jm.WendlandC2(2.0), degree=0) for solver in (jm.Iterative(), jm.Direct())
    ]
    moved = [jm.deform(jm.prepare(points, [0], method=method), [[0.1, 0.2]]) for method in methods]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-14)
