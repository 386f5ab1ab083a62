"""What is going on, for work that takes a while."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

PATIENCE = 2.0
"""Seconds after which a stage of the work is announced."""


class Progress:
    """Announces a stage that takes longer than `PATIENCE` on standard error, with the seconds it has taken so far.

    Nothing is said when standard error is not a terminal, and nothing stays of it when the stage is over.
    """

    def __init__(self, command: str):
        self.command = command

    @contextlib.contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        if not sys.stderr.isatty():
            yield
            return
        over = threading.Event()
        clock = threading.Thread(target=self._tell, args=(stage, over), daemon=True)
        clock.start()
        try:
            yield
        finally:
            over.set()
            clock.join()

    def _tell(self, stage: str, over: threading.Event) -> None:
        began, told = time.monotonic(), False
        while not over.wait(0.5 if told else PATIENCE):
            sys.stderr.write(f"\r\033[K{self.command}: {stage} ... {time.monotonic() - began:.0f} s")
            sys.stderr.flush()
            told = True
        if told:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()
