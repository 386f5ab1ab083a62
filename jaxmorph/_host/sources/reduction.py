"""Reduction of source points, the nodes that carry radial functions; distances between them."""

import abc
import dataclasses
import heapq
import itertools
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy import ndarray

from ..cells.topology import Pair
from ..package.arguments import between, check_fields, finite_array, whole
from ..package.rounding import (
    Tree,
    canonical_order,
    extent_of,
    first_largest,
    nearest_of,
    resolution,
    roundoff,
)
from ..tolerances import SAME


class AbstractReduction(abc.ABC):
    """Chooses source points: called with points (k, d), it returns distinct ids, ascending.

    Your own reduction is a frozen (hashable) dataclass with one method, `__call__`. A choice is
    discontinuous in the coordinates: as nodes move, another node becomes a source. In the library's
    own reductions, lengths within a relative 1e-9 are equal, and the first of equals in the order
    of coordinates counts.
    """

    most_on_far_walls: ClassVar[int] = 0
    """Most sources on fixed walls farther from the moving walls than they are long; 0: no limit."""

    @abc.abstractmethod
    def __call__(self, points: ndarray) -> ndarray: ...

    def beside(self, points: ndarray, others: ndarray) -> ndarray:
        """Chooses near the `others` (k, d), fixed nodes or moving sources; ignored by default."""
        return self(points)

    def closest(self, points: ndarray) -> float:
        """Returns the distance within which one of two sources is dropped; round-off by default."""
        return roundoff(points)


class AbstractSeparated(AbstractReduction):
    """A reduction of sources with a least distance, which takes points in canonical order."""

    separation: float

    @abc.abstractmethod
    def _chosen(self, points: ndarray, order: ndarray) -> ndarray:
        """Chooses rows of `points` (k, d) in canonical order; `order` (k,) has their ids."""

    def __call__(self, points: ndarray) -> ndarray:
        return chosen_in_order(points, self._chosen)

    def closest(self, points: ndarray) -> float:
        """Returns `separation` times the diagonal of all points, but at least round-off."""
        if len(points) == 0:
            return 0.0
        return max(
            self.separation * float(np.linalg.norm(np.ptp(points, axis=0))), roundoff(points)
        )


class AbstractSearchPoints(abc.ABC):
    """Places in a leaf's box, from -1 to 1; the mesh points closest to them become sources."""

    @abc.abstractmethod
    def local(self, dimension: int) -> ndarray:
        """Lists the local coordinates (k, d)."""


@dataclasses.dataclass(frozen=True)
class Centre(AbstractSearchPoints):
    """The middle of a box."""

    def local(self, dimension: int) -> ndarray:
        return np.zeros((1, dimension))


@dataclasses.dataclass(frozen=True)
class GaussPoints(AbstractSearchPoints):
    """The 4 or 8 Gauss points of the linear element, at +-1/sqrt(3)."""

    def local(self, dimension: int) -> ndarray:
        return Corners().local(dimension) / np.sqrt(3)


@dataclasses.dataclass(frozen=True)
class Corners(AbstractSearchPoints):
    """The 4 or 8 corners of a box."""

    def local(self, dimension: int) -> ndarray:
        return np.array(list(itertools.product((-1.0, 1.0), repeat=dimension)))


@dataclasses.dataclass(frozen=True)
class AllPoints(AbstractReduction):
    """Chooses all points, as in the classic method; of coincident points, one."""

    def __call__(self, points: ndarray) -> ndarray:
        return drop_close(points, np.arange(len(points)), roundoff(points))


@dataclasses.dataclass(frozen=True)
class KDTree(AbstractSeparated):
    """The paper's explicit reduction by a k-d tree (section 2.1), in five steps.

    The box with the most points is split at the median of its longest side. A leaf's box bounds its
    own points. The mesh points closest to the search points of the leaves become sources. The
    result depends on the set of points, not on their order.

    **Arguments:**

    - `leaves`: number of boxes at which splitting ends. One of `leaves`, `points_per_leaf` and
      `largest_box` is needed.
    - `search_points`: places in a box; `Corners()` by default, or `Centre()` or `GaussPoints()`.
    - `points_per_leaf`: a box with more points is split. Default None: no limit.
    - `smallest_box`, `largest_box`: lengths in the mesh's units. A box no longer than the first
      stays whole, a box longer than the second is split. Defaults 0 and infinity.
    - `separation`: the least distance between two sources, relative to the diagonal of all points.
      Closer sources ruin the condition of the solve. A fixed source is also dropped beside a moving
      source, by the smaller of both distances. Default 1e-3.
    - `extremes`: adds points on the bounding box: a blunt trailing edge, a wing's tip. Default
      False.
    - `crowded`: number of leaves if the other boundary is nearer to a point than the longest side
      of the bounding box. Default None: `leaves`.

    **Raises:** `ValueError` if no argument ends the splitting, and for values out of range.
    """

    leaves: int | np.integer | None = None
    search_points: AbstractSearchPoints = Corners()
    _: dataclasses.KW_ONLY
    points_per_leaf: int | np.integer | None = None
    smallest_box: float = 0.0
    largest_box: float = np.inf
    separation: float = 1e-3
    extremes: bool = False
    crowded: int | np.integer | None = None

    def __post_init__(self):
        if self.leaves is None and self.points_per_leaf is None and self.largest_box == np.inf:
            raise ValueError(
                "KDTree needs `leaves`, `points_per_leaf` or `largest_box`: splitting would not "
                "end."
            )
        for name in ("leaves", "points_per_leaf", "crowded"):
            if getattr(self, name) is not None:
                whole(name, getattr(self, name))
        check_fields(self)
        if not 0 <= self.smallest_box <= self.largest_box:
            raise ValueError(
                f"need 0 <= smallest_box <= largest_box, not {self.smallest_box}, "
                f"{self.largest_box}."
            )
        between("separation", self.separation, 0, 1, "[)")

    def _chosen(self, points: ndarray, order: ndarray) -> ndarray:
        boxes = self.boxes(points)
        local = self.search_points.local(points.shape[1])
        centre = boxes.mean(axis=1)
        half = np.ptp(boxes, axis=1) / 2
        search = (centre[:, None] + half[:, None] * local).reshape(-1, points.shape[1])
        sources = np.unique(nearest_of(search, points, np.arange(len(points))))
        if self.extremes:
            sources = np.concatenate([extreme_points(points), sources])
        return drop_close(points, sources, self.closest(points))

    def beside(self, points: ndarray, others: ndarray) -> ndarray:
        return self.given(points, others)(points)

    def given(self, points: ndarray, others: ndarray) -> "KDTree":
        """Returns the tree to build near the `others`: leaves are `crowded` near another point."""
        if self.crowded is None or not len(points) or not len(others):
            return self
        near = (1 - SAME) * float(extent_of(points))
        distance = Tree(others).query(points, distance_upper_bound=near)[0]
        return (
            dataclasses.replace(self, leaves=self.crowded) if np.isfinite(distance).any() else self
        )

    @staticmethod
    def with_sources(count: int, points: ndarray) -> "KDTree":
        """Searches for the tree that gives about `count` sources, with `extremes`.

        `count` is at least d + 1; not all numbers are possible, and the nearest is taken. `points`
        are the coordinates (n, d) of the moving nodes.

        **Raises:** `ValueError` for a smaller count.
        """
        points = finite_array("points", points, (None, 2), (None, 3))
        count = whole("count", count)
        points = points.astype(float)
        if count <= points.shape[1] or not len(points):
            least = f"{points.shape[1] + 1} or more in {points.shape[1]}-D"
            raise ValueError(
                f"`count` must be {least}, not {count}, and {len(points)} points have sources."
            )
        tried: dict[int, int] = {}
        low = 1
        high = min(count, len(points))
        while low <= high:
            leaves = (low + high) // 2
            tried[leaves] = len(KDTree(leaves, extremes=True)(points))
            low, high = (leaves + 1, high) if tried[leaves] < count else (low, leaves - 1)
        return KDTree(
            min(tried, key=lambda leaves: (abs(tried[leaves] - count), leaves)), extremes=True
        )

    def boxes(self, points: ndarray) -> ndarray:
        """Builds the tree of points (n, d); returns lower and upper corners of leaves (k, 2, d)."""
        done = []
        counter = itertools.count()  # breaks ties: the leaf found first is split first
        heap = [(-len(points), next(counter), np.arange(len(points)))]
        while heap:
            *_, members = heapq.heappop(heap)
            sides = np.ptp(points[members], axis=0)
            leaves = 1 + len(heap) + len(done)
            is_wanted = self.leaves is not None and leaves < self.leaves
            is_wanted |= self.points_per_leaf is not None and len(members) > self.points_per_leaf
            is_wanted |= sides.max() > self.largest_box * (1 + SAME)
            same = resolution(points[members])
            is_wanted &= sides.max() > max(self.smallest_box * (1 + SAME), same)
            if len(members) > 1 and is_wanted:
                longest = first_largest(sides, same)
                for half in _halve(points, members, longest):
                    heapq.heappush(heap, (-len(half), next(counter), half))
            else:
                done.append(members)
        return np.array(
            [[points[members].min(axis=0), points[members].max(axis=0)] for members in done]
        )


def _halve(points: ndarray, members: ndarray, axis: int) -> Pair:
    """Splits members at the median along an axis; points at one coordinate stay together."""
    members = members[np.argsort(points[members, axis], kind="stable")]
    along = points[members, axis]
    steps = np.diff(along)
    gaps = 1 + np.flatnonzero(steps > min(resolution(along[:, None]), steps.max() / 2))
    middle = gaps[np.abs(gaps - len(members) / 2).argmin()]
    return members[:middle], members[middle:]


def chosen_in_order(points: ndarray, choose: Callable[[ndarray, ndarray], ndarray]) -> ndarray:
    points = np.asarray(points, dtype=float)
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    order = canonical_order(points)
    return np.sort(order[choose(points[order], order)])


def extreme_points(points: ndarray) -> ndarray:
    extremes = []
    slack = resolution(points)
    for axis, sign in itertools.product(range(points.shape[1]), (-1, 1)):
        along = sign * points[:, axis]
        touching = np.flatnonzero(along >= along.max() - slack)
        others = np.delete(points[touching], axis, axis=1)
        extremes += [
            touching[first_largest(side * column, slack)] for column in others.T for side in (-1, 1)
        ]
    return np.unique(extremes)


def _with_noise(points: ndarray, closest: float) -> float:
    """A distance up to which points are too close, with that of points that round-off parts."""
    noise = roundoff(points)
    return closest * (1 + SAME) + (noise if closest > noise else 0.0)


def drop_close(points: ndarray, ids: ndarray, closest: float) -> ndarray:
    """Drops ids of points within `closest` of an earlier point that stays; the order stays."""
    if len(ids) < 2:
        return ids
    ids = ids[np.sort(np.unique(ids, return_index=True)[1])]
    keep = np.ones(len(ids), dtype=bool)
    for first, second in Tree(points[ids]).close_pairs(_with_noise(points, closest)):
        if keep[first]:
            keep[second] = False
    return ids[keep]


def drop_near(points: ndarray, ids: ndarray, others: ndarray, closest: float) -> ndarray:
    """Drops ids of points within `closest` of one of the `others`; the order stays."""
    if len(ids) == 0 or len(others) == 0:
        return ids
    return ids[Tree(points[others]).query(points[ids])[0] > _with_noise(points, closest)]
