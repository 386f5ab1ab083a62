"""Reading by meshio, for the formats that stand on it."""

try:
    import meshio
except ImportError as error:
    raise ImportError("this file format needs meshio: pip install 'jaxmorph[io]'") from error

import contextlib
import io
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxmorph._mesh import exchange, export
from jaxmorph._mesh.exchange import Parts

from ._format import Arrays, MeshLike, Source, faults_of, of_grid

for _kind in ("pyramid13", "wedge15"):  # types that meshio reads and writes, and whose dimension it lacks
    meshio._mesh.topological_dimension.setdefault(_kind, 3)


def load(path: pathlib.Path, name: str, reader: Callable[[str], Any]) -> meshio.Mesh:
    """Reads a file by `reader`, without prints; each way in which it fails is a `ValueError`."""
    path.open("rb").close()
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            mesh = reader(str(path))
    except (Exception, SystemExit) as error:
        detail = " ".join(f"{error or output.getvalue()}".split())[:120]
        reason = f"{type(error).__name__}: {detail}" if detail else "meshio gives no reason"
        message = f"{path}: not a {name} file, or a damaged one ({reason})."
        raise ValueError(message) from error
    printed = " ".join(output.getvalue().split())
    if "cannot handle" in printed:  # meshio leaves such cells out
        raise ValueError(f"{path}: {printed[printed.find('File contains') :]} They would be lost.")
    cells = sum(len(np.asarray(block.data)) for block in mesh.cells)
    if len(mesh.points) == 0 or cells == 0:
        raise ValueError(f"{path}: no mesh, the file holds {len(mesh.points)} points and {cells} cells.")
    return mesh


def to_mesh(path: pathlib.Path, mesh: Any, source: Source) -> Parts:
    """Makes a mesh as `Mesh.from_meshio` does; errors name the file."""
    with faults_of(path):
        grid = exchange.of_meshio(mesh)
    return of_grid(path, grid, source)


def of_mesh(mesh: MeshLike, point_data: Arrays | None = None, cell_data: Arrays | None = None) -> meshio.Mesh:
    """Makes meshio's mesh as `Mesh.to_meshio` does."""
    return export.to_meshio(Parts(mesh.points, mesh.cells, mesh.patches, mesh.source), point_data, cell_data)
