"""A hierarchy of surface nodes, farthest first, and the triangular system of its functions."""

import dataclasses

import numpy as np
from scipy.spatial.distance import cdist

from ..package.arguments import between
from ..package.rounding import SAME, Tree, canonical_order, first_largest, nearest_of, ranked, roundoff
from .farthest import FarthestPoints
from .reduction import AbstractReduction

BATCH = 256  # candidates for the next nodes in a batch
WIDTH = 8  # entries in a row of a sweep's table


def farthest_first(points: np.ndarray, earlier: np.ndarray, images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orders nodes so that the next is always the farthest from its predecessors.

    Also finds nearest predecessors. The `earlier` nodes are predecessors of all nodes, and mirror
    images of a node, of its number in `images` (b,), are its predecessors. Without earlier nodes,
    the first node is the farthest from the middle, and the node farthest from it counts as its
    nearest predecessor. A duplicate of a predecessor is left out. Duplicates and earlier nodes are
    their own nearest predecessors.
    """
    # A batch holds the nodes with the largest distances. Independent ones are picked together. Only
    # nodes within the distance of a picked node can come nearer to it.
    rank = canonical_order(points)
    place = np.argsort(rank)
    ordered = points[rank].astype(float)
    distance, nearest = _own_images(ordered, images[rank])
    start = place[earlier]
    if not len(earlier):
        start = _first(ordered, distance, nearest)
    others = np.setdiff1d(np.arange(len(points)), start)
    _approach(distance, nearest, others, *_nearest_of(ordered, start, others))
    radius = np.zeros(len(points))
    if not len(earlier):
        radius[start] = distance[start]
    distance[start] = 0
    tree, least = Tree(ordered), roundoff(points)
    while (batch := _farthest(distance, least)).size:
        picked = _certain(ordered, distance, batch)
        radius[picked], distance[picked] = distance[picked], 0
        around = tree.query_ball_point(ordered[picked], radius[picked])
        near, node = _joined(around), np.repeat(picked, [len(ids) for ids in around])
        gap = np.linalg.norm(ordered[near] - ordered[node], axis=1)
        inside = gap < radius[node] * (1 - SAME)
        _approach(distance, nearest, near[inside], node[inside], gap[inside])
    nearest[radius == 0] = np.flatnonzero(radius == 0)
    order = np.lexsort((np.arange(len(points)), -radius))[: np.count_nonzero(radius)]
    return rank[order], rank[nearest[place]]


@dataclasses.dataclass(frozen=True)
class Share(AbstractReduction):
    """Chooses a fraction of the points, at least one, as `FarthestPoints` does."""

    fraction: float

    def __post_init__(self):
        between("fraction", self.fraction, 0, 1, "(]")

    def __call__(self, points: np.ndarray) -> np.ndarray:
        count = int(np.ceil(self.fraction * len(points)))
        return FarthestPoints(count)(points) if count else np.zeros(0, dtype=np.int64)


def _own_images(points: np.ndarray, images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    distance, nearest = np.full(len(points), np.inf), np.arange(len(points))
    # Sorted by number, the images of a node are neighbours. Rows `shift` places apart are compared
    # where their numbers are equal, for all shifts up to the largest group.
    order = np.argsort(images, kind="stable")
    for shift in range(1, int(np.bincount(np.unique(images, return_inverse=True)[1]).max())):
        for here, there in ((order[shift:], order[:-shift]), (order[:-shift], order[shift:])):
            same = images[here] == images[there]
            here, there = here[same], there[same]
            gap = np.linalg.norm(points[here] - points[there], axis=1)
            closer = gap < (1 - SAME) * distance[here]
            distance[here[closer]], nearest[here[closer]] = gap[closer], there[closer]
    return distance, nearest


def _first(points: np.ndarray, distance: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    first = first_largest(np.linalg.norm(points - points.mean(axis=0), axis=1))
    if nearest[first] == first:
        away = np.linalg.norm(points - points[first], axis=1)
        distance[first], nearest[first] = away.max(), first_largest(away)
    return np.array([first])


def _nearest_of(points: np.ndarray, chosen: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    nearest = nearest_of(points[others], points[chosen], chosen)
    return nearest, np.linalg.norm(points[others] - points[nearest], axis=1)


def _farthest(distance: np.ndarray, least: float) -> np.ndarray:
    """Nodes with the largest distances above `least`, largest first; ties by first node."""
    last = np.partition(distance, -min(BATCH, len(distance)))[-min(BATCH, len(distance))]
    above, below = np.flatnonzero(distance > (1 + SAME) * last), (1 - SAME) * last
    equal = np.flatnonzero((distance >= below) & (distance <= (1 + SAME) * last))
    batch = np.concatenate([above, equal[: BATCH - len(above)]])
    batch = batch[distance[batch] > least]
    return batch[np.lexsort((batch, ranked(-distance[batch], SAME * distance.max())))]


def _certain(points: np.ndarray, distance: np.ndarray, batch: np.ndarray) -> np.ndarray:
    """The nodes of a batch whose distance does not change by earlier nodes of the batch."""
    gap = np.where(np.tri(len(batch), k=-1, dtype=bool), cdist(points[batch], points[batch]), np.inf)
    return batch[gap.min(axis=1) >= distance[batch] * (1 - SAME)]


def _approach(distance: np.ndarray, nearest: np.ndarray, near: np.ndarray, node: np.ndarray, gap: np.ndarray) -> None:
    """Updates distances and nearest nodes in place: `near[k]` is at `gap[k]` from `node[k]`."""
    closer = np.flatnonzero(gap < (1 - SAME) * distance[near])
    np.minimum.at(distance, near[closer], gap[closer])
    closer = closer[gap[closer] <= (1 + SAME) * distance[near[closer]]]
    closer = closer[np.argsort(-node[closer], kind="stable")]  # the first of equals is written last
    nearest[near[closer]] = node[closer]


def _joined(lists) -> np.ndarray:
    return np.concatenate([np.zeros(0, dtype=np.int64), *(np.asarray(ids, dtype=np.int64) for ids in lists)])


def overlaps(
    points: np.ndarray, centres: np.ndarray, radius: np.ndarray, targets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (target, centre) within the centre's radius (b,), by target, then centre."""
    tree = Tree(targets, leafsize=32, balanced_tree=False, compact_nodes=False)
    around = tree.query_ball_point(points[centres], radius[centres], return_sorted=False)
    target, rank = _joined(around), np.repeat(np.arange(len(centres)), [len(ids) for ids in around])
    order = np.lexsort((rank, target))
    return target[order], centres[rank[order]]


def padded(target: np.ndarray, centre: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lays pairs, sorted by target, into rows (count, k) of centres, with a mask of the pairs."""
    sizes = np.bincount(target, minlength=count)
    column = np.arange(len(target)) - (np.cumsum(sizes) - sizes)[target]
    rows = np.zeros((count, max(1, sizes.max(initial=0))), dtype=np.int32)
    used = np.zeros(rows.shape, dtype=bool)
    rows[target, column], used[target, column] = centre, True
    return rows, used


Sweep = tuple[np.ndarray, np.ndarray]
"""The order in which a triangular system is solved: s steps of r rows. A row adds up to `WIDTH`
entries of its owner: positions (s, r, WIDTH), -1 for padding, and owners (s, r).
"""


def sweeps(row: np.ndarray, column: np.ndarray, count: int) -> tuple[Sweep, Sweep]:
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
    return _sweep(row, level[row]), _sweep(column, level.max(initial=0) - level[column])


def _sweep(owner: np.ndarray, level: np.ndarray) -> Sweep:
    """Lays entries (e,), sorted by level and owner, into steps of rows."""
    # The entries of one owner within a level fill rows of `WIDTH`. All steps have equally many
    # rows, a quarter of the mean number of rows of a level. A level begins with a new step; the
    # rest of its last step stays empty.
    if not owner.size:
        return np.zeros((0, 1, WIDTH), dtype=np.int32), np.zeros((0, 1), dtype=np.int32)
    order = np.lexsort((owner, level))
    level, owner = level[order], owner[order]
    first = np.r_[True, (owner[1:] != owner[:-1]) | (level[1:] != level[:-1])]
    start = np.flatnonzero(first)[np.cumsum(first) - 1]
    within = np.arange(len(owner)) - start
    begins = within % WIDTH == 0
    row = np.cumsum(begins) - 1  # of a table without padding
    rows_of_level = np.bincount(level[begins])
    rows = -(-int(rows_of_level.sum()) // (4 * len(rows_of_level)))
    steps_of_level = -(-rows_of_level // rows)
    first_row = np.cumsum(rows_of_level) - rows_of_level
    first_slot = rows * (np.cumsum(steps_of_level) - steps_of_level)
    slot = first_slot[level] + row - first_row[level]
    steps = int(steps_of_level.sum())
    entries, owners = np.full((steps * rows, WIDTH), -1, dtype=np.int32), np.zeros(steps * rows, dtype=np.int32)
    entries[slot, within % WIDTH], owners[slot] = order, owner
    return entries.reshape(steps, rows, WIDTH), owners.reshape(steps, rows)
