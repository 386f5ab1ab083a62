"""Numbers of a file by their places: words of a text, or bytes; and nodes by their labels."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.topology import CORNERS, DIMENSION, NODES
from jaxmorph._host.rows import Rows
from jaxmorph._mesh.exchange import ByName, Grid

from ._format import FilePoints
from ._text import Pieces, Section, number_lines, replace_numbers

KIND_BY_NODES = {(0, 1): "vertex", (0, 2): "line"} | {
    (DIMENSION[kind], NODES[kind]): kind
    for kind in (
        *CORNERS,
        *("line3", "triangle6", "quad8"),
        *("tetra10", "pyramid13", "wedge15", "hexahedron20"),
    )
}
"""Types of linear cells, and of order 2 without inner nodes, by dimension and number of nodes."""


class CoordinatePart(NamedTuple):
    """Where the coordinates of the points `rows` stand: bytes `start` to `stop` of a file.

    Without a `dtype` this is a text, and `at` are the places of coordinates among its words, None
    for all words. Else `at` are the bytes at which points begin, counted from `start`, None for
    points without anything between them. `by_columns` all x of a text come before all y.
    """

    start: int
    stop: int
    rows: slice = slice(None)
    at: ndarray | None = None
    dtype: np.dtype | None = None
    by_columns: bool = False

    @classmethod
    def in_columns(
        cls, section: Section, shape: tuple[int, ...], columns: slice, first: int = 0
    ) -> "CoordinatePart":
        """Coordinates in some columns of a text's table, of the points from `first` on."""
        at = np.arange(np.prod(shape)).reshape(shape)[:, columns].ravel()
        return cls(section.start, section.stop, slice(first, first + shape[0]), at)


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedPoints(FilePoints):
    """The points of a file and their places in it.

    - `plain`: turns what stands between numbers of a text into blanks, byte for byte.
    - `form`, `columns`: writes new numbers, one a line; each takes so many columns (0: any).
    """

    raw: bytes
    parts: Sequence[CoordinatePart]
    plain: Callable[[bytes], bytes] = bytes
    form: Callable[[ndarray], bytes] = number_lines
    columns: int = 0

    def moved(self, points: ndarray) -> Pieces:
        points = self.in_file(points)
        done = 0
        for part in sorted(self.parts, key=lambda part: part.start):
            old = self.points[part.rows]
            values = points[part.rows]
            if part.by_columns:
                old = old.T
                values = values.T
            if part.dtype is None:
                yield from replace_numbers(
                    self.raw[done : part.stop],
                    slice(part.start - done, part.stop - done),
                    old.ravel(),
                    values.ravel(),
                    at=part.at,
                    plain=self.plain,
                    form=self.form,
                    columns=self.columns,
                )
            elif part.at is None:
                yield self.raw[done : part.start] + values.astype(part.dtype).tobytes()
            else:
                copy = bytearray(memoryview(self.raw)[done : part.stop])
                width = values.shape[1] * part.dtype.itemsize
                new = np.ascontiguousarray(values.astype(part.dtype)).view(f"V{width}")
                view_windows(copy, width)[part.at + part.start - done] = new.ravel()
                yield copy
            done = part.stop
        yield self.raw[done:]


def view_windows(data: Any, width: int) -> ndarray:
    """Views `width` bytes, at every byte where they may begin, as one element each."""
    return ndarray((max(memoryview(data).nbytes - width + 1, 0),), f"V{width}", data, strides=(1,))


class Labels:
    """Numbers that a file gives its nodes or elements, which are called `what` in messages.

    Raises `ValueError` for a number that comes twice.
    """

    def __init__(self, numbers: ndarray, what: str):
        self.what = what
        self.rows = Rows(numbers)
        again = np.sort(numbers[self.rows.repeated])
        if len(again):
            raise ValueError(
                f"{len(again)} numbers of {what} come a second time, first {again[0]}."
            )

    def find(self, ids: ndarray, whose: str) -> ndarray:
        """Finds the row of each number; raises `ValueError` for one of `whose` that is none."""
        found = self.rows.of(ids)
        wrong = ids[found < 0]
        if len(wrong):
            raise ValueError(
                f"{whose} names {wrong[0]}, which is none of the {len(self.rows.ids)} {self.what}."
            )
        return found


class Stream:
    """Goes through a section's numbers: `types` by letter, i, n or p for whole ones, d for reals.

    Without `types` the section is a text, whose numbers are taken as bytes of `dtype`.
    """

    def __init__(
        self,
        section: Section,
        types: Mapping[str, str] | None,
        dtype: type = np.float64,
        version: float = 0.0,
    ):
        self.section = section
        self.version = version
        self.rows = None
        self.data = section.text
        self.at = section.start
        self.stop = section.stop
        self.types = {letter: np.dtype(kind) for letter, kind in (types or {}).items()}
        if types is None:
            self.rows = section.rows(dtype)
            self.data = self.rows.values
            self.at = 0
            self.stop = self.rows.values.nbytes
            self.types = dict.fromkeys("inpd", np.dtype(dtype))

    def width(self, kinds: str) -> int:
        return sum(self.types[kind].itemsize for kind in kinds)

    def skip(self, count: int, kinds: str) -> int:
        """Goes over records of numbers of some kinds; returns where they begin."""
        start = self.at
        size = count * self.width(kinds)
        if count < 0 or size > self.stop - start:
            raise ValueError(f"the section ends before the {count} entries that it announces")
        self.at += size
        return start

    def take(self, kind: str, count: int, records: str = "", after: str = "") -> ndarray:
        """Reads whole numbers, the first of each of the `records` or side by side.

        In each record they stand `after` numbers of other kinds.
        """
        dtype = self.types[kind]
        records = after + (records or kind)
        start = self.skip(count, records) + self.width(after)
        values = ndarray((count,), dtype, self.data, start, (self.width(records),))
        if (
            dtype.kind == "f"
            and not ((values == np.floor(values)) & (np.abs(values) < 2.0**53)).all()
        ):
            raise ValueError("a number that is not whole where a tag or a count is expected")
        return values.astype(np.int64)

    def table(self, count: int, width: int) -> ndarray:
        """Reads rows (count, width) of whole numbers."""
        return self.take("n", count * width).reshape(count, width)

    def one(self, kind: str) -> int:
        return int(self.take(kind, 1)[0])

    def announced(self) -> int:
        """Reads a whole number that stands as text in front of binary ones."""
        if self.rows is not None:
            return self.one("n")
        start = self.at
        self.at = self.section.text.index(b"\n", self.at, self.stop) + 1
        return int(self.section.text[start : self.at])

    def end(self) -> None:
        """Raises `ValueError` where there is more: a binary section ends by one line end."""
        rest = self.section.text[self.at : self.stop]
        if self.at != self.stop if self.rows is not None else rest.strip() or not rest:
            raise ValueError("there is more, or less, than the section announces")

    def check_end(self, what: str) -> None:
        if self.at != self.stop:
            raise ValueError(f"more numbers than {what} announces.")

    def places(self, count: int, kinds: str) -> ndarray:
        """Goes over records; returns where each of them begins."""
        return self.skip(count, kinds) + self.width(kinds) * np.arange(count)

    def points(self, places: ndarray, d: int = 3) -> ndarray:
        """Reads the coordinates (n, d) that begin at each of the places."""
        dtype = self.types["d"]
        found = view_windows(self.data, d * dtype.itemsize)[places]
        return found.view(dtype).reshape(-1, d).astype(float)

    def content(
        self,
        places: ndarray,
        d: int = 3,
        *,
        raw: bytes | None = None,
        plain: Callable[[bytes], bytes] = bytes,
        singles: Sequence = (),
    ) -> PlacedPoints:
        """Makes the points (n, d) that begin at each of the places, in the bytes `raw` of a file.

        `plain` has made the section's text of these bytes.
        """
        section = self.section
        dtype = None if self.rows is not None else self.types["d"]
        words = (places[:, None] // 8 + np.arange(d)).ravel()
        at = words if dtype is None else places - section.start
        part = CoordinatePart(section.start, section.stop, at=at, dtype=dtype)
        raw = section.text if raw is None else raw
        return PlacedPoints(self.points(places, d), raw, [part], plain, singles=singles)


class LabelledCells(NamedTuple):
    """Elements of one type: their labels, and the labels (k, c) of their nodes."""

    kind: str
    labels: ndarray
    corners: ndarray


def make_labelled_grid(
    points: ndarray, labels: ndarray, cells: Sequence[LabelledCells], sets: Mapping[str, ByName]
) -> tuple[Grid, tuple[str, ...]]:
    """Makes a grid of what has labels, and notes on members of `sets` that it has not.

    `sets` are labels by the name of each set, of `elements` and of `nodes`. Raises `ValueError` for
    labels that come twice, and for elements between nodes that are none.
    """
    if not len(labels) or not cells:
        raise ValueError("no nodes, or no elements.")
    known = {
        "elements": Labels(np.concatenate([block.labels for block in cells]), "elements"),
        "nodes": Labels(labels, "nodes"),
    }
    rows = {what: known[what].rows.renumbered(sets[what]) for what in known}
    starts = np.cumsum([0, *(len(block.labels) for block in cells)])
    grid = Grid(
        points,
        [(block.kind, known["nodes"].find(block.corners, f"a {block.kind}")) for block in cells],
        {},
        {},
        {
            name: [ids[(a <= ids) & (ids < b)] - a for a, b in itertools.pairwise(starts)]
            for name, ids in rows["elements"].items()
        },
        point_sets={name: ids[ids >= 0] for name, ids in rows["nodes"].items()},
        own=("elements", "nodes"),
    )
    notes = (
        f"{(ids < 0).sum()} {what} of the set {name} are not in the mesh."
        for what in known
        for name, ids in rows[what].items()
        if (ids < 0).any()
    )
    return grid, tuple(notes)
