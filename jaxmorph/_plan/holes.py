"""Holes in the faces of a sliding patch where a moving body stands on it: nodes slide there too, once the body has left."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, QhullError

from .walls import inside


def filled(
    faces: Int[np.ndarray, "e d"], vertices: Float[np.ndarray, "v d"], moves: Bool[np.ndarray, " v"]
) -> Int[np.ndarray, "f d"]:
    """Adds faces between the vertices around each hole whose rim moves; the others stay open. A triangle's order is kept.

    In 2-D two ends that move are joined. The faces are those of a Delaunay triangulation in the rim's mean plane.
    """
    if faces.shape[1] == 2:
        ends, counts = np.unique(faces, return_counts=True)
        ends = ends[(counts == 1) & moves[ends]]
        if len(ends) != 2:
            return faces
        first = ends[np.argsort(~np.isin(ends, faces[:, 1]), kind="stable")]  # where a face ends, the new one starts
        return np.concatenate([faces, first[None]])
    new = [_between(loop, vertices[loop]) for loop in _loops(faces, moves)]
    return np.concatenate([faces, *new]).astype(faces.dtype)


def _loops(faces: np.ndarray, moves: np.ndarray) -> list[np.ndarray]:
    """Lists the closed rims whose vertices move, each against the order of the faces next to it."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    size = int(faces.max()) + 1
    key, back = edges @ np.array([size, 1]), edges @ np.array([1, size])
    rim = edges[~np.isin(back, key) & moves[edges].all(axis=1)]
    follows, loops = dict(zip(rim[:, 1].tolist(), rim[:, 0].tolist(), strict=True)), []
    while follows:
        start, node = follows.popitem()
        loop = [start]
        while node in follows:
            loop.append(node)
            node = follows.pop(node)
        if node == start and len(loop) > 2:
            loops.append(np.array(loop))
    return loops


def _between(loop: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Makes triangles (k, 3) between the nodes of a loop, in its order."""
    after = np.roll(rim, -1, axis=0)
    normal = np.cross(rim - rim[0], after - rim[0]).sum(axis=0)
    axes = np.linalg.svd(normal[None])[2][1:]
    flat = (rim - rim.mean(axis=0)) @ axes.T
    try:
        corners = Delaunay(flat).simplices
    except QhullError:
        return np.zeros((0, 3), dtype=loop.dtype)
    corners = corners[inside(flat[corners].mean(axis=1), np.stack([flat, np.roll(flat, -1, axis=0)], axis=1))]
    first, second, third = (rim[corners[:, k]] for k in range(3))
    is_back = np.cross(second - first, third - first) @ normal < 0
    corners[is_back] = corners[is_back][:, ::-1]
    return loop[corners]
