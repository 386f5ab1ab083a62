"""Node numbers of the front plane of a case with one layer of cells."""

import numpy as np


class Front:
    """Numbers nodes by their places in `front`, the case's ids of the nodes in front, which ascend."""

    front: np.ndarray

    def ids(self, nodes: np.ndarray) -> np.ndarray:
        """Returns the 2-D mesh's ids of those of `nodes` that are in the front, in their order."""
        at = np.minimum(np.searchsorted(self.front, nodes), len(self.front) - 1)
        return at[self.front[at] == nodes]

    def edges(self, faces: np.ndarray) -> np.ndarray:
        """Returns the edges (k, 2) of the front in which faces (k, c) that join the two planes end."""
        return self.ids(faces).reshape(-1, 2)
