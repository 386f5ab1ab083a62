"""What is sure to fail, told before JAX is imported and the mesh is read."""

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxmorph import METHODS
from jaxmorph._host.package.text import GRADIENTS, SENSITIVITIES
from jaxmorph.extend import input_path, output_path, patch_names
from jaxmorph.io.kinds import is_folder

from ._job import job_of
from ._parser import (
    ConfigFile,
    Folder,
    MeshFile,
    NewMesh,
    Picture,
    Written,
    flag_of,
    kind_of,
    values_of,
)
from ._requests import (
    AUTO,
    MOTIONS,
    SU2,
    Deform,
    ExportRequest,
    MethodFlags,
    MotionFlags,
    Planned,
    Quality,
    Request,
    SensitivityRequest,
    list_markers,
)

Files = list[tuple[str, Path]]
"""Files by the flag that names them."""

OWNERS = {
    "axis": ("rotate", "bend"),
    "about": ("rotate", "scale", "bend", "twist"),
    "along": ("bend", "twist"),
    "length": ("bend", "twist"),
    "onto_scale": ("onto",),
    "onto_length": ("onto",),
    "onto_angle": ("onto",),
    "onto_features": ("onto",),
}
"""Flags that make sense only beside others, and these others."""


def check_request(request: Request) -> None:
    inputs = _check_files(request, INPUTS)
    outputs = _check_files(request, OUTPUTS)
    if method := getattr(request, "method", None):
        _check_method(method)
    if type(request) in OF_COMMAND:
        OF_COMMAND[type(request)](request, inputs, outputs)
    check_apart(inputs, outputs)
    if isinstance(request, Deform | Planned):
        both = [name for name in request.moving if name in request.boundary.fixed]
        if both:
            raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")
        names = itertools.chain(request.moving, *vars(request.boundary).values())
        if request.file.suffix.lower() == ".su2" and (listed := list_markers(request.file)):
            patch_names(tuple(names), listed, {})


def _check_files(request: Any, kinds: tuple[Any, ...]) -> Files:
    files: Files = []
    for field, value in values_of(request):
        kind = kind_of(field) or Path
        metavar = field.metadata["settings"].get("metavar")
        flag = metavar if field.metadata["names"] == ("",) else flag_of(field.name)
        for path in _paths(value) if kind in kinds else ():
            files.append((flag, path))
            try:
                CHECKS[kind](path)
            except ValueError as error:
                raise ValueError(f"{flag} {error}") from None
    return files


def _paths(value: Any) -> list[Path]:
    if isinstance(value, tuple):
        return [path for entry in value for path in _paths(entry)]
    return [value] if isinstance(value, Path) else []


def _check_mesh(path: Path) -> None:
    if not input_path(path).is_file():
        is_folder(path)  # raises for an unknown ending
    path.stat()


def _check_folder(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise ValueError(f"{path}: is a file, and pictures and meshes go into a folder.")


CHECKS: dict[Any, Callable[[Path], Any]] = {
    Path: lambda path: input_path(path).stat(),
    MeshFile: _check_mesh,
    NewMesh: lambda path: output_path(path, folder=path.suffix != ".pvd" and is_folder(path)),
    Written: output_path,
    Picture: lambda path: output_path(path, ".png"),
    Folder: _check_folder,
    ConfigFile: lambda path: None,
}

INPUTS = (Path, MeshFile, ConfigFile)
OUTPUTS = (NewMesh, Written, Picture, Folder)


def check_apart(inputs: Files, outputs: Files) -> None:
    """Raises `ValueError` for an output that is an input, and for two outputs in one file."""
    taken: dict[Any, str] = {_identity(path): name for name, path in inputs}
    for name, path in outputs:
        file = _identity(path)
        if file in taken:
            raise ValueError(f"{name} {path} is the file of {taken[file]}. Write to another file.")
        taken[file] = name


def _identity(path: Path) -> Any:
    try:
        about = os.stat(path)
    except OSError:
        return os.path.realpath(path)
    return about.st_dev, about.st_ino  # those of links are the same


def is_given(group: MotionFlags, name: str) -> bool:
    return getattr(group, name) not in (None, ())


def _check_deform(request: Deform, *_: Files) -> None:
    for name in ("picture", "chunk", "zone", "tags"):
        if request.decomposed and getattr(request, name) is not None:
            raise ValueError(
                f"--{name} and --decomposed cannot be combined. Remove one of the two."
            )
    if request.decomposed and not is_folder(request.output):
        raise ValueError(
            f"OUT {request.output}: a decomposed case is written to a new folder, not to a file."
        )
    for name in ("chunk", "decomposed"):
        if getattr(request, name) and request.steps == AUTO:
            raise ValueError(
                f"--{name} needs a number of --steps: {AUTO} judges the whole mesh after each "
                "trial."
            )
    for name in ("chunk", "decomposed", "zone"):
        if getattr(request, name) and request.remesh:
            raise ValueError(f"--{name} and --remesh cannot be combined. Remove one of the two.")
    _check_motions(request)


def _check_method(request: MethodFlags) -> None:
    if request.sources is not None and METHODS[request.method].sources != "some":
        free = " and ".join(name for name, method in METHODS.items() if method.sources == "some")
        raise ValueError(
            f"--sources is for the methods {free}; {request.method} has no sources to choose."
        )


def _check_motions(request: Deform) -> None:
    for group in request.groups:
        title = f"{group.title}: " if len(request.groups) > 1 else ""
        given = [name for name in (*MOTIONS, *OWNERS) if is_given(group, name)]
        if not set(given) & set(MOTIONS):
            raise ValueError(f"{title}no motion: give one of {', '.join(map(flag_of, MOTIONS))}.")
        for name in given:
            if not set(OWNERS.get(name, given)) & set(given):
                raise ValueError(
                    f"{title}{flag_of(name)} without {' or '.join(map(flag_of, OWNERS[name]))}."
                )


def _check_sensitivity(request: SensitivityRequest, inputs: Files, _: Files) -> None:
    job = job_of(request)
    output_path(request.output, *(SENSITIVITIES if job is None else GRADIENTS))
    if job is not None:
        _check_method(job.method)
        _check_motions(job)
        inputs += _check_files(job, INPUTS)


def _check_export(request: ExportRequest, *_: Files) -> None:
    if request.method.dtype == "float32":
        raise ValueError(
            "--dtype float32: a plan in a file is in double precision. Leave the flag away."
        )
    plans = f"plans of a case are {request.file}/constant/jaxmorph.plan."
    if is_folder(request.file) and request.output is not None:
        raise ValueError(f"{request.output}: leave OUT out; {plans}")
    if not is_folder(request.file) and request.output is None:
        raise ValueError("OUT is missing: name the file of the plan, such as wing.plan.")


def _check_su2(request: SU2, *_: Files) -> None:
    if request.action == "shims":
        if request != SU2(speech=request.speech, action="shims", file=request.file):
            raise ValueError("su2 shims takes a folder alone.")
        return
    input_path(request.file).stat()
    if request.action == "def" and request.sensitivity is not None:
        raise ValueError("--sensitivity is for su2 dot, and su2 def moves the mesh.")
    if request.action == "dot" and request.picture is not None:
        raise ValueError("--picture is for su2 def, and su2 dot moves no mesh.")


def _check_quality(request: Quality, *_: Files) -> None:
    if request.moved is None and request.gates.min_jacobian_ratio is not None:
        raise ValueError("--min-jacobian-ratio compares two meshes: give FILE2.")


OF_COMMAND: dict[Any, Callable[[Any, Files, Files], None]] = {
    Deform: _check_deform,
    SensitivityRequest: _check_sensitivity,
    ExportRequest: _check_export,
    SU2: _check_su2,
    Quality: _check_quality,
}
