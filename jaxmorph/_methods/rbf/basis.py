"""Radial bases. Each takes the squared distance, so that no root has to be differentiated at a source."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._kernels.log import half_x_log_x
from ..._kernels.module import Module
from ..numbers import length


class AbstractBasis(Module):
    """A radial function phi, called with the squared distance r2 (any shape, the mesh's units squared).

    A basis of your own needs `__call__` alone. Two class attributes say when the interpolation is well posed and how it
    scales; their defaults suit every positive definite function with a radius:

    - `min_degree`: the lowest degree of the polynomial with which the interpolation matrix is regular (None: no polynomial
      needed). For a conditionally positive definite function of order k it is k - 1.
    - `scale_free`: True if phi of a scaled distance differs from a multiple of phi by a polynomial of `min_degree`. Distances
      are then taken in units of the sources' extent, which conditions the matrix.
    """

    min_degree: ClassVar[int | None] = None
    scale_free: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, r2: Float[Array, "..."]) -> Float[Array, "..."]:
        """Computes phi, elementwise. It must be finite, derivatives included, at r2 = 0."""


class ThinPlateSpline(AbstractBasis):
    """Evaluates phi(r) = r^2 log r (Duchon 1977): global, without a parameter; needs a linear polynomial."""

    min_degree: ClassVar[int | None] = 1
    scale_free: ClassVar[bool] = True

    def __call__(self, r2):
        return half_x_log_x(r2)


class WendlandC2(AbstractBasis):
    """Evaluates phi(r) = (1 - r/R)^4 (4 r/R + 1) for r < R, and 0 beyond (Wendland 1995).

    **Arguments:**

    - `support_radius`: R in the mesh's units. A larger one gives a smoother motion, and a worse condition.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    support_radius: Float[Array, ""] = eqx.field(converter=length("support_radius"))

    def __call__(self, r2):
        return _wendland_c2(r2, self.support_radius.astype(r2.dtype))


class Gaussian(AbstractBasis):
    """Evaluates phi(r) = exp(-r^2 / R^2).

    **Arguments:**

    - `radius`: R in the mesh's units. A wide one makes the matrix ill-conditioned.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    radius: Float[Array, ""] = eqx.field(converter=length("radius"))

    def __call__(self, r2):
        return jnp.exp(r2 * (-1 / self.radius.astype(r2.dtype) ** 2))


class Multiquadric(AbstractBasis):
    """Evaluates phi(r) = sqrt(1 + r^2 / R^2) (Hardy 1971); needs a constant polynomial.

    **Arguments:**

    - `radius`: R in the mesh's units. A wide one makes the matrix ill-conditioned.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    min_degree: ClassVar[int | None] = 0
    radius: Float[Array, ""] = eqx.field(converter=length("radius"))

    def __call__(self, r2):
        return jnp.sqrt(1 + r2 * (1 / self.radius.astype(r2.dtype) ** 2))


def relative_radius(r2, support_radius):
    """Computes r / R, but never less than round-off: its derivative would be infinite at 0."""
    return jnp.sqrt(r2 * (1 / support_radius**2) + float(jnp.finfo(r2.dtype).eps) ** 2)


@jax.custom_jvp
def _wendland_c2(r2, support_radius):
    xi = relative_radius(r2, support_radius)
    inner = 1 - xi
    return jnp.where(xi >= 1, 0, (inner * inner) * (inner * inner) * (4 * xi + 1))


@_wendland_c2.defjvp
def _wendland_c2_jvp(primals, tangents):
    # d phi / d r2 = -10 (1 - xi)^3 / R^2 is regular at r = 0, where the chain rule through the root is not
    r2, support_radius = primals
    r2_dot, radius_dot = tangents
    xi = relative_radius(r2, support_radius)
    slope = jnp.where(xi >= 1, 0, -10 * (1 - xi) ** 3 / support_radius**2)
    return _wendland_c2(r2, support_radius), slope * (r2_dot - 2 * r2 / support_radius * radius_dot)
