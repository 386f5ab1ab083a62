"""Tracks: the nodes that slide along one wall, or where two walls meet."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.package.errors import MeshError, place_of, worst_first
from .._kernels.values import norm
from .faces import Faceted, SmoothFaces
from .periodic import Pairing
from .symmetry import Plane
from .walls import AbstractWall, Flat, Round

STEPS = 6  # Newton steps to a curved wall, or to the edge between two walls; they converge quadratically
SMOOTH = np.cos(np.deg2rad(5))  # cosine of the angle below which two sliding patches meet without an edge


class Track(eqx.Module):
    """Nodes, `rows` (k,), that stay on one wall, or on the edge between two `walls`."""

    rows: Int[Array | np.ndarray, " k"]
    walls: tuple[AbstractWall, ...]

    @property
    def is_linear(self) -> bool:
        """True if all walls are flat: `along` is then linear in the displacements."""
        return all(wall.is_flat for wall in self.walls)

    def normals(self, points: Float[Array, "n d"]) -> Float[Array, "k w d"]:
        """In each row, orthogonal unit vectors that span the walls' normals. Traced."""
        places = self.project(points[self.rows])
        first, *others = (wall.height(places)[1] for wall in self.walls)
        frame = [first]
        for normal in others:
            rest = normal - jnp.sum(normal * first, axis=1, keepdims=True) * first
            frame.append(rest / norm(rest)[:, None])
        return jnp.stack(frame, axis=1)

    def along(self, points: Float[Array, "n d"], u: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Changes displacements so that the rows keep their distance from the walls. Traced."""
        start, displacement = points[self.rows], u[self.rows]
        if self.is_linear:
            normals = [jnp.asarray(wall.height(start[:1])[1][0]) for wall in self.walls]
            above = [jnp.matmul(displacement, normal, precision="highest") for normal in normals]
            tangential = displacement - _least(normals, above)
        else:
            tangential = self.project(start + displacement) - self.project(start)
        return u.at[self.rows].set(tangential)

    def project(self, x: Float[Array, "k d"]) -> Float[Array, "k d"]:
        only = self.walls[0] if len(self.walls) == 1 else None
        if isinstance(only, Faceted):
            return only.nearest(x)[0]
        is_exact = self.is_linear or (isinstance(only, Round) and only.spline is None)

        def nearer(x, _):
            above, normals = zip(*(wall.height(x) for wall in self.walls), strict=True)
            return x - _least(normals, above), None

        return nearer(x, None)[0] if is_exact else jax.lax.scan(nearer, x, length=STEPS)[0]

    def at(self, points: Float[Array, "n d"]) -> "Track":
        return Track(self.rows, tuple(wall.at(points) for wall in self.walls))

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "Track":
        return Track(place[np.asarray(self.rows)], tuple(wall.renumbered(place) for wall in self.walls))


def smoothed(track: Track) -> Track:
    walls = [
        SmoothFaces(wall.nodes, wall.vertices, wall.faces, wall.around) if type(wall) is Faceted else wall
        for wall in track.walls
    ]
    return Track(np.asarray(track.rows), tuple(walls))


def _least(normals, above):
    """The shortest vectors with the components `above` along one or two normals."""
    first, *others = (jnp.broadcast_to(normal, (len(above[0]), normal.shape[-1])) for normal in normals)
    if not others:
        return above[0][:, None] * first
    (second,) = others
    cosine = jnp.sum(first * second, axis=1)
    whole = 1 - cosine**2
    a, b = (above[0] - cosine * above[1]) / whole, (above[1] - cosine * above[0]) / whole
    return a[:, None] * first + b[:, None] * second


def tracks_of(
    walls: Sequence[tuple[AbstractWall, np.ndarray]], planes: Sequence[Plane], points: np.ndarray
) -> tuple[tuple[Track, ...], np.ndarray]:
    """Tracks of nodes of sliding patches, by walls, and nodes that cannot slide: corners, apex."""
    # A node has a row of flags: the walls and planes on which it lies. Equal rows are one track. A
    # node on as many walls as there are dimensions cannot slide.
    n, dimension = points.shape
    flags = np.zeros((n, len(walls) + len(planes)), dtype=bool)
    is_apex = np.zeros(n, dtype=bool)
    for k, (wall, nodes) in enumerate(walls):
        flags[nodes, k] = True
        is_apex[nodes] |= wall.is_apex(points[nodes])
    sliding = np.flatnonzero(flags.any(axis=1) & ~is_apex)
    for k, plane in enumerate(planes):
        flags[sliding, len(walls) + k] = plane.holds(points)[sliding]
    surfaces = [wall for wall, _ in walls] + [Flat(plane.normal, plane.origin) for plane in planes]
    groups, number = np.unique(flags[sliding], axis=0, return_inverse=True)
    tracks: list[Track] = []
    corners: list[np.ndarray] = [np.flatnonzero(is_apex)]
    for k, group in enumerate(groups):
        nodes = sliding[number.ravel() == k].astype(np.int32)
        chosen = tuple(surface for surface, is_on in zip(surfaces, group, strict=True) if is_on)
        if len(chosen) == 2:
            _check_edge(chosen, nodes, points)
        if len(chosen) < dimension:
            tracks.append(Track(nodes, chosen))
        else:
            corners.append(nodes)
    return tuple(tracks), np.concatenate(corners)


def _check_edge(walls: tuple[AbstractWall, ...], nodes: np.ndarray, points: np.ndarray) -> None:
    first, second = (np.asarray(wall.height(jnp.asarray(points[nodes]))[1]) for wall in walls)
    wrong = nodes[worst_first(np.abs(np.sum(first * second, axis=1)), SMOOTH)]
    if wrong.size:
        place = place_of(points[wrong[0]])
        raise MeshError(
            f"two sliding patches, or a sliding patch and a symmetry plane, meet at {len(wrong)} nodes without an edge, the worst "
            f"is node {{node}} at ({place}). Let both slide as one patch, jm.Slide((first, second)), or remove one.",
            wrong,
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
    exact, dimension = points.astype(float), points.shape[1]
    off = np.zeros((len(points), dimension, dimension))  # projections onto the normals of a node's walls
    off[corners] = np.eye(dimension)
    for track in tracks:
        normals = np.asarray(track.normals(jnp.asarray(exact)))
        off[track.rows] = np.swapaxes(normals, 1, 2) @ normals
    for pairing in pairings:
        first, second, matrix = map(np.asarray, (pairing.first, pairing.second, pairing.matrix))
        mismatch = np.linalg.norm(matrix @ off[first] @ matrix.T - off[second], axis=(1, 2))
        wrong = worst_first(mismatch * (free[first] & free[second]), np.sqrt(2 - 2 * SMOOTH**2))
        if wrong.size:
            node, partner = (int(side[wrong[0]]) for side in (first, second))
            raise MeshError(
                f"{len(wrong)} periodic pairs slide along walls that do not repeat each other, the worst is node {{node}} at "
                f"({place_of(points[node])}) and its partner {partner}: they cannot stay on both walls and move alike. Name them "
                "in `fixed`, or let both slide on a surface that repeats, jm.Slide(patch, jm.Plane(normal, origin)).",
                first[wrong],
            )
