"""The paper's first case (section 3.1; figures 5 and 6): a NACA0015 rotated by 15 degrees."""

import dataclasses
import pathlib
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph import cases, io, plot, shapes  # before matplotlib: it says what to install

# isort: split
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

ANGLES = (5.0, 10.0, 15.0)  # degrees, nose up, at the end of each step

QUARTER_CHORD = np.array([0.25, 0.0])

FAR_FIELD = jm.KDTree(2)  # six sources on the paper's far field
LEAVES = (1, 2, 4, 8)  # leaves of the wall's trees to compare, with four sources a leaf
SIZE = (
    5.5,
    4.6,
)  # inches of a figure, in which 10 points are legible at a column of a journal and on a phone

AIRFOIL: plot.Window = ((-0.35, 1.45), (-0.62, 0.48))
TRAILING_EDGE: plot.Window = ((0.915, 1.035), (-0.2325, -0.1592))
LARGEST = 0.5

REDUCED = ("#08306b", "#2171b5", "#6baed6", "#9ecae1")


@dataclasses.dataclass(frozen=True)
class Study:
    """A method to compare; `file` names its mesh, `title` its picture, `style` is its line's."""

    name: str
    method: jm.AbstractMethod | None
    rebuild: bool = False
    file: str = ""
    title: str = ""
    style: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of one method: a report for each angle; lengths in chords, times in seconds."""

    study: Study
    points: np.ndarray
    reports: list[jm.QualityReport]
    change: float
    error: float
    first: float
    again: float

    @property
    def skewness(self) -> list[tuple[float, float]]:
        return [
            (float(report.mean_skewness), float(report.max_skewness)) for report in self.reports
        ]

    @property
    def inverted(self) -> int:
        return max(int(report.inverted) for report in self.reports)


def say(what: str) -> None:
    if sys.stdout.isatty():
        print(f"{what} ...", file=sys.stderr)


def run(output: pathlib.Path, *, points: int | None = None) -> int:
    """Shows the case: tables on the terminal, pictures and meshes in the folder `output`.

    `points` asks for another mesh size than the paper's. Returns 0, or 1 for an inverted cell.
    Needs float64: switch JAX's x64 mode on first.
    """
    output = pathlib.Path(output)
    mesh = cases.naca0015() if points is None else cases.naca0015(points=points)
    output.mkdir(parents=True, exist_ok=True)
    say("generating the mesh, judging it")
    start = jm.quality(mesh)
    outcomes = []
    for study in compare(mesh):
        say(f"moving the mesh, {study.name}")
        outcomes.append(measure(mesh, start, study))
    by_file = {outcome.study.file: outcome for outcome in outcomes if outcome.study.file}
    say("writing meshes")
    states = [("undeformed", np.asarray(mesh.points), start)]
    states += [(name, outcome.points, outcome.reports[-1]) for name, outcome in by_file.items()]
    written = []
    for name, moved, report in states:
        written += write(
            output / f"naca0015-{name}.su2", mesh, moved, {"skewness": np.asarray(report.skewness)}
        )
    figures = [output / "figure5.png", output / "figure6.png"]
    say("drawing airfoil and trailing edge (figure 5)")
    figure5(figures[0], mesh, [by_file["dgm"], by_file["reduced-rbf"]])
    say("drawing the skewness of all methods (figure 6)")
    figure6(figures[1], start, outcomes, ANGLES)
    print(_tables(mesh, start, outcomes))
    print("\nwrote", "\n      ".join(map(str, [*figures, *written])))
    return int(any(outcome.inverted for outcome in outcomes))


def compare(mesh: jm.Mesh) -> list[Study]:
    points = np.asarray(mesh.points)
    wall = points[mesh.patch("airfoil")]
    far = points[mesh.patch("farfield")]
    full = {"color": plot.DARK, "marker": "x", "linewidth": 2, "markersize": 9, "zorder": 3}
    dgm = {"color": plot.ORANGE, "marker": "s", "linewidth": 2}
    graph = jm.DelaunayGraph()
    studies = [
        Study(f"full RBF, {len(wall)} + {len(far)}", jm.RBF.classic(), file="full-rbf", style=full),
        Study("DGM, ids kept", graph, file="dgm", title="Delaunay graph mapping", style=dgm),
        Study("DGM, ids found again", graph, rebuild=True, style=dgm | {"linestyle": "--"}),
    ]
    for leaves, shade, marker in zip(LEAVES, REDUCED, "o^vD", strict=False):
        rbf = jm.RBF(reduction=jm.KDTree(leaves), fixed_reduction=FAR_FIELD)
        count = f"{len(rbf.reduction(wall))} + {len(FAR_FIELD(far))}"
        title, file = (
            (f"Reduced RBF, {count} sources", "reduced-rbf") if leaves == LEAVES[0] else ("", "")
        )
        style = {"color": shade, "marker": marker, "linewidth": 2}
        method = jm.SurfaceReconstruction(rbf, graph)
        studies.append(Study(f"reduced RBF, {count}", method, file=file, title=title, style=style))
    return studies


def measure(mesh: jm.Mesh, start: jm.QualityReport, study: Study) -> Outcome:
    """Prepares, marches twice (once without compiling), and judges the mesh after each step."""
    moving = mesh.patch("airfoil")
    fixed = mesh.patch("farfield")
    wall = np.asarray(mesh.points)[moving]
    path = np.stack(
        [np.asarray(shapes.rotate(wall, -np.deg2rad(up), QUARTER_CHORD)) - wall for up in ANGLES]
    )
    times = [time.perf_counter()]
    plan = jm.prepare(mesh.points, moving, fixed, method=study.method)
    plans, end = jm.march(plan, path, rebuild=study.rebuild)
    points = np.asarray(end)
    times.append(time.perf_counter())
    np.asarray(jm.march(plan, path, rebuild=study.rebuild)[1])
    times.append(time.perf_counter())
    reports = [
        jm.quality(mesh, stage) for stage in (*(after.points for after in plans[1:]), points)
    ]
    change = np.abs(np.asarray(reports[-1].skewness) - np.asarray(start.skewness))[
        near_wall(mesh)
    ].mean()
    error = np.abs(points[moving] - mesh.points[moving] - path[-1]).max()
    first, again = np.diff(times).tolist()
    return Outcome(study, points, reports, float(change), float(error), first, again)


def near_wall(mesh: jm.Mesh) -> np.ndarray:
    """Lists cells in the inner 40 % of the layers round the airfoil, without the wake."""
    quads = mesh.cells["quad"]
    wall = mesh.patch("airfoil")
    wake = wall[0]
    columns = quads[0, 3] - 1
    base = len(wall) - (columns - 2 * wake)
    layers = (len(quads) - wake * base) // columns
    return (
        np.arange(round(0.4 * layers))[:, None] * columns + np.arange(wake, columns - wake)
    ).ravel()


def _tables(mesh: jm.Mesh, start: jm.QualityReport, outcomes: list[Outcome]) -> str:
    undeformed = f"{float(start.mean_skewness):.4f}", f"{float(start.max_skewness):.4f}"
    steps = [
        ("", *(head for angle in ANGLES for head in (f"at {angle:g}", "degrees"))),
        ("", *("mean", "max") * len(ANGLES)),
        ("undeformed", *undeformed, *[""] * 4),
    ]
    last = [
        ("", "mean", "max", "change", "inverted", "surface", "first", "once"),
        (f"at {ANGLES[-1]:g} degrees", "skew", "skew", "at wall", "cells", "error", "time", "more"),
        ("undeformed", *undeformed, *[""] * 5),
    ]
    for outcome in outcomes:
        skewness = [f"{number:.4f}" for pair in outcome.skewness for number in pair]
        rest = (
            f"{outcome.change:.3f} {outcome.inverted} {outcome.error:.1g} {outcome.first:.2f} "
            f"{outcome.again:.3f}"
        )
        steps.append((outcome.study.name, *skewness))
        last.append((outcome.study.name, *skewness[-2:], *rest.split()))
    size = f"{len(mesh.points)} points, {len(mesh.cells['quad'])} cells"
    return f"""\
NACA0015 C-grid, {size}: rotated nose up by {ANGLES[-1]:g} degrees
about the quarter chord in {len(ANGLES)} steps, far field fixed; wall + far-field sources.

{table(last[:2], last[2:])}

change at wall: mean absolute change of skewness in the {len(near_wall(mesh))} cells next to it;
surface error in chords; first time: seconds for ids, compiling and three steps,
once more: for the three steps again.

{table(steps[:2], steps[2:])}"""


def write(
    path: pathlib.Path, mesh: jm.Mesh, points: np.ndarray, values: dict[str, np.ndarray]
) -> list[pathlib.Path]:
    moved = mesh.moved(points)
    picture = path.with_suffix(".vtu")
    io.write(path, moved)
    io.write(picture, moved, point_data={"displacement": points - mesh.points}, cell_data=values)
    return [path, picture]


def table(heads: Sequence[tuple[str, ...]], rows: Sequence[tuple[str, ...]]) -> str:
    first, *others = [max(map(len, column)) for column in zip(*heads, *rows, strict=True)]
    lines = [
        "  ".join(
            [
                name.ljust(first),
                *(cell.rjust(width) for cell, width in zip(cells, others, strict=True)),
            ]
        ).rstrip()
        for name, *cells in (*heads, *rows)
    ]
    lines.insert(len(heads), "-" * (first + sum(others) + 2 * len(others)))
    return "\n".join(lines)


def figure5(path: pathlib.Path, mesh: jm.Mesh, outcomes: Sequence[Outcome]) -> None:
    figure = Figure(figsize=SIZE, dpi=200, layout="constrained")
    axes = figure.subplots(2, len(outcomes), squeeze=False)
    letters = iter("abcdefgh")
    for row, window in zip(axes, (AIRFOIL, TRAILING_EDGE), strict=True):
        for axis, outcome in zip(row, outcomes, strict=True):
            skewness = np.asarray(outcome.reports[-1].skewness)
            plot.mesh(
                mesh,
                outcome.points,
                values=skewness,
                limits=(0, LARGEST),
                window=window,
                bar=False,
                ax=axis,
            )
            axis.set(xlabel="x / chord", ylabel="y / chord")
            axis.locator_params(nbins=3)
            frame = {"facecolor": "w", "linewidth": 0, "pad": 2}
            axis.text(
                0.03,
                0.95,
                next(letters),
                transform=axis.transAxes,
                va="top",
                weight="bold",
                bbox=frame,
            )
    (left, right), (low, high) = TRAILING_EDGE
    for axis, outcome in zip(axes[0], outcomes, strict=True):
        axis.set_title(
            f"{outcome.study.title}\nlargest skewness {outcome.skewness[-1][1]:.2f}",
            fontsize="medium",
        )
        axis.add_patch(
            Rectangle(
                (left, low), right - left, high - low, fill=False, color=plot.BLUE, linewidth=1.5
            )
        )
    for axis in axes[1]:
        axis.spines[:].set(color=plot.BLUE, linewidth=1.5)
    figure.colorbar(
        axes[0, 0].collections[0],
        ax=axes,
        location="bottom",
        aspect=40,
        label="skewness of the cells",
    )
    figure.savefig(path)


def figure6(
    path: pathlib.Path,
    start: jm.QualityReport,
    outcomes: Sequence[Outcome],
    angles: Sequence[float],
) -> None:
    figure = Figure(figsize=SIZE, dpi=200, layout="constrained")
    axes = figure.subplots(1, 2)
    undeformed = float(start.mean_skewness), float(start.max_skewness)
    for outcome in outcomes:
        for column, axis in enumerate(axes):
            values = [undeformed[column], *(pair[column] for pair in outcome.skewness)]
            axis.plot([0, *angles], values, label=outcome.study.name, **outcome.study.style)
    for axis, what in zip(axes, ("a   mean skewness", "b   largest skewness"), strict=True):
        axis.set_title(what, fontsize="medium", loc="left")
        axis.set(xlabel="rotation in degrees", xticks=[0, *angles])
        axis.grid(axis="y", color="#dddddd")
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", frameon=False, ncols=2
    )
    figure.savefig(path)
