"""Shapes in sequence, shapes of some positions, and functions as shapes."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from .._host.package.arguments import as_array, check_fields, checked
from .._kernels.values import as_jax, is_known, replaced, taken
from ._arguments import Numbers, positions
from ._shape import AbstractShape


class Function(AbstractShape):
    """Makes a shape of a function of positions and parameters.

        pitch = shapes.Function(lambda x, angle: shapes.rotate(x, angle, [0.25, 0.0]), 0.0)

    **Arguments:**

    - `function`: takes positions (m, d) and parameters, returns positions (m, d).
    - `rest`: the parameters that move nothing.
    """

    function: Callable[[Any, Any], Any]
    rest: PyTree

    def __check_init__(self):
        check_fields(self)

    def neutral(self) -> PyTree:
        """Returns the parameters that move nothing."""
        return self.rest

    def __call__(self, x: Numbers, parameters: PyTree) -> Float[Array, "m d"]:
        return self.function(positions(x), parameters)


class Chain(AbstractShape):
    """Applies shapes in sequence; the parameters are a dict by the shapes' names.

    A shape whose name is not in the dict is not applied.

        wing = shapes.Chain({"box": box, "pitch": pitch})
        u = shapes.displacement(wing, plan, {"pitch": 0.1})

    **Arguments:**

    - `shapes`: shapes by name, in the order in which they are applied.

    **Raises:** `ValueError` for no shapes, and for parameters of unknown names.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    shapes: tuple[AbstractShape, ...]

    @checked
    def __init__(self, shapes: Mapping[str, AbstractShape]):
        if not shapes:
            raise ValueError("`Chain` needs one shape or more.")
        self.names, self.shapes = tuple(shapes), tuple(shapes.values())

    def neutral(self) -> dict[str, PyTree]:
        """Makes the parameters that move nothing."""
        return {name: shape.neutral() for name, shape in zip(self.names, self.shapes, strict=True)}

    def __call__(self, x: Numbers, parameters: Mapping[str, Any]) -> Float[Array, "m d"]:
        """Moves positions (m, d) by a dict of parameters."""
        x, unknown = positions(x), [name for name in parameters if name not in self.names]
        if unknown:
            raise ValueError(f"no shape is called {', '.join(unknown)}; this chain has {', '.join(self.names)}.")
        for name, shape in zip(self.names, self.shapes, strict=True):
            if name in parameters:
                x = shape(x, parameters[name])
        return x


class OnRows(AbstractShape):
    """Moves some rows of the positions by a shape, such as one patch of a wall.

    Unlike `Part`, it takes shapes that are not linear, and the shape meets its own rows alone.

    **Arguments:**

    - `shape`: any shape.
    - `rows`: (k,) different row numbers, 0 or more.

    **Raises:** `ValueError` for rows that are no different row numbers, and rows beyond the
    positions.
    """

    shape: AbstractShape
    rows: Int[Array, " k"]

    @checked
    def __init__(self, shape: AbstractShape, rows: Any):
        rows = as_array("rows", rows)
        if rows.ndim != 1 or rows.dtype.kind not in "iu" or (rows < 0).any() or len(np.unique(rows)) != len(rows):
            raise ValueError(f"`rows` is an array {rows.shape} of {rows.dtype}; expected (k,) different row numbers.")
        self.shape, self.rows = shape, as_jax(rows)

    def neutral(self) -> PyTree:
        """Makes the parameters that move nothing."""
        return self.shape.neutral()

    def __call__(self, x: Numbers, parameters: PyTree) -> Float[Array, "m d"]:
        x = positions(x)
        if len(self.rows) > len(x) or (
            is_known(self.rows) and self.rows.size and int(np.asarray(self.rows).max()) >= len(x)
        ):
            raise ValueError(f"`rows` has {len(self.rows)} rows up to {self.rows.max()}; `x` has {len(x)}.")
        return replaced(x, self.rows, self.shape(taken(x, self.rows), parameters))
