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
TREES = (1, 2, 4, 8)  # leaves of the wall's trees to compare, with four sources a leaf

# inches of a figure, in which 10 points are legible at a column of a journal and on a phone
SIZE = (5.5, 4.6)

AIRFOIL: plot.Window = ((-0.35, 1.45), (-0.62, 0.48))
TRAILING_EDGE: plot.Window = ((0.915, 1.035), (-0.2325, -0.1592))
SKEWEST = 0.5  # skewness at the dark end of the colours

SHADES = ("#08306b", "#2171b5", "#6baed6", "#9ecae1")  # of reduced RBF, for `TREES`


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


def run_paper_case(output: pathlib.Path, *, points: int | None = None) -> int:
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
    for study in studies_of(mesh):
        say(f"moving the mesh, {study.name}")
        outcomes.append(outcome_of(mesh, start, study))
    by_file = {outcome.study.file: outcome for outcome in outcomes if outcome.study.file}
    say("writing meshes")
    states = {"undeformed": (np.asarray(mesh.points), start)}
    states |= {name: (outcome.points, outcome.reports[-1]) for name, outcome in by_file.items()}
    written = []
    for name, (points_then, report) in states.items():
        path = output / f"naca0015-{name}.su2"
        skewness = {"skewness": np.asarray(report.skewness)}
        written += write_state(path, mesh, points_then, skewness)
    figures = [output / "figure5.png", output / "figure6.png"]
    say("drawing airfoil and trailing edge (figure 5)")
    figure5(figures[0], mesh, [by_file["dgm"], by_file["reduced-rbf"]])
    say("drawing the skewness of all methods (figure 6)")
    figure6(figures[1], start, outcomes, ANGLES)
    print(_tables(mesh, start, outcomes))
    print("\nwrote", "\n      ".join(map(str, [*figures, *written])))
    return int(any(outcome.inverted for outcome in outcomes))


def studies_of(mesh: jm.Mesh) -> list[Study]:
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
    for leaves, shade, marker in zip(TREES, SHADES, "o^vD", strict=False):
        rbf = jm.RBF(reduction=jm.KDTree(leaves), fixed_reduction=FAR_FIELD)
        count = f"{len(rbf.reduction(wall))} + {len(FAR_FIELD(far))}"
        study = Study(
            f"reduced RBF, {count}",
            jm.SurfaceReconstruction(rbf, graph),
            file="reduced-rbf" if leaves == TREES[0] else "",
            title=f"Reduced RBF, {count} sources",
            style={"color": shade, "marker": marker, "linewidth": 2},
        )
        studies.append(study)
    return studies


def outcome_of(mesh: jm.Mesh, start: jm.QualityReport, study: Study) -> Outcome:
    """Prepares, marches twice (once without compiling), and judges the mesh after each step."""
    moving = mesh.patch("airfoil")
    fixed = mesh.patch("farfield")
    wall = np.asarray(mesh.points)[moving]
    turned = [np.asarray(shapes.rotate(wall, -np.deg2rad(up), QUARTER_CHORD)) for up in ANGLES]
    path = np.stack(turned) - wall
    times = [time.perf_counter()]
    plan = jm.prepare(mesh.points, moving, fixed, method=study.method)
    plans, end = jm.march(plan, path, rebuild=study.rebuild)
    points = np.asarray(end)
    times.append(time.perf_counter())
    np.asarray(jm.march(plan, path, rebuild=study.rebuild)[1])
    times.append(time.perf_counter())
    reports = [jm.quality(mesh, after.points) for after in plans[1:]] + [jm.quality(mesh, points)]
    change = np.abs(np.asarray(reports[-1].skewness) - np.asarray(start.skewness))
    return Outcome(
        study=study,
        points=points,
        reports=reports,
        change=float(change[near_wall(mesh)].mean()),
        error=float(np.abs(points[moving] - wall - path[-1]).max()),
        first=times[1] - times[0],
        again=times[2] - times[1],
    )


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
        steps.append((outcome.study.name, *skewness))
        rest = (
            f"{outcome.change:.3f}",
            f"{outcome.inverted}",
            f"{outcome.error:.1g}",
            f"{outcome.first:.2f}",
            f"{outcome.again:.3f}",
        )
        last.append((outcome.study.name, *skewness[-2:], *rest))
    size = f"{len(mesh.points)} points, {len(mesh.cells['quad'])} cells"
    return f"""\
NACA0015 C-grid, {size}: rotated nose up by {ANGLES[-1]:g} degrees
about the quarter chord in {len(ANGLES)} steps, far field fixed; wall + far-field sources.

{align(last, 2)}

change at wall: mean absolute change of skewness in the {len(near_wall(mesh))} cells next to it;
surface error in chords; first time: seconds for ids, compiling and three steps,
once more: for the three steps again.

{align(steps, 2)}"""


def write_state(
    path: pathlib.Path, mesh: jm.Mesh, points: np.ndarray, values: Mapping[str, Any]
) -> list[pathlib.Path]:
    moved = mesh.moved(points)
    picture = path.with_suffix(".vtu")
    io.write(path, moved)
    of_points = {"displacement": points - mesh.points}
    io.write(picture, moved, point_data=of_points, cell_data=dict(values))
    return [path, picture]


def align(rows: Sequence[tuple[str, ...]], heads: int) -> str:
    """Text of columns: the first to the left, the others to the right, a line below the heads."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    first, *others = [f"{{:{'>' if k else '<'}{width}}}" for k, width in enumerate(widths)]
    form = "  ".join([first, *others])
    lines = [form.format(*row).rstrip() for row in rows]
    lines.insert(heads, "-" * len(form.format(*rows[0])))
    return "\n".join(lines)


def figure5(path: pathlib.Path, mesh: jm.Mesh, outcomes: Sequence[Outcome]) -> None:
    figure = Figure(figsize=SIZE, dpi=200, layout="constrained")
    axes = figure.subplots(2, len(outcomes), squeeze=False)
    letters = iter("abcdefgh")
    shown: dict[str, Any] = {"limits": (0, SKEWEST), "bar": False}
    frame = {"facecolor": "w", "linewidth": 0, "pad": 2}
    letter: dict[str, Any] = {"va": "top", "weight": "bold", "bbox": frame}
    for row, window in zip(axes, (AIRFOIL, TRAILING_EDGE), strict=True):
        for axis, outcome in zip(row, outcomes, strict=True):
            skewness = np.asarray(outcome.reports[-1].skewness)
            plot.mesh(mesh, outcome.points, values=skewness, window=window, ax=axis, **shown)
            axis.set(xlabel="x / chord", ylabel="y / chord")
            axis.locator_params(nbins=3)
            axis.text(0.03, 0.95, next(letters), transform=axis.transAxes, **letter)
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
    below: dict[str, Any] = {"location": "bottom", "aspect": 40}
    figure.colorbar(axes[0, 0].collections[0], ax=axes, label="skewness of the cells", **below)
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
