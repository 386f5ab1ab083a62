"""The NACA 4-digit family as a shape."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._host.package.arguments import between, checked
from .._kernels.values import slack
from ._arguments import Numbers, positions
from ._section import Chord
from ._shape import AbstractShape

LAST = (0.1015, 0.1036)
"""Last coefficient of the thickness: for a blunt trailing edge, and for a sharp edge."""

REACH = 2.0
"""Chords before and behind the crest of the mean line within which feet are searched."""

HALVINGS = 56
"""Halvings of an interval, down to round-off."""


class NACA4(AbstractShape):
    """Turns a NACA 4-digit airfoil into another: exact for its own nodes, smooth nearby.

    The parameters are (camber, place, thickness) in chords: (0.04, 0.4, 0.12) is the NACA 4412. A
    node keeps its place on the mean line; its height above the mean line scales with the thickness.

    **Arguments:**

    - `camber`, `place`, `thickness`: of the airfoil that is given.
    - `chord`: where it lies; from (0, 0) to (1, 0) by default.

    **Raises:** `ValueError` for a thickness that is not above 0, and a place outside of 0 to 1.
    """

    original: Float[Array, " 3"]
    chord: Chord

    @checked
    def __init__(self, camber: float, place: float, thickness: float, *, chord: Chord | None = None):
        between("camber", camber)
        between("place", place, 0, 1)
        between("thickness", thickness, 0)
        self.original = jnp.asarray([camber, place, thickness], float)
        self.chord = Chord() if chord is None else chord

    def neutral(self) -> Float[Array, " 3"]:
        """Makes the parameters of the given airfoil."""
        return self.original

    def __call__(self, x: Numbers, parameters: Numbers) -> Float[Array, "m d"]:
        """Moves positions (m, d) from the given airfoil to the airfoil of the parameters (3,)."""
        x = positions(x)
        parameters, original = jnp.asarray(parameters, x.dtype), self.original.astype(x.dtype)
        if parameters.shape != (3,):
            raise ValueError(f"parameters have shape {parameters.shape}; expected camber, place, thickness.")
        t, height = self.chord.coordinates(x)
        height = height / self.chord.length.astype(x.dtype)
        s = _station(t, height, original)
        t0, y0 = _from_mean_line(s, _offset(s, t, height, original), original)
        t1, y1 = _from_mean_line(s, _offset(s, t, height, original) * (parameters[2] / original[2]), parameters)
        chord, up = (self.chord.tail - self.chord.nose).astype(x.dtype), self.chord.up.astype(x.dtype)
        across = up * self.chord.length.astype(x.dtype)
        return x + (t1 - t0)[:, None] * chord[None, :] + (y1 - y0)[:, None] * across[None, :]


def _mean_line(
    s: Float[Array, "*shape"], airfoil: Float[Array, " 3"]
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Computes ordinate and slope of the mean line at each place."""
    camber, place = airfoil[0], airfoil[1]
    width = jnp.where(s < place, place, 1 - place)
    ordinate = camber / width**2 * (jnp.where(s < place, 0, 1 - 2 * place) + 2 * place * s - s**2)
    return ordinate, 2 * camber / width**2 * (place - s)


def _away(s, t, height, airfoil: Float[Array, " 3"]) -> Float[Array, "..."]:
    """Computes how far positions are beyond the mean line's normal at s: 0 at their foot."""
    ordinate, slope = _mean_line(s, airfoil)
    return s - t + (ordinate - height) * slope


def _rate(s, t, height, airfoil: Float[Array, " 3"]) -> Float[Array, "..."]:
    """Computes the derivative of `_away` by s."""
    return jax.jvp(lambda s: _away(s, t, height, airfoil), (s,), (jnp.ones_like(s),))[1]


@jax.custom_jvp
@jax.jit
def _station(t: Float[Array, " m"], height: Float[Array, " m"], airfoil: Float[Array, " 3"]) -> Float[Array, " m"]:
    """Finds the foot of each position on the mean line.

    Of several feet it is the one at which the airfoil is as thick as the position is far.
    """
    t, height = t[None], height[None]
    near, far = _intervals(height, airfoil)
    sign = jnp.sign(_away(near, t, height, airfoil))

    def halved(_, ends):
        middle = ends.mean(axis=0)
        same = jnp.sign(_away(middle, t, height, airfoil)) == sign
        return jnp.stack([jnp.where(same, middle, ends[0]), jnp.where(same, ends[1], middle)])

    s = jax.lax.fori_loop(0, HALVINGS, halved, jnp.stack([near, far])).mean(axis=0)
    for _ in range(2):
        rate = _rate(s, t, height, airfoil)
        s = s - _away(s, t, height, airfoil) / jnp.where(jnp.abs(rate) > 0.1, rate, jnp.inf)
    part = jnp.clip(s, 0, 1)
    half = [_half_thickness(part, airfoil[2], last) for last in LAST]
    offset = jnp.abs(_offset(s, t, height, airfoil))
    miss = jnp.minimum(*(jnp.abs(offset - thickness) for thickness in half)) + jnp.abs(_away(s, t, height, airfoil))
    first = jnp.argmax(miss <= miss.min(axis=0, keepdims=True) + slack(s.dtype), axis=0)
    return jnp.take_along_axis(s, first[None], axis=0)[0]


@_station.defjvp
def _station_jvp(primals, tangents):
    # the foot is defined by away(s, ...) = 0; the rule contains the foot itself, so that
    # derivatives of all orders follow
    s = _station(*primals)
    rate = _rate(s, *primals)
    moved = jax.jvp(lambda *values: _away(s, *values), primals, tangents)[1]
    return s, -moved / jnp.where(jnp.abs(rate) > slack(s.dtype), rate, 1)


def _intervals(
    height: Float[Array, "1 m"], airfoil: Float[Array, " 3"]
) -> tuple[Float[Array, "4 m"], Float[Array, "4 m"]]:
    """Computes the ends of intervals in which a position has at most one foot.

    Let v = s - place, and b = -camber / width^2 on each of the two parabolas. There a foot is a
    root of 2 b^2 v^3 + (1 + 2 b (camber - height)) v + place - t. The cubic is monotone up to its
    extremum, and beyond it.
    """
    camber, place = airfoil[0], airfoil[1]
    near, far = [], []
    for width, sign in ((place, -1), (1 - place, 1)):
        bend = -camber / width**2
        square = -(1 + 2 * bend * (camber - height)) / jnp.where(bend == 0, 1, 6 * bend**2)
        extremum = jnp.minimum(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0), REACH)
        near += [jnp.broadcast_to(place, height.shape), place + sign * extremum]
        far += [place + sign * extremum, jnp.broadcast_to(place + sign * REACH, height.shape)]
    return jnp.concatenate(near), jnp.concatenate(far)


def _half_thickness(s, thickness, last: float) -> Float[Array, "..."]:
    rest = s * (-0.126 + s * (-0.3516 + s * (0.2843 - last * s)))
    return 5 * thickness * (0.2969 * jnp.sqrt(s) + rest)


def _offset(s, t, height, airfoil: Float[Array, " 3"]) -> Float[Array, "..."]:
    """Computes the signed distance of each position from its foot."""
    ordinate, slope = _mean_line(s, airfoil)
    return ((height - ordinate) - (t - s) * slope) / jnp.sqrt(1 + slope**2)


def _from_mean_line(s, offset, airfoil: Float[Array, " 3"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    ordinate, slope = _mean_line(s, airfoil)
    cosine = 1 / jnp.sqrt(1 + slope**2)
    return s - offset * slope * cosine, ordinate + offset * cosine
