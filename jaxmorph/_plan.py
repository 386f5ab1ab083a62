"""The driver: a plan is found once on the host, and moves a mesh in traced code."""

import warnings
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from ._methods import default_method
from ._methods.base import AbstractMethod, Surface, map_points, place_points
from ._symmetry import Mirror, Plane, check_planes, mirror


class SurfaceHalf(eqx.Module):
    """What every device holds whole: the surface (b rows: moving, then fixed, each with its images) and the solve."""

    points: Float[Array, "b d"]
    nodes: Int[Array, " o"]
    mirror: Mirror | None
    ids: PyTree
    factors: PyTree


class VolumeHalf(eqx.Module):
    """What is laid over devices: each leaf has one row per point of the mesh."""

    points: Float[Array, "n d"]
    rows: Int[Array, " n"]
    on_plane: Bool[Array, "n p"] | None
    ids: PyTree
    placed: PyTree


class Plan(eqx.Module):
    """Everything that `deform` needs to know about a mesh: an immutable pytree of arrays.

    Made by `prepare`, which says what may move. It survives `jax.tree` round trips, pickling and
    `equinox.tree_serialise_leaves`, and may be passed through `jit`, `vmap` and `grad` like any array.
    """

    method: AbstractMethod
    surface: SurfaceHalf
    volume: VolumeHalf
    moves: int = eqx.field(static=True)
    carried: bool = eqx.field(static=True, default=False)

    @property
    def points(self) -> Float[Array, "n d"]:
        """The base coordinates: those that a zero displacement gives back."""
        return self.volume.points

    @property
    def moving(self) -> Int[Array, " m"]:
        """Node ids of the moving nodes; row i of a displacement moves node `moving[i]`."""
        return self.surface.nodes[: self.moves]

    @property
    def fixed(self) -> Int[Array, " f"]:
        """Node ids of the fixed nodes, those that also move left out."""
        return self.surface.nodes[self.moves :]

    def __repr__(self) -> str:
        n, d = self.points.shape
        return (
            f"Plan({n} points in {d}-D, {self.moves} moving, {len(self.surface.nodes) - self.moves} fixed, "
            f"{self.points.dtype}, {self.method})"
        )


def prepare(
    points: Float[ArrayLike, "n d"],
    moving: Int[ArrayLike, " m"],
    fixed: Int[ArrayLike, " f"] = (),
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
    the hull of the surface (graph mapping), and sources that do not determine the interpolation.
    """
    host, ids = _checked(points, moving, fixed)
    dtype = points.dtype if hasattr(points, "dtype") and np.issubdtype(points.dtype, np.floating) else host.dtype
    method = default_method() if method is None else method
    planes = [symmetry] if isinstance(symmetry, Plane) else list(symmetry)
    m, nodes = len(ids[0]), np.concatenate(ids)
    own, images, moves, on_plane = host[nodes], None, m, None
    everything, rows = own, np.arange(len(nodes))
    if planes:
        check_planes(planes, host.shape[1])
        on_plane = np.stack([plane.holds(host) for plane in planes], axis=1)
        images, moves = mirror(planes, on_plane[nodes], m)
        everything, rows = np.asarray(images.points(own)), images.rows
    row_of_node = np.where(np.arange(len(rows)) == _first(rows), nodes[rows], -1)
    surface = Surface(everything, row_of_node, moves, _first(rows))
    surface_ids, volume_ids = method.connect(surface, host)
    own_rows = np.full(len(host), len(nodes), dtype=np.int32)
    own_rows[nodes] = np.arange(len(nodes))
    plan = Plan(
        method=method,
        surface=SurfaceHalf(everything, nodes.astype(np.int32), images, surface_ids, None),
        volume=VolumeHalf(host, own_rows, on_plane, volume_ids, None),
        moves=m,
    )
    plan = jax.tree.map(jnp.asarray, plan)
    if plan.points.dtype != dtype and dtype == np.float64:
        warnings.warn(
            "the points are float64 but JAX's x64 mode is off, so the plan is float32: boundary layers and gradients suffer. "
            'Call jax.config.update("jax_enable_x64", True) first.',
            stacklevel=2,
        )
    plan = refit(plan, plan.points)
    method.check(plan.surface.factors)
    return plan


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
        raise ValueError(f"{(~finite).sum()} of {len(host)} points are not finite, first node {np.argmin(finite)}.")
    moving, fixed = (_node_ids(ids, name, len(host)) for ids, name in ((moving, "moving"), (fixed, "fixed")))
    unique, counts = np.unique(moving, return_counts=True)
    if len(unique) < len(moving):
        raise ValueError(
            f"{(counts > 1).sum()} nodes are named more than once in `moving`, first node {unique[counts > 1][0]}."
        )
    if len(moving) == 0:
        raise ValueError("`moving` is empty: name the nodes of the boundary that moves.")
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]
    return host, (moving, fixed[~np.isin(fixed, moving)])


def _node_ids(values, name: str, n: int) -> np.ndarray:
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


@eqx.filter_jit
def refit(plan: Plan, points: Float[ArrayLike, "n d"]) -> Plan:
    """The same plan on other base coordinates (n, d): ids are kept, floats computed anew. Traced and differentiable.

    For another mesh of the same family; the steps of one motion are those of `march`, for points that a large motion has
    carried out of their simplices extrapolate.

    Raises `ValueError` when the shape of `points` differs from the plan's.
    """
    plan = _fitted(plan, points)
    placed = place_points(plan.method, plan.points, plan.volume.ids, plan.surface.factors, plan.surface.points)
    return eqx.tree_at(lambda plan: plan.volume.placed, plan, placed, is_leaf=lambda leaf: leaf is None)


@eqx.filter_jit
def carry(plan: Plan, points: Float[ArrayLike, "n d"]) -> Plan:
    """The plan on the mesh that one of its own steps left: the solve is made anew, each point keeps its place in the graph."""
    return _fitted(plan, points, carried=True)


def _fitted(plan: Plan, points, carried: bool = False) -> Plan:
    points = jnp.asarray(points, plan.points.dtype)
    if points.shape != plan.points.shape:
        raise ValueError(f"`points` has shape {points.shape}; this plan was made for {plan.points.shape}.")
    old, volume = plan.surface, plan.volume
    surface = points[old.nodes]
    if old.mirror is not None:
        surface = old.mirror.points(surface)
    return Plan(
        method=plan.method,
        surface=SurfaceHalf(surface, old.nodes, old.mirror, old.ids, plan.method.fit(old.ids, surface)),
        volume=VolumeHalf(points, volume.rows, volume.on_plane, volume.ids, volume.placed),
        moves=plan.moves,
        carried=carried,
    )


@eqx.filter_jit
def deform(plan: Plan, u: Float[ArrayLike, "m d"]) -> Float[Array, "n d"]:
    """The mesh's points, moved: row i of `u` (m, d) displaces node `plan.moving[i]`, fixed nodes stay.

    One step, linear in `u`, in the mesh's own node order and units. Traced: `jit`, `grad`, `jvp`, `vmap` and `scan` apply.
    Judge the result with `quality`: nothing here knows about cells.

    Raises `ValueError` when the shape of `u` is not (m, d).
    """
    m, d = plan.moves, plan.points.shape[1]
    u = jnp.asarray(u)
    if u.shape != (m, d):
        raise ValueError(f"`u` has shape {u.shape}; this plan moves {m} points in {d} dimensions.")
    own = jnp.zeros((len(plan.surface.nodes), d), plan.points.dtype).at[:m].set(u.astype(plan.points.dtype))
    return deform_surface(plan, own)


def deform_surface(plan: Plan, own: Float[Array, "o d"]) -> Float[Array, "n d"]:
    """`deform` with a displacement for the fixed nodes too, whose rows follow those of the moving ones."""
    volume, surface = plan.volume, plan.surface
    if surface.mirror is None:
        u = own
    else:
        own = surface.mirror.within(own, volume.on_plane[surface.nodes])
        u = surface.mirror.vectors(own)
    field = plan.method.field(surface.ids, surface.factors, surface.points, u)
    displacement = map_points(field, volume.points, volume.placed)
    if plan.method.exact:
        displacement = jnp.where(
            (volume.rows < len(own))[:, None], own[volume.rows.clip(max=len(own) - 1)], displacement
        )
    if surface.mirror is not None:
        displacement = surface.mirror.within(displacement, volume.on_plane)
    return volume.points + displacement


@eqx.filter_jit
def pullback(plan: Plan, u: Float[ArrayLike, "m d"], cotangent: Float[ArrayLike, "n d"]) -> Float[Array, "m d"]:
    """Sensitivities with respect to all points (n, d), pulled back to the moving ones: (m, d).

    The transpose of `deform`, for an adjoint solver that gives dJ/d(points); often called warpDeriv. `deform` is linear in `u`,
    which says only where the derivative is taken and does not change it.

    Raises `ValueError` when the shape of `u` is not (m, d) or that of `cotangent` not (n, d).
    """
    cotangent = jnp.asarray(cotangent, plan.points.dtype)
    if cotangent.shape != plan.points.shape:
        raise ValueError(f"`cotangent` has shape {cotangent.shape}; this plan's points have {plan.points.shape}.")
    _, transpose = jax.vjp(lambda u: deform(plan, u), jnp.asarray(u, plan.points.dtype))
    return transpose(cotangent)[0]
