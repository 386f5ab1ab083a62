"""Walls along which nodes slide, traced: planes and surfaces of revolution."""

import abc

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._kernels.module import Module
from .._kernels.values import norm

ALONG_AXIS = 1e-7  # component of a unit normal that counts as zero: coordinates in files have few digits


class AbstractWall(Module):
    """A surface (a curve in 2-D) on which nodes stay."""

    @abc.abstractmethod
    def height(self, x: Float[Array, "k d"]) -> tuple[Float[Array, " k"], Float[Array, "k d"]]:
        """Measures signed distances of points from the wall, and their unit normals."""

    @property
    def is_flat(self) -> bool:
        """True for a plane, to which one step leads, linear in the point."""
        return False

    def distance(self, x: Float[Array, "k d"]) -> Float[Array, " k"]:
        return jnp.abs(self.height(x)[0])

    def at(self, points: Float[Array, "n d"]) -> "AbstractWall":
        """Moves the wall to other base points: the patch's own faces follow, a surface stays."""
        return self

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "AbstractWall":
        return self

    def has_end(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points at or beyond an end of the wall."""
        return np.zeros(len(x), dtype=bool)

    def is_apex(self, x: Float[np.ndarray, "k d"]) -> Bool[np.ndarray, " k"]:
        """Marks, on the host, the points of the wall without a normal: the apex of a cone."""
        return np.zeros(len(x), dtype=bool)


class Flat(AbstractWall):
    normal: Float[Array | np.ndarray, " d"]
    origin: Float[Array | np.ndarray, " d"]

    def height(self, x):
        normal = jnp.asarray(self.normal, x.dtype)
        above = jnp.matmul(x - jnp.asarray(self.origin, x.dtype)[None], normal, precision="highest")
        return above, jnp.broadcast_to(normal, x.shape)

    @property
    def is_flat(self) -> bool:
        return True


class Round(AbstractWall):
    """A circle in 2-D, a surface of revolution in 3-D, of straight or cubic profile."""

    axis: Float[Array | np.ndarray, " d"]  # direction, zero in 2-D
    origin: Float[Array | np.ndarray, " d"]  # a point on the axis
    line: Float[Array | np.ndarray, " 3"]  # (a, b, c): a z + b r = c, a^2 + b^2 = 1 at place z along the axis, radius r
    knots: Float[Array | np.ndarray, " l"] | None = None  # places along the axis; None for a line
    spline: Float[Array | np.ndarray, "4 k"] | None = None  # coefficients, cubic ones first; None for a line

    def height(self, x):
        axis = jnp.asarray(self.axis, x.dtype)
        arm = x - jnp.asarray(self.origin, x.dtype)[None]
        along = jnp.matmul(arm, axis, precision="highest")
        outward = arm - along[:, None] * axis[None]
        radius = norm(outward)
        outward = outward / jnp.where(radius > 0, radius, 1)[:, None]
        if self.spline is None or self.knots is None:
            a, b, c = (jnp.asarray(coefficient, x.dtype) for coefficient in self.line)
            above = a * along + b * radius - c
            a, b = jnp.broadcast_to(a, radius.shape), jnp.broadcast_to(b, radius.shape)
        else:
            knots, spline = jnp.asarray(self.knots, x.dtype), jnp.asarray(self.spline, x.dtype)
            piece = jnp.clip(jnp.searchsorted(knots, along, side="right") - 1, 0, spline.shape[1] - 1)
            t, (cubic, square, slope, value) = along - knots[piece], spline[:, piece]
            steep = slope + t * (2 * square + 3 * t * cubic)
            b = 1 / jnp.sqrt(1 + steep**2)
            a, above = -steep * b, (radius - value - t * (slope + t * (square + t * cubic))) * b
        return above, a[:, None] * axis[None] + b[:, None] * outward

    def has_end(self, x):
        if self.knots is None:
            return np.zeros(len(x), dtype=bool)
        along, slack = (x - np.asarray(self.origin)) @ np.asarray(self.axis), 1e-9 * float(np.ptp(self.knots))
        return (along < self.knots[0] - slack) | (along > self.knots[-1] + slack)

    def is_apex(self, x):
        axis, arm = np.asarray(self.axis), x - np.asarray(self.origin)
        is_disc = self.spline is None and abs(self.line[1]) < ALONG_AXIS
        if is_disc or not axis.any():
            return np.zeros(len(x), dtype=bool)
        radius = np.linalg.norm(arm - (arm @ axis)[:, None] * axis, axis=1)
        return radius <= ALONG_AXIS * np.ptp(x, axis=0).max()
