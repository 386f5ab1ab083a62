"""The boundary of a mesh, checked: what moves, stays, slides and repeats."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike, Real

from .._host.package.arguments import freeze
from .._host.package.errors import MeshError, check_none, place_of
from .._host.package.rounding import extent_of
from .._host.rows import join_ids, mark
from .._mesh.mesh import Mesh
from .conditions import Conditions
from .names import Named, Nodes
from .periodic import Pairing, Periodic, across_one_layer, check_pairings, merged, paired
from .slide import Slide, walls_of
from .symmetry import Mirrors, Plane, facing
from .tracks import Track, check_repeated, tracks_of


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Boundary(Conditions):
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
    finite, periodic patches that do not match, and sliding patches that leave their surface. Also
    for planes that hold no node or have nodes on both sides.
    """

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
        others = {"periodic": periodic, "sliding": sliding, "free": free}
        named = Named.of(mesh, moving, fixed, symmetry, **others)
        mirrors = Mirrors.of(named.planes, named.points)
        known = Conditions(
            points=named.points,
            moving=named.moving,
            free=named.free,
            planes=mirrors.planes,
            on=mirrors.on,
            mesh=patches,
            **_guides(named, mirrors, patches),
        )
        if patches is not None:
            known = known.with_mesh(patches)
        mirrors.check(known.points, known.loose)
        found = vars(known) | _guide_between(known)
        super().__init__(**jax.tree.map(freeze, found | {"mesh": None}) | {"mesh": patches})


def _guides(named: Named, mirrors: Mirrors, mesh: Mesh | None) -> dict[str, Any]:
    """Finds pairs, tracks, nodes that they guide, and `fixed` with corners, which cannot slide."""
    points = named.points
    size = float(extent_of(points))
    pairings = merged([paired(*pair, points) for pair in named.pairs], size)
    check_pairings(pairings, mirrors.planes, size)
    lists = {"fixed": named.fixed, "moving": named.moving}
    walls = walls_of(named.slides, points, mesh, lists)
    tracks, corners = tracks_of(walls, mirrors.planes, mirrors.on, points)
    check_none(
        corners[np.isin(corners, named.moving)],
        "{count} moving nodes are corners of sliding patches and cannot move, the first is "
        "node {node} at ({place}). Remove "
        "them from `moving`, or slide along fewer patches.",
        points,
    )
    check_repeated(tracks, corners, pairings, points, ~mark(len(points), named.fixed))
    fixed = np.append(named.fixed, corners[~np.isin(corners, named.fixed)])
    left = (Track(track.rows[~np.isin(track.rows, fixed)], track.walls) for track in tracks)
    tracks = tuple(track for track in left if len(track.rows))
    guided = _list_guided(pairings, tracks, named.moving, fixed, points)
    return {"pairings": pairings, "tracks": tracks, "guided": guided, "fixed": fixed}


def _list_guided(
    pairings: Sequence[Pairing],
    tracks: Sequence[Track],
    moving: np.ndarray,
    fixed: np.ndarray,
    points: np.ndarray,
) -> np.ndarray:
    """Lists sliding and periodic nodes in no list."""
    role = np.zeros(len(points), dtype=int)
    role[moving] = 1
    role[fixed] = 2
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
    parts = [pairing.nodes for pairing in pairings] + [track.rows for track in tracks]
    nodes = np.unique(join_ids(parts))
    return nodes[role[nodes] == 0]


def _guide_between(known: Conditions) -> dict[str, Any]:
    """Guides nodes of parallel planes in no list, and pairs them around one layer of cells.

    Two parallel mirrors have endless images. A field with some of them has a step beside the plane,
    by which cells invert. So parallel planes make no images, and their nodes are guided. Where
    planes hold all nodes, around one layer of cells, guided nodes that face each other move alike.
    """
    is_facing = known.on[:, facing(known.planes)].any(axis=1)
    between = np.setdiff1d(np.flatnonzero(is_facing), np.append(known.nodes, known.loose))
    if not len(between):
        return {}
    of_cells = np.delete(np.arange(len(known.points)), known.loose)
    layer = across_one_layer(known.planes, known.on[of_cells], known.points[of_cells])
    place = np.where(np.isin(of_cells, between), of_cells, -1)
    pairings = (*known.pairings, *(pairing.renumbered(place) for pairing in layer))
    guided = np.union1d(known.guided, between)
    return {"guided": guided, "between": between, "pairings": pairings}
