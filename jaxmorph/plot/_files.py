"""Files: a picture of what became of a mesh, a page to turn and deform it, films."""

import importlib
import io
import json
import os
import pathlib
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

import jaxmorph as jm
from jaxmorph.extend import checked, complete, finite_array, output_path, rows_of, whole

from . import _plane
from ._outside import outlines, outside
from ._plane import Axes, Figure, plt, round_numbers, to_hex
from ._space import (
    AIMED,
    before_after_3d,
    content,
    fitted_window,
    margins,
    set_view,
    view_axes,
    view_of,
    viewer_of,
    whole_view,
)
from ._style import DARK, DISPLACEMENT, Limits, Values, colour_scale, finite

SLIDER = """
const panel = document.createElement("form");
panel.id = "deformation";
panel.style.cssText = "position:fixed;top:16px;left:16px;font:16px sans-serif;color:#1b1b1b;background:#ffffffd0";
panel.innerHTML = `<label>undeformed
<input id="time" type="range" min="0" max="1" step="0.01" value="1" style="width:30vw;max-width:220px;vertical-align:middle">
deformed</label><div id="label" style="margin:12px 0 6px"></div><div id="bar" style="width:240px;height:16px"></div>
<div id="ticks" style="position:relative;width:240px;height:20px"></div>`;
document.body.append(panel);
document.title = TITLE;
document.getElementById("label").textContent = LABEL;
document.getElementById("bar").style.background = `linear-gradient(to right, ${COLOURS})`;
for (const [place, text] of TICKS) {
  const tick = document.createElement("span");
  tick.style.cssText = `position:absolute;left:${place}%;transform:translateX(${-place}%)`;
  tick.textContent = text;
  document.getElementById("ticks").append(tick);
}
document.getElementById("time").addEventListener("input", event => K3DInstance.setTime(Number(event.target.value)));
function look() {
  const upwards = HALF_VIEW / Math.min(1, window.innerWidth / window.innerHeight);
  K3DInstance.setCameraFOV(360 / Math.PI * Math.atan(upwards));
}
look();
window.addEventListener("resize", look);
"""
"""Script of a page; words in capitals are replaced by the page's texts, colours and numbers."""

# no bar of k3d's, which rounds its numbers to two digits: the script draws another
BARE = {"grid_visible": False, "menu_visibility": False, "camera_auto_fit": False, "colorbar_object_id": 0}
LINES = {"indices_type": "segment", "shader": "simple", "color": int(DARK[1:], 16)}

HALF_VIEW = np.tan(np.deg2rad(15))
"""Half of what a page's camera sees across the smaller side, over its distance."""

SEEN = 1.15
"""Width that a page's camera sees, over the largest side of the scene."""

Reports = tuple[jm.QualityReport, jm.QualityReport]


@checked
def picture(
    path: str | os.PathLike[str],
    before: jm.Mesh,
    points: Float[Any, "n d"],
    *,
    moving: Int[np.ndarray, " m"],
    reports: Reports | None = None,
) -> None:
    """Writes a mesh before and after: in 2-D the skewness at moving nodes, in 3-D their surface.

    A mesh in 3-D that is one cell wide, and moves in its plane, is drawn as one in 2-D.

    **Arguments:**

    - `path`: a .png; in 3-D also .html, a page to turn and deform the surface.
    - `before`, `points`: the undeformed mesh, and positions (n, d) of its nodes afterwards.
    - `moving`: ids of the moving nodes.
    - `reports`: the quality before and after, for a picture in 2-D. Default: computed.

    **Raises:** `ValueError` for another ending.
    """
    finite(points)
    d, moving = before.points.shape[1], rows_of("moving", moving, len(before.points))
    path = output_path(path, *((".png",) if d == 2 else (".png", ".html")))
    flat = None if d == 2 or path.suffix.lower() != ".png" else _in_plane(before, np.asarray(points))
    if flat is not None:
        before, points, nodes = flat
        d, reports, moving = 2, None, np.flatnonzero(np.isin(nodes, moving))
    if d == 2:
        drawn = _in_2d(before, np.asarray(points), moving, reports or (jm.quality(before), jm.quality(before, points)))
    else:
        only = jm.Mesh(before.points, before.cells, {"moving": moving})
        if path.suffix.lower() == ".html":
            page(path, only, points, patch="moving")
            return
        drawn = _in_3d(only, points)
    with complete(path) as partial:
        partial.write_bytes(drawn)


def _in_3d(only: jm.Mesh, points: Float[Any, "n 3"]) -> bytes:
    plotter, file = before_after_3d(only, points, patch="moving"), io.BytesIO()
    plt.imsave(file, plotter.screenshot(return_img=True), format="png")
    plotter.close()
    return file.getvalue()


def _in_2d(before: jm.Mesh, points: Float[np.ndarray, "n 2"], moving: np.ndarray, reports: Reports) -> bytes:
    states = np.asarray(before.points), points
    window = _plane.window_round(np.concatenate([state[moving] for state in states]), np.concatenate(states))
    width, height = (side[1] - side[0] for side in window)
    figure = Figure(figsize=(8, 1.5 + 3.6 * min(height / width, 1.5)), dpi=200, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    largest = max(float(report.max_skewness) for report in reports)
    for axis, state, report, title in zip(axes, states, reports, ("undeformed", "deformed"), strict=True):
        colours: dict[str, Any] = {"values": report.skewness, "limits": (0, largest or 1)}
        _plane.mesh(before, state, **colours, window=window, bar=False, ax=axis)
        axis.set_title(f"{title}: largest skewness {float(report.max_skewness):.3g}")
        axis.label_outer()
    figure.colorbar(axes[0].collections[0], ax=axes, location="bottom", aspect=50, label="skewness")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _in_plane(before: jm.Mesh, points: Float[np.ndarray, "n 3"]) -> tuple[jm.Mesh, np.ndarray, np.ndarray] | None:
    """Returns a side of a 3-D mesh one cell wide: 2-D mesh, moved points, node ids; else None."""
    base = np.asarray(before.points)
    height, size = base - base.min(axis=0), np.ptp(base, axis=0)
    near = 1e-6 * size.max()
    is_layer = (size > near) & ((height < near) | (height > size - near)).all(axis=0)
    thin = int(np.argmin(np.where(is_layer, size, np.inf)))
    if not is_layer[thin] or np.abs(points - base)[:, thin].max() > near:
        return None
    side = height[:, thin] < near
    faces = {kind: ids[side[ids].all(axis=1)] for kind, ids in jm.boundary_faces(before).items()}
    nodes, flat = np.flatnonzero(side), np.delete(base, thin, axis=1)
    number = np.cumsum(side) - 1
    cells = {kind: number[_counterclockwise(flat, ids)] for kind, ids in faces.items() if len(ids)}
    return jm.Mesh(flat[nodes], cells), np.delete(points, thin, axis=1)[nodes], nodes


def _counterclockwise(points: Float[np.ndarray, "n 2"], ids: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "k c"]:
    (a, b), (c, d) = ((points[ids[:, k]] - points[ids[:, 0]]).T for k in (1, 2))
    return np.where((a * d - b * c < 0)[:, None], ids[:, ::-1], ids)


@checked
def page(
    path: str | os.PathLike,
    mesh: jm.Mesh,
    points: Float[Any, "n 3"],
    *,
    values: Values | None = None,
    limits: Limits | None = None,
    label: str | None = None,
    patch: str | None = None,
) -> pathlib.Path:
    """Makes an interactive page (.html) of a 3-D mesh's outside or patch, with a slider.

    Any browser with WebGL opens it from disk, without a network. The file is 1.2 MB larger than the
    surface. Between the two ends of the slider nodes go in straight lines.

    **Arguments:**

    - `path`: the file to write, ending in .html.
    - `mesh`, `points`: the undeformed mesh, and deformed positions (n, 3) of its nodes.
    - `values`: one for each cell, which colours it wherever the slider stands. Default: the length
      of each node's displacement, in the mesh's units.
    - `limits`, `label`: as in `mesh`.
    - `patch`: the patch to show. Default: the whole outside.

    **Returns:** the path of the file, which is there whole or not at all.

    **Raises:** `ValueError` as `surface` does, for another ending and a missing folder;
    `ImportError` for a missing k3d.
    """
    path = output_path(path, ".html", ".htm")
    try:
        k3d: Any = importlib.import_module("k3d")  # its own types know no time series
    except ImportError as error:
        raise ImportError("pages need k3d: pip install 'jaxmorph[plot]'") from error
    faces = outside(mesh, points, values, patch)
    before, after = (np.asarray(part.points, float) for part in (outside(mesh, None, None, patch), faces))
    triangles = faces.cast_to_unstructured_grid().triangulate()
    lengths = np.linalg.norm(after - before, axis=1).astype(np.float32)
    colours, (low, high), style = _shade(lengths, triangles.cell_data.get("values"), limits)
    if "whole" not in faces.cell_data:
        faces.cell_data["whole"] = np.arange(faces.n_cells)
    middle = (after.min(axis=0) + after.max(axis=0)) / 2
    places = {time: (state - middle).astype(np.float32) for time, state in (("0", before), ("1", after))}
    edges = np.asarray(outlines(faces).lines).reshape(-1, 3)[:, 1:].astype(np.uint32)
    scene = k3d.plot(time=1.0, snapshot_type="full", **BARE)
    scene.camera = _camera(np.concatenate([*places.values()]), viewer_of(faces, np.ptp(after - before, axis=0)))
    scene += k3d.mesh(places, triangles.cells_dict[5].astype(np.uint32), side="double", name="surface", **style)
    scene += k3d.lines(places, edges, name="edges", **LINES)
    words = {
        "TITLE": path.stem,
        "LABEL": label or ("displacement" if values is None else "values of the cells"),
        "COLOURS": ", ".join(to_hex(colour) for colour in plt.get_cmap(colours)(np.linspace(0, 1, 9))),
        "TICKS": [(100 * (tick - low) / (high - low), f"{tick:.6g}") for tick in round_numbers(low, high, 4)],
        "HALF_VIEW": HALF_VIEW,
    }
    code = scene.get_snapshot(additional_js_code=_with_words(SLIDER, words)).encode()
    with complete(path) as partial:
        partial.write_bytes(code)
    return path


def _shade(lengths: np.ndarray, values: Any, limits: Limits | None) -> tuple[str, Limits, dict[str, Any]]:
    if values is None:
        colours, limits = colour_scale(limits, DISPLACEMENT)
        low, high = limits or (0.0, float(lengths.max()) or 1.0)
        style: dict[str, Any] = {"attribute": {"0": np.zeros_like(lengths), "1": lengths}}
    else:
        colours, limits = colour_scale(limits)
        known = np.asarray(values, np.float32)
        least, most = (float(end(known[np.isfinite(known)])) for end in (np.min, np.max))
        low, high = limits or (least, most if most > least else least + 1)
        style = {"triangles_attribute": np.clip(known, low, high)}
    places = np.linspace(0, 1, 64)
    colour_map = np.column_stack([places, plt.get_cmap(colours)(places)[:, :3]]).ravel().tolist()
    return colours, (low, high), style | {"color_map": colour_map, "color_range": [low, high]}


def _with_words(code: str, words: dict[str, Any]) -> str:
    """Puts texts and numbers into a script as JSON in ASCII without `<`, in one pass."""
    data = {name: json.dumps(text).replace("<", "\\u003c") for name, text in words.items()}
    return re.sub("|".join(words), lambda match: data[match[0]], code)


def _camera(shown: Float[np.ndarray, "k 3"], viewer: np.ndarray) -> list[float]:
    axes = np.stack(view_axes(viewer))
    seen = shown.astype(float) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    target = (low + high) / 2 @ axes
    away = (high - low)[0] / 2 + SEEN * max((high - low)[1:]) / 2 / HALF_VIEW
    return [*(target + away * axes[0]).tolist(), *target.tolist(), 0.0, 0.0, 1.0]


@checked
def swing(points: Float[Any, "n d"], extreme: Float[Any, "n d"], *, frames: int = 24) -> Float[np.ndarray, "f n d"]:
    """Computes a period of a mode: nodes go to `extreme` and back through it, as a sine of time.

    `deform` is linear in the displacement, so these are the meshes of the mode at each amplitude.

    **Arguments:**

    - `points`, `extreme`: points (n, d), undeformed and at the largest displacement.
    - `frames`: meshes in a period, 2 or more. Default 24.

    **Returns:** points (frames, n, d), for `animate`.

    **Raises:** `ValueError` where the shapes differ, and for fewer than 2 frames.
    """
    points = finite_array("points", points, (None, 2), (None, 3))
    extreme = finite_array("extreme", extreme, points.shape)
    whole("frames", frames, 2)
    phases = np.sin(2 * np.pi * np.arange(frames) / frames)
    return points + phases[:, None, None] * (extreme - points)


@checked
def animate(
    path: str | os.PathLike,
    draw: Callable[[Float[np.ndarray, "n d"]], Any],
    frames: Float[Any, "f n d"] | Sequence[Float[Any, "n d"]],
    *,
    rate: float | int = 12,
) -> pathlib.Path:
    """Makes a film (.gif) of a mesh that moves, one picture for each frame; it repeats for ever.

    An example is `animate("mode.gif", lambda points: plot.surface(mesh, points, patch="wing"),
    plot.swing(mesh.points, extreme))`. All frames have the view of the first, with room for the
    others unless `draw` is given a window or places the camera. The size is that of the first
    figure or window.

    **Arguments:**

    - `path`: the file to write, ending in .gif.
    - `draw`: makes the picture of points (n, d), and returns its axes or plotter.
    - `frames`: points (n, d) at successive times, as `swing` or `march` give them; 2 or more.
    - `rate`: frames a second. Default 12.

    **Returns:** the path of the file, which is there whole or not at all.

    **Raises:** `ValueError` for another ending, a missing folder, a rate that is not positive,
    fewer than 2 frames, and frames of different shapes.
    """
    path = output_path(path, ".gif")
    frames = [np.asarray(points) for points in frames]
    shapes = sorted({points.shape for points in frames})
    if len(frames) < 2 or len(shapes) > 1 or len(shapes[0]) != 2:
        raise ValueError(f"`frames` should be 2 or more of one shape (n, d); found {len(frames)} of shapes {shapes}.")
    if not 0 < rate < np.inf:
        raise ValueError(f"`rate` is in frames a second, not {rate}.")
    drawn = draw(frames[0])
    view = _view(drawn, draw, frames)
    pictures = [_pixels(drawn, view), *(_pixels(draw(points), view) for points in frames[1:])]
    with complete(path) as partial:
        _write_gif(partial, pictures, rate)
    return path


def _view(first: Any, draw: Callable, frames: list[np.ndarray]) -> Any:
    """Chooses the view of all frames: the first one's, with room for the farthest nodes."""
    if isinstance(first, Axes):
        ends = [_ends(first), *(_ends(axes) for axes in _farthest(draw, frames))]
        way = np.sign(ends[0][:, 1] - ends[0][:, 0])[:, None]  # an axis may be turned round
        low, high = (way * choose([way * each for each in ends], axis=0) for choose in (np.min, np.max))
        figure: Any = first.get_figure(root=True)
        return np.column_stack([low[:, 0], high[:, 1]]), figure.get_size_inches(), figure.dpi
    if not hasattr(first, "screenshot"):
        raise ValueError(f"`draw` should return the axes or the plotter that it drew on, not {type(first).__name__}.")
    view, window = view_of(first), first.window_size
    aimed, viewer, fitted = AIMED.get(first, (None, None, None))
    if not np.array_equal(view, aimed):
        return view, first.camera.parallel_projection, window  # `draw` placed the camera
    every = np.concatenate([content(first), *(content(other) for other in _farthest(draw, frames))])
    window = fitted_window(first, every, viewer) if window == fitted else window
    return whole_view(every, window, viewer, margins(first)), True, window


def _ends(axes: Axes) -> np.ndarray:
    return np.array([axes.get_xlim(), axes.get_ylim()])


def _farthest(draw: Callable, frames: list[np.ndarray]) -> Iterator[Any]:
    away = np.stack([points - frames[0] for points in frames])
    for k in sorted({*away.max(axis=1).argmax(axis=0).tolist(), *away.min(axis=1).argmin(axis=0).tolist()} - {0}):
        drawn = draw(frames[k])
        yield drawn
        _close(drawn)


def _close(drawn: Any) -> None:
    if isinstance(drawn, Axes):
        plt.close(drawn.get_figure(root=True))
    else:
        drawn.close()


def _pixels(drawn: Any, view: Any) -> UInt8[np.ndarray, "h w 3"]:
    if isinstance(drawn, Axes):
        (xlim, ylim), size, dpi = view
        drawn.set(xlim=xlim, ylim=ylim)
        figure: Any = drawn.get_figure(root=True)
        figure.set(dpi=dpi, size_inches=size)
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())
    else:
        *camera, drawn.window_size = view
        set_view(drawn, *camera)
        pixels = np.asarray(drawn.screenshot(return_img=True))
    pixels = pixels[..., :3].copy()
    _close(drawn)
    return pixels


def _write_gif(path: pathlib.Path, pictures: list[UInt8[np.ndarray, "h w 3"]], rate: float | int) -> None:
    """Writes a GIF with one palette for all frames, so that what does not move does not flicker."""
    from PIL import Image  # comes with matplotlib

    some = np.concatenate(pictures[:: max(1, len(pictures) // 6)])
    palette = Image.fromarray(some).quantize(256, Image.Quantize.FASTOCTREE)
    images = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    duration = max(20, round(100 / rate) * 10)  # in a GIF time goes by hundredths of a second
    images[0].save(path, save_all=True, append_images=images[1:], duration=duration, loop=0, optimize=True)
