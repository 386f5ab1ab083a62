"""Meshes that meshio or gmsh read: I-deas, Medit, Abaqus, XDMF, Nastran, AFLR, Netgen.

Where the coordinates stand in the file in the order of the points, they alone are replaced. Another
file is written by meshio, or not at all.
"""

import dataclasses
import itertools
import pickle
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._host.package.text import ending
from jaxmorph._mesh.exchange import GROUPS, LEVELS, MARKERS, Grid, Parts, Patch, imported, of_meshio
from jaxmorph._mesh.export import to_meshio

from ._apart import run_apart
from ._format import EVERYTHING, FilePoints, MeshLike, Source, of_grid, own_source
from ._gmsh import TYPES, ElementBlock, Names, grid_of
from ._text import parse, replaced, scan


class LibraryKind(NamedTuple):
    """A kind of file: the library that reads it, and its name of the kind; `nodes` precedes the
    coordinates in a text. Where `is_fixed`, a number stands in 25 columns. Where the library
    `writes`, it keeps sets and numbers.
    """

    library: str
    name: str
    nodes: bytes | None = None
    is_fixed: bool = False
    writes: bool = False


KINDS = {
    "I-deas": LibraryKind("gmsh", "gmsh", rb"^\s+(?:2411|781)\s*\n", is_fixed=True),
    "Nastran": LibraryKind("gmsh", "gmsh"),
    "Medit": LibraryKind("meshio", "medit", rb"^\s*Vertices\s+\d+", writes=True),
    "Abaqus": LibraryKind(
        "meshio", "abaqus", rb"(?i)^\*node\b(?!\s*(?:print|file|output))[^\n]*\n", writes=True
    ),
    "XDMF": LibraryKind("meshio", "xdmf", writes=True),
    "AFLR": LibraryKind("meshio", "ugrid", rb"\A(?:\s*\d+){7}"),
    "Netgen": LibraryKind("meshio", "netgen", rb"^points\s+\d+", writes=True),
}
_WORD = re.compile(rb"^\s*[A-Za-z*#$]", re.MULTILINE)
"""The first line that is no row of numbers."""


class Place(NamedTuple):
    """Where the coordinates of a file stand: bytes `start` to `stop`.

    Binary numbers have a type. In a text, `at` are the places of coordinates among all words there,
    and `nodes` those of its rows.
    """

    start: int
    stop: int
    dtype: np.dtype | None = None
    at: ndarray | None = None
    nodes: ndarray | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class OtherContent(FilePoints):
    raw: bytes
    place: Place | None
    content: Any

    @property
    def arrays(self) -> list[str]:
        names = [*getattr(self.content, "point_data", ()), *getattr(self.content, "cell_data", ())]
        return [name for name in names if name.lower() not in (*MARKERS, *GROUPS)]


class Codec(NamedTuple):
    """Reads and writes one of `KINDS`."""

    name: str

    @property
    def kind(self) -> LibraryKind:
        return KINDS[self.name]

    def read(self, path: Path) -> Parts:
        raw = path.read_bytes()
        grid, patches, notes = _found(path, self.kind, len(raw))
        if not len(grid.points):
            raise ValueError("no nodes in this file.")
        place, points = _place(raw, self.kind, np.asarray(grid.points))
        grid = dataclasses.replace(grid, points=points)
        is_single = place is not None and place.dtype is not None and place.dtype.itemsize == 4
        content = OtherContent(
            points, raw, place, grid.content, singles=EVERYTHING if is_single else ()
        )
        if place is None and self.kind.writes:
            notes += (
                "meshio writes it anew: comments, and what has no place in a mesh, are lost.",
            )
        if self.name == "Abaqus" and re.search(rb"(?im)^\*surface\b", raw):
            notes += ("surfaces of elements are not read, and are no patches.",)
        return of_grid(
            path, grid, Source(path, self.name, content, notes=notes, **content.known), patches
        )

    def check(self, path: Path, mesh: MeshLike) -> None:
        source = own_source(mesh, self.name)
        if (
            source.content.place is None or _form(path) != _form(source.path)
        ) and not self.kind.writes:
            what = f"a file of {self.name} like this one"
            what = what if source.content.place is None else "another form of the file"
            raise ValueError(f"{what} is not written; write .vtu or .msh.")

    def write(self, path: Path, mesh: MeshLike) -> None:
        source = own_source(mesh, self.name)
        values = source.content.in_file(np.asarray(mesh.points))
        is_binary = [ending(each) == ".meshb" for each in (path, source.path)]
        if source.content.place is not None and is_binary[0] == is_binary[1]:
            with path.open("wb") as file:
                file.writelines(_moved(source.content.raw, source.content.place, self.kind, values))
        else:
            moved = to_meshio(Parts(mesh.points, mesh.cells, {}, mesh.source), None, None)
            options = (
                {"data_format": "XML"} if self.name == "XDMF" else {}
            )  # else arrays are in another file
            imported("meshio", "io").write(path, moved, file_format=self.kind.name, **options)


def _form(path: Path) -> str:
    """Returns the part of an AFLR file's name that says how numbers are written, .lb8.ugrid."""
    words = path.name.lower().removesuffix(".gz").split(".")
    return words[-2] if ending(path) == ".ugrid" and re.fullmatch("l?[br][48]l?", words[-2]) else ""


def _moved(raw: bytes, place: Place, kind: LibraryKind, values: ndarray) -> Iterator[Any]:
    start, stop, dtype, at, nodes = place
    values = values[slice(None) if nodes is None else nodes].ravel()
    if dtype is not None:
        return iter((raw[:start], values.astype(dtype).tobytes(), raw[stop:]))
    if kind.is_fixed and at is not None:
        return iter((raw[:start], _in_columns(raw[start:stop], at, values), raw[stop:]))
    return replaced(raw, slice(start, stop), values, at=at, plain=_plain)


def _plain(text: bytes) -> bytes:
    return text.replace(b",", b" ")


def _in_columns(text: bytes, at: ndarray, values: ndarray) -> bytes:
    """Replaces numbers of 25 columns, which programs read by column."""
    new, (_, ends, _) = bytearray(text), scan(text)
    old = parse(b" ".join(text[end - 25 : end] for end in ends[at].tolist()), np.float64)
    letter = "D" if b"D" in text[: ends[at[-1]]] else "E"
    for k in np.flatnonzero(old != values).tolist():
        end = int(ends[at[k]])
        new[end - 25 : end] = f"{values[k]:25.16E}".replace("E", letter).encode()
    return bytes(new)


def _place(raw: bytes, kind: LibraryKind, points: ndarray) -> tuple[Place | None, ndarray]:
    """Finds the points in the file, with all digits: meshio reads some in single precision."""
    for code in ("<f8", ">f8", "<f4", ">f4"):
        start = raw.find(points.astype(code).tobytes())
        if start >= 0 and np.array_equal(points.astype(code), points):
            return Place(
                start, start + np.dtype(code).itemsize * points.size, np.dtype(code)
            ), points.astype(float)
    for begin in re.finditer(kind.nodes, raw, re.MULTILINE) if kind.nodes else ():
        end = _WORD.search(raw, begin.end())
        stop = end.start() if end else len(raw)
        rows = _rows(parse(_plain(raw[begin.end() : stop]), np.float64), points)
        if rows is not None:
            at, nodes, found = rows
            return Place(begin.end(), stop, None, at, nodes), found
    return None, points.astype(float)


def _rows(values: ndarray, points: ndarray) -> tuple[ndarray, ndarray, ndarray] | None:
    """Finds the points in rows of a table: the places of coordinates, nodes of rows, all digits."""
    n, d = points.shape
    for width in range(d, min(len(values) // n, 8) + 1):  # no row has more than 8 numbers
        rows = values[: n * width].reshape(n, width)
        orders = np.arange(n), np.argsort(rows[:, 0], kind="stable")
        for first, order in itertools.product(range(width - d + 1), orders):
            found = rows[order, first : first + d]
            if np.array_equal(found.astype(points.dtype), points):
                at = width * np.arange(n)[:, None] + first + np.arange(d)
                return at.ravel(), np.argsort(order), found
    return None


def _found(path: Path, kind: LibraryKind, size: int) -> tuple[Grid, list[Patch], tuple[str, ...]]:
    imported(kind.library, "io" if kind.library == "meshio" else "cases")
    with tempfile.TemporaryDirectory(prefix="jaxmorph-") as folder:
        run_apart(kind.name, path, size, folder)
        found = pickle.loads(Path(folder, "mesh.pickle").read_bytes())
    return (of_meshio(found), [], ()) if kind.library == "meshio" else _of_gmsh(*found)


def _of_gmsh(
    points: ndarray, found: list[tuple], names: Names
) -> tuple[Grid, list[Patch], tuple[str, ...]]:
    """Makes a grid of what `_apart_script.py` gives; a boundary without a group is `surface_5`."""
    unknown = [number for _, _, number, *_ in found if number not in TYPES]
    if unknown or not found:
        raise ValueError(
            f"elements of gmsh's types {unknown} are not read." if unknown else "no elements."
        )
    blocks = []
    top = max(level for level, *_ in found)
    for level, entity, number, ids, groups in found:
        if not groups and level == top - 1:
            groups = [-entity]
            names[level, -entity] = f"{LEVELS[level]}_{entity}"
        blocks.append(
            ElementBlock(TYPES[number], ids.astype(np.int64), dict.fromkeys(groups, slice(None)))
        )
    return grid_of(points, blocks, names)
