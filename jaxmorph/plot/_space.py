"""Pictures in 3-D, with pyvista, off screen."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph._host.cells.topology import VTK
from jaxmorph._host.package.arguments import checked

from ._cells import plt
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
    cell_values,
    colour_scale,
    finite,
    usual_limits,
    whole_of,
)
from ._view import VIEWER, add_bar, add_legend, aim, new_plotter, pyvista, view_axes

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

    A surface without values is lit. With values it is not, so that its colours are those of the
    bar.

    **Arguments:**

    - `mesh`, `points`, `values`, `limits`, `label`, `bar`: those of `plot.mesh`, in 3-D.
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
        (before.extract_cells(~is_still), ORANGE, 0.5, "undeformed"),
        (after.extract_cells(~is_still), BLUE, 0.45, "deformed"),
    )
    parts = [part for part in parts if part[0].n_cells]
    for faces, colour, opacity, _ in parts:
        plotter.add_mesh(faces, color=colour, opacity=opacity, **LIT, **LINES | {"show_edges": colour != ORANGE})
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
    - `mesh`, `points`, `values`, `limits`, `label`, `bar`, `plotter`: those of `surface`. A plotter
      that is given shows all.

    **Returns:** the plotter, or a new one, off screen.

    **Raises:** `ValueError` as `surface` does.
    """
    normal, origin = (np.asarray(vector, dtype=float) for vector in (plane.normal, plane.origin))
    viewer = normal * (-1 if np.dot(normal, VIEWER) < 0 else 1)
    grid = _grid(mesh, points, values)
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
    for lines, width in ((_outlines(section), 1), (walls, 3.5)):
        if lines.n_cells:
            actor = drawn.add_mesh(lines, color=DARK, line_width=width, lighting=False)
            # in front of the cells, from either side
            actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
            actor.mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -200)
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
    """Returns a section's cell edges for pyvista, without those between two pieces of a cell."""
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
    """Returns outer faces, or a patch's faces, for pyvista; `node` is the id of each point.

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


def _grid(mesh: jm.Mesh, points: Any, values: Any) -> Any:
    """Turns the mesh into pyvista's."""
    if mesh.points.shape[1] != 3:
        raise ValueError(f"this is for 3-D meshes, not {mesh}; see `plot.mesh` and `plot.before_after`.")
    points = finite(mesh.points if points is None else mesh.moved(np.asarray(points)).points)
    pieces = {VTK[kind]: np.asarray(ids) for kind, ids in mesh.linear.cells.items()}
    grid = pyvista().UnstructuredGrid(pieces, points)
    if values is not None:
        grid.cell_data["values"] = cell_values(mesh, values)
    return grid


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
        raise ValueError("there is nothing to draw: the plane cuts no cell.")
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
    plotter.add_mesh(part, show_scalar_bar=False, **LINES | {"show_edges": show_edges}, **light, **style)
    if has_values and bar:
        add_bar(plotter, label or "", limits, {f"{side}_label": sign for side, sign in ends})
    if new:
        aim(plotter, viewer_of(part))
    return plotter


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
    faces = _skin(part).compute_normals(point_normals=False, consistent_normals=False)
    areas = faces.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    directions = [mirrored + np.array([0, 0, lift]) for lift in (0, VIEWER[2], 3 * VIEWER[2])]
    ways = np.array(directions) / np.linalg.norm(directions, axis=1)[:, None]
    shown = np.abs(ways @ np.asarray(faces.cell_data["Normals"]).T) @ areas
    if motion is not None:
        shown *= np.linalg.norm(np.cross(ways, motion), axis=1)
    return directions[int(np.argmax(shown > 0.85 * shown.max()))]
