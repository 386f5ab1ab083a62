"""Pictures of the wing: its surface before and after, and cuts through the mesh."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxmorph as jm
from jaxmorph import plot  # before matplotlib: it says what to install

# isort: split
import matplotlib
import pyvista
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from ._wing import Outcome

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


def surface(path: pathlib.Path, mesh: jm.Mesh, start: jm.QualityReport, outcome: "Outcome", motion: Any) -> None:
    """Draws the wing before and after, each face coloured by its cell's aspect ratio."""
    views = [
        ("undeformed", mesh.points, start),
        (f"mode {motion[0]}, tip up by {motion[1]:g} semi-spans", outcome.points, outcome.reports[motion]),
    ]
    wing = mesh.patch("wing")
    camera, half = whole(np.concatenate([points[wing] for _, points, _ in views]), ABOVE)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13.33, 7.5), dpi=150, layout="constrained")
        axes = figure.subplots(1, len(views))
        for axis, (title, points, report) in zip(axes, views, strict=True):
            values = np.asarray(report.aspect_ratio)
            plotter = plot.surface(mesh, points, values=values, limits=ASPECT_RATIO, bar=False, patch="wing")
            _show(axis, plotter, camera, half, title)
        _bar(figure, axes, ASPECT_RATIO, "aspect ratio of the cells on the wing")
        figure.savefig(path)


def cut(path: pathlib.Path, mesh: jm.Mesh, outcomes: Sequence["Outcome"], motion: Any) -> None:
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
            titles = outcome.study.name, f"smallest V/V0 of all cells {float(report.min_volume_ratio):.2f}"
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


def whole(points: np.ndarray, viewer: tuple[float, float, float]) -> tuple[tuple, tuple[float, float]]:
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
