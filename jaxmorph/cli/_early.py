"""What is sure to fail, told before JAX is imported and the mesh is read."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxmorph import _demo
from jaxmorph._advice.methods import METHODS, entry
from jaxmorph._host.package.files import check_apart, input_path, is_same, output_path
from jaxmorph._host.package.text import GRADIENTS, LATTICES, SENSITIVITIES, is_folder
from jaxmorph.integrations import su2

from ._job import job_of
from ._parser import flag_of, values_of
from ._requests import MOTIONS, SU2, Deform, Demo, Group, Info, Modes, Quality, Request, Sensitivity

TABLES = ("box", "hicks_henne", "cst")
OWNERS = {
    "axis": ("rotate", "bend"),
    "about": ("rotate", "scale", "bend", "twist"),
    "along": ("bend", "twist"),
    "length": ("bend", "twist"),
    "displacement_from": ("displacement",),
    "lattice": ("box",),
}
"""Flags of a motion without a sense of their own, and the flags that they belong to."""


def check(request: Request) -> None:
    """Raises `ValueError` or `OSError` for a request that no mesh can fulfil."""
    match request:
        case Deform():
            _check_deform(request)
        case Modes():
            _check_modes(request)
        case Sensitivity():
            _check_sensitivity(request)
        case SU2():
            _check_su2(request)
        case Quality():
            _check_input(request.file)
            if request.moved is not None:
                _check_input(request.moved)
            elif request.gates.min_jacobian_ratio is not None:
                raise ValueError("--min-jacobian-ratio compares two meshes: give FILE2.")
        case Info():
            _check_input(request.file)
        case Demo():
            _demo.check(request.case)
            if request.output.exists() and not request.output.is_dir():
                raise ValueError(f"--output {request.output}: is a file, and pictures and meshes go into a folder.")
    _check_values(values_of(request))


def lattice_files(file: Path) -> tuple[Path, Path]:
    """Names the files of a lattice before and after its motion."""
    return file.with_stem(f"{file.stem}_before"), file.with_stem(f"{file.stem}_after")


def is_given(group: Group, name: str) -> bool:
    return getattr(group, name) not in (None, ())


def _inputs_of(request: Deform) -> dict[str, Sequence[Path | str | None]]:
    """Lists the files that a request reads, by what is read from them."""
    displacements = [file for group in request.groups for file in _files_of(group)]
    return {"the mesh is": [request.file], "the job is": [request.job], "the displacements are": displacements}


def _check_deform(request: Deform) -> None:
    if request.decomposed:
        for name in ("picture", "chunk", "zone"):
            if getattr(request, name) is not None:
                raise ValueError(f"--{name} and --decomposed cannot be combined. Remove one of the two.")
        if not request.file.is_dir():
            raise ValueError(f"{request.file}: no folder of an OpenFOAM case.")
    else:
        _check_input(request.file)
    _check_output(request.output, request.file)
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
    _check_surface(request)
    if request.chunk is not None and entry(request.method.method).needs_cells:
        raise ValueError(f"--chunk is not for {request.method.method}, which solves for all nodes at once.")


def _check_motion(group: Group) -> None:
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


def _files_of(group: Group) -> Iterator[Path | str]:
    """Yields the files that a motion reads."""
    files = (getattr(group, name) for name in ("displacement", "displacement_from", *TABLES))
    yield from (file for file in files if isinstance(file, Path))
    yield from (file for file, _ in group.mode)


def _check_modes(request: Modes) -> None:
    _check_input(request.file)
    if request.output.suffix != ".pvd":
        is_folder(request.output)
    output_path(request.output, folder=True)
    for file in request.mode:
        input_path(file).stat()
    _check_surface(request)


def _check_sensitivity(request: Sensitivity) -> None:
    job = job_of(request)
    output_path(request.output, *(SENSITIVITIES if job is None else GRADIENTS))
    inputs = {"the mesh is": [request.file]} if job is None else _inputs_of(job)
    check_apart([("OUT", request.output)], inputs | {"the sensitivities are": [request.sensitivity]})
    _check_input(request.file)
    input_path(request.sensitivity).stat()
    _check_surface(job or request)


def _check_su2(request: SU2) -> None:
    if request.action == "def" and request.sensitivity is not None:
        raise ValueError("--sensitivity is for su2 dot, and su2 def moves the mesh.")
    options = su2.checked_options(request.file, definition=request.definition)
    _check_input(options.mesh_file)
    if request.sensitivity is not None:
        input_path(request.sensitivity).stat()
    if request.action == "def":
        output = request.output or options.output
        _check_output(output, options.mesh_file)
        check_apart([("OUT", output)], {"the config is": [request.file]})
    elif request.output is not None:
        output_path(request.output)
    _check_sources(request)


def _check_input(path: Path) -> None:
    """Raises `ValueError` for a mesh of an unknown ending, `OSError` for one that is not there."""
    if is_folder(input_path(path)) and not path.is_dir():
        raise ValueError(f"{path}: no OpenFOAM case, there is no folder constant/polyMesh in it.")
    path.stat()


def _check_output(path: Path, source: Path) -> None:
    """Raises `ValueError` for a mesh that cannot be written, whatever it is."""
    is_case = is_folder(path)
    output_path(path, folder=is_case)
    if is_same(path, source):
        raise ValueError(f"{path}: the mesh was read from this file; write to another one.")
    is_time = re.fullmatch(r"\d+(\.\d*)?(e[+-]?\d+)?", path.name) is not None
    if is_case and not is_time and path.exists() and (not path.is_dir() or any(os.scandir(path))):
        time = f", or a time folder of the case such as {source / '1'}" if source.is_dir() else ""
        raise ValueError(f"{path}: exists; name a new folder{time}.")


def _check_surface(request: Deform | Modes | Sensitivity) -> None:
    """Raises `ValueError` for motions, patches and sources that fit no mesh."""
    groups = request.groups if isinstance(request, Deform) else ()
    for group in groups:
        try:
            _check_motion(group)
        except ValueError as error:
            raise ValueError(f"{group.title}: {error}" if len(groups) > 1 else str(error)) from None
    both, periodic = sorted(set(request.moving) & set(request.boundary.fixed)), request.boundary.periodic
    if both:
        raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")
    if len(periodic) % 2:
        raise ValueError(f"--periodic {' '.join(periodic)}: name pairs of patches, one after the other.")
    _check_sources(request)


def _check_sources(request: Deform | Modes | Sensitivity | SU2) -> None:
    method, sources = request.method.method, request.method.sources
    if sources is not None and entry(method).sources != "some":
        free = " and ".join(method.name for method in METHODS if method.sources == "some")
        raise ValueError(f"--sources is for the methods {free}; {method} has no sources to choose.")
    if sources is not None and sources < 3:
        raise ValueError(f"--sources must be 3 or more in 2-D, 4 in 3-D, found {sources}.")


def _check_values(values: Any) -> None:
    for name, value in values:
        if name in CHECKS and value is not None:
            CHECKS[name](flag_of(name), value)


def _check_picture(option: str, path: Path) -> None:
    if path.suffix.lower() not in (".png", ".html"):
        raise ValueError(f"{option} {path}: a picture of this mesh ends in .png, in 3-D also in .html.")
    if not path.parent.is_dir():
        raise ValueError(f"{option} {path}: there is no such folder.")


def _check_least(option: str, value: int) -> None:
    if value < 1:
        raise ValueError(f"{option} must be 1 or more, found {value}.")


def _check_finite(option: str, values: Sequence[float]) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"{option} needs finite numbers.")


def _check_limit(option: str, limit: float) -> None:
    if np.isnan(limit):
        raise ValueError(f"{option} needs a number, found nan.")


def _check_angle(option: str, degrees: float) -> None:
    if not np.isfinite(degrees):
        raise ValueError(f"{option} needs an angle in degrees, found {degrees}.")


def _check_vector(option: str, values: Sequence[float]) -> None:
    counts = (1, 2, 3) if option == "--scale" else (2, 3)
    if len(values) not in counts or not np.isfinite(values).all():
        listed = " or ".join([", ".join(map(str, counts[:-1])), "3"])
        raise ValueError(f"{option} needs {listed} numbers, found: {' '.join(f'{x:g}' for x in values)}.")


def _check_direction(option: str, values: Sequence[float]) -> None:
    _check_vector(option, values)
    if not any(values):
        raise ValueError(f"{option} needs a direction, found {' '.join(['0'] * len(values))}.")


CHECKS: dict[str, Callable[[str, Any], None]] = {
    **dict.fromkeys(("steps", "chunk", "zone"), _check_least),
    **dict.fromkeys(("rotate", "bend", "twist"), _check_angle),
    **dict.fromkeys(("scale", "translate", "about"), _check_vector),
    **dict.fromkeys(("axis", "along"), _check_direction),
    **dict.fromkeys(("max_aspect_ratio", "max_non_orthogonality", "max_skewness"), _check_limit),
    **dict.fromkeys(("max_face_skewness", "max_face_aspect_ratio", "min_jacobian_ratio"), _check_limit),
    "amplitude": _check_finite,
    "picture": _check_picture,
}
"""Checks of single flags, by the name of their field."""
