"""VTK's files of one mesh, XML and legacy (.vtk): VTK reads them apart, and writes them."""

import json
import os
import re
import tempfile
import urllib.parse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmorph._host.cells.topology import VTK_LAGRANGE
from jaxmorph._host.package.text import decoded
from jaxmorph._mesh import vtk
from jaxmorph._mesh.exchange import PREFIX, Parts
from jaxmorph._mesh.export import to_vtk

from ._apart import run_apart
from ._format import EVERYTHING, ArraysByName, FilePoints, MeshLike, Source, content_of

NAME = "VTK"

GRIDS = {".vtu": "vtkUnstructuredGrid", ".vts": "vtkStructuredGrid", ".vtp": "vtkPolyData"}
"""What each kind of XML file holds; a legacy file holds any of it."""

FILES_OF_FILES = (".pvtu", ".vtm")
"""Files that name pieces and blocks in other files."""

TOLD = re.compile(r"(?:ERROR|Warning): In .*\n(?:\w+ \(0x[0-9a-f]+\): )?((?:.+\n)+)")
"""An error or a warning of VTK, and its sentence."""


class Encoding(NamedTuple):
    """How a file is written: an XML file's mode (ascii, binary or appended, base64 or raw), its
    compressor, header and order of bytes; a legacy file's mode, title and version.
    """

    is_legacy: bool = False
    mode: str = "binary"
    is_raw: bool = False
    compressor: str = "ZLib"
    header_type: str = "UInt64"
    byte_order: str = "LittleEndian"
    title: str = "written by jaxmorph"
    version: str = "4.2"


class VTKContent(NamedTuple):
    data: Any
    encoding: Encoding

    @property
    def arrays(self) -> list[str]:
        fields = (self.data.GetPointData(), self.data.GetCellData(), self.data.GetFieldData())
        names = [
            str(field.GetArrayName(k)) for field in fields for k in range(field.GetNumberOfArrays())
        ]
        return [name for name in names if not name.startswith(PREFIX)]

    def __reduce__(self) -> tuple:
        vtk.vtk("util.pickle_support")  # teaches `pickle` VTK's data sets
        return type(self), (self.data, self.encoding)


def read(path: Path) -> Parts:
    content = _read_content(path)
    mesh = vtk.mesh_of(vtk.unstructured(content.data))
    places = vtk.coordinates(content.data)
    points = FilePoints(
        np.asarray(places, float), singles=EVERYTHING if places.dtype == np.float32 else ()
    )
    origin = mesh.source
    source = Source(
        path, NAME, content, origin.polyhedra, origin.cell_ids, notes=origin.notes, **points.known
    )
    return mesh._replace(source=source)


def check_ending(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix in FILES_OF_FILES:
        raise ValueError(
            f"{suffix} files name other files, and are not written; write .vtu, which holds all."
        )


def check(path: Path, mesh: MeshLike) -> None:
    suffix = path.suffix.lower()
    content = content_of(mesh, NAME)
    for kind in mesh.cells if content is None else ():
        vtk.number_of(kind)
    holds = GRIDS.get(suffix, "vtkDataSet")
    if suffix != ".vtu" and not (content.data.IsA(holds) if content else holds == "vtkDataSet"):
        raise ValueError(f"the cells of the mesh are not those of a {holds}; write .vtu.")


def write(path: Path, mesh: MeshLike, point_data: ArraysByName, cell_data: ArraysByName) -> None:
    """Writes what was read with other points, or a new grid in double precision."""
    content = content_of(mesh, NAME)
    is_legacy = path.suffix.lower() == ".vtk"
    parts = Parts(mesh.points, mesh.cells, mesh.patches, mesh.source)
    data = to_vtk(parts, content and content.data, point_data, cell_data)
    encoding = (
        content.encoding
        if content and content.encoding.is_legacy == is_legacy
        else Encoding(is_legacy)
    )
    path.write_bytes(
        file_bytes(vtk.unstructured(data) if path.suffix.lower() == ".vtu" else data, encoding)
    )


def file_bytes(data: Any, encoding: Encoding) -> bytes:
    """Makes the file. VTK itself tells no error where a device is full, so it writes to memory.

    VTK gives single precision six digits in a legacy text, and it needs nine. So the numbers come
    from a copy in double precision, and the lines that name types from the data themselves.
    """
    text = _text(data, encoding)
    if not encoding.is_legacy or encoding.mode != "ascii" or b" float" not in text:
        return text
    exact = _text(vtk.in_double(data), encoding).split(b"\n")
    lines = zip(text.split(b"\n"), exact, strict=True)
    return b"\n".join(own if b" float" in own else line for own, line in lines)


def _text(data: Any, encoding: Encoding) -> bytes:
    writer = (_legacy_writer if encoding.is_legacy else _xml_writer)(data, encoding)
    writer.SetInputData(data)
    writer.WriteToOutputStringOn()
    writer.Write()
    if writer.GetErrorCode():
        raise ValueError(f"VTK does not write this mesh ({writer.GetErrorCode()}).")
    text = (writer.GetOutputStdString if encoding.is_legacy else writer.GetOutputString)()
    return text.encode() if isinstance(text, str) else text


def _xml_writer(data: Any, encoding: Encoding) -> Any:
    writer = vtk.vtk("vtkIOXML").vtkXMLDataObjectWriter.NewWriter(data.GetDataObjectType())
    getattr(writer, f"SetDataModeTo{encoding.mode.capitalize()}")()
    writer.SetEncodeAppendedData(not encoding.is_raw)
    getattr(writer, f"SetCompressorTypeTo{encoding.compressor}")()
    getattr(writer, f"SetHeaderTypeTo{encoding.header_type}")()
    getattr(writer, f"SetByteOrderTo{encoding.byte_order}")()
    return writer


def _legacy_writer(data: Any, encoding: Encoding) -> Any:
    # a writer of any kind does not take the precision
    kind = data.GetClassName().removeprefix("vtk")
    writer = getattr(vtk.vtk("vtkIOLegacy"), f"vtk{kind}Writer")()
    writer.SetHeader(encoding.title)
    # before 5.1 files have another order of the nodes of hexahedra, in which VTK does not write
    is_new = encoding.version > "5" or VTK_LAGRANGE["hexahedron"] in vtk.numbers_of(
        vtk.unstructured(data)
    )
    writer.SetFileVersion(51 if is_new else 42)
    (writer.SetFileTypeToASCII if encoding.mode == "ascii" else writer.SetFileTypeToBinary)()
    writer.SetPrecision(17)
    return writer


def _encoding(raw: bytes) -> Encoding:
    legacy = re.match(rb"# vtk DataFile Version (\d\.\d)[^\n]*\n([^\r\n]*)\r?\n\s*(\w+)", raw)
    if legacy:
        version, title, mode = (decoded(word) for word in legacy.groups())
        return Encoding(True, mode.lower(), title=title, version=version)
    tag = re.search(rb"<VTKFile[^>]*>", raw)
    said = dict(re.findall(r'(\w+)="(\w+)"', decoded(tag[0]) if tag else ""))
    modes = {*re.findall(rb'format="(\w+)"', raw)}
    mode = next((mode for mode in ("appended", "binary") if mode.encode() in modes), "ascii")
    compressor = re.sub("^vtk|DataCompressor$", "", said.get("compressor", "None"))
    header = said.get("header_type", "UInt32")
    order = said.get("byte_order", "LittleEndian")
    return Encoding(False, mode, b'encoding="raw"' in raw, compressor, header, order)


def _read_content(path: Path) -> VTKContent:
    raw = path.read_bytes()
    named = []
    if path.suffix.lower() in FILES_OF_FILES:
        named = [
            path.parent / os.fsdecode(file)
            for file in re.findall(rb'(?:Source|file)="([^"]+)"', raw)
        ]
    size = len(raw) + sum(file.stat().st_size for file in named if file.is_file())
    data_sets = _read_apart(path, size)
    if named:
        return VTKContent(_join_grids(data_sets), Encoding())
    ((_, data),) = data_sets
    if not any(data.IsA(kind) for kind in GRIDS.values()):  # a lattice has no points that can move
        data = vtk.unstructured(data)
    return VTKContent(data, _encoding(raw))


def _read_apart(path: Path, size: int) -> list[tuple[str, Any]]:
    """Reads data sets and their names in another process, which a damaged file may end."""
    generic = vtk.vtk("vtkIOXML").vtkXMLGenericDataObjectReader
    with tempfile.TemporaryDirectory(prefix="jaxmorph-") as folder:
        names, said = json.loads(run_apart(path, size, folder))
        errors = [" ".join(sentence.split())[:200] for sentence in TOLD.findall(said)]
        if errors or not names:
            raise ValueError(
                f"a damaged file, or one cut short ({(errors or ['it holds nothing'])[0]})."
            )
        found = []
        for k, name in enumerate(names):
            reader = generic()
            reader.SetFileName(os.path.join(folder, f"{k}.xml"))
            reader.Update()
            found.append((name, reader.GetOutputDataObject(0)))
        return found


def _join_grids(named: list[tuple[str, Any]]) -> Any:
    """Joins pieces and blocks without ghost cells; blocks of lower dimension become patches."""
    grids = [(name, vtk.unstructured(data)) for name, data in named]
    levels = np.array([vtk.dimension_of(grid) for _, grid in grids])
    joined = vtk.vtk("vtkFiltersCore").vtkAppendFilter()
    is_solid = levels == levels.max()
    for at in np.flatnonzero(is_solid):
        joined.AddInputData(grids[at][1])
    joined.Update()
    whole = joined.GetOutput()
    whole.RemoveGhostCells()
    whole.GetFieldData().ShallowCopy(grids[is_solid.argmax()][1].GetFieldData())
    place = {point.tobytes(): k for k, point in enumerate(vtk.coordinates(whole))}
    for at in np.flatnonzero(~is_solid):
        name, grid = grids[at]
        nodes = [place.get(point.tobytes(), -1) for point in vtk.coordinates(grid)]
        if min(nodes, default=-1) >= 0:
            inside = np.isin(np.arange(whole.GetNumberOfPoints()), nodes).astype(np.uint8)
            vtk.add_arrays(whole.GetPointData(), {f"{PREFIX}{urllib.parse.quote(name)}": inside})
    return whole
