"""Radial bases: the abstract class, and functions without a support."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._kernels.log import half_x_log_x
from ..._kernels.module import Module
from ..._kernels.values import root
from ..numbers import length


class AbstractBasis(Module):
    """A radial function phi of the squared distance r2 (any shape, the mesh's units squared).

    A basis of your own needs `__call__` alone. Two class attributes say when the interpolation is
    well posed and how it scales; their defaults suit every positive definite function with a
    radius:

    - `min_degree`: the lowest degree of the polynomial with which the interpolation matrix is
      regular (None: no polynomial needed). For a conditionally positive definite function of order
      k it is k - 1.
    - `scale_free`: True if phi of a scaled distance differs from a multiple of phi by a polynomial
      of `min_degree`. Distances are then taken in units of the sources' extent, which conditions
      the matrix.
    """

    min_degree: ClassVar[int | None] = None
    scale_free: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, r2: Float[Array, "..."]) -> Float[Array, "..."]:
        """Computes phi, elementwise. It must be finite, derivatives included, at r2 = 0."""


class ThinPlateSpline(AbstractBasis):
    """Evaluates phi(r) = r^2 log r (Duchon 1977).

    It is global, has no parameter, and needs a linear polynomial.
    """

    min_degree: ClassVar[int | None] = 1
    scale_free: ClassVar[bool] = True

    def __call__(self, r2):
        return half_x_log_x(r2)


class LinearSpline(AbstractBasis):
    """Evaluates phi(r) = r, with a cone at each source (Duchon 1977).

    It has no parameter, and needs a constant polynomial.
    """

    min_degree: ClassVar[int | None] = 0
    scale_free: ClassVar[bool] = True

    def __call__(self, r2):
        return root(r2)


class CubicSpline(AbstractBasis):
    """Evaluates phi(r) = r^3, the smoothest interpolation in 3-D (Duchon 1977).

    It has no parameter, and needs a linear polynomial.
    """

    min_degree: ClassVar[int | None] = 1
    scale_free: ClassVar[bool] = True

    def __call__(self, r2):
        return r2 * root(r2)


class Gaussian(AbstractBasis):
    """Evaluates phi(r) = exp(-r^2 / R^2).

    **Arguments:**

    - `radius`: R in the mesh's units. A wide function makes the matrix ill-conditioned.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    radius: Float[Array, ""] = eqx.field(converter=length("radius"))

    def __call__(self, r2):
        return jnp.exp(r2 * (-1 / self.radius.astype(r2.dtype) ** 2))


class Multiquadric(AbstractBasis):
    """Evaluates phi(r) = sqrt(1 + r^2 / R^2) (Hardy 1971); needs a constant polynomial.

    **Arguments:**

    - `radius`: R in the mesh's units. A wide function makes the matrix ill-conditioned.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    min_degree: ClassVar[int | None] = 0
    radius: Float[Array, ""] = eqx.field(converter=length("radius"))

    def __call__(self, r2):
        return jnp.sqrt(1 + r2 * (1 / self.radius.astype(r2.dtype) ** 2))


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
