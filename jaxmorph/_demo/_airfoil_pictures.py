"""Figures 5 and 6 of the paper, from what the demo of the airfoil found."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxmorph as jm
from jaxmorph import plot  # before matplotlib: it says what to install

# isort: split
import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

if TYPE_CHECKING:
    from ._airfoil import Outcome

STYLE: dict[Any, Any] = {"font.size": 13, "axes.titlesize": 15, "axes.labelsize": 14}
AIRFOIL: plot.Window = ((-0.35, 1.45), (-0.62, 0.48))
TRAILING_EDGE: plot.Window = ((0.915, 1.035), (-0.2325, -0.1592))
LARGEST = 0.5
"""The skewness at the dark end of the scale."""

REDUCED = ("#08306b", "#2171b5", "#6baed6", "#9ecae1")
"""Fewest sources first."""


def figure5(path: pathlib.Path, mesh: jm.Mesh, outcomes: Sequence["Outcome"]) -> None:
    """Draws the deformed meshes of some methods side by side."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13.33, 7.5), dpi=150, layout="constrained")
        axes = figure.subplots(2, len(outcomes), squeeze=False)
        for column, outcome in zip(axes.T, outcomes, strict=True):
            skewness = np.asarray(outcome.reports[-1].skewness)
            for axis, window in zip(column, (AIRFOIL, TRAILING_EDGE), strict=True):
                plot.mesh(mesh, outcome.points, values=skewness, limits=(0, LARGEST), window=window, bar=False, ax=axis)
                axis.tick_params(labelsize=11)
                axis.locator_params(nbins=6)
            column[0].set_title(f"{outcome.study.title}: largest skewness {outcome.skewness[-1][1]:.2f}")
            _frame(column[0], TRAILING_EDGE)
            column[1].set_xlabel("x / chord")
        for axis, what in zip(axes[:, 0], ("airfoil", "trailing edge and wake"), strict=True):
            axis.set_ylabel(f"{what}\ny / chord")
        bar = figure.colorbar(axes[0, 0].collections[0], ax=axes, aspect=35, pad=0.01)
        bar.set_label("skewness of the cells")
        figure.savefig(path)


def _frame(axis: Axes, window: plot.Window) -> None:
    (left, right), (bottom, top) = window
    axis.add_patch(Rectangle((left, bottom), right - left, top - bottom, fill=False, color=plot.BLUE, linewidth=2.5))


def figure6(
    path: pathlib.Path, start: jm.QualityReport, outcomes: Sequence["Outcome"], angles: Sequence[float]
) -> None:
    """Draws mean and largest skewness against the angle."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13.33, 5.6), dpi=150, layout="constrained")
        axes = figure.subplots(1, 2)
        undeformed = float(start.mean_skewness), float(start.max_skewness)
        for outcome, style in zip(outcomes, _styles(outcomes), strict=True):
            for column, axis in enumerate(axes):
                values = [undeformed[column], *(pair[column] for pair in outcome.skewness)]
                axis.plot([0, *angles], values, label=outcome.study.name, **style)
        for axis, what in zip(axes, ("Mean skewness, weighted by area", "Largest skewness"), strict=True):
            axis.set(title=what, xlabel="angle of rotation in degrees", xticks=[0, *angles])
            axis.grid(axis="y", color="#dddddd")
            axis.set_axisbelow(True)
            axis.spines[["top", "right"]].set_visible(False)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
        figure.savefig(path)


def _styles(outcomes: Sequence["Outcome"]) -> list[dict]:
    """Chooses colours by family of methods; markers and dashes differ too."""
    styles, shades, markers = [], iter(REDUCED), iter("o^vD")
    for outcome in outcomes:
        method = outcome.study.method
        if isinstance(method, jm.SurfaceReconstruction):
            styles.append({"color": next(shades), "marker": next(markers), "linewidth": 2})
        elif isinstance(method, jm.DelaunayGraph):
            dashes = "--" if outcome.study.rebuild else "-"
            styles.append({"color": plot.ORANGE, "marker": "s", "linestyle": dashes, "linewidth": 2})
        else:
            styles.append({"color": plot.DARK, "marker": "x", "linewidth": 2, "markersize": 9, "zorder": 3})
    return styles
