"""Job files: the flags of `jaxmorph deform` as TOML."""

import argparse
import dataclasses
import itertools
import json
import os
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from jaxmorph._host.package.text import parse_toml

from ._parser import (
    Parser,
    build_request,
    flag_of,
    flags_of,
    guess_meant,
    is_switch,
    kind_of,
    settings_of,
    values_of,
)
from ._requests import (
    AUTO,
    BoundaryFlags,
    Deform,
    MethodFlags,
    MotionFlags,
    SensitivityRequest,
    Speech,
    Table,
)

Keys = Mapping[str, dataclasses.Field]

NO_KEYS = ("job", "save_job", "set", *(field.name for field in dataclasses.fields(Speech)))
"""Flags that are not keys of a job; `set` is a table of it."""

MOTION_KEYS: Keys = {field.name: field for field, _ in flags_of(MotionFlags)}
JOB_KEYS: Keys = {
    field.name: field for field, _ in flags_of(Deform) if field.name not in (*MOTION_KEYS, *NO_KEYS)
}


class JobParser(Parser):
    def __init__(self, path: Path):
        super().__init__(add_help=False)
        self.path = path
        self.add_fields(Deform)

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{self.path}: {message.rstrip('.')}.")

    def values(self, job: Table) -> argparse.Namespace:
        groups = job.pop("moving", [])
        changes = job.pop("set", {})
        if not isinstance(groups, list) or not all(isinstance(group, dict) for group in groups):
            self.error("moving is a list of tables: begin each with [[moving]]")
        if not isinstance(changes, dict):
            self.error(f"set is a table of names and numbers, found {reprlib.repr(changes)}")
        words = ["", ""]
        for name, value in job.items():
            words += self.words(JOB_KEYS[name], value)
        for name, value in changes.items():
            words += ["--set", f"{name}={','.join(map(str, as_list(value)))}"]
        for group in groups:
            words += self.group(check_keys(self.path, "[[moving]]", group, MOTION_KEYS))
        return self.parse_args(words)

    def group(self, group: Table) -> list[str]:
        patches = group.pop("patches", None) or self.error("a [[moving]] without patches")
        values = {"patches": patches, **group}
        return [
            word for name, value in values.items() for word in self.words(MOTION_KEYS[name], value)
        ]

    def words(self, field: dataclasses.Field, value: Any) -> list[str]:
        name = field.name
        settings = settings_of(field)
        flag, *_ = field.metadata["names"] or [flag_of(name)]
        if is_switch(settings):
            return [flag] * (self.boolean(name, value) is not field.default)
        if name == "mode":
            return [
                word
                for file, size in self.pairs(value)
                for word in (flag, self.word(file, True), str(size))
            ]
        if name == "onto_features":
            return [f"{flag}={json.dumps(value)}"]
        if isinstance(value, list) and "nargs" not in settings:
            self.error(f"{name} is one value, found {reprlib.repr(value)}")
        words = [self.word(entry, kind_of(field) is not None) for entry in as_list(value)]
        return [f"{flag}={words[0]}"] if len(words) == 1 else [flag, *words]

    def boolean(self, name: str, value: Any) -> bool:
        if not isinstance(value, bool):
            self.error(f"{name} is true or false, found {value!r}")
        return value

    def pairs(self, value: Any) -> list[list[Any]]:
        if not all(isinstance(pair, list) and len(pair) == 2 for pair in as_list(value)):
            found = reprlib.repr(value)
            self.error(
                f'mode is a list of files with amplitudes, [["FILE", 0.1], ...], found {found}'
            )
        return as_list(value)

    def word(self, value: Any, is_path: bool) -> str:
        if isinstance(value, dict):
            return json.dumps(value)
        return str(self.path.parent / str(value) if is_path else value)


def as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def with_job(command: str, words: Sequence[str]) -> tuple[list[str], argparse.Namespace]:
    """Reads the job that the words name: returns the words with its files, and its other values.

    For `sensitivity` there are no values, and the mesh of the job comes first. Raises `ValueError`
    for a bad job.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--job", type=Path, nargs="?")
    path = finder.parse_known_args(words)[0].job
    if path is None:
        return list(words), argparse.Namespace()
    values, files = read_job(path)
    given = list(itertools.takewhile(lambda word: not word.startswith("-"), words))
    if "file" not in files and (command == "sensitivity" or (files and not given)):
        raise ValueError(f"{path}: file is missing: the mesh that the job moves.")
    if command == "sensitivity":
        return [files["file"], *words], argparse.Namespace()
    return [*(given or files.values()), *words[len(given) :]], values


def read_job(path: Path) -> tuple[argparse.Namespace, dict[str, str]]:
    """Reads the values of a job, and its mesh files; paths are relative to the job's folder."""
    job = check_keys(
        path, "a job", parse_toml(str(path), path.read_bytes()), (*JOB_KEYS, "set", "moving")
    )
    files = {
        name: str(path.parent / str(job.pop(name))) for name in ("file", "output") if name in job
    }
    values = JobParser(path).values(job)
    for group in getattr(values, "groups", ()):
        group.flags.clear()  # flags beside a job win
    return values, files


def check_keys(path: Path, what: str, table: Table, names: Any) -> Table:
    table = {key.replace("-", "_"): value for key, value in table.items()}
    foreign = next((key for key in table if key not in names), None)
    if foreign is not None:
        hint = guess_meant(foreign, names) or "."
        if foreign in MOTION_KEYS and "moving" in names:
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
    values, _ = read_job(request.job)
    if values.steps == AUTO:
        raise ValueError(
            f"{request.job}: steps = {AUTO!r}: the number is needed. --save-job of deform writes "
            "it."
        )
    vars(values).update(
        file=request.file, output=request.output, job=request.job, set=[*values.set, *request.set]
    )
    return build_request(Deform, values)


def text_of(request: Deform, folder: Path) -> str:
    lines = list(_format_fields(JOB_KEYS, request, folder))
    if request.set:
        changes = {
            name: numbers[0] if len(numbers) == 1 else numbers for name, numbers in request.set
        }
        lines.append(f"set = {toml(changes, folder)}")
    for group in request.groups:
        lines += ["", "[[moving]]", *_format_fields(MOTION_KEYS, group, folder)]
    return "\n".join(lines) + "\n"


def _format_fields(keys: Keys, request: Any, folder: Path) -> Iterator[str]:
    for field, value in values_of(request):
        unsaid = (
            (field.default,) if keys is MOTION_KEYS or is_switch(settings_of(field)) else (None, ())
        )
        if keys.get(field.name) is field and value not in unsaid:
            yield f"{field.name} = {toml(value, folder)}"


def toml(value: Any, folder: Path) -> str:
    if isinstance(value, Path):
        value = str(value) if value.is_absolute() else os.path.relpath(value, folder)
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml(entry, folder) for entry in value)}]"
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(
                f"{json.dumps(key)} = {toml(entry, folder)}" for key, entry in value.items()
            )
            + " }"
        )
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
