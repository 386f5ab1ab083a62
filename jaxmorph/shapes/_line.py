"""Twisting and bending along a straight line."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.package.arguments import checked
from .._kernels.values import clipped, is_known
from ._arguments import Number, Numbers, axis_for, direction, number, positions, positive, vector
from ._rigid import turn


@checked
def twist(x: Numbers, angle: Number, about: Numbers, axis: Numbers, length: Number) -> Float[Array, "m 3"]:
    """Twists positions about an axis, in proportion to the distance along the axis.

    Positions before `about` stay, positions beyond `length` turn by the whole angle.

    **Arguments:**

    - `x`: positions (m, 3).
    - `angle`: radians at the end of the length; 0 is neutral.
    - `about`: the point (3,) on the axis where the twist begins.
    - `axis`: direction (3,) in which it grows.
    - `length`: distance over which it grows, above 0.

    **Returns:** positions (m, 3).

    **Raises:** `ValueError` for positions in 2-D, for wrong shapes, and for an axis or a length
    that is 0.
    """
    x = positions(x)
    if x.shape[1] == 2:
        raise ValueError("`twist` is for positions in 3-D; `rotate` turns a section in 2-D.")
    arm, along = x - vector("about", about, x)[None, :], direction("axis", axis, x)
    span = positive("length", length, x)
    share = clipped(arm @ along, 0, span) / span
    return x + turn(arm, number("angle", angle, x) * share[:, None], along)


@checked
def bend(
    x: Numbers, angle: Number, about: Numbers, along: Numbers, length: Number, axis: Numbers | None = None
) -> Float[Array, "m d"]:
    """Bends a straight line, with all that is around it, into an arc of equal length.

    Sections stay plane and at right angles to the line. Positions before `about` stay, positions
    beyond `length` follow the tangent.

    **Arguments:**

    - `x`: positions (m, d).
    - `angle`: radians by which the tangent turns at the end, in the sense of `rotate`; 0 is
      neutral.
    - `about`: the point (d,) where the line begins.
    - `along`: direction (d,) of the line.
    - `length`: length of the arc, above 0.
    - `axis`: direction (3,) about which the line turns, at right angles to it; only in 3-D.

    **Returns:** positions (m, d).

    **Raises:** `ValueError` for wrong shapes, directions or a length that are 0, and an axis not at
    right angles to the line.
    """
    x = positions(x)
    arm, along = x - vector("about", about, x)[None, :], direction("along", along, x)
    span, normal = positive("length", length, x), axis_for(axis, x)
    if normal is not None and is_known(normal, along) and abs(np.vdot(normal, along)) > 1e-3:
        raise ValueError(f"`axis` and `along` must be at right angles; their cosine is {float(normal @ along):.3g}.")
    up = jnp.stack([-along[1], along[0]]) if normal is None else jnp.cross(normal, along)
    curvature = number("angle", angle, x) / span
    reach, height = arm @ along, arm @ up
    s = clipped(reach, 0, span)
    turned, beyond = curvature * s, reach - s
    versine = 2 * jnp.sin(turned / 2) ** 2
    # the arc's chord: s sin(a) / a forward, s (1 - cos a) / a upward, exact at a = 0
    forward = s * (jnp.sinc(turned / jnp.pi) - 1) - height * jnp.sin(turned) - beyond * versine
    upward = s * jnp.sin(turned / 2) * jnp.sinc(turned / 2 / jnp.pi) - height * versine + beyond * jnp.sin(turned)
    return x + forward[:, None] * along[None, :] + upward[:, None] * up[None, :]
