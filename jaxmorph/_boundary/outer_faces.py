"""The boundary faces of a mesh, and the free faces among them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._host.cells import topology
from .._host.cells.adjacency import is_among
from .._host.cells.pieces import linear_cells, owned_sides, owners
from .._host.linear.products import outward
from .._host.package.arguments import checked
from .._mesh.mesh import Mesh
from .._mesh.polyhedra import Polyhedra, triangles


@dataclasses.dataclass(frozen=True, eq=False)
class OuterFaces:
    """The boundary faces (edges in 2-D) of the cells that fill the mesh, seen from outside.
    `corners` are node ids (k, corners) by type, `ids` (k,) the file's faces, one for all pieces of
    a face.
    """

    corners: dict[str, np.ndarray]
    ids: dict[str, np.ndarray]

    @classmethod
    def numbered(cls, faces: Mapping[str, Any]) -> "OuterFaces":
        corners = {kind: np.asarray(nodes) for kind, nodes in faces.items()}
        ends = np.cumsum([len(nodes) for nodes in corners.values()])
        ids = {kind: np.arange(end - len(corners[kind]), end) for kind, end in zip(corners, ends, strict=True)}
        return cls(corners, ids)

    def count(self, chosen: Mapping[str, np.ndarray] | None = None) -> int:
        ids = [numbers if chosen is None else numbers[chosen[kind]] for kind, numbers in self.ids.items()]
        return len(np.unique(np.concatenate(ids))) if ids else 0


@checked
def boundary_faces(mesh: Mesh, *patches: str) -> dict[str, np.ndarray]:
    """Lists the boundary faces (edges in 2-D) of a mesh, or of some patches, as arrays of node ids.

    A face belongs to the patches if all of its nodes do. Nodes are in counterclockwise order, seen
    from outside of the mesh. Faces of polyhedra with more than four corners are cut into triangles,
    faces of curved cells into pieces between their nodes. By default `patches`, names as
    `Mesh.patch` takes them, are the whole boundary.

    **Returns:** ids (k, corners) by type: `line`, `triangle` and `quad`. **Raises:** `ValueError`
    for a name that is no patch, and for a mesh without cells of its dimension.
    """
    outer = outer_faces(mesh)
    if outer is None:
        raise ValueError(f"the mesh has no cells of {mesh.points.shape[1]} dimensions, and so no boundary faces.")
    inside = np.full(len(mesh.points), not patches)
    inside[mesh.patch(*patches)] = True
    return {kind: corners[inside[corners].all(axis=1)] for kind, corners in outer.corners.items()}


def outer_faces(mesh: Mesh) -> OuterFaces | None:
    """The boundary faces of a mesh, none to other parts; None if no cells fill the space."""
    points = np.asarray(mesh.points)
    cells = {kind: np.asarray(corners) for kind, corners in topology.solid(mesh.cells, points.shape[1]).items()}
    if not cells:
        return None
    if mesh.polyhedra is not None and points.shape[1] == 3:
        return _of_polyhedra(mesh.polyhedra, points, mesh.between)
    sides, outwards = {}, [np.zeros(0)]
    for kind, (nodes, owner) in owned_sides(cells, len(points)).items():
        if mesh.between is not None:
            is_outer = ~is_among(nodes, mesh.between)
            nodes, owner = nodes[is_outer], owner[is_outer]
        sides[kind] = nodes
        corners = nodes[:, : topology.CORNERS[topology.SHAPES[kind]]]
        outwards.append(_outwards(points[corners], _middles(cells, points, owner)))
    ids = owners(sides)
    return OuterFaces(_seen_from_outside(linear_cells(sides), ids, np.concatenate(outwards)), ids)


def _middles(cells: Mapping[str, np.ndarray], points: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """The middles (f, d) of the corners of cells, numbered as in `cells`."""
    middle, first = np.empty((len(owner), points.shape[1])), 0
    for kind, ids in cells.items():
        here = (owner >= first) & (owner < first + len(ids))
        middle[here] = points[ids[owner[here] - first, : topology.CORNERS[topology.SHAPES[kind]]]].mean(axis=1)
        first += len(ids)
    return middle


def _outwards(corners: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Values (f,) for faces (f, c, d), negative for a face that points to its cell."""
    return np.einsum("kd,kd->k", outward(corners), corners.mean(axis=1) - middle)


def _seen_from_outside(
    corners: Mapping[str, np.ndarray], ids: Mapping[str, np.ndarray], outwards: np.ndarray
) -> dict[str, np.ndarray]:
    """Reverses faces that point to their cell, each for itself: its cell runs clockwise."""
    return {kind: np.where(outwards[ids[kind], None] < 0, rows[:, ::-1], rows) for kind, rows in corners.items()}


def _of_polyhedra(whole: Polyhedra, points: np.ndarray, between: np.ndarray | None) -> OuterFaces:
    """The file's faces: pieces of polyhedra share none with the whole cells beside them."""
    faces = whole.faces
    outer = np.ones(len(faces.owner), dtype=bool)
    outer[: len(faces.neighbour)] = faces.neighbour < 0
    rows = np.flatnonzero(outer)
    quads, others = (rows[is_quad] for is_quad in (faces.sizes[rows] == 4, faces.sizes[rows] != 4))
    cut, owner = triangles(faces, others, points) if len(others) else (np.zeros((0, 3), np.int64), np.zeros(0, int))
    corners = {"triangle": cut, "quad": faces.corners(quads, 4) if len(quads) else np.zeros((0, 4), np.int64)}
    ids = {"triangle": others[owner], "quad": quads}
    middle, outwards = whole.middles(points, faces.owner[rows]), np.zeros(len(outer))
    for kind, numbers in ids.items():
        np.add.at(outwards, numbers, _outwards(points[corners[kind]], middle[faces.owner[numbers]]))
    corners = _seen_from_outside(corners, ids, outwards)
    if between is not None:
        inner = rows[is_among(faces.padded(rows), between)]
        is_outer = {kind: ~np.isin(numbers, inner) for kind, numbers in ids.items()}
        corners, ids = ({kind: table[is_outer[kind]] for kind, table in part.items()} for part in (corners, ids))
    return OuterFaces(corners, ids)


@dataclasses.dataclass(frozen=True)
class FreeFaces:
    """Boundary faces that are neither moving, fixed, on a symmetry plane, nor declared free.

    - `count`, `total`: numbers of free faces and of boundary faces.
    - `patches`: number of free faces by name of the patch, only for patches with free faces.
    - `unnamed`: number of free faces in no patch.
    """

    count: int
    total: int
    patches: dict[str, int]
    unnamed: int

    def __bool__(self) -> bool:
        return self.count > 0

    def __str__(self) -> str:
        where = ", ".join(f"{name!r} ({number})" for name, number in self.patches.items())
        where = where and f", in {'patch' if len(self.patches) == 1 else 'patches'} {where}"
        where += f", {self.unnamed} of them in no patch" if self.unnamed else ""
        return (
            f"{self.count} of {self.total} boundary faces are neither moving, fixed nor on a symmetry plane{where}: "
            "their nodes follow like inner nodes, and may leave the boundary."
        )


def free_faces(mesh: Mesh, faces: OuterFaces, is_listed: np.ndarray) -> FreeFaces:
    """Finds the faces with a node that is not listed; `is_listed` is a mask (n,)."""
    free = {kind: np.asarray(~is_listed[corners].all(axis=1)) for kind, corners in faces.corners.items()}
    count, patches, unnamed = faces.count(free), {}, dict(free)
    for name, nodes in mesh.patches.items() if count else ():
        inside = np.zeros(len(is_listed), dtype=bool)
        inside[np.asarray(nodes)] = True
        here = {kind: free[kind] & inside[corners].all(axis=1) for kind, corners in faces.corners.items()}
        unnamed = {kind: is_unnamed & ~here[kind] for kind, is_unnamed in unnamed.items()}
        if number := faces.count(here):
            patches[name] = number
    return FreeFaces(count, faces.count(), patches, faces.count(unnamed))
