"""Nodes of symmetry planes, and planes of control points that stay so that no wall tears."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmorph import Mesh

from ._options import Options

KEPT = {"NO_DERIVATIVE": 1, "1ST_DERIVATIVE": 2, "2ND_DERIVATIVE": 3, "USER_INPUT": 0}
"""Planes of control points that stay behind each face of a box which the wall crosses."""


def planes(
    options: Options, lattice: Float[np.ndarray, "..."], segments: Float[np.ndarray, "s 2 d"]
) -> tuple[set[int], ...]:
    """Finds the planes that stay in each direction of a lattice.

    `segments` are the edges and diagonals of the wall's faces. Raises `ValueError` for words that
    SU2 does not have.
    """
    d, degrees = lattice.shape[-1], [count - 1 for count in lattice.shape[:-1]]
    word = options.choice("FFD_CONTINUITY", "2ND_DERIVATIVE", *KEPT)
    if word == "USER_INPUT":
        planes_of = [{int(value) for value in options.numbers(f"FFD_FIX_{axis}")} for axis in "IJK"[:d]]
        return tuple({k for k in planes if 0 <= k <= top} for planes, top in zip(planes_of, degrees, strict=True))
    is_symmetric = options.choice("FFD_SYMMETRY_PLANE", "NO", "NO", "YES") == "YES"
    fixed: tuple[set[int], ...] = tuple(set() for _ in range(d))
    for direction, top in enumerate(degrees):
        for side, last in ((0, 0), (1, -1)):
            if (direction == 1 and d == 3 and is_symmetric) or not _crosses(segments, _face(lattice, direction, last)):
                continue
            if KEPT[word] == 3 and top <= 1:
                continue  # as SU2 has it: a second derivative needs a degree of 2
            behind = [k if side == 0 else top - k for k in range(KEPT[word])]
            fixed[direction].update(k for k in behind if 0 <= k <= top)
    return fixed


def _face(lattice: Float[np.ndarray, "..."], direction: int, last: int) -> Float[np.ndarray, "t d d"]:
    """Cuts one face of a box into two triangles between its corners; in 2-D it is a segment."""
    d = lattice.shape[-1]
    corners = np.take(lattice[np.ix_(*[[0, -1]] * d)], last, axis=direction).reshape(-1, d)
    return corners[None] if d == 2 else corners[np.array([[0, 1, 2], [3, 2, 1]])]


def _crosses(segments: Float[np.ndarray, "s 2 d"], faces: Float[np.ndarray, "t d d"]) -> bool:
    """Checks whether a segment meets a triangle, or in 2-D another segment."""
    start, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    for face in faces:
        # start + s way = face[0] + edges^T w, for s in 0 to 1 and w in the triangle
        edges = face[1:] - face[0]
        matrix = np.concatenate([way[:, :, None], -np.broadcast_to(edges.T, (len(way), *edges.T.shape))], axis=2)
        good = np.abs(np.linalg.det(matrix)) > 1e-14 * np.linalg.norm(edges, axis=1).prod() * np.linalg.norm(
            way, axis=1
        )
        solution = np.linalg.solve(matrix[good], (face[0] - start[good])[:, :, None])[:, :, 0]
        share, weights = solution[:, 0], solution[:, 1:]
        if ((share >= 0) & (share <= 1) & (weights >= 0).all(axis=1) & (weights.sum(axis=1) <= 1)).any():
            return True
    return False


def segments_of(points: Float[np.ndarray, "n d"], faces: list[Int[np.ndarray, "k c"]]) -> Float[np.ndarray, "s 2 d"]:
    """Lists the segments between all corners of each face."""
    pairs = [ids[:, [a, b]] for ids in faces for a in range(ids.shape[1]) for b in range(a + 1, ids.shape[1])]
    return points[np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)]


def free_coordinates(mesh: Mesh, moving: Sequence[str], planes: Sequence[str]) -> Bool[np.ndarray, "m d"]:
    """Marks coordinates of the moving nodes that may change.

    A node of a patch of `planes` stays in the plane, whose axis is that along which the patch is
    thinnest, as SU2 has it.
    """
    nodes, points = mesh.patch(*moving) if moving else np.zeros(0, int), np.asarray(mesh.points, float)
    free = np.ones((len(nodes), points.shape[1]), bool)
    for name in planes:
        own = mesh.patch(name)
        axis = np.argmin(np.sum((points[own] - points[own[0]]) ** 2, axis=0))
        free[np.isin(nodes, own), axis] = False
    return free
