"""The cores that this process may use, and background calls."""

import collections
import contextvars
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")

SWITCH = "JAXMORPH_CPUS"  # the environment variable that limits the cores to use
ROWS_OF_A_CORE = 1 << 16  # rows in a block of one core
AHEAD = 2  # pieces of work for each core in advance


def cores() -> int:
    """Counts the cores to use: what `JAXMORPH_CPUS` says, else all of the process' affinity mask.
    Raises `ValueError` where the variable is no whole number of 1 or more.
    """
    words = os.environ.get(SWITCH, "")
    if words:
        if not words.isdecimal() or int(words) < 1:
            raise ValueError(f"{SWITCH} must be a number of cores, 1 or more, found {words!r}.")
        return int(words)
    if hasattr(os, "sched_getaffinity"):  # batch systems grant a few of many
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def beside(function: Callable[..., T], *arguments: Any) -> Future[T]:
    """Begins a call in a thread; with one core makes it at once. Errors are raised by `result`."""
    context = contextvars.copy_context()

    def call() -> T:
        return context.run(function, *arguments)

    if cores() > 1:
        pool = ThreadPoolExecutor(1)
        begun = pool.submit(call)
        pool.shutdown(wait=False)
        return begun
    future: Future[T] = Future()
    try:
        future.set_result(call())
    except Exception as error:
        future.set_exception(error)
    return future


def in_order(function: Callable[[Any], T], pieces: Iterable[Any]) -> Iterator[T]:
    """Yields `function` of each piece of work, in order, while all cores compute ahead. NumPy and
    SciPy release Python's lock for all that takes long, but `ufunc.at` and `unique`.
    """
    pieces = list(pieces)
    number = min(cores(), len(pieces))
    if number <= 1:
        yield from map(function, pieces)
        return
    # Few pieces are ahead of what is asked for, so that memory is that of a few results.
    with ThreadPoolExecutor(number) as pool:
        ahead: collections.deque[Future[T]] = collections.deque()
        for piece in pieces:
            ahead.append(pool.submit(contextvars.copy_context().run, function, piece))
            if len(ahead) > AHEAD * number:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


def over_blocks(function: Callable[[slice], Any], count: int) -> None:
    """Calls `function` with slices of `count` rows, whatever the number of cores, on all cores."""
    for _ in in_order(
        function,
        (
            slice(start, min(start + ROWS_OF_A_CORE, count))
            for start in range(0, count, ROWS_OF_A_CORE)
        ),
    ):
        pass
