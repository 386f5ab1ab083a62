"""Motions of all positions; at the neutral parameter x comes back bit for bit."""

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy import ndarray

from jaxmorph.extend import checked, finite_array, is_known

from ._arguments import (
    Numbers,
    Positions,
    ShapeNumber,
    ShapeWeights,
    Vector,
    above_zero,
    arms_from,
    axis_for,
    cast,
    clamp,
    direction,
    one_number,
    piecewise,
    positions,
    vector,
)
from ._shape import AbstractShape
from ._tolerances import LEVEL, RIGHT_ANGLE


@checked
def rotate(
    x: Numbers, angle: ShapeNumber | Numbers, about: Numbers, axis: Numbers | None = None
) -> Positions:
    """Rotates positions about a point in 2-D, about an axis through a point in 3-D.

    **Arguments:**

    - `x`: positions (m, d).
    - `angle`: radians, counter-clockwise as seen against `axis`, one or (m,); 0 is neutral.
    - `about`: a point (d,) that stays.
    - `axis`: direction (3,) of any length; only in 3-D.

    **Raises:** `ValueError` for wrong shapes, an axis in 2-D, none in 3-D, or one without length.
    """
    x = positions(x)
    angle = jnp.asarray(angle, x.dtype)
    angle = angle[:, None] if angle.shape == x.shape[:1] else one_number("angle", angle, x)
    return x + _rotate_arms(arms_from(x, about), angle, axis_for(axis, x))


@checked
def translate(x: Numbers, by: Numbers) -> Positions:
    """Translates positions (m, d) by a vector (d,), in their units; 0 is neutral.

    **Raises:** `ValueError` for wrong shapes.
    """
    x = positions(x)
    return x + vector("by", by, x)[None, :]


@checked
def scale(x: Numbers, factors: Numbers | ShapeNumber, about: Numbers) -> Positions:
    """Scales positions (m, d) about a point (d,) that stays, by one factor or (d,); 1 is neutral.

    **Raises:** `ValueError` for wrong shapes.
    """
    x = positions(x)
    factors = jnp.asarray(factors, x.dtype)
    if factors.ndim == 0:
        factors = jnp.broadcast_to(factors, x.shape[1:])
    return x + (vector("factors", factors, x) - 1)[None, :] * (arms_from(x, about))


@checked
def twist(
    x: Numbers, angle: ShapeNumber, about: Numbers, axis: Numbers, length: ShapeNumber
) -> Positions:
    """Twists positions about an axis, in proportion to the distance along it. Positions before
    `about` stay, positions beyond `length` turn by the whole angle.

    **Arguments:**

    - `x`: positions (m, 3).
    - `angle`: radians at the end of the length; 0 is neutral.
    - `about`, `axis`: the point (3,) where the twist begins, and its direction (3,).
    - `length`: distance over which it grows, above 0.

    **Raises:** `ValueError` for positions in 2-D, wrong shapes, and an axis or a length that is 0.
    """
    x = positions(x)
    if x.shape[1] == 2:
        raise ValueError("`twist` is for positions in 3-D; `rotate` turns a section in 2-D.")
    arm = arms_from(x, about)
    along = direction("axis", axis, x)
    span = above_zero("length", length, x)
    share = clamp(arm @ along, 0, span) / span
    return x + _rotate_arms(arm, one_number("angle", angle, x) * share[:, None], along)


@checked
def bend(
    x: Numbers,
    angle: ShapeNumber,
    about: Numbers,
    along: Numbers,
    length: ShapeNumber,
    axis: Numbers | None = None,
) -> Positions:
    """Bends a straight line, with all that is around it, into an arc of equal length.

    Sections stay plane and at right angles to the line. Positions before `about` stay, positions
    beyond `length` follow the tangent.

    **Arguments:**

    - `x`: positions (m, d).
    - `angle`: radians by which the tangent turns at the end, as `rotate` turns; 0 is neutral.
    - `about`, `along`: the point (d,) where the line begins, and its direction (d,).
    - `length`: length of the arc, above 0.
    - `axis`: direction (3,) about which the line turns, at right angles to it; only in 3-D.

    **Raises:** `ValueError` for wrong shapes, directions or a length that are 0, and an axis not at
    right angles to the line.
    """
    x = positions(x)
    arm = arms_from(x, about)
    along = direction("along", along, x)
    span = above_zero("length", length, x)
    normal = axis_for(axis, x)
    if x.shape[1] == 3 and is_known(normal, along) and abs(np.vdot(normal, along)) > RIGHT_ANGLE:
        raise ValueError(
            "`axis` and `along` must be at right angles; their cosine is "
            f"{float(normal @ along):.3g}."
        )
    up = jnp.cross(normal, jnp.pad(along, (0, 3 - len(along))))[: len(along)]
    curvature = one_number("angle", angle, x) / span
    forward, upward = _onto_arc(arm @ along, arm @ up, span, curvature)
    return x + forward[:, None] * along[None, :] + upward[:, None] * up[None, :]


def _onto_arc(reach: Array, height: Array, span: Array, curvature: Array) -> tuple[Array, Array]:
    """How far places go forward and upward as a line of length `span` is bent."""
    s = clamp(reach, 0, span)
    turned = curvature * s
    beyond = reach - s
    versine = 2 * jnp.sin(turned / 2) ** 2
    # the arc's chord: s sin(a) / a forward, s (1 - cos a) / a upward, exact at a = 0
    forward = s * (jnp.sinc(turned / jnp.pi) - 1) - height * jnp.sin(turned) - beyond * versine
    upward = (
        s * jnp.sin(turned / 2) * jnp.sinc(turned / 2 / jnp.pi)
        - height * versine
        + beyond * jnp.sin(turned)
    )
    return forward, upward


def _rotate_arms(arm: Positions, angle: Array, axis: Float[Array, " 3"]) -> Positions:
    d = arm.shape[1]
    arm = jnp.pad(arm, ((0, 0), (0, 3 - d)))
    axis = jnp.broadcast_to(axis, arm.shape)
    across = jnp.cross(axis, arm)
    return (jnp.sin(angle) * across + 2 * jnp.sin(angle / 2) ** 2 * jnp.cross(axis, across))[:, :d]


NEUTRAL = {"twist": 0.0, "chord": 1.0, "sweep": 0.0, "dihedral": 0.0, "span": 0.0}


class ReferenceAxis(AbstractShape):
    """Moves sections of a wing with stations of an axis: twisted, scaled and carried.

    The parameters are a dict with any of these, one value for each station (k,):

    - `twist`: radians about the direction of the span, in the sense of `rotate`; 0 is neutral.
    - `chord`: factor of a section's size around the axis; 1 is neutral. A taper falls to the tip.
    - `sweep`, `dihedral`, `span`: lengths by which a station moves along the chord, across chord
      and span, and along the span.

    Values are interpolated between stations, and constant before the first and behind the last.

    **Arguments:**

    - `points`: (k, 3) stations on the axis, from root to tip.
    - `chordwise`, `spanwise`: directions (3,) at right angles; the axes x and y by default.
    - `cubic`: natural cubic splines of values and axis between stations, not straight lines.

    **Raises:** `ValueError` for fewer than two stations, stations that do not advance along the
    span, and wrong parameters.
    """

    points: Float[Array, "k 3"]
    chordwise: Vector
    spanwise: Vector
    # of the weights of stations, by power of the distance from one
    coefficients: tuple[Float[Array, "j k"], ...]

    @checked
    def __init__(
        self,
        points: Numbers,
        *,
        chordwise: Numbers = (1.0, 0.0, 0.0),
        spanwise: Numbers = (0.0, 1.0, 0.0),
        cubic: bool = False,
    ):
        known = finite_array("points", points, (None, 3))
        along = _unit_vector("chordwise", chordwise)
        across = _unit_vector("spanwise", spanwise)
        if not abs(along @ across) <= LEVEL:
            raise ValueError(
                "`chordwise` and `spanwise` must be directions at right angles; their cosine is "
                f"{along @ across:.3g}."
            )
        if len(known) < 2:
            raise ValueError(f"`points` has shape {known.shape}; expected (k, 3), k >= 2.")
        stations = known @ across
        steps = np.diff(stations)
        if not (steps > 0).all():
            raise ValueError(
                f"station {int(np.argmin(steps)) + 1} is not farther along the span than the one "
                "before."
            )
        self.points = jnp.asarray(known)
        self.chordwise = jnp.asarray(along)
        self.spanwise = jnp.asarray(across)
        from scipy.interpolate import make_interp_spline  # not before it is needed

        degree = 3 if cubic else 1
        ends = "natural" if cubic else None
        spline = make_interp_spline(stations, np.eye(len(known)), degree, bc_type=ends)
        terms = [spline(stations[:-1], p) / math.factorial(p) for p in range(degree + 1)]
        self.coefficients = tuple(map(jnp.asarray, terms))

    def neutral(self) -> dict[str, Vector]:
        return {name: jnp.full(len(self.points), value) for name, value in NEUTRAL.items()}

    def __call__(self, x: Numbers, parameters: Mapping[str, Any]) -> Positions:
        x = positions(x)
        needed = self.points.shape[:1]
        shapes = {name: np.shape(values) for name, values in parameters.items()}
        if x.shape[1] != 3 or set(shapes.values()) - {needed} or not set(shapes) <= set(NEUTRAL):
            raise ValueError(
                f"`x` has shape {x.shape}, parameters have {shapes}: expected (m, 3), and {needed} "
                f"for any of {', '.join(NEUTRAL)}."
            )
        own = cast(self, x)
        weights = self.weights(x)
        given = self.neutral() | dict(parameters)
        twist, chord, sweep, dihedral, span = (
            (weights @ (jnp.asarray(given[name], x.dtype) - rest))[:, None]
            for name, rest in NEUTRAL.items()
        )
        chordwise = own.chordwise[None, :]
        spanwise = own.spanwise[None, :]
        arm = x - weights @ own.points
        arm = arm - (arm @ own.spanwise)[:, None] * spanwise
        growth = chord * arm
        turn = _rotate_arms(arm + growth, twist, own.spanwise)
        upward = jnp.cross(chordwise, spanwise)
        return x + (growth + turn + sweep * chordwise + dihedral * upward + span * spanwise)

    def weights(self, x: Positions) -> ShapeWeights:
        """Computes the weight of each station at each position, by its place along the span."""
        stations = (self.points @ self.spanwise).astype(x.dtype)
        y = clamp(x @ self.spanwise.astype(x.dtype), stations[0], stations[-1])
        return piecewise(y, stations, self.coefficients)


def _unit_vector(name: str, values: Numbers) -> Float[ndarray, " 3"]:
    known = finite_array(name, values, (3,))
    return known / np.linalg.norm(known)
