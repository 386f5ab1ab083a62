"""Stiffness of cells: a power of their volume, or of their distance from the moving surface."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._host.cells.elements import quadrature
from ..._kernels.module import Module
from ..._kernels.values import largest
from ..numbers import number


class AbstractStiffness(Module):
    """Gives each cell a stiffness, or a diffusivity."""

    @abc.abstractmethod
    def __call__(self, volume: Float[Array, ""], distance: Float[Array, ""]) -> Float[Array, ""]:
        """Computes the stiffness of one cell. Traced.

        `volume` is the cell's (area in 2-D), `distance` its corners' mean distance from the moving
        nodes.
        """


class ByVolume(AbstractStiffness):
    """Makes a cell as stiff as 1 / volume^exponent: small cells keep their shape.

    OpenFOAM calls it `inverseVolume`.

    **Arguments:**

    - `exponent`: default 1. With 0 all cells are equally stiff.
    """

    exponent: Float[Array, ""] = eqx.field(converter=number("exponent"), default_factory=lambda: np.asarray(1.0))

    def __call__(self, volume, distance):
        return volume ** -self.exponent.astype(volume.dtype)


class ByDistance(AbstractStiffness):
    """Makes a cell as stiff as 1 / distance^exponent.

    The distance is that of its corners from the nearest moving node, in the mean.

    A quad has a stiffness at each corner, with the mean distance of the corner and its two
    neighbours.

    OpenFOAM calls it `inverseDistance`, with the exponent 2 `quadratic inverseDistance`.

    **Arguments:**

    - `exponent`: default 1.
    """

    exponent: Float[Array, ""] = eqx.field(converter=number("exponent"), default_factory=lambda: np.asarray(1.0))

    def __call__(self, volume, distance):
        return distance ** -self.exponent.astype(distance.dtype)


SLIVER = 1e-6
"""Share of a cell's largest Jacobian below which a point of its quadrature fades out."""


def gradients(kind: str, corners: Float[Array, "c d"]) -> tuple[Float[Array, "q c d"], Float[Array, " q"]]:
    """Computes the shape functions' gradients and the volumes at the quadrature points. Traced.

    A point whose Jacobian is small beside the cell's largest Jacobian fades out. It belongs to a
    triangle at a straight corner, or between two corners at one place.
    """
    reference, weights = (jnp.asarray(table, corners.dtype) for table in quadrature(kind))
    jacobian = jnp.einsum("qca,cb->qab", reference, corners, precision="highest")  # d place / d reference, transposed
    inverse, determinant, safe = _inverse(jacobian)
    volume = jnp.abs(determinant)
    top = largest(volume)
    share = jnp.where(top > 0, jnp.minimum(volume / (SLIVER * jnp.where(top > 0, top, 1)), 1) ** 2, 1)
    gradient = jnp.einsum("qba,qca->qcb", inverse * share[:, None, None], reference, precision="highest")
    return gradient, weights * jnp.where(top > 0, volume, jnp.abs(safe))


def stiffness(
    of_cell: AbstractStiffness, kind: str, volume: Float[Array, " q"], distance: Float[Array, " c"]
) -> Float[Array, " q"]:
    """Computes the stiffness at the points of a cell's quadrature. Traced.

    `distance` is that of the corners from the moving nodes.

    A point takes the mean of the corners whose shape functions vary there. Where all corners move,
    nothing depends on the stiffness.
    """
    share = np.any(quadrature(kind)[0] != 0, axis=2).astype(float)
    share = jnp.asarray(share / share.sum(axis=1, keepdims=True), distance.dtype)
    mean = jnp.matmul(share, distance, precision="highest")
    return jax.vmap(lambda mean: of_cell(volume.sum(), mean))(jnp.where(mean > 0, mean, 1))


def _inverse(matrix: Float[Array, "q d d"]) -> tuple[Float[Array, "q d d"], Float[Array, " q"], Float[Array, " q"]]:
    """Inverts matrices in closed form; returns determinants, and divisors that are not zero."""
    rows = [matrix[:, k] for k in range(matrix.shape[1])]
    if len(rows) == 2:
        (a, b), (c, d) = (row.T for row in rows)
        determinant = a * d - b * c
        adjugate = jnp.stack([jnp.stack([d, -b], axis=1), jnp.stack([-c, a], axis=1)], axis=1)
    else:
        first, second, third = rows
        columns = [jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)]
        determinant = jnp.sum(first * columns[0], axis=1)
        adjugate = jnp.stack(columns, axis=2)
    size = jnp.sum(matrix**2, axis=(1, 2)) ** (len(rows) / 2)
    least = float(jnp.finfo(matrix.dtype).eps) * jnp.where(size > 0, size, 1)
    safe = jnp.where(jnp.abs(determinant) > least, determinant, least)
    return adjugate / safe[:, None, None], determinant, safe
