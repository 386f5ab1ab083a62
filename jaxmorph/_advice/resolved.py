"""Checks whether a field's sources resolve a displacement of the wall, and finds how many would."""

import numpy as np

from .._host.package.rounding import roundoff
from .._host.sources.reduction import KDTree
from .._host.sources.separation import drop_close

UNRESOLVED = 1 / 3
"""Share of the largest displacement that sources may miss between them."""

LEAVES = (64, 128, 256, 512, 1024, 2048)
"""Numbers of leaves of a k-d tree that are tried."""


def missed(points: np.ndarray, u: np.ndarray, sources: np.ndarray) -> float:
    """Measures what an interpolation from `sources` misses of `u` (m, d) at `points` (m, d).

    It is relative to the largest displacement, and zero without one. The interpolation is that of
    SciPy by distances.
    """
    from scipy.interpolate import RBFInterpolator  # takes a tenth of a second to import

    largest = np.linalg.norm(u, axis=1).max(initial=0)
    rows = drop_close(points, sources, roundoff(points))
    if largest == 0 or not len(rows):
        return 0.0
    field = RBFInterpolator(points[rows], u[rows], kernel="linear", degree=0)(points)
    return float(np.linalg.norm(field - u, axis=1).max() / largest)


def leaves_enough(points: np.ndarray, u: np.ndarray) -> int | None:
    """Finds the least of `LEAVES` whose sources miss less than a third of `u`, or None."""
    for leaves in LEAVES:
        sources = KDTree(leaves, extremes=True)(points)
        if missed(points, u, sources) <= UNRESOLVED:
            return leaves
        if len(sources) == len(points):
            break
    return None
