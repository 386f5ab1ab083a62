"""The boundary of a mesh, checked: what moves, stays, slides and repeats."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike, Bool, Int, Integer, Real

from .._host.cells.topology import solid
from .._host.package.arguments import freeze, real_array, rows_of, shown
from .._host.package.errors import MeshError, check_none, place_of, warn
from .._host.surface.skin import has_free_faces
from .._mesh.mesh import Mesh
from .._mesh.topology import OuterFaces
from .outer_faces import Faces, FreeFaces, Ids, free_faces, mask, row_of
from .periodic import Pairing, Periodic, merged, paired
from .slide import Slide, Walls, walls_of_patch, with_own_curves
from .symmetry import Plane, check_dimension, check_planes
from .tracks import Track, check_repeated, tracks_of

USE = 'prepare(mesh, "airfoil", "farfield") with a Mesh, or prepare(points, moving_ids, fixed_ids)'

# smallest extent of a mesh, relative to the length whose cube is the smallest normal number
SMALL = 1e4
PAIRS = "pairs such as jm.Periodic('lower', 'upper', translation=(0, 1))"
PLANES = (
    "jm.Plane(normal=(0, 1), origin=(0, 0)), jm.Plane.through(points, nodes), or the name of a "
    "patch of the mesh"
)
SLIDES = "slides such as jm.Slide('shroud', jm.Revolution((1, 0, 0))), or names of patches"
SYMMETRY = frozenset({"BCSymmetryPlane", "symmetry", "symmetryPlane", "axis"})

INSIDE = "cyclic", "processor", "empty", "wedge", "overset"
"""Prefixes of kinds of patches that are no outer boundary; overset grids lie inside others."""

Nodes = str | Sequence[str] | Integer[ArrayLike, " _k"] | Sequence[int | np.integer]

_NONE = np.zeros(0, dtype=np.int64)
_EMPTY: dict[str, Any] = {
    "planes": (),
    "pairings": (),
    "tracks": (),
    "free": _NONE,
    "loose": _NONE,
    "hidden": _NONE,
}
_EMPTY |= dict.fromkeys(("mesh", "faces", "left", "is_open", "cells"))


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Boundary:
    """What moves, stays, slides and repeats on the boundary of a mesh, checked once.

    `prepare`, `prepare_surface` and `prepare_in_chunks` take it. Its arrays are its own, and
    read-only; several plans may share it.

    **Arguments:**

    - `mesh`: a `Mesh`, or points (n, d) alone, d = 2 or 3, in any unit. With a mesh, methods see
      the boundary faces, patches may be named, and boundary faces in no list cause a warning.
    - `moving`, `fixed`: node ids, (m,) and (f,), or names of patches. A node in both lists moves.
      Nodes in no list follow. Where lists are of names, the `kinds` of the other patches decide:
      symmetry planes slide. All others are fixed if nothing but moving patches is named. A warning
      names them.
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
    free: Ids
    guided: Int[np.ndarray, " g"]
    planes: tuple[Plane, ...]
    pairings: tuple[Pairing, ...]
    tracks: tuple[Track, ...]
    faces: Faces | None
    left: FreeFaces | None
    is_open: bool | None
    cells: Faces | None
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
        if patches is not None:
            lists = {"fixed": fixed, "symmetry": symmetry, "sliding": sliding, "free": free}
            periodic = several("periodic", periodic, Periodic, PAIRS)
            fixed, symmetry = by_kinds(patches, moving, periodic, lists)
        check_named_once(sliding, fixed=fixed, symmetry=symmetry)
        moving, fixed, free = _listed(points, patches, moving=moving, fixed=fixed, free=free)
        planes = planes_named(symmetry, points, patches)
        check_dimension(planes, points.shape[1])
        outer = None if patches is None else patches.outer_faces
        pairings = _pairings(periodic, points, patches)
        walls = _walls(sliding, points, patches, {"fixed": fixed, "moving": moving}, outer)
        tracks, corners = tracks_of(walls, planes if walls else (), points)
        check_none(
            corners[np.isin(corners, moving)],
            "{count} moving nodes are corners of sliding patches and cannot move, the first is "
            "node {node} at ({place}). Remove "
            "them from `moving`, or slide along fewer patches.",
            points,
        )
        check_repeated(tracks, corners, pairings, points, ~mask(len(points), fixed))
        fixed = np.append(fixed, corners[~np.isin(corners, fixed)])
        left = (Track(track.rows[~np.isin(track.rows, fixed)], track.walls) for track in tracks)
        tracks = tuple(track for track in left if len(track.rows))
        guided = _guided(pairings, tracks, moving, fixed, points)
        lists = {"moving": moving, "fixed": fixed, "free": free, "guided": guided}
        made = boundary_of_lists(
            points, mesh=patches, planes=planes, pairings=pairings, tracks=tracks, **lists
        )
        vars(self).update(vars(made if patches is None else with_cells(made, patches)))

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
        return (
            np.array([plane.holds(self.points) for plane in self.planes], bool)
            .reshape(-1, len(self.points))
            .T
        )

    @property
    def nodes(self) -> np.ndarray:
        """Ids of the surface's nodes: moving, fixed, then guided."""
        return np.concatenate([self.moving, self.fixed, self.guided])

    @property
    def surface_faces(self) -> dict[str, np.ndarray] | None:
        """Faces with all nodes on the surface, as rows of `nodes`; None without known faces."""
        if self.faces is None:
            return None
        rows = {
            kind: row_of(self.nodes, len(self.points))[corners]
            for kind, corners in self.faces.items()
        }
        return {kind: corners[(corners >= 0).all(axis=1)] for kind, corners in rows.items()}

    def warn_of_free_faces(self) -> None:
        if self.left:
            warn(f"{self.left} Name them in `fixed`, `moving`, `symmetry` or `free`.")

    def part(self, nodes: Integer[ArrayLike, " _k"] | Sequence[int]) -> "Boundary":
        """Restricts the boundary to nodes (k,) of the mesh and those of the surface, ascending."""
        nodes = np.union1d(rows_of("nodes", nodes, len(self.points)), self.nodes)
        cells = self.cells if len(nodes) == len(self.points) else None
        return changed(
            self._restricted(nodes), cells=cells, loose=np.flatnonzero(np.isin(nodes, self.loose))
        )

    def alone(self) -> "Boundary":
        """Restricts the boundary to the surface's nodes; the guided nodes are then in no list."""
        own = self._restricted(self.nodes)
        listed = len(self.moving) + len(self.fixed)
        faces = own.faces and {
            kind: corners[(corners < listed).all(axis=1)] for kind, corners in own.faces.items()
        }
        is_open = None if faces is None else bool(self.tracks)
        return changed(own, guided=_NONE, faces=faces, left=None, is_open=is_open, loose=_NONE)

    def _restricted(self, nodes: np.ndarray) -> "Boundary":
        """Returns the boundary of some nodes in their order, those of the surface among them."""
        place = row_of(nodes, len(self.points))
        faces = self.surface_faces
        faces = faces and {kind: place[self.nodes[rows]] for kind, rows in faces.items()}
        lists: dict[str, Any] = {
            name: place[getattr(self, name)] for name in ("moving", "fixed", "guided")
        }
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
    fields = _EMPTY | {"points": points} | fields
    vars(boundary).update({name: jax.tree.map(freeze, part) for name, part in fields.items()})
    return boundary


def with_cells(boundary: Boundary, mesh: Mesh) -> Boundary:
    """Adds the cells of a mesh, and its boundary faces."""
    outer = mesh.outer_faces
    if outer is None:
        return boundary
    cells = {
        kind: np.asarray(corners)
        for kind, corners in solid(mesh.linear.cells, boundary.points.shape[1]).items()
    }
    # in no cell stand, for example, gmsh's points of the geometry with `SaveAll`
    loose = np.setdiff1d(mesh.topology.loose, boundary.nodes) if cells else boundary.loose
    hidden, outer = _without_bodies(boundary, mesh, cells, outer)
    return with_faces(changed(boundary, mesh=mesh, cells=cells, loose=loose, hidden=hidden), outer)


def _without_bodies(
    boundary: Boundary, mesh: Mesh, cells: Faces, outer: OuterFaces
) -> tuple[np.ndarray, OuterFaces]:
    """Finds moving nodes inside of bodies whose nodes all move, and the boundary without bodies."""
    n = len(boundary.points)
    is_moving = mask(n, boundary.moving)
    is_hidden = is_moving & mask(n, *cells.values()) & ~mask(n, *outer.corners.values())
    if mesh.polyhedra is None and is_hidden.any():
        left = {kind: corners[~is_moving[corners].all(axis=1)] for kind, corners in cells.items()}
        hidden = np.flatnonzero(is_hidden & ~mask(n, *left.values()))
        if len(hidden):
            return hidden, Mesh(mesh.points, left).outer_faces or outer
    return _NONE, outer


def with_faces(boundary: Boundary, outer: OuterFaces) -> Boundary:
    """Adds boundary faces, and finds those in no list."""
    mesh = boundary.mesh or Mesh(boundary.points)
    is_listed = mask(len(boundary.points), boundary.nodes) | boundary.on_planes.any(axis=1)
    is_open = has_free_faces(boundary.points, outer.corners, is_listed)
    left = free_faces(mesh, outer, is_listed | mask(len(is_listed), boundary.free))
    return changed(boundary, faces=outer.corners, left=left, is_open=is_open)


def _listed(
    points: np.ndarray, mesh: Mesh | None, **lists: Nodes
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    moving, fixed, free = (nodes_named(ids, name, mesh, len(points)) for name, ids in lists.items())
    if names_in(lists["fixed"]) and not len(fixed):
        raise ValueError(
            f"the patches of `fixed`, {shown(lists['fixed'])}, have no nodes: nothing would be "
            "fixed. Name others, or leave `fixed` out."
        )
    unique, counts = np.unique(moving, return_counts=True)
    check_none(
        unique[counts > 1], "{count} nodes are named more than once in `moving`, first node {node}."
    )
    fixed = fixed[
        np.sort(np.unique(fixed, return_index=True)[1])
    ]  # each once, where it comes first
    return moving, fixed[~np.isin(fixed, moving)], free


def _pairings(periodic: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Pairing, ...]:
    pairings = []
    for pair in several("periodic", periodic, Periodic, PAIRS):
        sides = (pair.patch, pair.partner)
        first, second = (
            np.unique(nodes_named(side, "periodic", mesh, len(points))) for side in sides
        )
        pairings.append(paired(pair, first, second, points))
    return merged(pairings, float(np.ptp(points, axis=0).max()))


def _walls(
    sliding: Any, points: np.ndarray, mesh: Mesh | None, lists: Faces, outer: OuterFaces | None
) -> Walls:
    walls = []
    patches = []
    faces = None
    if mesh is not None:
        faces = (outer or OuterFaces.numbered(mesh.linear.cells)).corners  # of a surface, its cells
    for slide in slides(sliding):
        nodes = np.unique(nodes_named(slide.patch, "sliding", mesh, len(points)))
        for name, listed in lists.items():
            check_none(
                nodes if np.isin(nodes, listed).all() else nodes[:0],
                f"all {{count}} nodes of {slide.name} are in `{name}`, first node {{node}} at "
                f"({{place}}): the patch would not "
                "slide. Remove them from one list.",
                points,
            )
        if any(np.array_equal(nodes, other) for other in patches):
            raise ValueError(
                f"{slide.name} comes twice in `sliding`. Its nodes slide along one surface. "
                "Remove one."
            )
        patches.append(nodes)
        walls += with_own_curves(walls_of_patch(slide, nodes, points, faces, lists["moving"]), mesh)
    return walls


def _guided(
    pairings: Sequence[Pairing],
    tracks: Sequence[Track],
    moving: np.ndarray,
    fixed: np.ndarray,
    points: np.ndarray,
) -> np.ndarray:
    """Lists sliding and periodic nodes in no list."""
    role = np.zeros(len(points), dtype=int)
    role[moving], role[fixed] = 1, 2
    for pairing in pairings:
        first = np.asarray(pairing.first)
        second = np.asarray(pairing.second)
        odd = np.flatnonzero(role[first] != role[second])
        if odd.size:
            words = ("in neither list", "in `moving`", "in `fixed`")
            worst = odd[0]
            raise MeshError(
                f"{len(odd)} periodic pairs have nodes in different lists: node {{node}} at "
                f"({place_of(points[first[worst]])}) is "
                f"{words[role[first[worst]]]}, its partner {second[worst]} "
                f"{words[role[second[worst]]]}. Name both nodes, or none.",
                first[odd],
            )
    parts = [
        np.zeros(0, dtype=np.int64),
        *(pairing.nodes for pairing in pairings),
        *(track.rows for track in tracks),
    ]
    nodes = np.unique(np.concatenate(parts))
    return nodes[role[nodes] == 0]


def renumbered(
    pairings: Sequence[Pairing], tracks: Sequence[Track], place: np.ndarray
) -> tuple[tuple[Pairing, ...], tuple[Track, ...]]:
    return tuple(pairing.renumbered(place) for pairing in pairings), tuple(
        track.renumbered(place) for track in tracks
    )


def checked_points(points: Any) -> np.ndarray:
    if isinstance(points, str | bytes) or points is None:
        raise ValueError(f"`prepare` takes a mesh or points first, not {points!r}. Call {USE}.")
    array = real_array("points", points, (None, 2), (None, 3))
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    check_finite(array)
    dtype = jax.dtypes.canonicalize_dtype(array.dtype)  # the precision of the plan
    size = np.abs(array).max(axis=1, initial=0)
    far = np.flatnonzero(size > np.finfo(dtype).max ** (1 / 3))
    if len(far):
        raise MeshError(
            f"{len(far)} of {len(array)} points are too far out for {dtype}, first node {{node}} "
            f"at {size[far[0]]:.3g}: "
            "volumes overflow. Choose a larger unit of length.",
            far,
        )
    extent = float(np.ptp(array, axis=0).max(initial=0)) if len(array) else 0.0
    if 0 < extent < SMALL * float(np.finfo(dtype).tiny) ** (1 / 3):
        raise ValueError(
            f"all {len(array)} points lie within {extent:.3g}, too near each other for {dtype}: "
            "volumes underflow. "
            "Choose a smaller unit of length."
        )
    return array


def check_finite(points: np.ndarray) -> None:
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    check_none(wrong, f"{{count}} of {len(points)} points are not finite, first node {{node}}.")


def names_in(values: Any) -> tuple[str, ...] | None:
    if isinstance(values, str):
        return (values,)
    is_list = isinstance(values, list | tuple | set | frozenset)
    return (
        tuple(values)
        if is_list and values and all(isinstance(name, str) for name in values)
        else None
    )


def nodes_named(values: Any, name: str, mesh: Mesh | None, n: int) -> Ids:
    names = names_in(values)
    if names is None:
        if values is None or isinstance(values, Mesh | Plane):
            raise ValueError(
                f"`{name}` must be node ids or names of patches, not {shown(values)}. Call {USE}."
            )
        if n == 0:
            raise ValueError(f"the mesh has no points. Call {USE}.")
        return rows_of(name, values, n)
    if mesh is None:
        raise ValueError(
            f"`{name}` names patches ({', '.join(map(repr, names))}), but points alone have no "
            "patches: pass the mesh, "
            f"prepare(mesh, ...), or node ids, mesh.patch({names[0]!r})."
        )
    return mesh.patch(*names).astype(np.int64)


def several(name: str, value: Any, kinds: type | tuple[type, ...], example: str) -> list[Any]:
    entries = [value] if isinstance(value, kinds) else value
    is_list = isinstance(entries, Sequence | set | frozenset) and not isinstance(
        entries, str | bytes
    )
    wrong = [entry for entry in entries if not isinstance(entry, kinds)] if is_list else [value]
    if wrong:
        raise ValueError(f"`{name}` holds {shown(wrong[0])}: pass {example}.")
    return list(entries)


def planes_named(symmetry: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Plane, ...]:
    planes: list[Plane] = []
    for entry in several("symmetry", symmetry, Plane if mesh is None else (Plane, str), PLANES):
        of_entry = (
            (entry,) if isinstance(entry, Plane) or mesh is None else Plane.of_patch(mesh, entry)
        )
        planes += [
            new for new in of_entry if not any(new.equals(plane, points) for plane in planes)
        ]
    return tuple(planes)


def slides(sliding: Any) -> list[Slide]:
    """Lists slides; a name slides along its own faces."""
    entries = several("sliding", sliding, (Slide, str), SLIDES)
    return [Slide(entry) if isinstance(entry, str) else entry for entry in entries]


def check_named_once(sliding: Any, **lists: Any) -> None:
    for slide in slides(sliding):
        for name, values in lists.items():
            both = set(names_in(slide.patch) or ()) & set(names_in(values) or ())
            if both:
                raise ValueError(
                    f"the patch {min(both)!r} is named in `sliding` and in `{name}`: it would not "
                    "slide. Remove it from one list."
                )


def by_kinds(
    mesh: Mesh, moving: Any, periodic: Sequence[Periodic], lists: Mapping[str, Any]
) -> tuple[Any, Any]:
    """Adds to `fixed` and `symmetry` of the lists by kinds in the file, where all are of names.

    Symmetry patches in no list that lie in planes slide. If only `moving` are named, all other
    outer patches with a kind are fixed. A warning names the choice.
    """
    is_alone = nothing_in(*lists.values())
    fixed, symmetry = lists["fixed"], lists["symmetry"]
    names = _names_of_all(moving, *lists.values())
    if names is None:
        return fixed, symmetry
    kinds = _outer_kinds(mesh, {*mesh.patch_names(*names)}.union(*(p.patches for p in periodic)))
    mirrors = [name for name in kinds if kinds[name] in SYMMETRY]
    others = [name for name in kinds if name not in mirrors] if is_alone else []
    mirrors = _in_planes(mesh, mirrors)
    clauses = _clauses(kinds, fixed=others, symmetry=mirrors)
    if clauses:
        alone = "No patches beside `moving` are named. " if is_alone else ""
        warn(f"{alone}By their kinds in the file {clauses}. Name the patches to choose otherwise.")
    return others or fixed, [*several("symmetry", symmetry, (Plane, str), PLANES), *mirrors]


def _names_of_all(moving: Any, *lists: Any) -> tuple[str, ...] | None:
    """Lists all names of patches; None where a list has ids, or nothing moves by name."""
    names = names_in(moving)
    for values in lists if names else ():
        entries = [values] if isinstance(values, str | Slide | Plane) else values
        for entry in entries if isinstance(entries, list | tuple | set | frozenset) else (None,):
            named = names_in(entry.patch if isinstance(entry, Slide) else entry)
            if names is None or (named is None and not isinstance(entry, Plane)):
                return None
            names += named or ()
    return names


def _clauses(kinds: Mapping[str, str], **lists: list[str]) -> str:
    shown = {
        name: ", ".join(f"{patch!r} ({kinds[patch]})" for patch in patches)
        for name, patches in lists.items()
    }
    return " and ".join(f"`{name}` are {patches}" for name, patches in shown.items() if patches)


def _outer_kinds(mesh: Mesh, elsewhere: set[str]) -> dict[str, str]:
    kinds = {
        name: kind
        for name, kind in mesh.kinds.items()
        if not kind.startswith(INSIDE) and len(mesh.patches[name])
    }
    return {name: kinds[name] for name in kinds if name not in elsewhere}


def _in_planes(mesh: Mesh, names: list[str]) -> list[str]:
    """Lists the patches that lie in planes; the caller must name a bent one."""
    flat = []
    planes = []
    for name in names:
        try:
            more = [*planes, *Plane.of_patch(mesh, name)]
            check_planes(more, np.asarray(mesh.points))
        except ValueError:
            continue
        flat = [*flat, name]
        planes = more
    return flat
