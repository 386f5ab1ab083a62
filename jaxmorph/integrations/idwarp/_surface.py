"""A solver's surface of points and faces: what moves by it, and a piece of mesh that follows it."""

import dataclasses
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.sparse import csr_array

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.extend import Tree, closest, fans, float64_mode, join_ids, parts_of, spacing

from .. import mpi
from ._grid import GridPoints

PATCH_WORDS = {"overset": "overset", "wall": "wall", r"(?<![a-z])(bc)?sym": "symmetry"}
"""What a patch is, by a word in its kind or its name."""
PART = 0.5
"""Share of a patch's nodes on the surface, from which the patch belongs to it."""
SAME_PLACE = 1e-12
"""Distance of duplicate points, as a share of the surface's extent."""
NEAR_FACE = 0.1
"""Distance of a node from its face, as a share of its longest edge: facets cut corners."""


@dataclasses.dataclass(frozen=True, eq=False)
class Definition:
    """A surface: points (s, 3) of all processes in turn, and triangles (t, 3) between them."""

    points: Float[ndarray, "s 3"]
    triangles: Int[ndarray, "t 3"]

    @staticmethod
    def gathered(comm: Any, points: ndarray, conn: ndarray, sizes: ndarray) -> "Definition":
        shares, triangles = zip(*comm.allgather((points, fans(conn, sizes))), strict=True)
        firsts = np.cumsum([0, *map(len, shares)])
        corners = [own + first for own, first in zip(triangles, firsts, strict=False)]
        return Definition(np.concatenate(shares), np.concatenate(corners))

    def weights(self, x: GridPoints) -> tuple[Any, ndarray, ndarray]:
        """Computes sparse weights (k, s) by which the surface's points move nodes `x`.

        A node moves as the closest point of the faces, or without faces as the three nearest
        places, each with the mean of its points: solvers repeat points. Rows sum to one. Also
        returned: each node's distance (k,) from the surface, and the largest distance (k,) of a
        node on it.
        """
        same = Tree(self.points).close_pairs(SAME_PLACE * np.ptp(self.points, axis=0).max())
        at = parts_of(same[:, 0], same[:, 1], len(self.points))
        place = self.points[np.unique(at, return_index=True)[1]]
        if len(self.triangles):
            corners = at[self.triangles]
            chosen, shares, away = closest(place[corners], x)
            edges = np.linalg.norm(place[corners] - place[np.roll(corners, 1, axis=1)], axis=2)
            columns = corners[chosen]
            limit = NEAR_FACE * edges.max(axis=1)[chosen]
        else:
            count = min(3, len(place))
            near, columns = Tree(place).query(x, k=range(1, count + 1))
            inverse = 1 / np.maximum(near, np.finfo(float).tiny ** 0.25) ** 2
            shares = inverse / inverse.sum(axis=1, keepdims=True)
            away = near[:, 0]
            limit = spacing(place)[columns[:, 0]]
        rows = np.repeat(np.arange(len(x)), columns.shape[1])
        of_places = csr_array((shares.ravel(), (rows, columns.ravel())), (len(x), len(place)))
        means = csr_array(
            (1 / np.bincount(at)[at], (at, np.arange(len(at)))), (len(place), len(at))
        )
        return of_places @ means, away, limit


def patches_by_kind(mesh: jm.Mesh, options: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Lists patches of `wall`, `symmetry` and `overset` by option, kind in the file, or name."""
    found: dict[str, list[str]] = {kind: [] for kind in (*PATCH_WORDS.values(), "")}
    for name in mesh.patches:
        found[_kind_of_patch(mesh, name)].append(name)
    for kind, option in (("wall", "specifiedSurfaces"), ("symmetry", "symmetrySurfaces")):
        if options[option] is not None:
            found[kind] = _patches_named(mesh, options[option], option)
    if options["symmetryPlanes"] is not None:
        on = np.zeros(len(mesh.points), bool)
        for plane in _read_planes(mesh, options):
            on |= plane.holds(_find_places(mesh))
        found["symmetry"] = [name for name, nodes in mesh.patches.items() if on[nodes].all()]
    walls = found.pop("wall")
    others = {
        kind: tuple(name for name in names if name not in walls)
        for kind, names in found.items()
        if kind
    }
    return others | {"wall": tuple(walls)}


def _find_places(mesh: jm.Mesh) -> ndarray:
    return np.asarray(mesh.points, dtype=float)


def _kind_of_patch(mesh: jm.Mesh, name: str) -> str:
    text = mesh.kinds.get(name, name).lower()
    kind = next((kind for word, kind in PATCH_WORDS.items() if re.search(word, text)), "")
    return kind or ("overset" if "overset" in name.lower() else "")  # no type of CGNS says so


def _patches_named(mesh: jm.Mesh, names: Sequence[str], option: str) -> list[str]:
    wanted = {name.lower() for name in names}
    missing = sorted(wanted - {name.lower() for name in mesh.patches})
    if missing:
        raise ValueError(
            f"`{option}`: no patch {', '.join(missing)}; there are {', '.join(mesh.patches)}."
        )
    return [name for name in mesh.patches if name.lower() in wanted]


def _read_planes(mesh: jm.Mesh, options: Mapping[str, Any]) -> list[jm.Plane]:
    planes = []
    points = _find_places(mesh)
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
    kinds = patches_by_kind(mesh, options)
    points = _find_places(mesh)
    walls = kinds["wall"]
    periodic = io.periodic(mesh)
    loose = {*kinds["symmetry"], *kinds["overset"]}
    moving = mesh.patch(*walls) if is_own else _on_surface(mesh, surface, walls, loose)
    loose |= {str(name) for pair in periodic for name in (pair.patch, pair.partner)}
    fixed = mesh.patch(*(name for name in mesh.patches if name not in loose))
    free = np.setdiff1d(mesh.patch(*kinds["overset"]), np.concatenate([fixed, moving]))
    symmetry = (
        kinds["symmetry"] if options["symmetryPlanes"] is None else _read_planes(mesh, options)
    )
    fixed = np.setdiff1d(fixed, moving)
    boundary = jm.Boundary(mesh, moving, fixed, symmetry=symmetry, periodic=periodic, free=free)
    return boundary, surface.weights(points[moving])[0]


def _on_surface(
    mesh: jm.Mesh, surface: Definition, walls: Sequence[str], loose: Collection[str]
) -> ndarray:
    for names in (walls, [name for name in mesh.patches if name not in loose]):
        found = []
        for nodes in (np.asarray(mesh.patches[name]) for name in names):
            if len(nodes) < 2:
                continue
            x = _find_places(mesh)[nodes]
            _, away, limit = surface.weights(x)
            is_on = away <= np.maximum(limit, NEAR_FACE * spacing(x))
            if is_on.mean() >= PART:
                found.append(nodes[is_on])
        if found:
            return np.unique(join_ids(found))
    low = np.round(surface.points.min(axis=0), 6).tolist()
    high = np.round(surface.points.max(axis=0), 6).tolist()
    raise ValueError(
        f"no patch of the mesh lies on the surface that is defined, {len(surface.points)} points "
        f"between {low} and {high}: "
        "its unit, or its place, is not that of the mesh, whose patches are "
        f"{', '.join(mesh.patches)}."
    )


class Follower:
    """Moves the mesh with the surface's `points` (k, 3), of which this process has some.

    `weights` (m, s) lead from the points of all processes to the moving nodes of the whole mesh;
    `own` are the rows of this process' points among all.
    """

    def __init__(self, piece: mpi.Piece, weights: Any, points: ndarray):
        self.piece = piece
        self.weights = weights
        self.points = points
        first = sum(piece.comm.allgather(len(points))[: piece.comm.rank])
        self.own = slice(first, first + len(points))
        self.copies = dataclasses.replace(piece, is_owner=np.ones_like(piece.is_owner))

    def deform(self, coordinates: ndarray) -> ndarray:
        with float64_mode():
            return self.piece.deform(self._u(coordinates - self.points))

    def pushforward(self, coordinates: ndarray, tangent: ndarray) -> ndarray:
        with float64_mode():
            return self.piece.pushforward(self._u(coordinates - self.points), self._u(tangent))

    def pullback(self, coordinates: ndarray, cotangent: ndarray) -> ndarray:
        """Pulls back a derivative by all processes' nodes: derivatives by a shared node add up."""
        with float64_mode():
            share = self.copies.pullback(self._u(coordinates - self.points), cotangent)
        moving = np.zeros((self.weights.shape[0], 3))
        for rows, values in self.piece.comm.allgather((self.piece.rows, share)):
            moving[rows] = values
        return (self.weights.T @ moving)[self.own]

    def _u(self, values: ndarray) -> ndarray:
        return (self.weights @ np.concatenate(self.piece.comm.allgather(values)))[self.piece.rows]
