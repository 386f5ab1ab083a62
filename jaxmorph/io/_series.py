"""Time series for ParaView: XDMF, with all arrays in one file (.h5), and collections of files (.pvd)."""

import contextlib
import os
import pathlib
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from jaxmorph import Mesh, QualityReport
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import complete, named, output_path

from ._moved import cell_arrays, displacement_of

NUMBERS = {
    "line": (2, 2),
    "triangle": (4,),
    "quad": (5,),
    "tetra": (6,),
    "pyramid": (7,),
    "wedge": (8,),
    "hexahedron": (9,),
}
"""XDMF's number of each type; a line's also says how many nodes follow."""


MARGIN, OF_EACH = 1 << 20, 1 << 12
"""Bytes that are reserved beside the arrays: once, and for what HDF5 writes about each."""


class _Nothing(Exception):
    """Tells the temporary file that nothing is to take its place."""


class XDMFSeries:
    """Writes moved states of a mesh as a time series in XDMF: one file of arrays (.h5), and one that says what they are.

    It is a context, at whose end both files appear; without any step, or after an error, there are none.

    **Arguments:**

    - `path`: a file that ends in .xdmf; the arrays go beside it, in the file of the same name that ends in .h5.
    - `mesh`: the undeformed mesh.

    **Raises:** `ImportError` where h5py is missing, `ValueError` for another ending.
    """

    @checked
    def __init__(self, path: str | os.PathLike[str], mesh: Mesh):
        path = output_path(path, ".xdmf")
        try:
            import h5py
        except ImportError as error:
            raise ImportError("XDMF files need h5py: pip install 'jaxmorph[io]'") from error
        if not sum(map(len, mesh.cells.values())):
            raise ValueError(f"{path}: `mesh` has no cells; XDMF files hold meshes.")
        self.path, self.arrays = path, path.with_suffix(".h5")
        self._mesh, self._grids = mesh, []
        with named(self.arrays), contextlib.ExitStack() as stack:
            self._partial = stack.enter_context(complete(self.arrays, name_errors=False))
            self._reserved = MARGIN
            self._file: Any = stack.enter_context(h5py.File(self._partial, "w"))
            rows = [
                np.concatenate([np.tile(np.array(NUMBERS[kind], np.int32), (len(ids), 1)), ids], axis=1).ravel()
                for kind, ids in mesh.cells.items()
            ]
            self._topology = self._item("cells", np.concatenate(rows))
            self._stack = stack.pop_all()
        self._count = sum(map(len, mesh.cells.values()))

    def __enter__(self) -> "XDMFSeries":
        return self

    def __exit__(self, kind, error, trace) -> None:
        if kind is None and self._grids:
            with named(self.arrays), self._stack:
                self._file.flush()
                size = self._file.id.get_filesize()
                self._file.close()
                os.truncate(self._partial, size)
                with complete(self.path) as partial:
                    partial.write_bytes(self._text().encode())
            return
        with contextlib.suppress(_Nothing if error is None else Exception):  # the first error is the one to tell
            self._stack.__exit__(_Nothing, _Nothing(), None)

    @checked
    def add(self, time: float, moved: Mesh, report: QualityReport) -> None:
        """Adds the moved mesh at a time, with its displacement and the quality of each cell."""
        step = str(len(self._grids))
        displacement = _in_3d(displacement_of(self._mesh, moved))
        attributes = [self._attribute("displacement", f"{step}/displacement", displacement, "Node", "Vector")]
        for name, values in cell_arrays(report).items():
            attributes.append(self._attribute(name, f"{step}/{name}", values, "Cell", "Scalar"))
        points = self._item(f"{step}/points", _in_3d(np.asarray(moved.points)))
        topology = f'<Topology TopologyType="Mixed" NumberOfElements="{self._count}">{self._topology}</Topology>'
        body = [f'<Time Value="{time!r}"/>', topology, f'<Geometry GeometryType="XYZ">{points}</Geometry>', *attributes]
        self._grids.append("\n".join([f'<Grid Name="{step}" GridType="Uniform">', *body, "</Grid>"]))

    def _attribute(self, name: str, place: str, values: np.ndarray, centre: str, kind: str) -> str:
        item = self._item(place, values)
        return f'<Attribute Name="{name}" AttributeType="{kind}" Center="{centre}">{item}</Attribute>'

    def _item(self, place: str, values: np.ndarray) -> str:
        with named(self.arrays):
            self._reserve(values.nbytes)
            self._file.create_dataset(place, data=values)
        kind = {"f": "Float", "i": "Int", "u": "UChar"}[values.dtype.kind]
        size = " ".join(map(str, values.shape))
        where = f"{self.arrays.name}:/{place}"
        about = f'Format="HDF" NumberType="{kind}" Precision="{values.dtype.itemsize}" Dimensions="{size}"'
        return f"<DataItem {about}>{quoteattr(where)[1:-1]}</DataItem>"

    def _reserve(self, size: int) -> None:
        """Asks the system for room on the device before HDF5 writes: where that fails, HDF5 may end the process."""
        self._reserved += size + OF_EACH
        if hasattr(os, "posix_fallocate"):
            with self._partial.open("r+b") as file:
                os.posix_fallocate(file.fileno(), 0, self._reserved)

    def _text(self) -> str:
        series = '<Grid Name="series" GridType="Collection" CollectionType="Temporal">'
        head = ['<?xml version="1.0"?>', '<Xdmf Version="3.0">', "<Domain>", series]
        return "\n".join([*head, *self._grids, "</Grid>", "</Domain>", "</Xdmf>", ""])


def _in_3d(values: np.ndarray) -> np.ndarray:
    return np.pad(values.astype(float), ((0, 0), (0, 3 - values.shape[1])))


@checked
def write_pvd(path: str | os.PathLike[str], files: Sequence[str | os.PathLike[str]], times: Sequence[float]) -> None:
    """Writes ParaView's collection of files (.pvd), each of `files` at one of `times`, named as they stand in its folder."""
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
