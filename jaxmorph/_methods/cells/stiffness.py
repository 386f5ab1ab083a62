"""Linear finite elements, and the stiffness of cells by their volume or distance from the wall."""

import abc
import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._host.linear.products import cofactors, dot
from ..._kernels.module import Module
from ..._kernels.values import largest
from ..base import number


class AbstractStiffness(Module):
    """Gives each cell a stiffness, or a diffusivity."""

    @abc.abstractmethod
    def __call__(self, volume: Float[Array, ""], distance: Float[Array, ""]) -> Float[Array, ""]:
        """Computes a cell's stiffness by its volume and its corners' mean distance. Traced.

        Volumes are areas in 2-D, distances those from the nearest moving node.
        """


class ByVolume(AbstractStiffness):
    """Makes a cell as stiff as 1 / volume^exponent: small cells keep their shape.

    OpenFOAM calls it `inverseVolume`.

    **Arguments:**

    - `exponent`: default 1. With 0 all cells are equally stiff.
    """

    exponent: Float[Array, ""] = eqx.field(converter=number("exponent"), default=1.0)

    def __call__(self, volume, distance):
        return volume ** -self.exponent.astype(volume.dtype)


class ByDistance(AbstractStiffness):
    """Makes a cell as stiff as 1 / distance^exponent, by its corners' mean distance.

    The distance is that from the nearest moving node. A quad has a stiffness at each corner, with
    the mean of the corner and its two neighbours. OpenFOAM calls it `inverseDistance`, with the
    exponent 2 `quadratic inverseDistance`.

    **Arguments:**

    - `exponent`: default 1.
    """

    exponent: Float[Array, ""] = eqx.field(converter=number("exponent"), default=1.0)

    def __call__(self, volume, distance):
        return distance ** -self.exponent.astype(distance.dtype)


SLIVER = 1e-6
"""Share of a cell's largest Jacobian below which a point of its quadrature fades out."""


def gradients(kind: str, corners: Float[Array, "c d"]) -> tuple[Float[Array, "q c d"], Float[Array, " q"]]:
    """Computes the shape functions' gradients and the volumes at the quadrature points. Traced."""
    # a point whose Jacobian is small beside the cell's largest fades out: it belongs to a triangle
    # at a straight corner, or between two corners at one place
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

    A point takes the mean distance of the corners whose shape functions vary there. Where all
    corners move, nothing depends on the stiffness.
    """
    share = np.any(quadrature(kind)[0] != 0, axis=2).astype(float)
    share = jnp.asarray(share / share.sum(axis=1, keepdims=True), distance.dtype)
    mean = jnp.matmul(share, distance, precision="highest")
    return jax.vmap(lambda mean: of_cell(volume.sum(), mean))(jnp.where(mean > 0, mean, 1))


def _inverse(matrix: Float[Array, "q d d"]) -> tuple[Float[Array, "q d d"], Float[Array, " q"], Float[Array, " q"]]:
    """Inverts matrices in closed form; returns determinants, and divisors that are not zero."""
    columns = list(jnp.moveaxis(matrix, 0, 2).swapaxes(0, 1))
    rows = cofactors(columns)
    determinant = dot(rows[0], columns[0])
    size = jnp.sum(matrix**2, axis=(1, 2)) ** (len(rows) / 2)
    least = float(jnp.finfo(matrix.dtype).eps) * jnp.where(size > 0, size, 1)
    safe = jnp.where(jnp.abs(determinant) > least, determinant, least)
    return jnp.moveaxis(jnp.stack([jnp.stack(row) for row in rows]), 2, 0) / safe[:, None, None], determinant, safe


_CUBE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
_COLLAPSED = {
    "quad": (0, 1, 2, 3),
    "hexahedron": (0, 1, 2, 3, 4, 5, 6, 7),
    "wedge": (0, 1, 2, 2, 3, 4, 5, 5),
    "pyramid": (0, 1, 2, 3, 4, 4, 4, 4),
}
"""Corner of the cell at each corner of a square or cube: pairs make a wedge, four a pyramid."""


@functools.cache
def quadrature(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Computes reference derivatives (q, corners, d) of the shape functions, and weights (q,).

    A simplex has one point. A quad has its four corners, with the linear triangles of the corners
    and their neighbours: the mean of both ways to cut it. Other types have two Gauss points in
    every direction.
    """
    if kind in ("triangle", "tetra"):
        d = 2 if kind == "triangle" else 3
        return np.concatenate([-np.ones((1, d)), np.eye(d)])[None], np.array([1 / (2 if d == 2 else 6)])
    target = np.array(_COLLAPSED[kind])
    d = 2 if kind == "quad" else 3
    corners = _CUBE[: len(target), :d]
    gauss = 0.5 - 12**-0.5, 0.5 + 12**-0.5
    places = corners.astype(float) if kind == "quad" else np.array(list(itertools.product(gauss, repeat=d)))
    factors = np.where(corners[None] == 1, places[:, None], 1 - places[:, None])  # (q, corners, d)
    signs = np.where(corners == 1, 1.0, -1.0)
    derivatives = np.stack([signs[:, i] * np.delete(factors, i, axis=2).prod(axis=2) for i in range(d)], axis=2)
    summed = np.einsum("qcd,ca->qad", derivatives, np.eye(target.max() + 1)[target])
    return summed, np.full(len(places), 1 / len(places))
