"""Free-form deformation in a box of any shape: eight corners in 3-D, four in 2-D."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmorph.extend import checked, is_known

from ._arguments import Numbers, check_finite, positions_in
from ._freeform import FreeForm
from ._shape import AbstractLinearShape, Move

STEPS = 30  # steps of Newton's method; a box that is no parallelepiped takes about six
OUTSIDE = 2.0  # coordinate of a position far from the box, whose place is not found

SQUARE = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
ORDER = {2: SQUARE, 3: np.array([(*corner, k) for k in (0, 1) for corner in SQUARE])}
"""Place of each corner in the lattice, in VTK's order: one face, then the opposite face."""


class Hexahedron(AbstractLinearShape):
    """A box of control points between corners that may stand anywhere: a bent `FreeForm`.

    In 2-D it is a quadrilateral. Coordinates in the box are those of a multilinear map of the unit
    cube. Positions inside move by the controls' displacements (*counts, d), the parameters,
    weighted with B-splines of these coordinates; positions outside stay. The `corners` are (8, 3)
    in the order of a cell of the mesh (VTK's and SU2's), the first four around one face; (4, 2) in
    2-D. All else is as for `FreeForm`.

    **Raises:** `ValueError` for another number of corners, a box without volume or turned inside
    out, and as `FreeForm` does.
    """

    corners: Float[Array, "..."]
    box: FreeForm

    @checked
    def __init__(
        self,
        corners: Numbers,
        counts: Sequence[int],
        *,
        degree: int | Sequence[int | None] | None = None,
        continuity: int | None = None,
    ):
        listed = jnp.asarray(corners, float)
        check_finite(corners=listed)
        if listed.shape not in ((4, 2), (8, 3)):
            raise ValueError(f"`corners` has shape {listed.shape}; expected (8, 3), or (4, 2) in 2-D.")
        d = listed.shape[1]
        self.corners = jnp.zeros((*(2,) * d, d), listed.dtype).at[tuple(ORDER[d].T)].set(listed)
        self.box = FreeForm(np.zeros(d), np.eye(d), counts, degree=degree, continuity=continuity)
        if is_known(self.corners):
            slopes = jax.vmap(lambda t: _slopes(t, self.corners))(jnp.asarray(ORDER[d], float))
            sizes, scale = np.asarray(jnp.linalg.det(slopes)), np.linalg.norm(np.ptp(np.asarray(listed), axis=0)) ** d
            if not ((sizes > 1e-12 * scale).all() or (sizes < -1e-12 * scale).all()):
                raise ValueError(
                    "the box is flat or turned inside out: list the corners around one face, then around the opposite face."
                )

    @property
    def counts(self) -> tuple[int, ...]:
        """Numbers of control points along each direction."""
        return self.box.counts

    @property
    def continuity(self) -> int | None:
        """As for `FreeForm`."""
        return self.box.continuity

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Mask (*counts,) of the control points that `continuity` leaves free."""
        return self.box.free

    @property
    def given_corners(self) -> Float[np.ndarray, "c d"]:
        return np.asarray(self.corners)[tuple(ORDER[len(self.counts)].T)]

    def neutral(self) -> Float[Array, "..."]:
        return self.box.neutral()

    def at(self, x: Numbers) -> Move:
        return self.box.at(self.coordinates(x))

    @checked
    def coordinates(self, x: Numbers) -> Float[Array, "m d"]:
        """Computes coordinates in the box, from 0 to 1 inside, 2 far outside. Traced."""
        x = positions_in(x, self.counts)
        return _places(x, self.corners.astype(x.dtype))

    def lattice(self, control: Numbers | None = None) -> Float[Array, "..."]:
        """Computes the positions (*counts, d) of the control points, displaced by `control`."""
        t = self.box.lattice()
        points = jax.vmap(lambda place: _at(place, self.corners))(t.reshape(-1, t.shape[-1])).reshape(t.shape)
        return points if control is None else points + jnp.asarray(control)


def _at(t: Float[Array, " d"], corners: Float[Array, "..."]) -> Float[Array, " d"]:
    for share in t:
        corners = (1 - share) * corners[0] + share * corners[1]
    return corners


_slopes = jax.jacfwd(_at)


@jax.custom_jvp
@jax.jit
def _places(x: Float[Array, "m d"], corners: Float[Array, "..."]) -> Float[Array, "m d"]:
    tolerance = 1e3 * jnp.finfo(x.dtype).eps * jnp.max(jnp.abs(corners))

    def one(position: Float[Array, " d"]) -> Float[Array, " d"]:
        def step(_, t):
            change = jnp.linalg.solve(_slopes(t, corners), position - _at(t, corners))
            return jnp.clip(t + jnp.clip(change, -1, 1), -1, 2)

        t = jax.lax.fori_loop(0, STEPS, step, jnp.full_like(position, 0.5))
        return jnp.where(jnp.max(jnp.abs(_at(t, corners) - position)) <= tolerance, t, OUTSIDE)

    return jax.vmap(one)(x)


@_places.defjvp
def _places_jvp(primals, tangents):
    # the place is defined by at(t, corners) = x; the rule contains the place itself, so that
    # derivatives of all orders follow
    (x, corners), (x_dot, corners_dot) = primals, tangents
    t = _places(x, corners)

    def one(t, x_dot):
        is_inside = jnp.all(t < OUTSIDE)
        slopes = jnp.where(is_inside, _slopes(jnp.where(is_inside, t, 0.5), corners), jnp.eye(len(t), dtype=t.dtype))
        return jnp.where(is_inside, jnp.linalg.solve(slopes, x_dot - _at(t, corners_dot)), 0)

    return t, jax.vmap(one)(t, x_dot)
