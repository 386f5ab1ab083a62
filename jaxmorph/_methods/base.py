"""What a method is: the two abstract classes, and the one place where a field is mapped over points."""

import abc
import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PyTree

Reduction = Callable[[np.ndarray], np.ndarray]

CHUNK = 512
"""Points per block: memory for derivatives is that of one block, whatever the size of the mesh."""


@dataclasses.dataclass(frozen=True)
class Surface:
    """The moving and fixed nodes as `AbstractMethod.connect` sees them, on the host.

    `points` (b, d) are their coordinates, the `moving` first ones moving, the others fixed. `nodes` (b,) are their row
    numbers among the points that `connect` is asked about, -1 for one that is not among them. `images` (b,) names for each
    row the row of which it is the mirror image, or itself.
    """

    points: np.ndarray
    nodes: np.ndarray
    moving: int
    images: np.ndarray

    def reduced(self, moving: Reduction, fixed: Reduction) -> np.ndarray:
        """Rows chosen among the moving nodes, then among the fixed ones, each with its mirror images."""
        chosen = []
        for reduction, rows in ((moving, np.arange(self.moving)), (fixed, np.arange(self.moving, len(self.points)))):
            own = rows[self.images[rows] == rows]
            chosen.append(rows[np.isin(self.images[rows], own[reduction(self.points[own])])])
        return np.concatenate(chosen)

    def itself(self) -> "Surface":
        """The same surface, for asking about the surface's own points."""
        return dataclasses.replace(self, nodes=np.arange(len(self.points)))

    def rows(self, n: int) -> np.ndarray:
        """(n,) the surface's row of each of n points; b for one that is not on the surface."""
        rows = np.full(n, len(self.points), dtype=np.int32)
        present = np.flatnonzero(self.nodes >= 0)
        rows[self.nodes[present]] = present
        return rows


class AbstractField(eqx.Module):
    """A displacement field, written for one point."""

    @abc.abstractmethod
    def __call__(self, x: Float[Array, " d"], ids: PyTree) -> Float[Array, " d"]:
        """The displacement at `x`; `ids` is what the method's `connect` found for this point."""

    def evaluate(self, points: Float[Array, "c d"], ids: PyTree) -> Float[Array, "c d"]:
        """The displacements of a block of points. Equal to the mapped one-point form; there for speed alone."""
        return jax.vmap(self)(points, ids)


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

    def check(self, factors: PyTree) -> None:
        """Host, once, after the first `fit`: raises or warns when the factors are unusable."""

    @property
    def exact(self) -> bool:
        """Whether the field takes the given displacements at the surface's nodes; they are then assigned bit for bit."""
        return True


def map_points(field: AbstractField, points: Float[Array, "n d"], ids: PyTree) -> Float[Array, "n d"]:
    """The field at every point, block by block, each block recomputed instead of stored for derivatives."""
    if len(points) <= CHUNK:
        return field.evaluate(points, ids)
    block = jax.checkpoint(lambda part: field.evaluate(*part))
    full = len(points) // CHUNK * CHUNK
    blocks = jax.tree.map(lambda leaf: leaf[:full].reshape(-1, CHUNK, *leaf.shape[1:]), (points, ids))
    mapped = jax.lax.map(block, blocks).reshape(full, points.shape[1])
    if full == len(points):
        return mapped
    rest = block(jax.tree.map(lambda leaf: leaf[full:], (points, ids)))
    return jax.numpy.concatenate([mapped, rest])
