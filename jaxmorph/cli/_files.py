"""Files that the command line writes, completely or not at all."""

import pathlib

import numpy as np

import jaxmorph as jm
from jaxmorph import Mesh, io
from jaxmorph._host.files import complete


def save(path: pathlib.Path, content: bytes) -> None:
    """Writes a file under a temporary name, and renames it at the end. Raises `OSError` where it cannot be written."""
    with complete(path) as partial:
        partial.write_bytes(content)


def write_moved(path: pathlib.Path, mesh: Mesh, moved: Mesh, after: jm.QualityReport) -> None:
    """Writes a moved mesh, with displacement and quality of cells if the format holds arrays."""
    if not io.check_output(path, mesh):
        io.write(path, moved)
        return
    displacement = np.asarray(moved.points) - np.asarray(mesh.points)
    io.write(path, moved, point_data={"displacement": displacement}, cell_data=cell_arrays(after))


def cell_arrays(report: jm.QualityReport) -> dict[str, np.ndarray]:
    """Lists the quality of each cell as arrays by name."""
    names = ("skewness", "aspect_ratio", "volume_ratio", "jacobian_ratio")
    arrays = {name: np.asarray(getattr(report, name)) for name in names}
    return arrays | {"is_inverted": np.asarray(report.is_inverted).astype(np.uint8)}
