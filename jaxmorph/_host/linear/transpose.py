"""Tables of the transpose of a sparse operator with a few entries a row, which need no scatter."""

import numpy as np
from scipy.sparse import csr_array

WIDTH = 16
"""Entries in a row of the table."""


def tabulate(nodes: np.ndarray, used: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Sorts the entries of a sparse operator by column, into rows of `WIDTH` entries.

    **Arguments:**

    - `nodes`: columns (n, k) of the entries.
    - `used`: a mask of rows (n,), or of entries (n, k), that count.
    - `count`: number of columns.

    **Returns:** `entries` (r, WIDTH), positions in the flattened (n, k), -1 for padding; and
    `owner` (r,), the column of a row of the table, ascending.

    **Raises:** `ValueError` for more entries than 32 bits count.
    """
    # Used entries are sorted by column. A column of s entries fills ceil(s / WIDTH) rows of the
    # table; its last row is padded. The shift of an entry is the padding of all columns before its
    # own.
    k = nodes.shape[1]
    if len(nodes) * k >= 2**31:
        raise ValueError(f"{len(nodes)} points are too many for one device; lay the plan over several with `shard`.")
    entries = np.flatnonzero(np.broadcast_to(used.reshape(len(nodes), -1), nodes.shape)).astype(np.int32)
    columns = nodes.ravel()[entries]
    order = _stable_order(columns, count)
    entries = entries[order]
    sizes = np.bincount(columns, minlength=count)
    lengths = -(-sizes // WIDTH)
    owner = np.repeat(np.arange(count, dtype=np.int32), lengths)
    first_row, first_entry = np.cumsum(lengths) - lengths, np.cumsum(sizes) - sizes
    table = np.full(len(owner) * WIDTH, -1, dtype=np.int32)
    table[np.arange(len(order)) + np.repeat(WIDTH * first_row - first_entry, sizes)] = entries
    return table.reshape(-1, WIDTH), owner


def _stable_order(columns: np.ndarray, count: int) -> np.ndarray:
    """Sorts small integers stably by SciPy's counting sort, faster than `numpy.argsort`."""
    places = np.arange(len(columns), dtype=np.int32)
    row = csr_array((places, columns, np.array([0, len(columns)], dtype=np.int32)), shape=(1, count))
    return row.tocsc().data
