"""The outside of 3-D meshes, and their cells near a plane, for pyvista; curved cells in pieces."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxmorph as jm
from jaxmorph.extend import lagrange_types

from ._style import SEGMENTS, bodies, cell_values, check_cells, finite

PIECES = 1_000_000
"""Pieces that a picture has about at most: edges of large meshes have fewer."""

NOTHING = "there is nothing to draw: the plane cuts no cell."


def pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("pictures in 3-D need pyvista: pip install 'jaxmorph[plot]'") from error
    return pyvista


def lines_of(points: Any, ids: np.ndarray) -> Any:
    return pyvista().PolyData(points, lines=np.insert(ids, 0, 2, axis=1).ravel())


def outlines(section: Any) -> Any:
    cells = section.cast_to_unstructured_grid().GetCells()
    labels, starts = (pyvista().convert_array(part()) for part in (cells.GetConnectivityArray, cells.GetOffsetsArray))
    after = np.roll(labels, -1)
    after[starts[1:] - 1] = labels[starts[:-1]]
    owner = np.repeat(section.cell_data["whole"], np.diff(starts))
    pairs = np.column_stack([np.minimum(labels, after), np.maximum(labels, after), owner])
    edges, counts = np.unique(pairs, axis=0, return_counts=True)
    return lines_of(section.points, np.unique(edges[counts == 1, :2], axis=0))


def patches_of(mesh: jm.Mesh, patch: str | None) -> Sequence[str]:
    check_cells(mesh)
    return bodies(mesh) if patch is None else (patch,)


def outside(mesh: jm.Mesh, points: Any, values: Any, patches: Sequence[str]) -> Any:
    """Returns outer faces, of all or patches; `whole` is the face of a piece of a curved one."""
    on_patch = mesh.patch(*patches) if patches else None
    if mesh.is_curved:
        faces = _curved_faces(mesh, points, values, patches)
    else:
        grid = grid_of(mesh, points, values)
        faces = skin(grid) if mesh.polyhedra is None else _polygons(mesh.polyhedra.faces, grid, mesh.cell_ids)
        if on_patch is not None:
            faces = faces.extract_points(np.isin(faces.point_data["node"], on_patch), adjacent_cells=False)
    if faces.n_cells == 0:
        owner = f"patch {', '.join(map(repr, patches))}" if patches else "the mesh"
        raise ValueError(f"there is nothing to draw: no face of the outside has all its nodes in {owner}.")
    return faces


def skin(grid: Any) -> Any:
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    boundary = vtkGeometryFilter()
    boundary.SetInputData(grid)
    boundary.PassThroughPointIdsOn()
    boundary.Update()
    faces = pyvista().wrap(boundary.GetOutput())
    # a name that the next filter takes again
    faces.point_data["node"] = np.asarray(faces.point_data["vtkOriginalPointIds"])
    return faces


def _polygons(whole: Any, grid: Any, cell_ids: Any) -> Any:
    """Returns polyhedra's outer faces as in the file, with the mean of their cell's pieces."""
    outer = np.flatnonzero(whole.all_neighbours() < 0)
    nodes, corners = np.unique(np.concatenate([whole.nodes(k, k + 1) for k in outer.tolist()]), return_inverse=True)
    sizes = whole.sizes[outer]
    polygons = np.insert(corners.ravel(), np.cumsum(sizes) - sizes, sizes)
    faces = pyvista().PolyData(np.asarray(grid.points)[nodes], polygons)
    faces.point_data["node"] = nodes
    if "values" in grid.cell_data:
        mean = np.bincount(cell_ids, grid.cell_data["values"]) / np.bincount(cell_ids)
        faces.cell_data["values"] = mean[whole.owner[outer]]
    return faces


def _places(mesh: jm.Mesh, points: Any) -> np.ndarray:
    if mesh.points.shape[1] != 3:
        raise ValueError(f"this is for 3-D meshes, not {mesh}; see `plot.mesh` and `plot.before_after`.")
    return finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)


def grid_of(mesh: jm.Mesh, points: Any, values: Any) -> Any:
    grid = jm.Mesh(_places(mesh, points), mesh.cells).to_pyvista()
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)
    return grid


def _curved_faces(mesh: jm.Mesh, points: Any, values: Any, patches: Sequence[str]) -> Any:
    """Returns outer faces of curved cells in pieces, all or those with all nodes on a patch."""
    surface, owner = mesh.moved(_places(mesh, points)).skin(*patches)
    if not sum(map(len, surface.cells.values())):
        return pyvista().PolyData()
    grid = _refined(surface)
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)[owner][grid.cell_data["whole"]]
    return skin(grid)


def near_plane(mesh: jm.Mesh, points: Any, values: Any, normal: np.ndarray, origin: np.ndarray) -> Any:
    x, chosen, number, first = _places(mesh, points), {}, [], 0
    above = (x - origin) @ normal
    for kind, ids in mesh.cells.items():
        low, high = above[ids].min(axis=1), above[ids].max(axis=1)
        room = (high - low) / 2  # a curved cell goes beyond its nodes
        is_met = (low - room <= 0) & (high + room >= 0) & (lagrange_types()[kind].dimension == 3)
        chosen[kind] = np.asarray(ids)[is_met]
        number.append(first + np.flatnonzero(is_met))
        first += len(ids)
    if not sum(map(len, chosen.values())):
        raise ValueError(NOTHING)
    grid = _refined(jm.Mesh(x, chosen))
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)[np.concatenate(number)][grid.cell_data["whole"]]
    return grid


def _refined(mesh: jm.Mesh) -> Any:
    """Cuts curved cells into linear pieces, which share points; `whole` is the cell of each."""
    types = [(lagrange_types()[kind], len(ids)) for kind, ids in mesh.cells.items() if len(ids)]
    order, dimension = max(cell.order for cell, _ in types), max(cell.dimension for cell, _ in types)
    count = sum(number * cell.order**cell.dimension for cell, number in types)
    fine, owner = mesh.refined(order * int(np.clip((PIECES / max(count, 1)) ** (1 / dimension), 1, SEGMENTS)))
    grid = fine.to_pyvista()
    grid.cell_data["whole"] = owner
    return grid
