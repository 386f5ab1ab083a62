"""Moves a mesh by its plan: points, sensitivities and velocities."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

from .._host.package.arguments import checked
from .._kernels.compile import compiled
from .plan import Plan, deform_surface, extended


@checked
@compiled
def deform(plan: Plan, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "n d"]:
    """Moves the mesh: row i of `u` displaces node `plan.moving[i]`, fixed nodes stay, all other nodes follow.

    A method that is `exact` moves and fixes these nodes exactly; a reduced `RBF` alone does so
    approximately. The motion is one step, and linear in `u` where `plan.is_linear`.
    Traced: `jit`, `grad`, `jvp`, `vmap` and `scan` apply. Judge the result with `quality`: `deform`
    knows nothing of cells.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.

    **Returns:** all points (n, d), in the mesh's own node order and unit.

    **Raises:** `ValueError` when the shape of `u` is not (m, d).
    """
    return deform_surface(plan, extended(plan, u))


@checked
@compiled
def pullback(
    plan: Plan, u: Real[ArrayLike, "m d"] | Sequence[Any], cotangent: Real[ArrayLike, "n d"] | Sequence[Any]
) -> Float[Array, "m d"]:
    """Pulls sensitivities with respect to all points back to the moving nodes.

    This is the transpose of `deform`, for an adjoint solver that gives dJ/d(points). Other programs
    call it warpDeriv.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) of the moving nodes. Where `plan.is_linear`, only the shape matters.
    - `cotangent`: dJ/d(points) at all points (n, d), in the mesh's own node order.

    **Returns:** dJ/du (m, d).

    **Raises:** `ValueError` when the shape of `u` is not (m, d), or the shape of `cotangent` not
    (n, d).
    """
    cotangent = jnp.asarray(cotangent, plan.points.dtype)
    if cotangent.shape != plan.points.shape:
        raise ValueError(f"`cotangent` has shape {cotangent.shape}; this plan's points have {plan.points.shape}.")
    _, transpose = jax.vjp(lambda u: deform(plan, u), jnp.asarray(u, plan.points.dtype))
    return transpose(cotangent)[0]


@checked
def velocity(plan: Plan, u: Float[ArrayLike, "m d"], u_dot: Float[ArrayLike, "m d"]) -> Float[Array, "n d"]:
    """Computes the velocity of every node from the velocity of the moving nodes.

    The volume of a cell changes at the rate of the velocity's flux through the faces of the cell,
    to round-off: the geometric conservation law.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) at this time.
    - `u_dot`: velocities (m, d) of the moving nodes.

    **Returns:** velocities (n, d), zero at fixed nodes.

    **Raises:** `ValueError` when the shape of `u` or `u_dot` is not (m, d).
    """
    u, u_dot = jnp.asarray(u, plan.points.dtype), jnp.asarray(u_dot, plan.points.dtype)
    if u.shape != u_dot.shape:
        raise ValueError(f"`u_dot` has shape {u_dot.shape}, `u` {u.shape}.")
    return jax.jvp(lambda u: deform(plan, u), (u,), (u_dot,))[1]
