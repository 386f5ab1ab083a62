"""`jaxmorph deform`."""

import dataclasses
import importlib
import itertools
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph._advice.inspect import inspected
from jaxmorph._host.package.cores import Beside
from jaxmorph._kernels.compile import quickly_compiled

from ._attempt import Attempt, explain
from ._describe import check_files, described, mesh_of, write_job
from ._method import NamedMethod, patches_of
from ._motion import motion
from ._output import Output, coordinates, count, title, wrapped
from ._requests import Deform
from ._way import Way, faults, say_proven
from ._writing import Writing

Chunks = Iterator[tuple[np.ndarray, jm.Plan]]
"""Nodes and plans of a mesh in chunks, one after the other."""

SMALL = 10_000
"""Points, times steps, up to which compilation takes longer than all else."""

LARGE = 500_000
"""Points from which on the estimate is printed."""


def deform(request: Deform, out: Output) -> int:
    """Reads, moves, judges and writes a mesh; prints all. Returns the exit status."""
    with out.progress(f"reading {title(request.file)}"):
        mesh = mesh_of(request.file, request.zone)
    with quickly_compiled(len(mesh.points) * request.steps <= SMALL):
        return _deform(request, mesh, out)


def _deform(request: Deform, mesh: Mesh, out: Output) -> int:
    attempt, choice, chunks = _attempt(request, mesh, out)
    _foresee(attempt, choice, out)
    nodes, plan, way = _moved(attempt, chunks, out)
    judging = Beside(attempt.judge, way)
    with Writing(way.write, judging.result) as writing:
        inspection, boundary = _inspected(attempt, nodes, plan, way.stored, out)
        with out.progress("judging the cells"):
            verdict = judging.result()
        _tell(attempt, way, verdict, inspection, boundary, out)
        bad = faults(verdict)
        _write_beside(attempt, way, verdict, out)
        if bad:
            explain(attempt, bad, out)
        if bad and not request.allow_inverted:
            out.complain(f"{request.output} is not written; --allow-inverted writes it anyway.")
            return 1
        with out.progress(f"writing {request.output.name}"):
            writing.finish()
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 1 if bad else 0


def _attempt(request: Deform, mesh: Mesh, out: Output) -> tuple[Attempt, NamedMethod, Chunks]:
    """Checks the request, describes it on the terminal, and collects what an attempt needs."""
    _check(request, mesh)
    judging = Beside(jm.judge, mesh, None, request.gates.limits)
    patches = patches_of(request, mesh)
    wall = np.asarray(mesh.points)[patches.nodes]
    moves = motion(request, mesh, patches.nodes)
    with out.progress("choosing sources"):
        choice = patches.method(request.method, request.chunk)
        chunks = patches.chunks(choice, request.chunk)
    n, d = mesh.points.shape
    cells = ", ".join(f"{number} {kind}" for kind, number in mesh.cell_counts.items())
    out.say(f"{title(request.file)}: {n} points in {d}-D, {cells}", points=n)
    described(request, patches, choice, moves.path(wall, 1)[-1], out)
    return Attempt(request, patches, moves, judging), choice, chunks


def _foresee(attempt: Attempt, choice: NamedMethod, out: Output) -> None:
    """Estimates the memory, and warns where it may not fit.

    It is printed if the mesh is large, or with `--verbose`.
    """
    patches, request = attempt.patches, attempt.request
    mesh = patches.mesh.moved(patches.points(choice))
    surface = (patches.nodes, patches.fixed_nodes)
    foreseen = jm.estimate(mesh, *surface, method=choice.method, chunk=request.chunk)
    if foreseen.points >= LARGE or request.speech.verbose:
        out.say(textwrap.fill(str(foreseen), 80, subsequent_indent=" " * 9))
    if foreseen.is_too_large:
        size = f"{foreseen.memory / 1e9:.2g} GB"
        fewer = "fewer --sources, " if choice.entry.sources == "some" else ""
        other = "--method default and" if choice.method.needs_cells else f"{fewer}--chunk and"
        out.warn(f"{size} may not fit into memory; {other} --dtype float32 need less.")


def _moved(attempt: Attempt, chunks: Chunks, out: Output) -> tuple[np.ndarray, jm.Plan, Way]:
    """Moves the points; returns the first chunk's nodes and plan, and the way of all points."""
    steps = attempt.request.steps
    with out.progress("preparing"):
        nodes, plan = next(chunks)
    with out.progress("judging the cells"):
        attempt.judging.result()  # it raises for limits on measures that the cells do not have
    with out.progress(f"deforming in {count(steps, 'step')}") as stage:
        return nodes, plan, attempt.way(itertools.chain([(nodes, plan)], chunks), steps, stage.done)


def _inspected(
    attempt: Attempt, nodes: np.ndarray, plan: jm.Plan, points: np.ndarray, out: Output
) -> tuple[jm.Inspection, jm.BoundaryQuality]:
    """Inspects the motion, warns of contradictions, and judges the boundary."""
    with out.progress("inspecting the motion"):
        u, mesh = attempt.motion.path(attempt.wall, 1)[-1], attempt.patches.mesh
        moved = points[nodes] if attempt.request.steps == 1 and plan.points.dtype == points.dtype else None
        inspection = inspected(plan, u, mesh, nodes, moved)
        for warning in inspection.warnings:
            out.warn(warning)
        return inspection, jm.boundary_quality(plan, points[nodes]).renumbered(nodes)


def _tell(
    attempt: Attempt,
    way: Way,
    verdict: jm.Verdict,
    inspection: jm.Inspection,
    boundary: jm.BoundaryQuality,
    out: Output,
) -> None:
    """Prints tables of quality before and after."""
    wall = _wall_numbers(attempt, way.stored)
    out.say(f"\n{verdict.table(_rows(wall, inspection))}\n")
    say_proven(verdict, way.is_straight, attempt.request.steps, out)
    if boundary.nodes:
        wrapped(out, f"boundary: {boundary}")
        measures = {name: getattr(boundary, name) for name in boundary.nodes}
        out.say(boundary=measures | {"ended": boundary.ended.tolist()})
    start, end = ({number.name: getattr(number, when) for number in wall} for when in ("before", "after"))
    out.say(before=attempt.before.facts | start, after=verdict.facts | end)
    out.say(overshoot=inspection.overshoot, overshoot_behind=inspection.overshoot_behind)
    out.say(gates=verdict.gate_facts)


@dataclasses.dataclass(frozen=True)
class WallNumber:
    """One number of the first grid line at the moving wall, before and after."""

    name: str
    label: str
    before: float
    after: float
    place: str = ""


def _wall_numbers(attempt: Attempt, points: np.ndarray) -> list[WallNumber]:
    """Measures the first grid line at the moving nodes.

    The list is empty where no side of a cell lies there, or no line begins.
    """
    try:
        wall = jm.wall_quality(attempt.patches.mesh, attempt.patches.nodes, points)
    except ValueError:
        return []
    # as mean_angle, max_angle and min_height, by NumPy: nothing is compiled for a table
    angle, height, nodes = np.asarray(wall.angle), np.asarray(wall.height), np.asarray(wall.nodes)
    if not len(nodes):
        return []
    most, least = int(angle.argmax()), int(height.argmin())
    steepest, lowest = (f"   node {nodes[row]} near {coordinates(points[nodes[row]])}" for row in (most, least))
    return [
        WallNumber("mean_wall_angle", "mean wall angle", 0.0, float(angle.mean())),
        WallNumber("max_wall_angle", "max wall angle", 0.0, float(angle[most]), steepest),
        WallNumber("min_first_cell_height", "min first-cell height", 1.0, float(height[least]), lowest),
    ]


def _rows(wall: list[WallNumber], inspection: jm.Inspection) -> list[str]:
    """Formats numbers of the first grid line, and the overshoot, as rows of a table."""
    rows = [f"{row.label:<23}{row.before:>12g}{row.after:>12.5g}{row.place}" for row in wall]
    for label, value in (("overshoot", inspection.overshoot), ("overshoot behind", inspection.overshoot_behind)):
        rows.append(f"{label:<23}{'-':>12}{value:>12.5g}")
    return rows


def _write_beside(attempt: Attempt, way: Way, verdict: jm.Verdict, out: Output) -> None:
    """Writes the job file, lattices and the picture, also if cells are bad."""
    picture = attempt.request.picture
    write_job(attempt.request, out)
    for file in attempt.motion.write_lattices():
        out.say(f"lattice  {file}")
    if picture is not None:
        try:
            with out.progress("drawing"):
                from jaxmorph import plot

                reports = attempt.before.corners, verdict.corners
                plot.picture(picture, way.mesh, way.stored, moving=attempt.patches.nodes, reports=reports)
            out.say(f"picture  {picture}", picture=str(picture))
        except (ValueError, OSError) as error:  # the mesh is worth more
            out.warn(f"no picture: {error}")


def _check(request: Deform, mesh: Mesh) -> None:
    """Raises `ValueError` for a request that is sure to fail, before any work."""
    io.check_output(request.output, mesh)
    check_files(request, mesh)
    if request.picture is not None:
        _check_picture(request.picture, mesh)


def _check_picture(path: Path, mesh: Mesh) -> None:
    """Raises `ValueError` or `ImportError` for a picture that is sure to fail, before any work."""
    endings = (".png",) if mesh.points.shape[1] == 2 else (".png", ".html")
    if path.suffix.lower() not in endings:
        raise ValueError(f"--picture {path}: a picture of this mesh ends in {' or '.join(endings)}.")
    importlib.import_module("jaxmorph.plot")
