"""VTK's data sets of every kind, and their files in every form as VTK's own writers make them."""

import itertools
import pathlib

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkIdList, vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkStructuredGrid, vtkUnstructuredGrid
from vtkmodules.vtkIOLegacy import vtkDataSetReader, vtkDataSetWriter
from vtkmodules.vtkIOXML import (
    vtkXMLPolyDataReader,
    vtkXMLPolyDataWriter,
    vtkXMLStructuredGridReader,
    vtkXMLStructuredGridWriter,
    vtkXMLUnstructuredGridReader,
    vtkXMLUnstructuredGridWriter,
)

READERS = {
    ".vtu": vtkXMLUnstructuredGridReader,
    ".vts": vtkXMLStructuredGridReader,
    ".vtp": vtkXMLPolyDataReader,
}
WRITERS = {
    ".vtu": vtkXMLUnstructuredGridWriter,
    ".vts": vtkXMLStructuredGridWriter,
    ".vtp": vtkXMLPolyDataWriter,
}
ENDINGS = {"structured": ".vts", "surface": ".vtp"}

SYNONYMS = {"signed char": "char", "long long": "long", "unsigned long long": "unsigned long"}
"""Types of C that are as wide as another one."""

TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")

BOX = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1, 2, 3)], float)
"""Three cubes side by side."""

FORMS = [
    *itertools.product(
        ("appended raw", "appended", "binary"), ("ZLib", "LZ4", "None"), ("UInt32", "UInt64")
    ),
    ("ascii", "None", "UInt64"),
]
"""How XML files may be encoded."""


def points_of(points: np.ndarray) -> vtkPoints:
    new = vtkPoints()
    new.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=1))
    return new


def in_single(data):
    """The data set with its points in single precision, three digits more than a text of six."""
    places = vtk_to_numpy(data.GetPoints().GetData()).astype("f4") / np.float32(7)
    data.SetPoints(points_of(places))
    return data


def with_arrays(data, *, on_cells: bool = True):
    """The data set with arrays of all sorts."""
    n, k = data.GetNumberOfPoints(), data.GetNumberOfCells()
    for attributes, rows in [
        (data.GetPointData(), n),
        *([(data.GetCellData(), k)] if on_cells else []),
    ]:
        for name, values in {
            "heat": np.linspace(0, 1, rows),
            "mean": np.where(np.arange(rows) == 0, np.nan, 0.5),
            **{dtype: np.arange(rows).astype(dtype) for dtype in TYPES},
            "u": (np.arange(3 * rows).reshape(rows, 3) / 7).astype("f4"),
        }.items():
            array = numpy_to_vtk(values, deep=1)
            array.SetName(name)
            attributes.AddArray(array)
    names = vtkStringArray()
    names.SetName("names")
    for name in ("a b", "c" * 100):
        names.InsertNextValue(name)
    time = numpy_to_vtk(np.array([2.5]), deep=1)
    time.SetName("TimeValue")
    for array in (names, time):
        data.GetFieldData().AddArray(array)
    flags = numpy_to_vtk((vtk_to_numpy(data.GetPoints().GetData())[:, 1] == 0).astype("u1"), deep=1)
    flags.SetName("patch:floor")
    data.GetPointData().AddArray(flags)
    return data


def unstructured(points: np.ndarray, cells: list[tuple[int, list]]) -> vtkUnstructuredGrid:
    """A grid of cells by VTK's number of the type and nodes; of polyhedra (42) a list of faces."""
    grid = vtkUnstructuredGrid()
    grid.SetPoints(points_of(points))
    for number, nodes in cells:
        if number == 42:
            stream = vtkIdList()
            for x in (len(nodes), *(x for face in nodes for x in (len(face), *face))):
                stream.InsertNextId(x)
            grid.InsertNextCell(number, stream)
        else:
            grid.InsertNextCell(number, len(nodes), nodes)
    return grid


def cube(x: int) -> list[int]:
    """Corners of cube number `x` of `BOX`."""
    return [x, x + 1, x + 5, x + 4, x + 8, x + 9, x + 13, x + 12]


def faces_of_box(x: int) -> list[list[int]]:
    """Outward faces of a cube: the lower one, the upper one, and the sides."""
    a, b, c, d, e, f, g, h = cube(x)
    return [[a, d, c, b], [e, f, g, h], [a, b, f, e], [b, c, g, f], [c, d, h, g], [d, a, e, h]]


LOW, (E, F, G, H), *SIDES = faces_of_box(0)
HOUSE = [LOW, [E, F, G], [E, G, H], *SIDES]
"""Faces of cube 0 whose top is two triangles: a polyhedron that is no standard cell."""
ROOF = [faces_of_box(1)[k] for k in (1, 0, 2, 3, 4, 5)]

KINDS = {
    "hexahedra": lambda: unstructured(BOX, [(12, cube(x)) for x in range(3)]),
    "voxels": lambda: unstructured(BOX, [(11, [x, x + 1, x + 4, x + 5, x + 8, x + 9, x + 12, x + 13]) for x in range(3)]),
    "polyhedra": lambda: unstructured(
        BOX, [(42, HOUSE), (42, ROOF), (12, cube(2)), (9, [0, 1, 5, 4]), (1, [0])]
    ),
    "structured": lambda: structured(),
    "pixels": lambda: unstructured(BOX[:8], [(8, [x, x + 1, x + 4, x + 5]) for x in range(3)] + [(3, [0, 1])]),
    "surface": lambda: surface(),
}  # fmt: skip
"""Small data sets of each kind, without arrays."""


def structured() -> vtkStructuredGrid:
    grid = vtkStructuredGrid()
    grid.SetDimensions(4, 2, 2)
    grid.SetPoints(points_of(BOX))
    return grid


def surface() -> vtkPolyData:
    data = vtkPolyData()
    data.SetPoints(points_of(BOX[:8]))
    data.Allocate(4)
    for number, nodes in (
        (3, [0, 1]),
        (9, [0, 1, 5, 4]),
        (5, [1, 2, 5]),
        (5, [2, 6, 5]),
        (9, [2, 3, 7, 6]),
    ):
        data.InsertNextCell(number, len(nodes), nodes)
    return data


def write(
    path: pathlib.Path, data, mode: str = "binary", compressor: str = "ZLib", header: str = "UInt64"
) -> None:
    """Writes an XML file in one of `FORMS`."""
    writer = WRITERS[path.suffix]()
    writer.SetInputData(data)
    getattr(writer, f"SetDataModeTo{mode.split()[0].capitalize()}")()
    writer.SetEncodeAppendedData(mode == "appended")
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    getattr(writer, f"SetHeaderTypeTo{header}")()
    writer.SetFileName(str(path))
    writer.Write()


def write_legacy(path: pathlib.Path, data, version: int, *, binary: bool) -> None:
    writer = vtkDataSetWriter()
    writer.SetInputData(data)
    writer.SetFileVersion(version)
    writer.SetWriteArrayMetaData(version > 50)
    (writer.SetFileTypeToBinary if binary else writer.SetFileTypeToASCII)()
    writer.SetFileName(str(path))
    writer.Write()


def read(path: pathlib.Path):
    """The data set in a file, by VTK alone."""
    reader = READERS.get(path.suffix, vtkDataSetReader)()
    if path.suffix == ".vtk":
        for name in ("Scalars", "Vectors", "Fields"):
            getattr(reader, f"ReadAll{name}On")()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def said(data) -> dict[str, list]:
    """Everything that a data set says, but the coordinates: arrays by name, of points, cells and the whole, and cells."""
    told = {}
    parts = (
        ("points", data.GetPointData()),
        ("cells", data.GetCellData()),
        ("whole", data.GetFieldData()),
    )
    for what, fields in parts:
        for k in range(fields.GetNumberOfArrays()):
            array = fields.GetAbstractArray(k)
            values = [array.GetVariantValue(i).ToString() for i in range(array.GetNumberOfValues())]
            kind = SYNONYMS.get(array.GetDataTypeAsString(), array.GetDataTypeAsString())
            told[f"{what} {array.GetName()}"] = [kind, array.GetNumberOfComponents(), *values]
    kinds, nodes = [], vtkIdList()
    for k in range(data.GetNumberOfCells()):
        data.GetCellPoints(k, nodes)
        kinds.append((data.GetCellType(k), [nodes.GetId(i) for i in range(nodes.GetNumberOfIds())]))
        if data.GetCellType(k) == 42:
            cell = data.GetCell(k)
            kinds.append([[cell.GetFace(f).GetPointId(i) for i in range(cell.GetFace(f).GetNumberOfPoints())]
                          for f in range(cell.GetNumberOfFaces())])  # fmt: skip
    return told | {"cells": kinds}


def places(data) -> np.ndarray:
    return vtk_to_numpy(data.GetPoints().GetData())
