"""Pieces of a surface that have passed through another one wholly: they cross it no more, and lie on its other side."""

import numpy as np

from ..cells.pairs import parts_of
from ..linear.products import cross

WHOLE = 1e-3
"""Distance of a winding number from a whole one up to which a point is not on the surface."""


def passed_pieces(points: np.ndarray, moved: np.ndarray, faces: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Finds pairs (k, 2) of pieces of which one was inside of the other before the motion and is not after it, or the reverse.

    Pieces are faces that hang together, named by their first face. What lies inside is told by the winding number of a piece about
    a node of the other one. It is whole for closed pieces, of faces seen from one side; others are left out.

    **Arguments:**

    - `points`, `moved`: coordinates (b, d) before and after.
    - `faces`: segments (f, 2) in 2-D, triangles (f, 3) in 3-D, as rows of `points`.
    - `place`: a number (b,) for each row. Faces that share one hang together.
    """
    piece = _pieces(place[faces])
    first = np.unique(piece, return_index=True)[1]
    if len(first) < 2:
        return np.zeros((0, 2), np.int64)
    moves = np.zeros(len(first), bool)
    np.logical_or.at(moves, piece, (points != moved).any(axis=1)[faces].any(axis=1))
    order = np.argsort(piece, kind="stable")
    pairs = [np.zeros((0, 2), np.int64)]
    for one, rows in enumerate(np.split(faces[order], np.cumsum(np.bincount(piece))[:-1])):
        others = np.flatnonzero((moves | moves[one]) & (np.arange(len(first)) != one))
        node = faces[first[others], 0]
        near = _in_box(points[node], points[rows]) | _in_box(moved[node], moved[rows])
        if not near.any():
            continue
        before, after = (_turns(each[node[near]], each[rows]) for each in (points, moved))
        is_whole = np.maximum(np.abs(before - np.round(before)), np.abs(after - np.round(after))) < WHOLE
        through = others[near][is_whole & (np.round(before) != np.round(after))]
        pairs.append(np.stack([first[through], np.full(len(through), first[one])], axis=1))
    return np.concatenate(pairs)


def _pieces(labels: np.ndarray) -> np.ndarray:
    """Numbers the piece of each face (f,)."""
    part = parts_of(labels[:, :-1].ravel(), labels[:, 1:].ravel(), int(labels.max()) + 1)
    return np.unique(part[labels[:, 0]], return_inverse=True)[1]


def _in_box(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    return ((places >= corners.min(axis=(0, 1))) & (places <= corners.max(axis=(0, 1)))).all(axis=1)


def _turns(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Computes the winding number of faces with these corners (f, d, d) about each place (k, d).

    In 3-D it is the sum of solid angles (van Oosterom and Strackee, 1983).
    """
    d = corners.shape[2]
    turns = np.zeros(len(places))
    for row, at in enumerate(places):
        arms = [arm.T for arm in np.moveaxis(corners - at, 1, 0)]
        if d == 2:
            angle = np.arctan2(cross(*arms)[0], (arms[0] * arms[1]).sum(axis=0))
        else:
            (a, b, c), sizes = arms, [np.sqrt((arm**2).sum(axis=0)) for arm in arms]
            volume = (a * np.array(cross(b, c))).sum(axis=0)
            products = [
                (p * q).sum(axis=0) * r for p, q, r in zip((a, b, c), (b, c, a), sizes[2:] + sizes[:2], strict=True)
            ]
            angle = 2 * np.arctan2(volume, np.prod(sizes, axis=0) + sum(products))
        turns[row] = angle.sum() / (2 * np.pi if d == 2 else 4 * np.pi)
    return turns
