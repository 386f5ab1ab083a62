"""The operator of a lattice: displacements of points from those of control points."""

import itertools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._arguments import Numbers
from ._shape import AbstractOperator
from ._spans import Blocks


class Rows(eqx.Module):
    """Weights of points, one array for each direction.

    A point takes part in `k` functions from `first` on.
    """

    weights: tuple[Float[Array, "m _"], ...]
    first: tuple[Int[Array, " m"], ...]
    counts: tuple[int, ...] = eqx.field(static=True)

    def sums(self, control: Float[Array, "n c"]) -> Float[Array, "m c"]:
        """Sums control displacements for each point."""
        if all(w.shape[1] == count for w, count in zip(self.weights, self.counts, strict=True)):
            return self._dense(control)
        total = jnp.zeros((len(self.weights[0]), control.shape[1]), control.dtype)
        for offsets in itertools.product(*(range(w.shape[1]) for w in self.weights)):
            row, weight = jnp.zeros_like(self.first[0]), jnp.ones_like(self.weights[0][:, 0])
            for offset, count, first, w in zip(offsets, self.counts, self.first, self.weights, strict=True):
                row, weight = row * count + first + offset, weight * w[:, offset]
            total = total + weight[:, None] * control[row]
        return total

    def _dense(self, control: Float[Array, "n c"]) -> Float[Array, "m c"]:
        # one matrix product along the first direction, then weighted sums along the others
        first, *others = self.weights
        values = (first @ control.reshape(self.counts[0], -1)).reshape(len(first), *self.counts[1:], control.shape[1])
        for w in others:
            values = jnp.einsum("mk,mk...->m...", w, values)
        return values


class LatticeOperator(AbstractOperator):
    """Computes displacements of points from control displacements; `free` may hold controls."""

    weights: Rows | Blocks
    free: Bool[Array, "..."] | None
    counts: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, parameters: Numbers) -> Float[Array, "m d"]:
        """Computes displacements (m, d) from the control points' displacements (*counts, d)."""
        control, d = jnp.asarray(parameters), len(self.counts)
        if control.shape != (*self.counts, d):
            raise ValueError(
                f"control displacements have shape {control.shape}; this lattice needs {(*self.counts, d)}."
            )
        if self.free is not None:
            control = jnp.where(self.free[..., None], control, 0)
        dtype = self.weights.inner.dtype if isinstance(self.weights, Blocks) else self.weights.weights[0].dtype
        return self.weights.sums(control.reshape(-1, d).astype(dtype))
