"""Holes in a patch's own faces, which bodies leave when they move; rims of faces."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, QhullError

from .._host.cells.adjacency import parts_of
from .._host.linear.products import normals, unit_rows
from .._host.surface.gaps import closest

CONTINUES = 0.5
"""Least cosine (60 degrees) of a hole's faces to those around: a dome's rim is no hole."""


def filled(
    faces: Int[np.ndarray, "e d"], vertices: Float[np.ndarray, "v d"], moves: Bool[np.ndarray, " v"]
) -> Int[np.ndarray, "f d"]:
    """Adds faces across all holes whose rim moves; other holes stay open. New faces continue the
    direction of the faces around them. In 2-D a line joins two ends that move. In 3-D a Delaunay
    triangulation in the rim's mean plane makes the faces. Old faces come first, in their order.
    """
    if faces.shape[1] == 2:
        new = [_joined(faces, vertices, moves)]
    else:
        new = [_across(rim, faces, vertices) for rim in _closed_rims(faces, moves)]
    return np.concatenate([faces, *new]).astype(faces.dtype)


def _joined(faces: np.ndarray, vertices: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Lists lines (k, 2) from moving ends to the nearest moving start that lies ahead."""
    along = unit_rows(np.diff(vertices[faces], axis=1)[:, 0])  # zero for a face of two nodes at one place
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


def _closed_rims(faces: np.ndarray, moves: np.ndarray) -> list[np.ndarray]:
    """Closed rims of moving vertices: edges (r, 2) against the faces beside them."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    size = int(faces.max()) + 1
    is_rim = ~np.isin(edges @ [1, size], edges @ [size, 1]) & moves[edges].all(axis=1)
    edges = edges[is_rim][:, ::-1]
    part = parts_of(edges[:, 0], edges[:, 1], size)[edges[:, 0]]
    rims = [edges[part == number] for number in np.unique(part)]
    return [rim for rim in rims if np.array_equal(*np.sort(rim, axis=0).T)]  # as many begin at a node as end


def _across(rim: np.ndarray, faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Triangles (k, 3) across a rim, unless they would turn off from the faces beside it."""
    nodes, ends = np.unique(rim), vertices[rim]
    area = np.cross(ends[:, 0] - ends[0, 0], ends[:, 1] - ends[0, 0]).sum(axis=0)
    beside = normals(vertices[faces[np.isin(faces, nodes).sum(axis=1) > 1]])
    if not (unit_rows(beside) @ area).mean() > CONTINUES * np.linalg.norm(area):
        return faces[:0]
    axes = np.linalg.svd(area[None])[2][1:]
    flat = (vertices[nodes] - vertices[nodes].mean(axis=0)) @ axes.T
    try:
        corners = Delaunay(flat).simplices
    except QhullError:
        return faces[:0]
    corners = corners[inside(flat[corners].mean(axis=1), flat[np.searchsorted(nodes, rim)])]
    is_back = normals(vertices[nodes[corners]]) @ area < 0
    corners[is_back] = corners[is_back][:, ::-1]
    return nodes[corners]


def rim(faces: Int[np.ndarray, "e d"]) -> Int[np.ndarray, "r c"]:
    """The edges that only one of the triangles has, or the ends of lines."""
    sides = np.concatenate([np.delete(faces, k, axis=1) for k in range(faces.shape[1])])
    once, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return once[counts == 1]


def distance_from_edges(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distances (k,) of points from the nearest edge (r, 2, d), or end (r, 1, d)."""
    return closest(ends[:, [0, -1]], x)[2] if len(ends) else np.full(len(x), np.inf)


def inside(x: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Marks the points (k, 2) within or on closed lines, given by their edges (r, 2, 2)."""
    crossed = np.zeros(len(x), dtype=bool)
    for (a, b), (c, d) in ends:
        between = (b > x[:, 1]) != (d > x[:, 1])
        crossed ^= between & (x[:, 0] < a + (x[:, 1] - b) * (c - a) / (d - b if d != b else 1))
    return crossed | (distance_from_edges(x, ends) < 1e-9 * np.ptp(ends.reshape(-1, 2), axis=0).max())
