"""Moved meshes in files: displacement and quality with the points, and ParaView's collections."""

import os
import pathlib
from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from jaxmorph import Mesh, QualityReport
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import complete, output_path

from ._registry import check_output, write


@checked
def cell_arrays(report: QualityReport) -> dict[str, np.ndarray]:
    """Lists each cell's quality by name, as files hold it: a number a cell, as in `mesh.cells`."""
    names = ("skewness", "aspect_ratio", "volume_ratio", "jacobian_ratio")
    arrays = {name: np.asarray(getattr(report, name)) for name in names}
    return arrays | {"is_inverted": np.asarray(report.is_inverted).astype(np.uint8)}


@checked
def write_moved(path: str | os.PathLike[str], mesh: Mesh, moved: Mesh, report: QualityReport) -> None:
    """Writes a moved mesh, with displacement and cell quality where the format holds arrays.

    **Arguments:**

    - `path`: the file; its ending chooses the format, as for `write`.
    - `mesh`, `moved`: the undeformed mesh and the moved one.
    - `report`: what `quality(mesh, moved.points)` gives.

    **Raises:** `ValueError` as `write` does.
    """
    path = pathlib.Path(path)
    if not check_output(path, mesh):
        write(path, moved)
        return
    before, after = np.asarray(mesh.points), np.asarray(moved.points)
    if before.shape != after.shape:
        raise ValueError(f"`moved` has points of shape {after.shape}, `mesh` {before.shape}. It must be `mesh`, moved.")
    write(path, moved, point_data={"displacement": after - before}, cell_data=cell_arrays(report))


@checked
def write_pvd(path: str | os.PathLike[str], files: Sequence[str | os.PathLike[str]], times: Sequence[float]) -> None:
    """Writes ParaView's collection (.pvd): each of `files`, by its name, at one of `times`."""
    path = output_path(path, ".pvd")
    if len(files) != len(times):
        raise ValueError(f"`times` has {len(times)} numbers for {len(files)} `files`.")
    rows = [
        f'    <DataSet timestep="{time!r}" part="0" file={quoteattr(pathlib.Path(file).name)}/>'
        for file, time in zip(files, times, strict=True)
    ]
    head = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">']
    text = "\n".join([*head, "  <Collection>", *rows, "  </Collection>", "</VTKFile>", ""])
    with complete(path) as partial:
        partial.write_bytes(text.encode())
