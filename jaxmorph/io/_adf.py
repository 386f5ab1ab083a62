"""ADF, the older file format of CGNS: its tree of nodes, with h5py's names for HDF5's.

The format is that of cgnslib's ADF core. A file is a heap of parts between tags: a header, nodes,
their tables of children, and chunks of data. A place is a block of 4,096 bytes and an offset in it:
hexadecimal digits in version A, integers in version B.
"""

import math
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy import ndarray

from ._text import decoded

BLOCK, ENTRY, POINTER, TAG = 4096, 44, 12, 4
MAGIC = b"ADF Database Version "
_ORDERS = {b"L": "<", b"B": ">"}
_HEADER_TAGS = {32: b"adf0", 64: b"adf1", 96: b"adf2", 102: b"adf3", 130: b"adf4", 182: b"adf5"}
_NODE = struct.Struct("4x 32s 32s 8s 8x 12s 32s 2s 96s 4s 12s 4x")
"""Name, label, number and table of children, type and number of dimensions, sizes, number and table of data."""


class Array:
    """A node's numbers, read and written in place: bytes `(at, count)` of the file, in pieces."""

    def __init__(
        self,
        file: BinaryIO,
        dtype: np.dtype,
        shape: tuple[int, ...],
        pieces: list[tuple[int, int]],
        attrs: Mapping[str, bytes] | None = None,
    ):
        self._file, self.dtype, self.pieces, self.attrs = file, dtype, pieces, attrs or {}
        self.shape, self.size = shape, math.prod(shape)

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
        self.name, self.attrs = name, {"label": label}


def check_spans(spans: list[tuple[int, int]], size: int) -> None:
    """Raises `ValueError` for parts of a file that share a byte, or lie beyond its end."""
    places = np.array(sorted(spans))
    if (places[1:, 0] < places[:-1, 1]).any() or places[places[:, 0] < places[:, 1], 1].max() > size:
        raise ValueError("parts of the file lie in one another, or beyond its end")


def hexadecimal(digits: bytes) -> int:
    if not re.fullmatch(rb"[0-9A-Fa-f]+", digits):
        raise ValueError(f"{digits!r} where hexadecimal digits should stand")
    return int(digits, 16)


class Reader:
    """Reads nodes, and records their `spans` of the file: no two may share a byte."""

    def __init__(self, path: Path, file: BinaryIO):
        self.path, self.file, self.size, self.spans = path, file, file.seek(0, 2), [(0, 186)]
        head = self._read(0, 186)
        self._tagged(head, _HEADER_TAGS)
        self.is_old, code, long = head[25:26] != b"B", head[100:101], hexadecimal(head[112:114])
        if code not in _ORDERS:
            raise ValueError(
                f"{path}: an ADF file with numbers of format {code.decode(errors='replace')!r}; IEEE's "
                "formats are read: `cgnsconvert`, where the file was written, converts it."
            )
        if long not in (4, 8):
            raise ValueError(f"long numbers of {long} bytes")
        self.order = _ORDERS[code]
        kinds = {
            "I4": "i4",
            "U4": "u4",
            "R4": "f4",
            "R8": "f8",
            "C1": "i1",
            "B1": "u1",
            "I8": f"i{long}",
            "U8": f"u{long}",
        }
        self.kinds = {code: np.dtype(self.order + kind) for code, kind in kinds.items()}
        self.root = self._pointer(head[134:146])

    def tree(self) -> Node:
        """Reads the tree of an open file, without arrays; refuses links, cycles and damage."""
        root, below = self._node(self.root)
        waiting, seen = [(root, "", below)], {self.root}
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
        return self._integer(raw[:8]) * BLOCK + self._integer(raw[8:])

    def _integer(self, raw: bytes) -> int:
        return hexadecimal(raw) if self.is_old else int(np.frombuffer(raw, f"{self.order}u{len(raw)}")[0])

    def _tagged(self, raw: bytes, tags: dict[int, bytes]) -> None:
        for at, tag in tags.items():
            if raw[at : at + TAG].lower() != tag:
                raise ValueError(f"{raw[at : at + TAG]!r} where {tag!r} should stand")

    def _node(self, at: int, place: str = "") -> tuple[Node, list[int]]:
        raw = self._read(at, _NODE.size)
        self._tagged(raw, {0: b"node", _NODE.size - TAG: b"tail"})
        self.spans.append((at, at + len(raw)))
        name, label, children, below, kind, dimensions, sizes, chunks, data = _NODE.unpack(raw)
        node = Node(decoded(name.rstrip(b" \0")), label.rstrip())
        code = kind.strip(b" \0").decode(errors="replace").upper()
        pieces = self._pieces(hexadecimal(chunks), data)
        if code == "LK":
            target = b"".join(self._read(first, count) for first, count in pieces)[:200].decode(errors="replace")
            raise ValueError(
                f"{self.path}: {place}/{node.name} is a link to {target.strip()}. Only files that hold all of their "
                "data, and without links, are read: `cgnsconvert -l` makes one."
            )
        # HDF5 has the last number of ADF's sizes first
        shape = tuple(self._integer(sizes[8 * k : 8 * k + 8]) for k in reversed(range(hexadecimal(dimensions))))
        if code in self.kinds and pieces and shape:
            need = math.prod(shape) * self.kinds[code].itemsize
            if need > sum(count for _, count in pieces):
                raise ValueError(f"{place}/{node.name} has less data than its shape {shape} says")
            node[" data"] = Array(self.file, self.kinds[code], shape, pieces)
        tags = (b"sntb", b"snte")
        entries = self._table(below, tags, ENTRY, hexadecimal(children))
        return node, [self._pointer(entry[-POINTER:]) for entry in entries]

    def _pieces(self, number: int, raw: bytes) -> list[tuple[int, int]]:
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

    def _part(self, raw: bytes, tags: tuple[bytes, bytes]) -> tuple[int, int]:
        """Finds a part's content, behind the place of the last one, and its number of bytes."""
        at = self._pointer(raw)
        head = self._read(at, TAG + POINTER)
        first, stop = at + len(head), self._pointer(head[TAG:])
        self._tagged(head, {0: tags[0]})
        self._tagged(self._read(stop, TAG), {0: tags[1]})
        if stop < first:
            raise ValueError(f"a part at {at} that ends at {stop}")
        self.spans.append((at, stop + TAG))
        return first, stop - first
