"""Colours, sizes, fonts and limits that all pictures share."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Real
from numpy import ndarray

import jaxmorph as jm
from jaxmorph.extend import finite_array, lagrange_types

Limits = tuple[float | int, float | int]
PlotColumn = Float[ndarray, " k"]
PlotPlaces = Float[ndarray, "_ d"]
PlotIds = Int[ndarray, " _"]
PlotValues = Real[Any, " k"] | Sequence[float | int]

DARK = "#1b1b1b"
GREY = "#9a9a9a"
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
"""Colours of Okabe and Ito, told apart by colour-blind readers."""

LIGHT = "#f7cfae"  # undeformed bodies
BODY = "#c4cad3"  # what is not mesh
RULE = "#dddddd"  # lines of a diagram

COLOURS = "YlOrBr"
"""For qualities: light where a cell is good, so that its outline is seen; by lightness."""

UNNAMED = "values of the cells"  # what a bar says of values without a label

FLAT_VIEW = 0.45  # height over width of a window below which two of them stand one above the other

# a new figure's width and largest height in inches: 10 points are legible at 3.5 inches too
LINE_WIDTH = 5.0
TALLEST = 5.0

# share of values that may lie beyond the colours, and the stretch from which they do
OUTLIERS = 0.01
STRETCH = 0.3

STILL = 0.01  # share of the largest displacement below which a node counts as still
SEGMENTS = 4  # pieces of a curved edge, for each order of its polynomial
MOST_PIECES = 1_000_000  # of a picture


def finite_points(points: Any) -> ndarray:
    array = np.asarray(points, dtype=float)
    return finite_array("points", array, array.shape)


def choose_points(mesh: jm.Mesh, points: Any) -> ndarray:
    """Returns where the nodes are: `points`, or the mesh's own for None."""
    return finite_points(mesh.points if points is None else mesh.moved(np.asarray(points)).points)


def check_cells(mesh: jm.Mesh) -> None:
    if not sum(map(len, mesh.cells.values())):
        raise ValueError(f"there is nothing to draw: {mesh} has no cells.")


def refine_cells(mesh: jm.Mesh, most: int = MOST_PIECES) -> tuple[jm.Mesh, PlotIds]:
    """Cuts curved cells into linear pieces, which share points; returns the cell of each too."""
    types = [(lagrange_types()[kind], len(ids)) for kind, ids in mesh.cells.items() if len(ids)]
    order = max(cell.order for cell, _ in types)
    dimension = max(cell.dimension for cell, _ in types)
    count = sum(number * cell.order**cell.dimension for cell, number in types)
    return mesh.refined(order * int(np.clip((most / count) ** (1 / dimension), 1, SEGMENTS)))


def cell_values(mesh: jm.Mesh, values: Any) -> ndarray:
    """Returns a value for each of `mesh.cells`, from one a cell, or one a whole polyhedron."""
    ids = np.asarray(mesh.cell_ids)
    shape = np.shape(values)
    count = f"{len(ids)} cells"
    if shape != (len(ids),) and mesh.polyhedra is not None:
        if shape == (mesh.polyhedra.faces.count,):
            return np.asarray(values)[ids]
        count = f"{mesh.polyhedra.faces.count} cells, in {len(ids)} pieces"
    if shape != (len(ids),):
        raise ValueError(f"`values` has shape {shape}; this mesh has {count}.")
    return np.asarray(values)


def scale_of(
    values: Real[ndarray, " k"], sizes: PlotColumn, limits: Limits | None
) -> tuple[str, Limits, bool, bool]:
    """Returns the colour map, reversed where the dark end is smaller, its limits, ascending, and
    whether values are below them, and above.
    """
    if limits is None:
        limits = usual_limits(values, sizes)
    elif np.shape(limits) != (2,) or not np.isfinite(limits).all() or limits[0] == limits[1]:
        raise ValueError(
            "`limits` are the values at the light and at the dark end of the colours, not "
            f"{limits}."
        )
    low, high = sorted(map(float, limits))
    colours = COLOURS if low == limits[0] else f"{COLOURS}_r"
    return colours, (low, high), bool(np.any(values < low)), bool(np.any(values > high))


def usual_limits(values: Real[ndarray, " k"], sizes: PlotColumn) -> Limits:
    """Returns the least and largest value without outliers: 1 % of the area would pale others."""
    chosen = np.isfinite(values)
    values = values[chosen].astype(float)
    sizes = np.abs(sizes[chosen])
    if not len(values):
        return 0.0, 1.0
    shares = (OUTLIERS, 1 - OUTLIERS)
    weights = sizes + np.finfo(float).tiny
    low, high = np.quantile(values, shares, weights=weights, method="inverted_cdf").tolist()
    near = STRETCH * (high - low)  # what is little farther away is no outlier
    low, high = (
        float(extreme) if abs(extreme - end) <= near else end
        for extreme, end in ((values.min(), low), (values.max(), high))
    )
    return low, high if high - low > 1e-9 * max(abs(low), abs(high)) else low + max(abs(low), 1)


def body_patches(mesh: jm.Mesh) -> list[str]:
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
