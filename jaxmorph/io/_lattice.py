"""Lattices of control points for ParaView."""

import pathlib
from typing import Any

import numpy as np

from .._host.files import complete


def write_lattice(file: str | pathlib.Path, points: Any) -> None:
    """Writes a lattice of control points as a structured grid in VTK's XML, which ParaView opens.

    **Arguments:**

    - `file`: its name ends in `.vts`.
    - `points`: (i, j, 2) or (i, j, k, 3), as `FreeForm.lattice` gives them, before or after a motion.

    **Raises:** `ValueError` for another shape or another ending.
    """
    points, file = np.asarray(points, float), pathlib.Path(file)
    d = points.shape[-1]
    if d not in (2, 3) or points.ndim != d + 1:
        raise ValueError(f"a lattice has shape (i, j, 2) or (i, j, k, 3), not {points.shape}.")
    if file.suffix != ".vts":
        raise ValueError(f"{file.name}: a lattice is written to a file that ends in .vts.")
    counts = (*points.shape[:-1], 1)[:3]
    full = np.zeros((*points.shape[:-1], 3))
    full[..., :d] = points
    rows = full.reshape(*counts, 3).transpose(2, 1, 0, 3).reshape(-1, 3)  # VTK's first index runs fastest
    extent = " ".join(f"0 {count - 1}" for count in counts)
    text = "\n".join(" ".join(f"{value:.17g}" for value in row) for row in rows)
    content = (
        '<?xml version="1.0"?>\n<VTKFile type="StructuredGrid" version="0.1" byte_order="LittleEndian">\n'
        f'<StructuredGrid WholeExtent="{extent}">\n<Piece Extent="{extent}">\n<Points>\n'
        f'<DataArray type="Float64" NumberOfComponents="3" format="ascii">\n{text}\n</DataArray>\n'
        "</Points>\n</Piece>\n</StructuredGrid>\n</VTKFile>\n"
    )
    with complete(file) as partial:
        partial.write_text(content, encoding="utf-8")
