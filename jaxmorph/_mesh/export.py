"""Meshes of meshio and PyVista made of a `Mesh`: its origin with other points, or a new mesh."""

import urllib.parse
from typing import Any

import numpy as np

from . import vtk
from .exchange import PREFIX, Arrays, Parts, block_of, imported, intact_source, kind_of_block


def to_meshio(mesh: Parts, point_data: Arrays | None, cell_data: Arrays | None) -> Any:
    meshio = imported("meshio", "io")
    point_arrays, cell_arrays = _check_arrays(mesh, point_data, cell_data)
    old = _origin(mesh, meshio.Mesh)
    points = _points_to_write(mesh, None if old is None else old.points)
    if old is None:
        new = meshio.Mesh(points, [block_of(kind, corners) for kind, corners in mesh.cells.items()])
    else:
        sets = {
            name: dict(getattr(old, name)) for name in ("point_sets", "cell_sets", "field_data")
        }
        new = meshio.Mesh(points, old.cells, dict(old.point_data), dict(old.cell_data), **sets)
    new.point_data.update(point_arrays)
    names = [kind_of_block(block.type, np.asarray(block.data))[0] for block in new.cells]
    kinds = np.repeat(names, [len(block.data) for block in new.cells])
    ends = np.cumsum([len(block.data) for block in new.cells])[:-1]
    new.cell_data.update(
        {
            name: np.split(values, ends)
            for name, values in _of_cells(mesh, cell_arrays, kinds).items()
        }
    )
    return new


def to_pyvista(mesh: Parts, point_data: Arrays | None, cell_data: Arrays | None) -> Any:
    pyvista = imported("pyvista", "plot")
    old = _origin(mesh, pyvista.UnstructuredGrid)
    new = (
        pyvista.wrap(vtk.new_grid(mesh.cells, _points_to_write(mesh, None)))
        if old is None
        else old.copy()
    )
    new.points = _points_to_write(mesh, np.asarray(new.points))
    point_arrays, cell_arrays = _check_arrays(mesh, point_data, cell_data)
    new.point_data.update(point_arrays)
    if cell_arrays:
        new.cell_data.update(_of_cells(mesh, cell_arrays, vtk.kinds_of(new)))
    return new


def to_vtk(mesh: Parts, old: Any, point_data: Arrays | None, cell_data: Arrays | None) -> Any:
    """Makes a VTK grid: `old` with other points in its precision, or if it is None a new one."""
    if old is None:
        new = vtk.new_grid(mesh.cells, _points_to_write(mesh, None))
    else:
        new = old.NewInstance()
        new.ShallowCopy(old)
        was = vtk.coordinates(old)
        new.SetPoints(
            vtk.points_of(
                _points_to_write(mesh, was).astype(np.float32 if was.dtype == np.float32 else float)
            )
        )
    point_arrays, cell_arrays = _check_arrays(mesh, point_data, cell_data)
    vtk.add_arrays(new.GetPointData(), point_arrays)
    if cell_arrays:
        vtk.add_arrays(
            new.GetCellData(), _of_cells(mesh, cell_arrays, vtk.kinds_of(vtk.unstructured(new)))
        )
    return new


def _origin(mesh: Parts, kind: type) -> Any:
    source = intact_source(mesh)
    while hasattr(source, "content"):
        source = source.content
    return source if isinstance(source, kind) else None


def _points_to_write(mesh: Parts, old: np.ndarray | None) -> np.ndarray:
    """Places points in 3-D, in double precision; a 2-D mesh gets its old z, or z = 0."""
    points = np.zeros((len(mesh.points), 3))
    if mesh.points.shape[1] == 2 and old is not None and old.shape[1] == 3:
        points[:, 2] = old[:, 2]
    points[:, : mesh.points.shape[1]] = np.asarray(mesh.points)
    return points


def _check_arrays(
    mesh: Parts, point_data: Arrays | None, cell_data: Arrays | None
) -> tuple[Arrays, Arrays]:
    """Checks lengths, adds patches as point arrays, and a third component 0 to 2-D vectors."""
    cells = sum(map(len, mesh.cells.values()))
    both = []
    for arrays, rows, what in (
        (point_data, len(mesh.points), "points"),
        (cell_data, cells, "cells"),
    ):
        both.append({name: np.asarray(values) for name, values in (arrays or {}).items()})
        for name, values in both[-1].items():
            if values.ndim not in (1, 2) or len(values) != rows:
                raise ValueError(
                    f"array {name!r} has shape {values.shape}; expected one row for each of "
                    f"{rows} {what}."
                )
            if values.dtype.kind not in "biuf":
                raise ValueError(f"array {name!r} holds {values.dtype}; files hold real numbers.")
            if values.shape[1:] == (2,):
                both[-1][name] = np.column_stack([values, np.zeros(rows, values.dtype)])
    for name, nodes in mesh.patches.items():
        inside = np.zeros(len(mesh.points), np.uint8)
        inside[np.asarray(nodes)] = 1
        both[0][f"{PREFIX}{urllib.parse.quote(name)}"] = inside
    return both[0], both[1]


def _of_cells(mesh: Parts, arrays: Arrays, kinds: np.ndarray) -> dict[str, np.ndarray]:
    """Reorders arrays from `mesh.cells` to cells of types `kinds`; other cells get NaN."""
    # `place` is the row of a cell in the arrays, or -1 for a cell of another type, which takes the
    # row of NaN at the end.
    place = np.full(len(kinds), -1)
    if "polyhedron" in kinds:  # a cell that was cut has the value of its first piece
        solid = vtk.solid_cells(kinds)
        ids = mesh.source.cell_ids
        place[solid[ids[::-1]]] = np.arange(len(ids))[::-1]
    first = 0
    for kind, corners in mesh.cells.items() if "polyhedron" not in kinds else ():
        place[kinds == kind] = first + np.arange(
            len(corners)
        )  # cells of one type have one order in both
        first += len(corners)
    if (place < 0).any():
        arrays = {
            name: np.concatenate([each, np.full((1, *each.shape[1:]), np.nan)])
            for name, each in arrays.items()
        }
    return {name: values[place] for name, values in arrays.items()}
