"""Faces of a surface that touch or cross each other once their nodes have moved."""

import numpy as np

from ..linear.products import cross

AFTER, BEFORE = 1e-9, 1e-6  # slack of a crossing, relative to the faces: faces that nearly touched before do not count
PARALLEL = 1e-9  # sine of the angle below which an edge lies along a face, and does not cross it
TOGETHER = 1 << 17  # pairs of faces in a block


def crossing_faces(
    points: np.ndarray, moved: np.ndarray, faces: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Finds pairs (k, 2) of faces that meet only after the motion, and where (k, d) they meet.
    `faces` are segments (f, 2) or triangles (f, 3), rows of `points` (b, d), which are `moved`.
    Faces with a common number of `place` (b,) are neighbours, and do not count.
    """
    is_moving = (points != moved).any(axis=1)[faces].any(axis=1)
    if not is_moving.any():
        return np.zeros((0, 2), np.int64), np.zeros((0, points.shape[1]))
    first, second = overlapping_boxes(moved[faces], is_moving)
    labels = place[faces]
    pairs, places = [np.zeros((0, 2), np.int64)], [np.zeros((0, points.shape[1]))]
    for start in range(0, len(first), TOGETHER):
        both = np.stack([first[start : start + TOGETHER], second[start : start + TOGETHER]], axis=1)
        shared = (labels[both[:, 0]][:, :, None] == labels[both[:, 1]][:, None, :]).any(axis=(1, 2))
        both = both[~shared]
        meets, where = _meet(moved[faces[both[:, 0]]], moved[faces[both[:, 1]]], AFTER)
        both, where = both[meets], where[meets]
        is_new = ~_meet(points[faces[both[:, 0]]], points[faces[both[:, 1]]], BEFORE)[0]
        pairs.append(both[is_new])
        places.append(where[is_new])
    return np.concatenate(pairs), np.concatenate(places)


def overlapping_boxes(corners: np.ndarray, is_moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces (f, corners, d), one moving, with overlapping boxes, each pair once."""
    # Faces are the leaves of a balanced tree. The search goes down level by level, for all pairs of
    # boxes together. Only overlapping pairs, of which one box moves, have pairs of children.
    order, depth = _balanced(corners.mean(axis=1))
    is_face, order = order < len(corners), np.minimum(order, len(corners) - 1)
    slack = AFTER * np.ptp(corners, axis=1).max(axis=1, keepdims=True)
    low = np.where(is_face[:, None], (corners.min(axis=1) - slack)[order], np.inf)
    high = np.where(is_face[:, None], (corners.max(axis=1) + slack)[order], -np.inf)
    levels = [(low, high, is_moving[order] & is_face)]
    for _ in range(depth):
        low, high, moves = levels[-1]
        levels.append((np.minimum(low[::2], low[1::2]), np.maximum(high[::2], high[1::2]), moves[::2] | moves[1::2]))
    first = second = np.zeros(1, np.int64)
    for level in range(depth, -1, -1):
        low, high, moves = levels[level]
        if level < depth:
            first = np.concatenate([2 * first, 2 * first, 2 * first + 1, 2 * first + 1])
            second = np.concatenate([2 * second, 2 * second + 1, 2 * second, 2 * second + 1])
        near = (first <= second) & (moves[first] | moves[second])
        for axis in range(low.shape[1]):
            first, second = first[near], second[near]
            near = (low[first, axis] <= high[second, axis]) & (low[second, axis] <= high[first, axis])
        first, second = first[near], second[near]
    differs = first != second
    return order[first[differs]], order[second[differs]]


def _balanced(centres: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces as leaves of a balanced tree, halved along the widest axis; padded from k on."""
    depth = (len(centres) - 1).bit_length()
    order = np.arange(1 << depth)[None]
    padded = np.concatenate([centres, np.repeat(centres[-1:], (1 << depth) - len(centres), axis=0)])
    for _ in range(depth):
        within = padded[order]
        widest = np.ptp(within, axis=1).argmax(axis=1)
        along = np.take_along_axis(within, widest[:, None, None], axis=2)[..., 0]
        half = np.argpartition(along, order.shape[1] // 2, axis=1)
        order = np.take_along_axis(order, half, axis=1).reshape(2 * len(order), -1)
    return order.ravel(), depth


def _meet(first: np.ndarray, second: np.ndarray, slack: float) -> tuple[np.ndarray, np.ndarray]:
    """Marks pairs of faces (k, corners, d) that meet, not in one plane, and finds the point."""
    meets, where = np.zeros(len(first), bool), np.full((len(first), first.shape[2]), np.nan)
    if first.shape[2] == 2:
        left = np.arange(len(first))
    else:
        left = np.flatnonzero(~_aside(first, second, slack))
        left = left[~_aside(second[left], first[left], slack)]
    through = _segment_meets_segment if first.shape[2] == 2 else _segment_meets_triangle
    sides = [(0, 1)] if first.shape[2] == 2 else [(0, 1), (1, 2), (2, 0)]
    for one, other in ((first, second), (second, first))[: first.shape[2] - 1]:
        for start, end in sides:
            hits, share = through(one[left, start], one[left, end], other[left], slack)
            rows = left[hits]
            meets[rows] = True
            where[rows] = one[rows, start] + share[hits, None] * (one[rows, end] - one[rows, start])
    return meets, where


def _aside(first: np.ndarray, second: np.ndarray, slack: float) -> np.ndarray:
    normal = np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0])
    arms = second - first[:, :1]
    height = np.einsum("kcd,kd->kc", arms, normal)
    scale = slack * np.sqrt(np.einsum("kd,kd->k", normal, normal) * np.einsum("kcd,kcd->kc", arms, arms).max(axis=1))
    return (height.min(axis=1) > scale) | (height.max(axis=1) < -scale)


def _segment_meets_segment(start, end, other, slack):
    """Marks segments `start` to `end` (k, 2) that meet `other` ones (k, 2, 2); with the share."""
    along, across, arm = end - start, other[:, 1] - other[:, 0], other[:, 0] - start
    turn = cross(along.T, across.T)[0]
    is_turned = np.abs(turn) > PARALLEL * np.sqrt((along**2).sum(axis=1) * (across**2).sum(axis=1))
    safe = np.where(is_turned, turn, 1)
    share, place = cross(arm.T, across.T)[0] / safe, cross(arm.T, along.T)[0] / safe
    inside = (np.minimum(share, place) >= -slack) & (np.maximum(share, place) <= 1 + slack)
    return is_turned & inside, share


def _segment_meets_triangle(start, end, corners, slack):
    """Marks segments `start` to `end` (k, 3) that meet triangles (k, 3, 3); with the share."""
    along, one, other = end - start, corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    arm, normal = start - corners[:, 0], np.cross(one, other)
    descent = -np.einsum("kd,kd->k", along, normal)
    size = np.sqrt((along**2).sum(axis=1) * (normal**2).sum(axis=1))
    is_steep = np.abs(descent) > PARALLEL * size
    safe, turned = np.where(is_steep, descent, 1), np.cross(arm, along)
    share = np.einsum("kd,kd->k", arm, normal) / safe
    u, v = np.einsum("kd,kd->k", other, turned) / safe, -np.einsum("kd,kd->k", one, turned) / safe
    inside = (np.minimum(np.minimum(share, u), v) >= -slack) & (np.maximum(share, u + v) <= 1 + slack)
    return is_steep & inside, share
