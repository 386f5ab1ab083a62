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
    """Writes a mesh before and after: in 2-D the skewness at moving nodes, in 3-D their surface.

    A mesh in 3-D that is one cell wide, and moves in its plane, is drawn as one in 2-D.

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
    flat = None if d == 2 or path.suffix.lower() != ".png" else _in_plane(before, np.asarray(points))
    if flat is not None:
        d, reports = 2, None
        before, points, nodes = flat
        moving = np.flatnonzero(np.isin(nodes, moving))
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
    figure = Figure(figsize=(8, 1.5 + 3.6 * min(height / width, 1.5)), dpi=200, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    largest = max(float(report.max_skewness) for report in reports)
    for axis, state, report, title in zip(axes, states, reports, ("undeformed", "deformed"), strict=True):
        colours: dict[str, Any] = {"values": report.skewness, "limits": (0, largest or 1)}
        mesh(before, state, **colours, window=window, bar=False, ax=axis)
        axis.set_title(f"{title}: largest skewness {float(report.max_skewness):.3g}")
        axis.label_outer()
    figure.colorbar(axes[0].collections[0], ax=axes, location="bottom", aspect=50, label="skewness")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _window(points: Float[np.ndarray, "k 2"]) -> Window:
    low, high = points.min(axis=0), points.max(axis=0)
    room = ROOM * (high - low).max()
    (left, bottom), (right, top) = (low - room).tolist(), (high + room).tolist()
    return (left, right), (bottom, top)


def _in_plane(before: jm.Mesh, points: Float[np.ndarray, "n 3"]) -> tuple[jm.Mesh, np.ndarray, np.ndarray] | None:
    """Returns one side of a 3-D mesh one cell wide, moving in its plane, as 2-D mesh; or None.

    With it come the moved points in 2-D, and the ids of the nodes on this side.
    """
    base = np.asarray(before.points)
    low, size = base.min(axis=0), np.ptp(base, axis=0)
    near = 1e-6 * size.max()
    thin = [
        axis
        for axis in np.argsort(size, kind="stable").tolist()
        if _is_layer(base[:, axis] - low[axis], size[axis], near)
    ]
    if not thin or np.abs(points - base)[:, thin[0]].max() > near:
        return None
    side = base[:, thin[0]] < low[thin[0]] + near
    faces = {kind: ids[side[ids].all(axis=1)] for kind, ids in jm.boundary_faces(before).items()}
    nodes = np.unique(np.concatenate([ids.ravel() for ids in faces.values()]))
    flat = np.delete(base, thin[0], axis=1)
    cells = {kind: _counterclockwise(flat, ids) for kind, ids in faces.items() if len(ids)}
    number = np.zeros(len(base), int)
    number[nodes] = np.arange(len(nodes))
    return (
        jm.Mesh(flat[nodes], {kind: number[ids] for kind, ids in cells.items()}),
        np.delete(points, thin[0], axis=1)[nodes],
        nodes,
    )


def _is_layer(height: np.ndarray, size: float, near: float) -> bool:
    return bool(size > near and ((height < near) | (height > size - near)).all())


def _counterclockwise(points: Float[np.ndarray, "n 2"], ids: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "k c"]:
    (a, b), (c, d) = ((points[ids[:, k]] - points[ids[:, 0]]).T for k in (1, 2))
    return np.where((a * d - b * c < 0)[:, None], ids[:, ::-1], ids)
