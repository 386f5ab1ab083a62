"""Radial bases: the abstract class, global functions, and functions of compact support.

Compact bases are those of Wendland (1995), and compact thin plate splines of Wu (1995). De Boer,
van der Schoot and Bijl (Computers and Structures 85, 2007) compared all on moving meshes.
"""

import abc
import functools
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._kernels.log import half_x_log_x
from ..._kernels.module import Module
from ..._kernels.values import root
from ..base import Scalar, number

Squared = Float[Array, "..."]  # squared distances, or a function of them
Sources = Float[Array, "s d"]  # coordinates of sources
Columns = Float[Array, "s k"]  # values or weights at sources
Weights = Float[Array, "k s"]  # weights of sources, in rows


class AbstractBasis(Module):
    """A radial function phi of the squared distance r2 (any shape, the mesh's units squared).

    A basis of your own needs `__call__` alone. The defaults of two class attributes suit every
    positive definite function with a radius:

    - `min_degree`: the lowest degree of the polynomial with which the interpolation matrix is
      regular (None: no polynomial needed): k - 1 for a conditionally positive definite function of
      order k.
    - `scale_free`: True if phi of a scaled distance differs from a multiple of phi by a polynomial
      of `min_degree`. Distances are then in units of the sources' extent: better conditioned.
    """

    min_degree: ClassVar[int | None] = None
    scale_free: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, r2: Squared) -> Squared:
        """Computes phi, elementwise. It must be finite, derivatives included, at r2 = 0."""


class ThinPlateSpline(AbstractBasis):
    """Evaluates phi(r) = r^2 log r (Duchon 1977); without parameter, with a linear polynomial."""

    min_degree = 1
    scale_free = True

    def __call__(self, r2):
        return half_x_log_x(r2)


class LinearSpline(AbstractBasis):
    """Evaluates phi(r) = r, a cone at each source (Duchon 1977); with a constant polynomial."""

    min_degree = 0
    scale_free = True

    def __call__(self, r2):
        return root(r2)


class CubicSpline(AbstractBasis):
    """Evaluates phi(r) = r^3, the smoothest in 3-D (Duchon 1977); needs a linear polynomial."""

    min_degree = 1
    scale_free = True

    def __call__(self, r2):
        return r2 * root(r2)


class AbstractScaledBasis(AbstractBasis):
    """A function of (r / R)^2 on the whole space, of a `radius` R in the mesh's units.

    A wide function makes the matrix ill-conditioned. The constructor raises `ValueError` for a
    radius that is not positive and finite.
    """

    radius: Scalar = eqx.field(converter=number("radius", 0))

    def relative(self, r2):
        return r2 * (1 / self.radius.astype(r2.dtype) ** 2)


class Gaussian(AbstractScaledBasis):
    """Evaluates phi(r) = exp(-r^2 / R^2), of a `radius` R; positive definite."""

    def __call__(self, r2):
        return jnp.exp(-self.relative(r2))


class Multiquadric(AbstractScaledBasis):
    """Evaluates phi(r) = sqrt(1 + r^2 / R^2), of a `radius` R; needs a constant polynomial."""

    min_degree = 0

    def __call__(self, r2):
        return jnp.sqrt(1 + self.relative(r2))


class InverseMultiquadric(AbstractScaledBasis):
    """Evaluates phi(r) = 1 / sqrt(1 + r^2 / R^2), of a `radius` R; positive definite."""

    def __call__(self, r2):
        return 1 / jnp.sqrt(1 + self.relative(r2))


class InverseQuadratic(AbstractScaledBasis):
    """Evaluates phi(r) = 1 / (1 + r^2 / R^2), of a `radius` R; positive definite."""

    def __call__(self, r2):
        return 1 / (1 + self.relative(r2))


class AbstractCompactBasis(AbstractBasis):
    """A function of xi = r / R that is zero from xi = 1 on; positive definite in 2-D and 3-D.

    It is given by `value`, phi(xi), and `slope`, phi'(xi) / (2 xi), for 0 < xi < 1: by a derivative
    of phi alone, the slope would not be right at a source. R is `support_radius`.
    """

    support_radius: Scalar = eqx.field(converter=number("support_radius", 0))

    @staticmethod
    @abc.abstractmethod
    def value(xi: Squared) -> Squared: ...

    @staticmethod
    @abc.abstractmethod
    def slope(xi: Squared) -> Squared: ...

    def __call__(self, r2):
        return _compact(type(self), r2, self.support_radius.astype(r2.dtype))


def _relative(r2, support_radius):
    """Computes r / R, but never less than round-off: its derivative would be infinite at 0."""
    return jnp.sqrt(r2 * (1 / support_radius**2) + float(jnp.finfo(r2.dtype).eps) ** 2)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _compact(kind, r2, support_radius):
    xi = _relative(r2, support_radius)
    return jnp.where(xi >= 1, 0, kind.value(jnp.minimum(xi, 1)))


@_compact.defjvp
def _compact_jvp(kind, primals, tangents):
    # d phi / d r2 = phi'(xi) / (2 xi R^2) is regular at r = 0, where the chain rule through the
    # root is not
    r2, support_radius = primals
    r2_dot, radius_dot = tangents
    xi = _relative(r2, support_radius)
    slope = jnp.where(xi >= 1, 0, kind.slope(jnp.minimum(xi, 1))) / support_radius**2
    return _compact(kind, r2, support_radius), slope * (
        r2_dot - 2 * r2 / support_radius * radius_dot
    )


def _factored(power: int, *coefficients: float | int) -> Any:
    """Makes (1 - xi)^power times a polynomial, its constant first."""

    def value(xi):
        return (1 - xi) ** power * sum(c * xi**k for k, c in enumerate(coefficients))

    return staticmethod(value)


class WendlandC0(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^2, with xi = r / `support_radius`: a cone at each source."""

    value = _factored(2, 1)
    slope = staticmethod(lambda xi: -(1 - xi) / xi)


class WendlandC2(AbstractCompactBasis):
    """Evaluates phi(r) = (1 - r/R)^4 (4 r/R + 1) for r < R, and 0 beyond (Wendland 1995).

    R is `support_radius`, in the mesh's units. A larger radius gives a smoother motion, and a worse
    condition. The constructor raises `ValueError` for a radius that is not positive and finite.
    """

    value = _factored(4, 1, 4)
    slope = _factored(3, -10)


class WendlandC4(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^6 (35/3 xi^2 + 6 xi + 1), with xi = r / `support_radius`.

    It has four continuous derivatives (Wendland 1995).
    """

    value = _factored(6, 1, 6, 35 / 3)
    slope = _factored(5, -28 / 3, -140 / 3)


class WendlandC6(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^8 (32 xi^3 + 25 xi^2 + 8 xi + 1), with xi = r / `support_radius`.

    It has six continuous derivatives (Wendland 1995).
    """

    value = _factored(8, 1, 8, 25, 32)
    slope = _factored(7, -11, -77, -176)


class CompactC0(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^5, de Boer's CTPS C0, with xi = r / `support_radius` (Wu 1995)."""

    value = _factored(5, 1)
    slope = staticmethod(lambda xi: -2.5 * (1 - xi) ** 4 / xi)


class CompactC1(AbstractCompactBasis):
    """Evaluates de Boer's CTPS C1, with xi = r / `support_radius` (Wu 1995).

    phi = 1 + 80/3 xi^2 - 40 xi^3 + 15 xi^4 - 8/3 xi^5 + 20 xi^2 log xi.
    """

    value = staticmethod(
        lambda xi: 1 + xi**2 * (80 / 3 - 40 * xi + 15 * xi**2 - 8 / 3 * xi**3 + 20 * jnp.log(xi))
    )
    slope = staticmethod(
        lambda xi: 110 / 3 - 60 * xi + 30 * xi**2 - 20 / 3 * xi**3 + 20 * jnp.log(xi)
    )


class CompactC2a(AbstractCompactBasis):
    """Evaluates de Boer's CTPS C2a, with xi = r / `support_radius` (Wu 1995).

    phi = 1 - 30 xi^2 - 10 xi^3 + 45 xi^4 - 6 xi^5 - 60 xi^3 log xi.
    """

    value = staticmethod(
        lambda xi: 1 - xi**2 * (30 + 10 * xi - 45 * xi**2 + 6 * xi**3 + 60 * xi * jnp.log(xi))
    )
    slope = staticmethod(lambda xi: -30 - 45 * xi + 90 * xi**2 - 15 * xi**3 - 90 * xi * jnp.log(xi))


class CompactC2b(AbstractCompactBasis):
    """Evaluates de Boer's CTPS C2b, with xi = r / `support_radius` (Wu 1995).

    phi = 1 - 20 xi^2 + 80 xi^3 - 45 xi^4 - 16 xi^5 + 60 xi^4 log xi.
    """

    value = staticmethod(
        lambda xi: 1 - xi**2 * (20 - 80 * xi + 45 * xi**2 + 16 * xi**3 - 60 * xi**2 * jnp.log(xi))
    )
    slope = staticmethod(
        lambda xi: -20 + 120 * xi - 60 * xi**2 - 40 * xi**3 + 120 * xi**2 * jnp.log(xi)
    )
