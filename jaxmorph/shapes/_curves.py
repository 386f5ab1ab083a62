"""Shapes of airfoils and curves: bumps, class functions, NACA's family, B-splines, modes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmorph.extend import between, checked, finite_array

from ._arguments import (
    Column,
    Numbers,
    Positions,
    Vector,
    cast,
    check_known,
    clamp,
    known_positions,
    positions,
    slack,
)
from ._freeform import bernstein, splines
from ._section import Chord
from ._shape import AbstractLinearShape, AbstractShape, Move


class HicksHenne(AbstractLinearShape):
    """Hicks-Henne bumps (1978): sin(pi t^(ln 0.5 / ln c))^w, of height 1 at t = c.

    t runs along the chord from 0 to 1; positions before and behind it stay. The parameters (k,) are
    the heights across the chord, in the units of the positions. `Part` restricts the bumps to one
    side.

    **Arguments:**

    - `centres`: c (k,), between 0 and 1.
    - `widths`: exponents w above 0, one or (k,). A larger exponent is a narrower bump.
    - `chord`: of the airfoil; from (0, 0) to (1, 0) by default.

    **Raises:** `ValueError` for numbers outside of these ranges, and equal bumps.
    """

    centres: Vector
    widths: Vector
    chord: Chord

    @checked
    def __init__(self, centres: Numbers, widths: Numbers = 3.0, *, chord: Chord | None = None):
        known = finite_array("centres", np.asarray(centres, float), (None,))
        powers = finite_array("widths", np.asarray(widths, float), (), known.shape)
        if not ((known > 0) & (known < 1) & (powers > 0)).all():
            raise ValueError(
                f"`centres` lie between 0 and 1, `widths` above 0; got {known} and {powers}."
            )
        bumps = np.column_stack([known, np.broadcast_to(powers, known.shape)])
        if twice := len(bumps) - len(np.unique(bumps, axis=0)):
            raise ValueError(f"{twice} of {len(bumps)} bumps stand twice.")
        self.centres = jnp.asarray(bumps[:, 0])
        self.widths = jnp.asarray(bumps[:, 1])
        self.chord = Chord() if chord is None else chord

    def neutral(self) -> Vector:
        return jnp.zeros(len(self.centres))

    def at(self, x: Numbers) -> Move:
        x = positions(x)
        own = cast(self, x)
        t = own.chord.coordinates(x)[0][:, None]
        inside = (t > 0) & (t < 1)
        exponent = (jnp.log(0.5) / jnp.log(own.centres)).astype(x.dtype)
        wave = jnp.sin(jnp.pi * jnp.where(inside, t, 0.5) ** exponent[None, :])
        bumps = jnp.where(inside, wave ** own.widths[None, :], 0)
        return lambda heights: (bumps @ self._numbers(heights, x))[:, None] * own.chord.up[None, :]


class CST(AbstractLinearShape):
    """Class and shape functions of one side of an airfoil (Kulfan, 2008).

    They are t^a (1 - t)^b times Bernstein polynomials. The `order + 2` parameters, in chords, are
    the weights of the polynomials and the ordinate of a blunt trailing edge. They are added to the
    airfoil, across the chord. `Part` restricts them to one side.

    **Arguments:**

    - `order`: degree of the polynomials, 1 or more.
    - `exponents`: (a, b); (0.5, 1) is a round nose and a sharp tail.
    - `chord`: of the airfoil; from (0, 0) to (1, 0) by default.
    """

    order: int = eqx.field(static=True)
    exponents: tuple[float, float] = eqx.field(static=True)
    chord: Chord

    @checked
    def __init__(
        self, order: int, exponents: tuple[float, float] = (0.5, 1.0), *, chord: Chord | None = None
    ):
        if order < 1 or min(exponents) <= 0:
            raise ValueError(
                f"order {order} and exponents {exponents} must be 1 or more, and above 0."
            )
        self.order = order
        self.exponents = exponents
        self.chord = Chord() if chord is None else chord

    def neutral(self) -> Vector:
        return jnp.zeros(self.order + 2)

    def at(self, x: Numbers) -> Move:
        x = positions(x)
        chord = cast(self.chord, x)
        t, _ = chord.coordinates(x)
        beyond = slack(t.dtype)
        inside = (t >= -beyond) & (t <= 1 + beyond)
        within = jnp.where(inside, t, 0.5)
        a, b = self.exponents
        class_function = jnp.where(inside, _side_power(within, a) * _side_power(1 - within, b), 0)
        functions = class_function[:, None] * bernstein(within, self.order)
        weights = chord.length * jnp.concatenate([functions, clamp(t, 0, 1)[:, None]], axis=1)
        return lambda numbers: (weights @ self._numbers(numbers, x))[:, None] * chord.up[None, :]


def _side_power(distance: Column, exponent: float) -> Column:
    """The derivative at the nose or tail is the one inside, or 0 where that is infinite."""
    if float(exponent).is_integer():
        return distance ** int(exponent)
    ahead = distance > 0
    return jnp.where(ahead, jnp.where(ahead, distance, 1) ** exponent, 0)


class BSplineCurve(AbstractLinearShape):
    """A B-spline along a curve of nodes, which follow control points by their arc length.

    The nodes are `points` (m, d) in order, end to end; neighbours must not coincide. The parameters
    are the displacements (count, d) of the control points, more than the `degree` of the spline.

    **Raises:** `ValueError` for other arguments, and positions other than `points`.
    """

    shares: Column
    count: int = eqx.field(static=True)
    degree: int = eqx.field(static=True)
    dimension: int = eqx.field(static=True)

    @checked
    def __init__(self, points: Numbers, count: int, degree: int = 3):
        known = known_positions(points, "points")
        steps = np.linalg.norm(np.diff(known, axis=0), axis=1)
        if not 1 <= degree < count:
            raise ValueError(
                f"a B-spline of degree {degree} with {count} control points: degree is 1 to count "
                "- 1."
            )
        if (steps == 0).any():
            first = int(np.argmin(steps))
            raise ValueError(
                f"{(steps == 0).sum()} nodes stand on the one before, first {first + 1}: leave "
                "them out."
            )
        lengths = np.append(0, np.cumsum(steps))
        self.shares = jnp.asarray(lengths / lengths[-1])
        self.count = count
        self.degree = degree
        self.dimension = known.shape[1]

    def neutral(self) -> Float[Array, "k d"]:
        return jnp.zeros((self.count, self.dimension))

    def at(self, x: Numbers) -> Move:
        x = positions(x, like=(len(self.shares), self.dimension))
        weights = splines(self.shares.astype(x.dtype), self.count, self.degree)
        return lambda control: weights @ self._numbers(control, x)


class Modes(AbstractLinearShape):
    """Displacement fields (k, m, d), such as mode shapes; the parameters (k,) are amplitudes.

    **Raises:** `ValueError` for fields of another shape than the positions.
    """

    fields: Float[Array, "k m d"]

    @checked
    def __init__(self, fields: Numbers):
        self.fields = jnp.asarray(fields, float)
        check_known(fields=self.fields)
        if self.fields.ndim != 3:
            raise ValueError(f"`fields` has shape {self.fields.shape}; expected (k, m, d).")

    def neutral(self) -> Vector:
        return jnp.zeros(len(self.fields))

    def at(self, x: Numbers) -> Move:
        x = positions(x, like=self.fields.shape[1:])
        return lambda amplitudes: jnp.tensordot(
            self._numbers(amplitudes, x), self.fields.astype(x.dtype), 1
        )


FOOT_STEPS = 16  # to a node's foot on the mean line; most take four

# half of a thickness over the radius of the mean line from which nodes below have several feet
BENT = 1.25


class NACA4(AbstractShape):
    """Turns a NACA 4-digit airfoil into another: exact for its own nodes, smooth nearby.

    The parameters are (camber, place, thickness) in chords: (0.04, 0.4, 0.12) is the NACA 4412. A
    node keeps its place on the mean line; its height above it scales with the thickness. `camber`,
    `place` and `thickness` are those of the given airfoil, `chord` its chord; from (0, 0) to (1, 0)
    by default.

    **Raises:** `ValueError` for a thickness that is not above 0, a place outside of 0 to 1, and a
    mean line that bends within the thickness, as from 6 % camber at 0.1 with 21 % thickness on.
    """

    original: Vector
    chord: Chord

    @checked
    def __init__(
        self, camber: float, place: float, thickness: float, *, chord: Chord | None = None
    ):
        between("camber", camber)
        between("place", place, 0, 1)
        between("thickness", thickness, 0)
        if abs(camber) * thickness > BENT * place**2:
            raise ValueError(
                f"the mean line of camber {camber} at {place} bends within the thickness "
                f"{thickness}: nodes have no single place along it. Try less of one of them."
            )
        self.original = jnp.asarray([camber, place, thickness], float)
        self.chord = Chord() if chord is None else chord

    def neutral(self) -> Vector:
        return self.original

    def __call__(self, x: Numbers, parameters: Numbers) -> Positions:
        x = positions(x)
        own = cast(self, x)
        airfoil = jnp.asarray(parameters, x.dtype)
        if airfoil.shape != (3,):
            raise ValueError(
                f"parameters have shape {airfoil.shape}; expected camber, place, thickness."
            )
        chord = own.chord
        t, height = chord.coordinates(x)
        s, offset = _on_mean_line(t, height / chord.length, own.original)
        before = _from_mean_line(s, offset, own.original)
        after = _from_mean_line(s, offset * (airfoil[2] / own.original[2]), airfoil)
        axes = jnp.stack([chord.tail - chord.nose, chord.up * chord.length])
        return x + (after - before) @ axes


def _mean_line(s: Column, airfoil: Vector) -> tuple[Column, Column]:
    """Ordinate and slope."""
    camber = airfoil[0]
    place = airfoil[1]
    width = jnp.where(s < place, place, 1 - place)
    return camber * (1 - ((s - place) / width) ** 2), 2 * camber / width**2 * (place - s)


def _on_mean_line(t: Column, height: Column, airfoil: Vector) -> tuple[Column, Column]:
    """The foot of each position on the mean line, and its distance from it."""

    def ahead(s):
        ordinate, slope = _mean_line(s, airfoil)
        return s - t + (ordinate - height) * slope

    def nearer(_, s):
        value, rate = jax.jvp(ahead, (s,), (jnp.ones_like(s),))
        return s - value / jnp.where(rate > 0.1, rate, 0.1)

    s = jax.lax.fori_loop(0, FOOT_STEPS, nearer, t)
    ordinate, slope = _mean_line(s, airfoil)
    return s, ((height - ordinate) - (t - s) * slope) / jnp.sqrt(1 + slope**2)


def _from_mean_line(s: Column, offset: Column, airfoil: Vector) -> Float[Array, "m 2"]:
    ordinate, slope = _mean_line(s, airfoil)
    away = offset / jnp.sqrt(1 + slope**2)
    return jnp.stack([s - away * slope, ordinate + away], axis=1)
