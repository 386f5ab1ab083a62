"""VTK's legacy files (.vtk): the sizes that a file announces are compared with its own, then VTK reads it."""

import dataclasses
import math
import re
from typing import Any

import numpy as np

from jaxmorph._host.cells.topology import VTK_LAGRANGE
from jaxmorph._mesh import vtk

from ..text.digits import parse

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
    rb"|(?:POINT|CELL)_DATA\s+(?P<rows>-?\d+)(?P<end>\s*\Z)?"
    rb"|FIELD\s+\S+\s+(?P<field>-?\d+)"
    rb"|(?:CELLS|VERTICES|LINES|POLYGONS|TRIANGLE_STRIPS)\s+(?P<cells>-?\d+\s+-?\d+)[^\n]*\n"
    rb"|DIMENSIONS\s+(?P<dimensions>-?\d+\s+-?\d+\s+-?\d+)"
    rb"|(?:POINTS|CELL_TYPES|[XYZ]_COORDINATES)\s+(?P<section>-?\d+)(?:[ \t]+(?P<points>\w+)[ \t\r]*\n)?)"
    rb"|(?<!\S)(?P<array>-?\d+\s+-?\d+)\s+(?P<type>(?:vtk|bit|unsigned_|signed_|char|short|int|long|float|double|string)\w*)[ \t\r]*\n",
    re.IGNORECASE,
)
"""All places where a file announces numbers, after which VTK asks for memory."""

COUNTS = ("scalars", "columns", "rows", "field", "cells", "dimensions", "section", "array")

WIDTHS = {
    name: np.dtype(code).itemsize
    for name, code in {
        **{b"signed_char": "i1", b"char": "i1", b"unsigned_char": "u1", b"short": "i2", b"unsigned_short": "u2"},
        **{b"int": "i4", b"unsigned_int": "u4", b"long": "l", b"unsigned_long": "L", b"float": "f4", b"double": "f8"},
        **{b"vtktypeint64": "i8", b"vtktypeuint64": "u8"},
    }.items()
}
"""Bytes of the numbers of VTK's types."""

LATTICE = 10**6
"""Points of a lattice without coordinates that a file of any size may have."""


@dataclasses.dataclass(frozen=True)
class Encoding:
    """How a file says a data set: its title, its version, in text or not."""

    kind: str = "UnstructuredGrid"
    title: str = "written by jaxmorph"
    version: str = "4.2"
    is_text: bool = False


def checked(raw: bytes) -> tuple[Encoding, None]:
    """Raises `ValueError` for sizes that do not fit to the file; tells its encoding."""
    head = HEAD.match(raw)
    if head is None:
        raise ValueError("not a .vtk file; `# vtk DataFile Version` and three lines more are expected first.")
    words = {name: value.decode(errors="replace") for name, value in head.groupdict().items()}
    kind = words["kind"].upper()
    if kind not in KINDS:
        raise ValueError(f"{kind} in it is no mesh; read are {', '.join(KINDS)}.")
    encoding = Encoding(KINDS[kind], words["title"].strip("\r"), words["version"], words["mode"].upper() == "ASCII")
    rows, section, limit = -1, "", 8 * len(raw)  # the smallest number is a bit
    for match in SIZES.finditer(raw, head.end()):
        told = " ".join(match[0].decode(errors="replace").split())
        name = next((name for name in COUNTS if match[name]), "")
        sizes = [int(word) for word in match[name].split()] if name else []
        rows = sizes[0] if name == "rows" else rows
        count = math.prod(sizes) * (max(rows, 1) if name in ("scalars", "columns") else 1)
        count = max(sizes) if name == "cells" else count
        if min(sizes, default=0) < 0 or count > limit + LATTICE * (name == "dimensions" and kind != "STRUCTURED_GRID"):
            raise ValueError(f"{told!r} announces {count} numbers, but the file has {len(raw)} bytes.")
        if name == "cells" and words["version"] < "5":
            _check_cells(raw, match.end(), *sizes, encoding.is_text)
        width = WIDTHS.get((match["points"] or match["type"] or b"").lower(), 0)
        if width and not encoding.is_text:
            end = match.end() + count * width * (3 if match["points"] and match[0][:1] in b"Pp" else 1)
            if raw[end : end + 1] not in (b"", b"\n", b"\r"):
                raise ValueError(f"{told!r} is not followed by as many numbers: a damaged file, or one cut short.")
        if match["end"] is not None or (name == "field" and section and rows < 0):
            raise ValueError(f"a damaged file, or one cut short, in the section that begins with {section or told!r}.")
        section = told if name in ("section", "cells", "rows") else section
    return encoding, None


def _check_cells(raw: bytes, start: int, count: int, size: int, is_text: bool) -> None:
    """Raises `ValueError` where `size` numbers are not `count` cells, each its number of nodes and these."""
    if is_text:
        word = re.compile(rb"[A-Z_a-z]").search(raw, start)
        numbers = parse(raw[start : word.start() if word else len(raw)], np.int64)[:size]
    else:
        numbers = (
            np.frombuffer(raw[start : start + 4 * size], ">i4") if start + 4 * size <= len(raw) else np.zeros(0, int)
        )
    if len(numbers) < size:
        raise ValueError(f"{len(numbers)} numbers in a section of cells, {size} announced.")
    # Cells of one size are gone through together: numbers of nodes stand at equal steps.
    at = found = 0
    block = 1
    while at < size:
        step = int(numbers[at]) + 1
        rows = numbers[at : at + block * step : step] if step > 0 else numbers[:0]
        same = len(rows) if (rows == step - 1).all() else int((rows != step - 1).argmax())
        if step < 1 or not same:
            raise ValueError(f"cell {found} has {step - 1} nodes.")
        at, found, block = at + same * step, found + same, 2 * block if same == block else 1
    if at != size or found != count:
        raise ValueError(f"{found} cells of {at} numbers, {count} of {size} are announced.")


MESHIO = {b"int8": b"signed_char", b"uint8": b"unsigned_char", b"int16": b"short", b"uint16": b"unsigned_short"}
MESHIO |= {b"int32": b"int", b"uint32": b"unsigned_int"}
"""Names of types that meshio writes, after `vtktype`, and VTK does not know."""


def reader(raw: bytes, encoding: Encoding) -> Any:
    new = getattr(vtk.vtk("vtkIOLegacy"), f"vtk{encoding.kind}Reader")()
    for name in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields"):
        getattr(new, f"ReadAll{name}On")()
    known = re.sub(rb"\bvtktype(u?int(?:8|16|32))\b", lambda match: MESHIO[match[1]], raw)
    if known != raw:
        new.ReadFromInputStringOn()
        new.SetBinaryInputString(known, len(known))
    return new


def written(data: Any, encoding: Encoding) -> bytes:
    """Makes the file. VTK itself tells no error where a device is full, so it writes to memory."""
    writer = vtk.vtk("vtkIOLegacy").vtkDataSetWriter()
    writer.SetInputData(data)
    writer.SetHeader(encoding.title)
    # before 5.1 files have another order of the nodes of hexahedra, in which VTK does not write
    is_new = encoding.version > "5" or VTK_LAGRANGE["hexahedron"] in vtk.numbers_of(vtk.unstructured(data))
    writer.SetFileVersion(51 if is_new else 42)
    (writer.SetFileTypeToASCII if encoding.is_text else writer.SetFileTypeToBinary)()
    writer.SetPrecision(17)
    writer.WriteToOutputStringOn()
    writer.Write()
    text = writer.GetOutputStdString()
    return text.encode() if isinstance(text, str) else text
