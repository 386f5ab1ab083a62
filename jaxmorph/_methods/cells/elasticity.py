"""Linear elasticity: the mesh as a solid whose small cells are stiff.

Tezduyar et al. 1992; Stein, Tezduyar and Benney 2003.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base import check_kind
from ..numbers import number
from .cells import AbstractCellMethod, all_pairs
from .stiffness import AbstractStiffness, ByVolume, gradients, stiffness


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
    poisson: Float[Array, ""] = eqx.field(converter=number("poisson", -1, 0.5), default_factory=lambda: np.asarray(0.3))

    def __check_init__(self):
        check_kind(self.stiffening, AbstractStiffness, "stiffening", "jm.ByVolume(1)")

    def pairs(self, kind):
        return all_pairs(kind)

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
