"""Shapes made of shapes: fewer parameters, sums of shapes, shapes on some positions."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from .._host.package.arguments import as_array, checked
from ._arguments import Numbers, check_finite, positions
from ._shape import AbstractLinearShape, AbstractOperator


class LinkedOperator(AbstractOperator):
    """Applies a matrix to the parameters before an operator."""

    operator: AbstractOperator
    matrix: Float[Array, "p q"]
    like: PyTree

    def __call__(self, parameters: Numbers) -> Float[Array, "m d"]:
        parameters = jnp.asarray(parameters, self.matrix.dtype)
        if parameters.shape != self.matrix.shape[1:]:
            raise ValueError(f"parameters have shape {parameters.shape}; this shape has {self.matrix.shape[1]}.")
        return self.operator(ravel_pytree(self.like)[1](self.matrix @ parameters))


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
        """Makes the parameters that move nothing: zeros (q,)."""
        return jnp.zeros(self.matrix.shape[1], self.matrix.dtype)

    def at(self, x: Numbers) -> LinkedOperator:
        """Computes the weights of positions (m, d) once."""
        x = positions(x)
        return LinkedOperator(self.shape.at(x), self.matrix.astype(x.dtype), self.shape.neutral())


class SumOperator(AbstractOperator):
    """Adds the displacements of several operators."""

    operators: tuple[AbstractOperator, ...]

    def __call__(self, parameters: Sequence[Any]) -> Float[Array, "m d"]:
        if len(parameters) != len(self.operators):
            raise ValueError(f"{len(parameters)} sets of parameters for {len(self.operators)} shapes.")
        terms = [operator(values) for operator, values in zip(self.operators, parameters, strict=True)]
        return sum(terms[1:], terms[0])


class Together(AbstractLinearShape):
    """Several linear shapes added, such as two boxes side by side.

    The parameters are a tuple, one entry for each shape.

    A box that another box is to carry is nested instead: `outer(inner(x, q), p)`.
    """

    shapes: tuple[AbstractLinearShape, ...]

    @checked
    def __init__(self, *shapes: AbstractLinearShape):
        if not shapes:
            raise ValueError("`Together` needs one shape or more.")
        self.shapes = shapes

    def neutral(self) -> tuple[PyTree, ...]:
        """Makes the parameters that move nothing."""
        return tuple(shape.neutral() for shape in self.shapes)

    def at(self, x: Numbers) -> SumOperator:
        """Computes the weights of positions (m, d) once."""
        return SumOperator(tuple(shape.at(x) for shape in self.shapes))


class MaskedOperator(AbstractOperator):
    """Keeps the displacements of some positions, and sets all other displacements to zero."""

    operator: AbstractOperator
    kept: Bool[Array, " m"]

    def __call__(self, parameters: PyTree) -> Float[Array, "m d"]:
        return jnp.where(self.kept[:, None], self.operator(parameters), 0)


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
        """Makes the parameters that move nothing."""
        return self.shape.neutral()

    def at(self, x: Numbers) -> MaskedOperator:
        """Computes the weights of positions (m, d) once."""
        x = positions(x)
        if self.kept.shape != x.shape[:1]:
            raise ValueError(f"`kept` has {len(self.kept)} rows for {len(x)} positions.")
        return MaskedOperator(self.shape.at(x), self.kept)


class MatrixOperator(AbstractOperator):
    """Sums vectors with weights: one matrix product.

    The parameters are (k, d), or numbers (k,) along one direction.
    """

    weights: Float[Array, "m k"]
    along: Float[Array, " d"] | None = None
    count: int = eqx.field(static=True, default=0)

    def __call__(self, parameters: Numbers) -> Float[Array, "m d"]:
        parameters = jnp.asarray(parameters, self.weights.dtype)
        expected = (self.weights.shape[1],) + (() if self.along is not None else (self.count,))
        if parameters.shape != expected:
            raise ValueError(f"parameters have shape {parameters.shape}; this shape needs {expected}.")
        sums = self.weights @ parameters
        return sums if self.along is None else sums[:, None] * self.along[None, :]
