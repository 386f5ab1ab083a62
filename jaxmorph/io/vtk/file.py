"""VTK's files of one mesh, XML and legacy (.vtk), read and written by VTK."""

import dataclasses
import pathlib
import urllib.parse
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxmorph._mesh import vtk
from jaxmorph._mesh.exchange import PREFIX, Parts
from jaxmorph._mesh.export import to_vtk

from .._format import EVERYTHING, Arrays, FilePoints, MeshLike, Source, content_of, faults_of
from . import legacy, xml
from .checks import errors_told

NAME = "VTK"

GRIDS = {".vtu": "vtkUnstructuredGrid", ".vts": "vtkStructuredGrid", ".vtp": "vtkPolyData"}
"""What each kind of XML file holds; a legacy file holds any of it."""

FILES_OF_FILES = (".pvtu", ".vtm")
"""Files that name pieces and blocks in other files."""


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    data: Any
    encoding: Any

    def __reduce__(self) -> tuple:
        vtk.vtk("util.pickle_support")  # teaches `pickle` VTK's data sets
        return type(self), (self.data, self.encoding)


def read(path: pathlib.Path) -> Parts:
    with faults_of(path):
        content = _read(path)
        mesh = vtk.mesh_of(vtk.unstructured(content.data))
    places = vtk.coordinates(content.data)
    points = FilePoints(np.asarray(places, float), singles=EVERYTHING if places.dtype == np.float32 else ())
    origin = mesh.source
    source = Source(path, NAME, content, origin.polyhedra, origin.cell_ids, notes=origin.notes, **points.known)
    return mesh._replace(source=source)


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    suffix = path.suffix.lower()
    content = content_of(mesh, NAME)
    if suffix in FILES_OF_FILES:
        raise ValueError(f"{path}: {suffix} files name other files, and are not written; write .vtu, which holds all.")
    try:
        for kind in mesh.cells if content is None else ():
            vtk.number_of(kind)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    holds = GRIDS.get(suffix, "vtkDataSet")
    if suffix != ".vtu" and not (content.data.IsA(holds) if content else holds == "vtkDataSet"):
        raise ValueError(f"{path}: the cells of the mesh are not those of a {holds}; write .vtu.")


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes what was read with other points, or a new grid in double precision.

    The file is encoded as the one that was read, where that was of the same kind.
    """
    content = content_of(mesh, NAME)
    parts = Parts(mesh.points, mesh.cells, mesh.patches, mesh.source)
    data = to_vtk(parts, content and content.data, point_data, cell_data)
    suffix = path.suffix.lower()
    kind: Any = legacy if suffix == ".vtk" else xml
    encoding = content.encoding if content and isinstance(content.encoding, kind.Encoding) else kind.Encoding()
    with errors_told():
        path.write_bytes(text_of(kind.writer, vtk.unstructured(data) if suffix == ".vtu" else data, encoding))


def text_of(make: Callable[..., Any], data: Any, encoding: Any) -> bytes:
    """Makes the file. VTK itself tells no error where a device is full, so it writes to memory."""
    writer = make(data, encoding)
    writer.SetInputData(data)
    writer.WriteToOutputStringOn()
    writer.Write()
    text = (writer.GetOutputStdString if hasattr(writer, "GetOutputStdString") else writer.GetOutputString)()
    return text.encode() if isinstance(text, str) else text


def _read(path: pathlib.Path) -> Content:
    if path.suffix.lower() in FILES_OF_FILES:
        named = xml.named_files(path)
        parts = [_data(file) for _, file in named]
        return Content(_joined([(name, data) for (name, _), (data, _) in zip(named, parts, strict=True)]), parts[0][1])
    data, encoding = _data(path)
    if not any(data.IsA(kind) for kind in GRIDS.values()):  # a lattice has no points that can move
        data = vtk.unstructured(data)
    return Content(data, encoding)


def _data(path: pathlib.Path) -> tuple[Any, Any]:
    kind: Any = legacy if path.suffix.lower() == ".vtk" else xml
    with errors_told():
        raw, encoding = kind.checked(path.read_bytes())
        reader = kind.reader(path, raw, encoding)
        reader.Update()
    return reader.GetOutput(), encoding


def _joined(named: list[tuple[str, Any]]) -> Any:
    """Joins pieces and blocks without ghost cells; blocks of lower dimension become patches."""
    grids = [(name, vtk.unstructured(data)) for name, data in named]
    levels = [vtk.dimension_of(grid) for _, grid in grids]
    joined = vtk.vtk("vtkFiltersCore").vtkAppendFilter()
    for level, (_, grid) in zip(levels, grids, strict=True):
        if level == max(levels):
            joined.AddInputData(grid)
    joined.Update()
    whole = joined.GetOutput()
    whole.RemoveGhostCells()
    whole.GetFieldData().ShallowCopy(grids[levels.index(max(levels))][1].GetFieldData())
    place = {point.tobytes(): k for k, point in enumerate(vtk.coordinates(whole))}
    for level, (name, grid) in zip(levels, grids, strict=True):
        nodes = [place.get(point.tobytes(), -1) for point in vtk.coordinates(grid)] if level < max(levels) else []
        if nodes and min(nodes) >= 0:
            inside = np.zeros(whole.GetNumberOfPoints(), np.uint8)
            inside[nodes] = 1
            vtk.add_arrays(whole.GetPointData(), {f"{PREFIX}{urllib.parse.quote(name)}": inside})
    return whole
