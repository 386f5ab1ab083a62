"""Rims and holes of a sliding patch.

A hole is where a moving body stands. Nodes slide there too, when the body has left.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, QhullError

from .._host.surface.gaps import distance_from_segment

CONTINUES = 0.5
"""Least cosine, of 60 degrees, between a hole's new faces and the faces around it.

The rim of a dome and the end of a tube are no holes.
"""


def filled(
    faces: Int[np.ndarray, "e d"], vertices: Float[np.ndarray, "v d"], moves: Bool[np.ndarray, " v"]
) -> Int[np.ndarray, "f d"]:
    """Adds faces across all holes whose rim moves; other holes stay open.

    New faces continue the direction of the faces around them. In 2-D a line joins two ends that
    move. In 3-D a Delaunay triangulation in the rim's mean plane makes the faces. Old faces come
    first, in their order.
    """
    if faces.shape[1] == 2:
        return np.concatenate([faces, _joined(faces, vertices, moves)]).astype(faces.dtype)
    loops = (loop for loop in _loops(faces, moves) if _goes_on(loop, faces, vertices))
    new = [_between(loop, vertices[loop]) for loop in loops]
    return np.concatenate([faces, *new]).astype(faces.dtype)


def _joined(faces: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Lists lines (k, 2) from moving ends to the nearest moving start that lies ahead."""
    along = np.diff(vertices[faces], axis=1)[:, 0]
    along = _unit(along)  # zero for a face of two nodes at one place
    last = np.flatnonzero(~np.isin(faces[:, 1], faces[:, 0]) & moves[faces[:, 1]])
    first = np.flatnonzero(~np.isin(faces[:, 0], faces[:, 1]) & moves[faces[:, 0]])
    gap = vertices[faces[first, 0]][None] - vertices[faces[last, 1]][:, None]
    size = np.linalg.norm(gap, axis=2)
    ahead = np.minimum(np.sum(gap * along[last][:, None], axis=2), np.sum(gap * along[first][None], axis=2))
    size = np.where((size > 0) & (ahead > CONTINUES * size), size, np.inf)
    lines = []
    while np.isfinite(size).any():
        end, start = np.unravel_index(size.argmin(), size.shape)
        lines.append([faces[last[end], 1], faces[first[start], 0]])
        size[end], size[:, start] = np.inf, np.inf
    return np.array(lines, dtype=faces.dtype).reshape(-1, 2)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Scales vectors to length one; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def _goes_on(loop: np.ndarray, faces: np.ndarray, vertices: np.ndarray) -> bool:
    """Checks whether faces across a loop would have the direction of the faces beside it."""
    beside = vertices[faces[np.isin(faces, loop).sum(axis=1) > 1]]
    normals = np.cross(beside[:, 1] - beside[:, 0], beside[:, 2] - beside[:, 0])
    across = _area(vertices[loop])
    return bool((_unit(normals) @ across).mean() > CONTINUES * np.linalg.norm(across))


def _area(rim: np.ndarray) -> np.ndarray:
    """Computes twice the area vector of a loop of points (k, 3)."""
    return np.cross(rim - rim[0], np.roll(rim, -1, axis=0) - rim[0]).sum(axis=0)


def _loops(faces: np.ndarray, moves: np.ndarray) -> list[np.ndarray]:
    """Lists the closed rims whose vertices move, against the order of the faces beside them."""
    # A rim edge is an edge of one face alone. The path follows rim edges from node to node. When it
    # comes back to one of its own nodes, the part since then is a loop, and is cut off.
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    size = int(faces.max()) + 1
    key, back = edges @ np.array([size, 1]), edges @ np.array([1, size])
    rim = edges[~np.isin(back, key) & moves[edges].all(axis=1)]
    follows: dict[int, list[int]] = {}
    for node, end in rim.tolist():
        follows.setdefault(end, []).append(node)
    loops = []
    while follows:
        path, place = [next(iter(follows))], {next(iter(follows)): 0}
        while path[-1] in follows:
            ways = follows[path[-1]]
            node = ways.pop()
            if not ways:
                del follows[path[-1]]
            if node in place:
                start = place[node]
                loops.append(np.array(path[start:]))
                for corner in path[start:]:
                    del place[corner]
                path = path[:start]
            place[node] = len(path)
            path.append(node)
    return [loop for loop in loops if len(loop) > 2]


def _between(loop: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Makes triangles (k, 3) between the nodes of a loop, in its order."""
    normal = _area(rim)
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


def rim(faces: Int[np.ndarray, "e d"]) -> Int[np.ndarray, "r c"]:
    """Lists the edges that only one of the triangles has, or the ends of lines."""
    d = faces.shape[1]
    sides = np.concatenate([np.delete(faces, k, axis=1) for k in range(d)])
    once, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return once[counts == 1]


def distance_from_edges(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Measures the distances (k,) of points from the nearest edge (r, 2, d), or end (r, 1, d)."""
    least = np.full(len(x), np.inf)
    for edge in ends:
        least = np.minimum(least, distance_from_segment(x, edge[0], edge[-1]))
    return least


def inside(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Marks the points (k, 2) within or on closed lines, given by their edges (r, 2, 2)."""
    crossed = np.zeros(len(x), dtype=bool)
    for (a, b), (c, d) in ends:
        between = (b > x[:, 1]) != (d > x[:, 1])
        crossed ^= between & (x[:, 0] < a + (x[:, 1] - b) * (c - a) / (d - b if d != b else 1))
    return crossed | (distance_from_edges(x, ends) < 1e-9 * np.ptp(ends.reshape(-1, 2), axis=0).max())
