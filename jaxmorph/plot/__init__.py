"""Draws meshes: in 2-D with matplotlib, in 3-D with pyvista, off screen.

Plots take matplotlib's axes `ax` or pyvista's `plotter`, by default a new one, and return it.
`page` makes an interactive page of a surface in 3-D.
"""

from ._curves import convergence as convergence
from ._curves import histogram as histogram
from ._files import page as page
from ._picture import picture as picture
from ._plane import Window as Window
from ._plane import before_after as before_after
from ._plane import graph as graph
from ._plane import mesh as mesh
from ._plane import whole as whole
from ._sources import sources as sources
from ._sources import sources_3d as sources_3d
from ._space import before_after_3d as before_after_3d
from ._space import cut as cut
from ._space import surface as surface
from ._style import BLUE as BLUE
from ._style import COLOURS as COLOURS
from ._style import DARK as DARK
from ._style import GREEN as GREEN
from ._style import GREY as GREY
from ._style import ORANGE as ORANGE
