"""What the formats read by meshio have in common."""

try:
    import meshio
except ImportError as error:
    raise ImportError("this file format needs meshio: pip install 'jaxmorph[io]'") from error

import contextlib
import io
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxmorph import Mesh
from jaxmorph._host.topology import CORNERS, DIMENSION

from ._boundary import boundary_faces
from ._format import Arrays

MeshioMesh = meshio.Mesh
PREFIX = "patch:"
"""Point arrays of this name and a patch's hold 1 at the nodes of the patch and 0 elsewhere."""


def load(path: pathlib.Path, name: str, reader: Callable[[str], Any]) -> MeshioMesh:
    """What `reader` reads. Whatever way it fails on a file it cannot read is a `ValueError` here; it prints nothing."""
    path.open("rb").close()
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            found = reader(str(path))
    except (Exception, SystemExit) as error:
        detail = " ".join(f"{error or said.getvalue()}".split())[:120]
        message = f"{path}: not a {name} file, or a damaged one ({type(error).__name__}{detail and ': '}{detail})."
        raise ValueError(message) from error
    cells = sum(len(np.asarray(block.data)) for block in found.cells)
    if len(found.points) == 0 or cells == 0:
        raise ValueError(f"{path}: no mesh, the file holds {len(found.points)} points and {cells} cells.")
    return found


def to_mesh(path: pathlib.Path, found: MeshioMesh, patches: dict[str, np.ndarray], source: Any) -> Mesh:
    """The cells of highest dimension, the points without z where all are in one plane z = constant, and `patches`.

    Without any patch, the nodes of faces that belong to one cell only become the patch `boundary`.
    """
    cells = _cells(path, found)
    points = np.asarray(found.points, dtype=float)
    if max(map(DIMENSION.__getitem__, cells)) == 2 and points.shape[1] == 3 and np.ptp(points[:, 2]) == 0:
        points = points[:, :2]
    if not np.isfinite(points).all():
        bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise ValueError(f"{path}: point {bad} is not finite: {points[bad].tolist()}.")
    try:
        mesh = Mesh(np.ascontiguousarray(points), cells, patches, source=source)
        if not patches:
            faces = boundary_faces(mesh)
            nodes = np.concatenate([corners.ravel() for corners in faces.values()])
            mesh = Mesh(mesh.points, cells, {"boundary": nodes}, source=source)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return mesh


def _cells(path: pathlib.Path, found: MeshioMesh) -> dict[str, np.ndarray]:
    blocks: dict[str, list[np.ndarray]] = {}
    for block in found.cells:
        corners = np.asarray(block.data)
        if len(corners) and block.type != "vertex":
            blocks.setdefault(block.type, []).append(corners)
    unknown = [kind for kind in blocks if kind not in CORNERS]
    if unknown:
        known = ", ".join(CORNERS)
        raise ValueError(f"{path}: cells of type {', '.join(unknown)} are not supported; those that are: {known}.")
    highest = max((DIMENSION[kind] for kind in blocks), default=0)
    if highest < 2:
        raise ValueError(f"{path}: no cells of an area or a volume, only {', '.join(blocks) or 'single nodes'}.")
    return {kind: np.concatenate(parts) for kind, parts in blocks.items() if DIMENSION[kind] == highest}


def set_patches(found: MeshioMesh) -> dict[str, np.ndarray]:
    """Patches from named sets of cells (not those of full dimension, which are regions of the volume)."""
    highest = max(block.dim for block in found.cells)
    patches: dict[str, list[np.ndarray]] = {}
    for name, members in found.cell_sets.items():
        for block, inside in zip(found.cells, members, strict=True):
            if inside is not None and np.size(inside) and block.dim < highest and not name.startswith("gmsh:"):
                patches.setdefault(name, []).append(np.asarray(block.data)[np.asarray(inside, dtype=np.int64)].ravel())
    return {name: np.concatenate(nodes) for name, nodes in patches.items()}


def in_space(values: np.ndarray) -> np.ndarray:
    """Points or vectors of the plane with a third component 0."""
    values = np.asarray(values)
    if values.ndim == 2 and values.shape[1] == 2:
        return np.column_stack([values, np.zeros(len(values), values.dtype)])
    return values


def split_cell_data(blocks: list[Any], mesh: Mesh, cell_data: Arrays) -> dict[str, Any]:
    """Arrays in the order of `mesh.cells` dealt out to blocks; a block of other cells gets NaN."""
    ends = np.cumsum([len(corners) for corners in mesh.cells.values()])
    first = dict(zip(mesh.cells, ends - [len(corners) for corners in mesh.cells.values()], strict=True))
    dealt: dict[str, list[np.ndarray]] = {name: [] for name in cell_data}
    for block in blocks:
        count, start = len(np.asarray(block.data)), first.get(block.type)
        for name, values in cell_data.items():
            values = in_space(values)
            others = np.full((count, *values.shape[1:]), np.nan)
            dealt[name].append(others if start is None else values[start : start + count])
        if start is not None:
            first[block.type] = start + count
    return dealt
