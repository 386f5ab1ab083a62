"""Reads a file by VTK in a process of its own: `_vtk_apart.py FILE FOLDER BYTES`.

VTK trusts what a file says of itself. A damaged file may end the process, or ask for any memory. So
this script, which imports nothing of the package, reads the file within `BYTES` of memory. It
writes each data set into the folder, in VTK's XML, raw and uncompressed, and prints one line of
JSON: the names of the data sets, and what VTK said.
"""

import json
import pathlib
import re
import sys
from collections.abc import Iterator
from typing import Any

from vtkmodules import vtkCommonCore, vtkIOLegacy, vtkIOXML
from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet, vtkDataSet

HEAD = re.compile(rb"# vtk DataFile[^\n]*\n[^\n]*\n\s*\w+\s+DATASET\s+(\w+)", re.IGNORECASE)
KINDS = {name.upper().replace(" ", "_"): name.replace(" ", "") for name in ("Unstructured Grid", "Structured Grid")}
KINDS |= {"POLYDATA": "PolyData", "STRUCTURED_POINTS": "StructuredPoints", "RECTILINEAR_GRID": "RectilinearGrid"}

MESHIO = {b"int8": b"signed_char", b"int16": b"short", b"int32": b"int"}
"""Types that meshio writes into legacy files behind `vtktype`, and `vtktypeu`, and VTK's words."""


def main(path: pathlib.Path, folder: pathlib.Path, most: int) -> None:
    limit_memory(most)
    said = vtkCommonCore.vtkStringOutputWindow()
    vtkCommonCore.vtkOutputWindow.SetInstance(said)
    vtkCommonCore.vtkLogger.SetStderrVerbosity(vtkCommonCore.vtkLogger.VERBOSITY_OFF)
    names = []
    for name, data in data_sets(read(path)):
        write(folder / f"{len(names)}.xml", data)
        names.append(name)
    text = said.GetOutput()
    text = text if isinstance(text, str) else text.decode(errors="replace")  # it may quote bytes of the file
    print(json.dumps([names, text]))


def limit_memory(most: int) -> None:
    if sys.platform == "linux":
        import resource

        used = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (used + most, hard))


def read(path: pathlib.Path) -> Any:
    if path.suffix.lower() != ".vtk":
        reader = vtkIOXML.vtkXMLGenericDataObjectReader()
        reader.SetFileName(str(path))
    else:
        raw, head = path.read_bytes(), HEAD.match(path.read_bytes())
        if head is None:
            raise SystemExit("not a .vtk file; `# vtk DataFile Version` and three lines more are expected first")
        kind = head[1].decode(errors="replace").upper()
        if kind not in KINDS:
            raise SystemExit(f"{kind} in it is no mesh; read are {', '.join(KINDS)}")
        raw = re.sub(rb"(?<=\s)vtktype(u?)(int8|int16|int32)(?=\s)", own_type, raw)
        reader = getattr(vtkIOLegacy, f"vtk{KINDS[kind]}Reader")()
        for name in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields"):
            getattr(reader, f"ReadAll{name}On")()
        reader.ReadFromInputStringOn()
        reader.SetBinaryInputString(raw, len(raw))
    reader.Update()
    data = reader.GetOutputDataObject(0)
    if isinstance(data, vtkDataSet):
        check_counts(path.read_bytes(), data)
    return data


def check_counts(raw: bytes, data: Any) -> None:
    """Refuses more numbers, or fewer arrays, than announced: VTK says nothing of them."""
    fields = (data.GetPointData(), data.GetCellData(), data.GetFieldData())
    announced = sum(map(int, re.findall(rb"^FIELD \S+ (\d{1,9})\s", raw, re.MULTILINE)))
    found = sum(field.GetNumberOfArrays() for field in fields)
    if found < announced:
        raise SystemExit(f"{announced} arrays are announced, and {found} are found")
    counts = {rb"<Points>\s*<DataArray[^>]*": 3 * data.GetNumberOfPoints()}
    if data.IsA("vtkUnstructuredGrid"):
        sizes = [data.GetNumberOfCells()] * 2 + [data.GetCells().GetNumberOfConnectivityIds()]
        names = (b"types", b"offsets", b"connectivity")
        counts |= {rb'<DataArray[^>]*Name="%s"[^>]*' % name: size for name, size in zip(names, sizes, strict=True)}
    for start, count in counts.items():
        texts = [text for tag, text in re.findall(rb"(%s)>([^<]*)<" % start, raw) if b'"ascii"' in tag]
        words = [float(word) for text in texts for word in text.split()]  # a `ValueError` ends the script
        if texts and len(words) != count:
            raise SystemExit(f"{len(words)} numbers are found where there are {count}")


def own_type(found: re.Match[bytes]) -> bytes:
    name = MESHIO[found[2]]
    return b"unsigned_" + name.removeprefix(b"signed_") if found[1] else name


def data_sets(data: Any) -> Iterator[tuple[str, Any]]:
    if not isinstance(data, vtkCompositeDataSet):
        yield "", data
        return
    blocks, name = data.NewIterator(), vtkCompositeDataSet.NAME()
    while not blocks.IsDoneWithTraversal():
        about = blocks.GetCurrentMetaData() if blocks.HasCurrentMetaData() else None
        yield about.Get(name) if about and about.Has(name) else "", blocks.GetCurrentDataObject()
        blocks.GoToNextItem()


def write(path: pathlib.Path, data: Any) -> None:
    writer = vtkIOXML.vtkXMLDataObjectWriter.NewWriter(data.GetDataObjectType())
    if writer is None:
        raise SystemExit(f"{data.GetClassName()} is no mesh")
    writer.SetInputData(data)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToNone()
    writer.SetHeaderTypeToUInt64()
    writer.SetFileName(str(path))
    writer.Write()


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), int(sys.argv[3]))
