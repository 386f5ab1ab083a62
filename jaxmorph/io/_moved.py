"""A moved mesh, with what became of it."""

import os
import pathlib

import numpy as np

from jaxmorph import Mesh, QualityReport
from jaxmorph._host.package.arguments import checked

from ._registry import check_output, write


def displacement_of(mesh: Mesh, moved: Mesh) -> np.ndarray:
    """Computes how far the points (n, d) of a mesh went; raises `ValueError` for meshes of other numbers of points."""
    before, after = np.asarray(mesh.points), np.asarray(moved.points)
    if before.shape != after.shape:
        raise ValueError(f"`moved` has points of shape {after.shape}, `mesh` {before.shape}: not the same mesh, moved.")
    return after - before


@checked
def cell_arrays(report: QualityReport) -> dict[str, np.ndarray]:
    """Lists the quality of each cell by name, as files hold it: one number a cell, in the order of `mesh.cells`."""
    names = ("skewness", "aspect_ratio", "volume_ratio", "jacobian_ratio")
    arrays = {name: np.asarray(getattr(report, name)) for name in names}
    return arrays | {"is_inverted": np.asarray(report.is_inverted).astype(np.uint8)}


@checked
def write_moved(path: str | os.PathLike[str], mesh: Mesh, moved: Mesh, report: QualityReport) -> None:
    """Writes a moved mesh, with the displacement and the quality of each cell where the format holds arrays.

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
    displacement = displacement_of(mesh, moved)
    write(path, moved, point_data={"displacement": displacement}, cell_data=cell_arrays(report))
