"""Velocities of the mesh from velocities of its surface."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .._host.package.arguments import checked
from .plan import Plan, deform


@checked
def velocity(plan: Plan, u: Float[ArrayLike, "m d"], u_dot: Float[ArrayLike, "m d"]) -> Float[Array, "n d"]:
    """Computes the velocity of every node from the velocity of the moving nodes.

    Volumes of cells change at the rate of this velocity's flux through their faces: the geometric conservation law, to round-off.

    **Arguments:**

    - `plan`: from `prepare`.
    - `u`: displacement (m, d) at this time.
    - `u_dot`: its rate (m, d).

    **Returns:** velocities (n, d), zero at fixed nodes.

    **Raises:** `ValueError` when the shape of `u` or `u_dot` is not (m, d).
    """
    u, u_dot = jnp.asarray(u, plan.points.dtype), jnp.asarray(u_dot, plan.points.dtype)
    if u.shape != u_dot.shape:
        raise ValueError(f"`u_dot` has shape {u_dot.shape}, `u` {u.shape}.")
    return jax.jvp(lambda u: deform(plan, u), (u,), (u_dot,))[1]
