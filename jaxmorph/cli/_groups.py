"""Groups of moving patches: `--moving` begins one, and the flags after it describe its motion."""

import argparse
import dataclasses
import pathlib
from typing import Any


@dataclasses.dataclass
class Group:
    """Patches and their motion, as the flags give it; `given` are the flags that have been."""

    patches: list[str] = dataclasses.field(default_factory=list)
    name: str | None = None
    displacement: pathlib.Path | None = None
    displacement_from: pathlib.Path | None = None
    displacement_is: str = "position"
    mode: list[tuple[str, float]] = dataclasses.field(default_factory=list)
    box: str | None = None
    lattice: pathlib.Path | None = None
    hicks_henne: str | None = None
    cst: str | None = None
    scale: list[float] | None = None
    twist: float | None = None
    bend: float | None = None
    rotate: float | None = None
    translate: list[float] | None = None
    about: list[float] | None = None
    axis: list[float] | None = None
    along: list[float] | None = None
    length: float | None = None
    given: set[str] = dataclasses.field(default_factory=set, repr=False, compare=False)

    @property
    def title(self) -> str:
        return ", ".join(self.patches)


MOTIONS = ("rotate", "translate", "scale", "bend", "twist", "mode", "displacement", "box", "hicks_henne", "cst")
"""The fields of a group that move something."""


class Moving(argparse.Action):
    """Begins a group; motion flags that came before the first `--moving` belong to it."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        groups = _groups(namespace)
        if groups and not groups[-1].patches:
            groups[-1].patches = list(values)
        else:
            groups.append(Group(list(values)))


class Part(argparse.Action):
    """One flag of the motion of the last group."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        groups = _groups(namespace)
        if not groups:
            groups.append(Group())
        group = groups[-1]
        if self.dest == "mode":
            group.mode.append(_mode(parser, values))
            return
        if self.dest in group.given:
            parser.error(f"{option_string} twice for one --moving; name the patches by --moving again to go on.")
        group.given.add(self.dest)
        setattr(group, self.dest, values)


class Job(argparse.Action):
    """Ends what a job file said: flags after it say otherwise."""

    def __call__(self, parser, namespace, values: Any, option_string=None):
        for group in _groups(namespace):
            group.given.clear()
        setattr(namespace, self.dest, values)


def _groups(namespace: argparse.Namespace) -> list[Group]:
    if namespace.moving is None:
        namespace.moving = []
    return namespace.moving


def _mode(parser: argparse.ArgumentParser, values: Any) -> tuple[str, float]:
    file, amplitude = values
    try:
        return file, float(amplitude)
    except ValueError:
        parser.error(f"argument --mode: the amplitude of {file} is a number, found {amplitude!r}.")
