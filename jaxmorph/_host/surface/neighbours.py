"""Nearest nodes: the nodes of a wall that lie nearest to a point."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import ndarray

from ..cells.topology import Pair
from ..package.cores import over_blocks
from ..package.rounding import (
    Tree,
    few_by,
    lowest_of_equals,
    morton_order,
    nearest_few,
    roundoff,
)
from ..tolerances import SAME

WALLS_APART = 16  # most walls for which every wall has a search tree of its own
LEAP_NEIGHBOURS = 8  # neighbours among whose distances a leap is searched

Once = Callable[[Any, Callable[[], Any]], Any]


def digest(values: ndarray) -> tuple[int, int]:
    """A cache key of an array: its length and a hash of its bytes."""
    return len(values), hash(values.tobytes())


def near_walls(
    surface: ndarray,
    wall: ndarray,
    reach: ndarray,
    points: ndarray,
    count: int,
    once: Once = lambda key, make: make(),
) -> Pair:
    """Finds the points near a wall, and the ids (k, count + 1) of the surface nodes near them.

    `reach` (b,) is the distance to which a node's wall reaches into the volume. A row holds the
    `count` nearest nodes of the nearest wall, nearest first, then lowest. Its last entry is the
    nearest node of another wall within eight times the reach, or the first entry again. A point
    nearer to another wall is left out. `once(key, make)` caches what depends on the surface alone.
    """
    # A search finds the nearest node of a point within reach. The `count` nearest ones are among
    # twice as many neighbours of that node on its wall, found once a node. Then come other walls.
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, count + 1), dtype=np.int32)
    # a tree is searched three times faster for neighbours one after the other
    order = morton_order(points)
    distance, first = _search_nearest(
        surface, _divide_by_reach(wall, reach), points[order], once, reach
    )
    hit = np.flatnonzero(distance < np.inf)
    near = order[hit]
    first = first[hit]
    distance = distance[hit]
    around = once(("around", digest(wall), count), lambda: _find_around(surface, wall, 2 * count))
    rows = np.empty((len(near), count + 1), dtype=np.int32)

    def compare(part: slice) -> None:
        candidates = around[first[part]]
        offsets = [
            surface[candidates, axis] - points[near[part], axis, None]
            for axis in range(points.shape[1])
        ]
        squared = np.sum([a * a for a in offsets], axis=0)
        rows[part, :count] = _pick_closest(candidates, squared, count)

    over_blocks(compare, len(near))
    closest, other = _search_others(surface, wall, reach, points[near], wall[first], once)
    rows[:, count] = np.where(closest < np.inf, other, rows[:, 0])
    is_nearest = distance <= closest
    return near[is_nearest], rows[is_nearest]


def _search_others(
    surface: ndarray,
    wall: ndarray,
    reach: ndarray,
    points: ndarray,
    labels: ndarray,
    once: Once,
) -> Pair:
    """The nearest node of another wall than the point's own, `labels` (k,), within eight times the
    reach of this, and its distance, else infinite.
    """
    distance = np.full(len(points), np.inf)
    nearest = np.zeros(len(points), dtype=np.int32)
    for label in np.unique(labels):
        here = np.flatnonzero(labels == label)
        others = np.flatnonzero(wall != label)
        if others.size:
            far = 8 * (1 + SAME) * reach[wall == label].max()
            bounded = [(members, far) for members in searched_together(wall, others)]
            distance[here], nearest[here] = _search_nearest(surface, bounded, points[here], once)
    return distance, nearest


def _divide_by_reach(wall: ndarray, reach: ndarray) -> list[tuple[ndarray, float]]:
    # nodes of similar reach are searched together: too large a bound costs ten times as much
    size = np.frexp(reach)[1]
    bounded = []
    for members in searched_together(wall, np.flatnonzero(reach > 0)):
        groups = [members[size[members] == exponent] for exponent in np.unique(size[members])]
        bounded += [(rows, reach[rows].max()) for rows in groups]
    return bounded


def _pick_closest(nodes: ndarray, squared: ndarray, count: int) -> ndarray:
    """Picks each row's `count` nearest nodes (k, c), nearest first; ties by first node."""
    order = np.argsort(squared, axis=1, kind="stable")
    nodes, squared = (np.take_along_axis(table, order, axis=1) for table in (nodes, squared))
    is_more = squared[:, 1:] > (1 + 2 * SAME) * squared[:, :-1]
    tied = np.flatnonzero(~is_more[:, :count].all(axis=1))
    nodes[tied] = lowest_of_equals(nodes[tied], is_more[tied])
    return nodes[:, :count]


def searched_together(wall: ndarray, rows: ndarray) -> list[ndarray]:
    """Divides rows of the surface by their walls, unless there are more than `FEW`. A search in a
    plane is fast from any distance. In a tree of several planes, a search from the middle of a cube
    takes fifty times longer.
    """
    labels = wall[rows]
    walls = np.unique(labels)
    return [rows[labels == label] for label in walls] if len(walls) <= WALLS_APART else [rows]


def _search_nearest(
    surface: ndarray,
    bounded: list[tuple[ndarray, float]],
    points: ndarray,
    once: Once,
    reach: ndarray | None = None,
) -> Pair:
    """The nearest node of several lists within their bounds, and its distance, else infinite. With
    `reach` (b,), a node counts only within its own reach. Ties go to the first list.
    """
    trees = [
        once(("tree", digest(members)), lambda members=members: _make_tree(surface[members]))
        for members, _ in bounded
    ]
    distance = np.full(len(points), np.inf)
    nearest = np.zeros(len(points), dtype=np.int64)
    place = np.zeros(len(points), dtype=np.int32)
    slack = max(roundoff(points), roundoff(surface))

    def search_all(part: slice) -> None:
        # A tree is searched only for points whose answer so far is farther than the tree's box. The
        # tree with the nearest box comes first: it holds the answer of most points.
        away = np.stack([_measure_to_box(points[part], tree) for tree in trees])
        away[away > (1 + SAME) * np.array([[bound] for _, bound in bounded])] = np.inf
        first = away.argmin(axis=0)
        for is_first, k in itertools.product((True, False), range(len(trees))):
            is_near = (away[k] <= (1 + SAME) * distance[part]) & (away[k] < np.inf)
            rows = part.start + np.flatnonzero(((first == k) == is_first) & is_near)
            least, node = _query(trees[k], *bounded[k], points[rows], slack)
            closer = (least < distance[rows]) | ((least == distance[rows]) & (k < place[rows]))
            closer &= least < (np.inf if reach is None else reach[node])
            better = rows[closer]
            distance[better] = least[closer]
            nearest[better] = node[closer]
            place[better] = k

    over_blocks(search_all, len(points) if bounded else 0)
    return distance, nearest


def _query(tree: Tree, members: ndarray, bound: float, points: ndarray, slack: float) -> Pair:
    """Each point's distance from the nearest of the `members` within the bound, else infinite, and
    this one; ties go to the first.
    """
    if not len(points):
        return np.zeros(0), members[:0]
    several = range(1, min(2, len(members)) + 1)
    found, row = tree.query(points, k=several, distance_upper_bound=bound, workers=1)
    is_equal = (found[:, -1] <= (1 + SAME) * found[:, 0]) & (row[:, -1] < len(members))
    row = np.minimum(row[:, 0], len(members) - 1)
    row[is_equal] = few_by(tree, points[is_equal], 1, slack)[:, 0]
    return found[:, 0], members[row]


def _measure_to_box(points: ndarray, tree: Tree) -> ndarray:
    """Distances (n,) of points from the box of a tree's points."""
    box = zip(points.T, tree.mins, tree.maxes, strict=True)
    return np.sqrt(sum(np.maximum(np.maximum(low - x, x - high), 0) ** 2 for x, low, high in box))


def _make_tree(points: ndarray) -> Tree:
    """A tree for many searches: cells cut in the middle are faster than at the median."""
    return Tree(points, leafsize=32, balanced_tree=False, compact_nodes=False)


def _find_around(surface: ndarray, wall: ndarray, count: int) -> ndarray:
    """The (b, count) nearest nodes on the wall: the node itself first, and as padding."""
    around = np.empty((len(surface), count), dtype=np.int32)
    for label in np.unique(wall):
        nodes = np.flatnonzero(wall == label)
        k = min(count, len(nodes))
        nearest = nodes[nearest_few(surface[nodes], surface[nodes], k)]
        around[nodes] = np.concatenate(
            [nearest, np.repeat(nodes[:, None], count - k, axis=1)], axis=1
        )
    return around


def nearly_coincident(points: ndarray, radius: float, share: float) -> Pair:
    """Points with neighbours far nearer than the next: ids, and nearest ids, closest first. Far
    nearer means below a `share` of the distance of the next neighbour, or of the `radius`. Up to
    `AROUND` points may be near each other.
    """
    distance, nearest = map(np.asarray, Tree(points).query(points, k=LEAP_NEIGHBOURS + 1))
    distance = distance[:, 1:]  # infinite where there are no more neighbours
    jumps = (distance[:, :-1] < share * np.minimum(distance[:, 1:], radius)).any(axis=1)
    first = np.flatnonzero(jumps)[np.argsort(distance[jumps, 0], kind="stable")]
    return first, nearest[first, 1]
