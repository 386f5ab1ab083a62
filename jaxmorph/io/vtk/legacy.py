"""VTK's legacy files (.vtk) of unstructured grids, versions 1 to 5.1, with VTK's arrays."""

import dataclasses
import pathlib
import re
import urllib.parse
from typing import Any

import numpy as np

from jaxmorph._host.cells.orders import swapped_edges
from jaxmorph._host.cells.topology import NODES, VTK, VTK_QUADRATIC

from .._meshio import load, meshio
from .scanner import Scanner

CELLS_OF_ANY_ORDER = ("curve", "triangle", "quadrilateral", "tetrahedron", "hexahedron", "wedge")

COMPONENTS = {
    "VECTORS": 3,
    "NORMALS": 3,
    "TENSORS": 9,
    "TENSORS6": 6,
    "GLOBAL_IDS": 1,
    "PEDIGREE_IDS": 1,
    "EDGE_FLAGS": 1,
}
OTHERS = {7: "polygon", 8: "pixel", 11: "voxel", 42: "polyhedron"}
LAGRANGE = {number: f"VTK_LAGRANGE_{name.upper()}" for number, name in enumerate(CELLS_OF_ANY_ORDER, start=68)}
KINDS = {1: "vertex"} | {number: kind for kind, number in (VTK | VTK_QUADRATIC).items()} | LAGRANGE
"""Types of cells that a mesh may have, by VTK's number."""

ORDER = {"wedge": [0, 2, 1, 3, 5, 4]}
"""Order in which meshio takes the nodes of a cell from VTK's files, where it is another one."""

HEAD = re.compile(
    rb"# vtk DataFile Version (?P<version>\d\.\d)\s*\n[^\n]*\n\s*(ASCII|BINARY)\s+DATASET\s+(\w+)[^\n]*\n",
    re.IGNORECASE,
)


def read(path: pathlib.Path) -> meshio.Mesh:
    """Reads a grid with its arrays, as meshio has it; meshio reads grids that are not unstructured.

    It raises `ValueError` for a damaged file, with its last section.
    """
    data = path.read_bytes()
    head = HEAD.match(data)
    if head is None:
        raise ValueError(f"{path}: not a .vtk file; `# vtk DataFile Version` and three lines more are expected first.")
    if head[3].upper() != b"UNSTRUCTURED_GRID":
        return load(path, ".vtk", meshio.vtk.read)
    scanner = Scanner(data, head.end(), head[2].upper() == b"ASCII")
    try:
        grid = _grid(scanner)
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        place = f"in the section that begins with {scanner.section!r}" if scanner.section else "before any section"
        detail = f"{error.args[0]!r} is not known" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{path}: a damaged .vtk file, or one cut short, {place} ({detail[:200]}).") from error
    if head["version"] < b"5.1":
        for block in grid.cells:
            block.data = swapped_edges(block.type, block.data)
    return grid


def _grid(scanner: Scanner) -> meshio.Mesh:
    """Reads section after section, and makes a mesh of them."""
    points, cells, types, sizes = None, None, None, {"POINT_DATA": -1, "CELL_DATA": -1}
    arrays: dict[str, Any] = {"": {}, "POINT_DATA": {}, "CELL_DATA": {}}
    place = ""
    while words := scanner.words():
        key = words[0].upper()
        if key in ("POINTS", "CELLS", "CELL_TYPES", *sizes):
            scanner.section = " ".join(words)
        if key == "POINTS":
            points = scanner.array(int(words[1]), 3, words[2]).reshape(-1, 3)
        elif key == "CELLS":
            cells = _cells(scanner, int(words[1]), int(words[2]))
        elif key == "CELL_TYPES":
            types = scanner.numbers(int(words[1]), "i4")
        elif key in sizes:
            place, sizes[key] = key, int(words[1])
        else:
            _attribute(scanner, key, words, arrays[place], sizes.get(place, -1))
    missing = [
        name for name, section in (("POINTS", points), ("CELLS", cells), ("CELL_TYPES", types)) if section is None
    ]
    if points is None or cells is None or types is None:
        raise ValueError(f"no {' and no '.join(missing)}")
    for name, size, wanted in (("POINT_DATA", "points", len(points)), ("CELL_DATA", "cells", len(types))):
        if sizes[name] not in (-1, wanted) or (sizes[name] == wanted and not arrays[name]):
            raise ValueError(f"{name} of {sizes[name]} rows and {len(arrays[name])} arrays, for {wanted} {size}")
    blocks, ends = _blocks(cells, types, len(points))
    cell_data: Any = {name: np.split(values, ends) for name, values in arrays["CELL_DATA"].items()}
    return meshio.Mesh(points, blocks, arrays["POINT_DATA"], cell_data, field_data=arrays[""])


@dataclasses.dataclass(frozen=True)
class _Cells:
    """Number of cells, where each one's nodes begin and all end (None before 5.1), all nodes."""

    count: int
    offsets: np.ndarray | None
    nodes: np.ndarray


def _cells(scanner: Scanner, count: int, size: int) -> _Cells:
    """Reads the nodes of cells. A cell's number stands before it up to 5.0, then in offsets."""
    start = scanner.at
    words = scanner.words()
    if words[:1] != ["OFFSETS"]:
        scanner.at = start
        return _Cells(count, None, scanner.numbers(size, "i4").astype(np.int64))
    offsets = scanner.array(count, 1, words[1])
    words = scanner.words()
    if words[:1] != ["CONNECTIVITY"]:
        raise ValueError("no CONNECTIVITY after OFFSETS")
    return _Cells(count - 1, offsets, scanner.array(size, 1, words[1]).astype(np.int64))


def _begins(cells: _Cells, types: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds where the nodes of each cell begin, and their number.

    The number follows from the type, and what the file says must agree.
    """
    strange = sorted({*types.tolist()} - {*KINDS})
    if strange:
        told = ", ".join(f"{OTHERS.get(number, 'others')} (type {number})" for number in strange)
        raise ValueError(f"cells that are not supported: {told}. They would be lost")
    # The sizes by type say where each cell begins. Before 5.1 a cell's number of nodes stands
    # before its nodes, so places are shifted by one more for each cell.
    known = np.array(sorted(KINDS))
    sizes = np.array([NODES.get(KINDS[number], 1) for number in known])[np.searchsorted(known, types)]
    _measure_lagrange(cells, types, sizes)
    ends = np.append(0, np.cumsum(sizes))
    if cells.offsets is None:
        ends += np.arange(len(ends))
    if len(types) != cells.count or ends[-1] != len(cells.nodes):
        raise ValueError(f"{len(types)} types of {ends[-1]} nodes, for {cells.count} cells of {len(cells.nodes)}")
    if cells.offsets is not None:
        agree, begins = cells.offsets == ends, ends[:-1]
    else:
        agree, begins = cells.nodes[ends[:-1]] == sizes, ends[:-1] + 1
    if not agree.all():
        raise ValueError(f"cell {agree.argmin()} has not as many nodes as its type")
    return begins, sizes


def _measure_lagrange(cells: _Cells, types: np.ndarray, sizes: np.ndarray) -> None:
    """Takes the number of nodes of cells of any order, in `sizes`, from the file."""
    rows = np.flatnonzero(np.isin(types, list(LAGRANGE)))
    if cells.offsets is not None and len(cells.offsets) == len(types) + 1:
        sizes[rows] = np.diff(cells.offsets)[rows]
    elif cells.offsets is None:
        begins = np.cumsum(np.append(0, sizes + 1))
        beyond = 0  # nodes of the cells before that `begins` does not count
        for row in rows.tolist():
            begin = int(begins[row]) + beyond
            if begin >= len(cells.nodes):
                raise ValueError(f"the file ends before cell {row}")
            beyond += int(cells.nodes[begin]) - int(sizes[row])
            sizes[row] = cells.nodes[begin]
    if len(rows) and sizes[rows].min() < 1:
        raise ValueError(f"a cell of {sizes[rows].min()} nodes")


def _blocks(cells: _Cells, types: np.ndarray, n: int) -> tuple[list, np.ndarray]:
    """Makes blocks of consecutive cells of one type; and the first cells of later blocks."""
    begins, sizes = _begins(cells, types)
    ends = np.flatnonzero((np.diff(types) != 0) | (np.diff(sizes) != 0)) + 1
    blocks = []
    for rows in np.split(np.arange(len(types)), ends) if len(types) else []:
        kind = KINDS[int(types[rows[0]])]
        corners = cells.nodes[begins[rows][:, None] + np.arange(int(sizes[rows[0]]))]
        if corners.min() < 0 or corners.max() >= n:
            raise ValueError(f"nodes {corners.min()} to {corners.max()} in cells, of {n} points")
        blocks.append((kind, corners[:, ORDER.get(kind, slice(None))]))
    return blocks, ends


def _attribute(scanner: Scanner, key: str, words: list[str], arrays: dict[str, np.ndarray], rows: int) -> None:
    """Reads the arrays of one keyword, without lookup tables."""
    if key == "FIELD":
        if rows < 0 and scanner.section:
            raise ValueError("a field of arrays, but neither POINT_DATA nor CELL_DATA before it")
        for _ in range(int(words[2])):
            _field(scanner, arrays, rows)
        return
    if rows < 0:
        raise ValueError(f"{' '.join(words)[:60]!r} is neither a section nor an array")
    name = urllib.parse.unquote(words[1])
    if key == "LOOKUP_TABLE":
        scanner.numbers(4 * int(words[2]), "f4" if scanner.is_text else "u1")
    elif key == "COLOR_SCALARS":
        columns = int(words[2])
        values = scanner.numbers(rows * columns, "f4" if scanner.is_text else "u1")
        values = np.round(255 * values).astype(np.uint8) if scanner.is_text else values
        arrays[name] = values if columns == 1 else values.reshape(rows, columns)
    elif key == "SCALARS":
        columns = int(words[3]) if len(words) > 3 else 1
        if (table := scanner.words())[:1] != ["LOOKUP_TABLE"]:
            raise ValueError(f"{' '.join(table)[:60]!r} where LOOKUP_TABLE is expected")
        arrays[name] = scanner.array(rows, columns, words[2])
    elif key == "TEXTURE_COORDINATES":
        arrays[name] = scanner.array(rows, int(words[2]), words[3])
    else:
        arrays[name] = scanner.array(rows, COMPONENTS[key], words[2])


def _field(scanner: Scanner, arrays: dict[str, np.ndarray], rows: int) -> None:
    """Reads one array of a field; strings are left out where they belong to no points or cells."""
    words = scanner.words()
    if words == ["NULL_ARRAY"]:
        return
    if len(words) != 4:
        raise ValueError(f"{' '.join(words)[:60]!r} where the name, sizes and type of an array are expected")
    columns, count = int(words[1]), int(words[2])
    if (rows >= 0 and count != rows) or columns < 1:
        raise ValueError(f"an array of {columns} times {count} numbers, for {rows} rows")
    if words[3].lower() != "string":
        arrays[urllib.parse.unquote(words[0])] = scanner.array(count, columns, words[3])
    elif rows >= 0:
        raise ValueError(f"the array {words[0]} holds strings, which are not kept: save the file without it")
    else:
        scanner.strings(columns * count)
