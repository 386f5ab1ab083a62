"""VTK's unstructured grids, XML (.vtu) and legacy (.vtk), through meshio."""

import pathlib
import re
from xml.etree import ElementTree

from jaxmorph import Mesh
from jaxmorph._host.topology import CORNERS, VTK

from ._format import Arrays, Source
from ._meshio import load, meshio, to_mesh

NAME = "VTK"


def read(path: pathlib.Path) -> Mesh:
    """Reads points, cells and patches as `Mesh.from_meshio` finds them.

    Patches are point arrays `patch:NAME`, as `write` leaves them, or come from numbers.
    """
    reader = meshio.vtu.read if path.suffix.lower() == ".vtu" else meshio.vtk.read
    try:
        mesh = load(path, path.suffix.lower(), reader)
    except ValueError as error:
        if reader is meshio.vtu.read:
            raise
        raise ValueError(f"{error} {_last_section(path)}") from error
    if reader is meshio.vtk.read:
        data = path.read_bytes()
        last = data.rstrip().rpartition(b"\n")[2]
        if last.startswith((b"POINT_DATA", b"CELL_DATA", b"FIELD")):
            raise ValueError(f"{path}: the file ends after {last.decode()!r}: it is cut short.")
        types = max(data.find(b"\nCELL_TYPES"), 0)
        places = [data.find(word, types) for word in (b"\nFIELD", b"\nPOINT_DATA", b"\nCELL_DATA")]
        if places[0] >= 0 and not any(0 <= place < places[0] for place in places[1:]):
            raise ValueError(f"{path}: FIELD after CELL_TYPES, but neither POINT_DATA nor CELL_DATA before it.")
    elif b'"ascii"' in path.read_bytes():
        _check_counts(path)
    return to_mesh(path, mesh, Source(path, NAME, mesh))


def _last_section(path: pathlib.Path) -> str:
    """Says which section of a legacy file is the last one: there it is cut short, or damaged, more often than not."""
    lines = re.findall(rb"^(?:POINTS|CELLS|CELL_TYPES|POINT_DATA|CELL_DATA)\b[ \w]*$", path.read_bytes(), re.MULTILINE)
    if not lines:
        return "It holds no line that begins with POINTS."
    return f"Its last section is {lines[-1].decode()!r}: is the file cut short there?"


def _check_counts(path: pathlib.Path) -> None:
    """Raises `ValueError` for lists of points or cells in text that hold more or less than announced."""
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
            for k, kind in enumerate(map(int, values["types"])):
                if sizes.get(kind, ends[k + 1] - ends[k]) != ends[k + 1] - ends[k]:
                    raise ValueError(f"{path}: cell {k} is of type {kind} and has {ends[k + 1] - ends[k]} nodes.")


def write(path: pathlib.Path, mesh: Mesh, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes in double precision, compressed. A mesh that came from such a file keeps its other cells and arrays."""
    out = mesh.to_meshio(point_data=dict(point_data), cell_data=dict(cell_data))
    (meshio.vtu.write if path.suffix.lower() == ".vtu" else meshio.vtk.write)(str(path), out)
