"""Job files: the flags of `jaxmorph deform` as TOML."""

import argparse
import dataclasses
import json
import os
import reprlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from .._host.package.text import read, written
from ._groups import Group, is_json, table
from ._parser import Fields, flag_of, flags_of, meant
from ._parts import Speech
from ._requests import Deform

NO_KEYS = ("job", "save_job", "set", *(field.name for field in dataclasses.fields(Speech)))
"""Flags that are not keys of a job; `set` is a table of it."""

KINDS = {int: "whole number", float: "number", table: "table"}
"""Kinds of values by the types of flags; others are text, paths, or switches."""


@dataclasses.dataclass(frozen=True)
class Key:
    """A name in a job, that of a flag: the kind of its value, and whether the value may be a list.

    A path is relative to the folder of the job. A table stands in the job, or in a file at a path.
    """

    name: str
    kind: str
    is_list: bool
    default: Any
    flag: str

    @classmethod
    def from_field(cls, field: dataclasses.Field) -> "Key":
        settings, names = field.metadata["settings"], field.metadata["names"]
        kind = KINDS.get(settings.get("type"), "path" if field.type in (Path, Path | None) else "text")
        kind = "switch" if settings.get("action") in ("store_true", "store_false") else kind
        is_list = settings.get("nargs") == "+"
        flag = "" if names == ("",) else names[0] if names else flag_of(field.name)
        return cls(field.name, kind, is_list, field.default, flag)


def _keys(fields: Fields) -> dict[str, Key]:
    keys = {
        field.name: Key.from_field(field) for field, owner in flags_of(fields) if fields is Group or owner is not Group
    }
    return {name: key for name, key in keys.items() if name not in NO_KEYS}


JOB, MOTION = _keys(Deform), _keys(Group)


def with_job(arguments: Sequence[str]) -> list[str]:
    """Puts the flags of the file that `--job` names before the given flags.

    It raises `ValueError` for a file that is no job.

    For `sensitivity` the mesh that the job names comes first instead.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--job", type=Path)
    arguments = list(arguments)
    command = arguments[:1]
    if command not in (["deform"], ["sensitivity"]):
        return arguments
    try:
        path = finder.parse_known_args(arguments)[0].job
    except argparse.ArgumentError:
        return arguments
    if path is None:
        return arguments
    files, flags = _flags(path)
    first = next((k for k, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    if "file" not in files and (command == ["sensitivity"] or ("output" in files and first == 1)):
        raise ValueError(f"{path}: file is missing: the mesh that the job moves.")
    if command == ["sensitivity"]:
        return [*command, files["file"], *arguments[1:]]
    return ["deform", *(arguments[1:first] or files.values()), *flags, *arguments[first:]]


def _flags(path: Path) -> tuple[dict[str, str], list[str]]:
    """Reads a job: its file and output by these names, and its flags with their values."""
    job = _known(path, "a job", read(str(path), path.read_bytes()), (*JOB, "set", "moving"))
    files: dict[str, str] = {}
    flags: list[str] = []
    for name, key in JOB.items():
        if name not in job:
            continue
        if key.kind != "switch":
            words = _words(path, key, job[name])
            if key.flag:
                flags += [key.flag, *words]
            else:
                files[name] = words[0]
        elif not isinstance(job[name], bool):
            raise ValueError(f"{path}: {name} is true or false, found {reprlib.repr(job[name])}.")
        elif job[name] is not key.default:
            flags.append(key.flag)
    flags += _changes(path, job.get("set", {}))
    moving = job.get("moving", [])
    if not isinstance(moving, list) or not all(isinstance(group, dict) for group in moving):
        raise ValueError(f"{path}: moving is a list of tables: begin each with [[moving]].")
    for group in moving:
        group = _known(path, "[[moving]]", group, tuple(MOTION))
        if not group.get("patches"):
            raise ValueError(f"{path}: a [[moving]] without patches.")
        for name in ("patches", *(name for name in group if name != "patches")):
            key = MOTION[name]
            flags += _modes(path, group[name]) if name == "mode" else [key.flag, *_words(path, key, group[name])]
    return files, flags


def _changes(path: Path, changes: Any) -> list[str]:
    """Converts numbers of design variables to flags."""
    if not isinstance(changes, dict):
        raise ValueError(f"{path}: set is a table of names and numbers, found {reprlib.repr(changes)}.")
    flags: list[str] = []
    for name, value in changes.items():
        values = value if isinstance(value, list) else [value]
        if not values or any(type(number) not in (int, float) for number in values):
            raise ValueError(f"{path}: set.{name} is a number, or a list of numbers, found {reprlib.repr(value)}.")
        flags += ["--set", f"{name}={','.join(map(str, values))}"]
    return flags


def _modes(path: Path, modes: Any) -> list[str]:
    """Converts mode shapes to flags."""
    flags: list[str] = []
    for mode in modes if isinstance(modes, list) else [modes]:
        if not isinstance(mode, list) or len(mode) != 2 or type(mode[1]) not in (int, float):
            raise ValueError(
                f'{path}: mode is a list of files with amplitudes, [["FILE", 0.1], ...], found {reprlib.repr(modes)}.'
            )
        flags += ["--mode", *_words(path, MOTION["mode"], mode[0]), str(mode[1])]
    return flags


def _known(path: Path, what: str, table: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    table = {key.replace("-", "_"): value for key, value in table.items()}
    foreign = [key for key in table if key not in names]
    if foreign:
        hint = meant(foreign[0], names) or "."
        if foreign[0] in MOTION and "moving" in names:
            hint = ": it belongs to a motion, below a [[moving]]."
        raise ValueError(f"{path}: {what} has no {foreign[0]}{hint} It may have {', '.join(names)}.")
    return table


def _words(path: Path, key: Key, value: Any) -> list[str]:
    """Converts a value to words; a path becomes relative to the current folder."""
    if key.kind == "table" and isinstance(value, dict):
        return [json.dumps(value)]
    is_number = key.kind in ("number", "whole number")
    types = {"number": (int, float), "whole number": (int,)}.get(key.kind, (str, int))
    values = value if isinstance(value, list) and key.is_list else [value]
    if not values or any(type(word) not in types for word in values):
        kinds = (f"a {key.kind}", f"{key.kind}s") if is_number else ("text", "texts")
        what = f"{kinds[0]}, or a list of {kinds[1]}" if key.is_list else kinds[0]
        raise ValueError(f"{path}: {key.name} is {what}, found {reprlib.repr(value)}.")
    words = [str(word) for word in values]
    wrong = [word for word in words if not is_number and (word.startswith("--") or "\0" in word)]
    if wrong:
        raise ValueError(f"{path}: {key.name} cannot be {reprlib.repr(wrong[0])}; a job has no flags as values.")
    is_path = key.kind in ("path", "table") or key.name == "mode"
    if is_path and not is_json(words[0]):
        words[0] = str(path.parent / words[0])
    return words


def text_of(request: Deform, folder: Path) -> str:
    """Writes a request as a job, with paths relative to a folder."""
    values = dict(_values(request))
    job = {name: _seen(key, values[name], folder) for name, key in JOB.items() if _is_said(key, values[name])}
    if request.set:
        job["set"] = {name: numbers[0] if len(numbers) == 1 else numbers for name, numbers in request.set}
    lines = [f"{name} = {written(value)}" for name, value in job.items()]
    for group in request.groups:
        lines += ["", "[[moving]]"]
        for name, key in MOTION.items():
            value = getattr(group, name)
            if _is_said(key, value) and not (name == "displacement_is" and group.displacement is None):
                lines.append(f"{name} = {written(_seen(key, value, folder))}")
    return "\n".join(lines) + "\n"


def _values(request: Any) -> Iterator[tuple[str, Any]]:
    """Yields the values of flags by name, flags of parts included."""
    for field in dataclasses.fields(request):
        value = getattr(request, field.name)
        if "part" in field.metadata:
            yield from _values(value)
        else:
            yield field.name, value


def _is_said(key: Key, value: Any) -> bool:
    return value is not key.default if key.kind == "switch" else value not in (None, (), [])


def _seen(key: Key, value: Any, folder: Path) -> Any:
    """Makes the paths of a value relative to a folder, unless they are absolute."""
    if key.name == "mode":
        return [(_seen(MOTION["displacement"], file, folder), amplitude) for file, amplitude in value]
    if key.kind not in ("path", "table"):
        return value
    if is_json(str(value)):
        return json.loads(value)
    return str(value) if os.path.isabs(value) else os.path.relpath(value, folder)
