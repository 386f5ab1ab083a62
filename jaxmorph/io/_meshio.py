"""What the formats read by meshio have in common."""

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

from jaxmorph import Mesh


def load(path: pathlib.Path, name: str, reader: Callable[[str], Any]) -> meshio.Mesh:
    """What `reader` reads. Whatever way it fails on a file it cannot read is a `ValueError` here; it prints nothing."""
    path.open("rb").close()
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            found = reader(str(path))
    except (Exception, SystemExit) as error:
        detail = " ".join(f"{error or said.getvalue()}".split())[:120]
        message = f"{path}: not a {name} file, or a damaged one ({type(error).__name__}{detail and ': '}{detail})."
        raise ValueError(message) from error
    cells = sum(len(np.asarray(block.data)) for block in found.cells)
    if len(found.points) == 0 or cells == 0:
        raise ValueError(f"{path}: no mesh, the file holds {len(found.points)} points and {cells} cells.")
    return found


def to_mesh(path: pathlib.Path, found: Any, source: Any) -> Mesh:
    """`Mesh.from_meshio`, whose errors name the file."""
    try:
        mesh = Mesh.from_meshio(found)
        return Mesh(mesh.points, mesh.cells, mesh.patches, source=source)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
