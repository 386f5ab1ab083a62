"""The driver: a plan moves a mesh in traced code."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree, Real

from .._boundary.closest import Track
from .._boundary.images import Images
from .._boundary.periodic import Pairing
from .._host.package.arguments import checked
from .._kernels.compile import compiled
from .._kernels.module import Module
from .._kernels.values import is_known
from .._methods import placing
from .._methods.base import AbstractField, AbstractMethod, Located
from .._methods.blocks import (
    carry_points,
    is_rows,
    map_points,
    place_points,
    with_tables,
    with_tables_of,
    without_tables,
)
from .._methods.reconstruction import SurfaceReconstruction
from .devices import Layout, over_points, pad_rows, rows_from, rows_here
from .slabs import joined, slabs
from .transposes import transposable


class SurfacePart(eqx.Module):
    """Holds what every device has whole: the surface and the solve.

    Its o own rows are the moving, fixed and guided nodes; b rows have images too. In a
    plan of a piece of a mesh `nodes` holds numbers from n on for nodes that the piece does not have.
    """

    points: Float[Array, "b d"]
    nodes: Int[Array, " o"]
    images: Images | None
    ids: PyTree
    factors: PyTree
    guide: "Guide | None" = None


class Guide(Module):
    """Moves nodes along boundaries: a field of the moving and fixed nodes alone moves them, and they are kept where they belong.

    Guided nodes slide or repeat. Nobody gives their displacement, yet the field of the mesh needs it: they are rows of its surface.
    So another field comes first. Its data are the moving and fixed nodes, and its points are the surface's own rows.
    It needs sources, images, factors, and all of these anew in each step of a march: everything that a plan is.
    So it is a plan, whose mesh is the surface of the outer one, and which has no guide itself.
    What it gives is put back on walls and made alike on both sides of periodic pairs; then the outer plan takes it as data.

    - `plan`: moves the surface's own rows, which are its points.
    - `pairings`: pairs of own rows.
    - `tracks`: own rows that stay on walls.
    - `rows`: own rows that are kept, also by a method that is not exact.
    """

    plan: "Plan"
    pairings: tuple[Pairing, ...]
    tracks: tuple[Track, ...]
    rows: Int[Array, " r"]

    def __call__(self, vectors: Float[Array, "o d"]) -> Float[Array, "o d"]:
        """Computes the displacements of all own rows from the displacements of listed rows.

        The listed rows are the moving and the fixed rows.
        """
        plan, known = self.plan, len(self.plan.surface.nodes)
        displacement = vectors[:known] if plan.images is None else plan.images.kept(vectors[:known])
        u = self._on_walls(jnp.concatenate([displacement, jnp.zeros_like(vectors[known:])]))
        moved = deform_surface(plan, u[:known]) - plan.points
        u = self._alike(jnp.concatenate([u[:known], moved[known:]]))
        return self._alike(self._on_walls(u)) if self.tracks else u

    def placed(self, vectors: Float[Array, "o d"]) -> Float[Array, "o d"]:
        """Moves all own rows; pairs that match bit for bit after a translation go on to."""
        base = self.plan.points
        points = base + vectors
        for pairing in self.pairings:
            points = pairing.matched(base, points)
        return points

    def _on_walls(self, u):
        for track in self.tracks:
            u = track.along(self.plan.points, u)
        return u

    def _alike(self, u):
        for pairing in self.pairings:
            u = pairing.alike(u)
        return u


class VolumePart(eqx.Module):
    """Per-point arrays, split over devices.

    Every leaf has one row per mesh point, except tables of transposes.
    """

    points: Float[Array, "n d"]
    on_plane: Bool[Array, "n p"] | None
    ids: PyTree
    placed: PyTree


class Plan(Module):
    """Holds everything that `deform` needs to know about a mesh: an immutable pytree of arrays.

    `prepare` makes it, and says what may move. It survives `jax.tree` round trips, pickling and
    `equinox.tree_serialise_leaves`, and may be passed through `jit`, `vmap` and `grad` like any array.

    Use `points`, `moving`, `fixed`, `guided`, `sources`, `n_moving`, `method`, `is_linear`, `is_piece` and `offset`. The fields
    `surface` and `volume` belong to the driver, and so do `carried` (by a step of `march`) and `layout` (over devices).
    In a plan of a piece (`SurfaceHalf.attach`) node ids of len(points) and more stand for nodes that other pieces have.
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
        """Base coordinates: the points that a zero displacement gives back."""
        return self.volume.points if self.layout is None else self.volume.points[: self.layout.count]

    @property
    def moving(self) -> Int[Array, " m"]:
        """Node ids of the moving nodes; row i of a displacement moves node `moving[i]`."""
        return self.surface.nodes[: self.n_moving]

    @property
    def fixed(self) -> Int[Array, " f"]:
        """Node ids of the fixed nodes, without nodes that also move."""
        return self.surface.nodes[self.n_moving : len(self.surface.nodes) - self.n_guided]

    @property
    def guided(self) -> Int[Array, " g"]:
        """Node ids of the nodes that follow along a boundary.

        They are on sliding patches, periodic patches or parallel symmetry planes.
        """
        return self.surface.nodes[len(self.surface.nodes) - self.n_guided :]

    @property
    def is_linear(self) -> bool:
        """Checks whether `deform` is linear in `u`.

        The method must be linear, and no nodes may slide along curved walls.
        """
        guide = self.surface.guide
        along = guide is None or (guide.plan.is_linear and all(track.is_linear for track in guide.tracks))
        return self.method.linear and along

    @property
    def surface_nodes(self) -> Int[Array, " o"]:
        """Node ids of the surface: moving, fixed, then guided."""
        return self.surface.nodes

    @property
    def reach(self) -> float:
        """Distance from the surface that the method's field reaches, on the host; infinity where it has no radius."""
        return self.method.control(self.surface.ids).reach

    @property
    def sources(self) -> Int[np.ndarray, " s"]:
        """Node ids of the coarse field's sources, on the host: moving ones first, without images.

        A source is a control point of the field: the centre of one radial basis function.
        """
        rows = np.asarray(self.method.control(self.surface.ids).sources, dtype=np.int64)
        if self.images is not None:
            rows = rows[np.asarray(self.images.kind)[rows] == 0]
            rows = np.asarray(self.images.rows)[rows]
        return np.asarray(self.surface.nodes)[rows]

    @property
    def images(self) -> Images | None:
        """Symmetry planes and periodic pairs, and the images that they make of the surface; None without either."""
        return self.surface.images

    @property
    def surface_points(self) -> Float[Array, "o d"]:
        """Base coordinates of `surface_nodes`, nodes of other pieces included."""
        if not self.is_piece:
            return self.points[self.surface.nodes]
        if self.images is None:
            return self.surface.points
        rows = jnp.zeros((len(self.surface.nodes), self.points.shape[1]), self.points.dtype)
        return rows.at[_rows_of_originals(self.images, len(rows))].set(self.surface.points, mode="drop")

    @property
    def moving_points(self) -> Float[Array, "m d"]:
        """Base coordinates of `moving`; in a piece, nodes of other pieces included."""
        return self.surface_points[: self.n_moving]

    def check_surface(self, call: str) -> None:
        """Raises `ValueError`, on the host, for a piece that lacks nodes of the surface."""
        if self.is_piece and (absent := int((np.asarray(self.surface_nodes) >= len(self.points)).sum())):
            raise ValueError(
                f"this plan is of a piece, and {absent} surface nodes are in others: call {call} with the plan of the "
                "surface, half.plan."
            )

    @checked
    def offset(self, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "o d"]:
        """Computes the displacement left to the correction (eq. 5), of moving, fixed and guided nodes. Traced in `u`."""
        return _offset(self, u)

    @checked
    def of_surface(self, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "o d"]:
        """Computes the surface nodes' displacements from the moving nodes' displacements. Traced."""
        return kept(self, _of_surface(self, u))

    def __repr__(self) -> str:
        """Describes the plan, whatever its leaves are: concrete, stacked or traced arrays, shapes, or None."""
        points, nodes = self.volume.points, self.surface.nodes
        parts = [f"{self.n_moving} moving"]
        if hasattr(points, "shape") and hasattr(nodes, "shape"):
            n, d = points.shape[-2:] if self.layout is None else (self.layout.count, points.shape[-1])
            fixed = nodes.shape[-1] - self.n_moving - self.n_guided
            guided = [f"{self.n_guided} guided"] if self.n_guided else []
            parts = [f"{n} points in {d}-D", *parts, f"{fixed} fixed", *guided, f"{points.dtype}"]
        for located in jax.tree.leaves(self.surface.ids, is_leaf=_is_located):
            counts = (located.repaired, located.outside) if _is_located(located) else ()
            if counts and all(map(eqx.is_array, counts)) and is_known(counts):
                repaired, outside = (int(count.sum()) for count in counts)
                parts.append(f"{repaired} repaired in location, {outside} outside by round-off")
        return f"Plan({', '.join(parts)}, {self.method})"


class Shared(eqx.Module):
    """Holds what all points share in a motion: the field, places or displacements of nodes, and images.

    `are_places` says what is `assigned` to the `nodes`: where they are to be, or by how much they move.
    """

    field: AbstractField
    assigned: Float[Array, "a d"]
    nodes: Int[Array, " a"]
    images: Images | None
    are_places: bool = eqx.field(static=True)


@compiled
def _offset(plan: Plan, u: Any) -> Float[Array, "o d"]:
    vectors, surface = plan.of_surface(u), plan.surface
    if not isinstance(plan.method, SurfaceReconstruction):
        return jnp.zeros_like(vectors)  # nothing is left to a correction
    extended = vectors if surface.images is None else surface.images.vectors(vectors)
    offset = plan.method.offset(surface.ids, surface.factors, surface.points, extended)
    if surface.images is None:
        return offset
    rows = _rows_of_originals(surface.images, len(vectors))
    return jnp.zeros_like(vectors).at[rows].set(offset, mode="drop")


def _rows_of_originals(images: Images, count: int) -> Int[Array, " b"]:
    """Finds the own row of each row of the surface; `count` for images."""
    return jnp.where(images.kind > 0, count, images.rows)


def _is_located(leaf: Any) -> bool:
    return isinstance(leaf, Located)


@compiled
def refitted(plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any]) -> Plan:
    """Computes a plan anew on other base coordinates, with the planes, walls and transforms that it has."""
    return _refitted(plan, points)


def _refitted(plan: Plan, points) -> Plan:
    plan = _fitted(plan, points)

    def place(shared, rows: VolumePart) -> PyTree:
        placed = place_points(plan.method, rows.points, rows.ids, *shared)
        return placed if rows.placed is None else with_tables_of(rows.placed, placed)

    return _placed(plan, place)


def _placed(plan: Plan, place: Callable[[PyTree, VolumePart], PyTree]) -> Plan:
    placed = over_points(plan.layout, place, (plan.surface.factors, plan.surface.points), plan.volume)
    return eqx.tree_at(lambda plan: plan.volume.placed, plan, placed, is_leaf=lambda leaf: leaf is None)


@compiled
def carry(
    plan: Plan, points: Real[ArrayLike, "n d"] | Sequence[Any], surface: Float[Array, "o d"] | None = None
) -> Plan:
    """Moves a plan to the mesh that one of its own steps left; a piece needs all of the moved surface.

    The solve is made anew, and each point keeps its place in the graph. A layer over a wall is laid anew.
    """
    return _carried(plan, points, surface)


def _carried(plan: Plan, points, surface: Float[Array, "o d"] | None = None) -> Plan:
    plan = _fitted(plan, points, carried=True, surface=surface)

    def place(shared, rows: VolumePart) -> PyTree:
        return carry_points(plan.method, (rows.points, rows.ids, rows.placed), *shared)

    return _placed(plan, place)


def _stepped(plan: Plan, points, carried: bool) -> Plan:
    return _carried(plan, points) if carried else _refitted(plan, points)


def _fitted(plan: Plan, points, carried: bool = False, surface: Float[Array, "o d"] | None = None) -> Plan:
    points = base_points(plan, points)
    old, volume, whole = plan.surface, plan.volume, points
    originals = points[old.nodes] if surface is None else surface
    surface = originals if old.images is None else old.images.points(originals)
    if plan.layout is not None:
        points = pad_rows(points, plan.layout)
    method, guide = plan.method, old.guide
    if guide is not None:
        guide = eqx.tree_at(lambda guide: guide.plan, guide, _stepped(guide.plan, originals, carried))
    ids, before = old.ids, old.factors
    factors = placing.carry(method, ids, before, surface, whole) if carried else method.fit(ids, surface, whole)
    return Plan(
        method=method,
        surface=SurfacePart(surface, old.nodes, old.images, old.ids, factors, guide),
        volume=VolumePart(points, volume.on_plane, volume.ids, volume.placed),
        n_moving=plan.n_moving,
        n_guided=plan.n_guided,
        carried=carried,
        is_piece=plan.is_piece,
        layout=plan.layout,
    )


def base_points(plan: Plan, points: Any) -> Float[Array, "n d"]:
    """Returns base coordinates in the precision of a plan. Raises `ValueError` for another shape than the plan's."""
    points = jnp.asarray(points, plan.volume.points.dtype)
    if points.shape != plan.points.shape:
        raise ValueError(f"`points` has shape {points.shape}; this plan was made for {plan.points.shape}.")
    return points


@checked
def deform(plan: Plan, u: Real[ArrayLike, "m d"] | Sequence[Any]) -> Float[Array, "n d"]:
    """Moves the mesh: row i of `u` displaces node `plan.moving[i]`, fixed nodes stay, all others follow.

    Both hold exactly for a method that is `exact`. A reduced `RBF` alone follows both approximately, and moves fixed
    nodes. It is one step, linear in `u` for a method that is `linear`, unless nodes slide along curved walls
    (`plan.is_linear`). Traced: `jit`, `grad`, `jvp`, `vmap` and `scan` apply. Judge the result with `quality`: the driver knows
    nothing of cells.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `u`: displacements (m, d) of the moving nodes, in the mesh's unit.

    **Returns:** all points (n, d), in the mesh's own node order and unit.

    **Raises:** `ValueError` when the shape of `u` is not (m, d).
    """
    parts = slabs(len(plan.volume.points), plan, u) if isinstance(plan, Plan) and plan.layout is None else ()
    if not parts:
        return _deform(transposable(plan, u), u)
    shared, volume = _shared_by(plan, u), without_tables(plan.volume)
    return joined(tuple(_slab(shared, volume, *part) for part in parts), len(volume.points))


@compiled
def _deform(plan: Plan, u: Any) -> Float[Array, "n d"]:
    return deform_surface(plan, _of_surface(plan, u))


@compiled
def _shared_by(plan: Plan, u: Any) -> Shared:
    return shared_of(plan, u)


def shared_of(plan: Plan, u: Any) -> Shared:
    """Computes what all points share in the motion by `u`. Traced."""
    return _shared(plan, _of_surface(plan, u))


@compiled
def _slab(shared: Shared, volume: VolumePart, start: Any, size: int) -> Float[Array, "s d"]:
    rows = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, size), volume)
    return move(shared, rows, rows_from(start, shared.nodes, size))


def _of_surface(plan: Plan, u: Any) -> Float[Array, "o d"]:
    """Checks a displacement of the moving nodes, and extends it by zeros for the fixed ones."""
    if not isinstance(plan, Plan):
        raise ValueError(f"the first argument must be a plan, deform(plan, u), not {type(plan).__name__}.")
    m, d = plan.n_moving, plan.points.shape[1]
    u = u if hasattr(u, "dtype") else np.asarray(u)
    if u.dtype.kind not in "fiuV":  # V: bfloat16 and its kin
        raise ValueError(f"`u` holds {u.dtype}; a displacement is real numbers of shape ({m}, {d}).")
    if u.shape != (m, d):
        raise ValueError(f"`u` has shape {u.shape}; this plan moves {m} points in {d} dimensions.")
    rest = len(plan.surface.nodes) - m
    return jnp.zeros((m + rest, d), plan.points.dtype).at[:m].set(u.astype(plan.points.dtype))


def deform_surface(plan: Plan, vectors: Float[Array, "o d"]) -> Float[Array, "n d"]:
    """Moves the mesh as `deform` does, with displacements for the fixed nodes too.

    Rows of the moving nodes come first, then rows of the fixed nodes.
    """
    moved = over_points(plan.layout, _moved(plan.layout), _shared(plan, vectors), plan.volume)
    return moved if plan.layout is None else moved[: plan.layout.count]


def _shared(plan: Plan, vectors: Float[Array, "o d"]) -> Shared:
    surface, vectors = plan.surface, kept(plan, vectors)
    u = vectors if surface.images is None else surface.images.vectors(vectors)
    field = plan.method.field(surface.ids, surface.factors, surface.points, u)
    nodes, guide = surface.nodes, surface.guide
    assigned = vectors if guide is None else guide.placed(vectors)
    if not plan.method.exact:
        rows = jnp.zeros(0, int) if guide is None else guide.rows
        nodes, assigned = nodes[rows], assigned[rows]
    return Shared(field, assigned, nodes, surface.images, guide is not None)


def moved_surface(plan: Plan, vectors: Float[Array, "o d"]) -> Float[Array, "o d"]:
    """Moves the surface's own rows alone, as `deform_surface` does for a method that is exact."""
    vectors, guide = kept(plan, vectors), plan.surface.guide
    return plan.surface_points + vectors if guide is None else guide.placed(vectors)


def kept(plan: Plan, vectors: Float[Array, "o d"]) -> Float[Array, "o d"]:
    """Changes displacements of the surface's own rows so that they stay on planes, and follow along boundaries."""
    surface = plan.surface
    if surface.guide is not None:
        vectors = surface.guide(vectors)
    return vectors if surface.images is None else surface.images.kept(vectors)


def _moved(layout: Layout | None) -> Callable[[Shared, VolumePart], Float[Array, "n d"]]:
    return lambda shared, volume: move(shared, volume, rows_here(layout, shared.nodes, len(volume.points)))


def move(shared: Shared, volume: VolumePart, at: Int[Array, " a"]) -> Float[Array, "n d"]:
    """Moves the points of some rows; `at` are the rows of the nodes that are assigned, beyond the last one for others."""
    displacement = map_points(shared.field, volume.points, volume.placed)
    if shared.images is not None and volume.on_plane is not None:
        displacement = shared.images.within(displacement, volume.on_plane)
    moved = volume.points + displacement
    if not len(at):
        return moved
    places = shared.assigned if shared.are_places else volume.points[at] + shared.assigned
    return moved.at[at].set(places, mode="drop", unique_indices=True)


@checked
def shard(plan: Plan, devices: Sequence[Any]) -> Plan:
    """Lays the volume's points over devices; `deform` and all else are called as before, with equal results.

    Each device holds the surface whole and an equal share of the points; the last one is padded where n is not a
    multiple. A gradient with respect to `u` costs one all-reduce. The devices may belong to several processes
    (`jax.distributed`), each of which calls this with the same plan.

    **Arguments:**

    - `plan`: what `prepare` returned.
    - `devices`: JAX's devices.

    **Returns:** a `Plan`.

    **Raises:** `ValueError` when there are no devices, or the plan is laid over devices already.
    Also for a method that solves for all nodes at once.
    """
    if plan.layout is not None:
        raise ValueError("this plan is laid over devices already: shard the plan that `prepare` returned.")
    if plan.method.needs_cells:
        raise ValueError(
            f"{type(plan.method).__name__} solves for all nodes at once: its plan is not laid over devices."
        )
    layout = Layout.over(devices, len(plan.volume.points))
    volume = jax.tree.map(lambda leaf: pad_rows(leaf, layout), without_tables(plan.volume))
    placed = with_tables(volume.placed, len(plan.surface.points), layout.mesh.size)
    volume = eqx.tree_at(
        lambda volume: volume.placed,
        volume,
        placed,
        is_leaf=lambda leaf: leaf is None or is_rows(leaf),
    )
    volume = layout.divided(volume)
    return Plan(
        layout.replicated(plan.method),
        layout.replicated(plan.surface),
        volume,
        plan.n_moving,
        plan.n_guided,
        plan.carried,
        plan.is_piece,
        layout,
    )
