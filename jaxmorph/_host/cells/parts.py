"""Parts of a mesh that pairs of nodes connect."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def parts_of(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Numbers connected parts of nodes (count,); `first` (e,) and `second` (e,) are connected."""
    graph = coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
