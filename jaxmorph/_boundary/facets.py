"""Walls made of a patch's own faces, in traced code: they follow the base points."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._kernels.values import norm
from .holes import distance_from_edges, inside, rim
from .walls import ALONG_AXIS, AbstractWall, Flat

BLOCK = 512
"""Nodes whose nearest faces are searched together."""


class FlatFaces(Flat):
    """The plane (the line in 2-D) of a patch's own faces. It follows the base points.

    - `nodes` (v,), `vertices` (v, d): ids or rows of the patch's nodes, and their places.
    - `faces` (e, d): corners, as rows of `vertices`.
    """

    nodes: Int[Array | np.ndarray, " v"]
    vertices: Float[Array | np.ndarray, "v d"]
    faces: Int[Array | np.ndarray, "e d"]

    def at(self, points):
        patch, old = points[self.nodes], jnp.asarray(self.normal, points.dtype)
        areas = _areas(patch, self.faces)
        areas = areas * jnp.where(jnp.matmul(areas, old) < 0, -1, 1)[:, None]  # both sides of a baffle add up
        total = jnp.sum(areas, axis=0)
        normal = total / norm(total)
        # The usual wall is at right angles to an axis: an exact normal keeps the coordinate bit for
        # bit.
        sharp = jnp.where(jnp.abs(normal) < ALONG_AXIS, 0, normal)
        normal = normal + jax.lax.stop_gradient(sharp / norm(sharp) - normal)
        return FlatFaces(normal, jnp.mean(patch, axis=0), self.nodes, patch, self.faces)

    def has_end(self, x):
        ends = np.asarray(self.vertices)[rim(np.asarray(self.faces))]
        if not len(ends):  # both sides of a plate: no rim
            return np.zeros(len(x), dtype=bool)
        normal = np.asarray(self.normal)
        if x.shape[1] == 2:
            along = np.array([normal[1], -normal[0]])
            places, ends = x @ along, ends[:, 0] @ along
            return (places < ends.min()) | (places > ends.max())
        axes = np.linalg.svd(normal[None])[2][1:]
        return ~inside(x @ axes.T, ends @ axes.T)

    def renumbered(self, place):
        return FlatFaces(self.normal, self.origin, place[np.asarray(self.nodes)], self.vertices, self.faces)


class Faceted(AbstractWall):
    """A wall of faces between nodes: triangles, or lines in 2-D. It follows the base points.

    - `nodes` (v,), `vertices` (v, d): ids or rows of the nodes, and their places.
    - `faces` (e, d): corners, as rows of `vertices`.
    - `around` (v, w): faces near every vertex; the last face fills up a row.
    """

    nodes: Int[Array | np.ndarray, " v"]
    vertices: Float[Array | np.ndarray, "v d"]
    faces: Int[Array | np.ndarray, "e d"]
    around: Int[Array | np.ndarray, "v w"]

    def height(self, x):
        place, normal = self.nearest(x)
        return jnp.sum((x - place) * normal, axis=1), normal

    def distance(self, x):
        return norm(x - self.nearest(x)[0])

    def has_end(self, x):
        ends = np.asarray(self.vertices)[rim(np.asarray(self.faces))]
        return distance_from_edges(x, ends) < 1e-9 * np.ptp(np.asarray(self.vertices), axis=0).max()

    def at(self, points):
        return type(self)(self.nodes, points[self.nodes], self.faces, self.around)

    def renumbered(self, place):
        return type(self)(place[np.asarray(self.nodes)], self.vertices, self.faces, self.around)

    def nearest(self, x: Float[Array, "k d"]) -> tuple[Float[Array, "k d"], Float[Array, "k d"]]:
        """Finds the nearest points of the faces, and the normals there."""
        normals = self._normals(x.dtype)
        return jax.lax.map(lambda point: self._nearest(point, normals), x, batch_size=BLOCK)

    def _normals(self, dtype) -> Float[Array, "v d"]:
        """Computes unit normals at the vertices, smoothed over their faces."""
        vertices = jnp.asarray(self.vertices, dtype)
        areas = _areas(vertices, self.faces)
        total = jnp.zeros_like(vertices).at[jnp.asarray(self.faces)].add(areas[:, None])
        length = norm(total)[:, None]
        return total / jnp.where(length > 0, length, 1)

    def _nearest(
        self, x: Float[Array, " d"], normals: Float[Array, "v d"]
    ) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        vertices = jnp.asarray(self.vertices, x.dtype)
        squared = jnp.sum((vertices - x[None]) ** 2, axis=1)
        vertex = jnp.argmin(squared)
        corners = vertices[jnp.asarray(self.faces)[jnp.asarray(self.around)[vertex]]]
        places = jax.vmap(nearest_of, in_axes=(None, 0))(x, corners)
        distances = jnp.sum((places - x[None]) ** 2, axis=1)
        chosen = jnp.argmin(jax.lax.stop_gradient(distances))
        place, normal = places[chosen], normal_of(corners[chosen])
        # At a node several faces meet. There the tangent is at right angles to the mean normal of
        # the faces.
        node, smooth = vertices[vertex], normals[vertex]
        size = jnp.max(jnp.sum((corners[:, 1] - corners[:, 0]) ** 2, axis=1))
        is_node = squared[vertex] <= 1e-20 * size
        tangent = node + (x - node) - jnp.sum((x - node) * smooth) * smooth
        return jnp.where(is_node, tangent, place), jnp.where(is_node, smooth, normal)


def nearest_of(x: Float[Array, " d"], corners: Float[Array, "d d"]) -> Float[Array, " d"]:
    """Finds the nearest point of a triangle, or of a line."""
    if len(corners) == 2:
        return _on_edge(x, corners[0], corners[1])
    first, second, third = corners
    normal = normal_of(corners)
    inside = x - jnp.sum((x - first) * normal) * normal
    sides = [
        jnp.sum(jnp.cross(b - a, inside - a) * normal) for a, b in ((first, second), (second, third), (third, first))
    ]
    on_edges = jnp.stack([_on_edge(x, *edge) for edge in ((first, second), (second, third), (third, first))])
    nearest = on_edges[jnp.argmin(jax.lax.stop_gradient(jnp.sum((on_edges - x[None]) ** 2, axis=1)))]
    return jnp.where(jnp.min(jnp.stack(sides)) >= 0, inside, nearest)


def _on_edge(x, first, second):
    edge = second - first
    squared = jnp.sum(edge**2)
    along = jnp.sum((x - first) * edge) / jnp.where(squared > 0, squared, 1)
    return first + jnp.clip(along, 0, 1) * edge


def _areas(points: Float[Array, "v d"], faces: Int[Array | np.ndarray, "e d"]) -> Float[Array, "e d"]:
    """Computes normals of faces: as long as a line, or as twice the area of a triangle."""
    first, *others = (points[jnp.asarray(faces)[:, k]] for k in range(points.shape[1]))
    if len(others) == 1:
        along = others[0] - first
        return jnp.stack([along[:, 1], -along[:, 0]], axis=1)
    return jnp.cross(others[0] - first, others[1] - first)


def normal_of(corners: Float[Array, "d d"]) -> Float[Array, " d"]:
    normal = _areas(corners, np.arange(len(corners))[None])[0]
    length = norm(normal)
    return normal / jnp.where(length > 0, length, 1)
