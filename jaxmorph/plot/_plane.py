"""Pictures in 2-D, with matplotlib: cells as fills, lines between them, walls."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import Delaunay

import jaxmorph as jm
from jaxmorph.extend import checked, finite_array

from ._style import (
    BLUE,
    BODY,
    DARK,
    GREY,
    LIGHT,
    LINE_WIDTH,
    ORANGE,
    TALLEST,
    UNNAMED,
    Limits,
    PlotColumn,
    PlotIds,
    PlotPlaces,
    PlotValues,
    body_patches,
    cell_values,
    check_cells,
    choose_points,
    finite_points,
    refine_cells,
    scale_of,
)

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes as Axes
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import to_hex as to_hex
    from matplotlib.figure import Figure as Figure
    from matplotlib.font_manager import findfont as findfont
    from matplotlib.patches import Patch, Polygon
    from matplotlib.textpath import TextPath as TextPath
    from matplotlib.ticker import Formatter as Formatter
    from matplotlib.ticker import MaxNLocator as MaxNLocator
except ImportError as error:
    raise ImportError(
        "jaxmorph.plot needs matplotlib and pyvista: pip install 'jaxmorph[plot]'"
    ) from error

Window = tuple[tuple[float, float], tuple[float, float]]
Outlines = Float[ndarray, "_ c 2"]

# widths of lines in points: of cells, a sixth of the cell; of walls
THINNEST = 0.01
THICKEST = 0.5
WALL = 1.4

# distance in points of a line from the next, over colours: below the first it is left out, from the
# second on it is whole, between them it fades
FADING = (0.5, 2.0)

# the part of the area below which lines of the cells that are wide enough for one are left out
WIDE_PART = 0.5

LABEL = 0.3  # inches of an axis for a number at least: numbers of a small window have many digits
UNLABELLED = 0.775  # the part of a figure's width that axes have until their labels are laid out
ROUND_STEPS = (1, 2, 2.5, 5, 10)  # between round numbers, times powers of ten
PLANE_PIECES = 200_000  # pieces of curved cells that a picture has about at most
FIGURE_ROOM = 0.4  # margin around the bodies, relative to their extent, unless a window is given
INNER_FLOW = 0.7  # part of the mesh, along one axis, beyond which the window is the mesh's own


@checked
def mesh(
    mesh: jm.Mesh,
    points: Float[Any, "n 2"] | None = None,
    *,
    values: PlotValues | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    window: Window | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draws a 2-D mesh's cells, coloured by a value each, and its boundary in a stronger line.

    Lines of coloured cells fade where they are close to each other. Polygons are drawn whole, edges
    of curved cells along their polynomials.

    **Arguments:**

    - `mesh`: a mesh in 2-D.
    - `points`: positions (n, 2) of its nodes; the mesh's own by default.
    - `values`: one for each cell, as `quality` gives, or for each whole polygon, as `face_quality`
      gives. Default: only the lines are drawn.
    - `limits`: the values at the light and at the dark end of the colours; (1, 0) for a measure
      that is small where cells are bad. Default: the limits of all values in the window, without
      outliers on 1 % of the area, for which the bar has an arrow.
    - `label`: what the values are, beside the colour bar.
    - `bar`: False leaves out the colour bar. For several axes that share one:
      `figure.colorbar(ax.collections[0], ax=axes)`.
    - `window`: ((left, right), (bottom, top)); by default the bodies and some room round them;
      of internal flow, and by `whole(mesh.points)`, all.
    - `ax`: matplotlib's axes; new ones by default, in a figure of the window's shape.

    **Raises:** `ValueError` for a mesh in 3-D, points of another shape, a number of values that is
    not that of the cells, and a `label` without values.
    """
    if values is None and label is not None:
        raise ValueError(f"there are no `values` that are {label!r}.")
    cells = PlaneCells.of(mesh, points)
    every = None if values is None else cell_values(mesh, values)[cells.cell]
    drawn = cells.drawn(window)
    window = window_of(mesh, None, points) if window is None else window
    if every is None:
        ax = show(choose_axes(ax, window), window)
    else:
        seen = find_seen(cells.outlines, window)
        colours, ends, *beyond = scale_of(every[seen], cells.areas[seen], limits)
        ax = show(choose_axes(ax, window, bar=bar), window)
        faces = fill(ax, cells.outlines[drawn], cmap=colours)
        fill_bodies(ax, cells, BODY)
        faces.set_array(every[drawn])
        faces.set_clim(*ends)
        if bar:
            extend = ("neither", "min", "max", "both")[beyond[0] + 2 * beyond[1]]
            ax.figure.colorbar(
                faces, cax=ax.inset_axes((1.02, 0, 0.03, 1)), label=label or UNNAMED, extend=extend
            )
    draw_lines(ax, cells, drawn, window, DARK, fading=None if every is None else FADING)
    draw_walls(ax, cells, DARK)
    return ax


@checked
def before_after(
    mesh: jm.Mesh,
    points: Float[Any, "n 2"],
    *,
    window: Window | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draws the deformed 2-D mesh in blue over the undeformed bodies in light orange.

    Arguments, result and errors are as of `plot.mesh`.
    """
    before = PlaneCells.of(mesh, None)
    after = PlaneCells.of(mesh, points)
    old = before.drawn(window)
    new = after.drawn(window)
    window = window_of(mesh, None, None, points) if window is None else window
    ax = show(choose_axes(ax, window, above=0.35), window)
    fill_bodies(ax, before, LIGHT)
    fill(ax, before.outlines[old], facecolors="white")
    draw_lines(ax, after, new, window, BLUE)
    draw_walls(ax, before, ORANGE)
    draw_walls(ax, after, BLUE)
    colours = (LIGHT, ORANGE, "undeformed"), ("white", BLUE, "deformed")
    legend_above(
        ax, [Patch(facecolor=face, edgecolor=edge, label=name) for face, edge, name in colours]
    )
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
    - `window`: as in `plot.mesh`; the moving nodes and some room by default.
    - `interior`: True shows the nodes of the volume too, where the plan's method puts them.
    - `ax`: matplotlib's axes; new ones by default.

    **Raises:** `ValueError` for a plan in 3-D, and when the shape of `u` is not (m, 2).
    """
    points = in_2d(plan.points)
    moving = np.asarray(plan.moving)
    fixed = np.asarray(plan.fixed)
    nodes = np.concatenate([moving, fixed])
    simplices = nodes[Delaunay(points[nodes]).simplices]
    if u is not None:
        points = np.asarray(jm.deform(plan, finite_array("u", u, (plan.n_moving, 2))))
    window = window_round(points[moving], points) if window is None else window
    ax = show(choose_axes(ax, window, above=0.35), window)
    if interior:
        ax.plot(*np.delete(points, nodes, axis=0).T, ".", color=GREY, markersize=2, zorder=1)
    edges = np.unique(
        np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0
    )
    ax.add_collection(
        LineCollection(list(points[edges]), colors=DARK, linewidths=0.25), autolim=False
    )
    for ids, colour, name in ((moving, ORANGE, "moving nodes"), (fixed, BLUE, "fixed nodes")):
        label = name if len(find_seen(points[ids][:, None], window)) else None
        ax.plot(*points[ids].T, ".", color=colour, markersize=5, label=label, zorder=3)
    if ax.get_legend_handles_labels()[1]:
        legend_above(ax)
    return ax


@dataclasses.dataclass(frozen=True)
class PlaneCells:
    """A 2-D mesh's cells as they are drawn, curved ones in pieces.

    - `points` (n, 2), `ids` (k, 4): corners, the last one repeated in triangles and lines.
    - `cell`, `whole` (k,): the mesh's cell, and the file's, of each of them.
    - `steps`: pieces along an edge.
    """

    points: PlotPlaces
    ids: Int[ndarray, "k 4"]
    cell: PlotIds
    whole: PlotIds
    steps: int

    @classmethod
    def of(cls, mesh: jm.Mesh, points: Any) -> "PlaneCells":
        if mesh.points.shape[1] != 2:
            raise ValueError(
                f"this is for 2-D meshes, not {mesh}; see `plot.surface`, `plot.cut` and "
                "`plot.before_after_3d`."
            )
        check_cells(mesh)
        places = choose_points(mesh, points)
        fine = mesh
        cell = np.arange(len(mesh.cell_ids))
        if mesh.is_curved:
            fine, cell = refine_cells(mesh.moved(places), PLANE_PIECES)
            places = np.asarray(fine.points)
        ids = [
            np.asarray(ids)[:, [*range(ids.shape[1]), -1, -1][:4]] for ids in fine.cells.values()
        ]
        steps = round((len(cell) / len(mesh.cell_ids)) ** 0.5)
        return cls(places, np.concatenate(ids), cell, np.asarray(mesh.cell_ids)[cell], steps)

    @property
    def outlines(self) -> Outlines:
        return self.points[self.ids]

    @property
    def areas(self) -> PlotColumn:
        corners = self.outlines
        (a, b), (c, d) = (np.moveaxis(corners[:, k + 2] - corners[:, k], 1, 0) for k in (0, 1))
        return np.abs(a * d - b * c) / 2

    def drawn(self, window: Window | None) -> PlotIds:
        """Lists the cells in a given window; else all, for views that move."""
        return np.arange(len(self.ids)) if window is None else find_seen(self.outlines, window)

    def edges(self, cells: PlotIds) -> tuple[ndarray, ndarray, ndarray]:
        """Lists edges (e, 2) of whole cells, their counts, and how far (e,) the next line is."""
        ids = self.ids[cells]
        ends = np.sort(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        lengths = np.linalg.norm(np.diff(self.points[ends], axis=1), axis=2).ravel()
        areas = np.repeat(self.steps * self.areas[cells], 4)
        width = np.divide(areas, lengths, out=np.zeros(len(areas)), where=lengths > 0)
        real = ends[:, 0] != ends[:, 1]
        # an edge between two pieces of a whole cell is none; a line's cell has its edge twice
        keys = np.column_stack([ends, np.repeat(self.whole[cells], 4)])[real]
        own, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
        width = width[real][first]
        shown = (count == 1) | (width == 0)
        edges, which = np.unique(own[shown, :2], axis=0, return_inverse=True)
        narrowest = np.full(len(edges), np.inf)
        np.minimum.at(narrowest, which.ravel(), width[shown])
        return edges, np.bincount(which.ravel(), count[shown]), narrowest

    @property
    def boundary(self) -> Int[ndarray, "e 2"]:
        # an edge with a cell on one side has an odd count: a line's cell has it twice
        edges, counts, _ = self.edges(np.arange(len(self.ids)))
        return edges[counts % 2 == 1]


def find_seen(corners: Outlines, window: Window) -> PlotIds:
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    (left, right), (bottom, top) = window
    return np.flatnonzero((high >= (left, bottom)).all(axis=1) & (low <= (right, top)).all(axis=1))


def fill(ax: Axes, outlines: Outlines, **style: Any) -> PolyCollection:
    faces = PolyCollection(
        list(outlines), linewidths=0.3, edgecolors="face", rasterized=True, **style
    )
    ax.add_collection(faces, autolim=False)
    return faces


def draw_lines(
    ax: Axes,
    cells: PlaneCells,
    seen: PlotIds,
    window: Window,
    colour: str,
    fading: tuple[float, float] | None = None,
) -> None:
    ids, _, narrowest = cells.edges(seen)
    edges = cells.points[ids]
    to_points = 72 * ax.get_window_extent().width / ax.figure.dpi / (window[0][1] - window[0][0])
    width = narrowest * to_points
    ink = np.ones(len(width)) if fading is None else np.clip(np.interp(width, fading, (0, 1)), 0, 1)
    areas = narrowest * np.linalg.norm(np.ptp(edges, axis=1), axis=1)
    if areas[ink > 0].sum() < WIDE_PART * areas.sum():  # single lines here and there are no mesh
        return
    chosen = ink > 0
    widths = np.clip(width[chosen] / 6, THINNEST, THICKEST)
    colours = [(colour, share) for share in ink[chosen].tolist()]
    lines = LineCollection(list(edges[chosen]), colors=colours, linewidths=widths, rasterized=True)
    ax.add_collection(lines, autolim=False)


def fill_bodies(ax: Axes, cells: PlaneCells, colour: str) -> None:
    """Fills all that boundaries enclose; cells are then drawn on it, and bodies are left."""
    place = np.unique(cells.points, axis=0, return_inverse=True)[1].ravel()
    first = np.zeros(len(cells.points), int)
    first[place] = np.arange(len(place))
    # the two sides of a cut at one place are no boundary
    edges, count = np.unique(np.sort(place[cells.boundary], axis=1), axis=0, return_counts=True)
    for ring in rings_of(edges[count % 2 == 1]):
        ax.add_patch(Polygon(cells.points[first[ring]], facecolor=colour, zorder=0.5))


def rings_of(edges: Int[ndarray, "e 2"]) -> list[list[int]]:
    """Walks along edges until none is left: closed rings of nodes."""
    beside: dict[int, set[int]] = {}
    for a, b in edges.tolist():
        beside.setdefault(a, set()).add(b)
        beside.setdefault(b, set()).add(a)
    rings = []
    while beside:
        ring = [next(iter(beside))]
        while ring[-1] in beside:
            node = ring[-1]
            after = beside[node].pop()
            beside[after].discard(node)
            ring.append(after)
            for end in (node, after):
                if not beside.get(end, True):
                    del beside[end]
        rings.append(ring)
    return rings


def draw_walls(ax: Axes, cells: PlaneCells, colour: str) -> None:
    lines = list(cells.points[cells.boundary])
    ax.add_collection(
        LineCollection(lines, colors=colour, linewidths=WALL, capstyle="round"), autolim=False
    )


def choose_axes(
    ax: Axes | None, window: Window | None = None, *, bar: bool = False, above: float = 0.1
) -> Axes:
    if ax is not None:
        return ax
    if window is None:
        return plt.subplots(figsize=(LINE_WIDTH, 0.7 * LINE_WIDTH), layout="constrained")[1]
    width, height = (side[1] - side[0] for side in window)
    # inches for labels, in which the mesh has no part
    beside = 0.85 + 1.0 * bar
    below = 0.55 + above
    scale = min((LINE_WIDTH - beside) / width, (TALLEST - below) / height)
    size = scale * width + beside, max(scale * height + below, 1.5)
    ax = plt.subplots(figsize=size, layout="constrained")[1]
    for axis, length in ((ax.xaxis, scale * width), (ax.yaxis, scale * height)):
        axis.set_major_locator(MaxNLocator(int(np.clip(length / LABEL, 2, 7)), steps=ROUND_STEPS))
    return ax


def round_numbers(low: float, high: float, count: int) -> list[float]:
    values = np.asarray(MaxNLocator(count, steps=ROUND_STEPS).tick_values(low, high))
    return values[(low <= values) & (values <= high)].tolist()


def legend_above(ax: Axes, handles: Sequence[Any] | None = None) -> None:
    handles = ax.get_legend_handles_labels()[0] if handles is None else handles
    size = plt.rcParams["font.size"]
    figure = ax.figure
    room = figure.bbox.width * min(ax.get_position().width / UNLABELLED, 1) - size * figure.dpi / 72
    tight: dict[str, Any] = {
        "handlelength": 1.2,
        "handletextpad": 0.4,
        "columnspacing": 1.0,
        "frameon": False,
    }
    for columns in range(len(handles), 0, -1):
        legend = ax.legend(
            handles=handles,
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            ncols=columns,
            fontsize=size,
            **tight,
        )
        if legend.get_window_extent().width <= room:
            return


def show(ax: Axes, window: Window) -> Axes:
    ax.set(xlim=window[0], ylim=window[1], aspect="equal")
    ax.set(xlabel=ax.get_xlabel() or "x", ylabel=ax.get_ylabel() or "y")
    return ax


def in_2d(points: Any) -> PlotPlaces:
    points = finite_points(points)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(
            f"this is for points in 2-D, not of shape {points.shape}; `plot.surface` is for 3-D."
        )
    return points


@checked
def whole(points: Float[Any, "n 2"]) -> Window:
    """Computes the window ((left, right), (bottom, top)) that shows all points (n, 2).

    **Raises:** `ValueError` for points that are not in 2-D.
    """
    points = in_2d(points)
    left, bottom = points.min(axis=0).tolist()
    right, top = points.max(axis=0).tolist()
    return (left, right), (bottom, top)


def window_of(mesh: jm.Mesh, nodes: PlotIds | None, *states: Any) -> Window:
    """Chooses the window round nodes, by default the bodies', in all states of the mesh."""
    states = tuple(np.asarray(mesh.points if points is None else points) for points in states)
    everything = np.concatenate(states)
    nodes = mesh.patch(*body_patches(mesh)) if nodes is None or not len(nodes) else nodes
    if not len(nodes):
        return whole(everything)
    return window_round(np.concatenate([points[nodes] for points in states]), everything)


def window_round(body: PlotPlaces, points: PlotPlaces) -> Window:
    """Leaves room round a body; of internal flow it is the whole mesh's."""
    low = body.min(axis=0)
    high = body.max(axis=0)
    room = FIGURE_ROOM * (high - low).max()
    low = np.maximum(low - room, points.min(axis=0))
    high = np.minimum(high + room, points.max(axis=0))
    return whole(
        points
        if (high - low > INNER_FLOW * np.ptp(points, axis=0)).any()
        else np.stack([low, high])
    )
