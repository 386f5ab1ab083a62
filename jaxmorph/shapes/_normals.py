"""Normals of a wall's nodes."""

import numpy as np
from jaxtyping import Float

from .._host.cells.first_lines import areas, first_lines
from .._host.package.arguments import checked
from .._mesh.mesh import Mesh


@checked
def wall_normals(mesh: Mesh, *patches: str) -> Float[np.ndarray, "m d"]:
    """Sums the areas of a wall's faces at its nodes: vectors from the body into the mesh, on the host.

    A face gives each of its corners an equal share of its area. In 2-D a node has half the edges beside it: its vector is at right
    angles to the line between its two neighbours. Solvers decide by it which side of an airfoil a node is on.

    **Arguments:**

    - `mesh`: a `Mesh` with cells.
    - `patches`: names of the wall's patches.

    **Returns:** vectors (m, d), in the order of `mesh.patch(*patches)`; 0 for a node of no face.

    **Raises:** `ValueError` for patches without faces on the boundary of the mesh's cells.
    """
    nodes, points = mesh.patch(*patches), np.asarray(mesh.points, float)
    cells = {kind: np.asarray(corners) for kind, corners in mesh.linear.cells.items()}
    wall = first_lines(cells, points, nodes)
    area = wall.sign[:, None] * areas(points[wall.faces])
    counted = np.ones(wall.faces.shape, bool)
    counted[:, -1] = wall.faces[:, -1] != wall.faces[:, -2]
    share = area / counted.sum(axis=1)[:, None]
    normals = np.zeros_like(points)
    for corner in range(wall.faces.shape[1]):
        np.add.at(normals, wall.faces[counted[:, corner], corner], share[counted[:, corner]])
    return normals[nodes]
