"""`jaxmorph deform`: one mesh, one motion, and other methods where it fails."""

import dataclasses
import functools
import itertools
import re
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph.extend import complete, quickly_compiled, wall_crossings

from ._job import text_of
from ._method import Chunks, Patches, describe_method, patches_of
from ._motion import Motion, motion
from ._output import Output, format_place, plural, title, wrap
from ._relay import move_over_meshes
from ._requests import AUTO, Deform
from ._way import (
    Points,
    Way,
    check_picture,
    draw,
    faults,
    finish,
    in_background,
    move_in_steps,
    paint,
    say_verdict,
    warn_of_size,
)
from ._zones import load_mesh

SMALL_WORK = 10_000
"""Points, times steps, below which compile time dominates."""

MOST_TRIED = 16
"""Steps that `--steps auto` tries at most."""

ON_TARGET = 1e-9
"""Distance from a target, over the wall's extent, of nodes that are on it."""

OVERSHOOT = "   farther than the wall moves"
"""Beside an overshoot above 1."""

PATIENCE = 120.0
"""Seconds of an attempt after which no other is tried."""

MeasureRow = tuple[str, int, float, str]
"""A row of the table of measures: label, before, after and place."""


class Distances(NamedTuple):
    """How far nodes (m,) of a wall are from its target, before and after. At `place` is the
    farthest; it is empty where all are on the target.
    """

    before: np.ndarray
    after: np.ndarray
    place: str

    def rows(self, target: str) -> list[tuple[str, float, float, str]]:
        told = self.facts()
        largest = (f"distance from {target}", told["before"], told["after"], self.place)
        middle = ("median distance", told["median_before"], told["median_after"], "")
        return [largest, middle] if self.place else [largest]

    def facts(self) -> dict[str, float]:
        return {
            "before": float(self.before.max()),
            "after": float(self.after.max()),
            "median_before": float(np.median(self.before)),
            "median_after": float(np.median(self.after)),
        }


@dataclasses.dataclass(frozen=True)
class Attempt:
    """All that an attempt needs; `judging` runs in another thread.

    With `reached`, the steps of the request were found: they keep the cells for this share of it.
    """

    request: Deform
    patches: Patches
    motion: Motion
    judging: Future[jm.Verdict]
    reached: float | None = None

    @property
    def before(self) -> jm.Verdict:
        return self.judging.result()

    @property
    def base(self) -> Points:
        return np.asarray(self.patches.mesh.points, dtype=float)

    def path(self, steps: int = 1) -> Float[np.ndarray, "k m d"]:
        return self.motion.path(self.base[self.patches.nodes], steps)

    def way(
        self, chunks: Chunks, steps: int, done: Callable[[float], None] = lambda share: None
    ) -> Way:
        """Moves the points by chunks, in double precision; only `--proven` keeps all steps."""
        path = self.path(steps)
        base = self.base
        wall = self.patches.nodes
        ends = {
            step: base.copy()
            for step in (range(steps) if self.request.gates.proven else [steps - 1])
        }
        is_moved = np.zeros(len(base), dtype=bool)
        is_straight = True
        for nodes, plan in chunks:
            here = np.flatnonzero(np.isin(nodes, wall))
            u = path[:, np.searchsorted(wall, nodes[here])]
            for step, points in enumerate(move_in_steps(plan, path, base[nodes], here, u)):
                if step in ends:
                    ends[step][nodes] = points
            is_moved[nodes] = True
            is_straight &= plan.is_linear
            done(is_moved.mean())
        return Way(self.request.output, self.patches.mesh, tuple(ends.values()), is_straight)

    def judge(self, way: Way) -> jm.Verdict:
        return way.judge(self.request.gates.limits, self.before)


def run_deform(request: Deform, out: Output) -> int:
    io.check_output(request.output, request.file)
    with out.progress(f"reading {title(request.file)}"):
        mesh = load_mesh(request.file, request.zone, request.tags)
    with quickly_compiled(len(mesh.points) * request.step_count <= SMALL_WORK):
        return _move_mesh(request, mesh, out)


def _move_mesh(request: Deform, mesh: Mesh, out: Output) -> int:
    io.check_output(request.output, mesh)
    if request.remesh:  # other cells than the file's: only where a format makes new files
        source = getattr(mesh.source, "of_new_cells", None)
        io.check_output(request.output, Mesh(mesh.points, mesh.cells, mesh.patches, source))
    check_picture(request.picture)
    judging = in_background(jm.judge, mesh, None, request.gates.limits)
    with out.progress("finding the motion"):
        patches = patches_of(request, mesh)
        attempt = Attempt(request, patches, motion(request, mesh, patches.nodes), judging)
        u = attempt.path()[-1]
    with out.progress("preparing"):
        chunks = patches.chunks(request.chunk)
        nodes, plan = next(chunks)
    if request.steps == AUTO:
        attempt = _find_steps(attempt, plan, out)
        request = attempt.request
    n, d = mesh.points.shape
    cells = ", ".join(f"{number} {kind}" for kind, number in mesh.cell_counts.items())
    out.say(f"{title(request.file)}: {n} points in {d}-D, {cells}", points=n)
    say_motion(request, patches, plan, u, out)
    if attempt.reached is not None:
        reach = (
            f"keep the cells for {attempt.reached:.1%} of the motion, and not for all of it"
            if attempt.reached < 1
            else "keep the cells"
        )
        out.say(f"steps    {request.step_count} {reach}", reached=attempt.reached)
    with out.progress("judging the cells"):
        judging.result()  # it raises for limits on measures that the cells do not have
    with out.progress(f"deforming in {plural(request.step_count, 'step')}") as stage:
        way = attempt.way(itertools.chain([(nodes, plan)], chunks), request.step_count, stage.done)
    return _write_result(attempt, way, nodes, plan, out)


def _find_steps(attempt: Attempt, plan: jm.Plan, out: Output) -> Attempt:
    """Finds the fewest steps; one where walls cross, which no number of steps cures."""
    request = attempt.request
    mesh = attempt.patches.mesh
    path = attempt.path()
    with out.progress("inspecting the motion"):
        crossed = wall_crossings(plan, mesh, path, np.asarray(jm.deform(plan, path[-1])))
    if crossed:
        return dataclasses.replace(attempt, request=dataclasses.replace(request, steps=1))
    with out.progress("seeking the fewest steps"):
        least = request.gates.min_jacobian_ratio or 0.0
        at = functools.partial(attempt.motion.at, attempt.base[attempt.patches.nodes])
        found = jm.fewest_steps(plan, mesh, at, min_jacobian_ratio=least, max_steps=MOST_TRIED)
    request = dataclasses.replace(request, steps=found.count)
    return dataclasses.replace(attempt, request=request, reached=found.fraction)


def _write_result(attempt: Attempt, way: Way, nodes: np.ndarray, plan: jm.Plan, out: Output) -> int:
    """Inspects and judges the motion, and writes the mesh; `nodes` are those of `plan`."""
    request = attempt.request
    with out.progress("judging the cells"):
        stored = way.stored
        judging = in_background(attempt.judge, way)
        off = _measure_distances(attempt, stored)
    with out.progress("inspecting the motion"):
        is_known = request.step_count == 1 and plan.points.dtype == stored.dtype
        points = stored[nodes] if is_known else None
        inspection = jm.inspect(plan, attempt.path()[-1], mesh=way.mesh, nodes=nodes, moved=points)
        for warning in inspection.warnings:
            out.warn(warning)
        boundary = jm.boundary_quality(plan, stored[nodes]).renumbered(nodes)
    with out.progress("judging the cells"):
        verdict = judging.result()
        wall = _wall_rows(attempt, stored)
    _say_measures(attempt, way, verdict, inspection, wall, off, out)
    if boundary.nodes:
        measures = {name: getattr(boundary, name) for name in boundary.nodes}
        out.say(
            wrap(f"boundary: {boundary}"),
            boundary=measures | {"ended": boundary.ended.tolist()},
        )
    write_job(request, out)
    draw(request.picture, way.mesh, out, stored, moving=attempt.patches.nodes, verdict=verdict)
    _draw_distances(attempt, stored, out)
    bad = faults(verdict)
    if bad and request.remesh:
        return move_over_meshes(request, attempt.patches, plan, out)
    if bad:
        bad[-1] += "" if inspection.is_hopeless else _advice(attempt, out)
    return finish(bad, request.allow_inverted, request.output, lambda: way.write(verdict), out)


def _draw_distances(attempt: Attempt, points: np.ndarray, out: Output) -> None:
    picture = attempt.request.picture
    for name, (nodes, wall) in attempt.motion.walls.items() if picture else ():
        assert picture is not None
        what = re.sub(r"\W+", "_", re.sub(r"\.\w+(?= |$)", "", name)).strip("_")
        paint(
            picture.with_name(f"{picture.stem}_distance_{what}.png"),
            out,
            lambda plot, file, name=name, nodes=nodes, wall=wall: plot.distances(
                file, wall.wall, wall.target, points[nodes], label=f"from {name}"
            ),
        )


def _say_measures(
    attempt: Attempt,
    way: Way,
    verdict: jm.Verdict,
    inspection: jm.Inspection,
    wall: list[MeasureRow],
    off: dict[str, Distances],
    out: Output,
) -> None:
    overshoots = {name: getattr(inspection, name) for name in ("overshoot", "overshoot_behind")}
    rows = [
        *wall,
        ("overshoot", "-", inspection.overshoot, OVERSHOOT if inspection.overshoot > 1 else ""),
        ("overshoot behind", "-", inspection.overshoot_behind, ""),
        *(row for file, each in off.items() for row in each.rows(file)),
    ]
    table = [
        f"{label:<23}{start if isinstance(start, str) else f'{start:.5g}':>12}{end:>12.5g}{place}"
        for label, start, end, place in rows
    ]
    say_verdict(
        verdict, out, is_straight=way.is_straight, steps=attempt.request.step_count, more=table
    )
    names = [re.sub("[ -]", "_", label) for label, *_ in wall]
    starts, ends = (dict(zip(names, (row[k] for row in wall), strict=True)) for k in (1, 2))
    out.say(before=attempt.before.facts | starts, after=verdict.facts | ends, **overshoots)
    out.say(distance={file: each.facts() for file, each in off.items()})


def _measure_distances(attempt: Attempt, points: np.ndarray) -> dict[str, Distances]:
    found = {}
    for name, (nodes, wall) in attempt.motion.walls.items():
        before, after = (np.asarray(wall.target.distance(x[nodes])) for x in (attempt.base, points))
        worst = nodes[after.argmax()]
        is_off = after.max() > ON_TARGET * np.ptp(points[nodes], axis=0).max()
        place = f"   node {worst} near {format_place(points[worst])}" if is_off else ""
        found[name] = Distances(before, after, place)
    return found


def _wall_rows(attempt: Attempt, points: np.ndarray) -> list[MeasureRow]:
    """Measures the first grid line: label, before, after and place; none without a line."""
    try:
        wall = jm.wall_quality(attempt.patches.mesh, attempt.patches.nodes, points)
    except ValueError:
        return []
    # as mean_angle, max_angle and min_height, by NumPy: nothing is compiled for a table
    angle = np.asarray(wall.angle)
    height = np.asarray(wall.height)
    nodes = np.asarray(wall.nodes)
    if not len(nodes):
        return []
    worst = nodes[[angle.argmax(), height.argmin()]]
    steepest, lowest = (f"   node {node} near {format_place(points[node])}" for node in worst)
    return [
        ("mean wall angle", 0, float(angle.mean()), ""),
        ("max wall angle", 0, float(angle.max()), steepest),
        ("min first-cell height", 1, float(height.min()), lowest),
    ]


def say_motion(
    request: Deform, patches: Patches, plan: jm.Plan, u: np.ndarray, out: Output
) -> None:
    mesh = patches.mesh
    way = np.linalg.norm(u, axis=1)

    def row(what: str, names: Iterable[Any], number: str) -> None:
        out.say(wrap(f"{what:<8} {', '.join(map(str, names))}: {number}"))

    for names in dict.fromkeys(group.patches for group in request.groups):
        nodes = mesh.patch(*names)
        largest = way[np.isin(patches.nodes, nodes)].max()
        row("moving", names, f"{plural(len(nodes), 'node')}, by up to {largest:.4g}")
    still = np.setdiff1d(mesh.patch(*patches.fixed), patches.nodes)
    row("fixed", request.boundary.fixed or ["no patch"], plural(len(still), "node"))
    for what, names in (("symmetry", patches.symmetry), ("sliding", patches.sliding)):
        if names:
            row(what, names, plural(len(mesh.patch(*names)), "node"))
    for pair in patches.periodic:
        row(
            "periodic", (pair.patch, pair.partner), plural(len(mesh.patch(str(pair.patch))), "pair")
        )
    name, sources = describe_method(request.method, plan)
    out.say(
        f"method   {name}, {plural(request.step_count, 'step')}",
        method=name,
        steps=request.step_count,
    )
    length = float(np.ptp(np.asarray(mesh.points)[patches.nodes], axis=0).max())
    warn_of_size(float(way.max()) / length if length else 0.0, out)
    moving = {name: len(mesh.patch(name)) for name in patches.moving}
    out.say(moving=moving, largest=float(way.max()), sources=sources)


def write_job(request: Deform, out: Output) -> None:
    if request.save_job is not None:
        with complete(request.save_job) as partial:
            partial.write_bytes(text_of(request, request.save_job.parent).encode())
        out.say(f"job      {request.save_job}")


def _advice(attempt: Attempt, out: Output) -> str:
    """Names other flags that cure a bad motion, those of the first attempt that succeeds."""
    request = attempt.request
    if any(gate.beyond for gate in attempt.before.gates):  # no way of moving the mesh cures it
        return ""
    if out.seconds > PATIENCE or not request.dry_run:
        return " No other flags were tried."
    trials = _trials(attempt)
    with out.progress("trying others") as stage:
        worked = next(
            (_flags(attempt, cure) for cure in stage.over(trials) if _works(attempt, cure)), ""
        )
    out.say(suggestion=worked)
    if worked:
        return f" {worked} works."
    tried = ", ".join(_flags(attempt, cure) for cure in trials)
    return f" A dry run with each of {tried} does not cure it." if tried else ""


def _trials(attempt: Attempt) -> list[jm.Cure]:
    """Lists cures in the order in which they are tried: the default method first."""
    patches = attempt.patches
    request = attempt.request
    found = [jm.Cure(method="default"), *jm.cures(patches.boundary, attempt.path()[-1])]
    if attempt.reached is None:
        found = [dataclasses.replace(cure, steps=cure.steps * request.step_count) for cure in found]
    else:
        found = [cure for cure in found if cure.steps == 1]  # more steps were sought
    return [cure for cure in found if cure.method != request.method.method]


def _flags(attempt: Attempt, cure: jm.Cure) -> str:
    flags = []
    if cure.sliding:
        flags.append(f"--sliding {' '.join(cure.sliding)} in place of --fixed")
    if cure.method:
        flags.append(f"--method {cure.method}")
    if cure.steps != attempt.request.step_count:
        flags.append(f"--steps {cure.steps}")
    return " ".join(flags)


def _works(attempt: Attempt, cure: jm.Cure) -> bool:
    patches = attempt.patches
    patches = dataclasses.replace(
        patches,
        fixed=tuple(name for name in patches.fixed if name not in cure.sliding),
        sliding=(*patches.sliding, *cure.sliding),
        request=dataclasses.replace(patches.request, method=cure.method or patches.request.method),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            way = dataclasses.replace(attempt, patches=patches).way(
                patches.chunks(attempt.request.chunk), cure.steps
            )
        except (
            ValueError,
            ImportError,
        ):  # ImportError: a solver for large 3-D meshes is not installed
            return False
        return attempt.judge(way).ok
