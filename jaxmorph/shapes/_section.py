"""Place of an airfoil: its chord, and the nodes on its upper side."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.package.arguments import checked
from .._kernels.module import Module
from ._arguments import Numbers, check_finite, known_positions, rows_of
from ._sides import SAME, upper_of_loop, upper_of_points
from ._walls import triangles_of

WINDOW = 14
"""Nodes around a node that decide on which side of an airfoil it is."""


class Chord(Module):
    """The chord of an airfoil, from nose to tail, and the direction across it.

    **Arguments:**

    - `nose`, `tail`: points (d,), (0, 0) and (1, 0) by default.
    - `up`: direction (d,) across the chord; the chord turned to the left by default, needed in 3-D.

    **Raises:** `ValueError` for a chord without length, and for no `up` in 3-D.
    """

    nose: Float[Array, " d"]
    tail: Float[Array, " d"]
    up: Float[Array, " d"]

    @checked
    def __init__(self, nose: Numbers = (0.0, 0.0), tail: Numbers = (1.0, 0.0), up: Numbers | None = None):
        nose, tail = np.asarray(nose, float), np.asarray(tail, float)
        if nose.shape not in ((2,), (3,)) or nose.shape != tail.shape or (nose == tail).all():
            raise ValueError(f"a chord from {nose} to {tail}: expected two different points in 2-D or 3-D.")
        if up is None and len(nose) == 3:
            raise ValueError("`up` is missing: a chord in 3-D needs the direction across it.")
        check_finite(nose=nose, tail=tail, up=up)
        along = (tail - nose) / np.linalg.norm(tail - nose)
        across = np.array([-along[1], along[0]]) if up is None else np.asarray(up, float)
        if across.shape != nose.shape or not np.linalg.norm(across) > 0:
            raise ValueError(f"`up` is {across}; expected a direction ({len(nose)},).")
        self.nose, self.tail = jnp.asarray(nose), jnp.asarray(tail)
        self.up = jnp.asarray(across / np.linalg.norm(across))

    @property
    def length(self) -> Float[Array, ""]:
        """The distance from nose to tail."""
        return jnp.linalg.norm(self.tail - self.nose)

    def coordinates(self, x: Float[Array, "m d"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Computes the place along the chord (0 to 1) and the height across it (in units of x)."""
        chord = (self.tail - self.nose).astype(x.dtype)
        if chord.shape != x.shape[1:]:
            raise ValueError(f"positions in {x.shape[1]}-D and a chord in {len(chord)}-D.")
        arm = x - self.nose.astype(x.dtype)[None, :]
        return arm @ chord / (chord @ chord), arm @ self.up.astype(x.dtype)

    @staticmethod
    @checked
    def along(points: Numbers) -> "Chord":
        """Finds the chord of an airfoil in 2-D.

        The tail has the largest x, the nose is the node farthest from the tail.

        Nodes of a blunt tail, which share the largest x, give their mean. Nodes that are
        equally far from the tail do so too. `points` are positions (m, 2).
        """
        known = known_positions(points, "points")
        last = known[:, 0].max()
        tail = known[known[:, 0] > last - 1e-9 * max(np.ptp(known[:, 0]), 1e-300)].mean(axis=0)
        distance = np.linalg.norm(known - tail, axis=1)
        return Chord(known[distance > (1 - 1e-9) * distance.max()].mean(axis=0), tail)


@checked
def upper_side(points: Numbers, chord: Chord | None = None, *, wall: Any = None) -> Bool[np.ndarray, " m"]:
    """Marks the nodes on the upper side of an airfoil.

    The wall is cut at nose and tail. A single node there is on the upper side. A blunt tail has a
    corner on either side. In 2-D without `wall`, the shortest way around through all nodes, along
    the chord and back, counts as the wall. In 3-D without it, a node is compared with the parabola
    closest to its neighbours along the chord, which thin edges may mislead.

    **Arguments:**

    - `points`: positions (m, d) of the airfoil's nodes, or of a mesh where `wall` names the
      airfoil's nodes.
    - `chord`: the airfoil's. Default `Chord.along` of its nodes.
    - `wall`: ids of its nodes in order, as `wall_loop` finds them; its faces in 3-D, as
      `jaxmorph.boundary_faces` finds them.

    **Returns:** booleans (m,), False for nodes that are not the airfoil's.

    **Raises:** `ValueError` where all nodes would be on one side, and for a wall whose ids are no
    rows of the points.
    """
    x = known_positions(points, "points")
    solid = wall is not None and x.shape[1] == 3
    groups = [triangles_of(wall, jnp.asarray(x))] if solid else [] if wall is None else [_rows_of_loop(wall, len(x))]
    rows = np.unique(np.concatenate([ids.ravel() for ids in groups])) if groups else np.arange(len(x))
    chord = Chord.along(x[rows]) if chord is None else chord
    t, height = (np.asarray(values, float) for values in chord.coordinates(jnp.asarray(x)))
    places = np.column_stack([t, height / float(chord.length)])
    upper = np.zeros(len(x), bool)
    if solid:
        upper[rows] = _by_faces(x.astype(float), groups[0], np.asarray(chord.up, float))[rows]
    elif wall is not None:
        upper[groups[0]] = upper_of_loop(places[groups[0]])
    else:
        upper = upper_of_points(places) if x.shape[1] == 2 else _by_neighbours(places)
    if upper[rows].all() or not upper.any():
        raise ValueError(f"{len(rows)} nodes do not show the two sides of an airfoil around its chord.")
    return upper


def _rows_of_loop(wall: Any, count: int) -> Int[np.ndarray, " k"]:
    loop = rows_of("wall", wall, count)
    if loop.ndim != 1 or len(loop) < 3 or len(np.unique(loop)) < len(loop):
        raise ValueError(
            f"`wall` has shape {loop.shape}; a wall in 2-D is a loop (k,) of three different nodes or more."
        )
    return loop


def _by_faces(
    x: Float[np.ndarray, "m 3"], triangles: Int[np.ndarray, "k 3"], up: Float[np.ndarray, " 3"]
) -> Bool[np.ndarray, " m"]:
    """Marks the nodes whose faces look upwards.

    The normals of a node's faces are summed with the faces' angles at the node. A tie is upper.

    Inward faces enclose a negative volume. The faces of a mesh's cells around the body are inward.
    """
    corners = x[triangles] - x[np.unique(triangles)].mean(axis=0)
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    area = np.cross(ahead[:, 0], back[:, 0])
    size = np.linalg.norm(area, axis=1)
    angles = np.arctan2(size[:, None], np.sum(ahead * back, axis=2))
    unit = np.sign(np.sum(area * corners.sum(axis=1))) * area / np.where(size > 0, size, 1)[:, None]
    normals = np.zeros_like(x)
    np.add.at(normals, triangles, angles[:, :, None] * unit[:, None, :])
    return normals @ up >= -SAME * np.linalg.norm(normals, axis=1)


def _by_neighbours(places: Float[np.ndarray, "m 2"]) -> Bool[np.ndarray, " m"]:
    """Marks the nodes on or above the parabola closest to their neighbours along the chord."""
    t, height = places.T
    # in the angle along the chord, nodes are spread evenly where they crowd at nose and tail
    angle = np.arccos(np.clip(1 - 2 * t, -1, 1))
    order = np.argsort(angle, kind="stable")
    window = min(WINDOW, len(order))
    first = np.clip(np.arange(len(order)) - window // 2, 0, len(order) - window)
    near = order[first[:, None] + np.arange(window)]
    away = angle[near] - angle[order][:, None]
    powers = np.stack([np.ones_like(away), away, away**2], axis=-1)
    line = np.empty(len(order))
    line[order] = np.einsum("mij,mj->mi", np.linalg.pinv(powers), height[near])[:, 0]
    return height >= line - SAME
