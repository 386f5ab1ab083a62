"""VTK's XML files, whose sizes are checked before VTK reads them.

VTK asks for memory as the file's numbers say, and takes lists in text as far as they go.
"""

import base64
import binascii
import dataclasses
import math
import os
import pathlib
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxmorph._mesh.vtk import POLYHEDRON, data_of, vtk

from .checks import check_ends, check_streams, errors_told, numbers

SMALL, UNPACKED = 2 * 10**8, 100
"""Bytes that a packed file may become in any case, and that one of its bytes may become."""

TYPES = {f"{sign}Int{bits}": f"{code}{bits // 8}" for sign, code in (("", "i"), ("U", "u")) for bits in (8, 16, 32, 64)}
TYPES |= {"Float32": "f4", "Float64": "f8", "String": "u1"}

KINDS = ("UnstructuredGrid", "StructuredGrid", "PolyData")
"""Data sets that are one mesh, with points of their own."""


STREAM = ("faces", "faceoffsets")
LISTS = ("face_connectivity", "face_offsets", "polyhedron_to_faces", "polyhedron_offsets")
"""Arrays of polyhedra, up to version 2.2 and since."""

SECTIONS = ("Cells", "Verts", "Lines", "Strips", "Polys")


@dataclasses.dataclass(frozen=True)
class Encoding:
    """How a file says a data set: ascii, binary or appended, in base64 or not, packed by what."""

    kind: str = "UnstructuredGrid"
    mode: str = "binary"
    is_raw: bool = False
    compressor: str = "vtkZLibDataCompressor"
    header: str = "UInt64"
    order: str = "LittleEndian"


@dataclasses.dataclass(frozen=True)
class _File:
    """The elements of a file, and the bytes that are appended to them."""

    root: ElementTree.Element
    appended: bytes | memoryview
    encoding: Encoding

    @property
    def head(self) -> np.dtype:
        order = ">" if self.encoding.order == "BigEndian" else "<"
        return np.dtype({"UInt32": "u4", "UInt64": "u8"}[self.encoding.header]).newbyteorder(order)

    def size(self, array: ElementTree.Element) -> tuple[int, bytes]:
        """Finds the number of bytes that an array has, by the sizes before it, and its text."""
        is_inline, width = array.get("format") == "binary", self.head.itemsize
        data, is_text = self.appended, is_inline or not self.encoding.is_raw
        start = 0 if is_inline else int(array.get("offset", "-1"))
        if is_inline:
            data = "".join((array.text or "").split()).encode()
        if not 0 <= start <= len(data):
            raise ValueError(f"it begins at byte {start} of {len(data)}")
        (count,) = self._numbers(data, start, 1, is_text)
        if not self.encoding.compressor:
            return count, self._stream(data, start, 1, count, is_text)
        if count * width > len(data):
            raise ValueError(f"{count} blocks in {len(data)} bytes")
        _, size, last, *packed = self._numbers(data, start, 3 + count, is_text) if count else (0, 0, 0)
        total = size * (count - (last > 0)) + last
        if count and not max(last, 1) <= size <= total + (1 << 24):
            raise ValueError(f"blocks of {size} bytes for {total}")
        return total, self._stream(data, start, 3 + count if count else 1, sum(packed), is_text)

    def _stream(self, data: bytes | memoryview, start: int, heads: int, count: int, is_text: bool) -> bytes:
        """Returns a header and `count` bytes. Raises `ValueError` where they are not there."""
        head = heads * self.head.itemsize
        if not is_text:
            end = start + head + count
            held = len(data) - start - head
        else:
            # the header is a text of its own where blocks follow or it is padded
            begin = start + 4 * -(-head // 3)
            is_apart = bool(self.encoding.compressor) or data[begin - 1 : begin] == b"="
            begin, wanted = (begin, count) if is_apart else (start, head + count)
            end = begin + 4 * -(-wanted // 3)
            held = len(base64.b64decode(data[begin:end], validate=True)) - wanted + count
        if held < count:
            raise ValueError(f"{count} bytes, of which the file has {max(held, 0)}")
        return bytes(data[start:end])

    def _numbers(self, data: bytes | memoryview, start: int, count: int, is_text: bool) -> list[int]:
        """Reads the first numbers of a header, in base64 or as they are."""
        size = count * self.head.itemsize
        data = data[start : start + (4 * -(-size // 3) if is_text else size)]
        if is_text:
            data = base64.b64decode(data, validate=True)
        if len(data) < size:
            raise ValueError("the file ends in an array")
        return np.frombuffer(data, self.head, count).tolist()


def checked(raw: bytes) -> tuple[bytes, Encoding]:
    """Raises `ValueError` for arrays that have not the size that the file says.

    Returns the file, and its encoding.
    """
    file = _opened(raw)
    if file.encoding.kind not in KINDS:
        raise ValueError(f"{file.encoding.kind!r} in it is no mesh; read are {', '.join(KINDS)}.")
    size = sum(math.prod(_check(file, array, rows)) for array, rows in _arrays(file.root))
    if size > SMALL + UNPACKED * len(raw):
        raise ValueError(f"{len(raw)} bytes become {size} when unpacked; no mesh does.")
    for piece in file.root.iter("Piece"):
        for section in piece:
            if section.tag in SECTIONS:
                _check_cells(file, piece, section)
    return raw, file.encoding


def _check_cells(file: _File, piece: ElementTree.Element, section: ElementTree.Element) -> None:
    """Raises `ValueError` where lists of nodes and faces do not end as their arrays do.

    VTK takes memory as the ends say, and crashes. So it reads them first, as arrays of a file
    without cells.
    """
    arrays = {array.get("Name", ""): array for array in section.iterfind("DataArray")}
    if len(arrays) != len(section.findall("DataArray")):
        raise ValueError(f"two arrays of one name in {section.tag}.")
    has_faces = bool(arrays.keys() & {*STREAM, *LISTS})
    found = _values(file, [array for name, array in arrays.items() if has_faces or name in ("offsets", "types")])
    count = _check(file, arrays["connectivity"], -1)[0] if "connectivity" in arrays else 0
    check_ends(found.get("offsets", np.zeros(0, np.int64)), count, "connectivity")
    if not (found.get("types", np.zeros(0)) == POLYHEDRON).any():
        return
    if found.keys() >= {*STREAM}:
        ends = found["faceoffsets"][found["faceoffsets"] >= 0].astype(np.int64)  # -1 for other cells
        check_streams(found["faces"], np.append(0, ends[:-1])[: len(ends)], ends)
    elif found.keys() >= {*LISTS}:
        faces, face_ends, of_cells, cell_ends = (found[name] for name in LISTS)
        check_ends(cell_ends, len(of_cells), "polyhedron_to_faces")
        check_ends(face_ends, len(faces), "face_connectivity")
        if len(cell_ends) != len(found["types"]) or not 0 <= of_cells.min(initial=0) <= of_cells.max(initial=0) < len(
            face_ends
        ):
            raise ValueError(
                f"polyhedra of {len(cell_ends)} cells name {of_cells.max(initial=0)}, of {len(face_ends)} faces."
            )
    else:
        raise ValueError(f"polyhedra without {' and '.join({*LISTS} - found.keys())}.")


def _values(file: _File, arrays: list[ElementTree.Element]) -> dict[str, np.ndarray]:
    """Reads arrays by VTK as those of a file of one point."""
    root = ElementTree.Element("VTKFile", file.root.attrib | {"type": "ImageData"})
    image = ElementTree.SubElement(root, "ImageData", {"WholeExtent": "0 0 0 0 0 0"})
    fields = ElementTree.SubElement(image, "FieldData")
    ElementTree.SubElement(image, "Piece", {"Extent": "0 0 0 0 0 0"})
    appended, empty = b"", {}
    for array in arrays:
        count, _ = _check(file, array, -1)
        if not count:  # VTK crashes
            empty[array.get("Name", "")] = np.zeros(0, np.int64)
            continue
        copy = ElementTree.SubElement(fields, "DataArray", array.attrib | {"NumberOfTuples": str(count)})
        copy.text = array.text
        if array.get("format") == "appended":
            copy.set("offset", str(len(appended)))
            appended += file.size(array)[1]
    encoding = b"raw" if file.encoding.is_raw else b"base64"
    tail = b'<AppendedData encoding="%s">_%s</AppendedData>' % (encoding, appended) if appended else b""
    new = vtk("vtkIOXML").vtkXMLImageDataReader()
    new.ReadFromInputStringOn()
    new.SetInputString(ElementTree.tostring(root).removesuffix(b"</VTKFile>") + tail + b"</VTKFile>")
    with errors_told():
        new.Update()
    return empty | data_of(new.GetOutput().GetFieldData())


def reader(path: pathlib.Path, _: bytes, encoding: Encoding) -> Any:
    new = getattr(vtk("vtkIOXML"), f"vtkXML{encoding.kind}Reader")()
    new.SetFileName(os.fsencode(path))
    return new


def written(data: Any, encoding: Encoding) -> bytes:
    """Makes the file. VTK itself tells no error where a device is full, so it writes to memory."""
    kind = data.GetClassName().removeprefix("vtk")
    writer = getattr(vtk("vtkIOXML"), f"vtkXML{kind}Writer")()
    writer.SetInputData(data)
    {"ascii": writer.SetDataModeToAscii, "binary": writer.SetDataModeToBinary}.get(
        encoding.mode, writer.SetDataModeToAppended
    )()
    writer.SetEncodeAppendedData(not encoding.is_raw)
    kinds = ("None", "ZLib", "LZ4", "LZMA")
    writer.SetCompressorType(next(k for k, name in enumerate(kinds) if name in (encoding.compressor or "None")))
    getattr(writer, f"SetHeaderTypeTo{encoding.header}")()
    getattr(writer, f"SetByteOrderTo{encoding.order}")()
    writer.SetWriteToOutputString(True)
    writer.Write()
    text = writer.GetOutputString()
    return text.encode() if isinstance(text, str) else text


def named_files(path: pathlib.Path) -> list[tuple[str, pathlib.Path]]:
    """Lists the files that a file of pieces or blocks names, with the names of blocks."""
    root = _opened(path.read_bytes()).root
    named = [(each.get("name", ""), each.get("Source") or each.get("file")) for each in root.iter()]
    found = [(name, path.parent / file) for name, file in named if file]
    wrong = [file for _, file in found if file.suffix.lower() not in (".vtu", ".vts", ".vtp")]
    if wrong or not found:
        raise ValueError(f"it names {len(found)} files of meshes" + f" and {wrong[0].name}." * bool(wrong))
    return found


def _check(file: _File, array: ElementTree.Element, rows: int) -> tuple[int, int]:
    """Compares an array with its rows, -1 for any; returns its count and size of numbers."""
    for key in array.iter("InformationKey"):
        if int(key.get("length", "0")) > len(key):
            raise ValueError(f"{key.get('length')} values in {key.get('name')!r}, of which {len(key)} are there.")
    name, kind, width = array.get("Name", "Points"), array.get("type", ""), int(array.get("NumberOfComponents", "1"))
    if kind not in TYPES:
        raise ValueError(f"the array {name!r} is of type {kind!r}.")
    dtype, is_text = np.dtype(TYPES[kind]), array.get("format", "ascii") == "ascii"
    try:
        values = numbers((array.text or "").encode(), TYPES[kind]) if is_text else np.zeros(0)
        count, rest = (len(values), 0) if is_text else divmod(file.size(array)[0], dtype.itemsize)
    except (ValueError, binascii.Error) as error:
        raise ValueError(f"the array {name!r} is damaged ({error}).") from error
    if kind == "String":  # VTK reads as many as are announced
        if not is_text:
            copy = ElementTree.Element("DataArray", array.attrib | {"type": "UInt8", "Name": "text"})
            copy.text = array.text
            values = _values(file, [copy])["text"]
        ends = int((values == 0).sum())
        if ends != rows * width:
            raise ValueError(f"{ends} strings in {name}, {rows * width} expected: a damaged file, or one cut short.")
        return count, 1
    if width < 1 or rest or (rows >= 0 and count != rows * width):
        raise ValueError(f"{count} numbers in {name}, {rows * width} expected: a damaged file, or one cut short.")
    return count, dtype.itemsize


def _arrays(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, int]]:
    """Lists all arrays, with the number of rows that each should have, or -1."""
    for grid in root:
        extents = [_sizes(part.get("Extent", "0 -1")) for part in grid if part.tag == "Piece"]
        whole = grid.get("WholeExtent")
        if whole is not None and sum(map(math.prod, extents)) != math.prod(_sizes(whole)):
            raise ValueError(f"its pieces are not those of the extent {whole}: a damaged file, or one cut short.")
        for part in grid:
            sections = part if part.tag == "Piece" else [part]
            rows = _rows(part) if part.tag == "Piece" else {}
            for section in sections:
                of_section = rows.get(section.tag, {})
                for array in section:
                    if array.tag in ("DataArray", "Array"):
                        known = of_section.get(
                            array.get("Name", ""), of_section.get("", array.get("NumberOfTuples", -1))
                        )
                        yield array, int(known)


def _sizes(extent: str) -> list[int]:
    """Counts cells along the axes of a structured grid; an axis of one point has one."""
    ends = [int(end) for end in extent.split()]
    return [max(high - low, 1) for low, high in zip(ends[::2], ends[1::2], strict=True)]


def _rows(piece: ElementTree.Element) -> dict[str, dict[str, int]]:
    """Counts the rows of a piece's arrays by section and name; "" stands for any name."""
    extent = piece.get("Extent")
    kinds = {kind: int(piece.get(f"NumberOf{kind}", 0)) for kind in ("Verts", "Lines", "Strips", "Polys")}
    if extent is None:
        points, cells = int(piece.get("NumberOfPoints", 0)), int(piece.get("NumberOfCells", sum(kinds.values())))
    else:
        ends = [int(end) for end in extent.split()]
        points = math.prod(high - low + 1 for low, high in zip(ends[::2], ends[1::2], strict=True))
        cells = math.prod(_sizes(extent))
    if min(points, cells, *kinds.values()) < 0:
        raise ValueError(f"{points} points and {cells} cells are announced.")
    rows = {"Points": {"": points}, "PointData": {"": points}, "CellData": {"": cells}}
    return rows | {"Cells": {"offsets": cells, "types": cells}} | {kind: {"offsets": n} for kind, n in kinds.items()}


def _opened(raw: bytes) -> _File:
    """Takes a file apart: XML, and what is appended to it."""
    at = raw.find(b"<AppendedData")
    tag = re.compile(rb"[^>]*>\s*_").match(raw, at) if at >= 0 else None
    end = raw.rfind(b"</AppendedData>")
    if at >= 0 and (tag is None or end < tag.end()):
        raise ValueError("no AppendedData that begin with '_' and end: a damaged file, or one cut short.")
    try:
        root = ElementTree.fromstring(raw if tag is None else raw[:at] + b"</VTKFile>")
    except ElementTree.ParseError as error:
        raise ValueError(f"not one of VTK's XML files, or a damaged one ({error}).") from error
    if root.tag != "VTKFile":
        raise ValueError(f"not one of VTK's XML files; it begins with <{root.tag}>.")
    formats = {array.get("format", "ascii") for array in root.iter("DataArray")}
    mode = next((mode for mode in ("appended", "binary") if mode in formats), "ascii")
    names = {"header": root.get("header_type", "UInt32"), "order": root.get("byte_order", "LittleEndian")}
    if names["header"] not in ("UInt32", "UInt64") or names["order"] not in ("LittleEndian", "BigEndian"):
        raise ValueError(f"headers of type {names['header']!r}, bytes in the order {names['order']!r}.")
    encoding = Encoding(
        root.get("type", ""), mode, tag is not None and b"raw" in tag[0], root.get("compressor", ""), **names
    )
    appended = memoryview(raw)[tag.end() : end] if tag else b""
    return _File(root, appended if encoding.is_raw else b"".join(bytes(appended).split()), encoding)
