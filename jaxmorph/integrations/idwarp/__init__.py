"""IDWarp's mesh objects: their calls, by jaxmorph's methods (extras `mpi` and, for CGNS, `io`)."""

from ._complex import MultiUSMesh_C as MultiUSMesh_C
from ._complex import USMesh_C as USMesh_C
from ._mesh import USMesh as USMesh
from ._multi import MultiUSMesh as MultiUSMesh
