"""Pictures in the plane, with matplotlib."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay

import jaxmorph as jm

from ._style import BLUE, DARK, GREY, ORANGE, check_values, colour_scale

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.ticker import ScalarFormatter as ScalarFormatter
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
    label: str | None = None,
    window: Window | None = None,
    axis: Axes | None = None,
) -> Axes:
    """The cells of a mesh in the plane, at `points` if given, coloured by `values` (one for each cell, as `quality` gives).

    `limits` are the values at the light and at the dark end of the colours: (1, 0) for a measure that is small where cells
    are bad. With a `label`, what the values are, a colour bar is drawn; `axis.collections[0]` is what one of your own needs.
    `window` ((left, right), (bottom, top)) is what is shown.

    Raises `ValueError` for a mesh in space, for points of another shape than the mesh's, for a number of values that is not that
    of the cells, and for a `label` without values.
    """
    corners = _corners(mesh, points)
    if values is None and label is not None:
        raise ValueError(f"there are no `values` that are {label!r}.")
    if values is not None:
        check_values(values, len(corners))
    colours, limits = colour_scale(limits)
    axis = given_or_new(axis)
    window = show(axis, corners.reshape(-1, 2), window)
    seen = _inside(corners, window)
    if values is not None:
        faces = PolyCollection(list(corners[seen]), cmap=colours, linewidths=0.3, edgecolors="face", rasterized=True)
        axis.set_facecolor("#c4cad3")  # what is not mesh: bodies
        faces.set_array(np.asarray(values)[seen])
        faces.set_clim(*(limits if limits is not None else (None, None)))
        axis.add_collection(faces, autolim=False)
        if label is not None:
            axis.figure.colorbar(faces, cax=axis.inset_axes((1.02, 0, 0.03, 1)), label=label)
    _edges(axis, corners[seen], window, DARK)
    return axis


def before_after(
    mesh: jm.Mesh, points: Float[Any, "n 2"], *, window: Window | None = None, axis: Axes | None = None
) -> Axes:
    """The undeformed mesh in orange under the deformed one in blue; `window` and errors as in `mesh`."""
    before, after = _corners(mesh, None), _corners(mesh, points)
    axis = given_or_new(axis)
    window = show(axis, np.concatenate([before, after]).reshape(-1, 2), window)
    for corners, colour, label in ((before, ORANGE, "undeformed"), (after, BLUE, "deformed")):
        _edges(axis, corners[_inside(corners, window)], window, colour)
        axis.plot([], [], color=colour, label=label)
    axis.legend(loc="upper right", framealpha=1)
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

    Moving nodes are orange, fixed ones blue; `interior=True` shows the nodes of the volume too, where the plan's method puts
    them.

    Raises `ValueError` for a plan in space, and when the shape of `u` is not (m, 2).
    """
    points = flat(plan.points)
    moving, fixed = np.asarray(plan.moving), np.asarray(plan.fixed)
    nodes = np.concatenate([moving, fixed])
    simplices = nodes[Delaunay(points[nodes]).simplices]
    if u is not None:
        points = np.asarray(jm.deform(plan, u))
    axis = given_or_new(axis)
    window = show(axis, points[nodes], window)
    if interior:
        axis.plot(*np.delete(points, nodes, axis=0).T, ".", color=GREY, markersize=2, zorder=1)
    edges = np.unique(np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    axis.add_collection(LineCollection(list(points[edges]), colors=DARK, linewidths=0.5), autolim=False)
    for ids, colour, label in ((moving, ORANGE, "moving"), (fixed, BLUE, "fixed")):
        axis.plot(*points[ids].T, ".", color=colour, markersize=5, label=label, zorder=3)
    axis.legend(loc="upper right", framealpha=1)
    return axis


def given_or_new(axis: Axes | None) -> Axes:
    return plt.subplots(layout="constrained")[1] if axis is None else axis


def _corners(mesh: jm.Mesh, points: Any) -> Float[np.ndarray, "k 4 2"]:
    """Corners of all cells in the order of `mesh.cells`; those of a triangle, or a line, repeated."""
    if mesh.points.shape[1] != 2:
        raise ValueError(
            f"this is for cells in the plane, not {mesh}; see `plot.surface`, `plot.cut` and `plot.before_after_in_space`."
        )
    points = np.asarray(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
    ids = [np.asarray(cells)[:, FOUR_CORNERS[kind]] for kind, cells in mesh.cells.items()]
    return points[np.concatenate(ids)]


def flat(points: Any, in_space: str | None = None) -> Float[np.ndarray, "n 2"]:
    """Points in the plane; `ValueError` for others, with what to use `in_space`."""
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2:
        see = "" if in_space is None else f"; see `{in_space}`"
        raise ValueError(f"this is for points in the plane, not of shape {points.shape}{see}.")
    return points


def show(axis: Axes, points: Float[np.ndarray, "n 2"], window: Window | None) -> Window:
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
