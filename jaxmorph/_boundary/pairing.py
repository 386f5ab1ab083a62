"""Pairs of nodes that move alike, and the transform that leads from one node to the other."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .symmetry import Plane

ALONG_AXIS = 1e-9
"""Component of a translation, relative to the largest component, that counts as zero."""


class Pairing(eqx.Module):
    """Pairs of nodes, and the transform x -> `matrix` x + `shift` from `first` to `second`.

    - `first`, `second` (q,): ids or rows of the nodes.
    - `alone` (s,): nodes on the axis of a rotation, which the transform does not move.
    - `keeps` (d, d): projection onto the vectors that the transform does not turn.
    - `turn`: number of sectors in a whole turn; 0 if no power of the transform is the identity.
    - `copies`: the number of images on either side; 0 for pairs that do no more than move alike.
    - `is_rotation`: whether the transform is a rotation.
    """

    first: Int[Array | np.ndarray, " q"]
    second: Int[Array | np.ndarray, " q"]
    alone: Int[Array | np.ndarray, " s"]
    matrix: Float[Array | np.ndarray, "d d"]
    shift: Float[Array | np.ndarray, " d"]
    keeps: Float[Array | np.ndarray, "d d"]
    turn: int = eqx.field(static=True)
    copies: int = eqx.field(static=True)
    is_rotation: bool = eqx.field(static=True)

    @property
    def nodes(self) -> np.ndarray:
        """All nodes of both patches, on the host."""
        return np.concatenate([self.first, self.second, self.alone])

    @property
    def powers(self) -> list[int]:
        """The powers of the transform that make images, the nearest first: 0, 1, -1, 2, ..."""
        powers = sorted(range(-self.copies, self.copies + 1), key=lambda k: (abs(k), -k))
        if not self.turn:
            return powers
        return list({k % self.turn: k for k in powers[::-1]}.values())[::-1]  # the nearest of equal images

    def power(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns matrix and shift of the k-th power of the transform, on the host."""
        matrix, shift = (self.matrix, self.shift) if k >= 0 else (self.matrix.T, -self.matrix.T @ self.shift)
        once = np.eye(len(shift) + 1)
        once[:-1, :-1], once[:-1, -1] = matrix, shift
        power = np.linalg.matrix_power(once, abs(k))
        return power[:-1, :-1], power[:-1, -1]

    @property
    def inverse(self) -> "Pairing":
        """The pairs in reverse, from `second` to `first`, on the host."""
        matrix, shift = self.power(-1)
        return dataclasses.replace(self, first=self.second, second=self.first, matrix=matrix, shift=shift)

    def renumbered(self, place: Int[np.ndarray, " n"]) -> "Pairing":
        """Renumbers node k to `place[k]`. Pairs with a node of place -1 are dropped."""
        first, second, alone = (place[np.asarray(nodes)] for nodes in (self.first, self.second, self.alone))
        is_complete = (first >= 0) & (second >= 0)
        first, second = first[is_complete], second[is_complete]
        return dataclasses.replace(self, first=first, second=second, alone=alone[alone >= 0])

    def at(self, points: Float[Array, "n d"]) -> "Pairing":
        """Moves pairs to other base points: translations follow, rotations stay. Traced."""
        if self.is_rotation:
            return self
        difference = points[self.second] - points[self.first]
        mean = jnp.mean(difference, axis=0)
        # The median is the value of most pairs, free of round-off; the mean has a smooth
        # derivative.
        shift = mean + jax.lax.stop_gradient(jnp.median(difference, axis=0) - mean)
        shift = jnp.where(jnp.abs(shift) < ALONG_AXIS * jnp.max(jnp.abs(shift)), 0, shift)
        return dataclasses.replace(self, shift=shift)

    def misses(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " q"]:
        """Measures, on the host, distances (q,) of second nodes from their partners' images."""
        return np.linalg.norm(points[self.first] @ self.matrix.T + self.shift - points[self.second], axis=1)

    def matched(self, base: Float[Array, "n d"], points: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Makes pairs match bit for bit if a translation does so at `base`. Traced."""
        if self.is_rotation:
            return points
        shift = jnp.asarray(self.shift, points.dtype)[None]
        matched = base[self.first] + shift == base[self.second]
        return points.at[self.second].set(jnp.where(matched, points[self.first] + shift, points[self.second]))

    def alike(self, u: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Makes displacements of a pair equal after the transform, by their mean. Traced."""
        matrix, keeps = jnp.asarray(self.matrix, u.dtype), jnp.asarray(self.keeps, u.dtype)
        mean = (u[self.first] + _product(u[self.second], matrix)) / 2
        u = u.at[self.first].set(mean).at[self.second].set(_product(mean, matrix.T))
        return u.at[self.alone].set(_product(u[self.alone], keeps)) if len(self.alone) else u

    def led(self, u: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Moves the second nodes as the first nodes move, after the transform. Traced."""
        return u.at[self.second].set(_product(u[self.first], jnp.asarray(self.matrix, u.dtype).T))


def _product(rows: Float[Array, "n d"], matrix: Float[Array, "d d"]) -> Float[Array, "n d"]:
    return jnp.matmul(rows, matrix, precision="highest")


def merged(pairings: Sequence[Pairing], size: float) -> tuple[Pairing, ...]:
    """Joins all pairings of one transform, such as the sides of a passage cut into patches."""
    # A list holds one pairing of every transform. A further pairing joins the entry with its own
    # transform; if an entry has the inverse transform, the pairing is turned round first.
    joined: list[Pairing] = []
    for pairing in pairings:
        matches = (
            (k, way)
            for k, other in enumerate(joined)
            for way in (pairing, pairing.inverse)
            if np.abs(way.matrix - other.matrix).max() < 1e-9 and np.abs(way.shift - other.shift).max() < 1e-6 * size
        )
        k, way = next(matches, (None, pairing))
        if k is None:
            joined.append(pairing)
        else:
            joined[k] = _union(joined[k], way)
    return tuple(joined)


def _union(one: Pairing, other: Pairing) -> Pairing:
    pairs = [np.stack([pairing.first, pairing.second], axis=1) for pairing in (one, other)]
    first, second = np.unique(np.concatenate(pairs), axis=0).T
    alone, copies = np.unique(np.concatenate([one.alone, other.alone])), max(one.copies, other.copies)
    return dataclasses.replace(one, first=first, second=second, alone=alone, copies=copies)


def check_pairings(pairings: Sequence[Pairing], planes: Sequence[Plane], size: float) -> None:
    """Raises `ValueError` for transforms that turn a symmetry plane, or that do not commute.

    Pairs without images may lie across a plane.
    """
    pairings = [pairing for pairing in pairings if pairing.copies]
    for k, pairing in enumerate(pairings):
        for normal in (plane.normal for plane in planes):
            along = pairing.matrix @ normal
            if np.abs(along - normal).max() > 1e-9 or abs(normal @ pairing.shift) > 1e-9 * size:
                raise ValueError(
                    f"a periodic transform moves the symmetry plane with normal {normal.tolist()}: the plane must be parallel to "
                    "the translation, or at right angles to the rotation's axis."
                )
        for other in pairings[:k]:
            there = pairing.matrix @ other.shift + pairing.shift - other.matrix @ pairing.shift - other.shift
            back = pairing.matrix @ other.matrix - other.matrix @ pairing.matrix
            if np.abs(there).max() > 1e-6 * size or np.abs(back).max() > 1e-6:
                raise ValueError("two periodic transforms must commute: all rotations need one axis.")
