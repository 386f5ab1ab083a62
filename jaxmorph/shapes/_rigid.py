"""Rotation, translation, scaling.

Each adds an increment that is exactly zero at the neutral parameter: x comes back bit for bit.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._host.package.arguments import checked
from ._arguments import Number, Numbers, axis_for, number, positions, vector


@checked
def rotate(x: Numbers, angle: Number | Numbers, about: Numbers, axis: Numbers | None = None) -> Float[Array, "m d"]:
    """Rotates positions about a point in 2-D, about an axis through a point in 3-D.

    **Arguments:**

    - `x`: positions (m, d).
    - `angle`: radians, counter-clockwise as seen against `axis`, for all positions or one for each
      (m,); 0 is neutral.
    - `about`: a point (d,) that stays.
    - `axis`: direction (3,) of any length; only in 3-D.

    **Returns:** positions (m, d).

    **Raises:** `ValueError` for wrong shapes, an axis in 2-D, none in 3-D, or one without length.
    """
    x = positions(x)
    angle = jnp.asarray(angle, x.dtype)
    angle = angle[:, None] if angle.shape == x.shape[:1] else number("angle", angle, x)
    return x + turn(x - vector("about", about, x)[None, :], angle, axis_for(axis, x))


@checked
def translate(x: Numbers, by: Numbers) -> Float[Array, "m d"]:
    """Translates positions.

    **Arguments:**

    - `x`: positions (m, d).
    - `by`: vector (d,), in the units of `x`; 0 is neutral.

    **Returns:** positions (m, d).

    **Raises:** `ValueError` for wrong shapes.
    """
    x = positions(x)
    return x + vector("by", by, x)[None, :]


@checked
def scale(x: Numbers, factors: Numbers | Number, about: Numbers) -> Float[Array, "m d"]:
    """Scales positions about a point.

    **Arguments:**

    - `x`: positions (m, d).
    - `factors`: one number, or one for each coordinate (d,); 1 is neutral.
    - `about`: a point (d,) that stays.

    **Returns:** positions (m, d).

    **Raises:** `ValueError` for wrong shapes.
    """
    x = positions(x)
    factors = jnp.asarray(factors, x.dtype)
    if factors.ndim == 0:
        factors = jnp.broadcast_to(factors, x.shape[1:])
    return x + (vector("factors", factors, x) - 1)[None, :] * (x - vector("about", about, x)[None, :])


def turn(
    arm: Float[Array, "m d"], angle: Float[Array, ""] | Float[Array, "m 1"], axis: Float[Array, " 3"] | None
) -> Float[Array, "m d"]:
    """Computes what a rotation adds to arms from its centre (Rodrigues' formula).

    There is one angle, or one for each arm (m, 1).
    """
    versine = 2 * jnp.sin(angle / 2) ** 2
    if axis is None:
        return jnp.sin(angle) * jnp.stack([-arm[:, 1], arm[:, 0]], axis=1) - versine * arm
    axis = jnp.broadcast_to(axis, arm.shape)
    across = jnp.cross(axis, arm)
    return jnp.sin(angle) * across + versine * jnp.cross(axis, across)
