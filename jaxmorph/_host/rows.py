"""Ids in a list, and their rows in it: made once from the list, then asked."""

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from .cells.topology import Pair

SMALL_TABLE = 1 << 22
SPARSE = 10
"""A table of all numbers up to the largest id is made if it has so many rows, or so many an id."""


class Rows:
    """The rows of ids in a list `ids` (k,) of whole numbers; of equal ids the first row counts."""

    def __init__(self, ids: Any):
        self.ids = np.asarray(ids)

    def of(self, wanted: Any) -> ndarray:
        """Finds the row of each id, in an array of any shape; -1 for one that is not listed."""
        wanted = np.asarray(wanted, np.int64)
        if not len(self.ids):
            return np.full(wanted.shape, -1)
        near = np.clip(wanted, self._least, self._most)
        if self._table is None:
            rows = self._order[np.searchsorted(self.ids, near, sorter=self._order)]
        else:
            rows = self._table[near - self._least]
        return np.where(self.ids[rows] == wanted, rows, -1)

    def mask(self, wanted: Any) -> ndarray:
        """Marks the ids that are listed, in an array of any shape."""
        return self.of(wanted) >= 0

    def take(self, wanted: Any) -> ndarray:
        """Finds the rows (m,) of those ids that are listed."""
        rows = self.of(wanted)
        return rows[rows >= 0]

    def renumbered(self, tables: Mapping[Any, Any]) -> dict[Any, ndarray]:
        """Puts rows in the place of ids, -1 for others, in tables by name."""
        return {name: self.of(ids) for name, ids in tables.items()}

    @property
    def repeated(self) -> ndarray:
        """Rows, ascending, whose id stands in an earlier row too."""
        return np.setdiff1d(np.arange(len(self.ids)), first_of_equals(self.ids)[0])

    @functools.cached_property
    def _least(self) -> int:
        return int(self.ids.min())

    @functools.cached_property
    def _most(self) -> int:
        return int(self.ids.max())

    @functools.cached_property
    def _order(self) -> ndarray:
        return np.argsort(self.ids, kind="stable")

    @functools.cached_property
    def _table(self) -> ndarray | None:
        size = self._most - self._least + 1
        if size > max(SMALL_TABLE, SPARSE * len(self.ids)):
            return None
        table = np.zeros(size, np.int64)
        # written backwards: of equal ids the first row stays
        table[self.ids[::-1] - self._least] = np.arange(len(self.ids))[::-1]
        return table


def mark(count: int, *lists: Any) -> ndarray:
    """Marks the ids of the lists among `count` ids, in a mask (count,)."""
    marks = np.zeros(count, bool)
    for ids in lists:
        marks[np.asarray(ids)] = True
    return marks


def first_of_equals(values: ndarray) -> Pair:
    """Finds the first row of each distinct value (k,), or of each row of a table (k, c), sorted by
    value, and the place of every row's value among these.
    """
    _, first, place = np.unique(values, axis=0, return_index=True, return_inverse=True)
    return first, place.ravel()


def join_ids(lists: Iterable[Any]) -> ndarray:
    """Joins lists of ids, of any shape, to one list (k,), which is empty without any."""
    return np.concatenate([np.zeros(0, np.int64), *map(np.ravel, lists)])
