"""Sums of control displacements, weighted with B-splines on clamped, equal knots over [0, 1].

Those of the highest degree are Bernstein polynomials. Many points are sorted by knot span into
blocks of one span. A block's points share their control points, so its sums are one small matrix
product. The operator and its transpose are two forms of one primitive. Both are gathers and
products, where XLA would turn a gather into a slow scatter.
"""

import functools
import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._kernels.linear import linear_primitive

BLOCK = 256
"""Points in a block, at most."""


def spans(t: Float[Array, " m"], count: int, degree: int) -> Int[Array, " m"]:
    """Finds the first of the `degree + 1` functions that are not zero at each t."""
    pieces = count - degree
    return jnp.clip(jnp.floor(t * pieces), 0, pieces - 1).astype(jnp.int32)


def values(t: Float[Array, " m"], first: Int[Array, " m"], count: int, degree: int) -> Float[Array, "m k"]:
    """Evaluates the `degree + 1` functions that are not zero at each t, from `first` on."""
    if degree == count - 1:
        return bernstein(t, degree)
    pieces = count - degree
    knot = lambda i: jnp.clip((first.astype(t.dtype) + i) / pieces, 0, 1)  # noqa: E731
    functions = [jnp.ones_like(t)]
    # Cox-de Boor: from one degree to the next, each function goes in two parts to its neighbours
    for p in range(1, degree + 1):
        raised = [jnp.zeros_like(t) for _ in range(p + 1)]
        for r, function in enumerate(functions):
            right, left = knot(r + 1), knot(r + 1 - p)
            part = function / (right - left)
            raised[r] = raised[r] + (right - t) * part
            raised[r + 1] = raised[r + 1] + (t - left) * part
        functions = raised
    return jnp.stack(functions, axis=1)


def bernstein(t: Float[Array, " m"], degree: int) -> Float[Array, "m k"]:
    """Evaluates the Bernstein polynomials of a degree."""
    powers, rest = [jnp.ones_like(t)], [jnp.ones_like(t)]
    for _ in range(degree):
        powers.append(powers[-1] * t)
        rest.append(rest[-1] * (1 - t))
    return jnp.stack([math.comb(degree, k) * powers[k] * rest[degree - k] for k in range(degree + 1)], axis=1)


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
        sums = (first @ control.reshape(self.counts[0], -1)).reshape(len(first), *self.counts[1:], control.shape[1])
        for w in others:
            sums = jnp.einsum("mk,mk...->m...", w, sums)
        return sums


class Blocks(eqx.Module):
    """Weights of points in k blocks of B points: one direction, and products of the rest.

    - `controls`: the flat ids of the control points of each span.
    - `span`: the span of each block.
    - `slot`: the place of each point in the flattened blocks.
    - `point`: the point in each place. Empty places have no weight.
    """

    outer: Float[Array, "k a B"]
    inner: Float[Array, "k B b"]
    controls: Int[Array, "s a b"]
    span: Int[Array, " k"]
    slot: Int[Array, " m"]
    point: Int[Array, " places"]

    @staticmethod
    def of(rows: Rows) -> "Blocks":
        """Sorts known rows by span, and lays out their weights."""
        # Points of one knot span share their control points. They fill whole blocks of `size`, so
        # that a block is one matrix product; the last block of a span has empty places at its end.
        # `outer` are the weights of the direction with the fewest weights, `inner` the products of
        # all others.
        known, counts = [np.asarray(w) for w in rows.weights], rows.counts
        shortest = int(np.argmin([w.shape[1] for w in known]))
        order = [shortest, *(axis for axis in range(len(counts)) if axis != shortest)]
        starts, of_point, sizes_of_span = np.unique(
            np.stack(rows.first), axis=1, return_inverse=True, return_counts=True
        )
        offsets = np.stack(np.meshgrid(*(np.arange(w.shape[1]) for w in known), indexing="ij"))
        ids = np.ravel_multi_index(tuple(starts[(...,) + (None,) * len(counts)] + offsets[:, None]), counts)
        ids = np.transpose(ids, (0, *(1 + axis for axis in order)))
        controls = ids.reshape(*ids.shape[:2], -1).astype(np.int32)
        size = int(np.clip(2 ** int(np.log2(sizes_of_span.mean())), 8, BLOCK))
        blocks = -(-sizes_of_span // size)
        begin = np.append(0, np.cumsum(blocks))[:-1] * size
        by_span = np.argsort(of_point.ravel(), kind="stable")
        first_of_span = np.append(0, np.cumsum(sizes_of_span))[:-1]
        rank = np.arange(len(by_span)) - np.repeat(first_of_span, sizes_of_span)
        slots, places = np.repeat(begin, sizes_of_span) + rank, int(blocks.sum()) * size
        slot, point = np.empty(len(by_span), np.int32), np.zeros(places, np.int32)
        slot[by_span], point[slots] = slots, by_span
        inner = known[order[1]]
        for axis in order[2:]:
            inner = (inner[:, :, None] * known[axis][:, None, :]).reshape(len(inner), -1)

        def in_blocks(weights):
            filled = np.zeros((places, weights.shape[1]), weights.dtype)
            filled[slots] = weights[by_span]
            return filled.reshape(-1, size, weights.shape[1])

        outer, inner = in_blocks(known[shortest]).swapaxes(1, 2), in_blocks(inner)
        span = np.repeat(np.arange(len(sizes_of_span), dtype=np.int32), blocks)
        return Blocks(*map(jnp.asarray, (outer, inner, controls, span, slot, point)))

    def sums(self, control: Float[Array, "n c"]) -> Float[Array, "m c"]:
        """Sums control displacements for each point."""
        return _sum_p.bind(control, *jax.tree.leaves(self), turned=False, count=len(control))


def _sum(values, *leaves, turned: bool, count: int):
    blocks = Blocks(*leaves)
    return _turned(values, blocks, count) if turned else _plain(values, blocks)


def _plain(control, blocks: Blocks):
    (k, a, size), b, c = blocks.outer.shape, blocks.inner.shape[2], control.shape[1]
    corners = control[blocks.controls].transpose(0, 2, 1, 3).reshape(len(blocks.controls), b, a * c)[blocks.span]
    sums = jax.lax.dot_general(blocks.inner, corners, (((2,), (1,)), ((0,), (0,))))
    total = functools.reduce(jnp.add, [blocks.outer[:, i, :, None] * sums[:, :, i * c : (i + 1) * c] for i in range(a)])
    return total.reshape(k * size, c).at[blocks.slot].get(mode="promise_in_bounds", unique_indices=True)


def _turned(cotangent, blocks: Blocks, count: int):
    # The transpose by blocks: cotangents of a block's points times both weights, summed over the
    # points by one product, then over the blocks of a span. Only the sums of spans are scattered,
    # to the control points.
    (k, a, size), b, c = blocks.outer.shape, blocks.inner.shape[2], cotangent.shape[1]
    columns = [cotangent[:, i].at[blocks.point].get(mode="promise_in_bounds").reshape(k, 1, size) for i in range(c)]
    parts = (blocks.outer[:, :, None, :] * jnp.stack(columns, axis=2)).reshape(k, a * c, size)
    sums = jax.lax.dot_general(parts, blocks.inner, (((2,), (1,)), ((0,), (0,)))).reshape(k, a * c * b)
    spans = jax.ops.segment_sum(sums, blocks.span, len(blocks.controls), indices_are_sorted=True)
    flat = spans.reshape(-1, a, c, b).swapaxes(2, 3).reshape(-1, c)
    return jnp.zeros((count, c), flat.dtype).at[blocks.controls.ravel()].add(flat)


_sum_p = linear_primitive(
    "jaxmorph_lattice_sum",
    _sum,
    rows=lambda outer, inner, controls, span, slot, point, *, turned, count: count if turned else slot.shape[0],
    turned=lambda *others, turned, count: (others, {"turned": not turned, "count": count}),
)
