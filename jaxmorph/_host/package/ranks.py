"""Work that the processes of a run share; a single process does it alone. It takes mpi4py's ranks."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

T = TypeVar("T")


@runtime_checkable
class Ranks(Protocol):
    """The used part of a communicator: a process is number `rank` of `size`."""

    @property
    def rank(self) -> int: ...

    @property
    def size(self) -> int: ...

    def allgather(self, value: Any) -> list[Any]: ...

    def alltoall(self, values: list[Any]) -> list[Any]: ...

    def bcast(self, value: Any) -> Any: ...

    def gather(self, value: Any) -> list[Any] | None: ...


class Alone:
    """One process, as a communicator."""

    rank, size = 0, 1

    def allgather(self, value: Any) -> list[Any]:
        return [value]

    def alltoall(self, values: list[Any]) -> list[Any]:
        return values

    def bcast(self, value: Any) -> Any:
        return value

    def gather(self, value: Any) -> list[Any]:
        return [value]


def together(ranks: Ranks, function: Callable[[], T]) -> T:
    """Calls a function in every process. If one process raises, all raise: no process waits forever."""
    result, error = None, None
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
    """Gives a node that several parts share one row of values in all of them: the first that came.

    Each id has a process that keeps its row, so that no process has those of all.
    """

    def __init__(self, ranks: Ranks):
        self.ranks = ranks
        self.ids, self.values = np.zeros(0, np.int64), np.zeros((0, 0))

    def __call__(self, ids: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Returns the shared values (k, d) of ids (k,). All processes call it, also without nodes."""
        keeper = ids % self.ranks.size
        rows = [np.flatnonzero(keeper == rank) for rank in range(self.ranks.size)]
        asked = self.ranks.alltoall([(ids[each], values[each]) for each in rows])
        for names, places in asked:
            self._keep(names, places)
        answers = self.ranks.alltoall([self.values[np.searchsorted(self.ids, names)] for names, _ in asked])
        agreed = values.copy()
        for each, answer in zip(rows, answers, strict=True):
            if len(each):
                agreed[each] = answer
        return agreed

    def _keep(self, ids: np.ndarray, values: np.ndarray) -> None:
        """Adds the ids that are new, with their values."""
        new = np.flatnonzero(~np.isin(ids, self.ids))
        if len(new):
            order = np.argsort(np.concatenate([self.ids, ids[new]]), kind="stable")
            self.values = np.concatenate([self.values.reshape(-1, values.shape[1]), values[new]])[order]
            self.ids = np.concatenate([self.ids, ids[new]])[order]
