"""OpenFOAM's 2-D cases: one layer of cells between two `empty` planes, which move alike."""

import dataclasses
from typing import ClassVar

import numpy as np

from jaxmorph._mesh.faces import Faces
from jaxmorph._mesh.polyhedra import Polyhedra, triangles

from .front import Front, behind
from .wedge import Sector

TOLERANCE = 1e-6
"""Distance that a node may be off its plane, as a share of the distance between the two."""


@dataclasses.dataclass(frozen=True, eq=False)
class Layer(Front):
    """Pairs of nodes of two planes: `front` and `back`, row by row; `axes` are along them.

    Node i of the 2-D mesh is `front[i]`; ids ascend, so nodes keep the order of the file.
    """

    front: np.ndarray
    back: np.ndarray
    axes: tuple[int, int]
    patch_type: ClassVar[str] = "empty"

    def in_plane(self, points: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(points[self.front][:, self.axes])

    def in_space(self, old: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """Places both planes of `old` at `plane`; a node behind an unmoved one stays."""
        new = old.copy()
        rows = np.ix_(self.front, np.array(self.axes))
        moved = plane != old[rows]
        new[rows] = plane
        behind = np.ix_(self.back, np.array(self.axes))
        new[behind] = np.where(moved, plane, old[behind])
        return new

    def added(self, values: np.ndarray) -> np.ndarray:
        """Adds values (N, 3) of both planes to (n, 2): the transpose of `in_space`."""
        return (values[self.front] + values[self.back])[:, self.axes]


def layer(faces: Faces, points: np.ndarray, empty: np.ndarray) -> Layer:
    """Finds the two planes of a case with patches of type empty, whose faces are `empty`.

    It raises `ValueError` where the nodes are not on two planes across one axis, or not in pairs.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    away = np.minimum(points - low, high - points).max(axis=0)
    normals = np.flatnonzero(away <= TOLERANCE * (high - low))
    if len(normals) > 1 and len(empty):  # one row of cells: the empty faces tell which way
        sizes = faces.sizes[empty]
        ends = np.cumsum(sizes)
        corners = points[np.concatenate([faces.nodes(face, face + 1) for face in empty.tolist()])]
        reach = np.maximum.reduceat(corners, ends - sizes) - np.minimum.reduceat(corners, ends - sizes)
        normals = normals[reach[:, normals].max(axis=0) <= TOLERANCE * (high - low)[normals]]
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
    back = behind(faces, is_front, ~is_front)[front]
    if (back < 0).any() or len(np.unique(back)) != len(points) - len(front):
        raise ValueError(
            f"patches of type empty, but {len(front)} nodes in front and {len(points) - len(front)} behind are not pairs "
            "joined by edges: there is more than one layer of cells."
        )
    off = np.abs(points[front][:, axes] - points[back][:, axes]).max()
    if off > TOLERANCE * 1e3 * (high - low).max():
        raise ValueError(f"patches of type empty, but nodes of the two planes are {off:.3g} apart along them.")
    return Layer(front, back, axes)


def plane_cells(
    faces: Faces, points: np.ndarray, empty: np.ndarray, plane: Layer | Sector
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Polyhedra | None]:
    """Makes triangles and quads of the front in cell order; larger faces become triangles.

    It also gives the ids of their cells by type, and the whole cells where some are cut. It raises
    `ValueError` where the front has not one face a cell.
    """
    is_front = np.zeros(len(points), bool)
    is_front[plane.front] = True
    front = empty[np.logical_and.reduceat(is_front[faces.labels], faces.starts[:-1])[empty]]
    front = front[np.argsort(faces.owner[front], kind="stable")]
    owner, sizes = faces.owner[front], faces.sizes[front]
    if not np.array_equal(owner, np.arange(faces.owner.max() + 1)):
        raise ValueError(
            f"patches of type {plane.patch_type} have {len(front)} faces in front of {faces.owner.max() + 1} cells, not one each: "
            "the mesh is not one layer of cells between them. Give these patches another type, such as patch."
        )
    corners = {"triangle": faces.corners(front[sizes == 3], 3), "quad": faces.corners(front[sizes == 4], 4)}
    ids = {"triangle": owner[sizes == 3], "quad": owner[sizes == 4]}
    cut, whole = front[sizes > 4], None
    if len(cut):
        pieces, piece_of = triangles(faces, cut, points)
        corners["triangle"] = np.concatenate([corners["triangle"], pieces])
        ids["triangle"] = np.concatenate([ids["triangle"], faces.owner[cut][piece_of]])
        whole = Polyhedra(_edges(faces, empty, is_front, plane), faces.owner[cut])
    cells = {kind: np.searchsorted(plane.front, rows) for kind, rows in corners.items() if len(rows)}
    return cells, ids, whole


def _edges(faces: Faces, empty: np.ndarray, is_front: np.ndarray, plane: Layer | Sector) -> Faces:
    """Makes the front's edges, one a face across the layer, with its cell on the left."""
    across = np.ones(len(faces.owner), bool)
    across[empty] = False
    chosen = np.flatnonzero(across)
    label, rows = faces.labels, np.flatnonzero(np.repeat(across, faces.sizes))
    face = np.repeat(np.arange(len(faces.owner)), faces.sizes)[rows]
    after = np.where(rows + 1 == faces.starts[face + 1], faces.starts[face], rows + 1)
    leaves, enters = (
        (is_front[label[rows]] & ~is_front[label[after]]),
        (~is_front[label[rows]] & is_front[label[after]]),
    )
    if not (np.array_equal(face[leaves], chosen) and np.array_equal(face[enters], chosen)):
        raise ValueError(f"patches of type {plane.patch_type}, but there are faces that do not join the two planes.")
    # seen from its cell, such a face runs along the front against the sense of the cell's face in
    # the front
    ends = np.stack([label[rows[leaves]], label[after[enters]]], axis=1)
    neighbour = np.full(len(faces.owner), -1)
    neighbour[: len(faces.neighbour)] = faces.neighbour
    starts = 2 * np.arange(len(chosen) + 1)
    return Faces(np.searchsorted(plane.front, ends).ravel(), starts, faces.owner[chosen], neighbour[chosen])
