"""The error that names nodes."""

from collections.abc import Sequence

import numpy as np


class MeshError(ValueError):
    """Refuses a mesh, and names the nodes that are at fault.

    `message` has `{node}` where the worst node's id belongs; `nodes` are ids, the worst first. `str` puts the two together.
    """

    def __init__(self, message: str, nodes: Sequence[int] | np.ndarray):
        super().__init__(message, nodes)
        self.message, self.nodes = message, np.asarray(nodes, dtype=np.int64)

    def __str__(self) -> str:
        return self.message.replace("{node}", str(self.nodes[0]))

    def renumbered(self, ids: np.ndarray) -> "MeshError":
        """The same error about a larger mesh, in which node k is node `ids[k]`."""
        return MeshError(self.message, np.asarray(ids)[self.nodes])
