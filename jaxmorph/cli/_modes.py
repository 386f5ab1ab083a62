"""`jaxmorph modes`: many motions of one mesh through one plan."""

import argparse
import contextlib
import dataclasses
import itertools
import pathlib
from collections.abc import Iterator
from xml.sax.saxutils import quoteattr

import jax
import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph import Mesh, io

from . import _gates
from ._files import save, write_moved
from ._gates import Judged
from ._method import check_patches, choose, in_double, prepare
from ._output import Output
from ._tables import count, inverted_cells, numbers
from ._xdmf import Series

BATCH = 8
"""Motions computed together."""


@dataclasses.dataclass(frozen=True)
class Case:
    """One shape times one amplitude, where it goes, and its time in a series."""

    number: int
    mode: int
    amplitude: float
    output: pathlib.Path
    time: float


def modes(arguments: argparse.Namespace, out: Output) -> int:
    """Each mode file at each amplitude: moves, judges, writes. Returns the exit status."""
    with out.progress(f"reading {arguments.file.name}"):
        mesh = io.read(arguments.file)
    cases = _cases(arguments)
    _check(arguments, mesh, cases)
    limits, moving = _gates.gates(arguments), mesh.patch(*arguments.moving)
    with out.progress("reading the modes"):
        shapes = np.stack([io.read_displacement(file, mesh, moving, is_position=False) for file in arguments.mode])
    with out.progress("preparing"):
        choice = choose(arguments.method, arguments.sources, np.asarray(mesh.points)[moving])
        plan = prepare(arguments, mesh, arguments.moving, choice.method)
    what = f"{count(len(shapes), 'mode')} at {count(len(arguments.amplitude), 'amplitude')}"
    out.say(f"{arguments.file.name}: {len(mesh.points)} points, {what}", points=len(mesh.points))
    out.say(f"method   {choice.name}", method=choice.name)
    out.say(f"\n{'':>6}{'amplitude':>12}{'skewness':>12}{'min J/J0':>12}{'inverted':>10}  mode")
    good, bad = [], 0
    before = Judged(mesh, mesh.points, jm.quality(mesh)) if limits else None
    xdmf = Series(arguments.output, mesh) if _is_xdmf(arguments) else None
    with xdmf or contextlib.nullcontext(), out.progress("moving") as stage:
        for case, points in _moved(mesh, plan, shapes, cases):
            report = jm.quality(mesh, points)
            failed = [inverted_cells(report), *_gates.failures(limits, before, Judged(mesh, points, report))]
            failed = [sentence for sentence in failed if sentence]
            bad += bool(failed)
            _tell(case, arguments.mode[case.mode], report, failed, out)
            if not failed or arguments.allow_inverted:
                if xdmf:
                    xdmf.add(case.time, mesh.moved(points), report)
                else:
                    write_moved(case.output, mesh, mesh.moved(points), report)
                good.append(case)
            stage.done(case.number / len(cases))
    return _end(arguments, good, bad, len(cases), out)


def _cases(arguments: argparse.Namespace) -> list[Case]:
    """Files beside OUT with the case's number in their names; times are amplitudes where these go up."""
    amplitudes, pairs = arguments.amplitude, []
    for mode in range(len(arguments.mode)):
        pairs += [(mode, amplitude) for amplitude in amplitudes]
    go_up = len(arguments.mode) == 1 and all(a < b for a, b in itertools.pairwise(amplitudes))
    suffix = ".vtu" if arguments.output.suffix == ".pvd" else arguments.output.suffix
    name = arguments.output.stem
    cases = []
    for k, (mode, a) in enumerate(pairs, start=1):
        output = arguments.output if _is_xdmf(arguments) else arguments.output.with_name(f"{name}_{k:04d}{suffix}")
        cases.append(Case(k, mode, a, output, a if go_up else float(k)))
    return cases


def _is_xdmf(arguments: argparse.Namespace) -> bool:
    return arguments.output.suffix == ".xdmf"


def _check(arguments: argparse.Namespace, mesh: Mesh, cases: list[Case]) -> None:
    """`ValueError` for what can be known to fail before any work."""
    check_patches(arguments, mesh, arguments.moving)
    if not np.isfinite(arguments.amplitude).all():
        raise ValueError("--amplitude needs finite numbers.")
    if _is_xdmf(arguments) and not arguments.output.parent.is_dir():
        raise ValueError(f"{arguments.output}: there is no folder {arguments.output.parent}.")
    for case in cases if not _is_xdmf(arguments) else ():
        io.check_output(case.output, mesh)


def _moved(
    mesh: Mesh, plan: jm.Plan, shapes: Float[np.ndarray, "k m d"], cases: list[Case]
) -> Iterator[tuple[Case, Float[np.ndarray, "n d"]]]:
    """The points of each case; `BATCH` of them at a time, which cost much less together."""
    together = jax.vmap(lambda u: jm.deform(plan, u))
    size = min(BATCH, len(cases))
    for first in range(0, len(cases), size):
        some = cases[first : first + size]
        u = np.zeros((size, *shapes.shape[1:]))
        u[: len(some)] = [case.amplitude * shapes[case.mode] for case in some]
        moved = np.asarray(together(u))
        for k, case in enumerate(some):
            yield case, in_double(np.asarray(mesh.points), plan, moved[k], u[k])


def _tell(case: Case, file: pathlib.Path, report: jm.QualityReport, failed: list[str], out: Output) -> None:
    skewness, ratio, inverted = float(report.max_skewness), float(report.min_jacobian_ratio), int(report.inverted)
    name = file.name if len(file.name) <= 26 else f"...{file.name[-23:]}"
    out.say(f"{case.number:>6}{case.amplitude:>12.5g}{skewness:>12.5g}{ratio:>12.5g}{inverted:>10}  {name}")
    found = {"mode": str(file), "amplitude": case.amplitude, "output": str(case.output), "problems": failed}
    out.facts.setdefault("cases", []).append(found | numbers(report))
    for sentence in failed:
        out.complain(f"case {case.number}: {sentence}")


def _end(arguments: argparse.Namespace, good: list[Case], bad: int, total: int, out: Output) -> int:
    out.say("")
    if good:
        files = good[0].output if len(good) == 1 else f"{good[0].output} to {good[-1].output.name}"
        if _is_xdmf(arguments):
            files = f"{arguments.output} and {arguments.output.with_suffix('.h5').name}"
            out.facts["output"] = str(arguments.output)
        out.say(f"wrote {files} ({out.seconds:.1f} s)")
    if arguments.output.suffix == ".pvd" and good:
        save(arguments.output, _series(good).encode())
        out.say(f"wrote {arguments.output}", output=str(arguments.output))
    if len(good) < total:
        missing = f"{total - len(good)} of {count(total, 'case')}"
        out.complain(f"{missing} not written; --allow-inverted writes all the same.")
    return 1 if bad else 0


def _series(cases: list[Case]) -> str:
    """ParaView's collection of files, each at its time."""

    rows = [f'    <DataSet timestep="{case.time!r}" part="0" file={quoteattr(case.output.name)}/>' for case in cases]
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
            "  <Collection>",
            *rows,
            "  </Collection>",
            "</VTKFile>",
            "",
        ]
    )
