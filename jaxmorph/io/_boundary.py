"""From patches of nodes back to the boundary faces between them."""

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.topology import FACES

SURFACE_TYPES = {2: "line", 3: "triangle", 4: "quad"}
"""The type of a side by the number of its corners."""


def boundary_faces(mesh: Mesh, among: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """The sides that belong to one cell only, by type; with `among`, those all of whose nodes are in it."""
    n = mesh.points.shape[0]
    candidate = np.ones(n, bool)
    if among is not None:
        candidate[:] = False
        candidate[among] = True
    found: dict[int, list[np.ndarray]] = {}
    for kind, corners in mesh.cells.items():
        for side in FACES.get(kind, ()):
            faces = np.asarray(corners)[:, side]
            # both copies of an inner side pass or fail together: counting among the candidates is counting among all
            found.setdefault(len(side), []).append(faces[candidate[faces].all(axis=1)])
    return {SURFACE_TYPES[size]: _single(np.concatenate(faces)) for size, faces in sorted(found.items())}


def _single(faces: np.ndarray) -> np.ndarray:
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]


def patch_faces(mesh: Mesh) -> dict[str, dict[str, np.ndarray]]:
    """For each patch its boundary faces, by type: the boundary faces all of whose nodes are in the patch.

    A face that several patches could have (the one edge of an inlet between two walls of one patch) goes to the
    smallest of them. `ValueError` for a patch with nodes that none of its faces holds: faces cannot say it.
    """
    patches = sorted(mesh.patches.items(), key=lambda item: len(item[1]))
    n = mesh.points.shape[0]
    named = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(nodes) for _, nodes in patches)]))
    left = boundary_faces(mesh, named)
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
