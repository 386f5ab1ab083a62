"""A sparse operator from surface nodes to points; XLA would transpose it to a slow scatter."""

import dataclasses
import weakref
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse import csr_array

from .._kernels.linear import linear_primitive
from .._kernels.values import as_jax, at_rows
from .base import AbstractWhole, Flag, Points, Rows, Scalar

WIDTH = 16  # entries in a row of the table


class Table(eqx.Module):
    """The entries of each column in the flattened weights (n, k), in the order of `tabulate`.
    `weights` are gathered once per base mesh: the gather costs more than all else in a transpose.
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

    def matrix(self, columns: int) -> csr_array:
        """Assembles the operator of many points. On the host."""
        weights = np.array(self.weights, float)
        if self.reached is not None:
            weights = np.where(np.asarray(self.reached).reshape(len(weights), -1), weights, 0)
        starts = np.arange(len(weights) + 1) * weights.shape[1]
        return csr_array(
            (weights.ravel(), np.array(self.nodes).ravel(), starts), (len(weights), columns)
        )

    def with_table(self, count: int, parts: int) -> "Interpolation":
        """Adds a table for `count` surface nodes; the rows lie in `parts` equal shares. Host."""
        if self.table is not None:
            return self
        # An interpolation is remade by each `jit` boundary, its array of weights is not: the array
        # is the key. Its `id` may serve another array later: the weak reference drops the entry
        # first.
        key = id(self.weights), count, parts
        if key not in _made:
            _made[key] = (
                self._tabled(count, parts),
                weakref.ref(self.weights, lambda _: _made.pop(key, None)),
            )
        return dataclasses.replace(self, table=_made[key][0])

    def _tabled(self, count: int, parts: int) -> Table:
        # A share's table has positions within the share. The last share overlaps the one before it.
        # All tables get one length: added rows hold no entry, and belong to the last column.
        nodes = np.asarray(self.nodes)
        weights = np.asarray(self.weights)
        reached = (
            np.ones(len(nodes), dtype=bool) if self.reached is None else np.asarray(self.reached)
        )
        size = -(-len(nodes) // parts)
        starts = [min(k * size, len(nodes) - size) for k in range(parts)]
        shares = [slice(start, start + size) for start in starts]
        tables = [tabulate(nodes[share], reached[share], count) for share in shares]
        longest = max(len(owner) for _, owner in tables)
        step = 2 ** max(0, longest.bit_length() - 6)
        longest = (
            -(-longest // step) * step
        )  # by 3 % at most, so that similar parts of a mesh share compiled code
        entries = [
            np.pad(table, ((0, longest - len(table)), (0, 0)), constant_values=-1)
            for table, _ in tables
        ]
        owners = [
            np.pad(owner, (0, longest - len(owner)), constant_values=count - 1)
            for _, owner in tables
        ]
        gathered = [
            np.where(at < 0, 0, weights[share].ravel()[at])
            for at, share in zip(entries, shares, strict=True)
        ]
        with (
            jax.ensure_compile_time_eval()
        ):  # also where JAX traces a call with a plan that is known
            return Table(*as_jax([np.concatenate(part) for part in (entries, owners, gathered)]))

    def without_table(self) -> "Interpolation":
        return dataclasses.replace(self, table=None)

    def with_table_of(self, old: "Interpolation") -> "Interpolation":
        table = old.table
        if table is None:
            return self.without_table()
        gathered = jnp.where(table.entries < 0, 0, self.weights.ravel()[table.entries])
        return dataclasses.replace(self, table=dataclasses.replace(table, weights=gathered))


_made: dict[
    tuple[int, int, int], tuple[Table, weakref.ref]
] = {}  # cache of the tables of arrays of weights


class Reach(eqx.Module):
    nodes: Int[Array, "*n k"]
    reached: Bool[Array, "*n k"]

    def weighted(self, weights: Float[Array, " k"], is_lost: Flag | bool = False) -> Interpolation:
        """Gives weights to the nodes; NaN where a node `is_lost`, which would belong to them."""
        weights = jnp.where(is_lost, jnp.nan, weights)
        return Interpolation(self.nodes, jnp.where(self.reached, weights, 0), self.reached)


class InterpolatedField(AbstractWhole):
    u: Rows

    def __call__(self, x, ids: Interpolation):
        return sum(
            (ids.weights[k] * self.u[i] for k, i in enumerate(ids.nodes)), start=jnp.zeros_like(x)
        )

    def evaluate(self, points, ids: Interpolation):
        return weighted_sum(ids, self.u)


def weighted_sum(rows: Interpolation, values: Float[Array, "b c"]) -> Float[Array, "n c"]:
    """Applies the operator to values at b surface nodes; without a table its transpose scatters."""
    table = rows.table
    if table is None:
        none = jnp.zeros((0, WIDTH), jnp.int32)
        table = Table(none, none[:, 0], jnp.zeros((0, WIDTH), rows.weights.dtype))
    ids = (rows.nodes, table.entries, table.owner)
    return _sum_p.bind(values, rows.weights, table.weights, *ids, turned=False, count=len(values))


def _sum(values, weights, *table, turned: bool, count: int):
    """Sums weights[i, k] values[nodes[i, k]] over k for each row i; `turned`, the transpose."""
    # The transpose by a scatter adds each entry to its column one by one. With a table, `tabulate`
    # has sorted the entries by column, in rows of fixed width. Each row is summed by gathers. The
    # rows of one column are neighbours, so that one sum over sorted segments adds them. Empty
    # places of the table have the weight 0.
    (sorted_weights, nodes, entries, owner), k = table, weights.shape[1]
    values = jax.lax.optimization_barrier(
        values
    )  # else what makes them is done again for each gather
    if not turned:
        return sum(weights[:, i, None] * at_rows(values, nodes[:, i]) for i in range(k))
    if not len(owner):
        entries = (weights[..., None] * values[:, None]).reshape(-1, values.shape[1])
        return jnp.zeros((count, values.shape[1]), entries.dtype).at[nodes.ravel()].add(entries)
    points = [
        jax.lax.div(entries[:, i], jnp.int32(k)) for i in range(entries.shape[1])
    ]  # 0 where there is no entry
    rows = sum(sorted_weights[:, i, None] * at_rows(values, at) for i, at in enumerate(points))
    return jax.ops.segment_sum(rows, owner, count, indices_are_sorted=True)


_sum_p = linear_primitive(
    "jaxmorph_sparse_sum",
    _sum,
    rows=lambda weights, *_, turned, count: count if turned else weights.shape[0],
    turned=lambda *others, turned, count: (others, {"turned": not turned, "count": count}),
)


def tabulate(nodes: np.ndarray, used: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Sorts the entries of a sparse operator by column, into rows of `WIDTH` entries.

    `nodes` are the columns of the entries, `used` a mask of rows (n,) or entries (n, k). Returns
    positions of `entries` (r, WIDTH) in the flattened (n, k), -1 for padding, and the `owner` (r,),
    the column of each row, ascending. Raises `ValueError` for more entries than 32 bits count.
    """
    # SciPy's counting sort orders the entries by column, faster than `numpy.argsort`. A column of s
    # entries fills ceil(s / WIDTH) rows of the table; its last row is padded. The shift of an entry
    # is the padding of all columns before its own.
    if nodes.size >= 2**31:
        raise ValueError(
            f"{len(nodes)} points are too many for one device; lay the plan over several with "
            "`shard`."
        )
    entries = np.flatnonzero(np.broadcast_to(used.reshape(len(nodes), -1), nodes.shape)).astype(
        np.int32
    )
    row = csr_array(
        (entries, nodes.ravel()[entries], np.array([0, len(entries)], np.int32)), shape=(1, count)
    ).tocsc()
    sizes = np.diff(row.indptr)
    lengths = -(-sizes // WIDTH)
    padding = WIDTH * lengths - sizes
    table = np.full(WIDTH * lengths.sum(), -1, dtype=np.int32)
    table[np.arange(len(entries)) + np.repeat(np.cumsum(padding) - padding, sizes)] = row.data
    return table.reshape(-1, WIDTH), np.repeat(np.arange(count, dtype=np.int32), lengths)


# search slack, relative to the radius: it serves bases that differ by less than half of it
SEARCH_SLACK = 0.05


class NodeSearch(eqx.Module):
    """A search for all surface nodes within a `distance` of each point: the coordinates then."""

    points: Points
    surface: Rows
    distance: Scalar

    def is_certain(self, radius: Scalar, surface: Rows, points: Points) -> Flag:
        """True if it surely found all nodes within a radius: nodes may have come nearer since."""
        of_surface = surface - self.surface
        of_points = points - self.points[: len(points)]  # images, which follow, are of the surface
        mean = of_surface.mean(axis=0)
        farthest = [
            jnp.sqrt(jnp.sum((shift - mean[None]) ** 2, axis=1).max(initial=0))
            for shift in (of_surface, of_points)
        ]
        nearer = farthest[0] + jnp.maximum(*farthest)
        return jax.lax.stop_gradient(radius + nearer <= self.distance)


def is_lost(is_certain: Flag, look: Callable[[], Any]) -> Flag:
    """Checks whether a search lost a node: `look` tells, and runs where it is not certain."""
    return jax.lax.cond(is_certain, lambda: jnp.array(False), look)


def squared_distance(a: Float[Array, "*k d"], b: Float[Array, "*m d"]) -> Float[Array, "*n"]:
    """Squared distances without a derivative."""
    return jnp.sum(jax.lax.stop_gradient(a - b) ** 2, axis=-1)
