"""Moves a mesh by its plan: points, sensitivities and velocities, on all cores and devices."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree, Real

from .._host.package.arguments import checked
from .._host.package.cores import T, in_order
from .._kernels.compile import Constant, compiled, float64_mode, is_direct
from .._kernels.values import is_known, is_readable
from .._methods.blocks import is_rows, with_tables, without_tables
from .devices import AXIS, Layout, pad_rows, rows_from
from .plan import Plan, Shared, VolumePart, deform_surface, extended, move, shared_by


@checked
def deform(plan: Plan, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "n d"]:
    """Moves the mesh: node `plan.moving[i]` by `u[i]`; fixed nodes stay, all other nodes follow.

    A method that is `exact` moves and fixes these nodes exactly; a reduced `RBF` alone does so
    approximately. The motion is one step, and linear in `u` (m, d), in the mesh's unit, where
    `plan.is_linear`. Traced. Judge the result with `quality`: `deform` knows nothing of cells.

    **Returns:** all points (n, d), in the mesh's own node order and unit. **Raises:** `ValueError`
    for another shape of `u`.
    """
    parts = (
        slabs(len(plan.volume.points), plan, u)
        if isinstance(plan, Plan) and plan.layout is None
        else ()
    )
    if not parts:
        return _deform(transposable(plan, u), u)
    shared = _shared(plan, u)
    volume = without_tables(plan.volume)
    moved = on_all_cores(lambda part: _slab(shared, volume, part[0], Constant(part[1])), parts)
    return join_slabs(moved, len(volume.points))


@compiled
def _deform(plan: Plan, u: Any) -> Float[Array, "n d"]:
    return deform_surface(plan, extended(plan, u))


@compiled
def _shared(plan: Plan, u: Any) -> Shared:
    return shared_by(plan, extended(plan, u))


@compiled
def _slab(shared: Shared, volume: VolumePart, start: Any, size: Constant) -> Float[Array, "s d"]:
    rows = _slice_rows(volume, start, size.value)
    return move(shared, rows, rows_from(start, shared.nodes, size.value))


def _slice_rows(rows: PyTree, start: Any, size: int) -> PyTree:
    return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, size), rows)


@checked
def pullback(
    plan: Plan,
    u: Real[ArrayLike, "m d"] | Sequence[Any],
    cotangent: Real[ArrayLike, "n d"] | Sequence[Any],
) -> Float[Array, "m d"]:
    """Pulls sensitivities with respect to all points back to the moving nodes.

    This is the transpose of `deform`, which other programs call warpDeriv.

    **Arguments:**

    - `plan`: from `prepare`.
    - `u`: displacements (m, d) of the moving nodes. Where `plan.is_linear`, only the shape matters.
    - `cotangent`: dJ/d(points) at all points (n, d), in the mesh's own node order.

    **Returns:** dJ/du (m, d). **Raises:** `ValueError` for another shape of `u` or `cotangent`.
    """
    number = shares(plan, u, cotangent) if isinstance(plan, Plan) and plan.layout is None else 1
    if number == 1:
        return _pullback(with_transposes(plan), u, cotangent)
    cotangent = _of_points(plan, cotangent)
    plan = with_transposes(plan, number)
    shared = _shared(plan, u)
    volume = plan.volume
    places = [np.asarray(k, np.int32) for k in range(number)]
    parts = on_all_cores(lambda k: _share(shared, volume, cotangent, k, Constant(number)), places)
    return _put_together(plan, u, parts)


@compiled
def _pullback(plan: Plan, u: Any, cotangent: Any) -> Float[Array, "m d"]:
    cotangent = _of_points(plan, cotangent)
    return jax.vjp(lambda u: _deform(plan, u), jnp.asarray(u, plan.points.dtype))[1](cotangent)[0]


def _of_points(plan: Plan, cotangent: Any) -> Float[Array, "n d"]:
    cotangent = jnp.asarray(cotangent, plan.points.dtype)
    if cotangent.shape != plan.points.shape:
        raise ValueError(
            f"`cotangent` has shape {cotangent.shape}; this plan's points have {plan.points.shape}."
        )
    return cotangent


@checked
def velocity(
    plan: Plan, u: Float[ArrayLike, "m d"], u_dot: Float[ArrayLike, "m d"]
) -> Float[Array, "n d"]:
    """Computes the velocity of every node from the velocities `u_dot` of the moving nodes.

    Both `u`, the displacements at this time, and `u_dot` are (m, d). The volume of a cell changes
    at the rate of the velocity's flux through its faces, to round-off: the geometric conservation
    law.

    **Returns:** velocities (n, d), zero at fixed nodes. **Raises:** `ValueError` for other shapes.
    """
    u = jnp.asarray(u, plan.points.dtype)
    u_dot = jnp.asarray(u_dot, plan.points.dtype)
    if u.shape != u_dot.shape:
        raise ValueError(f"`u_dot` has shape {u_dot.shape}, `u` {u.shape}.")
    return jax.jvp(lambda u: deform(plan, u), (u,), (u_dot,))[1]


def with_transposes(plan: Any, parts: int = 1) -> Any:
    """Adds the tables, for so many shares of points, to a plan of known arrays, and to its guide,
    once. A plan that is traced, or laid over devices, stays as it is: its transpose scatters, or
    has tables.
    """
    if not isinstance(plan, Plan) or plan.layout is not None or not is_readable(plan):
        return plan
    placed = with_tables(without_tables(plan.volume.placed), len(plan.surface.points), parts)
    surface = plan.surface
    guide = plan.surface.guide
    if guide is not None:
        surface = dataclasses.replace(
            surface, guide=dataclasses.replace(guide, plan=with_transposes(guide.plan))
        )
    return dataclasses.replace(
        plan, surface=surface, volume=dataclasses.replace(plan.volume, placed=placed)
    )


def transposable(plan: Any, *arguments: Any) -> Any:
    """Adds the tables where another argument is traced: it may be differentiated."""
    return plan if is_known(arguments) else with_transposes(plan)


# XLA splits the loop over a program's blocks among threads operation by operation, and they wait
# for each other at each. Programs of one slab of points each have nothing to wait for. XLA runs the
# programs that one thread begins one after the other, so a thread for each core begins them.
LEAST_SLAB = 2**16  # points of a slab below which a program of its own costs more than it gains
# slabs of all points, and shares of a sum: more cores than these would not make a call faster
MOST_PARTS = 64
# slabs begin at multiples of this, as blocks do: a block's size changes its last bits
SLAB_STEP = 1536


def slabs(count: int, *arguments: Any) -> list[tuple[np.ndarray, int]]:
    """Divides points into slabs: first rows and counts; none for traced calls or few points. All
    have one size, and so one program; some overlap. They do not depend on the number of cores:
    results have equal bits.
    """
    if count < 2 * LEAST_SLAB or not is_direct(arguments):
        return []
    # Every slab ends with the points that are left over when all are divided into steps, as the
    # last slab has to. Rows shared with the next slab are cut off.
    rest = count % SLAB_STEP
    number = min(MOST_PARTS, count // LEAST_SLAB // 2 * 2)
    stride = -(-(count - rest) // (number * SLAB_STEP)) * SLAB_STEP
    size = stride + rest
    return [
        (np.asarray(start, np.int32), size)
        for start in [*range(0, count - size, stride), count - size]
    ]


@compiled
def join_slabs(parts: tuple[Float[Array, "s d"], ...], count: int) -> Float[Array, "n d"]:
    *others, last = parts
    stride = len(last) - count % SLAB_STEP
    before = count - len(last)
    return jnp.concatenate(
        [*(part[: min(stride, before - k * stride)] for k, part in enumerate(others)), last]
    )


def shares(plan: Plan, *arguments: Any) -> int:
    """Counts shares of a plan's points in a sum, for any number of cores; 1 if traced."""
    surface = len(plan.surface.points)  # each share has a sum for all of it
    number = min(MOST_PARTS, len(plan.points) // max(LEAST_SLAB, 2 * surface)) // 2 * 2
    return number if number and is_direct(plan, arguments) else 1


def on_all_cores(program: Callable[[Any], T], pieces: list[Any]) -> tuple[T, ...]:
    """Runs a program for each piece, on all cores. The first call compiles."""
    is_wide = jax.dtypes.canonicalize_dtype(np.float64) == np.float64

    def run(piece: Any) -> T:
        with float64_mode(is_wide):  # a setting of the thread
            return program(piece)

    return (program(pieces[0]), *in_order(run, pieces[1:]))


@compiled
def _share(
    shared: Shared, volume: VolumePart, cotangent: Array, k: Any, number: Constant
) -> Shared:
    """Pulls cotangents of share k of the points back to the leaves that depend on `u`."""
    count = len(cotangent)
    size = -(-count // number.value)
    start = jnp.minimum(k * size, count - size)  # the last share overlaps the one before it

    def of_share(leaf: Any) -> Any:
        if not is_rows(leaf):
            return _slice_rows(leaf, start, size)
        length = len(leaf.table.owner) // number.value
        table = _slice_rows(leaf.table, k * length, length)
        return dataclasses.replace(_slice_rows(leaf.without_table(), start, size), table=table)

    rows = jax.tree.map(of_share, volume, is_leaf=is_rows)
    at = rows_from(start, shared.nodes, size)
    is_counted = start + jnp.arange(size) >= k * size
    cotangent = jnp.where(is_counted[:, None], _slice_rows(cotangent, start, size), 0)
    varying, constant = shared.split()

    def moved(varying: Shared) -> Float[Array, "s d"]:
        return move(eqx.combine(varying, constant), rows, at)

    return jax.vjp(moved, varying)[1](cotangent)[0]


@compiled
def _put_together(plan: Plan, u: Any, parts: tuple[Shared, ...]) -> Float[Array, "m d"]:
    """Sums the shares, always in one order, and pulls the sum back to `u`."""
    total = jax.tree.map(lambda *leaves: functools.reduce(jnp.add, leaves), *parts)
    u = jnp.asarray(u, plan.points.dtype)
    return jax.vjp(lambda u: _shared(plan, u).split()[0], u)[1](total)[0]


@checked
def shard(plan: Plan, devices: Sequence[Any]) -> Plan:
    """Lays the points of a plan over devices. `deform` and all other calls stay as they were.

    Every device holds the whole surface and an equal share of the points; the last share is padded.
    A gradient with respect to `u` costs one all-reduce. The devices may belong to several processes
    (`jax.distributed`). Every process then calls `shard` with an equal plan.

    **Raises:** `ValueError` without devices, for a plan that is laid over devices already, and for
    a method that solves for all nodes at once.
    """
    if plan.layout is not None:
        raise ValueError(
            "this plan is laid over devices already: shard the plan that `prepare` returned."
        )
    if plan.method.needs_cells:
        raise ValueError(
            f"{type(plan.method).__name__} solves for all nodes at once: its plan is not laid "
            "over devices."
        )
    layout = Layout.over(devices, len(plan.volume.points))
    volume = jax.tree.map(lambda leaf: pad_rows(leaf, layout), without_tables(plan.volume))
    placed = with_tables(volume.placed, len(plan.surface.points), layout.mesh.size)
    return dataclasses.replace(
        plan,
        method=layout.placed(plan.method),
        surface=layout.placed(plan.surface),
        volume=layout.placed(dataclasses.replace(volume, placed=placed), AXIS),
        layout=layout,
    )
