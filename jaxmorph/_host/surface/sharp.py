"""Sharp edges of walls in 2-D, and places behind them: mirror images of the wall in its own tip."""

import numpy as np

from ..package.rounding import SAME, distinct

SHARP = np.cos(np.deg2rad(60))
"""Cosine of the angle between the two edges of a tip below which the wall is sharp there."""

AWAY = 0.7
"""Least distance of such a place from all of the wall, relative to its distance from the tip."""


def behind_tips(
    points: np.ndarray, pairs: np.ndarray, length: np.ndarray, closest: float, room: np.ndarray
) -> np.ndarray:
    """Lists rows (g, 3): a sharp tip of a wall, and a node on either side of it.

    The mirror image in the tip of the middle of both nodes lies behind the tip. It is `length` away or one edge, whichever is
    more, no less than `closest`, and no more than `room`. These are given for each edge (e,) of the walls, `pairs` (e, 2).
    """
    first, same = distinct(points[pairs.ravel()])
    rows, ends = pairs.ravel()[first], same.reshape(-1, 2)  # the two nodes of a closed edge are one place
    place = points[rows]
    every = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
    count = np.bincount(every[:, 0], minlength=len(place))
    beside = every[:, 1][np.minimum((np.cumsum(count) - count)[:, None] + np.arange(2), len(every) - 1)]
    arms = place[beside] - place[:, None]
    is_sharp = np.sum(arms[:, 0] * arms[:, 1], axis=1) > SHARP * (1 + SAME) * np.linalg.norm(arms, axis=2).prod(axis=1)
    tips = []
    for tip in np.flatnonzero((count == 2) & is_sharp).tolist():
        edge = np.flatnonzero((ends == tip).any(axis=1))
        sides = [_walk(place, beside, count, tip, start, length[edge].min()) for start in beside[tip].tolist()]
        image = 2 * place[tip] - place[sides].mean(axis=0)
        step = np.linalg.norm(image - place[tip])
        is_free = np.linalg.norm(place - image, axis=1).min() > AWAY * (1 + SAME) * step
        if closest * (1 + SAME) < step < room[edge].min() * (1 - SAME) and is_free:
            tips.append([tip, *sides])
    return rows[np.array(tips, dtype=np.int64).reshape(-1, 3)]


def _walk(place: np.ndarray, beside: np.ndarray, count: np.ndarray, tip: int, node: int, length: float) -> int:
    """Follows the wall from a tip to the first node that is as far away as `length`, or that is the last one."""
    before = tip
    while count[node] == 2 and np.linalg.norm(place[node] - place[tip]) < length * (1 - SAME):
        ahead = int(beside[node, 0] if beside[node, 0] != before else beside[node, 1])
        if ahead == tip:
            break
        before, node = node, ahead
    return node
