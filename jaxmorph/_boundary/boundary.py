"""The boundary of a mesh, checked: node ids, planes, pairs, tracks and faces."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from .._host.cells.topology import solid
from .._host.package.errors import warn
from .._host.surface.skin import has_free_faces
from .._mesh.mesh import Mesh
from .outer_faces import FreeFaces, OuterFaces, free_faces, outer_faces
from .pairing import Pairing
from .symmetry import Plane
from .tracks import Track


@dataclasses.dataclass(frozen=True)
class Boundary:
    """A checked call of `prepare`.

    - `points` (n, d): base coordinates.
    - `moving` (m,), `fixed` (f,): node ids, no node twice.
    - `guided` (g,): ids of all other nodes on sliding and periodic patches, and on parallel planes.
    - `planes`: symmetry planes.
    - `pairings`: pairs of nodes that move alike.
    - `tracks`: nodes that stay on walls.
    - `faces`: boundary faces (k, corners) of the mesh by type, as node ids.
    - `left`: the boundary faces in no list.
    - `is_open`: whether some boundary faces are neither on the surface nor on a plane.
    - `cells`: node ids (k, corners) of the cells by type; None also for a part of a mesh.
    - `loose`: ids of the nodes of no cell and in no list, which stay where they are.

    `faces`, `left`, `is_open` and `cells` are None where no cells are known.
    """

    points: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    guided: np.ndarray
    planes: tuple[Plane, ...]
    pairings: tuple[Pairing, ...]
    tracks: tuple[Track, ...]
    faces: Mapping[str, np.ndarray] | None = None
    left: FreeFaces | None = None
    is_open: bool | None = None
    cells: Mapping[str, np.ndarray] | None = None
    loose: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def of_cells(self) -> np.ndarray:
        """Coordinates of all nodes but the loose ones."""
        return np.delete(self.points, self.loose, axis=0) if len(self.loose) else self.points

    @property
    def nodes(self) -> np.ndarray:
        """Ids of the surface's nodes: moving, fixed, then guided."""
        return np.concatenate([self.moving, self.fixed, self.guided])

    @property
    def surface_faces(self) -> dict[str, np.ndarray] | None:
        """Faces with all nodes on the surface, as rows of `nodes`; None without known faces."""
        if self.faces is None:
            return None
        rows = {kind: _rows(self.nodes, len(self.points))[corners] for kind, corners in self.faces.items()}
        return {kind: corners[(corners >= 0).all(axis=1)] for kind, corners in rows.items()}

    def with_faces_of(
        self, mesh: Mesh, outer: OuterFaces | None = None, free: np.ndarray | Sequence[int] = ()
    ) -> "Boundary":
        """Adds the cells of the mesh, its boundary faces, and the boundary faces in no list."""
        outer = outer_faces(mesh) if outer is None else outer
        if outer is None:
            return self
        is_listed = np.zeros(len(self.points), dtype=bool)
        is_listed[self.nodes] = True
        for plane in self.planes:
            is_listed |= plane.holds(self.points)
        is_open = has_free_faces(self.points, outer.corners, is_listed)
        is_listed[np.asarray(free, dtype=int)] = True
        cells = {kind: np.asarray(corners) for kind, corners in solid(mesh.linear.cells, self.points.shape[1]).items()}
        left = free_faces(mesh, outer, is_listed)
        loose = np.setdiff1d(of_no_cell(mesh), self.nodes) if cells else self.loose
        return dataclasses.replace(self, faces=outer.corners, left=left, is_open=is_open, cells=cells, loose=loose)

    def warn_of_free_faces(self) -> None:
        """Warns about boundary faces in no list."""
        if self.left:
            warn(f"{self.left} Name them in `fixed`, `moving`, `symmetry` or `free`.")

    def part(self, nodes: np.ndarray) -> "Boundary":
        """Restricts the boundary to `nodes` of the mesh: ascending ids, with the whole surface."""
        moving, fixed, guided = (np.searchsorted(nodes, ids) for ids in (self.moving, self.fixed, self.guided))
        faces, surface = self.surface_faces, np.concatenate([moving, fixed, guided])
        faces = None if faces is None else {kind: surface[rows] for kind, rows in faces.items()}
        place = _rows(nodes, len(self.points))
        lists = moving, fixed, guided, self.planes, *renumbered(self.pairings, self.tracks, place)
        cells = self.cells if len(nodes) == len(self.points) else None
        return Boundary(self.points[nodes], *lists, faces, self.left, self.is_open, cells)

    def alone(self) -> "Boundary":
        """Restricts the boundary to the surface's nodes; the guided nodes are then in no list."""
        m, count = len(self.moving), len(self.moving) + len(self.fixed)
        rows, place = np.arange(count), _rows(self.nodes, len(self.points))
        faces, is_open = self.surface_faces, None
        if faces is not None:
            faces = {kind: corners[(corners < count).all(axis=1)] for kind, corners in faces.items()}
            is_open = bool(self.tracks)
        lists = rows[:m], rows[m:], rows[:0], self.planes, *renumbered(self.pairings, self.tracks, place)
        return Boundary(self.points[self.nodes], *lists, faces, None, is_open)


def of_no_cell(mesh: Mesh) -> np.ndarray:
    """Lists the nodes of no cell, such as gmsh's points of the geometry with `SaveAll`."""
    is_loose = np.ones(len(mesh.points), dtype=bool)
    for corners in mesh.cells.values():
        is_loose[np.asarray(corners)] = False
    if mesh.polyhedra is not None:
        is_loose[mesh.polyhedra.faces.labels] = False
    return np.flatnonzero(is_loose)


def renumbered(
    pairings: Sequence[Pairing], tracks: Sequence[Track], place: np.ndarray
) -> tuple[tuple[Pairing, ...], tuple[Track, ...]]:
    """Renumbers pairs and tracks: node k becomes `place[k]`."""
    return tuple(pairing.renumbered(place) for pairing in pairings), tuple(track.renumbered(place) for track in tracks)


def _rows(nodes: np.ndarray, n: int) -> np.ndarray:
    """Finds the row of all n nodes in `nodes`; -1 for a node that is not in it."""
    row = np.full(n, -1, dtype=np.int32)
    row[nodes] = np.arange(len(nodes))
    return row
