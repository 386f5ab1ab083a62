"""VTK's legacy files (.vtk): the sizes that a file announces are compared with its own, then VTK reads it."""

import dataclasses
import math
import re
from typing import Any

from jaxmorph._mesh.vtk import vtk

HEAD = re.compile(
    rb"# vtk DataFile Version (?P<version>\d\.\d)[^\n]*\n(?P<title>[^\n]*)\n\s*(?P<mode>ASCII|BINARY)\s+DATASET\s+(?P<kind>\w+)",
    re.IGNORECASE,
)

KINDS = {
    **{"UNSTRUCTURED_GRID": "UnstructuredGrid", "STRUCTURED_GRID": "StructuredGrid", "POLYDATA": "PolyData"},
    **{"STRUCTURED_POINTS": "StructuredPoints", "RECTILINEAR_GRID": "RectilinearGrid"},
}

SIZES = re.compile(
    rb"\b(?:SCALARS\s+\S+\s+\w+(?:\s+(?P<scalars>-?\d+))?\s+LOOKUP_TABLE\s+\S+"
    rb"|(?:COLOR_SCALARS|TEXTURE_COORDINATES|LOOKUP_TABLE)\s+\S+\s+(?P<columns>-?\d+)"
    rb"|(?:POINT|CELL)_DATA\s+(?P<rows>-?\d+)"
    rb"|DIMENSIONS\s+(?P<dimensions>-?\d+\s+-?\d+\s+-?\d+)"
    rb"|(?:POINTS|CELLS|CELL_TYPES|VERTICES|LINES|POLYGONS|TRIANGLE_STRIPS|[XYZ]_COORDINATES|FIELD\s+\S+)"
    rb"\s+(?P<section>-?\d+(?:\s+-?\d+)?))"
    rb"|(?<!\S)(?P<array>-?\d+\s+-?\d+)\s+(?:vtk|bit|unsigned_|signed_|char|short|int|long|float|double|string)",
    re.IGNORECASE,
)
"""All places where a file announces numbers, after which VTK asks for memory."""

LATTICE = 10**6
"""Points of a lattice without coordinates that a file of any size may have."""


@dataclasses.dataclass(frozen=True)
class Encoding:
    """How a file says a data set: its title, its version, in text or not."""

    kind: str = "UnstructuredGrid"
    title: str = "written by jaxmorph"
    version: str = "4.2"
    is_text: bool = False


def checked(raw: bytes) -> Encoding:
    """Raises `ValueError` for sizes larger than the file itself; tells its encoding."""
    head = HEAD.match(raw)
    if head is None:
        raise ValueError("not a .vtk file; `# vtk DataFile Version` and three lines more are expected first.")
    words = {name: value.decode(errors="replace") for name, value in head.groupdict().items()}
    kind = words["kind"].upper()
    if kind not in KINDS:
        raise ValueError(f"{kind} in it is no mesh; read are {', '.join(KINDS)}.")
    limit, rows = 8 * len(raw), 1  # a bit is the smallest number
    for match in SIZES.finditer(raw):
        name = str(match.lastgroup)
        sizes = [int(word) for word in (match[name] or b"").split()] if match.lastgroup else []
        rows = sizes[0] if name == "rows" else rows
        count = math.prod(sizes) * (rows if name in ("scalars", "columns") else 1)
        count = max(sizes) if name == "section" else count
        is_lattice = name == "dimensions" and kind not in ("STRUCTURED_GRID",)
        if min(sizes, default=0) < 0 or count > (LATTICE if is_lattice else 0) + limit:
            told = " ".join(match[0].decode(errors="replace").split())
            raise ValueError(f"{told!r} announces {count} numbers, but the file has {len(raw)} bytes.")
    return Encoding(KINDS[kind], words["title"].strip("\r"), words["version"], words["mode"].upper() == "ASCII")


def reader(encoding: Encoding) -> Any:
    new = getattr(vtk("vtkIOLegacy"), f"vtk{encoding.kind}Reader")()
    for name in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields"):
        getattr(new, f"ReadAll{name}On")()
    return new


def written(data: Any, encoding: Encoding) -> bytes:
    """Makes the file. VTK itself tells no error where a device is full, so it writes to memory."""
    writer = vtk("vtkIOLegacy").vtkDataSetWriter()
    writer.SetInputData(data)
    writer.SetHeader(encoding.title)
    writer.SetFileVersion(42 if encoding.version < "5" else 51)
    (writer.SetFileTypeToASCII if encoding.is_text else writer.SetFileTypeToBinary)()
    writer.SetPrecision(17)
    writer.WriteToOutputStringOn()
    writer.Write()
    text = writer.GetOutputStdString()
    return text.encode() if isinstance(text, str) else text
