"""Free-form boxes of a config file and its mesh, and variables that move their control points."""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.interpolate
from jaxtyping import Array, Float
from numpy import ndarray

from jaxmorph import Mesh, boundary_faces, io, shapes
from jaxmorph.extend import warn

from ._motion import AbstractPart, PatchNamesOfMotion, check_axis
from ._options import VARIABLE_KINDS, Options, Variable

ControlValues = Float[Array, "..."]
"""Places or displacements (*counts, d) of a box's control points."""
Fixed = tuple[frozenset[int], ...]
"""Planes of control points that stay, in each direction of a box."""
PLANES_BEHIND = {"NO_DERIVATIVE": 1, "1ST_DERIVATIVE": 2, "2ND_DERIVATIVE": 3, "USER_INPUT": 0}
"""Planes of control points that stay behind each face of a box which the wall crosses."""
BOX_STEPS = 20
"""Steps of Newton's method, down to a double's rounding."""
MOST_OF_A_BOX = 10**6
"""Control points that a box may have."""
BEYOND = 2.0
"""Coordinate of a node outside of a box."""


class BoxPart(AbstractPart):
    """Moves nodes in a box by its control points, which the variables move in the file's order."""

    rows: tuple[int, ...] = eqx.field(static=True)
    variables: tuple[Variable, ...] = eqx.field(static=True)
    fixed: Fixed = eqx.field(static=True)
    length: float = eqx.field(static=True)
    control: ControlValues
    operator: Callable[[Any], Array]

    def __call__(self, x, values):
        return self.operator(self.change(values)).astype(x.dtype)

    def change(self, values: Float[Array, " k"]) -> ControlValues:
        """Computes the displacements (*counts, d) of the control points."""
        start = self.control.astype(values.dtype)
        control = start
        row = 0
        for variable in self.variables:
            part = values[row : row + variable.size]
            if variable.kind in TURN_KINDS:
                change = TURN_KINDS[variable.kind](self, variable, part[0], control)
            else:
                change = jnp.tensordot(part, jnp.asarray(self.factors(variable), part.dtype), 1)
            control = control + change
            row = row + variable.size
        return control - start

    def factors(self, variable: Variable) -> ndarray:
        """Computes what a unit of each value of a variable adds (size, *counts, d)."""
        factors = np.zeros((variable.size, *self.control.shape))
        ADDS[variable.kind.removesuffix("_2D")](self, variable, factors)
        return factors

    def is_fixed(self, *index: int) -> bool:
        return any(value in planes for value, planes in zip(index, self.fixed, strict=True))


def _control_point(part: BoxPart, variable: Variable, factors: ndarray) -> None:
    """Moves control points, of which -1 names all of a direction.

    SU2 moves none where a plane of a given number stays. Of a direction of all it leaves planes out
    in 3-D alone, and only where the other two numbers are given.
    """
    index = variable.index
    d = len(variable.index)
    if part.is_fixed(*index):
        return
    chosen = np.zeros(factors.shape[1:-1])
    chosen[_slices(*index)] = 1
    every = [k for k, value in enumerate(index) if value == -1]
    if d == 3 and len(every) == 1:
        np.moveaxis(chosen, every[0], 0)[sorted(part.fixed[every[0]])] = 0
    ways = np.array([variable.numbers[d:]]) if variable.size == 1 else np.eye(d)
    factors += chosen[..., None] * ways.reshape(-1, *[1] * d, d)


def _pair(part: BoxPart, variable: Variable, factors: ndarray) -> None:
    """Moves two control points across a box alike (camber), or apart (thickness)."""
    index = variable.index
    d = factors.shape[-1]
    if d == 2 or not any(part.is_fixed(*index, side) for side in (0, 1)):
        factors[(0, *index, 0, d - 1)] = -1 if "THICKNESS" in variable.kind else 1
        factors[(0, *index, 1, d - 1)] = 1


def _gull(part: BoxPart, variable: Variable, factors: ndarray) -> None:
    (j,) = variable.index
    factors[0, :, j, :, 2] = j not in part.fixed[1]


def _nacelle(part: BoxPart, variable: Variable, factors: ndarray) -> None:
    """Moves the control points at an angle and at the opposite angle."""
    i, j, k = variable.index
    last = factors.shape[2] - 1
    for angle in dict.fromkeys([j, last - j if j >= 0 else 0]):
        if part.is_fixed(i, angle, k):
            break
        factors[(0, *_slices(i, angle if j >= 0 else -1, k))] += [
            variable.numbers[3],
            0,
            variable.numbers[4],
        ]


def _slices(*index: int) -> tuple[int | slice, ...]:
    return tuple(slice(None) if value == -1 else value for value in index)


ADDS = {
    "FFD_CONTROL_POINT": _control_point,
    "FFD_CAMBER": _pair,
    "FFD_THICKNESS": _pair,
    "FFD_GULL": _gull,
    "FFD_NACELLE": _nacelle,
}
"""Displacements of control points per unit of the value, by kind."""


def _turn_about_axis(part: BoxPart, variable: Variable, value, control) -> ControlValues:
    """Turns the control points about an axis by degrees; the numbers have its two ends."""
    d = control.shape[-1]
    ends = np.array(variable.numbers)
    axis = ends[3:] - ends[:3]
    about = ends[:d]
    points = control.reshape(-1, d)
    angle = jnp.deg2rad(value)
    turn = (np.sign(axis[2]) * angle, about) if d == 2 else (angle, about, axis)
    return (shapes.rotate(points, *turn) - points).reshape(control.shape)


def _control_surface(part: BoxPart, variable: Variable, value, control) -> ControlValues:
    """Turns the other way, without the last two planes of i and the outer two of j each side."""
    chosen = np.zeros(control.shape[:-1], bool)
    chosen[:-2, 2:-2] = True
    return jnp.where(
        jnp.asarray(chosen)[..., None], _turn_about_axis(part, variable, -value, control), 0
    )


def _turn_plane(part: BoxPart, variable: Variable, value, control) -> ControlValues:
    """Turns one plane's control points about an axis along y, where a line meets the plane."""
    (j,) = variable.index
    start = np.array(variable.numbers[1:4])
    end = np.array(variable.numbers[4:7])
    rise = end[1] - start[1]
    share = (control[0, j, 0, 1] - start[1]) / (rise or 1.0)
    meets = (share >= 0) & (share <= 1) & (rise != 0)
    about = jnp.asarray(start, control.dtype) + share * jnp.asarray(end - start, control.dtype)
    plane = control[:, j].reshape(-1, 3)
    turned = shapes.rotate(plane, jnp.arctan(value / part.length), about, [0.0, 1.0, 0.0]) - plane
    free = np.ones(control.shape[:-1], bool)
    for axis, planes in enumerate(part.fixed):
        np.moveaxis(free, axis, 0)[sorted(planes)] = False
    turned = jnp.where(
        meets & jnp.asarray(free[:, j, :, None]), turned.reshape(len(control), -1, 3), 0
    )
    return jnp.zeros_like(control).at[:, j].set(turned)


TURN_KINDS = {
    "FFD_ROTATION": _turn_about_axis,
    "FFD_CONTROL_SURFACE": _control_surface,
    "FFD_TWIST": _turn_plane,
}
"""The other kinds, whose motions depend on where the control points are."""


def boxes_of(
    options: Options, mesh: Mesh, moving: PatchNamesOfMotion, is_setting: bool
) -> tuple[io.Box, ...]:
    """Lists the mesh's boxes; without any, or with `is_setting`, those of `FFD_DEFINITION`."""
    options.choice("FFD_COORD_SYSTEM", "CARTESIAN", "CARTESIAN")
    present = () if is_setting else io.boxes(mesh)
    if not present and "FFD_DEFINITION" in options:
        made = _read_boxes(options, mesh.points.shape[1])
        return tuple(
            io.Box(name, box, np.asarray(box.lattice()), _wall_in_box(box, mesh, moving))
            for name, box in made
        )
    nested = [box.name for box in present if box.level or box.parents or box.children]
    if nested:
        raise ValueError(f"box {nested[0]} is nested in another one; boxes side by side are taken.")
    return present


def _read_boxes(options: Options, d: int) -> list[tuple[str, shapes.Hexahedron]]:
    degree = None
    if options.choice("FFD_BLENDING", "BEZIER", "BEZIER", "BSPLINE_UNIFORM") != "BEZIER":
        orders = options.words("FFD_BSPLINE_ORDER")[:d] or ["2"] * d
        degree = [options.whole("FFD_BSPLINE_ORDER", word) - 1 for word in orders]
    degrees = options.groups("FFD_DEGREE")
    groups = options.groups("FFD_DEFINITION")
    if len(degrees) != len(groups):
        raise options.error(
            "FFD_DEGREE", f"{len(degrees)} groups of degrees for {len(groups)} boxes"
        )
    boxes = []
    for (name, *words), own in zip(groups, degrees, strict=True):
        corners = options.taken("FFD_DEFINITION", f"box {name}", words, 24)
        numbers = [options.number("FFD_DEFINITION", word) for word in corners]
        counts = [options.whole("FFD_DEGREE", word) + 1 for word in own[:d]]
        if len(counts) < d or math.prod(counts) > MOST_OF_A_BOX:
            limit = f"{d} degrees of at most {MOST_OF_A_BOX} control points"
            found = " x ".join(map(str, counts))
            raise options.error("FFD_DEGREE", f"{limit} expected, found {found}")
        places = np.reshape(numbers, (8, 3))[: 2**d, :d]
        boxes.append((name, shapes.Hexahedron(places, counts, degree=degree)))
    return boxes


def _wall_in_box(shape: shapes.Hexahedron, mesh: Mesh, moving: PatchNamesOfMotion) -> dict:
    surface = {}
    for name in moving:
        nodes = mesh.patch(name)
        places = np.asarray(shape.coordinates(np.asarray(mesh.points)[nodes]))
        inside = np.asarray(shape.box.holds(jnp.asarray(places)))
        surface[name] = nodes[inside], _of_spline(np.clip(places[inside], 0, 1), shape)
    return surface


def _of_spline(places: Float[ndarray, "k d"], shape: shapes.Hexahedron) -> Float[ndarray, "k d"]:
    """Finds coordinates at which the splines of the lattice at rest give the places in the box.

    The lattice is equal along each edge, so each direction stands alone. Splines of the highest
    degree, and of the lowest, are the places themselves.
    """
    found = places.copy()
    for axis, (count, p) in enumerate(zip(shape.counts, shape.box.degrees, strict=True)):
        if 1 < p < count - 1:
            knots = np.clip(np.arange(-p, count + 1) / (count - p), 0, 1)
            spline = scipy.interpolate.BSpline(knots, np.arange(count) / (count - 1), p)
            slope = spline.derivative()
            t = places[:, axis]
            for _ in range(BOX_STEPS):
                t = np.clip(t - (spline(t) - places[:, axis]) / slope(t), 0, 1)
            found[:, axis] = t
    return found


def box_parts(
    options: Options,
    listed: list[Variable],
    mesh: Mesh,
    moving: PatchNamesOfMotion,
    boxes: Sequence[io.Box],
) -> list[AbstractPart]:
    """Makes a part for each box, of the variables that move its control points."""
    _check_boxes(listed, boxes)
    nodes = mesh.patch(*moving)
    parts = []
    taken = np.zeros(len(nodes), bool)
    for box in reversed(boxes):  # of a node in two boxes SU2 has the last one move it
        places = np.full((len(nodes), len(box.shape.counts)), BEYOND)
        for ids, inside in (box.surface[name] for name in moving if name in box.surface):
            moves = np.isin(ids, nodes)
            places[np.searchsorted(nodes, ids[moves])] = inside[moves]
        places[taken] = BEYOND
        taken |= (places != BEYOND).any(axis=1)
        if own := tuple(variable for variable in listed if variable.box == box.name):
            part = BoxPart(
                rows=tuple(row for variable in own for row in variable.rows),
                variables=own,
                fixed=_fixed_planes(options, box.control, mesh, moving),
                length=options.number("REF_LENGTH"),
                control=jnp.asarray(box.control),
                operator=box.shape.box.at(jnp.asarray(places)),
            )
            _warn_of_held(options, part)
            parts.append(part)
    return parts[::-1]


def _warn_of_held(options: Options, part: BoxPart) -> None:
    """Warns of variables whose control points are all held, so that they move nothing."""
    word = options.choice("FFD_CONTINUITY", "2ND_DERIVATIVE", *PLANES_BEHIND)
    held = [
        f"{variable.box} ({', '.join(map(str, variable.index))})"
        for variable in part.variables
        if variable.kind not in TURN_KINDS and not part.factors(variable).any()
    ]
    if held:
        warn(
            f"{options.path}: {len(held)} of {len(part.variables)} design variables move nothing, "
            f"FFD_CONTINUITY= {word} holds their control points: {', '.join(held[:5])}. Take more "
            "degrees, a weaker FFD_CONTINUITY, or a box whose sides no wall crosses."
        )


def _check_boxes(listed: list[Variable], boxes: Sequence[io.Box]) -> None:
    known = {box.name: box for box in boxes}
    for variable in (variable for variable in listed if variable.box):
        if variable.box not in known:
            there = (
                ", ".join(known) or "none: run with DV_KIND= FFD_SETTING, or give FFD_DEFINITION"
            )
            raise ValueError(f"there is no box {variable.box} in the mesh file; it has {there}.")
        _check_variable(variable, known[variable.box])


def _check_variable(variable: Variable, box: io.Box) -> None:
    kind = variable.kind
    counts = box.shape.counts
    directions = VARIABLE_KINDS[variable.kind].indices
    index = variable.numbers[: len(directions)]
    if not index:
        return check_axis(kind, variable.numbers, len(counts))
    if kind.endswith("_2D") != (len(counts) == 2):
        raise ValueError(
            f"{kind} in a mesh in {len(counts)}-D: kinds ending in _2D are for 2-D, other kinds "
            "for 3-D."
        )
    if index == (-1, -1, -1):
        raise ValueError(
            f"{kind} of box {box.name} with all three numbers -1: SU2 moves no control point by it."
        )
    least = -1 if kind.startswith(("FFD_CONTROL_POINT", "FFD_NACELLE")) else 0
    for direction, value in zip(directions, index, strict=True):
        last = counts["ijk".index(direction)] - 1
        if value % 1 or not least <= value <= last:
            raise ValueError(
                f"{kind} has {direction} = {value:g}; box {box.name} has control points 0 to "
                f"{last} there."
            )


def _fixed_planes(
    options: Options, lattice: Float[ndarray, "..."], mesh: Mesh, moving: PatchNamesOfMotion
) -> Fixed:
    """Finds the planes that stay in each direction of a lattice, so that no wall tears."""
    word = options.choice("FFD_CONTINUITY", "2ND_DERIVATIVE", *PLANES_BEHIND)
    is_symmetric = options.choice("FFD_SYMMETRY_PLANE", "NO", "NO", "YES") == "YES"
    segments = _wall_segments(mesh, moving)
    *counts, d = lattice.shape
    fixed = []
    for direction, count in enumerate(counts):
        planes = (
            set(options.numbers(f"FFD_FIX_{'IJK'[direction]}")) if word == "USER_INPUT" else set()
        )
        # a second derivative needs a degree of 2
        depth = 0 if PLANES_BEHIND[word] == 3 and count <= 2 else PLANES_BEHIND[word]
        is_mirror = (direction, d, is_symmetric) == (1, 3, True)
        for last, behind in ((0, range(depth)), (-1, range(count - depth, count))):
            if depth and not is_mirror and _crosses(segments, _face(lattice, direction, last)):
                planes.update(behind)
        fixed.append(frozenset(int(k) for k in planes) & {*range(count)})
    return tuple(fixed)


def _face(lattice: Float[ndarray, "..."], direction: int, last: int) -> Float[ndarray, "t d d"]:
    """Cuts one face of a box into two triangles between its corners; in 2-D it is a segment."""
    d = lattice.shape[-1]
    corners = np.take(lattice[np.ix_(*[[0, -1]] * d)], last, axis=direction).reshape(-1, d)
    return corners[None] if d == 2 else corners[np.array([[0, 1, 2], [3, 2, 1]])]


def _crosses(segments: Float[ndarray, "s 2 d"], faces: Float[ndarray, "t d d"]) -> bool:
    start = segments[:, 0]
    way = segments[:, 1] - segments[:, 0]
    for face in faces:
        # start + s way = face[0] + edges^T w, for s in 0 to 1 and w in the triangle
        edges = face[1:] - face[0]
        matrix = np.concatenate(
            [way[:, :, None], -np.broadcast_to(edges.T, (len(way), *edges.T.shape))], axis=2
        )
        size = np.linalg.norm(edges, axis=1).prod() * np.linalg.norm(way, axis=1)
        good = np.abs(np.linalg.det(matrix)) > 1e-14 * size
        solution = np.linalg.solve(matrix[good], (face[0] - start[good])[:, :, None])[:, :, 0]
        if (
            (solution >= 0).all(axis=1) & (solution[:, 0] <= 1) & (solution[:, 1:].sum(axis=1) <= 1)
        ).any():
            return True
    return False


def _wall_segments(mesh: Mesh, moving: PatchNamesOfMotion) -> Float[ndarray, "s 2 d"]:
    faces = [ids for name in moving for ids in boundary_faces(mesh, name).values()]
    pairs = [
        ids[:, [a, b]] for ids in faces for a, b in itertools.combinations(range(ids.shape[1]), 2)
    ]
    return np.asarray(mesh.points, float)[np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)]
