"""A page to turn and deform a mesh."""

import importlib
import json
import os
import pathlib
import re
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxmorph as jm
from jaxmorph.extend import checked, complete, output_path

from ._plane import plt, round_numbers, to_hex
from ._space import outlines, outside, patches_of, view_axes, viewer_of
from ._style import DARK, DISPLACEMENT, UNNAMED, Limits, Places, Values, colour_scale

SLIDER = """
const panel = document.createElement("form");
panel.id = "deformation";
panel.style.cssText = "position:fixed;top:16px;left:16px;font:16px sans-serif;" +
  "color:#1b1b1b;background:#ffffffd0";
panel.innerHTML = `<label>undeformed
<input id="time" type="range" min="0" max="1" step="0.01" value="1"
 style="width:30vw;max-width:220px;vertical-align:middle">
deformed</label><div id="label" style="margin:12px 0 6px"></div>
<div id="bar" style="width:240px;height:16px"></div>
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
document.getElementById("time").addEventListener(
  "input", event => K3DInstance.setTime(Number(event.target.value)));
function look() {
  const upwards = HALF_VIEW / Math.min(1, window.innerWidth / window.innerHeight);
  K3DInstance.setCameraFOV(360 / Math.PI * Math.atan(upwards));
}
look();
window.addEventListener("resize", look);
"""
"""Script of a page; words in capitals are replaced by the page's texts, colours and numbers."""

# no bar of k3d's, which rounds its numbers to two digits: the script draws another
BARE = {
    "grid_visible": False,
    "menu_visibility": False,
    "camera_auto_fit": False,
    "colorbar_object_id": 0,
}
LINES = {"indices_type": "segment", "shader": "simple", "color": int(DARK[1:], 16)}

HALF_VIEW = np.tan(
    np.deg2rad(15)
)  # half of what a page's camera sees across the smaller side, over its distance
SEEN = 1.15  # width that a page's camera sees, over the largest side of the scene


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
    """Makes an interactive page (.html) of a 3-D mesh's bodies or patch, with a slider.

    Any browser with WebGL opens it from disk, without a network. The file is 1.2 MB larger than the
    surface. Between the two ends of the slider nodes go in straight lines.

    **Arguments:**

    - `path`: the file to write, ending in .html.
    - `mesh`, `points`: the undeformed mesh, and deformed positions (n, 3) of its nodes.
    - `values`: one for each cell, which colours it wherever the slider stands. Default: the length
      of each node's displacement, in the mesh's units.
    - `limits`, `label`: as in `mesh`.
    - `patch`: as `surface` takes it.

    **Returns:** the path of the file, which is there whole or not at all.

    **Raises:** `ValueError` as `surface` does, for another ending and a missing folder;
    `ImportError` for a missing k3d.
    """
    path = output_path(path, ".html", ".htm")
    k3d = _k3d()
    patches = patches_of(mesh, patch)
    faces = outside(mesh, points, values, patches)
    before, after = (
        np.asarray(part.points, float) for part in (outside(mesh, None, None, patches), faces)
    )
    triangles = faces.cast_to_unstructured_grid().triangulate()
    lengths = np.linalg.norm(after - before, axis=1).astype(np.float32)
    colours, (low, high), style = _shade(lengths, triangles.cell_data.get("values"), limits)
    if "whole" not in faces.cell_data:
        faces.cell_data["whole"] = np.arange(faces.n_cells)
    middle = (after.min(axis=0) + after.max(axis=0)) / 2
    places = {
        time: (state - middle).astype(np.float32) for time, state in (("0", before), ("1", after))
    }
    edges = np.asarray(outlines(faces).lines).reshape(-1, 3)[:, 1:].astype(np.uint32)
    scene = k3d.plot(time=1.0, snapshot_type="full", **BARE)
    scene.camera = _camera(
        np.concatenate([*places.values()]), viewer_of(faces, np.ptp(after - before, axis=0))
    )
    scene += k3d.mesh(
        places, triangles.cells_dict[5].astype(np.uint32), side="double", name="surface", **style
    )
    scene += k3d.lines(places, edges, name="edges", **LINES)
    words = {
        "TITLE": path.stem,
        "LABEL": label or ("displacement" if values is None else UNNAMED),
        "COLOURS": ", ".join(
            to_hex(colour) for colour in plt.get_cmap(colours)(np.linspace(0, 1, 9))
        ),
        "TICKS": [
            (100 * (tick - low) / (high - low), f"{tick:.6g}")
            for tick in round_numbers(low, high, 4)
        ],
        "HALF_VIEW": HALF_VIEW,
    }
    # as JSON in ASCII without `<`, in one pass
    data = {name: json.dumps(text).replace("<", "\\u003c") for name, text in words.items()}
    script = re.sub("|".join(words), lambda match: data[match[0]], SLIDER)
    code = scene.get_snapshot(additional_js_code=script).encode()
    with complete(path) as partial:
        partial.write_bytes(code)
    return path


def _k3d() -> Any:
    """The package, as its own types know no time series."""
    try:
        return importlib.import_module("k3d")
    except ImportError as error:
        raise ImportError("pages need k3d: pip install 'jaxmorph[plot]'") from error


def _shade(
    lengths: np.ndarray, values: Any, limits: Limits | None
) -> tuple[str, Limits, dict[str, Any]]:
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


def _camera(shown: Places, viewer: np.ndarray) -> list[float]:
    axes = np.stack(view_axes(viewer))
    seen = shown.astype(float) @ axes.T
    low = seen.min(axis=0)
    high = seen.max(axis=0)
    target = (low + high) / 2 @ axes
    away = (high - low)[0] / 2 + SEEN * max((high - low)[1:]) / 2 / HALF_VIEW
    return [*(target + away * axes[0]).tolist(), *target.tolist(), 0.0, 0.0, 1.0]
