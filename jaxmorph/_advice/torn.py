"""Neighbouring surface nodes that a motion tears apart, and what to try."""

import numpy as np
from scipy import sparse

from .._host.package.trees import Tree


def torn_pairs(points: np.ndarray, vectors: np.ndarray, is_fixed: np.ndarray) -> np.ndarray:
    """Finds pairs of neighbouring rows with contradictory displacements, the worst first."""
    count = min(2 * points.shape[1], len(points) - 1)
    distance, nearest = map(np.asarray, Tree(points).query(points, k=count + 1))
    first, second = np.repeat(np.arange(len(points)), count), nearest[:, 1:].ravel()
    distance = distance[:, 1:].ravel()
    difference = np.linalg.norm((vectors[first] - vectors[second]), axis=1)
    after = np.linalg.norm((points + vectors)[first] - (points + vectors)[second], axis=1)
    mixed = is_fixed[first] != is_fixed[second]
    # nodes that nearly coincide are one place by accident: the two sides of a wake, of an
    # interface, of a sharp edge
    scale = 1e-9 * np.ptp(points, axis=0).max()
    excess = np.where(mixed, difference, after - distance) / (distance + scale)
    torn = np.flatnonzero((excess > 1) & (distance > scale) & (first < second))
    return np.stack([first, second], axis=1)[torn[np.argsort(-excess[torn], kind="stable")]]


def share_faces(pairs: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Marks the pairs (k, 2) of `count` rows that lie on one face, or on faces that share a node.

    `faces` are (f, corners).
    """
    corners = np.repeat(np.arange(len(faces)), faces.shape[1])
    holds = sparse.csr_matrix(
        (np.ones(faces.size, dtype=np.int64), (faces.ravel(), corners)), shape=(count, len(faces))
    )
    around = holds @ holds.T  # neighbours of each row, and itself
    return np.asarray(around[pairs[:, 0]].multiply(around[pairs[:, 1]]).sum(axis=1)).ravel() > 0


def remedies(rests: np.ndarray, touches: np.ndarray) -> str:
    """Describes what tears each kind of pairs (k,), and what to try.

    Either one node of a pair rests, or both move. The boundary of a resting node touches that of
    the moving node, or lies across a gap.
    """
    slides, gap, both = (int(mask.sum()) for mask in (touches, rests & ~touches, ~rests))
    at = "" if slides == len(rests) else f"At {slides} of them a fixed boundary touches the moving one. "
    texts = (
        f"{at}Name the fixed boundary in `sliding` (--sliding) in place of `fixed`, or make it a symmetry plane, if it slides "
        "along the moving one. Name it in `free` (--free) if its nodes may follow, as those of a duct's ends.",
        f"{gap} of them lie across a gap to a fixed wall, which is narrower than the motion: cells in it shear as much.",
        f"In {both} of them both nodes move, and come to more than twice their distance. Row i of `u` moves node "
        "`plan.moving[i]`: is the order right? If so, the motion is too steep for the spacing of the nodes: smooth it "
        "(`shapes.Smoother`), or refine the surface.",
    )
    return " ".join(text for text, count in zip(texts, (slides, gap, both), strict=True) if count)
