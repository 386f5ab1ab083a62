"""Walls along which nodes slide, as traced code sees them: the nearest point on a plane, a surface of revolution, or faces."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._kernels.module import Module
from .._kernels.values import norm

STEPS = 6
"""Newton steps to a curved wall, or to where two walls meet; they end quadratically."""

ALONG_AXIS = 1e-7
"""Component of a unit normal below which it is zero: files have few digits."""

BLOCK = 512
"""Nodes whose nearest face is sought together."""


class AbstractWall(Module):
    """Keeps points on a surface (a curve in 2-D)."""

    @abc.abstractmethod
    def height(self, x: Float[Array, "k d"]) -> tuple[Float[Array, " k"], Float[Array, "k d"]]:
        """Measures how far points are off the wall, along unit normals that it returns too."""

    @property
    def is_flat(self) -> bool:
        """Checks whether one step leads to the wall, linear in the point."""
        return False

    def distance(self, x: Float[Array, "k d"]) -> Float[Array, " k"]:
        """Measures how far points are from the wall."""
        return jnp.abs(self.height(x)[0])

    def at(self, points: Float[Array, "n d"]) -> "AbstractWall":
        """Returns the wall of other base points; a surface that a caller gave stays as it is."""
        return self

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "AbstractWall":
        """Renumbers the wall: node k becomes `place[k]`."""
        return self

    def has_end(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points at or beyond an end of the wall; none without an end."""
        return np.zeros(len(x), dtype=bool)

    def is_apex(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points of the wall that have no normal: the apex of a cone."""
        return np.zeros(len(x), dtype=bool)


class Flat(AbstractWall):
    """A plane, or a line in 2-D."""

    normal: Float[Array | np.ndarray, " d"]
    origin: Float[Array | np.ndarray, " d"]

    def height(self, x):
        normal = jnp.asarray(self.normal, x.dtype)
        above = jnp.matmul(x - jnp.asarray(self.origin, x.dtype)[None], normal, precision="highest")
        return above, jnp.broadcast_to(normal, x.shape)

    @property
    def is_flat(self) -> bool:
        return True


class FlatFaces(Flat):
    """The plane, or the line in 2-D, of a patch's own faces: it follows the base points.

    - `nodes` (v,), `vertices` (v, d): ids of the patch's nodes, or rows of them, and where they are.
    - `faces` (e, d): rows of their corners.
    """

    nodes: Int[Array | np.ndarray, " v"]
    vertices: Float[Array | np.ndarray, "v d"]
    faces: Int[Array | np.ndarray, "e d"]

    def at(self, points):
        patch, old = points[self.nodes], jnp.asarray(self.normal, points.dtype)
        areas = _areas(patch, self.faces)
        areas = areas * jnp.where(jnp.matmul(areas, old) < 0, -1, 1)[:, None]  # both sides of a baffle count
        whole = jnp.sum(areas, axis=0)
        normal = whole / norm(whole)
        sharp = jnp.where(jnp.abs(normal) < ALONG_AXIS, 0, normal)  # the usual case: keep the coordinate bit for bit
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


class Round(AbstractWall):
    """A circle in 2-D, a surface of revolution in 3-D: its profile is a line, or a cubic spline of the radius along the axis.

    - `axis`, `origin` (d,): the axis, zero in 2-D, and a point of it.
    - `line` (3,): (a, b, c) with a z + b r = c and a^2 + b^2 = 1 at places z along the axis and radii r.
    - `knots` (k + 1,), `spline` (4, k): places and coefficients, cubic ones first; None for a line.
    """

    axis: Float[Array | np.ndarray, " d"]
    origin: Float[Array | np.ndarray, " d"]
    line: Float[Array | np.ndarray, " 3"]
    knots: Float[Array | np.ndarray, " l"] | None = None
    spline: Float[Array | np.ndarray, "4 k"] | None = None

    def height(self, x):
        axis = jnp.asarray(self.axis, x.dtype)
        arm = x - jnp.asarray(self.origin, x.dtype)[None]
        along = jnp.matmul(arm, axis, precision="highest")
        outward = arm - along[:, None] * axis[None]
        radius = norm(outward)
        outward = outward / jnp.where(radius > 0, radius, 1)[:, None]
        if self.spline is None or self.knots is None:
            a, b, c = (jnp.asarray(coefficient, x.dtype) for coefficient in self.line)
            above, a, b = (
                a * along + b * radius - c,
                jnp.broadcast_to(a, radius.shape),
                jnp.broadcast_to(b, radius.shape),
            )
        else:
            knots, spline = jnp.asarray(self.knots, x.dtype), jnp.asarray(self.spline, x.dtype)
            piece = jnp.clip(jnp.searchsorted(knots, along, side="right") - 1, 0, spline.shape[1] - 1)
            t, (cubic, square, slope, value) = along - knots[piece], spline[:, piece]
            steep = slope + t * (2 * square + 3 * t * cubic)
            b = 1 / jnp.sqrt(1 + steep**2)
            a, above = -steep * b, (radius - value - t * (slope + t * (square + t * cubic))) * b
        return above, a[:, None] * axis[None] + b[:, None] * outward

    def has_end(self, x):
        if self.knots is None:
            return np.zeros(len(x), dtype=bool)
        along, slack = (x - np.asarray(self.origin)) @ np.asarray(self.axis), 1e-9 * float(np.ptp(self.knots))
        return (along < self.knots[0] - slack) | (along > self.knots[-1] + slack)

    def is_apex(self, x):
        axis, arm = np.asarray(self.axis), x - np.asarray(self.origin)
        is_disc = self.spline is None and abs(self.line[1]) < ALONG_AXIS
        if is_disc or not axis.any():
            return np.zeros(len(x), dtype=bool)
        radius = np.linalg.norm(arm - (arm @ axis)[:, None] * axis, axis=1)
        return radius <= ALONG_AXIS * np.ptp(x, axis=0).max()


class Faceted(AbstractWall):
    """Faces between nodes: triangles, or lines in 2-D. They follow the base points.

    - `nodes` (v,), `vertices` (v, d): ids of the nodes, or rows of them, and where they are.
    - `faces` (e, d): rows of their corners.
    - `around` (v, w): faces near each vertex; its last ones are repeated.
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
        return _off_edges(x, ends) < 1e-9 * np.ptp(np.asarray(self.vertices), axis=0).max()

    def at(self, points):
        return Faceted(self.nodes, points[self.nodes], self.faces, self.around)

    def renumbered(self, place):
        return Faceted(place[np.asarray(self.nodes)], self.vertices, self.faces, self.around)

    def nearest(self, x: Float[Array, "k d"]) -> tuple[Float[Array, "k d"], Float[Array, "k d"]]:
        """Finds the nearest points of the faces, and the normals of these."""
        normals = self._normals(x.dtype)
        return jax.lax.map(lambda each: self._nearest(each, normals), x, batch_size=BLOCK)

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
        places = jax.vmap(_nearest_of, in_axes=(None, 0))(x, corners)
        distances = jnp.sum((places - x[None]) ** 2, axis=1)
        chosen = jnp.argmin(jax.lax.stop_gradient(distances))
        place, normal = places[chosen], _normal(corners[chosen])
        # At a node, where faces meet, the tangent is normal to the mean of the faces' normals.
        node, smooth = vertices[vertex], normals[vertex]
        size = jnp.max(jnp.sum((corners[:, 1] - corners[:, 0]) ** 2, axis=1))
        is_node = squared[vertex] <= 1e-20 * size
        tangent = node + (x - node) - jnp.sum((x - node) * smooth) * smooth
        return jnp.where(is_node, tangent, place), jnp.where(is_node, smooth, normal)


def _nearest_of(x: Float[Array, " d"], corners: Float[Array, "d d"]) -> Float[Array, " d"]:
    """Finds the nearest point of a triangle, or of a line."""
    if len(corners) == 2:
        return _on_edge(x, corners[0], corners[1])
    first, second, third = corners
    normal = _normal(corners)
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
    """Computes normals of faces, as long as twice their areas, or as long as lines."""
    first, *others = (points[jnp.asarray(faces)[:, k]] for k in range(points.shape[1]))
    if len(others) == 1:
        along = others[0] - first
        return jnp.stack([along[:, 1], -along[:, 0]], axis=1)
    return jnp.cross(others[0] - first, others[1] - first)


def _normal(corners: Float[Array, "d d"]) -> Float[Array, " d"]:
    normal = _areas(corners, np.arange(len(corners))[None])[0]
    length = norm(normal)
    return normal / jnp.where(length > 0, length, 1)


def rim(faces: Int[np.ndarray, "e d"]) -> Int[np.ndarray, "r c"]:
    """Lists the edges of triangles that only one of them has, or the ends of lines."""
    d = faces.shape[1]
    sides = np.concatenate([np.delete(faces, k, axis=1) for k in range(d)])
    once, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return once[counts == 1]


def _off_edges(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Measures how far (k,) points are from the nearest of some edges (r, 2, d), or ends (r, 1, d)."""
    least = np.full(len(x), np.inf)
    for first, *second in ends:
        edge = second[0] - first if second else np.zeros_like(first)
        along = np.clip((x - first) @ edge / max(float(edge @ edge), 1e-300), 0, 1)
        least = np.minimum(least, np.linalg.norm(x - first - along[:, None] * edge, axis=1))
    return least


def inside(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Marks the points (k, 2) within or on closed lines of edges (r, 2, 2)."""
    crossed = np.zeros(len(x), dtype=bool)
    for (a, b), (c, d) in ends:
        between = (b > x[:, 1]) != (d > x[:, 1])
        crossed ^= between & (x[:, 0] < a + (x[:, 1] - b) * (c - a) / (d - b if d != b else 1))
    return crossed | (_off_edges(x, ends) < 1e-9 * np.ptp(ends.reshape(-1, 2), axis=0).max())


class Track(eqx.Module):
    """Keeps rows on one wall, or where two walls meet.

    - `rows` (k,): ids of nodes, or rows of them.
    - `walls`: one or two walls.
    """

    rows: Int[Array | np.ndarray, " k"]
    walls: tuple[AbstractWall, ...]

    @property
    def is_linear(self) -> bool:
        """Checks whether displacements along the track are linear in the displacements given."""
        return all(wall.is_flat for wall in self.walls)

    def normals(self, points: Float[Array, "n d"]) -> Float[Array, "k w d"]:
        """Computes unit vectors at right angles that span the normals of the walls next to the rows. Traced."""
        places = self.project(points[self.rows])
        first, *others = (wall.height(places)[1] for wall in self.walls)
        frame = [first]
        for normal in others:
            rest = normal - jnp.sum(normal * first, axis=1, keepdims=True) * first
            frame.append(rest / norm(rest)[:, None])
        return jnp.stack(frame, axis=1)

    def along(self, points: Float[Array, "n d"], u: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Changes displacements so that the rows stay as near to the walls as they are. Traced."""
        start, displacement = points[self.rows], u[self.rows]
        if self.is_linear:
            normals = [jnp.asarray(wall.height(start[:1])[1][0]) for wall in self.walls]
            tangential = displacement - _least(
                normals, [jnp.matmul(displacement, normal, precision="highest") for normal in normals]
            )
        else:
            tangential = self.project(start + displacement) - self.project(start)
        return u.at[self.rows].set(tangential)

    def project(self, x: Float[Array, "k d"]) -> Float[Array, "k d"]:
        """Moves points to the walls."""
        if len(self.walls) == 1 and isinstance(self.walls[0], Faceted):
            return self.walls[0].nearest(x)[0]
        first = self.walls[0]
        is_exact = self.is_linear or (len(self.walls) == 1 and isinstance(first, Round) and first.spline is None)

        def nearer(x, _):
            above, normals = zip(*(wall.height(x) for wall in self.walls), strict=True)
            return x - _least(normals, above), None

        return nearer(x, None)[0] if is_exact else jax.lax.scan(nearer, x, length=STEPS)[0]

    def at(self, points: Float[Array, "n d"]) -> "Track":
        """Returns the track of other base points: walls of the mesh's own faces are there anew. Traced."""
        return Track(self.rows, tuple(wall.at(points) for wall in self.walls))

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "Track":
        """Renumbers the track: node k becomes `place[k]`."""
        return Track(place[np.asarray(self.rows)], tuple(wall.renumbered(place) for wall in self.walls))


def _least(normals, above):
    """Computes the shortest vectors that have the components `above` along one or two normals."""
    if len(normals) == 1:
        return above[0][:, None] * jnp.broadcast_to(normals[0], (len(above[0]), normals[0].shape[-1]))
    first, second = (jnp.broadcast_to(normal, (len(above[0]), normal.shape[-1])) for normal in normals)
    cosine = jnp.sum(first * second, axis=1)
    whole = 1 - cosine**2
    a, b = (above[0] - cosine * above[1]) / whole, (above[1] - cosine * above[0]) / whole
    return a[:, None] * first + b[:, None] * second
