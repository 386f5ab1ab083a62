"""The motion of an airfoil by SU2's design variables that look at x alone, and at the side."""

import abc
import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmorph import shapes

from ._motion import AbstractPart
from ._variables import Variable

UPPER, LOWER, ONE = 1, 0, 2
"""Sides of an airfoil, as the first parameter has them; for `ONE` SU2 moves the upper side."""
SIDED = ("HICKS_HENNE", "CST", "NACA_4DIGITS", "PARABOLIC")
"""Kinds that ask on which side of an airfoil a node is."""
TAIL = 0.99
"""The place along the chord behind which `HICKS_HENNE_CAMBER` moves nothing."""
EPS = 1e-16
"""Number that SU2 adds to numbers before it takes their powers."""


class Bumps(AbstractPart):
    """Bumps sin(pi t^(ln 0.5 / ln c))^3 across a chord of length 1, times a factor by node."""

    rows: tuple[int, ...] = eqx.field(static=True)
    centres: Float[Array, " k"]
    chord: shapes.Chord
    weights: Float[Array, " m"]

    def __call__(self, x, values):
        t = self.chord.coordinates(x)[0][:, None]
        behind = t > 10 * EPS
        power = (math.log(0.5) / jnp.log(self.centres)).astype(x.dtype)
        bumps = jnp.where(behind, jnp.sin(jnp.pi * jnp.where(behind, t, 0.5) ** power[None, :]) ** 3, 0)
        return (self.weights.astype(x.dtype) * (bumps @ values))[:, None] * self.chord.up.astype(x.dtype)[None, :]


class Kulfan(AbstractPart):
    """Class and shape functions along x, on one side.

    `orders` are k and n of each Bernstein polynomial.
    """

    rows: tuple[int, ...] = eqx.field(static=True)
    orders: tuple[tuple[int, int], ...] = eqx.field(static=True)
    weights: Float[Array, " m"]

    def __call__(self, x, values):
        t = jnp.maximum(x[:, 0], 0)
        front = jnp.where(t > 0, jnp.sqrt(jnp.where(t > 0, t, 1)), 0) * (1 - t)
        up = sum(values[i] * math.comb(n, k) * t**k * (1 - t) ** (n - k) for i, (k, n) in enumerate(self.orders))
        return _upwards(x, self.weights.astype(x.dtype) * front * up)


class SurfaceBump(AbstractPart):
    """A bump along x between two places, upwards on all nodes."""

    rows: tuple[int, ...] = eqx.field(static=True)
    start: float = eqx.field(static=True)
    end: float = eqx.field(static=True)
    place: float = eqx.field(static=True)

    def __call__(self, x, values):
        size = self.end - self.start
        t = x[:, 0] - self.start
        inside = (t > 0) & (t < size)
        power = math.log(0.5) / math.log((self.place - self.start + EPS) / size)
        bump = jnp.sin(jnp.pi * ((jnp.where(inside, t, size / 2) + EPS) / size) ** power) ** 3
        return _upwards(x, values[0] * jnp.where(inside, bump, 0))


class Section(AbstractPart):
    """Puts nodes onto an airfoil at their x; its numbers come from `DV_PARAM`."""

    rows: tuple[int, ...] = eqx.field(static=True)
    numbers: Float[Array, " k"]
    sides: Float[Array, " m"]

    def __call__(self, x, values):
        sides = self.sides.astype(x.dtype)
        mean, half = self.lines(x[:, 0], self.numbers.astype(x.dtype))
        return _upwards(x, jnp.where(sides != 0, mean + sides * half - x[:, 1], 0))

    @abc.abstractmethod
    def lines(self, t: Float[Array, " m"], numbers: Float[Array, " k"]) -> tuple[Array, Array]:
        """Computes ordinates of the mean line, and half the thickness."""


class Naca(Section):
    """Puts nodes onto a NACA 4-digit airfoil."""

    def lines(self, t, numbers):
        camber, place, thickness = numbers / jnp.array([100.0, 10.0, 100.0], t.dtype)
        ahead = t < place
        width = jnp.where(ahead, jnp.where(place > 0, place, 1), 1 - place)
        mean = camber / width**2 * (jnp.where(ahead, 0, 1 - 2 * place) + 2 * place * t - t**2)
        root = jnp.sqrt(jnp.where(t > 0, t, 0))
        return mean, thickness * (1.4845 * root + t * (-0.63 + t * (-1.758 + t * (1.4215 - 0.518 * t))))


class Parabola(Section):
    """Puts nodes onto an airfoil of two parabolas."""

    def lines(self, t, numbers):
        centre, thickness = numbers[0], numbers[1] / 100
        return jnp.zeros_like(t), thickness * (t * t - t) / (2 * (centre * centre - centre))


def _upwards(x: Float[Array, "m d"], up: Float[Array, " m"]) -> Float[Array, "m d"]:
    return jnp.zeros_like(x).at[:, 1].set(up)


def airfoil_parts(
    listed: Sequence[Variable],
    first: Int[np.ndarray, " v"],
    wall: Float[np.ndarray, "m d"],
    normals: Float[np.ndarray, "m d"],
) -> list[AbstractPart]:
    """Makes the parts of the variables that look at x.

    `first` is the place of each variable's first value. `normals` stand on the wall's nodes, out of
    the body, where `SIDED` kinds need them.
    """
    d, up = wall.shape[1], normals[:, 1]
    chord = shapes.Chord() if d == 2 else shapes.Chord([0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0])
    parts: list[AbstractPart] = []
    for side in (UPPER, LOWER):
        on = jnp.asarray(up > 0 if side == UPPER else up < 0, float)
        rows, members = _of_side(listed, first, "HICKS_HENNE", side)
        if members:
            sign = 1 if side == UPPER else -1
            parts.append(_bumps(rows, [variable.numbers[1] for variable in members], chord, sign * on))
        rows, members = _of_side(listed, first, "CST", side)
        if members:
            parts.append(Kulfan(rows, tuple(_orders(variable) for variable in members), on))
    camber = [k for k, variable in enumerate(listed) if variable.kind == "HICKS_HENNE_CAMBER"]
    if camber:
        rows = tuple(first[camber].tolist())
        parts.append(_camber(rows, [listed[k].numbers[0] for k in camber], wall))
    for variable, row in zip(listed, first.tolist(), strict=True):
        if variable.kind == "SURFACE_BUMP":
            parts.append(_surface_bump((row,), variable))
        elif variable.kind in ("NACA_4DIGITS", "PARABOLIC"):
            kind = Naca if variable.kind == "NACA_4DIGITS" else Parabola
            parts.append(kind((row,), jnp.asarray(variable.numbers), jnp.asarray(np.sign(up))))
    return parts


def _of_side(
    listed: Sequence[Variable], first: Int[np.ndarray, " v"], kind: str, side: int
) -> tuple[tuple[int, ...], list[Variable]]:
    members = [
        k for k, variable in enumerate(listed) if variable.kind == kind and _is_upper(variable) == (side == UPPER)
    ]
    return tuple(first[members].tolist()), [listed[k] for k in members]


def _is_upper(variable: Variable) -> bool:
    side = variable.numbers[0]
    if side not in (UPPER, LOWER, ONE):
        raise ValueError(f"{variable.kind} has the side {side:g}; 0 is the lower one, 1 the upper one.")
    return side != LOWER


def _bumps(rows: tuple[int, ...], centres: list[float], chord: shapes.Chord, weights: Array) -> Bumps:
    wrong = [centre for centre in centres if not 0 < centre < 1]
    if wrong:
        raise ValueError(f"a bump has its top at {wrong[0]:g} of the chord; expected between 0 and 1.")
    return Bumps(rows, jnp.asarray(centres), chord, weights)


def _camber(rows: tuple[int, ...], centres: list[float], wall: Float[np.ndarray, "m d"]) -> Bumps:
    """Makes bumps of both sides across the airfoil's own chord, which SU2 takes to be 1 long."""
    if wall.shape[1] != 2:
        raise ValueError("HICKS_HENNE_CAMBER in 3-D: SU2 has it for airfoils in 2-D.")
    own = shapes.Chord.along(wall)
    nose, along = np.asarray(own.nose), np.asarray(own.tail - own.nose)
    chord = shapes.Chord(nose, nose + along / np.linalg.norm(along))
    t = np.asarray(chord.coordinates(jnp.asarray(wall))[0])
    return _bumps(rows, centres, chord, jnp.asarray(t <= TAIL, float))


def _orders(variable: Variable) -> tuple[int, int]:
    number, most = variable.numbers[1:]
    if number != int(number) or most != int(most) or not 1 <= number <= most:
        raise ValueError(f"CST has the function {number:g} of {most:g}: whole numbers from 1 expected.")
    return int(number) - 1, int(most) - 1


def _surface_bump(rows: tuple[int, ...], variable: Variable) -> SurfaceBump:
    start, end, place = variable.numbers
    if not start < place < end:
        raise ValueError(f"SURFACE_BUMP from {start:g} to {end:g} with its top at {place:g}: it must lie between.")
    return SurfaceBump(rows, start, end, place)
