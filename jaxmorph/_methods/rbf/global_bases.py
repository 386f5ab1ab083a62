"""Bases without a support, beside `ThinPlateSpline`, `Gaussian` and `Multiquadric`."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._kernels.values import root
from ..numbers import length
from .basis import AbstractBasis


class LinearSpline(AbstractBasis):
    """Evaluates phi(r) = r: without a parameter; needs a constant polynomial. It has a cone at each source (Duchon 1977)."""

    min_degree: ClassVar[int | None] = 0
    scale_free: ClassVar[bool] = True

    def __call__(self, r2):
        return root(r2)


class CubicSpline(AbstractBasis):
    """Evaluates phi(r) = r^3, the smoothest interpolation in 3-D: no parameter; needs a linear polynomial (Duchon 1977)."""

    min_degree: ClassVar[int | None] = 1
    scale_free: ClassVar[bool] = True

    def __call__(self, r2):
        return r2 * root(r2)


class InverseMultiquadric(AbstractBasis):
    """Evaluates phi(r) = 1 / sqrt(1 + r^2 / R^2); positive definite.

    R is `radius`, a length in the mesh's units (de Boer, van der Schoot and Bijl 2007).
    """

    radius: Float[Array, ""] = eqx.field(converter=length("radius"))

    def __call__(self, r2):
        return 1 / jnp.sqrt(1 + r2 * (1 / self.radius.astype(r2.dtype) ** 2))


class InverseQuadratic(AbstractBasis):
    """Evaluates phi(r) = 1 / (1 + r^2 / R^2); positive definite.

    R is `radius`, a length in the mesh's units (de Boer, van der Schoot and Bijl 2007).
    """

    radius: Float[Array, ""] = eqx.field(converter=length("radius"))

    def __call__(self, r2):
        return 1 / (1 + r2 * (1 / self.radius.astype(r2.dtype) ** 2))
