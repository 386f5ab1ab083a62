"""VTK's unstructured grids, XML (.vtu) and legacy (.vtk), through meshio."""

import pathlib

from jaxmorph import Mesh

from ._format import Arrays, Source
from ._meshio import load, meshio, to_mesh

NAME = "VTK"


def read(path: pathlib.Path) -> Mesh:
    """Reads points, cells and patches as `Mesh.from_meshio` finds them.

    Patches are point arrays `patch:NAME`, as `write` leaves them, or come from numbers.
    """
    reader = meshio.vtu.read if path.suffix.lower() == ".vtu" else meshio.vtk.read
    mesh = load(path, path.suffix.lower(), reader)
    if reader is meshio.vtk.read:
        last = path.read_bytes().rstrip().rpartition(b"\n")[2]
        if last.startswith((b"POINT_DATA", b"CELL_DATA", b"FIELD")):
            raise ValueError(f"{path}: the file ends after {last.decode()!r}: it is cut short.")
    return to_mesh(path, mesh, Source(path, NAME, mesh))


def write(path: pathlib.Path, mesh: Mesh, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes in double precision, compressed. A mesh that came from such a file keeps its other cells and arrays."""
    out = mesh.to_meshio(point_data=dict(point_data), cell_data=dict(cell_data))
    (meshio.vtu.write if path.suffix.lower() == ".vtu" else meshio.vtk.write)(str(path), out)
