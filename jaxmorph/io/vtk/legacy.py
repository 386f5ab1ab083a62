"""VTK's legacy files (.vtk), whose sections are checked before VTK reads them."""

import dataclasses
import math
import pathlib
import re
from typing import Any

import numpy as np

from jaxmorph._host.cells.topology import VTK_LAGRANGE
from jaxmorph._mesh import vtk

from .._text import scan
from .checks import check_streams, numbers

HEAD = re.compile(
    rb"# vtk DataFile Version (?P<version>\d\.\d)[^\n]*\n(?P<title>[^\n]*)\n\s*(?P<mode>ASCII|BINARY)\s+DATASET\s+(?P<kind>\w+)",
    re.IGNORECASE,
)

KINDS = {
    **{"UNSTRUCTURED_GRID": "UnstructuredGrid", "STRUCTURED_GRID": "StructuredGrid", "POLYDATA": "PolyData"},
    **{"STRUCTURED_POINTS": "StructuredPoints", "RECTILINEAR_GRID": "RectilinearGrid"},
}

CELLS = ("CELLS", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")

COLUMNS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}
"""Numbers in a row of an array, by the word before its name and type."""

TYPES = {
    **{"signed_char": "i1", "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2"},
    **{"int": "i4", "unsigned_int": "u4", "vtkidtype": "i4", "long": "l", "unsigned_long": "L"},
    **{"long_long": "i8", "unsigned_long_long": "u8", "float": "f4", "double": "f8", "bit": "u1"},
    **{f"vtktype{sign}int{8 * n}": f"{sign or 'i'}{n}" for sign in ("", "u") for n in (1, 2, 4, 8)},
}

TYPES_OF_MESHIO = {
    **{b"vtktypeint8": b"signed_char", b"vtktypeuint8": b"unsigned_char", b"vtktypeint16": b"short"},
    **{b"vtktypeuint16": b"unsigned_short", b"vtktypeint32": b"int", b"vtktypeuint32": b"unsigned_int"},
}
"""Names of types that meshio writes, and VTK's own."""

MESHIO = re.compile(rb"(?<=\s)vtktypeu?int(?:8|16|32)(?=\s)")

LATTICE = 10**6
"""Points of a lattice without coordinates that a file of any size may have."""


@dataclasses.dataclass(frozen=True)
class Encoding:
    kind: str = "UnstructuredGrid"
    title: str = "written by jaxmorph"
    version: str = "4.2"
    is_text: bool = False


def checked(raw: bytes) -> tuple[bytes, Encoding]:
    """Refuses sizes that do not fit the file; returns the file for VTK, and its encoding."""
    head = HEAD.match(raw)
    if head is None:
        raise ValueError("not a .vtk file; `# vtk DataFile Version` and three lines more are expected first.")
    words = {name: value.decode(errors="replace") for name, value in head.groupdict().items()}
    kind = words["kind"].upper()
    if kind not in KINDS:
        raise ValueError(f"{kind} in it is no mesh; read are {', '.join(KINDS)}.")
    encoding = Encoding(KINDS[kind], words["title"].strip("\r"), words["version"], words["mode"].upper() == "ASCII")
    sections = _Sections(raw, head.end(), encoding.is_text, words["version"] < "5")
    keys = set()
    try:
        while line := sections.words():
            keys.add(line[0].upper())
            sections.skip(*line)
        missing = [key for key in ("POINTS", "CELLS", "CELL_TYPES") if key not in keys]
        if missing and kind == "UNSTRUCTURED_GRID":
            raise ValueError(f"no {' and no '.join(missing)}")
    except (ValueError, KeyError, IndexError, TypeError) as error:
        place = f"in the section that begins with {sections.section!r}" if sections.section else "before any section"
        raise ValueError(f"a damaged .vtk file, or one cut short, {place} ({str(error)[:200]}).") from error
    return sections.readable(), encoding


@dataclasses.dataclass
class _Sections:
    """Goes through a file as VTK does, to its place `at`, before VTK crashes on it."""

    raw: bytes
    at: int
    is_text: bool
    is_old: bool
    section: str = ""
    rows: int = -1
    points: int | None = None
    nodes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))
    ends: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(1, np.int64))
    edits: list[tuple[int, int, bytes]] = dataclasses.field(default_factory=list)

    def readable(self) -> bytes:
        starts, stops, texts = zip(*self.edits, (len(self.raw), 0, b""), strict=True)
        kept = (self.raw[a:b] for a, b in zip((0, *stops), starts, strict=False))
        return b"".join(part for pair in zip(kept, texts, strict=True) for part in pair)

    def words(self) -> list[str]:
        while self.at < len(self.raw):
            begin, line = self.at, self._line()
            for name in MESHIO.findall(line):
                place = begin + line.index(name)
                self.edits.append((place, place + len(name), TYPES_OF_MESHIO[name]))
            if words := line.split():  # at blanks of C, which are fewer than those of a text
                return [word.decode(errors="replace") for word in words]
        return []

    def skip(self, key: str, *words: str) -> None:
        key = key.upper()
        if key in (*CELLS, "POINTS", "CELL_TYPES", "POINT_DATA", "CELL_DATA"):
            self.section = " ".join([key, *words])
        known = {"METADATA": self._notes, "FIELD": self._field, "DIMENSIONS": self._lattice, "POINTS": self._points}
        known |= {"CELL_TYPES": self._types, "POINT_DATA": self._data, "CELL_DATA": self._data}
        known |= dict.fromkeys(CELLS, self._cells) | dict.fromkeys(("SPACING", "ORIGIN", "ASPECT_RATIO"), self._nothing)
        known |= dict.fromkeys(("X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES"), self._numbers)
        if key in known:
            known[key](*words)
        elif self.rows < 0:
            raise ValueError(f"{' '.join([key, *words])[:60]!r} is neither a section nor an array")
        else:
            self._attribute(key, words)

    def _nothing(self, *_: str) -> None: ...

    def _numbers(self, count: str, name: str) -> None:
        self.after(int(count), name)

    def _lattice(self, *sizes: str) -> None:
        self.points = math.prod(max(int(size), 0) for size in sizes[:3])
        if self.points > LATTICE + 8 * len(self.raw):
            raise ValueError(f"a lattice of {self.points} points in {len(self.raw)} bytes")

    def _points(self, count: str, name: str) -> None:
        if self.points not in (None, int(count)):
            raise ValueError(f"a grid has {self.points} points")
        self.after(3 * int(count), name)

    def _data(self, rows: str, *_: str) -> None:
        self.rows = int(rows)
        if self.rows and not self.raw[self.at :].strip():
            raise ValueError("no arrays")

    def _attribute(self, key: str, words: tuple[str, ...]) -> None:
        colour = "float" if self.is_text else "unsigned_char"
        if key == "LOOKUP_TABLE":
            self.after(4 * int(words[1]), colour)
        elif key in ("COLOR_SCALARS", "TEXTURE_COORDINATES"):
            self.after(self.rows * int(words[1]), (*words, colour)[2])
        elif key == "SCALARS":
            if (table := self.words())[:1] != ["LOOKUP_TABLE"]:
                raise ValueError(f"{' '.join(table)[:60]!r} where LOOKUP_TABLE is expected")
            self.after(self.rows * int((*words, "1")[2]), words[1])
        else:
            self.after(self.rows * COLUMNS[key], words[1])

    def _notes(self, *_: str) -> None:
        """Skips notes on an array, of which VTK is to read only the names of components."""
        begin, words = self.at, [b""]
        while words and words[0] != b"INFORMATION":
            begin = self.at
            words = self._line().split()
        while words:
            words = self._line().split()
        self.edits.append((begin, self.at, b"INFORMATION 0\n\n"))

    def _line(self) -> bytes:
        end = self.raw.find(b"\n", self.at) + 1 or len(self.raw)
        line, self.at = self.raw[self.at : end], end
        return line

    def _field(self, name: str, count: str) -> None:
        if self.rows < 0 and self.section:
            raise ValueError("a field of arrays, but neither POINT_DATA nor CELL_DATA before it")
        for _ in range(int(count)):
            words = self.words()
            while words == ["METADATA"]:
                self._notes()
                words = self.words()
            if words == ["NULL_ARRAY"]:
                continue
            if len(words) != 4:
                raise ValueError(f"{' '.join(words)[:60]!r} where the name, sizes and type of an array are expected")
            columns, rows = int(words[1]), int(words[2])
            if columns < 1 or (self.rows >= 0 and rows != self.rows):
                raise ValueError(f"an array of {columns} times {rows} numbers, for {self.rows} rows")
            self.after(columns * rows, words[3])

    def _cells(self, *sizes: str) -> None:
        """Skips cells: the number of nodes stands before them up to 5.0, then in offsets."""
        count, size = map(int, sizes[:2])
        if self.is_old:
            self.nodes = self.after(size, "int")
            self.ends = _ends(self.nodes)
            if self.ends[-1] != size or len(self.ends) - 1 != count:
                raise ValueError(f"{len(self.ends) - 1} cells of {self.ends[-1]} numbers")
            return
        self.ends, self.nodes = self._list("OFFSETS", count), self._list("CONNECTIVITY", size)
        if count and (self.ends[0] != 0 or self.ends[-1] != size or (self.ends[1:] < self.ends[:-1]).any()):
            raise ValueError(f"offsets that are not those of {size} nodes")

    def _list(self, key: str, count: int) -> np.ndarray:
        words = self.words()
        if words[:1] != [key]:
            raise ValueError(f"no {key}")
        return self.after(count, words[1])

    def _types(self, count: str, *_: str) -> None:
        kinds = self.after(int(count), "int")
        rows = np.flatnonzero(kinds == vtk.POLYHEDRON)
        if len(rows) and len(kinds) != len(self.ends) - 1:
            raise ValueError(f"{len(kinds)} types, for other cells")
        if len(rows):
            skip = int(self.is_old)  # the number of a cell's nodes
            check_streams(self.nodes, self.ends[rows] + skip, self.ends[rows + 1])

    def after(self, count: int, name: str) -> np.ndarray:
        """Reads so many numbers of a type by its name; `ValueError` where there are others."""
        kind, raw = name.lower(), self.raw
        if kind == "string":
            self._strings(count)
            return np.zeros(0)
        if not 0 <= count <= 8 * len(raw):  # bits are the smallest numbers
            raise ValueError(f"{count} numbers in a file of {len(raw)} bytes")
        if not self.is_text:
            begin, dtype = self.at, np.dtype(TYPES[kind]).newbyteorder(">")
            length = -(-count // 8) if kind == "bit" else count
            self.at += length * dtype.itemsize
            self._end_line(count)
            return np.frombuffer(raw, dtype, length, begin)
        left, parts = count, [np.zeros(0, np.int64)]
        while left:
            end = raw.find(b"\n", self.at + min(24 * left, 1 << 20)) + 1 or len(raw)
            _, ends, _ = scan(raw[self.at : end])
            wanted = min(left, len(ends))
            stop = self.at + int(ends[wanted - 1]) if wanted else self.at
            parts.append(numbers(raw[self.at : stop], TYPES[kind]))
            if not wanted or len(parts[-1]) != wanted:
                raise ValueError(f"something that is no number, or {count - left} numbers and not {count}")
            self.at, left = stop, left - wanted
        self._end_line(count)
        return np.concatenate(parts)

    def _end_line(self, count: int) -> None:
        rest = re.compile(rb"[ \t\r]*(\n|\Z)").match(self.raw, self.at)
        if rest is None or self.at > len(self.raw):
            raise ValueError(f"other than {count} numbers announced")
        self.at = rest.end()

    def _strings(self, count: int) -> None:
        """Skips strings: lines, or bytes behind a length (1 to 8 bytes, by its first bits)."""
        for _ in range(count):
            if self.at >= len(self.raw):
                raise ValueError(f"fewer than {count} strings")
            if self.is_text:
                self.at = self.raw.find(b"\n", self.at) + 1 or len(self.raw)
            else:
                size = {3: 1, 2: 2, 1: 4, 0: 8}[self.raw[self.at] >> 6]
                head = int.from_bytes(self.raw[self.at : self.at + size], "big")
                self.at += size + (head & ((1 << (8 * size - 2)) - 1))


def _ends(nodes: np.ndarray) -> np.ndarray:
    # Cells of one size are gone through together: numbers of nodes stand at equal steps.
    place, block, begins = 0, 1, [np.zeros(0, np.int64)]
    while place < len(nodes):
        step = int(nodes[place]) + 1
        rows = nodes[place : place + block * step : step] if step > 0 else nodes[:0]
        same = len(rows) if (rows == step - 1).all() else int((rows != step - 1).argmax())
        if not same:
            raise ValueError(f"a cell of {step - 1} nodes")
        begins.append(place + step * np.arange(same))
        place, block = place + same * step, 2 * block if same == block else 1
    return np.append(np.concatenate(begins), place)


def reader(_: pathlib.Path, raw: bytes, encoding: Encoding) -> Any:
    new = getattr(vtk.vtk("vtkIOLegacy"), f"vtk{encoding.kind}Reader")()
    for name in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords", "Fields"):
        getattr(new, f"ReadAll{name}On")()
    new.ReadFromInputStringOn()
    new.SetBinaryInputString(raw, len(raw))
    return new


def writer(data: Any, encoding: Encoding) -> Any:
    kind = data.GetClassName().removeprefix("vtk")
    writer = getattr(vtk.vtk("vtkIOLegacy"), f"vtk{kind}Writer")()
    writer.SetHeader(encoding.title)
    # before 5.1 files have another order of the nodes of hexahedra, in which VTK does not write
    is_new = encoding.version > "5" or VTK_LAGRANGE["hexahedron"] in vtk.numbers_of(vtk.unstructured(data))
    writer.SetFileVersion(51 if is_new else 42)
    (writer.SetFileTypeToASCII if encoding.is_text else writer.SetFileTypeToBinary)()
    writer.SetPrecision(17)
    return writer
