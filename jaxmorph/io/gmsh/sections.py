"""The sections of a .msh file, text or binary: nodes, elements, physical groups."""

import codecs
import dataclasses
import pathlib
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxmorph._host.cells.topology import DIMENSION, NODES
from jaxmorph._mesh.exchange import gathered

from .._text import Rows, Section, decoded

WHOLE = 2.0**53
"""Numbers of a text beyond it may not be whole."""

_NAME = re.compile(rb'\s*(?:(\d+)\s+)?(\d+)\s+(?:"(.*)"|(\S+))\s*')
_COMMENTS = rb"(?:[ \t]*\$Comments[ \t\r]*\n(?s:.*?)^[ \t]*\$EndComments[ \t\r]*(?:\n|\Z))*"
VERSIONS = ((2.0, 2, 3), (4.0, 4, 4.1), (4.1, 4.1, 4.2))
"""Versions that are read, and the ranges of their numbers in files."""
ORDERS = {b"\x01\0\0\0": "<", b"\0\0\0\x01": ">"}
"""Byte orders, and the number 1 in four bytes."""

Names = dict[tuple[int | None, int], str]
"""Names of physical groups by dimension and tag; None: of any dimension."""


@dataclasses.dataclass(frozen=True)
class Form:
    """A file's version (1, 2, 4.0, 4.1), text or binary, byte order and bytes of a size.

    In version 2.0 itself, without `has_levels`, names of groups may come without a dimension.
    """

    version: float
    is_text: bool
    order: str = "<"
    size: int = 8
    has_levels: bool = True

    @property
    def types(self) -> dict[str, np.dtype]:
        return {key: np.dtype(self.order + kind) for key, kind in (("i", "i4"), ("n", f"u{self.size}"), ("d", "f8"))}


def form_of(path: pathlib.Path, data: bytes) -> Form:
    """Reads `$MeshFormat`; version 1 begins with `$NOD` in its place."""
    comments = re.match(_COMMENTS, data, re.MULTILINE)
    start = comments.end() if comments else 0
    line, _, rest = data[start : start + 400].partition(b"\n")
    if line.strip() == b"$NOD":
        return Form(1.0, True)
    if line.strip() != b"$MeshFormat":
        mark = " The file begins with a byte order mark: save it without." if data.startswith(codecs.BOM_UTF8) else ""
        number, first = 1 + data.count(b"\n", 0, start), line.decode(errors="replace").strip()[:40]
        raise ValueError(f"{path}, line {number}: not a .msh file; $MeshFormat is expected here, not {first!r}.{mark}")
    words, _, rest = rest.partition(b"\n")
    return _format(path, words, rest[:4])


def _format(path: pathlib.Path, words: bytes, one: bytes) -> Form:
    try:
        version, binary, size = (kind(word) for kind, word in zip((float, int, int), words.split(), strict=False))
    except ValueError as error:
        raise ValueError(f"{path}: version, 0 or 1, and the size of a number expected after $MeshFormat.") from error
    known = [form for form, low, high in VERSIONS if low <= version < high]
    if not known or binary not in (0, 1) or size not in (4, 8):
        raise ValueError(f"{path}: .msh of version {version:g}, {binary}, {size}; 1, 2, 4.0 and 4.1 are read.")
    order = ORDERS.get(one) if binary else "<"
    if order is None:
        raise ValueError(f"{path}: a binary .msh file without the number 1 that tells its byte order.")
    return Form(known[0], not binary, order, size if known == [4.1] else 8, has_levels=version > 2)


def sections(path: pathlib.Path, data: bytes, form: Form) -> Iterator[tuple[str, Section]]:
    at = data.index(b"$MeshFormat" if form.version > 1 else b"$NOD")
    while (at := data.find(b"$", at)) >= 0:
        start = data.find(b"\n", at) + 1
        name = data[at + 1 : start].strip()
        stop = data.find((b"$END" if name in (b"NOD", b"ELM") else b"$End") + name, start)
        if start == 0 or stop < 0:
            raise ValueError(f"{path}: ${name.decode(errors='replace')[:40]} has no end: the file is cut short.")
        yield name.decode(errors="replace"), Section(path, data, start, stop)
        at = stop + 4 + len(name)


def physical_names(section: Section, form: Form) -> Names:
    count, *rows = [row for row in section.content.split(b"\n") if row.strip()] or [b""]
    matches = list(filter(None, map(_NAME.fullmatch, rows)))
    if not count.strip().isdigit() or not int(count) == len(rows) == len(matches):
        raise section.error(f"{len(rows)} lines of names in $PhysicalNames; as many as announced expected.")
    bare = [row for row, match in enumerate(matches, start=1) if form.has_levels and match[1] is None]
    if bare:
        raise section.error("a dimension, a tag and a name expected.", bare[0])
    return {(int(match[1]) if match[1] else None, int(match[2])): decoded(match[4] or match[3]) for match in matches}


class Stream:
    """Goes through a section's numbers; those of a text are taken as bytes of `dtype`."""

    def __init__(self, section: Section, form: Form, dtype: type = np.int64):
        self.section, self.version, self.types, self.rows = section, form.version, form.types, None
        self.data, self.at, self.stop = section.text, section.start, section.stop
        if form.is_text:
            self.rows = section.rows(dtype)
            self.data, self.at, self.stop = self.rows.values, 0, self.rows.values.nbytes
            self.types = dict.fromkeys(form.types, np.dtype(dtype))

    def width(self, kinds: str) -> int:
        return sum(self.types[kind].itemsize for kind in kinds)

    def skip(self, count: int, width: int) -> int:
        if count < 0 or count * width > self.stop - self.at:
            raise ValueError(f"the section ends before the {count} entries that it announces")
        self.at += count * width
        return self.at - count * width

    def take(self, kind: str, count: int) -> np.ndarray:
        values = self.column(kind, self.skip(count, self.width(kind)), count)
        return values.astype(float) if kind == "d" else whole(values)

    def column(self, kind: str, start: int, count: int, step: int | None = None) -> np.ndarray:
        """Views numbers `step` bytes apart, or side by side."""
        dtype = self.types[kind]
        return np.ndarray((count,), dtype, self.data, start, (dtype.itemsize if step is None else step,))

    def one(self, kind: str) -> int:
        return int(self.take(kind, 1)[0])

    def announced(self) -> int:
        if self.rows is not None:
            return self.one("n")
        end = self.section.text.index(b"\n", self.at, self.stop) + 1
        number, self.at = int(self.section.text[self.at : end]), end
        return number

    def end(self) -> None:
        """Raises `ValueError` where there is more: a binary section ends by one line end."""
        rest = self.section.text[self.at : self.stop]
        if self.at != self.stop if self.rows is not None else rest.strip() or not rest:
            raise ValueError("there is more, or less, than the section announces")


def triples(data: Any) -> np.ndarray:
    """Views 24 bytes, three doubles, at every byte where they may begin, as one element each."""
    return np.ndarray((max(memoryview(data).nbytes - 23, 0),), "V24", data, strides=(1,))


def whole(values: np.ndarray) -> np.ndarray:
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

Groups = dict[tuple[int, int], list[int]]
"""Tags of the physical groups of an entity, by its dimension and tag."""


class Nodes(NamedTuple):
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
            stream.take("d", 3 if dimension == 0 and stream.version > 4 else 6)
            groups[dimension, tag] = np.abs(stream.take("i", stream.one("n"))).tolist()
            if dimension:
                stream.take("i", stream.one("n"))  # its boundary
    stream.end()
    return groups


def nodes(stream: Stream, *, is_parametric: bool) -> Nodes:
    """Reads the nodes of `$Nodes`, of version 2's `$ParametricNodes`, or of version 1's `$NOD`."""
    if stream.version < 4:
        total = stream.announced()
        blocks = [_with_parameters(stream, total) if is_parametric else _records(stream, total, "iddd")]
    else:
        count, total, *_ = stream.take("n", 4 if stream.version > 4 else 2).tolist()
        blocks = [_block(stream) for _ in range(count)]
    stream.end()
    tags, places = (np.concatenate([np.zeros(0, np.int64), *column]) for column in zip(*blocks, strict=True))
    if len(tags) != total:
        raise ValueError(f"{len(tags)} nodes, and {total} announced")
    if (np.diff(tags) <= 0).any() and (again := total - len(np.unique(tags))):
        raise ValueError(f"{again} tags of nodes come a second time")
    return Nodes(tags, places)


def _entity(stream: Stream) -> tuple[int, int, int]:
    """Reads an entity's dimension and tag (in version 4.0 swapped), and a number."""
    first, second, third = stream.take("i", 3).tolist()
    return (first, second, third) if stream.version > 4 else (second, first, third)


def _block(stream: Stream) -> Nodes:
    """Reads one entity's nodes; as many parameters as its dimension may follow each."""
    dimension, _, is_parametric = _entity(stream)
    count = stream.one("n")
    if dimension not in range(4) or is_parametric not in (0, 1):
        raise ValueError(f"a block of nodes of dimension {dimension}, parametric {is_parametric}")
    kinds = "d" * (3 + dimension * is_parametric)
    if stream.version < 4.1:
        return _records(stream, count, f"i{kinds}")
    tags, step = stream.take("n", count), stream.width(kinds)
    return Nodes(tags, stream.skip(count, step) + step * np.arange(count))


def _records(stream: Stream, count: int, kinds: str) -> Nodes:
    step = stream.width(kinds)
    start = stream.skip(count, step)
    tags = whole(stream.column("i", start, count, step))
    return Nodes(tags, start + stream.width("i") + step * np.arange(count))


def _with_parameters(stream: Stream, total: int) -> Nodes:
    """Reads rows of tag, coordinates, entity (dimension, tag), parameters (curve 1, surface 2)."""
    found = [Nodes(np.zeros(0, np.int64), np.zeros(0, np.int64))]
    while total > 0:
        stream.at = stream.skip(1, stream.width("idddii"))
        place = stream.at + stream.width("iddd")
        dimension = int(whole(stream.column("i", place, 1))[0])
        if dimension not in range(4):
            raise ValueError(f"a node on an entity of dimension {dimension}")
        kinds = "idddii" + "d" * (dimension % 3)
        step = stream.width(kinds)
        count = max(min(total, RUN, (stream.stop - stream.at) // step), 1)
        others = np.flatnonzero(stream.column("i", place, count, step) != dimension)
        count = int(others[0]) if len(others) else count
        found.append(_records(stream, count, kinds))
        total -= count
    return Nodes(*map(np.concatenate, zip(*found, strict=True)))


def elements(stream: Stream, groups: Groups) -> list[Elements]:
    if stream.version < 4:
        lines = _lines(stream, stream.rows) if stream.rows else _numbered(stream)
        tables = gathered((kind, np.column_stack([corners, tags])) for kind, corners, tags in lines)
        return [_of_version_2(kind, table[:, :-2], table[:, -2:]) for kind, table in tables.items()]
    blocks, total, *_ = stream.take("n", 4 if stream.version > 4 else 2).tolist()
    result = [_of_entity(stream, groups) for _ in range(blocks)]
    stream.end()
    if sum(len(block.corners) for block in result) != total:
        raise ValueError(f"not the {total} elements that $Elements announces")
    return result


def _of_entity(stream: Stream, groups: Groups) -> Elements:
    dimension, tag, number = _entity(stream)
    count, kind = stream.one("n"), _kind(number)
    if (0 if kind == "vertex" else DIMENSION.get(kind, dimension)) != dimension:
        raise ValueError(f"elements of type {kind} on an entity of dimension {dimension}")
    width, numbers = 1 + CORNERS_OF[kind], "n" if stream.version > 4 else "i"
    stream.at = stream.skip(count, width * stream.width(numbers))
    rows = stream.take(numbers, count * width).reshape(count, width)
    return Elements(kind, rows[:, 1:], dict.fromkeys(groups.get((dimension, tag), ())))


def _kind(number: int) -> str:
    if number not in TYPES:
        raise ValueError(
            f"elements of type {number}; elements of order 1 to 4 are read, from order 3 on with all inner nodes: "
            "Mesh.SecondOrderIncomplete=0 makes them"
        )
    return TYPES[number]


def _lines(stream: Stream, rows: Rows) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yields types, corners (k, c) and two tags (k, 2): of version 2 in text, and of version 1.

    Lines are number, type, tags and nodes. In version 2 the number of tags comes before them, in
    version 1 that of nodes behind two tags.
    """
    if not len(rows.counts) or rows.counts[0] != 1 or rows.values[0] != len(rows.counts) - 1:
        raise stream.section.error(f"{len(rows.counts) - 1} lines of elements, not as many as announced.", 0)
    values, counts, first = rows.values, rows.counts[1:], rows.first[1:]
    is_first = stream.version < 2
    head = 5 if is_first else 3
    message = "an element has a number, a type, and numbers of tags or of nodes."
    rows.refuse(1 + np.flatnonzero(counts < head), lambda k: message)
    numbers, tags = values[first + 1], np.zeros_like(first) if is_first else values[first + 2]
    known, place = np.unique(numbers, return_inverse=True)
    corners = np.array([CORNERS_OF[_kind(number)] for number in known.tolist()], np.int64)[place]
    wanted = head + tags + corners
    wrong = (counts != wanted) | (tags < 0) | (is_first & (values[first + head - 1] != corners))
    rows.refuse(1 + np.flatnonzero(wrong), lambda k: f"{counts[k - 1]} numbers, {wanted[k - 1]} expected.")
    given = 2 if is_first else tags[:, None]
    places = first[:, None] + (2 if is_first else 3) + np.arange(2)
    table = np.where(given > np.arange(2), values[np.minimum(places, len(values) - 1)], 0)
    for number in dict.fromkeys(numbers.tolist()):
        chosen = np.flatnonzero(numbers == number)
        places = (first + head + tags)[chosen, None] + np.arange(CORNERS_OF[TYPES[number]])
        yield TYPES[number], values[places], table[chosen]


def _numbered(stream: Stream) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yields types, corners (k, c) and two tags (k, 2) of the blocks of version 2, binary."""
    left = stream.announced()
    while left > 0:
        number, count, tags = stream.take("i", 3).tolist()
        if count < 0 or tags < 0:
            raise ValueError(f"{count} elements with {tags} tags")
        width = 1 + tags + CORNERS_OF[_kind(number)]
        rows = stream.take("i", count * width).reshape(count, width)
        padded = np.column_stack([rows[:, 1 : 1 + tags], np.zeros((count, 2), np.int64)])
        yield TYPES[number], rows[:, 1 + tags :], padded[:, :2]
        left -= count
    stream.end()
    if left:
        raise ValueError("more elements than announced")


def _of_version_2(kind: str, corners: np.ndarray, table: np.ndarray) -> Elements:
    """Finds groups by tags of group (0: none) and entity; elements of two groups are read once."""
    physical, entity = np.abs(table[:, 0]), table[:, 1]
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
