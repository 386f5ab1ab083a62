"""Place of an airfoil: its chord, and the nodes on its upper side."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._host.door import checked
from .._kernels.module import Module
from ._door import Numbers, check_finite, known_positions

WINDOW = 14
"""Nodes around each one by which the two sides of an airfoil are told apart."""


class Chord(Module):
    """The chord of an airfoil, from nose to tail, and the direction across it.

    **Arguments:**

    - `nose`, `tail`: points (d,), (0, 0) and (1, 0) by default.
    - `up`: direction (d,) across the chord; the chord turned to the left by default, needed in 3-D.

    **Raises:** `ValueError` for a chord without length, and for no `up` in 3-D.
    """

    nose: Float[Array, " d"]
    tail: Float[Array, " d"]
    up: Float[Array, " d"]

    @checked
    def __init__(self, nose: Numbers = (0.0, 0.0), tail: Numbers = (1.0, 0.0), up: Numbers | None = None):
        nose, tail = np.asarray(nose, float), np.asarray(tail, float)
        if nose.shape not in ((2,), (3,)) or nose.shape != tail.shape or (nose == tail).all():
            raise ValueError(f"a chord from {nose} to {tail}: expected two different points in 2-D or 3-D.")
        if up is None and len(nose) == 3:
            raise ValueError("`up` is missing: a chord in 3-D needs the direction across it.")
        check_finite(nose=nose, tail=tail, up=up)
        along = (tail - nose) / np.linalg.norm(tail - nose)
        across = np.array([-along[1], along[0]]) if up is None else np.asarray(up, float)
        if across.shape != nose.shape or not np.linalg.norm(across) > 0:
            raise ValueError(f"`up` is {across}; expected a direction ({len(nose)},).")
        self.nose, self.tail = jnp.asarray(nose), jnp.asarray(tail)
        self.up = jnp.asarray(across / np.linalg.norm(across))

    @property
    def length(self) -> Float[Array, ""]:
        """The distance from nose to tail."""
        return jnp.linalg.norm(self.tail - self.nose)

    def coordinates(self, x: Float[Array, "m d"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Computes the place along the chord (0 to 1) and the height across it (in the units of x) of positions."""
        chord = (self.tail - self.nose).astype(x.dtype)
        if chord.shape != x.shape[1:]:
            raise ValueError(f"positions in {x.shape[1]}-D and a chord in {len(chord)}-D.")
        arm = x - self.nose.astype(x.dtype)[None, :]
        return arm @ chord / (chord @ chord), arm @ self.up.astype(x.dtype)

    @staticmethod
    @checked
    def along(points: Numbers) -> "Chord":
        """Finds the chord of an airfoil in 2-D: the tail has the largest x, the nose is the node farthest from the tail.

        Nodes of a blunt tail, which share the largest x, give their mean. `points` are positions (m, 2).
        """
        known = known_positions(points, "points")
        last = known[:, 0].max()
        tail = known[known[:, 0] > last - 1e-9 * max(np.ptp(known[:, 0]), 1e-300)].mean(axis=0)
        return Chord(known[np.linalg.norm(known - tail, axis=1).argmax()], tail)


@checked
def upper_side(points: Numbers, chord: Chord | None = None) -> Bool[np.ndarray, " m"]:
    """Tells which nodes of an airfoil are above its mean line.

    Around each node, the mean line is the parabola closest to the nodes next to it along the chord, which lie on both sides.

    **Arguments:**

    - `points`: positions (m, d) of the airfoil's nodes.
    - `chord`: its chord. Default `Chord.along(points)`.

    **Returns:** booleans (m,).

    **Raises:** `ValueError` where all nodes would be on one side.
    """
    x = jnp.asarray(known_positions(points, "points"))
    t, height = (np.asarray(each) for each in (Chord.along(x) if chord is None else chord).coordinates(x))
    # in the angle along the chord, nodes are spread evenly where they crowd at nose and tail
    angle = np.arccos(np.clip(1 - 2 * t, -1, 1))
    order = np.argsort(angle, kind="stable")
    window = min(WINDOW, len(order))
    first = np.clip(np.arange(len(order)) - window // 2, 0, len(order) - window)
    near = order[first[:, None] + np.arange(window)]
    away = angle[near] - angle[order][:, None]
    powers = np.stack([np.ones_like(away), away, away**2], axis=-1)
    line = np.empty(len(order))
    line[order] = np.einsum("mij,mj->mi", np.linalg.pinv(powers), height[near])[:, 0]
    upper = height >= line
    if np.allclose(height, line, atol=1e-12 * np.ptp(t)) or upper.all() or not upper.any():
        raise ValueError(f"{len(t)} nodes do not show the two sides of an airfoil around its chord.")
    return upper
