"""Sharp tips of walls in 2-D, and places behind them: mirror images of the wall in its own tip."""

import dataclasses

import numpy as np

from ..package.rounding import SAME, distinct

SHARP = np.cos(np.deg2rad(60))
"""Cosine of the angle between the two edges of a tip below which the wall is sharp there."""

NEARBY = 0.002, 0.008, 0.032
"""Distances of sources from a sharp tip, relative to the mean chord: waves invert cells at tips."""

AWAY = 0.7
"""Least distance of a place behind a tip from the wall, relative to its distance from the tip."""


@dataclasses.dataclass(frozen=True)
class Tips:
    """Sharp tips of walls in 2-D, and walls as chains of places (coincident nodes are one).

    - `rows` (p,), `points` (p, 2): a row of the surface at every place, and its coordinates.
    - `ends` (e, 2): the two places of every edge.
    - `count` (p,), `beside` (p, 2): number of neighbours of a place, and two of them.
    - `tips` (t,): places at which a wall is sharp.
    """

    rows: np.ndarray
    points: np.ndarray
    ends: np.ndarray
    beside: np.ndarray
    count: np.ndarray
    tips: np.ndarray

    def lengths(self, tip: int, lengths: np.ndarray) -> np.ndarray:
        """Selects, from the `lengths` (e,) of the edges, the lengths of a tip's edges."""
        return lengths[(self.ends == tip).any(axis=1)]

    def sides(self, tip: int, length: float) -> list[int]:
        """Finds the first place at the distance `length` on both sides of a tip."""
        return [self._walk(tip, start, length) for start in self.beside[tip].tolist()]

    def _walk(self, tip: int, place: int, length: float) -> int:
        """Follows the wall from a tip to the first place at distance `length`, or to its end."""
        before = tip
        while self.count[place] == 2 and np.linalg.norm(self.points[place] - self.points[tip]) < length * (1 - SAME):
            ahead = int(self.beside[place, 0] if self.beside[place, 0] != before else self.beside[place, 1])
            if ahead == tip:
                break
            before, place = place, ahead
        return place


def sharp_tips(points: np.ndarray, pairs: np.ndarray) -> Tips:
    """Finds the sharp tips of the walls with the edges `pairs` (e, 2)."""
    first, same = distinct(points[pairs.ravel()])
    rows, ends = pairs.ravel()[first], same.reshape(-1, 2)  # the two nodes of a closed edge are one place
    place = points[rows]
    directed = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)  # sorted by start
    count = np.bincount(directed[:, 0], minlength=len(place))
    beside = directed[:, 1][np.minimum((np.cumsum(count) - count)[:, None] + np.arange(2), len(directed) - 1)]
    arms = place[beside] - place[:, None]
    is_sharp = np.sum(arms[:, 0] * arms[:, 1], axis=1) > SHARP * (1 + SAME) * np.linalg.norm(arms, axis=2).prod(axis=1)
    return Tips(rows, place, ends, beside, count, np.flatnonzero((count == 2) & is_sharp))


def behind_tips(walls: Tips, length: np.ndarray, closest: float, room: np.ndarray) -> np.ndarray:
    """Lists rows (g, 3): a sharp tip of a wall, and a node on either side.

    The middle of the two nodes, mirrored in the tip, lies behind the tip. Its distance is at least
    `length`, at least one edge, more than `closest`, and less than `room`. Edges (e,) of the walls
    have `length` and `room`.
    """
    place, found = walls.points, []
    for tip in walls.tips.tolist():
        sides = walls.sides(tip, walls.lengths(tip, length).min())
        image = 2 * place[tip] - place[sides].mean(axis=0)
        step = np.linalg.norm(image - place[tip])
        is_free = np.linalg.norm(place - image, axis=1).min() > AWAY * (1 + SAME) * step
        if closest * (1 + SAME) < step < walls.lengths(tip, room).min() * (1 - SAME) and is_free:
            found.append([tip, *sides])
    return walls.rows[np.array(found, dtype=np.int64).reshape(-1, 3)]


def beside_tips(walls: Tips, chord: np.ndarray) -> np.ndarray:
    """Lists rows on both sides of sharp tips, at distances `NEARBY`; edges (e,) have a `chord`."""
    places = [
        place
        for tip in walls.tips.tolist()
        for share in NEARBY
        for place in walls.sides(tip, share * walls.lengths(tip, chord).min())
    ]
    return walls.rows[np.unique(np.array(places, dtype=np.int64))]
