"""The rows of a surface with their images: planes and periodic pairs, traced."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._kernels.values import Either
from .periodic import Pairing
from .symmetry import Plane

OwnRows = Float[Array, "o d"]


class Images(eqx.Module):
    """The own rows of a surface in canonical order, extended by their images.

    Methods see extended rows alone: no result depends on how nodes are numbered. Extended row i is
    the image of own row `rows[i]` by the transform `kind[i]`: x -> `matrices` x + `shifts`. Kind 0
    is the identity. Own row j lies on plane k where `on_plane[j, k]`. `pairings` pair own rows;
    `powers[t, q]` is the power of periodic transform q in transform t.
    """

    normals: Float[Array, "p d"]
    origins: Float[Array, "p d"]
    on_plane: Bool[Array, "o p"]
    rows: Int[Array, " b"]
    kind: Int[Array, " b"]
    matrices: Float[Array, "t d d"]
    shifts: Float[Array, "t d"]
    powers: Int[Array, "t q"]
    pairings: tuple[Pairing, ...]
    # pairs of planes that meet at another than a right angle
    edges: tuple[tuple[int, int], ...] = eqx.field(static=True, default=())

    def at(self, pairings: Sequence[Pairing]) -> "Images":
        shifts = self.shifts
        moved = []
        for p, (old, new) in enumerate(zip(self.pairings, pairings, strict=True)):
            shift = jnp.asarray(new.shift, shifts.dtype)
            shifts = (
                shifts
                + self.powers[:, p, None] * (shift - jnp.asarray(old.shift, shifts.dtype))[None]
            )
            moved.append(dataclasses.replace(old, shift=shift))
        return dataclasses.replace(self, shifts=shifts, pairings=tuple(moved))

    def points(self, points: OwnRows) -> Float[Array, "b d"]:
        rows = self.vectors(points)
        return rows if len(self.shifts) == 1 else rows + self.shifts.astype(points.dtype)[self.kind]

    def vectors(self, u: OwnRows) -> Float[Array, "b d"]:
        if len(self.matrices) == 1:
            return u[self.rows]
        turns = self.matrices.astype(u.dtype)[self.kind]
        image = jnp.einsum("bij,bj->bi", turns, u[self.rows], precision="highest")
        return jnp.where(self.kind[:, None] == 0, u[self.rows], image)

    def kept(self, u: OwnRows) -> OwnRows:
        """Projects displacements: rows stay on their planes, and periodic pairs move alike."""
        u = self.within(u, self.on_plane)
        for pairing in self.pairings:
            u = pairing.alike(u)
        return u

    def within(self, u: Float[Array, "n d"], on_plane: Bool[Array, "n p"]) -> Float[Array, "n d"]:
        for is_on, normal in self.normals_of(on_plane):
            normal = normal.astype(u.dtype)
            u = jnp.where(is_on[:, None], u - (u @ normal)[:, None] * normal[None], u)
        return u

    def normals_of(self, on_plane: Bool[Either, "n p"]) -> list[tuple[Bool[Either, " n"], Array]]:
        """Lists rows (n,), and the unit normal along which they do not move, to apply in turn."""
        sides = [(on_plane[:, k], normal) for k, normal in enumerate(self.normals)]
        for first, second in self.edges:  # the second normal would bring back some of the first
            normal = self.normals[second]
            across = self.normals[first] - (self.normals[first] @ normal) * normal
            is_on = on_plane[:, first] & on_plane[:, second]
            sides.append((is_on, across / jnp.linalg.norm(across)))
        return sides

    @property
    def is_plain(self) -> bool:
        """True without planes and pairs: the rows are only in another order."""
        return not len(self.normals) and not self.pairings

    @property
    def planes(self) -> tuple[Plane, ...]:
        return tuple(Plane(self.normals[k], self.origins[k]) for k in range(len(self.normals)))
