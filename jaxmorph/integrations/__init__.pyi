"""The submodules, for type checkers and for `__getattr__`."""

from . import idwarp as idwarp
from . import mphys as mphys
from . import mpi as mpi
from . import openmdao as openmdao
from . import su2 as su2
