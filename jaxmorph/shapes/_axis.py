"""A wing's planform along a reference axis: twist, chord, sweep, dihedral and span at stations."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.package.arguments import checked
from .._kernels.values import clipped
from ._arguments import Numbers, check_finite, positions
from ._rigid import turn
from ._shape import AbstractShape

NEUTRAL = {"twist": 0.0, "chord": 1.0, "sweep": 0.0, "dihedral": 0.0, "span": 0.0}
"""Values of a planform's parameters that change nothing."""


class ReferenceAxis(AbstractShape):
    """Moves sections of a wing with stations of an axis: twisted, scaled and carried.

    The parameters are a dict with any of these, one value for each station (k,):

    - `twist`: radians about the direction of the span at the axis, in the sense of `rotate`; 0 is
      neutral.
    - `chord`: factor of a section's size around the axis; 1 is neutral. A taper is a chord that
      falls from root to tip.
    - `sweep`, `dihedral`, `span`: lengths by which a station moves along the chord, across chord
      and span, and along the span.

    Between stations the values are interpolated. Before the first and behind the last station they
    are constant.

    **Arguments:**

    - `points`: (k, 3) stations on the axis, from root to tip; straight lines join them.
    - `chordwise`, `spanwise`: directions (3,) of chord and span, at right angles; the axes x and y
      by default.
    - `cubic`: natural cubic splines between stations instead of straight lines, for values and
      axis.

    **Raises:** `ValueError` for fewer than two stations, stations that do not advance along the
    span, and wrong parameters.
    """

    points: Float[Array, "k 3"]
    chordwise: Float[Array, " 3"]
    spanwise: Float[Array, " 3"]
    cubic: bool = eqx.field(static=True)

    @checked
    def __init__(
        self,
        points: Numbers,
        *,
        chordwise: Numbers = (1.0, 0.0, 0.0),
        spanwise: Numbers = (0.0, 1.0, 0.0),
        cubic: bool = False,
    ):
        known, along, across = np.asarray(points, float), np.asarray(chordwise, float), np.asarray(spanwise, float)
        check_finite(points=known, chordwise=along, spanwise=across)
        if along.shape != (3,) or across.shape != (3,) or not along.any() or not across.any():
            raise ValueError(f"`chordwise` is {along}, `spanwise` {across}; expected directions (3,).")
        along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
        if abs(along @ across) > 1e-9:
            raise ValueError(
                f"`chordwise` and `spanwise` must be at right angles; their cosine is {along @ across:.3g}."
            )
        if known.ndim != 2 or known.shape[1] != 3 or len(known) < 2:
            raise ValueError(f"`points` has shape {known.shape}; expected (k, 3), k >= 2.")
        self.points, self.chordwise, self.spanwise = jnp.asarray(known), jnp.asarray(along), jnp.asarray(across)
        self.cubic = cubic
        steps = np.diff(known @ across)
        if not (steps > 0).all():
            raise ValueError(f"station {int(np.argmin(steps)) + 1} is not farther along the span than the one before.")

    def neutral(self) -> dict[str, Float[Array, " k"]]:
        """Makes the parameters that move nothing."""
        return {name: jnp.full(len(self.points), value) for name, value in NEUTRAL.items()}

    def __call__(self, x: Numbers, parameters: Mapping[str, Any]) -> Float[Array, "m 3"]:
        """Moves positions (m, 3) by a dict of values at the stations."""
        x = positions(x)
        k = len(self.points)
        unknown = set(parameters) - set(NEUTRAL)
        shapes = {name: np.shape(values) for name, values in parameters.items() if np.shape(values) != (k,)}
        if x.shape[1] != 3 or unknown or shapes:
            raise ValueError(
                f"`x` has shape {x.shape}, parameters {', '.join(parameters)} of shapes {shapes or (k,)}: expected (m, 3), and "
                f"({k},) for any of {', '.join(NEUTRAL)}."
            )
        chord, span = self.chordwise.astype(x.dtype), self.spanwise.astype(x.dtype)
        up = jnp.cross(chord, span)
        weights = self.weights(x)
        at = {name: weights @ jnp.asarray(values, x.dtype) for name, values in parameters.items()}
        arm = x - weights @ self.points.astype(x.dtype)
        arm = arm - (arm @ span)[:, None] * span[None, :]
        added = jnp.zeros_like(x)
        if "chord" in at:
            added = (weights @ (jnp.asarray(parameters["chord"], x.dtype) - 1))[:, None] * arm
        if "twist" in at:
            added = added + turn(arm + added, at["twist"][:, None], span)
        for name, direction in (("sweep", chord), ("dihedral", up), ("span", span)):
            if name in at:
                added = added + at[name][:, None] * direction[None, :]
        return x + added

    def weights(self, x: Float[Array, "m 3"]) -> Float[Array, "m k"]:
        """Computes the weight of each station at each position, by its place along the span."""
        stations = (self.points @ self.spanwise).astype(x.dtype)
        y = clipped(x @ self.spanwise.astype(x.dtype), stations[0], stations[-1])
        steps = jnp.diff(stations)
        left = jnp.clip(jnp.searchsorted(stations, y, side="right") - 1, 0, len(steps) - 1)
        share = (y - stations[left]) / steps[left]
        k, size = len(stations), steps[left]
        identity = jnp.eye(k, dtype=x.dtype)
        weights = (1 - share)[:, None] * identity[left] + share[:, None] * identity[left + 1]
        if not self.cubic or k < 3:
            return weights
        curvature = _second_derivatives(steps)
        begin, end = ((1 - share) ** 3 - (1 - share)) * size**2 / 6, (share**3 - share) * size**2 / 6
        return weights + begin[:, None] * curvature[left] + end[:, None] * curvature[left + 1]


def _second_derivatives(steps: Float[Array, " j"]) -> Float[Array, "k k"]:
    """Computes the matrix from values at stations to second derivatives of a natural spline."""
    k = len(steps) + 1
    inner = jnp.arange(k - 2)
    system = jnp.zeros((k, k), steps.dtype).at[0, 0].set(1).at[-1, -1].set(1)
    system = system.at[inner + 1, inner].set(steps[:-1]).at[inner + 1, inner + 2].set(steps[1:])
    system = system.at[inner + 1, inner + 1].set(2 * (steps[:-1] + steps[1:]))
    right = (
        jnp.zeros((k, k), steps.dtype)
        .at[inner + 1, inner]
        .set(6 / steps[:-1])
        .at[inner + 1, inner + 2]
        .set(6 / steps[1:])
    )
    right = right.at[inner + 1, inner + 1].set(-6 / steps[:-1] - 6 / steps[1:])
    return jnp.linalg.solve(system, right)
