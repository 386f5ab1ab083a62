"""A solver's surface of points and faces: what moves by it, and a piece of mesh that follows it."""

import dataclasses
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.extend import closest, fans, float64_mode

from .. import mpi

WORDS = {"overset": "overset", "wall": "wall", r"(?<![a-z])(bc)?sym": "symmetry"}
"""What a patch is, by a word in its kind or its name."""
PART = 0.5
"""Share of a patch's nodes on the surface, from which the patch belongs to it."""
SAME = 1e-12
"""Distance of duplicate points, as a share of the surface's extent."""
AT = 1e-6
"""Distance of a wall node from its surface point, as a share of the points' spacing."""
NEAR = 0.1
"""Distance of a node from its face, as a share of its longest edge: facets cut corners."""


@dataclasses.dataclass(frozen=True, eq=False)
class Definition:
    """A surface: points (s, 3) of all processes in turn, and triangles (t, 3) between them."""

    points: Float[np.ndarray, "s 3"]
    triangles: Int[np.ndarray, "t 3"]

    @staticmethod
    def gathered(comm: Any, points: np.ndarray, conn: np.ndarray, sizes: np.ndarray) -> "Definition":
        shares = comm.allgather((points, fans(conn, sizes)))
        firsts = np.cumsum([0, *(len(share[0]) for share in shares)])
        corners = [share[1] + first for share, first in zip(shares, firsts, strict=False)]
        return Definition(np.concatenate([share[0] for share in shares]), np.concatenate(corners))

    def weights(self, x: Float[np.ndarray, "k 3"]) -> tuple[Any, np.ndarray, np.ndarray]:
        """Computes sparse weights (k, s) by which the surface's points move nodes `x`.

        A node at a place of the surface moves with the mean of its points. Another node moves as
        the closest point of the faces, or as the three nearest places without faces. Rows sum to
        one. Also returned: each node's distance (k,) from the surface, and the largest distance
        (k,) of a node on it.
        """
        place, at = self._places()
        tree = KDTree(place)
        away, nearest = (np.reshape(answer, (len(x), -1)) for answer in tree.query(x, k=min(3, len(place))))
        limit = _spacing(place)[nearest[:, 0]]
        is_point = away[:, 0] <= AT * limit
        inverse = 1 / np.maximum(away, np.finfo(float).tiny ** 0.25) ** 2
        inverse = np.where(is_point[:, None], np.arange(away.shape[1]) == 0, inverse)
        missing = ((0, 0), (0, 3 - away.shape[1]))
        columns, shares = np.pad(nearest, missing), np.pad(inverse / inverse.sum(axis=1, keepdims=True), missing)
        away = away[:, 0]
        if len(self.triangles):
            corners, off = at[self.triangles], np.flatnonzero(~is_point)
            chosen, inside, away[off] = closest(place[corners], x[off])
            columns[off], shares[off] = corners[chosen], inside
            sides = place[corners] - np.roll(place[corners], 1, axis=1)
            limit[off] = NEAR * np.linalg.norm(sides, axis=2).max(axis=1)[chosen]
        rows = np.repeat(np.arange(len(x)), 3)
        of_places = csr_array((shares.ravel(), (rows, columns.ravel())), (len(x), len(place)))
        means = csr_array((1 / np.bincount(at)[at], (at, np.arange(len(at)))), (len(place), len(at)))
        return of_places @ means, away, limit

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Finds the points' places (g, 3), and each point's place (s,): solvers repeat points."""
        place, at = np.unique(self.points, axis=0, return_inverse=True)
        same = KDTree(place).query_pairs(SAME * np.ptp(place, axis=0).max(), output_type="ndarray")
        graph = csr_array((np.ones(len(same)), (same[:, 0], same[:, 1])), (len(place), len(place)))
        part = connected_components(graph, directed=False)[1]
        return place[np.unique(part, return_index=True)[1]], part[at.ravel()]


def _spacing(points: np.ndarray) -> np.ndarray:
    """Each point's distance (n,) from its nearest neighbour; infinite for one point."""
    return np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]


def patches_by_kind(mesh: jm.Mesh, options: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Lists patches of `wall`, `symmetry` and `overset` by option, kind in the file, or name."""
    kinds: dict[str, list[str]] = {kind: [] for kind in (*WORDS.values(), "")}
    for name in mesh.patches:
        kinds[_kind_of(mesh, name)].append(name)
    for kind, option in (("wall", "specifiedSurfaces"), ("symmetry", "symmetrySurfaces")):
        if options[option] is not None:
            kinds[kind] = _named(mesh, options[option], option)
    if options["symmetryPlanes"] is not None:
        kinds["symmetry"] = _in_planes(mesh, _planes(mesh, options))
    walls, _ = kinds.pop("wall"), kinds.pop("")
    return {kind: tuple(name for name in names if name not in walls) for kind, names in kinds.items()} | {
        "wall": tuple(walls)
    }


def _in_planes(mesh: jm.Mesh, planes: Sequence[jm.Plane]) -> list[str]:
    on = np.zeros(len(mesh.points), bool)
    for plane in planes:
        on |= plane.holds(np.asarray(mesh.points, dtype=float))
    return [name for name, nodes in mesh.patches.items() if on[np.asarray(nodes)].all()]


def _kind_of(mesh: jm.Mesh, name: str) -> str:
    text = mesh.kinds.get(name, name).lower()
    kind = next((kind for word, kind in WORDS.items() if re.search(word, text)), "")
    return kind or ("overset" if "overset" in name.lower() else "")  # no type of CGNS says so


def _named(mesh: jm.Mesh, names: Sequence[str], option: str) -> list[str]:
    wanted = {name.lower() for name in names}
    missing = sorted(wanted - {name.lower() for name in mesh.patches})
    if missing:
        raise ValueError(f"`{option}`: no patch {', '.join(missing)}; there are {', '.join(mesh.patches)}.")
    return [name for name in mesh.patches if name.lower() in wanted]


def _planes(mesh: jm.Mesh, options: Mapping[str, Any]) -> list[jm.Plane]:
    planes, points = [], np.asarray(mesh.points, dtype=float)
    for origin, normal in options["symmetryPlanes"]:
        plane = jm.Plane(normal, origin)
        near = np.flatnonzero(np.abs(plane.height(points)) <= options["symmTol"])
        if not plane.holds(points)[near].all():
            through = jm.Plane.through(points, near)
            plane = through if abs(float(plane.normal @ through.normal)) > 0.99 else plane
        planes.append(plane)
    return planes


def boundary_of(
    mesh: jm.Mesh, options: Mapping[str, Any], surface: Definition, is_own: bool
) -> tuple[jm.Boundary, csr_array]:
    """Finds the mesh's boundary, and the surface's weights (m, s) of the moving nodes.

    With `is_own` the surface is the nodes of the wall patches. Otherwise it is a solver's: nodes
    move in patches with half of their nodes on its faces, walls first. All other patches but
    symmetry, periodic and overset ones are fixed.
    """
    kinds, points = patches_by_kind(mesh, options), np.asarray(mesh.points, dtype=float)
    walls, periodic = kinds["wall"], io.periodic(mesh)
    loose = {*kinds["symmetry"], *kinds["overset"]}
    moving = mesh.patch(*walls) if is_own else _on_surface(mesh, surface, walls, loose)
    loose |= {str(name) for pair in periodic for name in (pair.patch, pair.partner)}
    fixed = mesh.patch(*(name for name in mesh.patches if name not in loose))
    free = np.setdiff1d(mesh.patch(*kinds["overset"]), np.concatenate([fixed, moving]))
    symmetry = kinds["symmetry"] if options["symmetryPlanes"] is None else _planes(mesh, options)
    fixed = np.setdiff1d(fixed, moving)
    boundary = jm.Boundary(mesh, moving, fixed, symmetry=symmetry, periodic=periodic, free=free)
    return boundary, surface.weights(points[moving])[0]


def _on_surface(mesh: jm.Mesh, surface: Definition, walls: Sequence[str], loose: Collection[str]) -> np.ndarray:
    points = np.asarray(mesh.points, dtype=float)
    for names in (walls, [name for name in mesh.patches if name not in loose]):
        found = []
        for nodes in (np.asarray(mesh.patches[name]) for name in names if len(mesh.patches[name]) > 1):
            _, away, limit = surface.weights(points[nodes])
            is_on = away <= np.maximum(limit, NEAR * _spacing(points[nodes]))
            if is_on.mean() >= PART:
                found.append(nodes[is_on])
        if found:
            return np.unique(np.concatenate(found))
    low, high = (tuple(np.round(extreme(surface.points, axis=0), 6)) for extreme in (np.min, np.max))
    raise ValueError(
        f"no patch of the mesh lies on the surface that is defined, {len(surface.points)} points between {low} and {high}: "
        f"its unit, or its place, is not that of the mesh, whose patches are {', '.join(mesh.patches)}."
    )


class Follower:
    """Moves the mesh with the surface's points; this process has the points `coordinates` (k, 3).

    `weights` (m, s) lead from the points of all processes to the moving nodes of the whole mesh.
    """

    def __init__(self, piece: mpi.Piece, weights: Any, points: np.ndarray):
        self.piece, self.weights, self.points = piece, weights, points
        self.coordinates = points.copy()
        counts = piece.comm.allgather(len(points))
        self.first = sum(counts[: piece.comm.rank])
        self.copies = dataclasses.replace(piece, is_owner=np.ones_like(piece.is_owner))

    def deform(self, dof: int = 0, step: float = 0.0) -> np.ndarray:
        """Moves the piece, with a step of one coordinate of the points of all processes."""
        with float64_mode():
            return self.piece.deform(self._u(self._displacement(dof, step)))

    def pushforward(self, tangent: np.ndarray) -> np.ndarray:
        with float64_mode():
            return self.piece.pushforward(self._u(self._displacement()), self._u(tangent))

    def pullback(self, cotangent: np.ndarray) -> np.ndarray:
        """Pulls back a derivative by all processes' nodes: derivatives by a shared node add up."""
        with float64_mode():
            share = self.copies.pullback(self._u(self._displacement()), cotangent)
        moving = np.zeros((self.weights.shape[0], 3))
        for rows, values in self.piece.comm.allgather((self.piece.rows, share)):
            moving[rows] = values
        total = self.weights.T @ moving
        return total[self.first : self.first + len(self.points)]

    def _displacement(self, dof: int = 0, step: float = 0.0) -> np.ndarray:
        u = self.coordinates - self.points
        if 0 <= dof - 3 * self.first < u.size:
            u.ravel()[dof - 3 * self.first] += step
        return u

    def _u(self, values: np.ndarray) -> np.ndarray:
        everywhere = np.concatenate(self.piece.comm.allgather(values))
        return (self.weights @ everywhere)[self.piece.rows]
