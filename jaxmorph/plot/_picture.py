"""One picture of what became of a mesh."""

import io
import os
from typing import Any

import numpy as np
from jaxtyping import Float, Int

import jaxmorph as jm
from jaxmorph._host.package.arguments import checked, rows_of
from jaxmorph._host.package.files import complete, output_path

from ._page import page
from ._plane import ROOM, Window, mesh
from ._space import before_after_3d
from ._style import finite

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
    """Writes a picture of a mesh before and after: in 2-D the skewness near the moving nodes, in 3-D their surface.

    **Arguments:**

    - `path`: a .png; in 3-D also .html, a page to turn and deform the surface.
    - `before`: the undeformed mesh.
    - `points`: positions (n, d) of its nodes afterwards.
    - `moving`: ids of the moving nodes.
    - `reports`: the quality before and after; found by default. Only a picture in 2-D needs them.

    **Raises:** `ValueError` for another ending.
    """
    finite(points)
    d, moving = before.points.shape[1], rows_of("moving", moving, len(before.points))
    path = output_path(path, *((".png",) if d == 2 else (".png", ".html")))
    if d == 2:
        content = _in_2d(before, np.asarray(points), moving, reports or _reports(before, points))
    else:
        only = jm.Mesh(before.points, before.cells, {"moving": moving})
        if path.suffix.lower() == ".html":
            page(path, only, points, patch="moving")
            return
        content = _in_3d(only, points)
    with complete(path) as partial:
        partial.write_bytes(content)


def _reports(before: jm.Mesh, points: Float[Any, "n d"]) -> Reports:
    return jm.quality(before), jm.quality(before, points)


def _in_3d(only: jm.Mesh, points: Float[Any, "n 3"]) -> bytes:
    import matplotlib.image

    plotter, file = before_after_3d(only, points, patch="moving"), io.BytesIO()
    matplotlib.image.imsave(file, plotter.screenshot(return_img=True), format="png")
    plotter.close()
    return file.getvalue()


def _in_2d(before: jm.Mesh, points: Float[np.ndarray, "n 2"], moving: np.ndarray, reports: Reports) -> bytes:
    from matplotlib.figure import Figure

    states = np.asarray(before.points), points
    window = _window(np.concatenate([state[moving] for state in states]))
    width, height = (side[1] - side[0] for side in window)
    figure = Figure(figsize=(12.8, 1.6 + 6 * min(height / width, 1.5)), dpi=150, layout="constrained")
    axes = figure.subplots(1, 2)
    largest = max(float(report.max_skewness) for report in reports)
    for axis, state, report, title in zip(axes, states, reports, ("undeformed", "deformed"), strict=True):
        colours: dict[str, Any] = {"values": report.skewness, "limits": (0, largest or 1)}
        mesh(before, state, **colours, window=window, bar=False, ax=axis)
        axis.set_title(f"{title}: largest skewness {float(report.max_skewness):.3g}", fontsize=15)
    figure.colorbar(axes[0].collections[0], ax=axes, location="bottom", aspect=50, pad=0.02).set_label(
        "skewness", fontsize=13
    )
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _window(points: Float[np.ndarray, "k 2"]) -> Window:
    low, high = points.min(axis=0), points.max(axis=0)
    room = ROOM * (high - low).max()
    (left, bottom), (right, top) = (low - room).tolist(), (high + room).tolist()
    return (left, right), (bottom, top)
