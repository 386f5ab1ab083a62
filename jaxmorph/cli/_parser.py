"""Flags as fields of dataclasses, and the parser that is built from them."""

import argparse
import dataclasses
import functools
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NewType, TypeVar

from jaxmorph._host.package.text import similar

T = TypeVar("T")
Angle = NewType("Angle", float)

Fields = type[Any]
"""A dataclass whose fields are made by `flag`, `positional`, `switch`, `part` and `several`."""

SETTINGS: dict[Any, dict[str, Any]] = {
    Path: {"type": Path, "metavar": "FILE"},
    int: {"type": int, "metavar": "N"},
    float: {"type": float, "metavar": "X"},
    Angle: {"type": float, "metavar": "DEG"},
    list[float]: {"type": float, "metavar": ("X Y", "Z"), "nargs": "+"},
    tuple[float, ...]: {"type": float, "nargs": "+"},
    tuple[Path, ...]: {"type": Path, "metavar": "FILE", "nargs": "+"},
}
"""Settings of argparse by the type of a field, which may also be None."""


def flag(
    what: str, *names: str, default: Any = None, section: str = "", everyday: bool = False, **settings: Any
) -> Any:
    """Makes a field of a flag that `what` describes.

    - `names`: the flag's names. Default: the field's name.
    - `default`: its value where the flag is absent; `()` for a flag of several values.
    - `section`: the title above it on the page of help. Default: `SECTION` of its dataclass.
    - `everyday`: True for a flag of the short page of help.
    - `settings`: further settings of argparse.
    """
    settings = {"default": list(default) if default == () else default, "help": what, **settings}
    facts = {"names": names, "settings": settings, "section": section, "everyday": everyday}
    return dataclasses.field(default=default, metadata=facts)


def positional(what: str, metavar: str, **settings: Any) -> Any:
    return flag(what, "", everyday=True, metavar=metavar, **settings)


def switch(what: str, *names: str, default: bool = False, **settings: Any) -> Any:
    return flag(what, *names, default=default, action=f"store_{str(not default).lower()}", **settings)


def part(fields: Fields) -> Any:
    return dataclasses.field(default_factory=fields, metadata={"part": fields})


def several(fields: Fields) -> Any:
    return dataclasses.field(default=(), metadata={"several": fields})


def flags_of(fields: Fields) -> Iterator[tuple[dataclasses.Field, Fields]]:
    """Yields all fields that are flags, with their dataclass; fields of parts in their place."""
    for field in dataclasses.fields(fields):
        inner = field.metadata.get("part") or field.metadata.get("several")
        if inner:
            yield from flags_of(inner)
        elif field.metadata:
            yield field, fields


def settings_of(field: dataclasses.Field) -> dict[str, Any]:
    kind = next((kind for kind in SETTINGS if field.type in (kind, kind | None)), None)
    return SETTINGS.get(kind, {}) | field.metadata["settings"]


def is_switch(settings: dict[str, Any]) -> bool:
    return settings.get("nargs") == 0 or str(settings.get("action")).startswith(("store_", "help"))


def values_of(request: Any) -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(request):
        value = getattr(request, field.name)
        yield from values_of(value) if "part" in field.metadata else [(field.name, value)]


def made(fields: type[T], values: argparse.Namespace) -> T:
    arguments = {}
    for field in dataclasses.fields(fields):  # pyright: ignore[reportArgumentType]
        inner = field.metadata.get("part")
        value = made(inner, values) if inner else getattr(values, field.name, field.default)
        arguments[field.name] = tuple(value) if isinstance(value, list) else value
    return fields(**arguments)


class Parser(argparse.ArgumentParser):
    """Describes in one line what is wrong with the arguments, and guesses what was meant.

    A short page of help leaves out all flags that are not for every day. `flags` are the long flags
    of this command, `short` those of one letter.
    """

    def __init__(self, *, is_short: bool = False, **settings: Any):
        super().__init__(**settings, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
        self.is_short, self.flags, self.short = is_short, ["--help"], ["-h"]
        self.sections: dict[str, Any] = {"": self}

    def add(self, names: Sequence[str], settings: dict[str, Any], *, section: str = "", everyday: bool = True):
        self.flags += [name for name in names if name.startswith("--")]
        self.short += [name for name in names if re.match("-[^-]", name)]
        if not is_switch(settings):
            settings = settings | {"type": unquoted(settings.get("type", str))}
        if self.is_short and not everyday:
            settings = settings | {"help": argparse.SUPPRESS}
        if section not in self.sections:
            self.sections[section] = self.add_argument_group(section)
        plain = {name: value for name, value in settings.items() if name != "completer"}
        self.sections[section].add_argument(*names, **plain).completer = settings.get("completer")

    def add_fields(self, fields: Fields) -> None:
        for field, owner in flags_of(fields):
            facts, settings = field.metadata, getattr(owner, "SETTINGS", {}) | settings_of(field)
            names = [field.name]
            if facts["names"] != ("",):
                names, settings = facts["names"] or (flag_of(field.name),), settings | {"dest": field.name}
            section = facts["section"] or getattr(owner, "SECTION", "")
            self.add(names, settings, section=section, everyday=facts["everyday"])

    def check_flags(self, words: Sequence[str]) -> None:
        for word in itertools.takewhile(lambda word: word != "--", words):
            name = word.partition("=")[0]
            if name.startswith("--") and name not in self.flags:
                hint = meant(name, self.flags) or f"; a patch of this name is written with =, as in --moving={name}"
                self.error(f"there is no flag {name}{hint}")
            if f"-{name}" in self.flags and name not in self.flags:
                hint = f"did you mean -{name}? The patch {name} is written --moving={name}"
                self.error(f"there is no flag {name}; {hint}")

    def error(self, message: str):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def one_of(kind: str, words: Iterable[str]) -> Callable[[str], str]:
    known = tuple(words)

    def chosen(word: str) -> str:
        if word not in known:
            listed = f"({kind}s: {', '.join(known)})"
            raise argparse.ArgumentTypeError(f"there is no {kind} {word!r}{meant(word, known)} {listed}")
        return word

    return chosen


def flag_of(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def meant(word: str, known: Iterable[str]) -> str:
    near = similar(word, known)
    return f"; did you mean {near}?" if near else ""


def quoted(words: Sequence[str], short: Iterable[str]) -> list[str]:
    """Puts a space before words that argparse would take for flags: numbers, and names as `-wall`.

    `--moving=-wall` becomes two words, so that more names may follow. `short` are the command's
    flags of one letter; a value may follow one without a blank, but not `-h`.
    """
    flags = ("--", *({*short} - {"-h"}))
    done: list[str] = []
    for word in words:
        name, equals, value = word.partition("=")
        if name.startswith("--") and equals and value.startswith("-"):
            done += [name, f" {value}"]
        else:
            is_flag = word in ("-", "-h") or not word.startswith("-") or word.startswith(flags)
            done.append(word if is_flag else f" {word}")
    return done


def unquoted(kind: Callable[[str], Any]) -> Callable[[str], Any]:
    """Makes the type of a flag without the space of `quoted`."""

    @functools.wraps(kind, updated=())
    def converted(word: str) -> Any:
        return kind(word[1:] if word.startswith(" -") else word)

    return converted
