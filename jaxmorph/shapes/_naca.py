"""The NACA 4-digit family as a shape."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._host.door import between, checked
from ._door import Numbers, positions
from ._section import Chord
from ._shape import AbstractShape


class NACA4(AbstractShape):
    """Turns a NACA 4-digit airfoil into another one: exact for its own nodes, smooth for those near it.

    The parameters are (camber, place, thickness) in chords: (0.04, 0.4, 0.12) is the NACA 4412. A node keeps its place on the mean
    line; its height above the mean line scales with the thickness.

    **Arguments:**

    - `camber`, `place`, `thickness`: of the airfoil that is given.
    - `chord`: where it lies; from (0, 0) to (1, 0) by default.

    **Raises:** `ValueError` for a thickness that is not above 0, and a place outside of 0 to 1.
    """

    given: Float[Array, " 3"]
    chord: Chord

    @checked
    def __init__(self, camber: float, place: float, thickness: float, *, chord: Chord | None = None):
        between("camber", camber)
        between("place", place, 0, 1)
        between("thickness", thickness, 0)
        self.given = jnp.asarray([camber, place, thickness], float)
        self.chord = Chord() if chord is None else chord

    def neutral(self) -> Float[Array, " 3"]:
        """Makes the parameters of the given airfoil."""
        return self.given

    def __call__(self, x: Numbers, parameters: Numbers) -> Float[Array, "m d"]:
        """Moves positions (m, d) from the given airfoil to the one of the parameters (3,)."""
        x = positions(x)
        parameters, given = jnp.asarray(parameters, x.dtype), self.given.astype(x.dtype)
        if parameters.shape != (3,):
            raise ValueError(f"parameters have shape {parameters.shape}; expected camber, place, thickness.")
        t, height = self.chord.coordinates(x)
        height = height / self.chord.length.astype(x.dtype)
        s = _station(t, height, given)
        t0, y0 = _from_mean_line(s, _offset(s, t, height, given), given)
        t1, y1 = _from_mean_line(s, _offset(s, t, height, given) * (parameters[2] / given[2]), parameters)
        chord, up = (self.chord.tail - self.chord.nose).astype(x.dtype), self.chord.up.astype(x.dtype)
        across = up * self.chord.length.astype(x.dtype)
        return x + (t1 - t0)[:, None] * chord[None, :] + (y1 - y0)[:, None] * across[None, :]


def _mean_line(s: Float[Array, " m"], airfoil: Float[Array, " 3"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Computes ordinate and slope of the mean line at each place."""
    camber, place = airfoil[0], airfoil[1]
    width = jnp.where(s < place, place, 1 - place)
    ordinate = camber / width**2 * (jnp.where(s < place, 0, 1 - 2 * place) + 2 * place * s - s**2)
    return ordinate, 2 * camber / width**2 * (place - s)


def _station(t: Float[Array, " m"], height: Float[Array, " m"], airfoil: Float[Array, " 3"]) -> Float[Array, " m"]:
    """Finds the foot of each position on the mean line, by Newton's method; one last step carries the derivative."""

    def newton(s):
        def away(s):
            ordinate, slope = _mean_line(s, airfoil)
            return s - t + (ordinate - height) * slope

        value, rate = jax.jvp(away, (s,), (jnp.ones_like(s),))
        return s - value / jnp.where(jnp.abs(rate) > 0.1, rate, 1)

    start = jax.lax.stop_gradient(t)
    s = jax.lax.fori_loop(0, 12, lambda _, s: newton(s), start)
    return newton(jax.lax.stop_gradient(s))


def _offset(s, t, height, airfoil: Float[Array, " 3"]) -> Float[Array, " m"]:
    """Computes the signed distance of each position from its foot."""
    ordinate, slope = _mean_line(s, airfoil)
    return ((height - ordinate) - (t - s) * slope) / jnp.sqrt(1 + slope**2)


def _from_mean_line(s, offset, airfoil: Float[Array, " 3"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    ordinate, slope = _mean_line(s, airfoil)
    cosine = 1 / jnp.sqrt(1 + slope**2)
    return s - offset * slope * cosine, ordinate + offset * cosine
