"""The two sides of an airfoil: its loop is cut at nose and tail."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from .._host.cells.adjacency import parts_of

SAME = 1e-9
"""Distance in chords within which two nodes stand at one place."""

TIE = 1e-12
"""Difference in chords within which two tours are equally long."""

AT = 1e-3
"""Share of an edge within which the nose or the tail is the node at its end."""

BLUNT = 0.1
"""Largest length in chords of a blunt tail whose corner is given as the tail."""

CORNER, SHARP = np.cos(np.deg2rad([45, 135]))
"""Cosines of the turn of a loop at a corner of a blunt tail: an upper and a lower bound."""


def upper_of_loop(places: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, " k"]:
    """Marks the nodes on the upper side of a loop.

    A single node at the nose or the tail is on the upper side. Of several nodes there, as on a
    blunt tail, each side has one half. A line has no upper side.

    - `places`: along the chord from 0 to 1 and across it, in chords; in the order of the loop, in
      either sense.
    """
    x, y = places.T
    area = (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    if abs(area) < SAME:
        return np.zeros(len(places), bool)  # a line has no sides
    if area < 0:
        return upper_of_loop(places[::-1])[::-1]
    # neighbours at one place are one corner of the loop; it begins at the end of its longest edge
    lengths, count = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1), len(places)
    start = int(lengths.argmax())
    first = np.flatnonzero(np.roll(lengths, -start) > SAME)
    corners = np.roll(places, -start, axis=0)[first]

    def node(corner: int) -> int:
        return int(first[corner % len(first)]) + count * (corner // len(first))

    # counter-clockwise, the upper side runs from the middle of the tail to the middle of the nose
    tail, nose = _blunt(corners, *_cut(corners, 1.0)), _cut(corners, 0.0)
    begin = (node(tail[0]) + node(tail[1])) // 2
    end = (node(nose[0]) + node(nose[1]) - 1) // 2
    return np.roll((np.arange(count) - begin) % count <= (end - begin) % count, start)


def upper_of_points(places: Float[np.ndarray, "m 2"]) -> Bool[np.ndarray, " m"]:
    """Marks the nodes on the upper side, by the shortest way around the airfoil.

    Nodes at one place are on one side.

    - `places`: along the chord from 0 to 1 and across it, in chords.
    """
    near = KDTree(places).query_pairs(SAME, output_type="ndarray")
    spot = parts_of(near[:, 0], near[:, 1], len(places))
    different = places[np.unique(spot, return_index=True)[1]]
    upper = np.zeros(len(different), bool)
    if len(different) > 2:
        around = tour(different)
        upper[around] = upper_of_loop(different[around])
    return upper[spot]


def _cut(corners: Float[np.ndarray, "k 2"], place: float) -> tuple[int, int]:
    """Finds where the loop is nearest to a place on the chord.

    It returns the corners from the first to before the last; none within an edge.
    """
    edges, arms = np.roll(corners, -1, axis=0) - corners, np.array([[place, 0.0]]) - corners
    share = np.clip(np.sum(arms * edges, axis=1) / np.sum(edges**2, axis=1), 0, 1)
    nearest = int(np.linalg.norm(arms - share[:, None] * edges, axis=1).argmin())
    if AT < share[nearest] < 1 - AT:
        return nearest + 1, nearest + 1
    corner = nearest + int(share[nearest] > 0.5)
    return corner, corner + 1


def _blunt(corners: Float[np.ndarray, "k 2"], first: int, last: int) -> tuple[int, int]:
    """Extends one corner of a blunt tail to both of its corners."""
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(edges, axis=1)
    before = np.roll(edges, 1, axis=0)
    turn = np.sum(edges * before, axis=1) / (lengths * np.linalg.norm(before, axis=1))
    count = len(corners)
    if first == last or not SHARP < turn[first % count] < CORNER:
        return first, last
    ways = []
    for step in (1, -1):
        corner, length = first, 0.0
        while length <= BLUNT:
            length += lengths[(corner if step > 0 else corner - 1) % count]
            corner += step
            if turn[corner % count] < CORNER:
                ways.append((length, corner))
                break
    length, other = min(ways, default=(np.inf, first))
    return (min(first, other), max(first, other) + 1) if length <= BLUNT else (first, last)


def tour(places: Float[np.ndarray, "m 2"]) -> Int[np.ndarray, " m"]:
    """Finds the shortest tour of all places, along the chord and back (bitonic).

    - `places`: different places, along the chord and across it, in chords.
    """
    along = np.argsort(places[:, 0], kind="stable")
    column = np.cumsum(np.diff(places[along, 0], prepend=-np.inf) > SAME)
    order = along[np.lexsort((places[along, 1], column))]
    ahead, count = places[order], len(order)
    # two chains reach the nodes up to k: one ends at k, the other at j < k, and `cost[j]` is the
    # length of both
    cost, before = np.zeros(count), np.zeros(count, int)
    cost[0] = np.linalg.norm(ahead[1] - ahead[0])
    for k in range(1, count):
        following = ahead[min(k + 1, count - 1)]
        total = cost[:k] + np.linalg.norm(ahead[:k] - following, axis=1)
        before[k] = int(np.argmax(total <= total.min() + TIE))
        cost[:k] += np.linalg.norm(following - ahead[k])
        cost[k] = total[before[k]]
    # backwards: k was reached from k - 1, or from `before[k - 1]` where the other chain ends there
    other = int(before[count - 1])
    chains = [count - 1], [other]
    for k in range(count - 1, 1, -1):
        reached = int(before[k - 1]) if other == k - 1 else k - 1
        chains[int(chains[1][-1] == k)].append(reached)
        other = reached if other == k - 1 else other
    return order[chains[0] + chains[1][::-1]]
