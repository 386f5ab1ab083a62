"""Design variables that move the control points of a free-form box."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmorph import io, shapes

from ._motion import AbstractPart
from ._variables import Variable

Fixed = tuple[frozenset[int], ...]
TURNS = ("FFD_ROTATION", "FFD_CONTROL_SURFACE")
"""Kinds that turn control points about an axis, by degrees."""


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
            control = control + _moved(variable, part, control, self.fixed, self.length)
            row += variable.size
        return control - start


def box_part(
    box: io.Box, variables: Sequence[Variable], rows: Sequence[int], fixed: Fixed, length: float, places: np.ndarray
) -> BoxPart:
    """Makes the part of one box.

    `places` are coordinates of the wall's nodes in the box, NaN for nodes outside of it. Raises
    `ValueError` for numbers of control points that the box does not have.
    """
    for variable in variables:
        _check(variable, box)
    inside = np.isfinite(places).all(axis=1)
    operator = box.shape.box.at(jnp.asarray(np.where(np.asarray(inside)[:, None], places, 0.5)))
    control = jnp.asarray(box.control)
    return BoxPart(tuple(rows), tuple(variables), fixed, length, control, operator, jnp.asarray(inside))


def _check(variable: Variable, box: io.Box) -> None:
    kind, counts = variable.kind, box.shape.counts
    if kind.endswith("_2D") != (len(counts) == 2) and kind not in TURNS:
        raise ValueError(f"{kind} in a mesh in {len(counts)}-D: kinds ending in _2D are for 2-D, other kinds for 3-D.")
    if kind in TURNS and len(counts) == 2 and np.any(_axis(variable)[:2]):
        raise ValueError(f"{kind} in 2-D about an axis that is not along z: both ends have the same x and y.")
    if kind in TURNS and not np.any(_axis(variable)):
        raise ValueError(f"{kind} about an axis without length: its two ends are one point.")
    index = _indices(variable)
    if index == (-1, -1, -1):
        raise ValueError(f"{kind} of box {box.name} with all three numbers -1: SU2 moves no control point by it.")
    for direction, value in zip((1,) if kind in ("FFD_TWIST", "FFD_GULL") else (0, 1, 2), index, strict=False):
        count, least = counts[direction], -1 if kind.startswith(("FFD_CONTROL_POINT", "FFD_NACELLE")) else 0
        if value != int(value) or not least <= value < count:
            name = "ijk"[direction]
            raise ValueError(
                f"{kind} has {name} = {value:g}; box {box.name} has control points 0 to {count - 1} there."
            )


def _indices(variable: Variable) -> tuple[float, ...]:
    """Lists the numbers of control points among the parameters."""
    count = {"FFD_CONTROL_POINT": 3, "FFD_NACELLE": 3, "FFD_CONTROL_POINT_2D": 2, "FFD_CAMBER": 2, "FFD_THICKNESS": 2}
    return variable.numbers[: 0 if variable.kind in TURNS else count.get(variable.kind, 1)]


def _axis(variable: Variable) -> np.ndarray:
    return np.subtract(variable.numbers[3:6], variable.numbers[:3])


def _moved(variable: Variable, values, control, fixed: Fixed, length: float) -> Float[Array, "..."]:
    """Computes what one variable adds to the positions of the control points."""
    counts, d = control.shape[:-1], control.shape[-1]
    numbers, kind = variable.numbers, variable.kind
    if kind.startswith("FFD_CONTROL_POINT"):
        direction = values if variable.size > 1 else values[0] * jnp.asarray(numbers[d:], values.dtype)
        chosen = jnp.asarray(_chosen(numbers[:d], counts, fixed), values.dtype)
        return chosen[..., None] * jnp.broadcast_to(direction, control.shape)
    if kind.startswith(("FFD_CAMBER", "FFD_THICKNESS")):
        factors = np.zeros((*counts, d))
        at = tuple(int(value) for value in numbers[: d - 1])
        if d == 2 or (not _is_held((*at, 0), fixed) and not _is_held((*at, 1), fixed)):
            factors[(*at, 0, d - 1)] = -1 if "THICKNESS" in kind else 1
            factors[(*at, 1, d - 1)] = 1
        return values[0] * jnp.asarray(factors, values.dtype)
    if kind == "FFD_GULL":
        way = np.zeros(control.shape)
        way[:, int(numbers[0]), :, 2] = int(numbers[0]) not in fixed[1]
        return values[0] * jnp.asarray(way, values.dtype)
    if kind == "FFD_NACELLE":
        times = jnp.asarray(_both_sides(numbers[:3], counts, fixed), values.dtype)
        return (
            values[0] * times[..., None] * jnp.broadcast_to(jnp.asarray([numbers[3], 0.0, numbers[4]]), control.shape)
        )
    return _turned(variable, values, control) if kind in TURNS else _twist(variable, values, control, fixed, length)


def _turned(variable: Variable, values, control) -> Float[Array, "..."]:
    """Turns control points.

    A control surface turns the other way, without the last two planes of i and the two outer ones
    of j on each side.
    """
    d, axis, about = control.shape[-1], _axis(variable), np.array(variable.numbers[: control.shape[-1]])
    points, angle = control.reshape(-1, d), jnp.deg2rad(values[0])
    chosen = np.ones(control.shape[:-1], bool)
    if variable.kind == "FFD_CONTROL_SURFACE":
        angle, chosen = -angle, np.zeros_like(chosen)
        chosen[:-2, 2:-2] = True
    if d == 2:
        turned = shapes.rotate(points, np.sign(axis[2]) * angle, about) - points
    else:
        turned = shapes.rotate(points, angle, about, axis) - points
    return jnp.where(jnp.asarray(chosen)[..., None], turned.reshape(control.shape), 0)


def _twist(variable: Variable, values, control, fixed: Fixed, length: float) -> Float[Array, "..."]:
    """Turns one plane's control points about an axis along y, where a line meets the plane."""
    j, start, end = int(variable.numbers[0]), np.array(variable.numbers[1:4]), np.array(variable.numbers[4:7])
    rise = end[1] - start[1]
    height = control[0, j, 0, 1]
    share = (height - start[1]) / (rise if rise else 1.0)
    meets = (share >= 0) & (share <= 1) & (rise != 0)
    about = jnp.asarray(start, control.dtype) + share * jnp.asarray(end - start, control.dtype)
    plane = control[:, j].reshape(-1, 3)
    turned = shapes.rotate(plane, jnp.arctan(values[0] / length), about, [0.0, 1.0, 0.0]) - plane
    free = np.ones((control.shape[0], control.shape[2]), bool)
    free[sorted(fixed[0])] = False
    free[:, sorted(fixed[2])] = False
    free &= j not in fixed[1]
    turned = jnp.where(meets & jnp.asarray(free)[..., None], turned.reshape(*free.shape, 3), 0)
    return jnp.zeros_like(control).at[:, j].set(turned)


def _chosen(index: Sequence[float], counts: tuple[int, ...], fixed: Fixed) -> Bool[np.ndarray, "..."]:
    """Marks control points that move: -1 is all of a direction, and a plane that stays, stays.

    SU2 looks at planes of numbers that are named. Of a direction of all it leaves planes out in 3-D
    alone, and only where the other two numbers are named.
    """
    d = len(counts)
    chosen = np.zeros(counts, bool)
    chosen[tuple(slice(None) if value == -1 else int(value) for value in index)] = True
    every = [k for k, value in enumerate(index) if value == -1]
    if any(int(value) in fixed[k] for k, value in enumerate(index) if value != -1):
        return np.zeros(counts, bool)
    if d == 3 and len(every) == 1:
        stays = np.zeros(counts[every[0]], bool)
        stays[sorted(fixed[every[0]])] = True
        chosen &= ~stays.reshape([-1 if k == every[0] else 1 for k in range(d)])
    return chosen


def _both_sides(index: Sequence[float], counts: tuple[int, ...], fixed: Fixed) -> Float[np.ndarray, "..."]:
    """Counts how often control points of a nacelle move: points at the opposite angle do too."""
    i, j, k = (int(value) for value in index)
    times = np.zeros(counts)
    for opposite in [j] if j == counts[1] - 1 - j else [j, counts[1] - 1 - j if j >= 0 else 0]:
        if _is_held((i, opposite, k), fixed):
            break
        times[tuple(slice(None) if value == -1 else value for value in (i, opposite if j >= 0 else -1, k))] += 1
    return times


def _is_held(index: tuple[int, ...], fixed: Fixed) -> bool:
    return any(value in planes for value, planes in zip(index, fixed, strict=True))
