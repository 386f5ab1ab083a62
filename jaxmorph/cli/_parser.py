"""Flags as fields of dataclasses, and the parser that is built from them."""

import argparse
import dataclasses
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NewType, TypeVar, get_args

from jaxmorph._host.package.text import similar

T = TypeVar("T")
Angle = NewType("Angle", float)
MeshFile = NewType("MeshFile", Path)
NewMesh = NewType("NewMesh", Path)
Written = NewType("Written", Path)
Picture = NewType("Picture", Path)
Folder = NewType("Folder", Path)
ConfigFile = NewType("ConfigFile", Path)
"""Kinds of values: a `Path` or a `MeshFile` is read, the other files and folders are written, and a
`ConfigFile` is one or the other, by its command's action.
"""

FILES = (Path, MeshFile, NewMesh, Written, Picture, Folder, ConfigFile)

Settings = dict[str, Any]
"""Settings of a flag, as argparse takes them."""

Fields = type[Any]
"""A dataclass whose fields are made by `flag`, `positional`, `switch` and `nest`."""

MOTION = "motion of the patches of the last --moving (at least one flag)"
BAD = "when cells are bad"
SECTIONS = (
    "",
    "surface",
    MOTION,
    "shapes",
    "design variables",
    "method",
    "quality gates",
    BAD,
    "output",
)
"""Titles of flags on a page of help, in their order."""


def number(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError
    return value


def positive(word: str) -> int:
    if not word.isdecimal() or int(word) < 1:
        raise argparse.ArgumentTypeError(f"a whole number of 1 or more expected, found {word!r}")
    return int(word)


SETTINGS: dict[Any, Settings] = {
    **{kind: {"type": Path, "metavar": "FILE"} for kind in FILES},
    int: {"type": positive, "metavar": "N"},
    float: {"type": number, "metavar": "X"},
    Angle: {"type": number, "metavar": "DEG"},
    list[float]: {"type": number, "metavar": ("X Y", "Z"), "nargs": "+"},
    tuple[float, ...]: {"type": number, "nargs": "+"},
    tuple[Path, ...]: {"type": Path, "metavar": "FILE", "nargs": "+"},
}
"""Settings of argparse by the type of a field, which may also be None."""


def flag(
    what: str,
    *names: str,
    default: Any = None,
    section: str = "",
    everyday: bool = False,
    **settings: Any,
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
    return flag(
        what, *names, default=default, action=f"store_{str(not default).lower()}", **settings
    )


def nest(fields: Fields) -> Any:
    return dataclasses.field(default_factory=fields, metadata={"fields": fields})


def flags_of(fields: Fields) -> Iterator[tuple[dataclasses.Field, Fields]]:
    """Yields all fields that are flags, with their dataclass; fields of parts in their place."""
    for field in dataclasses.fields(fields):
        if "fields" in field.metadata:
            yield from flags_of(field.metadata["fields"])
        elif field.metadata:
            yield field, fields


def values_of(request: Any) -> Iterator[tuple[dataclasses.Field, Any]]:
    """Yields all fields that are flags, with their values; those of parts in their place."""
    for field in dataclasses.fields(request):
        value = getattr(request, field.name)
        if "fields" in field.metadata:
            yield from itertools.chain(
                *map(values_of, value if isinstance(value, tuple) else [value])
            )
        elif field.metadata:
            yield field, value


def settings_of(field: dataclasses.Field) -> Settings:
    kind = next((kind for kind in SETTINGS if field.type in (kind, kind | None)), None)
    return SETTINGS.get(kind, {}) | field.metadata["settings"]


def kind_of(field: dataclasses.Field) -> Any:
    """Finds which of `FILES` a flag names, or None."""
    return next((kind for kind in FILES if kind in (field.type, *get_args(field.type))), None)


def is_switch(settings: Settings) -> bool:
    return str(settings.get("action")).startswith("store_")


def build_request(fields: type[T], values: argparse.Namespace) -> T:
    arguments = {}
    for field in dataclasses.fields(fields):  # pyright: ignore[reportArgumentType]
        is_part = field.default is dataclasses.MISSING and "fields" in field.metadata
        value = (
            build_request(field.metadata["fields"], values)
            if is_part
            else getattr(values, field.name, field.default)
        )
        arguments[field.name] = tuple(value) if isinstance(value, list) else value
    return fields(**arguments)


class Parser(argparse.ArgumentParser):
    """Describes in one line what is wrong with the arguments, and guesses what was meant.

    A short page of help leaves out all flags that are not for every day.
    """

    def __init__(self, *, is_short: bool = False, **settings: Any):
        super().__init__(
            **settings, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
        )
        self.is_short = is_short
        self._negative_number_matcher = re.compile(
            r"-\.?\d"
        )  # as of Python 3.14: numbers such as -1e-3 are no flags

    @property
    def flags(self) -> list[str]:
        return [name for name in self._option_string_actions if name.startswith("--")]

    def add_fields(self, fields: Fields) -> None:
        sections = {
            field: field.metadata["section"] or getattr(owner, "SECTION", "")
            for field, owner in flags_of(fields)
        }
        groups: dict[str, Any] = {"": self}
        for field, owner in sorted(
            flags_of(fields), key=lambda flag: SECTIONS.index(sections[flag[0]])
        ):
            facts = field.metadata
            settings = getattr(owner, "SETTINGS", {}) | settings_of(field)
            names = [field.name]
            if facts["names"] != ("",):
                names = facts["names"] or (flag_of(field.name),)
                settings = settings | {"dest": field.name}
            if self.is_short and not facts["everyday"]:
                settings["help"] = argparse.SUPPRESS
            if sections[field] not in groups:
                groups[sections[field]] = self.add_argument_group(sections[field])
            completer = settings.pop("completer", None)
            groups[sections[field]].add_argument(*names, **settings).completer = completer

    def check_flags(self, words: Sequence[str]) -> None:
        of_flags = itertools.takewhile(lambda word: word != "--", words)
        for before, word in itertools.pairwise(("", *of_flags)):
            name = word.partition("=")[0]
            if name.startswith("--") and name not in self.flags:
                flags = [flag.lstrip("-") for flag in self.flags]
                hint = guess_meant(name.lstrip("-"), flags, "--")
                if not hint and before.startswith("--"):
                    hint = f"; a patch of this name is written with =, as in --moving={name}"
                self.error(f"there is no flag {name}{hint}")
            if f"-{name}" in self.flags:
                hint = f"did you mean -{name}? The patch {name} is written --moving={name}"
                self.error(f"there is no flag {name}; {hint}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            hint = guess_meant(str(value), known) or f"; there are {', '.join(known)}"
            raise argparse.ArgumentError(action, f"there is no {value}{hint}")

    def error(self, message: str):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def flag_of(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def guess_meant(word: str, known: Iterable[str], dashes: str = "") -> str:
    near = similar(word, known)
    return f"; did you mean {dashes}{near}?" if near else ""
