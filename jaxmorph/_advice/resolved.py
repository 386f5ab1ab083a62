"""Checks whether a field's sources resolve a displacement of the wall, and finds how many would."""

import numpy as np
from scipy.spatial.distance import cdist

from .._host.package.rounding import roundoff
from .._host.sources.reduction import KDTree, drop_close

UNRESOLVED = 1 / 3
"""Share of the largest displacement that sources may miss between them."""

ROWS = 4096
"""Points whose distances from all sources are in memory together."""

LEAVES = (64, 128, 256, 512, 1024, 2048)
"""Numbers of leaves of a k-d tree that are tried."""


def missed(points: np.ndarray, u: np.ndarray, sources: np.ndarray) -> float:
    """Measures what an interpolation from `sources` misses of `u` (m, d) at `points` (m, d).

    It is relative to the largest displacement, and zero without one. The interpolation is that by
    distances, and a constant; SciPy's `RBFInterpolator` takes a tenth of a second to import.
    """
    largest = np.linalg.norm(u, axis=1).max(initial=0)
    rows = drop_close(points, sources, roundoff(points))
    if largest == 0 or not len(rows):
        return 0.0
    system = np.pad(-cdist(points[rows], points[rows]), (0, 1), constant_values=1.0)
    system[-1, -1] = 0
    weights = np.linalg.solve(system, np.pad(u[rows], ((0, 1), (0, 0))))
    off = [
        u[part] - weights[-1] + cdist(points[part], points[rows]) @ weights[:-1]
        for part in (slice(start, start + ROWS) for start in range(0, len(points), ROWS))
    ]
    return float(np.linalg.norm(np.concatenate(off), axis=1).max() / largest)


def leaves_enough(points: np.ndarray, u: np.ndarray) -> int | None:
    """Finds the least of `LEAVES` whose sources miss less than a third of `u`, or None."""
    for leaves in LEAVES:
        sources = KDTree(leaves, extremes=True)(points)
        if missed(points, u, sources) <= UNRESOLVED:
            return leaves
        if len(sources) == len(points):
            break
    return None
