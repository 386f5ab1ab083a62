"""What is sure to fail, told before JAX is imported and the mesh is read."""

import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxmorph import METHODS
from jaxmorph._host.package.text import GRADIENTS, LATTICES, SENSITIVITIES, is_folder
from jaxmorph.extend import input_path, output_path
from jaxmorph.integrations import su2

from ._job import job_of
from ._names import check_names
from ._parser import flag_of, values_of
from ._requests import (
    AUTO,
    LIMITS,
    MOTIONS,
    SU2,
    Convert,
    Deform,
    Demo,
    ExportRequest,
    Info,
    MethodFlags,
    ModesRequest,
    MotionFlags,
    NativeRequest,
    Quality,
    Request,
    SensitivityRequest,
)

OWNERS = {
    "axis": ("rotate", "bend"),
    "about": ("rotate", "scale", "bend", "twist"),
    "along": ("bend", "twist"),
    "length": ("bend", "twist"),
    "displacement_from": ("displacement",),
    "lattice": ("box",),
}
"""Flags that make sense only beside others, and these others."""


def check(request: Request) -> None:
    OF_COMMAND[type(request)](request)
    _check_values(values_of(request))
    if isinstance(request, Deform | ModesRequest | SensitivityRequest | ExportRequest | SU2):
        _check_sources(request.method)
    if isinstance(request, Deform | ModesRequest | SensitivityRequest | ExportRequest):
        check_names(request.file, [*request.moving, *itertools.chain(*vars(request.boundary).values())])


def check_apart(
    outputs: Iterable[tuple[str, Path]], inputs: Mapping[str, Iterable[str | os.PathLike[str] | None]]
) -> None:
    """Raises `ValueError` for an output that is an input, and for two outputs in one file. Outputs
    come with the names that messages give them, inputs by their role: `the mesh is`.
    """
    read = {_identity(file): what for what, files in inputs.items() for file in files if file is not None}
    written: dict[Any, str] = {}
    for name, path in outputs:
        file = _identity(path)
        if file in read:
            raise ValueError(f"{name} {path}: {read[file]} read from this file; write to another one.")
        if file in written:
            raise ValueError(f"{name} {path} is the file of {written[file]}. Write to another file.")
        written[file] = name


def _identity(path: str | os.PathLike[str]) -> Any:
    try:
        about = os.stat(path)
    except OSError:
        return os.path.realpath(path)
    return about.st_dev, about.st_ino  # those of links are the same


def lattice_files(file: Path) -> tuple[Path, Path]:
    return file.with_stem(f"{file.stem}_before"), file.with_stem(f"{file.stem}_after")


def is_given(group: MotionFlags, name: str) -> bool:
    return getattr(group, name) not in (None, ())


def _check_deform(request: Deform) -> None:
    _check_way(request)
    _check_mesh_output(request.output)
    outputs = [("OUT", request.output), ("--save-job", request.save_job), ("--picture", request.picture)]
    lattices = [group.lattice for group in request.groups if group.lattice is not None]
    outputs += [("--lattice", file) for lattice in lattices for file in lattice_files(lattice)]
    check_apart([(name, file) for name, file in outputs if file is not None], _inputs_of(request))
    for lattice in lattices:
        output_path(lattice, *LATTICES)
    if request.save_job is not None:
        try:
            output_path(request.save_job)
        except ValueError as error:
            raise ValueError(f"--save-job {error}") from error
    _check_groups(request)


def _check_way(request: Deform) -> None:
    for name in ("picture", "chunk", "zone"):
        if request.decomposed and getattr(request, name) is not None:
            raise ValueError(f"--{name} and --decomposed cannot be combined. Remove one of the two.")
    if not request.decomposed:
        _check_input(request.file)
    elif not request.file.is_dir():
        raise ValueError(f"{request.file}: no folder of an OpenFOAM case.")
    for name in ("chunk", "decomposed"):
        if getattr(request, name) and request.steps == AUTO:
            raise ValueError(f"--{name} needs a number of --steps: {AUTO} judges the whole mesh after each trial.")
        if getattr(request, name) and METHODS[request.method.method].needs_cells:
            raise ValueError(f"--{name} is not for {request.method.method}, which solves for all nodes at once.")


def _check_sources(request: MethodFlags) -> None:
    if request.sources is not None and METHODS[request.method].sources != "some":
        free = " and ".join(name for name, method in METHODS.items() if method.sources == "some")
        raise ValueError(f"--sources is for the methods {free}; {request.method} has no sources to choose.")


def _check_groups(request: Deform) -> None:
    for group in request.groups:
        try:
            _check_motion(group)
        except ValueError as error:
            raise ValueError(f"{group.title}: {error}" if len(request.groups) > 1 else str(error)) from None


def _check_motion(group: MotionFlags) -> None:
    if not any(is_given(group, name) for name in MOTIONS):
        raise ValueError(f"no motion: give one of {', '.join(map(flag_of, MOTIONS))}.")
    for name, owners in OWNERS.items():
        if is_given(group, name) and not any(is_given(group, owner) for owner in owners):
            raise ValueError(f"{flag_of(name)} without {' or '.join(map(flag_of, owners))}.")
    _check_values(vars(group).items())
    for file, amplitude in group.mode:
        if not np.isfinite(amplitude):
            raise ValueError(f"--mode {file} needs an amplitude, found {amplitude}.")
    for file in _files_of(group):
        input_path(file).stat()


def _inputs_of(request: Deform) -> dict[str, Sequence[Path | str | None]]:
    displacements = [file for group in request.groups for file in _files_of(group)]
    return {"the mesh is": [request.file], "the job is": [request.job], "the displacements are": displacements}


def _files_of(group: MotionFlags) -> Iterator[Path | str]:
    files = (group.displacement, group.displacement_from, group.box, group.hicks_henne, group.cst)
    yield from (file for file in files if isinstance(file, Path))
    yield from (file for file, _ in group.mode)


def _check_modes(request: ModesRequest) -> None:
    _check_input(request.file)
    _check_mesh_output(request.output)
    for file in request.mode:
        input_path(file).stat()


def _check_sensitivity(request: SensitivityRequest) -> None:
    job = job_of(request)
    output_path(request.output, *(SENSITIVITIES if job is None else GRADIENTS))
    inputs = {"the mesh is": [request.file]} if job is None else _inputs_of(job)
    check_apart([("OUT", request.output)], inputs | {"the sensitivities are": [request.sensitivity]})
    _check_input(request.file)
    input_path(request.sensitivity).stat()
    if job is not None:
        _check_groups(job)
        _check_sources(job.method)


def _check_export(request: ExportRequest) -> None:
    _check_input(request.file)
    if request.method.dtype == "float32":
        raise ValueError("--dtype float32: a plan in a file is in double precision. Leave the flag away.")
    if METHODS[request.method.method].needs_cells:
        raise ValueError(f"--method {request.method.method} solves on the cells, which a plan in a file does not hold.")
    if is_folder(request.file):
        if request.output is not None:
            raise ValueError(
                f"{request.output}: leave OUT out; plans of a case are {request.file}/constant/jaxmorph.plan."
            )
    elif request.output is None:
        raise ValueError("OUT is missing: name the file of the plan, such as wing.plan.")
    else:
        output_path(request.output)
        check_apart([("OUT", request.output)], {"the mesh is": [request.file]})


def _check_su2(request: SU2) -> None:
    if request.action == "def" and request.sensitivity is not None:
        raise ValueError("--sensitivity is for su2 dot, and su2 def moves the mesh.")
    if request.action == "dot" and request.picture is not None:
        raise ValueError("--picture is for su2 def, and su2 dot moves no mesh.")
    options = su2.checked_options(request.file, definition=request.definition)
    _check_input(options.mesh_file)
    if request.sensitivity is not None:
        input_path(request.sensitivity).stat()
    if request.action == "def":
        output = request.output or options.output
        _check_mesh_output(output)
        inputs = {"the config is": [request.file], "the mesh is": [options.mesh_file]}
        check_apart([("OUT", output), *_picture_of(request)], inputs)
    elif request.output is not None:
        output_path(request.output)


def _picture_of(request: SU2 | Quality | Info) -> list[tuple[str, Path]]:
    return [] if request.picture is None else [("--picture", request.picture)]


def _check_info(request: Info) -> None:
    _check_input(request.file)
    check_apart(_picture_of(request), {"the mesh is": [request.file]})


def _check_quality(request: Quality) -> None:
    _check_input(request.file)
    check_apart(_picture_of(request), {"the mesh is": [request.file, request.moved]})
    if request.moved is not None:
        _check_input(request.moved)
    elif request.gates.min_jacobian_ratio is not None:
        raise ValueError("--min-jacobian-ratio compares two meshes: give FILE2.")


def _check_convert(request: Convert) -> None:
    _check_input(request.file)
    _check_mesh_output(request.output)
    check_apart([("OUT", request.output)], {"the mesh is": [request.file]})


def _check_demo(request: Demo) -> None:
    if request.output.exists() and not request.output.is_dir():
        raise ValueError(f"--output {request.output}: is a file, and pictures and meshes go into a folder.")


OF_COMMAND: dict[Any, Callable[[Any], None]] = {
    Deform: _check_deform,
    ModesRequest: _check_modes,
    SensitivityRequest: _check_sensitivity,
    ExportRequest: _check_export,
    NativeRequest: lambda request: None,
    SU2: _check_su2,
    Quality: _check_quality,
    Info: _check_info,
    Convert: _check_convert,
    Demo: _check_demo,
}


def _check_input(path: Path) -> None:
    if is_folder(input_path(path)) and not path.is_dir():
        raise ValueError(f"{path}: no OpenFOAM case, there is no folder constant/polyMesh in it.")
    path.stat()


def _check_mesh_output(path: Path) -> None:
    output_path(path, folder=path.suffix != ".pvd" and is_folder(path))


def _check_values(values: Iterable[tuple[str, Any]]) -> None:
    for name, value in values:
        for names, is_good, message in CHECKS:
            if value is not None and name in names.split() and not is_good(value):
                found = " ".join(f"{x:g}" for x in value) if isinstance(value, list | tuple) else value
                raise ValueError(f"{flag_of(name)} {message.format(found)}")


def _is_vector(values: Sequence[float], *counts: int) -> bool:
    return len(values) in (*counts, 2, 3) and bool(np.isfinite(values).all())


CHECKS: tuple[tuple[str, Callable[[Any], Any], str], ...] = (
    ("steps chunk zone", lambda number: number == AUTO or number >= 1, "must be 1 or more, found {}."),
    ("rotate bend twist", np.isfinite, "needs an angle in degrees, found {}."),
    ("scale", lambda values: _is_vector(values, 1), "needs 1, 2 or 3 numbers, found: {}."),
    ("translate about axis along", _is_vector, "needs 2 or 3 numbers, found: {}."),
    ("axis along", any, "needs a direction, found {}."),
    (" ".join(LIMITS), lambda limit: not np.isnan(limit), "needs a number, found {}."),
    ("amplitude", lambda values: np.isfinite(values).all(), "needs finite numbers, found {}."),
    (
        "picture",
        lambda path: path.suffix.lower() in (".png", ".html"),
        "{}: a picture of this mesh ends in .png, in 3-D also in .html.",
    ),
    ("picture", lambda path: path.parent.is_dir(), "{}: there is no such folder."),
)
"""Checks of single flags: the names of their fields, what is good, and the message."""
