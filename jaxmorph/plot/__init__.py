"""Pictures of meshes: in the plane with matplotlib, in space with pyvista, off screen.

Plots in the plane take an axis (a new one where none is given) and give it back; those in space do so with a plotter.
"""

from ._plane import Window as Window
from ._plane import before_after as before_after
from ._plane import graph as graph
from ._plane import histogram as histogram
from ._plane import mesh as mesh
from ._plane import sources as sources
from ._space import cut as cut
from ._space import surface as surface
from ._style import BLUE as BLUE
from ._style import COLOURS as COLOURS
from ._style import DARK as DARK
from ._style import GREEN as GREEN
from ._style import GREY as GREY
from ._style import ORANGE as ORANGE
