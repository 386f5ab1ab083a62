"""The paper's second case (section 3.2): the AGARD 445.6 wing, bent and twisted."""

import dataclasses
import pathlib
import time

import numpy as np

import jaxmorph as jm
from jaxmorph import cases

from . import _wing_pictures as pictures
from ._terminal import Study, progress, table, write

POINTS = 64_943
"""The paper's number of points."""

MOTIONS = ((1, 0.0735), (1, 0.1), (1, 0.25), (1, 0.5), (1, 0.75), (2, 0.2), (2, 0.3))
"""Mode, and motion of the tip's trailing edge in semi-spans.

At 0.0735 the mean aspect ratio rises as in the paper.
"""

SHOWN = (1, 0.5)
"""The motion of the pictures and of the meshes that are written."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of one method in metres and seconds: a report for each of MOTIONS.

    `points` are the mesh's points after the motion that is shown.
    """

    study: Study
    points: np.ndarray
    reports: dict[tuple[int, float], jm.QualityReport]
    sources: tuple[int, int]
    error: float
    preparation: float
    step: float

    @property
    def inverted(self) -> int:
        """Inverted cells of all motions together."""
        return sum(int(report.inverted) for report in self.reports.values())


def run(output: pathlib.Path, *, points: int | None = None) -> int:
    """Runs the whole comparison; returns 1 where the paper's method or the default fails."""
    output.mkdir(parents=True, exist_ok=True)
    studies = compare()
    with progress(len(studies) + 5) as say:
        say("meshing the wing with gmsh, unless it is in the cache")
        mesh = cases.agard445(points=POINTS if points is None else points)
        say("judging it")
        start, outcomes = jm.quality(mesh), []
        for study in studies:
            say(f"moving the mesh, {study.name}")
            outcomes.append(measure(mesh, study))
        say("writing meshes")
        written = write(output / "agard445-undeformed.su2", mesh, np.asarray(mesh.points), _aspect_ratio(start))
        for outcome in outcomes:
            path, values = output / f"agard445-{outcome.study.file}.su2", _aspect_ratio(outcome.reports[SHOWN])
            written += write(path, mesh, outcome.points, values)
        drawn = [output / "agard445-surface.png", output / "agard445-cut.png"]
        say("drawing the wing")
        pictures.surface(drawn[0], mesh, start, outcomes[-1], SHOWN)
        say("drawing cuts")
        pictures.cut(drawn[1], mesh, outcomes[:2], SHOWN)
    print(_tables(mesh, start, outcomes))
    print("\nwrote", "\n      ".join(map(str, [*drawn, *written])))
    return int(any(outcome.inverted for outcome in outcomes if outcome.study.file != "dgm"))


def compare() -> list[Study]:
    """Lists the methods to compare: the graph alone, the paper's method, `prepare`'s default."""
    paper = jm.SurfaceReconstruction(
        jm.RBF(reduction=jm.KDTree(64), fixed_reduction=jm.AllPoints()), jm.DelaunayGraph()
    )
    return [
        Study("DGM", jm.DelaunayGraph(), file="dgm"),
        Study("reduced RBF", paper, file="reduced-rbf"),
        Study("default", None, file="default"),
    ]


def measure(mesh: jm.Mesh, study: Study) -> Outcome:
    """Prepares once and moves the mesh by each of MOTIONS, in one step."""
    moving, fixed = mesh.patch("wing"), mesh.patch("farfield")
    wing = mesh.points[moving]
    begin = time.perf_counter()
    plan = jm.prepare(mesh.points, moving, fixed, method=study.method)
    shown = np.asarray(jm.deform(plan, cases.agard445_mode(wing, *SHOWN)))
    preparation = time.perf_counter() - begin
    reports, errors, seconds = {}, [], []
    for motion in MOTIONS:
        u = cases.agard445_mode(wing, *motion)
        begin = time.perf_counter()
        points = np.asarray(jm.deform(plan, u))
        seconds.append(time.perf_counter() - begin)
        errors.append(np.abs(points[moving] - wing - u).max())
        reports[motion] = jm.quality(mesh, points)
    return Outcome(study, shown, reports, _sources(plan), max(errors), preparation, min(seconds))


def _sources(plan: jm.Plan) -> tuple[int, int]:
    """Counts the sources on the wing and on the far field; 0 without radial functions."""
    on_wing = int(np.isin(plan.sources, np.asarray(plan.moving)).sum())
    return on_wing, len(plan.sources) - on_wing


def _aspect_ratio(report: jm.QualityReport) -> dict[str, np.ndarray]:
    return {"aspect_ratio": np.asarray(report.aspect_ratio)}


def _numbers(report: jm.QualityReport) -> tuple[str, ...]:
    mean = float(report.mean("aspect_ratio", weighted=False))
    return f"{mean:.4f}", f"{float(report.max_aspect_ratio):.2f}"


def _tables(mesh: jm.Mesh, start: jm.QualityReport, outcomes: list[Outcome]) -> str:
    rows: list[tuple[str, ...]] = [("undeformed", "", *_numbers(start), "1", "0")]
    for mode, amplitude in MOTIONS:
        for outcome in outcomes:
            report = outcome.reports[mode, amplitude]
            last = f"{float(report.min_volume_ratio):.3f}", str(int(report.inverted))
            motion = f"mode {mode}, {amplitude:g}" if outcome is outcomes[0] else ""
            rows.append((motion, outcome.study.name, *_numbers(report), *last))
    costs: list[tuple[str, ...]] = []
    for outcome in outcomes:
        times = f"{outcome.preparation:.1f}", f"{outcome.step:.3f}"
        costs.append((outcome.study.name, *map(str, outcome.sources), f"{outcome.error:.1g}", *times))
    heads = [
        ("", "", "mean", "largest", "smallest", "inverted"),
        ("motion", "method", "aspect", "aspect", "V/V0", "cells"),
    ]
    cost_heads = [
        ("", "sources", "sources", "surface", "first", "each"),
        ("method", "wing", "far", "error", "time", "more"),
    ]
    heading = (
        f"AGARD 445.6 wing, {len(mesh.points)} points, {len(mesh.cells['tetra'])} tetrahedra;",
        f"{len(mesh.patch('wing'))} nodes move, {len(mesh.patch('farfield'))} are fixed. Bent by mode 1, twisted by mode 2,",
        "in one step each; amplitude of the tip's trailing edge in semi-spans.\n",
    )
    notes = (
        "\nsurface error in metres; first time: seconds for ids, compiling and one step,",
        "each more: for one step.",
    )
    return "\n".join([*heading, table(heads, rows), "", table(cost_heads, costs), *notes])
