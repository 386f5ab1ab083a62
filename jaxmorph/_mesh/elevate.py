"""Meshes of high order made of linear ones."""

import numpy as np

from .._host.cells.lagrange import ORDERS, node_keys, of_order
from .._host.cells.pieces import boundary_sides
from .._host.cells.topology import CORNERS, SHAPES, solid
from .._host.package.arguments import checked
from .mesh import Mesh


@checked
def elevate(mesh: Mesh, order: int) -> Mesh:
    """Makes a mesh of order 2 to 4 of a linear one.

    The cells stay straight, with nodes on their edges, faces and inside. The nodes of the linear
    mesh come first, as they were. New nodes of boundary faces belong to the patches that have all
    corners of the face. `curve` then puts the wall's nodes onto a curved surface.

    **Arguments:**

    - `mesh`: a mesh of linear cells.
    - `order`: 2, 3 or 4.

    **Returns:** a new `Mesh`, which belongs to no file.

    **Raises:** `ValueError` for another order, for cells that are curved already, for a mesh
    without cells and for polyhedra.
    """
    if order not in ORDERS[1:]:
        raise ValueError(f"`order` is {order}; meshes of order 2, 3 and 4 can be made.")
    if mesh.is_curved or mesh.polyhedra is not None or not mesh.cells:
        raise ValueError(f"{mesh} cannot be elevated: linear cells are needed, of the types {', '.join(CORNERS)}.")
    targets = {kind: of_order(kind, order) for kind in mesh.cells}
    keys = {kind: node_keys(np.asarray(ids), targets[kind]) for kind, ids in mesh.cells.items()}
    # a new node is known by its corners and their weights, in ascending order: cells that share a
    # face agree on it
    every = np.concatenate([key.reshape(-1, key.shape[2]) for key in keys.values()])
    nodes, number = np.unique(every, axis=0, return_inverse=True)
    n, number = len(mesh.points), number.ravel()
    cells, first = {}, 0
    for kind, ids in mesh.cells.items():
        k, new = keys[kind].shape[:2]
        cells[targets[kind].name] = np.column_stack(
            [np.asarray(ids), n + number[first : first + k * new].reshape(k, new)]
        )
        first += k * new
    corners, weights = nodes[:, ::2], nodes[:, 1::2]
    old = np.asarray(mesh.points)
    added = np.einsum("nc,ncd->nd", weights / weights.sum(axis=1, keepdims=True), old[corners])
    points = np.concatenate([old, added.astype(old.dtype)])
    return Mesh(points, cells, _patches(mesh, cells, len(points)))


def _patches(mesh: Mesh, cells: dict[str, np.ndarray], n: int) -> dict[str, np.ndarray]:
    patches = {name: [np.asarray(nodes)] for name, nodes in mesh.patches.items()}
    for kind, faces in boundary_sides(solid(cells, mesh.points.shape[1]) or cells, n).items():
        for name, nodes in mesh.patches.items():
            inside = np.zeros(n, bool)
            inside[np.asarray(nodes)] = True
            patches[name].append(faces[inside[faces[:, : CORNERS[SHAPES[kind]]]].all(axis=1)].ravel())
    return {name: np.concatenate(parts) for name, parts in patches.items()}
