"""Farthest points: sources spread evenly or graded over a surface (Gonzalez 1985), and orders."""

import dataclasses

import numpy as np
from numpy import ndarray

from ..cells.topology import Pair
from ..linear.products import row_lengths
from ..package.arguments import between, check_fields, whole
from ..package.rounding import (
    Tree,
    canonical_order,
    first_largest,
    nearest_of,
    resolution,
    roundoff,
    spacing,
)
from ..tolerances import SAME
from .reduction import AbstractReduction, AbstractSeparated, KDTree, chosen_in_order, extreme_points

ENOUGH = {2: 84, 3: 400}  # sources of `Filled` by dimension: a wall in 3-D needs more than a curve


@dataclasses.dataclass(frozen=True)
class FarthestPoints(AbstractSeparated):
    """Chooses `count` points one by one, always the farthest from all chosen points.

    The first is the farthest from the middle. The largest distance of a surface point from its
    nearest source is at most twice that of the best choice of `count` sources. The result depends
    on the set of points, not on their order. It costs n times `count` operations (Gonzalez,
    Theoretical Computer Science 38, 1985).

    **Arguments:**

    - `count`: number of points, at least 1; fewer if `separation` leaves no more.
    - `separation`: the least distance between two sources, relative to the diagonal of all points.
      Default 1e-3.
    - `extremes`: begin with the points on the bounding box, as `KDTree` does. Default False.

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

    def _chosen(self, points: ndarray, order: ndarray) -> ndarray:
        first = extreme_points(points) if self.extremes else None
        return farthest(points, self.count, self.closest(points), first)


@dataclasses.dataclass(frozen=True)
class Filled(AbstractReduction):
    """Chooses the sources of a k-d tree with `extremes`, then the farthest points from them.

    The tree is finer at edges, as the mesh is. The farthest points leave no part of a wall without
    sources. There are 84 sources in 2-D and 400 in 3-D, or as many as the tree has.

    **Arguments:**

    - `leaves`: leaves of the tree. Default 16.
    - `crowded`: leaves if another boundary is near, as in `KDTree`. Default 32.
    """

    leaves: int = 16
    crowded: int | None = 32

    @property
    def tree(self) -> KDTree:
        return KDTree(self.leaves, extremes=True, crowded=self.crowded)

    def __call__(self, points: ndarray) -> ndarray:
        return self.beside(points, points[:0])

    def beside(self, points: ndarray, others: ndarray) -> ndarray:
        def chosen(points, order):
            first = self.tree.beside(points, others)
            return farthest(
                points, max(len(first), ENOUGH[points.shape[1]]), self.closest(points), first
            )

        return chosen_in_order(points, chosen)

    def closest(self, points: ndarray) -> float:
        return self.tree.closest(points)


def farthest(
    points: ndarray,
    count: int,
    closest: float,
    first: ndarray | None = None,
    reach: ndarray | float = 0.0,
) -> ndarray:
    """Picks ids of `count` points, each the farthest from all chosen points; `first` come first. It
    ends early if all points are within `closest` of chosen points. With `reach` (n,), distances are
    relative to it, and it ends when all points are within reach.
    """
    columns = np.ascontiguousarray(points.T)
    distance = np.full(len(points), np.inf)
    work = np.empty((2, len(points)))
    least = closest**2
    weight = 1.0
    if np.ndim(reach):
        # finite, also if all points are in one place
        weight = 1 / np.maximum(reach, max(closest, 1e-100)) ** 2
        least = 1.0
    least *= 1 + SAME
    noise = roundoff(points) * np.sqrt(np.broadcast_to(weight, len(points)))
    chosen = []
    away = row_lengths(points - points.mean(axis=0))
    outermost = first_largest(away, resolution(points))
    for node in [outermost] if first is None else first.tolist():
        if distance[node] > least and len(chosen) < count:
            chosen.append(node)
            _lower(distance, columns, node, weight, work)
    while len(chosen) < count and distance[top := distance.argmax()] > least:
        equal = max((1 - SAME / 2) * np.sqrt(distance[top]) - noise[top], 0.0) ** 2
        chosen.append(int((distance >= equal).argmax()))
        _lower(distance, columns, chosen[-1], weight, work)
    return np.array(chosen)


def _lower(
    distance: ndarray,
    columns: ndarray,
    node: int,
    weight: ndarray | float,
    work: ndarray,
) -> None:
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


# default `share` by dimension: a distant circle gets 16 sources, a sphere about 30
DEFAULT_SHARES = {
    2: 0.25,
    3: 0.5,
}


@dataclasses.dataclass(frozen=True)
class Graded(AbstractSeparated):
    """Chooses points so that sources are dense where the other boundary is near.

    The distance of every point from a source is at most `share` of its distance from the other
    boundary. It is made for the fixed boundary: where the moving boundary is near, the field must
    vanish within the gap, and a far field needs a few dozen sources.

    The distance is measured to the nearest source of the other boundary, and is at least the
    distance of that source from its own nearest source. Without another boundary it is the diagonal
    of all points. A fixed wall farther away than it is long, a body for example, gets its sources
    as if there were no other boundary, at most 512 on all such walls.

    **Arguments:**

    - `share`: above 0; 0.25 in 2-D and 0.5 in 3-D by default.
    - `most`: most sources; the most needed sources come first; 512 by default.
    - `separation`: least distance between sources, relative to the diagonal of all points; 1e-3 by
      default.

    **Raises:** `ValueError` for values that are not in these ranges.
    """

    share: float | None = None
    _: dataclasses.KW_ONLY
    most: int = 512
    separation: float = 1e-3

    most_on_far_walls = 512

    def __post_init__(self):
        if self.share is not None:
            between("share", self.share, 0)
        whole("most", self.most)
        between("separation", self.separation, 0, 1, "[)")

    def _chosen(self, points: ndarray, order: ndarray) -> ndarray:
        return self._near(points, points[:0])

    def beside(self, points: ndarray, others: ndarray) -> ndarray:
        others = others[canonical_order(others)] if len(others) else others
        return chosen_in_order(points, lambda points, order: self._near(points, others))

    def _near(self, points: ndarray, others: ndarray) -> ndarray:
        share = DEFAULT_SHARES[points.shape[1]] if self.share is None else self.share
        return farthest(
            points, self.most, self.closest(points), reach=share * _measure_room(points, others)
        )


def _measure_room(points: ndarray, others: ndarray) -> ndarray:
    """Measures distances (n,) from the nearest of the `others`, at least their spacing there."""
    if len(others) == 0:
        return np.full(len(points), float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0)
    distance = np.asarray(Tree(others).query(points)[0])
    if len(others) == 1:
        return np.maximum(distance, 1e-12 * distance.max())
    return np.maximum(distance, nearest_of(points, others, spacing(others)))


def far_to_near(points: ndarray, first: int, count: int) -> Pair:
    """Orders points (n, d) so that each is far from its predecessors, and finds near predecessors.
    Returns ids (n,), and places in their order (n - first, count): the point's own place, then near
    earlier places; its own place fills up the row. The result depends on the set of points, not on
    their order.
    """
    canonical = canonical_order(points)
    order = canonical[farthest(points[canonical], len(points), 0.0)]
    n = len(points)
    points = points[order]
    place = np.arange(min(first, n), n)[:, None]
    earlier = np.repeat(place.astype(np.int32), count, axis=1)
    start = first
    while start < n:
        end = min(n, start + start // 4 + 1)  # a tree for a quarter more points
        own = place[start - first : end - first]
        distances = []
        numbers = []
        for low, high in ((0, start), (start, end)):
            distance, row = Tree(points[low:high]).query(
                points[start:end], k=range(1, min(high - low, count) + 1)
            )
            distances.append(np.where(low + row < own, distance, np.inf))
            numbers.append(np.where(low + row < own, low + row, own))
        nearest = np.argsort(np.hstack(distances), axis=1, kind="stable")[:, : count - 1]
        found = np.take_along_axis(np.hstack(numbers), nearest, axis=1)
        earlier[start - first : end - first, 1 : 1 + nearest.shape[1]] = found
        start = end
    return order, earlier
