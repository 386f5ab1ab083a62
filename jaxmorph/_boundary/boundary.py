"""The boundary of `prepare`: names, ids and planes of a caller become checked node ids, planes, pairs and faces."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from .._host.cells.topology import solid
from .._host.package.arguments import as_array, shown
from .._host.package.errors import MeshError, place_of, warn
from .._host.surface.skin import has_free_faces
from .._mesh.mesh import Mesh
from .closest import AbstractWall, Flat, Track
from .outer_faces import FreeFaces, OuterFaces, free_faces, outer_faces
from .periodic import Pairing, Periodic, check_pairings, merged, paired
from .slide import Slide, check_repeated, tracks_of, walls_of_patch
from .symmetry import Plane, check_dimension, planes_through

USE = 'prepare(mesh, "airfoil", "farfield") with a Mesh, or prepare(points, moving_ids, fixed_ids)'

SMALL = 1e4
"""Least extent of a mesh, in lengths whose cube is the least normal number: cells are smaller than the mesh."""


@dataclasses.dataclass(frozen=True)
class Boundary:
    """A checked call of `prepare`.

    - `points` (n, d): base coordinates.
    - `moving` (m,), `fixed` (f,): node ids, no node twice.
    - `guided` (g,): node ids of sliding and periodic patches, and of parallel planes, that are in neither list.
    - `planes`: symmetry planes.
    - `pairings`: pairs of nodes that move alike.
    - `tracks`: nodes that stay on walls.
    - `faces`: the mesh's boundary faces (k, corners) by type, as node ids, or None if the cells are not known.
    - `left`: the faces that no list names, or None as well.
    - `is_open`: whether there are faces off the surface and the planes, free ones too, or None as well.
    - `cells`: node ids (k, corners) of the cells by type, or None as well, and for a part of a mesh.
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
        """The faces all of whose nodes are moving or fixed, as rows of `nodes`; None where faces are not known."""
        if self.faces is None:
            return None
        rows = {kind: _rows(self.nodes, len(self.points))[corners] for kind, corners in self.faces.items()}
        return {kind: corners[(corners >= 0).all(axis=1)] for kind, corners in rows.items()}

    def with_faces_of(
        self, mesh: Mesh, outer: OuterFaces | None = None, free: np.ndarray | Sequence[int] = ()
    ) -> "Boundary":
        """Adds the faces and cells of the mesh, and the `outer` faces that no list names."""
        outer = outer_faces(mesh) if outer is None else outer
        if outer is None:
            return self
        is_held = _listed(self.points, self.nodes, self.planes)
        is_open = has_free_faces(self.points, outer.corners, is_held)
        is_held[np.asarray(free, dtype=int)] = True
        cells = {kind: np.asarray(corners) for kind, corners in solid(mesh.linear.cells, self.points.shape[1]).items()}
        left = free_faces(mesh, outer, is_held)
        return dataclasses.replace(self, faces=outer.corners, left=left, is_open=is_open, cells=cells)

    def warn_of_free_faces(self) -> None:
        """Warns about boundary faces that no list names."""
        if self.left:
            warn(f"{self.left} Name them in `fixed`, `moving`, `symmetry` or `free`.")

    def part(self, nodes: np.ndarray) -> "Boundary":
        """Restricts the boundary to some `nodes` of the mesh: ascending ids with the whole surface."""
        moving, fixed, guided = (np.searchsorted(nodes, ids) for ids in (self.moving, self.fixed, self.guided))
        faces, surface = self.surface_faces, np.concatenate([moving, fixed, guided])
        faces = None if faces is None else {kind: surface[rows] for kind, rows in faces.items()}
        place = _rows(nodes, len(self.points))
        lists = moving, fixed, guided, self.planes, *renumbered(self.pairings, self.tracks, place)
        cells = self.cells if len(nodes) == len(self.points) else None
        return Boundary(self.points[nodes], *lists, faces, self.left, self.is_open, cells)

    def alone(self) -> "Boundary":
        """Restricts the boundary to the surface's nodes; the guided nodes are then in no list."""
        known = len(self.moving) + len(self.fixed)
        rows, place = np.arange(known), _rows(self.nodes, len(self.points))
        faces = self.surface_faces
        if faces is not None:
            faces = {kind: corners[(corners < known).all(axis=1)] for kind, corners in faces.items()}
        joined = renumbered(self.pairings, self.tracks, place)
        m, is_open = len(self.moving), None if faces is None else bool(self.tracks)
        lists = rows[:m], rows[m:], rows[:0], self.planes, *joined
        return Boundary(self.points[self.nodes], *lists, faces, None, is_open)


def renumbered(
    pairings: Sequence[Pairing], tracks: Sequence[Track], place: np.ndarray
) -> tuple[tuple[Pairing, ...], tuple[Track, ...]]:
    """Renumbers pairs and tracks: node k becomes `place[k]`."""
    return tuple(each.renumbered(place) for each in pairings), tuple(each.renumbered(place) for each in tracks)


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
    """Checks what `prepare` was given. Raises `ValueError` in one sentence that names the call to make.

    `outer` are the boundary faces where the cells of a `Mesh` are not there to tell them.
    """
    points = checked_points(mesh.points if isinstance(mesh, Mesh) else mesh)
    patches = mesh if isinstance(mesh, Mesh) else None
    _check_named_once(sliding, fixed=fixed, symmetry=symmetry)
    moving, fixed, free = (
        _nodes(ids, name, patches, len(points)) for ids, name in ((moving, "moving"), (fixed, "fixed"), (free, "free"))
    )
    unique, counts = np.unique(moving, return_counts=True)
    if len(unique) < len(moving):
        raise MeshError(
            f"{(counts > 1).sum()} nodes are named more than once in `moving`, first node {{node}}.", unique[counts > 1]
        )
    if len(moving) == 0:
        raise ValueError("`moving` is empty: name the nodes of the boundary that moves.")
    fixed = fixed[np.sort(np.unique(fixed, return_index=True)[1])]
    fixed = fixed[~np.isin(fixed, moving)]
    planes = _planes(symmetry, points, patches)
    if outer is None and patches is not None:
        outer = outer_faces(patches)
    pairings = _pairings(periodic, points, patches)
    lists = {"fixed": fixed, "moving": moving}
    tracks, corners = _tracks(sliding, points, patches, planes, lists, None if outer is None else outer.corners)
    if np.isin(corners, moving).any():
        corner = corners[np.isin(corners, moving)]
        raise MeshError(
            f"{len(corner)} moving nodes are corners of sliding patches and cannot move, the first is node {{node}} at "
            f"({place_of(points[corner[0]])}). Leave them out of `moving`, or slide along fewer patches.",
            corner,
        )
    is_free = np.isin(np.arange(len(points)), fixed, invert=True)
    check_repeated(tracks, corners, pairings, points, is_free)
    fixed = np.append(fixed, corners[~np.isin(corners, fixed)])
    tracks = tuple(Track(track.rows[~np.isin(track.rows, fixed)], track.walls) for track in tracks)
    tracks = tuple(track for track in tracks if len(track.rows))
    lists = moving, fixed, _guided(pairings, tracks, moving, fixed, points), planes, pairings, tracks
    boundary = Boundary(points, *lists, None, None, None)
    return boundary if patches is None else boundary.with_faces_of(patches, outer, free)


def checked_points(points: Any) -> np.ndarray:
    """Returns coordinates as a NumPy array (n, d) of float32 or float64. Raises `ValueError` for anything else."""
    if isinstance(points, str | bytes) or points is None:
        raise ValueError(f"`prepare` takes a mesh or points first, not {points!r}. Call {USE}.")
    try:
        array = points if isinstance(points, np.ma.MaskedArray) else np.asarray(points)
    except ValueError:
        raise ValueError(f"`points` is no array of numbers: its rows differ in length. Call {USE}.") from None
    if np.ma.is_masked(array):
        raise ValueError(f"`points` masks {np.ma.count_masked(array)} coordinates; every node needs all of its own.")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"`points` holds {array.dtype}, not real numbers. Call {USE}.")
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise ValueError(f"`points` has shape {array.shape}; expected (n, 2) or (n, 3).")
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        raise MeshError(
            f"{(~finite).sum()} of {len(array)} points are not finite, first node {{node}}.", np.flatnonzero(~finite)
        )
    dtype = jax.dtypes.canonicalize_dtype(array.dtype)  # what is computed in
    size = np.abs(array).max(axis=1, initial=0)
    far = np.flatnonzero(size > np.finfo(dtype).max ** (1 / 3))
    if len(far):
        raise MeshError(
            f"{len(far)} of {len(array)} points are too far out for {dtype}, first node {{node}} at {size[far[0]]:.3g}: "
            "volumes overflow. Choose another unit of length.",
            far,
        )
    extent = float(np.ptp(array, axis=0).max(initial=0)) if len(array) else 0.0
    if 0 < extent < SMALL * float(np.finfo(dtype).tiny) ** (1 / 3):
        raise ValueError(
            f"all {len(array)} points lie within {extent:.3g}, too near each other for {dtype}: volumes underflow. "
            "Choose another unit of length."
        )
    return array


def _names(values: Any) -> tuple[str, ...] | None:
    """Returns the names of patches, if `values` is one or several; None for anything else."""
    if isinstance(values, str):
        return (values,)
    is_list = isinstance(values, list | tuple | set | frozenset)
    return tuple(values) if is_list and values and all(isinstance(each, str) for each in values) else None


def _nodes(values: Any, name: str, mesh: Mesh | None, n: int) -> Int[np.ndarray, " k"]:
    names = _names(values)
    if names is None:
        return node_ids(values, name, n)
    if mesh is None:
        raise ValueError(
            f"`{name}` names patches ({', '.join(map(repr, names))}), but points alone have none: pass the mesh, "
            f"prepare(mesh, ...), or node ids, mesh.patch({names[0]!r})."
        )
    return mesh.patch(*names).astype(np.int64)


def node_ids(values: Any, name: str, n: int) -> Int[np.ndarray, " k"]:
    """Returns node ids as an array. Raises `ValueError` for what is no list of ids of a mesh of `n` points."""
    if values is None or isinstance(values, Mesh | Plane):
        raise ValueError(f"`{name}` must be node ids or names of patches, not {shown(values)}. Call {USE}.")
    ids = as_array(name, values)
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


def _planes(symmetry: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Plane, ...]:
    """Returns the planes, each once: patches are named where there is a mesh."""
    several = [symmetry] if isinstance(symmetry, Plane | str) else symmetry
    if not isinstance(several, Sequence | set | frozenset):
        raise ValueError(f"`symmetry` must be a Plane or several, not {shown(symmetry)}.")
    planes: list[Plane] = []
    for each in several:
        if isinstance(each, Plane):
            of_patch = (each,)
        elif isinstance(each, str) and mesh is not None:
            of_patch = planes_of(mesh, each)
        else:
            raise ValueError(
                f"`symmetry` holds {each!r}, which is no plane: pass jm.Plane(normal=(0, 1), origin=(0, 0)), "
                "jm.Plane.through(points, nodes), or the name of a patch where the first argument is a mesh."
            )
        planes += [new for new in of_patch if not any(new.equals(plane, points) for plane in planes)]
    return tuple(planes)


def planes_of(mesh: Mesh, name: str) -> tuple[Plane, ...]:
    """Finds the planes in which a patch lies. Raises `ValueError`, with the worst node, where it lies in none."""
    points, nodes = np.asarray(mesh.points), mesh.patch(name)

    def faces() -> Iterator[np.ndarray]:
        outer = outer_faces(mesh)
        every = mesh.cells if outer is None else outer.corners  # a part's cells are its outside
        yield from map(np.asarray, every.values())

    return planes_through(points, nodes, faces())


def _pairings(periodic: Any, points: np.ndarray, mesh: Mesh | None) -> tuple[Pairing, ...]:
    """Finds the pairs of nodes of periodic patches."""
    several = [periodic] if isinstance(periodic, Periodic) else periodic
    if not isinstance(several, Sequence) or not all(isinstance(pair, Periodic) for pair in several):
        raise ValueError(
            f"`periodic` must be pairs such as jm.Periodic('lower', 'upper', translation=(0, 1)), not {periodic!r}."
        )
    pairings = []
    for pair in several:
        first, second = (np.unique(_nodes(side, "periodic", mesh, len(points))) for side in (pair.patch, pair.partner))
        pairings.append(paired(pair, first, second, points))
    return merged(pairings, float(np.ptp(points, axis=0).max()))


def walls_of(
    mesh: Mesh, symmetry: Any, sliding: Any, periodic: Any, fixed: Any = ()
) -> tuple[list[tuple[AbstractWall, np.ndarray]], tuple[Pairing, ...]]:
    """Makes the walls of sliding patches and of symmetry planes, each with its nodes, and the periodic pairs.

    It takes and refuses what `prepare` does.
    """
    points = np.asarray(mesh.points)
    _check_named_once(sliding, symmetry=symmetry)
    outer = outer_faces(mesh)
    walls = _walls(sliding, points, mesh, {"fixed": np.asarray(fixed)}, None if outer is None else outer.corners)
    planes = _planes(symmetry, points, mesh)
    check_dimension(planes, mesh.points.shape[1])
    for plane in planes:
        walls.append((Flat(plane.normal, plane.origin), np.flatnonzero(plane.holds(points))))
    pairings = _pairings(periodic, points, mesh)
    check_pairings(pairings, planes, float(np.ptp(points, axis=0).max()))
    return walls, pairings


def _tracks(
    sliding: Any,
    points: np.ndarray,
    mesh: Mesh | None,
    planes: tuple[Plane, ...],
    lists: Mapping[str, np.ndarray],
    faces: Mapping[str, np.ndarray] | None,
) -> tuple[tuple[Track, ...], np.ndarray]:
    """Groups the sliding nodes by their walls; returns the nodes held between walls, too."""
    walls = _walls(sliding, points, mesh, lists, faces)
    return tracks_of(walls, planes if walls else (), points)


def _walls(
    sliding: Any,
    points: np.ndarray,
    mesh: Mesh | None,
    lists: Mapping[str, np.ndarray],
    faces: Mapping[str, np.ndarray] | None,
) -> list[tuple[AbstractWall, np.ndarray]]:
    """Makes the walls of sliding patches, each with its nodes. Raises `ValueError` for a patch that is in a list as a whole."""
    walls, patches = [], []
    for slide in slides(sliding):
        nodes = np.unique(_nodes(slide.patch, "sliding", mesh, len(points)))
        for name, listed in lists.items():
            if len(nodes) and np.isin(nodes, listed).all():
                place = place_of(points[nodes[0]])
                raise MeshError(
                    f"all {len(nodes)} nodes of {slide.name} are in `{name}`, first node {{node}} at ({place}): "
                    "it would not slide. Remove them from one of the two.",
                    nodes,
                )
        if any(np.array_equal(nodes, other) for other in patches):
            raise ValueError(f"{slide.name} is given twice. Its nodes slide along one surface. Remove one of the two.")
        patches.append(nodes)
        walls += walls_of_patch(slide, nodes, points, faces, lists.get("moving", ()))
    return walls


def slides(sliding: Any) -> tuple[Slide, ...]:
    """Returns a list of slides; a name becomes a slide along the patch's own faces.

    Raises `ValueError` for anything else.
    """
    if isinstance(sliding, type):
        raise ValueError(f"`sliding` is the class {sliding.__name__}: call it, sliding=jm.Slide('shroud').")
    several = [sliding] if isinstance(sliding, Slide | str) else sliding
    if not isinstance(several, Sequence | set | frozenset):
        raise ValueError(f"`sliding` must be a Slide or several, jm.Slide('shroud'), not {several!r}.")
    several = [Slide(slide) if isinstance(slide, str) else slide for slide in several if slide is not None]
    if not all(isinstance(slide, Slide) for slide in several):
        raise ValueError(
            f"`sliding` must be slides such as jm.Slide('shroud', jm.Revolution((1, 0, 0))), not {sliding!r}."
        )
    return tuple(several)


def _check_named_once(sliding: Any, **lists: Any) -> None:
    """Raises `ValueError` for a patch that slides and is in another list, where its nodes do not."""
    for slide in slides(sliding):
        for name, values in lists.items():
            both = set(_names(slide.patch) or ()) & set(_names(values) or ())
            if both:
                raise ValueError(
                    f"the patch {min(both)!r} is named in `sliding` and in `{name}`, and would not slide. Remove one of the two."
                )


def _guided(
    pairings: Sequence[Pairing], tracks: Sequence[Track], moving: np.ndarray, fixed: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Lists sliding and periodic nodes that are in no list. Raises `ValueError` where the partner of one is."""
    role = np.zeros(len(points), dtype=int)
    role[moving], role[fixed] = 1, 2
    for pairing in pairings:
        first, second = np.asarray(pairing.first), np.asarray(pairing.second)
        odd = np.flatnonzero(role[first] != role[second])
        if odd.size:
            words, worst = ("in neither list", "in `moving`", "in `fixed`"), odd[0]
            raise MeshError(
                f"{len(odd)} periodic pairs have nodes in different lists: node {{node}} at ({place_of(points[first[worst]])}) is "
                f"{words[role[first[worst]]]}, its partner {second[worst]} {words[role[second[worst]]]}. Name both, or neither.",
                first[odd],
            )
    nodes = [np.zeros(0, dtype=np.int64), *(pairing.nodes for pairing in pairings), *(track.rows for track in tracks)]
    every = np.unique(np.concatenate(nodes))
    return every[role[every] == 0]


def _listed(points: np.ndarray, listed: np.ndarray, planes: tuple[Plane, ...]) -> np.ndarray:
    """Marks (n,) nodes that are listed, or lie on a symmetry plane."""
    is_listed = np.zeros(len(points), dtype=bool)
    is_listed[listed] = True
    for plane in planes:
        is_listed |= plane.holds(points)
    return is_listed


def _rows(nodes: np.ndarray, n: int) -> np.ndarray:
    """Numbers (n,) the nodes by their rows, others by -1."""
    row = np.full(n, -1, dtype=np.int32)
    row[nodes] = np.arange(len(nodes))
    return row
