"""A lattice's operator on many points: points sorted by the knot spans that hold them, in blocks of one span each.

A block's points share their control points, so its sums are one small matrix product. The operator
and its transpose are two forms of one primitive: each is gathers and products, where XLA would turn
a gather into a slow scatter.
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
    """Weights of points in blocks (k of B points): one direction apart, the products of the others.

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
        # Points of one knot span share their control points. They stand one after the other, in
        # whole blocks of `size`, so that a block is one matrix product; the places that the last
        # block of a span has left are empty. The direction with the fewest weights stays apart
        # (`outer`), the products of all others are `inner`.
        known, starts = [np.asarray(w) for w in weights], np.stack([np.asarray(each) for each in first])
        apart = int(np.argmin([w.shape[1] for w in known]))
        order = [apart, *(axis for axis in range(len(counts)) if axis != apart)]
        sizes = [known[axis].shape[1] for axis in order]
        spans, of_point, held = np.unique(starts, axis=1, return_inverse=True, return_counts=True)
        offsets = np.stack(np.meshgrid(*(np.arange(w.shape[1]) for w in known), indexing="ij"))
        ids = np.ravel_multi_index(tuple(spans[(...,) + (None,) * len(counts)] + offsets[:, None]), counts)
        controls = np.transpose(ids, (0, *(1 + axis for axis in order))).reshape(len(held), sizes[0], -1)
        size = int(np.clip(2 ** int(np.log2(held.mean())), 8, BLOCK))
        blocks = -(-held // size)
        begin = np.append(0, np.cumsum(blocks))[:-1] * size
        by_span = np.argsort(of_point.ravel(), kind="stable")
        rank = np.arange(len(by_span)) - np.repeat(np.append(0, np.cumsum(held))[:-1], held)
        slots, places = np.repeat(begin, held) + rank, int(blocks.sum()) * size
        slot, point = np.empty(len(by_span), np.int32), np.zeros(places, np.int32)
        slot[by_span], point[slots] = slots, by_span
        inner = known[order[1]]
        for axis in order[2:]:
            inner = (inner[:, :, None] * known[axis][:, None, :]).reshape(len(inner), -1)
        rows = [np.zeros((places, each.shape[1]), each.dtype) for each in (known[apart], inner)]
        rows[0][slots], rows[1][slots] = known[apart][by_span], inner[by_span]
        apart_rows, inner_rows = (each.reshape(-1, size, each.shape[1]) for each in rows)
        laid = jnp.asarray(apart_rows.swapaxes(1, 2)), jnp.asarray(inner_rows)
        span = np.repeat(np.arange(len(held), dtype=np.int32), blocks)
        ids = (jnp.asarray(each) for each in (controls.astype(np.int32), span, slot, point))
        return Blocks(*laid, *ids)

    def sums(self, control: Float[Array, "n c"]) -> Float[Array, "m c"]:
        """Sums control displacements for each point."""
        return _sum_p.bind(control, *jax.tree.leaves(self), turned=False, count=len(control))


def _sum(values, outer, inner, controls, span, slot, point, *, turned: bool, count: int):
    return (_turned if turned else _plain)(values, outer, inner, controls, span, slot, point, count)


def _plain(control, outer, inner, controls, span, slot, point, count):
    (k, a, size), b, c = outer.shape, inner.shape[2], control.shape[1]
    corners = control[controls].transpose(0, 2, 1, 3).reshape(len(controls), b, a * c)[span]
    sums = jax.lax.dot_general(inner, corners, (((2,), (1,)), ((0,), (0,))))
    total = functools.reduce(jnp.add, [outer[:, i, :, None] * sums[:, :, i * c : (i + 1) * c] for i in range(a)])
    return total.reshape(k * size, c).at[slot].get(mode="promise_in_bounds", unique_indices=True)


def _turned(cotangent, outer, inner, controls, span, slot, point, count):
    (k, a, size), b, c = outer.shape, inner.shape[2], cotangent.shape[1]
    columns = [cotangent[:, i].at[point].get(mode="promise_in_bounds").reshape(k, 1, size) for i in range(c)]
    parts = (outer[:, :, None, :] * jnp.stack(columns, axis=2)).reshape(k, a * c, size)
    sums = jax.lax.dot_general(parts, inner, (((2,), (1,)), ((0,), (0,)))).reshape(k, a * c * b)
    spans = jax.ops.segment_sum(sums, span, len(controls), indices_are_sorted=True)
    flat = spans.reshape(-1, a, c, b).swapaxes(2, 3).reshape(-1, c)
    return jnp.zeros((count, c), flat.dtype).at[controls.ravel()].add(flat)


_sum_p = linear_primitive(
    "jaxmorph_lattice_sum",
    _sum,
    rows=lambda outer, inner, controls, span, slot, point, *, turned, count: count if turned else slot.shape[0],
    turned=lambda *others, turned, count: (others, {"turned": not turned, "count": count}),
)
