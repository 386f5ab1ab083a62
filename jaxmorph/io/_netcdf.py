"""Classic netCDF files (CDF-1, CDF-2, CDF-5): arrays by name as in h5py, read and written in place.

The format is that of Unidata's "NetCDF Classic Format Specification": a header of dimensions,
attributes and variables with their places, all numbers with the most significant byte first.
"""

import itertools
import math
import pathlib
from typing import Any, BinaryIO

import numpy as np

from .cgns.adf import Array

MAGIC = b"CDF"
_TYPES = {1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8", 7: "u1", 8: ">u2", 9: ">u4", 10: ">i8", 11: ">u8"}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
_UNSTATED = 2**32 - 4
"""Bytes of a variable from which on the header of an older file cannot state its size."""


def is_classic(path: pathlib.Path) -> bool:
    """Checks whether a file begins as a classic netCDF file."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


class Variable(Array):
    """An array with its attributes that are text."""

    def __init__(self, file: BinaryIO, dtype: np.dtype, shape: tuple[int, ...], at: int, attrs: dict[str, bytes]):
        super().__init__(file, dtype, shape, [(at, dtype.itemsize * math.prod(shape))])
        self.attrs = attrs


def tree(file: BinaryIO) -> dict[str, Any]:
    """Reads the header of an open file: its variables by name, without records of time.

    A dimension without a variable of its name is an array of its length that has no numbers, as in
    netCDF-4. It raises `ValueError` for what lies beyond the file, or in two variables.
    """
    return _Header(file).tree()


class _Header:
    """Reads the header of a file from its beginning to its end."""

    def __init__(self, file: BinaryIO):
        self.file, self.size = file, file.seek(0, 2)
        file.seek(0)
        version = self.taken(4)[3]
        if version not in (1, 2, 5):
            raise ValueError(f"version {version} of netCDF; 1, 2 and 5 are read")
        self.count, self.place = (8 if version == 5 else 4), (4 if version == 1 else 8)

    def taken(self, count: int) -> bytes:
        """Reads some bytes, and the bytes that fill them up to a multiple of four."""
        data = self.file.read(-(-count // 4) * 4) if count <= self.size else b""
        if len(data) < count:
            raise ValueError("the header goes beyond the end of the file")
        return data[:count]

    def number(self, width: int) -> int:
        return int.from_bytes(self.taken(width), "big")

    def name(self) -> str:
        return self.taken(self.number(self.count)).decode()

    def entries(self, tag: int) -> range:
        """Reads the head of a list: a tag and a count, or zeros for a list that is absent."""
        found, count = self.number(4), self.number(self.count)
        if found != tag and (found, count) != (0, 0):
            raise ValueError(f"a list of tag {found} where {tag} is expected")
        return range(count)

    def attributes(self) -> dict[str, bytes]:
        """Reads a list of attributes; numbers are left out."""
        texts = {}
        for _ in self.entries(_ATTRIBUTES):
            name, kind = self.name(), np.dtype(_TYPES[self.number(4)])
            data = self.taken(self.number(self.count) * kind.itemsize)
            if kind.kind == "S":
                texts[name] = data
        return texts

    def tree(self) -> dict[str, Any]:
        self.number(self.count)  # of records
        dimensions = [(self.name(), self.number(self.count)) for _ in self.entries(_DIMENSIONS)]
        self.attributes()
        variables, spans = [], []
        for _ in self.entries(_VARIABLES):
            name = self.name()
            sizes = [dimensions[self.number(self.count)][1] for _ in range(self.number(self.count))]
            attributes, kind = self.attributes(), np.dtype(_TYPES[self.number(4)])
            stated, at = self.number(self.count), self.number(self.place)
            if sizes[:1] == [0]:  # one number a record: they stand behind all else
                spans.append((at, at))
                continue
            size = kind.itemsize * math.prod(sizes)
            if stated not in (size, -(-size // 4) * 4) and size < _UNSTATED:
                raise ValueError(f"{name} has {stated} bytes, {size} expected")
            variables.append((name, Variable(self.file, kind, tuple(sizes) or (1,), at, attributes)))
            spans.append((at, at + size))
        spans = sorted([(0, self.file.tell()), *spans])
        if any(after < end for (_, end), (after, _) in itertools.pairwise(spans)) or any(
            start < end and end > self.size for start, end in spans
        ):
            raise ValueError("variables lie in one another, or beyond the end of the file")
        names = [name for name, _ in dimensions], [name for name, _ in variables]
        if any(len(set(several)) < len(several) for several in names):
            raise ValueError("two dimensions or two variables of one name")
        lengths = {name: Variable(self.file, np.dtype("i1"), (length,), 0, {}) for name, length in dimensions}
        return lengths | dict(variables)
