"""The arguments of `prepare`: names become checked node ids, planes, pairs, walls and faces."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._host.package.errors import MeshError, place_of
from .._mesh.mesh import Mesh
from .boundary import Boundary
from .curved_faces import with_own_curves
from .matching import paired
from .names import check_named_once, checked_points, nodes_named, planes_named, slides
from .outer_faces import OuterFaces, outer_faces
from .pairing import Pairing, check_pairings, merged
from .periodic import Periodic
from .slide import walls_of_patch
from .symmetry import check_dimension
from .tracks import Track, check_repeated, tracks_of
from .walls import AbstractWall, Flat


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
    guided = _guided(pairings, tracks, moving, fixed, points)
    boundary = Boundary(points, moving, fixed, guided, planes, pairings, tracks)
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
        own = walls_of_patch(slide, nodes, points, faces, lists.get("moving", ()))
        walls += with_own_curves(own, mesh)
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
