"""The energy of `improve` by the motion of the free nodes; its second derivatives."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Integer

from .._boundary.periodic import Pairing
from .._boundary.tracks import Track
from .._host.cells.topology import CORNERS, DIMENSION
from .._host.linear.products import determinant
from .._host.tolerances import SHIFT
from .._quality import measures
from .._quality.distortion import (
    Bounds,
    Target,
    energy,
    energy_of_cells,
    samples,
    stiffened,
    stretch,
)
from .._quality.vector import Vector, corner_points

Nodal = Float[Array, "n d"]  # a place, or a vector, of every node


class Ways(eqx.Module):
    """Leads nodes along walls, and the second node of a periodic pair, marked by `follows` (n,), as
    its first moves. `off` (n, d, d) are projections onto the normals of the walls where a node
    starts, zero for other nodes.
    """

    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]
    follows: Bool[Array, " n"]
    off: Float[Array, "n d d"]

    def at(self, start: Nodal) -> "Ways":
        off = jnp.zeros((*start.shape, start.shape[1]), start.dtype)
        for track in self.tracks:
            off = off.at[track.rows].set(track.off(start))
        return eqx.tree_at(lambda ways: ways.off, self, jax.lax.stop_gradient(off))

    @property
    def is_linear(self) -> bool:
        return all(track.is_linear for track in self.tracks)

    def __call__(self, start: Nodal, step: Nodal, change: Nodal) -> Nodal:
        """Turns steps into displacements from `start`. `change` is zero in value, and has the
        derivative of the starting places: a change off a wall, or a difference between partners,
        remains.
        """
        step = step - jnp.einsum("nab,nb->na", self.off, step, precision="highest")
        off_walls = jnp.zeros_like(change)
        for track in self.tracks:
            off_walls = off_walls + change - track.along(start, change)
            step = track.along(start, step)
        motion = step + off_walls - change
        for pairing in self.pairings:
            motion = pairing.led(motion)
        return motion + change

    def matched(self, start: Nodal, points: Nodal) -> Nodal:
        for pairing in self.pairings:
            points = pairing.matched(start, points)
        return points


class Distortion(eqx.Module):
    """A mesh's energy by the free nodes' motion y (n, d) from their start, in units of `scale`.
    `ways` lead the nodes of walls and periodic pairs. All samples stay within `bounds`.
    """

    cells: dict[str, Integer[Array, "_k _c"]]
    targets: dict[str, Target]
    scale: Float[Array, " n"]
    free: Bool[Array, " n"]
    softness: Float[Array, ""]
    ways: Ways
    size: float = eqx.field(static=True)
    bounds: Bounds | None = None

    def points(self, y: Nodal, base: Nodal) -> Nodal:
        """Places the nodes; fixed nodes stay at `base`, bit for bit."""
        start = jax.lax.stop_gradient(base)
        step = self.ways(start, self.scale[:, None] * y, base - start)
        return jnp.where(self.free[:, None], start + step, base)

    def __call__(self, y: Nodal, base: Nodal) -> Float[Array, ""]:
        return self._energy(self.points(y, base))

    def _energy(self, points: Nodal) -> Float[Array, ""]:
        total = jnp.zeros((), points.dtype)
        for kind, ids in self.cells.items():
            x = corner_points(points, ids)
            goal = self.targets[kind]
            total += jnp.sum(energy_of_cells(kind, x, goal, self.softness, self.size, self.bounds))
        return total

    def shift(self) -> Float[Array, " n"]:
        """The diagonal's term (n,): 1 for nodes at rest or led, `SHIFT` for others."""
        moves = self.free & (self.scale > 0) & ~self.ways.follows
        return jnp.where(moves, SHIFT, 1.0).astype(self.scale.dtype)

    def _samples(self, points: Nodal) -> tuple[Array, Array, Array]:
        """The mask of samples that count, |T|^2 / d and det T, of all types."""
        rows = []
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            squared, tau = samples(kind, corner_points(points, ids), goal)
            rows.append(jnp.stack([goal.counts, squared, tau]).reshape(3, -1))
        counts, squared, tau = jnp.concatenate(rows, axis=1)
        return counts > 0, squared, tau

    def least(self, y: Nodal, base: Nodal) -> Float[Array, ""]:
        counts, _, tau = self._samples(self.points(y, base))
        return jnp.min(jnp.where(counts, tau, 1))

    def worst(self, y: Nodal, base: Nodal) -> Float[Array, ""]:
        counts, squared, tau = self._samples(self.points(y, base))
        values = energy(squared, tau, self.softness, self.size, y.shape[1])
        return jnp.max(jnp.where(counts, values, 0), initial=0)

    def movable(self) -> "Distortion":
        """Leaves out samples whose nodes are all held: no motion lowers their distortion."""
        targets = {}
        for kind, ids in self.cells.items():
            moves = jnp.any(_corner_shares(kind) != 0, axis=2) @ self.free[ids].T
            targets[kind] = self.targets[kind]._replace(counts=self.targets[kind].counts * moves)
        return dataclasses.replace(self, targets=targets)

    def lost(self, points: Nodal) -> dict[str, Bool[Array, " _k"]]:
        """Marks the cells with an inverted sample whose nodes are all held, by type."""
        lost = {}
        movable = self.movable().targets
        for kind, ids in self.cells.items():
            is_held = (self.targets[kind].counts > 0) & (movable[kind].counts == 0)
            tau = samples(kind, corner_points(points, ids), self.targets[kind])[1]
            lost[kind] = jnp.any(is_held & (tau <= 0), axis=0)
        return lost

    def blocks(self, y: Nodal, base: Nodal, floor: Any = 0.0) -> Float[Array, "d d pairs"]:
        """Second derivatives by pairs of corners, or by nodes of `ways`; eigenvalues from
        `floor`.
        """
        # The stretch T = A W^-1 of a sample is linear in the corners. The last axis of the result
        # runs over cells fastest, then over the second corner z, then over the first corner c, type
        # after type: the order of `Pattern`.
        points = self.points(y, base)
        parts = []
        d = base.shape[1]
        # Derivatives of places by y, whose axis is the last; a partner moves by its first node's y.
        slopes = _derive_rows(lambda y: self.points(y, base), y)

        def of_sample(squared, tau):
            value = energy(squared, tau, self.softness, self.size, d)
            return value if self.bounds is None else stiffened(value, tau, self.bounds)

        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            share = _corner_shares(kind)
            slope = slopes[ids]
            matrices = _stack_all(stretch(kind, corner_points(points, ids), goal)).transpose(
                2, 3, 1, 0
            )
            second = (
                _convex(of_sample, matrices, floor)
                * (goal.counts / len(share))[..., None, None, None, None]
            )
            by_corner = jnp.einsum(
                "sce,ebsk->skcb", share, _stack_all(goal.inverse), precision="highest"
            )
            pairs = jnp.einsum(
                "skcb,skabfg,skzg->kcazf", by_corner, second, by_corner, precision="highest"
            )
            pairs = jnp.einsum("kcax,kcazf,kzfy->xyczk", slope, pairs, slope, precision="highest")
            parts.append(pairs.reshape(d, d, -1))
        parts.append(jnp.moveaxis(self._alone(y, base, floor), 0, 2))
        return jnp.concatenate(parts, axis=2)

    def _alone(self, y: Nodal, base: Nodal, floor: Any) -> Float[Array, "n d d"]:
        """Second derivatives of single nodes: one along normals, and walls' curvature."""
        added = self.ways.off
        if self.ways.is_linear:
            return added
        force = jax.grad(self._energy)(self.points(y, base))
        curved = _derive_rows(jax.grad(lambda y: jnp.sum(force * self.points(y, base))), y)
        return added + jnp.where(
            jnp.asarray(floor) < 0, (curved + jnp.swapaxes(curved, 1, 2)) / 2, 0
        )


def _convex(
    energy: Callable, stretch: Float[Array, "s k d d"], floor: Any
) -> Float[Array, "s k d d d d"]:
    """Second derivatives of energy(|T|^2 / d, det T) by entries of T, with eigenvalues from `floor`
    (Teran et al., Robust quasistatic finite elements and flesh simulation, SCA 2005).
    """
    d = stretch.shape[-1]
    hessian = jax.hessian(
        lambda entries: energy(jnp.sum(entries**2) / d, determinant(list(entries.reshape(d, d))))
    )
    values, vectors = jnp.linalg.eigh(jax.vmap(hessian)(stretch.reshape(-1, d * d)))
    scaled = vectors * jnp.maximum(values, floor)[:, None]
    return jnp.matmul(scaled, vectors.mT, precision="highest").reshape(*stretch.shape, d, d)


def _stack_all(rows: Any) -> Array:
    return jnp.stack(list(map(jnp.stack, rows)))


def _derive_rows(function: Callable, y: Nodal) -> Float[Array, "n d d"]:
    """Derivatives of a function row by row; the last axis is the axis of y."""
    axes = jnp.broadcast_to(jnp.eye(y.shape[1], dtype=y.dtype)[:, None], (y.shape[1], *y.shape))
    return jax.vmap(lambda axis: jax.jvp(function, (y,), (axis,))[1], out_axes=2)(axes)


def _corner_shares(kind: str) -> Float[Array, "s c e"]:
    """The corners' coefficients in all samples' edges: `frames` is linear in corners."""
    edges = measures.frames(kind, Vector([jnp.eye(CORNERS[kind])] * DIMENSION[kind]))
    return jnp.stack([edge[0] for edge in edges], axis=2)
