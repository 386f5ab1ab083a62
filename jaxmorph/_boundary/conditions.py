"""Conditions on the nodes of a mesh: which move, stay, slide and repeat."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from .._host.cells.topology import solid
from .._host.package.errors import warn
from .._host.rows import Rows, mark
from .._host.surface.skin import has_free_faces
from .._mesh.mesh import Mesh
from .._mesh.topology import OuterFaces
from .outer_faces import Faces, FreeFaces, Ids, free_faces
from .periodic import Pairing
from .symmetry import Plane
from .tracks import Track


def nothing() -> Ids:
    return np.zeros(0, dtype=np.int64)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Conditions:
    """What moves, stays, slides and repeats, by node ids of `points` (n, d).

    - `moving` (m,), `fixed` (f,), `free`: ids as the caller lists them, no node twice.
    - `guided` (g,): ids of all other nodes on sliding and periodic patches, and on parallel planes.
    - `planes`, `on` (n, p): symmetry planes, and the nodes on each.
    - `pairings`, `tracks`: nodes that move alike, nodes that stay on walls.
    - `between`: the nodes that parallel planes alone guide, which methods on cells do not need.
    - `mesh`: the mesh, or None for points alone. What its cells tell:
    - `faces`: boundary faces (k, corners) by type, seen from outside.
    - `left`: the boundary faces in no list.
    - `is_open`: whether some of them are neither on the surface nor on a plane.
    - `cells`: the linear cells that fill the space, by type.
    - `loose`: ids of the nodes of no cell and in no list.
    - `hidden`: ids of moving nodes inside of bodies whose nodes all move.
    """

    points: np.ndarray
    moving: Int[np.ndarray, " m"]
    fixed: Int[np.ndarray, " f"]
    guided: Int[np.ndarray, " g"]
    planes: tuple[Plane, ...]
    on: Bool[np.ndarray, "n p"]
    pairings: tuple[Pairing, ...]
    tracks: tuple[Track, ...]
    free: Int[np.ndarray, " e"] = dataclasses.field(default_factory=nothing)
    between: Int[np.ndarray, " b"] = dataclasses.field(default_factory=nothing)
    mesh: Mesh | None = None
    faces: Faces | None = None
    left: FreeFaces | None = None
    is_open: bool | None = None
    cells: Faces | None = None
    loose: Int[np.ndarray, " l"] = dataclasses.field(default_factory=nothing)
    hidden: Int[np.ndarray, " h"] = dataclasses.field(default_factory=nothing)

    def __repr__(self) -> str:
        n, d = self.points.shape
        lists = f"{len(self.moving)} moving, {len(self.fixed)} fixed, {len(self.guided)} guided"
        return f"Boundary({n} points in {d}-D, {lists})"

    @property
    def nodes(self) -> np.ndarray:
        """Ids of the surface's nodes: moving, fixed, then guided."""
        return np.concatenate([self.moving, self.fixed, self.guided])

    @property
    def surface_faces(self) -> dict[str, np.ndarray] | None:
        """Faces with all nodes on the surface, as rows of `nodes`; None without known faces."""
        if self.faces is None:
            return None
        rows = Rows(self.nodes).renumbered(self.faces)
        return {kind: corners[(corners >= 0).all(axis=1)] for kind, corners in rows.items()}

    def warn_of_free_faces(self) -> None:
        if self.left:
            warn(f"{self.left} Name them in `fixed`, `moving`, `symmetry` or `free`.")

    def altered(self, **fields: Any) -> "Conditions":
        """Returns conditions with some other fields."""
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(Conditions)}
        return Conditions(**(own | fields))

    def for_cells(self) -> "Conditions":
        """Leaves the nodes between parallel planes to a method that solves on cells."""
        pairings = tuple(pairing for pairing in self.pairings if pairing.copies)
        guided = np.setdiff1d(self.guided, self.between)
        return self.altered(guided=guided, between=nothing(), pairings=pairings)

    def with_mesh(self, mesh: Mesh) -> "Conditions":
        """Returns the conditions on a mesh, with what its cells tell."""
        here = self.altered(mesh=mesh)
        n, d = here.points.shape
        outer = mesh.outer_faces
        if outer is None:
            return here
        cells = {kind: np.asarray(ids) for kind, ids in solid(mesh.linear.cells, d).items()}
        hidden = nothing()
        is_moving = mark(n, self.moving)
        inside = is_moving & mark(n, *cells.values()) & ~mark(n, *outer.corners.values())
        if mesh.polyhedra is None and inside.any():  # of bodies whose nodes all move
            left = {kind: ids[~is_moving[ids].all(axis=1)] for kind, ids in cells.items()}
            hidden = np.flatnonzero(inside & ~mark(n, *left.values()))
            if len(hidden):
                outer = Mesh(mesh.points, left).outer_faces or outer
        # in no cell stand, for example, gmsh's points of the geometry with `SaveAll`
        loose = np.setdiff1d(mesh.topology.loose, self.nodes)
        return here.with_faces(outer, cells=cells, loose=loose, hidden=hidden)

    def with_faces(self, outer: OuterFaces, **of_cells: Any) -> "Conditions":
        """Returns the conditions with these boundary faces."""
        n = len(self.points)
        patches = {} if self.mesh is None else self.mesh.patches
        tracks = [track.rows for track in self.tracks]
        is_named = mark(n, self.moving, self.fixed, self.free, *tracks)
        is_listed = mark(n, self.nodes) | self.on.any(axis=1)
        return self.altered(
            faces=outer.corners,
            left=free_faces(patches, outer, is_named, self._sides()),
            is_open=has_free_faces(self.points, outer.corners, is_listed),
            **of_cells,
        )

    def _sides(self) -> list[Bool[np.ndarray, " n"]]:
        """Marks the nodes of each plane, and of either side of periodic pairs."""
        sides = [
            mark(len(self.points), side, pairing.alone)
            for pairing in self.pairings
            for side in (pairing.first, pairing.second)
        ]
        return [*self.on.T, *sides]

    def part(self, nodes: np.ndarray) -> "Conditions":
        """Restricts the conditions to nodes (k,) in this order, those of the surface among them."""
        place = Rows(nodes).of(np.arange(len(self.points)))
        faces = self.surface_faces
        if faces is not None:
            faces = {kind: place[self.nodes[rows]] for kind, rows in faces.items()}
        pairings, tracks = renumbered(self.pairings, self.tracks, place)
        return self.altered(
            mesh=None,
            points=self.points[nodes],
            moving=place[self.moving],
            fixed=place[self.fixed],
            free=nothing(),
            guided=place[self.guided],
            between=place[self.between],
            on=self.on[nodes],
            pairings=pairings,
            tracks=tracks,
            faces=faces,
            cells=None,
            loose=np.flatnonzero(np.isin(nodes, self.loose)),
            hidden=np.flatnonzero(np.isin(nodes, self.hidden)),
        )

    def alone(self) -> "Conditions":
        """Restricts the conditions to the surface's nodes; guided nodes are then in no list."""
        own = self.part(self.nodes)
        listed = len(self.moving) + len(self.fixed)
        lists = {"guided": nothing(), "between": nothing(), "loose": nothing()}
        if own.faces is None:
            return own.altered(**lists)
        faces = {kind: ids[(ids < listed).all(axis=1)] for kind, ids in own.faces.items()}
        return own.altered(faces=faces, is_open=bool(self.tracks), left=None, **lists)


def renumbered(
    pairings: Sequence[Pairing], tracks: Sequence[Track], place: np.ndarray
) -> tuple[tuple[Pairing, ...], tuple[Track, ...]]:
    return tuple(pairing.renumbered(place) for pairing in pairings), tuple(
        track.renumbered(place) for track in tracks
    )
