"""Makes a page with a surface in 3-D to turn, zoom and deform, by k3d."""

import dataclasses
import importlib
import json
import os
import pathlib
import re
from typing import Any

import numpy as np
from jaxtyping import Float, UInt32

import jaxmorph as jm
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.files import complete, output_path

from ._cells import MaxNLocator, plt, to_hex
from ._outside import corners_of, outlines, outside
from ._space import viewer_of
from ._style import COLOURS, DARK, DISPLACEMENT, Limits, Values, colour_scale
from ._view import view_axes

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

HALF_VIEW = np.tan(np.deg2rad(15))
"""Half of what the camera sees across the smaller side of its window, over its distance."""

ROOM = 1.15
"""Width that the camera sees, over the largest side of the scene."""


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

    Any browser with WebGL opens it from disk, without a network: all it needs is in the one file,
    1.2 MB more than the surface takes. The mouse turns, moves and zooms. Between the two ends of
    the slider nodes go in straight lines.

    **Arguments:**

    - `path`: the file to write, ending in .html.
    - `mesh`: the undeformed mesh.
    - `points`: deformed positions (n, 3) of its nodes.
    - `values`: one for each cell, which colours it wherever the slider stands. Default: the length
      of each node's displacement, in the mesh's units.
    - `limits`: the values at the light and at the dark end of the colours, as in `mesh`.
    - `label`: names the values.
    - `patch`: the patch to show. Default: the whole outside.

    **Returns:** the path of the file, which is there whole or not at all.

    **Raises:** `ValueError` as `surface` does, and for another ending or a folder that is not
    there. `ImportError` where k3d is missing.
    """
    path = output_path(path, ".html", ".htm")
    try:
        k3d: Any = importlib.import_module("k3d")  # its own types know no time series
    except ImportError as error:
        raise ImportError("pages need k3d: pip install 'jaxmorph[plot]'") from error
    surface = _Surface.outside_of(mesh, points, values, patch)
    scene = k3d.plot(
        grid_visible=False,
        menu_visibility=False,
        time=1.0,
        snapshot_type="full",
        camera_auto_fit=False,
        colorbar_object_id=0,  # none: its numbers are rounded to two digits; the script draws another
    )
    scene.camera = surface.camera()
    colours, limits = colour_scale(limits, COLOURS if values is not None else DISPLACEMENT)
    low, high = surface.range if limits is None else limits
    for part in surface.drawn(k3d, colours, low, high):
        scene += part
    label = label or ("displacement" if values is None else "values of the cells")
    words = {"TITLE": path.stem, "LABEL": label, "COLOURS": _css(colours), "TICKS": _ticks(low, high)}
    code = _with_words(SLIDER, words | {"HALF_VIEW": HALF_VIEW})
    content = scene.get_snapshot(additional_js_code=code).encode()
    with complete(path) as partial:
        partial.write_bytes(content)
    return path


def _ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Returns places on a bar in percent of its length, and the round numbers there."""
    values = np.asarray(MaxNLocator(4, steps=(1, 2, 2.5, 5, 10)).tick_values(low, high))
    shown = values[(low <= values) & (values <= high)]
    return [(100 * (value - low) / (high - low), f"{value:.6g}") for value in shown.tolist()]


def _with_words(code: str, words: dict[str, Any]) -> str:
    """Puts texts and numbers into a script as JSON in ASCII without `<`, in one pass."""
    data = {name: json.dumps(text).replace("<", "\\u003c") for name, text in words.items()}
    return re.sub("|".join(words), lambda match: data[match[0]], code)


@dataclasses.dataclass(frozen=True)
class _Surface:
    """A drawing round its middle: corners before and after, triangles, edges, colours."""

    before: Float[np.ndarray, "p 3"]
    after: Float[np.ndarray, "p 3"]
    triangles: UInt32[np.ndarray, "t 3"]
    edges: UInt32[np.ndarray, "e 2"]
    length: Float[np.ndarray, " p"]
    values: Float[np.ndarray, " t"] | None
    viewer: Float[np.ndarray, " 3"]

    @staticmethod
    def outside_of(mesh: jm.Mesh, points: Any, values: Any, patch: str | None) -> "_Surface":
        faces = outside(mesh, points, values, patch)
        before, after = (np.asarray(part.points, dtype=float) for part in (outside(mesh, None, None, patch), faces))
        middle = (after.min(axis=0) + after.max(axis=0)) / 2
        triangles, edges, owners = [], [], []
        labels, starts = corners_of(faces)
        for size in np.unique(np.diff(starts)).tolist():
            rows = np.flatnonzero(np.diff(starts) == size)
            corners = labels[starts[rows, None] + np.arange(size)]
            fan = np.array([[0, k, k + 1] for k in range(1, size - 1)])
            triangles.append(corners[:, fan].reshape(-1, 3))
            edges.append(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2))
            owners.append(np.repeat(rows, size - 2))
        if "whole" in faces.cell_data:  # of curved faces in pieces, the edges of the faces
            edges = [np.asarray(outlines(faces).lines).reshape(-1, 3)[:, 1:]]
        return _Surface(
            (before - middle).astype(np.float32),
            (after - middle).astype(np.float32),
            np.concatenate(triangles).astype(np.uint32),
            np.unique(np.sort(np.concatenate(edges), axis=1), axis=0).astype(np.uint32),
            np.linalg.norm(after - before, axis=1).astype(np.float32),
            None if values is None else np.asarray(faces.cell_data["values"], np.float32)[np.concatenate(owners)],
            viewer_of(faces, np.ptp(after - before, axis=0)),
        )

    def drawn(self, k3d: Any, colours: str, low: float, high: float) -> list[Any]:
        """Returns k3d's objects: the coloured faces, and their edges."""
        if self.values is None:
            shade = {"attribute": {"0": np.zeros(len(self.length), np.float32), "1": self.length}}
        else:
            shade = {"triangles_attribute": np.clip(self.values, low, high)}
        shade |= {"color_map": _colour_map(colours), "color_range": [low, high]}
        places = {"0": self.before, "1": self.after}
        line = {"indices_type": "segment", "shader": "simple", "color": int(DARK[1:], 16)}
        return [
            k3d.mesh(places, self.triangles, side="double", name="surface", **shade),
            k3d.lines(places, self.edges, name="edges", **line),
        ]

    def camera(self) -> list[float]:
        """Returns position, target, upwards: both ends of the motion show."""
        axes = np.stack(view_axes(self.viewer))
        seen = np.concatenate([self.before, self.after]).astype(float) @ axes.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        size = max((high - low)[1:])
        target = (low + high) / 2 @ axes
        away = (high - low)[0] / 2 + ROOM * size / 2 / HALF_VIEW
        return [*(target + away * axes[0]).tolist(), *target.tolist(), 0.0, 0.0, 1.0]

    @property
    def range(self) -> Limits:
        """Returns the smallest and the largest value, or zero and the largest displacement."""
        shown = self.length if self.values is None else self.values[np.isfinite(self.values)]
        low, high = 0.0 if self.values is None else float(shown.min()), float(shown.max())
        return low, high if high > low else low + 1


def _css(name: str) -> str:
    """Returns a colour map as the list of colours of a gradient in CSS."""
    return ", ".join(to_hex(colour) for colour in plt.get_cmap(name)(np.linspace(0, 1, 9)))


def _colour_map(name: str) -> list[float]:
    """Returns a colour map as k3d takes it: place, red, green and blue of each of 64 colours."""
    places = np.linspace(0, 1, 64)
    return np.column_stack([places, plt.get_cmap(name)(places)[:, :3]]).ravel().tolist()
