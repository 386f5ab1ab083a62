"""The way of a surface that turns as its displacement does: the nearest rotation, and the rest."""

import contextlib
import dataclasses
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real
from scipy.spatial.transform import Rotation

from .._host.linear.products import row_lengths
from .._host.package.arguments import checked, finite_array, whole
from .._host.tolerances import ROUND_PATCH, SAME
from .._kernels.values import Either

# angle of a motion in radians from which on its path turns, and round patches may slide
TURNS_FROM = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class Turn:
    """A displacement on the way that turns as it does: the nearest rotation, and the rest.

    - `u`: the displacements (m, d) at the end of the way.
    - `arms`: positions (m, 3) relative to a point on the axis of rotation, `centre` (3,).
    - `axis`: its direction (3,); z in 2-D.
    - `angle`: radians, from 0 to pi; 0 where less than 0.1: the way is then straight.
    """

    u: Float[np.ndarray, "m d"]
    arms: Float[np.ndarray, "m 3"]
    centre: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    angle: float

    @staticmethod
    @checked
    def of(x: Real[ArrayLike, "m d"], u: Real[ArrayLike, "m d"]) -> "Turn":
        """Finds the rotation (Kabsch, Acta Crystallographica A 32, 1976), on the host.

        **Arguments:**

        - `x`: positions (m, d) of the moving nodes, as `plan.moving_points`.
        - `u`: their displacements (m, d), in the unit of `x`.

        **Raises:** `ValueError` for `x` and `u` of different shapes, and what is not finite.
        """
        x = finite_array("x", x, (None, None))
        u = finite_array("u", u, x.shape)
        points = in_space(x)
        way = in_space(u)
        middle = points.mean(axis=0)
        mean = way.mean(axis=0)
        vector = _rotation(points - middle, points - middle + way - mean)
        angle = float(np.linalg.norm(vector))
        if angle <= TURNS_FROM:
            return Turn(u, points - middle, middle, np.array([0.0, 0.0, 1.0]), 0.0)
        change = np.eye(3) - Rotation.from_rotvec(vector).as_matrix()
        centre = middle + np.linalg.lstsq(change, mean, rcond=SAME)[0]
        return Turn(u, points - centre, centre, vector / angle, angle)

    def at(self, share: Any) -> Float[Either, "m d"]:
        """Computes the displacement (m, d) after a share of the way, 0 to 1: the `motion` of
        `fewest_steps`. Traced. The rotation goes on evenly, the rest in proportion.
        """
        d = self.u.shape[1]
        across = np.cross(self.axis, self.arms)
        inward = np.cross(self.axis, across)
        xp = jnp if isinstance(share, jax.Array) else np
        sine = xp.sin(share * self.angle) - share * np.sin(self.angle)
        versine = (1 - xp.cos(share * self.angle)) - share * (1 - np.cos(self.angle))
        return share * self.u + (sine * across + versine * inward)[:, :d].astype(self.u.dtype)

    def path(self, steps: int) -> Float[Array, "k m d"]:
        """Computes the displacements after equal steps, the `path` of `march`; the last is `u`.

        **Raises:** `ValueError` for fewer than one step.
        """
        whole("steps", steps)
        return jnp.stack(
            [*(self.at(step / steps) for step in range(1, steps)), jnp.asarray(self.u)]
        )

    def keeps(self, points: Real[ArrayLike, "k d"]) -> bool:
        """Whether the rotation takes a surface to itself: round about its axis, or flat across."""
        points = finite_array("points", points, (None, self.u.shape[1]))
        if not self.angle:
            return False
        arms = in_space(points) - self.centre
        height = arms @ self.axis
        radius = row_lengths(arms - height[:, None] * self.axis)
        slack = ROUND_PATCH * radius.max()
        return bool(np.ptp(radius) <= slack or (points.shape[1] == 3 and np.ptp(height) <= slack))


def _rotation(
    arms: Float[np.ndarray, "m 3"], moved: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "3"]:
    """The vector of the rotation: along the axis, radians long."""
    if not arms[:, 2].any() and not moved[:, 2].any():  # in a plane: never about an axis in it
        return np.array([0, 0, np.arctan2(np.cross(arms, moved)[:, 2].sum(), np.vdot(arms, moved))])
    with (
        contextlib.suppress(ValueError),
        warnings.catch_warnings(),
    ):  # nodes at one place, or on one line
        warnings.simplefilter("ignore")
        return Rotation.align_vectors(moved, arms)[0].as_rotvec()
    return np.zeros(3)


def in_space(points: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "k 3"]:
    return np.pad(points.astype(float), ((0, 0), (0, 3 - points.shape[1])))
