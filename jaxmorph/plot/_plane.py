"""Pictures in the plane, with matplotlib."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay

import jaxmorph as jm

from ._style import BLUE, COLOURS, DARK, GREEN, GREY, ORANGE, check_values

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection, PolyCollection
except ImportError as error:
    raise ImportError("jaxmorph.plot needs matplotlib and pyvista: pip install 'jaxmorph[plot]'") from error

Window = tuple[tuple[float, float], tuple[float, float]]

THINNEST, THICKEST = 0.01, 0.6
"""Of grid lines, in typographic points: a line takes a sixth of its cell, so that boundary layers do not turn black."""

FOUR_CORNERS = {"line": [0, 1, 1, 0], "triangle": [0, 1, 2, 2], "quad": [0, 1, 2, 3]}


def mesh(
    mesh: jm.Mesh,
    points: Float[Any, "n 2"] | None = None,
    *,
    values: Float[Any, " k"] | None = None,
    limits: tuple[float, float] | None = None,
    window: Window | None = None,
    axis: Axes | None = None,
) -> Axes:
    """The cells of a mesh in the plane, at `points` if given, coloured by `values` (one for each cell, as `quality` gives).

    `limits` are the values at the ends of the colour scale, `window` ((left, right), (bottom, top)) is what is shown.
    `axis.collections[0]` is what a colour bar needs.

    Raises `ValueError` for a mesh in space and for a number of values that is not that of the cells.
    """
    axis, corners = _axis(axis), _corners(mesh, points)
    window = _show(axis, corners.reshape(-1, 2), window)
    seen = _inside(corners, window)
    if values is not None:
        check_values(values, len(corners))
        faces = PolyCollection(list(corners[seen]), cmap=COLOURS, linewidths=0.3, edgecolors="face", rasterized=True)
        axis.set_facecolor("#c4cad3")  # what is not mesh: bodies
        faces.set_array(np.asarray(values)[seen])
        faces.set_clim(*(limits if limits is not None else (None, None)))
        axis.add_collection(faces, autolim=False)
    _edges(axis, corners[seen], window, DARK)
    return axis


def before_after(
    mesh: jm.Mesh, points: Float[Any, "n 2"], *, window: Window | None = None, axis: Axes | None = None
) -> Axes:
    """The undeformed mesh in orange under the deformed one in blue; `window` as in `mesh`."""
    axis, before, after = _axis(axis), _corners(mesh, None), _corners(mesh, points)
    window = _show(axis, np.concatenate([before, after]).reshape(-1, 2), window)
    for corners, colour, label in ((before, ORANGE, "undeformed"), (after, BLUE, "deformed")):
        _edges(axis, corners[_inside(corners, window)], window, colour)
        axis.plot([], [], color=colour, label=label)
    axis.legend(loc="upper right", framealpha=1)
    return axis


def sources(
    points: Float[Any, "m 2"],
    reduction: jm.AbstractReduction,
    *,
    axis: Axes | None = None,
) -> Axes:
    """What a reduction chooses among the nodes of a boundary; for a `KDTree` with its leaves' boxes (figure 1 of the paper)."""
    axis, points = _axis(axis), _flat(points)
    chosen = points[reduction(points)]
    if isinstance(reduction, jm.KDTree):
        boxes = reduction.boxes(points)
        outline = boxes[:, [0, 1, 1, 0, 0], 0], boxes[:, [0, 0, 1, 1, 0], 1]
        axis.plot(*(side.T for side in outline), color=GREEN, linewidth=1.2)
        axis.plot([], [], color=GREEN, label=f"{len(boxes)} leaves")
    axis.plot(*points.T, ".", color=GREY, markersize=4, label=f"{len(points)} nodes", zorder=2)
    axis.plot(*chosen.T, "o", color=ORANGE, markersize=7, label=f"{len(chosen)} sources", zorder=3)
    axis.set_aspect("equal")
    axis.margins(0.05, 0.1)
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.02), ncols=3, frameon=False)
    return axis


def graph(
    plan: jm.Plan,
    u: Float[Any, "m 2"] | None = None,
    *,
    window: Window | None = None,
    interior: bool = False,
    axis: Axes | None = None,
) -> Axes:
    """The Delaunay graph of a plan's surface, displaced by `u` if given (figure 2 of the paper).

    Moving nodes are orange, fixed ones blue; `interior=True` shows the nodes of the volume too.
    """
    axis, points = _axis(axis), _flat(plan.points)
    moving, fixed = np.asarray(plan.moving), np.asarray(plan.fixed)
    nodes = np.concatenate([moving, fixed])
    simplices = nodes[Delaunay(points[nodes]).simplices]
    if u is not None:
        points = np.asarray(jm.deform(plan, u))
    window = _show(axis, points[nodes], window)
    if interior:
        axis.plot(*np.delete(points, nodes, axis=0).T, ".", color=GREY, markersize=2, zorder=1)
    edges = np.unique(np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    axis.add_collection(LineCollection(list(points[edges]), colors=DARK, linewidths=0.5), autolim=False)
    for ids, colour, label in ((moving, ORANGE, "moving"), (fixed, BLUE, "fixed")):
        axis.plot(*points[ids].T, ".", color=colour, markersize=5, label=label, zorder=3)
    axis.legend(loc="upper right", framealpha=1)
    return axis


def histogram(reports: Mapping[str, jm.QualityReport], *, measure: str = "skewness", axis: Axes | None = None) -> Axes:
    """How many cells have which value of a measure, for several reports by name: `{"before": ..., "after": ...}`.

    `measure` is the name of one of the report's arrays. Counts are on a logarithmic scale: the worst cells are few.
    """
    axis = _axis(axis)
    values = {name: np.asarray(getattr(report, measure)) for name, report in reports.items()}
    finite = {name: of_cells[np.isfinite(of_cells)] for name, of_cells in values.items()}
    bins = np.histogram_bin_edges(np.concatenate(list(finite.values())), bins=60)
    colours = (GREY, BLUE, ORANGE, GREEN, DARK)
    for k, (name, of_cells) in enumerate(finite.items()):
        style = {"histtype": "bar", "alpha": 0.5} if k == 0 else {"histtype": "step", "linewidth": 1.8}
        axis.hist(of_cells, bins=list(bins), label=name, color=colours[k % len(colours)], log=True, **style)
    axis.set_xlabel(measure.replace("_", " "))
    axis.set_ylabel("cells")
    axis.legend()
    return axis


def _axis(axis: Axes | None) -> Axes:
    return plt.subplots(layout="constrained")[1] if axis is None else axis


def _corners(mesh: jm.Mesh, points: Any) -> Float[np.ndarray, "k 4 2"]:
    """Corners of all cells in the order of `mesh.cells`; those of a triangle, or a line, repeated."""
    points = np.asarray(mesh.points if points is None else points)
    if points.shape[1] != 2 or not set(mesh.cells) <= set(FOUR_CORNERS):
        raise ValueError(f"this is for cells in the plane, not {mesh}; see `plot.surface` and `plot.cut`.")
    ids = [np.asarray(cells)[:, FOUR_CORNERS[kind]] for kind, cells in mesh.cells.items()]
    return points[np.concatenate(ids)]


def _flat(points: Any) -> Float[np.ndarray, "n 2"]:
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"this is for points in the plane, not of shape {points.shape}.")
    return points


def _show(axis: Axes, points: Float[np.ndarray, "n 2"], window: Window | None) -> Window:
    if window is None:
        (left, bottom), (right, top) = points.min(axis=0), points.max(axis=0)
        window = ((left, right), (bottom, top))
    axis.set(xlim=window[0], ylim=window[1], aspect="equal")
    return window


def _inside(corners: Float[np.ndarray, "k 4 2"], window: Window) -> Int[np.ndarray, " s"]:
    """Ids of the cells that may be seen."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    (left, right), (bottom, top) = window
    return np.flatnonzero((high >= (left, bottom)).all(axis=1) & (low <= (right, top)).all(axis=1))


def _edges(axis: Axes, corners: Float[np.ndarray, "k 4 2"], window: Window, colour: str) -> None:
    """Outlines of cells, thinner where cells are thin."""
    left, right = window[0]
    to_points = 72 * axis.get_window_extent().width / axis.figure.dpi / (right - left)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    (a, b), (c, d) = (corners[:, 2] - corners[:, 0]).T, (corners[:, 3] - corners[:, 1]).T
    across = np.abs(a * d - b * c) / 2 / np.maximum(edges, np.finfo(float).tiny)
    widths = np.clip(across * to_points / 6, THINNEST, THICKEST)
    outlines = PolyCollection(list(corners), facecolors="none", edgecolors=colour, linewidths=widths, rasterized=True)
    axis.add_collection(outlines, autolim=False)
