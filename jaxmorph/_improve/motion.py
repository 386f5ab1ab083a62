"""The energy that `improve` minimises, by the motion of the free nodes; its second derivatives."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Integer

from .._host.cells.topology import CORNERS, DIMENSION
from .._quality import measures
from .._quality.distortion import Bounds, Target, energy, energy_of_cells, samples, stiffened
from .._quality.vector import Vector, corners
from .hessian import blocks
from .ways import Ways

SHIFT = 1e-12
"""Added to a Hessian's diagonal (order one): it may be singular where cells are inverted."""


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

        by_kind = self._by_edges(points, cell_energy, floor)
        for (kind, ids), derivatives in zip(self.cells.items(), by_kind, strict=True):
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

    def _by_edges(
        self, points: Float[Array, "n d"], energy: Callable, floor: Any
    ) -> list[Float[Array, "d d d d _s _k"]]:
        """Computes second derivatives by the edges of samples, type after type.

        Samples of all types are computed at once: one program for each type takes longer to
        compile.
        """
        rows, counts = [], [self.targets[kind].counts for kind in self.cells]
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            stretch = _stretch(measures.frames(kind, corners(points, ids)), goal)
            rows.append(([column.components for column in stretch], goal.inverse))
        joined = jax.tree.map(lambda *parts: jnp.concatenate([part.ravel() for part in parts])[None], *rows)
        every = blocks(energy, [Vector(column) for column in joined[0]], joined[1], floor)[..., 0, :]
        ends = np.cumsum([count.size for count in counts])[:-1]
        pairs = zip(jnp.split(every, ends, axis=-1), counts, strict=True)
        return [
            part.reshape(*part.shape[:4], *count.shape) * (count / len(count))[None, None, None, None]
            for part, count in pairs
        ]

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
