"""Moves a mesh by its plan: points, sensitivities and velocities."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

from .._host.package.arguments import checked
from .._kernels.compile import Constant, compiled
from .._methods.blocks import without_tables
from .devices import rows_from
from .plan import Plan, Shared, VolumePart, deform_surface, extended, move, shared_by
from .shares import pulled_back
from .slabs import joined, on_all_cores, shares, slabs
from .transposes import transposable, with_transposes


@checked
def deform(plan: Plan, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "n d"]:
    """Moves the mesh: node `plan.moving[i]` by `u[i]`; fixed nodes stay, all other nodes follow.

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
    parts = slabs(len(plan.volume.points), plan, u) if isinstance(plan, Plan) and plan.layout is None else ()
    if not parts:
        return _deform(transposable(plan, u), u)
    shared, volume = _shared(plan, u), without_tables(plan.volume)
    moved = on_all_cores(lambda part: _slab(shared, volume, part[0], Constant(part[1])), parts)
    return joined(moved, len(volume.points))


@compiled
def _deform(plan: Plan, u: Any) -> Float[Array, "n d"]:
    return deform_surface(plan, extended(plan, u))


@compiled
def _shared(plan: Plan, u: Any) -> Shared:
    return shared_by(plan, extended(plan, u))


@compiled
def _slab(shared: Shared, volume: VolumePart, start: Any, size: Constant) -> Float[Array, "s d"]:
    rows = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, size.value), volume)
    return move(shared, rows, rows_from(start, shared.nodes, size.value))


@checked
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
    number = shares(plan, u, cotangent) if isinstance(plan, Plan) and plan.layout is None else 1
    if number > 1:
        return pulled_back(plan, u, _of_points(plan, cotangent), number)
    return _pullback(with_transposes(plan), u, cotangent)


@compiled
def _pullback(plan: Plan, u: Any, cotangent: Any) -> Float[Array, "m d"]:
    cotangent = _of_points(plan, cotangent)
    return jax.vjp(lambda u: _deform(plan, u), jnp.asarray(u, plan.points.dtype))[1](cotangent)[0]


def _of_points(plan: Plan, cotangent: Any) -> Float[Array, "n d"]:
    cotangent = jnp.asarray(cotangent, plan.points.dtype)
    if cotangent.shape != plan.points.shape:
        raise ValueError(f"`cotangent` has shape {cotangent.shape}; this plan's points have {plan.points.shape}.")
    return cotangent


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
