"""Groups of moving patches: `--moving` begins one, and the flags after it describe its motion."""

import argparse
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from ._parser import flag
from ._parts import SEVERAL

WHAT_MOVES = 'patches that move: names, or patterns as "wing.*"'


def table(word: str) -> str:
    """Reads the name of a TOML file, or its table as JSON."""
    return word


def is_json(word: str) -> bool:
    """Checks whether the value of a `table` is JSON, and not the name of a file."""
    return word.lstrip().startswith("{")


def as_json(flag: str, word: str) -> dict[str, Any] | None:
    """Reads a table in JSON; None for the name of a file. Raises `ValueError` for what is none."""
    try:
        return json.loads(word) if is_json(word) else None
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"--{flag}: not a table in JSON ({error}).") from None


class Moving(argparse.Action):
    """Begins a group; motion flags before the first `--moving` belong to it."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        groups = _groups(namespace)
        if groups and not groups[-1].patches:
            groups[-1].patches = list(values)
        else:
            groups.append(Group(list(values)))


class InGroup(argparse.Action):
    """Sets one field of the last group."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        groups = _groups(namespace)
        if not groups:
            groups.append(Group())
        group = groups[-1]
        if self.dest == "mode":
            group.mode = [*group.mode, _mode(parser, values)]
            return
        if self.dest in group.flags:
            parser.error(f"{option_string} twice for one --moving. Begin another motion of the patches by --moving.")
        group.flags.add(self.dest)
        setattr(group, self.dest, values)


class Job(argparse.Action):
    """Ends the flags of a job file: flags after it replace them."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        for group in _groups(namespace):
            group.flags.clear()
        setattr(namespace, self.dest, values)


def _groups(namespace: argparse.Namespace) -> "list[Group]":
    if "groups" not in namespace:
        namespace.groups = []
    return namespace.groups


def _mode(parser: argparse.ArgumentParser, values: Any) -> tuple[str, float]:
    file, amplitude = values
    try:
        return file, float(amplitude)
    except ValueError:
        parser.error(f"argument --mode: the amplitude of {file} is a number, found {amplitude!r}.")


def _in_group(what: str, **settings: Any) -> Any:
    return flag(what, action=InGroup, **settings)


def _vector(what: str, **settings: Any) -> Any:
    return _in_group(what, metavar=("X Y", "Z"), type=float, nargs="+", **settings)


def _angle(what: str, **settings: Any) -> Any:
    return _in_group(what, metavar="DEG", type=float, **settings)


@dataclasses.dataclass
class Group:
    """Patches that move and their motion: `--moving` and the flags after it."""

    SECTION: ClassVar = "motion of the patches of the last --moving (at least one flag)"

    patches: Sequence[str] = flag(WHAT_MOVES, "--moving", section="surface", everyday=True, action=Moving, **SEVERAL)
    displacement: Path | None = _in_group(
        "new positions: node id, x, y[, z]; .npz, .stl, .obj", metavar="FILE", type=Path, everyday=True
    )
    displacement_from: Path | None = _in_group(
        "the undeformed surface (.stl, .obj, .npz), if --displacement is a deformed one",
        metavar="FILE",
        type=Path,
    )
    displacement_is: str = _in_group(
        "whether x, y[, z] of the file are new positions (default) or displacements",
        choices=("position", "displacement"),
        default="position",
    )
    mode: Sequence[tuple[str, float]] = _in_group(
        "a file of displacements, and a factor; may be repeated",
        metavar=("FILE", "AMPLITUDE"),
        nargs=2,
        default=(),
    )
    box: str | None = _in_group("a free-form deformation box, see below", metavar="FILE", type=table)
    hicks_henne: str | None = _in_group(
        "bumps of Hicks and Henne on an airfoil's sides, see below", metavar="FILE", type=table
    )
    cst: str | None = _in_group("class and shape functions to add to its sides, see below", metavar="FILE", type=table)
    lattice: Path | None = _in_group(
        "write the lattice of the box for ParaView: FILE_before.vts, FILE_after.vts", metavar="FILE.vts", type=Path
    )
    scale: list[float] | None = _in_group("factor, or a factor for each coordinate", metavar="S", type=float, nargs="+")
    twist: float | None = _angle("degrees by which the end of the line --along turns about the line, 3-D only")
    bend: float | None = _angle(
        "degrees of the arc that the line --along becomes, towards the cross product of --axis and --along"
    )
    rotate: float | None = _angle("degrees, counterclockwise; right-handed about --axis", everyday=True)
    translate: list[float] | None = _vector("vector to translate by", everyday=True)
    about: list[float] | None = _vector("centre of scaling, twist, bend, rotation (the origin)", everyday=True)
    axis: list[float] | None = _vector("axis of rotation and bend, 3-D only", everyday=True)
    along: list[float] | None = _vector("direction of the line from --about, for twist and bend")
    length: float | None = _in_group(
        "length of the line (default: up to the end of the patches)", metavar="L", type=float
    )
    name: str | None = _in_group("name of this motion for --set (default: its patches)", metavar="NAME")
    flags: set[str] = dataclasses.field(default_factory=set, repr=False, compare=False)

    @property
    def title(self) -> str:
        return ", ".join(self.patches)


MOTIONS = ("rotate", "translate", "scale", "bend", "twist", "mode", "displacement", "box", "hicks_henne", "cst")
"""The fields of a group that move something."""
