"""PLOT3D grids: one or many blocks, 2-D or 3-D, text, Fortran records or binary, single or double.

A file does not say which of these it is; the form whose sizes fit the file to the byte is taken. It
may have IBLANK, whose values are kept and not looked at. The file is written back in its form.
"""

import dataclasses
import itertools
import pathlib
from collections.abc import Iterator

import numpy as np

from jaxmorph._mesh.exchange import Parts

from ._format import EVERYTHING, Arrays, MeshLike, Source, faults_of, own_source
from ._joined import SIDES, Joined, Zones, block_cells, block_ids, block_sides, join
from ._text import chunks, parse, replace_words

NAME = "PLOT3D"
TEXT = bytes([*b"\t\r\n", *range(32, 127)])
WORDS = bytes.maketrans(b",Dd", b" ee")
"""Fortran's commas and exponents, as NumPy reads them."""


@dataclasses.dataclass(frozen=True)
class FileLayout:
    """Sizes of the blocks, and where coordinates begin: a number in text, a byte in binary."""

    shapes: tuple[tuple[int, ...], ...]
    starts: tuple[int, ...]
    dtype: np.dtype | None
    has_blank: bool

    def coordinates(self, numbers: np.ndarray) -> list[np.ndarray]:
        """Returns views (d, nodes) of each block's coordinates in a text's numbers or bytes."""
        views = []
        for shape, start in zip(self.shapes, self.starts, strict=True):
            d, count = len(shape), int(np.prod(shape))
            if self.dtype is None:
                views.append(numbers[start : start + d * count].reshape(d, count))
            else:
                views.append(np.ndarray((d, count), self.dtype, numbers.data, start))
        return views

    def blank(self, numbers: np.ndarray) -> int:
        """Counts the nodes whose IBLANK, behind each block's coordinates, is 0."""
        total = 0
        for shape, start in zip(self.shapes, self.starts, strict=True) if self.has_blank else ():
            count = int(np.prod(shape))
            if self.dtype is None:
                values = numbers[start + len(shape) * count :][:count]
            else:
                at = start + len(shape) * count * self.dtype.itemsize
                values = np.ndarray((count,), self.dtype.str[0] + "i4", numbers.data, at)
            total += int((values == 0).sum())
        return total


@dataclasses.dataclass(frozen=True, eq=False)
class _Content:
    data: bytes
    layout: FileLayout
    joined: Joined


def read(path: pathlib.Path) -> Parts:
    """Reads all blocks; nodes where blocks meet are one.

    Patches come from a file beside the grid, called as the grid with the ending `.patches`. It
    holds lines `NAME BLOCK SIDE` (`imin` to `kmax`) or `NAME BLOCK I1 I2 J1 J2 [K1 K2]`, nodes
    counted from 1. Without it each outer side of a block is a patch, as `block2_jmin`, or `jmin` in
    a file of one block.
    """
    data = path.read_bytes()
    is_text = len(data) > 0 and not data[:4096].translate(None, TEXT)
    numbers = _numbers(path, data) if is_text else np.frombuffer(data, np.uint8)
    layout = _text_layout(numbers) if is_text else _binary_layout(data)
    if layout is None:
        form = "text" if is_text else "binary"
        raise ValueError(
            f"{path}: not a whole PLOT3D grid; no count of blocks and sizes fits this {form} file to its end."
        )
    points = np.concatenate([block.T.astype(float) for block in layout.coordinates(numbers)])
    with faults_of(path):
        mesh, joined = join(_zones(path, layout.shapes, points))
        content = _Content(data, layout, joined)
        blank = layout.blank(numbers)
        notes = (f"{blank} nodes are blank (IBLANK 0), and are read as all others.",) if blank else ()
        is_single = layout.dtype is not None and layout.dtype.itemsize == 4
        known = {"in_file": joined.in_file, "held": joined.held(EVERYTHING if is_single else ()), "notes": notes}
        source = Source(path, NAME, content, file_nodes=joined.node, **known)
        return mesh._replace(source=source)


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes the file the mesh was read from with new coordinates."""
    source = own_source(path, mesh, NAME)
    content: _Content = source.content
    layout, data = content.layout, content.data
    points = content.joined.in_file(np.asarray(mesh.points))
    known = _numbers(source.path, data) if layout.dtype is None else np.frombuffer(data, np.uint8)
    numbers = known.copy()
    first = 0
    for block in layout.coordinates(numbers):
        block[...] = points[first : first + block.shape[1]].T
        first += block.shape[1]
    with path.open("wb") as file:
        file.writelines(
            replace_words(data, 0, len(data), known, numbers, WORDS) if layout.dtype is None else [numbers.tobytes()]
        )


def _numbers(path: pathlib.Path, text: bytes) -> np.ndarray:
    parts = []
    for chunk in chunks(text, 0, len(text)):
        words = chunk.translate(WORDS)
        parts.append(parse(words, np.float64))
        if len(parts[-1]) != len(words.split()):
            line = text.count(b"\n", 0, text.find(chunk)) + 1
            raise ValueError(f"{path}, lines from {line}: something that is not a number.")
    return np.concatenate(parts)


def _text_layout(numbers: np.ndarray) -> FileLayout | None:
    for d, is_multiple in itertools.product((3, 2), (True, False)):
        shapes = _shapes(numbers[:1] if is_multiple else np.ones(1), numbers[is_multiple:], d)
        start = is_multiple + d * len(shapes)
        counts = np.array([np.prod(shape) for shape in shapes], int)
        for width in (d, d + 1):
            if shapes and start + width * sum(counts) == len(numbers):
                starts = start + width * (np.cumsum(counts) - counts)
                blanks = [
                    numbers[end - count : end] for end, count in zip(starts + width * counts, counts, strict=True)
                ]
                if width > d and any((blank != np.floor(blank)).any() for blank in blanks):
                    continue  # IBLANK is whole numbers
                return FileLayout(shapes, tuple(starts.tolist()), None, width > d)
    return None


def _shapes(count: np.ndarray, sizes: np.ndarray, d: int) -> tuple[tuple[int, ...], ...]:
    """Reads the sizes of so many blocks; returns none if the numbers cannot be sizes."""
    blocks = int(count[0]) if len(count) and 0 < count[0] <= len(sizes) // d and count[0] == np.floor(count[0]) else 0
    rows = sizes[: d * blocks].reshape(blocks, d)
    good = len(rows) and (rows >= 1).all() and (rows < 2**31).all() and (rows == np.floor(rows)).all()
    # a block has cells: two of its indices have more than one node
    if not good or ((rows > 1).sum(axis=1) < 2).any():
        return ()
    return tuple(tuple(int(size) for size in row) for row in rows)


def _binary_layout(data: bytes) -> FileLayout | None:
    for order, mark, is_multiple, d in itertools.product("<>", (4, 0), (True, False), (3, 2)):
        kind = f"{order}i4"
        head = 4 + 2 * mark if is_multiple else 0
        count = np.frombuffer(data, kind, 1, mark) if is_multiple and len(data) > head else np.ones(1, int)
        rest = (len(data) - head - mark) // 4
        shapes = _shapes(
            count,
            np.frombuffer(data, kind, max(min(rest, d * int(max(count[0], 0))), 0), min(head + mark, len(data))),
            d,
        )
        start = head + 4 * d * len(shapes) + 2 * mark
        counts = np.array([float(np.prod(shape, dtype=float)) for shape in shapes])
        for width, has_blank in itertools.product((8, 4), (False, True)):
            sizes = counts * (width * d + 4 * has_blank) + 2 * mark
            if not shapes or start + sizes.sum() != len(data):
                continue
            starts = (start + np.cumsum(sizes) - sizes).astype(int) + mark
            if mark and not _are_records(
                data, kind, [4 * is_multiple, 4 * d * len(shapes), *(sizes - 8).astype(int).tolist()]
            ):
                continue
            return FileLayout(shapes, tuple(starts.tolist()), np.dtype(f"{order}f{width}"), has_blank)
    return None


def _are_records(data: bytes, kind: str, lengths: list[int]) -> bool:
    """Checks whether Fortran's marks stand before and after records of these lengths."""
    at = 0
    for length in filter(None, lengths):
        for place in (at, at + length + 4):
            if int(np.frombuffer(data, kind, 1, place)[0]) != length:
                return False
        at += length + 8
    return True


def _zones(path: pathlib.Path, shapes: tuple[tuple[int, ...], ...], points: np.ndarray) -> Zones:
    cells, faces, names, first = [], [], [], 0
    for block, shape in enumerate(shapes, start=1):
        ids = block_ids(shape, first)
        cells.append(block_cells(ids))
        faces += block_sides(ids)
        sides = [SIDES[2 * axis + end] for axis, size in enumerate(shape) if size > 1 for end in (0, 1)]
        names += [side if len(shapes) == 1 else f"block{block}_{side}" for side in sides]
        first += ids.size
    beside = path.with_name(f"{path.name}.patches")
    patches: dict[str, list[np.ndarray]] = {}
    if beside.is_file():
        for name, nodes in _patches_beside(beside, shapes):
            patches.setdefault(name, []).append(nodes)
    return Zones(points, cells, patches, faces, None if patches else names)


def _patches_beside(path: pathlib.Path, shapes: tuple[tuple[int, ...], ...]) -> Iterator[tuple[str, np.ndarray]]:
    """Names and nodes from lines `NAME BLOCK SIDE` or `NAME BLOCK I1 I2 J1 J2 [K1 K2]`."""
    firsts = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            block = int(words[1]) - 1
            shape = shapes[block] if block >= 0 else ()
            ids = firsts[block] + np.arange(np.prod(shape)).reshape(shape, order="F")
            if len(words) == 3:
                axis, end = divmod(SIDES.index(words[2].lower()), 2)
                yield words[0], ids.take(-end, axis=axis).ravel()
                continue
            ends = np.array(words[2:], int).reshape(len(shape), 2)
            if (ends < 1).any() or (ends > np.array(shape)[:, None]).any():
                raise ValueError
            yield words[0], ids[tuple(slice(min(pair) - 1, max(pair)) for pair in ends.tolist())].ravel()
        except (ValueError, IndexError) as error:
            sizes = ", ".join(" x ".join(map(str, shape)) for shape in shapes)
            message = (
                f"NAME BLOCK SIDE or NAME BLOCK and node ranges expected, found {line.strip()!r}; blocks are {sizes}"
            )
            raise ValueError(f"{path}, line {number}: {message}.") from error
