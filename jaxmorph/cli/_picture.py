"""`jaxmorph deform --picture`: what became of the mesh, to look at."""

import importlib
import io
import pathlib
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxmorph import Mesh

from ._files import save
from ._gates import Judged

ROOM = 0.4
"""Margin of a 2-D picture around the moving patches, relative to their extent."""


def check(path: pathlib.Path, mesh: Mesh) -> None:
    """Raises `ValueError` or `ImportError` for a picture that is sure to fail, before any work."""
    endings = (".png",) if mesh.points.shape[1] == 2 else (".png", ".html")
    if path.suffix.lower() not in endings:
        raise ValueError(f"--picture {path}: a picture of this mesh ends in {' or '.join(endings)}.")
    if not path.parent.is_dir():
        raise ValueError(f"--picture {path}: there is no such folder.")
    importlib.import_module("jaxmorph.plot")


def picture(path: pathlib.Path, mesh: Mesh, moving: np.ndarray, before: Judged, after: Judged) -> None:
    """Draws before and after: in 2-D the skewness near the moving nodes, in 3-D their surface."""
    from jaxmorph import plot

    if mesh.points.shape[1] == 2:
        save(path, _in_2d(mesh, moving, before, after))
        return
    only = Mesh(mesh.points, mesh.cells, {"moving": moving})
    if path.suffix.lower() == ".html":
        plot.page(path, only, after.points, patch="moving")
        return
    import matplotlib.image

    plotter, file = plot.before_after_3d(only, after.points, patch="moving"), io.BytesIO()
    matplotlib.image.imsave(file, plotter.screenshot(return_img=True), format="png")
    plotter.close()
    save(path, file.getvalue())


def _in_2d(mesh: Mesh, moving: np.ndarray, before: Judged, after: Judged) -> bytes:
    from matplotlib.figure import Figure

    from jaxmorph import plot

    window = _window(np.concatenate([np.asarray(judged.points)[moving] for judged in (before, after)]))
    width, height = (side[1] - side[0] for side in window)
    figure = Figure(figsize=(12.8, 1.6 + 6 * min(height / width, 1.5)), dpi=150, layout="constrained")
    axes = figure.subplots(1, 2)
    largest = max(float(judged.report.max_skewness) for judged in (before, after))
    for axis, judged, title in zip(axes, (before, after), ("undeformed", "deformed"), strict=True):
        colours: dict[str, Any] = {"values": judged.report.skewness, "limits": (0, largest or 1)}
        plot.mesh(mesh, judged.points, **colours, window=window, bar=False, ax=axis)
        axis.set_title(f"{title}: largest skewness {float(judged.report.max_skewness):.3g}", fontsize=15)
    figure.colorbar(axes[0].collections[0], ax=axes, location="bottom", aspect=50, pad=0.02).set_label(
        "skewness", fontsize=13
    )
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _window(points: Float[np.ndarray, "k 2"]) -> tuple[tuple[float, float], tuple[float, float]]:
    low, high = points.min(axis=0), points.max(axis=0)
    room = ROOM * (high - low).max()
    (left, bottom), (right, top) = (low - room).tolist(), (high + room).tolist()
    return (left, right), (bottom, top)
