"""New CGNS files: one unstructured zone, with a section of elements for each patch."""

import io
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from jaxmorph._host.cells.orders import CGNS_ORDER, reordered
from jaxmorph._host.cells.topology import DIMENSION
from jaxmorph._host.package.arguments import native_order
from jaxmorph._host.rows import join_ids

from .._format import MeshLike, patch_faces
from .._tree import h5py
from .zone import CGNS_TYPES, MIXED

CGNS_VERSION = 3.3
"""The version of CGNS: older libraries read it, too, and from 4.0 on tables of offsets come in."""
LONGEST_NAME = 32
"""Bytes of a name in a CGNS file."""
CGNS_NUMBERS = {kind: number for number, kind in CGNS_TYPES.items()}
CGNS_CODES = {"i1": "C1", "i4": "I4", "i8": "I8", "f4": "R4", "f8": "R8"}
FACE_PLACES = {2: "EdgeCenter", 3: "FaceCenter"}
"""Where a condition on sides of cells holds, by the dimension of the cells."""
NO_TYPE = "Null"
"""The type of a condition of which none is known."""


def check_new_file(path: pathlib.Path, mesh: MeshLike) -> None:
    """Refuses patches that boundary faces cannot express, and names that a node cannot have."""
    if not mesh.cells:
        raise ValueError(f"{path}: a mesh without cells is no zone of CGNS.")
    for name in mesh.patches:
        if not name.strip() or "/" in name or len(name.encode()) > LONGEST_NAME:
            raise ValueError(
                f"{path}: {name!r} cannot be the name of a boundary condition: 1 to {LONGEST_NAME} "
                "bytes without '/' are."
            )
    patch_faces(mesh)


def new_file(mesh: MeshLike, kinds: Mapping[str, str]) -> Iterator[bytes]:
    """Yields a file in HDF5, in which patches have types of `kinds`, by name."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", track_order=True) as file:
        file.create_dataset(" format", data=_letters("IEEE_LITTLE_32\0"))
        file.create_dataset(" hdf5version", data=_letters("HDF5 Version 1.10.8".ljust(33, "\0")))
        _describe(file, "HDF5 MotherNode", "Root Node of HDF5 File", "MT")
        _add_node(
            file, "CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([CGNS_VERSION], np.float32)
        )
        _add_base(file, mesh, kinds)
    yield buffer.getvalue()


def _add_node(parent: Any, name: str, label: str, value: str | ndarray | None = None) -> Any:
    """Adds a node as CGNS lays it out in HDF5: a group, whose array is called " data"."""
    group = parent.create_group(name, track_order=True)
    data = _letters(value) if isinstance(value, str) else value
    _describe(group, name, label, "MT" if data is None else CGNS_CODES[data.dtype.str[1:]])
    group.attrs["flags"] = np.array([1], np.int32)
    if data is not None:
        group.create_dataset(" data", data=data)
    return group


def _letters(text: str) -> ndarray:
    return np.frombuffer(text.encode(), np.int8)


def _describe(group: Any, name: str, label: str, code: str) -> None:
    for key, said, width in (("name", name, 33), ("label", label, 33), ("type", code, 3)):
        text = np.bytes_(said.encode().ljust(width, b"\0"))
        group.attrs.create(key, text, dtype=f"S{width}")


def _add_base(file: Any, mesh: MeshLike, kinds: Mapping[str, str]) -> None:
    points = native_order(np.asarray(mesh.points))
    n, d = points.shape
    level = max(DIMENSION[kind] for kind in mesh.cells)
    base = _add_node(file, "Base", "CGNSBase_t", np.array([level, d], np.int32))
    count = sum(len(ids) for ids in mesh.cells.values())
    zone = _add_node(base, "Zone", "Zone_t", np.array([[n], [count], [0]], np.int32))
    _add_node(zone, "ZoneType", "ZoneType_t", "Unstructured")
    grid = _add_node(zone, "GridCoordinates", "GridCoordinates_t")
    for axis, values in zip("XYZ", points.T, strict=False):
        _add_node(grid, f"Coordinate{axis}", "DataArray_t", np.ascontiguousarray(values))
    end = 0
    for kind, ids in mesh.cells.items():
        end = _add_section(zone, f"{kind} cells", {kind: np.asarray(ids)}, end)
    conditions = _add_node(zone, "ZoneBC", "ZoneBC_t")
    sides = {name: faces for name, faces in patch_faces(mesh).items() if len(mesh.patches[name])}
    for name, faces in sides.items():
        start = end
        end = _add_section(zone, name, faces, start)
        kind = kinds.get(name, NO_TYPE)
        family = _add_node(base, name, "Family_t")
        _add_node(family, "FamilyBC", "FamilyBC_t", kind)
        condition = _add_node(conditions, name, "BC_t", "FamilySpecified")
        _add_node(condition, "PointRange", "IndexRange_t", np.array([[1 + start], [end]], np.int32))
        _add_node(condition, "GridLocation", "GridLocation_t", FACE_PLACES[level])
        _add_node(condition, "FamilyName", "FamilyName_t", name)


def _add_section(zone: Any, name: str, cells: Mapping[str, ndarray], start: int) -> int:
    """Adds elements that are numbered behind the first `start` ones; returns the last number."""
    blocks = {
        CGNS_NUMBERS[kind]: 1 + reordered(kind, ids, None, CGNS_ORDER)
        for kind, ids in cells.items()
        if len(ids)
    }
    end = start + sum(map(len, blocks.values()))
    kind = next(iter(blocks))
    if len(blocks) > 1:  # each element begins with its type
        kind = MIXED
        blocks = {number: np.insert(ids, 0, number, axis=1) for number, ids in blocks.items()}
    section = _add_node(zone, name, "Elements_t", np.array([kind, 0], np.int32))
    _add_node(section, "ElementRange", "IndexRange_t", np.array([1 + start, end], np.int32))
    nodes = join_ids(ids.ravel() for ids in blocks.values()).astype(np.int32)
    _add_node(section, "ElementConnectivity", "DataArray_t", nodes)
    return end
