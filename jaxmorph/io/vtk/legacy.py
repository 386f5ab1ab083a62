"""VTK's legacy files (.vtk): the sizes that a file announces are compared with its own, then VTK reads it."""

import dataclasses
import math
import re
from typing import Any

import numpy as np

from jaxmorph._host.cells.topology import VTK_LAGRANGE
from jaxmorph._mesh import vtk

from ..text.digits import parse
from ..text.sections import scan
from .announced import Announced

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
    rb"|FIELD\s+\S+\s+(?P<field>-?\d+)[^\n]*\n"
    rb"|(?:CELLS|VERTICES|LINES|POLYGONS|TRIANGLE_STRIPS)\s+(?P<cells>-?\d+\s+-?\d+)[^\n]*\n"
    rb"|DIMENSIONS\s+(?P<dimensions>-?\d+\s+-?\d+\s+-?\d+)"
    rb"|POINTS\s+(?P<points>-?\d+)(?:[ \t]+(?P<type>\w+)[ \t\r]*\n)?"
    rb"|(?:CELL_TYPES|[XYZ]_COORDINATES)\s+(?P<section>-?\d+))",
    re.IGNORECASE,
)
"""All places where a file announces numbers, after which VTK asks for memory."""

COUNTS = ("scalars", "columns", "rows", "field", "cells", "dimensions", "points", "section")

ARRAY = re.compile(
    rb"\s*(?:METADATA[ \t\r]*\n(?:[^\n]*\S[^\n]*\n)*\s*)?"
    rb"(?:(?P<none>NULL_ARRAY)|\S+[ \t]+(?P<columns>\d+)[ \t]+(?P<rows>\d+)[ \t]+(?P<type>\w+))[ \t\r]*(?:\n|\Z)"
)
"""The line before an array of a field, and the notes on the array before it."""

TYPES = {
    **{b"signed_char": "i1", b"char": "i1", b"unsigned_char": "u1", b"short": "i2", b"unsigned_short": "u2"},
    **{b"int": "i4", b"unsigned_int": "u4", b"vtkidtype": "i4", b"long": "l", b"unsigned_long": "L"},
    **{b"long_long": "i8", b"unsigned_long_long": "u8", b"float": "f4", b"double": "f8", b"bit": "u1"},
    **{
        b"vtktype%s%d" % (sign, 8 * size): f"{code}{size}"
        for sign, code in ((b"int", "i"), (b"uint", "u"))
        for size in (1, 2, 4, 8)
    },
}

LATTICE = 10**6
"""Points of a lattice without coordinates that a file of any size may have."""


@dataclasses.dataclass(frozen=True)
class Encoding:
    """How a file says a data set: its title, its version, in text or not."""

    kind: str = "UnstructuredGrid"
    title: str = "written by jaxmorph"
    version: str = "4.2"
    is_text: bool = False


def checked(raw: bytes) -> tuple[Encoding, Announced]:
    """Raises `ValueError` for sizes that do not fit to the file; tells its encoding."""
    head = HEAD.match(raw)
    if head is None:
        raise ValueError("not a .vtk file; `# vtk DataFile Version` and three lines more are expected first.")
    words = {name: value.decode(errors="replace") for name, value in head.groupdict().items()}
    kind = words["kind"].upper()
    if kind not in KINDS:
        raise ValueError(f"{kind} in it is no mesh; read are {', '.join(KINDS)}.")
    encoding = Encoding(KINDS[kind], words["title"].strip("\r"), words["version"], words["mode"].upper() == "ASCII")
    text = _Text(raw, encoding.is_text)
    lattice, rows, section, arrays, at = None, -1, "", 0, head.end()
    while match := SIZES.search(raw, at):
        told, at = " ".join(match[0].decode(errors="replace").split()), match.end()
        name = next((name for name in COUNTS if match[name]), "")
        sizes = [int(word) for word in match[name].split()] if name else []
        rows = sizes[0] if name == "rows" else rows
        count = math.prod(sizes) * (max(rows, 1) if name in ("scalars", "columns") else 1)
        count = max(sizes) if name == "cells" else count
        has_points = name != "dimensions" or kind == "STRUCTURED_GRID"
        if min(sizes, default=0) < 0 or count > 8 * len(raw) + (0 if has_points else LATTICE):  # bits are smallest
            raise ValueError(f"{told!r} announces {count} numbers, but the file has {len(raw)} bytes.")
        if match["end"] is not None or (name == "field" and section and rows < 0):
            raise ValueError(f"a damaged file, or one cut short, in the section that begins with {section or told!r}.")
        if name == "dimensions" and has_points:
            lattice = count
        if name == "points" and lattice not in (None, count):
            raise ValueError(f"{told!r} for a grid of {lattice} points: a damaged file.")
        try:
            if match["type"]:
                at = text.after(at, 3 * count, match["type"])
            elif name == "field":
                at, arrays = text.after_field(at, count), arrays + count
            elif name == "cells" and words["version"] < "5":
                text.check_cells(at, *sizes)
        except ValueError as error:
            raise ValueError(f"a damaged file, or one cut short, in the section {told!r} ({error}).") from error
        section = told if name in ("section", "points", "cells", "rows") else section
    return encoding, Announced(arrays=arrays - raw.count(b"NULL_ARRAY"))


@dataclasses.dataclass(frozen=True)
class _Text:
    """The bytes of a file, and whether its numbers are words."""

    raw: bytes
    is_text: bool

    def after(self, at: int, count: int, name: bytes) -> int:
        """Finds the place after so many numbers. Raises `ValueError` where there are others."""
        name = name.lower()
        if name == b"string":
            return self._after_strings(at, count)
        if name not in TYPES:
            raise ValueError(f"{name.decode(errors='replace')!r} is no type of numbers")
        if not self.is_text:
            size = -(-count // 8) if name == b"bit" else count * np.dtype(TYPES[name]).itemsize
            rest = re.compile(rb"[ \t\r]*(\n|\Z)").match(self.raw, at + size)
            if rest is None or at + size > len(self.raw):
                raise ValueError(f"other than {count} numbers")
            return rest.end()
        kind = np.float64 if TYPES[name][0] == "f" else np.int64
        left = count
        while left:
            end = self.raw.find(b"\n", at + min(24 * left, 1 << 20)) + 1 or len(self.raw)
            _, ends, _ = scan(self.raw[at:end])
            wanted = min(left, len(ends))
            stop = at + int(ends[wanted - 1]) if wanted else at
            if not wanted or len(parse(self.raw[at:stop], kind)) != wanted:
                raise ValueError(f"{count - left} numbers and not {count}, or something that is no number")
            at, left = stop, left - wanted
        return at

    def _after_strings(self, at: int, count: int) -> int:
        """Goes over strings: a line each, or the length in 1 to 8 bytes, as two bits tell, and bytes."""
        for _ in range(count):
            if at >= len(self.raw):
                raise ValueError(f"fewer than {count} strings")
            if self.is_text:
                at = self.raw.find(b"\n", at) + 1 or len(self.raw)
            else:
                size = {3: 1, 2: 2, 1: 4, 0: 8}[self.raw[at] >> 6]
                length = int.from_bytes(self.raw[at : at + size], "big") & ((1 << (8 * size - 2)) - 1)
                at += size + length
        return at

    def after_field(self, at: int, count: int) -> int:
        """Finds the place after a field of so many arrays."""
        for _ in range(count):
            line = ARRAY.match(self.raw, at)
            if line is None:
                raise ValueError(
                    f"{self.raw[at : at + 60].strip()!r} where an array's name, sizes and type are expected"
                )
            at = line.end()
            if not line["none"]:
                columns, rows = int(line["columns"]), int(line["rows"])
                if columns < 1 or columns * rows > 8 * len(self.raw):
                    raise ValueError(f"an array of {columns} times {rows} numbers")
                at = self.after(at, columns * rows, line["type"])
        return at

    def check_cells(self, at: int, count: int, size: int) -> None:
        """Raises `ValueError` where numbers are not cells: each its number of nodes, and these."""
        end = self.after(at, size, b"int")
        numbers = parse(self.raw[at:end], np.int64) if self.is_text else np.frombuffer(self.raw, ">i4", size, at)
        # Cells of one size are gone through together: numbers of nodes stand at equal steps.
        place, found, block = 0, 0, 1
        while place < size:
            step = int(numbers[place]) + 1
            rows = numbers[place : place + block * step : step] if step > 0 else numbers[:0]
            same = len(rows) if (rows == step - 1).all() else int((rows != step - 1).argmax())
            if not same:
                raise ValueError(f"cell {found} has {step - 1} nodes")
            place, found, block = place + same * step, found + same, 2 * block if same == block else 1
        if place != size or found != count:
            raise ValueError(f"{found} cells of {place} numbers")


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
    kind = data.GetClassName().removeprefix("vtk")
    writer = getattr(vtk.vtk("vtkIOLegacy"), f"vtk{kind}Writer")()
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
