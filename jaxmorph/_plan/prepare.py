"""Preparation: everything about a mesh that does not depend on the displacement, found once on the host."""

import warnings
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.errors import MeshError
from .._methods.base import AbstractMethod, Surface
from .._methods.blocks import with_tables
from .._methods.default import default_method
from .plan import Plan, SurfaceHalf, VolumeHalf, refit
from .symmetry import Mirror, Plane, check_planes, mirror


def prepare(
    points: Float[Array | np.ndarray, "n d"],
    moving: Int[Array | np.ndarray, " m"] | Sequence[int],
    fixed: Int[Array | np.ndarray, " f"] | Sequence[int] = (),
    *,
    method: AbstractMethod | None = None,
    symmetry: Plane | Sequence[Plane] = (),
) -> Plan:
    """Finds, once per mesh and on the host, everything that does not depend on the displacement.

    `points` (n, d), d = 2 or 3, in any unit; `moving` (m,) and `fixed` (f,) are node ids, and a node in both moves. Nodes in
    neither are interior, and follow. Nodes on a plane of `symmetry` stay in it, the moving ones too. `method=None` is the
    paper's with two additions that real walls need, `SurfaceReconstruction(RBF(reduction=KDTree(64, extremes=True)),
    NearWall())`. Precision and device are those of `points`: float64 needs JAX's x64 mode.

    Raises `ValueError` for ids out of range or named twice in `moving`, coordinates that are not finite, points outside of
    the hull of the surface (graph mapping), planes that hold no node or have nodes on both sides, and sources that do not
    determine the interpolation.
    """
    host, ids = _checked(points, moving, fixed)
    method = default_method() if method is None else method
    m, nodes = len(ids[0]), np.concatenate(ids)
    surface, images, on_plane = surface_of(host, nodes, m, symmetry)
    surface_ids, volume_ids = jax.tree.map(jnp.asarray, method.connect(surface, host))
    plan = Plan(
        method=method,
        surface=SurfaceHalf(jnp.asarray(surface.points), jnp.asarray(nodes, jnp.int32), images, surface_ids, None),
        volume=VolumeHalf(
            jnp.asarray(host),
            None if on_plane is None else jnp.asarray(on_plane),
            volume_ids,
            None,
        ),
        moves=m,
    )
    if plan.points.dtype != host.dtype:
        warnings.warn(
            "the points are float64 but JAX's x64 mode is off, so the plan is float32: boundary layers and gradients suffer. "
            'Call jax.config.update("jax_enable_x64", True) first.',
            stacklevel=2,
        )
    plan = _with_tables(refit(plan, plan.points))
    method.check(plan.surface.ids, plan.surface.factors, _trial(plan))
    return plan


def surface_of(
    points: Float[np.ndarray, "n d"], nodes: Int[np.ndarray, " b"], moving: int, symmetry: Plane | Sequence[Plane]
) -> tuple[Surface, Mirror | None, Bool[np.ndarray, "n p"] | None]:
    """The surface that a method sees, its mirror, and which points lie on which plane; `nodes` are moving, then fixed."""
    planes = [symmetry] if isinstance(symmetry, Plane) else list(symmetry)
    everything, rows, images, on_plane = points[nodes], np.arange(len(nodes)), None, None
    if planes:
        check_planes(planes, points)
        on_plane = np.stack([plane.holds(points) for plane in planes], axis=1)
        images, moving = mirror(planes, on_plane[nodes], moving)
        everything, rows = np.asarray(images.points(jnp.asarray(everything))), np.asarray(images.rows)
    first = _first(rows)
    return (
        Surface(everything, np.where(np.arange(len(rows)) == first, nodes[rows], -1), moving, first),
        images,
        on_plane,
    )


def _with_tables(plan: Plan) -> Plan:
    """The plan with a table of the transpose for each of its interpolations."""
    placed = with_tables(plan.volume.placed, len(plan.surface.points))
    return eqx.tree_at(lambda plan: plan.volume.placed, plan, placed, is_leaf=lambda leaf: leaf is None)


def _trial(plan: Plan) -> Float[Array, "b d"]:
    """A smooth displacement of the moving nodes that no polynomial gives, of size one, fixed nodes at rest."""
    own, mirror = np.asarray(plan.points)[np.asarray(plan.surface.nodes)], plan.surface.mirror
    moving = own[: plan.moves]
    arms = moving - moving.mean(axis=0)
    u = np.zeros_like(own)
    u[: plan.moves] = np.cos(2 * arms / (np.abs(arms).max() or 1))
    if mirror is None:
        return jnp.asarray(u)
    return mirror.extended(jnp.asarray(u))


def _first(rows: np.ndarray) -> np.ndarray:
    """For each row, the first one with the same value."""
    _, first, inverse = np.unique(rows, return_index=True, return_inverse=True)
    return first[inverse]


def _checked(points, moving, fixed) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    host = np.asarray(points)
    if host.dtype not in (np.float32, np.float64):
        host = host.astype(np.float64)
    if host.ndim != 2 or host.shape[1] not in (2, 3):
        raise ValueError(f"`points` has shape {host.shape}; expected (n, 2) or (n, 3).")
    finite = np.isfinite(host).all(axis=1)
    if not finite.all():
        raise MeshError(
            f"{(~finite).sum()} of {len(host)} points are not finite, first node {{node}}.", np.flatnonzero(~finite)
        )
    moving, fixed = (node_ids(ids, name, len(host)) for ids, name in ((moving, "moving"), (fixed, "fixed")))
    unique, counts = np.unique(moving, return_counts=True)
    if len(unique) < len(moving):
        raise ValueError(
            f"{(counts > 1).sum()} nodes are named more than once in `moving`, first node {unique[counts > 1][0]}."
        )
    if len(moving) == 0:
        raise ValueError("`moving` is empty: name the nodes of the boundary that moves.")
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]
    return host, (moving, fixed[~np.isin(fixed, moving)])


def node_ids(values, name: str, n: int) -> np.ndarray:
    ids = np.asarray(values)
    if ids.size == 0:
        return np.zeros(0, dtype=np.int64)
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        hint = f"; for a mask use np.flatnonzero({name})" if ids.dtype == bool else ""
        raise ValueError(f"`{name}` must be a list of node ids, not {ids.dtype} of shape {ids.shape}{hint}.")
    wrong = (ids < 0) | (ids >= n)
    if wrong.any():
        raise ValueError(
            f"{wrong.sum()} ids in `{name}` are not nodes of the mesh (0 to {n - 1}), first {ids[wrong][0]}."
        )
    return ids.astype(np.int64)
