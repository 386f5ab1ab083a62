"""PLOT3D grids: one or many blocks, text, records or binary; the form is the one that fits."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._mesh.exchange import Parts

from ._format import EVERYTHING, FilePoints, Source
from ._joined import BLOCK_SIDES, join_zones, make_block_cells, make_block_sides, number_block
from ._text import Pieces, line_chunks, parse, replace_numbers

NAME = "PLOT3D"
TEXT = bytes([*b"\t\r\n", *range(32, 127)])
COMMAS_AS_BLANKS = bytes.maketrans(b",Dd", b" ee")
"""Fortran's commas and exponents, as NumPy reads them."""


class RecordForm(NamedTuple):
    """Types of a record's mark, of sizes, of coordinates and IBLANK (or None); text is doubles."""

    mark: int
    head: np.dtype
    types: list[tuple[np.dtype, np.dtype | None]]


DOUBLE = np.dtype("f8")
TEXTS = [RecordForm(0, DOUBLE, [(DOUBLE, None), (DOUBLE, DOUBLE)])]
Shapes = tuple[tuple[int, ...], ...]
BINARIES = [
    RecordForm(
        mark,
        whole,
        [(np.dtype(order + real), blank) for real in ("f8", "f4") for blank in (None, whole)],
    )
    for order, whole in (("<", np.dtype("<i4")), (">", np.dtype(">i4")))
    for mark in (4, 0)
]


class FileLayout(NamedTuple):
    """Sizes of the blocks, the bytes at which their coordinates begin, types, and whether text."""

    shapes: Shapes
    starts: ndarray
    dtype: np.dtype
    blank: np.dtype | None
    is_text: bool

    def coordinates(self, numbers: ndarray) -> list[ndarray]:
        """Returns views (d, nodes) of each block's coordinates in the bytes of numbers."""
        return [
            ndarray((len(shape), int(np.prod(shape))), self.dtype, numbers.data, int(start))
            for shape, start in zip(self.shapes, self.starts, strict=True)
        ]

    def blanks(self, numbers: ndarray) -> list[ndarray]:
        """Returns views (nodes,) of each block's IBLANK, behind its coordinates."""
        if self.blank is None:
            return []
        return [
            ndarray(block.shape[1], self.blank, numbers.data, int(start) + block.nbytes)
            for block, start in zip(self.coordinates(numbers), self.starts, strict=True)
        ]


@dataclasses.dataclass(frozen=True, eq=False)
class Plot3DContent(FilePoints):
    data: bytes
    layout: FileLayout

    def moved(self, points: ndarray) -> Pieces:
        points = self.in_file(points)
        old = _read_bytes(self.data, self.layout.is_text)
        numbers = old.copy()
        first = 0
        for block in self.layout.coordinates(numbers):
            block[...] = points[first : first + block.shape[1]].T
            first += block.shape[1]
        if not self.layout.is_text:
            return iter([numbers.tobytes()])
        whole = slice(0, len(self.data))
        return replace_numbers(
            self.data, whole, old.view(float), numbers.view(float), plain=_blank_commas
        )


def read(path: Path) -> Parts:
    """Reads all blocks; nodes where blocks meet are one.

    Patches come from a file beside the grid, whose lines count blocks and nodes from 1. Without it
    each outer side of a block is a patch, `block2_jmin`, or `jmin` for a single block.
    """
    data = path.read_bytes()
    is_text = len(data) > 0 and not data[:4096].translate(None, TEXT)
    numbers = _read_bytes(data, is_text)
    forms = TEXTS if is_text else BINARIES
    layout = next(
        itertools.chain.from_iterable(_find_layouts(numbers, form) for form in forms), None
    )
    if layout is None:
        form = "text" if is_text else "binary"
        raise ValueError(
            f"not a whole PLOT3D grid; no count of blocks and sizes fits this {form} file."
        )
    points = np.concatenate([block.T.astype(float) for block in layout.coordinates(numbers)])
    blank = sum(int((block == 0).sum()) for block in layout.blanks(numbers))
    singles = EVERYTHING if layout.dtype.itemsize == 4 else ()
    notes = (f"{blank} nodes are blank (IBLANK 0), and are read as all others.",) if blank else ()
    mesh, node = join_zones(points, *_make_zones(path, layout.shapes))
    content = Plot3DContent(points, data, layout, node=node, singles=singles)
    return mesh._replace(source=Source(path, NAME, content, notes=notes, **content.known))


def _blank_commas(text: bytes) -> bytes:
    return text.translate(COMMAS_AS_BLANKS)


def _read_bytes(data: bytes, is_text: bool) -> ndarray:
    if not is_text:
        return np.frombuffer(data, np.uint8)
    parts = []
    for chunk in line_chunks(data, 0, len(data)):
        words = _blank_commas(chunk)
        parts.append(parse(words, np.float64))
        if len(parts[-1]) != len(words.split()):
            line = data.count(b"\n", 0, data.find(chunk)) + 1
            raise ValueError(f"lines from {line}: something that is not a number.")
    return np.concatenate(parts).view(np.uint8)


def _find_layouts(numbers: ndarray, form: RecordForm) -> Iterator[FileLayout]:
    """Yields sizes that fit a form to its last byte, between Fortran's marks where it has them."""
    mark = form.mark
    head = form.head
    # does a count of blocks come first?
    for is_multiple, d in ((True, 3), (False, 3), (True, 2), (False, 2)):
        start = mark + (head.itemsize + 2 * mark) * is_multiple
        count = _view_as(numbers[mark:], head)[:1] if is_multiple else np.ones(1)
        shapes = _read_shapes(count, _view_as(numbers[start:], head), d)
        first = [float(head.itemsize)] * is_multiple + [head.itemsize * d * len(shapes)]
        nodes = np.array([*map(math.prod, shapes)], float)
        for dtype, blank in form.types if shapes else []:
            sizes = np.append(first, nodes * (d * dtype.itemsize + getattr(blank, "itemsize", 0)))
            ends = np.cumsum(sizes + 2 * mark)
            layout = FileLayout(
                shapes, (ends - mark - sizes)[-len(shapes) :], dtype, blank, head.kind == "f"
            )
            if ends[-1] == len(numbers) and _has_marks(numbers, layout, form, sizes, ends):
                yield layout


def _has_marks(
    numbers: ndarray, layout: FileLayout, form: RecordForm, sizes: ndarray, ends: ndarray
) -> bool:
    """Checks IBLANK of a text, and whether Fortran's marks stand before and after each record."""
    if not form.mark:
        return all((block == np.floor(block)).all() for block in layout.blanks(numbers))
    places = np.stack([ends - sizes - 8, ends - 4], axis=1).astype(int)[..., None] + np.arange(4)
    return bool((numbers[places].view(form.head)[..., 0] == sizes[:, None]).all())


def _view_as(numbers: ndarray, dtype: np.dtype) -> ndarray:
    return numbers[: len(numbers) // dtype.itemsize * dtype.itemsize].view(dtype)


def _read_shapes(count: ndarray, sizes: ndarray, d: int) -> Shapes:
    """Reads the sizes of so many blocks; returns none if the numbers cannot be sizes."""
    if not len(count) or not 0 < count[0] <= len(sizes) // d or count[0] != np.floor(count[0]):
        return ()
    rows = sizes[: d * int(count[0])].reshape(-1, d)
    # a block has cells: two of its indices have more than one node
    is_good = (rows >= 1) & (rows < 2**31) & (rows == np.floor(rows))
    if not is_good.all() or ((rows > 1).sum(axis=1) < 2).any():
        return ()
    return tuple(tuple(map(int, row)) for row in rows)


def _make_zones(path: Path, shapes: Shapes) -> tuple[list, dict, list[ndarray], list[str]]:
    """Makes the cells, patches and outer faces of all blocks, and the names of the faces."""
    cells = []
    faces = []
    names = []
    first = 0
    for block, shape in enumerate(shapes, start=1):
        ids = number_block(shape, first)
        cells.append(make_block_cells(ids))
        faces += make_block_sides(ids)
        sides = [side for k, side in enumerate(BLOCK_SIDES[: 2 * len(shape)]) if shape[k // 2] > 1]
        names += [side if len(shapes) == 1 else f"block{block}_{side}" for side in sides]
        first += ids.size
    beside = path.with_name(f"{path.name}.patches")
    patches = _read_beside(beside, shapes) if beside.is_file() else {}
    return cells, patches, faces, [] if patches else names


def _read_beside(path: Path, shapes: Shapes) -> dict[str, list[ndarray]]:
    patches: dict[str, list[ndarray]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.partition("#")[0].split()
        try:
            if words:
                patches.setdefault(words[0], []).append(_parse_patch(words, shapes))
        except (ValueError, IndexError) as error:
            sizes = ", ".join(" x ".join(map(str, shape)) for shape in shapes)
            raise ValueError(
                f"{path}, line {number}: NAME BLOCK SIDE or NAME BLOCK and node ranges expected, "
                f"found {line.strip()!r}; "
                f"blocks are {sizes}."
            ) from error
    return patches


def _parse_patch(words: list[str], shapes: Shapes) -> ndarray:
    block = int(words[1]) - 1
    shape = shapes[block] if block >= 0 else ()
    ids = number_block(shape, sum(map(math.prod, shapes[:block]))).reshape(shape)
    if len(words) == 3:
        axis, end = divmod(BLOCK_SIDES.index(words[2].lower()), 2)
        return ids.take(-end, axis=axis).ravel()
    ends = np.sort(np.array(words[2:], int).reshape(len(shape), 2), axis=1)
    if (ends < 1).any() or (ends[:, 1] > shape).any():
        raise ValueError
    return ids[tuple(slice(first - 1, last) for first, last in ends.tolist())].ravel()
