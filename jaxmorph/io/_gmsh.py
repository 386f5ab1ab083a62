"""gmsh's .msh, versions 2.2 and 4.1, ascii and binary, and 4.0: read by meshio, written back by replacing the coordinates.

meshio's own writer would lose bounding boxes, second physical groups and comments of a file it has read.
"""

import codecs
import dataclasses
import pathlib
import re
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.topology import DIMENSION

from ._boundary import patch_faces
from ._format import Arrays, Source, source_of
from ._meshio import load, meshio, to_mesh
from .text.sections import Section, replace

NAME = "gmsh"
TYPES, CORNERS_OF = meshio.gmsh.common._gmsh_to_meshio_type, meshio._mesh.num_nodes_per_cell
SPARSE = 1000
"""Largest tag that a file may have, in numbers of nodes."""


@dataclasses.dataclass(frozen=True)
class _GmshContent:
    """Keeps the bytes of a file, and its points with the constant z of a 2-D mesh."""

    data: bytes
    points: np.ndarray


def read(path: pathlib.Path) -> Mesh:
    """Reads points, cells and patches: the physical groups of lower dimension than the mesh.

    A group without a name is `physical_` and its tag.
    """
    data = path.read_bytes()
    _check_start(path, data)
    _check_sections(path, data)
    _check_tags(path, data)
    mesh = load(path, ".msh", meshio.gmsh.read)
    return to_mesh(path, mesh, Source(path, NAME, _GmshContent(data, mesh.points)))


def check(path: pathlib.Path, mesh: Mesh) -> None:
    """Raises `ValueError` for patches of a new file that boundary faces cannot express, or whose name ends before its end."""
    if source_of(mesh, NAME) is not None:
        return
    for name in mesh.patches:
        if any(mark in name for mark in '"\r\n') or not name:
            raise ValueError(
                f"{path}: {name!r} cannot be the name of a physical group: empty, or with '\"' or a line break."
            )
    patch_faces(mesh)


def write(path: pathlib.Path, mesh: Mesh, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes the file the mesh came from with new coordinates; for any other mesh a new file of version 2.2, binary.

    So it is with a mesh from ascii 4.0, whose rows of coordinates look like the heads of its blocks. In a new file a patch
    becomes a physical group, with the boundary faces between its nodes as elements.
    """
    source = source_of(mesh, NAME)
    if source is None or _format(source.content.data) == (b"4.0", False):
        meshio.gmsh.write(str(path), _new(mesh), fmt_version="2.2", binary=True)
        return
    points = np.array(source.content.points, dtype=float)
    points[:, : mesh.points.shape[1]] = np.asarray(mesh.points)
    with path.open("wb") as file:
        file.writelines(_replaced(source.content.data, points))


def _new(mesh: Mesh) -> meshio.Mesh:
    blocks: list[Any] = [(kind, np.asarray(corners)) for kind, corners in mesh.cells.items()]
    tags = [np.zeros(len(corners), np.int32) for _, corners in blocks]
    groups = {}
    for tag, (name, faces) in enumerate(patch_faces(mesh).items(), start=1):
        for kind, corners in faces.items():
            if len(corners):
                groups[name] = np.array([tag, DIMENSION[kind]])
                blocks.append((kind, corners))
                tags.append(np.full(len(corners), tag, np.int32))
    cell_data: Any = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    return meshio.Mesh(mesh.to_meshio().points, blocks, cell_data=cell_data, field_data=groups)


def _replaced(data: bytes, points: np.ndarray) -> Iterator[bytes | memoryview]:
    """Yields the file with other coordinates, in pieces; meshio numbers the points in the order of the file."""
    version, is_binary, start = _nodes(data)
    if is_binary:
        copy = bytearray(data)
        done = 0
        for view, _ in _binary_blocks(data, start, version):
            block = _view(copy, view)
            block[:] = points[done : done + len(block)]
            done += len(block)
        yield bytes(copy)
        return
    stop = data.index(b"$EndNodes", start)
    rows, column = (4, 1) if version.startswith(b"2") else (3, 0)
    yield from replace(data, slice(start, stop), points, lambda counts: counts == rows, column)


def _nodes(data: bytes) -> tuple[bytes, bool, int]:
    """Finds the version of a file, whether it is binary, and where the lines of `$Nodes` begin.

    It goes from section to section, for a comment may hold any word. It raises `ValueError` for a file without them.
    """
    version, is_binary = _format(data)
    for name, start, _ in _sections(data):
        if name == b"Nodes":
            return version, is_binary, start
    raise ValueError("no $Nodes")


def _format(data: bytes) -> tuple[bytes, bool]:
    version, binary, _ = data[data.index(b"$MeshFormat") :].split(b"\n", 2)[1].split()
    return version, binary != b"0"


def _sections(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yields the name of each section, where its lines begin, and where its `$End...` stands; `ValueError` for one without."""
    at = data.index(b"$MeshFormat")
    while (at := data.find(b"$", at)) >= 0:
        start = data.find(b"\n", at) + 1
        name = data[at + 1 : start].strip()
        stop = data.find(b"$End" + name, start)
        if start == 0 or stop < 0:
            raise ValueError(f"${name.decode(errors='replace')[:40]} has no end: the file is cut short")
        yield name, start, stop
        at = stop + 4 + len(name)


def _check_start(path: pathlib.Path, data: bytes) -> None:
    """Raises `ValueError` where anything but sections of comments stands before `$MeshFormat`: meshio would not go on."""
    at, number = 0, 1
    while (line := data[at : data.find(b"\n", at) + 1 or None]).strip() == b"$Comments":
        ended = re.compile(rb"^[ \t]*\$EndComments[ \t\r]*$", re.MULTILINE).search(data, at)
        after = data.find(b"\n", ended.end()) + 1 if ended else 0
        at, number = after or len(data), number + data.count(b"\n", at, after)
    if line.strip() != b"$MeshFormat":
        mark = " The file begins with a byte order mark: save it without." if data.startswith(codecs.BOM_UTF8) else ""
        first = line.decode(errors="replace").strip()[:40]
        raise ValueError(f"{path}, line {number}: not a .msh file; $MeshFormat is expected here, not {first!r}.{mark}")


class _Parametric(ValueError):
    """Stands for nodes with parametric coordinates, of which meshio says that it cannot read them."""


def _check_sections(path: pathlib.Path, data: bytes) -> None:
    """Raises `ValueError` for sections that hold more or less than they announce: meshio would take them as they come."""
    try:
        version, is_binary = _format(data)
        for name, start, stop in _sections(data):
            is_text = not is_binary or name == b"PhysicalNames"
            if is_text and name in (b"Nodes", b"Elements"):
                _check_rows(Section(path, data, start, stop), name == b"Nodes", version)
            end = (_end_of_text if is_text else _end_of_binary)(name, version, data, start, stop)
            if end is not None and (end > stop or data[end:stop].strip()):
                raise ValueError(f"more or less in ${name.decode(errors='replace')[:40]} than it announces")
            if not is_text and end == stop and data[stop - 1 : stop] == b"\n":
                raise ValueError(f"a byte less in ${name.decode(errors='replace')[:40]} than it announces")
    except _Parametric:
        return
    except (ValueError, IndexError, OverflowError, struct.error) as error:
        raise ValueError(f"{path}: not a .msh file, or a damaged one ({error}).") from error


def _check_rows(section: Section, are_nodes: bool, version: bytes) -> None:
    """Raises `ValueError` for a row with a number too many or too few: meshio would take numbers from the next one."""
    if not version.startswith(b"2") and version != b"4.1":
        return
    rows = section.rows(np.float64)
    counts, first = rows.counts, rows.first
    if not are_nodes and not np.isfinite(rows.values).all():
        raise ValueError("numbers that are not finite in $Elements")
    wanted = counts.copy()
    if version.startswith(b"2"):
        if are_nodes:
            wanted[1:] = 4
        else:
            kinds, tags = (rows.values[np.minimum(first[1:] + k, len(rows.values) - 1)] for k in (1, 2))
            wanted[1:] = 3 + tags + _corners(kinds)
    else:
        at = 1
        while at < len(counts):
            if counts[at] != 4:
                raise section.error(f"{counts[at]} numbers, 4 expected.", at)
            if not np.isfinite(rows.values[first[at] : first[at] + 4]).all():
                raise section.error("numbers that are not finite.", at)
            last, count = rows.values[first[at] + 2 : first[at] + 4].astype(np.int64)
            here = slice(at + 1, at + 1 + count)
            if count < 0:
                raise section.error(f"a block of {count} rows.", at)
            if are_nodes:
                wanted[here] = 1
                here = slice(here.stop, here.stop + count)
                wanted[here] = 3 if last == 0 else counts[here]  # parameters of nodes on curves and surfaces follow
            else:
                wanted[here] = 1 + _corners(np.array([last]))
            at = here.stop
    wrong = np.flatnonzero(counts != wanted)
    if len(wrong):
        raise section.error(f"{counts[wrong[0]]} numbers, {wanted[wrong[0]]} expected.", int(wrong[0]))


def _corners(kinds: np.ndarray) -> np.ndarray:
    """Looks up the numbers of nodes of elements by gmsh's numbers of their types."""
    known, place = np.unique(kinds, return_inverse=True)
    if not {*known.tolist()} <= {*TYPES}:
        raise ValueError(f"elements of type {next(kind for kind in known.tolist() if kind not in TYPES):g}")
    return np.array([CORNERS_OF[TYPES[int(kind)]] for kind in known])[place]


def _end_of_text(name: bytes, version: bytes, data: bytes, start: int, stop: int) -> int | None:
    """Finds where the announced lines of a section end; None for a section or version that is not looked at."""
    rows = {b"PhysicalNames": 1, b"Nodes": 2 if version == b"4.1" else 1, b"Elements": 1}.get(name)
    if rows is None:
        return None
    numbers = [int(word) for word in data[start : data.index(b"\n", start)].split()[:2]]
    blocks = 0 if name == b"PhysicalNames" or version.startswith(b"2") else numbers.pop(0)
    wanted = 1 + blocks + rows * numbers[0]
    if wanted == data.count(b"\n", start, stop):
        return stop
    lines = sum(1 for line in data[start:stop].splitlines() if line.strip())
    if lines != wanted:
        raise ValueError(f"{lines} lines in ${name.decode()}, {wanted} announced")
    return stop


def _end_of_binary(name: bytes, version: bytes, data: bytes, start: int, stop: int) -> int | None:
    """Finds where the announced bytes of a section end; None for a section that is not looked at."""
    if name == b"Nodes":
        ends = [each.offset + each.strides[0] * each.shape[0] for each, _ in _binary_blocks(data, start, version)]
        # before 4.1, rows begin with a tag of four bytes, before the coordinates
        return max(ends) - 4 * (version != b"4.1") if ends else None
    if name != b"Elements":
        return None
    if version.startswith(b"2"):
        line = data.index(b"\n", start) + 1
        at, left, blocks, width = line, int(data[start:line]), 0, 4
    else:
        blocks, left = struct.unpack_from("<2Q", data, start)
        at, width = (start + 32, 8) if version == b"4.1" else (start + 16, 4)
    while left > 0 or blocks > 0:
        if version.startswith(b"2"):
            kind, count, tags = struct.unpack_from("<3i", data, at)
            at += 12
        else:
            (kind, count), tags = struct.unpack_from("<iQ", data, at + 8), 0
            at += 20
        if kind not in TYPES or count < 0 or tags < 0:
            raise ValueError(f"{count} elements of type {kind} with {tags} tags in $Elements")
        at += count * width * (1 + tags + CORNERS_OF[TYPES[kind]])
        left, blocks = left - count, blocks - 1
    if left or at > stop:
        raise ValueError("$Elements is cut short")
    return at


def _check_tags(path: pathlib.Path, data: bytes) -> None:
    """Raises `ValueError` for tags of nodes far beyond their number: meshio makes a table as long as the largest."""
    try:
        version, is_binary, start = _nodes(data)
        if is_binary:
            tags = np.concatenate([_view(data, tags).ravel() for _, tags in _binary_blocks(data, start, version)])
        else:
            section = Section(path, data, start, data.index(b"$EndNodes", start))
            wanted = 4 if version.startswith(b"2") else 1
            rows = section.rows(np.float64)
            tags = rows.values[rows.first[rows.counts == wanted]]
    except (ValueError, OverflowError, struct.error, TypeError):
        return  # meshio tells what is wrong
    if len(tags) and tags.max() > SPARSE * len(tags) + SPARSE**2:
        raise ValueError(f"{path}: node tag {int(tags.max())} of {len(tags)} nodes: a damaged file, or renumber them.")


def _view(data: bytes | bytearray, block: "_Block") -> np.ndarray:
    return np.ndarray(block.shape, block.dtype, data, block.offset, block.strides)


@dataclasses.dataclass(frozen=True)
class _Block:
    """Locates a block of coordinates, or of tags, in a binary file."""

    offset: int
    shape: tuple[int, int]
    strides: tuple[int, int]
    dtype: str = "<f8"


def _binary_blocks(data: bytes, at: int, version: bytes) -> Iterator[tuple[_Block, _Block]]:
    """Yields where coordinates are, and the tags of their nodes."""
    if version.startswith(b"2"):
        end = data.index(b"\n", at) + 1
        count = int(data[at:end])
        yield _Block(end + 4, (count, 3), (28, 8)), _Block(end, (count, 1), (28, 4), "<i4")
        return
    blocks = struct.unpack_from("<Q", data, at)[0]
    at += 8 * (4 if version == b"4.1" else 2)
    for _ in range(blocks):
        is_parametric, count = struct.unpack_from("<iQ", data, at + 8)
        if is_parametric:
            raise _Parametric
        at += 20
        if version != b"4.1":
            yield _Block(at + 4, (count, 3), (28, 8)), _Block(at, (count, 1), (28, 4), "<i4")
            at += 28 * count
            continue
        at += 8 * count
        yield _Block(at, (count, 3), (24, 8)), _Block(at - 8 * count, (count, 1), (8, 8), "<u8")
        at += 24 * count
