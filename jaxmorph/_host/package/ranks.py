"""Work shared by the processes of a run, by a communicator such as mpi4py's."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy import ndarray

from ..rows import Rows

T = TypeVar("T")


@runtime_checkable
class Ranks(Protocol):
    """A communicator, as far as it is used here: a process is number `rank` of `size`."""

    @property
    def rank(self) -> int: ...

    @property
    def size(self) -> int: ...

    def allgather(self, value: Any) -> list[Any]: ...

    def alltoall(self, values: list[Any]) -> list[Any]: ...

    def bcast(self, value: Any) -> Any: ...

    def gather(self, value: Any) -> list[Any] | None: ...


class Alone:
    """The communicator of one process, for code that also runs under MPI."""

    rank = 0
    size = 1

    def allgather(self, value: Any) -> list[Any]:
        return [value]

    def alltoall(self, values: list[Any]) -> list[Any]:
        return values

    def bcast(self, value: Any) -> Any:
        return value

    def gather(self, value: Any) -> list[Any]:
        return [value]


def together(ranks: Ranks, function: Callable[[], T]) -> T:
    """Calls a function in every process of a communicator, `Alone` or mpi4py's.

    An error of one process is raised in all, so that none waits: its own where it occurred, and a
    `ValueError` that names the process in the others.
    """
    result = None
    error = None
    try:
        result = function()
    except Exception as raised:
        error = raised
    messages = ranks.allgather(None if error is None else str(error))
    if error is not None:
        raise error
    failed = [rank for rank, message in enumerate(messages) if message is not None]
    if failed:
        raise ValueError(f"process {failed[0]}: {messages[failed[0]]}")
    return result  # pyright: ignore[reportReturnType]


class Agreement:
    """Makes the values of a node that several parts share equal: the first values count. One
    process keeps the values of an id, and no process keeps the values of all ids.
    """

    def __init__(self, ranks: Ranks):
        self.ranks = ranks
        self.ids = np.zeros(0, np.int64)
        self.values = np.zeros((0, 0))

    def __call__(self, ids: ndarray, values: ndarray) -> ndarray:
        """Returns common values (k, d) of ids (k,); all processes call it, also without nodes."""
        # The keeper of an id is the process `id % size`. Every process sends ids and values to
        # their keepers, which add new ids and answer with their values.
        rows = [np.flatnonzero(ids % self.ranks.size == rank) for rank in range(self.ranks.size)]
        received = self.ranks.alltoall([(ids[row], values[row]) for row in rows])
        ids_sent, values_sent = zip(
            (self.ids, self.values.reshape(-1, values.shape[1])), *received, strict=True
        )
        self.ids, first = np.unique(np.concatenate(ids_sent), return_index=True)
        self.values = np.concatenate(values_sent)[first]
        known = Rows(self.ids)
        answers = self.ranks.alltoall([self.values[known.of(names)] for names, _ in received])
        common = values.copy()
        for row, answer in zip(rows, answers, strict=True):
            common[row] = answer
        return common
