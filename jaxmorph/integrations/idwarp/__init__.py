"""IDWarp's mesh objects: their calls, by jaxmorph's methods (extras `mpi` and, for CGNS, `io`)."""

from jaxmorph.extend import listing as _listing

from ._mesh import USMesh as USMesh
from ._mesh import USMesh_C as USMesh_C
from ._multi import MultiUSMesh as MultiUSMesh
from ._multi import MultiUSMesh_C as MultiUSMesh_C

__dir__ = _listing(globals())
