"""The closest place on faces between nodes, traced: flat ones, curved ones, a smooth surface."""

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

from .._host.cells.adjacency import columns_of, is_single, sorted_columns
from .._host.cells.lagrange import lagrange_types
from .._host.cells.topology import SHAPES
from .._host.surface.gaps import Closest, closest
from .._host.tolerances import AT_VERTEX, CANCELLED
from .._kernels.module import Module
from .._kernels.values import Either, add_at, area_vectors, constant, namespace, norm

Point = Float[Array, " d"]
Vertices = Float[Either, "v d"]
Places = Float[Array, "k d"]
Place = tuple[Point, Point]
Simplices = Float[Array, "w d d"]
Corners = Int[Either, "e c"]
Share = Float[Array, " e"]

FLAT_FACES = "flat"
SMOOTH_FACES = "smooth"
"""Kinds of faces; any other is a type of the sides of curved cells."""

POINTS_OF_BLOCK = 512  # nodes in a block
# steps of Gauss and Newton inside each face near a point; of Newton on the nearest face
SEARCH = 8
POLISH = 2
LIFTS = 4  # steps along the normal to a smooth surface; each leaves a small share of the distance


class FaceSearch(Module):
    """Finds the closest place on faces between nodes: triangles, or lines in 2-D.

    - `nodes` (v,): ids or rows of the nodes, `vertices` (v, d): their places.
    - `faces` (e, c): corners, as rows of `vertices`.
    - `kind`: `FLAT_FACES`; `SMOOTH_FACES`, the surface through the vertices; or the type of `sides`
      (q, s), rows of `vertices`: curved sides of cells, whose pieces are the `faces`.
    - `around` (v, w): faces, or sides, near every vertex, which `closest` compares; the last one
      fills up a row.
    """

    nodes: Int[Either, " v"]
    vertices: Float[Either, "v d"]
    faces: Int[Either, "e c"]
    around: Int[Either, "v w"] | None = None
    sides: Int[Either, "q s"] | None = None
    kind: str = eqx.field(static=True, default=FLAT_FACES)

    @classmethod
    def of(cls, nodes: Any, vertices: Any, faces: Any, kind: str = FLAT_FACES) -> "FaceSearch":
        around = faces_around(np.asarray(faces), len(vertices))
        return cls(nodes, vertices, faces, around, kind=kind)

    def on_curved(self, sides: Int[np.ndarray, "q s"], kind: str) -> "FaceSearch":
        """Takes the curved sides, of one type, of which the faces are pieces."""
        around = faces_around(sides, len(self.vertices))
        return dataclasses.replace(self, around=around, sides=sides, kind=kind)

    def at(self, points: Float[Array, "n d"]) -> "FaceSearch":
        """Moves the vertices to where their nodes are among other points."""
        return dataclasses.replace(self, vertices=points[self.nodes])

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "FaceSearch":
        return dataclasses.replace(self, nodes=place[np.asarray(self.nodes)])

    def closest(self, x: Places) -> tuple[Places, Places]:
        """Finds the closest place to each of `x`, and the unit normal there. Traced."""
        vertices = jnp.asarray(self.vertices, x.dtype)
        faces = jnp.asarray(self.faces)
        sides = faces if self.sides is None else jnp.asarray(self.sides)
        if self.kind == FLAT_FACES:
            normals = mean_normals(vertices, faces)
        elif self.kind == SMOOTH_FACES:
            normals = smooth_normals(vertices, faces)
        else:
            normals = None

        def place(point: Point) -> Place:
            vertex = jnp.argmin(jnp.sum((vertices - point[None]) ** 2, axis=1))
            near = sides[jnp.asarray(self.around)[vertex]]
            if normals is None:
                return _on_curved(point, vertices[near], self.kind)
            if self.kind == SMOOTH_FACES:
                return _on_smooth(point, vertices[near], normals[near])
            return _on_flat(point, vertices[near], vertices[vertex], normals[vertex])

        return jax.lax.map(place, x, batch_size=POINTS_OF_BLOCK)

    def find(self, x: Float[np.ndarray, "k d"]) -> Closest:
        """Finds, on the host, the faces that are closest to each of `x`, exactly."""
        return closest(np.asarray(self.vertices)[np.asarray(self.faces)], x)

    def at_rim(self) -> Bool[np.ndarray, "e c"]:
        """Marks, on the host, corners whose opposite edge (2-D: end) is of no other face."""
        faces = np.asarray(self.faces)
        edges = np.stack([np.delete(faces, k, axis=1) for k in range(faces.shape[1])], axis=1)
        columns = columns_of(edges.reshape(faces.size, -1))
        return is_single(sorted_columns(columns, len(columns))).reshape(faces.shape)


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


def on_simplices(x: Float[Either, "k d"], corners: Float[Either, "k c d"]) -> Any:
    """Finds the closest places (k, d), each on a triangle or line of its own."""
    xp = namespace(x)
    edges = xp.roll(corners, -1, axis=1) - corners
    squared = xp.sum(edges**2, axis=2)
    along = xp.sum((x[:, None] - corners) * edges, axis=2) / xp.where(squared > 0, squared, 1)
    on_edges = corners + xp.clip(along, 0, 1)[:, :, None] * edges
    if corners.shape[1] == 2:
        return on_edges[:, 0]
    normal = _scale_to_one(area_vectors(corners), 0)
    in_plane = x - xp.sum((x - corners[:, 0]) * normal, axis=1)[:, None] * normal
    sides = xp.sum(xp.cross(edges, in_plane[:, None] - corners) * normal[:, None], axis=2)
    is_inside = xp.min(sides, axis=1) >= 0
    away = constant(xp.sum((on_edges - x[:, None]) ** 2, axis=2))
    nearest = on_edges[xp.arange(len(x)), xp.argmin(away, axis=1)]
    return xp.where(is_inside[:, None], in_plane, nearest)


def _nearest_row(x: Point, places: Float[Array, "w d"]) -> Int[Array, ""]:
    return jnp.argmin(jax.lax.stop_gradient(jnp.sum((places - x[None]) ** 2, axis=1)))


def _on_nearest(x: Point, corners: Simplices) -> tuple[Point, Int[Array, ""]]:
    """The closest place on several flat faces, and the number of its face."""
    places = on_simplices(jnp.broadcast_to(x, (len(corners), len(x))), corners)
    chosen = _nearest_row(x, places)
    return places[chosen], chosen


def _on_flat(x: Point, corners: Simplices, vertex: Point, smooth: Point) -> Place:
    """On flat faces. At a vertex several meet: the tangent there is across their mean normal."""
    place, chosen = _on_nearest(x, corners)
    size = jnp.max(jnp.sum((corners[:, 1] - corners[:, 0]) ** 2, axis=1))
    is_vertex = jnp.sum((x - vertex) ** 2) <= AT_VERTEX * size
    tangent = x - jnp.sum((x - vertex) * smooth) * smooth
    normal = jnp.where(is_vertex, smooth, _normal_of(corners[chosen]))
    return jnp.where(is_vertex, tangent, place), normal


def _on_smooth(x: Point, corners: Simplices, normals: Simplices) -> Place:
    """On the smooth surface through the vertices.

    A place p of a face goes up to p + (p' - p) / 2, where p' is the mean of the places below p on
    the tangent planes of the face's vertices. A parabola is met exactly, faces in one plane stay
    it. The normal is the mean of the vertices' normals. It has no jump, the surface a tiny one.
    Source: Boubekeur and Alexa, Phong tessellation, ACM Trans. Graph. 27, 2008.
    """

    def nearer(state, _):
        place, _ = state
        surface, normal = _raise(place, corners, normals)
        return (place - jnp.sum((place - surface) * normal) * normal, normal), None

    return jax.lax.scan(nearer, (x, jnp.zeros_like(x)), length=LIFTS)[0]


def _raise(x: Point, corners: Simplices, normals: Simplices) -> Place:
    place, chosen = _on_nearest(x, corners)
    corner = corners[chosen]
    normal = normals[chosen]
    sides = corner[1:] - corner[0][None]
    gram = jnp.matmul(sides, sides.T, precision="highest")
    rest = solve_small(gram, jnp.matmul(sides, place - corner[0], precision="highest"))
    shares = jnp.concatenate([1 - jnp.sum(rest, keepdims=True), rest])
    above = jnp.sum((corner - place[None]) * normal, axis=1)
    mean = jnp.matmul(shares, normal, precision="highest")
    lift = jnp.matmul(shares * above, normal, precision="highest")
    length = norm(mean)  # zero where both sides of a plate cancel out
    return place + lift / 2, jnp.where(
        length > CANCELLED, mean / jnp.where(length > 0, length, 1), _normal_of(corner)
    )


def _on_curved(x: Point, corners: Float[Array, "w s d"], kind: str) -> Place:
    """On polynomials: of cells' sides of one type, by their nodes."""
    powers, matrix = _polynomials(kind)
    coefficients = jnp.einsum(
        "ks,wsd->wkd", jnp.asarray(matrix, x.dtype), corners, precision="highest"
    )
    first = jnp.argmin(jnp.sum((corners - x[None, None]) ** 2, axis=2), axis=1)
    start = jnp.asarray(lagrange_types()[kind].reference, x.dtype)[first]
    value = functools.partial(_evaluate, powers=powers)
    search = functools.partial(_search_inside, x, kind=kind)
    found = jax.lax.stop_gradient(jax.vmap(search)(start, coefficients))
    chosen = _nearest_row(x, jax.vmap(value)(found, coefficients))
    at = found[chosen]
    own = coefficients[chosen]
    # the last steps go beyond the face, and carry derivatives also of a node on its edge
    for _ in range(POLISH):
        gradient = jax.grad(lambda at: jnp.sum((value(at, own) - x) ** 2))
        at = at - solve_small(jax.jacfwd(gradient)(at), gradient(at))
    slope = jax.jacfwd(value)(at, own)
    corners = jnp.concatenate([jnp.zeros_like(x)[None], *slope.T[:, None]])
    return value(at, own), _normal_of(corners)


def _search_inside(x: Point, start: Share, coefficients: Float[Array, "k d"], kind: str) -> Share:
    value = functools.partial(_evaluate, powers=_polynomials(kind)[0])

    def nearer(at, _):
        slope = jax.jacfwd(value)(at, coefficients)
        off = value(at, coefficients) - x
        right = jnp.sum(slope * off[:, None], axis=0)
        step = solve_small(jnp.sum(slope[:, :, None] * slope[:, None], axis=0), right)
        at = jnp.clip(at - jnp.clip(step, -0.5, 0.5), 0, 1)
        return at / jnp.maximum(jnp.sum(at), 1) if SHAPES[kind] == "triangle" else at, None

    return jax.lax.scan(nearer, start, length=SEARCH)[0]


def _evaluate(at: Share, coefficients: Float[Array, "k d"], powers: np.ndarray) -> Point:
    """Evaluates a face's polynomial; whole powers are safe at zero in every derivative."""
    monomials = [
        math.prod(x**power for x, power in zip(at, row, strict=True)) for row in powers.tolist()
    ]
    return jnp.sum(jnp.stack(monomials)[:, None] * coefficients, axis=0)


@functools.cache
def _polynomials(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Exponents (k, e) of a side's polynomial, and coefficients (k, s) by its nodes."""
    name, completion = lagrange_types()[kind].completion()
    complete = lagrange_types()[name]
    monomials = np.prod(complete.reference[:, None] ** complete.lattice[None], axis=2)
    return complete.lattice, np.linalg.solve(monomials, completion)


def solve_small(matrix: Float[Array, "e e"], right: Share) -> Share:
    """Solves a symmetric system of one or two unknowns; a singular matrix gives zero."""
    signs = jnp.asarray([[1, -1], [-1, 1]])[: len(right), : len(right)]
    # of one unknown the adjugate is the matrix itself, and the determinant its square
    adjugate = matrix[::-1, ::-1] * signs
    size = jnp.sum(matrix[0] * adjugate[0])
    return jnp.sum(adjugate * right[None], axis=1) / jnp.where(size != 0, size, jnp.inf)


def _normal_of(corners: Float[Array, "d d"]) -> Point:
    return _scale_to_one(area_vectors(corners[None]), 0)[0]


def mean_normals(vertices: Vertices, faces: Corners) -> Vertices:
    """Computes unit normals at vertices: the mean of their faces', by area."""
    areas = area_vectors(vertices[faces])
    return _scale_to_one(jnp.zeros_like(vertices).at[faces].add(areas[:, None]), 0)


def smooth_normals(vertices: Vertices, faces: Corners) -> Vertices:
    """Computes unit normals at vertices, exact on a sphere (a circle in 2-D).

    At a rim, where faces lie on one side only, the normals of inner vertices go on. Source: Max,
    Weights for computing vertex normals from facet normals, J. Graph. Tools 4, 1999.
    """
    xp = namespace(vertices)
    corners = vertices[faces]
    size = faces.shape[1]
    areas = area_vectors(corners)
    others = xp.stack([xp.roll(corners, -step, axis=1) - corners for step in range(1, size)])
    squared = xp.prod(xp.sum(others**2, axis=3), axis=0)
    weight = norm(areas)[:, None] / xp.where(squared > 0, squared, xp.inf)
    total, weights = _sum_rows(
        faces, len(vertices), weight[..., None] * _scale_to_one(areas, 0)[:, None], weight
    )
    # Round an inner vertex each neighbour comes first once and last once: ids cancel out.
    if size == 3:
        turns = xp.roll(faces, -1, axis=1) - xp.roll(faces, 1, axis=1)
    else:
        turns = xp.asarray([[1, -1]], faces.dtype) + 0 * faces
    is_rim = add_at(xp.zeros(len(vertices), faces.dtype), faces, turns) != 0
    unit = _scale_to_one(total, CANCELLED * weights)
    return xp.where(is_rim[:, None], _go_on(vertices, faces, unit, is_rim), unit)


def _go_on(
    vertices: Vertices, faces: Corners, unit: Vertices, is_rim: Bool[Either, " v"]
) -> Vertices:
    """Continues the normals of inner vertices along edges, exact on a sphere. A short edge counts
    most: sides of quads count more than diagonals. Without inner neighbours a vertex keeps its
    normal.
    """
    xp = namespace(vertices)
    first, second = np.array(list(itertools.permutations(range(faces.shape[1]), 2))).T
    here = faces[:, first]
    there = faces[:, second]
    other = unit[there]
    side = vertices[here] - vertices[there]
    squared = xp.sum(side**2, axis=2)
    length = xp.where(squared > 0, squared, 1)
    reach = xp.max(squared[:, 0])
    weight = xp.where(is_rim[there] | (squared <= 0), 0, reach / length) ** 2
    share = xp.sum(other * side, axis=2) / length
    total, weights = _sum_rows(
        here, len(unit), weight[..., None] * (other - 2 * share[..., None] * side), weight
    )
    goes_on = norm(total) > CANCELLED * weights
    return xp.where(goes_on[:, None], _scale_to_one(total, CANCELLED * weights), unit)


def _sum_rows(
    rows: Corners,
    count: int,
    vectors: Float[Either, "e c d"],
    weights: Float[Either, "e c"],
):
    """Sums of vectors and of weights by row."""
    xp = namespace(vectors)
    total = add_at(xp.zeros((count, vectors.shape[2]), vectors.dtype), rows, vectors)
    return total, add_at(xp.zeros(count, weights.dtype), rows, weights)


def _scale_to_one(vectors: Vertices, noise: Float[Either, " v"] | int) -> Vertices:
    """Scales vectors to length one; a vector no longer than `noise` becomes zero."""
    xp = namespace(vectors)
    length = norm(vectors)
    return vectors * xp.where(length > noise, 1 / xp.where(length > 0, length, 1), 0)[:, None]
