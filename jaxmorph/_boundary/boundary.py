"""The boundary of a mesh, checked: what moves, stays, slides and repeats."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Bool, Int, Integer, Real

from .._host.cells.topology import solid
from .._host.package.arguments import rows_of
from .._host.package.errors import MeshError, place_of, warn
from .._host.surface.skin import has_free_faces
from .._mesh.mesh import Mesh
from .names import PAIRS, by_kinds, check_named_once, checked_points, nodes_named, planes_named, several, slides
from .outer_faces import FreeFaces, OuterFaces, free_faces, outer_faces
from .periodic import Pairing, Periodic, merged, paired
from .slide import Slide, Walls, walls_of_patch, with_own_curves
from .symmetry import Plane, check_dimension
from .tracks import Track, check_repeated, tracks_of

Nodes = str | Sequence[str] | Integer[ArrayLike, " _k"] | Sequence[int | np.integer]

_NONE = np.zeros(0, dtype=np.int64)
_EMPTY: dict[str, Any] = {"planes": (), "pairings": (), "tracks": (), "free": _NONE, "loose": _NONE, "hidden": _NONE}
_EMPTY |= dict.fromkeys(("mesh", "faces", "left", "is_open", "cells"))


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Boundary:
    """What moves, stays, slides and repeats on the boundary of a mesh, checked once.

    `prepare`, `prepare_surface` and `prepare_in_chunks` take it. It is immutable; several plans may
    share it.

    **Arguments:**

    - `mesh`: a `Mesh`, or points (n, d) alone, d = 2 or 3, in any unit. With a mesh, methods see
      the boundary faces, patches may be named, and boundary faces in no list cause a warning.
    - `moving`, `fixed`: node ids, (m,) and (f,), or names of patches. A node in both lists moves.
      Nodes in no list follow. If nothing but moving patches is named, the `kinds` of the other
      patches decide: symmetry planes slide, all others are fixed. A warning names them.
    - `symmetry`: planes, or names of patches that lie in one or several planes. Nodes on a plane
      stay in it, also moving nodes.
    - `periodic`: pairs of patches of which one repeats the other.
    - `sliding`: patches whose nodes move along their surface. A name stands for the patch's own
      faces.
    - `free`: node ids or names of patches whose nodes follow like inner nodes, without a warning.

    **Fields:**

    - `points` (n, d): base coordinates.
    - `moving` (m,), `fixed` (f,): node ids, no node twice.
    - `guided` (g,): ids of all other nodes on sliding and periodic patches, and on parallel planes.
    - `planes`: symmetry planes.
    - `left`: the boundary faces in no list, None where no cells are known.
    - `loose`: ids of the nodes of no cell and in no list, which stay where they are.

    **Raises:** `ValueError` for ids out of range or twice in `moving`, coordinates that are not
    finite, periodic patches that do not match, and sliding patches that leave their surface.
    """

    # `pairings`: nodes that move alike; `tracks`: nodes that stay on walls; `faces`: boundary faces
    # (k, corners) by type; `is_open`: whether some of them are neither on the surface nor on a
    # plane. They, `left` and `cells` are None of points alone.
    mesh: Mesh | None
    points: np.ndarray
    moving: Int[np.ndarray, " m"]
    fixed: Int[np.ndarray, " f"]
    free: Int[np.ndarray, " k"]
    guided: Int[np.ndarray, " g"]
    planes: tuple[Plane, ...]
    pairings: tuple[Pairing, ...]
    tracks: tuple[Track, ...]
    faces: Mapping[str, np.ndarray] | None
    left: FreeFaces | None
    is_open: bool | None
    cells: Mapping[str, np.ndarray] | None
    loose: Int[np.ndarray, " l"]
    hidden: Int[np.ndarray, " h"]

    def __init__(
        self,
        mesh: Mesh | Real[ArrayLike, "n d"] | Sequence[Any],
        moving: Nodes,
        fixed: Nodes = (),
        *,
        symmetry: Plane | str | Sequence[Plane | str] = (),
        periodic: Periodic | Sequence[Periodic] = (),
        sliding: Slide | str | Sequence[Slide | str] = (),
        free: Nodes = (),
    ):
        patches = mesh if isinstance(mesh, Mesh) else None
        points = checked_points(mesh.points if isinstance(mesh, Mesh) else mesh)
        if nothing_in(fixed, symmetry, sliding, free):
            periodic = several("periodic", periodic, Periodic, PAIRS)
            fixed, symmetry = by_kinds(mesh, moving, periodic)
        check_named_once(sliding, fixed=fixed, symmetry=symmetry)
        moving, fixed, free = _listed(points, patches, moving=moving, fixed=fixed, free=free)
        planes = planes_named(symmetry, points, patches)
        check_dimension(planes, points.shape[1])
        outer = None if patches is None else outer_faces(patches)
        pairings = _pairings(periodic, points, patches)
        walls = _walls(sliding, points, patches, {"fixed": fixed, "moving": moving}, outer)
        tracks, corners = tracks_of(walls, planes if walls else (), points)
        _check_corners(corners, moving, points)
        check_repeated(tracks, corners, pairings, points, np.isin(np.arange(len(points)), fixed, invert=True))
        fixed = np.append(fixed, corners[~np.isin(corners, fixed)])
        left = (Track(track.rows[~np.isin(track.rows, fixed)], track.walls) for track in tracks)
        tracks = tuple(track for track in left if len(track.rows))
        guided = _guided(pairings, tracks, moving, fixed, points)
        lists = {"moving": moving, "fixed": fixed, "free": free, "guided": guided}
        made = boundary_of_lists(points, mesh=patches, planes=planes, pairings=pairings, tracks=tracks, **lists)
        self._fill(vars(made if patches is None else with_cells(made, patches, outer)))

    def _fill(self, fields: Mapping[str, Any]) -> None:
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        n, d = self.points.shape
        lists = f"{len(self.moving)} moving, {len(self.fixed)} fixed, {len(self.guided)} guided"
        return f"Boundary({n} points in {d}-D, {lists})"

    @property
    def of_cells(self) -> np.ndarray:
        """Coordinates of all nodes but the loose ones."""
        return np.delete(self.points, self.loose, axis=0) if len(self.loose) else self.points

    @property
    def on_planes(self) -> Bool[np.ndarray, "n p"]:
        """Marks the points on each symmetry plane."""
        return np.array([plane.holds(self.points) for plane in self.planes], bool).reshape(-1, len(self.points)).T

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

    def warn_of_free_faces(self) -> None:
        if self.left:
            warn(f"{self.left} Name them in `fixed`, `moving`, `symmetry` or `free`.")

    def part(self, nodes: Integer[ArrayLike, " _k"] | Sequence[int]) -> "Boundary":
        """Restricts the boundary to nodes (k,) of the mesh and those of the surface, ascending."""
        nodes = np.union1d(rows_of("nodes", nodes, len(self.points)), self.nodes)
        cells = self.cells if len(nodes) == len(self.points) else None
        return changed(self._restricted(nodes), cells=cells, loose=np.flatnonzero(np.isin(nodes, self.loose)))

    def alone(self) -> "Boundary":
        """Restricts the boundary to the surface's nodes; the guided nodes are then in no list."""
        own, listed = self._restricted(self.nodes), len(self.moving) + len(self.fixed)
        faces = own.faces and {kind: corners[(corners < listed).all(axis=1)] for kind, corners in own.faces.items()}
        is_open = None if faces is None else bool(self.tracks)
        return changed(own, guided=_NONE, faces=faces, left=None, is_open=is_open, loose=_NONE)

    def _restricted(self, nodes: np.ndarray) -> "Boundary":
        """Returns the boundary of some nodes in their order, those of the surface among them."""
        place, faces = _rows(nodes, len(self.points)), self.surface_faces
        faces = faces and {kind: place[self.nodes[rows]] for kind, rows in faces.items()}
        lists: dict[str, Any] = {name: place[getattr(self, name)] for name in ("moving", "fixed", "guided")}
        lists["pairings"], lists["tracks"] = renumbered(self.pairings, self.tracks, place)
        lists["hidden"] = np.flatnonzero(np.isin(nodes, self.hidden))
        return changed(self, mesh=None, points=self.points[nodes], faces=faces, cells=None, **lists)


def nothing_in(*lists: Any) -> bool:
    """Checks whether all lists are as by default: an array without an id is a choice."""
    return all(isinstance(named, tuple) and not named for named in lists)


def changed(boundary: Boundary, **fields: Any) -> Boundary:
    """Copies a boundary with other fields, which are not checked."""
    return boundary_of_lists(**(vars(boundary) | fields))


def boundary_of_lists(points: np.ndarray, **fields: Any) -> Boundary:
    """Makes a boundary of lists that were checked before; a list that is not given is empty."""
    boundary = object.__new__(Boundary)
    boundary._fill(_EMPTY | {"points": points} | fields)
    return boundary


def with_cells(boundary: Boundary, mesh: Mesh, outer: OuterFaces | None = None) -> Boundary:
    """Adds the cells of a mesh, and its boundary faces. Default: these are found."""
    outer = outer_faces(mesh) if outer is None else outer
    if outer is None:
        return boundary
    cells = {kind: np.asarray(corners) for kind, corners in solid(mesh.linear.cells, boundary.points.shape[1]).items()}
    loose = np.setdiff1d(of_no_cell(mesh), boundary.nodes) if cells else boundary.loose
    hidden, outer = _without_bodies(boundary, mesh, cells, outer)
    return with_faces(changed(boundary, mesh=mesh, cells=cells, loose=loose, hidden=hidden), outer)


def _without_bodies(
    boundary: Boundary, mesh: Mesh, cells: Mapping[str, np.ndarray], outer: OuterFaces
) -> tuple[np.ndarray, OuterFaces]:
    """Finds moving nodes inside of bodies whose nodes all move, and the boundary without bodies."""
    is_moving, is_inside, is_seen = (np.zeros(len(boundary.points), dtype=bool) for _ in range(3))
    is_moving[boundary.moving] = True
    for corners in cells.values():
        is_inside[corners] = True
    for corners in outer.corners.values():
        is_inside[corners] = False
    if mesh.polyhedra is not None or not (is_inside & is_moving).any():
        return _NONE, outer
    left = {kind: corners[~is_moving[corners].all(axis=1)] for kind, corners in cells.items()}
    for corners in left.values():
        is_seen[corners] = True
    hidden = np.flatnonzero(is_moving & is_inside & ~is_seen)
    return (hidden, outer_faces(Mesh(mesh.points, left)) or outer) if len(hidden) else (_NONE, outer)


def with_faces(boundary: Boundary, outer: OuterFaces) -> Boundary:
    """Adds boundary faces, and finds those in no list."""
    is_listed, mesh = np.zeros(len(boundary.points), dtype=bool), boundary.mesh or Mesh(boundary.points)
    is_listed[boundary.nodes] = True
    is_listed |= boundary.on_planes.any(axis=1)
    is_open = has_free_faces(boundary.points, outer.corners, is_listed)
    is_listed[boundary.free] = True
    return changed(boundary, faces=outer.corners, left=free_faces(mesh, outer, is_listed), is_open=is_open)


def _listed(points: np.ndarray, mesh: Mesh | None, **lists: Nodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    moving, fixed, free = (nodes_named(ids, name, mesh, len(points)) for name, ids in lists.items())
    unique, counts = np.unique(moving, return_counts=True)
    if len(twice := unique[counts > 1]):
        raise MeshError(f"{len(twice)} nodes are named more than once in `moving`, first node {{node}}.", twice)
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]  # each once, where it comes first
    return moving, fixed[~np.isin(fixed, moving)], free


def _check_corners(corners: np.ndarray, moving: np.ndarray, points: np.ndarray) -> None:
    wrong = corners[np.isin(corners, moving)]
    if len(wrong):
        raise MeshError(
            f"{len(wrong)} moving nodes are corners of sliding patches and cannot move, the first is node {{node}} at "
            f"({place_of(points[wrong[0]])}). Remove them from `moving`, or slide along fewer patches.",
            wrong,
        )


def _pairings(periodic: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Pairing, ...]:
    pairings = []
    for pair in several("periodic", periodic, Periodic, PAIRS):
        sides = (pair.patch, pair.partner)
        first, second = (np.unique(nodes_named(side, "periodic", mesh, len(points))) for side in sides)
        pairings.append(paired(pair, first, second, points))
    return merged(pairings, float(np.ptp(points, axis=0).max()))


def _walls(
    sliding: Any, points: np.ndarray, mesh: Mesh | None, lists: Mapping[str, np.ndarray], outer: OuterFaces | None
) -> Walls:
    walls, patches, faces = [], [], None
    if mesh is not None:
        faces = (outer or OuterFaces.numbered(mesh.linear.cells)).corners  # of a surface, its cells
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
        walls += with_own_curves(walls_of_patch(slide, nodes, points, faces, lists["moving"]), mesh)
    return walls


def _guided(
    pairings: Sequence[Pairing], tracks: Sequence[Track], moving: np.ndarray, fixed: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Lists sliding and periodic nodes in no list."""
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
    """Finds the row of each of n nodes in `nodes`; -1 for an absent node."""
    row = np.full(n, -1, dtype=np.int32)
    row[nodes] = np.arange(len(nodes))
    return row
