"""The boundary of `prepare`: names become checked node ids, planes, pairs, walls and faces."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._host.cells.topology import solid
from .._host.package.errors import MeshError, place_of, warn
from .._host.surface.skin import has_free_faces
from .._mesh.mesh import Mesh
from .names import check_named_once, checked_points, nodes_named, planes_named, slides
from .outer_faces import FreeFaces, OuterFaces, free_faces, outer_faces
from .pairing import Pairing, check_pairings, merged
from .periodic import Periodic, paired
from .slide import walls_of_patch
from .symmetry import Plane, check_dimension
from .tracks import Track, check_repeated, tracks_of
from .walls import AbstractWall, Flat


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

    The last four are None where no cells are known.
    """

    points: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    guided: np.ndarray
    planes: tuple[Plane, ...]
    pairings: tuple[Pairing, ...]
    tracks: tuple[Track, ...]
    faces: Mapping[str, np.ndarray] | None
    left: FreeFaces | None
    is_open: bool | None
    cells: Mapping[str, np.ndarray] | None = None

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
        return dataclasses.replace(self, faces=outer.corners, left=left, is_open=is_open, cells=cells)

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


def renumbered(
    pairings: Sequence[Pairing], tracks: Sequence[Track], place: np.ndarray
) -> tuple[tuple[Pairing, ...], tuple[Track, ...]]:
    """Renumbers pairs and tracks: node k becomes `place[k]`."""
    return tuple(pairing.renumbered(place) for pairing in pairings), tuple(track.renumbered(place) for track in tracks)


def find_boundary(
    mesh: Any,
    moving: Any,
    fixed: Any,
    symmetry: Any,
    free: Any = (),
    periodic: Any = (),
    sliding: Any = (),
    *,
    outer: OuterFaces | None = None,
) -> Boundary:
    """Checks the arguments of `prepare`.

    Raises `ValueError` in one sentence that names the call to make. `outer` are the boundary faces,
    if a `Mesh` has no cells that show them.
    """
    points = checked_points(mesh.points if isinstance(mesh, Mesh) else mesh)
    patches = mesh if isinstance(mesh, Mesh) else None
    check_named_once(sliding, fixed=fixed, symmetry=symmetry)
    moving, fixed, free = (
        nodes_named(ids, name, patches, len(points))
        for ids, name in ((moving, "moving"), (fixed, "fixed"), (free, "free"))
    )
    _check_moving(moving)
    # each fixed node once, where it comes first
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]
    fixed = fixed[~np.isin(fixed, moving)]
    planes = planes_named(symmetry, points, patches)
    if outer is None and patches is not None:
        outer = outer_faces(patches)
    pairings = _pairings(periodic, points, patches)
    walls = _walls(sliding, points, patches, {"fixed": fixed, "moving": moving}, outer)
    tracks, corners = tracks_of(walls, planes if walls else (), points)
    _check_corners(corners, moving, points)
    is_free = np.isin(np.arange(len(points)), fixed, invert=True)
    check_repeated(tracks, corners, pairings, points, is_free)
    fixed = np.append(fixed, corners[~np.isin(corners, fixed)])
    tracks = tuple(Track(track.rows[~np.isin(track.rows, fixed)], track.walls) for track in tracks)
    tracks = tuple(track for track in tracks if len(track.rows))
    lists = moving, fixed, _guided(pairings, tracks, moving, fixed, points), planes, pairings, tracks
    boundary = Boundary(points, *lists, None, None, None)
    return boundary if patches is None else boundary.with_faces_of(patches, outer, free)


def _check_moving(moving: np.ndarray) -> None:
    unique, counts = np.unique(moving, return_counts=True)
    if len(unique) < len(moving):
        raise MeshError(
            f"{(counts > 1).sum()} nodes are named more than once in `moving`, first node {{node}}.", unique[counts > 1]
        )
    if len(moving) == 0:
        raise ValueError("`moving` is empty: name the nodes of the boundary that moves.")


def _check_corners(corners: np.ndarray, moving: np.ndarray, points: np.ndarray) -> None:
    """Raises `ValueError` for moving nodes at corners of sliding patches, which cannot move."""
    wrong = corners[np.isin(corners, moving)]
    if len(wrong):
        raise MeshError(
            f"{len(wrong)} moving nodes are corners of sliding patches and cannot move, the first is node {{node}} at "
            f"({place_of(points[wrong[0]])}). Remove them from `moving`, or slide along fewer patches.",
            wrong,
        )


def _pairings(periodic: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Pairing, ...]:
    """Finds the pairs of nodes of periodic patches."""
    several = [periodic] if isinstance(periodic, Periodic) else periodic
    if not isinstance(several, Sequence) or not all(isinstance(pair, Periodic) for pair in several):
        raise ValueError(
            f"`periodic` must be pairs such as jm.Periodic('lower', 'upper', translation=(0, 1)), not {periodic!r}."
        )
    pairings = []
    for pair in several:
        first, second = (
            np.unique(nodes_named(side, "periodic", mesh, len(points))) for side in (pair.patch, pair.partner)
        )
        pairings.append(paired(pair, first, second, points))
    return merged(pairings, float(np.ptp(points, axis=0).max()))


def walls_of(
    mesh: Mesh, symmetry: Any, sliding: Any, periodic: Any, fixed: Any = ()
) -> tuple[list[tuple[AbstractWall, np.ndarray]], tuple[Pairing, ...]]:
    """Makes the walls of sliding patches and symmetry planes, their nodes, and the periodic pairs.

    It takes and refuses the arguments of `prepare`.
    """
    points = np.asarray(mesh.points)
    check_named_once(sliding, symmetry=symmetry)
    walls = _walls(sliding, points, mesh, {"fixed": np.asarray(fixed)}, outer_faces(mesh))
    planes = planes_named(symmetry, points, mesh)
    check_dimension(planes, mesh.points.shape[1])
    for plane in planes:
        walls.append((Flat(plane.normal, plane.origin), np.flatnonzero(plane.holds(points))))
    pairings = _pairings(periodic, points, mesh)
    check_pairings(pairings, planes, float(np.ptp(points, axis=0).max()))
    return walls, pairings


def _walls(
    sliding: Any,
    points: np.ndarray,
    mesh: Mesh | None,
    lists: Mapping[str, np.ndarray],
    outer: OuterFaces | None,
) -> list[tuple[AbstractWall, np.ndarray]]:
    """Makes the walls of sliding patches, with their nodes.

    Raises `ValueError` for a patch that a list holds whole.
    """
    walls, patches, faces = [], [], None if outer is None else outer.corners
    for slide in slides(sliding):
        nodes = np.unique(nodes_named(slide.patch, "sliding", mesh, len(points)))
        for name, listed in lists.items():
            if len(nodes) and np.isin(nodes, listed).all():
                place = place_of(points[nodes[0]])
                raise MeshError(
                    f"all {len(nodes)} nodes of {slide.name} are in `{name}`, first node {{node}} at ({place}): "
                    "the patch would not slide. Remove them from one list.",
                    nodes,
                )
        if any(np.array_equal(nodes, other) for other in patches):
            raise ValueError(f"{slide.name} comes twice in `sliding`. Its nodes slide along one surface. Remove one.")
        patches.append(nodes)
        walls += walls_of_patch(slide, nodes, points, faces, lists.get("moving", ()))
    return walls


def _guided(
    pairings: Sequence[Pairing], tracks: Sequence[Track], moving: np.ndarray, fixed: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Lists sliding and periodic nodes in no list.

    Raises `ValueError` for a pair whose nodes are in different lists.
    """
    role = np.zeros(len(points), dtype=int)
    role[moving], role[fixed] = 1, 2
    for pairing in pairings:
        first, second = np.asarray(pairing.first), np.asarray(pairing.second)
        odd = np.flatnonzero(role[first] != role[second])
        if odd.size:
            words, worst = ("in neither list", "in `moving`", "in `fixed`"), odd[0]
            raise MeshError(
                f"{len(odd)} periodic pairs have nodes in different lists: node {{node}} at ({place_of(points[first[worst]])}) is "
                f"{words[role[first[worst]]]}, its partner {second[worst]} {words[role[second[worst]]]}. Name both nodes, or none.",
                first[odd],
            )
    parts = [np.zeros(0, dtype=np.int64), *(pairing.nodes for pairing in pairings), *(track.rows for track in tracks)]
    nodes = np.unique(np.concatenate(parts))
    return nodes[role[nodes] == 0]


def _rows(nodes: np.ndarray, n: int) -> np.ndarray:
    """Finds the row of all n nodes in `nodes`; -1 for a node that is not in it."""
    row = np.full(n, -1, dtype=np.int32)
    row[nodes] = np.arange(len(nodes))
    return row
