"""Pictures in 2-D, with matplotlib."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay

import jaxmorph as jm

from .._host.package.arguments import checked, finite_array
from ._style import (
    BLUE,
    BODY,
    DARK,
    GREY,
    LIGHT,
    ORANGE,
    TALLEST,
    WIDTH,
    Limits,
    Values,
    arrows,
    bodies,
    cell_values,
    colour_scale,
    finite,
    usual_limits,
)

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.font_manager import findfont as findfont
    from matplotlib.patches import Patch
    from matplotlib.textpath import TextPath as TextPath
except ImportError as error:
    raise ImportError("jaxmorph.plot needs matplotlib and pyvista: pip install 'jaxmorph[plot]'") from error

Window = tuple[tuple[float, float], tuple[float, float]]

THINNEST, THICKEST, WALL = 0.01, 0.5, 1.4
"""Widths in typographic points: a line between cells takes a sixth of its cell, so that layers do not turn black; a wall."""

NARROW = 0.8
"""Cells narrower than this, in typographic points, show their colour and no line."""

ROOM = 0.4
"""Margin of a picture around the bodies, relative to their extent, unless a window is given."""

FOUR_CORNERS = {"line": [0, 1, 1, 0], "triangle": [0, 1, 2, 2], "quad": [0, 1, 2, 3]}


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
    """Draws the cells of a 2-D mesh, coloured by a value for each cell, and its boundary in a stronger line.

    Cells too narrow for a line show their colour alone. Polygons are drawn whole.

    **Arguments:**

    - `mesh`: a mesh in 2-D.
    - `points`: positions (n, 2) of its nodes; the mesh's own by default.
    - `values`: one for each cell, as `quality` gives. Where the file has polyhedra or polygons, one for each whole cell will do, as
      `face_quality` gives. Without values only the lines are drawn.
    - `limits`: the values at the light and at the dark end of the colours; (1, 0) for a measure that is small where cells are bad.
      Default: those of all values in the window, without outliers on 1 % of the area, for which the bar has an arrow.
    - `label`: what the values are, beside the colour bar.
    - `bar`: False leaves out the colour bar. For several axes that share one: `figure.colorbar(ax.collections[0], ax=axes)`.
    - `window`: ((left, right), (bottom, top)); by default the bodies and some room round them. `whole(mesh.points)` shows all.
    - `ax`: matplotlib's axes; new ones by default, in a figure of the window's shape.

    **Returns:** the axes.

    **Raises:** `ValueError` for a mesh in 3-D, for points of another shape than the mesh's, for another number of values than of
    cells, and for a `label` without values.
    """
    cells = _Cells.of(mesh, points)
    if values is None and label is not None:
        raise ValueError(f"there are no `values` that are {label!r}.")
    every = None if values is None else cell_values(mesh, values)
    colours, limits = colour_scale(limits)
    window = _bodies(mesh, points) if window is None else window
    ax = show(given_or_new(ax, window, bar=bar and values is not None), window)
    seen = cells.inside(window)
    if every is not None:
        shown = every[seen]
        faces = _fill(ax, cells.corners[seen], cmap=colours)
        ax.set_facecolor(BODY)
        faces.set_array(shown)
        faces.set_clim(*(limits or usual_limits(shown, cells.areas[seen])))
        if bar:
            extend = arrows(shown, faces.get_clim())
            ax.figure.colorbar(faces, cax=ax.inset_axes((1.02, 0, 0.03, 1)), label=label or "", extend=extend)
    _lines(ax, cells, seen, window, DARK, least=0 if every is None else NARROW)
    _walls(ax, cells, DARK)
    return ax


@checked
def before_after(
    mesh: jm.Mesh, points: Float[Any, "n 2"], *, window: Window | None = None, ax: Axes | None = None
) -> Axes:
    """Draws the deformed 2-D mesh in blue over the undeformed bodies, which are filled in light orange.

    **Arguments:**

    - `mesh`, `points`, `window`, `ax`: those of `mesh`.

    **Returns:** the axes.

    **Raises:** `ValueError` for a mesh in 3-D, and for points of another shape than the mesh's.
    """
    before, after = _Cells.of(mesh, None), _Cells.of(mesh, points)
    window = _bodies(mesh, None, points) if window is None else window
    ax = show(given_or_new(ax, window), window)
    ax.set_facecolor(LIGHT)  # where there was no mesh
    _fill(ax, before.corners[before.inside(window)], facecolors="white")
    _lines(ax, after, after.inside(window), window, BLUE)
    _walls(ax, before, ORANGE)
    _walls(ax, after, BLUE)
    handles = [Patch(facecolor=face, edgecolor=edge) for face, edge in ((LIGHT, ORANGE), ("white", BLUE))]
    ax.legend(handles, ["undeformed", "deformed"], loc="upper right", framealpha=1)
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

    Moving nodes are orange, fixed nodes blue. The legend names what the window shows.

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
    window = _round(points[moving], points) if window is None else window
    ax = show(given_or_new(ax, window), window)
    if interior:
        ax.plot(*np.delete(points, nodes, axis=0).T, ".", color=GREY, markersize=2, zorder=1)
    edges = np.unique(np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    ax.add_collection(LineCollection(list(points[edges]), colors=DARK, linewidths=0.35), autolim=False)
    for ids, colour, name in ((moving, ORANGE, "moving nodes"), (fixed, BLUE, "fixed nodes")):
        label = name if len(_seen(points[ids][:, None], window)) else None
        ax.plot(*points[ids].T, ".", color=colour, markersize=5, label=label, zorder=3)
    if ax.get_legend_handles_labels()[1]:
        ax.legend(loc="upper right", framealpha=1)
    return ax


def given_or_new(ax: Axes | None, window: Window | None = None, *, bar: bool = False, above: float = 0.1) -> Axes:
    """Returns the axes given, or those of a new figure of the shape of its window, with `above` inches for what stands on top."""
    if ax is not None:
        return ax
    if window is None:
        return plt.subplots(figsize=(WIDTH, 0.7 * WIDTH), layout="constrained")[1]
    width, height = (side[1] - side[0] for side in window)
    beside, below = 0.75 + 0.9 * bar, 0.55 + above  # inches for labels, in which the mesh has no part
    scale = min((WIDTH - beside) / width, (TALLEST - below) / height)
    size = scale * width + beside, max(scale * height + below, 1.5)
    return plt.subplots(figsize=size, layout="constrained")[1]


@dataclasses.dataclass(frozen=True)
class _Cells:
    """Holds the cells of a 2-D mesh in the order of `mesh.cells`: four corners each, repeated in triangles and lines.

    `whole` is the cell of the file that each one is, or is a piece of.
    """

    points: Float[np.ndarray, "n 2"]
    ids: Int[np.ndarray, "k 4"]
    whole: Int[np.ndarray, " k"]

    @classmethod
    def of(cls, mesh: jm.Mesh, points: Any) -> "_Cells":
        if mesh.points.shape[1] != 2:
            raise ValueError(
                f"this is for 2-D meshes, not {mesh}; see `plot.surface`, `plot.cut` and `plot.before_after_3d`."
            )
        if not sum(map(len, mesh.cells.values())):
            raise ValueError(f"there is nothing to draw: {mesh} has no cells.")
        points = finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
        ids = [np.asarray(cells)[:, FOUR_CORNERS[kind]] for kind, cells in mesh.cells.items()]
        return cls(points, np.concatenate(ids), np.asarray(mesh.cell_ids))

    @property
    def corners(self) -> Float[np.ndarray, "k 4 2"]:
        return self.points[self.ids]

    @property
    def areas(self) -> Float[np.ndarray, " k"]:
        (a, b), (c, d) = ((self.corners[:, k + 2] - self.corners[:, k]).T for k in (0, 1))
        return np.abs(a * d - b * c) / 2

    def inside(self, window: Window) -> Int[np.ndarray, " s"]:
        """Lists the cells that may be seen."""
        return _seen(self.corners, window)

    def edges(self, cells: Int[np.ndarray, " s"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lists the edges (e, 2) of some cells, how often each comes, and the width (e,) of its narrowest cell.

        Edges between two pieces of one polygon are left out.
        """
        ids = self.ids[cells]
        pairs = np.sort(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2), axis=2)
        lengths = np.linalg.norm(np.diff(self.points[pairs], axis=2)[:, :, 0], axis=2).max(axis=1)
        width = self.areas[cells] / np.maximum(lengths, np.finfo(float).tiny)
        real = pairs[..., 0] != pairs[..., 1]
        edges, which, counts = np.unique(pairs[real], axis=0, return_inverse=True, return_counts=True)
        which, owner = which.ravel(), np.repeat(self.whole[cells], 4)[real.ravel()]
        narrowest, first, last = np.full(len(edges), np.inf), np.full(len(edges), len(self.whole)), np.full(len(edges), -1)
        np.minimum.at(narrowest, which, np.repeat(width, 4)[real.ravel()])
        np.minimum.at(first, which, owner)
        np.maximum.at(last, which, owner)
        shown = (counts == 1) | (first < last) | (narrowest == 0)
        return edges[shown], counts[shown], narrowest[shown]


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
    """Finds the window round the bodies of a mesh in all `states` of the points; all of it where there is none."""
    base = np.asarray(mesh.points)
    states = tuple(base if points is None else np.asarray(points) for points in states)
    everything, nodes = np.concatenate(states), bodies(base, mesh.patches)
    if not len(nodes):
        return whole(everything)
    return _round(np.concatenate([points[nodes] for points in states]), everything)


def _round(body: Float[np.ndarray, "k 2"], points: Float[np.ndarray, "n 2"]) -> Window:
    """Returns the window round a body with some room, and no larger than all points need."""
    low, high = body.min(axis=0), body.max(axis=0)
    room = ROOM * (high - low).max()
    low, high = np.maximum(low - room, points.min(axis=0)), np.minimum(high + room, points.max(axis=0))
    return whole(np.stack([low, high]))


def show(ax: Axes, window: Window) -> Axes:
    """Shows a window of the plane, and names its axes unless they have names."""
    ax.set(xlim=window[0], ylim=window[1], aspect="equal")
    ax.set(xlabel=ax.get_xlabel() or "x", ylabel=ax.get_ylabel() or "y")
    return ax


def _seen(corners: Float[np.ndarray, "k c 2"], window: Window) -> Int[np.ndarray, " s"]:
    low, high = corners.min(axis=1), corners.max(axis=1)
    (left, right), (bottom, top) = window
    return np.flatnonzero((high >= (left, bottom)).all(axis=1) & (low <= (right, top)).all(axis=1))


def _fill(ax: Axes, corners: Float[np.ndarray, "k 4 2"], **style: Any) -> PolyCollection:
    faces = PolyCollection(list(corners), linewidths=0.3, edgecolors="face", rasterized=True, **style)
    ax.add_collection(faces, autolim=False)
    return faces


def _lines(
    ax: Axes, cells: _Cells, seen: Int[np.ndarray, " s"], window: Window, colour: str, least: float = 0
) -> None:
    """Draws the lines between cells, thinner where cells are thin, and none where they are narrower than `least`."""
    edges, _, narrowest = cells.edges(seen)
    to_points = 72 * ax.get_window_extent().width / ax.figure.dpi / (window[0][1] - window[0][0])
    chosen = narrowest * to_points >= least
    widths = np.clip(narrowest[chosen] * to_points / 6, THINNEST, THICKEST)
    lines = LineCollection(list(cells.points[edges[chosen]]), colors=colour, linewidths=widths, rasterized=True)
    ax.add_collection(lines, autolim=False)


def _walls(ax: Axes, cells: _Cells, colour: str) -> None:
    """Draws the edges with a cell on one side: an odd number of times among all, since a cell of type line has it twice."""
    edges, counts, _ = cells.edges(np.arange(len(cells.ids)))
    lines = list(cells.points[edges[counts % 2 == 1]])
    ax.add_collection(LineCollection(lines, colors=colour, linewidths=WALL, capstyle="round"), autolim=False)
