"""Measures of a cell, from the coordinates of its corners.

Each function takes the cell's type and `x`, the corners of k cells, numbered as VTK numbers them,
relative to the first one. For measures without unit they are divided
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
from .vector import (
    PerCell,
    Samples,
    Scalar,
    Vector,
    angle,
    columns,
    combined,
    contracted,
    cross_product,
    determinant_of,
    divide,
    dot,
    join,
    length_of,
    mean,
    middle,
    total,
    unit_of,
)


def faces_by_size(kind: str) -> list[list[tuple[int, ...]]]:
    """Groups a type's faces by their number of corners; a surface cell is its own face."""
    faces = FACES[kind] if DIMENSION[kind] == 3 else (tuple(range(len(FACES[kind]))),)
    return [list(group) for _, group in itertools.groupby(faces, len)]


def _edge_vectors(x: Vector, kind: str) -> Vector:
    start, end = columns(x, EDGES[kind])
    return end - start


def principal_axes(kind: str, x: Vector) -> Vector:
    """Vectors between the middles of opposite sides: of quads times 2, of hexahedra 4."""
    return combined(2 * np.array(PLACES[kind]).T - 1, x)


def face_areas(kind: str, x: Vector) -> Vector:
    """Area vectors (f, k) of faces, 2-D: edges, outward for a right-handed cell."""
    if DIMENSION[kind] == 3:
        return join(area_vector(columns(x, group)) for group in faces_by_size(kind))
    along = _edge_vectors(x, kind)
    if len(x) == 2:
        return Vector((along[1], -along[0]))
    return cross_product(along, _unit_normal(kind, x))


def area_vector(corners: Sequence[Vector]) -> Vector:
    """Half the cross product of diagonals (triangle: two sides); a number in 2-D."""
    return cross_product(corners[2] - corners[0], corners[-1] - corners[1]) * 0.5


def _area_of(kind: str, x: Vector) -> Vector:
    return area_vector([x.at(slice(i, i + 1)) for i in range(CORNERS[SHAPES[kind]])])


def _unit_normal(kind: str, x: Vector) -> Vector:
    """Unit normals (1, k) of triangles or quads; +1 in 2-D, where areas have a sign."""
    area = _area_of(kind, x)
    return Vector([namespace(area[0]).ones_like(area[0])]) if len(area) == 1 else unit_of(area)


def measure_volume(kind: str, x: Vector) -> Scalar:
    """The signed volume, 2-D: signed area; in 3-D a surface's area; a line's length. Faces of four
    corners are bilinear: their flux is that of the mean of the corners, and the volume that of the
    trilinear cell. Of a cell of high order it is the integral of its Jacobian.
    """
    if kind in HIGH_ORDER:
        values = jacobians(kind, x)[0]
        weights = jacobian_samples(kind)[1]
        return contracted(weights[None].astype(values.dtype), values)[0]
    if kind in ("line", "tetra"):
        return jacobians(kind, x)[0][0] / math.factorial(DIMENSION[kind])
    if DIMENSION[kind] == 2:
        area = _area_of(kind, x)
        return (area[0] if len(area) == 1 else length_of(area))[0]
    groups = [columns(x, group) for group in faces_by_size(kind)]
    return sum(dot(area_vector(corners), mean(corners)).sum(axis=0) for corners in groups) / 3


def frames(kind: str, x: Vector) -> list[Vector]:
    """The edges that leave each corner, (s, k) each; also a hexahedron's axes. Of a cell of high
    order they are the columns of its Jacobian matrix, on a lattice and at Gauss points.
    """
    if kind in HIGH_ORDER:
        return _tangents(jacobian_samples(kind)[0], x)
    corner, *ends = columns(x, FRAMES[kind])
    edges = [end - corner for end in ends]
    if kind != "hexahedron":
        return edges
    axes = principal_axes(kind, x) * 0.25
    return [join([edge, axes.at(slice(i, i + 1))]) for i, edge in enumerate(edges)]


def jacobians(kind: str, x: Vector) -> tuple[Samples, Samples]:
    """Jacobians at corners, and a hexahedron's at its centre, as Verdict does. Each has a factor
    from an error of the coordinates to one of the Jacobian: the sum over the edges of the product
    of the other edges' lengths.
    """
    edges = frames(kind, x)
    a, *others = [length_of(edge) for edge in edges]
    if not others:
        return a, namespace(a).ones_like(a)
    if len(others) == 1:
        return dot(cross_product(*edges), _unit_normal(kind, x)), a + others[0]
    b, c = others
    return determinant_of(edges), a * b + b * c + c * a


def _tangents(derivatives: np.ndarray, x: Vector) -> list[Vector]:
    """Derivatives of the place by each reference coordinate, each (s, k)."""
    return [combined(table, x) for table in np.moveaxis(derivatives, 2, 0)]


def linear_cells_at_nodes(kind: str, x: Vector) -> tuple[str, Vector]:
    """Linear cells of the tangents at high-order nodes: s k cells, node by node; or k linear."""
    xp = namespace(x[0])
    shape = SHAPES[kind]
    if shape == kind:
        return kind, x
    rows = zip(*_tangents(derivatives_at_nodes(kind), x), strict=True)
    return shape, combined(
        np.array(PLACES[shape]), Vector(xp.stack(parts).reshape(len(parts), -1) for parts in rows)
    )


def openings(kind: str, x: Vector) -> Samples:
    """The largest Jacobians that corners could have by edge lengths; simplex: 0."""
    product = math.prod(constant(length_of(edge)) for edge in frames(kind, x))
    return product * (kind in HIGH_ORDER or (len(FRAMES[kind]) > 1 and kind != "triangle"))


def skewness(
    kind: str, x: Vector, maximum: Callable[[Float[Either, "t k"]], Scalar] = largest
) -> Scalar:
    """The skewness: 0 for the ideal cell, 1 for a degenerate one.

    It is the `maximum` of several terms, which may be a smooth stand-in. Quad and hexahedron: the
    largest |cos| of the angles between the principal axes (Taylor and Flanagan, SAND87-0525). The
    others: the largest deviation of an angle of a face from the equiangular one, over the largest
    there can be. For a tetrahedron the angles between faces count too. For a cell of high order it
    is the largest of the linear cells with its tangents at its nodes.
    """
    xp = namespace(x[0])
    if kind in HIGH_ORDER:
        shape, cells = linear_cells_at_nodes(kind, x)
        return maximum(skewness(shape, cells, maximum).reshape(len(x[0]), -1))
    if kind == "line":
        return xp.zeros_like(x[0][0])
    if kind in ("quad", "hexahedron"):
        axes = unit_of(principal_axes(kind, x))
        cosines = dot(*columns(axes, itertools.combinations(range(len(axes[0])), 2)))
        return maximum(xp.concatenate([cosines, -cosines]))
    terms = []
    for group in faces_by_size(kind):
        size = len(group[0])
        corners = columns(x, group)
        angles = [
            angle(corners[(i + 1) % size] - here, corners[i - 1] - here)
            for i, here in enumerate(corners)
        ]
        terms += _deviate(xp.concatenate(angles), math.pi * (size - 2) / size)
    if kind == "tetra":
        between = angle(*columns(face_areas(kind, x), itertools.combinations(range(4), 2)))
        terms += _deviate(math.pi - between, math.acos(1 / 3))
    return maximum(xp.concatenate(terms))


def _deviate(angles: Float[Either, "a k"], ideal: float) -> list[Float[Either, "a k"]]:
    return [(angles - ideal) / (math.pi - ideal), 1 - angles / ideal]


def aspect_ratio(kind: str, x: Vector) -> Scalar:
    """The aspect ratio: 1 for the ideal cell, infinite for a flat one.

    Triangle: longest edge / (2 sqrt 3 inradius). Quad: longest edge times perimeter / (4 area).
    Tetrahedron: longest edge / (2 sqrt 6 inradius). Hexahedron: longest over shortest principal
    axis. Wedge and pyramid: longest over shortest edge. A cell of high order is as for `skewness`.
    """
    if kind in HIGH_ORDER:
        shape, cells = linear_cells_at_nodes(kind, x)
        return largest(aspect_ratio(shape, cells).reshape(len(x[0]), -1))
    over, under = aspect_terms(kind, x)
    lengths = length_of(over)
    if under is None:
        return divide(largest(lengths), smallest(lengths), math.inf)
    size, surface = under
    return divide(largest(lengths) * surface, namespace(size).abs(size), math.inf)


def aspect_terms(kind: str, x: Vector) -> tuple[Vector, tuple[Scalar, Scalar] | None]:
    """Edges or axes, whose ratio or longest counts, and a signed size with a sum of sides."""
    edges = principal_axes(kind, x) if kind == "hexahedron" else _edge_vectors(x, kind)
    if kind not in _IDEAL_FACTORS:
        return edges, None
    sides = area_vector(columns(x, FACES[kind])) if kind == "tetra" else edges
    return edges, (_IDEAL_FACTORS[kind] * measure_volume(kind, x), length_of(sides).sum(axis=0))


_IDEAL_FACTORS = {"triangle": 4 * math.sqrt(3), "quad": 4.0, "tetra": 6 * math.sqrt(6)}
"""Longest edge times sum of sides over size, of the ideal cell."""


def measure_non_orthogonality(area: Vector, between: Vector, surface: bool) -> Scalar:
    """Angle in degrees of area vector and line between centres; below 90 for a surface in 3-D."""
    degrees = angle(area, between) * (180 / math.pi)
    return namespace(degrees).minimum(degrees, 180 - degrees) if surface else degrees


def relative_corners(x: Vector) -> tuple[Vector, PerCell]:
    """Corners relative to the first, and the cell's size, not differentiated."""
    relative = x - x.at(slice(0, 1))
    size = reach(relative)
    return relative, namespace(size).where(size > 0, size, 1)


def scaled(x: Vector, size: PerCell) -> Vector:
    return x * (1 / size)[None]


def reach(x: Vector) -> PerCell:
    xp = namespace(x[0])
    return constant(
        functools.reduce(xp.maximum, [xp.abs(component).max(axis=0) for component in x])
    )


def centre_of_mass(kind: str, x: Vector) -> Vector:
    """OpenFOAM's cell centre, of plane faces: weighted middles of simplices between the sides."""
    xp = namespace(x[0])
    if kind in ("line", "triangle", "tetra"):
        return middle(x)
    if kind == "quad":
        # weighs the triangles between the sides and the mean of the corners by projected areas
        corners = [x.at(i) for i in range(4)]
        centre = mean(corners)
        normal = area_vector(corners)
        spokes = [corner - centre for corner in corners]
        weights = [
            dot(cross_product(spokes[i - 1], spoke), normal) for i, spoke in enumerate(spokes)
        ]
        moment = total((spokes[i - 1] + spoke) * weights[i] for i, spoke in enumerate(spokes))
        whole = sum(weights)
        return centre + moment * divide(xp.full_like(whole, 1 / 3), whole, 0.0)
    sums = (xp.zeros_like(x[0][0]),) * 4

    def face(sums, corners):
        return tuple(a + b for a, b in zip(sums, _moments(x, corners), strict=True)), None

    for faces in map(np.array, faces_by_size(kind)):
        if xp is np:
            sums = functools.reduce(lambda sums, corners: face(sums, corners)[0], faces, sums)
        else:  # a program of one face is several times shorter to compile
            sums = jax.lax.scan(face, sums, faces)[0]
    whole, *moment = sums
    return Vector(moment) * divide(xp.full_like(whole, 0.25), whole, 0.0)


def _moments(x: Vector, corners: Int[Either, " c"]) -> list:
    """Six volumes and 24 first moments of the tetrahedra between a face and the origin."""
    around = [x.at(corner) for corner in corners]
    centre = mean(around)
    pairs = [(around[i - 1], corner) for i, corner in enumerate(around)]
    volumes = [dot(cross_product(a, b), centre) for a, b in pairs]
    moment = total((a + b + centre) * weight for (a, b), weight in zip(pairs, volumes, strict=True))
    return [sum(volumes), *moment]
