"""Job files: the flags of `jaxmorph deform` as TOML. They are read into flags, so one parser checks both."""

import argparse
import dataclasses
import json
import os
import pathlib
import tomllib
from collections.abc import Sequence
from typing import Any

from ._flags import GATES
from ._groups import Group
from ._parser import meant

LISTS = ("fixed", "symmetry")
VALUES = ("method", "sources", "steps", "chunk", "dtype", "preset", "picture", *GATES)
SWITCHES = {"allow_inverted": True, "dry_run": False}
"""Names that are either true or false, and the value that has a flag."""

FILES = ("file", "output")
PATHS = (*FILES, "picture", "displacement", "displacement_from", "box", "mode")
"""Names whose values are paths, relative to the job's folder. A mode begins with a path; a box may be a table instead."""

MOTION = tuple(field.name for field in dataclasses.fields(Group) if field.name != "given")


def with_job(arguments: Sequence[str]) -> list[str]:
    """Puts the flags of the file that `--job` names before the given ones. Raises `ValueError` for a file that is no job."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--job", type=pathlib.Path)
    arguments = list(arguments)
    if "deform" not in arguments[:1]:
        return arguments
    try:
        path = finder.parse_known_args(arguments)[0].job
    except argparse.ArgumentError:
        return arguments
    if path is None:
        return arguments
    files, flags = _flags(path)
    first = next((k for k, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    return ["deform", *(arguments[1:first] or files), *flags, *arguments[first:]]


def _flags(path: pathlib.Path) -> tuple[list[str], list[str]]:
    try:
        job = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not TOML ({error}).") from None
    job = _known(path, "a job", job, (*FILES, *LISTS, *VALUES, *SWITCHES, "moving"))
    flags: list[str] = []
    for name in (*LISTS, *VALUES):
        if name in job:
            flags += [_flag(name), *_words(path, name, job[name])]
    for name, value in SWITCHES.items():
        if name in job and not isinstance(job[name], bool):
            raise ValueError(f"{path}: {name} is true or false, found {job[name]!r}.")
        if job.get(name) is value:
            flags.append(_flag(name) if value else _flag(f"no_{name}"))
    moving = job.get("moving", [])
    if not isinstance(moving, list) or not all(isinstance(group, dict) for group in moving):
        raise ValueError(f"{path}: moving is a list of tables: begin each with [[moving]].")
    for group in moving:
        group = _known(path, "[[moving]]", group, MOTION)
        if not group.get("patches"):
            raise ValueError(f"{path}: a [[moving]] without patches.")
        flags += ["--moving", *_words(path, "patches", group.pop("patches"))]
        for mode in group.pop("mode", []):
            flags += ["--mode", *_words(path, "mode", mode)]
        for name, value in group.items():
            flags += [_flag(name), *_words(path, name, value)]
    return [word for name in FILES if name in job for word in _words(path, name, job[name])], flags


def _known(path: pathlib.Path, what: str, table: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    table = {key.replace("-", "_"): value for key, value in table.items()}
    foreign = [key for key in table if key not in names]
    if foreign:
        hint = meant(foreign[0], names) or "."
        raise ValueError(f"{path}: {what} has no {foreign[0]}{hint} It may have {', '.join(names)}.")
    return table


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _words(path: pathlib.Path, name: str, value: Any) -> list[str]:
    """Converts a value to words; a path becomes relative to the current folder."""
    if name == "box" and isinstance(value, dict):
        return [json.dumps(value)]
    values = value if isinstance(value, list) else [value]
    if not values or any(type(each) not in (str, int, float) for each in values):
        raise ValueError(f"{path}: {name} cannot be {value!r}.")
    words = [str(each) for each in values]
    if name in PATHS and not words[0].lstrip().startswith("{"):
        words[0] = str(path.parent / words[0])
    return words


def text_of(arguments: argparse.Namespace, folder: pathlib.Path) -> str:
    """Writes arguments of `jaxmorph deform` as a job, with paths relative to a folder."""
    job: dict[str, Any] = {}
    for name in (*FILES, *LISTS, *VALUES):
        value = getattr(arguments, name)
        if value not in (None, []):
            job[name] = _seen(name, value, folder)
    for name, value in SWITCHES.items():
        if getattr(arguments, name) is value:
            job[name] = value
    lines = [f"{name} = {_toml(value)}" for name, value in job.items()]
    for group in arguments.moving or ():
        lines += ["", "[[moving]]"]
        for name in MOTION:
            value = getattr(group, name)
            if value not in (None, []) and not (name == "displacement_is" and group.displacement is None):
                lines.append(f"{name} = {_toml(_seen(name, value, folder))}")
    return "\n".join(lines) + "\n"


def _seen(name: str, value: Any, folder: pathlib.Path) -> Any:
    """Makes the paths of a value relative to a folder, unless they are absolute; turns a box in JSON into a table."""
    if name == "mode":
        return [(_seen("displacement", file, folder), amplitude) for file, amplitude in value]
    if name not in PATHS:
        return value
    if str(value).lstrip().startswith("{"):
        return json.loads(value)
    return str(value) if os.path.isabs(value) else os.path.relpath(value, folder)


def _toml(value: Any) -> str:
    """Formats a value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {_toml(each)}" for key, each in value.items()) + " }"
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
