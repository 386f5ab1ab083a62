"""`jaxmorph modes`: many motions of one mesh through one plan."""

import dataclasses
import itertools
import pathlib
from collections.abc import Iterator

import jax
import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import Mesh, io

from ._early import check_apart
from ._method import described, patches_of
from ._output import Output, count, title
from ._requests import ModesRequest
from ._way import Way, faults, in_double, instants

BATCH = 8
"""Motions computed together."""


@dataclasses.dataclass(frozen=True)
class Case:
    """One shape times one amplitude, its output, and its time in a series."""

    number: int
    mode: int
    amplitude: float
    output: pathlib.Path
    time: float


def modes(request: ModesRequest, out: Output) -> int:
    with out.progress(f"reading {title(request.file)}"):
        mesh = io.read(request.file)
    cases, patches = _cases(request), patches_of(request, mesh)
    for case in cases:
        io.check_output(case.output, mesh)
    outputs = [("OUT", file) for file in (request.output, *(case.output for case in cases))]
    check_apart(outputs, {"the mesh is": [request.file], "the shapes are": request.mode})
    with out.progress("reading the modes"):
        shapes = [io.read_displacement(file, mesh, patches.nodes, is_position=False) for file in request.mode]
    with out.progress("preparing"):
        _, plan = next(patches.chunks())
    name, _ = described(request.method, plan)
    what = f"{count(len(shapes), 'mode')} at {count(len(request.amplitude), 'amplitude')}"
    out.say(f"{title(request.file)}: {len(mesh.points)} points, {what}", points=len(mesh.points))
    out.say(f"method   {name}", method=name)
    if request.gates.proven:
        out.say(f"proven   cells that fold nowhere inside, {instants(plan.is_linear, 1)}", on_the_way=plan.is_linear)
    limits = request.gates.limits
    before = jm.judge(mesh, None, limits)
    ratio = list(before.rows)[-1][1][0].upper()  # of volumes, or of Jacobians
    out.say(f"\n{'':>6}{'amplitude':>12}{'skewness':>12}{f'min {ratio}/{ratio}0':>12}{'inverted':>10}  mode")
    good, bad = [], 0
    with out.progress("moving") as stage:
        for case, points in _moved(mesh, plan, np.stack(shapes), cases):
            way = Way(case.output, mesh, (points,), plan.is_linear)
            verdict = way.judge(limits, before)
            bad += not verdict.ok
            _tell(case, request.mode[case.mode], verdict, out)
            if verdict.ok or request.allow_inverted:
                way.write(lambda verdict=verdict: verdict)
                good.append(case)
            stage.done(case.number / len(cases))
    _end(request, good, len(cases), out)
    return 1 if bad else 0


def _cases(request: ModesRequest) -> list[Case]:
    """Names a numbered file beside OUT for each case. Amplitudes are times if they increase."""
    amplitudes, out = request.amplitude, request.output
    go_up = len(request.mode) == 1 and all(a < b for a, b in itertools.pairwise(amplitudes))
    suffix = ".vtu" if out.suffix == ".pvd" else out.suffix
    pairs = itertools.product(range(len(request.mode)), amplitudes)
    return [
        Case(k, mode, a, out.with_name(f"{out.stem}_{k:04d}{suffix}"), a if go_up else float(k))
        for k, (mode, a) in enumerate(pairs, start=1)
    ]


def _moved(
    mesh: Mesh, plan: jm.Plan, shapes: Float[np.ndarray, "k m d"], cases: list[Case]
) -> Iterator[tuple[Case, Float[np.ndarray, "n d"]]]:
    """Yields the points of each case. `BATCH` cases together cost much less than single cases."""
    together = jax.vmap(lambda u: jm.deform(plan, u))
    size, base, nodes = min(BATCH, len(cases)), np.asarray(mesh.points), np.asarray(plan.moving)
    for first in range(0, len(cases), size):
        some = cases[first : first + size]
        u = np.zeros((size, *shapes.shape[1:]))
        u[: len(some)] = [case.amplitude * shapes[case.mode] for case in some]
        moved = np.asarray(together(u))
        for k, case in enumerate(some):
            yield case, in_double(base, moved[k], nodes, u[k], plan.method.exact)


def _tell(case: Case, file: pathlib.Path, verdict: jm.Verdict, out: Output) -> None:
    rows, failed, inverted = verdict.rows, faults(verdict), verdict.inverted
    skewness = next(number.value for (kind, name), number in rows.items() if kind == "max" and "skewness" in name)
    ratio = list(rows.values())[-1].value
    name = file.name if len(file.name) <= 26 else f"...{file.name[-23:]}"
    out.say(f"{case.number:>6}{case.amplitude:>12.5g}{skewness:>12.5g}{ratio:>12.5g}{inverted:>10}  {name}")
    facts = {"mode": str(file), "amplitude": case.amplitude, "output": str(case.output), "problems": failed}
    out.facts.setdefault("cases", []).append(facts | verdict.facts)
    for sentence in failed:
        out.complain(f"case {case.number}: {sentence}")


def _end(request: ModesRequest, good: list[Case], total: int, out: Output) -> None:
    out.say("")
    if good:
        files = good[0].output if len(good) == 1 else f"{good[0].output} to {good[-1].output.name}"
        out.say(f"wrote {files} ({out.seconds:.1f} s)")
    if request.output.suffix == ".pvd" and good:
        io.write_pvd(request.output, [case.output for case in good], [case.time for case in good])
        out.say(f"wrote {request.output}", output=str(request.output))
    if len(good) < total:
        missing = f"{total - len(good)} of {count(total, 'case')}"
        out.complain(f"{missing} not written; --allow-inverted writes them anyway.")
