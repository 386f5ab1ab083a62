"""Job files: the flags of `jaxmorph deform` as TOML."""

import argparse
import dataclasses
import itertools
import json
import os
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from jaxmorph._host.package.text import read

from ._parser import Fields, flags_of, is_switch, made, meant, settings_of, values_of
from ._requests import AUTO, BoundaryFlags, Deform, MethodFlags, MotionFlags, SensitivityRequest, Speech, steps, table

NO_KEYS = ("job", "save_job", "set", *(field.name for field in dataclasses.fields(Speech)))
"""Flags that are not keys of a job; `set` is a table of it."""

TYPES = {
    int: ((int,), "a whole number", "whole numbers"),
    float: ((int, float), "a number", "numbers"),
    bool: ((bool,), "true or false", ""),
    table: ((str, dict), "text", "texts"),
    steps: ((int, str), "a whole number or auto", ""),
}
"""Types in TOML by the type of a flag, and their names; others are text, also a patch such as 5."""


@dataclasses.dataclass(frozen=True)
class Key:
    """A flag as a name in a job; a path is relative to the folder of the job."""

    name: str
    settings: Mapping[str, Any]
    kind: Any
    is_path: bool

    def from_toml(self, job: Path, value: Any) -> Any:
        if self.name == "mode":
            return _modes(job, value)
        values = _checked(job, self.name, value, self.kind, self.settings.get("nargs") == "+")
        values = [self._one(job, entry) for entry in values]
        return values if self.settings.get("nargs") == "+" else values[0]

    def _one(self, job: Path, value: Any) -> Any:
        if isinstance(value, bool | dict):
            return value
        if self.kind not in (int, float):
            value = str(job.parent / str(value) if self.is_path else value)
        try:
            value = self.kind(value)
        except argparse.ArgumentTypeError as error:
            raise ValueError(f"{job}: {error}.") from None
        choices = self.settings.get("choices")
        if choices and value not in choices:
            raise ValueError(f"{job}: {self.name} is one of {', '.join(choices)}, found {value!r}.")
        return value

    def in_toml(self, value: Any, folder: Path) -> str:
        if self.name == "mode":
            value = [(_relative(file, folder), amplitude) for file, amplitude in value]
        return f"{self.name} = {written(_relative(value, folder) if isinstance(value, Path) else value)}"

    def is_said(self, value: Any) -> bool:
        return value is not self.settings["default"] if self.kind is bool else value not in (None, (), [])


def _checked(job: Path, name: str, value: Any, kind: Any, is_list: bool) -> list[Any]:
    types, one, several = TYPES.get(kind, ((str, int), "text", "texts"))
    values = value if isinstance(value, list) and is_list else [value]
    if not values or any(type(entry) not in types for entry in values):
        what = f"{one}, or a list of {several}" if is_list else one
        raise ValueError(f"{job}: {name} is {what}, found {reprlib.repr(value)}.")
    return values


def _relative(file: str | Path, folder: Path) -> str:
    return str(file) if os.path.isabs(file) else os.path.relpath(file, folder)


def _keys(fields: Fields) -> Iterator[tuple[str, Key]]:
    for field, owner in flags_of(fields):
        if (fields is MotionFlags or owner is not MotionFlags) and field.name not in NO_KEYS:
            settings = settings_of(field)
            kind = bool if is_switch(settings) else settings.get("type", str)
            yield field.name, Key(field.name, settings, kind, Path in (field.type, *get_args(field.type)))


JOB, MOTION = dict(_keys(Deform)), dict(_keys(MotionFlags))


def with_job(command: str, words: Sequence[str]) -> tuple[list[str], argparse.Namespace]:
    """Reads the job that the words name: returns the words with its files, and its other values.

    For `sensitivity` there are no values, and the mesh of the job comes first. Raises `ValueError`
    for a bad job.
    """
    path = _job_in(words)
    if path is None:
        return list(words), argparse.Namespace()
    values, given = read_job(path), list(itertools.takewhile(lambda word: not word.startswith("-"), words))
    if "file" not in values and (command == "sensitivity" or ("output" in values and not given)):
        raise ValueError(f"{path}: file is missing: the mesh that the job moves.")
    if command == "sensitivity":
        return [str(values["file"]), *words], argparse.Namespace()
    files = [str(values.pop(name)) for name in ("file", "output") if name in values]
    return [*(given or files), *words[len(given) :]], argparse.Namespace(**values)


def _job_in(words: Sequence[str]) -> Path | None:
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--job", type=Path, nargs="?")
    return finder.parse_known_args(words)[0].job


def read_job(path: Path) -> dict[str, Any]:
    job = _known(path, "a job", read(str(path), path.read_bytes()), (*JOB, "set", "moving"))
    values = {name: key.from_toml(path, job[name]) for name, key in JOB.items() if name in job}
    moving, changes = job.get("moving", []), job.get("set", {})
    if not isinstance(moving, list) or not all(isinstance(group, dict) for group in moving):
        raise ValueError(f"{path}: moving is a list of tables: begin each with [[moving]].")
    if not isinstance(changes, dict):
        raise ValueError(f"{path}: set is a table of names and numbers, found {reprlib.repr(changes)}.")
    numbers = {name: _checked(path, f"set.{name}", value, float, True) for name, value in changes.items()}
    values["set"] = [(name, tuple(map(float, several))) for name, several in numbers.items()]
    return values | {"groups": [_group(path, group) for group in moving]}


def _group(path: Path, group: dict[str, Any]) -> MotionFlags:
    group = _known(path, "[[moving]]", group, tuple(MOTION))
    if not group.get("patches"):
        raise ValueError(f"{path}: a [[moving]] without patches.")
    values: dict[str, Any] = {name: MOTION[name].from_toml(path, value) for name, value in group.items()}
    values["patches"] = tuple(values["patches"])
    return MotionFlags(**values)


def _modes(path: Path, modes: Any) -> tuple[tuple[str, float], ...]:
    if not isinstance(modes, list) or not all(map(_is_mode, modes)):
        found = reprlib.repr(modes)
        raise ValueError(f'{path}: mode is a list of files with amplitudes, [["FILE", 0.1], ...], found {found}.')
    return tuple((str(path.parent / file), float(amplitude)) for file, amplitude in modes)


def _is_mode(pair: Any) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str) and type(pair[1]) in (int, float)


def _known(path: Path, what: str, table: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    table = {key.replace("-", "_"): value for key, value in table.items()}
    foreign = next((key for key in table if key not in names), None)
    if foreign is not None:
        hint = meant(foreign, names) or "."
        if foreign in MOTION and "moving" in names:
            hint = ": it belongs to a motion, below a [[moving]]."
        raise ValueError(f"{path}: {what} has no {foreign}{hint} It may have {', '.join(names)}.")
    return table


def job_of(request: SensitivityRequest) -> Deform | None:
    """Reads the job that the request names; `ValueError` for flags that contradict its presence."""
    if request.job is None:
        if request.set:
            raise ValueError("--set without --job: it names design variables of a job.")
        return None
    if (request.moving, request.boundary, request.method) != ((), BoundaryFlags(), MethodFlags()):
        raise ValueError("--job names patches and method. Remove the flags of patches and methods.")
    values = read_job(request.job)
    if values.get("steps") == AUTO:
        raise ValueError(f"{request.job}: steps = {AUTO!r}: the number is needed. --save-job of deform writes it.")
    values |= {"file": request.file, "output": request.output, "job": request.job}
    values["set"] = [*values["set"], *request.set]
    return made(Deform, argparse.Namespace(**values))


def text_of(request: Deform, folder: Path) -> str:
    lines = list(_said(JOB, dict(values_of(request)), folder))
    if request.set:
        changes = {name: numbers[0] if len(numbers) == 1 else numbers for name, numbers in request.set}
        lines.append(f"set = {written(changes)}")
    for group in request.groups:
        unsaid = {"displacement_is": None} if group.displacement is None else {}
        lines += ["", "[[moving]]", *_said(MOTION, vars(group) | unsaid, folder)]
    return "\n".join(lines) + "\n"


def _said(keys: Mapping[str, Key], values: Mapping[str, Any], folder: Path) -> Iterator[str]:
    for name, key in keys.items():
        if key.is_said(values[name]):
            yield key.in_toml(values[name], folder)


def written(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {written(entry)}" for key, entry in value.items()) + " }"
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
