"""The operator of a lattice of control points: displacements of points from displacements of controls."""

import itertools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._shape import AbstractOperator


class LatticeOperator(AbstractOperator):
    """Sums control displacements with products of one weight for each direction.

    A point takes part in `degrees + 1` functions of each direction, from `first` on.
    """

    weights: tuple[Float[Array, "m k"], ...]
    first: tuple[Int[Array, " m"], ...]
    free: Bool[Array, "..."] | None
    counts: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, parameters: Float[Array, "..."]) -> Float[Array, "m d"]:
        """Computes displacements (m, d) from those of the control points (*counts, d)."""
        control = jnp.asarray(parameters, self.weights[0].dtype)
        d = len(self.counts)
        if control.shape != (*self.counts, d):
            raise ValueError(
                f"control displacements have shape {control.shape}; this lattice needs {(*self.counts, d)}."
            )
        if self.free is not None:
            control = jnp.where(self.free[..., None], control, 0)
        if all(w.shape[1] == count for w, count in zip(self.weights, self.counts, strict=True)):
            return self._dense(control)
        return self._local(control)

    def _dense(self, control: Float[Array, "..."]) -> Float[Array, "m d"]:
        # one matrix product along the first direction, then weighted sums along the others
        first, *others = self.weights
        values = (first @ control.reshape(self.counts[0], -1)).reshape(len(first), *control.shape[1:])
        for w in others:
            values = jnp.einsum("mk,mk...->m...", w, values)
        return values

    def _local(self, control: Float[Array, "..."]) -> Float[Array, "m d"]:
        flat = control.reshape(-1, control.shape[-1])
        total = jnp.zeros((len(self.weights[0]), control.shape[-1]), control.dtype)
        for offsets in itertools.product(*(range(w.shape[1]) for w in self.weights)):
            row, weight = jnp.zeros_like(self.first[0]), jnp.ones_like(self.weights[0][:, 0])
            for offset, count, first, w in zip(offsets, self.counts, self.first, self.weights, strict=True):
                row, weight = row * count + first + offset, weight * w[:, offset]
            total = total + weight[:, None] * flat[row]
        return total
