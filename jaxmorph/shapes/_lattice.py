"""The operator of a lattice: displacements of points from displacements of control points."""

import itertools
from typing import Any

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
        # a matrix product along the first direction, then weighted sums along other directions
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


def checked_counts(counts: Any, degree: Any, d: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Returns the numbers of control points and the degrees, one for each of d directions.

    Raises `ValueError` for numbers that make no lattice.
    """
    if any(int(count) != count for count in counts):
        raise ValueError(f"`counts` is {tuple(counts)}; expected whole numbers.")
    counts = tuple(int(count) for count in counts)
    if len(counts) != d or min(counts) < 2:
        raise ValueError(f"`counts` is {counts}; a box in {d}-D needs {d} numbers, 2 or more each.")
    degrees = (degree,) * d if degree is None or isinstance(degree, int) else tuple(degree)
    if len(degrees) != d:
        raise ValueError(f"`degree` has {len(degrees)} numbers; a box in {d}-D needs one, or {d}.")
    degrees = tuple(count - 1 if p is None else int(p) for p, count in zip(degrees, counts, strict=True))
    if any(not 1 <= p < count for p, count in zip(degrees, counts, strict=True)):
        raise ValueError(f"degrees {degrees} do not fit counts {counts}: each lies from 1 to count - 1.")
    return counts, degrees
