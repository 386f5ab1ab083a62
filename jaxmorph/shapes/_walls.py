"""Walls of a mesh and their measures for constraints.

A wall in 2-D is a loop: ids (k,) of its nodes in order, counter-clockwise, without repeating the
first. A wall in 3-D is a set of triangles (k, 3) or quads (k, 4), outward from what they enclose.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy import ndarray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import depth_first_order

from jaxmorph import Mesh, Plane, boundary_faces
from jaxmorph.extend import Module, area_vectors, checked, finite_array, is_known, norm

from ._arguments import (
    Numbers,
    Positions,
    Scalar,
    Vector,
    cast,
    known_positions,
    positions,
    rows_like,
    vector,
)
from ._features import height_of
from ._tolerances import ALONG_FACE, IN_PLANE, SAME_LENGTH


@checked
def wall_loop(mesh: Mesh, patch: str) -> Int[ndarray, " k"]:
    """Finds the nodes (k,) of a closed wall, a patch of a mesh in 2-D, in order, counter-clockwise.

    **Raises:** `ValueError` for a patch that is not one closed loop.
    """
    segments = wall_faces(mesh, patch).get("line", np.zeros((0, 2), int))
    ends, number, degree = np.unique(segments, return_inverse=True, return_counts=True)
    bad = ends[degree != 2]
    if len(bad) or not len(ends):
        raise ValueError(
            f"patch {patch!r} is no closed loop: {len(bad)} ends or branches, first nodes "
            f"{bad[:1]}."
        )
    links = coo_array((np.ones(len(segments)), number.reshape(-1, 2).T), (len(ends), len(ends)))
    loop = depth_first_order(links, 0, directed=False, return_predecessors=False)
    if len(loop) != len(ends):
        raise ValueError(
            f"patch {patch!r} is several loops: {len(loop)} of its {len(ends)} nodes hang together."
        )
    ids = ends[loop]
    x, y = np.asarray(mesh.points)[ids].T
    return ids if x @ np.roll(y, -1) > y @ np.roll(x, -1) else ids[::-1].copy()


@checked
def wall_normals(mesh: Mesh, *patches: str) -> Float[ndarray, "m d"]:
    """Sums the areas of a wall's faces at its nodes: vectors from the body into the mesh.

    A face gives each corner an equal share. Solvers take the side of an airfoil's node from the
    sum.

    **Returns:** vectors (m, d), in the order of `mesh.patch(*patches)`; 0 for a node of no face.
    **Raises:** `ValueError` for patches without faces on the boundary of the mesh's cells.
    """
    nodes = mesh.patch(*patches)
    points = np.asarray(mesh.points, float)
    normals = np.zeros_like(points)
    for ids in wall_faces(mesh, *patches).values():
        np.add.at(normals, ids, -area_vectors(points[ids])[:, None] / ids.shape[1])
    return normals[nodes]


def wall_faces(mesh: Mesh, *patches: str) -> dict[str, ndarray]:
    faces = {kind: ids for kind, ids in boundary_faces(mesh, *patches).items() if len(ids)}
    if not faces:
        raise ValueError(
            f"patch {', '.join(patches)} has no faces on the boundary of the mesh's cells."
        )
    return faces


FANS = {2: [(0, 1)], 3: [(0, 1, 2)], 4: [(0, 1, 2), (0, 2, 3)]}
"""Simplices into which a face is cut, by the number of its corners."""


def faces_of(faces: Any, shape: tuple[int, ...]) -> list[Int[ndarray, "k c"]]:
    n, d = shape
    is_list = isinstance(faces, list | tuple) and np.ndim(faces[0]) == 2
    arrays = [rows_like("faces", ids, n) for ids in (faces if is_list else [faces])]
    for ids in arrays:
        if ids.ndim != 2 or ids.shape[1] not in ((2,) if d == 2 else (3, 4)) or not ids.size:
            expected = "(k, 2)" if d == 2 else "(k, 3) or (k, 4)"
            raise ValueError(f"`faces` has shape {ids.shape}; walls in {d}-D have {expected}.")
    return arrays


def simplices_of(faces: Any, shape: tuple[int, ...]) -> Int[ndarray, "k d"]:
    kinds = faces_of(faces, shape)
    return np.concatenate([ids[:, cut] for ids in kinds for cut in FANS[ids.shape[1]]])


@checked
def area(x: Numbers, loop: Any) -> Scalar:
    """Computes the area within a loop (2-D), positive where the loop runs counter-clockwise.

    `x` are positions (n, 2), `loop` the ids (k,) that `wall_loop` returns.

    **Raises:** `ValueError` for other shapes.
    """
    return 0.5 * jnp.sum(jnp.cross(*_ends_of_loop(x, loop)))


@checked
def centroid(x: Numbers, loop: Any) -> Vector:
    """Computes the centre (2,) of the area within a loop; arguments and errors as `area`."""
    x = positions(x)
    a, b = _ends_of_loop(x, loop)
    origin = a[0]
    a = a - origin[None, :]
    b = b - origin[None, :]
    twice = jnp.cross(a, b)
    return origin + jnp.sum((a + b) * twice[:, None], axis=0) / (3 * jnp.sum(twice))


@checked
def volume(x: Numbers, faces: Any, plane: Numbers | None = None) -> Scalar:
    """Computes the volume within faces (3-D), positive where they are outward.

    **Arguments:**

    - `x`: positions (n, 3).
    - `faces`: ids (k, 3) or (k, 4), one array or a list of them.
    - `plane`: a point (3,) of the plane that closes an open wall, such as a symmetry plane.

    **Raises:** `ValueError` for an open wall without a plane, or with a border off it.
    """
    x = positions(x)
    if x.shape[1] != 3:
        raise ValueError(f"`x` has shape {x.shape}; expected (n, 3): a wall in 2-D has an `area`.")
    triangles = simplices_of(faces, x.shape)
    origin = x[triangles[0, 0]] if plane is None else vector("plane", plane, x)
    _check_closed(x, triangles, None if plane is None else origin)
    a, b, c = (x[triangles[:, k]] - origin[None, :] for k in range(3))
    return jnp.sum(a * jnp.cross(b, c)) / 6


@checked
def volume_of_revolution(x: Numbers, faces: Any, axis: Plane) -> Scalar:
    """Computes the volume that a wall in 2-D encloses as it turns around an axis.

    The wall may be open where it ends on the axis. The volume is that of frustums, positive where
    the segments run counter-clockwise, as those of `jm.Facets.of(mesh, "body")` do around a body.

    **Arguments:**

    - `x`: positions (n, 2).
    - `faces`: ids (k, 2) of segments, all in one sense.
    - `axis`: the line as `jm.Plane(normal, origin)`; its normal is the direction of radii.

    **Raises:** `ValueError` for other shapes, and a wall that crosses the axis.
    """
    places, radii = _frustums(x, faces, axis)
    between = places[:, 0] - places[:, 1]
    mean = jnp.sum(radii**2, axis=1) + radii[:, 0] * radii[:, 1]  # three times that of r^2
    return jnp.pi / 3 * jnp.sign(jnp.sum(radii)) * jnp.sum(between * mean)


@checked
def area_of_revolution(x: Numbers, faces: Any, axis: Plane) -> Scalar:
    """Computes the area of the surface that a wall in 2-D sweeps as it turns around an axis.

    Arguments and errors as `volume_of_revolution`; the segments may have any sense.
    """
    places, radii = _frustums(x, faces, axis)
    ends = jnp.stack([places, radii], axis=2)
    return jnp.pi * jnp.sum(jnp.abs(jnp.sum(radii, axis=1)) * norm(ends[:, 1] - ends[:, 0]))


@checked
def chord(x: Numbers, nose: Any, tail: Any) -> Scalar:
    """Computes the distance from nose to tail of an airfoil, nodes of positions `x` (n, d).

    Of several nodes, as of a blunt tail, the mean counts.

    **Raises:** `ValueError` for nodes that are no rows of `x`.
    """
    x = positions(x)
    nose, tail = (
        np.atleast_1d(rows_like(name, ids, len(x)))
        for name, ids in (("nose", nose), ("tail", tail))
    )
    return jnp.linalg.norm(jnp.mean(x[tail], axis=0) - jnp.mean(x[nose], axis=0))


def _frustums(x: Numbers, faces: Any, axis: Plane) -> tuple[Float[Array, "k 2"], ...]:
    """Computes places along the axis and signed radii of the segments' ends, (k, 2) each."""
    x = positions(x)
    if x.shape[1] != 2 or len(axis.normal) != 2:
        raise ValueError(
            f"`x` has shape {x.shape}, the axis a normal of {len(axis.normal)} components; "
            "expected (n, 2) and 2: a wall in 3-D has a `volume`."
        )
    ends = x[simplices_of(faces, x.shape)]
    height = height_of(ends.reshape(-1, 2), axis).reshape(ends.shape[:2])
    if is_known(height):
        slack = IN_PLANE * np.ptp(np.asarray(ends), axis=(0, 1)).max()
        below, above = float(jnp.min(height)), float(jnp.max(height))
        if min(-below, above) > slack:
            raise ValueError(
                f"the wall lies on both sides of the axis, from {below:.3g} to {above:.3g} of it."
            )
    along = jnp.asarray([axis.normal[1], -axis.normal[0]], x.dtype)
    return jnp.matmul(ends, along, precision="highest"), height


def _ends_of_loop(x: Numbers, loop: Any) -> tuple[Positions, Positions]:
    x = positions(x)
    if x.shape[1] != 2:
        raise ValueError(f"`x` has shape {x.shape}; expected (n, 2).")
    loop = rows_like("loop", loop, len(x))
    if loop.ndim != 1 or len(loop) < 3:
        raise ValueError(f"`loop` has shape {loop.shape}; expected three nodes or more.")
    return x[loop], x[np.roll(loop, -1)]


def _check_closed(x: Positions, triangles: Int[ndarray, "k 3"], plane: Vector | None) -> None:
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    border = unique[count == 1]
    if len(border) and plane is None:
        raise ValueError(
            f"the wall is open: {len(border)} edges have one face, first {border[0].tolist()}. "
            "Give `plane`."
        )
    if len(border) and is_known(x, plane):
        sizes = np.linalg.svd(
            np.asarray(x)[np.unique(border)] - np.asarray(plane), compute_uv=False
        )
        if len(sizes) == 3 and sizes[-1] > IN_PLANE * sizes[0]:
            raise ValueError(
                f"the wall's border of {len(border)} edges does not lie in a plane through "
                f"{np.asarray(plane)}."
            )


class Stations(Module):
    """Lines on which thickness is measured, with the first and the last face on each line.

    `Stations.on` finds them once; a moved wall is measured where its faces went.

    - `points` (s, d): a point on each line.
    - `directions` (s, d): of the lines, of length 1.
    - `faces` (s, 2, d): node ids of each line's two faces.
    """

    points: Positions
    directions: Positions
    faces: Int[Array, "s 2 d"]

    @staticmethod
    @checked
    def on(x: Numbers, faces: Any, points: Numbers, direction: Numbers) -> "Stations":
        """Finds the first and the last face that each line meets.

        The wall has positions `x` (n, d) and faces: segments (k, 2) in 2-D, triangles or quads in
        3-D, one array or several. The lines have points (s, d) and a direction (d,), or (s, d).

        **Raises:** `ValueError` with the number of lines that meet fewer than two faces.
        """
        wall = known_positions(x).astype(float)
        own = known_positions(points, "points").astype(float)
        if wall.shape[1] != own.shape[1]:
            raise ValueError(
                f"`x` has shape {wall.shape}, `points` {own.shape}; expected (n, d) and (s, d)."
            )
        along = finite_array("direction", direction, own.shape, own.shape[1:])
        lengths = np.linalg.norm(along, axis=-1, keepdims=True)
        if not lengths.all():
            raise ValueError("`direction` has length 0; it must be a direction.")
        lines = np.broadcast_to(along / lengths, own.shape)
        ids = simplices_of(faces, wall.shape)
        same = SAME_LENGTH * np.ptp(wall, axis=0).max()
        ends = [
            _first_and_last(_place_on_wall(wall[ids], *line), same)
            for line in zip(own, lines, strict=True)
        ]
        missed = [row for row, faces in enumerate(ends) if not faces]
        if missed:
            raise ValueError(
                f"{len(missed)} of {len(own)} lines miss the body, first row {missed[0]} at "
                f"{own[missed[0]]}."
            )
        return Stations(jnp.asarray(own), jnp.asarray(lines), jnp.asarray(ids[np.array(ends)]))


def _first_and_last(place: Float[ndarray, " k"], same: float) -> list[int]:
    """The faces that are met first and last: of those at one place, as around a node, the first."""
    if np.isnan(place).all() or not np.nanmax(place) - np.nanmin(place) > same:
        return []
    return [int(np.argmax(s <= np.nanmin(s) + same)) for s in (place, -place)]


def _place_on_wall(
    corners: Float[ndarray, "k d d"], point: ndarray, line: ndarray
) -> Float[ndarray, " k"]:
    """Where a line meets each face, as distances from its point; NaN where it does not."""
    # point + s line = first corner + weights times edges
    first = corners[:, 0]
    edges = np.moveaxis(first[:, None] - corners[:, 1:], 1, 2)
    system = np.concatenate([np.broadcast_to(line, first.shape)[:, :, None], edges], axis=2)
    regular = np.abs(np.linalg.det(system / np.abs(system).max())) > ALONG_FACE
    system[~regular] = np.eye(len(line))
    s, *weights = np.linalg.solve(system, (first - point)[:, :, None])[:, :, 0].T
    is_hit = (np.min(weights, axis=0) >= -SAME_LENGTH) & (
        np.sum(weights, axis=0) <= 1 + SAME_LENGTH
    )
    return np.where(regular & is_hit, s, np.nan)


@checked
def thickness(x: Numbers, stations: Stations) -> Vector:
    """Computes the distance between the two faces on each line, with positions (n, d). The faces
    count as planes, beyond their corners too.

    **Raises:** `ValueError` for positions in another dimension, or with too few rows.
    """
    x = positions(x)
    if x.shape[1] != stations.points.shape[1]:
        raise ValueError(
            f"`x` has shape {x.shape}; the stations are in {stations.points.shape[1]}-D."
        )
    if is_known(stations.faces):
        rows_like("stations.faces", stations.faces, len(x))
    own = cast(stations, x)
    corners = x[stations.faces]
    first = corners[:, :, 0]
    normal = area_vectors(corners.reshape(-1, *corners.shape[2:])).reshape(first.shape)
    line = jnp.broadcast_to(own.directions[:, None], first.shape)
    arm = first - own.points[:, None, :]
    place = jnp.sum(normal * arm, axis=-1) / jnp.sum(normal * line, axis=-1)
    return place[:, 1] - place[:, 0]
