"""Free-form boxes of a config file and its mesh, and variables that move control points."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import scipy.interpolate
from jaxtyping import Float, Int

from jaxmorph import Mesh, boundary_faces, io, shapes

from ._control import BoxPart, box_part
from ._options import Options
from ._planes import planes, segments_of
from ._variables import Variable

HALVINGS = 60
"""Halvings of an interval, down to a double's rounding."""

MOST = 10**6
"""Control points that a box may have."""


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
    d = mesh.points.shape[1]
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
            raise options.error(
                "FFD_DEFINITION", f"24 numbers for box {name}, eight corners, expected; found {len(numbers)}"
            )
        counts = [options.whole("FFD_DEGREE", word) + 1 for word in words_of_degrees[:d]]
        if len(counts) < d or math.prod(counts) > MOST:
            found = " x ".join(map(str, counts))
            raise options.error("FFD_DEGREE", f"{d} degrees of at most {MOST} control points expected, found {found}")
        shape = shapes.Hexahedron(np.reshape(numbers, (8, 3))[: 2**d, :d], counts, degree=degree)
        made.append(io.Box(name, shape, np.asarray(shape.lattice()), _surface(shape, mesh, moving)))
    return tuple(made)


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
    options: Options,
    listed: Sequence[Variable],
    first: Int[np.ndarray, " v"],
    mesh: Mesh,
    moving: Sequence[str],
    boxes: Sequence[io.Box],
) -> list[BoxPart]:
    """Makes the parts of the variables that move control points, one for each box that they name.

    `first` is the place of each variable's first value. Raises `ValueError` for a box that is not
    there.
    """
    boxed = [k for k, variable in enumerate(listed) if variable.box]
    known = [box.name for box in boxes]
    unknown = [listed[k].box for k in boxed if listed[k].box not in known]
    if unknown:
        there = (
            f"it has {', '.join(known)}"
            if known
            else "it has none: run with DV_KIND= FFD_SETTING, or give FFD_DEFINITION"
        )
        raise ValueError(f"there is no box {unknown[0]} in the mesh file; {there}.")
    nodes, points = mesh.patch(*moving), np.asarray(mesh.points, float)
    length = options.number("REF_LENGTH", options.text("REF_LENGTH", "1.0"))
    faces = [ids for name in moving for ids in boundary_faces(mesh, name).values()] if boxed else []
    parts, taken = [], np.zeros(len(nodes), bool)
    for box in reversed(boxes):  # of a node in two boxes SU2 has the last one move it
        members = [k for k in boxed if listed[k].box == box.name]
        places = _places(box, nodes, moving)
        if members:
            fixed = planes(options, box.control, segments_of(points, faces))
            rows = [row for k in members for row in range(first[k], first[k] + listed[k].size)]
            free = np.where(taken[:, None], np.nan, places)
            parts.append(box_part(box, [listed[k] for k in members], rows, tuple(map(frozenset, fixed)), length, free))
        taken |= np.isfinite(places).all(axis=1)
    return parts[::-1]


def _places(box: io.Box, nodes: Int[np.ndarray, " m"], moving: Sequence[str]) -> Float[np.ndarray, "m d"]:
    places = np.full((len(nodes), len(box.shape.counts)), np.nan)
    for name in moving:
        ids, inside = box.surface.get(name, (np.zeros(0, int), np.zeros((0, places.shape[1]))))
        moves = np.isin(ids, nodes)
        places[np.searchsorted(nodes, ids[moves])] = inside[moves]
    return places
