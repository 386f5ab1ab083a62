"""The calculated mode shapes of the AGARD 445.6 wing, and polynomials through them.

E. Carson Yates, "AGARD standard aeroelastic configurations for dynamic response. Candidate
configuration I.-wing 445.6", NASA TM-100492, 1987: deflections of 11 x 11 structural nodes, row by
row from root to tip, each from leading to trailing edge. The unit of a mode is its own; only the
component normal to the wing counts. The other components are 1e-10 (mode 1) or 4e-6 (mode 2) of it.
"""

import functools

import numpy as np

from ._agard445_wing import INCH, ROOT_CHORD, SEMI_SPAN, TIP_CHORD, TIP_LEADING_EDGE

# The nodes lie at tenths of the semi-span and of the chord, but for the sixth of each row: its x in
# inches.
SIXTH_NODE = (10.75, 13.65, 16.6, 19.5, 22.3, 25.2, 28.1, 30.9, 33.7, 36.7, 39.5)

DEFLECTIONS = {
    1: (
        (-0.0405, -0.0153, 0, 0, 0, 0, 0, 0, 0, -0.0524, -0.107),
        (0.00638, 0.0352, 0.069, 0.113, 0.166, 0.225, 0.306, 0.402, 0.538, 0.697, 0.914),
        (0.195, 0.317, 0.462, 0.628, 0.816, 1.03, 1.27, 1.56, 1.88, 2.25, 2.68),
        (0.815, 1.08, 1.38, 1.7, 2.05, 2.45, 2.86, 3.32, 3.84, 4.41, 5.03),
        (2.01, 2.42, 2.87, 3.35, 3.86, 4.43, 5, 5.63, 6.3, 7.03, 7.8),
        (3.8, 4.36, 4.95, 5.57, 6.22, 6.97, 7.63, 8.39, 9.19, 10, 10.9),
        (6.16, 6.85, 7.56, 8.29, 9.06, 9.96, 10.7, 11.5, 12.4, 13.3, 14.3),
        (9.05, 9.82, 10.6, 11.4, 12.3, 13.3, 14, 14.9, 15.9, 16.9, 17.9),
        (12.4, 13.2, 14, 14.9, 15.8, 16.8, 17.6, 18.5, 19.5, 20.5, 21.5),
        (16, 16.8, 17.7, 18.6, 19.5, 20.6, 21.3, 22.2, 23.2, 24.2, 25.1),
        (19.8, 20.6, 21.5, 22.4, 23.2, 24.4, 25, 26, 26.9, 27.8, 28.8),
    ),
    2: (
        (-0.315, -0.128, 0, 0, 0, 0, 0, 0, 0, -0.686, -2.28),
        (0.137, 0.335, 0.514, 0.668, 0.767, 0.778, 0.636, 0.238, -0.719, -2.35, -4.79),
        (1.62, 2.16, 2.59, 2.83, 2.83, 2.5, 1.74, 0.444, -1.5, -4.11, -7.53),
        (5.22, 5.84, 6.13, 6.03, 5.48, 4.35, 2.76, 0.476, -2.47, -6.1, -10.6),
        (10.5, 10.7, 10.4, 9.51, 8.05, 5.9, 3.28, -0.0744, -4.09, -8.8, -14.4),
        (16.5, 15.8, 14.4, 12.5, 9.91, 6.41, 2.86, -1.61, -6.72, -12.5, -19.2),
        (22, 20, 17.4, 14.3, 10.5, 5.47, 1.16, -4.39, -10.5, -17.3, -24.9),
        (25.9, 22.6, 18.7, 14.3, 9.4, 3.17, -2.01, -8.48, -15.5, -23, -31.3),
        (27.4, 22.9, 17.9, 12.4, 6.52, -0.653, -6.5, -13.6, -21.2, -29.2, -37.9),
        (26.3, 20.7, 14.8, 8.64, 2.11, -6.59, -11.9, -19.4, -27.3, -35.6, -44.5),
        (22.6, 16.5, 10.2, 3.58, -3.28, -12.4, -17.8, -25.6, -33.7, -42.3, -52.6),
    ),
}

SPAN_POWERS = range(2, 7)
CHORD_POWERS = range(4)


def structural_nodes() -> np.ndarray:
    """Returns the (121, 3) nodes of the table in metres, on the plane z = 0."""
    eta, xi = np.meshgrid(np.arange(11) / 10, np.arange(11) / 10, indexing="ij")
    x = TIP_LEADING_EDGE * eta + (ROOT_CHORD + (TIP_CHORD - ROOT_CHORD) * eta) * xi
    x[:, 5] = np.asarray(SIXTH_NODE) * INCH
    return np.column_stack([x.ravel(), SEMI_SPAN * eta.ravel(), np.zeros(eta.size)])


def deflections(mode: int) -> np.ndarray:
    """Returns the (121,) deflections of the table along z, 1 at the tip's trailing edge."""
    table = np.asarray(DEFLECTIONS[mode], dtype=float).ravel()
    return table / table[-1]


def planform_coordinates(points):
    """Computes `eta` along the span and `xi` along the chord (m,) of points (m, 3).

    They are 0 to 1 on the wing.
    """
    eta = points[:, 1] / SEMI_SPAN
    xi = (points[:, 0] - TIP_LEADING_EDGE * eta) / (ROOT_CHORD + (TIP_CHORD - ROOT_CHORD) * eta)
    return eta, xi


@functools.cache
def coefficients(mode: int) -> tuple[tuple[float, ...], ...]:
    """Fits a_ij of sum a_ij eta^i xi^j, i = 2..6, j = 0..3, to the table by least squares.

    The sum is 1 at the tip's trailing edge.

    There eta = xi = 1, so the coefficients add up to 1: the first is eliminated by it.
    """
    eta, xi = planform_coordinates(structural_nodes())
    terms = np.column_stack([eta**i * xi**j for i in SPAN_POWERS for j in CHORD_POWERS])
    rest = np.linalg.lstsq(terms[:, 1:] - terms[:, :1], deflections(mode) - terms[:, 0], rcond=None)[0]
    alpha = np.concatenate([[1 - rest.sum()], rest]).reshape(len(SPAN_POWERS), len(CHORD_POWERS))
    return tuple(tuple(float(value) for value in row) for row in alpha)


def mode_shape(points, mode: int):
    """Evaluates the fitted polynomial at (m, 3) points: (m,), NumPy's or JAX's as they are."""
    eta, xi = planform_coordinates(points)
    along_span = 0.0
    for row in reversed(coefficients(mode)):
        along_chord = 0.0
        for value in reversed(row):
            along_chord = along_chord * xi + value
        along_span = along_span * eta + along_chord
    return eta**2 * along_span
