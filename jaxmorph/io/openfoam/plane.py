"""OpenFOAM's 2-D and axisymmetric cases, one layer of cells between two planes; cyclic patches."""

import itertools
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import Pair
from jaxmorph._host.package.errors import place_of
from jaxmorph._host.ragged import Ragged
from jaxmorph._host.rows import Rows
from jaxmorph._mesh.exchange import gathered
from jaxmorph._mesh.faces import Faces, following
from jaxmorph._mesh.polyhedra import Polyhedra, triangles

from .file import Boundary, FoamPatch, load_file, read_patches

OFF_PLANE = 1e-6
"""Distance of a node off its plane, as a share of the mesh's extent."""
PARTNERS_APART = 1e-3
"""Distance between two partners, as a share of the mesh's extent."""
ROUNDING = 1e-12
"""Distance of a node off its axis, relative to the mesh's extent, that is written as zero."""


class Front(NamedTuple):
    """Nodes of two planes with one layer of cells between them; the 2-D mesh is the one in front.

    - `kind`: the type of their patches, empty or wedge.
    - `front`, `back` (n,): the case's ids of node i of the mesh, and of its partner; equal on an
      axis. Ids in front ascend, so nodes keep the order of the file.
    - `axes` (2, 2, 3): unit vectors of the mesh's coordinates in front and behind, from `origin`.
      Those of wedges lead along the axis and away from it.
    """

    kind: str
    front: ndarray
    back: ndarray
    axes: ndarray
    origin: ndarray

    @property
    def on_axis(self) -> ndarray:
        return self.front == self.back

    def file_nodes(self) -> ndarray:
        """Returns the 2-D mesh's node (N,) of each node of the case, in front and behind."""
        nodes = np.zeros(max(self.front.max(), self.back.max()) + 1, np.int64)
        nodes[self.front] = nodes[self.back] = np.arange(len(self.front))
        return nodes

    def ids(self, nodes: ndarray) -> ndarray:
        return Rows(self.front).take(nodes)

    def fitted(self, points: ndarray) -> "Front":
        if self.kind == "empty":
            return self
        axes, origin = _find_axis((self.front, np.unique(self.back)), points)
        return self._replace(axes=axes, origin=origin)

    def in_plane(self, points: ndarray) -> ndarray:
        plane = (points[self.front] - self.origin) @ self.axes[0].T
        plane[self.on_axis, 1] = 0
        return plane

    def in_space(self, old: ndarray, plane: ndarray) -> ndarray:
        """Places both planes of `old` at `plane`; coordinates that have not moved stay."""
        moved = plane - self.in_plane(old)
        limit = ROUNDING * np.ptp(old, axis=0).max()
        off = np.flatnonzero(self.on_axis & ~(np.abs(moved[:, 1]) <= limit))
        if off.size:
            raise ValueError(
                f"{off.size} nodes of the axis have left it, first node {off[0]}: name it, "
                "symmetry='axis' or --symmetry axis."
            )
        moved[self.on_axis, 1] = 0
        new = old.copy()
        has_moved = (moved != 0).any(axis=1)[:, None]
        for nodes, axes in zip((self.back, self.front), self.axes[::-1], strict=True):
            here = (old[nodes] - self.origin) @ axes.T
            there = np.where(moved != 0, plane, here)
            new[nodes] = np.where(has_moved, old[nodes] - here @ axes + there @ axes, old[nodes])
        return new

    def added(self, values: ndarray) -> ndarray:
        """Adds values (N, 3) of both planes to (n, 2): the transpose of `in_space`."""
        behind = np.where(self.on_axis[:, None], 0, values[self.back])
        return values[self.front] @ self.axes[0].T + behind @ self.axes[1].T


def find_sector(faces: Faces, points: ndarray, patches: Sequence[ndarray]) -> Front:
    planes = [np.unique(nodes) for nodes in patches]
    if len(np.union1d(*planes)) < len(points):
        raise ValueError(
            "patches of type wedge, but there are nodes off both: there is more than one layer "
            "of cells."
        )
    axes, origin = _find_axis(planes, points)
    # the plane farther around the axis is in front: seen from outside, (x, r) is right-handed
    turn = 1 if np.cross(axes[1, 1], axes[0, 1]) @ axes[0, 0] > 0 else -1
    return _pair_planes("wedge", faces, points, planes[::turn], axes[::turn], origin)


def _pair_planes(
    kind: str,
    faces: Faces,
    points: ndarray,
    planes: Sequence[ndarray],
    axes: ndarray,
    origin: ndarray,
) -> Front:
    """Finds the node behind that an edge joins to each node in front; one in both is its own."""
    front, back = planes
    on = np.zeros((2, len(points)), bool)
    on[0, front] = on[1, back] = True
    alone = on & ~on[::-1]
    corner = faces.labels
    after = faces.after(faces.labels)
    across = alone[0, corner] & alone[1, after]
    partner = np.where(on.all(axis=0), np.arange(len(points)), -1)
    partner[corner[across]] = after[across]
    partner = partner[front]
    if (partner < 0).any() or len(np.unique(partner)) < len(back):
        raise ValueError(
            f"patches of type {kind}, but {len(front)} nodes in front and {len(back)} behind are "
            "not pairs joined by edges: "
            "there is more than one layer of cells."
        )
    here, there = (
        (points[nodes] - origin) @ own.T for nodes, own in zip((front, partner), axes, strict=True)
    )
    distance = np.linalg.norm(here - there, axis=1).max()
    if distance > PARTNERS_APART * np.ptp(points, axis=0).max():
        raise ValueError(
            f"patches of type {kind}, but nodes of the two planes are {distance:.3g} apart along "
            "them."
        )
    return Front(kind, front, partner, axes, origin)


def _find_axis(patches: Sequence[ndarray], points: ndarray) -> Pair:
    """Finds the axis of two planes: unit vectors (2, 2, 3) along and away from it, and a point."""
    size = np.ptp(points, axis=0).max()
    middles = np.stack([points[nodes].mean(axis=0) for nodes in patches])
    arms = [points[nodes] - middle for nodes, middle in zip(patches, middles, strict=True)]
    normals = np.stack([np.linalg.svd(arm, full_matrices=False)[2][-1] for arm in arms])
    if (
        max(np.abs(arm @ normal).max() for arm, normal in zip(arms, normals, strict=True))
        > OFF_PLANE * size
    ):
        raise ValueError("a patch of type wedge does not lie in a plane.")
    axis = np.cross(*normals)
    if not np.linalg.norm(axis) > 1e-9:
        raise ValueError(
            "two patches of type wedge are parallel; a case in two dimensions has patches of "
            "type empty."
        )
    axis = axis / np.linalg.norm(axis) * np.sign(axis[np.abs(axis).argmax()])
    sharp = np.round(axis)
    axis = sharp if np.abs(axis - sharp).max() < OFF_PLANE else axis
    heights = np.append((normals * middles).sum(axis=1), 0)
    origin = np.linalg.lstsq(np.vstack([normals, axis]), heights, rcond=None)[0]
    origin = np.where(np.abs(origin) < OFF_PLANE * size, 0, origin)
    away = middles - origin
    away -= (away @ axis)[:, None] * axis
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return np.stack([np.tile(axis, (2, 1)), away], axis=1), origin


def find_layer(faces: Faces, points: ndarray, empty: ndarray) -> Front:
    """Finds the two planes of a case with patches of type empty, whose faces are `empty`."""
    low = points.min(axis=0)
    high = points.max(axis=0)
    away = np.minimum(points - low, high - points).max(axis=0)
    corners = points[faces.labels]
    starts = faces.starts[:-1]
    reach = (np.maximum.reduceat(corners, starts) - np.minimum.reduceat(corners, starts))[
        empty
    ].max(axis=0)
    normals = np.flatnonzero(np.maximum(away, reach) <= OFF_PLANE * (high - low))
    if len(normals) != 1:
        raise ValueError(
            f"patches of type empty, but their faces are two planes across {len(normals)} of the "
            "axes x, y, z instead of "
            "one. Cases in one dimension, and oblique planes, are not supported; other patches "
            "have another type."
        )
    normal = int(normals[0])
    axes = np.delete(np.eye(3), normal, axis=0)
    # seen from outside, the faces of the front run counterclockwise in its two coordinates
    is_high = points[:, normal] - low[normal] > high[normal] - points[:, normal]
    is_front = ~is_high if normal == 1 else is_high
    planes = np.flatnonzero(is_front), np.flatnonzero(~is_front)
    return _pair_planes("empty", faces, points, planes, np.stack([axes, axes]), np.zeros(3))


def make_front_cells(
    faces: Faces, points: ndarray, chosen: ndarray, plane: Front
) -> tuple[dict[str, ndarray], dict[str, ndarray], Polyhedra | None]:
    """Makes triangles and quads of the front in cell order; larger faces become triangles.

    `chosen` are the faces of both planes. Also returns the ids of their cells by type, and the
    whole cells where some are cut. Raises `ValueError` where the front has not one face a cell.
    """
    is_front = np.zeros(len(points), bool)
    is_front[plane.front] = True
    front = chosen[np.logical_and.reduceat(is_front[faces.labels], faces.starts[:-1])[chosen]]
    front = front[np.argsort(faces.owner[front], kind="stable")]
    owner = faces.owner[front]
    sizes = faces.sizes[front]
    if not np.array_equal(owner, np.arange(faces.count)):
        raise ValueError(
            f"patches of type {plane.kind} have {len(front)} faces in front of {faces.count} "
            "cells, not one each: "
            "the mesh is not one layer of cells between them. Give these patches another type, "
            "such as patch."
        )
    kinds = (("triangle", 3), ("quad", 4))
    parts = [(kind, faces.corners(front[sizes == c], c), owner[sizes == c]) for kind, c in kinds]
    cut = front[sizes > 4]
    whole = None
    if len(cut):
        if plane.kind == "wedge":
            raise ValueError(
                "patches of type wedge with faces of more than four corners are not supported."
            )
        pieces, piece_of = triangles(faces, cut, points)
        parts.append(("triangle", pieces, faces.owner[cut][piece_of]))
        whole = Polyhedra(_make_front_edges(faces, chosen, is_front, plane), faces.owner[cut])
    cells = gathered((kind, Rows(plane.front).of(rows)) for kind, rows, _ in parts if len(rows))
    return cells, gathered((kind, cell) for kind, _, cell in parts), whole


def _make_front_edges(faces: Faces, chosen: ndarray, is_front: ndarray, plane: Front) -> Faces:
    """Makes the front's edges, one a face across the layer, with its cell on the left."""
    across = np.delete(np.arange(len(faces.owner)), chosen)
    corners = faces.corners(across, 4)
    on = is_front[corners]
    # seen from its cell, a face runs along the front against the sense of the cell's face there:
    # the edge begins at the face's last corner in front
    last = np.argmax(on & ~np.roll(on, -1, axis=1), axis=1)
    ends = np.take_along_axis(corners, np.stack([last, last - 1], axis=1) % 4, axis=1)
    if (faces.sizes[across] != 4).any() or (on.sum(axis=1) != 2).any() or not is_front[ends].all():
        raise ValueError(
            f"patches of type {plane.kind}, but there are faces that do not join the two planes."
        )
    labels = Rows(plane.front).of(ends).ravel()
    starts = 2 * np.arange(len(across) + 1)
    return Faces(labels, starts, faces.owner[across], faces.all_neighbours()[across])


MATCH = 1e-4
"""Distance of paired faces, relative to their size: OpenFOAM's own `matchTolerance`."""


def list_cyclic_pairs(boundary: Boundary) -> list[tuple[FoamPatch, FoamPatch]]:
    """Lists the pairs of cyclic patches, without cyclicAMI and cyclicACMI: these need not match."""
    pairs = itertools.combinations(boundary, 2)
    return [(a, b) for a, b in pairs if "cyclic" == a.type == b.type and a.neighbour == b.name]


def check_cyclic(topology: pathlib.Path, old: ndarray, new: ndarray) -> None:
    """Raises `ValueError` where cyclic patches matched with `old` points, but not with `new`."""
    every = list_cyclic_pairs(read_patches(load_file(topology, "boundary")))
    pairs = [(a, b) for a, b in every if a.size == b.size > 0]
    if not pairs or np.array_equal(old, new):
        return
    faces = load_file(topology, "faces").faces()
    for first, second in pairs:
        before, after = (
            [_measure_faces(points, faces.take(patch.faces)) for patch in (first, second)]
            for points in (old, new)
        )
        turns = bool((_measure_mismatch(*before, turned=False) > MATCH).any())
        wrong = _measure_mismatch(*after, turned=turns) - _measure_mismatch(*before, turned=turns)
        if (wrong > MATCH).any():
            face = int(wrong.argmax())
            raise ValueError(
                f"the cyclic patches {first.name!r} and {second.name!r} no longer match: "
                f"{(wrong > MATCH).sum()} of "
                f"{first.size} pairs of faces miss each other, by up to {wrong[face]:.3g} of the "
                "face's size near "
                f"({place_of(after[0][0][face])}). Hold both patches fixed, or move both alike."
            )


def _measure_faces(points: ndarray, faces: Ragged) -> Pair:
    """Computes middles (k, 3) and sizes (k,), roots of areas, of faces."""
    corners = points[faces.values]
    begins = faces.starts[:-1]
    middles = np.add.reduceat(corners, begins) / faces.sizes[:, None]
    arms = corners - middles[faces.row]
    areas = np.add.reduceat(np.cross(arms, following(arms, faces.starts)), begins) / 2
    return middles, np.sqrt(np.linalg.norm(areas, axis=1))


def _measure_mismatch(first: tuple, second: tuple, turned: bool) -> ndarray:
    """Measures how far (k,) faces miss partners, by size, after the best transform."""
    middles, sizes = first
    partners, others = second
    arms = middles - middles.mean(axis=0)
    ends = partners - partners.mean(axis=0)
    if turned:
        left, _, right = np.linalg.svd(arms.T @ ends)
        signs = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
        arms = arms @ (left * signs) @ right
    distance = np.linalg.norm(arms - ends, axis=1)
    return np.maximum(distance, np.abs(sizes - others)) / np.maximum(
        np.minimum(sizes, others), 1e-300
    )
