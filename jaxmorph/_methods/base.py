"""What a method is: the two abstract classes, and the one place where a field is mapped over points."""

import abc
import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from .._host.reduction import AbstractReduction, drop_near

BLOCK = 512
"""Points per block at most: memory, that for derivatives too, is that of one block, whatever the size of the mesh."""


@dataclasses.dataclass(frozen=True)
class Surface:
    """The moving and fixed nodes as `AbstractMethod.connect` sees them, on the host.

    `points` (b, d) are their coordinates, the `moving` first ones moving, the others fixed. `nodes` (b,) are their row
    numbers among the points that `connect` is asked about, -1 for one that is not among them. `images` (b,) names for each
    row the row of which it is the mirror image, or itself. `matched` are rows whose displacement is known to vanish: the
    sources of a coarse field, where a correction has nothing to do.
    """

    points: np.ndarray
    nodes: np.ndarray
    moving: int
    images: np.ndarray
    matched: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int32))

    def reduced(self, moving: AbstractReduction, fixed: AbstractReduction) -> np.ndarray:
        """Rows chosen among the moving nodes, then among the fixed ones not too close to those, each with its mirror images."""
        chosen, closest = [], []
        for reduction, rows in ((moving, np.arange(self.moving)), (fixed, np.arange(self.moving, len(self.points)))):
            own = rows[self.images[rows] == rows]
            chosen.append(rows[np.isin(self.images[rows], own[reduction(self.points[own])])])
            closest.append(reduction.closest(self.points[own]))
        return np.concatenate([chosen[0], drop_near(self.points, chosen[1], chosen[0], min(closest))])

    def among(self, points: np.ndarray) -> tuple["Surface", np.ndarray]:
        """The same surface with each of its rows among the points: those that are not (mirror images) are added at the end."""
        absent = np.flatnonzero(self.nodes < 0)
        if not absent.size:
            return self, points
        nodes = self.nodes.copy()
        nodes[absent] = len(points) + np.arange(len(absent))
        return dataclasses.replace(self, nodes=nodes), np.concatenate([points, self.points[absent]])

    def rows(self, n: int) -> np.ndarray:
        """(n,) the surface's row of each of n points; b for one that is not on the surface."""
        rows = np.full(n, len(self.points), dtype=np.int32)
        present = np.flatnonzero(self.nodes >= 0)
        rows[self.nodes[present]] = present
        return rows


class Located(eqx.Module):
    """How the location of a mesh's points went: how many answers were `repaired`, how many points lie `outside` by round-off."""

    repaired: Int[Array, ""]
    outside: Int[Array, ""]


class AbstractField(eqx.Module):
    """A displacement field, written for one point."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, " d"], ids: PyTree) -> Float[Array, " d"]:
        """The displacement at `x`; `ids` is what the method's `connect` found for this point, or `place` made of it."""

    def evaluate(self, points: Float[Array, "c d"], ids: PyTree) -> Float[Array, "c d"]:
        """The displacements of a block of points. Equal to the mapped one-point form; there for speed alone."""
        return jax.vmap(self)(points, ids)

    @property
    def local(self) -> bool:
        """Whether a point costs a handful of numbers, so that all points make one block."""
        return False

    @property
    def block(self) -> int:
        """Points per block, where the field is not `local`."""
        return BLOCK


class AbstractMethod(eqx.Module):
    """Turns displacements of the surface into a displacement field.

    A method of your own needs `connect`, `fit` and `field`. The surface's rows are the moving nodes, then the fixed ones,
    no node twice; b of them.
    """

    @abc.abstractmethod
    def connect(self, surface: Surface, points: Float[np.ndarray, "n d"]) -> tuple[PyTree, PyTree]:
        """Host, once: ids for the surface, and ids for every point (each leaf has n rows)."""

    @abc.abstractmethod
    def fit(self, ids: PyTree, surface: Float[Array, "b d"]) -> PyTree:
        """Traced: the part of the solve that does not depend on `u`."""

    @abc.abstractmethod
    def field(
        self, ids: PyTree, factors: PyTree, surface: Float[Array, "b d"], u: Float[Array, "b d"]
    ) -> AbstractField:
        """Traced, and linear in `u`."""

    def place(self, x: Float[Array, " d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]) -> PyTree:
        """Traced: what a point's own place adds to its ids (barycentric coordinates), whatever `u` is; the ids by default.

        Computed once per base mesh. The steps of `march` keep it: a graph stands on the undeformed mesh.
        """
        return ids

    def matched(self, ids: PyTree) -> np.ndarray:
        """Host: the surface's rows whose displacement the field takes, of those that `connect` chose (a coarse field's sources)."""
        return np.zeros(0, dtype=np.int32)

    def check(self, ids: PyTree, factors: PyTree, u: Float[Array, "b d"]) -> None:
        """Host, once, after the first `fit`: raises or warns when the factors are unusable; `u` is a displacement to try."""

    @property
    def exact(self) -> bool:
        """Whether the field takes the given displacements at the surface's nodes; they are then assigned bit for bit."""
        return True


def map_points(field: AbstractField, points: Float[Array, "n d"], ids: PyTree) -> Float[Array, "n d"]:
    """The field at every point, block by block, each block recomputed instead of stored for derivatives."""
    if field.local:
        return field.evaluate(points, ids)
    return map_rows(jax.checkpoint(lambda part: field.evaluate(*part)), (points, ids), field.block)


def place_points(
    method: AbstractMethod, points: Float[Array, "n d"], ids: PyTree, factors: PyTree, surface: Float[Array, "b d"]
) -> PyTree:
    """`method.place` for every point."""
    if not jax.tree.leaves(ids):
        return ids
    place = jax.checkpoint(jax.vmap(lambda x, ids: method.place(x, ids, factors, surface)))
    n = len(points)
    block = min(BLOCK, n)
    starts = jnp.minimum(
        jnp.arange(0, n, block), n - block
    )  # the last block begins within the one before: no other shape

    def of_block(start):
        return place(*jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, block), (points, ids)))

    def put_together(leaf):
        rows = leaf.reshape(-1, *leaf.shape[2:])
        return jnp.concatenate([rows[: n - block], leaf[-1]])

    return jax.tree.map(put_together, jax.lax.map(of_block, starts))


def map_rows(function: Callable[[PyTree], PyTree], rows: PyTree, block: int) -> PyTree:
    """`function` of blocks of so many rows, put together again: what it returns for a block has as many rows.

    Each block adds its rows to one array of zeros, in place; the last block may be shorter. Nothing is padded.
    """
    n = len(jax.tree.leaves(rows)[0])
    full = (n - 1) // block * block
    last = function(jax.tree.map(lambda leaf: leaf[full:], rows))
    if full == 0:
        return last

    def add(whole, part, start):
        return jax.tree.map(lambda a, b: _add_rows(a, b, start), whole, part)

    def step(whole, start_and_part):
        start, part = start_and_part
        return add(whole, function(part), start), None

    blocks = jax.tree.map(lambda leaf: leaf[:full].reshape(-1, block, *leaf.shape[1:]), rows)
    zeros = jax.tree.map(lambda leaf: jnp.zeros((n, *leaf.shape[1:]), leaf.dtype), last)
    whole, _ = jax.lax.scan(step, zeros, (jnp.arange(0, full, block), blocks))
    return add(whole, last, jnp.asarray(full))


def _add_rows(whole: Array, part: Array, start: Int[Array, ""]) -> Array:
    """Adds, and does not replace: the transpose of an addition reads, where that of a replacement also copies and clears."""
    window = jax.lax.ScatterDimensionNumbers(
        update_window_dims=tuple(range(part.ndim)), inserted_window_dims=(), scatter_dims_to_operand_dims=(0,)
    )
    return jax.lax.scatter_add(
        whole,
        start[None],
        part,
        window,
        indices_are_sorted=True,
        unique_indices=True,
        mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )
