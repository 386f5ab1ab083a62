"""Faces of a surface that touch or cross each other once their nodes have moved."""

import numpy as np

from ..linear.products import cofactor_rows, normals
from ..package.rounding import morton_order

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
    pairs = overlapping_boxes(moved[faces], (points != moved).any(axis=1)[faces].any(axis=1))
    found, places = [pairs[:0]], [points[:0]]
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


def overlapping_boxes(corners: np.ndarray, is_moving: np.ndarray) -> np.ndarray:
    """Pairs (p, 2) of faces (f, corners, d), one moving, with overlapping boxes, each pair once."""
    # A box is a row: its least coordinates, then its largest ones, negative. The box of two boxes
    # is their minimum, and two boxes overlap if no least coordinate exceeds the other's largest.
    # One more axis goes from 0 to 1 for moving faces, and from 1 to 0 for others: these are apart.
    # Boxes are the leaves of a tree along Morton's curve. All pairs go down by one level together.
    slack, is_still = AFTER * np.ptp(corners, axis=1).max(axis=1, keepdims=True), ~is_moving[:, None]
    boxes = np.hstack([is_still, corners.min(axis=1) - slack, is_still - 1.0, -corners.max(axis=1) - slack])
    order = morton_order(corners.mean(axis=1))
    levels = [boxes[order].T]
    while levels[-1].shape[1] > 1:
        levels.append(np.minimum.reduceat(levels[-1], np.arange(0, levels[-1].shape[1], 2), axis=1))
    pairs, children = np.zeros((1, 2), np.int64), np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    for level in levels[::-1]:
        pairs = (2 * pairs[:, None] + children).reshape(-1, 2)
        pairs = pairs[(pairs[:, 0] <= pairs[:, 1]) & (pairs[:, 1] < level.shape[1])]
        for least, largest in zip(level, np.roll(level, len(level) // 2, axis=0), strict=True):
            pairs = pairs[least[pairs[:, 0]] + largest[pairs[:, 1]] <= 0]
    return order[pairs[pairs[:, 0] != pairs[:, 1]]]


def _meeting(corners: np.ndarray, slack: float) -> np.ndarray:
    """Where pairs (k, 2, c, d) of faces meet (k, d); NaN for none, or in one plane."""
    where, left = np.full((len(corners), corners.shape[3]), np.nan), np.arange(len(corners))
    both_ways = corners, corners[:, ::-1]
    for pairs in both_ways:
        left = left[~_is_aside(*pairs[left].swapaxes(0, 1), slack)]
    for pairs in both_ways:
        edges, others = pairs[left].swapaxes(0, 1)
        for start, end in zip(edges.swapaxes(0, 1), np.roll(edges, -1, axis=1).swapaxes(0, 1), strict=True):
            share = _share(start, end - start, others, slack)
            hits = np.isfinite(share)
            where[left[hits]] = start[hits] + share[hits, None] * (end - start)[hits]
    return where


def _is_aside(first: np.ndarray, second: np.ndarray, slack: float) -> np.ndarray:
    """Marks pairs of which the second face lies on one side of the first."""
    normal, arms = normals(first), second - first[:, :1]
    height = np.einsum("kcd,kd->kc", arms, normal)
    scale = slack * np.sqrt(np.einsum("kd,kd->k", normal, normal) * np.einsum("kcd,kcd->kc", arms, arms).max(axis=1))
    return (height.min(axis=1) > scale) | (height.max(axis=1) < -scale)


def _share(start: np.ndarray, along: np.ndarray, corners: np.ndarray, slack: float) -> np.ndarray:
    """The share (k,) of a segment up to where it meets a simplex (k, d, d); NaN if it does not."""
    # arm = share * along - places of the simplex * its edges, solved by Cramer's rule
    rows = cofactor_rows([along, *(corners[:, 1:] - corners[:, :1]).swapaxes(0, 1)])
    volume = np.einsum("kd,kd->k", rows[0], along)
    is_steep = np.abs(volume) > PARALLEL * np.linalg.norm(along, axis=1) * np.linalg.norm(rows[0], axis=1)
    share, *places = np.einsum("rkd,kd->rk", rows, corners[:, 0] - start) / np.where(is_steep, volume, 1)
    places = -np.array(places)
    inside = np.minimum(share, places.min(axis=0)) >= -slack
    return np.where(is_steep & inside & (np.maximum(share, places.sum(axis=0)) <= 1 + slack), share, np.nan)
