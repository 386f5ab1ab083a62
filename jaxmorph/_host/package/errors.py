"""An error that names nodes, and warnings that name the caller's line."""

import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray


class MeshError(ValueError):
    """A `ValueError` about a mesh with the ids of the nodes at fault, the worst first. `str`
    replaces `{node}` in its `message` by the worst.
    """

    def __init__(self, message: str, nodes: Sequence[int] | ndarray):
        super().__init__(message, nodes)
        self.message = message
        self.nodes = np.asarray(nodes, dtype=np.int64)

    def __str__(self) -> str:
        return self.message.replace("{node}", str(self.nodes[0]))

    def renumbered(self, ids: ndarray) -> "MeshError":
        """Renumbers the nodes for a larger mesh: node k becomes `ids[k]`."""
        return MeshError(self.message, np.asarray(ids)[self.nodes])


INNER = {"jaxmorph", "jax", "equinox", "jaxtyping", "beartype", "contextlib", "functools"}
"""Packages skipped when looking for the user's own line."""


def warn(message: str) -> None:
    """Warns with the line of the user's own code, outside of this package and of JAX."""
    level = 1
    frame = sys._getframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in INNER:
        level = level + 1
        frame = frame.f_back
    warnings.warn(message, stacklevel=level)


def worst_first(off: ndarray, allowed: Any) -> ndarray:
    """Rows where `off` (k,) exceeds the `allowed`, the largest first."""
    wrong = np.flatnonzero(off > allowed)
    return wrong[np.argsort(-off[wrong], kind="stable")]


def check_none(wrong: ndarray, message: str, points: ndarray | None = None) -> None:
    """Raises a `MeshError` if there are `wrong` nodes, the worst first: `{count}` of them, of which
    the worst is `{node}` at `{place}`.
    """
    if len(wrong):
        place = "" if points is None else place_of(points[wrong[0]])
        raise MeshError(
            message.replace("{count}", str(len(wrong))).replace("{place}", place), wrong
        )


def place_of(point: ndarray) -> str:
    return ", ".join(f"{x:.6g}" for x in point)


def check_all_finite(points: ndarray) -> None:
    """Raises `MeshError` for points (n, d) that are not finite, with the first one."""
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    check_none(wrong, f"{{count}} of {len(points)} points are not finite, first node {{node}}.")
