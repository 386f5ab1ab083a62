"""Job files: the flags of `jaxmorph deform` as TOML. They are read into flags, so one parser checks both."""

import argparse
import dataclasses
import json
import os
import pathlib
import reprlib
from collections.abc import Sequence
from typing import Any

from jaxmorph._host.package.toml import read, written

from ._flags import GATES
from ._groups import Group
from ._parser import meant

LISTS = ("fixed", "symmetry", "free", "sliding", "periodic")
VALUES = ("method", "sources", "steps", "chunk", "ranges", "dtype", "preset", "picture", *GATES)
SWITCHES = {"decomposed": True, "allow_inverted": True, "dry_run": False}
"""Names that are either true or false, and the value that has a flag."""

FILES = ("file", "output")
PATHS = (*FILES, "picture", "displacement", "displacement_from", "box", "hicks_henne", "cst", "lattice", "mode")
TABLES = ("box", "hicks_henne", "cst")
"""Names whose values are paths, relative to the job's folder. A mode begins with one; `TABLES` may be tables instead."""

SEVERAL = (*LISTS, "patches", "scale", "translate", "about", "axis", "along")
"""Names whose values may be lists."""

TEXTS = (*PATHS, *LISTS, "patches", "name", "method", "dtype", "preset", "displacement_is")
"""Names whose values are text; all others hold numbers."""

MOTION = tuple(field.name for field in dataclasses.fields(Group) if field.name != "given")


def with_job(arguments: Sequence[str]) -> list[str]:
    """Puts the flags of the file that `--job` names before the given ones. Raises `ValueError` for a file that is no job.

    For `sensitivity` it is the mesh that the job names.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--job", type=pathlib.Path)
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
    if command == ["sensitivity"]:
        if not files:
            raise ValueError(f"{path}: file is missing: the mesh that the job moves.")
        return [*command, files[0], *arguments[1:]]
    first = next((k for k, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    return ["deform", *(arguments[1:first] or files), *flags, *arguments[first:]]


def _flags(path: pathlib.Path) -> tuple[list[str], list[str]]:
    job = _known(
        path, "a job", read(str(path), path.read_bytes()), (*FILES, *LISTS, *VALUES, *SWITCHES, "set", "moving")
    )
    flags: list[str] = []
    for name in (*LISTS, *VALUES):
        if name in job:
            flags += [_flag(name), *_words(path, name, job[name])]
    for name, value in SWITCHES.items():
        if name in job and not isinstance(job[name], bool):
            raise ValueError(f"{path}: {name} is true or false, found {reprlib.repr(job[name])}.")
        if job.get(name) is value:
            flags.append(_flag(name) if value else _flag(f"no_{name}"))
    flags += _changes(path, job.get("set", {}))
    moving = job.get("moving", [])
    if not isinstance(moving, list) or not all(isinstance(group, dict) for group in moving):
        raise ValueError(f"{path}: moving is a list of tables: begin each with [[moving]].")
    for group in moving:
        group = _known(path, "[[moving]]", group, MOTION)
        if not group.get("patches"):
            raise ValueError(f"{path}: a [[moving]] without patches.")
        flags += ["--moving", *_words(path, "patches", group.pop("patches"))]
        flags += _modes(path, group.pop("mode", []))
        for name, value in group.items():
            flags += [_flag(name), *_words(path, name, value)]
    return [word for name in FILES if name in job for word in _words(path, name, job[name])], flags


def _changes(path: pathlib.Path, changes: Any) -> list[str]:
    """Converts numbers of design variables to flags."""
    if not isinstance(changes, dict):
        raise ValueError(f"{path}: set is a table of names and numbers, found {reprlib.repr(changes)}.")
    flags: list[str] = []
    for name, value in changes.items():
        values = value if isinstance(value, list) else [value]
        if not values or any(type(each) not in (int, float) for each in values):
            raise ValueError(f"{path}: set.{name} is a number, or a list of such, found {reprlib.repr(value)}.")
        flags += ["--set", f"{name}={','.join(map(str, values))}"]
    return flags


def _modes(path: pathlib.Path, modes: Any) -> list[str]:
    """Converts mode shapes to flags."""
    flags: list[str] = []
    for mode in modes if isinstance(modes, list) else [modes]:
        if not isinstance(mode, list) or len(mode) != 2 or type(mode[1]) not in (int, float):
            raise ValueError(
                f'{path}: mode is a list of files with amplitudes, [["FILE", 0.1], ...], found {reprlib.repr(modes)}.'
            )
        flags += ["--mode", *_words(path, "mode", mode[0]), str(mode[1])]
    return flags


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
    if name in TABLES and isinstance(value, dict):
        return [json.dumps(value)]
    values = value if isinstance(value, list) and name in SEVERAL else [value]
    kinds = (str, int) if name in TEXTS else (int, float)
    if not values or any(type(each) not in kinds for each in values):
        what = f"{'text' if name in TEXTS else 'a number'}{', or a list of such' if name in SEVERAL else ''}"
        raise ValueError(f"{path}: {name} is {what}, found {reprlib.repr(value)}.")
    wrong = [each for each in map(str, values) if name in TEXTS and (each.startswith("-") or "\0" in each)]
    if wrong:
        raise ValueError(f"{path}: {name} cannot be {reprlib.repr(wrong[0])}; a job has no flags as values.")
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
    changes = {name: values[0] if len(values) == 1 else values for name, values in arguments.set}
    if changes:
        job["set"] = changes
    lines = [f"{name} = {written(value)}" for name, value in job.items()]
    for group in arguments.moving or ():
        lines += ["", "[[moving]]"]
        for name in MOTION:
            value = getattr(group, name)
            if value not in (None, []) and not (name == "displacement_is" and group.displacement is None):
                lines.append(f"{name} = {written(_seen(name, value, folder))}")
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
