"""Files: a picture of what became of a mesh, and a page to turn and deform it."""

import importlib
import io
import json
import os
import pathlib
import re
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph.extend import checked, complete, output_path, rows_of

from . import _plane
from ._outside import outlines, outside
from ._plane import Figure, plt, round_numbers, to_hex
from ._space import before_after_3d, view_axes, viewer_of
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
