"""Preparation: all of a mesh that does not depend on the displacement, once on the host."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Integer, PyTree, Real

from .._boundary.arguments import find_boundary
from .._boundary.boundary import Boundary, renumbered
from .._boundary.images import Images, images_of
from .._boundary.kinds import by_kinds
from .._boundary.matching import across_one_layer
from .._boundary.pairing import check_pairings
from .._boundary.periodic import Periodic
from .._boundary.slide import Slide
from .._boundary.symmetry import Plane, check_planes, on_facing
from .._host.package.errors import warn
from .._host.package.rounding import SAME
from .._kernels.compile import compiled, quickly_compiled
from .._kernels.kept import kept_in_jaxs_folder
from .._kernels.values import as_jax
from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, check_kind
from .._methods.blocks import place_points
from .._methods.guiding import carrying, guiding
from .._methods.reconstruction import SurfaceReconstruction
from .._methods.surface import Cells, Surface
from .base import refitted
from .plan import Guide, Plan, SurfacePart, VolumePart

FEW = 50_000, 2_000
"""Points, and surface nodes, below which compiling takes longer than one compiled run."""


def prepare(
    mesh: Mesh | Real[ArrayLike, "n d"] | Sequence[Any],
    moving: str | Sequence[str] | Integer[ArrayLike, " m"] | Sequence[int | np.integer],
    fixed: str | Sequence[str] | Integer[ArrayLike, " f"] | Sequence[int | np.integer] = (),
    *,
    method: AbstractMethod | None = None,
    symmetry: Plane | str | Sequence[Plane | str] = (),
    periodic: Periodic | Sequence[Periodic] = (),
    sliding: Slide | str | Sequence[Slide | str] = (),
    free: str | Sequence[str] | Integer[ArrayLike, " k"] | Sequence[int | np.integer] = (),
) -> Plan:
    """Prepares a plan, once per mesh, on the host: all that does not depend on the displacement.

    **Arguments:**

    - `mesh`: a `Mesh`, or points (n, d) alone, d = 2 or 3, in any unit. With a mesh, methods see
      the boundary faces, patches may be named, and boundary faces in no list cause a warning.
      Precision and device come from the points: float64 needs JAX's x64 mode.
    - `moving`, `fixed`: node ids, (m,) and (f,), or names of patches. A node in both lists moves.
      Nodes in no list follow. If nothing but moving patches is named, the `kinds` of the other
      patches decide: symmetry planes slide, all others are fixed. A warning names them.
    - `method`: `SurfaceReconstruction()` by default. Where nothing is fixed and nodes lie beyond
      the moving ones, as in an overset grid, it is `InverseDistance(rotations=True)`.
    - `symmetry`: planes, or names of patches that lie in one or several planes. Nodes on a plane
      stay in it, also moving nodes.
    - `periodic`: pairs of patches of which one repeats the other. The two nodes of a pair move
      alike.
    - `sliding`: patches whose nodes stay on their surface and move along it. A name stands for the
      patch's own faces.
    - `free`: node ids or names of patches whose nodes may follow like inner nodes, without a
      warning. Default: none.

    **Returns:** a `Plan`.

    **Raises:** `ValueError` for ids out of range, ids that come twice in `moving`, and coordinates
    that are not finite. Also for points outside of the surface's hull (graph mapping), and sources
    that do not determine the interpolation. Also for planes that hold no node or have nodes on both
    sides, periodic patches that do not match, and sliding patches that do not lie on their surface.
    """
    check_kind(method, AbstractMethod, "method", "jm.RBF()", optional=True)
    if all(isinstance(argument, tuple) and not argument for argument in (fixed, symmetry, sliding, free)):
        fixed, symmetry = by_kinds(mesh, moving, periodic)
    return plan_of(find_boundary(mesh, moving, fixed, symmetry, free, periodic, sliding), method)


def plan_of(boundary: Boundary, method: AbstractMethod | None) -> Plan:
    """Prepares the plan of a checked boundary; warns of free faces and of lost precision."""
    boundary.warn_of_free_faces()
    method = default_for(boundary) if method is None else method
    boundary = between_planes(boundary, method)
    check_pairings(boundary.pairings, boundary.planes, float(np.ptp(boundary.points, axis=0).max()))
    if boundary.cells is None:
        refuse_cells(method)
    guide = _guide_of(boundary, method)
    plan = _plan_of(dataclasses.replace(boundary, pairings=(), tracks=()), method, guide)
    if plan.points.dtype != boundary.points.dtype:
        warn(
            "the points are float64 but JAX's x64 mode is off, so the plan is float32: boundary layers and gradients suffer. "
            'Call jax.config.update("jax_enable_x64", True) first.',
        )
    return plan


def default_for(boundary: Boundary) -> AbstractMethod:
    """Chooses the default method, which IDWarp's replaces where nothing holds an outer boundary."""
    if len(boundary.fixed) or not boundary.surface_faces:
        return SurfaceReconstruction()
    surface, points = (
        surface_of(dataclasses.replace(between_planes(boundary), pairings=()))[0].points,
        boundary.of_cells,
    )
    slack = SAME * np.ptp(points, axis=0).max()
    is_beyond = (points < surface.min(axis=0) - slack) | (points > surface.max(axis=0) + slack)
    return carrying() if is_beyond.any() else SurfaceReconstruction()


def between_planes(boundary: Boundary, method: AbstractMethod | None = None) -> Boundary:
    """Checks the planes, and guides the nodes of parallel planes, except for methods on cells.

    Two parallel mirrors have endless images. A field with some of the images has a step beside the
    plane, by which cells invert. So parallel planes make no images. A field without images guides
    the nodes of the planes, which then are data of the mesh's field. Where planes hold all nodes,
    as around one layer of cells, guided nodes that face each other move alike.
    """
    if boundary.planes:
        check_planes(boundary.planes, boundary.of_cells)
    if method is not None and method.needs_cells:
        return boundary
    others = np.setdiff1d(np.flatnonzero(on_facing(boundary.planes, boundary.points)), boundary.nodes)
    others = np.setdiff1d(others, boundary.loose)
    if not len(others):
        return boundary
    place = np.delete(np.arange(len(boundary.points)), boundary.loose)
    layer = across_one_layer(boundary.planes, boundary.of_cells)
    layer = tuple(pairing.renumbered(np.where(np.isin(place, others), place, -1)) for pairing in layer)
    guided, pairings = np.union1d(boundary.guided, others), (*boundary.pairings, *layer)
    return dataclasses.replace(boundary, guided=guided, pairings=pairings)


def refuse_cells(method: AbstractMethod) -> None:
    """Raises `ValueError` for a method that solves on cells, if no cells are known."""
    if method.needs_cells:
        raise ValueError(
            f"{type(method).__name__} needs the cells of the whole mesh: pass the mesh, prepare(mesh, ...), not points or a part."
        )


def _plan_of(boundary: Boundary, method: AbstractMethod, guide: Guide | None = None) -> Plan:
    surface, images, on_plane = surface_of(boundary)
    points, like, rests = boundary.points, np.arange(len(boundary.points)), None
    if len(boundary.loose):
        # nodes of no cell may lie anywhere: methods see them at the first moving node, with its ids
        like[boundary.loose] = boundary.moving[0]
        points, rests = points[like], as_jax(np.isin(np.arange(len(points)), boundary.loose))
    surface_ids, volume_ids = as_jax(method.connect(surface, points))
    if rests is not None:
        volume_ids = jax.tree.map(lambda leaf: leaf[like], volume_ids)
    nodes = as_jax(boundary.nodes.astype(np.int32))
    on_plane = None if on_plane is None else as_jax(on_plane)
    plan = Plan(
        method=method,
        surface=SurfacePart(as_jax(surface.points), nodes, images, surface_ids, None, guide),
        volume=VolumePart(as_jax(boundary.points), on_plane, volume_ids, None, rests),
        n_moving=len(boundary.moving),
        n_guided=len(boundary.guided),
    )
    sizes = len(boundary.points), len(surface.points)
    is_quick = not method.needs_cells and all(size <= most for size, most in zip(sizes, FEW, strict=True))
    with quickly_compiled(is_quick), kept_in_jaxs_folder():
        plan = refitted(plan, plan.points)
        method.check(plan.surface.ids, plan.surface.factors, _trial(plan))
    return plan


def laid_out(
    plan: Plan, shared: SurfacePart, points: Array, on_plane: Bool[np.ndarray, "n p"] | None, volume_ids: PyTree
) -> Plan:
    """Makes a plan of other points with the surface and the factors of a plan."""
    flags = None if on_plane is None else as_jax(on_plane)
    volume = VolumePart(points, flags, volume_ids, _placed(plan.method, shared, points, volume_ids))
    return Plan(plan.method, shared, volume, plan.n_moving, plan.n_guided, is_piece=True)


@compiled
def _placed(method: AbstractMethod, shared: SurfacePart, points: Array, ids: PyTree) -> PyTree:
    return place_points(method, points, ids, shared.factors, shared.points)


def _cells(boundary: Boundary, on_plane: Bool[np.ndarray, "n p"] | None) -> Cells:
    """Returns the cells and planes that a method sees."""
    n, d = boundary.points.shape
    normals = np.stack([plane.normal for plane in boundary.planes]) if boundary.planes else np.zeros((0, d))
    return Cells(boundary.cells or {}, normals, np.zeros((n, 0), dtype=bool) if on_plane is None else on_plane)


def surface_of(boundary: Boundary) -> tuple[Surface, Images | None, Bool[np.ndarray, "n p"] | None]:
    """Returns the surface that a method sees, its images, and a mask (n, p) of points on planes."""
    points, nodes, moving, faces = boundary.points, boundary.nodes, len(boundary.moving), boundary.surface_faces
    if not boundary.planes and not boundary.pairings:
        rows = np.arange(len(nodes))
        cells = None if boundary.cells is None else _cells(boundary, None)
        return (
            Surface(points[nodes], nodes, moving, rows, faces=faces, is_open=boundary.is_open, cells=cells),
            None,
            None,
        )
    on_plane = np.zeros((len(points), len(boundary.planes)), dtype=bool)
    for k, plane in enumerate(boundary.planes):
        on_plane[:, k] = plane.holds(points)
    images, copies = images_of(boundary.planes, boundary.pairings, on_plane, nodes, moving, points)
    everything = np.asarray(images.points(jnp.asarray(points[nodes])))
    faces = None if faces is None else {kind: copies.faces(corners) for kind, corners in faces.items()}
    ids = np.where(copies.kind == 0, nodes[copies.rows], -1)
    cells = None if boundary.cells is None else _cells(boundary, on_plane)
    listed = len(boundary.moving) + len(boundary.fixed)
    in_planes = (copies.rows >= listed) & np.asarray(on_plane[nodes].any(axis=1))[copies.rows]
    surface = Surface(
        *(everything, ids, copies.moving, copies.first),
        faces=faces,
        is_open=boundary.is_open,
        cells=cells,
        in_planes=in_planes if in_planes.any() else None,
    )
    return surface, images, on_plane


def _guide_of(boundary: Boundary, method: AbstractMethod) -> Guide | None:
    """Prepares the guide, if there are sliding, periodic or guided nodes."""
    if not boundary.pairings and not boundary.tracks and not len(boundary.guided):
        return None
    alone = boundary.alone()
    plan = _plan_of(alone, guiding(method))
    known = len(boundary.moving) + len(boundary.fixed)
    rows = [*(pairing.nodes for pairing in alone.pairings), *(np.asarray(track.rows) for track in alone.tracks)]
    rows.append(np.arange(known, len(boundary.nodes)))
    pairings, tracks = as_jax((alone.pairings, alone.tracks))
    return Guide(plan, pairings, tracks, jnp.asarray(np.unique(np.concatenate(rows)), jnp.int32))


def boundary_of(plan: Plan) -> Boundary:
    """Returns the boundary of a plan; without faces, which a plan does not keep."""
    points, moving, fixed, guided = map(np.asarray, (plan.points, plan.moving, plan.fixed, plan.guided))
    nodes, guide = np.concatenate([moving, fixed, guided]), plan.surface.guide
    planes = () if plan.images is None else plan.images.planes
    pairings, tracks = ((), ()) if guide is None else jax.tree.map(np.asarray, (guide.pairings, guide.tracks))
    joined = renumbered(pairings, tracks, nodes)
    loose = np.zeros(0, int) if plan.volume.rests is None else np.flatnonzero(plan.volume.rests)
    return Boundary(points, moving, fixed, guided, planes, *joined, loose=loose)


def _trial(plan: Plan) -> Float[Array, "b d"]:
    """Makes a smooth displacement of the moving nodes, of size one, no polynomial; others rest."""
    points, images = np.asarray(plan.points)[np.asarray(plan.surface.nodes)], plan.images
    moving = points[: plan.n_moving]
    arms = moving - moving.mean(axis=0)
    u = np.zeros_like(points)
    u[: plan.n_moving] = np.cos(2 * arms / (np.abs(arms).max() or 1))
    if images is None:
        return as_jax(u)
    return images.extended(as_jax(u))
