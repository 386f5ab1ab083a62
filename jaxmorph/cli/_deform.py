"""`jaxmorph deform`."""

import argparse
import dataclasses
import textwrap
import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import Mesh, io

from . import _gates, _picture
from ._chunks import Chunks, chunks
from ._estimate import estimate
from ._files import save, write_moved
from ._gates import Gate, Judged
from ._job import text_of
from ._method import Choice, check_patches, choose, in_double, prepare
from ._motion import Motions, motions
from ._output import Output
from ._tables import compared, count, inverted_cells, numbers

HINTS = {"paper": "more --sources or --steps", "rbf": "more --steps", "dgm": "--method paper"}
"""What to try when cells are inverted."""

TRIAL = 120.0
"""Seconds that a run may have taken for others to be tried after it."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A mesh, the motion of its moving nodes and what was asked for: all that one attempt needs but method and steps."""

    arguments: argparse.Namespace
    mesh: Mesh
    names: list[str]
    moving: np.ndarray
    motion: Motions
    gates: list[Gate]
    before: Judged
    chunks: Chunks

    @property
    def wall(self) -> Float[np.ndarray, "m d"]:
        return np.asarray(self.mesh.points)[self.moving]

    def prepare(self, choice: Choice) -> jm.Plan:
        """The plan of the first chunk."""
        return prepare(self.arguments, self.mesh, self.names, choice.method, next(iter(self.chunks)))

    def points(
        self, plan: jm.Plan, steps: int, done: Callable[[float], None] = lambda _: None
    ) -> Float[np.ndarray, "n d"]:
        """The moved points, always in double precision, from the plan of the first chunk; `done` hears the share that is done."""
        path, points = self.motion.path(self.wall, steps), np.array(self.mesh.points, dtype=float)
        for k, nodes in enumerate(self.chunks):
            if k > 0:
                done(k / len(self.chunks))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # said of the first chunk
                    plan = prepare(self.arguments, self.mesh, self.names, plan.method, nodes)
            moved = jm.deform(plan, path[0]) if steps == 1 else jm.march(plan, path)[1]
            points[nodes] = in_double(np.asarray(self.mesh.points)[nodes], plan, moved, path[-1])
        return points

    def judge(self, points: Float[np.ndarray, "n d"]) -> tuple[Judged, list[str]]:
        """The quality of the moved mesh, and a sentence for each thing that is wrong with it."""
        after = Judged(self.mesh, points, jm.quality(self.mesh, points))
        bad = inverted_cells(after.report)
        return after, [*([bad] if bad else []), *_gates.failures(self.gates, self.before, after)]


def deform(arguments: argparse.Namespace, out: Output) -> int:
    """Reads, moves, judges, writes; says each on the terminal. Returns the exit status."""
    with out.progress(f"reading {arguments.file.name}"):
        mesh = io.read(arguments.file)
    run, choice = _run(arguments, mesh, out)
    foreseen = estimate(mesh, len(mesh.patch(*run.names, *arguments.fixed)), choice, arguments)
    if foreseen.is_large or arguments.verbose:
        out.say(textwrap.fill(str(foreseen), 80, subsequent_indent=" " * 9))
    if foreseen.is_too_large:
        out.warn(
            f"{foreseen.memory / 1e9:.2g} GB may not fit into memory; fewer --sources, --chunk and --dtype float32 need less."
        )
    first = foreseen.preparing / len(run.chunks)
    with out.progress("preparing", first):
        plan = run.prepare(choice)
    with out.progress("inspecting the motion"):
        inspection = jm.inspect(plan, run.motion.path(run.wall, 1)[-1]).renumbered(next(iter(run.chunks)))
        for warning in inspection.warnings:
            out.warn(warning)
    left = foreseen.preparing - first + foreseen.deforming
    with out.progress(f"deforming in {count(arguments.steps, 'step')}", left) as stage:
        points = run.points(plan, arguments.steps, stage.done)
    del plan  # judging needs the memory
    with out.progress("judging the cells", foreseen.judging / 2):
        after, bad = run.judge(points)
        tables = [compared(run.before.report, after.report), _gates.table(run.gates, run.before, after)]
    out.say(
        "\n" + "\n\n".join(filter(None, tables)) + "\n", before=numbers(run.before.report), after=numbers(after.report)
    )
    out.say(gates=_gates.facts(run.gates, run.before, after))
    _write_beside(run, after, out)
    if bad:
        _fail(run, choice, bad, out)
    if bad and not arguments.allow_inverted:
        out.complain(f"{arguments.output} is not written; --allow-inverted writes it all the same.")
        return 1
    with out.progress(f"writing {arguments.output.name}"):
        write_moved(arguments.output, mesh, mesh.moved(points), after.report)
    out.say(f"wrote {arguments.output} ({out.seconds:.1f} s)", output=str(arguments.output))
    return 1 if bad else 0


def _write_beside(run: Run, after: Judged, out: Output) -> None:
    """The job and the picture, of a bad mesh too."""
    job, drawn = run.arguments.save_job, run.arguments.picture
    if job is not None:
        save(job, text_of(run.arguments).encode())
        out.say(f"job      {job}")
    if drawn is not None:
        try:
            with out.progress("drawing"):
                _picture.picture(drawn, run.mesh, run.moving, run.before, after)
            out.say(f"picture  {drawn}", picture=str(drawn))
        except (ValueError, OSError) as error:  # the mesh is worth more
            out.warn(f"no picture: {error}")


def _run(arguments: argparse.Namespace, mesh: Mesh, out: Output) -> tuple[Run, Choice]:
    """What is to be done, all of it checked; says so."""
    groups = arguments.moving or []
    names = list(dict.fromkeys(name for group in groups for name in group.patches))
    _check(arguments, mesh, names)
    moving, fixed = mesh.patch(*names), mesh.patch(*arguments.fixed)
    motion, points = motions(groups, mesh, moving), np.asarray(mesh.points)
    limits = _gates.gates(arguments)
    with out.progress("choosing sources"):
        choice = choose(arguments.method, arguments.sources, points[moving])
    way = np.linalg.norm(motion.path(points[moving], 1)[-1], axis=1)
    cells = ", ".join(f"{len(corners)} {kind}" for kind, corners in mesh.cells.items())
    out.say(f"{arguments.file.name}: {len(points)} points in {points.shape[1]}-D, {cells}", points=len(points))
    for patches in dict.fromkeys(tuple(group.patches) for group in groups):
        nodes = mesh.patch(*patches)
        largest = way[np.searchsorted(moving, nodes)].max()
        _wrapped(out, f"moving   {', '.join(patches)}: {count(len(nodes), 'node')}, by up to {largest:.4g}")
    _wrapped(out, f"fixed    {', '.join(arguments.fixed)}: {count(len(np.setdiff1d(fixed, moving)), 'node')}")
    out.say(f"method   {choice.name}, {count(arguments.steps, 'step')}", method=choice.name, steps=arguments.steps)
    out.say(moving={name: len(mesh.patch(name)) for name in names}, largest=float(way.max()), sources=choice.sources)
    with out.progress("judging the cells"):
        before = Judged(mesh, mesh.points, jm.quality(mesh))
        for gate in limits:
            gate.extreme(before)  # what cannot be judged is told now
    parts = chunks(mesh, np.union1d(moving, fixed), arguments.symmetry, arguments.chunk)
    return Run(arguments, mesh, names, moving, motion, limits, before, parts), choice


def _wrapped(out: Output, text: str) -> None:
    out.say(textwrap.fill(text, 80, subsequent_indent=" " * 9, break_long_words=False, break_on_hyphens=False))


def _check(arguments: argparse.Namespace, mesh: Mesh, names: list[str]) -> None:
    """`ValueError` for what can be known to fail before any work."""
    io.check_output(arguments.output, mesh)
    for group in arguments.moving or []:
        inputs = [group.displacement, group.displacement_from, *(file for file, _ in group.mode), group.box]
        for file in filter(None, inputs):
            if arguments.output.resolve() == type(arguments.output)(file).resolve():
                raise ValueError(
                    f"{arguments.output}: the displacements are read from this file; write to another one."
                )
        if group.patches and not len(mesh.patch(*group.patches)):
            raise ValueError(f"--moving {' '.join(group.patches)}: there are no nodes in it.")
    job = arguments.save_job
    if job is not None and (not job.parent.is_dir() or job.resolve() == arguments.output.resolve()):
        raise ValueError(f"--save-job {job}: {'OUT goes there' if job.parent.is_dir() else 'there is no such folder'}.")
    if arguments.picture is not None:
        _picture.check(arguments.picture, mesh)
    check_patches(arguments, mesh, names)
    if arguments.steps < 1:
        raise ValueError(f"--steps must be 1 or more, found {arguments.steps}.")


def _fail(run: Run, choice: Choice, bad: list[str], out: Output) -> None:
    """Says what is wrong, and what another attempt has found to be right."""
    for sentence in bad[:-1]:
        out.complain(sentence)
    if _gates.hopeless(run.gates, run.before):
        out.complain(bad[-1])
        return
    if out.seconds > TRIAL or not run.arguments.dry_run:
        out.complain(f"{bad[-1]} Try {HINTS[run.arguments.method]}.")
        return
    worked = _tried(run, choice, out)
    hint = (
        f"With {worked} all is well." if worked else f"A dry run with {HINTS[run.arguments.method]} does not cure it."
    )
    out.complain(f"{bad[-1]} {hint}")
    out.say(suggestion=worked)


def _tried(run: Run, choice: Choice, out: Output) -> str:
    """The flags of the first attempt, with more sources or more steps, whose mesh is good; nothing when none is."""
    asked, most = run.arguments, len(run.wall)
    more = [min(factor * choice.sources, most) for factor in (2, 4)] if asked.method == "paper" else [None, None]
    trials = [(more[0], asked.steps), (None, 2 * asked.steps), (more[1], 4 * asked.steps)]
    trials = list(dict.fromkeys(trial for trial in trials if trial != (None, asked.steps)))
    if asked.method == "dgm":
        trials = [(None, asked.steps), (None, 4 * asked.steps)]
    with out.progress("trying others") as stage:
        for done, (sources, steps) in enumerate(trials):
            method = "paper" if asked.method == "dgm" else asked.method
            sources = asked.sources if sources is None else sources
            if _works(run, method, sources, steps):
                flags = ["--method paper"] if method != asked.method else []
                flags += [f"--sources {sources}"] if sources != asked.sources else []
                return " ".join([*flags, *([f"--steps {steps}"] if steps != asked.steps else [])])
            stage.done((done + 1) / len(trials))
    return ""


def _works(run: Run, method: str, sources: int | None, steps: int) -> bool:
    """Whether the mesh is good by another method; not so where that one refuses."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            plan = run.prepare(choose(method, sources, run.wall))
        except ValueError:
            return False
        return not run.judge(run.points(plan, steps))[1]
