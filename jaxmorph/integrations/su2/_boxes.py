"""Free-form boxes of a config file and its mesh, and variables that move their control points."""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.interpolate
from jaxtyping import Array, Bool, Float, Int

from jaxmorph import Mesh, boundary_faces, io, shapes

from ._motion import AbstractPart, check_axis
from ._options import KINDS, Options, Variable

Fixed = tuple[frozenset[int], ...]
"""Planes of control points that stay, in each direction of a box."""
TURNS = ("FFD_ROTATION", "FFD_CONTROL_SURFACE")
"""Kinds that turn control points about an axis, by degrees."""
KEPT = {"NO_DERIVATIVE": 1, "1ST_DERIVATIVE": 2, "2ND_DERIVATIVE": 3, "USER_INPUT": 0}
"""Planes of control points that stay behind each face of a box which the wall crosses."""
HALVINGS = 60
"""Halvings of an interval, down to a double's rounding."""
MOST = 10**6
"""Control points that a box may have."""


class BoxPart(AbstractPart):
    """Moves nodes in a box by its control points.

    The control points go through the variables in the order of the file, so that a rotation turns
    what the variables before it moved.
    """

    rows: tuple[int, ...] = eqx.field(static=True)
    variables: tuple[Variable, ...] = eqx.field(static=True)
    fixed: Fixed = eqx.field(static=True)
    length: float = eqx.field(static=True)
    control: Float[Array, "..."]
    operator: Callable[[Any], Array]
    inside: Bool[Array, " m"]

    def __call__(self, x, values):
        moved = self.operator(self.change(values))
        return jnp.where(self.inside[:, None], moved, 0).astype(x.dtype)

    def change(self, values: Float[Array, " k"]) -> Float[Array, "..."]:
        """Computes the displacements (*counts, d) of the control points."""
        start = self.control.astype(values.dtype)
        control, row = start, 0
        for variable in self.variables:
            part = values[row : row + variable.size]
            if variable.kind in TURNS:
                change = _turned(variable, part[0], control)
            elif variable.kind == "FFD_TWIST":
                change = _twist(variable, part[0] / self.length, control, self.fixed)
            else:
                change = jnp.tensordot(part, jnp.asarray(_factors(variable, control.shape, self.fixed), part.dtype), 1)
            control, row = control + change, row + variable.size
        return control - start


def boxes_of(options: Options, mesh: Mesh, moving: Sequence[str], is_setting: bool) -> tuple[io.Box, ...]:
    """Lists the mesh's boxes; if it has none, or with `is_setting`, boxes of `FFD_DEFINITION`.

    Raises `ValueError` for nested boxes, and for numbers that do not fit.
    """
    options.choice("FFD_COORD_SYSTEM", "CARTESIAN", "CARTESIAN")
    present = () if is_setting else io.boxes(mesh)
    if present or "FFD_DEFINITION" not in options:
        nested = [box.name for box in present if box.level or box.parents or box.children]
        if nested:
            raise ValueError(f"box {nested[0]} is nested in another one; boxes side by side are taken.")
        return present
    shapes_by_name = _definition(options, mesh.points.shape[1])
    return tuple(
        io.Box(name, shape, np.asarray(shape.lattice()), _surface(shape, mesh, moving))
        for name, shape in shapes_by_name
    )


def _definition(options: Options, d: int) -> list[tuple[str, shapes.Hexahedron]]:
    blending = options.choice("FFD_BLENDING", "BEZIER", "BEZIER", "BSPLINE_UNIFORM")
    orders = options.words("FFD_BSPLINE_ORDER")[:d] or ["2"] * d
    degree = [options.whole("FFD_BSPLINE_ORDER", word) - 1 for word in orders] if blending != "BEZIER" else None
    degrees, groups = options.groups("FFD_DEGREE"), options.groups("FFD_DEFINITION")
    if len(degrees) != len(groups):
        raise options.error("FFD_DEGREE", f"{len(degrees)} groups of degrees for {len(groups)} boxes")
    made = []
    for (name, *words), words_of_degrees in zip(groups, degrees, strict=True):
        numbers = [options.number("FFD_DEFINITION", word) for word in words]
        if len(numbers) != 24:
            found = f"24 numbers for box {name}, eight corners, expected; found {len(numbers)}"
            raise options.error("FFD_DEFINITION", found)
        counts = [options.whole("FFD_DEGREE", word) + 1 for word in words_of_degrees[:d]]
        if len(counts) < d or math.prod(counts) > MOST:
            found = " x ".join(map(str, counts))
            raise options.error("FFD_DEGREE", f"{d} degrees of at most {MOST} control points expected, found {found}")
        made.append((name, shapes.Hexahedron(np.reshape(numbers, (8, 3))[: 2**d, :d], counts, degree=degree)))
    return made


def _surface(shape: shapes.Hexahedron, mesh: Mesh, moving: Sequence[str]) -> dict:
    """Finds the nodes of each marker that lie in a box, and their coordinates there."""
    surface = {}
    for name in moving:
        nodes = mesh.patch(name)
        places = np.asarray(shape.coordinates(np.asarray(mesh.points)[nodes]))
        inside = np.asarray(shape.box.holds(jnp.asarray(places)))
        surface[name] = nodes[inside], _of_spline(np.clip(places[inside], 0, 1), shape)
    return surface


def _of_spline(places: Float[np.ndarray, "k d"], shape: shapes.Hexahedron) -> Float[np.ndarray, "k d"]:
    """Finds coordinates at which the splines of the lattice at rest give the places in the box.

    The lattice is equal along each edge, so the places are a function of one coordinate along each.
    Splines of the highest degree, and of the lowest, are the places themselves.
    """
    found = places.copy()
    for axis, (count, p) in enumerate(zip(shape.counts, shape.box.degrees, strict=True)):
        if 1 < p < count - 1:
            knots = np.clip(np.arange(-p, count + 1) / (count - p), 0, 1)
            spline = scipy.interpolate.BSpline(knots, np.arange(count) / (count - 1), p)
            low, high = np.zeros(len(places)), np.ones(len(places))
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                below = spline(middle) < places[:, axis]
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            found[:, axis] = (low + high) / 2
    return found


def box_parts(
    options: Options, listed: Sequence[Variable], mesh: Mesh, moving: Sequence[str], boxes: Sequence[io.Box]
) -> list[AbstractPart]:
    """Makes the parts of the variables that move control points, one for each box that they name.

    Raises `ValueError` for a box or control points that are not there.
    """
    known = [box.name for box in boxes]
    for name in (variable.box for variable in listed if variable.box):
        if name not in known:
            hint = "it has none: run with DV_KIND= FFD_SETTING, or give FFD_DEFINITION"
            there = f"it has {', '.join(known)}" if known else hint
            raise ValueError(f"there is no box {name} in the mesh file; {there}.")
    nodes = mesh.patch(*moving)
    length = options.number("REF_LENGTH")
    parts, taken = [], np.zeros(len(nodes), bool)
    for box in reversed(boxes):  # of a node in two boxes SU2 has the last one move it
        members = tuple(variable for variable in listed if variable.box == box.name)
        places = _places(box, nodes, moving)
        inside = np.isfinite(places).all(axis=1) & ~taken
        if members:
            for variable in members:
                _check(variable, box)
            rows = tuple(row for variable in members for row in variable.rows)
            fixed = _fixed_planes(options, box.control, mesh, moving)
            operator = box.shape.box.at(jnp.asarray(np.where(inside[:, None], places, 0.5)))
            parts.append(BoxPart(rows, members, fixed, length, jnp.asarray(box.control), operator, jnp.asarray(inside)))
        taken |= inside
    return parts[::-1]


def _places(box: io.Box, nodes: Int[np.ndarray, " m"], moving: Sequence[str]) -> Float[np.ndarray, "m d"]:
    places = np.full((len(nodes), len(box.shape.counts)), np.nan)
    for name in moving:
        ids, inside = box.surface.get(name, (np.zeros(0, int), np.zeros((0, places.shape[1]))))
        moves = np.isin(ids, nodes)
        places[np.searchsorted(nodes, ids[moves])] = inside[moves]
    return places


def _check(variable: Variable, box: io.Box) -> None:
    """Raises `ValueError` for kinds of the other dimension, and for unknown control points."""
    kind, counts = variable.kind, box.shape.counts
    d, index = len(counts), variable.numbers[: KINDS[kind].indices]
    if kind in TURNS:
        return check_axis(kind, variable.numbers, d)
    if kind.endswith("_2D") != (d == 2):
        raise ValueError(f"{kind} in a mesh in {d}-D: kinds ending in _2D are for 2-D, other kinds for 3-D.")
    if index == (-1, -1, -1):
        raise ValueError(f"{kind} of box {box.name} with all three numbers -1: SU2 moves no control point by it.")
    least = -1 if kind.startswith(("FFD_CONTROL_POINT", "FFD_NACELLE")) else 0
    for direction, value in zip((1,) if kind in ("FFD_TWIST", "FFD_GULL") else (0, 1, 2), index, strict=False):
        last = counts[direction] - 1
        if value % 1 or not least <= value <= last:
            found = f"{'ijk'[direction]} = {value:g}"
            raise ValueError(f"{kind} has {found}; box {box.name} has control points 0 to {last} there.")


def _fixed_planes(options: Options, lattice: Float[np.ndarray, "..."], mesh: Mesh, moving: Sequence[str]) -> Fixed:
    """Finds the planes that stay in each direction of a lattice, so that no wall tears."""
    word = options.choice("FFD_CONTINUITY", "2ND_DERIVATIVE", *KEPT)
    is_symmetric = options.choice("FFD_SYMMETRY_PLANE", "NO", "NO", "YES") == "YES"
    segments, (*counts, d) = _segments(mesh, moving), lattice.shape
    planes: list[set[float]] = [set() for _ in counts]
    if word == "USER_INPUT":
        planes = [set(options.numbers(f"FFD_FIX_{axis}")) for axis in "IJK"[:d]]
    for direction, last in itertools.product(range(d), (0, -1)):
        top = counts[direction] - 1
        depth = 0 if KEPT[word] == 3 and top <= 1 else KEPT[word]  # a second derivative needs a degree of 2
        is_mirror = direction == 1 and d == 3 and is_symmetric
        if depth and not is_mirror and _crosses(segments, _face(lattice, direction, last)):
            planes[direction].update(k if last == 0 else top - k for k in range(depth))
    return tuple(frozenset(int(k) for k in own) & {*range(count)} for own, count in zip(planes, counts, strict=True))


def _face(lattice: Float[np.ndarray, "..."], direction: int, last: int) -> Float[np.ndarray, "t d d"]:
    """Cuts one face of a box into two triangles between its corners; in 2-D it is a segment."""
    d = lattice.shape[-1]
    corners = np.take(lattice[np.ix_(*[[0, -1]] * d)], last, axis=direction).reshape(-1, d)
    return corners[None] if d == 2 else corners[np.array([[0, 1, 2], [3, 2, 1]])]


def _crosses(segments: Float[np.ndarray, "s 2 d"], faces: Float[np.ndarray, "t d d"]) -> bool:
    start, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    for face in faces:
        # start + s way = face[0] + edges^T w, for s in 0 to 1 and w in the triangle
        edges = face[1:] - face[0]
        matrix = np.concatenate([way[:, :, None], -np.broadcast_to(edges.T, (len(way), *edges.T.shape))], axis=2)
        size = np.linalg.norm(edges, axis=1).prod() * np.linalg.norm(way, axis=1)
        good = np.abs(np.linalg.det(matrix)) > 1e-14 * size
        solution = np.linalg.solve(matrix[good], (face[0] - start[good])[:, :, None])[:, :, 0]
        share, weights = solution[:, 0], solution[:, 1:]
        if ((share >= 0) & (share <= 1) & (weights >= 0).all(axis=1) & (weights.sum(axis=1) <= 1)).any():
            return True
    return False


def _segments(mesh: Mesh, moving: Sequence[str]) -> Float[np.ndarray, "s 2 d"]:
    faces = [ids for name in moving for ids in boundary_faces(mesh, name).values()]
    pairs = [ids[:, [a, b]] for ids in faces for a in range(ids.shape[1]) for b in range(a + 1, ids.shape[1])]
    return np.asarray(mesh.points, float)[np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)]


def _factors(variable: Variable, shape: tuple[int, ...], fixed: Fixed) -> Float[np.ndarray, "k ..."]:
    """Computes what a unit of each value adds to the control points: (k, *counts, d)."""
    numbers, d, factors = variable.numbers, shape[-1], np.zeros((variable.size, *shape))
    index = tuple(int(value) for value in numbers[: KINDS[variable.kind].indices])
    match variable.kind.removesuffix("_2D"):
        case "FFD_CONTROL_POINT":
            direction = np.array(numbers[d:]) if variable.size == 1 else np.eye(d)
            factors += _chosen(index, shape[:-1], fixed)[..., None] * direction.reshape(-1, *[1] * d, d)
        case "FFD_CAMBER" | "FFD_THICKNESS" as kind:
            if d == 2 or not any(_is_fixed((*index, side), fixed) for side in (0, 1)):
                factors[(0, *index, 0, d - 1)] = -1 if kind == "FFD_THICKNESS" else 1
                factors[(0, *index, 1, d - 1)] = 1
        case "FFD_GULL":
            factors[0, :, index[0], :, 2] = index[0] not in fixed[1]
        case "FFD_NACELLE":  # the control points at the opposite angle move, too
            i, j, k = index
            for opposite in dict.fromkeys([j, shape[1] - 1 - j if j >= 0 else 0]):
                if _is_fixed((i, opposite, k), fixed):
                    break
                at = (i, opposite if j >= 0 else -1, k)
                factors[(0, *(slice(None) if value == -1 else value for value in at))] += [numbers[3], 0, numbers[4]]
    return factors


def _turned(variable: Variable, value, control) -> Float[Array, "..."]:
    """Turns control points.

    A control surface turns the other way, without the last two planes of i and the two outer ones
    of j on each side.
    """
    d, ends = control.shape[-1], np.array(variable.numbers)
    axis, about = ends[3:] - ends[:3], ends[: control.shape[-1]]
    points, angle = control.reshape(-1, d), jnp.deg2rad(value)
    chosen = np.ones(control.shape[:-1], bool)
    if variable.kind == "FFD_CONTROL_SURFACE":
        angle, chosen = -angle, np.zeros_like(chosen)
        chosen[:-2, 2:-2] = True
    turn = (np.sign(axis[2]) * angle, about) if d == 2 else (angle, about, axis)
    turned = shapes.rotate(points, *turn) - points
    return jnp.where(jnp.asarray(chosen)[..., None], turned.reshape(control.shape), 0)


def _twist(variable: Variable, value, control, fixed: Fixed) -> Float[Array, "..."]:
    """Turns one plane's control points about an axis along y, where a line meets the plane."""
    j, start, end = int(variable.numbers[0]), np.array(variable.numbers[1:4]), np.array(variable.numbers[4:7])
    rise = end[1] - start[1]
    height = control[0, j, 0, 1]
    share = (height - start[1]) / (rise if rise else 1.0)
    meets = (share >= 0) & (share <= 1) & (rise != 0)
    about = jnp.asarray(start, control.dtype) + share * jnp.asarray(end - start, control.dtype)
    plane = control[:, j].reshape(-1, 3)
    turned = shapes.rotate(plane, jnp.arctan(value), about, [0.0, 1.0, 0.0]) - plane
    free = np.array([[not _is_fixed((i, j, k), fixed) for k in range(control.shape[2])] for i in range(len(control))])
    turned = jnp.where(meets & jnp.asarray(free)[..., None], turned.reshape(*free.shape, 3), 0)
    return jnp.zeros_like(control).at[:, j].set(turned)


def _chosen(index: Sequence[int], counts: tuple[int, ...], fixed: Fixed) -> Bool[np.ndarray, "..."]:
    """Marks control points that move: -1 is all of a direction, and a plane that stays, stays.

    SU2 looks at planes of numbers that are named. Of a direction of all it leaves planes out in 3-D
    alone, and only where the other two numbers are named.
    """
    chosen = np.zeros(counts, bool)
    if any(value in planes for value, planes in zip(index, fixed, strict=True) if value != -1):
        return chosen
    chosen[tuple(slice(None) if value == -1 else value for value in index)] = True
    every = [k for k, value in enumerate(index) if value == -1]
    if len(counts) == 3 and len(every) == 1:
        np.moveaxis(chosen, every[0], 0)[sorted(fixed[every[0]])] = False
    return chosen


def _is_fixed(index: tuple[int, ...], fixed: Fixed) -> bool:
    return any(value in planes for value, planes in zip(index, fixed, strict=True))
