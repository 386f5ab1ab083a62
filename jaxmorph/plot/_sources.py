"""Drawings of the sources among a boundary's nodes, and of k-d tree leaves (paper, figure 1)."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.patches import Rectangle

import jaxmorph as jm
from jaxmorph.extend import checked

from ._plane import FIGURE_ROOM, Axes, Window, choose_axes, in_2d, legend_above, show, whole
from ._style import GREEN, GREY, ORANGE, PlotPlaces

FEW_SOURCES = 30  # sources up to which they are drawn as large dots, without covering each other

Parts = list[tuple[PlotPlaces, jm.AbstractReduction]]
"""Nodes (k, 2), and the reduction that chooses among them."""


@checked
def sources(
    surface: jm.Plan | Float[Any, "m 2"],
    reduction: jm.AbstractReduction | None = None,
    *,
    fixed: bool = False,
    window: Window | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draws the sources of a boundary, with a `KDTree`'s boxes (paper, figure 1).

    **Arguments:**

    - `surface`: a plan, with its own sources and boxes; or points (m, 2).
    - `reduction`: chooses the sources among points; not for a plan.
    - `fixed`: True shows the sources and boxes of a plan's fixed nodes too, which may be far away.
    - `window`: ((left, right), (bottom, top)); all that is drawn by default.
    - `ax`: matplotlib's axes; new ones by default.

    **Raises:** `ValueError` for points in 3-D, a plan without radial basis functions, points
    without a `reduction` and a plan with one.
    """
    parts, chosen = _split_sources(surface, reduction, fixed)
    nodes = np.concatenate([own for own, _ in parts])
    trees = [(tree, own) for own, tree in parts if isinstance(tree, jm.KDTree) and len(own)]
    corners = [corner for tree, own in trees for corner in tree.boxes(own)]
    if window is None:
        drawn = np.concatenate([nodes, *corners])
        room = FIGURE_ROOM / 10 * np.ptp(drawn, axis=0).max()
        window = whole(np.concatenate([drawn - room, drawn + room]))
    ax = show(choose_axes(ax, window, above=0.35), window)
    for k, (low, high) in enumerate(corners):
        label = f"{len(corners)} leaves" if k == 0 else None
        ax.add_patch(Rectangle(low, *(high - low), fill=False, color=GREEN, lw=1.2, label=label))
    size = float(np.clip(7 * np.sqrt(FEW_SOURCES / max(len(chosen), 1)), 3.5, 7))
    ax.plot(*nodes.T, ".", color=GREY, markersize=0.7 * size, label=f"{len(nodes)} nodes", zorder=2)
    ax.plot(*chosen.T, "o", color=ORANGE, markersize=size, label=f"{len(chosen)} sources", zorder=3)
    legend_above(ax)
    return ax


def _split_sources(
    surface: Any, reduction: jm.AbstractReduction | None, fixed: bool
) -> tuple[Parts, PlotPlaces]:
    """Finds nodes with their reductions, and the sources."""
    if not isinstance(surface, jm.Plan):
        if reduction is None:
            raise ValueError("points need a `reduction` of their own, such as jm.KDTree(16).")
        points = in_2d(surface)
        return [(points, reduction)], points[reduction(points)]
    if reduction is not None:
        raise ValueError("a plan has its own reductions: leave `reduction` out.")
    points = in_2d(surface.points)
    parts = _parts_of_plan(surface, points)
    shown = surface.sources
    if not fixed:
        return parts[:1], points[shown[np.isin(shown, surface.moving)]]
    return parts, points[shown]


def _parts_of_plan(plan: jm.Plan, points: PlotPlaces) -> Parts:
    """The moving nodes of a plan, then the fixed ones, with their reductions."""
    rbf = plan.method
    while isinstance(rbf, jm.SurfaceReconstruction):
        rbf = rbf.coarse
    rbf = rbf.rbf if isinstance(rbf, jm.FittedRBF) else rbf
    if not isinstance(rbf, jm.RBF):
        raise ValueError(f"the plan's method has no radial basis functions: {plan.method}.")
    wall = points[np.asarray(plan.moving)]
    others = points[np.asarray(plan.fixed)]
    tree = rbf.reduction
    tree = tree.given(wall, others) if isinstance(tree, jm.KDTree) else tree
    return [(wall, tree), (others, rbf.fixed_reduction)]
