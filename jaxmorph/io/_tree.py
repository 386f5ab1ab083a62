"""The tree of a CGNS, MED or Exodus file, in HDF5, in ADF or in classic netCDF.

Classic netCDF is CDF-1, CDF-2 and CDF-5 of Unidata's "NetCDF Classic Format Specification": a
header of dimensions, attributes and variables with their places, and big-endian numbers.
"""

import contextlib
import math
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy import ndarray

from jaxmorph._mesh.exchange import Grid, Parts, Patch

try:
    import h5py
    from h5py import h5l  # pyright: ignore[reportAttributeAccessIssue]
except ImportError as error:
    raise ImportError("CGNS, MED and Exodus files need h5py: pip install 'jaxmorph[io]'") from error

from . import _adf
from ._format import FilePoints, MeshLike, Source, of_grid, own_source, stamp_of
from ._text import decoded

WHAT = "a CGNS file in HDF5 or ADF"


@contextlib.contextmanager
def opened(path: Path, writes: bool = False, what: str = WHAT) -> Iterator[Any]:
    """Yields the root of a file's tree as h5py has it: groups with `label`, arrays as " data".

    `what` names the format in messages. Raises `ValueError` for another format, and for a file that
    is damaged or has data elsewhere, which a copy would share.
    """
    try:
        with path.open("r+b" if writes else "rb") as file:
            magic = file.read(_adf.TAG + len(_adf.MAGIC))
            if magic.startswith(MAGIC):
                yield _Header(file).tree()
            elif magic.endswith(_adf.MAGIC):
                yield _adf.Reader(path, file).tree()
            else:
                with h5py.File(path, "r+" if writes else "r") as tree:
                    _refuse_foreign_data(path, tree)
                    yield tree
    except Exception as error:  # HDF5 answers damage by a dozen classes
        if writes or (isinstance(error, ValueError) and str(path) in str(error)):
            raise
        detail = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not {what}, or a damaged one ({detail}).") from error


def _refuse_foreign_data(path: Path, file: Any) -> None:
    def elsewhere(name: bytes) -> str | None:
        kind = file.id.links.get_info(name).type
        if kind == h5l.TYPE_EXTERNAL:
            return f"/{decoded(name)} is a link to {decoded(file.id.links.get_val(name)[0])}"
        child = file[name] if kind == h5l.TYPE_HARD else None
        if isinstance(child, h5py.Dataset) and (child.external or child.is_virtual):
            other = child.external[0][0] if child.external else "other data sets"
            return f"/{decoded(name)} keeps its values in {other}"
        return None

    found = file.id.links.visit(elsewhere)  # each link once, though groups may hold each other
    if found:
        remedy = "Only files that hold all of their data are read: `h5repack` or `cgnsconvert` make one."
        raise ValueError(f"{path}: {found[-200:]}. {remedy}")


class Coordinates(NamedTuple):
    """An array of coordinates in a tree, at `rows` and `columns` of a file's points, by columns.

    Where it is `by_rows`, it is (n, d) as the points are.
    """

    array: Any
    rows: slice
    columns: slice
    by_rows: bool = False


def points_of(coordinates: Sequence[Coordinates], n: int, d: int) -> ndarray:
    points = np.full((n, d), np.nan)
    for array, rows, columns, by_rows in coordinates:
        width = d if columns == slice(None) else 1
        points[rows, columns] = array[()] if by_rows else array[()].reshape(width, -1).T
    return points


def singles_of(coordinates: Iterable[Coordinates]) -> list[tuple[slice, slice]]:
    return [(each.rows, each.columns) for each in coordinates if each.array.dtype.itemsize < 8]


def of_tree(
    path: Path,
    name: str,
    coordinates: Iterable[Coordinates],
    grid: Grid,
    patches: Iterable[Patch] = (),
    notes: Iterable[str] = (),
) -> Parts:
    content = FilePoints(grid.points, stamp=stamp_of(path), singles=singles_of(coordinates))
    return of_grid(path, grid, Source(path, name, content, notes=tuple(notes), **content.known), patches)


def write_points(
    path: Path,
    mesh: MeshLike,
    format_name: str,
    coordinates: Callable[[Any], Iterable[Coordinates]],
    what: str = WHAT,
) -> None:
    """Copies the file that a mesh was read from, and puts the mesh's points into the copy.

    `coordinates` finds them in the root of the copy's tree. NumPy rounds them, since HDF5 rounds
    ties otherwise. A file with data in another one is refused before it is copied.
    """
    source = own_source(mesh, format_name)
    with opened(source.path, what=what):
        pass
    shutil.copyfile(source.path, path)
    points, old = source.content.in_file(np.asarray(mesh.points)), source.content.points
    if np.array_equal(points, old):
        return
    with opened(path, writes=True, what=what) as file:
        for array, rows, columns, by_rows in coordinates(file):
            new = points[rows, columns]
            if not np.array_equal(new, old[rows, columns]):
                array[...] = (new if by_rows else new.T).reshape(array.shape).astype(array.dtype)


MAGIC = b"CDF"
_TYPES = {1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8", 7: "u1", 8: ">u2", 9: ">u4", 10: ">i8", 11: ">u8"}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
_UNSTATED = 2**32 - 4
"""Bytes of a variable from which on the header of an older file cannot state its size."""


class _Header:
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

    def number(self, width: int = 0) -> int:
        return int.from_bytes(self.taken(width or self.count), "big")

    def entries(self, tag: int) -> Iterator[str]:
        """Yields the names of a list: behind a tag and a count, or zeros for a list that is absent."""
        found, count = self.number(4), self.number()
        if found != tag and (found, count) != (0, 0):
            raise ValueError(f"a list of tag {found} where {tag} is expected")
        names = set()
        for _ in range(count):
            name = self.taken(self.number()).decode()
            if name in names:
                raise ValueError(f"two dimensions, variables or attributes are called {name}")
            names.add(name)
            yield name

    def attributes(self) -> dict[str, bytes]:
        texts = {}
        for name in self.entries(_ATTRIBUTES):
            kind = np.dtype(_TYPES[self.number(4)])
            texts[name] = self.taken(self.number() * kind.itemsize)
        return texts

    def tree(self) -> dict[str, _adf.Array]:
        """Reads the variables by name, without records of time.

        A dimension without a variable of its name is an empty array of its length, as in netCDF-4.
        Raises `ValueError` for what lies beyond the file, or in two variables.
        """
        self.number()  # of records
        lengths = {name: self.number() for name in self.entries(_DIMENSIONS)}
        self.attributes()
        arrays = {name: self._variable(name, [*lengths.values()]) for name in self.entries(_VARIABLES)}
        pieces = [(at, at + size) for array in arrays.values() for at, size in array.pieces]
        _adf.check_spans([(0, self.file.tell()), *pieces], self.size)
        arrays = {name: array for name, array in arrays.items() if array.shape[0]}  # a record has none
        return {name: _adf.Array(self.file, np.dtype("i1"), (n,), []) for name, n in lengths.items()} | arrays

    def _variable(self, name: str, lengths: list[int]) -> _adf.Array:
        """Reads the place of a variable; one of a number each record stands behind all else."""
        sizes = [lengths[self.number()] for _ in range(self.number())] or [1]
        attributes, kind = self.attributes(), np.dtype(_TYPES[self.number(4)])
        stated, at, size = self.number(), self.number(self.place), kind.itemsize * math.prod(sizes)
        if sizes[0] and stated not in (size, -(-size // 4) * 4) and size < _UNSTATED:
            raise ValueError(f"{name} has {stated} bytes, {size} expected")
        return _adf.Array(self.file, kind, tuple(sizes), [(at, size)], attributes)
