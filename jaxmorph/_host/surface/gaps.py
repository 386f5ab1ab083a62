"""Faces of a surface: closest places, gaps between walls, and faces that cross once nodes move."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from ..cells.topology import Pair
from ..linear.products import cofactor_rows, cross_rows, edges_of, outward, row_lengths
from ..package.rounding import Tree, canonical_order, morton_order, roundoff
from ..tolerances import ALIGNED, MEETS, MET_BEFORE, SAME

POINTS_TOGETHER = 1 << 12  # points of a block
NEAR_SIMPLICES = 2  # nearest simplices that bound the distance to all others
MEASURED_FIRST = 512  # rows whose share of a gap is measured before the others


def least_share_left(
    before: ndarray,
    after: ndarray,
    wall: ndarray,
    faces: ndarray,
    touching: float,
    below: float = 1.0,
) -> tuple[float, int]:
    """Smallest share of a gap that a motion leaves, and its row, where it is less than `below`;
    else `below`, or infinite without another wall. The gap before is the smaller of those at the
    row and at the corners of the face that is nearest afterwards: sliding walls keep their gap.
    Distances up to `touching` count as no gap.
    """
    # Rows are measured in the order of a lower bound of their shares, in larger and larger blocks,
    # until that of the next row is not below the least share so far.
    if len(np.unique(wall)) < 2 or not len(faces):
        return np.inf, 0
    old = WallGaps(before, wall, faces)
    new = WallGaps(after, wall, faces)
    rows, bound = _bounded_shares(old, new, faces, touching, below)
    least = below
    where = 0
    begin = 0
    size = MEASURED_FIRST
    while begin < len(rows) and bound[begin] < least:
        block = rows[begin : begin + size]
        distance, nearest = new.at(block)
        known, place = np.unique(np.column_stack([block, nearest]), return_inverse=True)
        narrowest = old.at(known)[0][place].reshape(len(block), -1).min(axis=1)
        is_gap = np.isfinite(distance) & (narrowest > touching)
        share = np.where(is_gap, distance / np.where(is_gap, narrowest, 1), np.inf)
        if share.min() < least:
            least = float(share.min())
            where = int(block[share.argmin()])
        begin += size
        size *= 4
    return least, where


def _bounded_shares(
    old: "WallGaps", new: "WallGaps", faces: ndarray, touching: float, below: float
) -> Pair:
    """Rows (k,) that matter, and lower bounds of the shares of their gaps, the least first."""
    # A row matters if it moves, or if a face that moves may be nearer than others were. A gap loses
    # at most what its two sides move, so wide ones do not matter.
    wall = old.wall
    moves = (old.points != new.points).any(axis=1)
    lost = _lost_at_most(row_lengths(new.points - old.points), wall)
    rows = np.flatnonzero(lost)
    reach = lost[rows] / (1 - below) if below < 1 else np.full(len(rows), np.inf)
    low, high = old.bounds(rows, reach.max(initial=0))
    is_narrow = (low <= reach) & np.isfinite(high) & (high > touching)
    rows = rows[is_narrow]
    high = high[is_narrow]
    within = below * high.max(initial=0)
    moving = WallGaps(new.points, wall, faces[moves[faces].any(axis=1)])
    is_near = moves[rows] | (moving.bounds(rows, within)[0] < high)
    low = new.bounds(rows, within)[0]
    bound = np.where(is_near, low / high, np.inf)
    order = np.argsort(bound)
    return rows[order], bound[order]


def _lost_at_most(size: ndarray, wall: ndarray) -> ndarray:
    """What the gap at each row (b,) can lose: its own way, and the longest of other walls."""
    number = np.unique(wall, return_inverse=True)[1]
    longest = np.zeros(number.max() + 1)
    np.maximum.at(longest, number, size)
    first = longest.argmax()
    others = np.full(len(longest), longest[first])
    others[first] = np.delete(longest, first).max()
    return size + others[number]


class WallGaps:
    """Distances of points from other walls. `wall` (b,) numbers the walls; `faces` are rows of
    `points`, segments (f, 2) or triangles (f, 3). A face between two walls does not count.
    """

    def __init__(self, points: ndarray, wall: ndarray, faces: ndarray):
        self.points = points
        self.wall = wall
        faces = faces[(wall[faces] == wall[faces[:, :1]]).all(axis=1)]
        label = wall[faces[:, 0]]
        self.walls = {number: faces[label == number] for number in np.unique(label).tolist()}
        self.searches = {number: FaceTrees(points[faces]) for number, faces in self.walls.items()}

    def bounds(self, rows: ndarray, within: float = np.inf) -> Pair:
        """Lower and upper bounds (k,) of the gaps at some rows, infinite beyond a distance."""
        low = np.full(len(rows), np.inf)
        high = np.full(len(rows), np.inf)
        for number, search in self.searches.items():
            here = np.flatnonzero(self.wall[rows] != number)
            least, most = search.bounds(self.points[rows[here]], within)
            low[here] = np.minimum(low[here], least)
            high[here] = np.minimum(high[here], most)
        return low, high

    def at(self, rows: ndarray) -> Pair:
        """Gaps (k,) at some rows, infinite without another wall, and the faces (k, d) there."""
        distance = np.full(len(rows), np.inf)
        nearest = np.repeat(rows[:, None], self.points.shape[1], axis=1)
        x = self.points[rows]
        high = self.bounds(rows)[1]
        for number, search in self.searches.items():
            here = np.flatnonzero(self.wall[rows] != number)
            here = here[search.bounds(x[here])[0] <= high[here]]
            found = search.closest(x[here])
            closer = found.distance < distance[here]
            distance[here[closer]] = found.distance[closer]
            nearest[here[closer]] = self.walls[number][found.face[closer]]
        return distance, nearest


def fans(ids: ndarray, counts: ndarray) -> ndarray:
    """Cuts polygons, of `counts` corners in `ids`, into triangles (t, 3) about first corners."""
    last = np.cumsum(counts) - 1
    first = last - counts + 1
    inner = np.delete(np.arange(len(ids)), np.concatenate([first, last]))
    return ids[np.stack([np.repeat(first, counts - 2), inner, inner + 1], axis=1)]


class Closest(NamedTuple):
    """The simplex (m,) that is closest to each point, by number, the `weights` (m, c) of its
    corners at its closest place, and the distance (m,).
    """

    face: ndarray
    weights: ndarray
    distance: ndarray


def closest(corners: ndarray, x: ndarray) -> Closest:
    """Finds the simplex of `corners` (t, c, d) that is closest to each of `x` (m, d).

    Of equally near ones it is that whose middle comes first by place.
    """
    return FaceTrees(corners).closest(x)


class FaceTrees:
    """Simplices of `corners` (t, c, d), searched by the places of their middles."""

    def __init__(self, corners: ndarray):
        # sorted by place, the first of equally near simplices is the one wanted
        self.order = canonical_order(corners.mean(axis=1))
        self.corners = corners[self.order]
        self.trees = _trees_by_size(self.corners)

    def closest(self, x: ndarray) -> Closest:
        row, near = self.nearby(x, 0.0)
        first = np.unique(row, return_index=True)[1]
        return Closest(*(column[first] for column in near))

    def nearby(self, x: ndarray, slack: float) -> tuple[ndarray, Closest]:
        """Finds the simplices that are farther than the closest one by `slack` at most, that one
        first. Rows of `x` ascend, and come with each of their simplices.
        """
        blocks = [
            _near_of_block(self.trees, self.corners, x[at : at + POINTS_TOGETHER], slack)
            for at in range(0, max(len(x), 1), POINTS_TOGETHER)
        ]
        row, simplex, weights, distance = map(np.concatenate, zip(*blocks, strict=True))
        block = np.repeat(np.arange(len(blocks)), [len(block[0]) for block in blocks])
        return row + POINTS_TOGETHER * block, Closest(self.order[simplex], weights, distance)

    def bounds(self, x: ndarray, within: float = np.inf) -> Pair:
        """Lower and upper bounds (m,) of the distances, from the nearest middles; infinite where
        these are farther than what is `within` a distance.
        """
        low = np.full(len(x), np.inf)
        high = np.full(len(x), np.inf)
        for _, tree, radius in self.trees:
            distance = tree.query(x, distance_upper_bound=within + radius)[0]
            low = np.minimum(low, np.maximum(distance - radius, 0))
            high = np.minimum(high, distance)
        return low, high


def _trees_by_size(corners: ndarray) -> list[tuple[ndarray, Tree, float]]:
    """Simplices of one size, a tree of their centres, and the largest radius about these."""
    # Those of one size are searched together: one ball around a point holds all that can be
    # closest, and a few long ones do not make candidates of all.
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    size = np.frexp(np.maximum(radius, SAME * radius.max()))[1]
    groups = [np.flatnonzero(size == exponent) for exponent in np.unique(size)]
    return [(group, Tree(centre[group]), radius[group].max()) for group in groups]


def _near_of_block(
    trees: list, corners: ndarray, x: ndarray, slack: float
) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    # The nearest middles bound the distance; a ball holds what may be closer, of which most is
    # beside, and its box farther than the bound.
    noise = max(roundoff(corners), roundoff(x))
    bound = np.full(len(x), np.inf)
    rows = []
    simplices = []
    for group, tree, _ in trees:
        near = group[tree.query(x, k=range(1, min(NEAR_SIMPLICES, len(group)) + 1))[1]]
        distance = _find_nearest_places(corners[near.ravel()], np.repeat(x, near.shape[1], axis=0))[
            1
        ]
        bound = np.minimum(bound, distance.reshape(near.shape).min(axis=1))
    bound = (bound + slack) * (1 + SAME)
    for group, tree, radius in trees:
        row, member = tree.within(x, bound + radius * (1 + SAME))
        box = _measure_to_boxes(corners[group], member, x, row)
        some = box <= (bound + noise)[row]
        rows.append(row[some])
        simplices.append(group[member[some]])
    row = np.concatenate(rows)
    simplex = np.concatenate(simplices)
    weights, distance = _find_nearest_places(corners[simplex], x[row])
    least = np.full(len(x), np.inf)
    np.minimum.at(least, row, distance)
    beyond = distance - least[row] - noise
    order = np.lexsort((simplex, beyond > 0, row))
    order = order[beyond[order] <= slack]
    return row[order], simplex[order], weights[order], distance[order]


def _measure_to_boxes(corners: ndarray, simplex: ndarray, x: ndarray, row: ndarray) -> ndarray:
    """Distances (k,) of points from the boxes of simplices, by their numbers."""
    squared = np.zeros(len(row))
    for place, *columns in zip(x.T, *corners.transpose(1, 2, 0), strict=True):
        here = place[row]
        below = np.minimum.reduce(columns)[simplex] - here
        above = here - np.maximum.reduce(columns)[simplex]
        squared += np.maximum(np.maximum(below, above), 0) ** 2
    return np.sqrt(squared)


def _find_nearest_places(corners: ndarray, x: ndarray) -> Pair:
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
        u, v = edges_of(corners)
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


TOGETHER = 1 << 17  # pairs of faces in a block
SPLIT = 8  # parts of a straight way, in each of which a node changes sides once at most
HALVES = 40  # bisections of a way to the place where a node passes a face
PAIRS_OF_FACE = 64  # pairs of a face, on average, beyond which none is compared: time is bounded
PAIRS_ALWAYS = 1 << 18  # pairs that are compared at any rate


class TooManyPairs(Exception): ...


def crossing_faces(points: ndarray, moved: ndarray, faces: ndarray, place: ndarray) -> Pair:
    """Finds pairs (k, 2) of faces that meet only after the motion, and where (k, d) they meet.
    `faces` are segments (f, 2) or triangles (f, 3), rows of `points` (b, d), which are `moved`.
    Faces with a common number of `place` (b,) are neighbours, and do not count.
    """
    pairs = overlapping_boxes(moved[faces], (points != moved).any(axis=1)[faces].any(axis=1))
    found = [pairs[:0]]
    places = [points[:0]]
    for both in _blocks_apart(pairs, place[faces]):
        where = _find_meeting(moved[faces[both]], MEETS)
        met = np.flatnonzero(np.isfinite(where[:, 0]))
        new = met[np.isnan(_find_meeting(points[faces[both[met]]], MET_BEFORE)[:, 0])]
        found.append(both[new])
        places.append(where[new])
    return np.concatenate(found), np.concatenate(places)


def _blocks_apart(pairs: ndarray, places: ndarray) -> Iterator[ndarray]:
    """Blocks of pairs of faces without a common number of `places` (f, c)."""
    for start in range(0, len(pairs), TOGETHER):
        both = pairs[start : start + TOGETHER]
        first, second = places[both].swapaxes(0, 1)
        yield both[~(first[:, :, None] == second[:, None]).any(axis=(1, 2))]


def overlapping_boxes(
    corners: ndarray, is_moving: ndarray, after: ndarray | None = None
) -> ndarray:
    """Pairs (p, 2) of faces (f, corners, d), one moving, with overlapping boxes, each pair once.
    With their places `after` a motion, those that no axis separates in one order before and after:
    of others no two points come together on straight ways. Raises `TooManyPairs`.
    """
    # A box is a row: its least coordinates, then its largest ones, negative. The box of two boxes
    # is their minimum, and two boxes overlap if no least coordinate exceeds the other's largest.
    # One more axis goes from 0 to 1 for moving faces, and from 1 to 0 for others: these are apart.
    # Boxes are the leaves of a tree along Morton's curve. All pairs go down by one level together.
    states = [corners] if after is None else [corners, after]
    most = PAIRS_ALWAYS + PAIRS_OF_FACE * len(corners)
    boxes = np.stack([_bound_faces(x, ~is_moving[:, None]).T for x in states])
    # a face that no box of all that move overlaps has no pair
    reached = boxes[:, :, is_moving].min(axis=2, initial=np.inf)[:, :, None]
    is_near = ~(boxes + np.roll(reached, reached.shape[1] // 2, axis=1) > 0).all(axis=0).any(axis=0)
    rows = np.flatnonzero(is_near)
    order = rows[morton_order(corners[rows].mean(axis=1))] if len(rows) else rows
    levels = [boxes[:, :, order]]
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


def _bound_faces(corners: ndarray, is_still: ndarray) -> ndarray:
    slack = MEETS * np.ptp(corners, axis=1).max(axis=1, keepdims=True)
    low = corners.min(axis=1) - slack
    return np.hstack([is_still, low, is_still - 1.0, -corners.max(axis=1) - slack])


class Passages(NamedTuple):
    """Nodes (k,) that pass through faces: `pairs` (k, 2) of the node's face and the one passed.
    `shares` (k,) are those of the way, `places` (k, d) where. `senses` (k,) are 1 from inside out.
    """

    pairs: ndarray
    nodes: ndarray
    shares: ndarray
    places: ndarray
    senses: ndarray

    @classmethod
    def none(cls, d: int) -> "Passages":
        pairs = np.zeros((0, 2), np.int64)
        return cls(pairs, pairs[:, 0], np.zeros(0), np.zeros((0, d)), np.zeros(0))

    @classmethod
    def joined(cls, steps: "Sequence[Passages]") -> "Passages":
        return cls(*map(np.concatenate, zip(*steps, strict=True)))

    def at(self, rows: ndarray) -> "Passages":
        return Passages(*(column[rows] for column in self))


def passages(
    before: ndarray,
    after: ndarray,
    faces: ndarray,
    place: ndarray,
    is_solid: ndarray,
) -> Passages:
    """Finds the nodes, marked by `is_solid` (b,), that change the side of a face within it while
    all rows (b, d) go straight from `before` to `after`. Nodes that touch a face at an end of the
    way do not count. Arguments as of `crossing_faces`.
    """
    moves = (before != after).any(axis=1)[faces].any(axis=1)
    pairs = overlapping_boxes(before[faces], moves, after[faces])
    found = [Passages.none(before.shape[1])]
    for both in _blocks_apart(pairs, place[faces]):
        both = np.concatenate([both, both[:, ::-1]])
        both = both[is_solid[faces[both[:, 0]]].all(axis=1)]
        node = faces[both[:, 0]].ravel()
        both = np.repeat(both, faces.shape[1], axis=0)
        # a node has several faces, and is compared with another face once
        single = np.unique(node * len(faces) + both[:, 1], return_index=True)[1]
        found.append(_find_passed(before, after, faces, both[single], node[single]))
    every = Passages.joined(found)
    keys = np.stack([every.nodes, every.pairs[:, 1], every.shares])
    return every.at(np.unique(keys, axis=1, return_index=True)[1])


def _find_passed(
    before: ndarray, after: ndarray, faces: ndarray, pairs: ndarray, node: ndarray
) -> Passages:
    near = _come_near(before, after, faces[pairs[:, 1]], node)
    pairs = pairs[near]
    node = node[near]
    corners = faces[pairs[:, 1]]
    times = np.linspace(0, 1, SPLIT + 1)
    sides = np.stack(
        [_find_side(*_place_on_way(before, after, t, corners, node), 0.0) for t in times]
    )
    for k in (0, -1):
        sides[k] = _find_side(*_place_on_way(before, after, times[k], corners, node))
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
        is_before = _find_side(*_place_on_way(before, after, share, corners, node), 0.0) * sense < 0
        low = np.where(is_before, share, low)
        high = np.where(is_before, high, share)
    face, where = _place_on_way(before, after, low, corners, node)
    hit = _find_nearest_places(face, where)[1] <= MET_BEFORE * np.ptp(face, axis=1).max(axis=1)
    return Passages(pairs, node, low, where, sense).at(np.flatnonzero(hit))


def _come_near(before: ndarray, after: ndarray, corners: ndarray, node: ndarray) -> ndarray:
    """Lists pairs of faces (k, c) and nodes (k,) that no axis separates in one order."""
    near = np.ones(len(node), dtype=bool)
    for start, end in zip(before.T, after.T, strict=True):
        columns = [
            x[corners[:, c]] - x[node] for x in (start, end) for c in range(corners.shape[1])
        ]
        near &= np.minimum.reduce(columns) <= 0
        near &= np.maximum.reduce(columns) >= 0
    return np.flatnonzero(near)


def _place_on_way(
    before: ndarray, after: ndarray, share: Any, corners: ndarray, node: ndarray
) -> Pair:
    """Faces (k, c, d) and nodes (k, d) at a share, one or (k,), of the way."""
    share = np.reshape(share, (-1, 1))
    face = before[corners] + share[:, None] * (after[corners] - before[corners])
    return face, before[node] + share * (after[node] - before[node])


def _find_side(corners: ndarray, x: ndarray, slack: float = MET_BEFORE) -> ndarray:
    """The side (k,) of faces on which points (k, d) lie: 1 outside, -1 inside, 0 on the face."""
    normal = outward(corners)
    height = np.einsum("kd,kd->k", normal, x - corners[:, 0])
    if not slack:
        return np.sign(height)
    size = row_lengths(normal) * np.ptp(corners, axis=1).max(axis=1)
    return np.where(np.abs(height) > slack * size, np.sign(height), 0)


def _find_meeting(corners: ndarray, slack: float) -> ndarray:
    """Where pairs (k, 2, c, d) of faces meet (k, d); NaN for none, or in one plane."""
    where = np.full((len(corners), corners.shape[3]), np.nan)
    for pairs in (corners, corners[:, ::-1]):
        edges, others = pairs.swapaxes(0, 1)
        for start, end in zip(
            edges.swapaxes(0, 1), np.roll(edges, -1, axis=1).swapaxes(0, 1), strict=True
        ):
            share = _measure_share(start, end - start, others, slack)[:, None]
            where = np.where(np.isfinite(share), start + share * (end - start), where)
    return where


def _measure_share(start: ndarray, along: ndarray, corners: ndarray, slack: float) -> ndarray:
    """The share (k,) of a segment up to where it meets a simplex (k, d, d); NaN if it does not."""
    # arm = share * along - places of the simplex * its edges, solved by Cramer's rule
    rows = cofactor_rows([along, *edges_of(corners)])
    volume = np.einsum("kd,kd->k", rows[0], along)
    is_steep = np.abs(volume) > ALIGNED * row_lengths(along) * row_lengths(rows[0])
    share, *places = np.einsum("rkd,kd->rk", rows, corners[:, 0] - start) / np.where(
        is_steep, volume, 1
    )
    places = -np.array(places)
    inside = np.minimum(share, places.min(axis=0)) >= -slack
    return np.where(
        is_steep & inside & (np.maximum(share, places.sum(axis=0)) <= 1 + slack), share, np.nan
    )
