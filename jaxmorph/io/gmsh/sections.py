"""The sections of a .msh file, and the numbers in them, of a text or a binary file alike."""

import codecs
import dataclasses
import pathlib
import re
from collections.abc import Iterator

import numpy as np

from ..text.digits import decoded
from ..text.sections import Section

WHOLE = 2.0**53
"""Numbers of a text beyond it may not be whole."""

_NAME = re.compile(rb'\s*(?:(\d+)\s+)?(\d+)\s+(?:"(.*)"|(\S+))\s*')

Names = dict[tuple[int | None, int], str]
"""Names of physical groups by dimension and tag; None: of any dimension."""


@dataclasses.dataclass(frozen=True)
class Form:
    """A file's version (1, 2, 4.0, 4.1), text or binary, byte order and bytes of a size.

    In version 2.0 itself, without `has_levels`, names of groups may come without a dimension.
    """

    version: float
    is_text: bool
    order: str
    size: int
    has_levels: bool = True

    def dtype(self, kind: str) -> np.dtype:
        """Returns the type of a binary number: `i` for an int, `n` for a size, `d` for a double."""
        return np.dtype(f"{self.order}{ {'i': 'i4', 'n': f'u{self.size}', 'd': 'f8'}[kind] }")


def form_of(path: pathlib.Path, data: bytes) -> Form:
    """Reads `$MeshFormat`; version 1 begins with `$NOD` in its place.

    It raises `ValueError` where other sections than comments come first.
    """
    at, number = 0, 1
    while (line := data[at : data.find(b"\n", at) + 1 or None]).strip() == b"$Comments":
        ended = re.compile(rb"^[ \t]*\$EndComments[ \t\r]*$", re.MULTILINE).search(data, at)
        after = data.find(b"\n", ended.end()) + 1 if ended else 0
        at, number = after or len(data), number + data.count(b"\n", at, after)
    if line.strip() == b"$NOD":
        return Form(1.0, True, "<", 8)
    if line.strip() != b"$MeshFormat":
        mark = " The file begins with a byte order mark: save it without." if data.startswith(codecs.BOM_UTF8) else ""
        first = line.decode(errors="replace").strip()[:40]
        raise ValueError(f"{path}, line {number}: not a .msh file; $MeshFormat is expected here, not {first!r}.{mark}")
    start = at + len(line)
    stop = data.find(b"\n", start) + 1
    words = data[start:stop].split()
    try:
        version, binary, size = float(words[0]), int(words[1]), int(words[2])
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path}: version, 0 or 1, and the size of a number expected after $MeshFormat.") from error
    known = next(
        (form for form, low, high in ((2.0, 2, 3), (4.0, 4, 4.1), (4.1, 4.1, 4.2)) if low <= version < high), None
    )
    if known is None or binary not in (0, 1) or size not in (4, 8):
        raise ValueError(f"{path}: .msh of version {version:g}, {binary}, {size}; 1, 2, 4.0 and 4.1 are read.")
    one = {b"\x01\0\0\0": "<", b"\0\0\0\x01": ">"}.get(data[stop : stop + 4])
    if binary and one is None:
        raise ValueError(f"{path}: a binary .msh file without the number 1 that tells its byte order.")
    order = one if binary and one else "<"
    return Form(known, not binary, order, size if known == 4.1 else 8, has_levels=version > 2)


def sections(path: pathlib.Path, data: bytes, form: Form) -> Iterator[tuple[str, Section]]:
    """Yields the name of each section and its content; `ValueError` for one without an end."""
    at = data.index(b"$MeshFormat" if form.version > 1 else b"$NOD")
    while (at := data.find(b"$", at)) >= 0:
        start = data.find(b"\n", at) + 1
        name = data[at + 1 : start].strip()
        stop = data.find((b"$END" if name in (b"NOD", b"ELM") else b"$End") + name, start)
        if start == 0 or stop < 0:
            raise ValueError(
                f"{path}: ${name.decode(errors='replace')[:40]} has no end: the file is damaged or cut short."
            )
        yield name.decode(errors="replace"), Section(path, data, start, stop)
        at = stop + 4 + len(name)


def physical_names(section: Section, form: Form) -> Names:
    """Reads the names of physical groups by dimension and tag."""
    rows = [row for row in section.text[section.start : section.stop].split(b"\n") if row.strip()]
    matches = [_NAME.fullmatch(row) for row in rows[1:]]
    if not rows or not rows[0].strip().isdigit() or int(rows[0]) != len(matches) or None in matches:
        raise section.error(
            f"{len(rows) - 1} lines in $PhysicalNames that name a group, or not; as many as announced expected."
        )
    names: Names = {}
    for row, match in enumerate(filter(None, matches), start=1):
        if form.has_levels and match[1] is None:
            raise section.error("a dimension, a tag and a name expected.", row)
        text = match[3] if match[3] is not None else match[4]
        names[None if match[1] is None else int(match[1]), int(match[2])] = decoded(text)
    return names


class Stream:
    """Goes through a section's numbers: `at` counts numbers of a text, bytes of a binary file."""

    def __init__(self, section: Section, form: Form, dtype: type = np.int64):
        self.section, self.form, self.data = section, form, section.text
        self.at, self.stop, self.rows = section.start, section.stop, None
        if form.is_text:
            self.rows = section.rows(dtype)
            self.at, self.stop = 0, len(self.rows.values)

    def width(self, kind: str) -> int:
        """Returns how far a number of a kind takes `at`."""
        return 1 if self.rows is not None else self.form.dtype(kind).itemsize

    def skip(self, count: int, width: int) -> int:
        """Goes over so many things, each `width` wide; returns where the first one begins."""
        if count < 0 or count * width > self.stop - self.at:
            raise ValueError(f"the section ends before the {count} entries that it announces")
        self.at += count * width
        return self.at - count * width

    def take(self, kind: str, count: int) -> np.ndarray:
        """Reads so many numbers; ints and sizes become int64."""
        start = self.skip(count, self.width(kind))
        if self.rows is None:
            return np.frombuffer(self.data, self.form.dtype(kind), count, start).astype("f8" if kind == "d" else "i8")
        values = self.rows.values[start : start + count]
        return values if kind == "d" else whole(values)

    def one(self, kind: str) -> int:
        return int(self.take(kind, 1)[0])

    def announced(self) -> int:
        """Reads the number on a section's first line of version 2, text in a binary file too."""
        if self.rows is not None:
            return self.one("n")
        end = self.data.index(b"\n", self.at, self.stop) + 1
        number = int(self.data[self.at : end])
        self.at = end
        return number

    def points(self, places: np.ndarray) -> np.ndarray:
        """Reads the coordinates (n, 3) that begin at places."""
        if self.rows is not None:
            return self.rows.values[places[:, None] + np.arange(3)]
        points = np.empty((len(places), 3))
        for rows, step in runs(places):
            shape = rows.stop - rows.start, 3
            points[rows] = np.ndarray(shape, self.form.dtype("d"), self.data, places[rows.start], (step, 8))
        return points

    def end(self) -> None:
        """Raises `ValueError` where there is more: a binary section ends by one line end."""
        rest = b"" if self.rows is not None else self.data[self.at : self.stop]
        if (self.rows is not None and self.at != self.stop) or rest.strip() or (self.rows is None and not rest):
            raise ValueError("there is more, or less, than the section announces")


def runs(places: np.ndarray) -> Iterator[tuple[slice, int]]:
    """Yields the rows whose places are equally far apart, and how far."""
    steps = np.diff(places)
    ends = np.flatnonzero(np.diff(steps)) + 1
    first = 0
    while first < len(places):
        after = np.searchsorted(ends, first, "right")
        last = int(ends[after]) + 1 if after < len(ends) else len(places)
        yield slice(first, last), int(steps[first]) if first < len(steps) else 0
        first = last


def whole(values: np.ndarray) -> np.ndarray:
    """Returns numbers as int64; raises `ValueError` for numbers that are not whole."""
    if values.dtype.kind == "f" and not ((values == np.floor(values)) & (np.abs(values) < WHOLE)).all():
        raise ValueError("a number that is not whole where a tag or a count is expected")
    return values.astype(np.int64)
