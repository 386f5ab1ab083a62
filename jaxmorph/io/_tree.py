"""The tree of a CGNS, MED or Exodus file, in HDF5, in ADF or in classic netCDF.

Classic netCDF is CDF-1, CDF-2 and CDF-5 of Unidata's "NetCDF Classic Format Specification". A
header lists dimensions, attributes and variables with their places. All numbers are big-endian.
"""

import contextlib
import itertools
import math
import pathlib
import shutil
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

import numpy as np

try:
    import h5py
    from h5py import h5l, h5o  # pyright: ignore[reportAttributeAccessIssue]
except ImportError as error:
    raise ImportError("CGNS, MED and Exodus files need h5py: pip install 'jaxmorph[io]'") from error

from . import _adf
from ._format import MeshLike, own_source
from ._text import decoded

WHAT = "a CGNS file in HDF5 or ADF"
_FOREIGN = "{0}: {1} {2}. Only files that hold all of their data are read: `h5repack` or `cgnsconvert` make one."


@contextlib.contextmanager
def opened(path: pathlib.Path, writes: bool = False, what: str = WHAT) -> Iterator[Any]:
    """Yields the root of a file's tree as h5py has it: groups with `label`, arrays as " data".

    `what` names the format in messages. A file to be read is refused with a `ValueError` where it
    is another one, damaged, or has data elsewhere. Writing would go through to them.
    """
    try:
        if _adf.is_adf(path):
            with path.open("r+b" if writes else "rb") as file:
                yield _adf.tree(path, file)
        elif is_classic(path):
            with path.open("r+b" if writes else "rb") as file:
                yield classic_tree(file)
        else:
            with h5py.File(path, "r+" if writes else "r") as file:
                _refuse_foreign_data(path, file)
                yield file
    except Exception as error:  # HDF5 answers damage by a dozen classes
        if writes or (isinstance(error, ValueError) and str(path) in str(error)):
            raise
        detail = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not {what}, or a damaged one ({detail}).") from error


def write_points(
    path: pathlib.Path,
    mesh: MeshLike,
    format_name: str,
    put: Callable[[Any, np.ndarray, np.ndarray], None],
    what: str = WHAT,
) -> None:
    """Copies the file that a mesh was read from, and puts the mesh's points into the copy.

    `put` takes the root of the copy's tree, the points in the file's order, and the old points. It
    is not called where no point has moved, and rounds by NumPy, since HDF5 has a rule of its own
    for ties. A file with data in another one is refused before it is
    copied.
    """
    source = own_source(path, mesh, format_name)
    with opened(source.path, what=what):
        pass
    shutil.copyfile(source.path, path)
    points, old = source.content.in_file(np.asarray(mesh.points)), source.content.points
    if not np.array_equal(points, old):
        with opened(path, writes=True, what=what) as file:
            put(file, points, old)


def _text(name: str | bytes) -> str:
    """Returns a name as text; h5py has names that are not UTF-8 as bytes."""
    return decoded(name) if isinstance(name, bytes) else name


def _link(group: Any, name: str | bytes) -> Any:
    """Returns the link of a group's member, as h5py's `get` does for names that are UTF-8."""
    if isinstance(name, str):
        return group.get(name, getlink=True)
    kind = group.id.links.get_info(name).type
    if kind == h5l.TYPE_EXTERNAL:
        return h5py.ExternalLink(*map(_text, group.id.links.get_val(name)))
    return h5py.SoftLink("elsewhere") if kind == h5l.TYPE_SOFT else h5py.HardLink()


def _refuse_foreign_data(path: pathlib.Path, file: Any) -> None:
    """Raises `ValueError` where anything in an HDF5 file has its data in another one.

    Links to other files, data sets in external storage and virtual ones are refused, wherever they
    stand.
    """
    groups, seen = [file["/"]], set()
    while groups:
        group = groups.pop()
        for name in group:
            link, place = _link(group, name), "/".join([_text(group.name).rstrip("/"), _text(name)])[-200:]
            if isinstance(link, h5py.ExternalLink):
                raise ValueError(_FOREIGN.format(path, place, f"is a link to {link.filename}"))
            if isinstance(link, h5py.SoftLink):
                continue  # to a place of this file, which is looked at by itself
            child = group[name]
            if isinstance(child, h5py.Dataset):
                if child.external or child.is_virtual:
                    other = child.external[0][0] if child.external else "other data sets"
                    raise ValueError(_FOREIGN.format(path, place, f"keeps its values in {other}"))
            elif isinstance(child, h5py.Group):
                address = h5o.get_info(child.id).addr
                if address not in seen:  # groups may hold each other
                    seen.add(address)
                    groups.append(child)


MAGIC = b"CDF"
_TYPES = {1: "i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8", 7: "u1", 8: ">u2", 9: ">u4", 10: ">i8", 11: ">u8"}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
_UNSTATED = 2**32 - 4
"""Bytes of a variable from which on the header of an older file cannot state its size."""


def is_classic(path: pathlib.Path) -> bool:
    """Checks whether a file begins as a classic netCDF file."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


class Variable(_adf.Array):
    """An array with its attributes that are text."""

    def __init__(self, file: BinaryIO, dtype: np.dtype, shape: tuple[int, ...], at: int, attrs: dict[str, bytes]):
        super().__init__(file, dtype, shape, [(at, dtype.itemsize * math.prod(shape))])
        self.attrs = attrs


def classic_tree(file: BinaryIO) -> dict[str, Any]:
    """Reads the header of an open file: its variables by name, without records of time.

    A dimension without a variable of its name is an array of its length that has no numbers, as in
    netCDF-4. It raises `ValueError` for what lies beyond the file, or in two variables.
    """
    return _Header(file).tree()


class _Header:
    """Reads the header of a file from its beginning to its end."""

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

    def number(self, width: int) -> int:
        return int.from_bytes(self.taken(width), "big")

    def name(self) -> str:
        return self.taken(self.number(self.count)).decode()

    def entries(self, tag: int) -> range:
        """Reads the head of a list: a tag and a count, or zeros for a list that is absent."""
        found, count = self.number(4), self.number(self.count)
        if found != tag and (found, count) != (0, 0):
            raise ValueError(f"a list of tag {found} where {tag} is expected")
        return range(count)

    def attributes(self) -> dict[str, bytes]:
        """Reads a list of attributes; numbers are left out."""
        texts = {}
        for _ in self.entries(_ATTRIBUTES):
            name, kind = self.name(), np.dtype(_TYPES[self.number(4)])
            data = self.taken(self.number(self.count) * kind.itemsize)
            if kind.kind == "S":
                texts[name] = data
        return texts

    def tree(self) -> dict[str, Any]:
        self.number(self.count)  # of records
        dimensions = [(self.name(), self.number(self.count)) for _ in self.entries(_DIMENSIONS)]
        self.attributes()
        variables, spans = [], []
        for _ in self.entries(_VARIABLES):
            name = self.name()
            sizes = [dimensions[self.number(self.count)][1] for _ in range(self.number(self.count))]
            attributes, kind = self.attributes(), np.dtype(_TYPES[self.number(4)])
            stated, at = self.number(self.count), self.number(self.place)
            if sizes[:1] == [0]:  # one number a record: they stand behind all else
                spans.append((at, at))
                continue
            size = kind.itemsize * math.prod(sizes)
            if stated not in (size, -(-size // 4) * 4) and size < _UNSTATED:
                raise ValueError(f"{name} has {stated} bytes, {size} expected")
            variables.append((name, Variable(self.file, kind, tuple(sizes) or (1,), at, attributes)))
            spans.append((at, at + size))
        spans = sorted([(0, self.file.tell()), *spans])
        if any(after < end for (_, end), (after, _) in itertools.pairwise(spans)) or any(
            start < end and end > self.size for start, end in spans
        ):
            raise ValueError("variables lie in one another, or beyond the end of the file")
        names = [name for name, _ in dimensions], [name for name, _ in variables]
        if any(len(set(several)) < len(several) for several in names):
            raise ValueError("two dimensions or two variables of one name")
        lengths = {name: Variable(self.file, np.dtype("i1"), (length,), 0, {}) for name, length in dimensions}
        return lengths | dict(variables)
