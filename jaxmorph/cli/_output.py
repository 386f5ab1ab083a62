"""Output of a command: text or one JSON object, warnings, progress, timings."""

import contextlib
import json
import os
import sys
import textwrap
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

ANNOUNCED_AFTER = 2.0
"""Seconds after which a stage is announced."""


class Stage:
    """One stage of the work, and the share of it that is done, from 0 to 1."""

    def __init__(self, name: str):
        self.name = name
        self.began = time.monotonic()
        self.share = 0.0

    def done(self, share: float) -> None:
        self.share = share

    def over(self, entries: Sequence[T]) -> Iterator[T]:
        for k, entry in enumerate(entries, start=1):
            yield entry
            self.done(k / len(entries))

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began

    def __str__(self) -> str:
        passed = self.seconds
        left = ""
        if self.share > 0:
            left = f", {self.share:.0%}, {passed / self.share - passed:.0f} s left"
        return f"{self.name} ... {passed:.0f} s{left}"

    def announce(self, command: str, over: threading.Event) -> None:
        """Shows the stage on a terminal's line after `ANNOUNCED_AFTER`; the line vanishes."""
        has_line = False
        while not over.wait(0.5 if has_line else ANNOUNCED_AFTER):
            has_line = True
            print(f"\r\033[K{command}: {self}", end="", file=sys.stderr, flush=True)
        if has_line:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


class Output:
    """Output of one command: text as it comes, or with `as_json` facts, printed at the end."""

    def __init__(self, command: str, *, as_json: bool = False):
        self.name = f"jaxmorph {command}"
        self.as_json = as_json
        self.verbose = False
        self.is_silent = False
        """True in all processes of an MPI run but one, which prints for all."""
        self.facts: dict[str, Any] = {"command": command}
        self.stages: dict[str, float] = {}
        """Seconds that each stage took."""
        self.began = time.monotonic()

    @contextlib.contextmanager
    def progress(self, name: str) -> Iterator[Stage]:
        stage = Stage(name)
        over = threading.Event()
        clock = threading.Thread(target=stage.announce, args=(self.name, over), daemon=True)
        is_heard = sys.stderr is not None and sys.stderr.isatty()  # a service may have closed it
        if is_heard:
            clock.start()
        try:
            yield stage
        finally:
            self.stages[name] = self.stages.get(name, 0.0) + stage.seconds
            over.set()
            if is_heard:
                clock.join()

    def say(self, text: str | None = None, **facts: Any) -> None:
        self.facts.update(facts)
        if text is not None and not self.as_json and not self.is_silent:
            _print_line(text)

    def complain(self, text: str, key: str = "problems") -> None:
        self.facts.setdefault(key, []).append(text)
        if not self.is_silent:
            print(f"{self.name}: {text}", file=sys.stderr)

    def warn(self, text: str) -> None:
        if f"warning: {text}" not in self.facts.get("warnings", []):
            self.complain(f"warning: {text}", "warnings")

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.began

    def wrote(self, path: Path, was_there: bool = False) -> None:
        old = ", in place of an older file" if was_there else ""
        self.say(f"wrote {path} ({self.seconds:.1f} s){old}", output=str(path), replaced=was_there)

    def end(self, status: int) -> int:
        if self.is_silent:
            return status
        if self.as_json:
            timings = {name: round(taken, 3) for name, taken in self.stages.items()}
            facts = self.facts | {
                "status": status,
                "seconds": round(self.seconds, 3),
                "stages": timings,
            }
            plain = json.loads(
                json.dumps(facts), parse_constant=lambda _: None
            )  # JSON has no NaN, no infinity
            _print_line(json.dumps(plain, allow_nan=False))
        elif self.verbose:
            total = self.seconds
            rest = max(0.0, total - sum(self.stages.values()))
            stages = self.stages | {"between them": rest, "all": total}
            lines = [
                f"  {name:<{max(map(len, stages))}} {taken:>9.2f} s {taken / total:>6.1%}"
                for name, taken in stages.items()
            ]
            _print_line("\n".join(["timings", *lines]))
        return status


def _print_line(text: str) -> None:
    with open_ended():
        print(text, flush=True)


@contextlib.contextmanager
def open_ended() -> Iterator[None]:
    """Goes on where the reader of the output has enough, as `head` has: the rest goes nowhere."""
    try:
        yield
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def wrap(text: str, indent: int = 9) -> str:
    return textwrap.fill(
        text, 80, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    )


def plural(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def some(ids: Any) -> str:
    return ", ".join(map(str, ids[:5])) + (", ..." if len(ids) > 5 else "")


def format_place(x: Any) -> str:
    return "(" + ", ".join(f"{number:.3g}" for number in x.tolist()) + ")"


def title(path: Path) -> str:
    """Returns the name of a file or folder; that of the folder itself for `.` and `..`."""
    return Path(os.path.abspath(path)).name or str(path)  # not resolved: a link has its own name


LISTED = 20
"""Design variables on the terminal, at most."""


def steepest(slopes: Any) -> list[int]:
    """Sorts design variables by their derivative, the largest first, at most `LISTED`."""
    return sorted(range(len(slopes)), key=lambda k: -abs(slopes[k]))[:LISTED]
