"""Derivatives beyond the first, and beyond the displacement, through the whole of `deform` and `quality`; against differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph import cases


@pytest.fixture(scope="module")
def mesh():
    return cases.naca0015(points=800)


@pytest.fixture(scope="module")
def plan(mesh):
    rbf = jm.RBF(jm.WendlandC2(4.0), reduction=jm.KDTree(4), fixed_reduction=jm.KDTree(2))
    method = jm.SurfaceReconstruction(rbf, jm.DelaunayGraph())
    return jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=method)


def bump(mesh, a):
    x = mesh.points[mesh.patch("airfoil")][:, :1]
    return a * jnp.sin(jnp.pi * x) * jnp.array([[0.0, 1.0]])


@pytest.mark.nightly
def test_hessian_vector_products_of_quality(mesh, plan):
    """Forward over reverse, the cheap way: costs a few gradients, whatever the number of displacements."""

    def objective(u):
        return jnp.mean(
            (jm.quality(mesh, jm.deform(plan, u)).volume_ratio - 1) ** 2
        )  # skewness has kinks

    x = mesh.points[mesh.patch("airfoil")][:, :1]
    u = bump(mesh, 0.05)
    direction = (
        1e-3 * np.sin(2 * np.pi * x) * [0.3, 1]
    )  # smooth: rounding is then small in the difference
    gradient = jax.jit(jax.grad(objective))
    product = jax.jit(lambda u, v: jax.jvp(gradient, (u,), (v,))[1])(u, direction)
    difference = (gradient(u + direction) - gradient(u - direction)) / 2
    np.testing.assert_allclose(product, difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.nightly
def test_a_hundred_steps_of_an_optimisation_in_one_program(mesh, plan):
    """Gradient descent inside of `lax.scan` finds the bump of a mesh, and is itself differentiable, each step recomputed."""
    target = jm.deform(plan, bump(mesh, 0.08))

    def misfit(a, target):
        return jnp.sum((jm.deform(plan, bump(mesh, a)) - target) ** 2)

    curvature = 2 * jnp.sum((jm.deform(plan, bump(mesh, 1.0)) - plan.points) ** 2)

    def descend(target):
        step = jax.checkpoint(
            lambda a, _: (a - 0.2 / curvature * jax.grad(misfit)(a, target), None)
        )
        return jax.lax.scan(step, jnp.zeros(()), length=100)[0]

    np.testing.assert_allclose(jax.jit(descend)(target), 0.08, rtol=1e-8)
    direction = jm.deform(plan, bump(mesh, 1.0)) - plan.points
    slope = jnp.vdot(
        jax.jit(jax.grad(descend))(target), direction
    )  # the bump found grows as the one given
    np.testing.assert_allclose(slope, 1.0, rtol=1e-8)


@pytest.mark.slow
def test_plans_of_one_shape_in_one_call(mesh, plan):
    u = bump(mesh, 0.1)
    plans = [jm.refit(plan, plan.points * stretch) for stretch in (0.9, 1.0, 1.2)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *plans)
    together = eqx.filter_vmap(jm.deform, in_axes=(eqx.if_array(0), None))(stacked, u)
    np.testing.assert_allclose(
        together, jnp.stack([jm.deform(one, u) for one in plans]), atol=1e-12
    )
