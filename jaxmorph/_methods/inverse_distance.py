"""Inverse distance weighting (Luke, Collins and Blades, J. Comput. Phys. 231, 2012)."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._host.package.arguments import between, check_fields
from .._kernels.values import area_vectors, jax_arrays, largest, norm, root
from .base import AbstractField, AbstractMethod, Rows, Scalar, einsum, matmul, number, or_one
from .rbf.system import block_size, squared_distances
from .surface import Surface

AT_NODE = 1e-12  # distance, relative to the surface's extent, below which a point is at a node

Faces = Mapping[str, Int[Array, "k c"]]


class InverseDistanceIds(eqx.Module):
    faces: Faces
    moving: Int[Array, ""]


class InverseDistanceFactors(eqx.Module):
    area: Float[Array, " b"]
    extent: Scalar


class InverseDistance(AbstractMethod):
    """Moves each point by a mean of the surface's displacements, weighted by distance.

    The method is that of Luke, Collins and Blades (Journal of Computational Physics 231, 2012). The
    weight of node i is A_i ((L / r)^far + (alpha L / r)^near). A_i is its share of the boundary
    faces; without cells it is 1. L is the largest distance of a surface node from the middle of the
    moving nodes. There is no system to solve. IDWarp has the defaults of the weights, and
    `rotations=True`. With `rotations` each node also turns its surroundings, as its normal turns: a
    body that pitches keeps the cells around it. The normals come from the boundary faces, so
    `prepare` needs the mesh. The displacement is then not linear in `u` (`method.linear` says so).
    Derivatives are complete, at u = 0 too. A node's rotation about its own normal is not seen.

    **Arguments:**

    - `far`, `near`: exponents. Defaults 3 and 5.
    - `alpha`: share of L within which the nearest nodes prevail. Default 0.25.
    - `rotations`: whether nodes turn. Default False.

    **Raises:** `ValueError` for a number that is not positive, and in `prepare` for rotations
    without boundary faces.
    """

    far: float = eqx.field(static=True, default=3.0)
    near: float = eqx.field(static=True, default=5.0)
    alpha: Scalar = eqx.field(converter=number("alpha", 0), default=0.25)
    rotations: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        between("far", self.far, 0)
        between("near", self.near, 0)
        check_fields(self)

    @property
    def linear(self) -> bool:
        return not self.rotations

    def connect(self, surface: Surface, points):
        faces = {kind: ids for kind, ids in (surface.faces or {}).items() if len(ids)}
        if self.rotations and not faces:
            raise ValueError(
                "InverseDistance(rotations=True) needs the boundary faces: pass the mesh, "
                "prepare(mesh, ...), not points."
            )
        return InverseDistanceIds(**jax_arrays(faces=faces, moving=surface.moving)), None

    def fit(self, ids, surface, points):
        moves = jnp.arange(len(surface)) < ids.moving
        middle = jnp.sum(jnp.where(moves[:, None], surface, 0), axis=0) / ids.moving
        extent = root(largest(jnp.sum((surface - middle[None]) ** 2, axis=1)))
        area = (
            _nodal_areas(ids.faces, surface) if ids.faces else jnp.ones(len(surface), surface.dtype)
        )
        return InverseDistanceFactors(
            area, or_one(extent)
        )  # all nodes at one place: any length serves

    def field(self, ids, factors, surface, u):
        turns = _turns(ids.faces, surface, u) if self.rotations else None
        return InverseDistanceField(self, factors, surface, u, turns)


class InverseDistanceField(AbstractField):
    method: InverseDistance
    factors: InverseDistanceFactors
    surface: Rows
    u: Rows
    turns: Float[Array, "b d d"] | None

    @property
    def varying(self):
        return self.u, self.turns

    @property
    def block_size(self) -> int:
        return block_size(len(self.surface))

    def __call__(self, x, ids):
        return self.evaluate(x[None], ids)[0]

    def evaluate(self, points, ids):
        weights = self._weights(points)
        if self.turns is None:
            return matmul(weights, self.u)
        about = self.u - einsum("bij,bj->bi", self.turns, self.surface)
        turn = einsum("kb,bij->kij", weights, self.turns)
        turned = einsum("kij,kj->ki", turn, points)
        return matmul(weights, about) + turned

    def _weights(self, points: Float[Array, "k d"]) -> Float[Array, "k b"]:
        far = self.method.far
        near = self.method.near
        alpha = self.method.alpha.astype(points.dtype)
        extent = self.factors.extent
        squared = jnp.maximum(squared_distances(points, self.surface), (AT_NODE * extent) ** 2)
        least = jax.lax.stop_gradient(squared.min(axis=1, keepdims=True))
        ratio = least / squared
        bound = nearest_bound(self.method, points.dtype)
        local = alpha**near * jnp.minimum(extent**2 / least, bound) ** ((near - far) / 2)
        weights = self.factors.area[None] * (_power(ratio, far) + local * _power(ratio, near))
        return weights / weights.sum(axis=1, keepdims=True)


def nearest_bound(method: InverseDistance, dtype: Any) -> float:
    """The largest (L / r)^2 in the weight of the nearest nodes."""
    far = method.far
    near = method.near
    largest = float(jnp.finfo(dtype).max) ** 0.25  # squared in derivatives, and added up
    return largest ** (2 / (near - far)) if near > far else float("inf")


def _power(squared: Float[Array, "..."], exponent: float) -> Float[Array, "..."]:
    """Powers of a root; a whole power by products, many times faster."""
    if exponent != int(exponent):
        return squared ** (exponent / 2)
    whole = jax.lax.integer_pow(squared, int(exponent) // 2)
    return whole * jnp.sqrt(squared) if exponent % 2 else whole


def _nodal_normals(faces: Faces, surface: Rows) -> Rows:
    total = jnp.zeros_like(surface)
    for ids in faces.values():
        total = total.at[ids].add(area_vectors(surface[ids])[:, None])
    return total


def _nodal_areas(faces: Faces, surface: Rows) -> Float[Array, " b"]:
    """Each node's share of its faces; a node without any has the mean share."""
    total = jnp.zeros(len(surface), surface.dtype)
    for ids in faces.values():
        total = total.at[ids].add(norm(area_vectors(surface[ids]))[:, None] / ids.shape[1])
    return jnp.where(total > 0, total, total.mean())


def _turns(faces: Faces, surface: Rows, u: Rows) -> Float[Array, "b d d"]:
    # Normals are linear in 2-D, and quadratic in 3-D: N(x + u) = N(x) + N'(x) u + N(u). So their
    # change is zero, bit for bit, where u is.
    before, change = jax.jvp(lambda places: _nodal_normals(faces, places), (surface,), (u,))
    if surface.shape[1] == 3:
        change = change + _nodal_normals(faces, u)
    after = before + change
    squared = jnp.sum(before**2, axis=1) * jnp.sum(after**2, axis=1)
    is_known = squared > 0
    scale = jnp.where(is_known, 1 / jnp.sqrt(jnp.where(is_known, squared, 1)), 0)
    cosine = jnp.where(is_known, jnp.sum(before * after, axis=1) * scale, 1)
    opposite = 1 / jnp.maximum(1 + cosine, float(jnp.finfo(before.dtype).eps) ** 0.5)
    d = before.shape[1]
    before, change = (jnp.pad(rows, ((0, 0), (0, 3 - d))) for rows in (before, change))
    axis = jnp.cross(before, change) * scale[:, None]
    skew = jnp.cross(axis[:, None], jnp.eye(3, dtype=axis.dtype)[None]).swapaxes(1, 2)
    return (skew + matmul(skew, skew) * opposite[:, None, None])[:, :d, :d]
