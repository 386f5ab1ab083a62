"""Inverse distances: closed forms, rotations in full, derivatives at rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body
from meshes import turn
from runs import over
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import cases


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
