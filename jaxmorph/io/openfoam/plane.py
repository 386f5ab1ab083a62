"""OpenFOAM's 2-D and axisymmetric cases, one layer of cells between two planes; cyclic patches."""

import dataclasses
import pathlib
from typing import ClassVar

import numpy as np

from jaxmorph._mesh.faces import Faces
from jaxmorph._mesh.polyhedra import Polyhedra, triangles

from .file import Patch, load, patches


class Front:
    """Numbers nodes by their places in `front`, the case's ascending ids of the front nodes.

    `back` are the ids of the nodes behind.
    """

    front: np.ndarray
    back: np.ndarray

    def file_nodes(self) -> np.ndarray:
        """Returns the 2-D mesh's node (N,) of each node of the case, in front and behind."""
        nodes = np.zeros(max(self.front.max(), self.back.max()) + 1, np.int64)
        nodes[self.front] = nodes[self.back] = np.arange(len(self.front))
        return nodes

    def ids(self, nodes: np.ndarray) -> np.ndarray:
        """Returns the 2-D mesh's ids of the `nodes` in the front, in their order."""
        at = np.minimum(np.searchsorted(self.front, nodes), len(self.front) - 1)
        return at[self.front[at] == nodes]

    def edges(self, faces: np.ndarray) -> np.ndarray:
        """Returns the front's edges (k, 2) in which faces (k, c) between the planes end."""
        return self.ids(faces).reshape(-1, 2)


def behind(faces: Faces, front: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Finds the `back` node that an edge joins to each `front` node; -1 elsewhere."""
    corner = faces.labels
    # the last label of a face is followed by its first
    after = np.empty_like(corner)
    after[:-1] = corner[1:]
    after[faces.starts[1:] - 1] = corner[faces.starts[:-1]]
    across = front[corner] & back[after]
    partner = np.full(len(front), -1)
    partner[corner[across]] = after[across]
    return partner


FLAT = 1e-6
"""Distance that a node may be off its plane, as a share of the mesh's extent."""
APART = 1e-3
"""Distance that the places of two partners may be apart, as a share of the mesh's extent."""
ROUNDING = 1e-12
"""Distance of a node off its axis, relative to the mesh's extent: it is written on the axis."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sector(Front):
    """Pairs of nodes of two wedge planes: `front` and `back`, row by row, equal on the axis.

    Node i of the 2-D mesh is `front[i]`, at its place along the `axis` and its distance from it,
    along `out` in front and `out_behind` behind, from the point `origin`. Ids ascend, so nodes keep
    the order of the file. `is_first` tells that the front is the first of the file's two planes.
    """

    front: np.ndarray
    back: np.ndarray
    axis: np.ndarray
    origin: np.ndarray
    out: np.ndarray
    out_behind: np.ndarray
    is_first: bool
    patch_type: ClassVar[str] = "wedge"

    def in_plane(self, points: np.ndarray) -> np.ndarray:
        arms = points[self.front] - self.origin
        return np.stack([arms @ self.axis, np.where(self.on_axis, 0, arms @ self.out)], axis=1)

    def fitted(self, points: np.ndarray) -> "Sector":
        """Finds the axis and both planes in other points (N, 3), as reading them does."""
        front, back = self.front, np.unique(self.back)
        axis, origin, outward = _frame((front, back) if self.is_first else (back, front), points)
        out, out_behind = outward if self.is_first else outward[::-1]
        return dataclasses.replace(self, axis=axis, origin=origin, out=out, out_behind=out_behind)

    @property
    def on_axis(self) -> np.ndarray:
        """Marks the nodes (n,) of the axis."""
        return self.front == self.back

    def in_space(self, old: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """Moves both planes of `old` as `plane` has moved.

        Raises `ValueError` where the axis does not stay.
        """
        along, outward = (plane - self.in_plane(old)).T[:, :, None]
        limit = ROUNDING * np.ptp(old, axis=0).max()
        off = np.flatnonzero(self.on_axis & ~(np.abs(outward[:, 0]) <= limit))
        if off.size:
            raise ValueError(
                f"{off.size} nodes of the axis have left it, first node {off[0]}: name it, symmetry='axis' or --symmetry axis."
            )
        outward = np.where(self.on_axis[:, None], 0, outward)
        new = old.copy()
        new[self.front] = old[self.front] + along * self.axis + outward * self.out
        behind = self.back[~self.on_axis]
        new[behind] = old[behind] + (along * self.axis + outward * self.out_behind)[~self.on_axis]
        return new

    def added(self, values: np.ndarray) -> np.ndarray:
        """Adds values (N, 3) of both planes to (n, 2): the transpose of `in_space`."""
        front, back = values[self.front], np.where(self.on_axis[:, None], 0, values[self.back])
        return np.stack([(front + back) @ self.axis, front @ self.out + back @ self.out_behind], axis=1)


def sector(faces: Faces, first: np.ndarray, second: np.ndarray, points: np.ndarray) -> Sector:
    """Finds the planes of two wedge patches by their nodes.

    It raises `ValueError` where they are not planes at an angle, or their nodes are not pairs that
    edges join.
    """
    size = np.ptp(points, axis=0).max()
    first, second = np.unique(first), np.unique(second)
    if len(np.union1d(first, second)) < len(points):
        raise ValueError("patches of type wedge, but there are nodes off both: there is more than one layer of cells.")
    axis, origin, outward = _frame((first, second), points)
    # the plane farther around the axis is in front: seen from outside, (x, r) is right-handed
    is_first = np.cross(outward[1], outward[0]) @ axis > 0
    front, back = (first, second) if is_first else (second, first)
    out, out_behind = outward if is_first else outward[::-1]
    on = np.zeros((2, len(points)), dtype=bool)
    on[0, front], on[1, back] = True, True
    partner = np.where(on.all(axis=0), np.arange(len(points)), behind(faces, on[0] & ~on[1], on[1] & ~on[0]))[front]
    if (partner < 0).any() or len(np.unique(partner)) < len(back):
        raise ValueError(
            f"patches of type wedge, but their {len(front)} and {len(back)} nodes are not pairs joined by edges: there is more "
            "than one layer of cells."
        )
    places = [
        np.stack([(points[nodes] - origin) @ axis, (points[nodes] - origin) @ away], axis=1)
        for nodes, away in ((front, out), (partner, out_behind))
    ]
    distance = np.linalg.norm(places[0] - places[1], axis=1).max()
    if distance > APART * size:
        raise ValueError(f"patches of type wedge, but nodes of their planes are up to {distance:.3g} apart along them.")
    return Sector(front, partner, axis, origin, out, out_behind, bool(is_first))


def _frame(
    patches: tuple[np.ndarray, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Finds the axis of two patches, a point on it, and the direction in which each leaves it."""
    axis, origin = _axis(patches, points, np.ptp(points, axis=0).max())
    outward = []
    for nodes in patches:
        arm = points[nodes].mean(axis=0) - origin
        arm = arm - (arm @ axis) * axis
        outward.append(arm / np.linalg.norm(arm))
    return axis, origin, outward


def _axis(patches: tuple[np.ndarray, np.ndarray], points: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Finds the line in which the planes of two patches meet: its direction, and a point on it."""
    normals = []
    for nodes in patches:
        middle = points[nodes].mean(axis=0)
        normals.append(np.linalg.svd(points[nodes] - middle, full_matrices=False)[2][-1])
        if np.abs((points[nodes] - middle) @ normals[-1]).max() > FLAT * size:
            raise ValueError("a patch of type wedge does not lie in a plane.")
    axis = np.cross(*normals)
    if not np.linalg.norm(axis) > 1e-9:
        raise ValueError("two patches of type wedge are parallel; a case in two dimensions has patches of type empty.")
    axis = axis / np.linalg.norm(axis) * np.sign(axis[np.abs(axis).argmax()])
    sharp = np.round(axis)
    axis = sharp if np.abs(axis - sharp).max() < FLAT else axis
    heights = [normal @ points[nodes].mean(axis=0) for normal, nodes in zip(normals, patches, strict=True)]
    origin = np.linalg.lstsq(np.stack([*normals, axis]), np.array([*heights, 0.0]), rcond=None)[0]
    return axis, np.where(np.abs(origin) < FLAT * size, 0, origin)


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
    normals = np.flatnonzero(away <= FLAT * (high - low))
    if len(normals) > 1 and len(empty):  # one row of cells: the empty faces tell which way
        sizes = faces.sizes[empty]
        ends = np.cumsum(sizes)
        corners = points[np.concatenate([faces.nodes(face, face + 1) for face in empty.tolist()])]
        reach = np.maximum.reduceat(corners, ends - sizes) - np.minimum.reduceat(corners, ends - sizes)
        normals = normals[reach[:, normals].max(axis=0) <= FLAT * (high - low)[normals]]
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
    if off > FLAT * 1e3 * (high - low).max():
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


MATCH = 1e-4
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
        turns = bool((_misses(*before, turned=False) > MATCH).any())
        wrong = _misses(*after, turned=turns) - _misses(*before, turned=turns)
        if (wrong > MATCH).any():
            face = int(wrong.argmax())
            place = ", ".join(f"{x:.4g}" for x in after[0][0][face])
            raise ValueError(
                f"the cyclic patches {first.name!r} and {second.name!r} no longer match: {(wrong > MATCH).sum()} of "
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
