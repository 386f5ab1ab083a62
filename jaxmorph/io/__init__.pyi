"""Public names of `jaxmorph.io` and their homes, for type checkers and for the room as it runs."""

# isort: off
from ._boxes import Box as Box
from ._boxes import boxes as boxes
from ._boxes import read_box as read_box
from ._boxes import with_boxes as with_boxes
from ._boxes import write_lattice as write_lattice
from ._displacement import read_displacement as read_displacement
from ._displacement import read_facets as read_facets
from ._displacement import read_surface as read_surface
from ._registry import as_written as as_written
from ._registry import check_output as check_output
from ._registry import losses as losses
from ._registry import periodic as periodic
from ._registry import read as read
from ._registry import symmetry as symmetry
from ._registry import write as write
from ._registry import write_moved as write_moved
from ._registry import write_pvd as write_pvd
from ._sensitivity import read_sensitivity as read_sensitivity
from ._sensitivity import write_gradient as write_gradient
from ._sensitivity import write_sensitivity as write_sensitivity
from ._su2 import read_zones as read_zones
from ._su2 import write_zones as write_zones
from .openfoam.motion import patch_roles as patch_roles
from .openfoam.parts import Decomposed as Decomposed
from .openfoam.parts import export_case as export_case
from .openfoam.parts import global_nodes as global_nodes
