"""Derivatives of whole maps by component: planes, coincident nodes, Hessians, shards, float32, and `improve`."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial
from cases import body, few, motion, whole_and_part
from meshes import grid
from oracles import jacobian

import jaxmorph as jm

slow, nightly = (functools.partial(pytest.param, marks=mark) for mark in (pytest.mark.slow, pytest.mark.nightly))


def operator(plan):
    """(n d, m d): the linear map by its columns, each a displaced mesh of its own."""
    m, d = plan.n_moving, plan.points.shape[1]
    moved = jax.jit(jax.vmap(lambda u: jm.deform(plan, u) - plan.points))(np.eye(m * d).reshape(-1, m, d))
    return np.asarray(moved).reshape(m * d, -1).T


def check_operator(plan, rows=slice(None, None, 7)):
    """Forward mode, reverse mode and `pullback` give the operator, to 1e-8 in each component."""
    a, u = operator(plan), jnp.zeros((plan.n_moving, plan.points.shape[1]))
    forward = jax.jit(jax.jacfwd(lambda u: jm.deform(plan, u)))(u)
    np.testing.assert_allclose(forward.reshape(a.shape), a, rtol=0, atol=1e-8)
    picked = np.eye(len(a))[rows].reshape(-1, *plan.points.shape)
    reverse = jax.jit(jax.vmap(lambda w: jm.pullback(plan, u, w)))(picked)
    np.testing.assert_allclose(reverse.reshape(len(picked), -1), a[rows], rtol=0, atol=1e-8)
    return a


def check_base(plan, u, places):
    """The gradient by base points: finite everywhere, and that of differences in the components (node, axis) of `places`."""
    w = np.random.default_rng(5).normal(size=plan.points.shape)
    points = np.asarray(plan.points)
    objective = jax.jit(lambda points: jnp.sum(w * jm.deform(jm.refit(plan, points), u)))
    found = np.asarray(jax.jit(jax.grad(objective))(points))
    assert np.isfinite(found).all()
    nodes, axes = np.array(places).T
    expected = jacobian(lambda x: objective(jnp.asarray(points).at[nodes, axes].set(x)), points[nodes, axes], 1e-4)
    np.testing.assert_allclose(found[nodes, axes], expected, rtol=1e-6, atol=1e-6 * np.abs(found).max())


@pytest.mark.parametrize("planes", [nightly(1), nightly(2), nightly(3)])
def test_symmetry_planes(planes):
    part, role, *_ = whole_and_part(3, planes)
    moving, fixed, inner = (np.flatnonzero(role == k) for k in (1, 2, 0))
    symmetry = [jm.Plane(np.eye(3)[axis], np.zeros(3)) for axis in range(planes)]
    method = jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3))
    plan = jm.prepare(part, moving, fixed, method=method, symmetry=symmetry)
    a = check_operator(plan).reshape(*part.shape, len(moving), 3)
    for axis in range(planes):
        on = part[:, axis] == 0
        assert (a[on, axis] == 0).all()  # what stays in a plane
        assert (a[:, :, on[moving], axis] == 0).all()  # and what leads off it
    off = inner[(part[inner, :planes] != 0).all(axis=1)][::25]
    held = moving[(part[moving, :planes] != 0).all(axis=1)][:2]
    check_base(plan, motion(part)[moving], [(node, axis) for node in (*off[:3], *held) for axis in range(3)])


@pytest.mark.nightly
def test_coincident_nodes():
    """A wall node in two copies that move apart, and an inner node on the wall."""
    mesh = body(2)
    twice, on_wall = mesh.points[mesh.moving[:1]], mesh.points[mesh.moving[5:6]]
    points, n = np.concatenate([mesh.points, twice, on_wall]), len(mesh.points)
    plan = jm.prepare(points, np.append(mesh.moving, n), mesh.fixed)
    a = check_operator(plan).reshape(*points.shape, -1, 2)
    for copy, row in ((mesh.moving[0], 0), (n, len(mesh.moving))):
        np.testing.assert_array_equal(a[copy, :, row], np.eye(2))
    u = motion(points)[np.append(mesh.moving, n)]
    check_base(plan, u, [(node, axis) for node in mesh.inner[::40] for axis in range(2)])


@pytest.mark.parametrize("laid", [slow(False), nightly(True)], ids=["whole", "shard"])
def test_hessian_of_the_default(laid):
    """Of a sum of sines, in full: the operator's transpose, the sines' second derivatives, the operator."""
    mesh = body(2)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed)
    a, u = operator(plan), motion(mesh.points[mesh.moving])
    w = np.random.default_rng(7).normal(size=mesh.points.shape)
    used = jm.shard(plan, jax.devices()[:1]) if laid else plan
    found = jax.jit(jax.hessian(lambda u: jnp.sum(w * jnp.sin(jm.deform(used, u)))))(u)
    curvature = -(w * np.sin(np.asarray(jm.deform(plan, u)))).ravel()
    expected = a.T @ (curvature[:, None] * a)
    np.testing.assert_allclose(found.reshape(expected.shape), expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.nightly
def test_float32():
    """The operator of float32 points is that of float64 as far as seven digits and the solve let it."""
    mesh = body(2)
    whole = jm.prepare(mesh.points, mesh.moving, mesh.fixed)
    single = jm.prepare(mesh.points.astype(np.float32), mesh.moving, mesh.fixed)
    w = np.random.default_rng(7).normal(size=mesh.points.shape)
    u = motion(mesh.points[mesh.moving])

    def gradients(plan, dtype):
        points, weights = plan.points, w.astype(dtype)
        objective = lambda u, x: jnp.sum(weights * jnp.sin(jm.deform(jm.refit(plan, x), u)))  # noqa: E731
        return jax.jit(jax.grad(objective, argnums=(0, 1)))(u.astype(dtype), points)

    for found, expected in zip(gradients(single, np.float32), gradients(whole, np.float64), strict=True):
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def strip():
    """3 x 2 quads with two inner nodes, pulled out of shape."""
    return grid(np.arange(4.0), np.arange(3.0)), np.array([4, 7])


def needle():
    """Tetrahedra between the corners of one and two nodes within it."""
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]])
    points = np.concatenate([corners, [[0.4, 0.5, 0.5], [0.7, 0.4, 0.4]]])
    cells = scipy.spatial.Delaunay(points).simplices
    return jm.Mesh(points, {"tetra": cells}), np.array([4, 5])


@pytest.mark.parametrize(("make", "is_near"), [nightly(strip, False), nightly(needle, True)])
def test_every_component_of_improve(make, is_near):
    """From inverted cells: the derivative of the minimum by the outer nodes, and zero by the inner ones, where it begins."""
    mesh, inner = make()
    points = np.array(mesh.points)
    outer = np.setdiff1d(np.arange(len(points)), inner)
    points[outer] += 0.15 * np.random.default_rng(3).uniform(-1, 1, points[outer].shape)
    points[inner] = points[inner[::-1]] + 0.2
    assert np.asarray(jm.inverted(mesh, points)).any()

    def improved(points):
        found = jm.improve(mesh, points, tolerance=1e-11)
        return found.points[inner], (found.points[inner], found.after)

    both = jax.jit(jax.jacrev(improved, has_aux=True))
    slopes, (least, after) = both(points)
    assert int(after) == 0

    def places(x):
        start = points.copy()
        start[outer] = x
        if is_near:
            start[inner] = least
        return both(start)[1][0]

    expected = jacobian(places, points[outer], 8e-3)
    slopes = np.asarray(slopes)
    np.testing.assert_allclose(slopes[:, :, outer], expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert (slopes[:, :, inner] == 0).all()


@pytest.mark.parametrize("rebuild", [nightly(False), nightly(True)])
def test_every_component_of_a_path(rebuild):
    """`replay` by the path, where each step starts on the mesh that the steps before it left; forward mode along one direction."""
    mesh = body(2)
    path = np.stack([share * motion(mesh.points[mesh.moving]) for share in (0.4, 1.0)])
    method = jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3))
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=method)
    plans, points = jm.march(plan, path, rebuild=rebuild)
    w = np.random.default_rng(7).normal(size=points.shape)
    objective = jax.jit(lambda path: jnp.sum(w * jnp.sin(jm.replay(plans, path))))
    expected = jacobian(objective, path, 1e-3)
    scale, v = np.abs(expected).max(), np.random.default_rng(8).normal(size=path.shape)
    np.testing.assert_allclose(jax.jit(jax.grad(objective))(path), expected, rtol=0, atol=1e-8 * scale)
    _, along = jax.jit(lambda path: jax.jvp(objective, (path,), (v,)))(path)
    np.testing.assert_allclose(along, np.vdot(expected, v), rtol=0, atol=1e-8 * scale * np.abs(v).sum())
