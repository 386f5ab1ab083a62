"""Draws meshes: in 2-D with matplotlib, in 3-D with pyvista, off screen.

Plots take matplotlib's axes `ax` or pyvista's `plotter`, by default a new one, and return it.
"""

# isort: off
from jaxmorph.extend import listing as _listing
from ._curves import convergence as convergence, histogram as histogram
from ._distances import distances as distances
from ._picture import picture as picture
from ._plane import (
    Window as Window,
    before_after as before_after,
    graph as graph,
    mesh as mesh,
    whole as whole,
)
from ._sources import sources as sources
from ._space import before_after_3d as before_after_3d, cut as cut, surface as surface
from ._style import (
    BLUE as BLUE,
    COLOURS as COLOURS,
    DARK as DARK,
    GREEN as GREEN,
    GREY as GREY,
    ORANGE as ORANGE,
)

__dir__ = _listing(globals())
