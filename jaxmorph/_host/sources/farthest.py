"""Farthest points: sources spread evenly over a surface (Gonzalez 1985)."""

import dataclasses

import numpy as np

from ..package.arguments import between, check_fields, whole
from ..package.rounding import SAME, first_largest
from .reduction import AbstractReduction, AbstractSeparated, KDTree, chosen_in_order, extreme_points

ENOUGH = {2: 84, 3: 400}
"""Sources of `Filled` by dimension: a wall in 3-D needs more than a curve."""


@dataclasses.dataclass(frozen=True)
class FarthestPoints(AbstractSeparated):
    """Chooses `count` points one by one, always the farthest from all chosen points.

    The first is the farthest from the middle. The largest distance of a surface point from its
    nearest source is then at most twice that of the best choice of `count` sources, whatever the
    density of the mesh. The result depends on the set of points, not on their order. It costs n
    times `count` operations (Gonzalez, Theoretical Computer Science 38, 1985).

    **Arguments:**

    - `count`: number of points, at least 1; fewer if `separation` leaves no more.
    - `separation`: the least distance between two sources, as a share of the diagonal of all
      points, from 0 to 1. Default 1e-3.
    - `extremes`: begin with the points on the bounding box, as `KDTree` does: a blunt trailing
      edge, a wing's tip. Default False.

    **Raises:** `ValueError` for a count below one, and for a separation that is not from 0 to 1.
    """

    count: int
    _: dataclasses.KW_ONLY
    separation: float = 1e-3
    extremes: bool = False

    def __post_init__(self):
        whole("count", self.count)
        check_fields(self)
        between("separation", self.separation, 0, 1, "[)")

    def _chosen(self, points: np.ndarray, order: np.ndarray) -> np.ndarray:
        first = extreme_points(points) if self.extremes else None
        return farthest(points, self.count, self.closest(points), first)


@dataclasses.dataclass(frozen=True)
class Filled(AbstractReduction):
    """Chooses the sources of a k-d tree with `extremes`, then the farthest points from them.

    The tree follows the density of the mesh: it is finer at edges. The farthest points leave no
    part of a wall without sources. There are 84 sources in 2-D and 400 in 3-D, or more if the tree
    has more.

    **Arguments:**

    - `leaves`: leaves of the tree. Default 16.
    - `crowded`: leaves if another boundary is near, as in `KDTree`. Default 32.
    """

    leaves: int = 16
    crowded: int | None = 32

    @property
    def tree(self) -> KDTree:
        return KDTree(self.leaves, extremes=True, crowded=self.crowded)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.beside(points, np.zeros((0, np.shape(points)[1])))

    def beside(self, points: np.ndarray, others: np.ndarray) -> np.ndarray:
        def chosen(points, order):
            first = self.tree.beside(points, others)
            return farthest(points, max(len(first), ENOUGH[points.shape[1]]), self.closest(points), first)

        return chosen_in_order(points, chosen)

    def closest(self, points: np.ndarray) -> float:
        return self.tree.closest(points)


def farthest(
    points: np.ndarray,
    count: int,
    closest: float,
    first: np.ndarray | None = None,
    reach: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Picks ids of `count` points, each the farthest from all chosen points; `first` come first.

    It ends early if all points are within `closest` of chosen points. With `reach` (n,), distances
    are relative to a point's own reach, and it ends when all points are within reach.
    """
    columns = np.ascontiguousarray(points.T)
    distance, work = np.full(len(points), np.inf), np.empty((2, len(points)))
    least, weight = closest**2, 1.0
    if np.ndim(reach):
        # finite, also if all points are in one place
        weight, least = 1 / np.maximum(reach, max(closest, 1e-100)) ** 2, 1.0
    least *= 1 + SAME
    chosen, outermost = [], first_largest(((points - points.mean(axis=0)) ** 2).sum(axis=1))
    for node in [outermost] if first is None else first.tolist():
        if distance[node] > least and len(chosen) < count:
            chosen.append(node)
            _lower(distance, columns, node, weight, work)
    while len(chosen) < count and (top := distance.max()) > least:
        chosen.append(int((distance >= (1 - SAME) * top).argmax()))
        _lower(distance, columns, chosen[-1], weight, work)
    return np.array(chosen)


def _lower(distance: np.ndarray, columns: np.ndarray, node: int, weight: np.ndarray | float, work: np.ndarray) -> None:
    """Lowers squared distances where `node` is closer, in place: all data stay in the cache."""
    total, term = work
    np.subtract(columns[0], columns[0, node], out=total)
    np.multiply(total, total, out=total)
    for column in columns[1:]:
        np.subtract(column, column[node], out=term)
        np.multiply(term, term, out=term)
        np.add(total, term, out=total)
    np.multiply(total, weight, out=total)
    np.minimum(distance, total, out=distance)
