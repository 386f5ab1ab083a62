"""Lattices of control points for ParaView."""

import os
import pathlib
from typing import Any

import numpy as np

from .._host.package.arguments import checked, finite_array
from .._host.package.files import complete, output_path
from .._host.package.text import LATTICES
from .._mesh.exchange import imported


@checked
def write_lattice(file: str | os.PathLike[str], points: Any) -> None:
    """Writes a lattice of control points as a structured grid in VTK's XML, which ParaView opens.

    **Arguments:**

    - `file`: its name ends in `.vts`.
    - `points`: (i, j, 2) or (i, j, k, 3), as `FreeForm.lattice` gives them, before or after a
      motion.

    **Raises:** `ValueError` for another shape or another ending, `ImportError` without pyvista.
    """
    path, points = check_lattice_output(file), finite_array("points", points, (None, None, 2), (None, None, None, 3))
    d = points.shape[-1]
    full = np.zeros((*points.shape[:-1], *(1,) * (3 - d), 3))
    full[..., :d] = points.reshape(*full.shape[:-1], d)
    content = _text(imported("pyvista", "plot").StructuredGrid(*np.moveaxis(full, -1, 0)))
    with complete(path) as partial:
        partial.write_bytes(content)


def _text(grid: Any) -> bytes:
    """Returns the file as VTK writes it.

    VTK itself raises no error where the device is full.
    """
    from vtkmodules.vtkIOXML import vtkXMLStructuredGridWriter

    writer = vtkXMLStructuredGridWriter()
    writer.SetInputData(grid)
    writer.WriteToOutputStringOn()
    writer.Write()
    return writer.GetOutputString().encode()


@checked
def check_lattice_output(file: str | os.PathLike[str]) -> pathlib.Path:
    """Raises `ValueError` or `ImportError` where `write_lattice` cannot write; returns the path."""
    path = output_path(file, *LATTICES)
    imported("pyvista", "plot")
    return path
