"""`jaxmorph deform --decomposed`: an OpenFOAM case part by part, in one process or in those of an MPI run."""

import os
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.package.ranks import Alone, Ranks, together

from ._deform import check_files, described, write_job
from ._judged import Judged
from ._method import in_double, named_method, patches_of
from ._motion import motion
from ._output import Output, title
from ._parts import Verdict, Verdicts, verdict
from ._requests import Deform
from ._trials import MORE

COUNTS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS")
"""Variables that count the processes which mpiexec or srun started together; the launcher's own are first."""

STARTED = (*COUNTS, "MPI_LOCALNRANKS", "PMIX_RANK", "PMI_RANK")
"""Variables that mpiexec and srun leave in the environment of the processes that they start."""


class _Bad(Exception):
    """Ends the writing of a case whose cells are bad."""


def deform_parts(request: Deform, out: Output) -> int:
    """Reads, moves, judges and writes part after part; says each on the terminal. Returns the exit status."""
    ranks = _ranks()
    out.is_silent = ranks.rank > 0
    case = together(ranks, lambda: _checked(request))
    share = range(ranks.rank, len(case), ranks.size)
    with out.progress("reading the surface"):
        sides = together(ranks, lambda: {k: (case.side(k), len(case.read(k).points)) for k in share})
    largest = max(ranks.allgather(max((count for _, count in sides.values()), default=0)))
    gathered = ranks.gather({k: side for k, (side, _) in sides.items()})
    del sides

    def prepared() -> tuple[jm.SurfaceHalf, np.ndarray, str] | None:
        every = {k: side for each in gathered or () for k, side in each.items()}
        if not gathered:
            return None
        return prepared_half(request, case.surface([every[k] for k in range(len(case))]), out, "--decomposed")

    half, path, dtype = ranks.bcast(together(ranks, prepared))  # pyright: ignore[reportGeneralTypeIssues]
    verdicts: list[Verdict] = []
    try:
        with case.writing(request.output, ranks) as writer, out.progress("moving and judging the parts") as stage:
            for first in range(0, len(case), ranks.size):
                k = first + ranks.rank if first + ranks.rank < len(case) else None
                moved = together(ranks, lambda k=k: _moved(request, case, k, half, path, dtype, largest, verdicts))
                writer.add(k, moved)
                stage.done(min(1.0, (first + ranks.size) / len(case)))
            every = [each for some in ranks.allgather(verdicts) for each in some]
            _say_warnings_of_all(out, ranks)
            judged = Verdicts(sorted(every, key=lambda each: each.part), request.gates)
            out.say(f"\n{judged.table}\n", **judged.facts)
            if judged.faults and not request.allow_inverted:
                raise _Bad
    except _Bad:
        complain(request, judged, out)  # pyright: ignore[reportPossiblyUnboundVariable]
        out.complain(f"{request.output} is not written; --allow-inverted writes it all the same.")
        return 1
    complain(request, judged, out)
    out.say(f"wrote {request.output} ({out.seconds:.1f} s)", output=str(request.output))
    return 1 if judged.faults else 0


def complain(request: Deform, judged: Verdicts, out: Output) -> None:
    """Says the faults of all parts, with what to try."""
    for k, sentence in enumerate(judged.faults):
        hint = (
            f" Try {MORE if request.method.name == 'default' else '--method default'}."
            if k + 1 == len(judged.faults)
            else ""
        )
        out.complain(sentence + hint)


def _say_warnings_of_all(out: Output, ranks: Ranks) -> None:
    """Says the warnings that the silent processes of an MPI run have kept, once each."""
    spoken = out.facts.get("warnings", [])
    for warning in dict.fromkeys(each for some in ranks.gather(spoken) or () for each in some):
        if warning not in spoken:
            out.complain(warning, "warnings")


def _ranks() -> Ranks:
    """Returns the processes that mpiexec or srun started together. Raises `ImportError` and `ValueError` where they cannot meet."""
    if not any(name in os.environ for name in STARTED):
        return Alone()
    counts = [os.environ[name] for name in COUNTS if name in os.environ]
    size = int(counts[0]) if counts and counts[0].isdecimal() else None
    if size == 1:
        return Alone()
    try:
        from mpi4py import MPI
    except ImportError as error:
        raise ImportError(
            "mpiexec or srun started this process, but mpi4py is missing: pip install 'jaxmorph[mpi]', or start one process."
        ) from error
    world: Any = MPI.COMM_WORLD
    if size is not None and world.size != size:
        raise ValueError(
            f"{size} processes were started, and mpi4py sees {world.size}: they belong to different MPI libraries. Take the "
            "mpiexec of mpi4py's library, or srun --mpi= with a name that this library knows (srun --mpi=list)."
        )
    return world


def _checked(request: Deform) -> io.Decomposed:
    """Opens the case. Raises `ValueError` for a request that is sure to fail, before any work."""
    case = io.Decomposed(request.file)
    case.check_output(request.output)
    check_flags(request, "--decomposed")
    return case


def check_flags(request: Deform, way: str) -> None:
    """Raises `ValueError` for flags that need the whole mesh; `way` is the flag by which it comes in pieces."""
    if request.picture is not None or request.chunk is not None:
        flag = "--picture" if request.picture is not None else "--chunk"
        raise ValueError(f"{flag} is not for {way}, which never has the whole mesh: leave it away.")
    if request.steps < 1:
        raise ValueError(f"--steps must be 1 or more, found {request.steps}.")


def prepared_half(request: Deform, surface: jm.Mesh, out: Output, way: str) -> tuple[jm.SurfaceHalf, np.ndarray, str]:
    """Prepares the surface and its motion, describes both, and warns of what no method moves well.

    `way` is the flag by which the mesh comes in pieces.
    """
    check_files(request, surface)
    patches = patches_of(request.surface, surface, request.file)
    wall = np.asarray(surface.points)[patches.nodes]
    moves = motion(request.groups, surface, patches.nodes, request.changes)
    with out.progress("preparing the surface"):
        choice = named_method(request.method, wall)
        if choice.method.needs_cells:
            raise ValueError(f"{way} is not for {request.method.name}, which solves for all nodes at once.")
        path = moves.path(wall, request.steps)
        out.say(f"{title(request.file)}: boundary of {len(surface.points)} nodes in {surface.points.shape[1]}-D")
        described(request, patches, choice, path[-1], out)
        half = patches.half(choice)
        for warning in jm.inspect(half.plan, path[-1].astype(choice.dtype)).warnings:
            out.warn(warning)
    write_job(request, out)
    for file in moves.write_lattices():
        out.say(f"lattice  {file}")
    return half, path, choice.dtype


def _moved(
    request: Deform,
    case: io.Decomposed,
    k: int | None,
    half: jm.SurfaceHalf,
    path: np.ndarray,
    dtype: str,
    largest: int,
    verdicts: list[Verdict],
) -> jm.Mesh | None:
    """Moves part `k` and judges it; nothing where a process has no part left."""
    if k is None:
        return None
    mesh = case.read(k)
    base = np.asarray(mesh.points)
    points = moved_points(half, path, dtype, largest, base, io.global_nodes(mesh), f"processor{k}")
    before = Judged(mesh, base)
    verdicts.append(verdict(k, before, Judged(mesh, points, before), request.gates))
    return mesh.moved(points)


def moved_points(
    half: jm.SurfaceHalf,
    path: np.ndarray,
    dtype: str,
    largest: int,
    base: np.ndarray,
    ids: np.ndarray,
    name: str,
) -> np.ndarray:
    """Moves the points `base` (k, d) of one piece, whose nodes are `ids` (k,) of the whole mesh; errors begin with `name`.

    It is filled up with copies of a node to the size of the largest piece: all pieces share compiled code.
    """
    is_inner = ~np.isin(ids, half.surface_nodes)
    more = largest - len(ids)
    rows = np.append(np.arange(len(ids)), np.full(more, is_inner.argmax()))
    names = np.append(np.where(is_inner, -1, ids), np.full(more, -1))
    try:
        plan = half.attach(base.astype(dtype)[rows], names)
    except jm.MeshError as error:
        raise ValueError(f"{name}: {error.renumbered(rows)}") from None
    points = jm.deform(plan, path[0]) if len(path) == 1 else jm.march(plan, path)[1]
    here = np.flatnonzero(np.isin(ids, half.moving))
    order = np.argsort(half.moving)
    of_moving = order[np.searchsorted(half.moving[order], ids[here])]
    return in_double(base, np.asarray(points)[: len(ids)], here, path[-1][of_moving], half.plan.method.exact)
