"""Reading by meshio, for the formats that stand on it."""

try:
    import meshio
except ImportError as error:
    raise ImportError("this file format needs meshio: pip install 'jaxmorph[io]'") from error

from jaxmorph._mesh import export
from jaxmorph._mesh.exchange import Parts

from ._format import Arrays, MeshLike

for _kind in ("pyramid13", "wedge15"):  # types that meshio reads and writes, and whose dimension it lacks
    meshio._mesh.topological_dimension.setdefault(_kind, 3)


def of_mesh(mesh: MeshLike, point_data: Arrays | None = None, cell_data: Arrays | None = None) -> meshio.Mesh:
    """Makes meshio's mesh as `Mesh.to_meshio` does."""
    return export.to_meshio(Parts(mesh.points, mesh.cells, mesh.patches, mesh.source), point_data, cell_data)
