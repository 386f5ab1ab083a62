"""VTK's unstructured grids, XML (.vtu) and legacy (.vtk), through meshio."""

import pathlib
import urllib.parse
from typing import Any

import numpy as np

from jaxmorph import Mesh

from ._format import Arrays, Source, source_of
from ._meshio import PREFIX, MeshioMesh, in_space, load, meshio, set_patches, split_cell_data, to_mesh

NAME = "VTK"
MARKERS = (
    "patch",
    "patch_id",
    "patchid",
    "marker",
    "boundary",
    "boundary_id",
    "cellentityids",
    "gmsh:physical",
    "medit:ref",
)
"""Arrays, by their names in lower case, whose numbers tell the patches apart."""


def read(path: pathlib.Path) -> Mesh:
    """`patches` from point arrays `patch:NAME` that are not zero at the nodes of the patch, as `write` leaves them.

    Else from whole numbers in an array with one of the names `MARKERS`: of the boundary's cells (`marker_3` has their nodes),
    or of points, where 0 is inside.
    """
    reader = meshio.vtu.read if path.suffix.lower() == ".vtu" else meshio.vtk.read
    found = load(path, path.suffix.lower(), reader)
    patches = set_patches(found)
    for name, values in found.point_data.items():
        if name.startswith(PREFIX) and np.ndim(values) == 1:
            patches[urllib.parse.unquote(name.removeprefix(PREFIX))] = np.flatnonzero(values)
    return to_mesh(path, found, patches or _marked(found), Source(path, NAME, found))


def _marked(found: MeshioMesh) -> dict[str, np.ndarray]:
    """Patches by the numbers of the first array of `MARKERS`, on the cells of lower dimension or on the points."""
    highest = max(block.dim for block in found.cells)
    for name in sorted(found.cell_data, key=_rank):
        patches: dict[str, list[np.ndarray]] = {}
        for block, values in zip(found.cells, found.cell_data[name], strict=True):
            if _rank(name) < len(MARKERS) and 0 < block.dim < highest and _are_whole(values):
                for number in np.unique(values).tolist():
                    nodes = np.asarray(block.data)[values == number].ravel()
                    patches.setdefault(f"{name}_{int(number)}", []).append(nodes)
        if patches:
            return {name: np.concatenate(nodes) for name, nodes in patches.items()}
    for name in sorted(found.point_data, key=_rank):
        values = np.asarray(found.point_data[name])
        if _rank(name) < len(MARKERS) and _are_whole(values) and values.any():
            return {f"{name}_{int(v)}": np.flatnonzero(values == v) for v in np.unique(values[values != 0]).tolist()}
    return {}


def _rank(name: str) -> int:
    return MARKERS.index(name.lower()) if name.lower() in MARKERS else len(MARKERS)


def _are_whole(values: Any) -> bool:
    """Whole numbers, one each; as floats too, with NaN nowhere."""
    return np.ndim(values) == 1 and bool((values == np.floor(values)).all())


def write(path: pathlib.Path, mesh: Mesh, point_data: Arrays, cell_data: Arrays) -> None:
    """Double precision, compressed. A mesh that came from such a file keeps its other cells and arrays."""
    source = source_of(mesh, NAME)
    points = in_space(np.asarray(mesh.points)).astype(float)
    arrays = {name: in_space(values) for name, values in point_data.items()}
    for name, nodes in mesh.patches.items():
        inside = np.zeros(len(points), np.uint8)
        inside[nodes] = 1
        arrays[f"{PREFIX}{urllib.parse.quote(name)}"] = inside
    if source is None:
        out = MeshioMesh(points, [(kind, np.asarray(corners)) for kind, corners in mesh.cells.items()])
    else:
        old: MeshioMesh = source.content
        if mesh.points.shape[1] == 2:
            points[:, 2] = old.points[0, 2] if old.points.shape[1] == 3 else 0
        out = MeshioMesh(points, old.cells, dict(old.point_data), dict(old.cell_data), field_data=old.field_data)
    out.point_data.update(arrays)
    out.cell_data.update(split_cell_data(out.cells, mesh, cell_data))
    (meshio.vtu.write if path.suffix.lower() == ".vtu" else meshio.vtk.write)(str(path), out)
