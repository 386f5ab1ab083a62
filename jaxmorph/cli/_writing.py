"""Writing beside judging: the file is there, under another name, when the verdict comes."""

import contextlib
import threading
from collections.abc import Callable
from typing import Any

from jaxmorph._host.package.cores import Beside, cores
from jaxmorph._host.package.files import appearing_if


class Writing:
    """A call that writes a file beside what comes next; `finish` lets the file appear.

    With one core all is written by `finish`. A block that ends without it leaves no file.
    """

    def __init__(self, write: Callable[..., None], *arguments: Any):
        self._is_wanted, self._is_decided = False, threading.Event()
        with appearing_if(self._wait):
            self._call = Beside(write, *arguments)

    def finish(self) -> None:
        """Waits for the file, which appears. Raises what the call raises."""
        self._is_wanted = True
        self._is_decided.set()
        self._call.result()

    def drop(self) -> None:
        """Removes what has been written, and waits for it, unless the file is there already."""
        self._is_wanted = False
        self._is_decided.set()
        if cores() > 1:
            with contextlib.suppress(Exception):  # a fault of a file that nobody wants
                self._call.result()

    def _wait(self) -> bool:
        self._is_decided.wait()
        return self._is_wanted

    def __enter__(self) -> "Writing":
        return self

    def __exit__(self, *error: Any) -> None:
        self.drop()
