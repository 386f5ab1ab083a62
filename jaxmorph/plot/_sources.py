"""Which nodes of a surface carry the radial basis functions, and where the k-d tree's leaves are (figure 1 of the paper)."""

import dataclasses
import itertools
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm

from ._plane import Axes, Window, flat, given_or_new, show
from ._space import add_legend, aim, new_plotter, pyvista
from ._style import BLUE, DARK, GREEN, GREY, ORANGE


def sources(
    surface: jm.Plan | Float[Any, "m 2"],
    reduction: jm.AbstractReduction | None = None,
    *,
    fixed: bool = True,
    search_points: bool = False,
    window: Window | None = None,
    axis: Axes | None = None,
) -> Axes:
    """What a reduction chooses among the nodes of a boundary; for a `KDTree` with its leaves' boxes (figure 1 of the paper).

    `surface` is a plan, whose own sources and boxes are shown, those of the fixed nodes too unless `fixed=False`; or points
    (m, 2) with the `reduction` to show. `search_points=True` marks the places in each box that a source was looked for at.
    `window` as in `mesh`.

    Raises `ValueError` for points in space, for a plan whose method has no radial basis functions, for points without a
    `reduction` and for a plan with one.
    """
    found = _found(surface, reduction, fixed, dimension=2)
    axis = given_or_new(axis)
    if found.leaves:
        outline = found.boxes[:, [0, 1, 1, 0, 0], 0], found.boxes[:, [0, 0, 1, 1, 0], 1]
        axis.plot(*(side.T for side in outline), color=GREEN, linewidth=1.2)
        axis.plot([], [], color=GREEN, label=f"{found.leaves} leaves")
    axis.plot(*found.nodes.T, ".", color=GREY, markersize=5, label=f"{len(found.nodes)} nodes", zorder=2)
    axis.plot(*found.sources.T, "o", color=ORANGE, markersize=7, label=f"{len(found.sources)} sources", zorder=3)
    if search_points and found.leaves:
        style = {"color": BLUE, "markersize": 7, "markeredgewidth": 1.5, "zorder": 4}
        axis.plot(*found.searched.T, "+", label=f"{len(found.searched)} search points", **style)
    axis.margins(0.05, 0.1)
    if window is None:
        axis.set_aspect("equal")
    else:
        show(axis, found.nodes, window)
    axis.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.02), ncols=4 if len(axis.figure.axes) == 1 else 3, frameon=False
    )
    return axis


def sources_in_space(
    surface: jm.Plan | Float[Any, "m 3"],
    reduction: jm.AbstractReduction | None = None,
    *,
    fixed: bool = True,
    search_points: bool = False,
    plotter: Any = None,
) -> Any:
    """`sources` for a surface in space: nodes as dark points, sources as orange spheres, each box by its twelve edges.

    Takes a pyvista plotter (a new one, off screen, where none is given) and gives it back: one from `surface` shows the sources on
    the body. Far from it lie those of the far field, which `fixed=False` leaves out.

    Raises `ValueError` as `sources` does, with points in the plane for those in space.
    """
    found = _found(surface, reduction, fixed, dimension=3)
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    legend = [[f"{len(found.nodes)} nodes", DARK], [f"{len(found.sources)} sources", ORANGE]]
    balls = {"render_points_as_spheres": True, "lighting": False}
    plotter.add_points(found.nodes, color=DARK, point_size=4, **balls)
    plotter.add_points(found.sources, color=ORANGE, point_size=14, **balls)
    if found.leaves:
        plotter.add_mesh(_wires(found.boxes), color=GREEN, line_width=2.5, lighting=False)
        legend.append([f"{found.leaves} leaves", GREEN])
        if search_points:
            plotter.add_points(found.searched, color=BLUE, point_size=8, **balls)
            legend.append([f"{len(found.searched)} search points", BLUE])
    add_legend(plotter, legend)
    if new:
        aim(plotter)
    return plotter


@dataclasses.dataclass(frozen=True)
class _Found:
    """What is drawn: coordinates of nodes and sources, the lower and upper corner of each leaf's box, search points."""

    nodes: Float[np.ndarray, "n d"]
    sources: Float[np.ndarray, "s d"]
    boxes: Float[np.ndarray, "l 2 d"]
    searched: Float[np.ndarray, "q d"]

    @property
    def leaves(self) -> int:
        return len(self.boxes)


def _found(surface: Any, reduction: jm.AbstractReduction | None, fixed: bool, dimension: int) -> _Found:
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
    return _Found(nodes, chosen, np.concatenate(boxes), np.concatenate(searched))


def radial_basis_functions(plan: jm.Plan) -> tuple[jm.RBF, Any]:
    """The plan's RBF and the rows of the surface that are its sources; `ValueError` where it has none."""
    method, ids = plan.method, plan.surface.ids
    while isinstance(method, jm.SurfaceReconstruction):
        method, ids = method.coarse, ids[0]
    if not isinstance(method, jm.RBF):
        raise ValueError(f"the plan's method has no radial basis functions, and so no sources: {plan.method}.")
    return method, np.asarray(ids)


def of_plan(plan: jm.Plan, fixed: bool = True) -> tuple[list[tuple[np.ndarray, jm.AbstractReduction]], np.ndarray]:
    """Moving and fixed nodes with their reductions; and the sources, without their images in symmetry planes."""
    rbf, ids = radial_basis_functions(plan)
    points, mirror = np.asarray(plan.points, dtype=float), plan.surface.mirror
    if mirror is not None:
        is_image = np.asarray(mirror.mirrored).any(axis=1)
        ids = np.asarray(mirror.rows)[ids[~np.asarray(is_image)[ids]]]
    parts = [(points[np.asarray(plan.moving)], rbf.reduction)]
    if fixed:
        parts.append((points[np.asarray(plan.fixed)], rbf.fixed_reduction))
    else:
        ids = ids[ids < plan.moves]
    return parts, points[np.asarray(plan.surface.nodes)[ids]]


def _checked(points: Any, dimension: int) -> np.ndarray:
    if dimension == 2:
        return flat(points, "plot.sources_in_space")
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"this is for points in space, not of shape {points.shape}; see `plot.sources`.")
    return points


def _wires(boxes: Float[np.ndarray, "l 2 3"]) -> Any:
    """The twelve edges of each box, as pyvista's lines."""
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
