"""Writing beside judging: the file is there, under another name, when the verdict comes."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from jaxmorph._host.package.cores import Beside, cores
from jaxmorph._host.package.files import appearing_if


class Writing:
    """A call that writes a file beside what comes next; `finish` lets the file appear.

    With one core all is written by `finish`. A block that ends without it leaves no file.
    """

    def __init__(self, write: Callable[..., None], *arguments: Any):
        self._is_wanted: Future[bool] = Future()
        with appearing_if(self._is_wanted.result):
            self._call = Beside(write, *arguments)

    def finish(self) -> None:
        """Waits for the file, which appears. Raises what the call raises."""
        self._is_wanted.set_result(True)
        self._call.result()

    def __enter__(self) -> "Writing":
        return self

    def __exit__(self, *error: Any) -> None:
        if not self._is_wanted.done():
            self._is_wanted.set_result(False)
        if cores() > 1:
            with contextlib.suppress(Exception):  # a fault of a file that nobody wants, or that `finish` has told
                self._call.result()
