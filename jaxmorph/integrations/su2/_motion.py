"""The motion of a wall by SU2's design variables, as SU2 states each; displacements add up."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxmorph import shapes

from ._variables import Variable


class AbstractPart(eqx.Module):
    """The displacement by some design variables; `rows` are their places among all values."""

    rows: eqx.AbstractVar[tuple[int, ...]]

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "m d"], values: Float[Array, " k"]) -> Float[Array, "m d"]:
        """Computes displacements (m, d) of a wall at `x`."""


class DesignVariables(shapes.AbstractShape):
    """A config file's shape: moves the nodes of `DV_MARKER` by the design variables' values.

    The parameters (n,) are the values in the order of the file; a control point without a direction
    has a value for each coordinate. `names` are the variables' names, as messages have them. Nodes
    in symmetry planes stay in them: their coordinates that are not `free` stay.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    parts: tuple[AbstractPart, ...]
    scales: Float[Array, " n"]
    rest: Float[Array, " n"]
    free: Bool[Array, "m d"]

    def neutral(self) -> Float[Array, " n"]:
        """Makes the values that move nothing: 1 for a factor, else 0."""
        return self.rest

    def __call__(self, x: Any, parameters: Any) -> Float[Array, "m d"]:
        x = jnp.asarray(x)
        if np.shape(parameters) != self.rest.shape:
            raise ValueError(f"`parameters` have shape {np.shape(parameters)}; this config file has {self.rest.shape}.")
        values = jnp.asarray(parameters, x.dtype) * self.scales.astype(x.dtype)
        terms = [part(x, values[np.array(part.rows, int)]) for part in self.parts]
        return x + jnp.where(self.free, sum(terms[1:], terms[0]), 0) if terms else x


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


class Displacement(AbstractPart):
    """Moves nodes to where a file puts them, whatever the value."""

    rows: tuple[int, ...] = eqx.field(static=True)
    u: Float[Array, "m d"]

    def __call__(self, x, values):
        return self.u.astype(x.dtype)


def rigid_parts(listed: Sequence[Variable], first: Int[np.ndarray, " v"], d: int) -> list[AbstractPart]:
    """Makes the parts of the variables that move all nodes alike, or the whole mesh.

    `first` is the place of each variable's first value.
    """
    parts: list[AbstractPart] = []
    for variable, row in zip(listed, first.tolist(), strict=True):
        numbers, rows = np.array(variable.numbers), (row,)
        if variable.kind in ("TRANSLATION", "TRANSLATE_GRID"):
            length = np.linalg.norm(numbers[:d]) if variable.kind == "TRANSLATE_GRID" else 1.0
            if not length:
                raise ValueError("TRANSLATE_GRID along a vector without length.")
            parts.append(Translation(rows, jnp.asarray(numbers[:d] / length)))
        elif variable.kind in ("ROTATION", "ROTATE_GRID"):
            axis = numbers[3:] - numbers[:3]
            if d == 2 and axis[:2].any():
                raise ValueError(f"{variable.kind} about the axis {axis}: in 2-D both ends have the same x and y.")
            if d == 3 and not axis.any():
                raise ValueError(f"{variable.kind} about an axis without length: its two ends are one point.")
            parts.append(Rotation(rows, jnp.asarray(numbers[:d]), jnp.asarray(axis) if d == 3 else None))
        elif variable.kind in ("SCALE", "SCALE_GRID"):
            parts.append(Scale(rows))
    return parts
