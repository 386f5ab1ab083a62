"""Orders of points, canonical and along Morton's curve, and rows of ids."""

import numpy as np

from .rounding import SAME, ranked

BETWEEN = 0.618
"""Place of the borders of Morton's cells, relative to their size: off structured grids."""


def canonical_order(points: np.ndarray) -> np.ndarray:
    """Sorts points by their coordinates, so that results do not depend on the order given."""
    slack = SAME * float(np.ptp(points, axis=0).max())
    return np.lexsort([ranked(column, slack) for column in points.T[::-1]])


def rows_in(ids: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Finds the row in `ids` (k,) of each of `wanted`, which are all among them."""
    order = np.argsort(ids, kind="stable")
    return order[np.searchsorted(ids[order], wanted)]


def morton_order(points: np.ndarray) -> np.ndarray:
    """Sorts points along Morton's curve, so that successive points are close to each other."""
    # A point has an integer coordinate on every axis. The key interleaves their bits: bit 0 of x, y
    # and z, then bit 1 of x, y and z. Points with equal upper bits lie in one box.
    dimension = points.shape[1]
    bits = 62 // dimension
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max() or 1.0
    key = np.zeros(len(points), dtype=np.uint64)
    for axis in range(dimension):
        grid = ((points[:, axis] - low[axis]) / extent * (2**bits - 2) + BETWEEN).astype(np.uint64)
        key |= _spread(grid, dimension) << np.uint64(axis)
    return np.argsort(key, kind="stable")


def _spread(grid: np.ndarray, dimension: int) -> np.ndarray:
    """Moves bit k of all numbers to place k times `dimension`, by halving blocks of bits."""
    for half in (16, 8, 4, 2, 1):
        bits = sum((2**half - 1) << place for place in range(0, 64, half * dimension)) % 2**64
        grid = (grid | grid << np.uint64(half * (dimension - 1))) & np.uint64(bits)
    return grid
