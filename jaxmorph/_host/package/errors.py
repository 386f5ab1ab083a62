"""The error that names nodes, and warnings that name the caller's line."""

import sys
import warnings
from collections.abc import Sequence

import numpy as np


class MeshError(ValueError):
    """Refuses a mesh, and names the nodes that are at fault. It is a `ValueError`.

    **Arguments:**

    - `message`: the text. `{node}` in it stands where the worst node's id belongs; `str` puts the id there.
    - `nodes`: ids of the nodes at fault, the worst first.
    """

    def __init__(self, message: str, nodes: Sequence[int] | np.ndarray):
        super().__init__(message, nodes)
        self.message, self.nodes = message, np.asarray(nodes, dtype=np.int64)

    def __str__(self) -> str:
        return self.message.replace("{node}", str(self.nodes[0]))

    def renumbered(self, ids: np.ndarray) -> "MeshError":
        """Renumbers the error's nodes for a larger mesh, in which node k is node `ids[k]`."""
        return MeshError(self.message, np.asarray(ids)[self.nodes])


INNER = {"jaxmorph", "jax", "equinox", "jaxtyping", "beartype", "contextlib", "functools"}
"""Packages skipped when looking for the user's own line."""


def warn(message: str) -> None:
    """Warns about the line of the user's script that called the library, however deep the call is."""
    level, frame = 1, sys._getframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in INNER:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, stacklevel=level)


def place_of(point: np.ndarray) -> str:
    """Writes coordinates (d,) for a message, without brackets."""
    return ", ".join(f"{x:.6g}" for x in point)
