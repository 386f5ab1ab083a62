"""Preparation: all of a mesh that does not depend on the displacement, once on the host."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Real

from .._boundary.boundary import Boundary
from .._boundary.conditions import Conditions
from .._boundary.images import Images
from .._boundary.names import Nodes, nothing_in
from .._boundary.periodic import Periodic
from .._boundary.slide import Slide
from .._boundary.surface import surface_of
from .._boundary.symmetry import Plane
from .._host.package.errors import warn
from .._host.package.rounding import extent_of
from .._host.rows import mark
from .._host.tolerances import SAME
from .._kernels.compile import compiled, quickly_compiled
from .._kernels.values import as_jax, jax_arrays
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, Rows, check_kind
from .._methods.multiscale import carrying, guiding
from .._methods.reconstruction import SurfaceReconstruction
from .._methods.surface import Surface
from .plan import Guide, Plan, SurfacePart, VolumePart
from .refit import refitted

# numbers of points and of surface nodes below which compiling takes longer than one compiled run
QUICK_POINTS = 50_000
QUICK_ROWS = 2_000


def prepare(
    mesh: Conditions | Mesh | Real[ArrayLike, "n d"] | Sequence[Any],
    moving: Nodes | None = None,
    fixed: Nodes = (),
    *,
    method: AbstractMethod | None = None,
    symmetry: Plane | str | Sequence[Plane | str] = (),
    periodic: Periodic | Sequence[Periodic] = (),
    sliding: Slide | str | Sequence[Slide | str] = (),
    free: Nodes = (),
) -> Plan:
    """Prepares a plan, once per mesh, on the host: all that does not depend on the displacement.

    `prepare(mesh, "wing", "far", ...)` is short for `prepare(Boundary(mesh, "wing", "far", ...))`.

    **Arguments:**

    - `mesh`: a `Boundary`, or a `Mesh` or points (n, d). Precision and device come from the points:
      float64 needs JAX's x64 mode.
    - `moving`, `fixed`, `symmetry`, `periodic`, `sliding`, `free`: as `Boundary` takes them, which
      is then made. Not with a `Boundary`.
    - `method`: `SurfaceReconstruction()` by default. Where nothing is fixed and nodes lie beyond
      the moving ones, as in an overset grid, it is `InverseDistance(rotations=True)`.

    **Returns:** a `Plan`.

    **Raises:** `ValueError` where `Boundary` does. Also for no moving nodes, for points outside of
    the surface's hull (graph mapping), and sources that do not determine the interpolation. Also
    for planes that hold no node or have nodes on both sides.
    """
    check_kind(method, AbstractMethod, "method", "jm.RBF()", optional=True)
    lists = {"symmetry": symmetry, "periodic": periodic, "sliding": sliding, "free": free}
    if not isinstance(mesh, Conditions):
        return plan_of(Boundary(mesh, () if moving is None else moving, fixed, **lists), method)
    if moving is not None or not nothing_in(fixed, *lists.values()):
        raise ValueError(
            "a Boundary has its lists of nodes: call prepare(boundary, method=...), and name "
            "them there."
        )
    return plan_of(mesh, method)


def plan_of(boundary: Conditions, method: AbstractMethod | None) -> Plan:
    if not len(boundary.moving):
        raise ValueError("`moving` is empty: name the nodes of the boundary that moves.")
    boundary.warn_of_free_faces()
    if method is not None and method.needs_cells:
        if boundary.cells is None:
            refuse_cells(method)
        boundary = boundary.for_cells()
    surface, images = surface_of(boundary)
    method = default_for(boundary, surface) if method is None else method
    if method.needs_cells and images.edges:
        raise ValueError(
            f"{type(method).__name__} takes symmetry planes that are parallel or at right "
            "angles: for others call prepare with SurfaceReconstruction() or RBF()."
        )
    guide = _guide_of(boundary, method)
    plan = _plan_of(boundary, method, surface, images, guide)
    if plan.points.dtype != boundary.points.dtype:
        warn(
            "the points are float64 but JAX's x64 mode is off, so the plan is float32: boundary "
            "layers and gradients suffer. "
            'Call jax.config.update("jax_enable_x64", True) first.'
        )
    return plan


def default_for(boundary: Conditions, surface: Surface) -> AbstractMethod:
    """Chooses the default method: inverse distances if no outer boundary is fixed."""
    if len(boundary.fixed) or not boundary.surface_faces:
        return SurfaceReconstruction()
    points = np.delete(boundary.points, boundary.loose, axis=0)
    slack = SAME * extent_of(points)
    low = surface.points.min(axis=0) - slack
    high = surface.points.max(axis=0) + slack
    is_beyond = (points < low) | (points > high)
    return carrying() if is_beyond.any() else SurfaceReconstruction()


def refuse_cells(method: AbstractMethod) -> None:
    if method.needs_cells:
        raise ValueError(
            f"{type(method).__name__} needs the cells of the whole mesh: pass the mesh, "
            "prepare(mesh, ...), not points or a part."
        )


def _plan_of(
    boundary: Conditions,
    method: AbstractMethod,
    surface: Surface,
    images: Images,
    guide: Guide | None = None,
) -> Plan:
    points = boundary.points
    like = np.arange(len(boundary.points))
    rests = None
    if len(boundary.loose):
        # nodes of no cell may lie anywhere: methods see them at the first moving node, with its ids
        like[boundary.loose] = boundary.moving[0]
        points = points[like]
        rests = as_jax(mark(len(points), boundary.loose))
    surface_ids, volume_ids = as_jax(method.connect(surface, points))
    if rests is not None:
        volume_ids = jax.tree.map(lambda leaf: leaf[like], volume_ids)
    of_surface = jax_arrays(points=surface.points, nodes=boundary.nodes)
    of_points = jax_arrays(points=boundary.points, on_plane=boundary.on)
    plan = Plan(
        method=method,
        surface=SurfacePart(
            **of_surface, images=images, ids=surface_ids, factors=None, guide=guide
        ),
        volume=VolumePart(**of_points, ids=volume_ids, placed=None, rests=rests),
        n_moving=len(boundary.moving),
        n_guided=len(boundary.guided),
    )
    is_small = len(points) <= QUICK_POINTS and len(surface.points) <= QUICK_ROWS
    is_quick = is_small and not method.needs_cells
    with quickly_compiled(is_quick):
        plan = refitted(plan, plan.points)
        method.check(plan.surface.ids, plan.surface.factors, _trial_displacement(plan))
    return plan


def _guide_of(boundary: Conditions, method: AbstractMethod) -> Guide | None:
    if not boundary.pairings and not boundary.tracks and not len(boundary.guided):
        return None
    alone = boundary.alone()
    plan = _plan_of(alone, guiding(method), *surface_of(alone, alone.pairings))
    known = len(boundary.moving) + len(boundary.fixed)
    rows = [
        *(pairing.nodes for pairing in alone.pairings),
        *(np.asarray(track.rows) for track in alone.tracks),
    ]
    rows.append(np.arange(known, len(boundary.nodes)))
    pairings, tracks = as_jax((alone.pairings, alone.tracks))
    return Guide(plan, pairings, tracks, jnp.asarray(np.unique(np.concatenate(rows)), jnp.int32))


def _trial_displacement(plan: Plan) -> Rows:
    """Makes a smooth displacement of the moving nodes, of size one, no polynomial; others rest."""
    points = np.asarray(plan.points)[np.asarray(plan.surface.nodes)]
    moving = points[: plan.n_moving]
    arms = moving - moving.mean(axis=0)
    u = np.zeros_like(points)
    u[: plan.n_moving] = np.cos(2 * arms / (np.abs(arms).max() or 1))
    images = plan.images
    return as_jax(u[np.asarray(images.rows)]) if images.is_plain else _with_images(images, u)


@compiled
def _with_images(images: Images, u: Any) -> Rows:
    return images.vectors(images.kept(jnp.asarray(u)))
