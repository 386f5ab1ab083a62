"""Pictures in 2-D, with matplotlib."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import Delaunay

import jaxmorph as jm

from .._host.package.arguments import checked, finite_array
from ._cells import (
    NARROW,
    Axes,
    Cells,
    LineCollection,
    Patch,
    Window,
    draw_lines,
    draw_walls,
    fill,
    given_or_new,
    legend_above,
    seen_in,
    show,
)
from ._style import (
    BLUE,
    BODY,
    DARK,
    GREY,
    LIGHT,
    ORANGE,
    Limits,
    Values,
    beyond,
    bodies,
    cell_values,
    colour_scale,
    finite,
    usual_limits,
)

ROOM = 0.4
"""Margin of a picture around the bodies, relative to their extent, unless a window is given."""


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
    """Draws a 2-D mesh's cells, coloured by a value each, and its boundary in a stronger line.

    Cells too narrow for a line show their colour alone. Polygons are drawn whole, edges of curved
    cells along their polynomials.

    **Arguments:**

    - `mesh`: a mesh in 2-D.
    - `points`: positions (n, 2) of its nodes; the mesh's own by default.
    - `values`: one for each cell, as `quality` gives. Where the file has polyhedra or polygons, one
      for each whole cell will do, as `face_quality` gives. Without values only the lines are drawn.
    - `limits`: the values at the light and at the dark end of the colours; (1, 0) for a measure
      that is small where cells are bad. Default: the limits of all values in the window, without
      outliers on 1 % of the area, for which the bar has an arrow.
    - `label`: what the values are, beside the colour bar.
    - `bar`: False leaves out the colour bar. For several axes that share one:
      `figure.colorbar(ax.collections[0], ax=axes)`.
    - `window`: ((left, right), (bottom, top)); by default the bodies and some room round them.
      `whole(mesh.points)` shows all.
    - `ax`: matplotlib's axes; new ones by default, in a figure of the window's shape.

    **Returns:** the axes.

    **Raises:** `ValueError` for a mesh in 3-D, for points of another shape than the mesh's, for
    another number of values than of cells, and for a `label` without values.
    """
    cells = Cells.of(mesh, points)
    if values is None and label is not None:
        raise ValueError(f"there are no `values` that are {label!r}.")
    every = None if values is None else cell_values(mesh, values)
    colours, limits = colour_scale(limits)
    drawn = cells.drawn(window)
    window = _bodies(mesh, points) if window is None else window
    ax = show(given_or_new(ax, window, bar=bar and values is not None), window)
    if every is not None:
        seen = cells.inside(window)
        shown = every[seen]
        faces = fill(ax, cells.outlines[drawn], cmap=colours)
        ax.set_facecolor(BODY)
        faces.set_array(every[drawn])
        faces.set_clim(*(limits or usual_limits(shown, cells.areas[seen])))
        if bar:
            below, above = beyond(shown, faces.get_clim())
            extend = ("neither", "min", "max", "both")[below + 2 * above]
            ax.figure.colorbar(faces, cax=ax.inset_axes((1.02, 0, 0.03, 1)), label=label or "", extend=extend)
    draw_lines(ax, cells, drawn, window, DARK, least=0 if every is None else NARROW)
    draw_walls(ax, cells, DARK)
    return ax


@checked
def before_after(
    mesh: jm.Mesh, points: Float[Any, "n 2"], *, window: Window | None = None, ax: Axes | None = None
) -> Axes:
    """Draws the deformed 2-D mesh in blue over the undeformed bodies in light orange.

    **Arguments:**

    - `mesh`, `points`, `window`, `ax`: as `plot.mesh` takes them.

    **Returns:** the axes.

    **Raises:** `ValueError` for a mesh in 3-D, and for points of another shape than the mesh's.
    """
    before, after = Cells.of(mesh, None), Cells.of(mesh, points)
    old, new = before.drawn(window), after.drawn(window)
    window = _bodies(mesh, None, points) if window is None else window
    ax = show(given_or_new(ax, window, above=0.35), window)
    ax.set_facecolor(LIGHT)  # where there was no mesh
    fill(ax, before.outlines[old], facecolors="white")
    draw_lines(ax, after, new, window, BLUE)
    draw_walls(ax, before, ORANGE)
    draw_walls(ax, after, BLUE)
    colours = (LIGHT, ORANGE, "undeformed"), ("white", BLUE, "deformed")
    legend_above(ax, [Patch(facecolor=face, edgecolor=edge, label=name) for face, edge, name in colours])
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
    """Draws the Delaunay graph of a plan's surface, displaced by `u` if given (paper, figure 2).

    Moving nodes are orange, fixed nodes blue. The legend names what the window shows.

    **Arguments:**

    - `plan`: a plan in 2-D, with any method.
    - `u`: displacements (m, 2) of the moving nodes. Default None: the undeformed graph.
    - `window`: ((left, right), (bottom, top)); the moving nodes and some room by default.
      `whole(plan.points)` shows all.
    - `interior`: True shows the nodes of the volume too, where the plan's method puts them. Default
      False.
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
    ax = show(given_or_new(ax, window, above=0.35), window)
    if interior:
        ax.plot(*np.delete(points, nodes, axis=0).T, ".", color=GREY, markersize=2, zorder=1)
    edges = np.unique(np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    ax.add_collection(LineCollection(list(points[edges]), colors=DARK, linewidths=0.25), autolim=False)
    for ids, colour, name in ((moving, ORANGE, "moving nodes"), (fixed, BLUE, "fixed nodes")):
        label = name if len(seen_in(points[ids][:, None], window)) else None
        ax.plot(*points[ids].T, ".", color=colour, markersize=5, label=label, zorder=3)
    if ax.get_legend_handles_labels()[1]:
        legend_above(ax)
    return ax


def flat(points: Any, other: str | None = None) -> Float[np.ndarray, "n 2"]:
    """Checks that points are 2-D; the `ValueError` names the `other` function, for 3-D."""
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
    """Finds the window round a mesh's bodies in all `states`; all of it without bodies."""
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
