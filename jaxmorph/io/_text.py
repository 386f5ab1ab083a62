"""Numbers in large text files: read in bulk, rounded correctly, and replaced where they stand."""

import io
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import Pair
from jaxmorph._host.package.text import decoded as decoded

Pieces = Iterator[bytes | bytearray | memoryview]
"""A file, piece by piece."""

LONG_TEXT = 1 << 14
"""Bytes from which SciPy's writer of Matrix Market files pays: `repr`'s digits, much faster."""

_FORTRAN = bytes.maketrans(b"Dd", b"ee")


def parse(text: bytes, dtype: type) -> ndarray:
    """Reads a text's numbers up to the first non-number, also with Fortran's exponents, 1.5D-3."""
    if not text.strip():
        return np.zeros(0, dtype)
    if np.issubdtype(dtype, np.floating) and (b"D" in text or b"d" in text):
        text = text.translate(_FORTRAN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(text, dtype, sep=" ")
        except ValueError:
            return np.zeros(0, dtype)


def number_lines(values: ndarray) -> bytes:
    """Writes one number a line, with the fewest digits that read back as the double it is."""
    values = values.astype(float, copy=False)
    if 16 * len(values) < LONG_TEXT:
        return repr(values.tolist())[1:-1].encode().replace(b", ", b"\n")
    import scipy.io  # 40 modules, which a reader does not need

    file = io.BytesIO()
    scipy.io.mmwrite(file, values.reshape(-1, 1), symmetry="general")
    text = file.getvalue()
    head = b"\n%d 1\n" % len(values)
    return text[text.index(head) + len(head) : -1]


WIDEST = 64
"""Bytes of a text that are one row of a table at most."""


def splice(text: bytes, starts: ndarray, ends: ndarray, lines: bytes) -> bytes:
    """Replaces what stands between `starts` and `ends` of a text by `lines`, without line ends.

    Pieces of text and lines alternate. Each is a row of a table as wide as the widest of its kind,
    and the rows are written in turn up to their ends. A long piece becomes several rows, and a line
    follows only the last of them.
    """
    begins = np.append(0, ends[:-1])
    rows = 1 + (starts - begins) // WIDEST
    last = np.cumsum(rows) - 1
    place = np.repeat(begins - WIDEST * (last + 1 - rows), rows) + WIDEST * np.arange(rows.sum())
    own = _gather_bytes(text, place, np.minimum(np.repeat(starts, rows) - place, WIDEST))
    breaks = np.append(np.flatnonzero(np.frombuffer(lines, np.uint8) == ord("\n")), len(lines))
    first, size = np.zeros((2, len(place)), np.int64)
    first[last] = np.append(0, breaks[:-1] + 1)
    size[last] = breaks - first[last]
    table, inside = (
        np.concatenate(pair, axis=1)
        for pair in zip(own, _gather_bytes(lines, first, size), strict=True)
    )
    return table[inside].tobytes() + text[ends[-1] :]


def _gather_bytes(text: bytes, starts: ndarray, sizes: ndarray) -> Pair:
    """Gathers bytes from each of `starts`, as wide as the longest; a mask marks own bytes."""
    width = max(int(sizes.max()), 1)
    windows = ndarray(len(text) + 1, f"V{width}", text + bytes(width), strides=(1,))
    return windows[starts].view(np.uint8).reshape(-1, width), np.arange(width) < sizes[:, None]


CHUNK = 1 << 20
"""Bytes looked at together: all tables made of them stay in a core's own cache."""


class Section(NamedTuple):
    """Marks the bytes `start` to `stop` of a file's text, and names the line of anything in it."""

    path: Path
    text: bytes
    start: int
    stop: int

    @property
    def content(self) -> bytes:
        return self.text[self.start : self.stop]

    def error(self, message: str, row: int | None = None) -> ValueError:
        """Makes a `ValueError` that names file and line: of that row, or before the section."""
        return ValueError(f"{self.path}, line {self._line(row)}: {message}")

    def _line(self, row: int | None) -> int:
        line = sum(chunk.count(b"\n") for chunk in line_chunks(self.text, 0, self.start))
        if row is None:
            return max(line, 1)
        for number, content in enumerate(self._lines(), start=line + 1):
            row -= bool(content.strip())
            if row < 0:
                return number
        return line

    def _lines(self) -> Iterator[bytes]:
        for chunk in line_chunks(self.text, self.start, self.stop):
            yield from chunk.removesuffix(b"\n").split(b"\n")

    def blocks(self, dtype: type) -> Iterator["NumberRows"]:
        row = 0
        for chunk in line_chunks(self.text, self.start, self.stop):
            counts = scan(chunk)[2]
            values = parse(chunk, dtype)
            if len(values) != counts.sum():
                raise self._not_a_number(dtype)
            if len(counts):
                yield NumberRows(self, values, counts, row)
            row += len(counts)

    def rows(self, dtype: type) -> "NumberRows":
        blocks = [NumberRows(self, np.zeros(0, dtype), np.zeros(0, np.int64)), *self.blocks(dtype)]
        values, counts = (
            [getattr(block, name) for block in blocks] for name in ("values", "counts")
        )
        return NumberRows(self, np.concatenate(values), np.concatenate(counts))

    def _not_a_number(self, dtype: type) -> ValueError:
        kind, what = (
            (int, "an integer") if np.issubdtype(dtype, np.integer) else (float, "a number")
        )
        for row, line in enumerate(line for line in self._lines() if line.strip()):
            for word in line.split():
                try:
                    kind(word.translate(_FORTRAN))
                except ValueError:
                    return self.error(
                        f"found {word[:40].decode(errors='replace')!r} in place of {what}.", row
                    )
        return self.error("the rows that follow hold something that is not a number.")


class NumberRows(NamedTuple):
    """Lines of a section with numbers, from number `row` on: all `values`, `counts` a line."""

    section: Section
    values: ndarray
    counts: ndarray
    row: int = 0

    @property
    def first(self) -> ndarray:
        return np.cumsum(self.counts) - self.counts

    def refuse(self, wrong: Any, message: str | Callable[[int], str]) -> None:
        """Raises `ValueError` for the first of the rows `wrong`, ids or a mask."""
        rows = np.flatnonzero(wrong) if wrong.dtype == bool else wrong
        if len(rows):
            row = int(rows[0])
            raise self.section.error(
                message if isinstance(message, str) else message(row), self.row + row
            )

    def behind_count(self, message: str) -> "NumberRows":
        """Returns all lines but the first, which has their number; else raises `ValueError`."""
        if not len(self.counts) or self.counts[0] != 1 or self.values[0] != len(self.counts) - 1:
            raise self.section.error(message, 0)
        return self._replace(values=self.values[1:], counts=self.counts[1:], row=1)

    def by_kind(
        self, column: int, sizes: Mapping[int, int], n: int, more: int = 0
    ) -> Iterator[tuple[int, ndarray, ndarray]]:
        """Yields each type of elements in a column, its rows, and their numbers up to the nodes.

        These are 0 to n - 1, so many of each type as `sizes` says. An index follows if `more` is 1.
        """
        self.refuse(self.counts <= column, "an element's type and nodes expected.")
        kinds = self.values[self.first + column]
        for kind in dict.fromkeys(kinds.tolist()):
            rows = np.flatnonzero(kinds == kind)
            size = sizes.get(kind, 0)
            known = f"element type {kind} is not known; known are {', '.join(map(str, sizes))}."
            self.refuse(rows[: 0 if size else 1], known)
            width = column + 1 + size
            message = (
                f"an element of type {kind} has {size} nodes: {width} "
                f"numbers{' and an index' * more} expected."
            )
            self.refuse(rows[self.counts[rows] != width + more], message)
            table = self.values[self.first[rows, None] + np.arange(width)]
            nodes = table[:, column + 1 :]
            is_foreign = ((nodes < 0) | (nodes >= n)).any(axis=1)
            self.refuse(rows[is_foreign], f"there are nodes 0 to {n - 1}, and others here.")
            yield kind, rows, table


def blank_out(pattern: bytes, text: bytes) -> bytes:
    """Puts blanks in the place of what matches, byte for byte: comments."""
    return re.sub(pattern, lambda found: b" " * len(found[0]), text)


def split_sections(path: Path, text: bytes, pattern: bytes) -> Iterator[tuple[Any, Section]]:
    """Yields each match of a pattern, and the section up to the next one, or to the end."""
    heads = list(re.finditer(pattern, text))
    stops = [*(head.start() for head in heads[1:]), len(text)]
    for head, stop in zip(heads, stops, strict=False):
        yield head, Section(path, text, min(head.end(), stop), stop)


def line_chunks(text: bytes, start: int, stop: int) -> Iterator[bytes]:
    """Yields the text from `start` to `stop` in pieces of whole lines, about `CHUNK` bytes each."""
    while start < stop:
        end = text.find(b"\n", min(start + CHUNK, stop - 1), stop) + 1 or stop
        yield text[start:end]
        start = end


def scan(chunk: bytes) -> tuple[ndarray, ndarray, ndarray]:
    """Finds where a chunk's words begin and end, and how many each line has that has any."""
    codes = np.frombuffer(chunk, np.uint8)
    blank = np.ones(len(codes) + 2, bool)
    np.less_equal(codes, 32, out=blank[1:-1])
    change = np.flatnonzero(blank[1:] != blank[:-1])
    starts = change[0::2]
    ends = change[1::2]
    line_ends = np.append(np.flatnonzero(codes == 10), len(codes))
    counts = np.diff(np.searchsorted(starts, line_ends), prepend=0)
    return starts, ends, counts[counts > 0]


def replace_numbers(
    text: bytes,
    part: slice,
    old: ndarray,
    values: ndarray,
    *,
    at: ndarray | None = None,
    plain: Callable[[bytes], bytes] = bytes,
    form: Callable[[ndarray], bytes] = number_lines,
    columns: int = 0,
) -> Pieces:
    """Yields the text, in pieces, with `values` in place of the `old` numbers in a part of it.

    `at` are the places of these numbers among all words of the part, ascending; None for all words.
    `plain` turns what stands between numbers into blanks, byte for byte. An unchanged number keeps
    its digits; changed ones are written by `form`, one a line: by default the shortest digits that
    read back bit for bit. A number takes at least so many `columns`, to the end of the old one.
    """
    words = 0
    done = 0
    yield memoryview(text)[: part.start]
    for chunk in line_chunks(text, part.start, part.stop):
        numbers = plain(chunk)
        starts, ends, _ = scan(numbers)
        chosen = np.arange(len(starts))
        if at is not None:
            chosen = at[slice(*np.searchsorted(at, (words, words + len(starts))))] - words
        here = slice(done, done + len(chosen))
        new = values[here]
        changed = np.flatnonzero(new != old[here].astype(new.dtype))
        last = ends[chosen[changed]]
        first = np.minimum(starts[chosen[changed]], last - columns)
        yield splice(chunk, first, last, form(new[changed])) if len(changed) else chunk
        words = words + len(starts)
        done = done + len(chosen)
    yield memoryview(text)[part.stop :]
