"""The parser of one command: sections of flags, errors in one line, and a short page of help."""

import argparse
import difflib
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with the arguments, and what was perhaps meant.

    A short page of help leaves out all flags that are not for every day. `flags` are the long flags of this command.
    """

    def __init__(self, *, is_short: bool = False, **settings: Any):
        super().__init__(**settings, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
        self.is_short, self.flags = is_short, ["--help"]

    def section(self, title: str | None = None) -> Callable[..., argparse.Action]:
        """Begins a section of the page of help; returns the function that adds a flag or argument to it."""
        group = self if title is None else self.add_argument_group(title)

        def add(*names: str, everyday: bool = False, **settings: Any) -> argparse.Action:
            self.flags += [name for name in names if name.startswith("--")]
            if self.is_short and not everyday:
                settings["help"] = argparse.SUPPRESS
            return group.add_argument(*names, **settings)

        return add

    def check_flags(self, words: Sequence[str]) -> None:
        """Ends with status 2 for a flag that this command does not have."""
        for word in words:
            flag = word.partition("=")[0]
            if word == "--":
                return
            if flag.startswith("--") and flag not in self.flags:
                self.error(f"there is no flag {flag}{meant(flag, self.flags)}")

    def error(self, message: str):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def meant(word: str, known: Iterable[str]) -> str:
    """Writes `; did you mean ...?`, or nothing if no known word is similar."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def quoted(words: Sequence[str]) -> list[str]:
    """Puts a space before negative numbers: argparse takes -1e-3 for a flag."""
    return [f" {word}" if re.match(r"-\.?\d", word) else word for word in words]
