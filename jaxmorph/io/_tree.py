"""The tree of a CGNS, MED or Exodus file, in HDF5, in ADF or in classic netCDF.

ADF is that of cgnslib's core, the older format of CGNS. A file is a heap of parts between tags: a
header, nodes, their tables of children, and chunks of data. A place is a block of 4,096 bytes and
an offset in it: hexadecimal digits in version A, integers in version B.

Classic netCDF is CDF-1, CDF-2 and CDF-5 of Unidata's "NetCDF Classic Format Specification": a
header of dimensions, attributes and variables with their places, and big-endian numbers.
"""

import contextlib
import dataclasses
import math
import re
import shutil
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy import ndarray

try:
    import h5py
    from h5py import h5l  # pyright: ignore[reportAttributeAccessIssue]
except ImportError as error:
    raise ImportError("CGNS, MED and Exodus files need h5py: pip install 'jaxmorph[io]'") from error

from ._format import FilePoints
from ._text import decoded

CGNS_FILE = "a CGNS file in HDF5 or ADF"
Span = tuple[int, int]
Spans = list[Span]
"""Two places in a file, or a place and a number of bytes."""


@contextlib.contextmanager
def open_tree(path: Path, writes: bool = False, what: str = CGNS_FILE) -> Iterator[Any]:
    """Yields the root of a file's tree as h5py has it: groups with `label`, arrays as " data".

    `what` names the format in messages. Raises `ValueError` for another format, and for a file that
    is damaged or has data elsewhere, which a copy would share.
    """
    try:
        with path.open("r+b" if writes else "rb") as file:
            magic = file.read(TAG_SIZE + len(ADF))
            if magic.startswith(CDF):
                yield _Header(file).tree()
            elif magic.endswith(ADF):
                yield Reader(path, file).tree()
            else:
                with h5py.File(path, "r+" if writes else "r") as tree:
                    _refuse_foreign_data(path, tree)
                    yield tree
    except Exception as error:  # HDF5 answers damage by a dozen classes
        if writes or (isinstance(error, ValueError) and str(path) in str(error)):
            raise
        detail = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not {what}, or a damaged one ({detail}).") from error


def _refuse_foreign_data(path: Path, file: Any) -> None:
    def elsewhere(name: bytes) -> str | None:
        kind = file.id.links.get_info(name).type
        if kind == h5l.TYPE_EXTERNAL:
            return f"/{decoded(name)} is a link to {decoded(file.id.links.get_val(name)[0])}"
        child = file[name] if kind == h5l.TYPE_HARD else None
        if isinstance(child, h5py.Dataset) and (child.external or child.is_virtual):
            other = child.external[0][0] if child.external else "other data sets"
            return f"/{decoded(name)} keeps its values in {other}"
        return None

    found = file.id.links.visit(elsewhere)  # each link once, though groups may hold each other
    if found:
        remedy = (
            "Only files that hold all of their data are read: `h5repack` or `cgnsconvert` make one."
        )
        raise ValueError(f"{path}: {found[-200:]}. {remedy}")


def read_text(value: Any) -> str:
    """Decodes a text in a file: what stands before its first zero, without blanks around."""
    return (
        value
        if isinstance(value, str)
        else decoded(np.asarray(value).tobytes().split(b"\0")[0]).strip()
    )


def take_only(groups: Mapping[str, Any], what: str) -> tuple[str, Any]:
    if len(groups) != 1:
        raise ValueError(f"{len(groups)} {what} in the file, one is read")
    return next(iter(groups.items()))


def read_labels(group: Any, name: str, n: int) -> ndarray | None:
    """Reads the file's own numbers of its n nodes; None where it has none."""
    if name not in group:
        return None
    labels = group[name][()]
    if labels.shape != (n,):
        raise ValueError(f"{labels.size} numbers of nodes for {n} of them")
    return labels


class Coordinates(NamedTuple):
    """An array of a file's points at `rows` and `columns`: (n, d) if `by_rows`, else by columns."""

    array: Any
    rows: slice
    columns: slice
    by_rows: bool = False


Find = Callable[[Any], Iterable[Coordinates]]
"""Finds the coordinates in the root of a file's tree."""


@dataclasses.dataclass(frozen=True, eq=False)
class TreePoints(FilePoints):
    """The points of a file that is written as a copy, into which the new ones are put.

    - `path`, `find`, `what`: the file, what finds coordinates in it, and its name in messages.
    - `stamp`: size and time of the file, by which a changed one is found.
    """

    path: Path
    find: Find
    what: str
    stamp: Span

    @classmethod
    def of(cls, path: Path, tree: Any, find: Find, what: str = CGNS_FILE) -> "TreePoints":
        coordinates = list(find(tree))
        n = max(each.rows.stop for each in coordinates)
        d = max(each.columns.stop for each in coordinates)
        points = np.full((n, d), np.nan)
        for array, rows, columns, by_rows in coordinates:
            width = columns.stop - columns.start
            points[rows, columns] = array[()] if by_rows else array[()].reshape(width, -1).T
        singles = [each[1:3] for each in coordinates if each.array.dtype.itemsize < 8]
        return cls(points, path, find, what, _read_stamp(path), singles=singles)

    @property
    def is_current(self) -> bool:
        return _read_stamp(self.path) == self.stamp

    def write(self, path: Path, points: ndarray) -> None:
        """Copies the file, and puts the mesh's points into the copy.

        NumPy rounds them, since HDF5 rounds ties otherwise. A file with data in another one is
        refused before it is copied.
        """
        with open_tree(self.path, what=self.what):
            pass
        shutil.copyfile(self.path, path)
        points = self.in_file(points)
        if np.array_equal(points, self.points):
            return
        with open_tree(path, writes=True, what=self.what) as tree:
            for array, rows, columns, by_rows in self.find(tree):
                new = points[rows, columns]
                if not np.array_equal(new, self.points[rows, columns]):
                    shape = array.shape
                    array[...] = (new if by_rows else new.T).reshape(shape).astype(array.dtype)


def _read_stamp(path: Path) -> Span:
    status = path.stat()
    return status.st_size, status.st_mtime_ns


ADF_BLOCK = 4096
ENTRY = 44
POINTER = 12
TAG_SIZE = 4
ADF = b"ADF Database Version "
_ADF_ORDERS = {b"L": "<", b"B": ">"}
_HEADER_TAGS = {32: b"adf0", 64: b"adf1", 96: b"adf2", 102: b"adf3", 130: b"adf4", 182: b"adf5"}
_NODE = struct.Struct("4x 32s 32s 8s 8x 12s 32s 2s 96s 4s 12s 4x")
"""A node's name, label, number and table of children, type, number of sizes, sizes, its data."""


class Array:
    """A node's numbers, read and written in place: bytes `(at, count)` of the file, in pieces."""

    def __init__(
        self,
        file: BinaryIO,
        dtype: np.dtype,
        shape: tuple[int, ...],
        pieces: Spans,
        attrs: Mapping[str, bytes] | None = None,
    ):
        self._file = file
        self.dtype = dtype
        self.pieces = pieces
        self.attrs = attrs or {}
        self.shape = shape
        self.size = math.prod(shape)

    def __getitem__(self, key: Any) -> ndarray:
        parts = []
        for at, count in self.pieces:
            self._file.seek(at)
            parts.append(self._file.read(count))
        values = np.frombuffer(b"".join(parts), self.dtype, self.size).reshape(self.shape)
        return values.astype(self.dtype.newbyteorder("="))[key]

    def __setitem__(self, _: Any, values: ndarray) -> None:
        raw = np.ascontiguousarray(values, self.dtype).tobytes()
        for at, count in self.pieces:
            self._file.seek(at)
            self._file.write(raw[:count])
            raw = raw[count:]


class Node(dict[str, Any]):
    """A node: its children by name, and its `Array` as " data", if it has one."""

    def __init__(self, name: str, label: bytes):
        super().__init__()
        self.name = name
        self.attrs = {"label": label}


def check_spans(spans: Spans, size: int) -> None:
    """Raises `ValueError` for parts of a file that share a byte, or lie beyond its end."""
    places = np.array(sorted(spans))
    if (places[1:, 0] < places[:-1, 1]).any() or places[
        places[:, 0] < places[:, 1], 1
    ].max() > size:
        raise ValueError("parts of the file lie in one another, or beyond its end")


def parse_hexadecimal(digits: bytes) -> int:
    if not re.fullmatch(rb"[0-9A-Fa-f]+", digits):
        raise ValueError(f"{digits!r} where hexadecimal digits should stand")
    return int(digits, 16)


class Reader:
    """Reads nodes, and records their `spans` of the file: no two may share a byte."""

    def __init__(self, path: Path, file: BinaryIO):
        self.path = path
        self.file = file
        self.size = file.seek(0, 2)
        self.spans = [(0, 186)]
        head = self._read(0, 186)
        self._tagged(head, _HEADER_TAGS)
        self.is_old = head[25:26] != b"B"
        code = head[100:101]
        long = parse_hexadecimal(head[112:114])
        if code not in _ADF_ORDERS:
            raise ValueError(
                f"{path}: an ADF file with numbers of format {code.decode(errors='replace')!r}; "
                "IEEE's "
                "formats are read: `cgnsconvert`, where the file was written, converts it."
            )
        if long not in (4, 8):
            raise ValueError(f"long numbers of {long} bytes")
        self.order = _ADF_ORDERS[code]
        kinds = {"I4": "i4", "U4": "u4", "R4": "f4", "R8": "f8", "C1": "i1", "B1": "u1"}
        kinds |= {"I8": f"i{long}", "U8": f"u{long}"}
        self.kinds = {code: np.dtype(self.order + kind) for code, kind in kinds.items()}
        self.root = self._pointer(head[134:146])

    def tree(self) -> Node:
        """Reads the tree of an open file, without arrays; refuses links, cycles and damage."""
        root, below = self._node(self.root)
        waiting = [(root, "", below)]
        seen = {self.root}
        while waiting:
            node, place, entries = waiting.pop()
            for at in entries:
                if at in seen:
                    raise ValueError(f"a node of {place or '/'} stands at two places of the tree")
                seen.add(at)
                child, below = self._node(at, place)
                if child.name in node:
                    raise ValueError(f"{place or '/'} has two nodes {child.name}")
                node[child.name] = child
                waiting.append((child, f"{place}/{child.name}", below))
        check_spans(self.spans, self.size)
        return root

    def _read(self, at: int, count: int) -> bytes:
        if at + count > self.size:
            raise ValueError(f"a place {at} beyond the {self.size} bytes of the file")
        self.file.seek(at)
        return self.file.read(count)

    def _pointer(self, raw: bytes) -> int:
        return self._integer(raw[:8]) * ADF_BLOCK + self._integer(raw[8:])

    def _integer(self, raw: bytes) -> int:
        return (
            parse_hexadecimal(raw)
            if self.is_old
            else int(np.frombuffer(raw, f"{self.order}u{len(raw)}")[0])
        )

    def _tagged(self, raw: bytes, tags: dict[int, bytes]) -> None:
        for at, tag in tags.items():
            if raw[at : at + TAG_SIZE].lower() != tag:
                raise ValueError(f"{raw[at : at + TAG_SIZE]!r} where {tag!r} should stand")

    def _node(self, at: int, place: str = "") -> tuple[Node, list[int]]:
        raw = self._read(at, _NODE.size)
        self._tagged(raw, {0: b"node", _NODE.size - TAG_SIZE: b"tail"})
        self.spans.append((at, at + len(raw)))
        name, label, children, below, kind, dimensions, sizes, chunks, data = _NODE.unpack(raw)
        node = Node(decoded(name.rstrip(b" \0")), label.rstrip())
        code = decoded(kind.strip(b" \0")).upper()
        pieces = self._pieces(parse_hexadecimal(chunks), data)
        if code == "LK":
            target = b"".join(self._read(first, count) for first, count in pieces)[:200].decode(
                errors="replace"
            )
            raise ValueError(
                f"{self.path}: {place}/{node.name} is a link to {target.strip()}. Only files that "
                "hold all of their "
                "data, and without links, are read: `cgnsconvert -l` makes one."
            )
        # HDF5 has the last number of ADF's sizes first
        shape = tuple(
            self._integer(sizes[8 * k : 8 * k + 8])
            for k in reversed(range(parse_hexadecimal(dimensions)))
        )
        if code in self.kinds and pieces and shape:
            need = math.prod(shape) * self.kinds[code].itemsize
            if need > sum(count for _, count in pieces):
                raise ValueError(f"{place}/{node.name} has less data than its shape {shape} says")
            node[" data"] = Array(self.file, self.kinds[code], shape, pieces)
        entries = self._table(below, (b"sntb", b"snte"), ENTRY, parse_hexadecimal(children))
        return node, [self._pointer(entry[-POINTER:]) for entry in entries]

    def _pieces(self, number: int, raw: bytes) -> Spans:
        if number < 2:
            return [self._part(raw, (b"data", b"dend"))] if number else []
        pieces = []
        for entry in self._table(raw, (b"dctb", b"dcte"), 2 * POINTER, number):
            at, count = self._part(entry[:POINTER], (b"data", b"dend"))
            used = max(self._pointer(entry[POINTER:]) - at, 0)
            if used > count:
                raise ValueError(f"a chunk of {count} bytes, of which its table says {used}")
            pieces.append((at, used))
        return pieces

    def _table(self, raw: bytes, tags: tuple[bytes, bytes], width: int, number: int) -> list[bytes]:
        """Reads so many rows of a table, if any, whose place is in `raw`."""
        if not number:
            return []
        first, count = self._part(raw, tags)
        if width * number > count:
            raise ValueError(f"a table of {width * number} bytes in {count}")
        return [self._read(first + k * width, width) for k in range(number)]

    def _part(self, raw: bytes, tags: tuple[bytes, bytes]) -> Span:
        """Finds a part's content, behind the place of the last one, and its number of bytes."""
        at = self._pointer(raw)
        head = self._read(at, TAG_SIZE + POINTER)
        first = at + len(head)
        stop = self._pointer(head[TAG_SIZE:])
        self._tagged(head, {0: tags[0]})
        self._tagged(self._read(stop, TAG_SIZE), {0: tags[1]})
        if stop < first:
            raise ValueError(f"a part at {at} that ends at {stop}")
        self.spans.append((at, stop + TAG_SIZE))
        return first, stop - first


CDF = b"CDF"
CDF_TYPES = ("", "i1", "S1", ">i2", ">i4", ">f4", ">f8", "u1", ">u2", ">u4", ">i8", ">u8")
"""Types of numbers by CDF's codes, from 1 on."""
_DIMENSIONS = 10
_VARIABLES = 11
_ATTRIBUTES = 12
_UNSTATED = 2**32 - 4
"""Bytes of a variable from which on the header of an older file cannot state its size."""


class _Header:
    def __init__(self, file: BinaryIO):
        self.file = file
        self.size = file.seek(0, 2)
        file.seek(0)
        version = self.taken(4)[3]
        if version not in (1, 2, 5):
            raise ValueError(f"version {version} of netCDF; 1, 2 and 5 are read")
        self.count = 8 if version == 5 else 4
        self.place = 4 if version == 1 else 8

    def taken(self, count: int) -> bytes:
        """Reads some bytes, and the bytes that fill them up to a multiple of four."""
        data = self.file.read(-(-count // 4) * 4) if count <= self.size else b""
        if len(data) < count:
            raise ValueError("the header goes beyond the end of the file")
        return data[:count]

    def number(self, width: int = 0) -> int:
        return int.from_bytes(self.taken(width or self.count), "big")

    def entries(self, tag: int) -> Iterator[str]:
        """Yields names of a list: behind a tag and a count, or zeros for a list that is absent."""
        found = self.number(4)
        count = self.number()
        if found != tag and (found, count) != (0, 0):
            raise ValueError(f"a list of tag {found} where {tag} is expected")
        names = set()
        for _ in range(count):
            name = self.taken(self.number()).decode()
            if name in names:
                raise ValueError(f"two dimensions, variables or attributes are called {name}")
            names.add(name)
            yield name

    def attributes(self) -> dict[str, bytes]:
        texts = {}
        for name in self.entries(_ATTRIBUTES):
            kind = np.dtype(CDF_TYPES[self.number(4)])
            texts[name] = self.taken(self.number() * kind.itemsize)
        return texts

    def tree(self) -> dict[str, Array]:
        """Reads the variables by name, without records of time.

        A dimension without a variable of its name is an empty array of its length, as in netCDF-4.
        Raises `ValueError` for what lies beyond the file, or in two variables.
        """
        self.number()  # of records
        lengths = {name: self.number() for name in self.entries(_DIMENSIONS)}
        self.attributes()
        arrays = {
            name: self._variable(name, [*lengths.values()]) for name in self.entries(_VARIABLES)
        }
        pieces = [(at, at + size) for array in arrays.values() for at, size in array.pieces]
        check_spans([(0, self.file.tell()), *pieces], self.size)
        # a record has none
        arrays = {name: array for name, array in arrays.items() if array.shape[0]}
        return {
            name: Array(self.file, np.dtype("i1"), (n,), []) for name, n in lengths.items()
        } | arrays

    def _variable(self, name: str, lengths: list[int]) -> Array:
        """Reads the place of a variable; one of a number each record stands behind all else."""
        sizes = [lengths[self.number()] for _ in range(self.number())] or [1]
        attributes = self.attributes()
        kind = np.dtype(CDF_TYPES[self.number(4)])
        stated = self.number()
        at = self.number(self.place)
        size = kind.itemsize * math.prod(sizes)
        if sizes[0] and stated not in (size, -(-size // 4) * 4) and size < _UNSTATED:
            raise ValueError(f"{name} has {stated} bytes, {size} expected")
        return Array(self.file, kind, tuple(sizes), [(at, size)], attributes)
