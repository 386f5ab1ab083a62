"""VTK's unstructured grids as a `Grid`, and a `Mesh` as one of VTK's grids."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from .._host.cells.orders import VTK_ORDER, reordered
from .._host.cells.topology import DIMENSION, NODES, SHAPES, VTK, VTK_LAGRANGE, VTK_QUADRATIC
from .._host.ragged import Ragged
from .._host.rows import join_ids
from .exchange import Arrays, Grid, Parts, check_width, checked_parts, imported, parts, sized
from .faces import Faces, faces_of_cells, joined_faces
from .polyhedra import cells_of_faces

AXIS_ALIGNED = {
    8: [0, 1, 3, 2],
    11: [0, 1, 3, 2, 4, 5, 7, 6],
}  # the order of the corners of pixels and voxels

OTHERS = {
    **{
        8: ("quad", 2),
        11: ("hexahedron", 3),
        0: ("empty", 0),
        1: ("vertex", 0),
        2: ("poly_vertex", 0),
    },
    **{4: ("poly_line", 1), 6: ("triangle_strip", 2), 7: ("polygon", 2), 42: ("polyhedron", 3)},
}
"""Names and dimensions of VTK's other linear cells."""

_KIND_OF_NUMBER = {number: kind for kind, number in (VTK | VTK_QUADRATIC).items()}
_KIND_OF_NUMBER |= {number: kind for number, (kind, _) in OTHERS.items()}
_SHAPE_OF_NUMBER = {number: shape for shape, number in VTK_LAGRANGE.items()}
_LEVELS = dict(OTHERS.values()) | DIMENSION


def vtk(name: str) -> Any:
    return imported(f"vtkmodules.{name}", "io")


def _as_numpy(array: Any) -> np.ndarray:
    return vtk("util.numpy_support").vtk_to_numpy(array)


def _lists_of(cells: Any) -> Ragged:
    """Returns the rows of a `vtkCellArray`: the nodes of cells or faces, the faces of cells."""
    if cells is None or not cells.GetNumberOfCells():
        return Ragged(np.zeros(0, np.int64), np.zeros(1, np.int64))
    return Ragged(_as_numpy(cells.GetConnectivityArray()), _as_numpy(cells.GetOffsetsArray()))


def in_double(data: Any) -> Any:
    """Returns a shallow copy of a data set, of which no array is in single precision."""
    core = vtk("vtkCommonCore")
    copy = data.NewInstance()
    copy.ShallowCopy(data)
    points = core.vtkPoints()
    points.SetData(_doubled(data.GetPoints().GetData()))
    copy.SetPoints(points)
    for field in (copy.GetPointData(), copy.GetCellData(), copy.GetFieldData()):
        for k in range(field.GetNumberOfArrays()):
            if field.GetAbstractArray(k).GetDataType() == core.vtkFloatArray().GetDataType():
                field.AddArray(_doubled(field.GetArray(k)))  # by its name, in its place
    return copy


def _doubled(array: Any) -> Any:
    double = vtk("vtkCommonCore").vtkDoubleArray()
    double.DeepCopy(array)
    return double


def numbers_of(grid: Any) -> np.ndarray:
    return _as_numpy(grid.GetCellTypes()) if grid.GetNumberOfCells() else np.zeros(0, np.uint8)


def data_of(attributes: Any) -> dict[str, np.ndarray]:
    found = {}
    for k in range(attributes.GetNumberOfArrays()):
        array = attributes.GetArray(k)
        name = attributes.GetAbstractArray(k).GetName()
        if (
            array is not None and name is not None and array.GetDataType() != 1
        ):  # of bits NumPy has no view
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
    sizes = _lists_of(grid.GetCells()).sizes
    base = int(sizes.max(initial=0)) + 1  # a type and a size make one number
    both, which = np.unique(numbers_of(grid).astype(np.int64) * base + sizes, return_inverse=True)
    names = [_kind(*divmod(pair, base)) for pair in both.tolist()]
    return np.array(names, dtype=object)[which] if names else np.zeros(0, object)


def _kind(number: int, size: int) -> str:
    if number in _SHAPE_OF_NUMBER:
        return sized(_SHAPE_OF_NUMBER[number], size)
    if number not in _KIND_OF_NUMBER:
        names = vtk("vtkCommonDataModel").vtkCellTypeUtilities
        return names.GetClassNameFromTypeId(number).removeprefix("vtk")
    return _KIND_OF_NUMBER[number]


def solid_cells(kinds: np.ndarray) -> np.ndarray:
    levels = {kind: _LEVELS.get(kind, 3) for kind in set(kinds.tolist())}
    highest = max(levels.values(), default=0)
    return np.flatnonzero(
        np.isin(kinds, [kind for kind, level in levels.items() if level == highest])
    )


def dimension_of(grid: Any) -> int:
    return max((_LEVELS.get(kind, 3) for kind in set(kinds_of(grid).tolist())), default=0)


def of_vtk(grid: Any) -> Grid:
    """Reads points, cells and arrays of an unstructured grid. Polyhedra become standard cells or
    are cut. It raises `ValueError` for cells that no mesh has, and for ids of nodes that are not
    there.
    """
    points = coordinates(grid)
    _check_ids("a cell", _lists_of(grid.GetCells()).values, len(points))
    kinds = kinds_of(grid)
    solid = solid_cells(kinds)
    top = dict.fromkeys(kinds[solid].tolist())
    _refuse(
        kind for kind in sorted(top.keys() - {*NODES, "polyhedron"}) if _LEVELS.get(kind, 3) > 1
    )
    blocks = []
    whole = (None, None)
    outer = None
    if "polyhedron" in top:
        blocks, whole, outer = _polyhedral(grid, points.astype(float), kinds, solid)
    for kind in dict.fromkeys(kinds.tolist()):
        if outer is None or kind not in top:
            blocks += _of_kind(grid, kind, np.flatnonzero(kinds == kind))
    data = data_of(grid.GetCellData())
    cell_data = {name: [values[rows] for *_, rows in blocks] for name, values in data.items()}
    read = [(kind, corners) for kind, corners, _ in blocks]
    return Grid(
        points,
        read,
        data_of(grid.GetPointData()),
        cell_data,
        content=grid,
        outer=outer,
        whole=whole,
    )


def _check_ids(what: str, ids: np.ndarray, count: int) -> None:
    outside = ids[(ids < 0) | (ids >= count)]
    if len(outside):
        raise ValueError(f"{what} names node {outside[0]}, but there are {count} points.")


def _refuse(kinds: Iterable[str], where: str = "") -> None:
    names = ", ".join(kinds)
    if names:
        raise ValueError(f"cells of type {names}{where} are not supported; they would be lost.")


def _of_kind(
    grid: Any, kind: str, rows: np.ndarray
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    cells = _lists_of(grid.GetCells())
    numbers = numbers_of(grid)
    sizes = cells.sizes[rows]
    for size in np.unique(sizes).tolist():
        check_width(kind, size)
        chosen = rows[sizes == size]
        nodes = cells.table(chosen, size).astype(np.int64)
        for number, order in AXIS_ALIGNED.items():
            if (numbers[chosen] == number).any():
                nodes[numbers[chosen] == number] = nodes[numbers[chosen] == number][:, order]
        yield kind, reordered(kind, nodes, VTK_ORDER, None) if kind in NODES else nodes, chosen


def _polyhedral(
    grid: Any, points: np.ndarray, kinds: np.ndarray, solid: np.ndarray
) -> tuple[list, tuple, np.ndarray]:
    """Makes standard cells and tetrahedra of all solid cells of a grid with polyhedra. It returns
    types, corners and the grid's cells, whole cells, and the nodes of outer faces.
    """
    curved = sorted({kind for kind in kinds[solid].tolist() if SHAPES.get(kind, kind) != kind})
    _refuse(curved, " beside polyhedra")
    sides = [_polyhedral_faces(grid, points, solid, kinds)]
    for kind in dict.fromkeys(kinds[solid][kinds[solid] != "polyhedron"].tolist()):
        cell = np.flatnonzero(kinds[solid] == kind)
        sides += [
            faces_of_cells(kind, nodes, cell) for _, nodes, _ in _of_kind(grid, kind, solid[cell])
        ]
    blocks, whole = cells_of_faces(joined_faces(sides), points, solid)
    blocks.sort(key=lambda block: block[0])
    faces = whole.faces
    cells = np.concatenate([cell for *_, cell in blocks])
    rows = np.flatnonzero(faces.neighbour < 0)
    outer = np.unique(faces.rows.take(rows).values)
    of_grid = [(kind, corners, solid[cell]) for kind, corners, cell in blocks]
    return of_grid, (whole if len(whole.cut) else None, cells), outer


def _polyhedral_faces(grid: Any, points: np.ndarray, solid: np.ndarray, kinds: np.ndarray) -> Faces:
    of_cells = _lists_of(grid.GetPolyhedronFaceLocations())
    every = _lists_of(grid.GetPolyhedronFaces())
    cells = np.flatnonzero(kinds[solid] == "polyhedron")
    if len(of_cells) != len(kinds):
        raise ValueError(f"faces of {len(of_cells)} cells, for {len(kinds)}.")
    own = of_cells.take(solid[cells])
    face = own.values
    if len(face) and (face.min() < 0 or face.max() >= len(every)):
        raise ValueError(f"a polyhedron names face {face.max()}, but there are {len(every)}.")
    rows = every.take(face)
    if (rows.sizes < 3).any():
        raise ValueError(f"a face of a polyhedron has {rows.sizes.min()} nodes.")
    labels = rows.values.astype(np.int64)
    _check_ids("a face of a polyhedron", labels, len(points))
    faces = Faces(labels, rows.starts, cells[own.row], np.full(len(rows), -1))
    return dataclasses.replace(faces, labels=faces.rows.turned(_inward(faces, points)).values)


def _inward(faces: Faces, points: np.ndarray) -> np.ndarray:
    """Finds faces that point into their cell: VTK asks for outward ones, but programs differ."""
    # A cell's faces have one sense where its edges are gone along once each way. A node has a
    # random number. Those of an edge's ends make a number whose sign is that of the way, so that
    # the numbers of such a cell add up to zero.
    random = np.random.default_rng(0).integers(2**64, size=len(points), dtype=np.uint64)
    here = random[faces.labels]
    begins = faces.starts[:-1]
    cell = faces.owner
    count = faces.count
    after = faces.after(here)
    balance = np.zeros(count, np.uint64)
    np.add.at(balance, np.repeat(cell, faces.sizes), here * after * (here - after))
    # Normals are summed over the triangles between a face's mean and its edges.
    corners = points[faces.labels]
    middle = np.add.reduceat(corners, begins) / faces.sizes[:, None]
    arms = corners - np.repeat(middle, faces.sizes, axis=0)
    normal = np.add.reduceat(np.cross(arms, faces.after(arms)), begins)
    number = np.maximum(np.bincount(cell, minlength=count), 1)
    centre = np.stack([np.bincount(cell, column, count) / number for column in middle.T], axis=1)
    volume = np.einsum("fk,fk->f", normal, middle - centre[cell])
    most = np.bincount(cell, volume, count)[
        (balance == 0) & (np.bincount(cell, minlength=count) > 0)
    ]
    return np.where(balance[cell] != 0, volume < 0, 2 * (most < 0).sum() > len(most))


def mesh_of(grid: Any) -> Parts:
    return checked_parts(*parts(of_vtk(grid)))


def new_grid(cells: Mapping[str, Any], points: np.ndarray) -> Any:
    """Makes an unstructured grid; refuses high-order pyramids, which VTK lacks."""
    model = vtk("vtkCommonDataModel")
    numpy = vtk("util.numpy_support")
    nodes = [
        reordered(kind, np.asarray(ids), None, VTK_ORDER).astype(np.int64)
        for kind, ids in cells.items()
    ]
    counts = list(map(len, nodes))
    numbers = np.repeat([number_of(kind) for kind in cells], counts).astype(np.uint8)
    sizes = np.repeat([rows.shape[1] for rows in nodes], counts)
    rows = Ragged.of(join_ids(nodes), sizes.astype(np.int64))
    array = model.vtkCellArray()
    array.SetData(*(numpy.numpy_to_vtk(part, deep=1) for part in (rows.starts, rows.values)))
    grid = model.vtkUnstructuredGrid()
    grid.SetPoints(points_of(points))
    grid.SetCells(numpy.numpy_to_vtk(numbers, deep=1), array)
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
        values = np.ascontiguousarray(
            values, kind.get(values.dtype.kind, values.dtype.newbyteorder("="))
        )
        array = vtk("util.numpy_support").numpy_to_vtk(values, deep=1)
        array.SetName(name)
        attributes.AddArray(array)
