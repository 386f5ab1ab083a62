"""Walls along which nodes slide, traced: planes, surfaces of revolution, faces."""

import abc

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import Delaunay, QhullError

from .._host.surface.gaps import distance_from_segment
from .._kernels.module import Module
from .._kernels.values import norm

ALONG_AXIS = 1e-7
"""Component of a unit normal that counts as zero: coordinates in files have few digits."""


class AbstractWall(Module):
    """A surface (a curve in 2-D) on which nodes stay."""

    @abc.abstractmethod
    def height(self, x: Float[Array, "k d"]) -> tuple[Float[Array, " k"], Float[Array, "k d"]]:
        """Measures signed distances of points from the wall, and their unit normals."""

    @property
    def is_flat(self) -> bool:
        """True for a plane, to which one step leads, linear in the point."""
        return False

    def distance(self, x: Float[Array, "k d"]) -> Float[Array, " k"]:
        """Measures the distances of points from the wall."""
        return jnp.abs(self.height(x)[0])

    def at(self, points: Float[Array, "n d"]) -> "AbstractWall":
        """Moves the wall to other base points: the patch's own faces follow, a surface stays."""
        return self

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "AbstractWall":
        """Renumbers the wall's nodes: node k becomes `place[k]`."""
        return self

    def has_end(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points at or beyond an end of the wall."""
        return np.zeros(len(x), dtype=bool)

    def is_apex(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points of the wall without a normal: the apex of a cone."""
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


class Round(AbstractWall):
    """A circle in 2-D, a surface of revolution in 3-D.

    The profile is a line, or a cubic spline of the radius.

    - `axis`, `origin` (d,): the axis, zero in 2-D, and a point on it.
    - `line` (3,): (a, b, c) with a z + b r = c and a^2 + b^2 = 1 at places z along the axis and
      radii r.
    - `knots` (k + 1,), `spline` (4, k): places along the axis, and coefficients, the cubic ones
      first. None for a line.
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
            above = a * along + b * radius - c
            a, b = jnp.broadcast_to(a, radius.shape), jnp.broadcast_to(b, radius.shape)
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


CONTINUES = 0.5
"""Least cosine, of 60 degrees, between a hole's new faces and the faces around it.

The rim of a dome and the end of a tube are no holes.
"""


def filled(
    faces: Int[np.ndarray, "e d"], vertices: Float[np.ndarray, "v d"], moves: Bool[np.ndarray, " v"]
) -> Int[np.ndarray, "f d"]:
    """Adds faces across all holes whose rim moves; other holes stay open.

    New faces continue the direction of the faces around them. In 2-D a line joins two ends that
    move. In 3-D a Delaunay triangulation in the rim's mean plane makes the faces. Old faces come
    first, in their order.
    """
    if faces.shape[1] == 2:
        return np.concatenate([faces, _joined(faces, vertices, moves)]).astype(faces.dtype)
    loops = (loop for loop in _loops(faces, moves) if _goes_on(loop, faces, vertices))
    new = [_between(loop, vertices[loop]) for loop in loops]
    return np.concatenate([faces, *new]).astype(faces.dtype)


def _joined(faces: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Lists lines (k, 2) from moving ends to the nearest moving start that lies ahead."""
    along = np.diff(vertices[faces], axis=1)[:, 0]
    along = _unit(along)  # zero for a face of two nodes at one place
    last = np.flatnonzero(~np.isin(faces[:, 1], faces[:, 0]) & moves[faces[:, 1]])
    first = np.flatnonzero(~np.isin(faces[:, 0], faces[:, 1]) & moves[faces[:, 0]])
    gap = vertices[faces[first, 0]][None] - vertices[faces[last, 1]][:, None]
    size = np.linalg.norm(gap, axis=2)
    ahead = np.minimum(np.sum(gap * along[last][:, None], axis=2), np.sum(gap * along[first][None], axis=2))
    size = np.where((size > 0) & (ahead > CONTINUES * size), size, np.inf)
    lines = []
    while np.isfinite(size).any():
        end, start = np.unravel_index(size.argmin(), size.shape)
        lines.append([faces[last[end], 1], faces[first[start], 0]])
        size[end], size[:, start] = np.inf, np.inf
    return np.array(lines, dtype=faces.dtype).reshape(-1, 2)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Scales vectors to length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def _goes_on(loop: np.ndarray, faces: np.ndarray, vertices: np.ndarray) -> bool:
    """Checks whether faces across a loop would have the direction of the faces beside it."""
    beside = vertices[faces[np.isin(faces, loop).sum(axis=1) > 1]]
    normals = np.cross(beside[:, 1] - beside[:, 0], beside[:, 2] - beside[:, 0])
    across = _area(vertices[loop])
    return bool((_unit(normals) @ across).mean() > CONTINUES * np.linalg.norm(across))


def _area(rim: np.ndarray) -> np.ndarray:
    """Computes twice the area vector of a loop of points (k, 3)."""
    return np.cross(rim - rim[0], np.roll(rim, -1, axis=0) - rim[0]).sum(axis=0)


def _loops(faces: np.ndarray, moves: np.ndarray) -> list[np.ndarray]:
    """Lists the closed rims whose vertices move, against the order of the faces beside them."""
    # A rim edge is an edge of one face alone. The path follows rim edges from node to node. When it
    # comes back to one of its own nodes, the part since then is a loop, and is cut off.
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    size = int(faces.max()) + 1
    key, back = edges @ np.array([size, 1]), edges @ np.array([1, size])
    rim = edges[~np.isin(back, key) & moves[edges].all(axis=1)]
    follows: dict[int, list[int]] = {}
    for node, end in rim.tolist():
        follows.setdefault(end, []).append(node)
    loops = []
    while follows:
        path, place = [next(iter(follows))], {next(iter(follows)): 0}
        while path[-1] in follows:
            ways = follows[path[-1]]
            node = ways.pop()
            if not ways:
                del follows[path[-1]]
            if node in place:
                start = place[node]
                loops.append(np.array(path[start:]))
                for corner in path[start:]:
                    del place[corner]
                path = path[:start]
            place[node] = len(path)
            path.append(node)
    return [loop for loop in loops if len(loop) > 2]


def _between(loop: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Makes triangles (k, 3) between the nodes of a loop, in its order."""
    normal = _area(rim)
    axes = np.linalg.svd(normal[None])[2][1:]
    flat = (rim - rim.mean(axis=0)) @ axes.T
    try:
        corners = Delaunay(flat).simplices
    except QhullError:
        return np.zeros((0, 3), dtype=loop.dtype)
    corners = corners[inside(flat[corners].mean(axis=1), np.stack([flat, np.roll(flat, -1, axis=0)], axis=1))]
    first, second, third = (rim[corners[:, k]] for k in range(3))
    is_back = np.cross(second - first, third - first) @ normal < 0
    corners[is_back] = corners[is_back][:, ::-1]
    return loop[corners]


def rim(faces: Int[np.ndarray, "e d"]) -> Int[np.ndarray, "r c"]:
    """Lists the edges that only one of the triangles has, or the ends of lines."""
    d = faces.shape[1]
    sides = np.concatenate([np.delete(faces, k, axis=1) for k in range(d)])
    once, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return once[counts == 1]


def distance_from_edges(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Measures the distances (k,) of points from the nearest edge (r, 2, d), or end (r, 1, d)."""
    least = np.full(len(x), np.inf)
    for edge in ends:
        least = np.minimum(least, distance_from_segment(x, edge[0], edge[-1]))
    return least


def inside(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Marks the points (k, 2) within or on closed lines, given by their edges (r, 2, 2)."""
    crossed = np.zeros(len(x), dtype=bool)
    for (a, b), (c, d) in ends:
        between = (b > x[:, 1]) != (d > x[:, 1])
        crossed ^= between & (x[:, 0] < a + (x[:, 1] - b) * (c - a) / (d - b if d != b else 1))
    return crossed | (distance_from_edges(x, ends) < 1e-9 * np.ptp(ends.reshape(-1, 2), axis=0).max())
