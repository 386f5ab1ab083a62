"""The cells of a 2-D mesh as they are drawn: fills, lines between them, walls."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm

from .._host.cells.lagrange import lagrange_types, values
from ._style import TALLEST, WIDTH, finite

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes as Axes
    from matplotlib.collections import LineCollection as LineCollection
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_hex as to_hex
    from matplotlib.font_manager import findfont as findfont
    from matplotlib.patches import Patch as Patch
    from matplotlib.textpath import TextPath as TextPath
    from matplotlib.ticker import MaxNLocator as MaxNLocator
except ImportError as error:
    raise ImportError("jaxmorph.plot needs matplotlib and pyvista: pip install 'jaxmorph[plot]'") from error

Window = tuple[tuple[float, float], tuple[float, float]]

THINNEST, THICKEST, WALL = 0.01, 0.5, 1.4
"""Line widths in points: of cells a sixth of the cell, so that layers stay light; of walls."""

NARROW = 0.8
"""Cells narrower than this, in typographic points, show their colour and no line."""

LABEL = 0.3
"""Inches of an axis for a number at least: numbers of a small window have many digits."""

UNLABELLED = 0.775
"""The part of a figure's width that axes have until their labels are laid out."""

FOUR_CORNERS = {"line": [0, 1, 1, 0], "triangle": [0, 1, 2, 2], "quad": [0, 1, 2, 3]}

SEGMENTS = 4
"""Pieces of a curved edge in a picture, for each order of its polynomial."""


@dataclasses.dataclass(frozen=True)
class Cells:
    """A 2-D mesh's cells as they are drawn: four sides, some of no length in triangles and lines.

    - `sides` (k, 4, m, 2): places along each side, both ends among them: two of a straight one.
    - `ids` (k, 4): corners, repeated in triangles and lines.
    - `between` (k, 4): the node next to the first corner of a curved side; -1 for a straight one.
    - `whole` (k,): the cell of the file that each one is, or is a piece of.
    """

    sides: Float[np.ndarray, "k 4 m 2"]
    ids: Int[np.ndarray, "k 4"]
    between: Int[np.ndarray, "k 4"]
    whole: Int[np.ndarray, " k"]

    @classmethod
    def of(cls, mesh: jm.Mesh, points: Any) -> "Cells":
        if mesh.points.shape[1] != 2:
            raise ValueError(
                f"this is for 2-D meshes, not {mesh}; see `plot.surface`, `plot.cut` and `plot.before_after_3d`."
            )
        if not sum(map(len, mesh.cells.values())):
            raise ValueError(f"there is nothing to draw: {mesh} has no cells.")
        points = finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
        cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
        order = max(lagrange_types()[kind].order for kind in cells)
        along = np.linspace(0, 1, 2 if order == 1 else SEGMENTS * order + 1)[:, None]
        parts = [_sides(kind, nodes, points, along) for kind, nodes in cells.items()]
        sides, ids, between = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(sides, ids, between, np.arange(len(ids)) if mesh.is_curved else np.asarray(mesh.cell_ids))

    @property
    def outlines(self) -> Float[np.ndarray, "k c 2"]:
        """Places once round each cell: the corners of a straight one."""
        return self.sides[:, :, :-1].reshape(len(self.ids), -1, 2)

    @property
    def areas(self) -> Float[np.ndarray, " k"]:
        x = self.outlines - self.outlines[:, :1]
        (a, b), (c, d) = (np.moveaxis(part, 2, 0) for part in (x, np.roll(x, -1, axis=1)))
        return np.abs(np.sum(a * d - b * c, axis=1)) / 2

    def inside(self, window: Window) -> Int[np.ndarray, " s"]:
        """Lists the cells that may be seen."""
        return seen_in(self.outlines, window)

    def drawn(self, window: Window | None) -> Int[np.ndarray, " s"]:
        """Lists the cells in a given window; else all, for films and readers who move the view."""
        return np.arange(len(self.ids)) if window is None else self.inside(window)

    def edges(self, cells: Int[np.ndarray, " s"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lists edges (e, m, 2) of cells, their counts, and the width (e,) of the narrowest cell.

        Edges between two pieces of one polygon are left out.
        """
        ids = self.ids[cells]
        ends = np.sort(np.stack([ids, np.roll(ids, -1, axis=1)], axis=2), axis=2)
        keys = np.concatenate([ends, self.between[cells][:, :, None]], axis=2)
        lengths = np.linalg.norm(np.diff(self.sides[cells], axis=2), axis=3).sum(axis=2).max(axis=1)
        width = self.areas[cells] / np.maximum(lengths, np.finfo(float).tiny)
        real = keys[..., 0] != keys[..., 1]
        edges, index, which, counts = np.unique(
            keys[real], axis=0, return_index=True, return_inverse=True, return_counts=True
        )
        which, owner = which.ravel(), np.repeat(self.whole[cells], 4)[real.ravel()]
        narrowest, first, last = (
            np.full(len(edges), np.inf),
            np.full(len(edges), len(self.whole)),
            np.full(len(edges), -1),
        )
        np.minimum.at(narrowest, which, np.repeat(width, 4)[real.ravel()])
        np.minimum.at(first, which, owner)
        np.maximum.at(last, which, owner)
        shown = (counts == 1) | (first < last) | (narrowest == 0)
        return self.sides[cells][real][index[shown]], counts[shown], narrowest[shown]


def _sides(
    kind: str, nodes: Int[np.ndarray, "k s"], points: Float[np.ndarray, "n 2"], along: Float[np.ndarray, "m 1"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Computes the sides of cells of one type at places `along` an edge, their corners and keys."""
    cell = lagrange_types()[kind]
    corners = FOUR_CORNERS[cell.shape]
    edges = {frozenset(edge[:2].tolist()): edge for edge in cell.edges}
    weights = values("line" if cell.order == 1 else f"line{cell.order + 1}", along)
    sides, between = [], []
    for first, second in zip(corners, [*corners[1:], corners[0]], strict=True):
        edge = edges.get(frozenset((first, second)), np.full(cell.order + 1, first))
        x = np.einsum("mn,knd->kmd", weights, points[nodes[:, edge]])
        sides.append(x if edge[0] == first else x[:, ::-1])
        inner = nodes[:, edge[2:]]
        between.append(inner.min(axis=1) if inner.shape[1] else np.full(len(nodes), -1))
    return np.stack(sides, axis=1), nodes[:, corners], np.stack(between, axis=1)


def seen_in(corners: Float[np.ndarray, "k c 2"], window: Window) -> Int[np.ndarray, " s"]:
    low, high = corners.min(axis=1), corners.max(axis=1)
    (left, right), (bottom, top) = window
    return np.flatnonzero((high >= (left, bottom)).all(axis=1) & (low <= (right, top)).all(axis=1))


def fill(ax: Axes, outlines: Float[np.ndarray, "k c 2"], **style: Any) -> PolyCollection:
    faces = PolyCollection(list(outlines), linewidths=0.3, edgecolors="face", rasterized=True, **style)
    ax.add_collection(faces, autolim=False)
    return faces


def draw_lines(
    ax: Axes, cells: Cells, seen: Int[np.ndarray, " s"], window: Window, colour: str, least: float | int = 0
) -> None:
    """Draws lines between cells, thinner where these are thin, none below `least`."""
    edges, _, narrowest = cells.edges(seen)
    to_points = 72 * ax.get_window_extent().width / ax.figure.dpi / (window[0][1] - window[0][0])
    chosen = narrowest * to_points >= least
    widths = np.clip(narrowest[chosen] * to_points / 6, THINNEST, THICKEST)
    lines = LineCollection(list(edges[chosen]), colors=colour, linewidths=widths, rasterized=True)
    ax.add_collection(lines, autolim=False)


def draw_walls(ax: Axes, cells: Cells, colour: str) -> None:
    """Draws edges with a cell on one side: an odd count, for a line's cell has it twice."""
    edges, counts, _ = cells.edges(np.arange(len(cells.ids)))
    lines = list(edges[counts % 2 == 1])
    ax.add_collection(LineCollection(lines, colors=colour, linewidths=WALL, capstyle="round"), autolim=False)


def given_or_new(ax: Axes | None, window: Window | None = None, *, bar: bool = False, above: float = 0.1) -> Axes:
    """Returns the given axes, or new ones of their window's shape, `above` inches on top."""
    if ax is not None:
        return ax
    if window is None:
        return plt.subplots(figsize=(WIDTH, 0.7 * WIDTH), layout="constrained")[1]
    width, height = (side[1] - side[0] for side in window)
    beside, below = 0.85 + 1.0 * bar, 0.55 + above  # inches for labels, in which the mesh has no part
    scale = min((WIDTH - beside) / width, (TALLEST - below) / height)
    size = scale * width + beside, max(scale * height + below, 1.5)
    ax = plt.subplots(figsize=size, layout="constrained")[1]
    for axis, length in ((ax.xaxis, scale * width), (ax.yaxis, scale * height)):
        axis.set_major_locator(MaxNLocator(int(np.clip(length / LABEL, 2, 7)), steps=(1, 2, 2.5, 5, 10)))
    return ax


def legend_above(ax: Axes, handles: Sequence[Any] | None = None) -> None:
    """Puts the legend above the axes, in as few rows as the figure's width has room for."""
    handles = ax.get_legend_handles_labels()[0] if handles is None else handles
    size, count = plt.rcParams["font.size"], len(handles)
    widths = [
        2.8 * size + TextPath((0, 0), str(handle.get_label()), size=size).get_extents().width for handle in handles
    ]
    room = 72 / ax.figure.dpi * ax.figure.bbox.width * min(ax.get_position().width / UNLABELLED, 1) - size
    # a column holds the entries of `rows` places in a row, and is as wide as its widest
    rows = 1
    while rows < count and sum(max(widths[k : k + rows]) for k in range(0, count, rows)) > room:
        rows += 1
    tight: dict[str, Any] = {"handlelength": 1.2, "handletextpad": 0.4, "columnspacing": 1.0, "frameon": False}
    columns = -(-count // rows)
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, fontsize=size, **tight)


def show(ax: Axes, window: Window) -> Axes:
    """Shows a window of the plane, and names its axes unless they have names."""
    ax.set(xlim=window[0], ylim=window[1], aspect="equal")
    ax.set(xlabel=ax.get_xlabel() or "x", ylabel=ax.get_ylabel() or "y")
    return ax
