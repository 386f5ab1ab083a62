"""Walls along which nodes slide, traced: planes, surfaces of revolution, own faces."""

import abc
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._host.linear.products import row_lengths
from .._host.package.rounding import extent_of
from .._host.tolerances import ALONG_AXIS, END
from .._kernels.module import Module
from .._kernels.values import Either, area_vectors, norm
from .face_search import FaceSearch, Places

Vector = Float[Either, " d"]


class AbstractWall(Module):
    """A surface (a curve in 2-D) on which nodes stay."""

    @abc.abstractmethod
    def height(self, x: Places) -> tuple[Float[Array, " k"], Places]:
        """Measures signed distances of points from the wall, and their unit normals."""

    @property
    def is_flat(self) -> bool:
        """True for a plane, to which one step leads, linear in the point."""
        return False

    def distance(self, x: Places) -> Float[Array, " k"]:
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
    """A plane (a line in 2-D) that stays, or that of a patch's `own` faces, which it follows."""

    normal: Vector
    origin: Vector
    own: FaceSearch | None = None

    def height(self, x):
        normal = jnp.asarray(self.normal, x.dtype)
        above = jnp.matmul(x - jnp.asarray(self.origin, x.dtype)[None], normal, precision="highest")
        return above, jnp.broadcast_to(normal, x.shape)

    @property
    def is_flat(self) -> bool:
        return True

    def at(self, points):
        if self.own is None:
            return self
        own = self.own.at(points)
        patch = jnp.asarray(own.vertices)
        old = jnp.asarray(self.normal, points.dtype)
        areas = area_vectors(patch[jnp.asarray(own.faces)])
        # both sides of a baffle add up
        areas = areas * jnp.where(jnp.matmul(areas, old) < 0, -1, 1)[:, None]
        total = jnp.sum(areas, axis=0)
        normal = total / norm(total)
        # The usual wall is at right angles to an axis: an exact normal keeps the coordinate bit for
        # bit.
        sharp = jnp.where(jnp.abs(normal) < ALONG_AXIS, 0, normal)
        normal = normal + jax.lax.stop_gradient(sharp / norm(sharp) - normal)
        return Flat(normal, jnp.mean(patch, axis=0), own)

    def renumbered(self, place):
        return dataclasses.replace(self, own=self.own and self.own.renumbered(place))

    def has_end(self, x):
        if self.own is None:
            return super().has_end(x)
        normal = np.asarray(self.normal)
        extent = extent_of(np.asarray(self.own.vertices))
        inside = x - ((x - np.asarray(self.origin)) @ normal)[:, None] * normal
        return np.asarray(self.own.find(inside).distance > END * extent)


class Round(AbstractWall):
    """A circle in 2-D, a surface of revolution in 3-D: radii are cubic in places along the axis."""

    axis: Vector  # direction, zero in 2-D
    origin: Vector  # a point on the axis
    knots: Float[
        Either, " l"
    ]  # places along the axis; of one straight piece without ends 0 and infinity
    spline: Float[Either, "4 k"]  # coefficients of the radius, cubic ones first

    @property
    def is_straight(self) -> bool:
        """True for one piece, a circle, cylinder or cone, to which one step leads."""
        return len(self.knots) == 2

    def height(self, x):
        axis = jnp.asarray(self.axis, x.dtype)
        arm = x - jnp.asarray(self.origin, x.dtype)[None]
        along = jnp.matmul(arm, axis, precision="highest")
        outward = arm - along[:, None] * axis[None]
        radius = norm(outward)
        outward = outward / jnp.where(radius > 0, radius, 1)[:, None]
        knots = jnp.asarray(self.knots, x.dtype)
        spline = jnp.asarray(self.spline, x.dtype)
        piece = jnp.clip(jnp.searchsorted(knots, along, side="right") - 1, 0, spline.shape[1] - 1)
        t = along - knots[piece]
        cubic, square, slope, value = spline[:, piece]
        steep = slope + t * (2 * square + 3 * t * cubic)
        share = 1 / jnp.sqrt(1 + steep**2)
        above = (radius - value - t * (slope + t * (square + t * cubic))) * share
        return above, share[:, None] * (outward - steep[:, None] * axis[None])

    def has_end(self, x):
        along = (x - np.asarray(self.origin)) @ np.asarray(self.axis)
        low, *_, high = np.asarray(self.knots)
        slack = END * (high - low)
        return np.asarray((along < low - slack) | (along > high + slack))

    def is_apex(self, x):
        axis = np.asarray(self.axis)
        arm = x - np.asarray(self.origin)
        radius = row_lengths(arm - (arm @ axis)[:, None] * axis)
        return np.asarray(axis.any() & (radius <= ALONG_AXIS * extent_of(x)))


class OnFaces(AbstractWall):
    """The patch's own faces: flat, curved, or the smooth surface through their nodes."""

    own: FaceSearch

    def height(self, x):
        place, normal = self.own.closest(x)
        return jnp.sum((x - place) * normal, axis=1), normal

    def distance(self, x):
        return norm(x - self.own.closest(x)[0])

    def at(self, points):
        return OnFaces(self.own.at(points))

    def renumbered(self, place):
        return OnFaces(self.own.renumbered(place))

    def has_end(self, x):
        face, shares, _ = self.own.find(x)
        return np.asarray(((shares <= END) & self.own.at_rim()[face]).any(axis=1))
