"""Walls along which nodes slide, traced: planes, surfaces of revolution, own faces."""

import abc
import dataclasses
import functools
import itertools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import csr_array

from .._host.cells.lagrange import lagrange_types
from .._host.cells.topology import SHAPES
from .._host.surface.gaps import closest
from .._kernels.module import Module
from .._kernels.values import Either, area_vectors, norm

Point = Float[Array, " d"]
Vertices = Float[Array, "v d"]
Number = Int[Array, ""]
Places = Float[Array, "k d"]
Coordinates = Float[Either, "v d"]
Ids = Int[Either, " v"]
Corners = Int[Either, "e d"]

# component of a unit normal that counts as zero: coordinates in files have few digits
ALONG_AXIS = 1e-7
# distance from the end of faces that counts as zero: relative to their extent, or share of a corner
END = 1e-9
BLOCK = 512  # nodes in a block
SEARCH, POLISH = (
    8,
    2,
)  # steps of Gauss and Newton inside each face near a point; of Newton on the nearest face
LIFTS = 4  # steps along the normal to a smooth surface; each leaves a small share of the distance
# length of a sum of unit normals, over their number, that is no direction: a thin plate's
CANCELLED = 1e-3


class AbstractWall(Module):
    """A surface (a curve in 2-D) on which nodes stay."""

    @abc.abstractmethod
    def height(self, x: Places) -> tuple[Float[Array, " k"], Places]:
        """Measures signed distances of points from the wall, and their unit normals."""

    @property
    def is_flat(self) -> bool:
        """True for a plane, to which one step leads, linear in the point."""
        return False

    def distance(self, x: Places) -> Float[Array, " k"]:
        return jnp.abs(self.height(x)[0])

    def at(self, points: Float[Array, "n d"]) -> "AbstractWall":
        """Moves the wall to other base points: the patch's own faces follow, a surface stays."""
        return self

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "AbstractWall":
        return self

    def has_end(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points at or beyond an end of the wall."""
        return np.zeros(len(x), dtype=bool)

    def is_apex(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points of the wall without a normal: the apex of a cone."""
        return np.zeros(len(x), dtype=bool)


class Flat(AbstractWall):
    normal: Float[Either, " d"]
    origin: Float[Either, " d"]

    def height(self, x):
        normal = jnp.asarray(self.normal, x.dtype)
        above = jnp.matmul(x - jnp.asarray(self.origin, x.dtype)[None], normal, precision="highest")
        return above, jnp.broadcast_to(normal, x.shape)

    @property
    def is_flat(self) -> bool:
        return True


class Round(AbstractWall):
    """A circle in 2-D, a surface of revolution in 3-D: radii are cubic in places along the axis."""

    axis: Float[Either, " d"]  # direction, zero in 2-D
    origin: Float[Either, " d"]  # a point on the axis
    knots: Float[
        Either, " l"
    ]  # places along the axis; of one straight piece without ends 0 and infinity
    spline: Float[Either, "4 k"]  # coefficients of the radius, cubic ones first

    @property
    def is_straight(self) -> bool:
        """True for one piece, a circle, cylinder or cone, to which one step leads."""
        return len(self.knots) == 2

    def height(self, x):
        axis = jnp.asarray(self.axis, x.dtype)
        arm = x - jnp.asarray(self.origin, x.dtype)[None]
        along = jnp.matmul(arm, axis, precision="highest")
        outward = arm - along[:, None] * axis[None]
        radius = norm(outward)
        outward = outward / jnp.where(radius > 0, radius, 1)[:, None]
        knots = jnp.asarray(self.knots, x.dtype)
        spline = jnp.asarray(self.spline, x.dtype)
        piece = jnp.clip(jnp.searchsorted(knots, along, side="right") - 1, 0, spline.shape[1] - 1)
        t, (cubic, square, slope, value) = along - knots[piece], spline[:, piece]
        steep = slope + t * (2 * square + 3 * t * cubic)
        share = 1 / jnp.sqrt(1 + steep**2)
        above = (radius - value - t * (slope + t * (square + t * cubic))) * share
        return above, share[:, None] * (outward - steep[:, None] * axis[None])

    def has_end(self, x):
        along, (low, *_, high) = (
            (x - np.asarray(self.origin)) @ np.asarray(self.axis),
            np.asarray(self.knots),
        )
        slack = 1e-9 * (high - low)
        return np.asarray((along < low - slack) | (along > high + slack))

    def is_apex(self, x):
        axis = np.asarray(self.axis)
        arm = x - np.asarray(self.origin)
        radius = np.linalg.norm(arm - (arm @ axis)[:, None] * axis, axis=1)
        return np.asarray(axis.any() & (radius <= ALONG_AXIS * np.ptp(x, axis=0).max()))


class FlatFaces(Flat):
    """The plane (the line in 2-D) of a patch's own faces. `nodes` (v,) are ids or rows of the
    patch's nodes, `vertices` (v, d) their places, `faces` (e, d) corners, as rows of `vertices`.
    """

    nodes: Ids
    vertices: Coordinates
    faces: Corners

    def at(self, points):
        patch = points[self.nodes]
        old = jnp.asarray(self.normal, points.dtype)
        areas = area_vectors(patch[jnp.asarray(self.faces)])
        areas = (
            areas * jnp.where(jnp.matmul(areas, old) < 0, -1, 1)[:, None]
        )  # both sides of a baffle add up
        total = jnp.sum(areas, axis=0)
        normal = total / norm(total)
        # The usual wall is at right angles to an axis: an exact normal keeps the coordinate bit for
        # bit.
        sharp = jnp.where(jnp.abs(normal) < ALONG_AXIS, 0, normal)
        normal = normal + jax.lax.stop_gradient(sharp / norm(sharp) - normal)
        return FlatFaces(normal, jnp.mean(patch, axis=0), self.nodes, patch, self.faces)

    def has_end(self, x):
        normal = np.asarray(self.normal)
        patch = np.asarray(self.vertices)
        inside = x - ((x - np.asarray(self.origin)) @ normal)[:, None] * normal
        return np.asarray(
            closest(patch[np.asarray(self.faces)], inside)[2] > END * np.ptp(patch, axis=0).max()
        )

    def renumbered(self, place):
        return dataclasses.replace(self, nodes=place[np.asarray(self.nodes)])


class Faceted(AbstractWall):
    """Linear faces between nodes: triangles, or lines in 2-D."""

    nodes: Ids  # ids or rows of the nodes
    vertices: Coordinates  # their places
    faces: Corners  # corners, as rows of `vertices`
    around: Int[Either, "v w"]  # faces near every vertex; the last face fills up a row

    @classmethod
    def of(cls, nodes: Ids, vertices: Coordinates, faces: Corners) -> "Faceted":
        return cls(nodes, vertices, faces, faces_around(np.asarray(faces), len(vertices)))

    def height(self, x):
        place, normal = self.nearest(x)
        return jnp.sum((x - place) * normal, axis=1), normal

    def distance(self, x):
        return norm(x - self.nearest(x)[0])

    def has_end(self, x):
        faces = np.asarray(self.faces)
        face, shares, _ = closest(np.asarray(self.vertices)[faces], x)
        # corners whose opposite edge (2-D: end) is of no other face
        sides = np.stack(
            [np.delete(np.sort(faces, axis=1), k, axis=1) for k in range(faces.shape[1])], axis=1
        )
        _, place, count = np.unique(
            sides.reshape(faces.size, -1), axis=0, return_inverse=True, return_counts=True
        )
        is_rim = (count[place.ravel()] == 1).reshape(faces.shape)
        is_rim = np.take_along_axis(is_rim, np.argsort(np.argsort(faces, axis=1), axis=1), axis=1)
        return np.asarray(((shares <= END) & is_rim[face]).any(axis=1))

    def at(self, points):
        return dataclasses.replace(self, vertices=points[self.nodes])

    def renumbered(self, place):
        return dataclasses.replace(self, nodes=place[np.asarray(self.nodes)])

    def nearest(self, x: Places) -> tuple[Places, Places]:
        vertices = jnp.asarray(self.vertices, x.dtype)
        normals = self.normals(vertices)
        return jax.lax.map(
            lambda point: self._nearest(point, vertices, normals), x, batch_size=BLOCK
        )

    def normals(self, vertices: Vertices) -> Vertices:
        """Computes unit normals at the vertices, smoothed over their faces."""
        areas = area_vectors(vertices[jnp.asarray(self.faces)])
        return _unit(jnp.zeros_like(vertices).at[jnp.asarray(self.faces)].add(areas[:, None]), 0)

    def _nearest(self, x: Point, vertices: Vertices, normals: Vertices) -> tuple[Point, Point]:
        vertex, faces = self._near(x, vertices, self.faces)
        corners = vertices[faces]
        place, chosen = _closest(x, corners)
        # At a node several faces meet. There the tangent is at right angles to the mean normal of
        # the faces.
        node = vertices[vertex]
        smooth = normals[vertex]
        size = jnp.max(jnp.sum((corners[:, 1] - corners[:, 0]) ** 2, axis=1))
        is_node = jnp.sum((x - node) ** 2) <= 1e-20 * size
        tangent = x - jnp.sum((x - node) * smooth) * smooth
        return jnp.where(is_node, tangent, place), jnp.where(
            is_node, smooth, normal_of(corners[chosen])
        )

    def _near(self, x: Point, vertices: Vertices, faces: Any) -> tuple[Number, Int[Array, "w s"]]:
        """The vertex nearest to x, and the nodes of the faces near it."""
        vertex = jnp.argmin(jnp.sum((vertices - x[None]) ** 2, axis=1))
        return vertex, jnp.asarray(faces)[jnp.asarray(self.around)[vertex]]


def _closest(x: Point, corners: Float[Array, "w d d"]) -> tuple[Point, Number]:
    """Finds the nearest place of triangles, or of lines, and the number of its face."""
    places = jax.vmap(nearest_of, in_axes=(None, 0))(x, corners)
    chosen = _first_nearest(x, places)
    return places[chosen], chosen


def _first_nearest(x: Point, places: Float[Array, "w d"]) -> Number:
    return jnp.argmin(jax.lax.stop_gradient(jnp.sum((places - x[None]) ** 2, axis=1)))


def nearest_of(x: Point, corners: Float[Array, "c d"]) -> Point:
    edges = jnp.roll(corners, -1, axis=0) - corners
    squared = jnp.sum(edges**2, axis=1)
    along = jnp.sum((x[None] - corners) * edges, axis=1) / jnp.where(squared > 0, squared, 1)
    on_edges = corners + jnp.clip(along, 0, 1)[:, None] * edges
    if len(corners) == 2:
        return on_edges[0]
    normal = normal_of(corners)
    in_plane = x - jnp.sum((x - corners[0]) * normal) * normal
    is_inside = (
        jnp.min(jnp.matmul(jnp.cross(edges, in_plane[None] - corners), normal, precision="highest"))
        >= 0
    )
    return jnp.where(is_inside, in_plane, on_edges[_first_nearest(x, on_edges)])


def normal_of(corners: Float[Array, "d d"]) -> Point:
    return _unit(area_vectors(corners[None]), 0)[0]


def faces_around(elements: Int[np.ndarray, "e c"], count: int) -> Int[np.ndarray, "v w"]:
    """The faces at each of `count` vertices and its neighbours; the last face fills a row."""
    ids = np.repeat(np.arange(len(elements)), elements.shape[1])
    touch = csr_array((np.ones(ids.size), (elements.ravel(), ids)), shape=(count, len(elements)))
    near = csr_array(touch @ touch.T @ touch)
    sizes = np.diff(near.indptr)
    steps = np.minimum(np.arange(sizes.max())[None], np.maximum(sizes - 1, 0)[:, None])
    return near.indices[np.minimum(near.indptr[:-1, None] + steps, len(near.indices) - 1)].astype(
        np.int32
    )


class CurvedFaces(Faceted):
    """The curved faces of one type between nodes: the polynomials of the cells' sides.

    - `nodes`, `vertices`, `faces`: as in `Faceted`, for linear pieces of the faces.
    - `around` (v, w): curved faces near every vertex.
    - `sides` (q, s): the nodes of each face, as rows of `vertices`; their type is `kind`.
    """

    sides: Int[Either, "q s"]
    kind: str = eqx.field(static=True)

    def normals(self, vertices):
        return vertices  # a polynomial has its own normals

    def _nearest(self, x, vertices, normals):
        powers, matrix = polynomials(self.kind)
        corners = vertices[self._near(x, vertices, self.sides)[1]]
        coefficients = jnp.einsum(
            "ks,wsd->wkd", jnp.asarray(matrix, x.dtype), corners, precision="highest"
        )
        first = jnp.argmin(jnp.sum((corners - x[None, None]) ** 2, axis=2), axis=1)
        start = jnp.asarray(lagrange_types()[self.kind].reference, x.dtype)[first]
        place = functools.partial(_place, powers=powers)
        found = jax.lax.stop_gradient(
            jax.vmap(self._searched, in_axes=(None, 0, 0))(x, start, coefficients)
        )
        chosen = _first_nearest(x, jax.vmap(place)(found, coefficients))
        at = found[chosen]
        own = coefficients[chosen]
        # the last steps go beyond the face, and carry derivatives also of a node on its edge
        for _ in range(POLISH):
            gradient = jax.grad(lambda at: jnp.sum((place(at, own) - x) ** 2))
            at = at - solved(jax.jacfwd(gradient)(at), gradient(at))
        slope = jax.jacfwd(place)(at, own)
        return place(at, own), normal_of(
            jnp.concatenate([jnp.zeros_like(x)[None], *slope.T[:, None]])
        )

    def _searched(
        self, x: Point, start: Float[Array, " e"], coefficients: Float[Array, "k d"]
    ) -> Float[Array, " e"]:
        place = functools.partial(_place, powers=polynomials(self.kind)[0])

        def nearer(at, _):
            slope = jax.jacfwd(place)(at, coefficients)
            off = place(at, coefficients) - x
            right = jnp.sum(slope * off[:, None], axis=0)
            step = solved(jnp.sum(slope[:, :, None] * slope[:, None], axis=0), right)
            at = jnp.clip(at - jnp.clip(step, -0.5, 0.5), 0, 1)
            return at / jnp.maximum(jnp.sum(at), 1) if SHAPES[self.kind] == "triangle" else at, None

        return jax.lax.scan(nearer, start, length=SEARCH)[0]


def _place(at: Float[Array, " e"], coefficients: Float[Array, "k d"], powers: np.ndarray) -> Point:
    """Evaluates a face's polynomial; whole powers are safe at zero in every derivative."""
    monomials = [
        math.prod(x**power for x, power in zip(at, row, strict=True)) for row in powers.tolist()
    ]
    return jnp.sum(jnp.stack(monomials)[:, None] * coefficients, axis=0)


def solved(matrix: Float[Array, "e e"], right: Float[Array, " e"]) -> Float[Array, " e"]:
    """Solves a symmetric system of one or two unknowns; a singular matrix gives zero."""
    signs = jnp.asarray([[1, -1], [-1, 1]])[: len(right), : len(right)]
    adjugate = (
        matrix[::-1, ::-1] * signs
    )  # of one unknown the matrix itself, and the square its determinant
    size = jnp.sum(matrix[0] * adjugate[0])
    return jnp.sum(adjugate * right[None], axis=1) / jnp.where(size != 0, size, jnp.inf)


@functools.cache
def polynomials(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Exponents (k, e) of a side's polynomial, and coefficients (k, s) by its nodes."""
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    monomials = np.prod(complete.reference[:, None] ** complete.lattice[None], axis=2)
    return complete.lattice, np.linalg.solve(monomials, completion)


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
        corners = vertices[faces]
        size = faces.shape[1]
        areas = area_vectors(corners)
        others = jnp.stack([jnp.roll(corners, -step, axis=1) - corners for step in range(1, size)])
        squared = jnp.prod(jnp.sum(others**2, axis=3), axis=0)
        weight = norm(areas)[:, None] / jnp.where(squared > 0, squared, jnp.inf)
        total, weights = _summed(
            faces, len(vertices), weight[..., None] * _unit(areas, 0)[:, None], weight
        )
        # Round an inner vertex each neighbour comes first once and last once: ids cancel out.
        if size == 3:
            turns = jnp.roll(faces, -1, axis=1) - jnp.roll(faces, 1, axis=1)
        else:
            turns = jnp.asarray([[1, -1]], faces.dtype) + 0 * faces
        is_rim = jnp.zeros(len(vertices), faces.dtype).at[faces].add(turns) != 0
        unit = _unit(total, CANCELLED * weights)
        return jnp.where(is_rim[:, None], self._beyond(vertices, unit, is_rim), unit)

    def _beyond(self, vertices: Vertices, unit: Vertices, is_rim: Bool[Array, " v"]) -> Vertices:
        """Continues the normals of inner vertices along edges, exact on a sphere. A short edge
        counts most: sides of quads count more than diagonals. Without inner neighbours a vertex
        keeps its normal.
        """
        faces = jnp.asarray(self.faces)
        size = faces.shape[1]
        first, second = np.array(list(itertools.permutations(range(size), 2))).T
        here = faces[:, first]
        there = faces[:, second]
        other = unit[there]
        side = vertices[here] - vertices[there]
        squared = jnp.sum(side**2, axis=2)
        length = jnp.where(squared > 0, squared, 1)
        reach = jnp.max(squared[:, 0])
        weight = jnp.where(is_rim[there] | (squared <= 0), 0, reach / length) ** 2
        share = jnp.sum(other * side, axis=2) / length
        total, weights = _summed(
            here, len(unit), weight[..., None] * (other - 2 * share[..., None] * side), weight
        )
        goes_on = norm(total) > CANCELLED * weights
        return jnp.where(goes_on[:, None], _unit(total, CANCELLED * weights), unit)

    def _nearest(self, x, vertices, normals):
        _, faces = self._near(x, vertices, self.faces)

        def nearer(state, _):
            place, _ = state
            surface, normal = _raised(place, vertices[faces], normals[faces])
            return (place - jnp.sum((place - surface) * normal) * normal, normal), None

        return jax.lax.scan(nearer, (x, jnp.zeros_like(x)), length=LIFTS)[0]


def _summed(
    rows: Int[Array, "e c"],
    count: int,
    vectors: Float[Array, "e c d"],
    weights: Float[Array, "e c"],
):
    """Sums of vectors and of weights by row."""
    total = jnp.zeros((count, vectors.shape[2]), vectors.dtype).at[rows].add(vectors)
    return total, jnp.zeros(count, weights.dtype).at[rows].add(weights)


def _raised(
    x: Point, corners: Float[Array, "w d d"], normals: Float[Array, "w d d"]
) -> tuple[Point, Point]:
    place, chosen = _closest(x, corners)
    corner = corners[chosen]
    normal = normals[chosen]
    sides = corner[1:] - corner[0][None]
    gram = jnp.matmul(sides, sides.T, precision="highest")
    rest = solved(gram, jnp.matmul(sides, place - corner[0], precision="highest"))
    shares = jnp.concatenate([1 - jnp.sum(rest, keepdims=True), rest])
    above = jnp.sum((corner - place[None]) * normal, axis=1)
    mean = jnp.matmul(shares, normal, precision="highest")
    lift = jnp.matmul(shares * above, normal, precision="highest")
    length = norm(mean)  # zero where both sides of a plate cancel out
    return place + lift / 2, jnp.where(
        length > CANCELLED, mean / jnp.where(length > 0, length, 1), normal_of(corner)
    )


def _unit(vectors: Vertices, noise: Float[Array, " v"] | int) -> Vertices:
    """Scales vectors to length one; a vector no longer than `noise` becomes zero."""
    length = norm(vectors)
    return vectors * jnp.where(length > noise, 1 / jnp.where(length > 0, length, 1), 0)[:, None]
