"""A file with a picture of a mesh, or of what became of it."""

import dataclasses
import io
import os
import pathlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

import jaxmorph as jm
from jaxmorph.extend import checked, complete, lagrange_types, output_path, rows_of

from . import _plane
from ._files import page
from ._plane import Figure, plt
from ._space import before_after_3d, surface
from ._style import BLUE, STILL, WIDTH, bodies, check_cells, finite

FLAT = 0.45
"""Height over width of a window below which two of them stand one above the other."""


@checked
def picture(
    path: str | os.PathLike[str],
    before: jm.Mesh,
    points: Float[Any, "n d"] | None = None,
    *,
    moving: Int[np.ndarray, " m"] | None = None,
    verdict: jm.Verdict | None = None,
) -> None:
    """Writes a mesh, or a mesh before and after: in 2-D the skewness, in 3-D bodies and what moved.

    Each cell has the mean over its nodes of the skewness at them, itself a mean over their cells. A
    cross is at the worst cell. A mesh in 3-D that is one cell wide, and moves in its plane, is
    drawn as one in 2-D.

    **Arguments:**

    - `path`: a .png; in 3-D also .html, a page to turn and deform the surface.
    - `before`, `points`: the undeformed mesh, and positions (n, d) of its nodes afterwards. Default
      None: the mesh alone, in 3-D its bodies by their cells' skewness.
    - `moving`: ids of the moving nodes. Default: those of patches that moved.
    - `verdict`: what `judge` said of the motion. Default: it is asked.

    **Raises:** `ValueError` for another ending.
    """
    check_cells(before)
    places = finite(before.points if points is None else before.moved(np.asarray(points)).points)
    path = output_path(path, *((".png",) if places.shape[1] == 2 else (".png", ".html")))
    nodes = _moved(before, places) if moving is None else rows_of("moving", moving, len(before.points))
    side = None if path.suffix.lower() == ".html" else FlatSide.of(before, places)
    if side is None and points is not None:
        drawn: bytes | None = _in_3d(path, before, places, nodes)
    else:
        verdict = jm.judge(before, points) if verdict is None or verdict.judged is None else verdict
        drawn = _alone(path, before, verdict) if side is None else _in_2d(side, nodes, verdict)
    if drawn is not None:
        with complete(path) as partial:
            partial.write_bytes(drawn)


def _moved(mesh: jm.Mesh, places: Float[np.ndarray, "n d"]) -> Int[np.ndarray, " m"]:
    lengths = np.linalg.norm(places - np.asarray(mesh.points), axis=1)
    return np.intersect1d(mesh.patch(*mesh.patches), np.flatnonzero(lengths > STILL * lengths.max()))


def _in_3d(path: pathlib.Path, mesh: jm.Mesh, places: Float[np.ndarray, "n 3"], moving: np.ndarray) -> bytes | None:
    nodes = np.union1d(moving, mesh.patch(*bodies(mesh)))
    only = jm.Mesh(mesh.points, mesh.cells, {"drawn": nodes}, mesh.source)
    patch = "drawn" if len(nodes) else None
    if path.suffix.lower() == ".html":
        page(path, only, places, patch=patch)
        return None
    return _png(before_after_3d(only, places, patch=patch))


def _alone(path: pathlib.Path, mesh: jm.Mesh, verdict: jm.Verdict) -> bytes | None:
    colours: dict[str, Any] = {"label": _measure(verdict).replace("_", " "), "values": _of_cells(verdict)}
    if path.suffix.lower() == ".html":
        page(path, mesh, np.asarray(mesh.points), **colours)
        return None
    return _png(surface(mesh, **colours))


def _png(plotter: Any) -> bytes:
    file = io.BytesIO()
    plt.imsave(file, plotter.screenshot(return_img=True), format="png")
    plotter.close()
    return file.getvalue()


def _measure(verdict: jm.Verdict) -> str:
    """The name of skewness in the verdict's table: of cells by their corners, or of faces."""
    return next(name for _, name in verdict.rows if name.endswith("skewness"))


def _of_cells(verdict: jm.Verdict) -> Float[np.ndarray, " k"]:
    """Skewness of the file's cells; NaN for cells that do not count."""
    judged: Any = verdict.judged
    values = np.full(len(judged.report.counted), np.nan)
    values[judged.counted] = judged.values(_measure(verdict))
    return values


def _in_2d(side: "FlatSide", moving: np.ndarray, verdict: jm.Verdict) -> bytes:
    mesh, name = side.mesh, _measure(verdict)
    label = name.replace("_", " ")
    states = {"deformed": (side.points, verdict)}
    if verdict.before is not None:
        states = {"undeformed": (np.asarray(mesh.points), verdict.before)} | states
    seen, every = np.flatnonzero(np.isin(side.nodes, moving)), [points for points, _ in states.values()]
    window = _plane.window_of(mesh, seen if len(seen) else None, *every)
    width, height = (end - start for start, end in window)
    rows = len(states) if height < FLAT * width else 1
    columns = len(states) // rows
    tall = rows * (0.4 + (WIDTH - 0.9) / columns * min(height / width, 1.5)) + 1.15 + 0.2 * columns
    figure = Figure(figsize=(WIDTH, tall), dpi=300, layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    colours = [_averaged(mesh, _of_cells(own)[side.cells]) for _, own in states.values()]
    largest = max(np.nanmax(values, initial=0) for values in colours)
    for axis, values, (state, (points, own)) in zip(axes, colours, states.items(), strict=True):
        _plane.mesh(mesh, points, values=values, limits=(0, largest or 1), window=window, bar=False, ax=axis)
        worst = own.rows["max", name]
        axis.plot(*np.array(worst.near)[side.axes], "x", color=BLUE, markersize=7, markeredgewidth=1.5)
        title = f"{state}\n" if len(states) > 1 and rows == 1 else f"{state}: " if len(states) > 1 else ""
        axis.set_title(f"{title}largest {label} {round(worst.value, 9):.3g} (×)", fontsize="medium")
        axis.label_outer()
    bar = figure.colorbar(axes[0].collections[0], ax=axes, location="bottom", aspect=40)
    bar.set_label(f"{label}, mean of the cells at each node")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _averaged(mesh: jm.Mesh, values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Means over the cells at each node, then over its nodes: single triangles are noise."""
    kinds = [np.asarray(ids) for ids in mesh.cells.values()]
    cell = np.repeat(np.arange(len(values)), np.concatenate([np.full(len(ids), ids.shape[1]) for ids in kinds]))
    node, counts = np.concatenate([ids.ravel() for ids in kinds]), np.isfinite(values)
    weights, sums = (np.bincount(node, part[cell], len(mesh.points)) for part in (counts, np.where(counts, values, 0)))
    at_nodes = sums / np.maximum(weights, 1)
    return np.bincount(cell, at_nodes[node]) / np.bincount(cell)


@dataclasses.dataclass(frozen=True, eq=False)
class FlatSide:
    """What is drawn in 2-D: a mesh in 2-D, or one side of a mesh in 3-D that is one cell wide.

    `points` (k, 2) are its nodes afterwards, `nodes` (k,) their ids, `cells` the file's cell of
    each of its cells, `axes` the coordinates in its plane.
    """

    mesh: jm.Mesh
    points: Float[np.ndarray, "k 2"]
    nodes: Int[np.ndarray, " k"]
    cells: Int[np.ndarray, " c"]
    axes: list[int]

    @classmethod
    def of(cls, mesh: jm.Mesh, places: Float[np.ndarray, "n d"]) -> "FlatSide | None":
        base = np.asarray(mesh.points)
        if base.shape[1] == 2:
            return cls(mesh, places, np.arange(len(base)), np.asarray(mesh.cell_ids), [0, 1])
        height, size = base - base.min(axis=0), np.ptp(base, axis=0)
        near = 1e-6 * size.max()
        is_layer = (size > near) & ((height < near) | (height > size - near)).all(axis=0)
        thin = int(np.argmin(np.where(is_layer, size, np.inf)))
        if not is_layer[thin] or np.abs(places - base)[:, thin].max() > near:
            return None
        on = height[:, thin] < near
        faces = {kind: ids[on[ids].all(axis=1)] for kind, ids in jm.boundary_faces(mesh).items()}
        faces = {kind: ids for kind, ids in sorted(faces.items()) if len(ids)}
        nodes, axes, number = np.flatnonzero(on), [k for k in range(3) if k != thin], np.cumsum(on) - 1
        cells = {kind: number[_counterclockwise(base[:, axes], ids)] for kind, ids in faces.items()}
        return cls(
            jm.Mesh(base[nodes][:, axes], cells), places[nodes][:, axes], nodes, _owners(mesh, faces.values()), axes
        )


def _owners(mesh: jm.Mesh, faces: Iterable[Int[np.ndarray, "k c"]]) -> Int[np.ndarray, " f"]:
    """Finds the file's cell that has all nodes of each face."""
    kinds = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    sizes = np.concatenate([np.full(len(ids), ids.shape[1]) for ids in kinds.values()])
    solid = np.concatenate([np.full(len(ids), lagrange_types()[kind].dimension == 3) for kind, ids in kinds.items()])
    cells, nodes = np.repeat(np.asarray(mesh.cell_ids), sizes), np.concatenate([ids.ravel() for ids in kinds.values()])
    table = csr_array((np.repeat(solid, sizes).astype(float), (nodes, cells)))
    table.data = np.minimum(table.data, 1)  # pieces of a cell share nodes
    shared: list[Any] = [sum(table[column] for column in ids.T) for ids in faces]
    return np.concatenate([counts.argmax(axis=1) for counts in shared])


def _counterclockwise(points: Float[np.ndarray, "n 2"], ids: Int[np.ndarray, "k c"]) -> Int[np.ndarray, "k c"]:
    (a, b), (c, d) = ((points[ids[:, k]] - points[ids[:, 0]]).T for k in (1, 2))
    return np.where((a * d - b * c < 0)[:, None], ids[:, ::-1], ids)
