"""Nearest nodes: which nodes of which wall lie nearest to a point."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..package.cores import Tree
from ..package.rounding import SAME, nearest_few
from .graph import morton_order

FEW = 16
"""Walls up to which each is searched on its own."""

AROUND = 8
"""Neighbours among which a leap in their distances is looked for."""

Once = Callable[[Any, Callable[[], Any]], Any]


def at_once(key: Any, make: Callable[[], Any]) -> Any:
    """Calls `make` without a cache."""
    return make()


def digest(values: np.ndarray) -> tuple[int, int]:
    """Makes a cache key of an array: its length and a hash of its bytes."""
    return len(values), hash(values.tobytes())


def near_walls(
    surface: np.ndarray, wall: np.ndarray, reach: np.ndarray, points: np.ndarray, count: int, once: Once = at_once
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the points that lie near a wall, and the ids (k, count + 1) of the surface nodes that matter to them.

    `reach` (b,) is how far a node's wall reaches into the volume. A row holds the `count` nearest nodes of the nearest
    wall, nearest first, of equals the first one first. Its last entry is the nearest node of any other wall within eight
    times the reach, or the first entry again. A point belongs to the wall of its nearest node alone; a point nearer to another
    wall is left out.

    `once(key, make)` keeps what depends on the surface and its walls alone, for other points.
    """
    # Searches give each point its nearest node within reach. Its `count` nearest nodes are then among that node's
    # 2 count neighbours on the wall, which are found once a node instead of once a point. At last each wall's points are
    # compared with the nodes of all other walls.
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, count + 1), dtype=np.int32)
    order = morton_order(points)  # a tree is searched three times faster for neighbours one after the other
    distance, first = _nearest_within(surface, wall, reach, points[order], once)
    hit = np.flatnonzero(distance < np.inf)
    near, first, distance = order[hit], first[hit], distance[hit]
    around = once(("around", digest(wall), count), lambda: _around(surface, wall, 2 * count))
    rows = np.empty((len(near), count + 1), dtype=np.int32)
    for start in range(0, len(near), 65536):
        part = slice(start, start + 65536)
        candidates = around[first[part]]
        offsets = [surface[candidates, axis] - points[near[part], axis, None] for axis in range(points.shape[1])]
        rows[part, :count] = _closest(candidates, np.sum([a * a for a in offsets], axis=0), count)
    rows[:, count] = rows[:, 0]
    is_nearest = np.ones(len(near), dtype=bool)
    for label in np.unique(wall[first]):
        here, others = np.flatnonzero(wall[first] == label), np.flatnonzero(wall != label)
        if others.size:
            far = 8 * (1 + SAME) * reach[wall == label].max()
            bounded = [(members, far) for members in searched_together(wall, others)]
            closest, other = _nearest(surface, bounded, points[near[here]], once)
            close = np.flatnonzero(closest < np.inf)
            rows[here[close], count] = other[close]
            is_nearest[here[close]] = distance[here[close]] <= closest[close]
    return near[is_nearest], rows[is_nearest]


def _closest(nodes: np.ndarray, squared: np.ndarray, count: int) -> np.ndarray:
    """Picks the `count` nearest nodes from each row (k, c), nearest first; ties go to the first."""
    order = np.argsort(squared, axis=1, kind="stable")
    nodes, squared = (np.take_along_axis(table, order, axis=1) for table in (nodes, squared))
    is_more = squared[:, 1:] > (1 + 2 * SAME) * squared[:, :-1]
    tied = np.flatnonzero(~is_more[:, :count].all(axis=1))
    rank = np.zeros((len(tied), nodes.shape[1]), dtype=np.int64)
    np.cumsum(is_more[tied], axis=1, out=rank[:, 1:])
    order = np.argsort((rank << 32) + nodes[tied], axis=1)
    nodes[tied] = np.take_along_axis(nodes[tied], order, axis=1)
    return nodes[:, :count]


def _nearest_within(
    surface: np.ndarray, wall: np.ndarray, reach: np.ndarray, points: np.ndarray, once: Once
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the nearest surface node within whose reach a point lies, and its distance, infinite where there is none.

    Nodes of about the same reach are searched together: a bound that is far too large costs ten times as much.
    """
    bounded = []
    for members in searched_together(wall, np.flatnonzero(reach > 0)):
        size = np.frexp(reach[members])[1]
        alike = [members[size == exponent] for exponent in np.unique(size)]
        bounded += [(rows, reach[rows].max()) for rows in alike]
    return _nearest(surface, bounded, points, once, reach)


def searched_together(wall: np.ndarray, rows: np.ndarray) -> list[np.ndarray]:
    """Divides rows of the surface by their walls, unless these are many.

    The nearest node of a plane is found at once, from however far away. A tree of several planes has boxes that reach from
    one to the other: from the middle of a cube it takes fifty times longer.
    """
    labels = wall[rows]
    walls = np.unique(labels)
    return [rows[labels == label] for label in walls] if len(walls) <= FEW else [rows]


def _nearest(
    surface: np.ndarray,
    bounded: list[tuple[np.ndarray, float]],
    points: np.ndarray,
    once: Once,
    reach: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the nearest of several lists of surface nodes, each up to a bound, and its distance, infinite where there is none.

    With `reach` (b,), nodes count up to their own distance alone.
    """
    distance, nearest = np.full(len(points), np.inf), np.zeros(len(points), dtype=np.int64)
    for members, bound in bounded:
        tree = _kept_tree(surface, members, once)
        both, rows = map(np.asarray, tree.query(points, k=min(2, len(members)), distance_upper_bound=bound))
        both, rows = both.reshape(len(points), -1), rows.reshape(len(points), -1)
        apart, row = both[:, 0], np.minimum(rows[:, 0], len(members) - 1)
        equal = np.flatnonzero((both[:, -1] <= (1 + SAME) * apart) & (rows[:, -1] < len(members)))
        row[equal] = nearest_few(points[equal], surface[members], 1)[:, 0]
        node = members[row]
        closer = apart < (distance if reach is None else np.minimum(distance, reach[node]))
        distance[closer], nearest[closer] = apart[closer], node[closer]
    return distance, nearest


def _kept_tree(surface: np.ndarray, rows: np.ndarray, once: Once) -> Tree:
    return once(("tree", digest(rows)), lambda: _tree(surface[rows]))


def _tree(points: np.ndarray) -> Tree:
    """Builds a tree for many searches: cells cut in the middle are searched three times faster than cells cut at the median."""
    return Tree(points, leafsize=32, balanced_tree=False, compact_nodes=False)


def _around(surface: np.ndarray, wall: np.ndarray, count: int) -> np.ndarray:
    """Lists (b, count) the nodes nearest to each node on its wall, itself first and repeated if the wall has fewer."""
    around = np.empty((len(surface), count), dtype=np.int32)
    for label in np.unique(wall):
        nodes = np.flatnonzero(wall == label)
        k = min(count, len(nodes))
        nearest = nodes[nearest_few(surface[nodes], surface[nodes], k)]
        around[nodes] = np.concatenate([nearest, np.repeat(nodes[:, None], count - k, axis=1)], axis=1)
    return around


def nearly_coincident(points: np.ndarray, radius: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Finds points far nearer to some others than these are to the next ones: their ids and nearest points, the nearest first.

    Far nearer is below a `share` of the distance to the next ones, or of the `radius`, beyond which none counts. Up to `AROUND`
    points may be near each other.
    """
    if len(points) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    distance, nearest = map(np.asarray, Tree(points).query(points, k=min(AROUND + 1, len(points))))
    distance = distance[:, 1:]
    if distance.shape[1] < AROUND:  # there are no others
        distance = np.column_stack([distance, np.full(len(points), radius)])
    jumps = (distance[:, :-1] < share * np.minimum(distance[:, 1:], radius)).any(axis=1)
    first = np.flatnonzero(jumps)[np.argsort(distance[jumps, 0], kind="stable")]
    return first, nearest[first, 1]
