"""Words, numbers and texts of a legacy VTK file, in text or binary, one after the other."""

import dataclasses
import re

import numpy as np

from ..text.digits import parse
from ..text.sections import scan

TYPES = {
    **{"signed_char": "i1", "char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2"},
    **{"int": "i4", "unsigned_int": "u4", "vtkidtype": "i4", "long": "i8", "unsigned_long": "u8"},
    **{"long_long": "i8", "unsigned_long_long": "u8", "float": "f4", "double": "f8", "bit": "u1"},
    **{f"vtktype{sign}int{8 * size}": f"{sign[:1] or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
}
"""VTK's names of types; it writes ids as `vtktypeint64`, and reads `vtkIdType` as four bytes."""


@dataclasses.dataclass
class Scanner:
    """Goes through a file: `at` is where it stands, `section` the last line that began one."""

    data: bytes
    at: int
    is_text: bool
    section: str = ""

    def line(self) -> str:
        """Returns the next line, whatever it holds; empty at the end of the file."""
        end = self.data.find(b"\n", self.at) + 1 or len(self.data)
        text, self.at = self.data[self.at : end], end
        return text.decode(errors="replace")

    def words(self) -> list[str]:
        """Returns the words of the next line with any, without metadata; none at the end."""
        while self.at < len(self.data):
            words = self.line().split()
            if words == ["METADATA"]:
                while self.line().strip():
                    pass
            elif words:
                return words
        return []

    def numbers(self, count: int, kind: str, *, is_bit: bool = False) -> np.ndarray:
        """Reads so many numbers of a type of NumPy; the line ends behind them."""
        if count < 0:
            raise ValueError(f"{count} numbers announced")
        values = self._text(count, kind) if self.is_text else self._binary(count, kind, is_bit)
        rest = re.compile(rb"[ \t\r]*(\n|\Z)").match(self.data, self.at)
        if rest is None:
            raise ValueError(f"more than the {count} numbers announced")
        self.at = rest.end()
        return values

    def _text(self, count: int, kind: str) -> np.ndarray:
        """Reads so many numbers of a text: the blanks between them show where they end."""
        dtype = np.float64 if kind[0] == "f" else np.uint64 if kind == "u8" else np.int64
        parts, left = [np.zeros(0, dtype)], count
        while left:
            size = min(24 * left, 1 << 20)
            chunk = self.data[self.at : (self.data.find(b"\n", self.at + size) + 1) or len(self.data)]
            _, ends, _ = scan(chunk)
            if not len(ends):
                raise ValueError(f"{count - left} numbers, {count} announced")
            end = int(ends[min(left, len(ends)) - 1])
            parts.append(parse(chunk[:end], dtype))
            if len(parts[-1]) != min(left, len(ends)):
                raise ValueError(f"something that is not a number, or {count - left} numbers and not {count}")
            left -= len(parts[-1])
            self.at += end
        values = np.concatenate(parts)
        with np.errstate(over="ignore"):
            result = values.astype(kind)
        if kind[0] != "f" and not np.array_equal(result, values):
            raise ValueError(f"a number beyond the range of its type, {np.dtype(kind).name}")
        return result

    def _binary(self, count: int, kind: str, is_bit: bool) -> np.ndarray:
        """Reads numbers of a binary file, largest byte first; bits are packed, eight a byte."""
        dtype = np.dtype(kind).newbyteorder(">")
        number = -(-count // 8) if is_bit else count
        if number * dtype.itemsize > len(self.data) - self.at:
            raise ValueError(f"the file ends before the {count} numbers announced")
        values = np.frombuffer(self.data, dtype, number, self.at)
        self.at += values.nbytes
        return np.unpackbits(values)[:count] if is_bit else values.astype(kind)

    def array(self, rows: int, columns: int, name: str) -> np.ndarray:
        """Reads an array of so many rows of a type by VTK's name."""
        name = name.lower()
        values = self.numbers(rows * columns, TYPES[name], is_bit=name == "bit")
        return values if columns == 1 else values.reshape(rows, columns)

    def strings(self, count: int) -> None:
        """Goes over strings: a line each in a text, length and bytes in a binary file.

        The length has 1 to 8 bytes, as its first two bits tell.
        """
        for _ in range(count):
            if self.is_text:
                self.line()
            else:
                size = {3: 1, 2: 2, 1: 4, 0: 8}[self.data[self.at] >> 6]
                head = int.from_bytes(self.data[self.at : self.at + size], "big")
                self.at += size + (head & ((1 << (8 * size - 2)) - 1))
        if not self.is_text:
            self.line()
