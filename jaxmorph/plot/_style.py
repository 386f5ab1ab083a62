"""What all pictures share."""

from typing import Any

import numpy as np

DARK, GREY, BLUE, ORANGE, GREEN = "#1b1b1b", "#9a9a9a", "#0072b2", "#d55e00", "#009e73"
"""Colours of Okabe and Ito, told apart by colour-blind readers."""

COLOURS = "YlOrBr"
"""For qualities: light where a cell is good, so that its outline is seen; ordered by lightness alone."""


def check_values(values: Any, cells: int) -> None:
    """Raises `ValueError` unless there is one value for each cell."""
    if np.shape(values) != (cells,):
        raise ValueError(f"`values` has shape {np.shape(values)}; this mesh has {cells} cells.")
