"""The motion of a wall by SU2's design variables, as SU2 states each; displacements add up."""

import abc
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy import ndarray

from jaxmorph import Mesh, io, shapes

from ._options import LOWER, Options, Variable

PatchNamesOfMotion = Sequence[str]
MotionNumbers = Sequence[tuple[float, ...]] | Float[ndarray, "k p"]
TAIL = 0.99
"""The place along the chord behind which `HICKS_HENNE_CAMBER` moves nothing."""
EPS = 1e-16
"""SU2's bumps begin behind ten times this place."""


class AbstractPart(eqx.Module):
    """The displacement by some design variables; `rows` are their places among all values."""

    rows: eqx.AbstractVar[tuple[int, ...]]

    @abc.abstractmethod
    def __call__(self, x: Float[Array, "m d"], values: Float[Array, " k"]) -> Float[Array, "m d"]:
        """Computes displacements (m, d) of a wall at `x`."""


class WallPart(AbstractPart):
    """The displacement by all variables of one kind; `data` is the wall's, for `MOVES`.

    `move` gives displacements (m, d), or (m,) upwards.
    """

    rows: tuple[int, ...] = eqx.field(static=True)
    move: Callable[..., Array] = eqx.field(static=True)
    numbers: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    data: Any

    def __call__(self, x, values):
        moved = self.move(x, values, self.numbers, self.data)
        return (moved if moved.ndim == 2 else jnp.zeros_like(x).at[:, 1].set(moved)).astype(x.dtype)


class DesignVariables(shapes.AbstractShape):
    """A config file's shape: moves the nodes of `DV_MARKER` by the design variables' values.

    The parameters (n,) are the values in the order of the file; a control point without a direction
    has a value for each coordinate. `names` are the variables' names in messages. Coordinates of
    nodes that are not `free` stay: nodes do not leave symmetry planes.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    parts: tuple[AbstractPart, ...]
    scales: Float[Array, " n"]
    rest: Float[Array, " n"]
    free: Bool[Array, "m d"]

    def neutral(self) -> Float[Array, " n"]:
        """Makes the values that move nothing: 1 for a factor, else 0."""
        return self.rest

    def __call__(self, x: Any, parameters: Any) -> Float[Array, "m d"]:
        x = jnp.asarray(x)
        if np.shape(parameters) != self.rest.shape:
            raise ValueError(
                f"`parameters` have shape {np.shape(parameters)}; this config file has "
                f"{self.rest.shape}."
            )
        values = jnp.asarray(parameters, x.dtype) * self.scales.astype(x.dtype)
        terms = [part(x, values[np.array(part.rows, int)]) for part in self.parts]
        return x + jnp.where(self.free, sum(terms[1:], terms[0]), 0) if terms else x


def wall_parts(
    options: Options, listed: list[Variable], mesh: Mesh, moving: PatchNamesOfMotion
) -> list[AbstractPart]:
    """Makes a part of the variables of each kind that moves no boxes."""
    parts: list[AbstractPart] = []
    for kind in dict.fromkeys(variable.kind for variable in listed if variable.kind in MOVES):
        members = [variable for variable in listed if variable.kind == kind]
        numbers = tuple(variable.numbers for variable in members)
        move, data_of = MOVES[kind]
        _check_motion(kind, numbers, mesh.points.shape[1])
        data = data_of(options, mesh, moving) if data_of else None
        parts.append(WallPart(tuple(variable.first for variable in members), move, numbers, data))
    return parts


def _check_motion(kind: str, numbers: MotionNumbers, d: int) -> None:
    if kind == "HICKS_HENNE_CAMBER" and d != 2:
        raise ValueError(f"{kind} in 3-D: SU2 has it for airfoils in 2-D.")
    for own in numbers:
        if kind == "TRANSLATE_GRID" and not any(own[:d]):
            raise ValueError(f"{kind} along a vector without length.")
        if kind in ("ROTATION", "ROTATE_GRID"):
            check_axis(kind, own, d)


def check_axis(kind: str, numbers: Sequence[float], d: int) -> None:
    """Raises `ValueError` for two ends of an axis that is not along z in 2-D, or has no length."""
    axis = np.subtract(numbers[3:6], numbers[:3])
    if d == 2 and axis[:2].any():
        raise ValueError(
            f"{kind} in 2-D about an axis that is not along z: both ends have the same x and y."
        )
    if (d == 3 or kind.startswith("FFD")) and not axis.any():
        raise ValueError(f"{kind} about an axis without length: its two ends are one point.")


def _signs(options: Options, mesh: Mesh, moving: PatchNamesOfMotion) -> Float[ndarray, " m"]:
    """Finds the side of each node: 1 where the wall's normal points up, -1 where down."""
    return np.sign(shapes.wall_normals(mesh, *moving)[:, 1])


def _chord_of_walls(
    options: Options, mesh: Mesh, moving: PatchNamesOfMotion
) -> tuple[shapes.Chord, Float[ndarray, " m"]]:
    """Finds the airfoil's own chord, which SU2 takes to be 1 long; 1 for nodes ahead of `TAIL`."""
    wall = np.asarray(mesh.points, float)[mesh.patch(*moving)]
    own = shapes.Chord.along(wall)
    nose = np.asarray(own.nose)
    along = np.asarray(own.tail - own.nose)
    chord = shapes.Chord(nose, nose + along / np.linalg.norm(along))
    return chord, np.where(np.asarray(chord.coordinates(jnp.asarray(wall))[0]) <= TAIL, 1.0, 0.0)


def _file(options: Options, mesh: Mesh, moving: PatchNamesOfMotion) -> Float[ndarray, "m d"]:
    # the older name
    name = options.text("DV_FILENAME", options.text("MOTION_FILENAME", "surface_positions.dat"))
    return io.read_displacement(options.beside(name), mesh, mesh.patch(*moving))


def _translation(x, values, numbers: MotionNumbers, data):
    return jnp.broadcast_to(values @ np.array(numbers)[:, : x.shape[1]].astype(x.dtype), x.shape)


def _translation_of_length(x, values, numbers: MotionNumbers, data):
    along = np.array(numbers)[:, : x.shape[1]]
    return _translation(x, values, along / np.linalg.norm(along, axis=1, keepdims=True), data)


def _rotate_walls(x, values, numbers: MotionNumbers, data):
    """Turns about an axis by degrees; the numbers have its two ends."""
    d = x.shape[1]
    ends = np.array(numbers)
    axes = ends[:, 3:] - ends[:, :3] if d == 3 else [None] * len(ends)
    turns = zip(values, ends[:, :d], axes, strict=True)
    return sum(
        shapes.rotate(x, jnp.deg2rad(value), about, axis) - x for value, about, axis in turns
    )


def _scale_about(x, values, numbers: MotionNumbers, data):
    return (values - 1).sum() * x


def _displace(x, values, numbers: MotionNumbers, u):
    return jnp.asarray(u, x.dtype)


def _hicks_henne(x, values, numbers: MotionNumbers, signs):
    """Moves each side outwards by bumps across a unit chord along x."""
    sides, tops = np.array(numbers).T
    ways = np.where(sides == LOWER, -1, 1)[None, :]
    return (_bumps(x[:, :1], tops) * (ways * (signs[:, None] == ways))) @ values


def _camber(x, values, numbers: MotionNumbers, data):
    chord, weights = data
    rise = (_bumps(chord.coordinates(x)[0][:, None], np.ravel(numbers)) @ values) * weights.astype(
        x.dtype
    )
    return rise[:, None] * chord.up.astype(x.dtype)[None, :]


def _surface_bump(x, values, numbers: MotionNumbers, data):
    """Moves both sides upwards by bumps along x between two places."""
    start, end, top = np.array(numbers).T[:, None].astype(x.dtype)
    t = (x[:, :1] - start) / (end - start)
    return jnp.where(t < 1, _bumps(t, ((top - start) / (end - start))[0]), 0) @ values


def _bumps(t: Float[Array, "m _"], tops: Float[ndarray, " k"]) -> Float[Array, "m k"]:
    """Evaluates sin(pi t^(ln 0.5 / ln c))^3 for tops c."""
    behind = t > 10 * EPS
    power = (math.log(0.5) / np.log(tops))[None, :].astype(t.dtype)
    return jnp.where(behind, jnp.sin(jnp.pi * jnp.where(behind, t, 0.5) ** power) ** 3, 0)


def _kulfan(x, values, numbers: MotionNumbers, signs):
    """Moves one side by a Bernstein polynomial times sqrt(t) (1 - t)."""
    t = jnp.maximum(x[:, 0], 0)
    front = jnp.where(t > 0, jnp.sqrt(jnp.where(t > 0, t, 1)), 0) * (1 - t)
    rise = 0
    for value, (side, number, most) in zip(values, numbers, strict=True):
        k = int(number) - 1
        n = int(most) - 1
        on = signs == (-1 if side == LOWER else 1)
        rise += value * math.comb(n, k) * t**k * (1 - t) ** (n - k) * on
    return front * rise


def _naca(x, values, numbers: MotionNumbers, signs):
    camber, place, thickness = (np.array(numbers[0]) / [100, 10, 100]).tolist()
    t = x[:, 0]
    ahead = t < place
    width = jnp.where(ahead, place if place > 0 else 1.0, 1 - place)
    mean = camber / width**2 * (jnp.where(ahead, 0, 1 - 2 * place) + 2 * place * t - t**2)
    root = jnp.sqrt(jnp.where(t > 0, t, 0))
    half = thickness * (1.4845 * root + t * (-0.63 + t * (-1.758 + t * (1.4215 - 0.518 * t))))
    return jnp.where(signs != 0, mean + signs * half - x[:, 1], 0)


def _parabolic(x, values, numbers: MotionNumbers, signs):
    t = x[:, 0]
    centre, thickness = numbers[0]
    half = thickness / 100 * (t * t - t) / (2 * (centre * centre - centre))
    return jnp.where(signs != 0, signs * half - x[:, 1], 0)


MOVES: dict[str, tuple[Callable[..., Any], Callable[..., Any] | None]] = {
    "TRANSLATION": (_translation, None),
    "ROTATION": (_rotate_walls, None),
    "SCALE": (_scale_about, None),
    "TRANSLATE_GRID": (_translation_of_length, None),
    "ROTATE_GRID": (_rotate_walls, None),
    "SCALE_GRID": (_scale_about, None),
    "HICKS_HENNE": (_hicks_henne, _signs),
    "HICKS_HENNE_CAMBER": (_camber, _chord_of_walls),
    "CST": (_kulfan, _signs),
    "SURFACE_BUMP": (_surface_bump, None),
    "NACA_4DIGITS": (_naca, _signs),
    "PARABOLIC": (_parabolic, _signs),
    "SURFACE_FILE": (_displace, _file),
}
"""How each kind moves a wall, and what it knows of the undeformed one."""
