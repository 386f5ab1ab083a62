"""Curves: histograms of quality, and the progress of an optimisation."""

from collections.abc import Mapping
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph.extend import checked
from jaxmorph.shapes import History

from ._plane import Axes, given_or_new, legend_above, plt
from ._style import BLUE, DARK, GREEN, GREY, LIGHT, ORANGE, RULE, WIDTH, Column


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
    finite = {name: _of_cells(report, measure) for name, report in reports.items()}
    ax = given_or_new(ax)
    bins = np.histogram_bin_edges(np.concatenate(list(finite.values())), bins=60)
    colours = (GREY, BLUE, ORANGE, GREEN, DARK)
    for k, (name, of_cells) in enumerate(finite.items()):
        style = (
            {"histtype": "bar", "alpha": 0.5} if k == 0 else {"histtype": "step", "linewidth": 1.8}
        )
        ax.hist(
            of_cells,
            bins=list(bins),
            label=name,
            color=colours[k % len(colours)],
            log=True,
            **style,
        )
    ax.set_ylim(bottom=0.5)  # below a single cell
    ax.set_xlabel(measure.replace("_", " "))
    ax.set_ylabel("cells")
    legend_above(ax)
    return ax


def _of_cells(report: jm.QualityReport, measure: str) -> Column:
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
    iterations, one below the other, each on its own scale; what is beyond bounds is shaded.

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
    panels = {"objective": history.values} | {
        name: history.column(name) for name in (*history.names, *bounds)
    }
    axes = _stack(ax, len(panels))
    for axis, (name, column) in zip(axes, panels.items(), strict=True):
        style: dict[str, Any] = {"marker": "."} if column.ndim == 1 else {"linewidth": 0.8}
        axis.plot(np.arange(len(history)), column, color=BLUE if axis is axes[0] else DARK, **style)
        _shade_beyond(axis, bounds.get(name, (-np.inf, np.inf)))
        axis.set_title(name.replace("_", " "), loc="left", fontsize="medium", pad=3)
        axis.grid(color=RULE)
        axis.set_axisbelow(True)
        axis.label_outer()
    axes[-1].set_xlabel("iteration")
    axes[-1].locator_params("x", integer=True)
    return axes[0]


def _shade_beyond(axis: Axes, bounds: tuple[float | int, float | int]) -> None:
    low, high = axis.get_ylim()
    known = np.array([bound for bound in bounds if np.isfinite(bound)])
    room = 0.05 * (high - low)
    axis.set_ylim(min(low, *(known - room), np.inf), max(high, *(known + room), -np.inf))
    for bound, end in zip(bounds, axis.get_ylim(), strict=True):
        if np.isfinite(bound):
            axis.axhline(bound, color=ORANGE, linestyle="--")
            axis.axhspan(bound, end, color=LIGHT, alpha=0.5, linewidth=0)


def _stack(ax: Axes | None, count: int) -> list[Axes]:
    """Makes axes one below the other, with one axis of iterations, in the place of one."""
    if ax is None:
        size = WIDTH, 0.6 + 1.15 * count
        return list(
            plt.subplots(count, sharex=True, squeeze=False, figsize=size, layout="constrained")[
                1
            ].ravel()
        )
    place = ax.get_subplotspec()
    if place is None:
        raise ValueError("`ax` stands in no grid: give axes of plt.subplots.")
    rows = place.subgridspec(count, 1)
    ax.set_subplotspec(rows[0])
    return [ax, *(ax.figure.add_subplot(rows[row], sharex=ax) for row in range(1, count))]
