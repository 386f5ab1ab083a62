"""Walls that no mesh can follow: they cross a boundary, leave the domain, or fold through it."""

import contextlib
import dataclasses
import itertools
from typing import Any

import numpy as np
from jaxtyping import Float

from .._host.cells.adjacency import parts_of
from .._host.cells.topology import solid
from .._host.linear.products import outward, row_lengths
from .._host.package.rounding import Tree, extent_of
from .._host.rows import Rows, join_ids
from .._host.surface.gaps import Passages, TooManyPairs, crossing_faces, passages
from .._host.tolerances import FLAT_CORNER, PLANAR, SAME
from .._mesh.mesh import Mesh
from .._mesh.topology import OuterFaces
from .._plan.plan import Plan
from .turn import Turn

STRIDE = np.deg2rad(20)  # angle of a turn that is taken for a straight way

UNKNOWN = (
    "walls may cross on their way: so many boundary faces come near each other that they were not "
    "compared. Is the motion meant to be so large? In several steps fewer do."
)


@dataclasses.dataclass(frozen=True, eq=False)
class Crossings:
    """Pairs of boundary faces that cross or touch only after the motion; true if there are any. If
    there are none, nodes of one face that have passed through another face on the way.

    - `nodes` (k, 2): one node of each of the two faces.
    - `patches`: names of both patches of each pair; "" without a patch.
    - `places` (k, d): a point of each crossing, in the mesh's unit.
    - `share`: of the motion, where a node first passes through a face; NaN where none does.
    - `beyond`: the largest distance of a node, after the motion, from where it has passed through.
    - `leaves`: whether a node has left the domain.
    - `crosses`: whether faces cross after the motion.
    - `is_known`: whether all of the way was looked at. Where too many faces come near each other,
      it is not, for that would take minutes.
    """

    nodes: np.ndarray
    patches: tuple[tuple[str, str], ...]
    places: np.ndarray
    share: float = np.nan
    beyond: float = 0.0
    leaves: bool = False
    crosses: bool = True
    is_known: bool = True

    def __len__(self) -> int:
        return len(self.nodes)

    def __str__(self) -> str:
        if not len(self):
            return "" if self.is_known else UNKNOWN
        place = ", ".join(f"{x:.4g}" for x in self.places[0])
        pairs = dict.fromkeys(tuple(sorted(pair)) for pair in self.patches)
        between = ", ".join(_and(*pair) for pair in pairs)
        count = f"{len(self)} {'pair' if len(self) == 1 else 'pairs'}"
        said = f"{count} of boundary faces cross each other after the motion"
        if not self.crosses:
            verb = "and leave the domain" if self.leaves else "on their way"
            said = f"walls pass through each other {verb}"
        where = (
            ""
            if np.isnan(self.share)
            else f" They meet after {100 * self.share:.3g} % of the motion, and end up to "
            f"{self.beyond:.3g} beyond."
        )
        return (
            f"{said} ({between}), first near ({place}).{where} No mesh can follow: move the wall "
            "less, or both walls together."
        )


def _and(first: str, second: str) -> str:
    one, other = (repr(name) if name else "faces of no patch" for name in (first, second))
    return f"{one} and itself" if first == second else f"{one} and {other}"


def wall_crossings(
    plan: Plan,
    mesh: Mesh,
    path: Float[np.ndarray, "k m d"],
    moved: np.ndarray | None = None,
    nodes: np.ndarray | None = None,
) -> Crossings:
    """Finds what walls cross on a path (k, m, d) of displacements, from rest on. Between two of
    them each connected body turns as in `Turn`. `nodes` are the mesh's ids
    of the plan's points. Where the whole mesh is, the points `moved` at the end are known, walls
    that pass through symmetry planes and free boundaries are found, too.
    """
    surface = np.asarray(plan.surface_nodes)
    ids = surface if nodes is None else np.asarray(nodes)[surface]
    points = np.asarray(mesh.points, dtype=float)
    cut = simplices(mesh, ids)
    inner = cut[0][(cut[0] < plan.n_moving).all(axis=1)]
    bodies = _number_bodies(inner, plan.n_moving)
    states = [
        np.asarray(plan.of_surface(u.astype(plan.points.dtype)), float)
        for u in turned_path(points[ids[: plan.n_moving]], np.asarray(path, float), bodies)
    ]
    if nodes is None and moved is not None:
        corners = [rows.ravel() for rows in _outer_of(mesh).corners.values()]
        rest = np.setdiff1d(np.concatenate([ids, *corners]), ids)
        way = np.asarray(moved, float)[rest] - points[rest]
        states = [np.concatenate([u, (k + 1) / len(states) * way]) for k, u in enumerate(states)]
        ids = np.concatenate([ids, rest])
        cut = simplices(mesh, ids)
    is_held = np.arange(len(ids)) < len(surface)
    for plane in plan.images.planes:
        is_held |= np.abs(plane.height(points[ids])) <= PLANAR * extent_of(points)
    return crossings(cut, mesh, ids, np.stack(states), len(surface), is_held)


def turned_path(
    points: Float[np.ndarray, "m d"], path: Float[np.ndarray, "k m d"], bodies: np.ndarray
) -> list[Float[np.ndarray, "m d"]]:
    """Refines a path (k, m, d): each of the `bodies` (m,) turns by `STRIDE` at most at once."""
    groups = [np.flatnonzero(bodies == body) for body in np.unique(bodies)]
    groups = [rows for rows in groups if len(rows) > 1]
    states = []
    start = np.zeros_like(points)
    for end in path:
        turns = [Turn.of((points + start)[rows], (end - start)[rows]) for rows in groups]
        count = int(np.ceil(max([turn.angle / STRIDE for turn in turns], default=0.0))) or 1
        for k in range(1, count):
            state = start + k / count * (end - start)
            for rows, turn in zip(groups, turns, strict=True):
                state[rows] = start[rows] + np.asarray(turn.at(k / count))
            states.append(state)
        states.append(end)
        start = end
    return states


def crossings(
    cut: tuple[np.ndarray, np.ndarray],
    mesh: Mesh,
    nodes: np.ndarray,
    states: Float[np.ndarray, "*k o d"],
    walls: int | None = None,
    is_held: np.ndarray | None = None,
) -> Crossings:
    """Finds where the boundary `cut` comes to cross itself as `nodes` (o,) move by `states`, their
    displacements (k, o, d) one after another, or at once (o, d). The first `walls` of the nodes are
    those of walls; others follow, and may be in each other's way. Faces of nodes that are not held
    (o,) follow the walls that they are connected with, well or badly: these do not pass them.
    """
    faces, ids = cut
    points = np.asarray(mesh.points, dtype=float)
    before = points[nodes]
    ways = [before, *(before + vectors for vectors in states.reshape(-1, *before.shape))]
    is_solid = np.arange(len(nodes)) < (len(nodes) if walls is None else walls)
    close = Tree(before).close_pairs(SAME * extent_of(points))
    place = parts_of(close[:, 0], close[:, 1], len(before))  # nearly coincident nodes are at one
    here = np.flatnonzero(is_solid[faces].all(axis=1))
    passed = Passages.none(points.shape[1])
    pairs = passed.pairs
    places = passed.places
    is_known = False
    with contextlib.suppress(TooManyPairs):
        pairs, places = crossing_faces(before, ways[-1], faces[here], place)
        pairs = here[pairs]
        passed = _join_passages(ways, faces, place, is_solid)
        is_known = True
    if is_held is not None:
        passed = _without_followers(passed, faces, is_held)
    crosses = len(pairs) > 0
    if crosses:
        single = np.sort(np.unique(np.sort(ids[pairs], axis=1), axis=0, return_index=True)[1])
        pairs = pairs[single]
        places = places[single]
        both = faces[pairs, 0]
    else:
        pairs = passed.pairs
        places = passed.places
        both = np.stack([passed.nodes, faces[pairs[:, 1], 0]], axis=1)
    first, second = (names_of(mesh, nodes[faces[pairs[:, k]]]) for k in range(2))
    facts = _facts_of(passed, faces, ways[-1]) | {"crosses": crosses, "is_known": is_known}
    return Crossings(nodes[both], tuple(zip(first, second, strict=True)), places, **facts)


def _without_followers(passed: Passages, faces: np.ndarray, is_held: np.ndarray) -> Passages:
    """Leaves out passages of faces that follow the wall that they are connected with."""
    sheet = _number_bodies(faces, len(is_held))
    face = faces[passed.pairs[:, 1]]
    follows = ~is_held[face].all(axis=1) & (sheet[face[:, 0]] == sheet[passed.nodes])
    return passed.at(np.flatnonzero(~follows))


def _facts_of(passed: Passages, faces: np.ndarray, end: np.ndarray) -> dict[str, Any]:
    """When nodes first pass faces, how far beyond they are at the end, whether they leave."""
    if not len(passed.nodes):
        return {}
    faced = end[faces[passed.pairs[:, 1]]].mean(axis=1)
    return {
        "share": float(passed.shares.min()),
        "beyond": float(row_lengths(end[passed.nodes] - faced).max()),
        "leaves": bool((np.bincount(passed.nodes, passed.senses) > 0).any()),
    }


def _join_passages(
    ways: list[np.ndarray], faces: np.ndarray, place: np.ndarray, is_solid: np.ndarray
) -> Passages:
    """Joins the passages of all steps, the first to come first. A body may graze itself on a way
    that is straight only here: of its own, they count where the body is turned inside out.
    """
    steps = []
    for k, (start, end) in enumerate(itertools.pairwise(ways)):
        step = passages(start, end, faces, place, is_solid)
        steps.append(step._replace(shares=(k + step.shares) / (len(ways) - 1)))
    every = Passages.joined(steps)
    moves = np.any([way != ways[0] for way in ways[1:]], axis=(0, 2))
    inner = faces[moves[faces].all(axis=1)]
    body = _number_bodies(inner, len(moves))
    other = faces[every.pairs[:, 1], 0]
    is_own = (body[every.nodes] == body[other]) & moves[every.nodes] & moves[other]
    kept = ~is_own | (_turned_out(ways, inner, body) < 0)[body[other]]
    return every.at(np.flatnonzero(kept)[np.argsort(every.shares[kept], kind="stable")])


def _number_bodies(faces: np.ndarray, count: int) -> np.ndarray:
    """Numbers the connected parts of so many rows, joined by faces."""
    first = np.repeat(faces[:, 0], faces.shape[1] - 1)
    return parts_of(first, faces[:, 1:].ravel(), count)


def _turned_out(ways: list[np.ndarray], faces: np.ndarray, body: np.ndarray) -> np.ndarray:
    """The volume of each body at the end over the one at the start; 1 for flat ones."""
    # A volume is a sum of pyramids from the body's middle to its faces. Those that point outwards
    # and inwards cancel; their sizes alone tell how flat the body is.
    count = body.max() + 1
    of = body[faces[:, 0]]
    volumes = []
    for x in (ways[0], ways[-1]):
        middle = x[faces].mean(axis=1)
        sums = np.stack([np.bincount(of, column, count) for column in middle.T], axis=1)
        arms = middle - (sums / np.maximum(np.bincount(of, minlength=count), 1)[:, None])[of]
        height = np.einsum("kd,kd->k", outward(x[faces]), arms)
        volumes.append((np.bincount(of, height, count), np.bincount(of, np.abs(height), count)))
    (start, size), (end, _) = volumes
    return np.where(np.abs(start) > FLAT_CORNER * size, end / np.where(start == 0, 1, start), 1.0)


def _outer_of(mesh: Mesh) -> OuterFaces:
    outer = mesh.outer_faces
    if outer is None:
        return OuterFaces.numbered(solid(mesh.linear.cells, mesh.points.shape[1] - 1))
    return outer


def simplices(mesh: Mesh, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cuts the boundary faces between `nodes` (o,) into simplices (f, d), rows of `nodes`, seen
    from outside. Also returns the number (f,) of the file's face of each. A
    mesh of a surface alone has its cells for faces.
    """
    outer = _outer_of(mesh)
    rows = Rows(nodes)
    faces = []
    ids = []
    for kind, corners in outer.corners.items():
        triangles = (
            [[0, 1, 2], [0, 2, 3]] if corners.shape[1] == 4 else [[*range(corners.shape[1])]]
        )
        faces.append(rows.of(corners[:, triangles]))
        ids.append(np.repeat(outer.ids[kind], len(triangles)))
    joined = join_ids(faces).reshape(-1, mesh.points.shape[1])
    known = (joined >= 0).all(axis=1)
    return joined[known], join_ids(ids)[known]


def names_of(mesh: Mesh, faces: np.ndarray) -> list[str]:
    """Names the smallest patch with all nodes of each face (k, corners); "" without any."""
    names = np.full(len(faces), "", dtype=object)
    for name, nodes in sorted(mesh.patches.items(), key=lambda item: -len(item[1])):
        names[Rows(nodes).mask(faces).all(axis=1)] = name
    return names.tolist()
