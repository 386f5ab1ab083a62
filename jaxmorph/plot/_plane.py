"""Pictures in 2-D, with matplotlib."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay

import jaxmorph as jm

from .._host.cells.lagrange import PLACES
from .._host.cells.shape_functions import values as shape_values
from .._host.cells.topology import SHAPES
from .._host.package.arguments import checked, finite_array
from ._style import BLUE, DARK, GREY, ORANGE, Limits, Values, cell_values, colour_scale, finite

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection, PolyCollection
except ImportError as error:
    raise ImportError("jaxmorph.plot needs matplotlib and pyvista: pip install 'jaxmorph[plot]'") from error

Window = tuple[tuple[float, float], tuple[float, float]]

THINNEST, THICKEST = 0.01, 0.6
"""Widths of grid lines in typographic points: a line takes a sixth of its cell, so that boundary layers do not turn black."""

ROOM = 0.4
"""Margin of a picture around the bodies, relative to their extent, unless a window is given."""

FOUR_CORNERS = {"line": [0, 1, 1, 0], "triangle": [0, 1, 2, 2], "quad": [0, 1, 2, 3]}

ALONG_EDGE = 8
"""Straight pieces that draw an edge of a curved cell."""


@checked
def mesh(
    mesh: jm.Mesh,
    points: Float[Any, "n 2"] | None = None,
    *,
    values: Values | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    window: Window | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draws the cells of a 2-D mesh, coloured by a value for each cell.

    **Arguments:**

    - `mesh`: a mesh in 2-D.
    - `points`: positions (n, 2) of its nodes; the mesh's own by default.
    - `values`: one for each cell, as `quality` gives. Where the file has polyhedra or polygons, one for each whole cell will do, as
      `face_quality` gives. Without values only the lines are drawn.
    - `limits`: the values at the light and at the dark end of the colours; (1, 0) for a measure that is small where cells are bad.
    - `label`: what the values are, beside the colour bar.
    - `bar`: False leaves out the colour bar. For several axes that share one: `figure.colorbar(ax.collections[0], ax=axes)`.
    - `window`: ((left, right), (bottom, top)); by default the bodies and some room round them. `whole(mesh.points)` shows all.
    - `ax`: matplotlib's axes; new ones by default.

    **Returns:** the axes.

    **Raises:** `ValueError` for a mesh in 3-D, for points of another shape than the mesh's, for another number of values than of
    cells, and for a `label` without values.
    """
    corners = _corners(mesh, points)
    if values is None and label is not None:
        raise ValueError(f"there are no `values` that are {label!r}.")
    each = None if values is None else cell_values(mesh, values)
    colours, limits = colour_scale(limits)
    ax = given_or_new(ax)
    window = show(ax, _bodies(mesh, points) if window is None else window)
    seen = _inside(corners, window)
    if each is not None:
        faces = PolyCollection(list(corners[seen]), cmap=colours, linewidths=0.3, edgecolors="face", rasterized=True)
        ax.set_facecolor("#c4cad3")  # what is not mesh: bodies
        faces.set_array(each[seen])
        faces.set_clim(*(limits if limits is not None else (None, None)))
        ax.add_collection(faces, autolim=False)
        if bar:
            ax.figure.colorbar(faces, cax=ax.inset_axes((1.02, 0, 0.03, 1)), label=label or "")
    _edges(ax, corners[seen], window, DARK)
    return ax


@checked
def before_after(
    mesh: jm.Mesh, points: Float[Any, "n 2"], *, window: Window | None = None, ax: Axes | None = None
) -> Axes:
    """Draws the undeformed 2-D mesh in orange and the deformed one over it in blue.

    **Arguments:**

    - `mesh`, `points`, `window`, `ax`: those of `mesh`.

    **Returns:** the axes.

    **Raises:** `ValueError` for a mesh in 3-D, and for points of another shape than the mesh's.
    """
    before, after = _corners(mesh, None), _corners(mesh, points)
    ax = given_or_new(ax)
    window = show(ax, _bodies(mesh, None, points) if window is None else window)
    for corners, colour, label in ((before, ORANGE, "undeformed"), (after, BLUE, "deformed")):
        _edges(ax, corners[_inside(corners, window)], window, colour)
        ax.plot([], [], color=colour, label=label)
    ax.legend(loc="upper right", framealpha=1)
    return ax


@checked
def graph(
    plan: jm.Plan,
    u: Float[Any, "m 2"] | None = None,
    *,
    window: Window | None = None,
    interior: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draws the Delaunay graph of a plan's surface, displaced by `u` if given (figure 2 of the paper).

    Moving nodes are orange, fixed nodes blue.

    **Arguments:**

    - `plan`: a plan in 2-D, with any method.
    - `u`: displacements (m, 2) of the moving nodes. Default None: the undeformed graph.
    - `window`: ((left, right), (bottom, top)); the moving nodes and some room by default. `whole(plan.points)` shows all.
    - `interior`: True shows the nodes of the volume too, where the plan's method puts them. Default False.
    - `ax`: matplotlib's axes; new ones by default.

    **Returns:** the axes `ax`, or new ones.

    **Raises:** `ValueError` for a plan in 3-D, and when the shape of `u` is not (m, 2).
    """
    points = flat(plan.points)
    moving, fixed = np.asarray(plan.moving), np.asarray(plan.fixed)
    nodes = np.concatenate([moving, fixed])
    simplices = nodes[Delaunay(points[nodes]).simplices]
    if u is not None:
        points = np.asarray(jm.deform(plan, finite_array("u", u, (plan.n_moving, 2))))
    ax = given_or_new(ax)
    show(ax, _round(points[moving], points) if window is None else window)
    if interior:
        ax.plot(*np.delete(points, nodes, axis=0).T, ".", color=GREY, markersize=2, zorder=1)
    edges = np.unique(np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    ax.add_collection(LineCollection(list(points[edges]), colors=DARK, linewidths=0.5), autolim=False)
    for ids, colour, label in ((moving, ORANGE, "moving"), (fixed, BLUE, "fixed")):
        ax.plot(*points[ids].T, ".", color=colour, markersize=5, label=label, zorder=3)
    ax.legend(loc="upper right", framealpha=1)
    return ax


def given_or_new(ax: Axes | None) -> Axes:
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def _corners(mesh: jm.Mesh, points: Any) -> Float[np.ndarray, "k c 2"]:
    """Returns the corners of all cells in the order of `mesh.cells`, points along the edges where cells are curved.

    Corners of a triangle or a line are repeated, so that all cells have as many.
    """
    if mesh.points.shape[1] != 2:
        raise ValueError(
            f"this is for 2-D meshes, not {mesh}; see `plot.surface`, `plot.cut` and `plot.before_after_3d`."
        )
    if not sum(map(len, mesh.cells.values())):
        raise ValueError(f"there is nothing to draw: {mesh} has no cells.")
    points = finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
    if not mesh.is_curved:
        return points[np.concatenate([np.asarray(ids)[:, FOUR_CORNERS[kind]] for kind, ids in mesh.cells.items()])]
    most = 4 * ALONG_EDGE
    outlines = [np.einsum("sn,knd->ksd", _outline(kind), points[np.asarray(ids)]) for kind, ids in mesh.cells.items()]
    return np.concatenate([np.pad(each, ((0, 0), (0, most - each.shape[1]), (0, 0)), "edge") for each in outlines])


def _outline(kind: str) -> Float[np.ndarray, "s n"]:
    """Returns the shape functions at places along the edges of a cell."""
    corners = np.array(PLACES[SHAPES[kind]], dtype=float)
    t = np.arange(ALONG_EDGE)[:, None] / ALONG_EDGE
    edges = [(1 - t) * corner + t * after for corner, after in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return shape_values(kind, np.concatenate(edges))


def flat(points: Any, other: str | None = None) -> Float[np.ndarray, "n 2"]:
    """Checks that points are 2-D; the `ValueError` for others names the `other` function, for 3-D."""
    points = finite(points)
    if points.ndim != 2 or points.shape[1] != 2:
        see = "" if other is None else f"; see `{other}`"
        raise ValueError(f"this is for points in 2-D, not of shape {points.shape}{see}.")
    return points


@checked
def whole(points: Float[Any, "n 2"]) -> Window:
    """Computes the window that shows all points.

    **Arguments:**

    - `points`: (n, 2).

    **Returns:** ((left, right), (bottom, top)).

    **Raises:** `ValueError` for points that are not in 2-D.
    """
    points = flat(points)
    (left, bottom), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (left, right), (bottom, top)


def _bodies(mesh: jm.Mesh, *states: Any) -> Window:
    """Finds the window round the patches that are not part of the outer boundary, in all `states` of the points; else all."""
    base = np.asarray(mesh.points)
    low, high = base.min(axis=0), base.max(axis=0)
    near = 1e-6 * (high - low)
    nodes = [np.asarray(ids) for ids in mesh.patches.values() if len(ids)]
    inner = [ids for ids in nodes if (base[ids] > low + near).all() and (base[ids] < high - near).all()]
    states = tuple(base if points is None else np.asarray(points) for points in states)
    everything = np.concatenate(states)
    if not inner:
        return whole(everything)
    ids = np.concatenate(inner)
    return _round(np.concatenate([points[ids] for points in states]), everything)


def _round(body: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]) -> Window:
    """Returns the window round a body with some room, and no larger than all points need."""
    low, high = body.min(axis=0), body.max(axis=0)
    room = ROOM * (high - low).max()
    low, high = np.maximum(low - room, points.min(axis=0)), np.minimum(high + room, points.max(axis=0))
    return whole(np.stack([low, high]))


def show(ax: Axes, window: Window) -> Window:
    ax.set(xlim=window[0], ylim=window[1], aspect="equal")
    return window


def _inside(corners: Float[np.ndarray, "k c 2"], window: Window) -> Int[np.ndarray, " s"]:
    """Returns the ids of the cells that may be seen."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    (left, right), (bottom, top) = window
    return np.flatnonzero((high >= (left, bottom)).all(axis=1) & (low <= (right, top)).all(axis=1))


def _edges(ax: Axes, corners: Float[np.ndarray, "k c 2"], window: Window, colour: str) -> None:
    """Draws the outlines of cells, thinner where cells are thin."""
    left, right = window[0]
    to_points = 72 * ax.get_window_extent().width / ax.figure.dpi / (right - left)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    quarter = corners.shape[1] // 4
    (a, b), (c, d) = ((corners[:, k + 2 * quarter] - corners[:, k]).T for k in (0, quarter))
    across = np.abs(a * d - b * c) / 2 / np.maximum(edges, np.finfo(float).tiny)
    widths = np.clip(across * to_points / 6, THINNEST, THICKEST)
    outlines = PolyCollection(list(corners), facecolors="none", edgecolors=colour, linewidths=widths, rasterized=True)
    ax.add_collection(outlines, autolim=False)
