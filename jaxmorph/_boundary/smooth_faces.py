"""Walls made of a patch's own faces without kinks: a quadratic surface through their nodes."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._kernels.values import norm
from .tracks import Track
from .walls import Faceted, nearest_of, normal_of

STEPS = 4
"""Steps along the normal to the surface; each leaves a small share of the distance."""

CANCELLED = 1e-3
"""Length of a sum of unit normals, over their number, that is no direction: a thin plate's."""


class SmoothFaces(Faceted):
    """The smooth surface through the nodes of faces: triangles, or lines in 2-D.

    A place p of a face goes up to p + (p' - p) / 2, where p' is the mean of the places below p on
    the tangent planes of the face's nodes. A parabola is met exactly, faces in one plane stay it.
    The normal is the mean of the nodes' normals. It has no jump, but the surface has a tiny one.

    Source: Boubekeur and Alexa, Phong tessellation, ACM Trans. Graph. 27, 2008.
    """

    def _normals(self, dtype) -> Float[Array, "v d"]:
        """Computes unit normals at the vertices, exact on a sphere (a circle in 2-D).

        Source: Max, Weights for computing vertex normals from facet normals, J. Graph. Tools 4,
        1999. At a rim, where faces lie on one side only, the normals of inner vertices go on.
        """
        vertices, faces = jnp.asarray(self.vertices, dtype), jnp.asarray(self.faces)
        corners, size = vertices[faces], faces.shape[1]
        flat, none = jax.vmap(normal_of)(corners), jnp.zeros(len(vertices), dtype)
        total, weights, turns = jnp.zeros_like(vertices), none, jnp.zeros(len(vertices), faces.dtype)
        for k in range(size):
            sides = [corners[:, (k + step) % size] - corners[:, k] for step in range(1, size)]
            squared = functools.reduce(jnp.multiply, [jnp.sum(side**2, axis=1) for side in sides])
            area = norm(jnp.cross(sides[0], sides[1])) if size == 3 else norm(sides[0])
            weight = area / jnp.where(squared > 0, squared, jnp.inf)
            total = total.at[faces[:, k]].add(weight[:, None] * flat)
            weights = weights.at[faces[:, k]].add(weight)
            # Round an inner vertex each neighbour comes first once and last once: ids cancel out.
            turns = turns.at[faces[:, k]].add(faces[:, (k + 1) % size] - faces[:, k - 1] if size == 3 else 1 - 2 * k)
        unit = _unit(total, CANCELLED * weights)
        return jnp.where((turns != 0)[:, None], self._beyond(unit, turns != 0), unit)

    def _beyond(self, unit: Float[Array, "v d"], is_rim: Bool[Array, " v"]) -> Float[Array, "v d"]:
        """Continues the normals of inner vertices along edges, exact on a sphere.

        A short edge counts most: sides of quads count more than diagonals. Without inner neighbours
        a vertex keeps its normal.
        """
        vertices, faces = jnp.asarray(self.vertices, unit.dtype), jnp.asarray(self.faces)
        total, weights, size = jnp.zeros_like(unit), jnp.zeros(len(unit), unit.dtype), faces.shape[1]
        reach = jnp.max(jnp.sum((vertices[faces[:, 1]] - vertices[faces[:, 0]]) ** 2, axis=1))
        for k, step in itertools.permutations(range(size), 2):
            other, side = unit[faces[:, step]], vertices[faces[:, k]] - vertices[faces[:, step]]
            squared = jnp.sum(side**2, axis=1)
            share = jnp.where(squared > 0, jnp.sum(other * side, axis=1) / jnp.where(squared > 0, squared, 1), 0)
            weight = jnp.where(is_rim[faces[:, step]] | (squared <= 0), 0, reach / jnp.where(squared > 0, squared, 1))
            total = total.at[faces[:, k]].add(weight[:, None] ** 2 * (other - 2 * share[:, None] * side))
            weights = weights.at[faces[:, k]].add(weight**2)
        goes_on = norm(total) > CANCELLED * weights
        return jnp.where(goes_on[:, None], _unit(total, CANCELLED * weights), unit)

    def _nearest(
        self, x: Float[Array, " d"], normals: Float[Array, "v d"]
    ) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        vertices = jnp.asarray(self.vertices, x.dtype)
        vertex = jnp.argmin(jnp.sum((vertices - x[None]) ** 2, axis=1))
        faces = jnp.asarray(self.faces)[jnp.asarray(self.around)[vertex]]

        def nearer(state, _):
            place, _ = state
            surface, normal = _raised(place, vertices[faces], normals[faces])
            return (place - jnp.sum((place - surface) * normal) * normal, normal), None

        return jax.lax.scan(nearer, (x, jnp.zeros_like(x)), length=STEPS)[0]


def _raised(
    x: Float[Array, " d"], corners: Float[Array, "w d d"], normals: Float[Array, "w d d"]
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    """Finds the place of the surface above the nearest place of the faces, and the normal there."""
    places = jax.vmap(nearest_of, in_axes=(None, 0))(x, corners)
    chosen = jnp.argmin(jax.lax.stop_gradient(jnp.sum((places - x[None]) ** 2, axis=1)))
    place, corner, normal = places[chosen], corners[chosen], normals[chosen]
    shares = _shares(place, corner)
    above = jnp.sum((corner - place[None]) * normal, axis=1)
    mean = jnp.matmul(shares, normal, precision="highest")
    lift = jnp.matmul(shares * above, normal, precision="highest")
    length = norm(mean)  # zero where both sides of a plate cancel out
    return place + lift / 2, jnp.where(length > CANCELLED, mean / jnp.where(length > 0, length, 1), normal_of(corner))


def _unit(vectors: Float[Array, "v d"], noise: Float[Array, " v"]) -> Float[Array, "v d"]:
    """Scales vectors to length one; a vector no longer than `noise` becomes zero."""
    length = norm(vectors)
    return vectors * jnp.where(length > noise, 1 / jnp.where(length > 0, length, 1), 0)[:, None]


def _shares(place: Float[Array, " d"], corners: Float[Array, "d d"]) -> Float[Array, " d"]:
    """Computes barycentric coordinates of a place on a line or on a triangle."""
    sides = corners[1:] - corners[0][None]
    gram = jnp.matmul(sides, sides.T, precision="highest")
    right = jnp.matmul(sides, place - corners[0], precision="highest")
    if len(sides) == 1:
        rest = right / jnp.where(gram[0] > 0, gram[0], 1)
    else:
        whole = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
        rest = jnp.stack([gram[1, 1] * right[0] - gram[0, 1] * right[1], gram[0, 0] * right[1] - gram[0, 1] * right[0]])
        rest = rest / jnp.where(whole > 0, whole, 1)
    return jnp.concatenate([1 - jnp.sum(rest, keepdims=True), rest])


def smoothed(track: Track) -> Track:
    """Replaces the walls of a patch's own faces by smooth ones."""
    walls = [
        SmoothFaces(wall.nodes, wall.vertices, wall.faces, wall.around) if type(wall) is Faceted else wall
        for wall in track.walls
    ]
    return Track(np.asarray(track.rows), tuple(walls))
