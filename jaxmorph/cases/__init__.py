"""Generated meshes: the paper's airfoil and its relatives, a wing, bricks, bodies in a box."""

from jaxmorph.extend import listing as _listing

from ._meshes import bodies as bodies
from ._meshes import bricks as bricks
from ._meshes import naca0015 as naca0015
from ._meshes import naca4 as naca4
from ._meshes import wing as wing

__dir__ = _listing(globals())
