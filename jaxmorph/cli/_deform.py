"""`jaxmorph deform`."""

import importlib
import textwrap
from pathlib import Path

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph._host.package.files import complete, output_path
from jaxmorph._kernels.compile import quickly_compiled

from . import _gates
from ._attempt import Attempt
from ._judged import Judged
from ._method import NamedMethod, Patches, named_method, patches_of
from ._motion import motion
from ._output import Output, title
from ._requests import Deform
from ._tables import compared, count, numbers, wall_numbers, wall_rows
from ._trials import explain

SMALL = 10_000
"""Points, times steps, up to which compilation takes longer than all else."""

LARGE, LONG = 500_000, 30.0
"""Points, and seconds, from which on the estimate is told."""


def deform(request: Deform, out: Output) -> int:
    """Reads, moves, judges, writes; says each on the terminal. Returns the exit status."""
    with out.progress(f"reading {title(request.file)}"):
        mesh = io.read(request.file)
    with quickly_compiled(len(mesh.points) * request.steps <= SMALL):
        return _deform(request, mesh, out)


def _deform(request: Deform, mesh: Mesh, out: Output) -> int:
    attempt, choice, chunks = _attempt(request, mesh, out)
    foreseen = _foreseen(attempt, choice, out)
    points, inspection, boundary = _moved(attempt, chunks, foreseen, out)
    with out.progress("judging the cells", foreseen.judging / 2):
        after, bad = attempt.judge(points)
        wall = wall_numbers(attempt.wall_quality(points))
        rows = wall_rows(wall, inspection, points)
        tables = [compared(attempt.before, after, rows)]
        tables.append(_gates.table(request.gates, attempt.before, after))
    out.say("\n" + "\n\n".join(filter(None, tables)) + "\n")
    if boundary.nodes:
        _wrapped(out, f"boundary: {boundary}")
        kept = {name: getattr(boundary, name) for name in boundary.nodes} | {"ended": boundary.ended.tolist()}
        out.say(boundary=kept)
    start, end = ({each.name: getattr(each, when) for each in wall} for when in ("before", "after"))
    out.say(before=numbers(attempt.before) | start, after=numbers(after) | end)
    out.say(overshoot=inspection.overshoot, overshoot_behind=inspection.overshoot_behind)
    out.say(gates=_gates.facts(request.gates, attempt.before, after))
    _write_beside(attempt, after, out)
    if bad:
        explain(attempt, choice, bad, out)
    if bad and not request.allow_inverted:
        out.complain(f"{request.output} is not written; --allow-inverted writes it all the same.")
        return 1
    with out.progress(f"writing {request.output.name}"):
        after.write(request.output)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 1 if bad else 0


def _attempt(request: Deform, mesh: Mesh, out: Output) -> tuple[Attempt, NamedMethod, jm.Chunks]:
    """Checks the request, describes it on the terminal, and collects what an attempt needs."""
    _check(request, mesh)
    patches = patches_of(request.surface, mesh, request.file)
    if request.chunk is not None and request.chunk < 1:
        raise ValueError(f"--chunk must be 1 or more, found {request.chunk}.")
    if request.steps < 1:
        raise ValueError(f"--steps must be 1 or more, found {request.steps}.")
    wall = np.asarray(mesh.points)[patches.nodes]
    moves = motion(request.groups, mesh, patches.nodes, request.changes)
    with out.progress("choosing sources"):
        choice = named_method(request.method, wall, request.chunk)
        chunks = patches.chunks(choice, request.chunk)
    n, d = mesh.points.shape
    cells = ", ".join(f"{number} {kind}" for kind, number in mesh.cell_counts.items())
    out.say(f"{title(request.file)}: {n} points in {d}-D, {cells}", points=n)
    described(request, patches, choice, moves.path(wall, 1)[-1], out)
    with out.progress("judging the cells"):
        before = Judged(mesh, mesh.points)
        for gate in request.gates:
            gate.extreme(before)  # what cannot be judged is told now
    return Attempt(request, patches, moves, before), choice, chunks


def described(request: Deform, patches: Patches, choice: NamedMethod, u: np.ndarray, out: Output) -> None:
    """Describes what moves, by how much, what stays, and the method; `u` are the displacements of the moving nodes."""
    mesh, way = patches.mesh, np.linalg.norm(u, axis=1)
    for names in dict.fromkeys(tuple(group.patches) for group in request.groups):
        nodes = mesh.patch(*names)
        largest = way[np.searchsorted(patches.nodes, nodes)].max()
        _wrapped(out, f"moving   {', '.join(names)}: {count(len(nodes), 'node')}, by up to {largest:.4g}")
    fixed = np.setdiff1d(patches.fixed_nodes, patches.nodes)
    names = ", ".join(request.surface.fixed) or "no patch"
    _wrapped(out, f"fixed    {names}: {count(len(fixed), 'node')}")
    if patches.symmetry:
        _wrapped(out, f"symmetry {', '.join(patches.symmetry)}: {count(len(mesh.patch(*patches.symmetry)), 'node')}")
    if patches.sliding:
        _wrapped(out, f"sliding  {', '.join(patches.sliding)}: {count(len(mesh.patch(*patches.sliding)), 'node')}")
    for pair in patches.periodic:
        _wrapped(out, f"periodic {pair.patch}, {pair.partner}: {count(len(mesh.patch(str(pair.patch))), 'pair')}")
    out.say(f"method   {choice.name}, {count(request.steps, 'step')}", method=choice.name, steps=request.steps)
    moving = {name: len(mesh.patch(name)) for name in patches.moving}
    out.say(moving=moving, largest=float(way.max()), sources=choice.sources)


def _foreseen(attempt: Attempt, choice: NamedMethod, out: Output) -> jm.Estimate:
    """Estimates memory and time, and prints them if they are large or requested."""
    patches, request = attempt.patches, attempt.request
    mesh = patches.mesh.moved(patches.points(choice))
    surface = (patches.nodes, patches.fixed_nodes)
    foreseen = jm.estimate(mesh, *surface, method=choice.method, steps=request.steps, chunk=request.chunk)
    if foreseen.points >= LARGE or foreseen.seconds >= LONG or request.verbose:
        out.say(textwrap.fill(str(foreseen), 80, subsequent_indent=" " * 9))
    if foreseen.is_too_large:
        size = f"{foreseen.memory / 1e9:.2g} GB"
        fewer = "fewer --sources, " if request.method.name in ("default", "published") else ""
        other = "--method default and" if choice.method.needs_cells else f"{fewer}--chunk and"
        out.warn(f"{size} may not fit into memory; {other} --dtype float32 need less.")
    return foreseen


def _moved(
    attempt: Attempt, chunks: jm.Chunks, foreseen: jm.Estimate, out: Output
) -> tuple[np.ndarray, jm.Inspection, jm.BoundaryQuality]:
    """Moves the points, inspects the motion before, warns of what no method moves well, and judges the moved boundary."""
    steps = attempt.request.steps
    first = foreseen.preparing / len(chunks)
    with out.progress("preparing", first):
        plan = attempt.patches.plan(chunks)
    with out.progress("inspecting the motion"):
        u, mesh = attempt.motion.path(attempt.wall, 1)[-1], attempt.patches.mesh
        inspection = jm.inspect(plan, u, mesh=mesh, nodes=chunks.nodes[0])
        for warning in inspection.warnings:
            out.warn(warning)
    left = foreseen.preparing - first + foreseen.deforming
    with out.progress(f"deforming in {count(steps, 'step')}", left) as stage:
        points, part = attempt.points(chunks, plan, steps, stage.done), chunks.nodes[0]
        return points, inspection, jm.boundary_quality(plan, points[part]).renumbered(part)


def _write_beside(attempt: Attempt, after: Judged, out: Output) -> None:
    """Writes the job file, lattices and the picture, also if cells are bad."""
    picture = attempt.request.picture
    write_job(attempt.request, out)
    for file in attempt.motion.write_lattices():
        out.say(f"lattice  {file}")
    if picture is not None:
        try:
            with out.progress("drawing"):
                from jaxmorph import plot

                reports = attempt.before.report, after.report
                plot.picture(picture, attempt.patches.mesh, after.points, moving=attempt.patches.nodes, reports=reports)
            out.say(f"picture  {picture}", picture=str(picture))
        except (ValueError, OSError) as error:  # the mesh is worth more
            out.warn(f"no picture: {error}")


def write_job(request: Deform, out: Output) -> None:
    """Writes the job file that is asked for."""
    if request.job is not None:
        with complete(request.job[0]) as partial:
            partial.write_bytes(request.job[1].encode())
        out.say(f"job      {request.job[0]}")


def _wrapped(out: Output, text: str) -> None:
    out.say(textwrap.fill(text, 80, subsequent_indent=" " * 9, break_long_words=False, break_on_hyphens=False))


def _check(request: Deform, mesh: Mesh) -> None:
    """Raises `ValueError` for a request that is sure to fail, before any work."""
    io.check_output(request.output, mesh)
    check_files(request, mesh)
    if request.picture is not None:
        _check_picture(request.picture, mesh)


def check_files(request: Deform, mesh: Mesh) -> None:
    """Raises `ValueError` for patches without nodes, and for files that are read or written beside the meshes."""
    for group in request.groups:
        inputs = [
            group.displacement,
            group.displacement_from,
            *(file for file, _ in group.mode),
            group.box,
            group.hicks_henne,
            group.cst,
        ]
        for file in filter(None, inputs):
            if request.output.resolve() == Path(file).resolve():
                raise ValueError(f"{request.output}: the displacements are read from this file; write to another one.")
        if group.lattice is not None:
            io.check_lattice_output(group.lattice)
        if group.patches and not len(mesh.patch(*group.patches)):
            raise ValueError(f"--moving {' '.join(group.patches)}: there are no nodes in it.")
    if request.job is not None:
        job = request.job[0]
        try:
            output_path(job)
        except ValueError as error:
            raise ValueError(f"--save-job {error}") from error
        if job.resolve() == request.output.resolve():
            raise ValueError(f"--save-job {job}: OUT goes there.")


def _check_picture(path: Path, mesh: Mesh) -> None:
    """Raises `ValueError` or `ImportError` for a picture that is sure to fail, before any work."""
    endings = (".png",) if mesh.points.shape[1] == 2 else (".png", ".html")
    if path.suffix.lower() not in endings:
        raise ValueError(f"--picture {path}: a picture of this mesh ends in {' or '.join(endings)}.")
    if not path.parent.is_dir():
        raise ValueError(f"--picture {path}: there is no such folder.")
    importlib.import_module("jaxmorph.plot")
