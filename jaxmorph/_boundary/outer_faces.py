"""The boundary faces of a mesh, and the free faces among them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.cells import topology
from .._host.cells.adjacency import is_among
from .._host.cells.pieces import linear_cells, owned_sides, owners
from .._host.linear.products import outward
from .._host.package.arguments import checked
from .._mesh.mesh import Mesh
from .._mesh.polyhedra import Polyhedra, triangles

Points = Float[np.ndarray, "n d"]
Ids = Int[np.ndarray, " k"]
Faces = Mapping[str, np.ndarray]  # corners (k, c), or numbers (k,), by type


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
        return cls({kind: np.asarray(nodes) for kind, nodes in faces.items()}, owners(faces))


def mask(n: int, *nodes: Any) -> Bool[np.ndarray, " n"]:
    marked = np.zeros(n, dtype=bool)
    for ids in nodes:
        marked[np.asarray(ids)] = True
    return marked


def row_of(nodes: np.ndarray, n: int) -> Int[np.ndarray, " n"]:
    """Finds the row of each of n nodes in `nodes`; -1 for an absent node."""
    row = np.full(n, -1, dtype=np.int32)
    row[nodes] = np.arange(len(nodes))
    return row


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
        raise ValueError(
            f"the mesh has no cells of {mesh.points.shape[1]} dimensions, and so no boundary faces."
        )
    inside = mask(
        len(mesh.points), mesh.patch(*patches) if patches else np.arange(len(mesh.points))
    )
    return {kind: corners[inside[corners].all(axis=1)] for kind, corners in outer.corners.items()}


def outer_faces(mesh: Mesh) -> OuterFaces | None:
    """The boundary faces of a mesh, none to other parts; None if no cells fill the space."""
    points = np.asarray(mesh.points)
    cells = {
        kind: np.asarray(corners)
        for kind, corners in topology.solid(mesh.cells, points.shape[1]).items()
    }
    if not cells:
        return None
    if mesh.polyhedra is not None and points.shape[1] == 3:
        return _of_polyhedra(mesh.polyhedra, points, mesh.between)
    sides = {}
    owner = []
    for kind, (nodes, cell) in owned_sides(cells, len(points)).items():
        is_outer = (
            np.ones(len(nodes), dtype=bool)
            if mesh.between is None
            else ~is_among(nodes, mesh.between)
        )
        sides[kind] = nodes[is_outer]
        owner.append(cell[is_outer])
    corners = [ids[:, : topology.CORNERS[topology.SHAPES[kind]]].T for kind, ids in cells.items()]
    middle = np.concatenate(
        [sum(points[ids] for ids in columns) / len(columns) for columns in corners]
    )
    ids = owners(sides)
    return OuterFaces(
        _seen_from_outside(linear_cells(sides), ids, points, middle[np.concatenate(owner)]), ids
    )


def _seen_from_outside(
    corners: Faces, ids: Faces, points: np.ndarray, middle: np.ndarray
) -> dict[str, np.ndarray]:
    """Reverses faces that point to the `middle` (f, d) of their cell, each for itself: it runs
    clockwise. A face has one sense, that of the sum of its pieces.
    """
    outwards = np.zeros(len(middle))
    for kind, rows in corners.items():
        x = points[rows]
        face = ids[kind]
        np.add.at(outwards, face, np.einsum("kd,kd->k", outward(x), x.mean(axis=1) - middle[face]))
    return {
        kind: np.where(outwards[ids[kind], None] < 0, rows[:, ::-1], rows)
        for kind, rows in corners.items()
    }


def _of_polyhedra(whole: Polyhedra, points: np.ndarray, between: np.ndarray | None) -> OuterFaces:
    """The file's faces: pieces of polyhedra share none with the whole cells beside them."""
    faces = whole.faces
    rows = np.setdiff1d(np.arange(len(faces.owner)), np.flatnonzero(faces.neighbour >= 0))
    if between is not None:
        rows = rows[~is_among(faces.padded(rows), between)]
    quads, others = (
        np.flatnonzero(is_kind) for is_kind in (faces.sizes[rows] == 4, faces.sizes[rows] != 4)
    )
    none = np.zeros((0, 3), np.int64), np.zeros(0, int)
    cut, piece_of = triangles(faces, rows[others], points) if len(others) else none
    corners = {
        "triangle": cut,
        "quad": faces.corners(rows[quads], 4) if len(quads) else np.zeros((0, 4), np.int64),
    }
    ids = {"triangle": others[piece_of], "quad": quads}
    owner = faces.owner[rows]
    return OuterFaces(
        _seen_from_outside(corners, ids, points, whole.middles(points, owner)[owner]), ids
    )


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
            f"{self.count} of {self.total} boundary faces are neither moving, fixed nor on a "
            f"symmetry plane{where}: "
            "their nodes follow like inner nodes, and may leave the boundary."
        )


def free_faces(mesh: Mesh, faces: OuterFaces, is_listed: np.ndarray) -> FreeFaces:
    """Finds the faces with a node that is not listed; `is_listed` is a mask (n,)."""
    ids = np.concatenate([np.zeros(0, int), *faces.ids.values()])

    def inside(is_in: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [np.zeros(0, bool), *(is_in[ids].all(axis=1) for ids in faces.corners.values())]
        )

    def count(chosen: Any) -> int:
        return len(np.unique(ids[chosen]))

    free = ~inside(is_listed)
    patches = {}
    unnamed = free.copy()
    for name, nodes in mesh.patches.items() if free.any() else ():
        here = free & inside(mask(len(is_listed), nodes))
        unnamed &= ~here
        patches |= {name: count(here)} if here.any() else {}
    return FreeFaces(count(free), count(slice(None)), patches, count(unnamed))
