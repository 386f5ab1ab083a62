"""`jaxmorph deform`: one mesh, one motion, and other methods where it fails."""

import dataclasses
import importlib
import itertools
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph._advice.cures import Cure, cures
from jaxmorph._advice.inspect import inspected
from jaxmorph._host.package.cores import Beside
from jaxmorph._host.package.files import complete
from jaxmorph._kernels.compile import quickly_compiled

from ._job import text_of
from ._method import NamedMethod, Patches, mesh_of, patches_of
from ._motion import Motion, motion
from ._output import Output, coordinates, count, title, wrapped
from ._requests import Deform
from ._way import Way, faults, followed, in_double, say_proven, writing

Chunks = Iterator[tuple[Int[np.ndarray, " c"], jm.Plan]]
"""Nodes and plans of a mesh in chunks, one after the other."""

SMALL = 10_000
"""Points, times steps, below which compile time dominates."""

PATIENCE = 120.0
"""Seconds that an attempt may have taken for others to be tried after it."""


@dataclasses.dataclass(frozen=True)
class Attempt:
    """All that an attempt needs but the method and the steps.

    `judging` judges the undeformed mesh in another thread.
    """

    request: Deform
    patches: Patches
    motion: Motion
    judging: Beside[jm.Verdict]

    @property
    def before(self) -> jm.Verdict:
        """The verdict on the undeformed mesh. Raises `ValueError` for what cannot be judged."""
        return self.judging.result()

    @property
    def base(self) -> Float[np.ndarray, "n d"]:
        """The undeformed points."""
        return np.asarray(self.patches.mesh.points, dtype=float)

    @property
    def wall(self) -> Float[np.ndarray, "m d"]:
        """The undeformed points of the moving nodes."""
        return self.base[self.patches.nodes]

    def way(
        self,
        chunks: Chunks,
        steps: int,
        done: Callable[[float], None] | None = None,
    ) -> Way:
        """Moves the points chunk by chunk, in double precision; `done` takes the finished share.

        Steps before the last one are kept for `--proven` alone.
        """
        path = self.motion.path(self.wall, steps)
        ends = {step: self.base.copy() for step in (range(steps) if self.request.gates.proven else [steps - 1])}
        is_moved, is_straight = np.zeros(len(self.base), dtype=bool), True
        for nodes, plan in chunks:
            here = np.flatnonzero(np.isin(nodes, self.patches.nodes))
            of_wall = np.searchsorted(self.patches.nodes, nodes[here])
            for step, moved in enumerate(followed(plan, path)):
                if step in ends:
                    u = path[step][of_wall]
                    ends[step][nodes] = in_double(self.base[nodes], moved, here, u, plan.method.exact)
            is_moved[nodes] = True
            is_straight &= plan.is_linear
            if done is not None:
                done(is_moved.mean())
        return Way(self.request.output, self.patches.mesh, tuple(ends.values()), is_straight)

    def judge(self, way: Way) -> jm.Verdict:
        return way.judge(self.request.gates.limits, self.before)


def deform(request: Deform, out: Output) -> int:
    """Reads, moves, judges and writes a mesh; prints all. Returns the exit status."""
    with out.progress(f"reading {title(request.file)}"):
        mesh = mesh_of(request.file, request.zone)
    with quickly_compiled(len(mesh.points) * request.steps <= SMALL):
        return _deform(request, mesh, out)


def _deform(request: Deform, mesh: Mesh, out: Output) -> int:
    attempt, chunks = _attempt(request, mesh, out)
    nodes, plan, way = _moved(attempt, chunks, out)
    judging = Beside(attempt.judge, way)
    with writing(way.write, judging.result) as finish:
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
            finish()
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 1 if bad else 0


def _attempt(request: Deform, mesh: Mesh, out: Output) -> tuple[Attempt, Chunks]:
    """Checks the request, describes it on the terminal, and collects what an attempt needs."""
    _check(request, mesh)
    judging = Beside(jm.judge, mesh, None, request.gates.limits)
    patches = patches_of(request, mesh)
    wall = np.asarray(mesh.points)[patches.nodes]
    moves = motion(request, mesh, patches.nodes)
    with out.progress("choosing sources"):
        choice = patches.method(request.method)
        chunks = patches.chunks(choice.method, request.chunk)
    n, d = mesh.points.shape
    cells = ", ".join(f"{number} {kind}" for kind, number in mesh.cell_counts.items())
    out.say(f"{title(request.file)}: {n} points in {d}-D, {cells}", points=n)
    described(request, patches, choice, moves.path(wall, 1)[-1], out)
    return Attempt(request, patches, moves, judging), chunks


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

                reports: Any = attempt.before.corners, verdict.corners
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


def check_files(request: Deform, mesh: Mesh) -> None:
    """Raises `ValueError` for patches without nodes, `ImportError` for lattices without VTK."""
    for group in request.groups:
        if group.lattice is not None:
            io.check_lattice_output(group.lattice)
        if group.patches and not len(mesh.patch(*group.patches)):
            raise ValueError(f"--moving {' '.join(group.patches)}: there are no nodes in it.")


def described(request: Deform, patches: Patches, choice: NamedMethod, u: np.ndarray, out: Output) -> None:
    """Describes what moves, by how much, what stays, and the method.

    `u` are the displacements of the moving nodes.
    """
    mesh, way = patches.mesh, np.linalg.norm(u, axis=1)
    for names in dict.fromkeys(tuple(group.patches) for group in request.groups):
        nodes = mesh.patch(*names)
        largest = way[np.searchsorted(patches.nodes, nodes)].max()
        wrapped(out, f"moving   {', '.join(names)}: {count(len(nodes), 'node')}, by up to {largest:.4g}")
    names = ", ".join(request.boundary.fixed) or "no patch"
    wrapped(out, f"fixed    {names}: {count(len(patches.fixed_nodes), 'node')}")
    if patches.symmetry:
        wrapped(out, f"symmetry {', '.join(patches.symmetry)}: {count(len(mesh.patch(*patches.symmetry)), 'node')}")
    if patches.sliding:
        wrapped(out, f"sliding  {', '.join(patches.sliding)}: {count(len(mesh.patch(*patches.sliding)), 'node')}")
    for pair in patches.periodic:
        wrapped(out, f"periodic {pair.patch}, {pair.partner}: {count(len(mesh.patch(str(pair.patch))), 'pair')}")
    out.say(f"method   {choice.name}, {count(request.steps, 'step')}", method=choice.name, steps=request.steps)
    moving = {name: len(mesh.patch(name)) for name in patches.moving}
    out.say(moving=moving, largest=float(way.max()), sources=choice.sources)


def write_job(request: Deform, out: Output) -> None:
    """Writes the job file that is asked for."""
    if request.save_job is not None:
        with complete(request.save_job) as partial:
            partial.write_bytes(text_of(request, request.save_job.parent).encode())
        out.say(f"job      {request.save_job}")


def explain(attempt: Attempt, bad: list[str], out: Output) -> None:
    """Prints what is wrong, and other flags that cure it, if an attempt with them succeeds."""
    request = attempt.request
    for sentence in bad[:-1]:
        out.complain(sentence)
    if any(gate.beyond for gate in attempt.before.gates):  # no way of moving the mesh cures it
        out.complain(bad[-1])
        return
    if out.seconds > PATIENCE or not request.dry_run:
        out.complain(f"{bad[-1]} No other flags were tried.")
        return
    trials, worked = _trials(attempt), ""
    with out.progress("trying others") as stage:
        for k, cure in enumerate(trials):
            if _works(attempt, cure):
                worked = _flags(attempt, cure)
                break
            stage.done((k + 1) / len(trials))
    tried = ", ".join(_flags(attempt, cure) for cure in trials)
    advice = f"{worked} works." if worked else f"A dry run with each of {tried} does not cure it."
    out.complain(f"{bad[-1]} {advice}" if trials else bad[-1])
    out.say(suggestion=worked)


def _trials(attempt: Attempt) -> list[Cure]:
    """Lists cures in the order in which they are tried: the default method first."""
    patches, request = attempt.patches, attempt.request
    u = attempt.motion.path(attempt.wall, 1)[-1]
    found = [Cure(method="default"), *cures(patches.mesh, patches.nodes, patches.fixed_nodes, u)]
    found = [dataclasses.replace(cure, steps=cure.steps * request.steps) for cure in found]
    return [cure for cure in found if cure.method != request.method.method]


def _flags(attempt: Attempt, cure: Cure) -> str:
    flags = [f"--sliding {' '.join(cure.sliding)} in place of --fixed"] if cure.sliding else []
    flags += [f"--method {cure.method}"] if cure.method else []
    return " ".join([*flags, *([f"--steps {cure.steps}"] if cure.steps != attempt.request.steps else [])])


def _works(attempt: Attempt, cure: Cure) -> bool:
    """Checks whether a cure leaves the mesh good. False if it is refused."""
    patches, method = attempt.patches, attempt.request.method
    fixed = tuple(name for name in patches.fixed if name not in cure.sliding)
    attempt = dataclasses.replace(
        attempt, patches=dataclasses.replace(patches, fixed=fixed, sliding=(*patches.sliding, *cure.sliding))
    )
    method = dataclasses.replace(method, method=cure.method or method.method)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            chunks = attempt.patches.chunks(attempt.patches.method(method).method, attempt.request.chunk)
            way = attempt.way(chunks, cure.steps)
        except (ValueError, ImportError):  # ImportError: a solver for large 3-D meshes is not installed
            return False
        return attempt.judge(way).ok
