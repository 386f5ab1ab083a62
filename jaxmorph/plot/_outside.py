"""The outside of 3-D meshes, and their cells near a plane, for pyvista."""

from typing import Any

import numpy as np

import jaxmorph as jm

from .._host.cells.pieces import owned_sides
from .._host.cells.topology import DIMENSION, VTK, solid
from ._curved import refined, segments
from ._style import cell_values, finite
from ._view import pyvista

NOTHING = "there is nothing to draw: the plane cuts no cell."


def outlines(section: Any) -> Any:
    """Returns a section's cell edges for pyvista, without edges between two pieces of a cell."""
    labels, starts = corners_of(section)
    after = np.roll(labels, -1)
    after[starts[1:] - 1] = labels[starts[:-1]]
    owner = np.repeat(section.cell_data["whole"], np.diff(starts))
    pairs = np.column_stack([np.minimum(labels, after), np.maximum(labels, after), owner])
    edges, counts = np.unique(pairs, axis=0, return_counts=True)
    edges = np.unique(edges[counts == 1, :2], axis=0)
    return pyvista().PolyData(section.points, lines=np.insert(edges, 0, 2, axis=1).ravel())


def corners_of(faces: Any) -> tuple[np.ndarray, np.ndarray]:
    """Returns the corners of pyvista's faces, and where each face begins (one more at the end)."""
    cells = faces.cast_to_unstructured_grid().GetCells()
    labels, starts = (pyvista().convert_array(part()) for part in (cells.GetConnectivityArray, cells.GetOffsetsArray))
    return labels, starts


def outside(mesh: jm.Mesh, points: Any, values: Any, patch: str | None) -> Any:
    """Returns outer faces, or a patch's faces, for pyvista.

    Faces of polyhedra are whole. Faces of curved cells are cut into pieces; `whole` is then the
    face of each piece. `ValueError` where there are none.
    """
    on_patch = None if patch is None else mesh.patch(patch)
    if mesh.is_curved:
        faces = _curved_faces(mesh, points, values, on_patch)
    else:
        grid = grid_of(mesh, points, values)
        faces = skin(grid) if mesh.polyhedra is None else _polygons(mesh, grid)
    if on_patch is not None and not mesh.is_curved:
        faces = faces.extract_points(np.isin(faces.point_data["node"], on_patch), adjacent_cells=False)
    if faces.n_cells == 0:
        owner = "the mesh" if patch is None else f"patch {patch!r}"
        raise ValueError(f"there is nothing to draw: no face of the outside has all its nodes in {owner}.")
    return faces


def skin(grid: Any) -> Any:
    """Returns the outer faces by VTK's own filter: pyvista has called it by several names."""
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    boundary = vtkGeometryFilter()
    boundary.SetInputData(grid)
    boundary.PassThroughPointIdsOn()
    boundary.Update()
    faces = pyvista().wrap(boundary.GetOutput())
    # a name that the next filter takes again
    faces.point_data["node"] = np.asarray(faces.point_data["vtkOriginalPointIds"])
    return faces


def _polygons(mesh: jm.Mesh, grid: Any) -> Any:
    """Returns polyhedra's outer faces as in the file, with the mean of their cell's pieces."""
    assert mesh.polyhedra is not None
    whole = mesh.polyhedra.faces
    outer = np.flatnonzero(np.append(whole.neighbour, np.full(len(whole.owner) - len(whole.neighbour), -1)) < 0)
    nodes, corners = np.unique(np.concatenate([whole.nodes(k, k + 1) for k in outer.tolist()]), return_inverse=True)
    sizes = whole.sizes[outer]
    faces = pyvista().PolyData(
        np.asarray(grid.points)[nodes], np.insert(corners.ravel(), np.cumsum(sizes) - sizes, sizes)
    )
    faces.point_data["node"] = nodes
    if "values" in grid.cell_data:
        cells = np.asarray(mesh.cell_ids)
        faces.cell_data["values"] = (np.bincount(cells, grid.cell_data["values"]) / np.bincount(cells))[
            whole.owner[outer]
        ]
    return faces


def _places(mesh: jm.Mesh, points: Any) -> np.ndarray:
    if mesh.points.shape[1] != 3:
        raise ValueError(f"this is for 3-D meshes, not {mesh}; see `plot.mesh` and `plot.before_after`.")
    return finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)


def _curved_faces(mesh: jm.Mesh, points: Any, values: Any, on_patch: np.ndarray | None) -> Any:
    """Returns outer faces of curved cells in pieces, all or the faces with all nodes on a patch."""
    x, cells = _places(mesh, points), solid(mesh.cells, 3)
    found = owned_sides({kind: np.asarray(ids) for kind, ids in cells.items()}, len(x), on_patch)
    sides = {kind: ids for kind, (ids, _) in found.items()}
    owner = np.concatenate([owner for _, owner in found.values()])
    if not len(owner):
        return pyvista().PolyData()
    grid, whole = _pieces(sides, x, segments(sides))
    if values is not None:
        inside = np.concatenate([np.full(len(ids), kind in cells) for kind, ids in mesh.cells.items()])
        grid.cell_data["values"] = cell_values(mesh, values)[inside][owner][whole]
    return skin(grid)


def near_plane(mesh: jm.Mesh, points: Any, values: Any, normal: np.ndarray, origin: np.ndarray) -> Any:
    """Returns pieces of the curved cells that a plane may cut."""
    x, chosen, number, first = _places(mesh, points), {}, [], 0
    above = (x - origin) @ normal
    for kind, ids in mesh.cells.items():
        low, high = above[ids].min(axis=1), above[ids].max(axis=1)
        room = (high - low) / 2  # a curved cell goes beyond its nodes
        rows = np.flatnonzero((low - room <= 0) & (high + room >= 0) & (DIMENSION[kind] == 3))
        chosen[kind] = np.asarray(ids)[rows]
        number.append(first + rows)
        first += len(ids)
    if not sum(map(len, chosen.values())):
        raise ValueError(NOTHING)
    grid, whole = _pieces(chosen, x, segments(chosen))
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)[np.concatenate(number)][whole]
    return grid


def _pieces(cells: Any, points: np.ndarray, m: int) -> tuple[Any, np.ndarray]:
    """Cuts curved cells into pieces for pyvista; `whole` is the number of each piece's cell."""
    places, pieces, whole = refined(cells, points, m)
    grid = pyvista().UnstructuredGrid({VTK[shape]: ids for shape, ids in pieces.items()}, places)
    grid.cell_data["whole"] = whole
    return grid, whole


def grid_of(mesh: jm.Mesh, points: Any, values: Any) -> Any:
    """Turns the mesh into pyvista's."""
    points = _places(mesh, points)
    pieces = {VTK[kind]: np.asarray(ids) for kind, ids in mesh.cells.items()}
    grid = pyvista().UnstructuredGrid(pieces, points)
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)
    return grid
