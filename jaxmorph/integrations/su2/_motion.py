"""The motion of a wall by SU2's design variables, as SU2 states each; displacements add up."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmorph import shapes

from ._variables import Variable

UPPER, LOWER, BOTH = 1, 0, 2
"""Sides of an airfoil, as the first parameter of `HICKS_HENNE` has them."""


SIDED = ("HICKS_HENNE", "NACA_4DIGITS")
"""Kinds that ask on which side of an airfoil a node is."""


class AbstractPart(eqx.Module):
    """The displacement by some design variables; `rows` are their places among all values."""

    rows: eqx.AbstractVar[tuple[int, ...]]

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "m d"], values: Float[Array, " k"]) -> Float[Array, "m d"]:
        """Computes displacements (m, d) of a wall at `x`."""


class DesignVariables(shapes.AbstractShape):
    """A config file's shape: moves the nodes of `DV_MARKER` by the design variables' values.

    The parameters (n,) are the values in the order of the file; a control point without a direction
    has one for each coordinate. `names` are those of the variables, as messages have them.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    parts: tuple[AbstractPart, ...]
    scales: Float[Array, " n"]
    rest: Float[Array, " n"]

    def neutral(self) -> Float[Array, " n"]:
        """Makes the values that move nothing: 1 for a factor, else 0."""
        return self.rest

    def __call__(self, x: Any, parameters: Any) -> Float[Array, "m d"]:
        x = jnp.asarray(x)
        if np.shape(parameters) != self.rest.shape:
            raise ValueError(f"`parameters` have shape {np.shape(parameters)}; this config file has {self.rest.shape}.")
        values = jnp.asarray(parameters, x.dtype) * self.scales.astype(x.dtype)
        terms = [part(x, values[np.array(part.rows, int)]) for part in self.parts]
        return x + sum(terms[1:], terms[0]) if terms else x


class Translation(AbstractPart):
    """Moves all nodes along a vector, times the value."""

    rows: tuple[int, ...] = eqx.field(static=True)
    along: Float[Array, " d"]

    def __call__(self, x, values):
        return jnp.broadcast_to(values[0] * self.along.astype(x.dtype), x.shape)


class Rotation(AbstractPart):
    """Turns all nodes about an axis, by the value in degrees."""

    rows: tuple[int, ...] = eqx.field(static=True)
    about: Float[Array, " d"]
    axis: Float[Array, " 3"] | None

    def __call__(self, x, values):
        return shapes.rotate(x, jnp.deg2rad(values[0]), self.about, self.axis) - x


class Scale(AbstractPart):
    """Stretches all nodes from the origin, by the value."""

    rows: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, x, values):
        return (values[0] - 1) * x


class Bumps(AbstractPart):
    """Hicks-Henne bumps on one side of an airfoil of chord 1 from 0; below, they move downwards."""

    rows: tuple[int, ...] = eqx.field(static=True)
    shape: shapes.HicksHenne
    heights: Float[Array, "k n"]
    weights: Float[Array, " m"]

    def __call__(self, x, values):
        return self.weights.astype(x.dtype)[:, None] * self.shape.at(x)(self.heights.astype(x.dtype) @ values)


class Airfoil(AbstractPart):
    """Puts nodes onto a NACA 4-digit airfoil at their x; the digits come from `DV_PARAM`."""

    rows: tuple[int, ...] = eqx.field(static=True)
    numbers: Float[Array, " 3"]
    sides: Float[Array, " m"]

    def __call__(self, x, values):
        camber, place, thickness = self.numbers.astype(x.dtype) / jnp.array([100.0, 10.0, 100.0], x.dtype)
        t = x[:, 0]
        ahead = t < place
        width = jnp.where(ahead, jnp.where(place > 0, place, 1), 1 - place)
        mean = camber / width**2 * (jnp.where(ahead, 0, 1 - 2 * place) + 2 * place * t - t**2)
        root = jnp.sqrt(jnp.where(t > 0, t, 0))
        half = thickness * (1.4845 * root + t * (-0.63 + t * (-1.758 + t * (1.4215 - 0.518 * t))))
        sides = self.sides.astype(x.dtype)
        up = jnp.where(sides != 0, mean + sides * half - x[:, 1], 0)
        return jnp.zeros_like(x).at[:, 1].set(up)


class Displacement(AbstractPart):
    """Moves nodes to where a file puts them, whatever the value."""

    rows: tuple[int, ...] = eqx.field(static=True)
    u: Float[Array, "m d"]

    def __call__(self, x, values):
        return self.u.astype(x.dtype)


def simple_parts(
    listed: Sequence[Variable], first: Int[np.ndarray, " v"], d: int, normals: Float[np.ndarray, "m d"] | None
) -> list[AbstractPart]:
    """Makes the parts of all variables that need neither a box nor a file.

    `first` is the place of each variable's first value. `normals` are those of the wall's nodes,
    out of the body, where `SIDED` kinds need them.
    """
    parts: list[AbstractPart] = []
    for side in (UPPER, LOWER, BOTH):
        members = [k for k, variable in enumerate(listed) if variable.kind == "HICKS_HENNE" and _side(variable) == side]
        if members and normals is not None:
            parts.append(_bumps([listed[k].numbers[1] for k in members], first[members], side, normals))
    for variable, row in zip(listed, first.tolist(), strict=True):
        numbers, rows = np.array(variable.numbers), (row,)
        if variable.kind == "TRANSLATION":
            parts.append(Translation(rows, jnp.asarray(numbers[:d])))
        elif variable.kind == "ROTATION":
            axis = numbers[3:] - numbers[:3]
            if d == 2 and axis[:2].any():
                raise ValueError(f"ROTATION about the axis {axis}: in 2-D both ends have the same x and y.")
            if d == 3 and not axis.any():
                raise ValueError("ROTATION about an axis without length: its two ends are one point.")
            parts.append(Rotation(rows, jnp.asarray(numbers[:d]), jnp.asarray(axis) if d == 3 else None))
        elif variable.kind == "SCALE":
            parts.append(Scale(rows))
        elif variable.kind == "NACA_4DIGITS" and normals is not None:
            parts.append(Airfoil(rows, jnp.asarray(numbers), jnp.asarray(np.sign(normals[:, 1]))))
    return parts


def _side(variable: Variable) -> int:
    side = variable.numbers[0]
    if side not in (UPPER, LOWER, BOTH):
        raise ValueError(f"HICKS_HENNE has the side {side:g}; 0 is the lower one, 1 the upper one, 2 the whole wall.")
    return int(side)


def _bumps(centres: list[float], rows: np.ndarray, side: int, normals: np.ndarray) -> Bumps:
    d, up = normals.shape[1], normals[:, 1]
    chord = shapes.Chord() if d == 2 else shapes.Chord([0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0])
    unique, place = np.unique(centres, return_inverse=True)
    heights = np.zeros((len(unique), len(centres)))
    heights[place, np.arange(len(centres))] = 1
    weights = {UPPER: up > 0, LOWER: -1.0 * (up < 0), BOTH: np.ones(len(up))}[side]
    shape = shapes.HicksHenne(unique, 3.0, chord=chord)
    return Bumps(tuple(rows.tolist()), shape, jnp.asarray(heights), jnp.asarray(weights, float))


def check_alone(listed: Sequence[Variable]) -> None:
    """Raises `ValueError` for kinds that stand alone in SU2, and boxes beside other kinds."""
    kinds = {variable.kind for variable in listed if variable.kind not in ("ANGLE_OF_ATTACK", "FFD_ANGLE_OF_ATTACK")}
    for kind in ("NACA_4DIGITS", "SURFACE_FILE"):
        if kind in kinds and len(listed) > 1:
            raise ValueError(f"{kind} is taken alone; found {len(listed)} design variables.")
    boxed = {kind for kind in kinds if kind.startswith("FFD_")}
    if boxed and boxed != kinds:
        raise ValueError(
            f"{', '.join(sorted(boxed))} beside {', '.join(sorted(kinds - boxed))}: SU2 moves by one sort."
        )
