"""Ways of boundary nodes that are not held: along planes and walls, and with periodic partners."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._boundary.periodic import Pairing
from .._boundary.tracks import Track


class Ways(eqx.Module):
    """Leads nodes along walls, and the second node of a periodic pair as its first moves.

    - `tracks`, `pairings`: of node ids.
    - `follows` (n,): True for the second node of a pair.
    - `normals` (n, q, d): unit vectors that span the normals of the walls where a node starts; zero
      vectors fill up the list.
    """

    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]
    follows: Bool[Array, " n"]
    normals: Float[Array, "n q d"]

    def at(self, start: Float[Array, "n d"]) -> "Ways":
        """Computes the ways of nodes from other starting places. Traced."""
        n, d = start.shape
        normals = jnp.zeros((n, d - 1, d), start.dtype)
        for track in self.tracks:
            normals = normals.at[track.rows, : len(track.walls)].set(track.normals(start))
        return eqx.tree_at(lambda ways: ways.normals, self, jax.lax.stop_gradient(normals))

    @property
    def is_linear(self) -> bool:
        """True if all walls are flat."""
        return all(track.is_linear for track in self.tracks)

    @property
    def off(self) -> Float[Array, "n d d"]:
        """Projections onto the normals."""
        return jnp.einsum("nqa,nqb->nab", self.normals, self.normals, precision="highest")

    def __call__(
        self, start: Float[Array, "n d"], step: Float[Array, "n d"], change: Float[Array, "n d"]
    ) -> Float[Array, "n d"]:
        """Turns steps into displacements from `start`.

        `change` is zero in value, and carries the derivative of the starting places: a change off a
        wall, or a difference between partners, remains.
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
        """Makes pairs match bit for bit if they do so at `start`."""
        for pairing in self.pairings:
            points = pairing.matched(start, points)
        return points
