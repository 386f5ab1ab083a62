"""Cyclic patches: pairs whose faces match after one translation or one rotation."""

import pathlib

import numpy as np

from .file import Patch, load, patches

TOLERANCE = 1e-4
"""Distance of paired faces, relative to their size: OpenFOAM's own `matchTolerance`."""


def cyclic_pairs(boundary: list[Patch]) -> list[tuple[Patch, Patch]]:
    """Lists the pairs of cyclic patches of a case.

    Those whose faces need not match (cyclicAMI, cyclicACMI) are none.
    """
    by_name = {patch.name: patch for patch in boundary}
    pairs = [(patch, by_name[patch.neighbour]) for patch in by_name.values() if patch.neighbour in by_name]
    return [(a, b) for a, b in pairs if "cyclic" == a.type == b.type and a.start < b.start and a.count == b.count > 0]


def check_cyclic(topology: pathlib.Path, old: np.ndarray, new: np.ndarray) -> None:
    """Raises `ValueError` where cyclic patches matched with `old` points, but not with `new`."""
    pairs = cyclic_pairs(patches(load(topology, "boundary")))
    if not pairs or np.array_equal(old, new):
        return
    labels, starts = load(topology, "faces").faces()
    for first, second in pairs:
        before, after = ([_faces(points, labels, starts, patch) for patch in (first, second)] for points in (old, new))
        turns = bool((_misses(*before, turned=False) > TOLERANCE).any())
        wrong = _misses(*after, turned=turns) - _misses(*before, turned=turns)
        if (wrong > TOLERANCE).any():
            face = int(wrong.argmax())
            place = ", ".join(f"{x:.4g}" for x in after[0][0][face])
            raise ValueError(
                f"the cyclic patches {first.name!r} and {second.name!r} no longer match: {(wrong > TOLERANCE).sum()} of "
                f"{first.count} pairs of faces miss each other, by up to {wrong[face]:.3g} of the face's size near ({place}). "
                "Hold both patches fixed, or move both alike."
            )


def _faces(points: np.ndarray, labels: np.ndarray, starts: np.ndarray, patch: Patch) -> tuple[np.ndarray, np.ndarray]:
    """Computes middles (k, 3) and sizes (k,), roots of areas, of a patch's faces."""
    begins = np.asarray(starts[patch.start : patch.start + patch.count + 1], dtype=np.int64)
    corners = points[labels[begins[0] : begins[-1]]]
    begins, sizes = begins[:-1] - begins[0], np.diff(begins)
    middles = np.add.reduceat(corners, begins) / sizes[:, None]
    after = np.arange(len(corners)) + 1
    after[np.append(begins[1:], len(corners)) - 1] = begins
    arms = corners - np.repeat(middles, sizes, axis=0)
    areas = np.add.reduceat(np.cross(arms, arms[after]), begins) / 2
    return middles, np.sqrt(np.linalg.norm(areas, axis=1))


def _misses(first: tuple, second: tuple, turned: bool) -> np.ndarray:
    """Measures how far (k,) faces miss partners, by size, after the best transform."""
    (middles, sizes), (partners, others) = first, second
    arms, ends = middles - middles.mean(axis=0), partners - partners.mean(axis=0)
    if turned:
        left, _, right = np.linalg.svd(arms.T @ ends)
        signs = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
        arms = arms @ (left * signs) @ right
    distance = np.linalg.norm(arms - ends, axis=1)
    return np.maximum(distance, np.abs(sizes - others)) / np.maximum(np.minimum(sizes, others), 1e-300)
