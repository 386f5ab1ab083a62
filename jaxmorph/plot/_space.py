"""Pictures in 3-D, with pyvista, off screen."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph._host.cells.pieces import owners
from jaxmorph._host.cells.topology import VTK
from jaxmorph._host.package.arguments import checked

from ._style import BLUE, DARK, GREY, ORANGE, Limits, Values, cell_values, colour_scale, finite

VIEWER = -1.0, -2.5, 1.8
"""The direction towards the viewer: x to the right, y away, z up."""

MARGIN = 1.15
"""Height and width of a picture, relative to the height and width of its content."""

BAR = 0.16
"""Share of the width, at the right, that is kept for a colour bar."""

SEEN_THROUGH = 0.55
"""Opacity of surfaces that are drawn over each other."""

WINDOW = 1600, 900
"""Pixels of a picture."""


@checked
def surface(
    mesh: jm.Mesh,
    points: Float[Any, "n 3"] | None = None,
    *,
    values: Values | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    patch: str | None = None,
    plotter: Any = None,
) -> Any:
    """Draws the outside of a 3-D mesh, or one patch of it, each face coloured by the value of its cell.

    A surface without values is lit. With values it is not, so that its colours are those of the bar.

    **Arguments:**

    - `mesh`, `points`, `values`, `limits`, `label`, `bar`: those of `plot.mesh`, in 3-D.
    - `patch`: the patch to draw. Default: the whole outside.
    - `plotter`: pyvista's; a new one, off screen, by default.

    **Returns:** the plotter, or a new one, off screen: `plotter.screenshot(path)` writes the picture.

    **Raises:** `ValueError` as `mesh` does, for a mesh in 2-D, for a `patch` that is not known, and where there is no face.
    """
    return _draw(outside(mesh, points, values, patch), limits, label, bar, plotter)


@checked
def before_after_3d(mesh: jm.Mesh, points: Float[Any, "n 3"], *, patch: str | None = None, plotter: Any = None) -> Any:
    """Draws the undeformed outside of a 3-D mesh, or of a patch, in orange, and the deformed one in blue (figure 7a of the paper).

    Both are translucent, so that each is seen through the other.

    **Arguments:**

    - `mesh`, `points`, `patch`, `plotter`: those of `surface`.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `surface` does.
    """
    before, after = outside(mesh, None, None, patch), outside(mesh, points, None, patch)
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    light = {"ambient": 0.4, "diffuse": 0.7, "show_edges": True, "edge_opacity": 0.5, "line_width": 0.5}
    plotter.add_mesh(before, color=ORANGE, opacity=SEEN_THROUGH, label="undeformed", edge_color=DARK, **light)
    plotter.add_mesh(after, color=BLUE, opacity=SEEN_THROUGH, label="deformed", edge_color=DARK, **light)
    plotter.disable_anti_aliasing()  # with samples for each pixel, VTK draws nothing of what it peels
    plotter.enable_depth_peeling(number_of_peels=8)
    plotter.enable_anti_aliasing("ssaa")
    add_legend(plotter, [["undeformed", ORANGE], ["deformed", BLUE]])
    if new:
        aim(plotter)
    return plotter


@checked
def cut(
    mesh: jm.Mesh,
    points: Float[Any, "n 3"] | None = None,
    *,
    plane: jm.Plane,
    values: Values | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    plotter: Any = None,
) -> Any:
    """Draws the cells of a 3-D mesh where a plane cuts them, seen along its normal.

    **Arguments:**

    - `plane`: a `Plane`.
    - `mesh`, `points`, `values`, `limits`, `label`, `bar`, `plotter`: those of `surface`.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `surface` does.
    """
    normal, origin = (np.asarray(vector, dtype=float).tolist() for vector in (plane.normal, plane.origin))
    section = _grid(mesh, points, values).slice(normal=normal, origin=origin)
    drawn = _draw(section, limits, label, bar, plotter, lighting=False)
    if plotter is None:
        aim(drawn, np.array(normal) * (-1 if np.dot(normal, VIEWER) < 0 else 1))
    return drawn


def outside(mesh: jm.Mesh, points: Any, values: Any, patch: str | None) -> Any:
    """Returns the outer faces, or the faces of a patch, for pyvista; `node` is the id of each point.

    VTK's own filter does it: pyvista has called it by several names. `ValueError` where there are none.
    """
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    on_patch = None if patch is None else mesh.patch(patch)
    boundary = vtkGeometryFilter()
    boundary.SetInputData(_grid(mesh, points, values))
    boundary.PassThroughPointIdsOn()
    boundary.Update()
    faces = pyvista().wrap(boundary.GetOutput())
    faces.point_data["node"] = np.asarray(
        faces.point_data["vtkOriginalPointIds"]
    )  # a name that the next filter takes again
    if on_patch is not None:
        chosen = np.isin(faces.point_data["node"], on_patch)
        faces = faces.extract_points(chosen, adjacent_cells=False)
    if faces.n_cells == 0:
        owner = "the mesh" if patch is None else f"patch {patch!r}"
        raise ValueError(f"there is nothing to draw: no face of the outside has all its nodes in {owner}.")
    return faces


def _grid(mesh: jm.Mesh, points: Any, values: Any) -> Any:
    """Turns the mesh into pyvista's."""
    if mesh.points.shape[1] != 3:
        raise ValueError(f"this is for 3-D meshes, not {mesh}; see `plot.mesh` and `plot.before_after`.")
    points = finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
    pieces = {VTK[kind]: np.asarray(ids) for kind, ids in mesh.linear.cells.items()}
    grid = pyvista().UnstructuredGrid(pieces, points)
    if values is not None:
        rows = owners(mesh.cells)
        grid.cell_data["values"] = cell_values(mesh, values)[np.concatenate([rows[kind] for kind in sorted(rows)])]
    return grid


def _draw(part: Any, limits: Any, label: str | None, bar: bool, plotter: Any, *, lighting: bool = True) -> Any:
    """Draws faces, with colours and a bar where they have values."""
    if part.n_cells == 0:
        raise ValueError("there is nothing to draw: the plane cuts no cell.")
    has_values = "values" in part.cell_data
    if label is not None and not has_values:
        raise ValueError(f"there are no `values` that are {label!r}.")
    colours, limits = colour_scale(limits)
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    coloured = {"scalars": "values", "cmap": colours, "clim": limits} if has_values else {"color": GREY}
    is_lit = lighting and not has_values  # light would change the colours, and the bar not
    light = {"ambient": 0.4, "diffuse": 0.7} if is_lit else {"lighting": False}
    edges = {"show_edges": True, "edge_color": DARK, "edge_opacity": 0.7, "line_width": 0.5}
    plotter.add_mesh(part, show_scalar_bar=False, **edges, **light, **coloured)
    if has_values and bar:
        size = {"height": 0.6, "width": 0.05, "position_x": 0.88, "position_y": 0.2}
        font = {"font_family": "arial", "title_font_size": 30, "label_font_size": 26, "fmt": "%.3g", "color": DARK}
        plotter.add_scalar_bar(f"{label or ''}\n", vertical=True, **font, **size)
    if new:
        aim(plotter)
    return plotter


def new_plotter() -> Any:
    with pyvista().vtk_verbosity("off"):  # it complains where there is no display, and draws all the same
        plotter = pyvista().Plotter(off_screen=True, window_size=WINDOW)
    plotter.set_background("white")
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    return plotter


def aim(plotter: Any, viewer: Sequence[float] | np.ndarray = VIEWER) -> None:
    """Turns the camera to all that was drawn, beside the colour bar."""
    set_view(plotter, whole_view(box(plotter), plotter.window_size, viewer, kept(plotter)))


def kept(plotter: Any) -> float:
    """Returns the share of a picture's width that its colour bar takes."""
    return BAR if len(plotter.scalar_bars) else 0.0


def box(plotter: Any) -> Float[np.ndarray, "8 3"]:
    """Returns the corners of the box round all that was drawn."""
    return np.array(list(itertools.product(*np.reshape(plotter.bounds, (3, 2)))))


def whole_view(
    points: Float[np.ndarray, "k 3"],
    window: Sequence[int],
    viewer: Sequence[float] | np.ndarray = VIEWER,
    kept: float = 0,
) -> Float[np.ndarray, " 10"]:
    """Places a camera: its position, what it looks at, upwards, half the height that it sees.

    It has no perspective. All points are in a window of this width and height, left of a share `kept` of the width.
    """
    axes = np.stack(view_axes(viewer))
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, (depth, width, height) = (low + high) / 2 @ axes, high - low
    distance = 2 * (depth + width + height)
    aspect = window[0] / window[1]
    scale = MARGIN / 2 * max(height, width / (1 - kept) / aspect)
    middle = middle + kept * scale * aspect * axes[1]
    return np.array([*(middle + distance * axes[0]), *middle, *axes[2], scale])


def view_of(plotter: Any) -> Float[np.ndarray, " 10"]:
    """Returns the view (10,) of the plotter's camera as it is now."""
    return np.array([*np.ravel(list(plotter.camera_position)), plotter.camera.parallel_scale])


def set_view(plotter: Any, view: Float[np.ndarray, " 10"], is_parallel: bool = True) -> None:
    plotter.camera_position = [tuple(vector) for vector in view[:9].reshape(3, 3).tolist()]
    plotter.camera.parallel_projection, plotter.camera.parallel_scale = is_parallel, float(view[9])
    plotter.renderer.reset_camera_clipping_range()


def view_axes(viewer: Sequence[float] | np.ndarray = VIEWER) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns unit vectors towards the viewer, to the right, and upwards in the picture: z, or y for one who looks along z."""
    towards = np.array(viewer) / np.linalg.norm(viewer)
    across = np.cross((0, 0, 1) if abs(towards[2]) < 0.99 else (0, 1, 0), towards)
    across /= np.linalg.norm(across)
    return towards, across, np.cross(towards, across)


def add_legend(plotter: Any, entries: list[list[str]]) -> None:
    """Writes names, each in its colour, in the upper right corner."""
    for k, (name, colour) in enumerate(entries):
        place = {"position": (0.8, 0.94 - 0.05 * k), "viewport": True, "name": f"legend {k}"}
        plotter.add_text(name, font_size=16, color=colour, **place)


def pyvista() -> Any:
    """Imports the package; the `ImportError` names what to install."""
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("pictures in 3-D need pyvista: pip install 'jaxmorph[plot]'") from error
    return pyvista
