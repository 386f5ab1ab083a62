"""Shapes: functions of positions and parameters, and shapes made of shapes."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from jaxmorph.extend import Module, checked, is_known

from ._arguments import Numbers, Positions, Vector, check_known, positions, rows_like


class AbstractShape(Module):
    """Moves positions by parameters: `shape(x, parameters)`; a plain function serves as well."""

    @abc.abstractmethod
    def __call__(self, x: Numbers, parameters: PyTree) -> Positions:
        """Moves positions (m, d)."""

    @abc.abstractmethod
    def neutral(self) -> PyTree:
        """Makes the parameters that move nothing."""


Move = Callable[[Any], Positions]  # takes parameters to displacements of given positions


class AbstractLinearShape(AbstractShape):
    """Moves positions by a displacement that is linear in the parameters."""

    @abc.abstractmethod
    def at(self, x: Numbers) -> Move:
        """Computes the weights of positions once, to be applied to many parameters.

        **Returns:** a function from parameters to displacements (m, d), of which
        `jax.vjp` gives the transpose.
        """

    def __call__(self, x: Numbers, parameters: Any) -> Positions:
        x = positions(x)
        return x + self.at(x)(parameters)

    def _numbers(self, parameters: Any, like: Array) -> Float[Array, "..."]:
        needed = self.neutral().shape
        parameters = jnp.asarray(parameters, like.dtype)
        if parameters.shape != needed:
            raise ValueError(
                f"parameters have shape {parameters.shape}; this shape needs {needed}."
            )
        return parameters


class Function(AbstractShape):
    """Makes a shape of a function of positions (m, d) and parameters, which are neutral at `rest`.

    pitch = shapes.Function(lambda x, angle: shapes.rotate(x, angle, [0.25, 0.0]), 0.0)
    """

    function: Callable[[Any, Any], Any]
    rest: PyTree

    @checked
    def __init__(self, function: Callable[[Any, Any], Any], rest: PyTree):
        self.function = function
        self.rest = rest

    def neutral(self) -> PyTree:
        return self.rest

    def __call__(self, x: Numbers, parameters: PyTree) -> Positions:
        return self.function(positions(x), parameters)


class Chain(AbstractShape):
    """Applies shapes in sequence, in the order of a dict by their names.

    The parameters are a dict too; a shape without parameters is not applied.

        wing = shapes.Chain({"box": box, "pitch": pitch})
        u = shapes.displacement(wing, plan, {"pitch": 0.1})

    **Raises:** `ValueError` for no shapes, and for parameters of unknown names.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    shapes: tuple[AbstractShape, ...]

    @checked
    def __init__(self, shapes: Mapping[str, AbstractShape]):
        if not shapes:
            raise ValueError("`Chain` needs one shape or more.")
        self.names = tuple(shapes)
        self.shapes = tuple(shapes.values())

    def neutral(self) -> dict[str, PyTree]:
        return {name: shape.neutral() for name, shape in zip(self.names, self.shapes, strict=True)}

    def __call__(self, x: Numbers, parameters: Mapping[str, Any]) -> Positions:
        x = positions(x)
        unknown = [name for name in parameters if name not in self.names]
        if unknown:
            raise ValueError(
                f"no shape is called {', '.join(unknown)}; this chain has {', '.join(self.names)}."
            )
        for name, shape in zip(self.names, self.shapes, strict=True):
            if name in parameters:
                x = shape(x, parameters[name])
        return x


class OnRows(AbstractShape):
    """Moves some rows of the positions, such as a patch of a wall, by any shape, which sees them
    alone.

    **Raises:** `ValueError` for rows (k,) that are equal, negative, or beyond the positions.
    """

    shape: AbstractShape
    rows: Int[Array, " k"]

    @checked
    def __init__(self, shape: AbstractShape, rows: Any):
        rows = rows_like("rows", rows, 2**31)
        if rows.ndim != 1 or len(np.unique(rows)) != len(rows):
            raise ValueError(
                f"`rows` is an array {rows.shape}; expected (k,) different row numbers."
            )
        self.shape = shape
        self.rows = jnp.asarray(rows)

    def neutral(self) -> PyTree:
        return self.shape.neutral()

    def __call__(self, x: Numbers, parameters: PyTree) -> Positions:
        x = positions(x)
        if is_known(self.rows) and (np.asarray(self.rows) >= len(x)).any():
            raise ValueError(
                f"`rows` has {len(self.rows)} rows up to {self.rows.max()}; `x` has {len(x)}."
            )
        return x.at[self.rows].set(self.shape(x[self.rows], parameters))


class Linked(AbstractLinearShape):
    """A shape whose parameters are a linear map of fewer parameters, such as a basis of your own.

    The p parameters of `shape`, flattened as `jax.flatten_util.ravel_pytree` does, are `matrix @
    parameters`, with a `matrix` (p, q).

    **Raises:** `ValueError` for a matrix of another height.
    """

    shape: AbstractLinearShape
    matrix: Float[Array, "p q"]

    @checked
    def __init__(self, shape: AbstractLinearShape, matrix: Numbers):
        self.shape = shape
        self.matrix = jnp.asarray(matrix, float)
        check_known(matrix=self.matrix)
        count = sum(leaf.size for leaf in jax.tree.leaves(shape.neutral()))
        if self.matrix.ndim != 2 or len(self.matrix) != count:
            raise ValueError(
                f"`matrix` has shape {self.matrix.shape}; a shape with {count} parameters needs "
                f"({count}, q)."
            )

    def neutral(self) -> Vector:
        return jnp.zeros(self.matrix.shape[1], self.matrix.dtype)

    def at(self, x: Numbers) -> Move:
        x = positions(x)
        move = self.shape.at(x)
        unravel = ravel_pytree(self.shape.neutral())[1]
        return lambda parameters: move(
            unravel(self.matrix.astype(x.dtype) @ self._numbers(parameters, x))
        )


class Together(AbstractLinearShape):
    """Several linear shapes added, such as two boxes side by side; the parameters are a tuple.

    A box that another box carries is nested instead: `outer(inner(x, q), p)`, or a `Chain`.
    """

    shapes: tuple[AbstractLinearShape, ...]

    @checked
    def __init__(self, *shapes: AbstractLinearShape):
        if not shapes:
            raise ValueError("`Together` needs one shape or more.")
        self.shapes = shapes

    def neutral(self) -> tuple[PyTree, ...]:
        return tuple(shape.neutral() for shape in self.shapes)

    def at(self, x: Numbers) -> Move:
        moves = [shape.at(x) for shape in self.shapes]

        def add(parameters: Sequence[Any]) -> Positions:
            if len(parameters) != len(moves):
                raise ValueError(f"{len(parameters)} sets of parameters for {len(moves)} shapes.")
            first, *others = (move(own) for move, own in zip(moves, parameters, strict=True))
            return sum(others, start=first)

        return add


class Part(AbstractLinearShape):
    """A linear shape restricted to a mask (m,), such as the upper side of an airfoil.

    **Raises:** `ValueError` for a mask of another length than the positions.
    """

    shape: AbstractLinearShape
    mask: Bool[Array, " m"]

    @checked
    def __init__(self, shape: AbstractLinearShape, mask: Bool[ArrayLike, " m"] | Sequence[Any]):
        self.shape = shape
        self.mask = jnp.asarray(mask)
        if self.mask.ndim != 1 or self.mask.dtype != bool:
            raise ValueError(
                f"`mask` has shape {self.mask.shape}; expected (m,) of True and False."
            )

    def neutral(self) -> PyTree:
        return self.shape.neutral()

    def at(self, x: Numbers) -> Move:
        x = positions(x)
        if self.mask.shape != x.shape[:1]:
            raise ValueError(f"`mask` has {len(self.mask)} rows for {len(x)} positions.")
        move = self.shape.at(x)
        return lambda parameters: jnp.where(self.mask[:, None], move(parameters), 0)
