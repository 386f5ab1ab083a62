"""Faces of a surface: closest places, gaps between walls, and faces that cross once nodes move."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..cells.topology import Pair
from ..linear.products import cofactor_rows, cross_rows, outward
from ..package.rounding import Tree, morton_order

CLOSEST = 12  # faces of other walls, of nearest middles, to which a node's distance is measured
BLOCK = 1 << 12  # points of a block
NEAR = 8  # nearest simplices that bound the distance to all others


def share_left(
    before: np.ndarray, after: np.ndarray, wall: np.ndarray, faces: np.ndarray, touching: float
) -> np.ndarray:
    """Share (b,) of the gap at every row that a motion leaves; infinite without a gap. The gap
    before is the smaller of those at the row and at the corners of the face that is nearest
    afterwards: sliding walls keep their gap. Distances up to `touching` count as no gap.
    """
    first = gaps(before, wall, faces)[0]
    second = gaps(after, wall, faces)
    narrowest = np.minimum(first, first[second[1]].min(axis=1))
    known = np.isfinite(second[0]) & (narrowest > touching)
    return np.where(known, second[0] / np.where(known, narrowest, 1), np.inf)


def gaps(points: np.ndarray, wall: np.ndarray, faces: np.ndarray) -> Pair:
    """Each point's distance (b,) from other walls, else infinite, and the face (b, d) there. `wall`
    (b,) numbers the walls; `faces` are rows of `points`, segments (f, 2) or triangles (f, 3). A
    face between two walls does not count.
    """
    faces = faces[(wall[faces] == wall[faces[:, :1]]).all(axis=1)]
    distance = np.full(len(points), np.inf)
    nearest = np.zeros((len(points), faces.shape[1]), dtype=np.int64)
    for label in np.unique(wall):
        here = np.flatnonzero(wall == label)
        others = faces[wall[faces[:, 0]] != label]
        if len(others):
            tree = Tree(
                points[others].mean(axis=1), leafsize=32, balanced_tree=False, compact_nodes=False
            )
            near = others[
                tree.query(points[here], k=range(1, min(CLOSEST, len(others)) + 1))[1]
            ].swapaxes(0, 1)
            away = np.stack([_places(points[candidates], points[here])[1] for candidates in near])
            best = away.argmin(axis=0), np.arange(len(here))
            distance[here] = away[best]
            nearest[here] = near[best]
    return distance, nearest


def fans(ids: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Cuts polygons, of `counts` corners in `ids`, into triangles (t, 3) about first corners."""
    last = np.cumsum(counts) - 1
    first = last - counts + 1
    inner = np.delete(np.arange(len(ids)), np.concatenate([first, last]))
    return ids[np.stack([np.repeat(first, counts - 2), inner, inner + 1], axis=1)]


def closest(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Finds the first simplex (m,) of `corners` (t, c, d) that is closest to each of `x` (m, d).
    Returns its number, the weights (m, c) of its corners at its closest place, and the distance.
    """
    # Simplices of one size are searched together: one ball around a point holds all that can be
    # closest, and a few long ones do not make candidates of all.
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    size = np.frexp(np.maximum(radius, 1e-9 * radius.max()))[1]
    groups = [np.flatnonzero(size == exponent) for exponent in np.unique(size)]
    trees = [(group, Tree(centre[group]), radius[group].max()) for group in groups]
    blocks = [
        _closest(trees, corners, x[at : at + BLOCK]) for at in range(0, max(len(x), 1), BLOCK)
    ]
    return tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))


def _closest(
    trees: list, corners: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    bound = np.full(len(x), np.inf)
    rows = []
    simplices = []
    for group, tree, _ in trees:
        near = group[tree.query(x, k=range(1, min(NEAR, len(group)) + 1))[1]]
        distance = _places(corners[near.ravel()], np.repeat(x, near.shape[1], axis=0))[1]
        bound = np.minimum(bound, distance.reshape(near.shape).min(axis=1))
    for group, tree, radius in trees:
        row, member = tree.within(x, (bound + radius) * (1 + 1e-9))
        rows.append(row)
        simplices.append(group[member])
    row = np.concatenate(rows)
    simplex = np.concatenate(simplices)
    weights, distance = _places(corners[simplex], x[row])
    order = np.lexsort((simplex, distance, row))
    best = order[np.unique(row[order], return_index=True)[1]]
    return simplex[best], weights[best], distance[best]


def _places(corners: np.ndarray, x: np.ndarray) -> Pair:
    """Weights (m, c) of corners (m, c, d) at places closest to `x`, and distances."""
    choices = []
    for i, j in itertools.combinations(range(corners.shape[1]), 2):
        along = corners[:, j] - corners[:, i]
        weights = np.zeros(corners.shape[:2])
        length = np.einsum("md,md->m", along, along)
        share = np.einsum("md,md->m", x - corners[:, i], along) / np.where(length > 0, length, 1)
        weights[:, j] = np.clip(share, 0, 1)
        weights[:, i] = 1 - weights[:, j]
        choices.append(weights)
    if corners.shape[1] == 3:  # the foot of the perpendicular, if it is inside
        a = corners[:, 0]
        u = corners[:, 1] - corners[:, 0]
        v = corners[:, 2] - corners[:, 0]
        normal = cross_rows(u, v)
        arm = x - a
        area = np.einsum("md,md->m", normal, normal)
        turned = np.stack([cross_rows(arm, v), cross_rows(u, arm)], axis=1)
        shares = np.einsum("mcd,md->mc", turned, normal) / np.where(area > 0, area, 1)[:, None]
        weights = np.column_stack([1 - shares.sum(axis=1), shares])
        inside = (area > 0) & (weights >= 0).all(axis=1)
        choices.append(np.where(inside[:, None], weights, choices[0]))
    places = np.einsum("emc,mcd->emd", choices, corners)
    distance = np.linalg.norm(places - x, axis=2)
    best = distance.argmin(axis=0), np.arange(len(x))
    return np.stack(choices)[best], distance[best]


AFTER, BEFORE = (
    1e-9,
    1e-6,
)  # slack of a crossing, relative to the faces: faces that nearly touched before do not count
PARALLEL = 1e-9  # sine of the angle below which an edge lies along a face, and does not cross it
TOGETHER = 1 << 17  # pairs of faces in a block
SPLIT = 8  # parts of a straight way, in each of which a node changes sides once at most
HALVES = 40  # bisections of a way to the place where a node passes a face
PAIRS_OF_FACE = 64  # pairs of a face, on average, beyond which none is compared: time is bounded
PAIRS_ALWAYS = 1 << 18  # pairs that are compared at any rate


class TooManyPairs(Exception): ...


def crossing_faces(
    points: np.ndarray, moved: np.ndarray, faces: np.ndarray, place: np.ndarray
) -> Pair:
    """Finds pairs (k, 2) of faces that meet only after the motion, and where (k, d) they meet.
    `faces` are segments (f, 2) or triangles (f, 3), rows of `points` (b, d), which are `moved`.
    Faces with a common number of `place` (b,) are neighbours, and do not count.
    """
    pairs = overlapping_boxes(moved[faces], (points != moved).any(axis=1)[faces].any(axis=1))
    found = [pairs[:0]]
    places = [points[:0]]
    for start in range(0, len(pairs), TOGETHER):
        both = pairs[start : start + TOGETHER]
        first, second = place[faces[both]].swapaxes(0, 1)
        both = both[~(first[:, :, None] == second[:, None]).any(axis=(1, 2))]
        where = _meeting(moved[faces[both]], AFTER)
        met = np.flatnonzero(np.isfinite(where[:, 0]))
        new = met[np.isnan(_meeting(points[faces[both[met]]], BEFORE)[:, 0])]
        found.append(both[new])
        places.append(where[new])
    return np.concatenate(found), np.concatenate(places)


def overlapping_boxes(
    corners: np.ndarray, is_moving: np.ndarray, after: np.ndarray | None = None
) -> np.ndarray:
    """Pairs (p, 2) of faces (f, corners, d), one moving, with overlapping boxes, each pair once.
    With their places `after` a motion, those that no axis separates in one order before and after:
    of others no two points come together on straight ways. Raises `TooManyPairs`.
    """
    # A box is a row: its least coordinates, then its largest ones, negative. The box of two boxes
    # is their minimum, and two boxes overlap if no least coordinate exceeds the other's largest.
    # One more axis goes from 0 to 1 for moving faces, and from 1 to 0 for others: these are apart.
    # Boxes are the leaves of a tree along Morton's curve. All pairs go down by one level together.
    states = [corners] if after is None else [corners, after]
    order = morton_order(corners.mean(axis=1))
    most = PAIRS_ALWAYS + PAIRS_OF_FACE * len(corners)
    levels = [np.stack([_boxes(x, ~is_moving[:, None])[order].T for x in states])]
    while levels[-1].shape[2] > 1:
        levels.append(np.minimum.reduceat(levels[-1], np.arange(0, levels[-1].shape[2], 2), axis=2))
    pairs = np.zeros((1, 2), np.int64)
    children = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    for level in levels[::-1]:
        pairs = (2 * pairs[:, None] + children).reshape(-1, 2)
        pairs = pairs[(pairs[:, 0] <= pairs[:, 1]) & (pairs[:, 1] < level.shape[2])]
        opposite = np.roll(level, level.shape[1] // 2, axis=1)
        for least, largest in zip(level.swapaxes(0, 1), opposite.swapaxes(0, 1), strict=True):
            apart = least[:, pairs[:, 0]] + largest[:, pairs[:, 1]] > 0
            pairs = pairs[~apart.all(axis=0)]
        if len(pairs) > most:
            raise TooManyPairs
    return order[pairs[pairs[:, 0] != pairs[:, 1]]]


def _boxes(corners: np.ndarray, is_still: np.ndarray) -> np.ndarray:
    slack = AFTER * np.ptp(corners, axis=1).max(axis=1, keepdims=True)
    low = corners.min(axis=1) - slack
    return np.hstack([is_still, low, is_still - 1.0, -corners.max(axis=1) - slack])


@dataclasses.dataclass(frozen=True)
class Passages:
    """Nodes (k,) that pass through faces: `pairs` (k, 2) of the node's face and the one passed.
    `shares` (k,) are those of the way, `places` (k, d) where. `senses` (k,) are 1 from inside out.
    """

    pairs: np.ndarray
    nodes: np.ndarray
    shares: np.ndarray
    places: np.ndarray
    senses: np.ndarray

    @classmethod
    def none(cls, d: int) -> "Passages":
        pairs = np.zeros((0, 2), np.int64)
        return cls(pairs, pairs[:, 0], np.zeros(0), np.zeros((0, d)), np.zeros(0))

    @classmethod
    def joined(cls, steps: "Sequence[Passages]") -> "Passages":
        return cls(*map(np.concatenate, zip(*(vars(step).values() for step in steps), strict=True)))

    def at(self, rows: np.ndarray) -> "Passages":
        return Passages(*(column[rows] for column in vars(self).values()))


def passages(
    before: np.ndarray,
    after: np.ndarray,
    faces: np.ndarray,
    place: np.ndarray,
    is_solid: np.ndarray,
) -> Passages:
    """Finds the nodes, marked by `is_solid` (b,), that change the side of a face within it while
    all rows (b, d) go straight from `before` to `after`. Nodes that touch a face at an end of the
    way do not count. Arguments as of `crossing_faces`.
    """
    moves = (before != after).any(axis=1)[faces].any(axis=1)
    pairs = overlapping_boxes(before[faces], moves, after[faces])
    found = []
    for start in range(0, max(len(pairs), 1), TOGETHER):
        both = pairs[start : start + TOGETHER]
        first, second = place[faces[both]].swapaxes(0, 1)
        both = both[~(first[:, :, None] == second[:, None]).any(axis=(1, 2))]
        both = np.concatenate([both, both[:, ::-1]])
        both = both[is_solid[faces[both[:, 0]]].all(axis=1)]
        node = faces[both[:, 0]].ravel()
        both = np.repeat(both, faces.shape[1], axis=0)
        # a node has several faces, and is compared with another face once
        single = np.unique(node * len(faces) + both[:, 1], return_index=True)[1]
        found.append(_passed(before, after, faces, both[single], node[single]))
    every = Passages.joined(found)
    keys = np.stack([every.nodes, every.pairs[:, 1], every.shares])
    return every.at(np.unique(keys, axis=1, return_index=True)[1])


def _passed(
    before: np.ndarray, after: np.ndarray, faces: np.ndarray, pairs: np.ndarray, node: np.ndarray
) -> Passages:
    near = _come_near(before, after, faces[pairs[:, 1]], node)
    pairs = pairs[near]
    node = node[near]
    corners = faces[pairs[:, 1]]
    times = np.linspace(0, 1, SPLIT + 1)
    sides = np.stack([_side(*_between(before, after, t, corners, node), 0.0) for t in times])
    for k in (0, -1):
        sides[k] = _side(*_between(before, after, times[k], corners, node))
    for k in range(1, SPLIT):  # a node on a face on the way is still on the side it came from
        sides[k] = np.where(sides[k] == 0, sides[k - 1], sides[k])
    part, some = np.nonzero(sides[:-1] * sides[1:] < 0)
    pairs = pairs[some]
    node = node[some]
    corners = corners[some]
    sense = sides[part + 1, some]
    low = times[part]
    high = times[part + 1]
    for _ in range(HALVES):
        share = (low + high) / 2
        is_before = _side(*_between(before, after, share, corners, node), 0.0) * sense < 0
        low = np.where(is_before, share, low)
        high = np.where(is_before, high, share)
    face, where = _between(before, after, low, corners, node)
    hit = _places(face, where)[1] <= BEFORE * np.ptp(face, axis=1).max(axis=1)
    return Passages(pairs, node, low, where, sense).at(np.flatnonzero(hit))


def _come_near(
    before: np.ndarray, after: np.ndarray, corners: np.ndarray, node: np.ndarray
) -> np.ndarray:
    """Lists pairs of faces (k, c) and nodes (k,) that no axis separates in one order."""
    near = np.ones(len(node), dtype=bool)
    for start, end in zip(before.T, after.T, strict=True):
        columns = [
            x[corners[:, c]] - x[node] for x in (start, end) for c in range(corners.shape[1])
        ]
        near &= np.minimum.reduce(columns) <= 0
        near &= np.maximum.reduce(columns) >= 0
    return np.flatnonzero(near)


def _between(
    before: np.ndarray, after: np.ndarray, share: Any, corners: np.ndarray, node: np.ndarray
) -> Pair:
    """Faces (k, c, d) and nodes (k, d) at a share, one or (k,), of the way."""
    share = np.reshape(share, (-1, 1))
    face = before[corners] + share[:, None] * (after[corners] - before[corners])
    return face, before[node] + share * (after[node] - before[node])


def _side(corners: np.ndarray, x: np.ndarray, slack: float = BEFORE) -> np.ndarray:
    """The side (k,) of faces on which points (k, d) lie: 1 outside, -1 inside, 0 on the face."""
    normal = outward(corners)
    height = np.einsum("kd,kd->k", normal, x - corners[:, 0])
    if not slack:
        return np.sign(height)
    size = np.linalg.norm(normal, axis=1) * np.ptp(corners, axis=1).max(axis=1)
    return np.where(np.abs(height) > slack * size, np.sign(height), 0)


def _meeting(corners: np.ndarray, slack: float) -> np.ndarray:
    """Where pairs (k, 2, c, d) of faces meet (k, d); NaN for none, or in one plane."""
    where = np.full((len(corners), corners.shape[3]), np.nan)
    for pairs in (corners, corners[:, ::-1]):
        edges, others = pairs.swapaxes(0, 1)
        for start, end in zip(
            edges.swapaxes(0, 1), np.roll(edges, -1, axis=1).swapaxes(0, 1), strict=True
        ):
            share = _share(start, end - start, others, slack)[:, None]
            where = np.where(np.isfinite(share), start + share * (end - start), where)
    return where


def _share(start: np.ndarray, along: np.ndarray, corners: np.ndarray, slack: float) -> np.ndarray:
    """The share (k,) of a segment up to where it meets a simplex (k, d, d); NaN if it does not."""
    # arm = share * along - places of the simplex * its edges, solved by Cramer's rule
    rows = cofactor_rows([along, *(corners[:, 1:] - corners[:, :1]).swapaxes(0, 1)])
    volume = np.einsum("kd,kd->k", rows[0], along)
    is_steep = np.abs(volume) > PARALLEL * np.linalg.norm(along, axis=1) * np.linalg.norm(
        rows[0], axis=1
    )
    share, *places = np.einsum("rkd,kd->rk", rows, corners[:, 0] - start) / np.where(
        is_steep, volume, 1
    )
    places = -np.array(places)
    inside = np.minimum(share, places.min(axis=0)) >= -slack
    return np.where(
        is_steep & inside & (np.maximum(share, places.sum(axis=0)) <= 1 + slack), share, np.nan
    )
