"""Colours, sizes, fonts and limits that all pictures share."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Real

import jaxmorph as jm
from jaxmorph.extend import lagrange_types

Limits = tuple[float | int, float | int]
Column = Float[np.ndarray, " k"]
Places = Float[np.ndarray, "_ d"]
Ids = Int[np.ndarray, " _"]
Values = Real[Any, " k"] | Sequence[float | int]

DARK = "#1b1b1b"
GREY = "#9a9a9a"
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
"""Colours of Okabe and Ito, told apart by colour-blind readers."""

LIGHT, BODY, RULE = (
    "#f7cfae",
    "#c4cad3",
    "#dddddd",
)  # undeformed bodies, what is not mesh, and the lines of a diagram

COLOURS = "YlOrBr"
"""For qualities: light where a cell is good, so that its outline is seen; by lightness."""

DISPLACEMENT = "YlGnBu"  # for lengths of displacements: of another hue, ordered by lightness too
UNNAMED = "values of the cells"  # what a bar says of values without a label
WIDTH, TALLEST = (
    5.0,
    5.0,
)  # a new figure's width and largest height in inches: 10 points are legible at 3.5 inches too
OUTLIERS, FAR = (
    0.01,
    0.3,
)  # share of values that may lie beyond the colours, and the stretch from which they do
STILL = 0.01  # share of the largest displacement below which a node counts as still
SEGMENTS, PIECES = (
    4,
    1_000_000,
)  # pieces of a curved edge, for each order of its polynomial; of a picture


def finite(points: Any) -> np.ndarray:
    array = np.asarray(points, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError(
            f"{(~np.isfinite(array)).sum()} of {array.size} numbers of `points` are not finite."
        )
    return array


def check_cells(mesh: jm.Mesh) -> None:
    if not sum(map(len, mesh.cells.values())):
        raise ValueError(f"there is nothing to draw: {mesh} has no cells.")


def refined(mesh: jm.Mesh, most: int = PIECES) -> tuple[jm.Mesh, Ids]:
    """Cuts curved cells into linear pieces, which share points; returns the cell of each too."""
    types = [(lagrange_types()[kind], len(ids)) for kind, ids in mesh.cells.items() if len(ids)]
    order = max(cell.order for cell, _ in types)
    dimension = max(cell.dimension for cell, _ in types)
    count = sum(number * cell.order**cell.dimension for cell, number in types)
    return mesh.refined(order * int(np.clip((most / count) ** (1 / dimension), 1, SEGMENTS)))


def cell_values(mesh: jm.Mesh, values: Any) -> np.ndarray:
    """Returns a value for each of `mesh.cells`, from one a cell, or one a whole polyhedron."""
    cells = len(mesh.cell_ids)
    known = f"{len(mesh.cell_ids)} cells"
    if mesh.polyhedra is not None and np.shape(values) != (cells,):
        whole = mesh.polyhedra.faces.count
        if np.shape(values) == (whole,):
            return np.asarray(values)[mesh.cell_ids]
        known = f"{whole} cells, in {cells} pieces"
    if np.shape(values) != (cells,):
        raise ValueError(f"`values` has shape {np.shape(values)}; this mesh has {known}.")
    return np.asarray(values)


def colour_scale(limits: Limits | None, colours: str = COLOURS) -> tuple[str, Limits | None]:
    """Returns the colour map and its limits, ascending; reversed where the dark end is smaller."""
    if limits is None:
        return colours, None
    if np.shape(limits) != (2,) or not np.isfinite(limits).all() or limits[0] == limits[1]:
        raise ValueError(
            "`limits` are the values at the light and at the dark end of the colours, not "
            f"{limits}."
        )
    light, dark = map(float, limits)
    return (colours, (light, dark)) if light < dark else (f"{colours}_r", (dark, light))


def scale_of(
    values: Real[np.ndarray, " k"], sizes: Column, limits: Limits | None
) -> tuple[str, Limits, bool, bool]:
    """Returns the colour map, its limits, and whether values are below them, and above."""
    colours, limits = colour_scale(limits)
    low, high = limits or _usual_limits(values, sizes)
    known = values[np.isfinite(values)]
    return colours, (low, high), bool((known < low).any()), bool((known > high).any())


def _usual_limits(values: Real[np.ndarray, " k"], sizes: Column) -> Limits:
    """Returns the least and largest value without outliers: 1 % of the area would pale others."""
    chosen = np.isfinite(values)
    values = values[chosen].astype(float)
    sizes = np.abs(sizes[chosen])
    if not len(values):
        return 0.0, 1.0
    shares = (OUTLIERS, 1 - OUTLIERS)
    weights = sizes + np.finfo(float).tiny
    low, high = np.quantile(values, shares, weights=weights, method="inverted_cdf").tolist()
    near = FAR * (high - low)  # what is little farther away is no outlier
    low, high = (
        float(extreme) if abs(extreme - end) <= near else end
        for extreme, end in ((values.min(), low), (values.max(), high))
    )
    return low, high if high - low > 1e-9 * max(abs(low), abs(high)) else low + max(abs(low), 1)


def bodies(mesh: jm.Mesh) -> list[str]:
    """Names bodies: patches with a node inside all points' box, on two sides at most."""
    points = np.asarray(mesh.points)
    low = points.min(axis=0)
    high = points.max(axis=0)
    near = 1e-6 * (high - low)
    found = []
    for name, nodes in mesh.patches.items():
        own = points[np.asarray(nodes)]
        sides = np.concatenate([own <= low + near, own >= high - near], axis=1)
        if len(own) and sides.any(axis=0).sum() <= 2 and not sides.any(axis=1).all():
            found.append(name)
    return found
