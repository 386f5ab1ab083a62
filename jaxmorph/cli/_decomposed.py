"""`jaxmorph deform --decomposed`: an OpenFOAM case part by part, in one process or an MPI run."""

import functools
import os
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

import jaxmorph as jm
from jaxmorph import io
from jaxmorph.extend import Alone, together, wall_crossings

from ._deform import say_motion, write_job
from ._method import patches_of
from ._motion import motion
from ._output import Output, Stage, title
from ._requests import Deform
from ._way import Way, faults, is_kept, move_in_steps, say_verdict

T = TypeVar("T")

COUNTS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS")
"""Variables of the environment in which mpiexec or srun count their processes."""

STARTED = (*COUNTS, "MPI_LOCALNRANKS", "PMIX_RANK", "PMI_RANK")
"""Variables of the environment that mpiexec and srun set for their processes."""


class _Bad(Exception): ...


def run_decomposed(request: Deform, out: Output) -> int:
    ranks = _ranks()
    out.is_silent = ranks.rank > 0
    with out.progress("reading the surface"):
        case = together(ranks, lambda: io.Decomposed(request.file))
        together(ranks, lambda: case.check_output(request.output))
        share = range(ranks.rank, len(case), ranks.size)
        sides = together(
            ranks, lambda: {k: (case.side(k), len(case.read(k).points)) for k in share}
        )
        largest = max(ranks.allgather(max((count for _, count in sides.values()), default=0)))
        gathered = ranks.gather({k: side for k, (side, _) in sides.items()})
    del sides

    prepared = together(
        ranks,
        lambda: _prepare_half(request, case.surface(_by_part(gathered)), out) if gathered else None,
    )
    half, path = ranks.bcast(prepared)  # pyright: ignore[reportGeneralTypeIssues]
    part = functools.partial(_move_part, request, case, half, path, largest)
    try:
        with case.writing(request.output, ranks) as writer:
            with out.progress("moving and judging the parts") as stage:
                verdict = _move_parts(part, len(case), ranks, writer, stage)
            _say_warnings_of_all(out, ranks)
            say_verdict(verdict, out, is_straight=half.plan.is_linear, steps=len(path))
            out.say(faces_between_parts=verdict.between, parts=verdict.parts)
            bad = faults(verdict)
            if not is_kept(bad, request.allow_inverted, request.output, out):
                raise _Bad
    except _Bad:
        return 1
    out.wrote(request.output)
    return 1 if bad else 0


def _move_parts(
    part: Callable[[int], tuple[jm.Mesh, jm.Verdict]],
    count: int,
    ranks: Any,
    writer: Any,
    stage: Stage,
) -> jm.Verdict:
    verdicts: dict[int, jm.Verdict] = {}
    for first in range(0, count, ranks.size):
        k = first + ranks.rank
        mesh, verdict = together(ranks, lambda k=k: part(k) if k < count else (None, None))
        if verdict is not None:
            verdicts[k] = verdict
        writer.add(None if mesh is None else k, mesh)
        stage.done(min(1.0, (first + ranks.size) / count))
    return jm.Verdict.together(_by_part(ranks.allgather(verdicts)))


def _by_part(shares: Iterable[dict[int, T]]) -> list[T]:
    """Joins what the processes have of their parts, in the order of the parts."""
    joined = {k: entry for share in shares for k, entry in share.items()}
    return [joined[k] for k in sorted(joined)]


def _say_warnings_of_all(out: Output, ranks: Any) -> None:
    """Prints the warnings of the silent processes of an MPI run, each warning once."""
    printed = out.facts.get("warnings", [])
    for warning in dict.fromkeys(
        warning for share in ranks.gather(printed) or () for warning in share
    ):
        if warning not in printed:
            out.complain(warning, "warnings")


def _ranks() -> Any:
    if not any(name in os.environ for name in STARTED):
        return Alone()
    count = next((os.environ[name] for name in COUNTS if name in os.environ), "")
    size = int(count) if count.isdecimal() else None
    if size == 1:
        return Alone()
    try:
        from mpi4py import MPI
    except (
        ImportError,
        RuntimeError,
    ) as error:  # RuntimeError: mpi4py is there, and no MPI library
        raise ImportError(
            "mpiexec or srun started this process, but mpi4py or its MPI library is missing: "
            "pip install 'jaxmorph[mpi]' mpich, or start one process."
        ) from error
    world: Any = MPI.COMM_WORLD
    if size is not None and world.size != size:
        raise ValueError(
            f"{size} processes were started, and mpi4py sees {world.size}: they belong to "
            "different MPI libraries. Take the "
            "mpiexec of mpi4py's library, or srun --mpi= with a name that this library knows "
            "(srun --mpi=list)."
        )
    return world


def _prepare_half(
    request: Deform, surface: jm.Mesh, out: Output
) -> tuple[jm.SurfaceHalf, np.ndarray]:
    with out.progress("finding the motion"):
        patches = patches_of(request, surface)
        moves = motion(request, surface, patches.nodes)
        path = moves.path(np.asarray(surface.points)[patches.nodes], request.step_count)
    with out.progress("preparing the surface"):
        half = patches.half()
    out.say(
        f"{title(request.file)}: boundary of {len(surface.points)} nodes in "
        f"{surface.points.shape[1]}-D"
    )
    say_motion(request, patches, half.plan, path[-1], out)
    with out.progress("inspecting the motion"):
        inspection = jm.inspect(half.plan, path[-1].astype(request.method.dtype))
        rows = np.searchsorted(io.global_nodes(surface), half.nodes)
        crossed = str(wall_crossings(half.plan, surface, path, nodes=rows))
    for warning in (*inspection.warnings, *filter(None, [crossed])):
        out.warn(warning)
    write_job(request, out)
    return half, path


def _move_part(
    request: Deform,
    case: io.Decomposed,
    half: jm.SurfaceHalf,
    path: np.ndarray,
    largest: int,
    k: int,
) -> tuple[jm.Mesh, jm.Verdict]:
    """Moves and judges a part by the path (k, m, d) of the surface.

    Copies of a node fill it up to the size of the `largest` part, so that all share compiled code.
    """
    mesh = case.read(k)
    method = request.method
    ids = io.global_nodes(mesh)
    base = np.asarray(mesh.points)
    is_inner = ~np.isin(ids, half.surface_nodes)
    rows = np.append(np.arange(len(ids)), np.full(largest - len(ids), is_inner.argmax()))
    nodes = np.where((np.arange(largest) < len(ids)) & ~is_inner[rows], ids[rows], -1)
    try:
        plan = half.attach(base.astype(method.dtype)[rows], nodes)
    except jm.MeshError as error:
        raise ValueError(f"processor{k}: {error.renumbered(rows)}") from None
    here = np.flatnonzero(np.isin(ids, half.moving))
    ends = tuple(move_in_steps(plan, path, base, here, path[:, half.rows(ids[here])]))
    way = Way(request.output, mesh, ends, plan.is_linear)
    return mesh.moved(ends[-1]), way.judge(request.gates.limits, part=k)
