"""A hierarchy of surface nodes, farthest first, and the triangular system of its functions."""

import dataclasses

import numpy as np
from numpy import ndarray
from scipy import sparse
from scipy.spatial.distance import cdist

from ..cells.topology import Pair
from ..linear.products import row_lengths
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
    """Orders nodes so that the next is always the farthest from its predecessors; also finds the
    nearest of these. `earlier` nodes are predecessors of all, and so are images of a node, of its
    number in `images` (b,). Without earlier ones, the first is the farthest from the middle, and
    the node farthest from it its nearest. Duplicates are left out; they are their own nearest.
    """
    rank = canonical_order(points)
    place = np.argsort(rank)
    ordered = points[rank].astype(float)
    distance = np.full(len(points), np.inf)
    nearest = np.arange(len(points))
    radius = np.zeros(len(points))

    def approach(near: ndarray, node: ndarray) -> None:
        """Updates distances and nearest nodes of nodes `near` that are nearer to `node`."""
        gap = row_lengths(ordered[near] - ordered[node])
        closer = np.flatnonzero(gap < (1 - SAME) * distance[near])
        np.minimum.at(distance, near[closer], gap[closer])
        closer = closer[gap[closer] <= (1 + SAME) * distance[near[closer]]]
        closer = closer[np.argsort(-node[closer], kind="stable")]  # the first of equals is last
        nearest[near[closer]] = node[closer]

    approach(*_pair_equals(images[rank]))
    start = place[earlier]
    if not len(earlier):
        start = np.array([first_largest(row_lengths(ordered - ordered.mean(axis=0)))])
        away = row_lengths(ordered - ordered[start])
        if nearest[start] == start:
            distance[start] = away.max()
            nearest[start] = first_largest(away)
        radius[start] = distance[start]
    others = np.setdiff1d(np.arange(len(points)), start)
    approach(others, nearest_of(ordered[others], ordered[start], start))
    distance[start] = 0
    tree = Tree(ordered)
    least = roundoff(points)
    while (picked := _pick(ordered, distance, least)).size:
        # only nodes within the distance of a picked node can come nearer to it
        radius[picked] = distance[picked]
        distance[picked] = 0
        node, near = tree.within(ordered[picked], (1 - SAME) * radius[picked])
        approach(near, picked[node])
    nearest[radius == 0] = np.flatnonzero(radius == 0)
    order = np.argsort(-radius, kind="stable")[: np.count_nonzero(radius)]
    return rank[order], rank[nearest[place]]


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


def _pick(points: ndarray, distance: ndarray, least: float) -> ndarray:
    """Nodes with the largest distances above `least`, largest first; ties by first node. Of a batch
    of them, those that no earlier node of the batch comes nearer to.
    """
    count = min(CANDIDATES, len(distance))
    last = np.partition(distance, -count)[-count]
    batch = np.flatnonzero((distance >= (1 - SAME) * last) & (distance > least))
    order = np.lexsort((batch, ranked(-distance[batch], SAME * distance.max())))
    batch = batch[order[:CANDIDATES]]
    earlier = np.tri(len(batch), k=-1, dtype=bool)
    gaps = np.where(earlier, cdist(points[batch], points[batch]), np.inf)
    return batch[gaps.min(axis=1, initial=np.inf) >= (1 - SAME) * distance[batch]]


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
