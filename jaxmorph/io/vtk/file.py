"""VTK's unstructured grids, XML (.vtu) and legacy (.vtk), through meshio."""

import functools
import pathlib
import re
import tempfile
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxmorph._host.cells.orders import swapped_edges
from jaxmorph._host.cells.topology import CORNERS, NODES, SHAPES, VTK, VTK_QUADRATIC
from jaxmorph._mesh.exchange import Parts

from .._format import Arrays, FilePoints, MeshLike, Source
from .._meshio import load, meshio, of_mesh, to_mesh
from . import legacy

NAME = "VTK"


def read(path: pathlib.Path) -> Parts:
    """Reads points, cells and patches as `Mesh.from_meshio` finds them.

    Patches are point arrays `patch:NAME`, as `write` leaves them, or come from numbers.
    """
    if path.suffix.lower() == ".vtu":
        data = path.read_bytes()
        version = re.search(rb'<VTKFile[^>]*\sversion="(\d+)\.(\d+)"', data[:4096])
        number = 10 * int(version[1]) + int(version[2]) if version else 1
        if b"vtkLZ4DataCompressor" in data[:4096]:
            raise ValueError(
                f"{path}: compressed by LZ4, which is not read; write it with ZLib (ParaView: Compressor Type)."
            )
        reader = meshio.vtu.read
        if version is not None and number >= 20:
            reader = functools.partial(_read_newer, data, version.end())
        mesh = load(path, ".vtu", reader)
        if number < 22:
            for block in mesh.cells:
                block.data = swapped_edges(block.type, block.data)
        if b'"ascii"' in data:
            _check_counts(path)
    else:
        mesh = legacy.read(path)
    return to_mesh(path, mesh, Source(path, NAME, mesh, in_file=FilePoints(np.asarray(mesh.points, float)).in_file))


def _read_newer(data: bytes, head: int, _: str) -> Any:
    """Reads a file of version 2.3, unknown to meshio: only the order of hexahedra differs."""
    with tempfile.TemporaryDirectory() as folder:
        older = pathlib.Path(folder) / "older.vtu"
        older.write_bytes(re.sub(rb'(\sversion=")[\d.]+"', rb'\g<1>1.0"', data[:head]) + data[head:])
        return meshio.vtu.read(str(older))


def _check_counts(path: pathlib.Path) -> None:
    """Raises `ValueError` for text lists of points or cells longer or shorter than announced."""
    for piece in ElementTree.parse(path).iter("Piece"):
        values = {}
        for array in [*piece.iterfind("Points/DataArray"), *piece.iterfind("Cells/DataArray")]:
            if array.get("format") == "ascii":
                values[array.get("Name", "Points").lower()] = (array.text or "").split()
        points, cells = int(piece.get("NumberOfPoints", 0)), int(piece.get("NumberOfCells", 0))
        wanted = {"points": 3 * points, "offsets": cells, "types": cells}
        wanted["connectivity"] = int((values.get("offsets") or ["0"])[-1])
        for name, count in wanted.items():
            if name in values and len(values[name]) != count:
                raise ValueError(f"{path}: {len(values[name])} numbers in {name}, {count} expected.")
        if {"offsets", "types"} <= values.keys():
            ends = [0, *map(int, values["offsets"])]
            sizes = {number: CORNERS[kind] for kind, number in VTK.items()} | {1: 1}
            sizes |= {number: NODES[kind] for kind, number in VTK_QUADRATIC.items()}
            for k, kind in enumerate(map(int, values["types"])):
                if sizes.get(kind, ends[k + 1] - ends[k]) != ends[k + 1] - ends[k]:
                    raise ValueError(f"{path}: cell {k} is of type {kind} and has {ends[k + 1] - ends[k]} nodes.")


def check(path: pathlib.Path, mesh: MeshLike) -> None:
    """Raises `ValueError` for pyramids that VTK does not have.

    All other meshes fit, with patches as flags of points.
    """
    unknown = [kind for kind in mesh.cells if SHAPES[kind] == "pyramid" and kind not in VTK | VTK_QUADRATIC]
    if unknown:
        raise ValueError(f"{path}: VTK has no cells of type {', '.join(unknown)}; it has pyramids of 5 and 13 nodes.")


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes in double precision, .vtu compressed; keeps the cells and arrays of its own file."""
    made = of_mesh(mesh, point_data, cell_data)
    is_legacy = path.suffix.lower() == ".vtk"
    blocks: Any = [(block.type, swapped_edges(block.type, block.data)) for block in made.cells]
    out: Any = meshio.Mesh(made.points, blocks, made.point_data, made.cell_data, field_data=made.field_data)
    ends = np.cumsum([len(block.data) for block in out.cells])[:-1]
    name_of = _quoted if is_legacy else str
    out.point_data = {name_of(name): _storable(values, is_legacy) for name, values in out.point_data.items()}
    joined = {name_of(name): _storable(np.concatenate(parts), is_legacy) for name, parts in out.cell_data.items()}
    out.cell_data = {name: np.split(values, ends) for name, values in joined.items()}
    if is_legacy:  # VTK and meshio know the names of types in 4.2; VTK does not know meshio's names in 5.1
        meshio.vtk.write(str(path), out, fmt_version="4.2")
    else:
        meshio.vtu.write(str(path), out)


def _quoted(name: str) -> str:
    """Writes the name of an array as VTK does in legacy files: `%20` for a blank."""
    return re.sub(r"[^!#$&-~]", lambda sign: "".join(f"%{byte:02X}" for byte in sign[0].encode()), name)


def _storable(values: np.ndarray, is_legacy: bool) -> np.ndarray:
    """Gives an array a type of fixed size: `long` has four bytes or eight, by the system."""
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.kind == "f":
        return values.astype(np.float32 if values.dtype.itemsize <= 4 else np.float64)
    is_long = is_legacy and values.dtype.itemsize == 8 and values.size
    return values.astype(np.int32) if is_long and -(2**31) <= values.min() <= values.max() < 2**31 else values
