"""Curves: histograms of quality, and the progress of an optimisation."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph.extend import checked
from jaxmorph.shapes import History

from ._plane import Axes, given_or_new, legend_above
from ._style import BLUE, DARK, GREEN, GREY, ORANGE, RULE


@checked
def histogram(reports: Mapping[str, jm.QualityReport], *, measure: str = "skewness", ax: Axes | None = None) -> Axes:
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
        raise ValueError(f"no measure is called {measure!r}; there are {', '.join(jm.QualityReport.measures)}.")
    if not reports:
        raise ValueError("`reports` is empty: give at least one, such as {'undeformed': jm.quality(mesh)}.")
    finite = {name: _of_cells(report, measure) for name, report in reports.items()}
    ax = given_or_new(ax)
    bins = np.histogram_bin_edges(np.concatenate(list(finite.values())), bins=60)
    colours = (GREY, BLUE, ORANGE, GREEN, DARK)
    for k, (name, of_cells) in enumerate(finite.items()):
        style = {"histtype": "bar", "alpha": 0.5} if k == 0 else {"histtype": "step", "linewidth": 1.8}
        ax.hist(of_cells, bins=list(bins), label=name, color=colours[k % len(colours)], log=True, **style)
    ax.set_ylim(bottom=0.5)  # below a single cell
    ax.set_xlabel(measure.replace("_", " "))
    ax.set_ylabel("cells")
    legend_above(ax)
    return ax


def _of_cells(report: jm.QualityReport, measure: str) -> Float[np.ndarray, " k"]:
    values = np.asarray(getattr(report, measure))
    return values[report.counted & np.isfinite(values)]


@checked
def convergence(history: History, *, ax: Axes | None = None) -> Axes:
    """Draws an optimisation's progress: the objective over its first value against the iterations,
    with its constraints and measures.

    **Arguments:**

    - `history`: a `shapes.History`.
    - `ax`: matplotlib's axes; new ones by default.

    **Returns:** the axes. **Raises:** `ValueError` where there is nothing to draw.
    """
    if not len(history):
        raise ValueError(f"`history`: {history.path} has no iteration yet.")
    ax, steps, values = given_or_new(ax), np.arange(len(history)), history.values
    first = values[0] if np.isfinite(values[0]) and values[0] else 1.0
    ax.plot(steps, values / first, "o-", color=ORANGE, label="objective over the first" if first != 1 else "objective")
    for k, name in enumerate(history.names):
        column = history.column(name)
        style: dict[str, Any] = {"color": (BLUE, GREEN, DARK, GREY)[k % 4], "linestyle": ("-", "--")[k // 4 % 2]}
        if column.ndim == 1:
            ax.plot(steps, column, marker=".", label=name, **style)
        else:  # of several the one nearest to its bound
            ax.plot(steps, column.min(axis=1), marker=".", label=f"smallest of {name}", **style)
    ax.set_xlabel("iteration")
    ax.locator_params("x", integer=True)
    ax.grid(color=RULE)
    ax.set_axisbelow(True)
    legend_above(ax)
    return ax
