"""A mesh of several zones or blocks with joined nodes, and the way back to the file's nodes."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxmorph._host.cells.topology import DIMENSION
from jaxmorph._mesh.arrays import checked_parts
from jaxmorph._mesh.exchange import Parts

from .._host.cells.adjacency import columns_of, is_single, sorted_columns
from ._rounding import Held
from ._structured import open_faces, shared_nodes


@dataclasses.dataclass(frozen=True, eq=False)
class Zones:
    """All nodes of a file, zone after zone, cells and patches of their ids, and outer faces.

    `names` are names of the patches that the faces become where no other zone meets them; without
    names such a patch is `unnamed`.
    """

    points: np.ndarray
    cells: list[tuple[str, np.ndarray]]
    patches: dict[str, list[np.ndarray]]
    faces: list[np.ndarray]
    names: list[str] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Joined:
    """Maps each node of the file to the mesh's (`node`), and keeps the file's `points`."""

    node: np.ndarray
    points: np.ndarray
    is_flat: bool

    def in_file(self, points: np.ndarray) -> np.ndarray:
        """Returns the file's points from the mesh's; copies of an unmoved point stay as read."""
        first = np.unique(self.node, return_index=True)[1]
        new = self.points.copy()
        d = points.shape[1]
        moved = (points != self.points[first, :d].astype(points.dtype))[self.node]
        new[:, :d] = np.where(moved, points[self.node], self.points[:, :d])
        return new

    def in_mesh(self, values: np.ndarray) -> np.ndarray:
        """Returns the mesh's points from the file's: those of each node's first copy."""
        return values[np.unique(self.node, return_index=True)[1], : 2 if self.is_flat else 3]

    def held(self, singles: Sequence[tuple[slice, Any]]) -> Held | None:
        """Tells how a file in single precision at `singles` holds the points; None: all digits."""
        return Held(self.points, self.in_file, self.in_mesh, singles) if singles else None


def join(zones: Zones) -> tuple[Parts, Joined]:
    """Joins zones to one mesh in the file's node order; 2-D if all cells are, and z is constant.

    It raises `ValueError` for coordinates that are not finite.
    """
    points = zones.points
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise ValueError(f"{bad.size} points are not finite, first node {bad[0]}: {points[bad[0]].tolist()}.")
    original, node, patches = _join_nodes(zones)
    cells: dict[str, list[np.ndarray]] = {}
    for kind, corners in zones.cells:
        cells.setdefault(kind, []).append(node[corners])
    is_flat = max(DIMENSION[kind] for kind in cells) == 2 and (points.shape[1] == 2 or bool(np.ptp(points[:, 2]) == 0))
    at = points[original][:, : 2 if is_flat else 3]
    whole = {kind: np.concatenate(parts) for kind, parts in cells.items()}
    return checked_parts(np.ascontiguousarray(at), whole, patches), Joined(node, points, is_flat)


def _join_nodes(zones: Zones) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Finds the nodes that stay, the mesh node of each file node, and the mesh's patches.

    Where no patch lies, nodes at one place are one. Faces that are then alone and in no patch are
    the patch `unnamed`, or `boundary` where there is no other, unless they have a name. Where the
    file has a patch `unnamed` they are `unnamed_faces`.
    """
    covers = [nodes for parts in zones.patches.values() for nodes in parts]
    faces = open_faces(zones.faces, covers, len(zones.points))
    original, node = np.unique(shared_nodes(zones.points, faces), return_inverse=True)
    patches = {name: np.concatenate([node[nodes] for nodes in parts]) for name, parts in zones.patches.items()}
    rest = "unnamed" if patches else "boundary"
    while rest in patches:
        rest += "_faces"
    shared = [node[corners] for corners in faces]
    for number, (corners, mask) in enumerate(zip(shared, _single(shared), strict=True)):
        if mask.any():
            name = zones.names[number] if zones.names else rest
            patches[name] = np.concatenate([patches.get(name, corners[:0, 0]), corners[mask].ravel()])
    return original, node, patches


def _single(faces: list[np.ndarray]) -> list[np.ndarray]:
    """Finds faces that come once and are not shrunk to a line or point: a mask for each array."""
    if not faces:
        return []
    width = max(corners.shape[1] for corners in faces)
    columns = [sorted_columns(columns_of(corners), width) for corners in faces]
    has_extent = []
    for corners, column in zip(faces, columns, strict=True):
        size = corners.shape[1]
        distinct = 1 + sum((b != a).astype(np.int8) for a, b in itertools.pairwise(column[:size]))
        has_extent.append(distinct >= min(size, 3))
    once = is_single([np.concatenate(parts) for parts in zip(*columns, strict=True)])
    return np.split(once & np.concatenate(has_extent), np.cumsum([len(corners) for corners in faces])[:-1])
