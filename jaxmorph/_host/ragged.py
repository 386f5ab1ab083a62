"""Rows of different lengths in one array: faces of many corners, cells of many faces."""

import dataclasses
from typing import Any

import numpy as np
from numpy import ndarray

from .cells.topology import Pair


@dataclasses.dataclass(frozen=True, eq=False)
class Ragged:
    """Rows of different lengths: all `values` in a row, and where each row begins, and the end.

    - `values` (m, ...), `starts` (k + 1,).
    """

    values: ndarray
    starts: ndarray

    @classmethod
    def of(cls, values: ndarray, sizes: Any) -> "Ragged":
        """Cuts values into rows of some `sizes` (k,)."""
        return cls(values, np.append(0, np.cumsum(sizes)))

    @classmethod
    def counted(cls, numbers: ndarray, more: int = 0) -> "Ragged":
        """Reads rows behind their counts, each with so many `more` numbers than it counts.

        The last row may be cut short; a negative count is 0.
        """
        heads = heads_of(numbers, lambda count: 1 + max(count, 0) + more)
        sizes = np.maximum(numbers[heads], 0) + more
        return cls.of(np.delete(numbers, heads), sizes)

    def __len__(self) -> int:
        return len(self.starts) - 1

    @property
    def sizes(self) -> ndarray:
        return np.diff(self.starts)

    @property
    def row(self) -> ndarray:
        """The row (m,) of each value."""
        return np.repeat(np.arange(len(self)), self.sizes)

    def take(self, rows: ndarray) -> "Ragged":
        """Selects rows, in the order given."""
        places, _ = spread(self.starts[rows], self.starts[rows + 1])
        return Ragged.of(self.values[places], self.sizes[rows])

    def table(self, rows: ndarray, size: int) -> ndarray:
        """Gathers rows of one size, (..., size)."""
        return self.values[self.starts[rows][..., None] + np.arange(size)]

    @property
    def column(self) -> ndarray:
        """The place (m,) of each value in its row."""
        return np.arange(len(self.values)) - self.starts[self.row]

    def padded(self, fill: Any, width: int = 0) -> ndarray:
        """Lays rows into a table (k, width or more), with `fill` behind the last value of each."""
        size = max(width, self.sizes.max(initial=0))
        table = np.full((len(self), size), fill, self.values.dtype)
        table[self.row, self.column] = self.values
        return table

    def turned(self, chosen: ndarray) -> "Ragged":
        """Reverses the rows that are `chosen` (k,), a mask."""
        places = np.arange(len(self.values))
        back = (self.starts[:-1] + self.starts[1:] - 1)[self.row] - places
        return Ragged(self.values[np.where(chosen[self.row], back, places)], self.starts)


def heads_of(numbers: ndarray, step: Any) -> ndarray:
    """Finds where records begin in a stream: the first number of each tells its length to `step`.

    The last record may be cut short. Raises what `step` raises for a number.
    """
    words = np.ascontiguousarray(numbers).data
    heads = []
    at = 0
    while at < len(words):
        heads.append(at)
        at += step(words[at])
    return np.array(heads, np.int64)


def spread(first: ndarray, last: ndarray) -> Pair:
    """Lists the whole numbers of many ranges in a row, and the range of each."""
    # A count through all ranges is shifted in each: by the range's first number, less the numbers
    # of the ranges before it.
    counts = last - first
    ends = np.cumsum(counts)
    which = np.repeat(np.arange(len(counts)), counts)
    return np.arange(counts.sum()) + (first - ends + counts)[which], which
