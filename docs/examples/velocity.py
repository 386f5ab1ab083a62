"""Mesh velocities: their flux through a cell's faces is the rate of its volume, to round-off (geometric conservation law)."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from jaxmorph import cases

jax.config.update("jax_enable_x64", True)
mesh = cases.naca0015(points=400)
plan = jm.prepare(mesh, "airfoil", "farfield")
u_dot = np.sin(np.pi * plan.moving_points[:, :1]) * np.array([0.0, 1.0])
u = 0.1 * u_dot
quads = mesh.cells["quad"]
x, v = jm.deform(plan, u)[quads], jm.velocity(plan, u, u_dot)[quads]


def areas(u):
    a = jm.deform(plan, u)[quads]
    b = jnp.roll(a, -1, axis=1)
    return 0.5 * jnp.sum(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], axis=1)


rate = jax.jvp(areas, (jnp.asarray(u),), (jnp.asarray(u_dot),))[1]
edge, middle = jnp.roll(x, -1, axis=1) - x, 0.5 * (jnp.roll(v, -1, axis=1) + v)
flux = jnp.sum(edge[..., 1] * middle[..., 0] - edge[..., 0] * middle[..., 1], axis=1)
difference = float(jnp.abs(rate - flux).max() / jnp.abs(rate).max())
print(f"difference {difference:.0e}")
assert difference < 1e-12
