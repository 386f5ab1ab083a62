"""Drawings of the sources among a surface's nodes, and of k-d tree leaves (paper, figure 1)."""

import dataclasses
import itertools
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm

from .._host.package.arguments import checked
from ._cells import Axes, Window, given_or_new, legend_above, show
from ._plane import ROOM, flat, whole
from ._style import BLUE, GREEN, GREY, ORANGE, finite
from ._view import add_legend, aim, aim_again, new_plotter, pyvista

FEW = 30
"""Sources up to which they are drawn as large dots: more of them would cover each other."""


@checked
def sources(
    surface: jm.Plan | Float[Any, "m 2"],
    reduction: jm.AbstractReduction | None = None,
    *,
    fixed: bool = False,
    search_points: bool = False,
    window: Window | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draws the sources of a boundary, with a `KDTree`'s boxes (paper, figure 1).

    **Arguments:**

    - `surface`: a plan, whose own sources and boxes are shown; or points (m, 2).
    - `reduction`: chooses the sources among points; not for a plan, which has its own.
    - `fixed`: True shows the sources and boxes of a plan's fixed nodes too. They may be far away.
      Default False.
    - `search_points`: True marks the places in each box at which a source was looked for. Default
      False.
    - `window`: ((left, right), (bottom, top)); all that is drawn by default.
    - `ax`: matplotlib's axes; new ones by default.

    **Returns:** the axes.

    **Raises:** `ValueError` for points in 3-D, for a plan whose method has no radial basis
    functions, for points without a `reduction` and for a plan with one.
    """
    picture = _picture(surface, reduction, fixed, dimension=2)
    drawn = np.concatenate([picture.nodes, picture.boxes.reshape(-1, 2)])
    if window is None:
        room = ROOM / 10 * np.ptp(drawn, axis=0).max()
        window = whole(np.concatenate([drawn - room, drawn + room]))
    ax = show(given_or_new(ax, window, above=0.35), window)
    if picture.leaves:
        outline = picture.boxes[:, [0, 1, 1, 0, 0], 0], picture.boxes[:, [0, 0, 1, 1, 0], 1]
        ax.plot(*(side.T for side in outline), color=GREEN, linewidth=1.2)
        ax.plot([], [], color=GREEN, label=f"{picture.leaves} leaves")
    size = float(np.clip(7 * np.sqrt(FEW / max(len(picture.sources), 1)), 3.5, 7))
    ax.plot(*picture.nodes.T, ".", color=GREY, markersize=0.7 * size, label=f"{len(picture.nodes)} nodes", zorder=2)
    ax.plot(*picture.sources.T, "o", color=ORANGE, markersize=size, label=f"{len(picture.sources)} sources", zorder=3)
    if search_points and picture.leaves:
        style = {"color": BLUE, "markersize": 7, "markeredgewidth": 1.5, "zorder": 4}
        ax.plot(*picture.searched.T, "+", label=f"{len(picture.searched)} search points", **style)
    legend_above(ax)
    return ax


@checked
def sources_3d(
    surface: jm.Plan | Float[Any, "m 3"],
    reduction: jm.AbstractReduction | None = None,
    *,
    fixed: bool = False,
    search_points: bool = False,
    plotter: Any = None,
) -> Any:
    """Draws sources in 3-D: nodes as grey points, sources as orange spheres, boxes by edges.

    **Arguments:**

    - `surface`, `reduction`, `fixed`, `search_points`: as `sources` takes them, in 3-D.
    - `plotter`: pyvista's; a new one by default. A plotter from `plot.surface` shows the sources on
      the body.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `sources` does, for points in 2-D.
    """
    picture = _picture(surface, reduction, fixed, dimension=3)
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    legend = [(f"{len(picture.nodes)} nodes", GREY), (f"{len(picture.sources)} sources", ORANGE)]
    balls = {"render_points_as_spheres": True, "lighting": False}
    plotter.add_points(picture.nodes, color=GREY, point_size=5, **balls)
    plotter.add_points(picture.sources, color=ORANGE, point_size=22, **balls)
    if picture.leaves:
        plotter.add_mesh(_wires(picture.boxes), color=GREEN, line_width=1.5, lighting=False)
        legend.append((f"{picture.leaves} leaves", GREEN))
        if search_points:
            plotter.add_points(picture.searched, color=BLUE, point_size=12, **balls)
            legend.append((f"{len(picture.searched)} search points", BLUE))
    add_legend(plotter, legend)
    (aim if new else aim_again)(plotter)
    return plotter


@dataclasses.dataclass(frozen=True)
class _Picture:
    """A drawing: coordinates of nodes and sources, corners of leaves' boxes, search points."""

    nodes: Float[np.ndarray, "n d"]
    sources: Float[np.ndarray, "s d"]
    boxes: Float[np.ndarray, "l 2 d"]
    searched: Float[np.ndarray, "q d"]

    @property
    def leaves(self) -> int:
        return len(self.boxes)


def _picture(surface: Any, reduction: jm.AbstractReduction | None, fixed: bool, dimension: int) -> _Picture:
    if isinstance(surface, jm.Plan):
        if reduction is not None:
            raise ValueError("a plan has its own reductions: give points with `reduction`, or the plan alone.")
        parts, chosen = of_plan(surface, fixed)
    else:
        if reduction is None:
            raise ValueError("points need the `reduction` that is to choose among them, such as jm.KDTree(16).")
        points = _checked(surface, dimension)
        parts, chosen = [(points, reduction)], points[reduction(points)]
    nodes = _checked(np.concatenate([points for points, _ in parts]), dimension)
    boxes, searched = [np.zeros((0, 2, dimension))], [np.zeros((0, dimension))]
    for points, reduction in parts:
        if isinstance(reduction, jm.KDTree) and len(points):
            boxes.append(reduction.boxes(points))
            local = reduction.search_points.local(dimension)
            centre, half = boxes[-1].mean(axis=1), np.ptp(boxes[-1], axis=1) / 2
            searched.append((centre[:, None] + half[:, None] * local).reshape(-1, dimension))
    return _Picture(nodes, chosen, np.concatenate(boxes), np.concatenate(searched))


def radial_basis_functions(plan: jm.Plan) -> jm.RBF:
    """Returns the plan's RBF; `ValueError` where it has none."""
    method = plan.method
    while isinstance(method, jm.SurfaceReconstruction):
        method = method.coarse
    method = method.rbf if isinstance(method, jm.FittedRBF) else method
    if not isinstance(method, jm.RBF):
        raise ValueError(f"the plan's method has no radial basis functions, and so no sources: {plan.method}.")
    return method


def of_plan(plan: jm.Plan, fixed: bool = True) -> tuple[list[tuple[np.ndarray, jm.AbstractReduction]], np.ndarray]:
    """Returns moving and fixed nodes with their reductions; and sources, without images."""
    rbf, points, sources = radial_basis_functions(plan), np.asarray(plan.points, dtype=float), plan.sources
    on_wall, other = points[np.asarray(plan.moving)], points[np.asarray(plan.fixed)]
    reduction = rbf.reduction.given(on_wall, other) if isinstance(rbf.reduction, jm.KDTree) else rbf.reduction
    parts = [(on_wall, reduction)]
    if fixed:
        parts.append((other, rbf.fixed_reduction))
    else:
        sources = sources[np.isin(sources, plan.moving)]
    return parts, points[sources]


def _checked(points: Any, dimension: int) -> np.ndarray:
    if dimension == 2:
        return flat(points, "plot.sources_3d")
    points = finite(points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"this is for points in 3-D, not of shape {points.shape}; see `plot.sources`.")
    return points


def _wires(boxes: Float[np.ndarray, "l 2 3"]) -> Any:
    """Draws the twelve edges of each box as pyvista's lines."""
    corners = list(itertools.product((0, 1), repeat=3))
    edges = [
        (i, j)
        for i, a in enumerate(corners)
        for j, b in enumerate(corners)
        if i < j and np.abs(np.subtract(a, b)).sum() == 1
    ]
    points = np.stack([boxes[:, corner, range(3)] for corner in corners], axis=1).reshape(-1, 3)
    first = 8 * np.arange(len(boxes))[:, None, None]
    ids = (first + np.array(edges)).reshape(-1, 2)
    return pyvista().PolyData(points, lines=np.insert(ids, 0, 2, axis=1).ravel())
