"""A sparse operator from surface nodes to points, with its transpose as fast as itself.

XLA transposes a gather into a scatter, which is many times slower on a CPU. A linear primitive in
two forms, each the transpose of the other, avoids that.
"""

import weakref

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._host.linear.transpose import WIDTH, tabulate
from .._kernels.linear import linear_primitive
from .._kernels.values import as_jax
from .base import AbstractField
from .placing import AbstractPlacing


class Table(eqx.Module):
    """The entries of each column in the flattened weights (n, k), in the order of `tabulate`.

    `weights` are the entries themselves, gathered once per base mesh: the gather costs more than
    all else in a transpose.
    """

    entries: Int[Array, "r width"]
    owner: Int[Array, " r"]
    weights: Float[Array, "r width"]


class Interpolation(eqx.Module):
    """Interpolates points' displacements from surface nodes: weighted sums by a sparse operator.

    For one point, `nodes` and `weights` are (k,); for many (n, k), to which a table of the
    transpose may be added. A row or entry where `reached` is False is empty, whatever the
    coordinates.
    """

    nodes: Int[Array, "*n k"]
    weights: Float[Array, "*n k"]
    reached: Bool[Array, "..."] | None = None
    table: Table | None = None

    def with_table(self, count: int, parts: int) -> "Interpolation":
        """Adds a table for `count` surface nodes; the rows lie in `parts` equal shares. Host.

        A share's table has positions within the share. All tables have equally many rows.
        """
        if self.table is not None:
            return self
        # An interpolation is remade by each `jit` boundary, its array of weights is not. So the
        # array is the key. Its `id` may serve another array later: the weak reference drops the
        # entry first.
        key = id(self.weights), count, parts
        if key not in _made:
            _made[key] = self._tabled(count, parts), weakref.ref(self.weights, lambda _: _made.pop(key, None))
        return Interpolation(self.nodes, self.weights, self.reached, _made[key][0])

    def _tabled(self, count: int, parts: int) -> Table:
        nodes = np.asarray(self.nodes)
        reached = np.ones(len(nodes), dtype=bool) if self.reached is None else np.asarray(self.reached)
        size = -(-len(nodes) // parts)
        starts = [min(k * size, len(nodes) - size) for k in range(parts)]  # the last share overlaps the one before it
        shares = [slice(start, start + size) for start in starts]
        tables = [tabulate(nodes[share], reached[share], count) for share in shares]
        # all shares get tables of one length: rows that are added hold no entry, and belong to the
        # last column
        longest = _rounded(max(len(owner) for _, owner in tables))
        entries = [np.pad(table, ((0, longest - len(table)), (0, 0)), constant_values=-1) for table, _ in tables]
        owners = [np.pad(owner, (0, longest - len(owner)), constant_values=count - 1) for _, owner in tables]
        weights = np.asarray(self.weights)
        gathered = [np.where(at < 0, 0, weights[share].ravel()[at]) for at, share in zip(entries, shares, strict=True)]
        with jax.ensure_compile_time_eval():  # also where JAX traces a call with a plan that is known
            return Table(*as_jax([np.concatenate(part) for part in (entries, owners, gathered)]))

    def without_table(self) -> "Interpolation":
        """Drops the table: every leaf then has one row a point."""
        return Interpolation(self.nodes, self.weights, self.reached)

    def with_table_of(self, old: "Interpolation") -> "Interpolation":
        """Takes over the table of rows with equal ids, with the weights of these rows. Traced."""
        table = old.table
        if table is not None:
            gathered = jnp.where(table.entries < 0, 0, self.weights.ravel()[table.entries])
            table = Table(table.entries, table.owner, gathered)
        return Interpolation(self.nodes, self.weights, self.reached, table)


_made: dict[tuple[int, int, int], tuple[Table, weakref.ref]] = {}
"""Tables by the weights that they are of, each as long as these exist."""


class Reach(eqx.Module):
    """The nodes whose functions reach a point; an entry that is not `reached` is empty."""

    nodes: Int[Array, "*n k"]
    reached: Bool[Array, "*n k"]

    def weighted(self, weights: Float[Array, " k"]) -> Interpolation:
        """Interpolates one point with these values of the functions."""
        return Interpolation(self.nodes, jnp.where(self.reached, weights, 0), self.reached)


def _rounded(rows: int) -> int:
    """Rounds up by 3 % at most, so that similar parts of a mesh share compiled code."""
    step = 2 ** max(0, rows.bit_length() - 6)
    return -(-rows // step) * step


class InterpolatedField(AbstractField):
    """Interpolates displacements between surface nodes (eq. 8)."""

    method: AbstractPlacing
    factors: PyTree
    surface: Float[Array, "b d"]
    u: Float[Array, "b d"]

    @property
    def block_size(self) -> None:
        return None

    def __call__(self, x: Float[Array, " d"], ids: Interpolation | PyTree) -> Float[Array, " d"]:
        at = ids if isinstance(ids, Interpolation) else self.method.place(x, ids, self.factors, self.surface)
        return sum((at.weights[k] * self.u[i] for k, i in enumerate(at.nodes)), start=jnp.zeros_like(x))

    def evaluate(self, points, ids):
        return weighted_sum(ids, self.u) if isinstance(ids, Interpolation) else super().evaluate(points, ids)


def weighted_sum(rows: Interpolation, values: Float[Array, "b c"]) -> Float[Array, "n c"]:
    """Applies the operator to values at b surface nodes; without a table its transpose scatters."""
    table = rows.table
    if table is None:
        none = jnp.zeros((0, WIDTH), jnp.int32)
        table = Table(none, none[:, 0], jnp.zeros((0, WIDTH), rows.weights.dtype))
    ids = (rows.nodes, table.entries, table.owner)
    return _sum_p.bind(values, rows.weights, table.weights, *ids, turned=False, count=len(values))


def _sum(values, weights, *table, turned: bool, count: int):
    """Sums weights[i, k] values[nodes[i, k]] over k for each row i.

    `turned`, it computes the transpose, for each column j.
    """
    # The transpose by a scatter adds each entry to its column one by one. With a table, `tabulate`
    # has sorted the entries by column, in rows of fixed width. Each row is summed by gathers. The
    # rows of one column are neighbours, so that one sum over sorted segments adds them. Empty
    # places of the table have the weight 0.
    (sorted_weights, nodes, entries, owner), k = table, weights.shape[1]
    values = jax.lax.optimization_barrier(values)  # else what makes them is done again for each gather
    if not turned:
        return sum(weights[:, i, None] * _rows(values, nodes[:, i]) for i in range(k))
    if not len(owner):
        entries = (weights[..., None] * values[:, None]).reshape(-1, values.shape[1])
        return jnp.zeros((count, values.shape[1]), entries.dtype).at[nodes.ravel()].add(entries)
    points = [jax.lax.div(entries[:, i], jnp.int32(k)) for i in range(entries.shape[1])]  # 0 where there is no entry
    rows = sum(sorted_weights[:, i, None] * _rows(values, at) for i, at in enumerate(points))
    return jax.ops.segment_sum(rows, owner, count, indices_are_sorted=True)


def _rows(values: Float[Array, "b c"], ids: Int[Array, " n"]) -> Float[Array, "n c"]:
    """Gathers `values[ids]` for ids that are known to be rows."""
    return values.at[ids].get(mode="promise_in_bounds", wrap_negative_indices=False)


_sum_p = linear_primitive(
    "jaxmorph_sparse_sum",
    _sum,
    rows=lambda weights, *_, turned, count: count if turned else weights.shape[0],
    turned=lambda *others, turned, count: (others, {"turned": not turned, "count": count}),
)
