"""Progress on the terminal, for work that takes a while."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

PATIENCE = 2.0
"""Seconds after which a stage of the work is announced."""


class Stage:
    """One stage of the work, and how much of it is done."""

    def __init__(self, name: str):
        self.name = name
        self.began, self.share = time.monotonic(), 0.0

    def done(self, share: float) -> None:
        """Tells how much of the stage is done, of 1."""
        self.share = share

    def __str__(self) -> str:
        passed = time.monotonic() - self.began
        text = f"{self.name} ... {passed:.0f} s"
        if self.share > 0:
            return f"{text}, {self.share:.0%}, {passed / self.share - passed:.0f} s left"
        return text


class Progress:
    """Announces a stage that takes longer than `PATIENCE` on standard error: the seconds passed, and those left where known.

    Nothing is said when standard error is not a terminal, and nothing stays of it when the stage is over. `seconds` holds
    how long each stage took.
    """

    def __init__(self, command: str):
        self.command = command
        self.seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[Stage]:
        stage, over = Stage(name), threading.Event()
        clock = threading.Thread(target=self._tell, args=(stage, over), daemon=True)
        is_heard = sys.stderr.isatty()
        if is_heard:
            clock.start()
        try:
            yield stage
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - stage.began
            over.set()
            if is_heard:
                clock.join()

    def _tell(self, stage: Stage, over: threading.Event) -> None:
        told = False
        while not over.wait(0.5 if told else PATIENCE):
            sys.stderr.write(f"\r\033[K{self.command}: {stage}")
            sys.stderr.flush()
            told = True
        if told:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()
