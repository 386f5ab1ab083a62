"""ADF, the older file format of CGNS: its tree of nodes, with h5py's names for HDF5's.

The format is that of cgnslib's ADF core. A file is a heap of parts between tags: a header, nodes,
their tables of children, and chunks of data. A place is a block of 4,096 bytes and an offset in it:
hexadecimal digits in version A, integers in version B.
"""

import math
import pathlib
import re
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from ._text import decoded

BLOCK, NODE, ENTRY, POINTER, TAG = 4096, 246, 44, 12, 4
MAGIC = b"ADF Database Version "
_ORDERS = {b"L": "<", b"B": ">"}
_SIZES = {"int": (110, (4,)), "long": (112, (4, 8)), "float": (114, (4,)), "double": (116, (8,))}
_HEADER_TAGS = {32: b"adf0", 64: b"adf1", 96: b"adf2", 102: b"adf3", 130: b"adf4", 182: b"adf5"}


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

    def __getitem__(self, key: Any) -> np.ndarray:
        parts = []
        for at, count in self.pieces:
            self._file.seek(at)
            parts.append(self._file.read(count))
        values = np.frombuffer(b"".join(parts), self.dtype, self.size).reshape(self.shape)
        return values.astype(self.dtype.newbyteorder("="))[key]

    def __setitem__(self, _: Any, values: np.ndarray) -> None:
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


class Reader:
    """Reads nodes, and records their `spans` of the file: no two may share a byte."""

    def __init__(self, path: pathlib.Path, file: BinaryIO):
        self.path, self.file, self.size = path, file, file.seek(0, 2)
        head = self.read(0, 186)
        self._tagged(head, _HEADER_TAGS)
        self.is_old = head[25:26] != b"B"
        if head[100:101] not in _ORDERS:
            raise ValueError(
                f"{path}: an ADF file with numbers of format {head[100:101].decode(errors='replace')!r}; IEEE's "
                "formats are read: `cgnsconvert`, where the file was written, converts it."
            )
        self.order = _ORDERS[head[100:101]]
        sizes = {name: self.hexadecimal(head[at : at + 2]) for name, (at, _) in _SIZES.items()}
        if any(sizes[name] not in allowed for name, (_, allowed) in _SIZES.items()):
            raise ValueError(f"sizes of numbers are {sizes} bytes")
        kinds = {"I4": "i4", "U4": "u4", "R4": "f4", "R8": "f8", "C1": "i1", "B1": "u1"}
        kinds |= {"I8": f"i{sizes['long']}", "U8": f"u{sizes['long']}"}
        self.kinds = {code: np.dtype(self.order + kind) for code, kind in kinds.items()}
        self.root = self.pointer(head[134:146])
        self.spans = [(0, 186)]

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
        self.spans.sort()
        ends = np.array(self.spans)
        if (ends[1:, 0] < ends[:-1, 1]).any():
            raise ValueError("two parts of the file lie on each other")
        return root

    def read(self, at: int, count: int) -> bytes:
        if at + count > self.size:
            raise ValueError(f"a place {at} beyond the {self.size} bytes of the file")
        self.file.seek(at)
        return self.file.read(count)

    @staticmethod
    def hexadecimal(digits: bytes) -> int:
        if not re.fullmatch(rb"[0-9A-Fa-f]+", digits):
            raise ValueError(f"{digits!r} where hexadecimal digits should stand")
        return int(digits, 16)

    def pointer(self, raw: bytes) -> int:
        return self._integer(raw[:8]) * BLOCK + self._integer(raw[8:])

    def _tagged(self, raw: bytes, tags: dict[int, bytes]) -> None:
        for at, tag in tags.items():
            if raw[at : at + TAG].lower() != tag:
                raise ValueError(f"{raw[at : at + TAG]!r} where {tag!r} should stand")

    def _node(self, at: int, place: str = "") -> tuple[Node, list[int]]:
        raw = self.read(at, NODE)
        self._tagged(raw, {0: b"node", NODE - TAG: b"tail"})
        self.spans.append((at, at + NODE))
        node = Node(decoded(raw[4:36].rstrip(b" \0")), raw[36:68].rstrip())
        code = raw[96:128].strip(b" \0").decode(errors="replace").upper()
        shape = self._shape(raw[128:226])
        pieces = self._pieces(self.hexadecimal(raw[226:230]), raw[230:242])
        if code == "LK":
            target = b"".join(self.read(first, count) for first, count in pieces)[:200].decode(errors="replace")
            raise ValueError(
                f"{self.path}: {place}/{node.name} is a link to {target.strip()}. Only files that hold all of their "
                "data, and without links, are read: `cgnsconvert -l` makes one."
            )
        if code in self.kinds and pieces and shape:
            need = math.prod(shape) * self.kinds[code].itemsize
            if need > sum(count for _, count in pieces):
                raise ValueError(f"{place}/{node.name} has less data than its shape {shape} says")
            node[" data"] = Array(self.file, self.kinds[code], shape, pieces)
        return node, self._entries(self.hexadecimal(raw[68:76]), raw[84:96])

    def _shape(self, raw: bytes) -> tuple[int, ...]:
        """Returns the shape of an array as HDF5 has it: the last number of ADF's first."""
        number = self.hexadecimal(raw[:2])
        if number > 12:
            raise ValueError(f"{number} dimensions of an array")
        sizes = [self._integer(raw[2 + 8 * k : 10 + 8 * k]) for k in range(number)]
        return tuple(sizes[::-1])

    def _integer(self, raw: bytes) -> int:
        return self.hexadecimal(raw) if self.is_old else int(np.frombuffer(raw, self.order + f"u{len(raw)}")[0])

    def _entries(self, number: int, raw: bytes) -> list[int]:
        if not number:
            return []
        table = self._table(self.pointer(raw), (b"sntb", b"snte"), ENTRY * number)
        return [self.pointer(table[k - POINTER : k]) for k in range(ENTRY, len(table) + 1, ENTRY)]

    def _pieces(self, number: int, raw: bytes) -> list[tuple[int, int]]:
        if number < 2:
            return [self._part(self.pointer(raw), (b"data", b"dend"))] if number else []
        pieces = []
        table = self._table(self.pointer(raw), (b"dctb", b"dcte"), 2 * POINTER * number)
        for k in range(0, len(table), 2 * POINTER):
            first, last = (self.pointer(table[k + step : k + step + POINTER]) for step in (0, POINTER))
            at, count = self._part(first, (b"data", b"dend"))
            if last - at > count:
                raise ValueError(f"a chunk of {count} bytes, of which its table says {last - at}")
            pieces.append((at, max(last - at, 0)))
        return pieces

    def _table(self, at: int, tags: tuple[bytes, bytes], need: int) -> bytes:
        first, count = self._part(at, tags)
        if need > count:
            raise ValueError(f"a table of {need} bytes in {count}")
        return self.read(first, need)

    def _part(self, at: int, tags: tuple[bytes, bytes]) -> tuple[int, int]:
        """Finds a part's content, behind the place of the last one, and its number of bytes."""
        raw = self.read(at, TAG + POINTER)
        first, stop = at + len(raw), self.pointer(raw[TAG:])
        self._tagged(raw, {0: tags[0]})
        self._tagged(self.read(stop, TAG), {0: tags[1]})
        if stop < first:
            raise ValueError(f"a part at {at} that ends at {stop}")
        self.spans.append((at, stop + TAG))
        return first, stop - first
