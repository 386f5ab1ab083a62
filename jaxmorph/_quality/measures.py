"""Measures of a cell, from the coordinates of its corners.

Each function takes the cell's type and `x`, the corners of k cells: one vector for each corner,
numbered as VTK numbers them, relative to the first one. For measures without unit they are divided
by the cell's size, so that products of lengths stay within float32. The definitions are those of
Verdict, the library behind VTK's cell quality (Stimpson et al., The Verdict geometric quality
library, SAND2007-1751). Derivatives are finite, on cells of no size too.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from .._host.cells.lagrange import PLACES, derivatives_at_nodes, jacobian_samples
from .._host.cells.topology import CORNERS, DIMENSION, EDGES, FACES, FRAMES, HIGH_ORDER, SHAPES
from .._kernels.values import Either, constant, largest, namespace, smallest
from .vector import Scalar, Vector, angle, cross, determinant, divide, dot, mean, norm, stack, total, unit

_PARALLEL: dict[str, tuple[tuple[tuple[int, int], ...], ...]] = {
    "quad": (((0, 1), (3, 2)), ((1, 2), (0, 3))),
    "hexahedron": (
        ((0, 1), (3, 2), (4, 5), (7, 6)),
        ((0, 3), (1, 2), (4, 7), (5, 6)),
        ((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}


def pick(x: Sequence[Vector], table: tuple[tuple[int, ...], ...]) -> list[Vector]:
    """Gathers one vector for each column of corners: every face's first corner, second, ..."""
    return [stack([x[i] for i in column]) for column in _columns(table)]


def _columns(table: tuple[tuple[int, ...], ...]) -> list[tuple[int, ...]]:
    return list(zip(*table, strict=True))


def faces_by_size(kind: str) -> list[tuple[tuple[int, ...], ...]]:
    """Groups a type's faces by their number of corners; a surface cell is its own face."""
    faces = FACES[kind] if DIMENSION[kind] == 3 else (tuple(range(len(FACES[kind]))),)
    return [tuple(face for face in faces if len(face) == size) for size in sorted({len(face) for face in faces})]


def _edges(x: Sequence[Vector], kind: str) -> Vector:
    start, end = pick(x, EDGES[kind])
    return end - start


def principal_axes(kind: str, x: Sequence[Vector]) -> list[Vector]:
    """Vectors between the middles of opposite sides: of quads times 2, of hexahedra 4."""
    return [total(x[end] - x[start] for start, end in pairs) for pairs in _PARALLEL[kind]]


def face_areas(kind: str, x: Sequence[Vector]) -> Vector:
    """Area vectors (f, k) of faces, 2-D: edges, outward for a right-handed cell."""
    if DIMENSION[kind] == 3:
        groups = faces_by_size(kind)
        areas = [area_vector(pick(x, group)) for group in groups]
        joined = Vector(map(namespace(x[0][0]).concatenate, zip(*areas, strict=True)))
        faces = [face for group in groups for face in group]
        order = [faces.index(face) for face in FACES[kind]]
        return joined if order == list(range(len(order))) else stack([joined.at(i) for i in order])
    along = _edges(x, kind)
    if len(x[0]) == 2:
        return Vector((along[1], -along[0]))
    return cross(along, stack([_normal(kind, x)]))


def area_vector(corners: Sequence[Vector]) -> Vector:
    """Half the cross product of diagonals (triangle: two sides); a number in 2-D."""
    if len(corners) == 3:
        return cross(corners[1] - corners[0], corners[2] - corners[0]) * 0.5
    return cross(corners[2] - corners[0], corners[3] - corners[1]) * 0.5


def _area(kind: str, x: Sequence[Vector]) -> Vector:
    return area_vector(list(x[: CORNERS[SHAPES[kind]]]))


def _normal(kind: str, x: Sequence[Vector]) -> Vector:
    """Unit normals of triangles or quads; +1 in 2-D, where areas have a sign."""
    area = _area(kind, x)
    return Vector([namespace(area[0]).ones_like(area[0])]) if len(area) == 1 else unit(area)


def volume(kind: str, x: Sequence[Vector]) -> Scalar:
    """The signed volume, 2-D: signed area; in 3-D a surface's area; a line's length. Faces of four
    corners are bilinear: their flux is that of the mean of the corners, and the volume that of the
    trilinear cell. Of a cell of high order it is the integral of its Jacobian.
    """
    xp = namespace(x[0][0])
    if kind in HIGH_ORDER:
        values, weights = jacobians(kind, x)[0], jacobian_samples(kind)[1]
        return xp.tensordot(weights.astype(values.dtype), values, axes=1)
    if kind == "line":
        return norm(x[1] - x[0])
    if DIMENSION[kind] == 2:
        area = _area(kind, x)
        return area[0] if len(area) == 1 else norm(area)
    if kind == "tetra":
        return jacobians(kind, x)[0][0] / 6
    groups = [pick(x, group) for group in faces_by_size(kind)]
    fluxes = [xp.sum(dot(area_vector(corners), mean(corners)), axis=0) for corners in groups]
    return functools.reduce(xp.add, fluxes) / 3


def frames(kind: str, x: Sequence[Vector]) -> list[Vector]:
    """The edges that leave each corner, (s, k) each; also a hexahedron's axes. Of a cell of high
    order they are the columns of its Jacobian matrix, on a lattice and at Gauss points.
    """
    if kind in HIGH_ORDER:
        return _tangents(jacobian_samples(kind)[0], x)
    corner, *ends = _columns(FRAMES[kind])
    edges = [[x[b] - x[a] for a, b in zip(corner, column, strict=True)] for column in ends]
    if kind == "hexahedron":
        edges = [[*rows, axis * 0.25] for rows, axis in zip(edges, principal_axes(kind, x), strict=True)]
    return [stack(rows) for rows in edges]


def jacobians(kind: str, x: Sequence[Vector]) -> tuple[Float[Either, "s k"], Float[Either, "s k"]]:
    """Jacobians at corners, and a hexahedron's at its centre, as Verdict does. Each has a factor
    from an error of the coordinates to one of the Jacobian: the sum over the edges of the product
    of the other edges' lengths.
    """
    edges = frames(kind, x)
    lengths = [norm(edge) for edge in edges]
    if DIMENSION[kind] == 1:
        return lengths[0], namespace(lengths[0]).ones_like(lengths[0])
    if DIMENSION[kind] == 2:
        return dot(cross(*edges), stack([_normal(kind, x)])), lengths[0] + lengths[1]
    a, b, c = lengths
    return determinant(edges), a * b + b * c + c * a


def _tangents(derivatives: np.ndarray, x: Sequence[Vector]) -> list[Vector]:
    """Derivatives of the place by each reference coordinate, each (s, k)."""
    nodes, xp = stack(x), namespace(x[0][0])
    tables = np.moveaxis(derivatives, 2, 0).astype(nodes[0].dtype)
    return [Vector(xp.matmul(table, component) for component in nodes) for table in tables]


def linear_cells_at_nodes(kind: str, x: Sequence[Vector]) -> tuple[str, list[Vector]]:
    """Linear cells of the tangents at high-order nodes: s k cells, node by node."""
    tangents = _tangents(derivatives_at_nodes(kind), x)
    places = [[tangents[0] * 0, *itertools.compress(tangents, place)] for place in PLACES[SHAPES[kind]]]
    return SHAPES[kind], [Vector(component.reshape(-1) for component in total(parts)) for parts in places]


def openings(kind: str, x: Sequence[Vector]) -> Float[Either, "s k"]:
    """The largest Jacobians that corners could have by edge lengths; simplex: 0."""
    lengths = [constant(norm(edge)) for edge in frames(kind, x)]
    product = functools.reduce(namespace(lengths[0]).multiply, lengths)
    return product * (kind in HIGH_ORDER or (len(FRAMES[kind]) > 1 and kind != "triangle"))


def skewness(kind: str, x: Sequence[Vector], maximum: Callable[[Float[Either, "t k"]], Scalar] = largest) -> Scalar:
    """The skewness: 0 for the ideal cell, 1 for a degenerate one.

    It is the `maximum` of several terms, which may be a smooth stand-in. Quad and hexahedron: the
    largest |cos| of the angles between the principal axes (Taylor and Flanagan, SAND87-0525). The
    others: the largest deviation of an angle of a face from the equiangular one, over the largest
    there can be. For a tetrahedron the angles between faces count too. For a cell of high order it
    is the largest of the linear cells with its tangents at its nodes.
    """
    if kind in HIGH_ORDER:
        shape, cells = linear_cells_at_nodes(kind, x)
        return maximum(skewness(shape, cells, maximum).reshape(len(x), -1))
    xp = namespace(x[0][0])
    if kind == "line":
        return xp.zeros_like(x[0][0])
    if kind in _PARALLEL:
        axes = [unit(axis) for axis in principal_axes(kind, x)]
        cosines = xp.stack([dot(a, b) for a, b in itertools.combinations(axes, 2)])
        return maximum(xp.concatenate([cosines, -cosines]))
    terms = []
    for group in faces_by_size(kind):
        size, corners = len(group[0]), pick(x, group)
        angles = [angle(corners[(i + 1) % size] - here, corners[i - 1] - here) for i, here in enumerate(corners)]
        terms += _deviations(xp.concatenate(angles), math.pi * (size - 2) / size)
    if kind == "tetra":
        areas = face_areas(kind, x)
        first, second = pick([areas.at(i) for i in range(4)], tuple(itertools.combinations(range(4), 2)))
        terms += _deviations(math.pi - angle(first, second), math.acos(1 / 3))
    return maximum(xp.concatenate(terms))


def _deviations(angles: Float[Either, "a k"], ideal: float) -> list[Float[Either, "a k"]]:
    return [(angles - ideal) / (math.pi - ideal), 1 - angles / ideal]


def aspect_ratio(kind: str, x: Sequence[Vector]) -> Scalar:
    """The aspect ratio: 1 for the ideal cell, infinite for a flat one.

    Triangle: longest edge / (2 sqrt 3 inradius). Quad: longest edge times perimeter / (4 area).
    Tetrahedron: longest edge / (2 sqrt 6 inradius). Hexahedron: longest over shortest principal
    axis. Wedge and pyramid: longest over shortest edge. A cell of high order is as for `skewness`.
    """
    if kind in HIGH_ORDER:
        shape, cells = linear_cells_at_nodes(kind, x)
        return largest(aspect_ratio(shape, cells).reshape(len(x), -1))
    xp = namespace(x[0][0])
    if kind == "line":
        return xp.ones_like(x[0][0])
    over, under = aspect_terms(kind, x)
    lengths = norm(over)
    if under is None:
        return divide(largest(lengths), smallest(lengths), math.inf)
    size, surface = under
    return divide(largest(lengths) * surface, xp.abs(size), math.inf)


def aspect_terms(kind: str, x: Sequence[Vector]) -> tuple[Vector, tuple[Scalar, Scalar] | None]:
    """Edges or axes, whose ratio or longest counts, and a signed size with a sum of sides."""
    edges = stack(principal_axes(kind, x)) if kind == "hexahedron" else _edges(x, kind)
    if kind in ("hexahedron", "wedge", "pyramid"):
        return edges, None
    xp, size = namespace(x[0][0]), volume(kind, x)
    if kind == "tetra":
        return edges, (6 * math.sqrt(6) * size, xp.sum(norm(area_vector(pick(x, FACES[kind]))), axis=0))
    ideal = 4 * math.sqrt(3) if kind == "triangle" else 4.0
    return edges, (ideal * size, xp.sum(norm(edges), axis=0))


def non_orthogonality(area: Vector, between: Vector, surface: bool) -> Scalar:
    """Angle in degrees of area vector and line between centres; below 90 for a surface in 3-D."""
    degrees = angle(area, between) * (180 / math.pi)
    return namespace(degrees).minimum(degrees, 180 - degrees) if surface else degrees


def relative_corners(x: list[Vector]) -> tuple[list[Vector], Float[Either, " k"]]:
    """Corners relative to the first, and the cell's size, not differentiated."""
    relative = [corner - x[0] for corner in x]
    size = reach(relative)
    return relative, namespace(size).where(size > 0, size, 1)


def scaled(x: list[Vector], size: Float[Either, " k"]) -> list[Vector]:
    return [corner * (1 / size) for corner in x]


def reach(x: list[Vector]) -> Float[Either, " k"]:
    xp = namespace(x[0][0])
    return constant(functools.reduce(xp.maximum, [xp.abs(component) for corner in x for component in corner]))


def centre_of_mass(kind: str, x: Sequence[Vector]) -> Vector:
    """OpenFOAM's cell centre, of plane faces: weighted middles of simplices between the sides."""
    if kind in ("line", "triangle", "tetra"):
        return mean(x)
    if kind == "quad":
        return _centre_of_quad(x)
    xp, parts, stacked = namespace(x[0][0]), [], stack(x)
    zero = xp.zeros_like(x[0][0])

    def face(sums, corners):
        return tuple(a + b for a, b in zip(sums, _moments(stacked, corners), strict=True)), None

    for faces in map(np.array, faces_by_size(kind)):
        if xp is np:
            parts.append(functools.reduce(lambda sums, corners: face(sums, corners)[0], faces, (zero,) * 4))
        else:  # a program of one face is several times shorter to compile
            parts.append(jax.lax.scan(face, (zero,) * 4, faces)[0])
    whole, *moment = (functools.reduce(xp.add, part) for part in zip(*parts, strict=True))
    return Vector(moment) * divide(xp.full_like(whole, 0.25), whole, 0.0)


def _moments(x: Vector, corners: Int[Either, " c"]) -> list:
    """Six volumes and 24 first moments of the tetrahedra between a face and the origin."""
    around = [x.at(corner) for corner in corners]
    middle = mean(around)
    pairs = [(around[i - 1], corner) for i, corner in enumerate(around)]
    volumes = [dot(cross(a, b), middle) for a, b in pairs]
    moment = total((a + b + middle) * weight for (a, b), weight in zip(pairs, volumes, strict=True))
    return [functools.reduce(namespace(middle[0]).add, volumes), *moment]


def _centre_of_quad(corners: Sequence[Vector]) -> Vector:
    """Weighs the triangles between the sides and the mean of the corners by projected areas."""
    xp, middle, normal = namespace(corners[0][0]), mean(corners), area_vector(corners)
    spokes = [corner - middle for corner in corners]
    pairs = [(spokes[i - 1], spoke) for i, spoke in enumerate(spokes)]
    weights = [dot(cross(a, b), normal) for a, b in pairs]
    moment = total((a + b) * weight for (a, b), weight in zip(pairs, weights, strict=True))
    whole = functools.reduce(xp.add, weights)
    return middle + moment * divide(xp.full_like(whole, 1 / 3), whole, 0.0)
