"""A rigid motion of the body that fades with distance.

Translation and rotation are blended along a great circle (slerp).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._host.package.rounding import nearest_of
from .._kernels.values import is_known, norm
from .base import AbstractField, AbstractMethod, length
from .surface import Surface

REFINED = 2
"""Newton steps after the eigenvector: its derivatives come from them."""


class RigidBlend(AbstractMethod):
    """Moves points near the moving surface rigidly with it, and less the farther they are.

    The rigid motion is the nearest one to the displacements, about the middle of the moving nodes.
    Its angle and translation are the body's up to `inner` from the nearest moving node, and zero
    from `outer` on. Between these distances they fade with the logarithm of the distance, which
    spreads the shear evenly over cells that grow with it.

    It is a coarse field, `SurfaceReconstruction(RigidBlend(0.25, 19.5), NearWall())`, for rotations
    by up to 180 degrees in one step. OpenFOAM's `sixDoFRigidBodyMotion` also moves meshes so, but
    fades with the distance. It is not linear in `u`. Several bodies count as one.

    **Arguments:**

    - `inner`, `outer`: distances in the mesh's units: about a quarter of the body, and where the
      fixed boundary begins.

    **Raises:** `ValueError` unless 0 < inner < outer. `prepare` raises it for moving nodes at one
    place, or in 3-D on one line.
    """

    inner: Float[Array, ""] = eqx.field(converter=length("inner"))
    outer: Float[Array, ""] = eqx.field(converter=length("outer"))

    def __check_init__(self):
        if is_known((self.inner, self.outer)) and not 0 < float(self.inner) < float(self.outer):
            raise ValueError(f"RigidBlend needs 0 < inner < outer, not {float(self.inner)} and {float(self.outer)}.")

    @property
    def exact(self) -> bool:
        return False

    @property
    def linear(self) -> bool:
        return False

    def connect(self, surface: Surface, points):
        moving = surface.points[: surface.moving].astype(float)
        extents = np.linalg.svd(moving - moving.mean(axis=0), compute_uv=False)
        if (extents > 1e-6 * max(1e-300, np.abs(moving).max())).sum() < moving.shape[1] - 1:
            where = "at one place" if moving.shape[1] == 2 else "on one line"
            raise ValueError(
                f"RigidBlend finds no rotation of {len(moving)} moving nodes {where}: take more of the body."
            )
        nearest = nearest_of(points, moving, np.arange(surface.moving, dtype=np.int32))
        return np.int32(surface.moving), nearest

    def fit(self, ids, surface, points):
        return None

    def field(self, ids, factors, surface, u):
        moves = (jnp.arange(len(surface)) < ids)[:, None]
        middle, translation = (jnp.sum(jnp.where(moves, rows, 0), axis=0) / ids for rows in (surface, u))
        arms = jnp.where(moves, surface - middle[None], 0)
        rest = jnp.where(moves, u - translation[None], 0)
        turn = _angle(arms, rest) if surface.shape[1] == 2 else _rotation_vector(arms, rest)
        return RigidField(self, surface, middle, translation, turn)


class RigidField(AbstractField):
    """Evaluates the blended motion.

    `turn` is the angle, or the rotation vector, about `middle`, which moves by `translation`.
    """

    method: RigidBlend
    surface: Float[Array, "b d"]
    middle: Float[Array, " d"]
    translation: Float[Array, " d"]
    turn: Float[Array, "..."]

    def __call__(self, x, ids):
        inner, outer = self.method.inner.astype(x.dtype), self.method.outer.astype(x.dtype)
        distance = jnp.clip(norm(x - self.surface[ids]), inner, outer)
        far = jnp.log(distance / inner) / jnp.log(outer / inner)
        share = 1 - far**2 * (3 - 2 * far)
        arm, turn = x - self.middle, share * self.turn
        if len(x) == 2:
            along, across = -2 * jnp.sin(turn / 2) ** 2, jnp.sin(turn)
            return share * self.translation + along * arm + across * jnp.stack([-arm[1], arm[0]])
        half = _sinc(jnp.sum(turn**2) / 4)
        once = jnp.cross(turn, arm)
        return share * self.translation + _sinc(jnp.sum(turn**2)) * once + half**2 / 2 * jnp.cross(turn, once)


def _sinc(squared: Float[Array, ""]) -> Float[Array, ""]:
    small = squared < 1e-6
    a = jnp.sqrt(jnp.where(small, 1, squared))
    return jnp.where(small, 1 - squared / 6 + squared**2 / 120, jnp.sin(a) / a)


def _angle(arms: Float[Array, "b 2"], u: Float[Array, "b 2"]) -> Float[Array, ""]:
    across = jnp.sum(arms[:, 0] * u[:, 1] - arms[:, 1] * u[:, 0])
    return jnp.arctan2(across, jnp.sum(arms**2) + jnp.sum(arms * u))


def _rotation_vector(arms: Float[Array, "b 3"], u: Float[Array, "b 3"]) -> Float[Array, "3"]:
    """Computes the rotation vector of the nearest rotation.

    Its quaternion is an eigenvector (Horn 1987).
    """
    size = jnp.sum(arms**2)
    spread = jnp.matmul(arms.T, arms + u, precision="highest") / size
    across = jnp.sum(jnp.cross(arms, u), axis=0) / size
    trace, one = jnp.trace(spread), jnp.eye(3, dtype=u.dtype)
    matrix = jnp.block([[trace[None, None], across[None]], [across[:, None], spread + spread.T - trace * one]])
    turn = jnp.linalg.eigh(jax.lax.stop_gradient(matrix))[1][:, -1]
    for _ in range(REFINED):
        value = jnp.sum(turn * jnp.sum(matrix * turn[None], axis=1))
        rest = jnp.sum(matrix * turn[None], axis=1) - value * turn
        system = value * jnp.eye(4, dtype=u.dtype) - matrix + turn[:, None] * turn[None]
        turn = turn + jnp.linalg.solve(system, rest)
        turn = turn / jnp.sqrt(jnp.sum(turn**2))
    turn = jnp.where(turn[0] < 0, -turn, turn)
    squared = jnp.sum(turn[1:] ** 2)
    small = squared < 1e-12
    sine = jnp.sqrt(jnp.where(small, 1, squared))
    return 2 * turn[1:] * jnp.where(small, 1 + squared / 6, jnp.arctan2(sine, turn[0]) / sine)
