"""Newton's method for a mesh's distortion: optimistix's line search, positive Hessians of cells."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Integer

from .._host.cells.topology import CORNERS, DIMENSION
from .._host.linear.hessians import Pattern, solve, solve_exactly
from .._kernels.callback import host_call
from .._quality import measures
from .._quality.distortion import Bounds, Target, energy, energy_of_cells, samples, stiffened
from .._quality.vector import Vector, corners
from .hessian import blocks
from .ways import Ways

SHIFT = 1e-12
"""Added to a Hessian's diagonal (order one): it may be singular where cells are inverted."""

NEAR = 1.0
"""Largest derivative (order one) at which the whole Hessian is taken: quadratic convergence."""


class Distortion(eqx.Module):
    """A mesh's energy by the free nodes' motion y (n, d) from their start, in units of `scale`.

    `ways` lead the nodes of walls and periodic pairs; None without walls and pairs. With `bounds`
    all samples stay within them.
    """

    cells: dict[str, Integer[Array, "_k _c"]]
    targets: dict[str, Target]
    scale: Float[Array, " n"]
    free: Bool[Array, " n"]
    softness: Float[Array, ""]
    ways: Ways | None
    size: float = eqx.field(static=True)
    bounds: Bounds | None = None

    def points(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Places the nodes; fixed nodes stay at `base`, bit for bit."""
        start, step = jax.lax.stop_gradient(base), self.scale[:, None] * y
        if self.ways is not None:
            step = self.ways(start, step, base - start)
        return jnp.where(self.free[:, None], start + step, base)

    def __call__(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        return self._energy(self.points(y, base))

    def _energy(self, points: Float[Array, "n d"]) -> Float[Array, ""]:
        total = jnp.zeros((), points.dtype)
        for kind, ids in self.cells.items():
            x, goal = corners(points, ids), self.targets[kind]
            total += jnp.sum(energy_of_cells(kind, x, goal, self.softness, self.size, self.bounds))
        return total

    def shift(self) -> Float[Array, " n"]:
        """Computes the diagonal's term (n,): 1 for nodes at rest or led, `SHIFT` for others."""
        moves = self.free & (self.scale > 0)
        moves = moves if self.ways is None else moves & ~self.ways.follows
        return jnp.where(moves, SHIFT, 1.0).astype(self.scale.dtype)

    def least(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        """Computes the smallest determinant of T: negative if a cell is inverted."""
        points, least = self.points(y, base), []
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            least.append(jnp.min(jnp.where(goal.counts > 0, samples(kind, corners(points, ids), goal)[1], 1)))
        return jnp.min(jnp.stack(least))

    def worst(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        """Computes the largest distortion of a sample, without stiffness."""
        points, worst = self.points(y, base), []
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            values = energy(*samples(kind, corners(points, ids), goal), self.softness, self.size, points.shape[1])
            worst.append(jnp.max(jnp.where(goal.counts > 0, values, 0), initial=0))
        return jnp.max(jnp.stack(worst))

    def movable(self) -> "Distortion":
        """Leaves out samples whose nodes are all held: no motion lowers their distortion."""
        targets = {}
        for kind, ids in self.cells.items():
            moves = jnp.any(_shares(kind) != 0, axis=2) @ self.free[ids].T
            targets[kind] = self.targets[kind]._replace(counts=self.targets[kind].counts * moves)
        return dataclasses.replace(self, targets=targets)

    def lost(self, points: Float[Array, "n d"]) -> dict[str, Bool[Array, " _k"]]:
        """Marks the cells with an inverted sample whose nodes are all held, by type."""
        movable, lost = self.movable().targets, {}
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            is_held = (goal.counts > 0) & (movable[kind].counts == 0)
            lost[kind] = jnp.any(is_held & (samples(kind, corners(points, ids), goal)[1] <= 0), axis=0)
        return lost

    def blocks(self, y: Float[Array, "n d"], base: Float[Array, "n d"], floor: Any = 0.0) -> Float[Array, "d d pairs"]:
        """Computes second derivatives for pairs of a cell's corners; with `ways`, of single nodes.

        The eigenvalues of a sample are at least `floor`.
        """
        # A sample has second derivatives by its edges. An edge is a sum of corners (`share`), which
        # gives derivatives by corners. The last axis of the result runs over cells fastest, then
        # over the second corner z, then over the first corner c, type after type: the order of
        # `Pattern`.
        points, parts = self.points(y, base), []
        moves, d = self.scale * self.free, base.shape[1]
        # Derivatives of places by y, whose axis is the last; a partner moves by its first node's y.
        slopes = None if self.ways is None else _columns(lambda y: self.points(y, base), y)

        def cell_energy(squared, tau):
            value = energy(squared, tau, self.softness, self.size, d)
            return value if self.bounds is None else stiffened(value, tau, self.bounds)

        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            edges = measures.frames(kind, corners(points, ids))
            derivatives = blocks(cell_energy, _stretch(edges, goal), goal.inverse, floor)
            derivatives = derivatives * (goal.counts / len(goal.counts))[None, None, None, None]
            share, scale = _shares(kind), moves[ids].T
            sums = jnp.einsum("sce,szf->czefs", share, share).reshape(scale.shape[0] ** 2, -1)
            whole = jnp.einsum("pq,abqk->abpk", sums, derivatives.reshape(d, d, -1, derivatives.shape[-1]))
            if slopes is None:
                whole = whole * (scale[:, None] * scale[None]).reshape(1, 1, -1, scale.shape[1])
            else:
                pairs, slope = whole.reshape(d, d, *scale.shape[:1] * 2, -1), slopes[ids]
                whole = jnp.einsum("kcxa,xycek,keyb->abcek", slope, pairs, slope, precision="highest")
            parts.append(whole.reshape(d, d, -1))
        if self.ways is not None:
            parts.append(jnp.moveaxis(self._alone(y, base, floor), 0, 2))
        return jnp.concatenate(parts, axis=2)

    def _alone(self, y: Float[Array, "n d"], base: Float[Array, "n d"], floor: Any) -> Float[Array, "n d d"]:
        """Computes second derivatives of single nodes: one along normals, and walls' curvature."""
        assert self.ways is not None
        added = self.ways.off
        if self.ways.is_linear:
            return added
        force = jax.grad(self._energy)(self.points(y, base))
        curved = _columns(jax.grad(lambda y: jnp.sum(force * self.points(y, base))), y)
        return added + jnp.where(jnp.asarray(floor) < 0, (curved + jnp.swapaxes(curved, 1, 2)) / 2, 0)


def _columns(function: Callable, y: Float[Array, "n d"]) -> Float[Array, "n d d"]:
    """Computes derivatives of a function row by row; the last axis is the axis of y."""

    def column(axis):
        return jax.jvp(function, (y,), (jnp.broadcast_to(axis, y.shape),))[1]

    return jax.vmap(column, out_axes=2)(jnp.eye(y.shape[1], dtype=y.dtype))


def _stretch(edges: list[Vector], goal: Target) -> list[Vector]:
    """Computes the columns of T = A W^-1; the columns of A are the edges."""
    columns = []
    for b in range(len(edges)):
        parts = [edge * row[b] for edge, row in zip(edges, goal.inverse, strict=True)]
        columns.append(sum(parts[1:], start=parts[0]))
    return columns


def _shares(kind: str) -> Float[Array, "s c e"]:
    """Computes the corners' coefficients in all samples' edges: `frames` is linear in corners."""
    edges = measures.frames(kind, [Vector([jnp.asarray(row)] * DIMENSION[kind]) for row in np.eye(CORNERS[kind])])
    return jnp.stack([edge[0] for edge in edges], axis=2)


def _on_host(solver: Callable, pattern: Pattern, blocks, shift, right: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """Calls a solver of `hessians` on the host, with a Hessian and a right side."""
    structure = jax.ShapeDtypeStruct(right.shape, right.dtype)
    return host_call(solver, structure, *pattern, blocks, shift, right)


class _Inverse(lx.AbstractLinearOperator):
    """The inverse of a Hessian, applied on the host."""

    pattern: Pattern
    blocks: Float[Array, "d d pairs"]
    shift: Float[Array, " n"]
    structure: Any = eqx.field(static=True)

    def mv(self, vector):
        return _on_host(solve, self.pattern, self.blocks, self.shift, vector)

    def as_matrix(self):
        return jax.vmap(self.mv)(jnp.eye(self.in_size()).reshape(-1, *self.structure.shape)).reshape(self.in_size(), -1)

    def transpose(self):
        return self

    def in_structure(self):
        return self.structure

    def out_structure(self):
        return self.structure


class HessianSolver(lx.AbstractLinearSolver):
    """A solver with the energy's Hessian at a minimum, on the host: implicit differentiation.

    Its operator is the derivative of the energy's gradient, as optimistix builds it.
    """

    distortion: Distortion
    base: Float[Array, "n d"]
    pattern: Pattern

    def init(self, operator, options):
        if not isinstance(operator, lx.JacobianLinearOperator):
            raise ValueError(
                f"the Hessian of an energy is a `JacobianLinearOperator`, not a {type(operator).__name__}."
            )
        return self.distortion.blocks(jax.lax.stop_gradient(operator.x), self.base, -jnp.inf)

    def compute(self, state, vector, options):
        solution = _on_host(solve_exactly, self.pattern, state, self.distortion.shift(), vector)
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


@lx.is_symmetric.register(_Inverse)
def _(operator):
    return True


class ProjectedNewton(optx.AbstractQuasiNewton):
    """Newton's method; far from a minimum without negative curvature, so that steps descend.

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
        return self._information(f, grad, jnp.zeros((y.shape[1], y.shape[1], pairs), y.dtype)), None

    def update_hessian(self, y, y_eval, f_info, f_eval_info, hessian_update_state):
        near = jnp.max(jnp.abs(f_eval_info.grad)) < NEAR
        blocks = self.distortion.blocks(y_eval, self.base, jnp.where(near, -jnp.inf, 0))
        return self._information(f_eval_info.f, f_eval_info.grad, blocks), None

    def _information(self, f, grad, blocks):
        inverse = _Inverse(self.pattern, blocks, self.distortion.shift(), jax.ShapeDtypeStruct(grad.shape, grad.dtype))
        return optx.FunctionInfo.EvalGradHessianInv(f, grad, inverse)
