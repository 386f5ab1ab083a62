"""OpenFOAM's 2-D cases: one layer of cells between two `empty` planes, which move alike."""

import dataclasses

import numpy as np

from jaxmorph._mesh.faces import Faces
from jaxmorph._mesh.polyhedra import triangles

TOLERANCE = 1e-6
"""Distance that a node may be off its plane, as a share of the distance between the two."""


@dataclasses.dataclass(frozen=True, eq=False)
class Layer:
    """Pairs the nodes of two planes: `front` and `back`, row by row one behind the other; `axes` are the two along them.

    Node i of the 2-D mesh is `front[i]`; ids ascend, so nodes keep the order of the file.
    """

    front: np.ndarray
    back: np.ndarray
    axes: tuple[int, int]

    def in_plane(self, points: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(points[self.front][:, self.axes])

    def in_space(self, old: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """Places both planes of `old` at `plane`; a node behind one that has not moved stays where it is."""
        new = old.copy()
        rows = np.ix_(self.front, np.array(self.axes))
        moved = plane != old[rows]
        new[rows] = plane
        behind = np.ix_(self.back, np.array(self.axes))
        new[behind] = np.where(moved, plane, old[behind])
        return new

    def added(self, values: np.ndarray) -> np.ndarray:
        """Adds the values (N, 3) of both planes to (n, 2), as both move: the transpose of `in_space`."""
        return (values[self.front] + values[self.back])[:, self.axes]

    def ids(self, nodes: np.ndarray) -> np.ndarray:
        """Returns the 2-D mesh's ids of those of `nodes` that are in the front."""
        at = np.minimum(np.searchsorted(self.front, nodes), len(self.front) - 1)
        return at[self.front[at] == nodes]


def layer(faces: Faces, points: np.ndarray) -> Layer:
    """Finds the two planes of a case with patches of type empty.

    It raises `ValueError` where the nodes are not on two planes across one axis, or not in pairs.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    away = np.minimum(points - low, high - points).max(axis=0)
    normals = np.flatnonzero(away <= TOLERANCE * (high - low))
    if len(normals) != 1:
        raise ValueError(
            f"patches of type empty, but the nodes lie on two planes across {len(normals)} of the axes x, y, z instead of "
            "one. Cases in one dimension, and planes that are oblique, are not supported."
        )
    normal = int(normals[0])
    axes = [(1, 2), (0, 2), (0, 1)][normal]
    # seen from outside, the faces of the front run counterclockwise in its two coordinates
    is_high = points[:, normal] - low[normal] > high[normal] - points[:, normal]
    is_front = ~is_high if normal == 1 else is_high
    front = np.flatnonzero(is_front)
    corner = faces.labels
    # the last label of a face is followed by its first
    after = np.empty_like(corner)
    after[:-1] = corner[1:]
    after[faces.starts[1:] - 1] = corner[faces.starts[:-1]]
    across = is_front[corner] & ~is_front[after]
    behind = np.full(len(points), -1)
    behind[corner[across]] = after[across]
    back = behind[front]
    if (back < 0).any() or len(np.unique(back)) != len(points) - len(front):
        raise ValueError(
            f"patches of type empty, but {len(front)} nodes in front and {len(points) - len(front)} behind are not pairs "
            "joined by edges: there is more than one layer of cells."
        )
    off = np.abs(points[front][:, axes] - points[back][:, axes]).max()
    if off > TOLERANCE * 1e3 * (high - low).max():
        raise ValueError(f"patches of type empty, but nodes of the two planes are {off:.3g} apart along them.")
    return Layer(front, back, axes)


def plane_cells(faces: Faces, points: np.ndarray, empty: np.ndarray, plane: Layer) -> dict[str, np.ndarray]:
    """Makes triangles and quads of the front, in the order of their cells; a face of more corners becomes triangles."""
    is_front = np.zeros(len(points), bool)
    is_front[plane.front] = True
    front = empty[is_front[faces.labels[faces.starts[empty]]]]
    front = front[np.argsort(faces.owner[front], kind="stable")]
    sizes = faces.sizes[front]
    cells = {}
    quads = faces.corners(front[sizes == 4], 4)
    others = [faces.corners(front[sizes == 3], 3)]
    if (sizes > 4).any():
        others.append(triangles(faces, front[sizes > 4], points)[0])
    for kind, corners in (("triangle", np.concatenate(others)), ("quad", quads)):
        if len(corners):
            cells[kind] = np.searchsorted(plane.front, corners)
    return cells
