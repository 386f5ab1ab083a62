"""Generated meshes: published cases, and one for each fault that walls provoke."""

from ._agard445 import agard445 as agard445
from ._agard445 import agard445_mode as agard445_mode
from ._bricks import bricks as bricks
from ._bricks import wing as wing
from ._gaps import blade_tip as blade_tip
from ._gaps import bodies as bodies
from ._gaps import valve as valve
from ._naca import naca0015 as naca0015
from ._naca import naca4 as naca4
from ._o_grid import sharp_o_grid as sharp_o_grid
from ._passages import cascade as cascade
from ._passages import channel as channel
