"""Searches for nodes near points, and a check that they hold on a new base."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

SLACK = 0.05
"""Share of a radius by which a search goes beyond it.

Where a new base differs by less than half of it, no other pairs are looked at.
"""


class Searched(eqx.Module):
    """Base coordinates in which nodes within a `distance` were searched for."""

    points: Float[Array, "n d"]
    surface: Float[Array, "b d"]
    distance: Float[Array, ""]

    def certain(
        self, radius: Float[Array, ""], surface: Float[Array, "b d"], points: Float[Array, "n d"]
    ) -> Bool[Array, ""]:
        """Checks whether the search surely found all nodes within a radius.

        The search reached `distance` on the old base, and nodes may have come nearer since.
        """
        shifts = surface - self.surface, points - self.points[: len(points)]  # images, which follow, are of the surface
        mean = shifts[0].mean(axis=0)
        shifts = [jnp.sqrt(jnp.sum((shift - mean[None]) ** 2, axis=1).max(initial=0)) for shift in shifts]
        nearer = shifts[0] + jnp.maximum(*shifts)
        return jax.lax.stop_gradient(radius + nearer <= self.distance)


def squared_distance(a: Float[Array, "*k d"], b: Float[Array, "*m d"]) -> Float[Array, "*n"]:
    """Computes squared distances without a derivative, component by component."""
    a, b = jax.lax.stop_gradient((a, b))
    first, *others = ((a[..., axis] - b[..., axis]) ** 2 for axis in range(a.shape[-1]))
    return sum(others, start=first)
