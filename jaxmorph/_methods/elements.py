"""What a cell gives to the system of its method: finite elements, and springs."""

import abc
import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.cells.lagrange import derivatives_at_nodes, jacobian_samples
from .._host.cells.topology import EDGES, FRAMES
from .._host.linear.products import cofactors, determinant, dot
from .._kernels.module import Module
from .._kernels.values import largest
from .base import Scalar, check_kind, einsum, matmul, number, or_one
from .cells import AbstractCellMethod, all_pairs

Samples = Float[Array, " q"]  # values at quadrature points


class AbstractStiffness(Module):
    """Gives each cell a stiffness, or a diffusivity."""

    @abc.abstractmethod
    def __call__(self, volume: Scalar, distance: Scalar) -> Scalar:
        """Computes a cell's stiffness by its volume (in 2-D its area), and its corners' mean
        distance from the nearest moving node. Traced.
        """


class ByVolume(AbstractStiffness):
    """Makes a cell as stiff as 1 / volume^exponent: small cells keep their shape.

    OpenFOAM calls it `inverseVolume`. The default of `exponent` is 1; with 0 all cells are equally
    stiff.
    """

    exponent: Scalar = eqx.field(converter=number("exponent"), default=1.0)

    def __call__(self, volume, distance):
        return volume ** -self.exponent.astype(volume.dtype)


class ByDistance(AbstractStiffness):
    """Makes a cell as stiff as 1 / distance^exponent, by its corners' mean distance.

    The distance is that from the nearest moving node. A quad has a stiffness at each corner, with
    the mean of the corner and its two neighbours. The default of `exponent` is 1. OpenFOAM calls it
    `inverseDistance`, with the exponent 2 `quadratic inverseDistance`.
    """

    exponent: Scalar = eqx.field(converter=number("exponent"), default=1.0)

    def __call__(self, volume, distance):
        return distance ** -self.exponent.astype(distance.dtype)


SMALLEST_SHARE = 1e-6  # share of a cell's largest Jacobian below which a quadrature point fades out


def gradients(kind: str, corners: Float[Array, "c d"]) -> tuple[Float[Array, "q c d"], Samples]:
    """Returns the shape functions' gradients and the volumes at the quadrature points. Traced."""
    # A point whose Jacobian is small beside the cell's largest fades out: it belongs to a triangle
    # at a straight corner, or between two corners at one place.
    reference, weights = (jnp.asarray(table, corners.dtype) for table in quadrature(kind))
    jacobian = einsum("qca,cb->qab", reference, corners)  # d place / d reference, transposed
    inverse, determinant, safe = _inverse(jacobian)
    volume = jnp.abs(determinant)
    top = largest(volume)
    share = jnp.where(top > 0, jnp.minimum(volume / (SMALLEST_SHARE * or_one(top)), 1) ** 2, 1)
    gradient = einsum("qba,qca->qcb", inverse * share[:, None, None], reference)
    return gradient, weights * jnp.where(top > 0, volume, jnp.abs(safe))


def stiffness(
    of_cell: AbstractStiffness, kind: str, volume: Samples, distance: Float[Array, " c"]
) -> Samples:
    """Computes the stiffness at the quadrature points. A point takes the mean distance of the
    corners whose shape functions vary there. Where all corners move, nothing depends on the
    stiffness.
    """
    share = np.any(quadrature(kind)[0] != 0, axis=2).astype(float)
    share = jnp.asarray(share / share.sum(axis=1, keepdims=True), distance.dtype)
    mean = matmul(share, distance)
    return jax.vmap(lambda mean: of_cell(volume.sum(), mean))(or_one(mean))


def _inverse(matrix: Float[Array, "q d d"]) -> tuple[Float[Array, "q d d"], Samples, Samples]:
    """Inverts matrices in closed form; returns determinants, and divisors that are not zero."""
    columns = list(jnp.moveaxis(matrix, 0, 2).swapaxes(0, 1))
    rows = cofactors(columns)
    determinant = dot(rows[0], columns[0])
    size = jnp.sum(matrix**2, axis=(1, 2)) ** (len(rows) / 2)
    least = float(jnp.finfo(matrix.dtype).eps) * or_one(size)
    safe = jnp.where(jnp.abs(determinant) > least, determinant, least)
    return (
        jnp.moveaxis(jnp.stack([jnp.stack(row) for row in rows]), 2, 0) / safe[:, None, None],
        determinant,
        safe,
    )


@functools.cache
def quadrature(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns reference derivatives (q, corners, d) of the shape functions, and weights (q,). A
    simplex has one point; a quad its four corners, with the linear triangles of the corners and
    their neighbours: the mean of both diagonals. Other types have two Gauss points in every
    direction.
    """
    if kind in ("triangle", "tetra"):
        return derivatives_at_nodes(kind)[:1].round(12), np.array(
            [1 / (2 if kind == "triangle" else 6)]
        )
    if kind == "quad":
        return derivatives_at_nodes(kind).round(12), np.full(4, 1 / 4)
    slopes, weights = jacobian_samples(kind)
    return slopes[weights > 0], weights[weights > 0]


class Laplacian(AbstractCellMethod):
    """Smooths each component of the displacement by Laplace's equation, of linear finite elements.

    Löhner and Yang made the diffusivity depend on the distance from the body (Communications in
    Numerical Methods in Engineering 12, 1996). Components are independent: a rotation shears the
    cells. `prepare` needs cells, and refuses those without volume. The `diffusivity` of a cell is
    `ByDistance(exponent)` or `ByVolume(exponent)`, by default `ByDistance(2)`, which OpenFOAM calls
    `quadratic inverseDistance`.
    """

    diffusivity: AbstractStiffness = eqx.field(default_factory=lambda: ByDistance(2.0))

    def __check_init__(self):
        check_kind(self.diffusivity, AbstractStiffness, "diffusivity", "jm.ByDistance(2)")

    def entries(self, kind, corners, distance):
        gradient, volume = gradients(kind, corners)
        stiff = volume * stiffness(self.diffusivity, kind, volume, distance)
        return _products(gradient, stiff, self.ends(kind))


class Biharmonic(AbstractCellMethod):
    """Smooths each component by the biharmonic equation, in its mixed form (Helenbrook 2003).

    The displacement's derivative across the surface is zero: first cells keep their height, and
    follow the wall's translation, not its rotation. Finite elements are linear. `prepare` needs
    cells, and refuses those without volume.
    """

    def entries(self, kind, corners, distance):
        return _products(*gradients(kind, corners), self.ends(kind))

    def masses(self, ids, places):
        masses = jnp.zeros(len(places), places.dtype)
        for kind, cells in ids.cells.items():
            volumes = jax.vmap(
                lambda corners, kind=kind: gradients(kind, places[corners])[1].sum()
            )(cells.corners)
            share = jnp.broadcast_to(volumes[:, None], cells.corners.shape) / cells.corners.shape[1]
            masses = masses.at[cells.corners].add(share)
        return or_one(masses)


def _products(gradient, volume, ends):
    i, j = ends
    return einsum("q,qpa,qpa->p", volume, gradient[:, i], gradient[:, j])


class LinearElasticity(AbstractCellMethod):
    """Moves the mesh like an elastic solid, of linear finite elements (in 2-D in plane strain).

    A quad is the mean of both cuts into triangles. Small cells are stiff, as Johnson and Tezduyar
    proposed (Computer Methods in Applied Mechanics and Engineering 119, 1994). Translations and
    small rotations are reproduced; a large rotation is not, for the equation is linear. `prepare`
    needs cells, and refuses those without volume.

    **Arguments:**

    - `stiffening`: a cell's modulus of elasticity: `ByVolume(exponent)` or `ByDistance(exponent)`.
      Default `ByVolume(1)`.
    - `poisson`: Poisson's ratio, between -1 and 0.5. Default 0.3.

    **Raises:** `ValueError` for another ratio.
    """

    stiffening: AbstractStiffness = eqx.field(default_factory=ByVolume)
    poisson: Scalar = eqx.field(converter=number("poisson", -1, 0.5), default=0.3)

    def __check_init__(self):
        check_kind(self.stiffening, AbstractStiffness, "stiffening", "jm.ByVolume(1)")

    def entries(self, kind, corners, distance):
        gradient, volume = gradients(kind, corners)
        i, j = self.ends(kind)
        nu = self.poisson.astype(corners.dtype)
        shear = 1 / (2 * (1 + nu))
        dilation = nu / ((1 + nu) * (1 - 2 * nu))
        stiff = volume * stiffness(self.stiffening, kind, volume, distance)
        outer = einsum("q,qpa,qpb->pab", stiff, gradient[:, i], gradient[:, j])
        trace = jnp.trace(outer, axis1=1, axis2=2)
        isotropic = trace[:, None, None] * jnp.eye(corners.shape[1], dtype=corners.dtype)[None]
        return dilation * outer + shear * (jnp.swapaxes(outer, 1, 2) + isotropic)


class SpringAnalogy(AbstractCellMethod):
    """Holds each edge by a spring that acts in all directions (Batina 1990).

    A spring is as stiff as 1 / length^`exponent`, by default 2. `prepare` needs cells, for their
    edges.
    """

    exponent: Scalar = eqx.field(converter=number("exponent"), default=2.0)

    def pairs(self, kind):
        return EDGES[kind] if kind != "triangle" else all_pairs(kind)

    def entries(self, kind, corners, distance):
        i, j = self.ends(kind)
        squared = jnp.sum((corners[j] - corners[i]) ** 2, axis=1)
        has_length = squared > 0
        stiff = jnp.where(has_length, squared, 1) ** (-self.exponent.astype(corners.dtype) / 2)
        return -jnp.where(has_length, stiff, jnp.inf)


class TorsionalSprings(AbstractCellMethod):
    """Holds each edge by a spring, and each angle by a spring that grows stiff as it closes.

    `prepare` needs cells. In 2-D it is the method of Farhat et al. (1998): springs against changes
    of the angles of each triangle. A quad has the triangles at its four corners. In 3-D it is the
    semi-torsional method (Zeng and Ethier 2005). An edge of a tetrahedron is as stiff as 1 / sin^2
    of the angle between the two faces that meet it in one node. Other cells have the tetrahedra at
    their corners. `lineal`, by default 0.1, is the stiffness of the springs along edges, times 1 /
    length^2, so that scaling the mesh changes nothing. Farhat et al. have 1 / length.
    """

    lineal: Scalar = eqx.field(converter=number("lineal", 0, ends="[)"), default=0.1)

    def entries(self, kind, corners, distance):
        simplices = np.array(FRAMES[kind])
        element = _triangle if corners.shape[1] == 2 else _tetrahedron
        blocks = jax.vmap(lambda corners: element(corners, self.lineal.astype(corners.dtype)))(
            corners[simplices]
        )
        total = jnp.zeros((len(corners), len(corners), *blocks.shape[3:]), corners.dtype)
        i, j = self.ends(kind)
        return total.at[simplices[:, :, None], simplices[:, None]].add(blocks)[i, j]


def _triangle(corners: Float[Array, "3 2"], lineal: Scalar) -> Float[Array, "3 3 2 2"]:
    def angles(corners):
        (ax, ay), (bx, by) = ((jnp.roll(corners, -k, axis=0) - corners).T for k in (1, 2))
        return jnp.arctan2(ax * by - ay * bx, ax * bx + ay * by)

    edges = corners[None] - corners[:, None]
    squared = jnp.sum(edges**2, axis=2) + jnp.eye(3, dtype=corners.dtype)
    area = determinant([*edges[0, 1:]])
    stiff = jnp.stack(
        [
            squared[0, 1] * squared[0, 2],
            squared[1, 2] * squared[1, 0],
            squared[2, 0] * squared[2, 1],
        ]
    )
    rates = jax.jacfwd(angles)(corners)
    turning = einsum("k,kia,kjb->ijab", stiff / area**2, rates, rates)  # 1 / sin^2
    return turning - lineal * edges[..., None] * edges[..., None, :] / squared[..., None, None] ** 2


_ENDS = np.array(
    [(i, j, *sorted({0, 1, 2, 3} - {i, j})) for i, j in itertools.permutations(range(4), 2)]
).T
"""The two corners of each edge of a tetrahedron, then the two other corners."""


def _tetrahedron(corners: Float[Array, "4 3"], lineal: Scalar) -> Float[Array, "4 4"]:
    """Stiffnesses of edges: lineal, and by the angle between the faces opposite to the ends."""
    i, j, k, m = (corners[ends] for ends in _ENDS)
    # both faces have the edge k m
    normal_i = jnp.cross(m - k, i - k)
    normal_j = jnp.cross(m - k, j - k)
    both = jnp.sum(normal_i**2, axis=1) * jnp.sum(normal_j**2, axis=1)
    sine = jnp.sum(jnp.cross(normal_i, normal_j) ** 2, axis=1)
    stiff = (lineal + both / sine) / jnp.sum((j - i) ** 2, axis=1)
    return jnp.zeros((4, 4), corners.dtype).at[_ENDS[0], _ENDS[1]].set(-stiff)
