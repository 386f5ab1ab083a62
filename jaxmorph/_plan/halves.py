"""The two halves of `prepare`, for a mesh in pieces: the surface once, then piece by piece."""

import dataclasses
import functools
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Integer, PyTree, Real

from .._boundary.boundary import Boundary
from .._boundary.conditions import Conditions
from .._boundary.names import checked_points
from .._boundary.surface import surface_of
from .._boundary.symmetry import Mirrors
from .._host.package.arguments import as_array, checked, rows_of, whole
from .._host.package.errors import MeshError
from .._host.package.rounding import extent_of, roundoff
from .._host.rows import Rows
from .._host.surface.skin import has_free_sides
from .._kernels.compile import compiled
from .._kernels.values import as_jax, jax_arrays
from .._mesh.mesh import Mesh
from .._mesh.topology import OuterFaces
from .._methods.base import AbstractMethod, check_kind
from .._methods.blocks import place_points
from .._methods.reconstruction import sees_free_sides
from .._methods.surface import ByKind, Surface
from .plan import Plan, SurfacePart, VolumePart
from .prepare import default_for, plan_of, refuse_cells

# largest difference of a surface node's place in piece and half, as a share of the extent
SAME_POINT = 1e-12


@dataclasses.dataclass(frozen=True)
class SurfaceHalf:
    """The part of a plan that all pieces of a mesh share: the surface, its sources and the solve.

    `prepare_surface` makes it. `jm.save`, `jm.load` and pickle keep its bits. Two pieces, also of
    two processes, move a common point alike, to round-off. Common points of the surface are equal
    bit for bit.

    - `plan`: the plan of the surface's nodes alone, for `inspect`, `plan.offset` and
      `plan.sources`.
    - `nodes` (k,): ids of the plan's points in the whole mesh.
    - `faces`: boundary faces between rows of `plan.surface_nodes` by type, or None if unknown.
    - `is_open`: whether some side of the mesh is free.
    """

    plan: Plan
    nodes: Int[np.ndarray, " k"]
    faces: ByKind | None
    is_open: bool

    def __getstate__(self) -> dict[str, Any]:
        """Returns the fields, without the cache of `attach`."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def __repr__(self) -> str:
        return f"SurfaceHalf({self.plan})"

    @property
    def moving(self) -> Int[np.ndarray, " m"]:
        """Ids of the moving nodes in the whole mesh: row i of `u` moves node `moving[i]`."""
        return self.nodes[np.asarray(self.plan.moving)]

    @property
    def surface_nodes(self) -> Int[np.ndarray, " o"]:
        """Ids of the surface's nodes in the whole mesh: moving, fixed, then guided."""
        return self.nodes[np.asarray(self.plan.surface_nodes)]

    @checked
    def rows(self, nodes: Integer[ArrayLike, " k"] | Sequence[int]) -> Int[np.ndarray, " k"]:
        """Finds the row of `u` (k,) that moves each of these nodes, ids in the whole mesh.

        **Raises:** `ValueError` for a node that does not move.
        """
        ids = rows_of("nodes", nodes, 2**62)
        rows = Rows(self.moving).of(ids)
        if (rows < 0).any():
            raise ValueError(
                f"{(rows < 0).sum()} of {len(ids)} nodes do not move, first {ids[rows < 0][0]}."
            )
        return rows

    @checked
    def attach(
        self,
        points: Real[np.ndarray, "n d"] | Sequence[Any],
        nodes: Integer[np.ndarray, " n"] | Sequence[int],
    ) -> Plan:
        """Prepares the plan of one piece of the mesh.

        `deform` of the plan takes displacements of all moving nodes, and returns the points of the
        piece. `pullback` returns the piece's contribution to all moving nodes: their sum is the
        pullback of the whole mesh, if no two pieces share a node.

        **Arguments:**

        - `points`: base coordinates (n, d) of the piece, in the unit of the surface.
        - `nodes`: id (n,) of every point in the whole mesh. Ids that are not in `surface_nodes`, -1
          for example, are inner nodes.

        **Returns:** a `Plan` of n points, for `march` and `replay`, but not for `refit`.

        **Raises:** `ValueError` for a surface node that is named twice, or lies elsewhere than in
        the half. Also for points outside of the hull, and for points that are not finite.
        """
        plan = self.plan
        given = checked_points(points)
        if given.shape[1] != plan.points.shape[1]:
            raise ValueError(
                f"`points` has shape {given.shape}; the surface has {plan.points.shape[1]} "
                "dimensions."
            )
        if not len(given):
            raise ValueError("the piece has no points.")
        place = self._places(nodes, given)
        self._check_sides(given, place)
        return self._attach(given.astype(plan.points.dtype), place)

    def _attach(self, points: np.ndarray, place: np.ndarray) -> Plan:
        # A method connects to one list of points: the n points of the piece, then the half's points
        # that the piece lacks. So tolerances come from the whole mesh. Then the rows from n on are
        # cut off; their numbers stay in the plan, for surface nodes that other pieces have.
        plan = self.plan
        count = len(points)
        is_here = place >= 0
        base = np.asarray(plan.points)
        points[place[is_here]] = base[is_here]
        rows = np.where(is_here, place, count + np.cumsum(~is_here) - 1)
        together = np.concatenate([points, base[~is_here]])
        nodes = self._surface.nodes
        surface = self._surface.altered(nodes=np.where(nodes < 0, -1, rows[nodes]))
        ids = plan.method.connect(surface, together)[1]
        on_plane = Mirrors.of(plan.images.planes, together).on
        ids, on_plane = as_jax(jax.tree.map(lambda leaf: leaf[:count], (ids, on_plane)))
        own_nodes = jax_arrays(nodes=rows[np.asarray(plan.surface.nodes)])
        own = dataclasses.replace(plan.surface, **own_nodes)
        x = as_jax(points)
        placed = _place_piece(plan.method, own, x, ids)
        volume = VolumePart(points=x, on_plane=on_plane, ids=ids, placed=placed)
        return dataclasses.replace(plan, surface=own, volume=volume, is_piece=True)

    def _check_sides(self, points: np.ndarray, place: np.ndarray) -> None:
        """Refuses points on a free side, if the surface was prepared without."""
        if self.faces is not None or self.is_open or not sees_free_sides(self.plan.method):
            return
        is_inner = np.ones(len(points), dtype=bool)
        is_inner[place[place >= 0]] = False
        if has_free_sides(self._surface.points, is_inner, points):
            raise ValueError(
                "this piece has nodes on a flat side of the mesh that is neither moving, fixed "
                "nor a symmetry plane. Name the "
                "side, or pass is_open=True to prepare_surface, which changes the field."
            )

    @functools.cached_property
    def _surface(self) -> Surface:
        """The surface as methods see it."""
        boundary = self.plan.boundary
        faces = self.faces
        if faces is not None:
            faces = {kind: boundary.nodes[rows] for kind, rows in faces.items()}
        images = self.plan.images  # their order is that of the places in double precision
        order = np.asarray(images.rows)[np.asarray(images.kind) == 0]
        return surface_of(boundary.altered(faces=faces, is_open=self.is_open), (), order)[0]

    def _places(self, nodes: Any, points: np.ndarray) -> np.ndarray:
        """Finds the row (k,) in `points` of each node of the half; -1 for an absent node."""
        ids = as_array("nodes", nodes)
        if ids.shape != (len(points),) or ids.dtype.kind not in "iu":
            raise ValueError(
                f"`nodes` holds {ids.dtype} of shape {ids.shape}; expected an id for each of "
                f"{len(points)} points."
            )
        rows = np.where(ids < 0, -1, Rows(self.nodes).of(ids))
        present = np.flatnonzero(rows >= 0)
        rows = rows[present]
        twice = np.flatnonzero(np.bincount(rows, minlength=len(self.nodes)) > 1)
        if twice.size:
            raise ValueError(
                f"{twice.size} nodes are named more than once in `nodes`, first "
                f"{self.nodes[twice[0]]}."
            )
        base = np.asarray(self.plan.points)
        distance = np.abs(points[present] - base[rows]).max(axis=1, initial=0.0)
        wrong = np.flatnonzero(distance > max(4 * roundoff(base), SAME_POINT * extent_of(base)))
        if wrong.size:
            worst = wrong[distance[wrong].argmax()]
            raise MeshError(
                f"{wrong.size} surface nodes lie elsewhere than in the half: id "
                f"{ids[present[worst]]}, point {{node}}, by "
                f"{distance[worst]:.3g}. Attach the mesh on which the surface was prepared.",
                present[wrong],
            )
        place = np.full(len(self.nodes), -1, dtype=np.int64)
        place[rows] = present
        return place


def _check_kinds(boundary: Any, method: Any) -> None:
    check_kind(boundary, Boundary, "boundary", 'jm.Boundary(mesh, "wall", "far")')
    check_kind(method, AbstractMethod, "method", "jm.RBF()", optional=True)


def prepare_surface(
    boundary: Boundary,
    *,
    nodes: Integer[np.ndarray, " n"] | Sequence[int] | None = None,
    method: AbstractMethod | None = None,
    is_open: bool | None = None,
    faces: Mapping[str, Integer[np.ndarray, "_k _c"]] | None = None,
) -> SurfaceHalf:
    """Prepares the surface of a mesh too large for one `prepare`, or in several processes.

    `prepare_surface(boundary).attach(mesh.points, range(n))` equals `prepare(boundary)`. If no
    process has the whole mesh, gather the moving and fixed nodes of all pieces, and pass them.

    **Arguments:**

    - `boundary`: the boundary. Its points have all surface nodes, all nodes of parallel symmetry
      planes, and better the outermost nodes: they set tolerances and show free sides.
    - `nodes`: ids (n,) of the boundary's points in the whole mesh, by which pieces name them; -1
      for points that no piece names. Default: 0 to n - 1.
    - `method`: `SurfaceReconstruction()` by default.
    - `is_open`: whether the whole mesh has a side that is neither moving, fixed nor a symmetry
      plane. Default None: decided by `faces`, or by the points, which must then be all.
    - `faces`: boundary faces (k, corners) of the whole mesh by type, as rows of the points, seen
      from outside; in 2-D `line`s. Default None: those of the mesh's cells, if it has cells.

    **Returns:** a `SurfaceHalf`.

    **Raises:** `ValueError` as `prepare` does, for ids that come twice in `nodes`, and for a method
    that solves on cells.
    """
    _check_kinds(boundary, method)
    count = len(boundary.points)
    whole = boundary
    if faces is not None:
        cells = Mesh(boundary.points, dict(faces)).cells
        whole = boundary.with_faces(OuterFaces.numbered(cells))
    ids = np.arange(count) if nodes is None else _unique_ids(nodes, count)
    if method is not None:
        refuse_cells(method)
    surface = surface_of(whole)[0]
    method = default_for(whole, surface) if method is None else method
    if is_open is None:
        is_open = surface.has_free_sides(boundary.points)
    rows = np.union1d(whole.nodes, _fence(whole))
    part = whole.altered(is_open=is_open).part(rows)
    try:
        return SurfaceHalf(plan_of(part, method), ids[rows], part.surface_faces, is_open)
    except MeshError as error:
        raise error.renumbered(rows) from None


def _fence(boundary: Conditions) -> np.ndarray:
    """Finds the outermost nodes and one node of every symmetry plane, which set tolerances."""
    place = np.delete(np.arange(len(boundary.points)), boundary.loose)
    points = boundary.points[place]
    on_planes = (np.flatnonzero(is_on)[:1] for is_on in boundary.on[place].T)
    return place[np.concatenate([points.argmin(axis=0), points.argmax(axis=0), *on_planes])]


def _unique_ids(nodes: Any, count: int) -> np.ndarray:
    ids = as_array("nodes", nodes)
    if (
        ids.shape != (count,)
        or ids.dtype.kind not in "iu"
        or len(np.unique(ids[ids >= 0])) < (ids >= 0).sum()
    ):
        raise ValueError(
            f"`nodes` must be {count} ids, one for every point of the boundary; only -1 may come "
            "twice."
        )
    return ids


def prepare_in_chunks(
    boundary: Boundary, *, size: int | None = None, method: AbstractMethod | None = None
) -> Iterator[tuple[Int[np.ndarray, " c"], Plan]]:
    """Yields the nodes (c,) and the plan of every chunk of a mesh, one chunk after the other.

    The surface is prepared once, and chunks are attached to it.

    ```python
    points = np.array(mesh.points)
    for nodes, plan in jm.prepare_in_chunks(jm.Boundary(mesh, "wing", "far"), size=1_000_000):
        points[nodes] = jm.deform(plan, u)
    ```

    Nodes of no cell, which stay, are in no chunk of a `size`.

    **Arguments:**

    - `boundary`: the mesh's boundary.
    - `size`: most inner nodes of a chunk, beside all nodes of the surface. None makes one chunk.
    - `method`: `SurfaceReconstruction()` by default.

    **Raises:** `ValueError` for a size below 1, and where `prepare` does. With a size, also for a
    method that solves on cells. A wrong point raises with its chunk; a `MeshError` names nodes of
    the whole mesh.
    """
    _check_kinds(boundary, method)
    if size is not None:
        whole("size", size)
        if method is not None:
            refuse_cells(method)
    return _chunks(boundary, method, size)


def _chunks(
    boundary: Boundary, method: AbstractMethod | None, size: int | None
) -> Iterator[tuple[Int[np.ndarray, " c"], Plan]]:
    # A chunk of k has the surface and every k-th other node. A chunk that is one node short takes
    # the first other node again: so all chunks have one length and share compiled code.
    points = boundary.points
    every = np.arange(len(boundary.points))
    if size is None:
        yield every, plan_of(boundary, method)
        return
    half = prepare_surface(boundary, method=method)
    surface = np.unique(half.surface_nodes)
    others = np.setdiff1d(every, np.union1d(surface, boundary.loose), assume_unique=True)
    count = max(1, -(-len(others) // size))
    steps = count * np.arange(-(-len(others) // count))
    for k in range(count):
        nodes = np.sort(np.concatenate([surface, others[(k + steps) % max(1, len(others))]]))
        with warnings.catch_warnings():
            if k > 0:
                warnings.simplefilter("ignore")  # about the surface: they came with the first chunk
            try:
                plan = half.attach(points[nodes], nodes)
            except MeshError as error:
                raise error.renumbered(nodes) from None
        yield nodes, plan


@compiled
def _place_piece(
    method: AbstractMethod, surface: SurfacePart, points: Array, ids: PyTree
) -> PyTree:
    return place_points(method, points, ids, surface.factors, surface.points)
