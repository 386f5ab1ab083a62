"""Node numbers of the front plane of a case with one layer of cells."""

import numpy as np

from jaxmorph._mesh.faces import Faces


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
