"""Preparation: everything about a mesh that does not depend on the displacement, found once on the host."""

import warnings
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Integer, Real

from .._mesh.mesh import Mesh
from .._methods.base import AbstractMethod, Cells, Surface, check_kind
from .._methods.blocks import with_tables
from .._methods.reconstruction import SurfaceReconstruction
from .door import Boundary, boundary
from .plan import Plan, SurfaceHalf, VolumeHalf, refit
from .symmetry import Mirror, Plane, check_planes, mirror


def prepare(
    mesh: Mesh | Real[ArrayLike, "n d"] | Sequence[Any],
    moving: str | Sequence[str] | Integer[ArrayLike, " m"] | Sequence[int | np.integer],
    fixed: str | Sequence[str] | Integer[ArrayLike, " f"] | Sequence[int | np.integer] = (),
    *,
    method: AbstractMethod | None = None,
    symmetry: Plane | str | Sequence[Plane | str] = (),
    free: str | Sequence[str] | Integer[ArrayLike, " k"] | Sequence[int | np.integer] = (),
) -> Plan:
    """Prepares a plan, once per mesh and on the host: all that does not depend on the displacement.

    **Arguments:**

    - `mesh`: a `Mesh`, or points (n, d) alone, d = 2 or 3, in any unit. With a mesh, methods see which nodes its
      boundary faces connect, patches may be named, and boundary faces in no list are warned of. Precision and device
      are those of the points: float64 needs JAX's x64 mode.
    - `moving`, `fixed`: node ids, (m,) and (f,), or names of patches. A node in both moves. All others follow.
    - `method`: `SurfaceReconstruction()` by default.
    - `symmetry`: planes, or names of the patches that lie in them. Nodes on a plane stay in it, moving ones too.
    - `free`: node ids or names of patches whose nodes may follow like inner ones: not warned of. Default: none.

    **Returns:** a `Plan`.

    **Raises:** `ValueError` for ids out of range or named twice in `moving`, and coordinates that are not finite. Also for
    points outside of the hull of the surface (graph mapping), and sources that do not determine the interpolation. Also for
    planes that hold no node or have nodes on both sides.
    """
    check_kind(method, AbstractMethod, "method", "jm.RBF()", optional=True)
    return plan_of(boundary(mesh, moving, fixed, symmetry, free), method)


def plan_of(named: Boundary, method: AbstractMethod | None) -> Plan:
    """Prepares a plan of what has been checked. It warns of boundary faces that no list names, and of lost precision."""
    named.warn_of_free_faces()
    method = SurfaceReconstruction() if method is None else method
    if method.needs_cells and named.cells is None:
        raise ValueError(
            f"{type(method).__name__} needs the cells of the whole mesh: pass the mesh, prepare(mesh, ...), not points or a part."
        )
    surface, images, on_plane = surface_of(named)
    surface_ids, volume_ids = jax.tree.map(jnp.asarray, method.connect(surface, named.points))
    plan = Plan(
        method=method,
        surface=SurfaceHalf(
            jnp.asarray(surface.points), jnp.asarray(named.nodes, jnp.int32), images, surface_ids, None
        ),
        volume=VolumeHalf(
            jnp.asarray(named.points),
            None if on_plane is None else jnp.asarray(on_plane),
            volume_ids,
            None,
        ),
        n_moving=len(named.moving),
    )
    if plan.points.dtype != named.points.dtype:
        warnings.warn(
            "the points are float64 but JAX's x64 mode is off, so the plan is float32: boundary layers and gradients suffer. "
            'Call jax.config.update("jax_enable_x64", True) first.',
            stacklevel=3,
        )
    plan = _with_tables(refit(plan, plan.points))
    method.check(plan.surface.ids, plan.surface.factors, _trial(plan))
    return plan


def surface_of(named: Boundary) -> tuple[Surface, Mirror | None, Bool[np.ndarray, "n p"] | None]:
    """Returns the surface that a method sees, its mirror, and which points lie on which plane."""
    nodes, moving = named.nodes, len(named.moving)
    everything, rows, images, on_plane = named.points[nodes], np.arange(len(nodes)), None, None
    faces = named.surface_faces
    if named.planes:
        check_planes(named.planes, named.points)
        on_plane = np.stack([plane.holds(named.points) for plane in named.planes], axis=1)
        images, moving = mirror(named.planes, on_plane[nodes], moving)
        everything, rows = np.asarray(images.points(jnp.asarray(everything))), np.asarray(images.rows)
        faces = None if faces is None else {kind: images.faces(corners) for kind, corners in faces.items()}
    first = _first(rows)
    ids = np.where(np.arange(len(rows)) == first, nodes[rows], -1)
    cells = None if named.cells is None else _cells(named, on_plane)
    surface = Surface(everything, ids, moving, first, faces=faces, is_open=named.is_open, cells=cells)
    return surface, images, on_plane


def _cells(named: Boundary, on_plane: Bool[np.ndarray, "n p"] | None) -> Cells:
    """Returns the cells and planes that a method sees."""
    n, d = named.points.shape
    normals = np.stack([plane.normal for plane in named.planes]) if named.planes else np.zeros((0, d))
    return Cells(named.cells or {}, normals, np.zeros((n, 0), dtype=bool) if on_plane is None else on_plane)


def _with_tables(plan: Plan) -> Plan:
    """Returns the plan with a table of the transpose for each of its interpolations."""
    placed = with_tables(plan.volume.placed, len(plan.surface.points))
    return eqx.tree_at(lambda plan: plan.volume.placed, plan, placed, is_leaf=lambda leaf: leaf is None)


def _trial(plan: Plan) -> Float[Array, "b d"]:
    """Makes a smooth displacement of the moving nodes that no polynomial gives, of size one, fixed nodes at rest."""
    points, mirror = np.asarray(plan.points)[np.asarray(plan.surface.nodes)], plan.surface.mirror
    moving = points[: plan.n_moving]
    arms = moving - moving.mean(axis=0)
    u = np.zeros_like(points)
    u[: plan.n_moving] = np.cos(2 * arms / (np.abs(arms).max() or 1))
    if mirror is None:
        return jnp.asarray(u)
    return mirror.extended(jnp.asarray(u))


def _first(rows: np.ndarray) -> np.ndarray:
    """Finds for each row the first one with the same value."""
    _, first, inverse = np.unique(rows, return_index=True, return_inverse=True)
    return first[inverse]
