"""Colours, limits and file names that all pictures share."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Real

import jaxmorph as jm

Limits = tuple[float | int, float | int]
Values = Real[Any, " k"] | Sequence[float | int]

DARK, GREY, BLUE, ORANGE, GREEN = "#1b1b1b", "#9a9a9a", "#0072b2", "#d55e00", "#009e73"
"""Colours of Okabe and Ito, told apart by colour-blind readers."""

COLOURS = "YlOrBr"
"""For qualities: light where a cell is good, so that its outline is seen; ordered by lightness alone."""

DISPLACEMENT = "YlGnBu"
"""For lengths of displacements: of another hue, ordered by lightness too."""


def finite(points: Any) -> np.ndarray:
    """Returns points as an array; raises `ValueError` for points that are not finite."""
    array = np.asarray(points, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError(f"{(~np.isfinite(array)).sum()} of {array.size} numbers of `points` are not finite.")
    return array


def cell_values(mesh: jm.Mesh, values: Any) -> np.ndarray:
    """Returns one value for each cell of a mesh; the value of a whole polyhedron, or polygon, is that of all its pieces.

    Raises `ValueError` for another number of values than of cells, and of whole cells.
    """
    cells, known = len(mesh.cell_ids), f"{len(mesh.cell_ids)} cells"
    if mesh.polyhedra is not None and np.shape(values) != (cells,):
        faces = mesh.polyhedra.faces
        whole = int(max(faces.owner.max(), faces.neighbour.max())) + 1
        if np.shape(values) == (whole,):
            return np.asarray(values)[mesh.cell_ids]
        known = f"{whole} cells, in {cells} pieces"
    if np.shape(values) != (cells,):
        raise ValueError(f"`values` has shape {np.shape(values)}; this mesh has {known}.")
    return np.asarray(values)


def colour_scale(limits: Limits | None, colours: str = COLOURS) -> tuple[str, Limits | None]:
    """Returns the colour map and its limits, ascending: the map is turned round where the dark end is the smaller one.

    Raises `ValueError` unless the limits are two finite numbers that differ.
    """
    if limits is None:
        return colours, None
    if np.shape(limits) != (2,) or not np.isfinite(limits).all() or limits[0] == limits[1]:
        raise ValueError(f"`limits` are the values at the light and at the dark end of the colours, not {limits}.")
    light, dark = map(float, limits)
    return (colours, (light, dark)) if light < dark else (f"{colours}_r", (dark, light))
