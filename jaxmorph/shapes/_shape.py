"""Shapes: functions of positions and parameters."""

import abc
from typing import Any

from jaxtyping import Array, Float, PyTree

from .._kernels.module import Module
from ._arguments import Numbers, positions


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


class AbstractOperator(Module):
    """Computes displacements (m, d) of fixed positions; linear in the parameters.

    `jax.linear_transpose` gives its transpose.
    """

    @abc.abstractmethod
    def __call__(self, parameters: PyTree) -> Float[Array, "m d"]:
        """Computes the displacements."""


class AbstractLinearShape(AbstractShape):
    """Moves positions by a displacement that is linear in the parameters."""

    @abc.abstractmethod
    def at(self, x: Numbers) -> AbstractOperator:
        """Computes the weights of positions once, to be applied to many parameters."""

    def __call__(self, x: Numbers, parameters: Any) -> Float[Array, "m d"]:
        """Moves positions (m, d): `x + shape.at(x)(parameters)`."""
        x = positions(x)
        return x + self.at(x)(parameters)
