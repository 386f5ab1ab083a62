"""gmsh's .msh, versions 2.2 and 4.1, ascii and binary: read by meshio, written back by replacing the coordinates.

meshio's own writer would lose bounding boxes, second physical groups and comments of a file it has read.
"""

import dataclasses
import pathlib
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
    _check_tags(path, data)
    mesh = load(path, ".msh", meshio.gmsh.read)
    return to_mesh(path, mesh, Source(path, NAME, _GmshContent(data, mesh.points)))


def write(path: pathlib.Path, mesh: Mesh, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes the file the mesh came from with new coordinates; for any other mesh a new file of version 2.2, binary.

    In a new file a patch becomes a physical group, with the boundary faces between its nodes as elements.
    """
    source = source_of(mesh, NAME)
    if source is None:
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
    at = data.index(b"$MeshFormat")
    version, binary, _ = data[at:].split(b"\n", 2)[1].split()
    while True:
        at = data.index(b"$", at)
        end = data.index(b"\n", at)
        name = data[at + 1 : end].strip()
        if name == b"Nodes":
            return version, binary != b"0", end + 1
        at = data.index(b"$End" + name, end) + 4 + len(name)


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
    except (ValueError, struct.error, TypeError):
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
    at += 4 * 8
    for _ in range(blocks):
        count = struct.unpack_from("<Q", data, at + 12)[0]
        at += 20 + 8 * count
        yield _Block(at, (count, 3), (24, 8)), _Block(at - 8 * count, (count, 1), (8, 8), "<u8")
        at += 24 * count
