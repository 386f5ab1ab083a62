"""The boundary faces of a mesh, and the free faces among them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .._host.package.arguments import checked
from .._host.rows import Rows, join_ids, mark
from .._mesh.mesh import Mesh
from .._mesh.topology import OuterFaces

Points = Float[np.ndarray, "n d"]
Ids = Int[np.ndarray, " _k"]
Faces = Mapping[str, Any]  # corners (k, c), or numbers (k,), by type


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
    outer = mesh.outer_faces
    if outer is None:
        raise ValueError(
            f"the mesh has no cells of {mesh.points.shape[1]} dimensions, and so no boundary faces."
        )
    inside = Rows(mesh.patch(*patches) if patches else np.arange(len(mesh.points)))
    return {kind: ids[inside.mask(ids).all(axis=1)] for kind, ids in outer.corners.items()}


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


def free_faces(
    patches: Faces,
    faces: OuterFaces,
    is_listed: Bool[np.ndarray, " n"],
    sides: Sequence[Bool[np.ndarray, " n"]],
) -> FreeFaces:
    """Finds the faces with a node that is not listed, but for those within one of the `sides`.

    A face from one side to another, as at the rim of a slab, is free: its nodes leave it along the
    sides.
    """
    ids = join_ids(faces.ids.values())

    def inside(is_in: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [np.zeros(0, bool), *(is_in[ids].all(axis=1) for ids in faces.corners.values())]
        )

    def count(chosen: Any) -> int:
        return len(np.unique(ids[chosen]))

    free = ~inside(is_listed)
    for side in sides:
        free &= ~inside(is_listed | side)
    counts = {}
    unnamed = free.copy()
    for name, nodes in patches.items() if free.any() else ():
        here = free & inside(mark(len(is_listed), nodes))
        unnamed &= ~here
        counts |= {name: count(here)} if here.any() else {}
    return FreeFaces(count(free), count(slice(None)), counts, count(unnamed))
