"""VTK's XML files; their sizes are checked, because VTK trusts them when it asks for memory."""

import base64
import binascii
import dataclasses
import itertools
import math
import os
import pathlib
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxmorph._mesh.vtk import POLYHEDRON, vtk

from .checks import check_ends, check_streams, numbers

SMALL, UNPACKED = 2 * 10**8, 100
"""Bytes that a packed array may become in any case, and that a byte of its file may become."""

TYPES = {f"{sign}Int{bits}": f"{code}{bits // 8}" for sign, code in (("", "i"), ("U", "u")) for bits in (8, 16, 32, 64)}
TYPES |= {"Float32": "f4", "Float64": "f8", "String": "u1"}

KINDS = ("UnstructuredGrid", "StructuredGrid", "PolyData")
"""Data sets that are one mesh, with points of their own."""


STREAM = ("faces", "faceoffsets")
LISTS = ("face_connectivity", "face_offsets", "polyhedron_to_faces", "polyhedron_offsets")
"""Arrays of polyhedra, up to version 2.2 and since."""

OPTIONS = {
    "header_type": ("UInt32", "UInt64"),
    "byte_order": ("LittleEndian", "BigEndian"),
    "compressor": ("", "vtkZLibDataCompressor", "vtkLZ4DataCompressor", "vtkLZMADataCompressor"),
}
"""What the root of a file may say of its arrays, the default first."""

SECTIONS = ("Cells", "Verts", "Lines", "Strips", "Polys")


@dataclasses.dataclass(frozen=True)
class Encoding:
    """The encoding of a data set: ascii, binary or appended, base64 or raw, and its compressor."""

    kind: str = "UnstructuredGrid"
    mode: str = "binary"
    is_raw: bool = False
    compressor: str = "vtkZLibDataCompressor"
    header: str = "UInt64"
    order: str = "LittleEndian"


@dataclasses.dataclass(frozen=True)
class _File:
    root: ElementTree.Element
    appended: bytes | memoryview
    encoding: Encoding
    limit: int

    def dtype(self, name: str) -> np.dtype:
        return np.dtype(TYPES[name]).newbyteorder(">" if self.encoding.order == "BigEndian" else "<")

    def values(self, array: ElementTree.Element) -> np.ndarray:
        kind = array.get("type", "")
        if array.get("format", "ascii") == "ascii":
            return numbers((array.text or "").encode(), TYPES[kind])
        unpacked = b"".join(self._unpacked(*block) for block in self.blocks(array))
        return np.frombuffer(unpacked, self.dtype(kind))

    def count(self, array: ElementTree.Element) -> int:
        if array.get("format", "ascii") == "ascii":
            return len(self.values(array))
        size = sum(size for size, _ in self.blocks(array))
        count, rest = divmod(size, self.dtype(array.get("type", "")).itemsize)
        if rest:
            raise ValueError(f"{size} bytes")
        return count

    def blocks(self, array: ElementTree.Element) -> list[tuple[int, bytes | memoryview]]:
        head, data, start, is_text = self.dtype(self.encoding.header), self.appended, 0, True
        if array.get("format") == "binary":
            data = "".join((array.text or "").split()).encode()
        else:
            start, is_text = int(array.get("offset", "-1")), not self.encoding.is_raw
        first, end = _taken(data, start, head.itemsize, is_text)
        (count,) = np.frombuffer(first, head).tolist()
        if not self.encoding.compressor:
            # in base64 the header is a text of its own only where it is padded
            is_apart = not is_text or bytes(data[end - 1 : end]) == b"="
            begin, skipped = (end, 0) if is_apart else (start, head.itemsize)
            return [(count, _taken(data, begin, skipped + count, is_text)[0][skipped:])]
        if not count:
            return []
        heads, end = _taken(data, start, (3 + count) * head.itemsize, is_text)
        _, size, last, *packed = np.frombuffer(heads, head).tolist()
        sizes = [size] * (count - 1) + [last or size]
        if min(sizes) < 1 or sum(sizes) > self.limit:
            raise ValueError(f"blocks of {size} bytes become {sum(sizes)} when unpacked; no mesh does")
        body, _ = _taken(data, end, sum(packed), is_text)
        ends = np.cumsum([0, *packed]).tolist()
        return [(size, body[a:b]) for size, (a, b) in zip(sizes, itertools.pairwise(ends), strict=True)]

    def _unpacked(self, size: int, block: bytes | memoryview) -> bytes | memoryview:
        if not self.encoding.compressor:
            return block
        unpacked = bytearray(size)
        if (
            getattr(vtk("vtkIOCore"), self.encoding.compressor)().Uncompress(bytes(block), len(block), unpacked, size)
            != size
        ):
            raise ValueError("a block that does not unpack")
        return bytes(unpacked)


def _taken(data: bytes | memoryview, at: int, count: int, is_text: bool) -> tuple[bytes | memoryview, int]:
    end = at + (4 * -(-count // 3) if is_text else count)
    piece = data[at:end] if at >= 0 else b""
    piece = base64.b64decode(piece, validate=True) if is_text else piece
    if len(piece) < count:
        raise ValueError(f"{count} bytes, of which the file has {len(piece)}")
    return piece[:count], end


def checked(raw: bytes) -> tuple[bytes, Encoding]:
    """Refuses arrays of another size than the file states; returns the file, and its encoding."""
    file = _opened(raw)
    if file.encoding.kind not in KINDS:
        raise ValueError(f"{file.encoding.kind!r} in it is no mesh; read are {', '.join(KINDS)}.")
    for array, rows in _arrays(file.root):
        name = array.get("Name", "Points")
        try:
            _check(file, array, rows, name)
        except binascii.Error as error:
            raise ValueError(f"the array {name!r} is damaged ({error}).") from error
    for piece in file.root.iter("Piece"):
        for section in piece:
            if section.tag in SECTIONS:
                _check_cells(file, section)
    return raw, file.encoding


def _check(file: _File, array: ElementTree.Element, rows: int, name: str) -> None:
    for key in array.iter("InformationKey"):
        if int(key.get("length", "0")) > len(key):
            raise ValueError(f"{key.get('length')} values in {key.get('name')!r}, of which {len(key)} are there.")
    kind, width = array.get("type", ""), int(array.get("NumberOfComponents", "1"))
    if kind not in TYPES:
        raise ValueError(f"the array {name!r} is of type {kind!r}.")
    what = "strings" if kind == "String" else "numbers"  # VTK reads as many as are announced
    try:
        count = int((file.values(array) == 0).sum()) if kind == "String" else file.count(array)
    except ValueError as error:
        raise ValueError(f"the array {name!r} is damaged ({error}).") from error
    if width < 1 or (rows >= 0 and count != rows * width):
        raise ValueError(f"{count} {what} in {name}, {rows * width} expected: a damaged file, or one cut short.")


def _check_cells(file: _File, section: ElementTree.Element) -> None:
    """Refuses lists of nodes and faces whose ends are wrong: VTK trusts them, and crashes."""
    arrays = {array.get("Name", ""): array for array in section.iterfind("DataArray")}
    if len(arrays) != len(section.findall("DataArray")):
        raise ValueError(f"two arrays of one name in {section.tag}.")
    count = file.count(arrays["connectivity"]) if "connectivity" in arrays else 0
    ends = file.values(arrays["offsets"]) if "offsets" in arrays else np.zeros(0, np.int64)
    check_ends(ends, count, "connectivity")
    types = file.values(arrays["types"]) if "types" in arrays else np.zeros(0)
    if (types == POLYHEDRON).any():
        _check_polyhedra(file, arrays, len(types))


def _check_polyhedra(file: _File, arrays: dict[str, ElementTree.Element], count: int) -> None:
    if arrays.keys() >= {*STREAM}:
        faces, ends = (file.values(arrays[name]) for name in STREAM)
        ends = ends[ends >= 0].astype(np.int64)  # -1 for other cells
        check_streams(faces, np.append(0, ends[:-1])[: len(ends)], ends)
        return
    if not arrays.keys() >= {*LISTS}:
        raise ValueError(f"polyhedra without {' and '.join({*LISTS} - arrays.keys())}.")
    faces, face_ends, of_cells, cell_ends = (file.values(arrays[name]) for name in LISTS)
    check_ends(cell_ends, len(of_cells), "polyhedron_to_faces")
    check_ends(face_ends, len(faces), "face_connectivity")
    most = of_cells.max(initial=0)
    if len(cell_ends) != count or not 0 <= of_cells.min(initial=0) <= most < len(face_ends):
        raise ValueError(f"polyhedra of {len(cell_ends)} cells name {most}, of {len(face_ends)} faces.")


def reader(path: pathlib.Path, _: bytes, encoding: Encoding) -> Any:
    new = getattr(vtk("vtkIOXML"), f"vtkXML{encoding.kind}Reader")()
    new.SetFileName(os.fsencode(path))
    return new


def writer(data: Any, encoding: Encoding) -> Any:
    kind = data.GetClassName().removeprefix("vtk")
    writer = getattr(vtk("vtkIOXML"), f"vtkXML{kind}Writer")()
    getattr(writer, f"SetDataModeTo{encoding.mode.capitalize()}")()
    writer.SetEncodeAppendedData(not encoding.is_raw)
    kinds = ("None", "ZLib", "LZ4", "LZMA")
    writer.SetCompressorType(next(k for k, name in enumerate(kinds) if name in (encoding.compressor or "None")))
    getattr(writer, f"SetHeaderTypeTo{encoding.header}")()
    getattr(writer, f"SetByteOrderTo{encoding.order}")()
    return writer


def named_files(path: pathlib.Path) -> list[tuple[str, pathlib.Path]]:
    root = _opened(path.read_bytes()).root
    named = [(each.get("name", ""), each.get("Source") or each.get("file")) for each in root.iter()]
    found = [(name, path.parent / file) for name, file in named if file]
    wrong = [file for _, file in found if file.suffix.lower() not in (".vtu", ".vts", ".vtp")]
    if wrong or not found:
        raise ValueError(f"it names {len(found)} files of meshes" + f" and {wrong[0].name}." * bool(wrong))
    return found


def _arrays(root: ElementTree.Element) -> Iterator[tuple[ElementTree.Element, int]]:
    """Lists all arrays, with the number of rows that each should have, or -1."""
    for grid in root:
        pieces = [part for part in grid if part.tag == "Piece"]
        whole, cells = grid.get("WholeExtent"), [_sizes(piece.get("Extent", "0 -1"))[1] for piece in pieces]
        if whole is not None and sum(cells) != _sizes(whole)[1]:
            raise ValueError(f"its pieces are not those of the extent {whole}: a damaged file, or one cut short.")
        for part in grid:
            sections, rows = (part, _rows(part)) if part.tag == "Piece" else ([part], {})
            for section in sections:
                known = rows.get(section.tag, {})
                for array in section:
                    if array.tag in ("DataArray", "Array"):
                        other = known.get("", array.get("NumberOfTuples", -1))
                        yield array, int(known.get(array.get("Name", ""), other))


def _sizes(extent: str) -> tuple[int, int]:
    """Counts points and cells of a structured grid; an axis of one point has one cell."""
    ends = [int(end) for end in extent.split()]
    steps = [high - low for low, high in zip(ends[::2], ends[1::2], strict=True)]
    return math.prod(step + 1 for step in steps), math.prod(max(step, 1) for step in steps)


def _rows(piece: ElementTree.Element) -> dict[str, dict[str, int]]:
    """Counts the rows of a piece's arrays by section and name; "" stands for any name."""
    extent, kinds = piece.get("Extent"), {kind: int(piece.get(f"NumberOf{kind}", 0)) for kind in SECTIONS[1:]}
    points, cells = int(piece.get("NumberOfPoints", 0)), int(piece.get("NumberOfCells", sum(kinds.values())))
    if extent is not None:
        points, cells = _sizes(extent)
    if min(points, cells, *kinds.values()) < 0:
        raise ValueError(f"{points} points and {cells} cells are announced.")
    rows = {"Points": {"": points}, "PointData": {"": points}, "CellData": {"": cells}}
    return rows | {"Cells": {"offsets": cells, "types": cells}} | {kind: {"offsets": n} for kind, n in kinds.items()}


def _opened(raw: bytes) -> _File:
    at, end = raw.find(b"<AppendedData"), raw.rfind(b"</AppendedData>")
    tag = re.compile(rb"<AppendedData[^>]*>\s*_").match(raw, max(at, 0))
    if at >= 0 and (tag is None or end < tag.end()):
        raise ValueError("no AppendedData that begin with '_' and end: a damaged file, or one cut short.")
    try:
        root = ElementTree.fromstring(raw if tag is None else raw[:at] + b"</VTKFile>")
    except ElementTree.ParseError as error:
        raise ValueError(f"not one of VTK's XML files, or a damaged one ({error}).") from error
    if root.tag != "VTKFile":
        raise ValueError(f"not one of VTK's XML files; it begins with <{root.tag}>.")
    is_raw = tag is not None and b"raw" in tag[0]
    appended = memoryview(raw)[tag.end() : end] if tag else b""
    appended = appended if is_raw else b"".join(bytes(appended).split())
    return _File(root, appended, _encoding(root, is_raw), SMALL + UNPACKED * len(raw))


def _encoding(root: ElementTree.Element, is_raw: bool) -> Encoding:
    formats = {array.get("format", "ascii") for array in root.iter("DataArray")}
    mode = next((mode for mode in ("appended", "binary") if mode in formats), "ascii")
    said = {name: root.get(name) or options[0] for name, options in OPTIONS.items()}
    for name, options in OPTIONS.items():
        if said[name] not in options:
            raise ValueError(f"the {name} {said[name]!r} is none of {', '.join(filter(None, options))}.")
    return Encoding(root.get("type", ""), mode, is_raw, said["compressor"], said["header_type"], said["byte_order"])
