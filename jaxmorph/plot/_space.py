"""Pictures in 3-D, with pyvista, off screen: cells, cameras, bars, legends, axes and scales."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

import jaxmorph as jm
from jaxmorph.extend import checked, join_ids, lagrange_types

from ._plane import FIGURE_ROOM, TextPath, findfont, plt, round_numbers
from ._style import (
    BLUE,
    DARK,
    GREY,
    ORANGE,
    STILL,
    UNNAMED,
    Limits,
    PlotValues,
    body_patches,
    cell_values,
    check_cells,
    choose_points,
    refine_cells,
    scale_of,
)

NOTHING_CUT = "there is nothing to draw: the plane cuts no cell."

LIT = {"ambient": 0.4, "diffuse": 0.7}
PLAIN = LIT | {"color": GREY}
LINES = {"show_edges": True, "edge_color": DARK, "edge_opacity": 0.6, "line_width": 0.5}

Direction = Sequence[float] | ndarray

# the direction towards the viewer: x right, y away, z up; mirrored for an open surface
VIEWER = (-1.0, -2.5, 1.8)

WINDOW = (1200, 900)  # width and largest height of a picture in pixels
LETTERS = 30  # height of letters in pixels
ALONG = 0.97  # cosine between an axis and the view from which the axis is a point, and has no name

# over the width of a picture: sides, room below for axes, a legend, a colour bar
EDGE = 0.025
BELOW = 0.13
LEGEND = 0.06
BAR = 0.25


@checked
def surface(
    mesh: jm.Mesh,
    points: Float[Any, "n 3"] | None = None,
    *,
    values: PlotValues | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    patch: str | None = None,
    plotter: Any = None,
) -> Any:
    """Draws a 3-D mesh's bodies, or one patch, each face coloured by its cell's value.

    A surface without values is lit. With values it is not lit, so that its colours match the bar.

    **Arguments:**

    - `mesh`, `points`, `values`, `limits`, `label`, `bar`: as `plot.mesh` takes them, in 3-D.
    - `patch`: the patch to draw, or a pattern. Default: the bodies, without what is round them;
      where there are none, the whole outside, as for `".*"`.
    - `plotter`: pyvista's; a new one, off screen, by default.

    **Returns:** the plotter: `plotter.screenshot(path)` writes the picture.

    **Raises:** `ValueError` as `mesh` does, for a mesh in 2-D, an unknown `patch`, and no faces.
    """
    return _draw_mesh(
        outside(mesh, points, values, select_patches(mesh, patch)), limits, label, bar, plotter
    )


@checked
def before_after_3d(
    mesh: jm.Mesh, points: Float[Any, "n 3"], *, patch: str | None = None, plotter: Any = None
) -> Any:
    """Draws a 3-D mesh's bodies or patch: undeformed orange, deformed blue (paper, figure 7a).

    Both are translucent; faces that hardly move are grey, and drawn once. Arguments, result and
    errors are as of `surface`.
    """
    before, after = (
        outside(mesh, state, None, select_patches(mesh, patch)) for state in (None, points)
    )
    new = plotter is None
    plotter = new_plotter() if plotter is None else plotter
    moved = np.linalg.norm(after.points - before.points, axis=1)
    is_still = np.ones(after.n_cells, bool)
    is_still[after.extract_points(moved > STILL * moved.max())["vtkOriginalCellIds"]] = False
    plotter.enable_depth_peeling(number_of_peels=8)
    parts = (
        (after.extract_cells(is_still), GREY, 1.0, "in place"),
        (before.extract_cells(~is_still), ORANGE, 0.6, "undeformed"),
        (after.extract_cells(~is_still), BLUE, 0.6, "deformed"),
    )
    parts = [part for part in parts if part[0].n_cells]
    for faces, colour, opacity, _ in parts:
        _add_faces(plotter, faces, colour != ORANGE, color=colour, opacity=opacity, **LIT)
    add_legend(plotter, [(name, colour) for _, colour, _, name in parts])
    if new:
        aim(plotter, viewer_of(after, np.ptp(after.points - before.points, axis=0)))
    return plotter


@checked
def cut(
    mesh: jm.Mesh,
    points: Float[Any, "n 3"] | None = None,
    *,
    plane: jm.Plane,
    values: PlotValues | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    plotter: Any = None,
) -> Any:
    """Draws the cells of a 3-D mesh that a plane cuts, along its normal; walls in stronger lines.

    **Arguments:**

    - `plane`: a `Plane`. Where it meets a body the picture is of the body and some room round it,
      else of all that is cut. A given plotter shows all.
    - `mesh`, `points`, `values`, `limits`, `label`, `bar`, `plotter`: as `surface` takes them.

    **Returns:** the plotter. **Raises:** `ValueError` as `surface` does.
    """
    normal, origin = (np.asarray(vector, dtype=float) for vector in (plane.normal, plane.origin))
    viewer = normal * (-1 if np.dot(normal, VIEWER) < 0 else 1)
    grid = _near_plane(mesh, points, values, normal, origin)
    # through nodes, up to round-off, the plane would cut cells on both sides of it by turns
    origin = origin + 1e-9 * grid.length * normal
    body = np.asarray(grid.points)[mesh.patch(*body_patches(mesh))]
    away = (body - origin) @ normal
    is_met = plotter is None and len(body) and away.min() <= 0 <= away.max()
    near = body[np.abs(away) <= np.quantile(np.abs(away), 0.1)] if is_met else None
    section, walls = (
        _crop(
            part.slice(normal=normal.tolist(), origin=origin.tolist()), near, view_axes(viewer)[1:]
        )
        for part in (grid, outside(mesh, points, None, ()))
    )
    drawn = _draw_mesh(section, limits, label, bar, plotter, is_cut=True)
    for lines, width in ((outlines(section), 1), (walls, 3.5)):
        if lines.n_cells:
            _in_front(drawn.add_mesh(lines, color=DARK, line_width=width, lighting=False))
    if plotter is None:
        aim(drawn, viewer)
    return drawn


def _crop(section: Any, body: ndarray | None, axes: Sequence[ndarray]) -> Any:
    if body is None:
        return section
    room = FIGURE_ROOM * max(np.ptp(body @ axis) for axis in axes)
    for axis in (*axes, *(-axis for axis in axes)):
        section = section.clip(normal=axis, origin=axis * ((body @ axis).max() + room))
    return section


def _draw_mesh(
    part: Any, limits: Any, label: str | None, bar: bool, plotter: Any, *, is_cut: bool = False
) -> Any:
    if part.n_cells == 0:
        raise ValueError(NOTHING_CUT)
    has_values = "values" in part.cell_data
    if label is not None and not has_values:
        raise ValueError(f"there are no `values` that are {label!r}.")
    style: dict[str, Any] = {"lighting": False, "color": "white"} if is_cut else PLAIN
    ends: dict[str, str] = {}
    if has_values:
        style, ends = _colours_of(part, limits)
    new = plotter is None
    plotter = new_plotter() if plotter is None else plotter
    _add_faces(plotter, part, not is_cut, show_scalar_bar=False, **style)
    if has_values and bar:
        add_bar(plotter, label, style["clim"], ends)
    if new:
        aim(plotter, viewer_of(part))
    return plotter


def _colours_of(part: Any, limits: Limits | None) -> tuple[dict[str, Any], dict[str, str]]:
    values = part.cell_data["values"]
    sizes = part.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    colours, limits, is_below, is_above = scale_of(values, sizes, limits)
    style = {"scalars": "values", "cmap": colours, "clim": limits, "lighting": False}
    ends = {}
    beyond = ((is_below, "below", 0.0, "<"), (is_above, "above", 1.0, ">"))
    for is_beyond, side, share, mark in beyond:
        if is_beyond:
            style[f"{side}_color"] = plt.get_cmap(colours)(share)
            ends[f"{side}_label"] = mark
    return style, ends


def _add_faces(plotter: Any, faces: Any, show_edges: bool, **style: Any) -> None:
    in_pieces = "whole" in faces.cell_data
    if show_edges and in_pieces:
        lines = {"color": DARK, "opacity": LINES["edge_opacity"], "line_width": LINES["line_width"]}
        _in_front(plotter.add_mesh(outlines(faces), lighting=False, **lines))
    # last, so that a colour bar is that of the faces
    plotter.add_mesh(faces, **LINES | {"show_edges": show_edges and not in_pieces}, **style)


def _in_front(actor: Any) -> None:
    actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -200)


def viewer_of(part: Any, motion: ndarray | None = None) -> ndarray:
    """Chooses the viewer's direction: not into an open surface, but across a motion (3,)."""
    only_rim = dict.fromkeys(("feature_edges", "manifold_edges", "non_manifold_edges"), False)
    viewer = np.array(VIEWER)
    rim = np.asarray(part.extract_feature_edges(**only_rim).points, dtype=float)
    if not len(rim):
        return viewer
    outward = rim.mean(axis=0) - part.points.mean(axis=0)
    _, (size, _, thin), axes = np.linalg.svd(rim - rim.mean(axis=0), full_matrices=False)
    normal = axes[2] * np.sign(axes[2] @ outward)
    if (
        thin > 1e-3 * size
        or outward @ normal < 0.05 * np.ptp(part.points @ normal)
        or viewer @ normal <= 0
    ):
        return viewer
    mirrored = viewer - 2 * (viewer @ normal) * normal
    faces = part.compute_normals(point_normals=False, consistent_normals=False)
    areas = faces.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    directions = [mirrored + np.array([0, 0, lift]) for lift in (0, VIEWER[2], 3 * VIEWER[2])]
    ways = np.array(directions) / np.linalg.norm(directions, axis=1)[:, None]
    shown = np.abs(ways @ np.asarray(faces.cell_data["Normals"]).T) @ areas
    if motion is not None:
        shown *= np.linalg.norm(np.cross(ways, motion), axis=1)
    return directions[int(np.argmax(shown > 0.85 * shown.max()))]


def add_bar(plotter: Any, label: str | None, limits: Limits, beyond: dict[str, str]) -> None:
    title = label or UNNAMED.replace(" of", "\nof")
    title = title.replace("|", "\u2223")  # VTK begins a column at an ASCII bar
    bar = plotter.add_scalar_bar(
        f"{title}\n", vertical=True, fmt="%.6g", color=DARK, width=0.05, **beyond
    )
    bar.SetUnconstrainedFontSize(True)
    bar.SetUseCustomLabels(True)
    bar.SetCustomLabels(pyvista().convert_array(np.array(round_numbers(*limits, 6))))
    bar.SetTextPad(8)
    _in_font(
        *(getattr(bar, f"Get{part}TextProperty")() for part in ("Title", "Label", "Annotation"))
    )


def _in_font(*texts: Any) -> None:
    for text in texts:
        text.SetFontSize(LETTERS)
        text.SetFontFamily(4)  # VTK's number for a font from a file
        text.SetFontFile(findfont("DejaVu Sans"))
        for style in ("Bold", "Italic", "Shadow"):
            getattr(text, f"Set{style}")(False)


def new_plotter() -> Any:
    # VTK complains where there is no display, and draws anyway
    with pyvista().vtk_verbosity("off"):
        plotter = pyvista().Plotter(off_screen=True, window_size=WINDOW)
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")  # with samples for each pixel, VTK does not draw peels
    _add_axes(plotter)
    return plotter


def _add_axes(plotter: Any) -> None:
    from vtkmodules.vtkRenderingAnnotation import vtkAxisActor2D

    axes = plotter.add_axes(xlabel="x", ylabel="y", zlabel="z", color=DARK, line_width=3)
    scale = vtkAxisActor2D()
    scale.SetNumberOfLabels(2)
    scale.AdjustLabelsOff()
    scale.LabelVisibilityOff()
    scale.GetProperty().SetLineWidth(3)
    scale.UseFontSizeFromPropertyOn()
    for part in (scale.GetProperty(), scale.GetTitleTextProperty()):
        part.SetColor(pyvista().Color(DARK).float_rgb)
    texts = [scale.GetTitleTextProperty()]
    for name in "XYZ":
        caption = getattr(axes, f"Get{name}AxisCaptionActor2D")()
        caption.GetTextActor().SetTextScaleModeToNone()
        texts.append(caption.GetCaptionTextProperty())
        texts[-1].SetJustificationToCentered()
        texts[-1].SetVerticalJustificationToCentered()
    axes.SetNormalizedLabelPosition(1.4, 1.4, 1.4)  # off the arrows
    _in_font(*texts)
    plotter.renderer.AddViewProp(scale)
    plotter.renderer.AddObserver("StartEvent", lambda *_: _arrange(plotter, axes, scale, texts))


def _arrange(plotter: Any, axes: Any, scale: Any, texts: Sequence[Any]) -> None:
    """Fits axes, scale and bars to the window and the view, before each drawing."""
    width, height = plotter.window_size
    camera = plotter.camera
    tall = width / height
    seen = 2 * camera.parallel_scale * tall
    power = 10 ** np.floor(np.log10(0.2 * seen))
    length = power * max(factor for factor in (1, 2, 5) if factor * power <= 0.2001 * seen)
    scale.SetPosition(0.97 - length / seen, 0.075 * tall)
    scale.SetPosition2(0.97, 0.075 * tall)
    scale.SetTitle(f"{length:g}")
    scale.SetVisibility(bool(camera.parallel_projection))
    low = (BELOW + EDGE) * tall
    for bar in plotter.scalar_bars.values():
        bar.SetPosition(1 - 0.6 * BAR, low)
        bar.SetHeight(min(0.93 - low, 0.6 * WINDOW[1] / height))
    plotter.renderer.axes_widget.SetViewport(-0.075, -0.105 * tall, 0.163, 0.133 * tall)
    for text in texts:
        text.SetFontSize(round(LETTERS * width / WINDOW[0]))
    for name, along in zip("xyz", camera.direction, strict=True):
        getattr(axes, f"Set{name.upper()}AxisLabelText")(name if abs(along) < ALONG else "")


def aim(plotter: Any, viewer: Direction = VIEWER) -> None:
    """Shows all without perspective, in a window of its shape, with room for bars and legends."""
    axes = np.stack(view_axes(viewer))
    points = np.concatenate([np.asarray(part.points, float) for part in plotter.meshes])
    seen = points @ axes.T
    low = seen.min(axis=0)
    high = seen.max(axis=0)
    depth, width, height = high - low
    right = BAR if len(plotter.scalar_bars) else EDGE
    above = LEGEND if any(name.startswith("legend") for name in plotter.actors) else EDGE
    wide = 1 - EDGE - right
    tall = BELOW + above
    share = wide * height / max(width, 1e-9 * height) + tall
    share = float(np.clip(share, WINDOW[1] / WINDOW[0] / 2, WINDOW[1] / WINDOW[0]))
    plotter.window_size = WINDOW[0], round(share * WINDOW[0])
    scale = max(width / wide, height / (share - tall))  # length across the window
    middle = ((low + high) / 2 + scale / 2 * np.array([0, right - EDGE, above - BELOW])) @ axes
    position = middle + 2 * (depth + width + height) * axes[0]
    plotter.camera_position = [position.tolist(), middle.tolist(), axes[2].tolist()]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = scale * share / 2
    plotter.renderer.reset_camera_clipping_range()


def view_axes(viewer: Direction) -> tuple[ndarray, ndarray, ndarray]:
    """Returns unit vectors to the viewer, right, and up in the picture: z, or y seen along z."""
    towards = np.array(viewer) / np.linalg.norm(viewer)
    across = np.cross((0, 0, 1) if abs(towards[2]) < 0.99 else (0, 1, 0), towards)
    across /= np.linalg.norm(across)
    return towards, across, np.cross(towards, across)


def add_legend(plotter: Any, entries: Sequence[tuple[str, str]]) -> None:
    place = EDGE
    for k, (name, colour) in enumerate(entries):
        text = plotter.add_text(
            name, color=colour, viewport=True, name=f"legend {k}", position=(place, 0.985)
        )
        text.prop.SetVerticalJustificationToTop()
        _in_font(text.prop)
        place += (TextPath((0, 0), name, size=LETTERS).get_extents().width + LETTERS) / WINDOW[0]


def pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise ImportError("pictures in 3-D need pyvista: pip install 'jaxmorph[plot]'") from error
    return pyvista


def outlines(section: Any) -> Any:
    cells = section.cast_to_unstructured_grid().GetCells()
    labels, starts = (
        pyvista().convert_array(part())
        for part in (cells.GetConnectivityArray, cells.GetOffsetsArray)
    )
    after = np.roll(labels, -1)
    after[starts[1:] - 1] = labels[starts[:-1]]
    owner = np.repeat(section.cell_data["whole"], np.diff(starts))
    pairs = np.column_stack([np.minimum(labels, after), np.maximum(labels, after), owner])
    edges, counts = np.unique(pairs, axis=0, return_counts=True)
    ends = np.unique(edges[counts == 1, :2], axis=0)
    return pyvista().PolyData(section.points, lines=np.insert(ends, 0, 2, axis=1).ravel())


def select_patches(mesh: jm.Mesh, patch: str | None) -> Sequence[str]:
    check_cells(mesh)
    return body_patches(mesh) if patch is None else (patch,)


def outside(mesh: jm.Mesh, points: Any, values: Any, patches: Sequence[str]) -> Any:
    """Returns outer faces, of all or patches; `whole` is the face of a piece of a curved one."""
    places = _space_points(mesh, points)
    faces = (_skin if mesh.polyhedra is None else _polygons)(mesh, places, values, patches)
    if faces.n_cells == 0:
        owner = f"patch {', '.join(map(repr, patches))}" if patches else "the mesh"
        raise ValueError(
            f"there is nothing to draw: no face of the outside has all its nodes in {owner}."
        )
    return faces


def _skin(mesh: jm.Mesh, places: ndarray, values: Any, patches: Sequence[str]) -> Any:
    whole = mesh.moved(places)
    surface, owner = whole.skin(*patches)
    if not patches and not len(owner):  # a mesh of faces alone
        surface = whole
        owner = np.arange(len(whole.cell_ids))
    if not len(owner):
        return pyvista().PolyData()
    # a camera takes the points of no face for what is to be seen
    nodes = np.unique(join_ids(surface.cells.values()))
    cells = {kind: np.searchsorted(nodes, ids) for kind, ids in surface.cells.items()}
    grid, face = _as_grid(jm.Mesh(surface.points[nodes], cells), mesh, values, owner)
    if mesh.is_curved:
        grid.cell_data["whole"] = face
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    faces = vtkGeometryFilter()
    faces.SetInputData(grid)
    faces.Update()
    return pyvista().wrap(faces.GetOutput())


def _polygons(mesh: jm.Mesh, places: ndarray, values: Any, patches: Sequence[str]) -> Any:
    """Returns polyhedra's outer faces as in the file, with the mean of their cell's pieces."""
    whole: Any = mesh.polyhedra
    whole = whole.faces
    outer = np.flatnonzero(whole.all_neighbours() < 0)
    corners = whole.padded(outer)  # -1 behind the last corner
    if patches:
        on = ((corners < 0) | np.isin(corners, mesh.patch(*patches))).all(axis=1)
        outer = outer[on]
        corners = corners[on]
    if not len(outer):
        return pyvista().PolyData()
    # VTK's rows: the number of corners, then the corners, among the points that faces have
    nodes = np.unique(corners[corners >= 0])
    rows = np.column_stack([whole.sizes[outer], np.searchsorted(nodes, corners)])
    is_listed = np.insert(corners >= 0, 0, True, axis=1)
    faces = pyvista().PolyData(places[nodes], rows[is_listed])
    if values is not None:
        ids = np.asarray(mesh.cell_ids)
        mean = np.bincount(ids, cell_values(mesh, values)) / np.bincount(ids)
        faces.cell_data["values"] = mean[whole.owner[outer]]
    return faces


def _space_points(mesh: jm.Mesh, points: Any) -> ndarray:
    if mesh.points.shape[1] != 3:
        raise ValueError(
            f"this is for 3-D meshes, not {mesh}; see `plot.mesh` and `plot.before_after`."
        )
    return choose_points(mesh, points)


def _near_plane(mesh: jm.Mesh, points: Any, values: Any, normal: ndarray, origin: ndarray) -> Any:
    """Returns solid cells that a plane may cut, curved ones in pieces; `whole` are the file's."""
    x = _space_points(mesh, points)
    kinds = lagrange_types()
    above = (x - origin) @ normal
    chosen = {}
    is_met = []
    for kind, ids in mesh.cells.items():
        low = above[ids].min(axis=1)
        high = above[ids].max(axis=1)
        room = (high - low) / 2  # a curved cell goes beyond its nodes
        is_met.append((low - room <= 0) & (high + room >= 0) & (kinds[kind].dimension == 3))
        chosen[kind] = np.asarray(ids)[is_met[-1]]
    cells = np.flatnonzero(np.concatenate(is_met))
    if not len(cells):
        raise ValueError(NOTHING_CUT)
    grid, piece_of = _as_grid(jm.Mesh(x, chosen), mesh, values, cells)
    grid.cell_data["whole"] = np.asarray(mesh.cell_ids)[cells][piece_of]
    return grid


def _as_grid(part: jm.Mesh, mesh: jm.Mesh, values: Any, cells: ndarray) -> tuple[Any, ndarray]:
    """Makes a grid of a part, of which each entry is of one of the mesh's `cells`.

    Curved ones are cut. Also returned is the entry that each piece is of.
    """
    entry = np.arange(len(cells))
    if mesh.is_curved:
        part, entry = refine_cells(part)
    grid = part.to_pyvista()
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)[cells][entry]
    return grid, entry
