"""Bases of compact support: of Wendland (1995), and compact thin plate splines of Wu (1995).

De Boer, van der Schoot and Bijl (Computers and Structures 85, 2007) compared them with global bases
on moving meshes.
"""

import abc
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numbers import length
from .basis import AbstractBasis


class AbstractCompactBasis(AbstractBasis):
    """A function of xi = r / R that is zero from xi = 1 on.

    It is given with its slope, so that both are right at a source.

    The radius R is in the mesh's units. All are positive definite, in 2-D and 3-D: no polynomial is
    needed.
    """

    support_radius: Float[Array, ""] = eqx.field(converter=length("support_radius"))

    @staticmethod
    @abc.abstractmethod
    def value(xi: Float[Array, "..."]) -> Float[Array, "..."]:
        """Computes phi(xi) for 0 < xi < 1."""

    @staticmethod
    @abc.abstractmethod
    def slope(xi: Float[Array, "..."]) -> Float[Array, "..."]:
        """Computes phi'(xi) / (2 xi) for 0 < xi < 1."""

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
    return _compact(kind, r2, support_radius), slope * (r2_dot - 2 * r2 / support_radius * radius_dot)


class WendlandC0(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^2: continuous alone, with a cone at each source.

    xi is the distance over `support_radius`, a length in the mesh's units (Wendland 1995).
    """

    @staticmethod
    def value(xi):
        return (1 - xi) ** 2

    @staticmethod
    def slope(xi):
        return -(1 - xi) / xi


class WendlandC2(AbstractCompactBasis):
    """Evaluates phi(r) = (1 - r/R)^4 (4 r/R + 1) for r < R, and 0 beyond (Wendland 1995).

    **Arguments:**

    - `support_radius`: R in the mesh's units. A larger radius gives a smoother motion, and a worse
      condition.

    **Raises:** `ValueError` for a radius that is not positive and finite.
    """

    @staticmethod
    def value(xi):
        inner = 1 - xi
        return (inner * inner) * (inner * inner) * (4 * xi + 1)

    @staticmethod
    def slope(xi):
        return -10 * (1 - xi) ** 3


class WendlandC4(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^6 (35/3 xi^2 + 6 xi + 1): four continuous derivatives.

    xi is the distance over `support_radius`, a length in the mesh's units (Wendland 1995).
    """

    @staticmethod
    def value(xi):
        return (1 - xi) ** 6 * (35 / 3 * xi**2 + 6 * xi + 1)

    @staticmethod
    def slope(xi):
        return -28 / 3 * (1 - xi) ** 5 * (5 * xi + 1)


class WendlandC6(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^8 (32 xi^3 + 25 xi^2 + 8 xi + 1): six continuous derivatives.

    xi is the distance over `support_radius`, a length in the mesh's units (Wendland 1995).
    """

    @staticmethod
    def value(xi):
        return (1 - xi) ** 8 * (32 * xi**3 + 25 * xi**2 + 8 * xi + 1)

    @staticmethod
    def slope(xi):
        return -11 * (1 - xi) ** 7 * (16 * xi**2 + 7 * xi + 1)


class CompactC0(AbstractCompactBasis):
    """Evaluates phi = (1 - xi)^5, de Boer's CTPS C0: continuous alone.

    xi is the distance over `support_radius`, a length in the mesh's units (Wu 1995; de Boer, van
    der Schoot and Bijl 2007).
    """

    @staticmethod
    def value(xi):
        return (1 - xi) ** 5

    @staticmethod
    def slope(xi):
        return -2.5 * (1 - xi) ** 4 / xi


class CompactC1(AbstractCompactBasis):
    """Evaluates de Boer's CTPS C1.

    phi = 1 + 80/3 xi^2 - 40 xi^3 + 15 xi^4 - 8/3 xi^5 + 20 xi^2 log xi.

    xi is the distance over `support_radius`, a length in the mesh's units (Wu 1995; de Boer, van
    der Schoot and Bijl 2007).
    """

    @staticmethod
    def value(xi):
        return 1 + xi**2 * (80 / 3 - 40 * xi + 15 * xi**2 - 8 / 3 * xi**3 + 20 * jnp.log(xi))

    @staticmethod
    def slope(xi):
        return 110 / 3 - 60 * xi + 30 * xi**2 - 20 / 3 * xi**3 + 20 * jnp.log(xi)


class CompactC2a(AbstractCompactBasis):
    """Evaluates de Boer's CTPS C2a.

    phi = 1 - 30 xi^2 - 10 xi^3 + 45 xi^4 - 6 xi^5 - 60 xi^3 log xi.

    xi is the distance over `support_radius`, a length in the mesh's units (Wu 1995; de Boer, van
    der Schoot and Bijl 2007).
    """

    @staticmethod
    def value(xi):
        return 1 - xi**2 * (30 + 10 * xi - 45 * xi**2 + 6 * xi**3 + 60 * xi * jnp.log(xi))

    @staticmethod
    def slope(xi):
        return -30 - 45 * xi + 90 * xi**2 - 15 * xi**3 - 90 * xi * jnp.log(xi)


class CompactC2b(AbstractCompactBasis):
    """Evaluates de Boer's CTPS C2b.

    phi = 1 - 20 xi^2 + 80 xi^3 - 45 xi^4 - 16 xi^5 + 60 xi^4 log xi.

    xi is the distance over `support_radius`, a length in the mesh's units (Wu 1995; de Boer, van
    der Schoot and Bijl 2007).
    """

    @staticmethod
    def value(xi):
        return 1 - xi**2 * (20 - 80 * xi + 45 * xi**2 + 16 * xi**3 - 60 * xi**2 * jnp.log(xi))

    @staticmethod
    def slope(xi):
        return -20 + 120 * xi - 60 * xi**2 - 40 * xi**3 + 120 * xi**2 * jnp.log(xi)
