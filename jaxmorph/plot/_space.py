"""Pictures in space, with pyvista, off screen."""

from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm

from ._style import COLOURS, DARK, GREY, check_values


def surface(
    mesh: jm.Mesh,
    points: Float[Any, "n 3"] | None = None,
    *,
    values: Float[Any, " k"] | None = None,
    limits: tuple[float, float] | None = None,
    patch: str | None = None,
    plotter: Any = None,
) -> Any:
    """The outside of a mesh in space, or one patch of it, each face coloured by the value of its cell.

    `points`, `values` and `limits` as in `mesh`. Returns the pyvista plotter (a new one, off screen, where none is given):
    `plotter.screenshot(path)` writes the picture, `plotter.add_scalar_bar("aspect ratio")` adds the scale.
    """
    outside = _outside(_grid(mesh, points, values))
    if patch is not None:
        on_patch = np.isin(outside.point_data["vtkOriginalPointIds"], mesh.patch(patch))
        outside = outside.extract_points(on_patch, adjacent_cells=False)  # faces with all nodes in it
    return _draw(outside, limits, plotter, lighting=True)


def cut(
    mesh: jm.Mesh,
    points: Float[Any, "n 3"] | None = None,
    *,
    plane: jm.Plane,
    values: Float[Any, " k"] | None = None,
    limits: tuple[float, float] | None = None,
    plotter: Any = None,
) -> Any:
    """The cells of a mesh in space where a plane cuts them; everything else as in `surface`."""
    normal, origin = (np.asarray(vector, dtype=float).tolist() for vector in (plane.normal, plane.origin))
    section = _grid(mesh, points, values).slice(normal=normal, origin=origin)
    return _draw(section, limits, plotter, lighting=False)


def _grid(mesh: jm.Mesh, points: Any, values: Any) -> Any:
    """The mesh as pyvista has it."""
    pyvista = _pyvista()
    points = np.asarray(mesh.points if points is None else points, dtype=float)
    if points.shape[1] != 3:
        raise ValueError(f"this is for cells in space, not {mesh}; see `plot.mesh`.")
    types = {"tetra": 10, "hexahedron": 12, "wedge": 13, "pyramid": 14, "triangle": 5, "quad": 9, "line": 3}
    grid = pyvista.UnstructuredGrid({types[kind]: np.asarray(ids) for kind, ids in mesh.cells.items()}, points)
    if values is not None:
        check_values(values, grid.n_cells)
        grid.cell_data["values"] = np.asarray(values)
    return grid


def _outside(grid: Any) -> Any:
    """Faces that bound the cells. By VTK's own filter: pyvista has called it by several names."""
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    boundary = vtkGeometryFilter()
    boundary.SetInputData(grid)
    boundary.PassThroughPointIdsOn()
    boundary.Update()
    return _pyvista().wrap(boundary.GetOutput())


def _draw(part: Any, limits: tuple[float, float] | None, plotter: Any, *, lighting: bool) -> Any:
    if part.n_cells == 0:
        raise ValueError("there is nothing to draw: the plane cuts no cell, or no face has all its nodes in the patch.")
    if plotter is None:
        pyvista = _pyvista()
        with pyvista.vtk_verbosity("off"):  # it complains where there is no display, and draws all the same
            plotter = pyvista.Plotter(off_screen=True, window_size=(1600, 900))
    coloured = {"scalars": "values", "cmap": COLOURS, "clim": limits} if "values" in part.cell_data else {"color": GREY}
    light = {"ambient": 0.4, "diffuse": 0.7} if lighting else {"lighting": False}  # without: colours as on the scale
    edges = {"show_edges": True, "edge_color": DARK, "line_width": 0.5}
    plotter.add_mesh(part, show_scalar_bar=False, **edges, **light, **coloured)
    return plotter


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("pictures in space need pyvista: pip install 'jaxmorph[plot]'") from error
    return pyvista
