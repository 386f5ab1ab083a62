"""Sources on rings far from a body, which move as an elastic plate that it pushes and turns."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._host.tolerances import SAME
from ..._kernels.values import Either, norm
from ..base import Pairs, Rows, einsum, matmul

PLATE = 80
"""Radius at which rotation ends, relative to the root mean square radius of the walls."""

STRAIN_WEIGHT = 0.4
"""Weight of a wall's strain against its displacement in the affine motion that rings carry."""


def middles(
    edges: Int[Either, "e 2"], surface: Float[Either, "b d"]
) -> tuple[Float[Either, "e d"], Float[Either, " e"], Float[Either, " d"]]:
    """The middles of edges, their shares of the length of all, and their mean by these shares: one
    more node changes neither mean nor moments of a wall.
    """
    length = norm(surface[edges[:, 1]] - surface[edges[:, 0]])
    weight = length / length.sum()
    middle = surface[edges].mean(axis=1)
    return middle, weight, (weight[:, None] * middle).sum(axis=0)


class Rings(eqx.Module):
    """The map from displacements at the middles of edges to those of the rings.

    A body pushes and turns the rings as it would an elastic plate that is held at the far field.
    They get shares of its mean displacement, and of the affine motion about its centre that fits it
    best. Strain weighs there, so a thin body's change of thickness goes no farther.

    - `moments` (1 + d, e): weights of the mean, and of its moments.
    - `shares` (d, r, d, 1 + d): of the mean and the moments at the rings.
    """

    moments: Float[Array, "k e"]
    shares: Float[Array, "d r d k"]

    @classmethod
    def made(
        cls, edges: Pairs, far: Int[Array, " r"], share: Float[Array, " r"], surface: Rows
    ) -> "Rings":
        """`far` are fixed rows, on the way to which, at a `share`, a ring stands."""
        d = surface.shape[1]
        eye = jnp.eye(d, dtype=surface.dtype)
        middle, weight, centre = middles(edges, surface)
        arm = middle - centre[None]
        moments = jnp.concatenate([weight[None], (weight[:, None] * arm).T])
        if not len(far):
            return cls(moments, jnp.zeros((d, 0, d, 1 + d), surface.dtype))
        # (A M + weight 2 dev sym A)_ab = mean of u_a arm_b, with the moments M of the arms
        unit = einsum("ac,bd->abcd", eye, eye)
        strain = unit + unit.swapaxes(0, 1) - 2 / d * einsum("ab,cd->abcd", eye, eye)
        matrix = matmul(moments[1:], arm)
        # the turn of a straight body about itself is none
        system = einsum("ac,db->abcd", eye, matrix) + jnp.trace(matrix) * (
            STRAIN_WEIGHT * strain + SAME * unit
        )
        affine = jnp.linalg.inv(system.reshape(d * d, d * d)).reshape(d, d, d, d)
        reach = share.astype(surface.dtype)
        way = surface[far] - centre[None]
        # a plate so large that its rotation has an end in a small mesh as in a large one
        body = jnp.sqrt(jnp.trace(matrix))
        held = jnp.minimum(norm(way), PLATE * body)
        turned = turning(jnp.minimum(reach * norm(way) / held, 1)) / turning(body / held)
        turned = (turned * reach)[:, None] * way
        pushed = einsum("r,ac->arc", pushing(reach), eye)[..., None]
        return cls(
            moments, jnp.concatenate([pushed, einsum("rb,abck->arck", turned, affine)], axis=3)
        )

    def moved(self, middles: Float[Array, "e d"]) -> Float[Array, "r d"]:
        return einsum("arck,kc->ra", self.shares, matmul(self.moments, middles))


def pushing(reach: Float[Array, " r"]) -> Float[Array, " r"]:
    """The share of a displacement at a share of the way to the far field, where a plate is held."""
    squared = reach**2
    return 1 - squared + squared * jnp.log(squared)


def turning(reach: Float[Array, " r"]) -> Float[Array, " r"]:
    """The same for a rotation, but for a factor."""
    return -jnp.log(reach) - (1 - reach**2) / 2
