"""Drawings of the sources among a surface's nodes, and of k-d tree leaves (paper, figure 1)."""

import itertools
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph.extend import checked

from ._plane import ROOM, Axes, Window, given_or_new, in_dimension, legend_above, show, whole
from ._space import add_legend, aim, aim_again, lines_of, new_plotter
from ._style import GREEN, GREY, ORANGE, Places

FEW = 30  # sources up to which they are drawn as large dots, without covering each other


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
    nodes, chosen, boxes = _drawn(surface, reduction, fixed, dimension=2)
    drawn = np.concatenate([nodes, boxes.reshape(-1, 2)])
    if window is None:
        room = ROOM / 10 * np.ptp(drawn, axis=0).max()
        window = whole(np.concatenate([drawn - room, drawn + room]))
    ax = show(given_or_new(ax, window, above=0.35), window)
    if len(boxes):
        outline = boxes[:, [0, 1, 1, 0, 0], 0], boxes[:, [0, 0, 1, 1, 0], 1]
        ax.plot(*(side.T for side in outline), color=GREEN, linewidth=1.2)
        ax.plot([], [], color=GREEN, label=f"{len(boxes)} leaves")
    size = float(np.clip(7 * np.sqrt(FEW / max(len(chosen), 1)), 3.5, 7))
    ax.plot(*nodes.T, ".", color=GREY, markersize=0.7 * size, label=f"{len(nodes)} nodes", zorder=2)
    ax.plot(*chosen.T, "o", color=ORANGE, markersize=size, label=f"{len(chosen)} sources", zorder=3)
    legend_above(ax)
    return ax


@checked
def sources_3d(
    surface: jm.Plan | Float[Any, "m 3"],
    reduction: jm.AbstractReduction | None = None,
    *,
    fixed: bool = False,
    plotter: Any = None,
) -> Any:
    """Draws sources in 3-D: nodes as grey points, sources as orange spheres, boxes by edges.

    **Arguments:**

    - `surface`, `reduction`, `fixed`: as `sources` takes them, in 3-D.
    - `plotter`: pyvista's; a new one by default. One from `plot.surface` shows the sources on the
      body.

    **Returns:** the plotter. **Raises:** `ValueError` as `sources` does, for points in 2-D.
    """
    nodes, chosen, boxes = _drawn(surface, reduction, fixed, dimension=3)
    new = plotter is None
    plotter = new_plotter() if plotter is None else plotter
    legend = [(f"{len(nodes)} nodes", GREY), (f"{len(chosen)} sources", ORANGE)]
    balls = {"render_points_as_spheres": True, "lighting": False}
    plotter.add_points(nodes, color=GREY, point_size=5, **balls)
    plotter.add_points(chosen, color=ORANGE, point_size=22, **balls)
    if len(boxes):
        plotter.add_mesh(_wires(boxes), color=GREEN, line_width=1.5, lighting=False)
        legend.append((f"{len(boxes)} leaves", GREEN))
    add_legend(plotter, legend)
    (aim if new else aim_again)(plotter)
    return plotter


def _drawn(
    surface: Any, reduction: jm.AbstractReduction | None, fixed: bool, dimension: int
) -> tuple[Places, Places, Float[np.ndarray, "l 2 d"]]:
    """Returns coordinates of nodes and sources, corners of leaves' boxes."""
    if isinstance(surface, jm.Plan):
        if reduction is not None:
            raise ValueError(
                "a plan has its own reductions: give points with `reduction`, or the plan alone."
            )
        parts, chosen = _of_plan(surface, fixed)
    else:
        if reduction is None:
            raise ValueError(
                "points need the `reduction` that is to choose among them, such as jm.KDTree(16)."
            )
        points = in_dimension(surface, dimension)
        parts = [(points, reduction)]
        chosen = points[reduction(points)]
    nodes = in_dimension(np.concatenate([points for points, _ in parts]), dimension)
    trees = [
        (tree, points) for points, tree in parts if isinstance(tree, jm.KDTree) and len(points)
    ]
    boxes = [np.zeros((0, 2, dimension)), *(tree.boxes(points) for tree, points in trees)]
    return nodes, chosen, np.concatenate(boxes)


def _radial_basis_functions(plan: jm.Plan) -> jm.RBF:
    method = plan.method
    while isinstance(method, jm.SurfaceReconstruction):
        method = method.coarse
    method = method.rbf if isinstance(method, jm.FittedRBF) else method
    if not isinstance(method, jm.RBF):
        raise ValueError(
            f"the plan's method has no radial basis functions, and so no sources: {plan.method}."
        )
    return method


def _of_plan(
    plan: jm.Plan, fixed: bool
) -> tuple[list[tuple[np.ndarray, jm.AbstractReduction]], np.ndarray]:
    """Returns moving and fixed nodes with their reductions; and sources, without images."""
    rbf = _radial_basis_functions(plan)
    points = np.asarray(plan.points, dtype=float)
    sources = plan.sources
    on_wall = points[np.asarray(plan.moving)]
    other = points[np.asarray(plan.fixed)]
    reduction = (
        rbf.reduction.given(on_wall, other)
        if isinstance(rbf.reduction, jm.KDTree)
        else rbf.reduction
    )
    parts = [(on_wall, reduction)]
    if fixed:
        parts.append((other, rbf.fixed_reduction))
    else:
        sources = sources[np.isin(sources, plan.moving)]
    return parts, points[sources]


def _wires(boxes: Float[np.ndarray, "l 2 3"]) -> Any:
    corners = np.array([*itertools.product((0, 1), repeat=3)])
    edges = [
        (i, j)
        for i, j in itertools.combinations(range(8), 2)
        if np.abs(corners[i] - corners[j]).sum() == 1
    ]
    points = boxes[:, corners, range(3)].reshape(-1, 3)
    return lines_of(
        points, (8 * np.arange(len(boxes))[:, None, None] + np.array(edges)).reshape(-1, 2)
    )
