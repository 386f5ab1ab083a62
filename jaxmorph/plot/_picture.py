"""A file with a picture of a mesh, or of what became of it."""

import dataclasses
import pathlib
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

import jaxmorph as jm
from jaxmorph.extend import PathLike, checked, complete, join_ids, output_path, rows_of

from . import _plane
from ._plane import Figure, plt
from ._space import before_after_3d, surface
from ._style import (
    BLUE,
    FLAT_VIEW,
    LINE_WIDTH,
    STILL,
    PlotColumn,
    PlotIds,
    PlotPlaces,
    body_patches,
    check_cells,
    choose_points,
    usual_limits,
)

ROUNDOFF_MEASURE = 1e-9  # of a mesh of ideal cells
PAD = 0.05  # inches round what is drawn


@checked
def picture(
    path: PathLike,
    before: jm.Mesh,
    points: Float[Any, "n d"] | None = None,
    *,
    moving: PlotIds | None = None,
    verdict: jm.Verdict | None = None,
) -> None:
    """Writes a mesh, or a mesh before and after: in 2-D the skewness, in 3-D bodies and what moved.

    Each cell has the mean over its nodes of the skewness at them, itself a mean over their cells. A
    cross is at the worst cell, if the picture has it. A mesh in 3-D that is one cell wide, and
    moves in its plane, is drawn as one in 2-D.

    **Arguments:**

    - `path`: a .png.
    - `before`, `points`: the undeformed mesh, and positions (n, d) of its nodes afterwards. Default
      None: the mesh alone, in 3-D its bodies by their cells' skewness.
    - `moving`: ids of the moving nodes. Default: those of patches that moved.
    - `verdict`: what `judge` said of the motion. Default: it is asked.

    **Raises:** `ValueError` for another ending.
    """
    check_cells(before)
    places = choose_points(before, points)
    path = output_path(path, ".png")
    nodes = (
        _draw_moved(before, places)
        if moving is None
        else rows_of("moving", moving, len(before.points))
    )
    side = FlatSide.of(before, places)
    if side is None and points is not None:
        return _in_3d(path, before, places, nodes)
    verdict = jm.judge(before, points) if verdict is None or verdict.judged is None else verdict
    if side is not None:
        return _draw_in_2d(path, side, nodes, verdict)
    label = _measure(verdict).replace("_", " ")
    _save_picture(path, surface(before, values=_values_of_cells(verdict), label=label))


def _draw_moved(mesh: jm.Mesh, places: PlotPlaces) -> PlotIds:
    lengths = np.linalg.norm(places - np.asarray(mesh.points), axis=1)
    return np.intersect1d(
        mesh.patch(*mesh.patches), np.flatnonzero(lengths > STILL * lengths.max())
    )


def _in_3d(path: pathlib.Path, mesh: jm.Mesh, places: PlotPlaces, moving: ndarray) -> None:
    nodes = np.union1d(moving, mesh.patch(*body_patches(mesh)))
    only = jm.Mesh(mesh.points, mesh.cells, {"drawn": nodes}, mesh.source)
    _save_picture(path, before_after_3d(only, places, patch="drawn" if len(nodes) else None))


def _save_picture(path: pathlib.Path, plotter: Any) -> None:
    with complete(path) as partial:
        plt.imsave(partial, plotter.screenshot(return_img=True), format="png")
    plotter.close()


def _measure(verdict: jm.Verdict) -> str:
    """The name of skewness in the verdict's table: of cells by their corners, or of faces."""
    return next(name for _, name in verdict.rows if name.endswith("skewness"))


def _values_of_cells(verdict: jm.Verdict) -> PlotColumn:
    """Skewness of the file's cells; NaN for cells that do not count."""
    judged: Any = verdict.judged
    values = np.full(len(judged.report.counted), np.nan)
    values[judged.counted] = judged.values(_measure(verdict))
    return values


def _draw_in_2d(path: pathlib.Path, side: "FlatSide", moving: ndarray, verdict: jm.Verdict) -> None:
    mesh = side.mesh
    name = _measure(verdict)
    label = name.replace("_", " ")
    states = {"deformed": (side.points, verdict)}
    if verdict.before is not None:
        states = {"undeformed": (np.asarray(mesh.points), verdict.before)} | states
    seen = np.flatnonzero(np.isin(side.nodes, moving))
    window = _plane.window_of(mesh, seen, *(points for points, _ in states.values()))
    figure, axes = _panels(window, len(states))
    colours = [_average(mesh, _values_of_cells(own)[side.cells]) for _, own in states.values()]
    largest, is_beyond = _largest_seen(
        mesh, colours, [points for points, _ in states.values()], window
    )
    for axis, values, (state, (points, own)) in zip(
        axes.ravel(), colours, states.items(), strict=True
    ):
        _plane.mesh(
            mesh, points, values=values, limits=(0, largest), window=window, bar=False, ax=axis
        )
        worst = own.rows["max", name]
        value = round(worst.value, 9) + 0.0  # no -0
        is_marked = value > 0 and _put_cross(axis, np.array(worst.near)[side.axes], window)
        titles = [state, f"largest {label} {value:.3g}{' (×)' * is_marked}"][-axes.size :]
        axis.set_title(("\n" if len(axes) == 1 else ": ").join(titles), fontsize="medium")
        axis.label_outer()
    extend = "max" if is_beyond else "neither"
    faces = axes[0, 0].collections[0]
    bar = figure.colorbar(faces, ax=axes, location="bottom", aspect=40, extend=extend)
    bar.set_label(f"{label}, mean of the cells at each node")
    _leave_out_blank(figure)
    with complete(path) as partial:
        figure.savefig(partial, format="png")


def _largest_seen(
    mesh: jm.Mesh, colours: list[PlotColumn], states: list[PlotPlaces], window: _plane.Window
) -> tuple[float, bool]:
    """The largest value of all states in a window, without outliers, and whether there are any."""
    values = []
    sizes = []
    for own, points in zip(colours, states, strict=True):
        cells = _plane.PlaneCells.of(mesh, points)
        seen = _plane.find_seen(cells.outlines, window)
        values.append(own[cells.cell[seen]])
        sizes.append(cells.areas[seen])
    every = np.concatenate(values)
    largest = usual_limits(every, np.concatenate(sizes))[1]
    largest = min(largest, float(np.nanmax(every, initial=0)))
    return (largest, bool(np.any(every > largest))) if largest > ROUNDOFF_MEASURE else (1.0, False)


def _put_cross(axis: Any, place: ndarray, window: _plane.Window) -> bool:
    (left, right), (bottom, top) = window
    if not (left <= place[0] <= right and bottom <= place[1] <= top):
        return False
    axis.plot(*place, "x", color=BLUE, markersize=7, markeredgewidth=1.5, clip_on=False, zorder=9)
    return True


def _leave_out_blank(figure: Figure) -> None:
    """Lowers a figure to what is drawn: axes of one scale leave room above them."""
    figure.draw_without_rendering()
    drawn = figure.get_tightbbox()
    figure.set_figheight(min(drawn.height + 2 * PAD, figure.get_figheight()))


def _panels(window: _plane.Window, count: int) -> tuple[Figure, Any]:
    """Axes beside each other, or one above the other for a flat window."""
    width, height = (end - start for start, end in window)
    rows = count if height < FLAT_VIEW * width else 1
    columns = count // rows
    tall = (
        rows * (0.4 + (LINE_WIDTH - 0.9) / columns * min(height / width, 1.5))
        + 1.15
        + 0.2 * columns
    )
    figure = Figure(figsize=(LINE_WIDTH, tall), dpi=300, layout="constrained")
    return figure, figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)


def _average(mesh: jm.Mesh, values: PlotColumn) -> PlotColumn:
    """Means over the cells at each node, then over its nodes: single triangles are noise."""
    kinds = [np.asarray(ids) for ids in mesh.cells.values()]
    cell = np.repeat(
        np.arange(len(values)), np.concatenate([np.full(len(ids), ids.shape[1]) for ids in kinds])
    )
    node = join_ids(kinds)
    counts = np.isfinite(values)
    weights, sums = (
        np.bincount(node, part[cell], len(mesh.points))
        for part in (counts, np.where(counts, values, 0))
    )
    at_nodes = sums / np.maximum(weights, 1)
    return np.bincount(cell, at_nodes[node]) / np.bincount(cell)


@dataclasses.dataclass(frozen=True, eq=False)
class FlatSide:
    """What is drawn in 2-D: a mesh in 2-D, or one side of a mesh in 3-D that is one cell wide.

    `points` (k, 2) are its nodes afterwards, `nodes` (k,) their ids, `cells` the file's cell of
    each of its cells, `axes` the coordinates in its plane.
    """

    mesh: jm.Mesh
    points: PlotPlaces
    nodes: PlotIds
    cells: PlotIds
    axes: list[int]

    @classmethod
    def of(cls, mesh: jm.Mesh, places: PlotPlaces) -> "FlatSide | None":
        base = np.asarray(mesh.points)
        if base.shape[1] == 2:
            return cls(mesh, places, np.arange(len(base)), np.asarray(mesh.cell_ids), [0, 1])
        height = base - base.min(axis=0)
        size = np.ptp(base, axis=0)
        near = 1e-6 * size.max()
        is_layer = (size > near) & ((height < near) | (height > size - near)).all(axis=0)
        thin = int(np.argmin(np.where(is_layer, size, np.inf)))
        if not is_layer[thin] or np.abs(places - base)[:, thin].max() > near:
            return None
        on = height[:, thin] < near
        axes = [k for k in range(3) if k != thin]
        surface, owner = jm.Mesh(base, mesh.cells).skin()
        chosen = {kind: on[ids].all(axis=1) for kind, ids in surface.cells.items()}
        nodes = np.flatnonzero(on)
        number = np.cumsum(on) - 1
        flat = jm.Mesh(
            base[nodes][:, axes],
            {kind: number[ids[chosen[kind]]] for kind, ids in surface.cells.items()},
        )
        cells = np.asarray(mesh.cell_ids)[owner[np.concatenate([*chosen.values()])]]
        return cls(flat, places[nodes][:, axes], nodes, cells, axes)
