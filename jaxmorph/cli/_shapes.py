"""Motions that are not rigid: twisting and bending along a line, and the free-form deformation box."""

import dataclasses
import json
import pathlib
import tomllib
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import comb

Points = Float[np.ndarray, "m d"]


@dataclasses.dataclass(frozen=True)
class Line:
    """A line from `start` in the direction `along` (of length 1); over `length` of it a section turns by `angle` in radians."""

    start: Float[np.ndarray, " d"]
    along: Float[np.ndarray, " d"]
    length: float
    angle: float

    def station(self, x: Points) -> Float[np.ndarray, " m"]:
        """How far along the line each point is, from 0 to `length`."""
        return np.clip((x - self.start) @ self.along, 0.0, self.length)


def twisted(x: Points, line: Line, share: float) -> Points:
    """Sections turned about the line, in proportion to how far along it they are (Rodrigues' formula)."""
    angle = (share * line.angle / line.length * line.station(x))[:, None]
    arm = x - line.start
    on_axis = np.outer(arm @ line.along, line.along)
    return line.start + on_axis + (arm - on_axis) * np.cos(angle) + np.cross(line.along, arm) * np.sin(angle)


def bent(x: Points, line: Line, up: Float[np.ndarray, " d"], share: float) -> Points:
    """The line becomes an arc of the same length that turns towards `up`; sections stay plane, and at right angles to it.

    Points before its start stay; those beyond its end go on along the tangent.
    """
    curvature = share * line.angle / line.length
    s, arm = line.station(x), x - line.start
    beyond, height = arm @ line.along - s, arm @ up
    angle = curvature * s
    # sin(a) / a and (1 - cos a) / a, exact at a = 0
    forward = s * np.sinc(angle / np.pi) - height * np.sin(angle) + beyond * np.cos(angle)
    upward = s * np.sin(angle / 2) * np.sinc(angle / 2 / np.pi) + height * np.cos(angle) + beyond * np.sin(angle)
    aside = arm - np.outer(arm @ line.along, line.along) - np.outer(height, up)
    return line.start + aside + np.outer(forward, line.along) + np.outer(upward, up)


@dataclasses.dataclass(frozen=True)
class Box:
    """A lattice of control points between two corners, and the displacement (i, j[, k], d) of each.

    A point inside moves by the displacements weighted with Bernstein polynomials (Sederberg and Parry, Free-form deformation
    of solid geometric models, SIGGRAPH 1986); points outside stay.
    """

    low: Float[np.ndarray, " d"]
    high: Float[np.ndarray, " d"]
    control: Float[np.ndarray, "*counts d"]

    def moved(self, x: Points, share: float) -> Points:
        t = (x - self.low) / (self.high - self.low)
        inside = ((t >= 0) & (t <= 1)).all(axis=1)
        values = np.broadcast_to(self.control, (int(inside.sum()), *self.control.shape))
        for axis, count in enumerate(self.control.shape[:-1]):
            values = np.einsum("mk,mk...->m...", bernstein(count - 1, t[inside, axis]), values)
        result = x.copy()
        result[inside] += share * values
        return result


def bernstein(degree: int, t: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m k"]:
    """The Bernstein polynomials of a degree at each of `t`."""
    k = np.arange(degree + 1)
    return comb(degree, k) * t[:, None] ** k * (1 - t[:, None]) ** (degree - k)


def read_box(given: str, d: int) -> Box:
    """From a TOML file, or the same as JSON text: `low`, `high`, `points` and a list `moved` of `at` and `by`.

    Raises `ValueError` for what does not fit a mesh in `d` dimensions.
    """
    where = "--box" if given.lstrip().startswith("{") else given
    try:
        found = json.loads(given) if where == "--box" else tomllib.loads(pathlib.Path(given).read_text())
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{where}: not a table in {'JSON' if where == '--box' else 'TOML'} ({error}).") from None
    expected = {"low", "high", "points", "moved"}
    if set(found) != expected or not isinstance(found["moved"], list):
        raise ValueError(
            f"{where}: low, high, points and a list moved expected, found {', '.join(found) or 'nothing'}."
        )
    low, high = (_numbers(where, name, found[name], d) for name in ("low", "high"))
    counts = _numbers(where, "points", found["points"], d)
    if not (low < high).all() or not (counts >= 2).all() or (counts != np.floor(counts)).any():
        raise ValueError(f"{where}: low must be below high, and points 2 or more whole numbers of control points.")
    control = np.zeros((*counts.astype(int), d))
    for entry in found["moved"]:
        if not isinstance(entry, dict) or set(entry) != {"at", "by"}:
            raise ValueError(f"{where}: each of moved has at and by, found {entry}.")
        at = _numbers(where, "at", entry["at"], d)
        if (at < 0).any() or (at >= counts).any() or (at != np.floor(at)).any():
            raise ValueError(f"{where}: at = {entry['at']} is none of the control points 0 to {counts - 1}.")
        control[tuple(at.astype(int))] += _numbers(where, "by", entry["by"], d)
    return Box(low, high, control)


def _numbers(where: str, name: str, values: Any, d: int) -> Float[np.ndarray, " d"]:
    good = isinstance(values, list) and len(values) == d and all(type(value) in (int, float) for value in values)
    if not good or not np.isfinite(values).all():
        raise ValueError(f"{where}: {name} needs {d} numbers for a mesh in {d}-D, found {values}.")
    return np.array(values, float)
