"""VTK's unstructured grids, XML (.vtu) and legacy (.vtk), through meshio."""

import pathlib
import urllib.parse

import numpy as np

from jaxmorph import Mesh

from ._format import Arrays, Source, source_of
from ._meshio import PREFIX, MeshioMesh, in_space, load, meshio, set_patches, split_cell_data, to_mesh

NAME = "VTK"


def read(path: pathlib.Path) -> Mesh:
    """`patches` from point arrays `patch:NAME` that are not zero at the nodes of the patch, as `write` leaves them."""
    reader = meshio.vtu.read if path.suffix.lower() == ".vtu" else meshio.vtk.read
    found = load(path, path.suffix.lower(), reader)
    patches = set_patches(found)
    for name, values in found.point_data.items():
        if name.startswith(PREFIX) and np.ndim(values) == 1:
            patches[urllib.parse.unquote(name.removeprefix(PREFIX))] = np.flatnonzero(values)
    return to_mesh(path, found, patches, Source(path, NAME, found))


def write(path: pathlib.Path, mesh: Mesh, point_data: Arrays, cell_data: Arrays) -> None:
    """Double precision, compressed. A mesh that came from such a file keeps its other cells and arrays."""
    source = source_of(mesh, NAME)
    points = in_space(np.asarray(mesh.points)).astype(float)
    arrays = {name: in_space(values) for name, values in point_data.items()}
    for name, nodes in mesh.patches.items():
        inside = np.zeros(len(points), np.uint8)
        inside[nodes] = 1
        arrays[f"{PREFIX}{urllib.parse.quote(name)}"] = inside
    if source is None:
        out = MeshioMesh(points, [(kind, np.asarray(corners)) for kind, corners in mesh.cells.items()])
    else:
        old: MeshioMesh = source.content
        if mesh.points.shape[1] == 2:
            points[:, 2] = old.points[0, 2] if old.points.shape[1] == 3 else 0
        out = MeshioMesh(points, old.cells, dict(old.point_data), dict(old.cell_data), field_data=old.field_data)
    out.point_data.update(arrays)
    out.cell_data.update(split_cell_data(out.cells, mesh, cell_data))
    (meshio.vtu.write if path.suffix.lower() == ".vtu" else meshio.vtk.write)(str(path), out)
