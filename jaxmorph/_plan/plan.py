"""The plan: everything about a mesh before it moves, and its motion by fields, traced."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree, Real

from .._boundary.conditions import Conditions, renumbered
from .._boundary.images import Images
from .._boundary.periodic import Pairing
from .._boundary.tracks import Track
from .._host.package.arguments import checked
from .._kernels.compile import compiled
from .._kernels.module import Module
from .._kernels.values import array, taken
from .._mesh.mesh import Mesh
from .._methods.base import AbstractField, AbstractMethod, Point, Rows
from .._methods.blocks import map_points
from .._methods.reconstruction import SurfaceReconstruction
from .devices import AXIS, Layout, over_points, rows_from

Own = Float[Array, "o d"]  # coordinates or displacements of the moving, fixed and guided nodes


class SurfacePart(eqx.Module):
    """The surface and the solve, which every device holds whole. The o own rows are the moving,
    fixed and guided nodes. The b rows are own rows and their images. In a plan of a piece, `nodes`
    has numbers from n on for nodes that the piece lacks.
    """

    points: Rows
    nodes: Int[Array, " o"]
    images: Images
    ids: PyTree
    factors: PyTree
    guide: "Guide | None" = None

    @property
    def tracks(self) -> tuple[Track, ...]:
        return () if self.guide is None else self.guide.tracks

    @property
    def pairings(self) -> tuple[Pairing, ...]:
        return () if self.guide is None else self.guide.pairings


class Guide(Module):
    """Moves the guided nodes along their boundaries, before the mesh moves.

    Guided nodes slide or repeat. No caller gives their displacement, but the field of the mesh
    needs it. So a first field, of the moving and fixed nodes alone, moves the nodes of the surface.
    It needs sources, images and factors, anew in every step of a march. So it is a plan too, of the
    outer plan's surface, without a guide. Its result is put back on walls, and made equal in
    periodic pairs. The outer plan takes it as data.
    """

    plan: "Plan"  # moves the surface's own rows, which are its points
    pairings: tuple[Pairing, ...]  # pairs of own rows
    tracks: tuple[Track, ...]  # own rows that stay on walls
    rows: Int[Array, " r"]  # own rows with an assigned place, also for a method that is not exact

    def __call__(self, vectors: Own) -> Own:
        plan = self.plan
        known = len(self.plan.surface.nodes)
        displacement = plan.images.kept(vectors[:known])
        u = self._on_walls(jnp.concatenate([displacement, jnp.zeros_like(vectors[known:])]))
        moved = deform_surface(plan, u[:known]) - plan.points
        u = self._alike(jnp.concatenate([u[:known], moved[known:]]))
        return self._alike(self._on_walls(u)) if self.tracks else u

    def _on_walls(self, u):
        for track in self.tracks:
            u = track.along(self.plan.points, u)
        return u

    def _alike(self, u):
        for pairing in self.pairings:
            u = pairing.alike(u)
        return u


class VolumePart(eqx.Module):
    """Per-point arrays, split over devices. Every leaf has one row per mesh point, except tables of
    transposes. `rests` marks nodes of no cell.
    """

    points: Float[Array, "n d"]
    on_plane: Bool[Array, "n p"]
    ids: PyTree
    placed: PyTree
    rests: Bool[Array, " n"] | None = None

    def seen(self, at: Point) -> Float[Array, "n d"]:
        """The points as a method sees them: nodes of no cell are `at` one place."""
        return (
            self.points
            if self.rests is None
            else jnp.where(self.rests[:, None], at[None], self.points)
        )


class Plan(Module):
    """Everything that `deform` needs to know about a mesh: an immutable pytree of arrays.

    `prepare` makes it. It survives `jax.tree` round trips, pickling and
    `equinox.tree_serialise_leaves`, and passes through `jit`, `vmap` and `grad` like any array. The
    fields `surface`, `volume`, `carried` (by a step of `march`) and `layout` (over devices) belong
    to the driver. In a plan of a piece (`SurfaceHalf.attach`), node ids from len(points) on stand
    for nodes of other pieces.
    """

    method: AbstractMethod
    surface: SurfacePart
    volume: VolumePart
    n_moving: int = eqx.field(static=True)
    n_guided: int = eqx.field(static=True, default=0)
    carried: bool = eqx.field(static=True, default=False)
    is_piece: bool = eqx.field(static=True, default=False)
    layout: Layout | None = eqx.field(static=True, default=None)

    @property
    def points(self) -> Float[Array, "n d"]:
        """Base coordinates: where a zero displacement leaves the points."""
        return (
            self.volume.points if self.layout is None else self.volume.points[: self.layout.count]
        )

    @property
    def moving(self) -> Int[Array, " m"]:
        """Node ids of the moving nodes; row i of a displacement moves node `moving[i]`."""
        return taken(self.surface.nodes, slice(self.n_moving))

    @property
    def fixed(self) -> Int[Array, " f"]:
        """Node ids of the fixed nodes."""
        return taken(
            self.surface.nodes, slice(self.n_moving, len(self.surface.nodes) - self.n_guided)
        )

    @property
    def guided(self) -> Int[Array, " g"]:
        """Ids of nodes that follow along sliding or periodic patches, or parallel planes."""
        return self.surface.nodes[len(self.surface.nodes) - self.n_guided :]

    @property
    def boundary(self) -> Conditions:
        """What moves, stays, slides and repeats, on the host; a plan keeps no faces."""
        pairings, tracks = jax.tree.map(np.asarray, (self.surface.pairings, self.surface.tracks))
        pairings, tracks = renumbered(pairings, tracks, np.asarray(self.surface.nodes))
        points = np.asarray(self.points)
        rests = self.volume.rests
        return Conditions(
            points=points,
            moving=np.asarray(self.moving),
            fixed=np.asarray(self.fixed),
            guided=np.asarray(self.guided),
            planes=self.images.planes,
            on=np.asarray(self.volume.on_plane)[: len(points)],
            pairings=pairings,
            tracks=tracks,
            loose=np.flatnonzero(np.zeros(0, bool) if rests is None else rests),
        )

    @property
    def is_linear(self) -> bool:
        """True where `deform` is linear in `u`: a linear method, and no curved sliding walls."""
        return self.method.linear and all(track.is_linear for track in self.surface.tracks)

    @property
    def surface_nodes(self) -> Int[Array, " o"]:
        """Node ids of the surface: moving, fixed, then guided."""
        return self.surface.nodes

    @property
    def reach(self) -> float:
        """Reach of the method's field from the surface, on the host; infinity without a radius."""
        return self.method.control(self.surface.ids).reach

    @property
    def sources(self) -> Int[np.ndarray, " s"]:
        """Node ids of the coarse field's sources, on the host: moving ones first, without images. A
        source is a control point of the field: the centre of one radial basis function.
        """
        rows = np.asarray(self.method.control(self.surface.ids).sources, dtype=np.int64)
        rows = rows[np.asarray(self.images.kind)[rows] == 0]
        return np.asarray(self.surface.nodes)[np.asarray(self.images.rows)[rows]]

    @property
    def images(self) -> Images:
        return self.surface.images

    @property
    def surface_points(self) -> Float[Array, "o d"]:
        """Base coordinates of `surface_nodes`, also of nodes that other pieces have."""
        if not self.is_piece and self.layout is None:
            return taken(self.points, self.surface.nodes)
        rows = jnp.zeros((len(self.surface.nodes), self.points.shape[1]), self.points.dtype)
        return rows.at[_rows_of_originals(self.images, len(rows))].set(
            self.surface.points, mode="drop"
        )

    @property
    def moving_points(self) -> Float[Array, "m d"]:
        """Base coordinates of `moving`, also of nodes that other pieces have."""
        return taken(self.surface_points, slice(self.n_moving))

    def places_of(self, vectors: Own) -> Own:
        """Moves the surface's own rows; periodic pairs that match bit for bit still do."""
        base = self.surface_points
        places = base + vectors
        for pairing in self.surface.pairings:
            places = pairing.matched(base, places)
        return places

    def check_surface(self, call: str) -> None:
        if self.is_piece and (
            absent := int((np.asarray(self.surface_nodes) >= len(self.points)).sum())
        ):
            raise ValueError(
                f"this plan is of a piece, and {absent} surface nodes are in other pieces: call "
                f"{call} with the plan of "
                "the surface, half.plan."
            )

    def check_mesh(self, mesh: Mesh) -> None:
        if tuple(mesh.points.shape) != tuple(self.points.shape):
            raise ValueError(
                f"`mesh` has points {tuple(mesh.points.shape)}; this plan was made for "
                f"{tuple(self.points.shape)}."
            )

    @checked
    def offset(self, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "o d"]:
        """Computes the offset for the correction (eq. 5), at all surface nodes. Traced in `u`."""
        return _offset(self, u)

    @checked
    def of_surface(self, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "o d"]:
        """Extends `u`, of the moving nodes, to displacements of all surface nodes. Traced."""
        vectors = extended(self, u)
        is_plain = self.surface.guide is None and self.images.is_plain
        return vectors if is_plain else _constrain(self, vectors)

    def __repr__(self) -> str:
        points = self.volume.points
        nodes = self.surface.nodes
        parts = [f"{self.n_moving} moving"]
        if hasattr(points, "shape") and hasattr(nodes, "shape"):
            n, d = (
                points.shape[-2:] if self.layout is None else (self.layout.count, points.shape[-1])
            )
            fixed = nodes.shape[-1] - self.n_moving - self.n_guided
            guided = [f"{self.n_guided} guided"] if self.n_guided else []
            parts = [f"{n} points in {d}-D", *parts, f"{fixed} fixed", *guided, f"{points.dtype}"]
        return f"Plan({', '.join(parts)}, {self.method})"


@compiled
def _offset(plan: Plan, u: Any) -> Own:
    vectors = plan.of_surface(u)
    surface = plan.surface
    if not isinstance(plan.method, SurfaceReconstruction):
        return jnp.zeros_like(vectors)  # nothing is left to a correction
    offset = plan.method.offset(
        surface.ids, surface.factors, surface.points, surface.images.vectors(vectors)
    )
    rows = _rows_of_originals(surface.images, len(vectors))
    return jnp.zeros_like(vectors).at[rows].set(offset, mode="drop")


def _rows_of_originals(images: Images, count: int) -> Int[Array, " b"]:
    return jnp.where(images.kind > 0, count, images.rows)


def extended(plan: Plan, u: Any) -> Own:
    """Checks a displacement of the moving nodes, and adds zeros for other surface nodes."""
    if not isinstance(plan, Plan):
        raise ValueError(
            f"the first argument must be a plan, deform(plan, u), not {type(plan).__name__}."
        )
    m = plan.n_moving
    d = plan.points.shape[1]
    u = u if hasattr(u, "dtype") else np.asarray(u)
    if u.dtype.kind not in "fiuV":  # V: bfloat16 and similar types
        raise ValueError(
            f"`u` holds {u.dtype}; a displacement is real numbers of shape ({m}, {d})."
        )
    if u.shape != (m, d):
        several = " For several displacements, jax.vmap." if u.shape[1:] == (m, d) else ""
        raise ValueError(
            f"`u` has shape {u.shape}; this plan moves {m} points in {d} dimensions.{several}"
        )
    dtype = plan.points.dtype
    count = len(plan.surface.nodes) - m
    if isinstance(u, np.ndarray):
        return array(np.pad(u.astype(dtype), ((0, count), (0, 0))))
    return jnp.zeros((m + count, d), dtype).at[:m].set(u.astype(dtype))


class Shared(eqx.Module):
    """What the motions of all points have in common: the field, and `places` of nodes that do not
    follow it.
    """

    field: AbstractField
    places: Float[Array, "a d"]
    nodes: Int[Array, " a"]
    images: Images

    def split(self) -> tuple["Shared", "Shared"]:
        """Splits off the leaves that depend on `u` from all others; `eqx.combine` joins them."""
        varies = eqx.tree_at(
            lambda shared: jax.tree.leaves((shared.field.varying, shared.places)),
            jax.tree.map(lambda _: False, self),
            replace_fn=lambda _: eqx.is_inexact_array,
        )
        return eqx.partition(self, varies)


def deform_surface(plan: Plan, vectors: Own) -> Float[Array, "n d"]:
    """Moves the mesh as `deform` does, by displacements of moving, then fixed nodes."""
    layout = plan.layout

    def moved_here(shared: Shared, volume: VolumePart) -> Float[Array, "n d"]:
        count = len(volume.points)
        nodes = shared.nodes
        here = (
            nodes if layout is None else rows_from(jax.lax.axis_index(AXIS) * count, nodes, count)
        )
        return move(shared, volume, here)

    moved = over_points(layout, moved_here, shared_by(plan, vectors), plan.volume)
    return moved if layout is None else moved[: layout.count]


def shared_by(plan: Plan, vectors: Own) -> Shared:
    surface = plan.surface
    vectors = constrain(plan, vectors)
    field = plan.method.field(
        surface.ids, surface.factors, surface.points, surface.images.vectors(vectors)
    )
    nodes = surface.nodes
    places = plan.places_of(vectors)
    if not plan.method.exact:
        rows = jnp.zeros(0, int) if surface.guide is None else surface.guide.rows
        nodes = nodes[rows]
        places = places[rows]
    return Shared(field, places, nodes, surface.images)


def move(shared: Shared, volume: VolumePart, at: Int[Array, " a"]) -> Float[Array, "n d"]:
    """Moves points of some rows; `at` are rows of assigned nodes, beyond the last if absent."""
    displacement = shared.images.within(
        map_points(shared.field, volume.points, volume.placed), volume.on_plane
    )
    if volume.rests is not None:
        displacement = jnp.where(volume.rests[:, None], 0, displacement)
    moved = volume.points + displacement
    return moved.at[at].set(shared.places, mode="drop", unique_indices=True) if len(at) else moved


def constrain(plan: Plan, vectors: Own) -> Own:
    """Makes displacements of the surface's own rows keep to planes, walls and periodic pairs."""
    guide = plan.surface.guide
    return plan.images.kept(vectors if guide is None else guide(vectors))


_constrain = compiled(constrain)
