"""Curves: histograms of quality, and the progress of an optimisation."""

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph.extend import checked
from jaxmorph.shapes import History

from ._plane import Axes, Formatter, choose_axes, legend_above, plt
from ._style import BLUE, DARK, GREEN, GREY, LINE_WIDTH, ORANGE, RULE, PlotColumn


@checked
def histogram(
    reports: Mapping[str, jm.QualityReport], *, measure: str = "skewness", ax: Axes | None = None
) -> Axes:
    """Draws histograms of a measure for reports by name: `{"before": ..., "after": ...}`.

    Counts are on a logarithmic scale: the worst cells are few. Boundary cells and infinite values
    do not count.

    **Arguments:**

    - `reports`: what `quality` returned, by the names for the legend.
    - `measure`: the name of one of the report's arrays. Default "skewness".
    - `ax`: matplotlib's axes; new ones by default.

    **Returns:** the axes. **Raises:** `ValueError` for an unknown measure, and no report.
    """
    if measure not in jm.QualityReport.measures:
        raise ValueError(
            f"no measure is called {measure!r}; there are {', '.join(jm.QualityReport.measures)}."
        )
    if not reports:
        raise ValueError(
            "`reports` is empty: give at least one, such as {'undeformed': jm.quality(mesh)}."
        )
    values = {name: _counted_values(report, measure) for name, report in reports.items()}
    ax = choose_axes(ax)
    bins = np.histogram_bin_edges(np.concatenate(list(values.values())), bins=60).tolist()
    colours = itertools.cycle((GREY, BLUE, ORANGE, GREEN, DARK))
    style: dict[str, Any] = {"histtype": "bar", "alpha": 0.5}
    for (name, own), colour in zip(values.items(), colours, strict=False):
        ax.hist(own, bins=bins, label=name, color=colour, log=True, **style)
        style = {"histtype": "step", "linewidth": 1.8}  # the first one is filled
    ax.set_ylim(bottom=0.5)  # below a single cell
    ax.set_xlabel(measure.replace("_", " "))
    ax.set_ylabel("cells")
    legend_above(ax)
    return ax


def _counted_values(report: jm.QualityReport, measure: str) -> PlotColumn:
    values = np.asarray(getattr(report, measure))
    return values[report.counted & np.isfinite(values)]


@checked
def convergence(
    history: History,
    *,
    bounds: Mapping[str, tuple[float | int, float | int]] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draws an optimisation's progress: the objective, each constraint and each measure against the
    iterations, one below the other, each on its own scale, with dashed lines at bounds.

    **Arguments:**

    - `history`: a `shapes.History`.
    - `bounds`: least and largest values of constraints and measures by name, one of them infinite
      or not: `{"lift": (0.5, np.inf)}`.
    - `ax`: matplotlib's axes in a grid, whose place the panels share; new ones by default.

    **Returns:** the axes of the objective, the first.

    **Raises:** `ValueError` where there is nothing to draw, and for bounds of an unknown name.
    """
    bounds = {} if bounds is None else bounds
    if not len(history):
        raise ValueError(f"`history`: {history.path} has no iteration yet.")
    names = dict.fromkeys((*history.names, *bounds))
    panels = {"objective": history.values} | {name: history.column(name) for name in names}
    axes = _stack(ax, len(panels))
    for axis, (name, column) in zip(axes, panels.items(), strict=True):
        style: dict[str, Any] = {"marker": "."} if column.ndim == 1 else {"linewidth": 0.8}
        axis.plot(np.arange(len(history)), column, color=BLUE if axis is axes[0] else DARK, **style)
        for bound in filter(np.isfinite, bounds.get(name, ())):
            axis.axhline(bound, color=ORANGE, linestyle="--")
        axis.set_title(name.replace("_", " "), loc="left", fontsize="medium", pad=3)
        axis.yaxis.set_major_formatter(WholeNumbers())
        axis.grid(color=RULE)
        axis.set_axisbelow(True)
        axis.label_outer()
    axes[-1].set_xlabel("iteration")
    axes[-1].locator_params("x", integer=True)
    return axes[0]


class WholeNumbers(Formatter):
    """Labels numbers whole: an offset or a power above the axis would be in the title's place."""

    def __call__(self, x: float, pos: Any = None) -> str:
        axis: Any = self.axis
        low, high = sorted(axis.get_view_interval())
        span = high - low or 1.0
        digits = 2 + int(np.ceil(np.log10(max(abs(low), abs(high), span) / span)))
        return f"{0.0 if abs(x) < 1e-9 * span else x:.{digits}g}"


def _stack(ax: Axes | None, count: int) -> list[Axes]:
    """Makes axes one below the other, with one axis of iterations, in the place of one."""
    if ax is None:
        size = LINE_WIDTH, 0.6 + 1.15 * count
        figure, axes = plt.subplots(count, sharex=True, squeeze=False, figsize=size)
        figure.set_layout_engine("constrained")
        return list(axes.ravel())
    place = ax.get_subplotspec()
    if place is None:
        raise ValueError("`ax` stands in no grid: give axes of plt.subplots.")
    rows = place.subgridspec(count, 1)
    ax.set_subplotspec(rows[0])
    return [ax, *(ax.figure.add_subplot(rows[row], sharex=ax) for row in range(1, count))]
