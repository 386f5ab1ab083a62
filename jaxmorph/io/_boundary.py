"""From patches of nodes back to the boundary faces between them."""

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.topology import boundary_faces


def patch_faces(mesh: Mesh) -> dict[str, dict[str, np.ndarray]]:
    """For each patch its boundary faces, by type: the boundary faces all of whose nodes are in the patch.

    A face that several patches could have (the one edge of an inlet between two walls of one patch) goes to the
    smallest of them. `ValueError` for a patch with nodes that none of its faces holds: faces cannot say it.
    """
    patches = sorted(mesh.patches.items(), key=lambda item: len(item[1]))
    n = mesh.points.shape[0]
    named = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(nodes) for _, nodes in patches)]))
    left = boundary_faces(mesh.cells, n, named)
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, nodes in patches:
        inside, held = np.zeros(n, bool), np.zeros(n, bool)
        inside[nodes] = True
        found[name] = {}
        for kind, faces in left.items():
            mine = inside[faces].all(axis=1)
            found[name][kind], left[kind] = faces[mine], faces[~mine]
            held[faces[mine]] = True
        missing = np.flatnonzero(inside & ~held)
        if missing.size:
            raise ValueError(
                f"patch {name!r}: {missing.size} of {len(nodes)} nodes (first {missing[0]}) are on no boundary face of "
                "the patch, and this format keeps patches as faces. Drop the patch, or write .vtu, which keeps nodes."
            )
    return {name: found[name] for name in mesh.patches}
