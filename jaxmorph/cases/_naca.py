"""The NACA 4-digit family, meshed: the paper's NACA0015 and its cambered relatives."""

import functools

import numpy as np

import jaxmorph as jm

from .._host.package.arguments import checked
from ._c_grid import REFERENCE_POINTS, c_grid


@checked
def naca0015(*, points: int = REFERENCE_POINTS) -> jm.Mesh:
    """Makes the C-grid around the NACA0015 of the paper's section 3.1, in chords.

    It has 39,666 points, none coincident, and 39,300 convex quads; patches `airfoil` (166 nodes)
    and `farfield` (566). The mean skewness (weighted by area) is 0.0710, the largest 0.1750, the
    paper's values. The first cell is 1e-5 chords, the trailing edge blunt.

    The first 260 x 150 cells are layers round the airfoil, from the wall outwards. Those of columns
    50 to 209 touch the wall in the first layer. The others are above and below the wake. The last
    50 x 6 are behind the base.

    **Arguments:**

    - `points`: about how many points: 2,000 for a test, a million for a benchmark. Default 39,666,
      at least 300.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for fewer than 300 points.
    """
    return naca4("0015", points=points, first_cell=1e-5)


@checked
def naca4(code: str, *, points: int = REFERENCE_POINTS, first_cell: float = 1e-6, sharp: bool = False) -> jm.Mesh:
    """Makes a C-grid around a NACA 4-digit airfoil, in chords: `cases.naca4("4412")`.

    Thickness is laid off normal to the camber line, and the trailing edge is blunt, as published
    (Jacobs, Ward and Pinkerton, NACA Report 460, 1933). Rays leave the wall as nearly along its
    normal as lets them turn steadily from one trailing edge to the other, so that they never meet
    before a concave wall. Cells, their order and patches as in `naca0015`.

    **Arguments:**

    - `code`: four digits: the camber in percent of the chord, its place in tenths, and the
      thickness in percent.
    - `points`: about how many points, 300 or more. Default 39,666.
    - `first_cell`: height of the cells at the wall, in chords. Default 1e-6.
    - `sharp`: True lets the thickness end at zero (its last coefficient is then 0.1036). Both sides
      meet in one node, and there is no base. Default False.

    **Returns:** a `Mesh`.

    **Raises:** `ValueError` for a code that is not of the family, fewer than 300 points, and a
    first cell that does not fit. Also for sections that straight rays cannot leave without a cell
    that is not convex. Such sections are below 4 % thickness with the camber far aft, or 24 % and
    more with large camber in the first tenth (9901, 9124). No other is known.
    """
    if not (isinstance(code, str) and len(code) == 4 and code.isascii() and code.isdigit()):
        raise ValueError(f"`code` is {code!r}; the NACA 4-digit family is written with four digits, such as '4412'.")
    camber, place, thickness = int(code[0]) / 100, int(code[1]) / 10, int(code[2:]) / 100
    if thickness == 0:
        raise ValueError(f"`code` is {code!r}: by its last two digits the section has no thickness.")
    if camber > 0 and place == 0:
        raise ValueError(f"`code` is {code!r}: a cambered section needs a place of its largest camber, 1 to 9 tenths.")
    return c_grid(
        functools.partial(_section, camber, place, thickness, 0.1036 if sharp else 0.1015),
        points=points,
        first_cell=first_cell,
    )


def _section(camber: float, place: float, thickness: float, last: float, t: np.ndarray) -> np.ndarray:
    """Computes the contour, x = t^2 along the chord: t < 0 below, t > 0 above."""
    x = t**2
    half = 5 * thickness * (0.2969 * np.abs(t) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - last * x**4)
    line, slope = np.zeros_like(x), np.zeros_like(x)
    if camber:
        ahead = x < place
        scale = camber / np.where(ahead, place, 1 - place) ** 2
        line = scale * (np.where(ahead, 0, 1 - 2 * place) + 2 * place * x - x**2)
        slope = 2 * scale * (place - x)
    away = np.sign(t) * half / np.sqrt(1 + slope**2)
    return np.column_stack([x - away * slope, line + away])
