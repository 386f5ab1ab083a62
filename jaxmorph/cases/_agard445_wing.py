"""The AGARD 445.6 wing's shape: planform and section, in metres.

Yates, NASA TM-100492, 1987, "weakened model 3".
"""

from typing import Any

import numpy as np

INCH = 0.0254
ROOT_CHORD = 21.96 * INCH
TIP_CHORD = 14.496 * INCH
SEMI_SPAN = 30.0 * INCH
TIP_LEADING_EDGE = 31.866 * INCH

# NACA 65A004, percent of the chord: stations, and half thickness at each. NASA TM-100492, which
# repeats the NACA's own ordinates for this section. At the last station 0.009 is published; 0 here
# gives the sharp trailing edge, on the straight line (0.490, 0.249, 0.008) along which the section
# ends anyway.
STATIONS = (0, 0.5, 0.75, 1.25, 2.5, 5, 7.5, *range(10, 101, 5))
HALF_THICKNESS = (
    *(0, 0.311, 0.378, 0.481, 0.656, 0.877, 1.062, 1.216, 1.463, 1.649, 1.790, 1.894, 1.962, 1.996),
    *(1.996, 1.952, 1.867, 1.742, 1.584, 1.400, 1.193, 0.966, 0.728, 0.490, 0.249, 0),
)
LEADING_EDGE_RADIUS = 0.102


def half_thickness(x: np.ndarray) -> np.ndarray:
    """Computes the half thickness of the section at `x` along the chord, both in chords.

    A cubic spline through the published ordinates in t = sqrt(x), in which a round nose is smooth:
    z = t sqrt(2 r) at the leading edge, r its radius.
    """
    from scipy.interpolate import CubicSpline  # its import takes longer than all other meshes together

    t = np.sqrt(np.asarray(STATIONS) / 100)
    ends: Any = ((1, np.sqrt(2 * LEADING_EDGE_RADIUS / 100)), "not-a-knot")
    spline = CubicSpline(t, np.asarray(HALF_THICKNESS) / 100, bc_type=ends)
    return spline(np.sqrt(x))


def upper_contour(intervals: int) -> np.ndarray:
    """Places (intervals + 1, 2) points evenly along the arc of the upper contour, in chords.

    They run from leading to trailing edge.
    """
    x = np.linspace(0, 1, 20_001) ** 2
    z = half_thickness(x)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
    even = np.interp(np.linspace(0, arc[-1], intervals + 1), arc, x)
    return np.column_stack([even, half_thickness(even)])
