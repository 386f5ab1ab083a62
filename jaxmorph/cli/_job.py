"""Job files: the flags of `jaxmorph deform` as TOML."""

import argparse
import dataclasses
import os
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from jaxmorph._host.package.text import read, written

from ._parser import Fields, flags_of, made, meant, settings_of, values_of
from ._requests import BoundaryFlags, Deform, Group, Method, Sensitivity, Speech, table

NO_KEYS = ("job", "save_job", "set", *(field.name for field in dataclasses.fields(Speech)))
"""Flags that are not keys of a job; `set` is a table of it."""

TYPES = {int: (int,), float: (int, float), table: (str, dict)}
"""Types in TOML by the type of a flag; others are text, also the name of a patch such as 5."""

WORDS = {int: ("a whole number", "whole numbers"), float: ("a number", "numbers")}


@dataclasses.dataclass(frozen=True)
class Key:
    """A flag as a name in a job; a path is relative to the folder of the job."""

    name: str
    settings: Mapping[str, Any]
    is_path: bool

    @property
    def is_switch(self) -> bool:
        return str(self.settings.get("action")).startswith("store_")

    def from_toml(self, job: Path, value: Any) -> Any:
        """Makes the field's value. Raises `ValueError` for a value of another type."""
        if self.is_switch:
            if not isinstance(value, bool):
                raise ValueError(f"{job}: {self.name} is true or false, found {reprlib.repr(value)}.")
            return value
        kind, is_list = self.settings.get("type"), self.settings.get("nargs") == "+"
        values = value if isinstance(value, list) and is_list else [value]
        if not values or any(type(entry) not in TYPES.get(kind, (str, int)) for entry in values):
            one, several = WORDS.get(kind, ("text", "texts"))
            what = f"{one}, or a list of {several}" if is_list else one
            raise ValueError(f"{job}: {self.name} is {what}, found {reprlib.repr(value)}.")
        made = [self._one(job, entry) for entry in values]
        return made if is_list else made[0]

    def _one(self, job: Path, value: Any) -> Any:
        kind, choices = self.settings.get("type", str), self.settings.get("choices")
        if kind in (int, float) or isinstance(value, dict):
            return value if isinstance(value, dict) else kind(value)
        try:
            made = kind(str(job.parent / str(value) if self.is_path else value))
        except argparse.ArgumentTypeError as error:
            raise ValueError(f"{job}: {error}.") from None
        if choices and made not in choices:
            raise ValueError(f"{job}: {self.name} is one of {', '.join(choices)}, found {made!r}.")
        return made

    def in_toml(self, value: Any, folder: Path) -> Any:
        """Makes the paths of a value relative to a folder, unless they are absolute."""
        if self.name == "mode":
            return [(_relative(file, folder), amplitude) for file, amplitude in value]
        return _relative(value, folder) if isinstance(value, Path) else value

    def is_said(self, value: Any) -> bool:
        return value is not self.settings["default"] if self.is_switch else value not in (None, (), [])


def _relative(file: str | Path, folder: Path) -> str:
    return str(file) if os.path.isabs(file) else os.path.relpath(file, folder)


def _keys(fields: Fields) -> dict[str, Key]:
    keys = {}
    for field, owner in flags_of(fields):
        if (fields is Group or owner is not Group) and field.name not in NO_KEYS:
            keys[field.name] = Key(field.name, settings_of(field), Path in (field.type, *get_args(field.type)))
    return keys


JOB, MOTION = _keys(Deform), _keys(Group)


def with_job(command: str, words: Sequence[str]) -> tuple[list[str], argparse.Namespace]:
    """Reads the job that the words name: returns the words with its files, and its other values.

    For `sensitivity` there are no values, and the mesh of the job comes first.

    Raises `ValueError` for a file that is no job.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--job", type=Path)
    try:
        path = finder.parse_known_args(words)[0].job if command in ("deform", "sensitivity") else None
    except argparse.ArgumentError:
        path = None
    if path is None:
        return list(words), argparse.Namespace()
    values = read_job(path)
    first = next((k for k, word in enumerate(words) if word.startswith("-")), len(words))
    is_whole = command == "sensitivity" or (first == 0 and "output" in values)
    if is_whole and "file" not in values:
        raise ValueError(f"{path}: file is missing: the mesh that the job moves.")
    files = [str(values.pop(name)) for name in ("file", "output") if name in values]
    if command == "sensitivity":
        return [files[0], *words], argparse.Namespace()
    return [*(words[:first] or files), *words[first:]], argparse.Namespace(**values)


def read_job(path: Path) -> dict[str, Any]:
    """Reads the values of a job by the fields of a request. Raises `ValueError` for others."""
    job = _known(path, "a job", read(str(path), path.read_bytes()), (*JOB, "set", "moving"))
    values = {name: key.from_toml(path, job[name]) for name, key in JOB.items() if name in job}
    moving = job.get("moving", [])
    if not isinstance(moving, list) or not all(isinstance(group, dict) for group in moving):
        raise ValueError(f"{path}: moving is a list of tables: begin each with [[moving]].")
    return values | {"set": _changes(path, job.get("set", {})), "groups": [_group(path, group) for group in moving]}


def _group(path: Path, group: dict[str, Any]) -> Group:
    group = _known(path, "[[moving]]", group, tuple(MOTION))
    if not group.get("patches"):
        raise ValueError(f"{path}: a [[moving]] without patches.")
    modes = _modes(path, group.pop("mode")) if "mode" in group else ()
    values = {name: MOTION[name].from_toml(path, value) for name, value in group.items()}
    return Group(**values | {"patches": tuple(values["patches"]), "mode": modes})


def _changes(path: Path, changes: Any) -> list[tuple[str, tuple[float, ...]]]:
    """Reads new values of design variables."""
    if not isinstance(changes, dict):
        raise ValueError(f"{path}: set is a table of names and numbers, found {reprlib.repr(changes)}.")
    read = []
    for name, value in changes.items():
        values = value if isinstance(value, list) else [value]
        if not values or any(type(number) not in (int, float) for number in values):
            raise ValueError(f"{path}: set.{name} is a number, or a list of numbers, found {reprlib.repr(value)}.")
        read.append((name, tuple(map(float, values))))
    return read


def _modes(path: Path, modes: Any) -> tuple[tuple[str, float], ...]:
    """Reads files of mode shapes with their amplitudes."""
    if not isinstance(modes, list) or not all(map(_is_mode, modes)):
        found = reprlib.repr(modes)
        raise ValueError(f'{path}: mode is a list of files with amplitudes, [["FILE", 0.1], ...], found {found}.')
    return tuple((str(path.parent / file), float(amplitude)) for file, amplitude in modes)


def _is_mode(pair: Any) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str) and type(pair[1]) in (int, float)


def _known(path: Path, what: str, table: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    table = {key.replace("-", "_"): value for key, value in table.items()}
    foreign = [key for key in table if key not in names]
    if foreign:
        hint = meant(foreign[0], names) or "."
        if foreign[0] in MOTION and "moving" in names:
            hint = ": it belongs to a motion, below a [[moving]]."
        raise ValueError(f"{path}: {what} has no {foreign[0]}{hint} It may have {', '.join(names)}.")
    return table


def job_of(request: Sensitivity) -> Deform | None:
    """Reads the job that the request names.

    It raises `ValueError` for flags that make no sense with a job, or without one.
    """
    if request.job is None:
        if request.set:
            raise ValueError("--set without --job: it names design variables of a job.")
        return None
    if (request.moving, request.boundary, request.method) != ((), BoundaryFlags(), Method()):
        raise ValueError("--job names patches and method. Remove the flags of patches and methods.")
    values = read_job(request.job)
    values |= {"file": request.file, "output": request.output, "job": request.job}
    values["set"] = [*values["set"], *request.set]
    return made(Deform, argparse.Namespace(**values))


def text_of(request: Deform, folder: Path) -> str:
    """Writes a request as a job, with paths relative to a folder."""
    values = dict(values_of(request))
    job = {name: key.in_toml(values[name], folder) for name, key in JOB.items() if key.is_said(values[name])}
    if request.set:
        job["set"] = {name: numbers[0] if len(numbers) == 1 else numbers for name, numbers in request.set}
    lines = [f"{name} = {written(value)}" for name, value in job.items()]
    for group in request.groups:
        lines += ["", "[[moving]]"]
        for name, key in MOTION.items():
            value = getattr(group, name)
            if key.is_said(value) and not (name == "displacement_is" and group.displacement is None):
                lines.append(f"{name} = {written(key.in_toml(value, folder))}")
    return "\n".join(lines) + "\n"
