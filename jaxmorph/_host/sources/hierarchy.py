"""A hierarchy of surface nodes, farthest first, and the triangular system of its functions."""

import dataclasses

import numpy as np
from numpy import ndarray
from scipy import sparse
from scipy.spatial.distance import cdist

from ..cells.topology import Pair
from ..package.arguments import between
from ..package.rounding import (
    Tree,
    canonical_order,
    first_largest,
    nearest_of,
    ranked,
    roundoff,
)
from ..ragged import Ragged
from ..tolerances import SAME
from .farthest import FarthestPoints
from .reduction import AbstractReduction

CANDIDATES = 256  # candidates for the next nodes in a batch
ROW_WIDTH = 8  # entries in a row of a sweep's table


def farthest_first(points: ndarray, earlier: ndarray, images: ndarray) -> Pair:
    """Orders nodes so that the next is always the farthest from its predecessors.

    Also finds nearest predecessors. The `earlier` nodes are predecessors of all nodes, and mirror
    images of a node, of its number in `images` (b,), are its predecessors. Without earlier nodes,
    the first node is the farthest from the middle, and the node farthest from it counts as its
    nearest predecessor. A duplicate of a predecessor is left out. Duplicates and earlier nodes are
    their own nearest predecessors.
    """
    rank = canonical_order(points)
    place = np.argsort(rank)
    order = _Order.start(points[rank].astype(float), place[earlier], images[rank])
    tree = Tree(order.points)
    least = roundoff(points)
    while (batch := _pick_batch(order.distance, least)).size:
        order.pick(batch, tree)
    radius = order.radius
    first = np.lexsort((np.arange(len(points)), -radius))[: np.count_nonzero(radius)]
    nearest = np.where(radius == 0, np.arange(len(points)), order.nearest)
    return rank[first], rank[nearest[place]]


@dataclasses.dataclass(frozen=True, eq=False)
class _Order:
    """Points by place, their distances from nodes that are picked, the `nearest` of these, and the
    distance, `radius`, at which each was picked. Arrays change in place.
    """

    points: ndarray
    distance: ndarray
    nearest: ndarray
    radius: ndarray

    @classmethod
    def start(cls, points: ndarray, start: ndarray, images: ndarray) -> "_Order":
        n = len(points)
        order = cls(points, np.full(n, np.inf), np.arange(n), np.zeros(n))
        order.approach(*_pair_equals(images))
        if not len(start):
            start = np.array([first_largest(np.linalg.norm(points - points.mean(axis=0), axis=1))])
            away = np.linalg.norm(points - points[start], axis=1)
            if order.nearest[start] == start:
                order.distance[start] = away.max()
                order.nearest[start] = first_largest(away)
            order.radius[start] = order.distance[start]
        others = np.setdiff1d(np.arange(n), start)
        order.approach(others, nearest_of(points[others], points[start], start))
        order.distance[start] = 0
        return order

    def approach(self, near: ndarray, node: ndarray) -> None:
        """Updates distances and nearest nodes of nodes `near` that are nearer to `node`."""
        gap = np.linalg.norm(self.points[near] - self.points[node], axis=1)
        closer = np.flatnonzero(gap < (1 - SAME) * self.distance[near])
        np.minimum.at(self.distance, near[closer], gap[closer])
        closer = closer[gap[closer] <= (1 + SAME) * self.distance[near[closer]]]
        # the first of equals is written last
        closer = closer[np.argsort(-node[closer], kind="stable")]
        self.nearest[near[closer]] = node[closer]

    def pick(self, batch: ndarray, tree: Tree) -> None:
        """Picks those of a batch, the nodes with the largest distances, that no earlier node of the
        batch comes nearer to. Only nodes within the distance of a picked one come nearer to it.
        """
        gaps = cdist(self.points[batch], self.points[batch])
        gaps = np.where(np.tri(len(batch), k=-1, dtype=bool), gaps, np.inf)
        picked = batch[gaps.min(axis=1) >= self.distance[batch] * (1 - SAME)]
        self.radius[picked] = self.distance[picked]
        self.distance[picked] = 0
        node, near = tree.within(self.points[picked], (1 - SAME) * self.radius[picked])
        self.approach(near, picked[node])


@dataclasses.dataclass(frozen=True)
class Share(AbstractReduction):
    """Chooses a fraction of the points, at least one, as `FarthestPoints` does."""

    fraction: float

    def __post_init__(self):
        between("fraction", self.fraction, 0, 1, "(]")

    def __call__(self, points: ndarray) -> ndarray:
        count = int(np.ceil(self.fraction * len(points)))
        return FarthestPoints(count)(points) if count else np.zeros(0, dtype=np.int64)


def _pair_equals(numbers: ndarray) -> Pair:
    """All pairs of two different rows (k,) with equal numbers, both ways."""
    groups = np.unique(numbers, return_inverse=True)[1]
    member = sparse.csr_array((np.ones(len(numbers), bool), (np.arange(len(numbers)), groups)))
    first, second = (member @ member.T).nonzero()
    return first[first != second], second[first != second]


def _pick_batch(distance: ndarray, least: float) -> ndarray:
    """Nodes with the largest distances above `least`, largest first; ties by first node."""
    count = min(CANDIDATES, len(distance))
    last = np.partition(distance, -count)[-count]
    batch = np.flatnonzero((distance >= (1 - SAME) * last) & (distance > least))
    return batch[np.lexsort((batch, ranked(-distance[batch], SAME * distance.max())))[:CANDIDATES]]


def overlaps(points: ndarray, centres: ndarray, radius: ndarray, targets: ndarray) -> Pair:
    """Pairs (target, centre) within the centre's radius (b,), by target, then centre."""
    tree = Tree(targets, leafsize=32, balanced_tree=False, compact_nodes=False)
    rank, target = tree.within(points[centres], radius[centres])
    order = np.lexsort((rank, target))
    return target[order], centres[rank[order]]


def _count_in_runs(*keys: ndarray) -> ndarray:
    """The place of each entry (e,) in its run of entries with equal keys."""
    row = np.arange(len(keys[0]))
    begins = np.logical_or.reduce([np.diff(key, prepend=-1) != 0 for key in keys])
    return row - np.maximum.accumulate(np.where(begins, row, 0))


def padded(target: ndarray, centre: ndarray, count: int) -> Pair:
    """Lays pairs, sorted by target, into rows (count, k) of centres, with a mask of the pairs."""
    rows = Ragged.of(centre.astype(np.int32), np.bincount(target, minlength=count))
    table = rows.padded(0, 1)
    return table, np.arange(table.shape[1]) < rows.sizes[:, None]


def sweeps(row: ndarray, column: ndarray, count: int) -> tuple[Pair, Pair]:
    """Orders the equations of a triangular matrix, and of its transpose, for forward substitution.
    The `count` equations have ones on the diagonal. A level needs only earlier levels.
    """
    level = np.zeros(count, dtype=np.int64)
    while True:
        deeper = level.copy()
        np.maximum.at(deeper, row, level[column] + 1)
        if (deeper == level).all():
            break
        level = deeper
    return _lay_out_sweep(row, level[row]), _lay_out_sweep(
        column, level.max(initial=0) - level[column]
    )


def _lay_out_sweep(owner: ndarray, level: ndarray) -> Pair:
    """Lays entries (e,), by level and owner, into s steps of r rows, each of up to `WIDTH` entries
    of its owner. Returns positions (s, r, WIDTH), -1 for padding, and owners (s, r).
    """
    # The entries of one owner within a level fill rows of `WIDTH`. All steps have equally many
    # rows, a quarter of the mean number of rows of a level. A level begins with a new step; the
    # rest of its last step stays empty.
    if not owner.size:
        return np.zeros((0, 1, ROW_WIDTH), dtype=np.int32), np.zeros((0, 1), dtype=np.int32)
    order = np.lexsort((owner, level))
    level = level[order]
    owner = owner[order]
    within = _count_in_runs(level, owner)
    begins = within % ROW_WIDTH == 0
    level_of_row = level[begins]
    rows_of_level = np.bincount(level_of_row)
    rows = -(-len(level_of_row) // (4 * len(rows_of_level)))
    last_step = np.cumsum(-(-rows_of_level // rows))
    first_slot = rows * np.append(0, last_step)[level_of_row]
    slot = (first_slot + _count_in_runs(level_of_row))[np.cumsum(begins) - 1]
    entries = np.full((last_step[-1] * rows, ROW_WIDTH), -1, dtype=np.int32)
    owners = np.zeros(last_step[-1] * rows, np.int32)
    entries[slot, within % ROW_WIDTH] = order
    owners[slot] = owner
    return entries.reshape(-1, rows, ROW_WIDTH), owners.reshape(-1, rows)
