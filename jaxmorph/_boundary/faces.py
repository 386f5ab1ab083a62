"""Walls made of a patch's own faces, traced, which follow the base points."""

import dataclasses
import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import csr_array

from .._host.cells.lagrange import lagrange_types
from .._host.cells.topology import SHAPES
from .._kernels.values import area_vectors, norm
from .holes import distance_from_edges, inside, rim
from .walls import ALONG_AXIS, AbstractWall, Flat

BLOCK = 512  # nodes in a block


class FlatFaces(Flat):
    """The plane (the line in 2-D) of a patch's own faces. `nodes` (v,) are ids or rows of the
    patch's nodes, `vertices` (v, d) their places, `faces` (e, d) corners, as rows of `vertices`.
    """

    nodes: Int[Array | np.ndarray, " v"]
    vertices: Float[Array | np.ndarray, "v d"]
    faces: Int[Array | np.ndarray, "e d"]

    def at(self, points):
        patch, old = points[self.nodes], jnp.asarray(self.normal, points.dtype)
        areas = area_vectors(patch[jnp.asarray(self.faces)])
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
        return dataclasses.replace(self, nodes=place[np.asarray(self.nodes)])


class Faceted(AbstractWall):
    """Linear faces between nodes: triangles, or lines in 2-D."""

    nodes: Int[Array | np.ndarray, " v"]  # ids or rows of the nodes
    vertices: Float[Array | np.ndarray, "v d"]  # their places
    faces: Int[Array | np.ndarray, "e d"]  # corners, as rows of `vertices`
    around: Int[Array | np.ndarray, "v w"]  # faces near every vertex; the last face fills up a row

    def height(self, x):
        place, normal = self.nearest(x)
        return jnp.sum((x - place) * normal, axis=1), normal

    def distance(self, x):
        return norm(x - self.nearest(x)[0])

    def has_end(self, x):
        ends = np.asarray(self.vertices)[rim(np.asarray(self.faces))]
        return distance_from_edges(x, ends) < 1e-9 * np.ptp(np.asarray(self.vertices), axis=0).max()

    def at(self, points):
        return dataclasses.replace(self, vertices=points[self.nodes])

    def renumbered(self, place):
        return dataclasses.replace(self, nodes=place[np.asarray(self.nodes)])

    def nearest(self, x: Float[Array, "k d"]) -> tuple[Float[Array, "k d"], Float[Array, "k d"]]:
        vertices = jnp.asarray(self.vertices, x.dtype)
        normals = self.normals(vertices)
        return jax.lax.map(lambda point: self._nearest(point, vertices, normals), x, batch_size=BLOCK)

    def normals(self, vertices: Float[Array, "v d"]) -> Float[Array, "v d"]:
        """Computes unit normals at the vertices, smoothed over their faces."""
        areas = area_vectors(vertices[jnp.asarray(self.faces)])
        total = jnp.zeros_like(vertices).at[jnp.asarray(self.faces)].add(areas[:, None])
        length = norm(total)[:, None]
        return total / jnp.where(length > 0, length, 1)

    def _nearest(
        self, x: Float[Array, " d"], vertices: Float[Array, "v d"], normals: Float[Array, "v d"]
    ) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        squared = jnp.sum((vertices - x[None]) ** 2, axis=1)
        vertex = jnp.argmin(squared)
        corners = vertices[jnp.asarray(self.faces)[jnp.asarray(self.around)[vertex]]]
        place, chosen = _closest(x, corners)
        normal = normal_of(corners[chosen])
        # At a node several faces meet. There the tangent is at right angles to the mean normal of
        # the faces.
        node, smooth = vertices[vertex], normals[vertex]
        size = jnp.max(jnp.sum((corners[:, 1] - corners[:, 0]) ** 2, axis=1))
        is_node = squared[vertex] <= 1e-20 * size
        tangent = node + (x - node) - jnp.sum((x - node) * smooth) * smooth
        return jnp.where(is_node, tangent, place), jnp.where(is_node, smooth, normal)


def _closest(x: Float[Array, " d"], corners: Float[Array, "w d d"]) -> tuple[Float[Array, " d"], Int[Array, ""]]:
    """Finds the nearest place of triangles, or of lines, and the number of its face."""
    places = jax.vmap(nearest_of, in_axes=(None, 0))(x, corners)
    chosen = jnp.argmin(jax.lax.stop_gradient(jnp.sum((places - x[None]) ** 2, axis=1)))
    return places[chosen], chosen


def nearest_of(x: Float[Array, " d"], corners: Float[Array, "c d"]) -> Float[Array, " d"]:
    if len(corners) == 2:
        return _on_edge(x, corners[0], corners[1])
    first, second, third = corners
    normal, edges = normal_of(corners), ((first, second), (second, third), (third, first))
    in_plane = x - jnp.sum((x - first) * normal) * normal
    sides = [jnp.sum(jnp.cross(b - a, in_plane - a) * normal) for a, b in edges]
    on_edges = jnp.stack([_on_edge(x, *edge) for edge in edges])
    nearest = on_edges[jnp.argmin(jax.lax.stop_gradient(jnp.sum((on_edges - x[None]) ** 2, axis=1)))]
    return jnp.where(jnp.min(jnp.stack(sides)) >= 0, in_plane, nearest)


def _on_edge(x, first, second):
    edge = second - first
    squared = jnp.sum(edge**2)
    along = jnp.sum((x - first) * edge) / jnp.where(squared > 0, squared, 1)
    return first + jnp.clip(along, 0, 1) * edge


def normal_of(corners: Float[Array, "d d"]) -> Float[Array, " d"]:
    normal = area_vectors(corners[None])[0]
    length = norm(normal)
    return normal / jnp.where(length > 0, length, 1)


def faces_around(elements: Int[np.ndarray, "e c"], count: int) -> Int[np.ndarray, "v w"]:
    """The faces at each of `count` vertices and its neighbours; the last face fills a row."""
    ids = np.repeat(np.arange(len(elements)), elements.shape[1])
    touch = csr_array((np.ones(ids.size), (elements.ravel(), ids)), shape=(count, len(elements)))
    near = csr_array(touch @ touch.T @ touch)
    sizes = np.diff(near.indptr)
    steps = np.minimum(np.arange(sizes.max())[None], np.maximum(sizes - 1, 0)[:, None])
    return near.indices[np.minimum(near.indptr[:-1, None] + steps, len(near.indices) - 1)].astype(np.int32)


SEARCH, POLISH = 8, 2  # steps of Gauss and Newton inside each face near a point; of Newton on the nearest face


class CurvedFaces(Faceted):
    """The curved faces of one type between nodes: the polynomials of the cells' sides.

    - `nodes`, `vertices`, `faces`: as in `Faceted`, for linear pieces of the faces.
    - `around` (v, w): curved faces near every vertex.
    - `sides` (q, s): the nodes of each face, as rows of `vertices`; their type is `kind`.
    """

    sides: Int[Array | np.ndarray, "q s"]
    kind: str = eqx.field(static=True)

    def normals(self, vertices):
        return vertices  # a polynomial has its own normals

    def _nearest(self, x, vertices, normals):
        powers, matrix = polynomials(self.kind)
        vertex = jnp.argmin(jnp.sum((vertices - x[None]) ** 2, axis=1))
        corners = vertices[jnp.asarray(self.sides)[jnp.asarray(self.around)[vertex]]]
        coefficients = jnp.einsum("ks,wsd->wkd", jnp.asarray(matrix, x.dtype), corners, precision="highest")
        first = jnp.argmin(jnp.sum((corners - x[None, None]) ** 2, axis=2), axis=1)
        start = jnp.asarray(lagrange_types()[self.kind].reference, x.dtype)[first]
        place = functools.partial(_place, powers=powers)
        found = jax.lax.stop_gradient(jax.vmap(self._searched, in_axes=(None, 0, 0))(x, start, coefficients))
        distances = jnp.sum((jax.vmap(place)(found, coefficients) - x[None]) ** 2, axis=1)
        chosen = jnp.argmin(jax.lax.stop_gradient(distances))
        at, own = found[chosen], coefficients[chosen]
        # the last steps go beyond the face, and carry derivatives also of a node on its edge
        for _ in range(POLISH):
            gradient = jax.grad(lambda at: jnp.sum((place(at, own) - x) ** 2))
            at = at - _solved(jax.jacfwd(gradient)(at), gradient(at))
        slope = jax.jacfwd(place)(at, own)
        normal = jnp.cross(slope[:, 0], slope[:, 1]) if len(x) == 3 else jnp.stack([slope[1, 0], -slope[0, 0]])
        length = jnp.sqrt(jnp.sum(normal**2))
        return place(at, own), normal / jnp.where(length > 0, length, 1)

    def _searched(
        self, x: Float[Array, " d"], start: Float[Array, " e"], coefficients: Float[Array, "k d"]
    ) -> Float[Array, " e"]:
        place = functools.partial(_place, powers=polynomials(self.kind)[0])

        def nearer(at, _):
            slope, off = jax.jacfwd(place)(at, coefficients), place(at, coefficients) - x
            right = jnp.sum(slope * off[:, None], axis=0)
            step = _solved(jnp.sum(slope[:, :, None] * slope[:, None], axis=0), right)
            at = jnp.clip(at - jnp.clip(step, -0.5, 0.5), 0, 1)
            return at / jnp.maximum(jnp.sum(at), 1) if SHAPES[self.kind] == "triangle" else at, None

        return jax.lax.scan(nearer, start, length=SEARCH)[0]


def _place(at: Float[Array, " e"], coefficients: Float[Array, "k d"], powers: np.ndarray) -> Float[Array, " d"]:
    """Evaluates a face's polynomial; powers are products, safe at zero in every derivative."""
    table = [jnp.ones_like(at)]
    for _ in range(int(powers.max())):
        table.append(table[-1] * at)
    table = jnp.stack(table)
    monomials = functools.reduce(jnp.multiply, [table[powers[:, axis], axis] for axis in range(powers.shape[1])])
    return jnp.sum(monomials[:, None] * coefficients, axis=0)


def _solved(matrix: Float[Array, "e e"], right: Float[Array, " e"]) -> Float[Array, " e"]:
    """Solves for one or two unknowns; a singular matrix gives zero."""
    if len(right) == 1:
        return right / jnp.where(matrix[0] != 0, matrix[0], jnp.inf)
    whole = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    first = matrix[1, 1] * right[0] - matrix[0, 1] * right[1]
    second = matrix[0, 0] * right[1] - matrix[1, 0] * right[0]
    return jnp.stack([first, second]) / jnp.where(whole != 0, whole, jnp.inf)


@functools.cache
def polynomials(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Exponents (k, e) of a side's polynomial, and coefficients (k, s) by its nodes."""
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    monomials = np.prod(complete.reference[:, None] ** complete.lattice[None], axis=2)
    return complete.lattice, np.linalg.solve(monomials, completion)


LIFTS = 4  # steps along the normal to the surface; each leaves a small share of the distance
CANCELLED = 1e-3  # length of a sum of unit normals, over their number, that is no direction: a thin plate's


class SmoothFaces(Faceted):
    """The smooth surface through the nodes of faces: triangles, or lines in 2-D.

    A place p of a face goes up to p + (p' - p) / 2, where p' is the mean of the places below p on
    the tangent planes of the face's nodes. A parabola is met exactly, faces in one plane stay it.
    The normal is the mean of the nodes' normals. It has no jump, but the surface has a tiny one.
    Source: Boubekeur and Alexa, Phong tessellation, ACM Trans. Graph. 27, 2008.
    """

    def normals(self, vertices):
        """Unit normals at the vertices, exact on a sphere (a circle in 2-D). At a rim, where faces
        lie on one side only, the normals of inner vertices go on. Source: Max, Weights for
        computing vertex normals from facet normals, J. Graph. Tools 4, 1999.
        """
        faces = jnp.asarray(self.faces)
        corners, size = vertices[faces], faces.shape[1]
        flat, none = jax.vmap(normal_of)(corners), jnp.zeros(len(vertices), vertices.dtype)
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
        return jnp.where((turns != 0)[:, None], self._beyond(vertices, unit, turns != 0), unit)

    def _beyond(
        self, vertices: Float[Array, "v d"], unit: Float[Array, "v d"], is_rim: Bool[Array, " v"]
    ) -> Float[Array, "v d"]:
        """Continues the normals of inner vertices along edges, exact on a sphere. A short edge
        counts most: sides of quads count more than diagonals. Without inner neighbours a vertex
        keeps its normal.
        """
        faces = jnp.asarray(self.faces)
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

    def _nearest(self, x, vertices, normals):
        vertex = jnp.argmin(jnp.sum((vertices - x[None]) ** 2, axis=1))
        faces = jnp.asarray(self.faces)[jnp.asarray(self.around)[vertex]]

        def nearer(state, _):
            place, _ = state
            surface, normal = _raised(place, vertices[faces], normals[faces])
            return (place - jnp.sum((place - surface) * normal) * normal, normal), None

        return jax.lax.scan(nearer, (x, jnp.zeros_like(x)), length=LIFTS)[0]


def _raised(
    x: Float[Array, " d"], corners: Float[Array, "w d d"], normals: Float[Array, "w d d"]
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    place, chosen = _closest(x, corners)
    corner, normal = corners[chosen], normals[chosen]
    sides = corner[1:] - corner[0][None]
    gram = jnp.matmul(sides, sides.T, precision="highest")
    rest = _solved(gram, jnp.matmul(sides, place - corner[0], precision="highest"))
    shares = jnp.concatenate([1 - jnp.sum(rest, keepdims=True), rest])
    above = jnp.sum((corner - place[None]) * normal, axis=1)
    mean = jnp.matmul(shares, normal, precision="highest")
    lift = jnp.matmul(shares * above, normal, precision="highest")
    length = norm(mean)  # zero where both sides of a plate cancel out
    return place + lift / 2, jnp.where(length > CANCELLED, mean / jnp.where(length > 0, length, 1), normal_of(corner))


def _unit(vectors: Float[Array, "v d"], noise: Float[Array, " v"]) -> Float[Array, "v d"]:
    """Scales vectors to length one; a vector no longer than `noise` becomes zero."""
    length = norm(vectors)
    return vectors * jnp.where(length > noise, 1 / jnp.where(length > 0, length, 1), 0)[:, None]
