"""Newton's method for the distortion of a mesh: optimistix's line search, with Hessians made positive cell by cell."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from . import _cells
from ._distortion import Target, energy, energy_of_cells, samples
from ._host.newton import Pattern, solve
from ._host.topology import CORNERS
from ._vector import Vector, corners

SHIFT = 1e-8
"""Added to the diagonal of a Hessian in coordinates of order one, which may be singular where cells are inverted."""


class Distortion(eqx.Module):
    """The energy of a mesh over the free nodes' places y (n, d), in units of `scale` from where they started."""

    cells: dict[str, Int[Array, "k c"]]
    targets: dict[str, Target]
    scale: Float[Array, " n"]
    free: Bool[Array, " n"]
    softness: Float[Array, ""]
    size: float = eqx.field(static=True)

    def points(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Fixed nodes where `base` has them, bit for bit."""
        start = jax.lax.stop_gradient(base)
        return jnp.where(self.free[:, None], start + self.scale[:, None] * y, base)

    def __call__(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        points, total = self.points(y, base), jnp.zeros((), y.dtype)
        for kind, ids in self.cells.items():
            x, of = corners(points, ids), self.targets[kind]
            total += jnp.sum(energy_of_cells(kind, x, of, self.softness, self.size))
        return total

    def least(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        """Smallest determinant of T: negative where a cell is inverted."""
        points, least = self.points(y, base), []
        for kind, ids in self.cells.items():
            of = self.targets[kind]
            least.append(jnp.min(jnp.where(of.counts > 0, samples(kind, corners(points, ids), of)[1], 1)))
        return jnp.min(jnp.stack(least))

    def blocks(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, "pairs d d"]:
        """Second derivatives for each pair of corners of each cell, the negative ones of each sample left out."""
        points, parts = self.points(y, base), []
        moves = self.scale * self.free
        for kind, ids in self.cells.items():
            of, d = self.targets[kind], points.shape[1]
            gradients = _gradients(kind, of)  # (s, c, d, k)
            stretch = jnp.einsum("kca,scbk->skab", points[ids], gradients)
            curved = jax.vmap(jax.vmap(jax.hessian(self._of_stretch)))(stretch.reshape(*stretch.shape[:2], d * d))
            values, vectors = jnp.linalg.eigh(curved)
            values = jnp.maximum(values, 0) * (of.counts / len(of.counts))[..., None]
            positive = jnp.einsum("skip,skp,skjp->skij", vectors, values, vectors).reshape(
                *values.shape[:2], d, d, d, d
            )
            half = jnp.einsum("skabef,szfk->skabze", positive, gradients)
            whole = jnp.einsum("skabze,scbk->kczae", half, gradients)
            scale = moves[ids]
            whole = whole * (scale[:, :, None] * scale[:, None, :])[..., None, None]
            parts.append(whole.reshape(-1, d, d))
        return jnp.concatenate(parts)

    def _of_stretch(self, stretch: Float[Array, " dd"]) -> Float[Array, ""]:
        d = round(stretch.size**0.5)
        matrix = stretch.reshape(d, d)
        tau = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0] if d == 2 else _determinant(matrix)
        return energy(jnp.sum(stretch**2) / d, tau, self.softness, self.size, d)


def _determinant(m: Float[Array, "3 3"]) -> Float[Array, ""]:
    return jnp.dot(m[0], jnp.cross(m[1], m[2]))


def _gradients(kind: str, of: Target) -> Float[Array, "s c d k"]:
    """What each corner adds to T: T[a, b] = sum over corners c of x[c, a] gradients[s, c, b, k]."""
    one = np.eye(CORNERS[kind])
    dimension = len(of.inverse)
    edges = _cells.frames(kind, [Vector([jnp.asarray(row)] * dimension) for row in one])  # linear in the corners
    parts = [
        edge[0][:, :, None, None] * jnp.stack(row, axis=1)[:, None] for edge, row in zip(edges, of.inverse, strict=True)
    ]
    return sum(parts[1:], start=parts[0])


class _Inverse(lx.AbstractLinearOperator):
    """The inverse of a Hessian, applied on the host."""

    pattern: Pattern
    blocks: Float[Array, "pairs d d"]
    shift: Float[Array, " n"]
    structure: Any = eqx.field(static=True)

    def mv(self, vector):
        arguments = (*self.pattern, self.blocks, self.shift, vector)
        return jax.pure_callback(solve, self.structure, *arguments, vmap_method="sequential")

    def as_matrix(self):
        return jax.vmap(self.mv)(jnp.eye(self.in_size()).reshape(-1, *self.structure.shape)).reshape(self.in_size(), -1)

    def transpose(self):
        return self

    def in_structure(self):
        return self.structure

    def out_structure(self):
        return self.structure


@lx.is_symmetric.register(_Inverse)
def _(operator):
    return True


class ProjectedNewton(optx.AbstractQuasiNewton):
    """Newton's method with a Hessian whose negative curvature is left out sample by sample, so that each step descends.

    Teran et al., Robust quasistatic finite elements and flesh simulation, SCA 2005.
    """

    rtol: Any
    atol: Any
    norm: Callable
    distortion: Distortion
    base: Float[Array, "n d"]
    pattern: Pattern
    verbose: Callable
    use_inverse: bool = True
    descent: optx.AbstractDescent = optx.NewtonDescent()
    search: optx.AbstractSearch = optx.BacktrackingArmijo(slope=1e-4)

    def init_hessian(self, y, f, grad):
        pairs = len(self.pattern.block)
        return self._information(f, grad, jnp.zeros((pairs, y.shape[1], y.shape[1]), y.dtype)), None

    def update_hessian(self, y, y_eval, f_info, f_eval_info, hessian_update_state):
        blocks = self.distortion.blocks(y_eval, self.base)
        return self._information(f_eval_info.f, f_eval_info.grad, blocks), None

    def _information(self, f, grad, blocks):
        shift = jnp.where(self.distortion.free & (self.distortion.scale > 0), SHIFT, 1.0).astype(grad.dtype)
        inverse = _Inverse(self.pattern, blocks, shift, jax.ShapeDtypeStruct(grad.shape, grad.dtype))
        return optx.FunctionInfo.EvalGradHessianInv(f, grad, inverse)
