"""The sections of a .msh file, text or binary: nodes, elements, physical groups."""

import codecs
import dataclasses
import pathlib
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from jaxmorph._host.cells.topology import DIMENSION, NODES

from .._text import Section, decoded

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


TYPES = {1: "line", 2: "triangle", 3: "quad", 4: "tetra", 5: "hexahedron", 6: "wedge", 7: "pyramid", 15: "vertex"}
TYPES |= {
    **{8: "line3", 9: "triangle6", 10: "quad9", 11: "tetra10", 12: "hexahedron27", 13: "wedge18", 14: "pyramid14"},
    **{16: "quad8", 17: "hexahedron20", 18: "wedge15", 19: "pyramid13", 26: "line4", 21: "triangle10", 36: "quad16"},
    **{29: "tetra20", 90: "wedge40", 92: "hexahedron64", 118: "pyramid30", 27: "line5", 23: "triangle15"},
    **{37: "quad25", 30: "tetra35", 91: "wedge75", 93: "hexahedron125", 119: "pyramid55"},
}
"""Types of cells by gmsh's numbers."""
CORNERS_OF = NODES | {"vertex": 1}
RUN = 1 << 16
"""Rows of varying width that are looked at together."""

Groups = dict[tuple[int, int], list[int]]
"""Tags of the physical groups of an entity, by its dimension and tag."""


class Nodes(NamedTuple):
    """Tags (n,) of nodes, and places of their x (n,): numbers of a text, bytes of a binary file."""

    tags: np.ndarray
    places: np.ndarray


@dataclasses.dataclass(frozen=True)
class Elements:
    """Elements of one type: node tags (k, corners), rows by physical group; None is all rows."""

    kind: str
    corners: np.ndarray
    groups: dict[int, np.ndarray | None]


def entities(stream: Stream, *, is_partitioned: bool) -> Groups:
    """Reads the physical groups of entities, or of the pieces into which a partition cuts them."""
    groups: Groups = {}
    if is_partitioned:
        stream.one("n")
        stream.take("i", 2 * stream.one("n"))  # ghost entities
    for dimension, count in enumerate(stream.take("n", 4).tolist()):
        for _ in range(count):
            tag = stream.one("i")
            if is_partitioned:
                stream.take("i", 2)  # the entity that it is a piece of
                stream.take("i", stream.one("n"))
            stream.take("d", 3 if dimension == 0 and stream.form.version > 4 else 6)
            groups[dimension, tag] = np.abs(stream.take("i", stream.one("n"))).tolist()
            if dimension:
                stream.take("i", stream.one("n"))  # its boundary
    stream.end()
    return groups


def nodes(stream: Stream, *, is_parametric: bool) -> Nodes:
    """Reads the nodes of `$Nodes`, of version 2's `$ParametricNodes`, or of version 1's `$NOD`."""
    version = stream.form.version
    if version < 4:
        total = stream.announced()
        blocks = [_with_parameters(stream, total) if is_parametric else _records(stream, total, 3)]
    else:
        count, total, *_ = stream.take("n", 4 if version > 4 else 2).tolist()
        blocks = [_block(stream) for _ in range(count)]
    stream.end()
    empty = np.zeros(0, np.int64)
    tags, places = (np.concatenate([empty, *(block[k] for block in blocks)]) for k in (0, 1))
    if len(tags) != total:
        raise ValueError(f"{len(tags)} nodes, and {total} announced")
    if (np.diff(tags) <= 0).any() and (again := total - len(np.unique(tags))):
        raise ValueError(f"{again} tags of nodes come a second time")
    return Nodes(tags, places)


def _block(stream: Stream) -> Nodes:
    """Reads one entity's nodes; as many parameters as its dimension may follow each."""
    first, second, is_parametric = stream.take("i", 3).tolist()
    count, dimension = stream.one("n"), first if stream.form.version > 4 else second
    if dimension not in range(4) or is_parametric not in (0, 1):
        raise ValueError(f"a block of nodes of dimension {dimension}, parametric {is_parametric}")
    width = 3 + dimension * is_parametric
    if stream.form.version < 4.1:
        return _records(stream, count, width)
    tags, step = stream.take("n", count), width * stream.width("d")
    return Nodes(tags, stream.skip(count, step) + step * np.arange(count))


def _records(stream: Stream, count: int, width: int) -> Nodes:
    """Reads rows of a tag and `width` numbers."""
    step = stream.width("i") + width * stream.width("d")
    start = stream.skip(count, step)
    return Nodes(whole(_column(stream, start, count, step)), start + stream.width("i") + step * np.arange(count))


def _column(stream: Stream, start: int, count: int, step: int) -> np.ndarray:
    """Returns ints `step` apart unchanged; in a text file they are floats."""
    if stream.rows is not None:
        return stream.rows.values[start : start + count * step : step]
    return np.ndarray((count,), stream.form.dtype("i"), stream.data, start, (step,))


def _with_parameters(stream: Stream, total: int) -> Nodes:
    """Reads rows of tag, coordinates, entity (dimension, tag), and parameters (curve 1, surface 2).

    Rows of one width are read together.
    """
    head, double = 3 * stream.width("i") + 3 * stream.width("d"), stream.width("d")
    before = stream.width("i") + 3 * double
    tags, places = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    while total > 0:
        stream.skip(1, head)
        stream.at -= head
        dimension = int(whole(_column(stream, stream.at + before, 1, 1))[0])
        if dimension not in range(4):
            raise ValueError(f"a node on an entity of dimension {dimension}")
        step = head + dimension % 3 * double
        count = min(total, RUN, (stream.stop - stream.at) // step)
        others = np.flatnonzero(_column(stream, stream.at + before, count, step) != dimension) if count else np.zeros(0)
        count = int(others[0]) if len(others) else count
        start = stream.skip(max(count, 1), step)
        tags.append(whole(_column(stream, start, count, step)))
        places.append(start + stream.width("i") + step * np.arange(count))
        total -= count
    return Nodes(np.concatenate(tags), np.concatenate(places))


def elements(stream: Stream, groups: Groups) -> list[Elements]:
    """Reads the elements."""
    if stream.form.version < 4:
        return _numbered(stream) if stream.rows is None else _lines(stream)
    blocks, total, *_ = stream.take("n", 4 if stream.form.version > 4 else 2).tolist()
    result, kind_of_number = [], "n" if stream.form.version > 4 else "i"
    for _ in range(blocks):
        first, second, number = stream.take("i", 3).tolist()
        count, kind = stream.one("n"), _kind(number)
        entity = (first, second) if stream.form.version > 4 else (second, first)
        if (0 if kind == "vertex" else DIMENSION.get(kind, entity[0])) != entity[0]:
            raise ValueError(f"elements of type {kind} on an entity of dimension {entity[0]}")
        width = 1 + CORNERS_OF[kind]
        stream.skip(count, width * stream.width(kind_of_number))
        stream.at -= count * width * stream.width(kind_of_number)
        rows = stream.take(kind_of_number, count * width).reshape(count, width)
        result.append(Elements(kind, rows[:, 1:], dict.fromkeys(groups.get(entity, ()))))
    stream.end()
    if sum(len(block.corners) for block in result) != total:
        raise ValueError(f"not the {total} elements that $Elements announces")
    return result


def _kind(number: int) -> str:
    if number not in TYPES:
        raise ValueError(
            f"elements of type {number}; elements of order 1 to 4 are read, from order 3 on with all inner nodes: "
            "Mesh.SecondOrderIncomplete=0 makes them"
        )
    return TYPES[number]


def _lines(stream: Stream) -> list[Elements]:
    """Reads lines of number, type, tags and nodes: version 2 in text, and version 1.

    In version 2 the number of tags comes before them, in version 1 that of nodes behind two tags.
    """
    assert stream.rows is not None
    values, counts, first = stream.rows.values, stream.rows.counts, stream.rows.first
    if not len(counts) or counts[0] != 1 or values[0] != len(counts) - 1:
        raise stream.section.error(f"{len(counts) - 1} lines of elements, not as many as announced.", 0)
    counts, first, is_first = counts[1:], first[1:], stream.form.version < 2
    head = 5 if is_first else 3
    if (counts < head).any():
        line = 1 + int((counts < head).argmax())
        raise stream.section.error("an element has a number, a type, and numbers of tags or of nodes.", line)
    numbers, tags = values[first + 1], np.zeros_like(first) if is_first else values[first + 2]
    known, place = np.unique(numbers, return_inverse=True)
    corners = np.array([CORNERS_OF[_kind(number)] for number in known.tolist()], np.int64)[place]
    wanted = head + tags + corners
    wrong = np.flatnonzero((counts != wanted) | (tags < 0) | (is_first & (values[first + head - 1] != corners)))
    if len(wrong):
        raise stream.section.error(f"{counts[wrong[0]]} numbers, {wanted[wrong[0]]} expected.", 1 + int(wrong[0]))
    result = []
    for number in dict.fromkeys(numbers.tolist()):
        rows = np.flatnonzero(numbers == number)
        corners = (first + head + tags)[rows][:, None] + np.arange(CORNERS_OF[TYPES[number]])
        table = [np.where(tags[rows] > k, values[first[rows] + 3 + np.minimum(k, tags[rows])], 0) for k in (0, 1)]
        table = [values[first[rows] + 2 + k] for k in (0, 1)] if is_first else table
        result.append(_of_version_2(TYPES[number], values[corners], np.stack(table)))
    return result


def _numbered(stream: Stream) -> list[Elements]:
    """Reads blocks of a type, a number of elements and one of tags: version 2, binary."""
    left, blocks = stream.announced(), []
    while left > 0:
        number, count, tags = stream.take("i", 3).tolist()
        if count < 0 or tags < 0:
            raise ValueError(f"{count} elements with {tags} tags")
        width = 1 + tags + CORNERS_OF[_kind(number)]
        rows = stream.take("i", count * width).reshape(count, width)
        table = np.zeros((2, count), np.int64)
        table[: min(tags, 2)] = rows[:, 1 : 1 + min(tags, 2)].T
        blocks.append((TYPES[number], rows[:, 1 + tags :], table))
        left -= count
    stream.end()
    if left:
        raise ValueError("more elements than announced")
    result = []
    for kind in dict.fromkeys(kind for kind, _, _ in blocks):
        of_kind = [(corners, table) for other, corners, table in blocks if other == kind]
        corners, table = np.concatenate([rows for rows, _ in of_kind]), np.hstack([tags for _, tags in of_kind])
        result.append(_of_version_2(kind, corners, table))
    return result


def _of_version_2(kind: str, corners: np.ndarray, table: np.ndarray) -> Elements:
    """Finds groups of elements: `table` (2, k) has tags of physical group (0: none) and entity.

    In version 2 an element of two groups stands twice, with the second group: it is read once.
    """
    physical, entity = np.abs(table[0]), table[1]
    tags = np.unique(physical[physical > 0]).tolist()
    groups: dict[int, np.ndarray | None] = {tag: np.flatnonzero(physical == tag) for tag in tags}
    if len(tags) < 2:
        return Elements(kind, corners, groups)
    # An element's key is its entity and corners. Equal keys are one element, kept where it comes
    # first; `new` is the row of each old element among the kept ones.
    keys = np.column_stack([entity, corners, physical])
    first, which = np.unique(keys[:, :-1], axis=0, return_index=True, return_inverse=True)[1:]
    if len(first) == len(keys) or len(np.unique(keys, axis=0)) < len(keys):
        return Elements(kind, corners, groups)  # what stands twice in one group is told as a fault
    order = np.sort(first)
    new = np.searchsorted(order, first)[which.ravel()]
    return Elements(kind, corners[order], {tag: new[rows] for tag, rows in groups.items()})
