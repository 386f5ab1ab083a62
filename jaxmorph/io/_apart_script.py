"""Reads a file by VTK, apart: `_apart_script.py FILE FOLDER BYTES`.

VTK trusts what a file says of itself. A damaged file may end the process, or ask for any memory. So
this script, which imports nothing of the package, reads the file within `BYTES` of memory, and puts
each data set into the folder in VTK's XML, raw and uncompressed. One line of JSON is printed: the
names of the data sets, and what VTK said.
"""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LEGACY_HEAD = re.compile(rb"# vtk DataFile[^\n]*\n[^\n]*\n\s*\w+\s+DATASET\s")

MESHIO_TYPES = {b"int8": b"signed_char", b"int16": b"short", b"int32": b"int"}
"""Types that meshio writes into legacy files behind `vtktype`, and `vtktypeu`, and VTK's words."""


def read_data_sets(file: str, where: str, most: str) -> None:
    from vtkmodules import vtkCommonCore

    path = Path(file)
    folder = Path(where)

    reader = make_reader(path, folder)
    names = []
    limit_memory(int(most))
    said = vtkCommonCore.vtkStringOutputWindow()
    vtkCommonCore.vtkOutputWindow.SetInstance(said)
    vtkCommonCore.vtkLogger.SetStderrVerbosity(vtkCommonCore.vtkLogger.VERBOSITY_OFF)
    reader.Update()
    for name, data in list_data_sets(reader.GetOutputDataObject(0)):
        if data.IsA("vtkDataSet") and path.suffix.lower() not in (".pvtu", ".vtm"):
            raw = path.read_bytes()
            check_counts(raw, data)
            check_numbers(raw, data)
        write_data(folder / f"{len(names)}.xml", data)
        names.append(name)
    text = said.GetOutput()
    # it may quote bytes of the file
    text = text if isinstance(text, str) else text.decode(errors="replace")
    print(json.dumps([names, text]))


def limit_memory(most: int) -> None:
    if sys.platform == "linux":
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (used + most, hard))


def make_reader(path: Path, folder: Path) -> Any:
    from vtkmodules import vtkIOLegacy, vtkIOXML

    with path.open("rb") as file:
        is_xml = file.read(4096).lstrip().startswith(b"<")
    if is_xml:
        reader = vtkIOXML.vtkXMLGenericDataObjectReader()
        reader.SetFileName(str(path))
        return reader
    raw = path.read_bytes()
    if not LEGACY_HEAD.match(raw):
        raise SystemExit(
            "not a .vtk file; `# vtk DataFile Version` and three lines more are expected first"
        )
    copy = folder / "copy.vtk"
    copy.write_bytes(re.sub(rb"(?<=\s)vtktype(u?)(int8|int16|int32)(?=\s)", name_type, raw))
    reader = vtkIOLegacy.vtkGenericDataObjectReader()
    for name in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields"):
        getattr(reader, f"ReadAll{name}On")()
    reader.SetFileName(str(copy))
    return reader


def check_counts(raw: bytes, data: Any) -> None:
    """Refuses fewer cells or arrays than announced: VTK says nothing of them."""
    fields = (data.GetPointData(), data.GetCellData(), data.GetFieldData())
    announced = sum(map(int, re.findall(rb"^FIELD \S+ (\d{1,9})\s", raw, re.MULTILINE)))
    found = sum(field.GetNumberOfArrays() for field in fields)
    if found < announced or re.search(rb"_DATA\s+\d+\s*\Z", raw[-99:]):
        raise SystemExit(f"{announced or 'some'} arrays are announced, and {found} are found")
    first = raw.find(b"\nFIELD")
    points = raw.find(b"\nPOINTS ")
    if 0 <= points < first and b"_DATA" not in raw[points:first]:
        raise SystemExit("a field of arrays, but neither POINT_DATA nor CELL_DATA before it")
    if data.GetNumberOfCells() < 1:
        raise SystemExit("no cells, the file is cut short, or damaged")


def check_numbers(raw: bytes, data: Any) -> None:
    """Refuses more or fewer numbers in a text than its arrays have."""
    counts = {rb"<Points>\s*<DataArray[^>]*": 3 * data.GetNumberOfPoints()}
    if data.IsA("vtkUnstructuredGrid"):
        sizes = {b"types": data.GetNumberOfCells(), b"offsets": data.GetNumberOfCells()}
        sizes[b"connectivity"] = data.GetCells().GetNumberOfConnectivityIds()
        counts |= {rb'<DataArray[^>]*Name="%s"[^>]*' % name: size for name, size in sizes.items()}
    for start, count in counts.items():
        texts = [
            text for tag, text in re.findall(rb"(%s)>([^<]*)<" % start, raw) if b'"ascii"' in tag
        ]
        words = [float(word) for word in b" ".join(texts).split()]  # a `ValueError` ends the script
        if texts and len(words) != count:
            raise SystemExit(f"{len(words)} numbers are found where there are {count}")


def name_type(found: re.Match[bytes]) -> bytes:
    name = MESHIO_TYPES[found[2]]
    return b"unsigned_" + name.removeprefix(b"signed_") if found[1] else name


def list_data_sets(data: Any) -> Iterator[tuple[str, Any]]:
    from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet

    if not isinstance(data, vtkCompositeDataSet):
        yield "", data
        return
    blocks = data.NewIterator()
    name = vtkCompositeDataSet.NAME()
    while not blocks.IsDoneWithTraversal():
        about = blocks.GetCurrentMetaData() if blocks.HasCurrentMetaData() else None
        yield about.Get(name) if about and about.Has(name) else "", blocks.GetCurrentDataObject()
        blocks.GoToNextItem()


def write_data(path: Path, data: Any) -> None:
    from vtkmodules import vtkIOXML

    if not data.IsA("vtkDataSet"):
        raise SystemExit(f"{data.GetClassName()} is no mesh")
    writer = vtkIOXML.vtkXMLDataObjectWriter.NewWriter(data.GetDataObjectType())
    writer.SetInputData(data)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    writer.SetCompressorTypeToNone()
    writer.SetHeaderTypeToUInt64()
    writer.SetFileName(str(path))
    writer.Write()


if __name__ == "__main__":
    read_data_sets(*sys.argv[1:])
