"""A lattice's operator on many points, sorted by knot span into blocks of one span.

A block's points share their control points, so its sums are one small matrix product. The operator
and its transpose are two forms of one primitive. Both are gathers and products, where XLA would
turn a gather into a slow scatter.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._kernels.linear import linear_primitive

BLOCK = 256
"""Points in a block, at most."""


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
    def sorted_by_span(weights: tuple[Array, ...], first: tuple[Array, ...], counts: tuple[int, ...]) -> "Blocks":
        """Sorts points by span and lays out their weights; needs known weights."""
        # Points of one knot span share their control points. They fill whole blocks of `size`, so
        # that a block is one matrix product; the last block of a span has empty places at its end.
        # `outer` are the weights of the direction with the fewest weights, `inner` the products of
        # all others.
        known, starts = [np.asarray(w) for w in weights], np.stack([np.asarray(start) for start in first])
        shortest = int(np.argmin([w.shape[1] for w in known]))
        order = [shortest, *(axis for axis in range(len(counts)) if axis != shortest)]
        sizes = [known[axis].shape[1] for axis in order]
        spans, of_point, sizes_of_span = np.unique(starts, axis=1, return_inverse=True, return_counts=True)
        offsets = np.stack(np.meshgrid(*(np.arange(w.shape[1]) for w in known), indexing="ij"))
        ids = np.ravel_multi_index(tuple(spans[(...,) + (None,) * len(counts)] + offsets[:, None]), counts)
        controls = np.transpose(ids, (0, *(1 + axis for axis in order))).reshape(len(sizes_of_span), sizes[0], -1)
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
            rows = np.zeros((places, weights.shape[1]), weights.dtype)
            rows[slots] = weights[by_span]
            return rows.reshape(-1, size, weights.shape[1])

        outer, inner = in_blocks(known[shortest]).swapaxes(1, 2), in_blocks(inner)
        span = np.repeat(np.arange(len(sizes_of_span), dtype=np.int32), blocks)
        return Blocks(*map(jnp.asarray, (outer, inner, controls.astype(np.int32), span, slot, point)))

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
