"""Pictures in 3-D, with pyvista, off screen."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph._host.package.arguments import checked

from ._cells import plt
from ._outside import NOTHING, grid_of, near_plane, outlines, outside, skin
from ._plane import ROOM
from ._style import (
    BLUE,
    DARK,
    GREY,
    ORANGE,
    STILL,
    Limits,
    Values,
    beyond,
    bodies,
    colour_scale,
    usual_limits,
    whole_of,
)
from ._view import VIEWER, add_bar, add_legend, aim, new_plotter, view_axes

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
    """Draws a 3-D mesh's outside, or one patch, each face coloured by its cell's value.

    A surface without values is lit. With values it is not lit, so that its colours match the bar.

    **Arguments:**

    - `mesh`, `points`, `values`, `limits`, `label`, `bar`: as `plot.mesh` takes them, in 3-D.
    - `patch`: the patch to draw. Default: the whole outside.
    - `plotter`: pyvista's; a new one, off screen, by default.

    **Returns:** the plotter, or a new one, off screen: `plotter.screenshot(path)` writes the
    picture.

    **Raises:** `ValueError` as `mesh` does, for a mesh in 2-D, for a `patch` that is not known, and
    where there is no face.
    """
    return _draw(outside(mesh, points, values, patch), limits, label, bar, plotter)


@checked
def before_after_3d(mesh: jm.Mesh, points: Float[Any, "n 3"], *, patch: str | None = None, plotter: Any = None) -> Any:
    """Draws a 3-D mesh's outside or patch: undeformed orange, deformed blue (paper, figure 7a).

    Both are translucent, so that each is seen through the other. Faces that hardly move are grey,
    and drawn once.

    **Arguments:**

    - `mesh`, `points`, `patch`, `plotter`: as `surface` takes them.

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
        (before.extract_cells(~is_still), ORANGE, 0.5, "undeformed"),
        (after.extract_cells(~is_still), BLUE, 0.45, "deformed"),
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
    values: Values | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    bar: bool = True,
    plotter: Any = None,
) -> Any:
    """Draws the cells of a 3-D mesh that a plane cuts, along its normal; walls in stronger lines.

    **Arguments:**

    - `plane`: a `Plane`. Where it meets a body the picture is of the body and some room round it,
      else of all that is cut.
    - `mesh`, `points`, `values`, `limits`, `label`, `bar`, `plotter`: as `surface` takes them. A
      plotter that is given shows all.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `surface` does.
    """
    normal, origin = (np.asarray(vector, dtype=float) for vector in (plane.normal, plane.origin))
    viewer = normal * (-1 if np.dot(normal, VIEWER) < 0 else 1)
    grid = near_plane(mesh, points, values, normal, origin) if mesh.is_curved else grid_of(mesh, points, values)
    if not mesh.is_curved:
        grid.cell_data["whole"] = whole_of(mesh)
    # through nodes, up to round-off, the plane would cut cells on both sides of it by turns
    origin = origin + 1e-9 * grid.length * normal
    body = np.asarray(grid.points)[bodies(np.asarray(mesh.points), mesh.patches)]
    away = (body - origin) @ normal
    is_met = plotter is None and len(body) and away.min() <= 0 <= away.max()
    near = body[np.abs(away) <= np.quantile(np.abs(away), 0.1)] if is_met else None
    section, walls = (
        _cropped(part.slice(normal=normal.tolist(), origin=origin.tolist()), near, view_axes(viewer)[1:])
        for part in (grid, outside(mesh, points, None, None))
    )
    drawn = _draw(section, limits, label, bar, plotter, lighting=False, show_edges=False)
    for lines, width in ((outlines(section), 1), (walls, 3.5)):
        if lines.n_cells:
            _in_front(drawn.add_mesh(lines, color=DARK, line_width=width, lighting=False))
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


def _draw(
    part: Any,
    limits: Any,
    label: str | None,
    bar: bool,
    plotter: Any,
    *,
    lighting: bool = True,
    show_edges: bool = True,
) -> Any:
    """Draws faces, with colours and a bar where they have values."""
    if part.n_cells == 0:
        raise ValueError(NOTHING)
    has_values = "values" in part.cell_data
    if label is not None and not has_values:
        raise ValueError(f"there are no `values` that are {label!r}.")
    colours, limits = colour_scale(limits)
    new, plotter = plotter is None, new_plotter() if plotter is None else plotter
    style: dict[str, Any] = {"color": GREY if lighting else "white"}
    ends: list[tuple[str, str]] = []
    if has_values:
        values, sizes = part.cell_data["values"], part.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
        limits = limits or usual_limits(values, sizes)
        below, above = beyond(values, limits)
        ends = [("below", "<")] * below + [("above", ">")] * above
        style = {"scalars": "values", "cmap": colours, "clim": limits}
        style |= {f"{side}_color": plt.get_cmap(colours)(float(side == "above")) for side, _ in ends}
    light = LIT if lighting and not has_values else {"lighting": False}  # it would change the colours, and the bar not
    _add_faces(plotter, part, show_edges, show_scalar_bar=False, **light, **style)
    if has_values and bar:
        add_bar(plotter, label or "", limits, {f"{side}_label": sign for side, sign in ends})
    if new:
        aim(plotter, viewer_of(part))
    return plotter


def _add_faces(plotter: Any, faces: Any, show_edges: bool, **style: Any) -> None:
    """Draws faces, with their edges; of pieces of curved faces the edges of the whole faces."""
    in_pieces = "whole" in faces.cell_data
    if show_edges and in_pieces:
        lines = {"color": DARK, "opacity": LINES["edge_opacity"], "line_width": LINES["line_width"]}
        _in_front(plotter.add_mesh(outlines(faces), lighting=False, **lines))
    # last, so that a colour bar is that of the faces
    plotter.add_mesh(faces, **LINES | {"show_edges": show_edges and not in_pieces}, **style)


def _in_front(actor: Any) -> None:
    """Draws lines in front of the faces that they lie on, from either side."""
    actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -200)


def viewer_of(part: Any, motion: np.ndarray | None = None) -> np.ndarray:
    """Chooses the viewer's direction: not into a surface open at a side, as a half wing's root.

    A motion (3,) should be seen too, across the view.
    """
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
    faces = skin(part).compute_normals(point_normals=False, consistent_normals=False)
    areas = faces.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    directions = [mirrored + np.array([0, 0, lift]) for lift in (0, VIEWER[2], 3 * VIEWER[2])]
    ways = np.array(directions) / np.linalg.norm(directions, axis=1)[:, None]
    shown = np.abs(ways @ np.asarray(faces.cell_data["Normals"]).T) @ areas
    if motion is not None:
        shown *= np.linalg.norm(np.cross(ways, motion), axis=1)
    return directions[int(np.argmax(shown > 0.85 * shown.max()))]
