"""The paper's second case (section 3.2): the AGARD 445.6 wing, bent and twisted; tables, and with --output pictures and meshes.

python benchmarks/wing.py [--output wing] [--points 64943] [--classic]

A minute and a half with meshing (`pip install 'jaxmorph[plot,io,cases]'`). --classic adds the classic RBF, every surface node a
source: at full size some 17,000 equations, 6 GB, and minutes on two cores.
"""

import argparse
import dataclasses
import pathlib
import time
from collections.abc import Sequence
from typing import Any

import agard445
import jax
import matplotlib
import numpy as np
import pyvista
from _measure import about
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import jaxmorph as jm
from jaxmorph import plot
from jaxmorph._demo import Study, align, say, write_state

MOTIONS = ((1, 0.0735), (1, 0.1), (1, 0.25), (1, 0.5), (1, 0.75), (2, 0.2), (2, 0.3))
"""Mode, and motion of the tip's trailing edge in semi-spans.

At 0.0735 the mean aspect ratio rises as in the paper.
"""

SHOWN = (1, 0.5)
"""The motion of the pictures and of the meshes that are written."""

STYLE: dict[Any, Any] = {"font.size": 13, "axes.titlesize": 15}
ASPECT_RATIO = 1.0, 4.0
CHANGE_OF_VOLUME = 0.0, 0.3
"""Values at the ends of the scales."""

CUT = 0.92
"""Place of the cut across the wing, in semi-spans."""

HALF_CUT = (0.36, 0.25)
"""Half width and half height of what is shown of the cut, in metres."""

ABOVE = (-1.0, -3.0, 2.2)
"""Direction from the wing to the viewer of the whole wing: above its root."""

HEIGHT = 1400
"""Height of a 3-D picture in pixels: more than are shown, so that lines are thin."""

MARGIN = 1.04
"""Height and width of a picture, relative to the height and width of its content."""


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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--output",
        type=pathlib.Path,
        help="a folder for pictures and meshes (default: the tables alone)",
    )
    parser.add_argument("--points", type=int, default=64_943, choices=agard445.RESOLUTIONS)
    parser.add_argument("--classic", action="store_true", help="compare the classic RBF too")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    say("meshing the wing with gmsh, unless it is in the cache")
    mesh = agard445.mesh(asked.points)
    about(n=len(mesh.points), b=len(mesh.patch("wing")) + len(mesh.patch("farfield")))
    start, outcomes = jm.quality(mesh), []
    for study in [
        *compare(),
        *([Study("classic RBF", jm.RBF.classic(), file="classic")] if asked.classic else []),
    ]:
        say(f"moving the mesh, {study.name}")
        outcomes.append(measure(mesh, study))
    print(_tables(mesh, start, outcomes))
    if asked.output is not None:
        asked.output.mkdir(parents=True, exist_ok=True)
        shown(asked.output, mesh, start, outcomes)
    return int(any(outcome.inverted for outcome in outcomes if outcome.study.file != "dgm"))


def shown(
    output: pathlib.Path, mesh: jm.Mesh, start: jm.QualityReport, outcomes: list[Outcome]
) -> None:
    """Writes meshes and pictures of the motion that is shown."""
    written = write_state(
        output / "agard445-undeformed.su2", mesh, np.asarray(mesh.points), _aspect_ratio(start)
    )
    for outcome in outcomes:
        path, values = (
            output / f"agard445-{outcome.study.file}.su2",
            _aspect_ratio(outcome.reports[SHOWN]),
        )
        written += write_state(path, mesh, outcome.points, values)
    drawn = [output / "agard445-surface.png", output / "agard445-cut.png"]
    surface(drawn[0], mesh, start, outcomes[2], SHOWN)
    cut(drawn[1], mesh, outcomes[:2], SHOWN)
    print("\nwrote", "\n      ".join(map(str, [*drawn, *written])))


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
    shown = np.asarray(jm.deform(plan, agard445.mode(wing, *SHOWN)))
    preparation = time.perf_counter() - begin
    reports, errors, seconds = {}, [], []
    for motion in MOTIONS:
        u = agard445.mode(wing, *motion)
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
        costs.append(
            (outcome.study.name, *map(str, outcome.sources), f"{outcome.error:.1g}", *times)
        )
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
    return "\n".join(
        [
            *heading,
            align([*heads, *rows], len(heads)),
            "",
            align([*cost_heads, *costs], len(cost_heads)),
            *notes,
        ]
    )


def surface(
    path: pathlib.Path, mesh: jm.Mesh, start: jm.QualityReport, outcome: Outcome, motion: Any
) -> None:
    """Draws the wing before and after, each face coloured by its cell's aspect ratio."""
    views = [
        ("undeformed", mesh.points, start),
        (
            f"mode {motion[0]}, tip up by {motion[1]:g} semi-spans",
            outcome.points,
            outcome.reports[motion],
        ),
    ]
    wing = mesh.patch("wing")
    camera, half = whole(np.concatenate([points[wing] for _, points, _ in views]), ABOVE)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13.33, 7.5), dpi=150, layout="constrained")
        axes = figure.subplots(1, len(views))
        for axis, (title, points, report) in zip(axes, views, strict=True):
            values = np.asarray(report.aspect_ratio)
            plotter = plot.surface(
                mesh, points, values=values, limits=ASPECT_RATIO, bar=False, patch="wing"
            )
            _show(axis, plotter, camera, half, title)
        _bar(figure, axes, ASPECT_RATIO, "aspect ratio of the cells on the wing")
        figure.savefig(path)


def cut(path: pathlib.Path, mesh: jm.Mesh, outcomes: Sequence[Outcome], motion: Any) -> None:
    """Draws the cells that a plane across the wing cuts, by each method.

    The aspect ratio is above, the change of volume below.
    """
    plane = jm.Plane((0, 1, 0), (0, _span_of_cut(mesh), 0))
    kinds = (ASPECT_RATIO, "aspect ratio"), (CHANGE_OF_VOLUME, "|V/V0 - 1|")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13.33, 8.6), dpi=150, layout="constrained")
        axes = figure.subplots(2, len(outcomes), squeeze=False)
        for column, outcome in zip(axes.T, outcomes, strict=True):
            report = outcome.reports[motion]
            values = np.asarray(report.aspect_ratio), np.abs(np.asarray(report.volume_ratio) - 1)
            titles = (
                outcome.study.name,
                f"smallest V/V0 of all cells {float(report.min_volume_ratio):.2f}",
            )
            camera = _across(mesh, outcome.points)
            for axis, shown, (limits, _), title in zip(column, values, kinds, titles, strict=True):
                window = pyvista.Plotter(off_screen=True)  # one that is given shows all that is cut
                drawn = {"values": shown, "limits": limits, "bar": False, "plotter": window}
                plotter = plot.cut(mesh, outcome.points, plane=plane, **drawn)
                _show(axis, plotter, camera, HALF_CUT, title)
        for row, (limits, label) in zip(axes, kinds, strict=True):
            _bar(figure, row, limits, label)
        figure.savefig(path)


def _across(mesh: jm.Mesh, points: np.ndarray) -> tuple:
    """Makes a camera that sees x to the right and z up, round the section that is cut."""
    wing, y = points[mesh.patch("wing")], _span_of_cut(mesh)
    section = wing[np.abs(wing[:, 1] - y) < 0.02]
    x, _, z = (section.min(axis=0) + section.max(axis=0)) / 2
    return (x, y - 5, z), (x, y, z), (0, 0, 1)


def _span_of_cut(mesh: jm.Mesh) -> float:
    return CUT * float(mesh.points[mesh.patch("wing"), 1].max())


def whole(
    points: np.ndarray, viewer: tuple[float, float, float]
) -> tuple[tuple, tuple[float, float]]:
    """Places a camera in the direction `viewer` that sees all points (n, 3), z up.

    It returns also half the width and height of the picture.
    """
    towards = np.asarray(viewer) / np.linalg.norm(viewer)
    right = np.cross((0, 0, 1), towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right), towards])
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    focus = (low + high) / 2 @ axes
    width, height = MARGIN * (high - low)[:2] / 2
    return (focus + 5 * towards, focus, (0, 0, 1)), (float(width), float(height))


def _show(axis: Any, plotter: Any, camera: tuple, half: tuple[float, float], title: str) -> None:
    """Puts a 3-D picture on a 2-D axis, without perspective; `half` is half its size."""
    plotter.window_size = round(HEIGHT * half[0] / half[1]), HEIGHT
    plotter.set_background("white")
    plotter.camera_position = [tuple(map(float, vector)) for vector in camera]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = half[1]
    axis.imshow(plotter.screenshot(return_img=True))
    plotter.close()
    axis.set_title(title)
    axis.set_axis_off()


def _bar(figure: Figure, axes: Any, limits: tuple[float, float], label: str) -> None:
    scale = ScalarMappable(Normalize(*limits), plot.COLOURS)
    figure.colorbar(scale, ax=axes, aspect=35, pad=0.02, extend="max").set_label(label)


if __name__ == "__main__":
    raise SystemExit(main())
