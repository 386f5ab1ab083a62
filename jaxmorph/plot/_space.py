"""Pictures in 3-D, with pyvista, off screen."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph._host.cells.topology import VTK
from jaxmorph._host.package.arguments import checked

from matplotlib.colors import to_hex
from ._plane import ROOM, TextPath, findfont, plt
from ._style import (
    BLUE,
    DARK,
    GREY,
    ORANGE,
    STILL,
    Limits,
    Values,
    bodies,
    cell_values,
    colour_scale,
    finite,
    arrows,
    usual_limits,
)

VIEWER = -1.0, -2.5, 1.8
"""The direction towards the viewer: x to the right, y away, z up; mirrored where it would look into an open surface."""

WINDOW = 1200, 900
"""Width of a picture in pixels, and its largest height."""

TEXT = 30
"""Height of letters in pixels."""

EDGE, BELOW, LEGEND, BAR = 0.025, 0.12, 0.06, 0.25
"""Margins, relative to the width: at each side, below for axes and scale, above for a legend, right for a colour bar."""

LIT = {"ambient": 0.4, "diffuse": 0.7}
LINES = {"show_edges": True, "edge_color": DARK, "edge_opacity": 0.6, "line_width": 0.5}


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

    Both are translucent, so that each is seen through the other. Faces that hardly move are grey, and drawn once.

    **Arguments:**

    - `mesh`, `points`, `patch`, `plotter`: those of `surface`.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `surface` does.
    """
    before, after = (outside(mesh, state, None, patch) for state in (None, points))
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    moved = np.linalg.norm(after.points - before.points, axis=1)
    is_still = np.ones(after.n_cells, bool)
    is_still[after.extract_points(moved > STILL * moved.max())["vtkOriginalCellIds"]] = False
    plotter.enable_depth_peeling(number_of_peels=8)
    parts = (
        (after.extract_cells(is_still), GREY, 1.0, "in place"),
        (before.extract_cells(~is_still), ORANGE, 0.35, "undeformed"),
        (after.extract_cells(~is_still), BLUE, 0.65, "deformed"),
    )
    parts = [part for part in parts if part[0].n_cells]
    for faces, colour, opacity, _ in parts:
        plotter.add_mesh(faces, color=colour, opacity=opacity, **LIT, **LINES | {"show_edges": colour != ORANGE})
    add_legend(plotter, [(name, colour) for _, colour, _, name in parts])
    if new:
        aim(plotter, _viewer(after))
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
    """Draws the cells of a 3-D mesh where a plane cuts them, seen along its normal; polyhedra whole, walls in a stronger line.

    **Arguments:**

    - `plane`: a `Plane`. Where it meets a body the picture is of the body and some room round it, else of all that is cut.
    - `mesh`, `points`, `values`, `limits`, `label`, `bar`, `plotter`: those of `surface`.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `surface` does.
    """
    normal, origin = (np.asarray(vector, dtype=float) for vector in (plane.normal, plane.origin))
    viewer = normal * (-1 if np.dot(normal, VIEWER) < 0 else 1)
    grid = _grid(mesh, points, values)
    grid.cell_data["whole"] = np.asarray(mesh.cell_ids)
    body = np.asarray(grid.points)[bodies(np.asarray(mesh.points), mesh.patches)]
    away = (body - origin) @ normal
    near = body[np.abs(away) <= np.quantile(np.abs(away), 0.1)] if len(body) and away.min() <= 0 <= away.max() else None
    section, walls = (
        _cropped(part.slice(normal=normal.tolist(), origin=origin.tolist()), near, view_axes(viewer)[1:])
        for part in (grid, outside(mesh, points, None, None))
    )
    drawn = _draw(section, limits, label, bar, plotter, lighting=False, show_edges=False)
    before = 1e-3 * section.length * view_axes(viewer)[0]  # lines in front of the cells, which would cover a part of them
    for lines, width in ((_outlines(section), 1), (walls, 3.5)):
        if lines.n_cells:
            drawn.add_mesh(lines.translate(before), color=DARK, line_width=width, lighting=False)
    if plotter is None:
        aim(drawn, viewer)
    return drawn


def _cropped(section: Any, body: np.ndarray | None, axes: Sequence[np.ndarray]) -> Any:
    """Crops a section to a body and some room round it; without a body it stays whole."""
    if body is None:
        return section
    room = ROOM * max(np.ptp(body @ axis) for axis in axes)
    for axis in (*axes, *(-axis for axis in axes)):
        section = section.clip(normal=axis, origin=axis * ((body @ axis).max() + room))
    return section


def _outlines(section: Any) -> Any:
    """Returns the edges of the cells of a section for pyvista, but those that a cell has twice: between two pieces of it."""
    grid = section.cast_to_unstructured_grid()
    labels, starts = grid.cell_connectivity, grid.offset
    after = np.roll(labels, -1)
    after[starts[1:] - 1] = labels[starts[:-1]]
    owner = np.repeat(section.cell_data["whole"], np.diff(starts))
    pairs = np.column_stack([np.minimum(labels, after), np.maximum(labels, after), owner])
    edges, counts = np.unique(pairs, axis=0, return_counts=True)
    edges = np.unique(edges[counts == 1, :2], axis=0)
    return pyvista().PolyData(section.points, lines=np.insert(edges, 0, 2, axis=1).ravel())


def outside(mesh: jm.Mesh, points: Any, values: Any, patch: str | None) -> Any:
    """Returns the outer faces, or the faces of a patch, for pyvista; `node` is the id of each point.

    Faces of polyhedra are whole. `ValueError` where there are none.
    """
    on_patch = None if patch is None else mesh.patch(patch)
    grid = _grid(mesh, points, values)
    faces = _skin(grid) if mesh.polyhedra is None else _polygons(mesh, grid)
    if on_patch is not None:
        faces = faces.extract_points(np.isin(faces.point_data["node"], on_patch), adjacent_cells=False)
    if faces.n_cells == 0:
        owner = "the mesh" if patch is None else f"patch {patch!r}"
        raise ValueError(f"there is nothing to draw: no face of the outside has all its nodes in {owner}.")
    return faces


def _skin(grid: Any) -> Any:
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
    """Returns the outer faces of polyhedra as the file has them, each with the mean value of its cell's pieces."""
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
        faces.cell_data["values"] = (np.bincount(cells, grid.cell_data["values"]) / np.bincount(cells))[whole.owner[outer]]
    return faces


def _grid(mesh: jm.Mesh, points: Any, values: Any) -> Any:
    """Turns the mesh into pyvista's."""
    if mesh.points.shape[1] != 3:
        raise ValueError(f"this is for 3-D meshes, not {mesh}; see `plot.mesh` and `plot.before_after`.")
    points = finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
    grid = pyvista().UnstructuredGrid({VTK[kind]: np.asarray(ids) for kind, ids in mesh.cells.items()}, points)
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)
    return grid


def _draw(
    part: Any, limits: Any, label: str | None, bar: bool, plotter: Any, *, lighting: bool = True, show_edges: bool = True
) -> Any:
    """Draws faces, with colours and a bar where they have values."""
    if part.n_cells == 0:
        raise ValueError("there is nothing to draw: the plane cuts no cell.")
    has_values = "values" in part.cell_data
    if label is not None and not has_values:
        raise ValueError(f"there are no `values` that are {label!r}.")
    colours, limits = colour_scale(limits)
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    style: dict[str, Any] = {"color": GREY}
    beyond: dict[str, str] = {}
    if has_values:
        values, sizes = part.cell_data["values"], part.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
        limits = limits or usual_limits(values, sizes)
        style = {"scalars": "values", "cmap": colours, "clim": limits}
        beyond = {"min": {"below": 0.0}, "max": {"above": 1.0}, "both": {"below": 0.0, "above": 1.0}}.get(arrows(values, limits), {})
        style |= {f"{side}_color": to_hex(plt.get_cmap(colours)(place)) for side, place in beyond.items()}
    light = LIT if lighting and not has_values else {"lighting": False}  # it would change the colours, and the bar not
    plotter.add_mesh(part, show_scalar_bar=False, **LINES | {"show_edges": show_edges}, **light, **style)
    if has_values and bar:
        _add_bar(plotter, label or "", {f"{side}_label": "<>"[side == "above"] for side in beyond})
    if new:
        aim(plotter, _viewer(part))
    return plotter


def _add_bar(plotter: Any, label: str, beyond: dict[str, str]) -> None:
    size = {"height": 0.6, "width": 0.05, "position_x": 0.85, "position_y": 0.2}
    bar = plotter.add_scalar_bar(f"{label}\n", vertical=True, n_labels=5, fmt="%.3g", color=DARK, **size, **beyond)
    bar.SetUnconstrainedFontSize(True)
    bar.SetTextPad(8)
    for text in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty(), bar.GetAnnotationTextProperty()):
        text.SetFontSize(TEXT)
        _in_font(text)


def _in_font(text: Any) -> None:
    """Sets text in the font of the pictures in 2-D."""
    text.SetFontFamily(4)  # VTK's number for a font from a file
    text.SetFontFile(findfont("DejaVu Sans"))
    text.SetBold(False)
    text.SetItalic(False)
    text.SetShadow(False)


def new_plotter() -> Any:
    with pyvista().vtk_verbosity("off"):  # it complains where there is no display, and draws all the same
        plotter = pyvista().Plotter(off_screen=True, window_size=WINDOW)
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")  # with samples for each pixel, VTK draws nothing of what it peels
    axes = plotter.add_axes(xlabel="x", ylabel="y", zlabel="z", color=DARK, line_width=3)
    for name in "XYZ":
        caption = getattr(axes, f"Get{name}AxisCaptionActor2D")()
        caption.GetTextActor().SetTextScaleModeToNone()
        caption.GetCaptionTextProperty().SetFontSize(TEXT)
        _in_font(caption.GetCaptionTextProperty())
    _add_scale(plotter)
    return plotter


def _add_scale(plotter: Any) -> None:
    """Draws a bar of a round length in the lower right corner, which follows the camera; none in perspective."""
    from vtkmodules.vtkRenderingAnnotation import vtkAxisActor2D

    scale = vtkAxisActor2D()
    scale.SetNumberOfLabels(2)
    scale.AdjustLabelsOff()
    scale.LabelVisibilityOff()
    scale.TickVisibilityOn()
    scale.GetProperty().SetColor(0.1, 0.1, 0.1)
    scale.GetProperty().SetLineWidth(3)
    scale.UseFontSizeFromPropertyOn()
    scale.GetTitleTextProperty().SetColor(0.1, 0.1, 0.1)
    scale.GetTitleTextProperty().SetFontSize(TEXT)
    _in_font(scale.GetTitleTextProperty())
    plotter.renderer.AddViewProp(scale)

    def fit(*_: Any) -> None:
        width, height = plotter.window_size
        seen = 2 * plotter.camera.parallel_scale * width / height
        length = _round_length(0.2 * seen)
        for coordinate, x in ((scale.GetPositionCoordinate(), 0.97 - length / seen), (scale.GetPosition2Coordinate(), 0.97)):
            coordinate.SetCoordinateSystemToNormalizedViewport()
            coordinate.SetValue(x, 0.06 * width / height)
        plotter.renderer.axes_widget.SetViewport(-0.04, -0.05 * width / height, 0.16, 0.15 * width / height)
        scale.SetTitle(f"{length:g}")
        scale.SetVisibility(bool(plotter.camera.parallel_projection))

    plotter.renderer.AddObserver("StartEvent", fit)


def _round_length(largest: float) -> float:
    """Returns the largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10 ** np.floor(np.log10(largest))
    return float(power * max(factor for factor in (1, 2, 5) if factor * power <= largest * (1 + 1e-9)))


def _viewer(part: Any) -> np.ndarray:
    """Chooses the direction towards the viewer: not into a surface that is open at one side, as a half wing at its root is."""
    only_rim = dict.fromkeys(("feature_edges", "manifold_edges", "non_manifold_edges"), False)
    viewer, rim = np.array(VIEWER), np.asarray(part.extract_feature_edges(**only_rim).points, dtype=float)
    if not len(rim):
        return viewer
    outward = rim.mean(axis=0) - part.points.mean(axis=0)
    _, (size, _, thin), axes = np.linalg.svd(rim - rim.mean(axis=0), full_matrices=False)
    normal = axes[2] * np.sign(axes[2] @ outward)
    if thin > 1e-3 * size or outward @ normal < 0.05 * np.ptp(part.points @ normal) or viewer @ normal <= 0:
        return viewer
    mirrored = viewer - 2 * (viewer @ normal) * normal
    faces = _skin(part).compute_normals(point_normals=False, consistent_normals=False)
    areas = faces.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    directions = [mirrored, mirrored + [0, 0, VIEWER[2]], mirrored + [0, 0, 3 * VIEWER[2]]]
    shown = [areas @ np.abs(faces.cell_data["Normals"] @ (way / np.linalg.norm(way))) for way in directions]
    return directions[int(np.argmax(np.array(shown) > 0.85 * max(shown)))]


def aim(plotter: Any, viewer: Sequence[float] | np.ndarray = VIEWER, shown: np.ndarray | None = None) -> None:
    """Turns the camera to points, by default all that was drawn, and gives the window their shape."""
    shown = content(plotter) if shown is None else shown
    plotter.window_size = fitted_window(plotter, shown, viewer)
    set_view(plotter, whole_view(shown, plotter.window_size, viewer, margins(plotter)))


def fitted_window(
    plotter: Any, points: Float[np.ndarray, "k 3"], viewer: Sequence[float] | np.ndarray
) -> tuple[int, int]:
    """Chooses width and height in pixels of a picture of points, so that little is white."""
    (width, height), (left, right, below, above) = np.ptp(points @ np.stack(view_axes(viewer)[1:]).T, axis=0), margins(plotter)
    tall = (1 - left - right) * height / max(width, 1e-9 * height) + below + above
    return WINDOW[0], round(float(np.clip(tall * WINDOW[0], WINDOW[1] / 2, WINDOW[1])))


def content(plotter: Any) -> Float[np.ndarray, "k 3"]:
    """Returns the points of all that was drawn."""
    return np.concatenate([np.asarray(mesh.points, dtype=float) for mesh in plotter.meshes])


def margins(plotter: Any) -> tuple[float, float, float, float]:
    """Returns what is left free at the left and right, below and above, relative to the width."""
    has_legend = any(name.startswith("legend") for name in plotter.actors)
    return EDGE, BAR if len(plotter.scalar_bars) else EDGE, BELOW, LEGEND if has_legend else EDGE


def whole_view(
    points: Float[np.ndarray, "k 3"],
    window: Sequence[int],
    viewer: Sequence[float] | np.ndarray = VIEWER,
    free: tuple[float, float, float, float] = (EDGE, EDGE, BELOW, EDGE),
) -> Float[np.ndarray, " 10"]:
    """Places a camera: its position, what it looks at, upwards, half the height that it sees.

    It has no perspective. All points are in a window of this width and height, within the margins that are left free.
    """
    axes, tall = np.stack(view_axes(viewer)), window[1] / window[0]
    seen, (left, right, below, above) = points @ axes.T, free
    low, high = seen.min(axis=0), seen.max(axis=0)
    depth, width, height = high - low
    scale = max(width / (1 - left - right), height / (tall - below - above))  # length across the window
    beside = np.array([0, (right - left) / 2, (above - below) / 2]) * scale
    middle = ((low + high) / 2 + beside) @ axes
    distance = 2 * (depth + width + height)
    return np.array([*(middle + distance * axes[0]), *middle, *axes[2], scale * tall / 2])


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


def add_legend(plotter: Any, entries: Sequence[tuple[str, str]]) -> None:
    """Writes names, each in its colour, in a row above the picture."""
    place = EDGE
    for k, (name, colour) in enumerate(entries):
        text = plotter.add_text(name, color=colour, viewport=True, name=f"legend {k}", position=(place, 0.0))
        text.prop.SetFontSize(TEXT)
        text.prop.SetVerticalJustificationToTop()
        text.SetPosition(place, 0.985)
        _in_font(text.prop)
        place += (TextPath((0, 0), name, size=TEXT).get_extents().width + TEXT) / WINDOW[0]


def pyvista() -> Any:
    """Imports the package; the `ImportError` names what to install."""
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("pictures in 3-D need pyvista: pip install 'jaxmorph[plot]'") from error
    return pyvista
