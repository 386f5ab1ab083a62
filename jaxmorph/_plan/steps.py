"""Motions in several steps: a path of displacements, followed on the host, replayed in traces."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

from .._host.package.arguments import checked
from .._kernels.compile import compiled
from .._kernels.values import Either, on_host
from .._mesh.mesh import Mesh
from .deform import transposable
from .plan import Own, Plan, constrain, deform_surface
from .prepare import plan_of
from .refit import CARRIED, refitted, with_boundary


@checked
def march(
    plan: Plan,
    path: Real[ArrayLike, "k m d"] | Sequence[Any],
    *,
    rebuild: bool = False,
    mesh: Mesh | None = None,
) -> tuple[tuple[Plan, ...], Float[Array, "n d"]]:
    """Follows a path of total displacements; refits the plan on the moved mesh before each step.

    Sources are solved for anew at every step; a Delaunay graph stays on the undeformed mesh.

    **Arguments:**

    - `plan`: from `prepare`.
    - `path`: displacements (k, m, d) in the mesh's unit. `path[j]` leads from the plan's base
      coordinates to the end of step j: a rotation is a path of rotated positions.
    - `rebuild`: choose the ids (sources, graph) again before every step, as the paper does. Default
      False. The result then jumps, by as much as a step, wherever the graph of the moved surface
      changes: a line search or a finite difference meets cliffs.
    - `mesh`: the plan's mesh, for `rebuild`: methods see its cells and boundary faces again.
      Default: points alone, which methods on cells refuse.

    **Returns:** the plans of all steps, for `replay`, and the points (n, d) at the end. **Raises:**
    `ValueError` when `path` is not (k, m, d), for a mesh of other points, and where `prepare` does.
    """
    _check_march(plan, rebuild, mesh)
    points = plan.points
    surface = None
    plans = []
    for j, target in enumerate(_own_targets(plan, path)):
        step = (
            plan
            if j == 0
            else _anew(plan, points, mesh)
            if rebuild
            else refitted(plan, points, surface, CARRIED)
        )
        points, surface = _advance(step, target)
        plans.append(step)
    return tuple(plans), points


@checked
def replay(
    plans: Sequence[Plan], path: Real[ArrayLike, "k m d"] | Sequence[Any]
) -> Float[Array, "n d"]:
    """Repeats the steps of a `march` with the recorded ids: the points are equal.

    Traced; differentiable with respect to `path`, and to the base coordinates through
    `refit(plans[0], points)`. `plans` are those that `march` returned, and `path` (k, m, d) has an
    entry for every plan, as for `march`.

    **Returns:** the points (n, d) at the end. **Raises:** `ValueError` for another shape of `path`.
    """
    if not plans:
        raise ValueError("`plans` is empty: pass the plans that `march` returned.")
    targets = _own_targets(plans[0], path)
    if len(targets) != len(plans):
        raise ValueError(
            f"`path` has {len(targets)} steps, but there are {len(plans)} plans; pass the path "
            "that was marched."
        )
    plans = [transposable(plan, path) for plan in plans]
    current = plans[0]
    points = plans[0].points
    surface = None
    for plan, target in zip(plans, targets, strict=True):
        if plan.carried:
            current = refitted(current, points, surface, CARRIED)
        elif current is not plan:
            current = refitted(
                with_boundary(plan, current.surface.tracks, current.surface.pairings), points
            )
        points, surface = _advance(current, target)
    return points


def _own_targets(plan: Plan, path) -> Float[Either, "k o d"]:
    """Places (k, o, d) of the surface's own rows at the end of every step."""
    path = jnp.asarray(path, plan.points.dtype)
    m = plan.n_moving
    d = plan.points.shape[1]
    if path.ndim != 3 or path.shape[1:] != (m, d):
        raise ValueError(
            f"`path` has shape {path.shape}; expected (steps, {m}, {d}): the total displacement "
            "at the end of every step."
        )
    base = plan.surface_points
    if on_host(base, path):
        targets = np.repeat(np.asarray(base)[None], len(path), axis=0)
        targets[:, :m] += np.asarray(path)
        return targets
    return jnp.broadcast_to(base, (len(path), *base.shape)).at[:, :m].add(path)


@compiled
def _advance(plan: Plan, target: Own) -> tuple[Float[Array, "n d"], Own | None]:
    vectors = target - plan.surface_points
    points = deform_surface(plan, vectors)
    if not plan.is_piece:
        return points, None
    if not plan.method.exact:
        return points, points[plan.surface.nodes]
    return points, plan.places_of(constrain(plan, vectors))


def _check_march(plan: Plan, rebuild: bool, mesh: Mesh | None) -> None:
    if rebuild and mesh is None and plan.method.needs_cells:
        name = type(plan.method).__name__
        raise ValueError(
            f"{name} needs the cells of the mesh at each step: march(plan, path, rebuild=True, "
            "mesh=mesh)."
        )
    if mesh is not None:
        plan.check_mesh(mesh)
        if not rebuild:
            raise ValueError(
                "`mesh` needs `rebuild=True`. Without it the ids of the plan are kept. Pass "
                "rebuild=True, or remove `mesh`."
            )
    if plan.is_piece and (
        rebuild or (not plan.method.exact and int(plan.surface.nodes.max()) >= len(plan.points))
    ):
        raise ValueError(
            "march of a piece needs rebuild=False, and a method that is exact at the surface: "
            "other pieces have the rest."
        )


def _anew(plan: Plan, points, mesh: Mesh | None) -> Plan:
    boundary = plan.boundary.altered(points=np.asarray(points))
    if mesh is not None:
        # `prepare` has warned of free faces
        boundary = boundary.with_mesh(mesh.moved(points)).altered(left=None)
    return plan_of(boundary, plan.method)
