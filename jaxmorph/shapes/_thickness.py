"""Thickness of a body along lines.

The host finds which faces a line meets, traced code where it meets them.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._host.package.arguments import as_array, checked
from .._kernels.module import Module
from .._kernels.values import is_known
from ._arguments import Numbers, check_finite, known_positions, positions, rows_of
from ._walls import triangles_of


class Stations(Module):
    """Lines on which thickness is measured, with the first and the last face on each line.

    `Stations.on` makes them once. The faces keep the wall's nodes, so that a moved wall is measured
    where its faces went.

    - `points` (s, d): a point on each line.
    - `directions` (s, d): of the lines, of length 1.
    - `faces` (s, 2, d): node ids of each line's two faces.
    """

    points: Float[Array, "s d"]
    directions: Float[Array, "s d"]
    faces: Int[Array, "s 2 d"]

    @staticmethod
    @checked
    def on(x: Numbers, faces: Any, points: Numbers, direction: Numbers) -> "Stations":
        """Finds the first and the last face that each line meets.

        **Arguments:**

        - `x`: positions (n, d) of the wall.
        - `faces`: segments (k, 2) in 2-D; triangles or quads in 3-D, one array or several.
        - `points`: (s, d) a point on each line.
        - `direction`: (d,) of all lines, or (s, d).

        **Raises:** `ValueError` with the number of lines that meet fewer than two faces.
        """
        x, points = known_positions(x).astype(float), known_positions(points, "points").astype(float)
        check_finite(direction=direction)
        known = np.asarray(direction, float)
        if x.shape[1] != points.shape[1] or known.shape not in (points.shape, points.shape[1:]):
            raise ValueError(
                f"`x` has shape {x.shape}, `points` {points.shape}, `direction` {known.shape}; expected (n, d), (s, d), (d,)."
            )
        lines = np.broadcast_to(known, points.shape)
        if not np.linalg.norm(lines, axis=1).all():
            raise ValueError("`direction` has length 0; it must be a direction.")
        lines = lines / np.linalg.norm(lines, axis=1)[:, None]
        ids = as_array("faces", faces) if x.shape[1] == 2 else triangles_of(faces, jnp.asarray(x))
        if ids.ndim != 2 or ids.shape[1] != x.shape[1]:
            raise ValueError(f"`faces` has shape {ids.shape}; walls in 2-D have segments (k, 2).")
        rows_of("faces", ids, len(x))
        chosen = np.zeros((len(points), 2, x.shape[1]), int)
        missed, same = [], 1e-9 * np.ptp(x, axis=0).max()
        for s, (point, line) in enumerate(zip(points, lines, strict=True)):
            place, inside = _meets(x, ids, point, line)
            hits = np.flatnonzero(inside)
            if len(hits) < 2 or np.ptp(place[hits]) <= same:
                missed.append(s)
            else:  # of faces that are met at one place, such as around a node, the first counts
                ends = place[hits] <= place[hits].min() + same, place[hits] >= place[hits].max() - same
                chosen[s] = ids[[hits[end.argmax()] for end in ends]]
        if missed:
            raise ValueError(
                f"{len(missed)} of {len(points)} lines miss the body, first row {missed[0]} at {points[missed[0]]}."
            )
        return Stations(jnp.asarray(points), jnp.asarray(lines), jnp.asarray(chosen))


@checked
def thickness(x: Numbers, stations: Stations) -> Float[Array, " s"]:
    """Computes the distance between the two faces that each line meets.

    **Arguments:**

    - `x`: positions (n, d) of the wall, moved or not; traced.
    - `stations`: from `Stations.on`.

    **Returns:** thickness (s,), in the units of `x`; the faces count as planes, beyond their
    corners too.

    **Raises:** `ValueError` for positions of another wall: another dimension, or fewer rows than
    the faces name.
    """
    x = positions(x)
    if is_known(stations.faces) and x.shape[1] == stations.points.shape[1]:
        rows_of("stations.faces", stations.faces, len(x))
    elif x.shape[1] != stations.points.shape[1]:
        raise ValueError(f"`x` has shape {x.shape}; the stations are in {stations.points.shape[1]}-D.")
    corners = x[stations.faces]
    first, line = (
        corners[:, :, 0],
        jnp.broadcast_to(stations.directions.astype(x.dtype)[:, None], corners[:, :, 0].shape),
    )
    if x.shape[1] == 2:
        edge = corners[:, :, 1] - first
        normal = jnp.stack([edge[..., 1], -edge[..., 0]], axis=-1)
    else:
        normal = jnp.cross(corners[:, :, 1] - first, corners[:, :, 2] - first)
    arm = first - stations.points.astype(x.dtype)[:, None, :]
    place = jnp.sum(normal * arm, axis=-1) / jnp.sum(normal * line, axis=-1)
    return place[:, 1] - place[:, 0]


def _meets(x: np.ndarray, ids: np.ndarray, point: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solves point + s line = first corner + weights times edges for all faces.

    It returns s, and whether the place is inside the face.
    """
    first, d = x[ids[:, 0]], x.shape[1]
    columns = [np.broadcast_to(line, first.shape)] + [first - x[ids[:, k]] for k in range(1, d)]
    system = np.stack(columns, axis=2)
    size = np.abs(system).max()
    regular = np.abs(np.linalg.det(system / size)) > 1e-14
    solution = np.full((len(ids), d), np.nan)
    solution[regular] = np.linalg.solve(system[regular], (first - point)[regular][:, :, None])[:, :, 0]
    weights = solution[:, 1:]
    inside = regular & (weights >= -1e-9).all(axis=1) & (weights.sum(axis=1) <= 1 + 1e-9)
    return solution[:, 0], inside
