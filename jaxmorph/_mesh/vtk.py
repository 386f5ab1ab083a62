"""VTK's unstructured grids as a `Grid`, and a `Mesh` as one of VTK's grids."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from .._host.cells.orders import VTK_ORDER, reordered
from .._host.cells.topology import CORNERS, DIMENSION, NODES, SHAPES, VTK, VTK_LAGRANGE, VTK_QUADRATIC
from .exchange import Arrays, Grid, Parts, checked_parts, imported, parts
from .faces import Faces, faces_of_cells, joined_faces
from .polyhedra import cells_of_faces, spread

POLYHEDRON = 42

AXIS_ALIGNED = {8: ("quad", [0, 1, 3, 2]), 11: ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6])}
"""Pixels and voxels: the type with their corners, and the order of these."""

OTHERS = {
    **{0: ("empty", 0), 1: ("vertex", 0), 2: ("poly_vertex", 0), 4: ("poly_line", 1), 6: ("triangle_strip", 2)},
    **{7: ("polygon", 2), POLYHEDRON: ("polyhedron", 3)},
}
"""Names and dimensions of VTK's other linear cells."""

_KINDS = {number: kind for kind, number in (VTK | VTK_QUADRATIC).items()}
_KINDS |= {number: kind for number, (kind, _) in (AXIS_ALIGNED | OTHERS).items()}
_SHAPES = {number: shape for shape, number in VTK_LAGRANGE.items()}


def vtk(name: str) -> Any:
    return imported(f"vtkmodules.{name}", "io")


def _as_numpy(array: Any) -> np.ndarray:
    return vtk("util.numpy_support").vtk_to_numpy(array)


def _arrays_of(cells: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns where the rows of a `vtkCellArray` begin, with the end, and all of its ids."""
    if cells is None or not cells.GetNumberOfCells():
        return np.zeros(1, np.int64), np.zeros(0, np.int64)
    return _as_numpy(cells.GetOffsetsArray()), _as_numpy(cells.GetConnectivityArray())


def numbers_of(grid: Any) -> np.ndarray:
    if not grid.GetNumberOfCells():
        return np.zeros(0, np.uint8)
    return _as_numpy(grid.GetCellTypes())


def data_of(attributes: Any) -> dict[str, np.ndarray]:
    found = {}
    for k in range(attributes.GetNumberOfArrays()):
        array, name = attributes.GetArray(k), attributes.GetAbstractArray(k).GetName()
        if array is not None and name is not None and array.GetDataType() != 1:  # of bits NumPy has no view
            found[name if isinstance(name, str) else name.decode("latin-1")] = _as_numpy(array)
    return found


def coordinates(grid: Any) -> np.ndarray:
    return _as_numpy(grid.GetPoints().GetData()) if grid.GetNumberOfPoints() else np.zeros((0, 3))


def unstructured(data: Any) -> Any:
    if data.IsA("vtkUnstructuredGrid"):
        return data
    joined = vtk("vtkFiltersCore").vtkAppendFilter()
    joined.AddInputData(data)
    joined.Update()
    grid = joined.GetOutput()
    grid.GetFieldData().ShallowCopy(data.GetFieldData())
    return grid


def kinds_of(grid: Any) -> np.ndarray:
    """Names the type of each cell (k,) as here, or as VTK does where it is unknown."""
    starts, _ = _arrays_of(grid.GetCells())
    sizes = np.diff(starts)
    base = int(sizes.max(initial=0)) + 1  # a type and a size make one number
    both, which = np.unique(numbers_of(grid).astype(np.int64) * base + sizes, return_inverse=True)
    names = [_kind(*divmod(pair, base)) for pair in both.tolist()]
    return np.array(names, dtype=object)[which] if names else np.zeros(0, object)


def _kind(number: int, size: int) -> str:
    if number in _SHAPES:
        shape = _SHAPES[number]
        return shape if size == CORNERS[shape] else f"{shape}{size}"
    if number not in _KINDS:
        names = vtk("vtkCommonDataModel").vtkCellTypeUtilities
        return names.GetClassNameFromTypeId(number).removeprefix("vtk")
    return _KINDS[number]


def _dimension(kind: str) -> int:
    return DIMENSION.get(kind, dict(OTHERS.values()).get(kind, 3))


def solid_cells(kinds: np.ndarray) -> np.ndarray:
    levels = {kind: _dimension(kind) for kind in set(kinds.tolist())}
    highest = max(levels.values(), default=0)
    return np.flatnonzero(np.isin(kinds, [kind for kind, level in levels.items() if level == highest]))


def dimension_of(grid: Any) -> int:
    return max(map(_dimension, set(kinds_of(grid).tolist())), default=0)


def of_vtk(grid: Any) -> Grid:
    """Reads points, cells and arrays of an unstructured grid.

    Polyhedra become standard cells or are cut. It raises `ValueError` for cells
    that no mesh has, and for ids of nodes that are not there.
    """
    points, (_, ids) = coordinates(grid), _arrays_of(grid.GetCells())
    outside = ids[(ids < 0) | (ids >= len(points))]
    if len(outside):
        raise ValueError(f"a cell names node {outside[0]}, but there are {len(points)} points.")
    kinds = kinds_of(grid)
    solid = solid_cells(kinds)
    top = dict.fromkeys(kinds[solid].tolist())
    unknown = sorted(top.keys() - {*NODES, "polyhedron"})
    _refuse(kind for kind in unknown if _dimension(kind) > 1)
    blocks, whole, outer, done = [], (None, None), None, {}
    if "polyhedron" in top:
        blocks, whole, outer = _polyhedral(grid, points.astype(float), kinds, solid)
        done = top
    for kind in dict.fromkeys(kinds.tolist()):
        if kind not in done:
            blocks += _of_kind(grid, kind, np.flatnonzero(kinds == kind))
    data = data_of(grid.GetCellData())
    cell_data = {name: [values[rows] for *_, rows in blocks] for name, values in data.items()}
    read = [(kind, corners) for kind, corners, _ in blocks]
    known: dict[str, Any] = {"content": grid, "outer": outer, "whole": whole}
    return Grid(points, read, data_of(grid.GetPointData()), cell_data, **known)


def _refuse(kinds: Iterable[str], where: str = "") -> None:
    names = ", ".join(kinds)
    if names:
        raise ValueError(f"cells of type {names}{where} are not supported; they would be lost.")


def _of_kind(grid: Any, kind: str, rows: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    (starts, ids), numbers = _arrays_of(grid.GetCells()), numbers_of(grid)
    sizes = np.diff(starts)[rows]
    if kind in NODES and (sizes != NODES[kind]).any():
        raise ValueError(f"cells of type {kind} have {sizes[sizes != NODES[kind]][0]} nodes, not {NODES[kind]}.")
    for size in np.unique(sizes).tolist():
        chosen = rows[sizes == size]
        nodes = ids[starts[chosen][:, None] + np.arange(size)]
        yield kind, _canonical(kind, nodes, numbers[chosen]), chosen


def _canonical(kind: str, nodes: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    nodes = np.asarray(nodes, np.int64)
    for number, (other, order) in AXIS_ALIGNED.items():
        if other == kind and (numbers == number).any():
            nodes[numbers == number] = nodes[numbers == number][:, order]
    return reordered(kind, nodes, VTK_ORDER, None) if kind in NODES else nodes


def _polyhedral(grid: Any, points: np.ndarray, kinds: np.ndarray, solid: np.ndarray) -> tuple[list, tuple, np.ndarray]:
    """Makes standard cells and tetrahedra of all solid cells of a grid with polyhedra.

    It returns types, corners and the grid's cells, whole cells, and the nodes of outer faces.
    """
    curved = sorted({kind for kind in kinds[solid].tolist() if kind not in CORNERS and kind != "polyhedron"})
    _refuse(curved, " beside polyhedra")
    (starts, ids), numbers = _arrays_of(grid.GetCells()), numbers_of(grid)
    sides = [_sides(grid, points, solid, kinds)]
    for kind in dict.fromkeys(kinds[solid][kinds[solid] != "polyhedron"].tolist()):
        cell = np.flatnonzero(kinds[solid] == kind)
        nodes = ids[starts[solid[cell]][:, None] + np.arange(CORNERS[kind])]
        sides.append(faces_of_cells(kind, _canonical(kind, nodes, numbers[solid[cell]]), cell))
    blocks, whole = cells_of_faces(joined_faces(sides), points, solid)
    blocks.sort(key=lambda block: block[0])
    faces, cells = whole.faces, np.concatenate([cell for *_, cell in blocks])
    rows = np.flatnonzero(faces.neighbour < 0)
    outer = np.unique(faces.labels[spread(faces.starts[rows], faces.starts[rows + 1])[0]])
    of_grid = [(kind, corners, solid[cell]) for kind, corners, cell in blocks]
    return of_grid, (whole if len(whole.cut) else None, cells), outer


def _sides(grid: Any, points: np.ndarray, solid: np.ndarray, kinds: np.ndarray) -> Faces:
    first, face_of = _arrays_of(grid.GetPolyhedronFaceLocations())
    starts, ids = _arrays_of(grid.GetPolyhedronFaces())
    cells = np.flatnonzero(kinds[solid] == "polyhedron")
    if len(first) != len(kinds) + 1:
        raise ValueError(f"faces of {len(first) - 1} cells, for {len(kinds)}.")
    rows, cell = spread(first[solid[cells]], first[solid[cells] + 1])
    face, cell = face_of[rows], cells[cell]
    if len(face) and (face.min() < 0 or face.max() >= len(starts) - 1):
        raise ValueError(f"a polyhedron names face {face.max()}, but there are {len(starts) - 1}.")
    places, which = spread(starts[face], starts[face + 1])
    labels, sizes = ids[places], np.diff(starts)[face]
    outside = labels[(labels < 0) | (labels >= len(points))]
    if len(outside) or (sizes < 3).any():
        raise ValueError(f"a face of a polyhedron has {sizes.min()} nodes, or a node that is not there.")
    begins = np.cumsum(sizes) - sizes
    inward = _inward(points, labels, begins, np.searchsorted(cells, cell))
    back = begins[which] + sizes[which] - 1 - (np.arange(len(labels)) - begins[which])
    labels = labels[np.where(inward[which], back, np.arange(len(labels)))].astype(np.int64)
    return Faces(labels, np.concatenate([[0], np.cumsum(sizes)]), cell, np.full(len(sizes), -1))


def _inward(points: np.ndarray, labels: np.ndarray, begins: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Finds faces that point into their cell: VTK asks for outward ones, but programs differ."""
    sizes = np.diff(begins, append=len(labels))
    which = np.repeat(np.arange(len(begins)), sizes)
    after = np.arange(1, len(labels) + 1)
    after[begins + sizes - 1] = begins
    # A cell's faces have one sense where its edges are gone along once each way. An edge of a cell
    # has +1 in the one sense and -1 in the other, which are summed.
    low, high = np.sort(np.stack([labels, labels[after]]), axis=0)
    order = np.lexsort((high, low, cell[which]))
    edges = np.stack([cell[which], low, high])[:, order]
    first = np.flatnonzero((np.diff(edges, axis=1, prepend=-1) != 0).any(axis=0))
    ways = np.add.reduceat(np.where(labels < labels[after], 1, -1)[order], first)
    count = int(cell.max(initial=-1)) + 1
    is_mixed = np.bincount(edges[0, first], ways != 0, count) > 0
    # Normals are summed over the triangles between a face's mean and its edges.
    middle = np.add.reduceat(points[labels], begins) / sizes[:, None]
    arms = points[labels] - middle[which]
    normal = np.add.reduceat(np.cross(arms, points[labels[after]] - middle[which]), begins)
    number = np.bincount(cell, minlength=count)[:, None]
    centre = np.stack([np.bincount(cell, middle[:, k], count) for k in range(3)], axis=1) / number
    volume = np.einsum("fk,fk->f", normal, middle - centre[cell])
    most = np.bincount(cell, volume, count)[~is_mixed]
    return np.where(is_mixed[cell], volume < 0, 2 * (most < 0).sum() > len(most))


def mesh_of(grid: Any) -> Parts:
    return checked_parts(*parts(of_vtk(grid)))


def new_grid(cells: Mapping[str, Any], points: np.ndarray) -> Any:
    """Makes an unstructured grid; refuses high-order pyramids, which VTK lacks."""
    model, numpy = vtk("vtkCommonDataModel"), vtk("util.numpy_support")
    numbers, ids, ends = [np.zeros(0, np.uint8)], [np.zeros(0, np.int64)], [np.zeros(1, np.int64)]
    for kind, corners in cells.items():
        nodes = reordered(kind, np.asarray(corners), None, VTK_ORDER)
        numbers.append(np.full(len(nodes), number_of(kind), np.uint8))
        ids.append(nodes.ravel().astype(np.int64))
        ends.append(ends[-1][-1] + nodes.shape[1] * np.arange(1, len(nodes) + 1))
    array = model.vtkCellArray()
    array.SetData(*(numpy.numpy_to_vtk(np.concatenate(part), deep=1) for part in (ends, ids)))
    grid = model.vtkUnstructuredGrid()
    grid.SetPoints(points_of(points))
    grid.SetCells(numpy.numpy_to_vtk(np.concatenate(numbers), deep=1), array)
    return grid


def number_of(kind: str) -> int:
    number = (VTK | VTK_QUADRATIC).get(kind, VTK_LAGRANGE.get(SHAPES[kind]))
    if number is None:
        raise ValueError(f"VTK has no cells of type {kind}; it has pyramids of 5 and 13 nodes.")
    return number


def points_of(points: np.ndarray) -> Any:
    new = vtk("vtkCommonCore").vtkPoints()
    new.SetData(vtk("util.numpy_support").numpy_to_vtk(np.ascontiguousarray(points), deep=1))
    return new


def add_arrays(attributes: Any, arrays: Arrays) -> None:
    for name, values in arrays.items():
        kind = {"b": np.uint8, "f": np.float32 if values.dtype.itemsize <= 4 else np.float64}
        values = np.ascontiguousarray(values, kind.get(values.dtype.kind, values.dtype.newbyteorder("=")))
        array = vtk("util.numpy_support").numpy_to_vtk(values, deep=1)
        array.SetName(name)
        attributes.AddArray(array)
