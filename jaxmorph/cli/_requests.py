"""Requests: the flags of each command as typed values."""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from ._flags import GATES, parser
from ._gates import Gate, gates
from ._groups import Group
from ._job import text_of, with_job
from ._parser import quoted


@dataclasses.dataclass(frozen=True)
class PatchNames:
    """Patches that move, stay, lie in a plane, follow like inner nodes, slide, and repeat: names, patterns or groups."""

    moving: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    symmetry: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    sliding: tuple[str, ...] = ()
    periodic: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Method:
    """The method by its name, how many sources it has on the moving patches (None: its own choice), and the precision."""

    name: str = "default"
    sources: int | None = None
    dtype: str = "float64"


@dataclasses.dataclass(frozen=True)
class Deform:
    """Request of `jaxmorph deform`. `changes` are to the motion, by name; `job` is a file to write and its text."""

    file: Path
    output: Path
    surface: PatchNames
    groups: tuple[Group, ...]
    changes: dict[str, tuple[float, ...]]
    method: Method
    steps: int
    chunk: int | None
    gates: tuple[Gate, ...]
    picture: Path | None
    job: tuple[Path, str] | None
    allow_inverted: bool
    dry_run: bool
    verbose: bool
    decomposed: bool = False
    ranges: int | None = None


@dataclasses.dataclass(frozen=True)
class Modes:
    """Request of `jaxmorph modes`."""

    file: Path
    output: Path
    surface: PatchNames
    method: Method
    modes: tuple[Path, ...]
    amplitudes: tuple[float, ...]
    gates: tuple[Gate, ...]
    allow_inverted: bool


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Request of `jaxmorph sensitivity`; with a job on to what it moves by."""

    file: Path
    sensitivity: Path
    output: Path
    surface: PatchNames
    method: Method
    job: Deform | None


@dataclasses.dataclass(frozen=True)
class SU2:
    """Request of `jaxmorph su2`: `action` is `def` or `dot`."""

    action: str
    file: Path
    sensitivity: Path | None
    output: Path | None
    method: Method
    definition: bool
    allow_inverted: bool


@dataclasses.dataclass(frozen=True)
class Quality:
    """Request of `jaxmorph quality`. `moved` is the file of the same mesh, moved."""

    file: Path
    moved: Path | None
    gates: tuple[Gate, ...]


@dataclasses.dataclass(frozen=True)
class Info:
    """Request of `jaxmorph info`."""

    file: Path


@dataclasses.dataclass(frozen=True)
class Demo:
    """Request of `jaxmorph demo`."""

    case: str
    output: Path


Request = Deform | Modes | Sensitivity | SU2 | Quality | Info | Demo


def request_of(arguments: argparse.Namespace) -> Request:
    """Makes the request of the command that the flags name."""
    return _REQUESTS[arguments.command](arguments)


def _deform(arguments: argparse.Namespace) -> Deform:
    groups: list[Group] = arguments.moving or []
    names = tuple(dict.fromkeys(name for group in groups for name in group.patches))
    job = arguments.save_job
    return Deform(
        arguments.file,
        arguments.output,
        _surface(arguments, names),
        tuple(groups),
        dict(arguments.set),
        _method(arguments),
        arguments.steps,
        arguments.chunk,
        _gates(arguments),
        arguments.picture,
        None if job is None else (job, text_of(arguments, job.parent)),
        arguments.allow_inverted,
        arguments.dry_run,
        arguments.verbose,
        arguments.decomposed,
        arguments.ranges,
    )


def _modes(arguments: argparse.Namespace) -> Modes:
    return Modes(
        arguments.file,
        arguments.output,
        _surface(arguments, arguments.moving),
        _method(arguments),
        tuple(arguments.mode),
        tuple(arguments.amplitude),
        _gates(arguments),
        arguments.allow_inverted,
    )


def _sensitivity(arguments: argparse.Namespace) -> Sensitivity:
    surface, method = _surface(arguments, arguments.moving), _method(arguments)
    files = arguments.file, arguments.sensitivity, arguments.output
    if arguments.job is None:
        if arguments.set:
            raise ValueError("--set without --job: it names design variables of a job.")
        return Sensitivity(*files, surface, method, None)
    if (surface, method) != (PatchNames(), Method()):
        raise ValueError("--job says what moves and how; flags of patches and methods beside it make no sense.")
    words = ["deform", str(arguments.file), str(arguments.file), "--job", str(arguments.job)]
    job = _deform(parser()[0].parse_args(quoted(with_job(words))))
    job = dataclasses.replace(job, changes=job.changes | dict(arguments.set))
    return Sensitivity(*files, job.surface, job.method, job)


def _surface(arguments: argparse.Namespace, moving: Sequence[str]) -> PatchNames:
    kinds = ("fixed", "symmetry", "free", "sliding", "periodic")
    return PatchNames(tuple(moving), *(tuple(getattr(arguments, kind)) for kind in kinds))


def _method(arguments: argparse.Namespace) -> Method:
    return Method(arguments.method, arguments.sources, arguments.dtype)


def _gates(arguments: argparse.Namespace) -> tuple[Gate, ...]:
    return gates({name: getattr(arguments, name) for name in GATES}, arguments.preset)


_REQUESTS = {
    "deform": _deform,
    "modes": _modes,
    "sensitivity": _sensitivity,
    "su2": lambda arguments: SU2(
        arguments.action,
        arguments.file,
        arguments.sensitivity,
        arguments.output,
        _method(arguments),
        arguments.definition,
        arguments.allow_inverted,
    ),
    "quality": lambda arguments: Quality(arguments.file, arguments.moved, _gates(arguments)),
    "info": lambda arguments: Info(arguments.file),
    "demo": lambda arguments: Demo(arguments.case, arguments.output),
}
