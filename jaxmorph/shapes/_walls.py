"""Walls of a mesh as shapes take them: loops in 2-D, faces in 3-D, normals of nodes."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float, Int

from .._boundary.outer_faces import boundary_faces
from .._host.cells.first_lines import first_lines
from .._host.package.arguments import as_array, checked
from .._mesh.mesh import Mesh
from ._arguments import rows_of


@checked
def wall_loop(mesh: Mesh, patch: str) -> Int[np.ndarray, " k"]:
    """Finds the nodes of a closed wall in 2-D in order, counter-clockwise.

    **Arguments:**

    - `mesh`: a `Mesh` in 2-D.
    - `patch`: the name of the wall's patch.

    **Returns:** node ids (k,).

    **Raises:** `ValueError` for a patch that is not one closed loop, with a node where it ends or
    branches.
    """
    segments = boundary_faces(mesh, patch).get("line", np.zeros((0, 2), int))
    ends, degree = np.unique(segments, return_counts=True)
    if len(segments) == 0 or (degree != 2).any():
        where = f", first node {ends[degree != 2][0]}" if len(segments) else ""
        raise ValueError(f"patch {patch!r} is no closed loop: {(degree != 2).sum()} ends or branches{where}.")
    beside: dict[int, list[int]] = {int(node): [] for node in ends}
    for a, b in segments.tolist():
        beside[a].append(b)
        beside[b].append(a)
    loop = [int(ends[0])]
    loop.append(beside[loop[0]][0])
    while (following := next(n for n in beside[loop[-1]] if n != loop[-2])) != loop[0]:
        loop.append(following)
    if len(loop) != len(ends):
        raise ValueError(f"patch {patch!r} is several loops: {len(loop)} of its {len(ends)} nodes hang together.")
    ids = np.array(loop)
    x, y = np.asarray(mesh.points)[ids].T
    return ids if x @ np.roll(y, -1) > y @ np.roll(x, -1) else ids[::-1].copy()


@checked
def wall_normals(mesh: Mesh, *patches: str) -> Float[np.ndarray, "m d"]:
    """Sums the areas of a wall's faces at its nodes: vectors from the body into the mesh.

    It runs on the host.

    A face gives each of its corners an equal share of its area. In 2-D a node has half the edges
    beside it: its vector is at right angles to the line between its two neighbours. Solvers decide
    by it which side of an airfoil a node is on.

    **Arguments:**

    - `mesh`: a `Mesh` with cells.
    - `patches`: names of the wall's patches.

    **Returns:** vectors (m, d), in the order of `mesh.patch(*patches)`; 0 for a node of no face.

    **Raises:** `ValueError` for patches without faces on the boundary of the mesh's cells.
    """
    nodes, points = mesh.patch(*patches), np.asarray(mesh.points, float)
    cells = {kind: np.asarray(corners) for kind, corners in mesh.linear.cells.items()}
    normals = np.zeros_like(points)
    for side in first_lines(cells, points, nodes).sides:
        np.add.at(normals, side.ids, side.areas(points) / side.ids.shape[1])
    return normals[nodes]


def face_arrays(faces: Any) -> list[np.ndarray]:
    """Lists the arrays of faces that are one array or several."""
    is_list = isinstance(faces, list | tuple) and np.ndim(faces[0]) == 2
    return [as_array("faces", ids) for ids in (faces if is_list else [faces])]


def triangles_of(faces: Any, x: Float[Array, "n d"]) -> Int[np.ndarray, "k 3"]:
    """Cuts faces of a wall in 3-D into triangles. Raises `ValueError` for faces of other shapes."""
    pieces = []
    for ids in face_arrays(faces):
        if x.shape[1] != 3 or ids.ndim != 2 or ids.shape[1] not in (3, 4) or ids.size == 0:
            raise ValueError(
                f"`x` has shape {x.shape}, `faces` {ids.shape}; expected (n, 3) and its rows (k, 3) or (k, 4)."
            )
        ids = rows_of("faces", ids, len(x))
        pieces += [ids[:, [0, k, k + 1]] for k in range(1, ids.shape[1] - 1)]
    return np.concatenate(pieces)
