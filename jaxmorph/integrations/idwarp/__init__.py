"""IDWarp's mesh objects: their calls, by jaxmorph's methods (extras `mpi` and, for CGNS, `io`)."""

from ._mesh import USMesh as USMesh
from ._multi import MultiUSMesh as MultiUSMesh
