"""Tracks: the nodes that slide along one wall, or where two walls meet."""

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.linear.products import dot_rows
from .._host.package.errors import MeshError, check_none, place_of, worst_first
from .._host.tolerances import NO_EDGE
from .._kernels.values import Either
from .face_search import FLAT_FACES, SMOOTH_FACES, Places, solve_small
from .periodic import Nodal, Pairing
from .symmetry import Plane
from .walls import AbstractWall, Flat, OnFaces, Round

# Newton steps to a curved wall, or to the edge between two walls; they converge quadratically
PROJECTIONS = 6


class Track(eqx.Module):
    """Nodes, `rows` (k,), that stay on one wall, or on the edge between two `walls`."""

    rows: Int[Either, " k"]
    walls: tuple[AbstractWall, ...]

    @property
    def is_linear(self) -> bool:
        """True if all walls are flat: `along` is then linear in the displacements."""
        return all(wall.is_flat for wall in self.walls)

    def off(self, points: Nodal) -> Float[Array, "k d d"]:
        """The projections onto the walls' normals at the rows' places. Traced."""
        normals = self._heights(self.project(points[self.rows]))[1]
        return jax.vmap(_shortest, (None, 2), 2)(normals, normals)

    def along(self, points: Nodal, u: Nodal) -> Nodal:
        """Changes displacements so that the rows keep their distance from the walls. Traced."""
        start = points[self.rows]
        displacement = u[self.rows]
        if self.is_linear:
            normals = self._heights(start)[1]
            above = jnp.einsum("kwd,kd->kw", normals, displacement, precision="highest")
            tangential = displacement - _shortest(normals, above)
        else:
            tangential = self.project(start + displacement) - self.project(start)
        return u.at[self.rows].set(tangential)

    def _heights(self, x: Places) -> tuple[Float[Array, "k w"], Float[Array, "k w d"]]:
        above, normals = zip(*(wall.height(x) for wall in self.walls), strict=True)
        return jnp.stack(above, axis=1), jnp.stack(normals, axis=1)

    def project(self, x: Places) -> Places:
        only = self.walls[0] if len(self.walls) == 1 else None
        if isinstance(only, OnFaces):
            return only.own.closest(x)[0]
        is_exact = self.is_linear or (isinstance(only, Round) and only.is_straight)

        def nearer(x, _):
            above, normals = self._heights(x)
            return x - _shortest(normals, above), None

        return jax.lax.scan(nearer, x, length=1 if is_exact else PROJECTIONS)[0]

    def at(self, points: Nodal) -> "Track":
        return Track(self.rows, tuple(wall.at(points) for wall in self.walls))

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "Track":
        return Track(
            place[np.asarray(self.rows)], tuple(wall.renumbered(place) for wall in self.walls)
        )


def smoothed(track: Track) -> Track:
    """Lets the rows of a track slide on the smooth surface instead of flat faces."""
    return Track(np.asarray(track.rows), tuple(map(_smooth, track.walls)))


def _smooth(wall: AbstractWall) -> AbstractWall:
    if isinstance(wall, OnFaces) and wall.own.kind == FLAT_FACES:
        return OnFaces(dataclasses.replace(wall.own, kind=SMOOTH_FACES))
    return wall


def _shortest(normals: Float[Array, "k w d"], above: Float[Array, "k w"]) -> Places:
    """The shortest vectors with the components `above` along one or two normals."""
    gram = jnp.einsum("kvd,kwd->kvw", normals, normals, precision="highest")
    return jnp.einsum(
        "kw,kwd->kd", jax.vmap(solve_small)(gram, above), normals, precision="highest"
    )


def tracks_of(
    walls: Sequence[tuple[AbstractWall, np.ndarray]],
    planes: Sequence[Plane],
    on_plane: Bool[np.ndarray, "n p"],
    points: np.ndarray,
) -> tuple[tuple[Track, ...], np.ndarray]:
    """Tracks of nodes of sliding patches, by walls, and nodes that cannot slide: corners, apex."""
    # A node has a row of flags: the walls and planes on which it lies. Equal rows are one track. A
    # node on as many walls as there are dimensions cannot slide.
    n, dimension = points.shape
    surfaces = [wall for wall, _ in walls] + [Flat(plane.normal, plane.origin) for plane in planes]
    is_apex = np.zeros(n, dtype=bool)
    on_wall = np.zeros((n, len(walls)), dtype=bool)
    for k, (wall, nodes) in enumerate(walls):
        is_apex[nodes] |= wall.is_apex(points[nodes])
        on_wall[nodes, k] = True
    sliding = np.flatnonzero(on_wall.any(axis=1) & ~is_apex)
    flags = np.concatenate([on_wall, on_plane], axis=1)[sliding]
    groups, number = np.unique(flags, axis=0, return_inverse=True)
    tracks: list[Track] = []
    corners: list[np.ndarray] = [np.flatnonzero(is_apex)]
    for k, group in enumerate(groups):
        nodes = sliding[number.ravel() == k].astype(np.int32)
        chosen = tuple(itertools.compress(surfaces, group))
        if len(chosen) == 2:
            _check_edge(chosen, nodes, points)
        if len(chosen) < dimension:
            tracks.append(Track(nodes, chosen))
        else:
            corners.append(nodes)
    return tuple(tracks), np.concatenate(corners)


def _check_edge(walls: tuple[AbstractWall, ...], nodes: np.ndarray, points: np.ndarray) -> None:
    first, second = (np.asarray(wall.height(jnp.asarray(points[nodes]))[1]) for wall in walls)
    check_none(
        nodes[worst_first(np.abs(dot_rows(first, second)), NO_EDGE)],
        "two sliding patches, or a sliding patch and a symmetry plane, meet at {count} nodes "
        "without an edge, the worst "
        "is node {node} at ({place}). Let both slide as one patch, jm.Slide((first, second)), or "
        "remove one.",
        points,
    )


def check_repeated(
    tracks: Sequence[Track],
    corners: np.ndarray,
    pairings: Sequence[Pairing],
    points: np.ndarray,
    free: Bool[np.ndarray, " n"],
) -> None:
    if not tracks or not pairings:
        return
    exact = points.astype(float)
    dimension = points.shape[1]
    off = np.zeros(
        (len(points), dimension, dimension)
    )  # projections onto the normals of a node's walls
    off[corners] = np.eye(dimension)
    for track in tracks:
        off[track.rows] = track.off(jnp.asarray(exact))
    for pairing in pairings:
        first, second, matrix = map(np.asarray, (pairing.first, pairing.second, pairing.matrix))
        mismatch = np.linalg.norm(matrix @ off[first] @ matrix.T - off[second], axis=(1, 2))
        wrong = worst_first(mismatch * (free[first] & free[second]), np.sqrt(2 - 2 * NO_EDGE**2))
        if wrong.size:
            node, partner = (int(side[wrong[0]]) for side in (first, second))
            raise MeshError(
                f"{len(wrong)} periodic pairs slide along walls that do not repeat each other, "
                f"the worst is node {{node}} at "
                f"({place_of(points[node])}) and its partner {partner}: they cannot stay on both "
                "walls and move alike. Name them "
                "in `fixed`, or let both slide on a surface that repeats, jm.Slide(patch, "
                "jm.Plane(normal, origin)).",
                first[wrong],
            )
