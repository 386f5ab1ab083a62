"""Boundary faces between the nodes of patches."""

import numpy as np

from jaxmorph._host.cells.pieces import boundary_sides

from ._format import MeshLike


def patch_faces(mesh: MeshLike) -> dict[str, dict[str, np.ndarray]]:
    """Finds the boundary faces of each patch, by type: all nodes of the face are in the patch.

    A face that several patches could have (the one edge of an inlet between two walls of one patch)
    goes to the smallest of them. It raises `ValueError` for a patch with nodes that none of its
    faces holds: faces cannot say it.
    """
    patches = sorted(mesh.patches.items(), key=lambda item: len(item[1]))
    n = mesh.points.shape[0]
    nodes_of_all = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(nodes) for _, nodes in patches)]))
    left = boundary_sides({kind: np.asarray(ids) for kind, ids in mesh.cells.items()}, n, nodes_of_all)
    result: dict[str, dict[str, np.ndarray]] = {}
    for name, nodes in patches:
        inside, on_faces = np.zeros(n, bool), np.zeros(n, bool)
        inside[nodes] = True
        result[name] = {}
        for kind, faces in left.items():
            is_inside = inside[faces].all(axis=1)
            result[name][kind], left[kind] = faces[is_inside], faces[~is_inside]
            on_faces[faces[is_inside]] = True
        missing = np.flatnonzero(inside & ~on_faces)
        if missing.size:
            raise ValueError(
                f"patch {name!r}: {missing.size} of {len(nodes)} nodes (first {missing[0]}) are on no boundary face of "
                "the patch, and this format keeps patches as faces. Drop the patch, or write .vtu, which keeps nodes."
            )
    return {name: result[name] for name in mesh.patches}
