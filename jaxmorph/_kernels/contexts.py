"""Values that hold within a block of code, in its thread alone."""

import contextlib
import contextvars
from collections.abc import Iterator
from typing import TypeVar

T = TypeVar("T")


@contextlib.contextmanager
def holding(variable: contextvars.ContextVar[T], value: T) -> Iterator[None]:
    """Gives a context variable a value within a block, and the old value back at its end."""
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)
