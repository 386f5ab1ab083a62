"""Radial basis functions against SciPy's interpolator and a dense solve in NumPy; inverse distances against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, full, moved_by, planned, surface_values
from meshes import turn
from oracles import dense, wendland
from runs import over
from scipy.interpolate import RBFInterpolator
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import cases

SCIPY = [  # SciPy writes phi(epsilon r), with epsilon = 1 / R, and its multiquadric with the other sign
    (jm.ThinPlateSpline(), 1, {"kernel": "thin_plate_spline", "degree": 1}, 2),
    (jm.ThinPlateSpline(), 1, {"kernel": "thin_plate_spline", "degree": 1}, 3),
    (jm.Gaussian(0.15), None, {"kernel": "gaussian", "epsilon": 1 / 0.15, "degree": -1}, 2),
    (jm.Gaussian(0.15), 0, {"kernel": "gaussian", "epsilon": 1 / 0.15, "degree": 0}, 2),
    (jm.Gaussian(0.4), 1, {"kernel": "gaussian", "epsilon": 1 / 0.4, "degree": 1}, 3),
    (jm.Multiquadric(0.15), 0, {"kernel": "multiquadric", "epsilon": 1 / 0.15, "degree": 0}, 2),
    (jm.Multiquadric(0.15), 1, {"kernel": "multiquadric", "epsilon": 1 / 0.15, "degree": 1}, 3),
]


@over("basis degree options dimension", [SCIPY[0], SCIPY[2], SCIPY[6]], nightly=[SCIPY[1], *SCIPY[3:6]])
def test_full_interpolation_equals_scipys(basis, degree, options, dimension):
    mesh = body(dimension)
    u, values = surface_values(mesh)
    moved = moved_by(mesh, full(basis, degree), u)
    expected = RBFInterpolator(mesh.points[mesh.boundary], values, smoothing=0, **options)(mesh.points)
    np.testing.assert_allclose(moved - mesh.points, expected, rtol=0, atol=1e-11)


@over("degree", [0], nightly=[None, 1])
def test_wendland_equals_a_dense_solve(degree):
    mesh = body(2)
    u, values = surface_values(mesh)
    moved = moved_by(mesh, full(jm.WendlandC2(1.7), degree), u)
    expected = dense(mesh.points, mesh.points[mesh.boundary], values, lambda r: wendland(r, 1.7), degree)
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
        step = dense(expected, expected[mesh.boundary], 5 * values / steps, lambda r: wendland(r, 1.7), None)
        expected = expected + step
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-10)


def test_a_reduced_interpolation_is_one_of_its_sources():
    """Sources are what the reductions choose, moving and fixed apart; SciPy interpolates those same ones."""
    mesh = body(3)
    u, values = surface_values(mesh)
    moving, fixed = jm.KDTree(3), jm.KDTree(2, jm.GaussPoints())
    moved = moved_by(mesh, jm.RBF(reduction=moving, fixed_reduction=fixed), u)
    chosen = np.concatenate([moving(mesh.points[mesh.moving]), len(mesh.moving) + fixed(mesh.points[mesh.fixed])])
    assert 8 < len(chosen) < len(mesh.boundary) / 2
    sources = mesh.points[mesh.boundary][chosen]
    expected = RBFInterpolator(sources, values[chosen], kernel="thin_plate_spline", degree=1)(mesh.points)
    np.testing.assert_allclose(moved - mesh.points, expected, rtol=0, atol=1e-11)


def test_far_from_the_origin_and_in_other_units():
    mesh = body(2)
    u, _ = surface_values(mesh)
    method = full(jm.ThinPlateSpline(), 1)
    near = moved_by(mesh, method, u) - mesh.points
    for length, shift, allowed in ((1, 1e6, 1e-8), (1e-4, 0, 1e-12), (1e5, 3e5, 1e-12)):
        points = mesh.points * length + shift
        moved = jm.deform(jm.prepare(points, mesh.moving, mesh.fixed, method=method), u * length) - points
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
    plan = jm.prepare(points, np.arange(40), method=full(jm.WendlandC2(3.0), 0))  # a constant needs no span
    np.testing.assert_allclose(jm.deform(plan, np.ones((40, dimension))), points + 1, atol=1e-10)


def test_a_degree_that_does_not_exist_or_does_not_suffice():
    with pytest.raises(ValueError, match="None, 0 or 1, not 2"):
        jm.RBF(degree=2)
    with pytest.warns(UserWarning, match="ThinPlateSpline without a polynomial of degree 1"):
        jm.RBF(degree=0)


@pytest.mark.parametrize(("far", "near"), [(3, 5), (2.5, 4.2)])
def test_the_weights_are_lukes(far, near):
    mesh, rng = body(2), np.random.default_rng(0)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.InverseDistance(float(far), float(near)))
    u = rng.normal(size=(len(mesh.moving), 2))
    surface = mesh.points[mesh.boundary]
    length = np.linalg.norm(surface - mesh.points[mesh.moving].mean(axis=0), axis=1).max()
    apart = np.linalg.norm(mesh.points[mesh.inner][:, None] - surface[None], axis=2)
    weights = (length / apart) ** far + (0.25 * length / apart) ** near
    expected = weights @ np.concatenate([u, np.zeros((len(mesh.fixed), 2))]) / weights.sum(axis=1)[:, None]
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
        np.testing.assert_allclose(np.vdot(pushed, w), np.vdot(v, jm.pullback(plan, u, w)), rtol=1e-9)
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
