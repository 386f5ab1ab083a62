"""Searches for the nearest points, with all cores. `cores.py` comes before SciPy."""

from typing import Any

from scipy.spatial import KDTree

from .cores import cores

FEW = 4096
"""Points of a search up to which threads cost more than they gain."""


class Tree(KDTree):
    """A k-d tree that is searched with all cores. The answers do not depend on their number."""

    def query(self, x: Any, *arguments: Any, **keywords: Any) -> tuple[Any, Any]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Finds the nearest points of the tree, as `scipy.spatial.KDTree.query` does."""
        return super().query(x, *arguments, **{"workers": cores() if len(x) > FEW else 1} | keywords)
