"""Ways of boundary nodes that are not held: along planes and walls, and in step with their periodic partners."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._boundary.closest import Track
from .._boundary.periodic import Pairing


class Ways(eqx.Module):
    """Leads nodes along their walls, and the second node of a periodic pair as the first one goes.

    - `tracks`, `pairings`: of node ids.
    - `follows` (n,): which nodes are second ones.
    - `normals` (n, q, d): unit vectors at right angles off the walls, where the nodes start; zero for none.
    """

    tracks: tuple[Track, ...]
    pairings: tuple[Pairing, ...]
    follows: Bool[Array, " n"]
    normals: Float[Array, "n q d"]

    def at(self, start: Float[Array, "n d"]) -> "Ways":
        """Computes the ways of nodes that start elsewhere. Traced."""
        n, d = start.shape
        normals = jnp.zeros((n, d - 1, d), start.dtype)
        for track in self.tracks:
            normals = normals.at[track.rows, : len(track.walls)].set(track.normals(start))
        return eqx.tree_at(lambda ways: ways.normals, self, jax.lax.stop_gradient(normals))

    @property
    def is_linear(self) -> bool:
        """Checks whether all walls are flat."""
        return all(track.is_linear for track in self.tracks)

    @property
    def off(self) -> Float[Array, "n d d"]:
        """Projections on the normals."""
        return jnp.einsum("nqa,nqb->nab", self.normals, self.normals, precision="highest")

    def __call__(
        self, start: Float[Array, "n d"], step: Float[Array, "n d"], given: Float[Array, "n d"]
    ) -> Float[Array, "n d"]:
        """Turns steps into displacements from `start`.

        `given` is zero in value. Its derivative is that of the starting places: what leads off a wall, or apart from a
        partner, is kept.
        """
        step = step - jnp.einsum("nab,nb->na", self.off, step, precision="highest")
        kept = jnp.zeros_like(given)
        for track in self.tracks:
            kept = kept + given - track.along(start, given)
            step = track.along(start, step)
        apart = step + kept - given
        for pairing in self.pairings:
            apart = pairing.led(apart)
        return apart + given

    def matched(self, start: Float[Array, "n d"], points: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """Puts partners that match bit for bit at `start` there again."""
        for pairing in self.pairings:
            points = pairing.matched(start, points)
        return points
