"""A file with a picture of how far a wall is from its target, before and after its motion."""

import pathlib
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph.extend import PathLike, checked, complete, finite_array, output_path

from ._plane import Figure, LineCollection, MaxNLocator, plt, show, whole
from ._space import add_legend, aim, new_plotter, surface, viewer_of
from ._style import COLOURS, DARK, FLAT_VIEW, GREY, LINE_WIDTH, PlotColumn, PlotPlaces, usual_limits

ROUNDOFF = 1e-9  # distance over the wall's extent of a wall that is on its target
WALL_WIDTH = 3.0  # points of a wall in the colours of its distances
WALL_ROOM = 0.1  # round a wall in 2-D, over its extent


@checked
def distances(
    path: PathLike,
    wall: jm.Facets,
    target: jm.Facets,
    points: Float[Any, "m d"],
    *,
    label: str = "from the target",
) -> None:
    """Writes how far a wall is from its target, before and after: each state in its own colours.

    A wall that is on its target, to round-off, has none. In 2-D the target is a thin line.

    **Arguments:**

    - `path`: a .png.
    - `wall`, `target`: as `shapes.onto` takes them.
    - `points`: places (m, d) of the wall's nodes afterwards.
    - `label`: what the titles say behind "distance", such as "from scan.stl".

    **Raises:** `ValueError` for another ending, points of another shape, and different dimensions.
    """
    path = output_path(path, ".png")
    start = np.asarray(wall.points, float)
    end = finite_array("points", points, start.shape)
    off = [np.asarray(target.distance(x), float) for x in (start, end)]
    states = []
    for name, x, own in zip(("before", "after"), (start, end), off, strict=True):
        is_on = own.max() <= ROUNDOFF * np.ptp(start, axis=0).max()
        most = "none" if is_on else f"up to {own.max():.3g}"
        states.append((x, None if is_on else own, f"distance {label}\n{name}: {most}"))
    if start.shape[1] == 2:
        return _write_in_2d(path, wall, target, states)
    _write_in_3d(path, wall, states)


State = tuple[PlotPlaces, PlotColumn | None, str]
"""Places of a wall's nodes, their distances if they are off the target, and a title."""


def _write_in_3d(path: pathlib.Path, wall: jm.Facets, states: list[State]) -> None:
    faces = np.asarray(wall.faces)
    pictures = []
    viewer = None
    for x, off, title in states:
        skin = jm.Mesh(x, {"triangle": faces})
        plotter = new_plotter()
        of_faces = None if off is None else off[faces].mean(axis=1)
        colours = {} if off is None else {"limits": _limits(wall, off), "label": "distance"}
        surface(skin, values=of_faces, plotter=plotter, **colours)
        viewer = viewer_of(plotter.meshes[0]) if viewer is None else viewer
        add_legend(plotter, [(title.replace("\n", " "), DARK)])
        aim(plotter, viewer)
        pictures.append(plotter.screenshot(return_img=True))
        plotter.close()
    with complete(path) as partial:
        plt.imsave(partial, np.concatenate(pictures), format="png")


def _limits(wall: jm.Facets, off: PlotColumn) -> tuple[float, float]:
    faces = np.asarray(wall.faces)
    sizes = np.linalg.norm(np.asarray(wall.areas()), axis=1)
    of_faces = off[faces].mean(axis=1)
    return 0.0, min(usual_limits(of_faces, sizes)[1], float(of_faces.max()))


def _write_in_2d(
    path: pathlib.Path, wall: jm.Facets, target: jm.Facets, states: list[State]
) -> None:
    faces = np.asarray(wall.faces)
    everything = np.concatenate([x for x, _, _ in states])
    room = WALL_ROOM * np.ptp(everything, axis=0).max()
    window = whole(np.stack([everything.min(axis=0) - room, everything.max(axis=0) + room]))
    width, height = (end - start for start, end in window)
    rows = 2 if height < FLAT_VIEW * width else 1
    size = (
        LINE_WIDTH,
        0.4 + 0.4 / rows + rows * (0.3 + 0.72 * LINE_WIDTH * rows / 2 * height / width),
    )
    figure = Figure(figsize=size, dpi=300, layout="constrained")
    axes = figure.subplots(rows, 2 // rows, sharex=True, sharey=True)
    places = np.asarray(target.points)[np.asarray(target.faces)]
    for axis, (x, off, title) in zip(axes, states, strict=True):
        show(axis, window)
        axis.add_collection(LineCollection(list(places), colors=GREY, linewidths=0.8))
        style: Any = {"colors": DARK} if off is None else {"cmap": COLOURS}
        drawn = LineCollection(
            list(x[faces]), linewidths=WALL_WIDTH, capstyle="round", zorder=1, **style
        )
        axis.add_collection(drawn)
        axis.set_title(title if rows == 1 else title.replace("\n", " "), fontsize="medium")
        axis.label_outer()
        if off is not None:
            drawn.set_array(off[faces].mean(axis=1))
            drawn.set_clim(*_limits(wall, off))
            bar = axis.inset_axes((1.02, 0, 0.03, 1))
            figure.colorbar(drawn, cax=bar).locator = MaxNLocator(4)
    with complete(path) as partial:
        figure.savefig(partial, format="png")
