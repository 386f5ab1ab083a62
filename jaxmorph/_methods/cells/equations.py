"""Laplace's, the biharmonic and the elastic equation, by linear finite elements on the cells."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base import check_kind, number
from .cells import AbstractCellMethod
from .stiffness import AbstractStiffness, ByDistance, ByVolume, gradients, stiffness


class Laplacian(AbstractCellMethod):
    """Smooths each component of the displacement by Laplace's equation, of linear finite elements.

    Löhner and Yang made the diffusivity depend on the distance from the body (Communications in
    Numerical Methods in Engineering 12, 1996). It needs the mesh's cells. Components do not know of
    each other: a rotation shears the cells.

    **Arguments:**

    - `diffusivity`: of a cell: `ByDistance(exponent)` or `ByVolume(exponent)`. Default
      `ByDistance(2)`, which OpenFOAM calls `quadratic inverseDistance`.

    **Raises:** `prepare` raises a `ValueError` for points without cells, and for cells without
    volume.
    """

    diffusivity: AbstractStiffness = eqx.field(default_factory=lambda: ByDistance(2.0))

    def __check_init__(self):
        check_kind(self.diffusivity, AbstractStiffness, "diffusivity", "jm.ByDistance(2)")

    def entries(self, kind, corners, distance):
        gradient, volume = gradients(kind, corners)
        stiff = volume * stiffness(self.diffusivity, kind, volume, distance)
        return _products(gradient, stiff, self.pairs(kind))


class Biharmonic(AbstractCellMethod):
    """Smooths each component by the biharmonic equation (Helenbrook 2003).

    The equation is in its mixed form, with linear finite elements.

    The displacement's derivative across the surface is zero: first cells keep their height, and
    follow the wall's translation, not its rotation. It needs the mesh's cells.

    **Raises:** `prepare` raises a `ValueError` for points without cells, and for cells without
    volume.
    """

    def entries(self, kind, corners, distance):
        return _products(*gradients(kind, corners), self.pairs(kind))

    def masses(self, ids, places):
        masses = jnp.zeros(len(places), places.dtype)
        for kind, cells in ids.cells.items():
            volumes = jax.vmap(lambda corners, kind=kind: gradients(kind, places[corners])[1].sum())(cells.corners)
            share = jnp.broadcast_to(volumes[:, None], cells.corners.shape) / cells.corners.shape[1]
            masses = masses.at[cells.corners].add(share)
        return jnp.where(masses > 0, masses, 1)


def _products(gradient, volume, pairs):
    """Integrates the products of the gradients of two shape functions, for each pair."""
    i, j = np.array(pairs).T
    return jnp.einsum("q,qpa,qpa->p", volume, gradient[:, i], gradient[:, j], precision="highest")


class LinearElasticity(AbstractCellMethod):
    """Moves the mesh like an elastic solid, of linear finite elements (in 2-D in plane strain).

    A quad is the mean of the two ways to cut it into triangles.

    Small cells are stiff, as Johnson and Tezduyar proposed (Computer Methods in Applied Mechanics
    and Engineering 119, 1994).

    It needs the mesh's cells. Symmetry planes are planes in which nodes slide freely. Translations,
    and small rotations, are reproduced; a large rotation of everything is not, for the equation is
    linear.

    **Arguments:**

    - `stiffening`: a cell's modulus of elasticity: `ByVolume(exponent)` or `ByDistance(exponent)`.
      Default `ByVolume(1)`.
    - `poisson`: Poisson's ratio, between -1 and 0.5. Default 0.3.

    **Raises:** `ValueError` for another ratio. `prepare` raises it for points without cells, and
    for cells without volume.
    """

    stiffening: AbstractStiffness = eqx.field(default_factory=ByVolume)
    poisson: Float[Array, ""] = eqx.field(converter=number("poisson", -1, 0.5), default=0.3)

    def __check_init__(self):
        check_kind(self.stiffening, AbstractStiffness, "stiffening", "jm.ByVolume(1)")

    def entries(self, kind, corners, distance):
        gradient, volume = gradients(kind, corners)
        i, j = np.array(self.pairs(kind)).T
        nu = self.poisson.astype(corners.dtype)
        shear = 1 / (2 * (1 + nu))
        dilation = nu / ((1 + nu) * (1 - 2 * nu))
        stiff = volume * stiffness(self.stiffening, kind, volume, distance)
        outer = jnp.einsum("q,qpa,qpb->pab", stiff, gradient[:, i], gradient[:, j], precision="highest")
        trace = jnp.trace(outer, axis1=1, axis2=2)
        isotropic = trace[:, None, None] * jnp.eye(corners.shape[1], dtype=corners.dtype)[None]
        return dilation * outer + shear * (jnp.swapaxes(outer, 1, 2) + isotropic)
