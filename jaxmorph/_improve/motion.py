"""The energy of `improve` by the motion of the free nodes; its second derivatives."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Integer

from .._boundary.periodic import Pairing
from .._boundary.tracks import Track
from .._host.cells.topology import CORNERS, DIMENSION
from .._quality import measures
from .._quality.distortion import Bounds, Target, energy, energy_of_cells, samples, stiffened, stretch
from .._quality.vector import Vector, corners
from .hessian import blocks


class Ways(eqx.Module):
    """Leads nodes along walls, and the second node of a periodic pair, marked by `follows` (n,), as
    its first moves. `normals` (n, q, d) are unit vectors that span the normals of the walls where a
    node starts, filled up by zero vectors.
    """

    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]
    follows: Bool[Array, " n"]
    normals: Float[Array, "n q d"]

    def at(self, start: Float[Array, "n d"]) -> "Ways":
        n, d = start.shape
        normals = jnp.zeros((n, d - 1, d), start.dtype)
        for track in self.tracks:
            normals = normals.at[track.rows, : len(track.walls)].set(track.normals(start))
        return eqx.tree_at(lambda ways: ways.normals, self, jax.lax.stop_gradient(normals))

    @property
    def is_linear(self) -> bool:
        return all(track.is_linear for track in self.tracks)

    @property
    def off(self) -> Float[Array, "n d d"]:
        return jnp.einsum("nqa,nqb->nab", self.normals, self.normals, precision="highest")

    def __call__(
        self, start: Float[Array, "n d"], step: Float[Array, "n d"], change: Float[Array, "n d"]
    ) -> Float[Array, "n d"]:
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

    def matched(self, start: Float[Array, "n d"], points: Float[Array, "n d"]) -> Float[Array, "n d"]:
        for pairing in self.pairings:
            points = pairing.matched(start, points)
        return points


SHIFT = 1e-12  # added to a Hessian's diagonal (order one): it may be singular where cells are inverted


class Distortion(eqx.Module):
    """A mesh's energy by the free nodes' motion y (n, d) from their start, in units of `scale`.
    `ways` lead the nodes of walls and periodic pairs. All samples stay within `bounds`.
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
        """The diagonal's term (n,): 1 for nodes at rest or led, `SHIFT` for others."""
        moves = self.free & (self.scale > 0)
        moves = moves if self.ways is None else moves & ~self.ways.follows
        return jnp.where(moves, SHIFT, 1.0).astype(self.scale.dtype)

    def _samples(self, points: Float[Array, "n d"]) -> Iterator[tuple[str, Array, Array, Array]]:
        """Each type with the mask of samples that count, |T|^2 / d and det T."""
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            yield kind, goal.counts > 0, *samples(kind, corners(points, ids), goal)

    def least(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        rows = self._samples(self.points(y, base))
        return jnp.min(jnp.stack([jnp.min(jnp.where(counts, tau, 1)) for _, counts, _, tau in rows]))

    def worst(self, y: Float[Array, "n d"], base: Float[Array, "n d"]) -> Float[Array, ""]:
        worst = []
        for _, counts, squared, tau in self._samples(self.points(y, base)):
            values = energy(squared, tau, self.softness, self.size, y.shape[1])
            worst.append(jnp.max(jnp.where(counts, values, 0), initial=0))
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
        movable = self.movable().targets
        return {
            kind: jnp.any(counts & (movable[kind].counts == 0) & (tau <= 0), axis=0)
            for kind, counts, _, tau in self._samples(points)
        }

    def blocks(self, y: Float[Array, "n d"], base: Float[Array, "n d"], floor: Any = 0.0) -> Float[Array, "d d pairs"]:
        """Second derivatives by pairs of corners, or by nodes of `ways`; eigenvalues from
        `floor`.
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
        """Second derivatives by the edges of samples: of all types in one program."""
        rows, counts = [], [self.targets[kind].counts for kind in self.cells]
        for kind, ids in self.cells.items():
            goal = self.targets[kind]
            columns = stretch(kind, corners(points, ids), goal)
            rows.append(([tuple(column) for column in columns], goal.inverse))
        joined = jax.tree.map(lambda *parts: jnp.concatenate([part.ravel() for part in parts])[None], *rows)
        every = blocks(energy, list(map(Vector, joined[0])), joined[1], floor)[..., 0, :]
        ends = np.cumsum([count.size for count in counts])[:-1]
        pairs = zip(jnp.split(every, ends, axis=-1), counts, strict=True)
        return [
            part.reshape(*part.shape[:4], *count.shape) * (count / len(count))[None, None, None, None]
            for part, count in pairs
        ]

    def _alone(self, y: Float[Array, "n d"], base: Float[Array, "n d"], floor: Any) -> Float[Array, "n d d"]:
        """Second derivatives of single nodes: one along normals, and walls' curvature."""
        assert self.ways is not None
        added = self.ways.off
        if self.ways.is_linear:
            return added
        force = jax.grad(self._energy)(self.points(y, base))
        curved = _columns(jax.grad(lambda y: jnp.sum(force * self.points(y, base))), y)
        return added + jnp.where(jnp.asarray(floor) < 0, (curved + jnp.swapaxes(curved, 1, 2)) / 2, 0)


def _columns(function: Callable, y: Float[Array, "n d"]) -> Float[Array, "n d d"]:
    """Derivatives of a function row by row; the last axis is the axis of y."""

    def column(axis):
        return jax.jvp(function, (y,), (jnp.broadcast_to(axis, y.shape),))[1]

    return jax.vmap(column, out_axes=2)(jnp.eye(y.shape[1], dtype=y.dtype))


def _shares(kind: str) -> Float[Array, "s c e"]:
    """The corners' coefficients in all samples' edges: `frames` is linear in corners."""
    edges = measures.frames(kind, Vector([jnp.eye(CORNERS[kind])] * DIMENSION[kind]))
    return jnp.stack([edge[0] for edge in edges], axis=2)
