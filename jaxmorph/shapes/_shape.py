"""Shapes: functions of positions and parameters, and shapes made of shapes."""

import abc
import functools
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._host.package.arguments import as_array, check_fields, checked
from .._kernels.module import Module
from .._kernels.values import as_jax, is_known, taken
from ._arguments import Numbers, check_finite, positions


class AbstractShape(Module):
    """Moves positions by parameters: `shape(x, parameters)`.

    A plain function of `(x, parameters)` serves as well. A class adds `neutral()`, the parameters
    that move nothing.
    """

    @abc.abstractmethod
    def __call__(self, x: Numbers, parameters: PyTree) -> Float[Array, "m d"]:
        """Moves positions (m, d)."""

    @abc.abstractmethod
    def neutral(self) -> PyTree:
        """Makes the parameters that move nothing."""


class AbstractLinearShape(AbstractShape):
    """Moves positions by a displacement that is linear in the parameters."""

    @abc.abstractmethod
    def at(self, x: Numbers) -> Callable[[Any], Float[Array, "m d"]]:
        """Computes the weights of positions once, to be applied to many parameters.

        **Returns:** a function from parameters to displacements (m, d), of which
        `jax.linear_transpose` gives the transpose.
        """

    def __call__(self, x: Numbers, parameters: Any) -> Float[Array, "m d"]:
        """Moves positions (m, d): `x + shape.at(x)(parameters)`."""
        x = positions(x)
        return x + self.at(x)(parameters)


class Operator(Module):
    """A linear function of parameters with its arrays: `function(*arrays, parameters)`.

    As a closure over the arrays would be, but the arrays are leaves, and programs do not hold them.
    With `shape`, parameters are one array of this shape, which takes the dtype of the first array.
    """

    function: Callable[..., Any] = eqx.field(static=True)
    arrays: tuple[PyTree, ...]
    shape: tuple[int, ...] | None = eqx.field(static=True, default=None)

    def __call__(self, parameters: PyTree) -> Float[Array, "m d"]:
        if self.shape is not None:
            parameters = jnp.asarray(parameters, jax.tree.leaves(self.arrays)[0].dtype)
            if parameters.shape != self.shape:
                raise ValueError(f"parameters have shape {parameters.shape}; this shape needs {self.shape}.")
        return self.function(*self.arrays, parameters)


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
        return self.shape.neutral()

    def __call__(self, x: Numbers, parameters: PyTree) -> Float[Array, "m d"]:
        x = positions(x)
        if is_known(self.rows) and (np.asarray(self.rows) >= len(x)).any():
            raise ValueError(f"`rows` has {len(self.rows)} rows up to {self.rows.max()}; `x` has {len(x)}.")
        return x.at[self.rows].set(self.shape(taken(x, self.rows), parameters))


class Linked(AbstractLinearShape):
    """A shape whose parameters are a linear map of fewer parameters.

    It freezes, links and mirrors parameters, or takes a basis of your own.

    **Arguments:**

    - `shape`: a linear shape with p parameters, flattened as `jax.flatten_util.ravel_pytree` does.
    - `matrix`: (p, q); the shape's parameters are `matrix @ parameters`.

    **Raises:** `ValueError` for a matrix of another height.
    """

    shape: AbstractLinearShape
    matrix: Float[Array, "p q"]

    @checked
    def __init__(self, shape: AbstractLinearShape, matrix: Numbers):
        self.shape, self.matrix = shape, jnp.asarray(matrix, float)
        check_finite(matrix=self.matrix)
        count = sum(leaf.size for leaf in jax.tree.leaves(shape.neutral()))
        if self.matrix.ndim != 2 or len(self.matrix) != count:
            raise ValueError(
                f"`matrix` has shape {self.matrix.shape}; a shape with {count} parameters needs ({count}, q)."
            )

    def neutral(self) -> Float[Array, " q"]:
        return jnp.zeros(self.matrix.shape[1], self.matrix.dtype)

    def at(self, x: Numbers) -> Operator:
        x = positions(x)
        arrays = self.matrix.astype(x.dtype), self.shape.at(x), self.shape.neutral()
        return Operator(_linked, arrays, self.matrix.shape[1:])


def _linked(matrix: Array, operator: Callable, like: PyTree, parameters: Array) -> Float[Array, "m d"]:
    return operator(ravel_pytree(like)[1](matrix @ parameters))


class Together(AbstractLinearShape):
    """Several linear shapes added, such as two boxes side by side.

    The parameters are a tuple, one entry for each shape.

    A box that another box is to carry is nested instead: `outer(inner(x, q), p)`, or a `Chain`.
    """

    shapes: tuple[AbstractLinearShape, ...]

    @checked
    def __init__(self, *shapes: AbstractLinearShape):
        if not shapes:
            raise ValueError("`Together` needs one shape or more.")
        self.shapes = shapes

    def neutral(self) -> tuple[PyTree, ...]:
        return tuple(shape.neutral() for shape in self.shapes)

    def at(self, x: Numbers) -> Operator:
        return Operator(_summed, tuple(shape.at(x) for shape in self.shapes))


def _summed(*operators_and_parameters: Any) -> Float[Array, "m d"]:
    *operators, parameters = operators_and_parameters
    if len(parameters) != len(operators):
        raise ValueError(f"{len(parameters)} sets of parameters for {len(operators)} shapes.")
    first, *others = (operator(values) for operator, values in zip(operators, parameters, strict=True))
    return functools.reduce(jnp.add, others, first)


class Part(AbstractLinearShape):
    """A linear shape on some of the positions, such as the upper side of an airfoil.

    **Arguments:**

    - `shape`: a linear shape.
    - `kept`: (m,) True where it acts.

    **Raises:** `ValueError` for a mask of another length than the positions.
    """

    shape: AbstractLinearShape
    kept: Bool[Array, " m"]

    @checked
    def __init__(self, shape: AbstractLinearShape, kept: Any):
        kept = as_array("kept", kept)
        if kept.ndim != 1 or kept.dtype != bool:
            raise ValueError(f"`kept` is an array {kept.shape} of {kept.dtype}; expected (m,) of True and False.")
        self.shape, self.kept = shape, jnp.asarray(kept)

    def neutral(self) -> PyTree:
        return self.shape.neutral()

    def at(self, x: Numbers) -> Operator:
        x = positions(x)
        if self.kept.shape != x.shape[:1]:
            raise ValueError(f"`kept` has {len(self.kept)} rows for {len(x)} positions.")
        return Operator(_masked, (self.kept, self.shape.at(x)))


def _masked(mask: Array, operator: Callable, parameters: PyTree) -> Float[Array, "m d"]:
    return jnp.where(mask[:, None], operator(parameters), 0)
