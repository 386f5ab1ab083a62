"""What is sure to fail, told before JAX is imported and the mesh is read."""

import dataclasses
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from jaxmorph import _demo
from jaxmorph._advice.methods import METHODS, entry
from jaxmorph._host.package.endings import GRADIENTS, LATTICES, SENSITIVITIES, is_folder
from jaxmorph._host.package.files import check_apart, input_path, is_same, output_path
from jaxmorph.integrations import su2

from ._flags import request_of
from ._groups import MOTIONS, Group, as_json, is_json
from ._parser import flag_of
from ._parts import Boundary, Method
from ._requests import SU2, Deform, Demo, Info, Modes, Quality, Request, Sensitivity
from ._vectors import angle_of, direction_of

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
            _check_least("--zone", request.zone)
        case Info():
            _check_input(request.file)
        case Demo():
            _demo.check(request.case)
            if request.output.exists() and not request.output.is_dir():
                raise ValueError(f"--output {request.output}: is a file, and pictures and meshes go into a folder.")


def inputs_of(request: Deform) -> dict[str, Sequence[Path | str | None]]:
    """Lists the files that a request reads, by what is read from them."""
    displacements = [file for group in request.groups for file in _files_of(group)]
    return {"the mesh is": [request.file], "the job is": [request.job], "the displacements are": displacements}


def lattice_files(file: Path) -> tuple[Path, Path]:
    """Names the files of a lattice before and after its motion."""
    return file.with_stem(f"{file.stem}_before"), file.with_stem(f"{file.stem}_after")


def job_of(request: Sensitivity) -> Deform | None:
    """Reads the job that the request names.

    It raises `ValueError` for flags that make no sense with a job, or without one.
    """
    if request.job is None:
        if request.set:
            raise ValueError("--set without --job: it names design variables of a job.")
        return None
    if (request.moving, request.boundary, request.method) != ((), Boundary(), Method()):
        raise ValueError("--job names patches and method. Remove the flags of patches and methods.")
    job = request_of(["deform", str(request.file), str(request.file), "--job", str(request.job)])
    assert isinstance(job, Deform)
    return dataclasses.replace(job, set=(*job.set, *request.set))


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
    check_apart([(name, file) for name, file in outputs if file is not None], inputs_of(request))
    for lattice in lattices:
        output_path(lattice, *LATTICES)
    if request.save_job is not None:
        try:
            output_path(request.save_job)
        except ValueError as error:
            raise ValueError(f"--save-job {error}") from error
    _check_picture(request.picture)
    _check_least("--steps", request.steps)
    _check_least("--chunk", request.chunk)
    _check_least("--zone", request.zone)
    _check_motions(request.groups)
    _check_boundary(request.moving, request.boundary)
    _check_method(request.method, request.chunk)


def _check_motions(groups: Sequence[Group]) -> None:
    """Raises `ValueError` for motions that fit no mesh, `OSError` for files that are not there."""
    for group in groups:
        try:
            _check_motion(group)
        except ValueError as error:
            raise ValueError(f"{group.title}: {error}" if len(groups) > 1 else str(error)) from None


def _check_motion(group: Group) -> None:
    if not any(_is_given(group, name) for name in MOTIONS):
        raise ValueError(f"no motion: give one of {', '.join(map(flag_of, MOTIONS))}.")
    for name, owners in OWNERS.items():
        if _is_given(group, name) and not any(_is_given(group, owner) for owner in owners):
            raise ValueError(f"{flag_of(name)} without {' or '.join(map(flag_of, owners))}.")
    for name in TABLES:
        if getattr(group, name) is not None:
            as_json(name.replace("_", "-"), getattr(group, name))
    for file, amplitude in group.mode:
        if not np.isfinite(amplitude):
            raise ValueError(f"--mode {file} needs an amplitude, found {amplitude}.")
    for file in _files_of(group):
        input_path(file).stat()
    for name in ("rotate", "bend", "twist"):
        if _is_given(group, name):
            angle_of(flag_of(name), getattr(group, name))
    for name in ("scale", "translate", "about", "axis", "along"):
        if _is_given(group, name):
            _check_vector(name, getattr(group, name))


def _check_vector(name: str, values: Sequence[float]) -> None:
    counts = (1, 2, 3) if name == "scale" else (2, 3)
    if len(values) not in counts or not np.isfinite(values).all():
        listed = " or ".join([", ".join(map(str, counts[:-1])), "3"])
        raise ValueError(f"{flag_of(name)} needs {listed} numbers, found: {' '.join(f'{x:g}' for x in values)}.")
    if name in ("axis", "along"):
        direction_of(flag_of(name), list(values), len(values))


def _is_given(group: Group, name: str) -> bool:
    return getattr(group, name) not in (None, ())


def _files_of(group: Group) -> Iterator[Path | str]:
    """Yields the files that a motion reads."""
    yield from (file for file in (group.displacement, group.displacement_from) if file is not None)
    yield from (file for file, _ in group.mode)
    tables = (getattr(group, name) for name in TABLES)
    yield from (table for table in tables if table is not None and not is_json(table))


def _check_modes(request: Modes) -> None:
    _check_input(request.file)
    if request.output.suffix != ".pvd":
        is_folder(request.output)
    output_path(request.output, folder=True)
    for file in request.mode:
        input_path(file).stat()
    if not np.isfinite(request.amplitude).all():
        raise ValueError("--amplitude needs finite numbers.")
    _check_boundary(request.moving, request.boundary)
    _check_method(request.method)


def _check_sensitivity(request: Sensitivity) -> None:
    job = job_of(request)
    output_path(request.output, *(SENSITIVITIES if job is None else GRADIENTS))
    inputs = {"the mesh is": [request.file]} if job is None else inputs_of(job) | {"the job is": [request.job]}
    check_apart([("OUT", request.output)], inputs | {"the sensitivities are": [request.sensitivity]})
    _check_input(request.file)
    input_path(request.sensitivity).stat()
    if job is not None:
        _check_motions(job.groups)
    _check_boundary((job or request).moving, (job or request).boundary)
    _check_method((job or request).method)


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
    _check_method(request.method)


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


def _check_picture(path: Path | None) -> None:
    if path is None:
        return
    if path.suffix.lower() not in (".png", ".html"):
        raise ValueError(f"--picture {path}: a picture of this mesh ends in .png, in 3-D also in .html.")
    if not path.parent.is_dir():
        raise ValueError(f"--picture {path}: there is no such folder.")


def _check_least(option: str, value: int | None) -> None:
    if value is not None and value < 1:
        raise ValueError(f"{option} must be 1 or more, found {value}.")


def _check_boundary(moving: Sequence[str], boundary: Boundary) -> None:
    both = sorted(set(moving) & set(boundary.fixed))
    if both:
        raise ValueError(f"{', '.join(both)} cannot be both --moving and --fixed.")
    if len(boundary.periodic) % 2:
        raise ValueError(f"--periodic {' '.join(boundary.periodic)}: name pairs of patches, one after the other.")


def _check_method(request: Method, chunk: int | None = None) -> None:
    """Raises `ValueError` for sources and chunks that the method does not take."""
    listed = entry(request.method)
    if request.sources is not None and listed.sources != "some":
        free = " and ".join(method.name for method in METHODS if method.sources == "some")
        raise ValueError(f"--sources is for the methods {free}; {request.method} has no sources to choose.")
    if request.sources is not None and request.sources < 3:
        raise ValueError(f"--sources must be 3 or more in 2-D, 4 in 3-D, found {request.sources}.")
    if chunk is not None and listed.needs_cells:
        raise ValueError(f"--chunk is not for {request.method}, which solves for all nodes at once.")
