"""MED files of Salome and Code_Aster, in HDF5: copies with other coordinates."""

import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmorph._host.cells.topology import DIMENSION
from jaxmorph._mesh.exchange import Grid, Parts, Patch, regions_note

from ._format import Arrays, MeshLike, Source, StampedPoints, of_grid, stamp_of
from ._text import decoded
from ._tree import opened, write_points

NAME = "MED"
WHAT = "a MED file"
TYPES = {
    "PO1": ("vertex", [0]),
    "SE2": ("line", [0, 1]),
    "TR3": ("triangle", [0, 1, 2]),
    "QU4": ("quad", [0, 1, 2, 3]),
    "TE4": ("tetra", [0, 2, 1, 3]),
    "PY5": ("pyramid", [0, 3, 2, 1, 4]),
    "PE6": ("wedge", [0, 2, 1, 3, 5, 4]),
    "HE8": ("hexahedron", [0, 3, 2, 1, 4, 7, 6, 5]),
}
"""Types of cells by MED's, and the places of MED's corners in VTK's order."""


def read(path: pathlib.Path) -> Parts:
    """Reads points, cells and patches: groups of elements of lower dimension, and of nodes.

    A group of nodes that is called as one of elements, and has other nodes, is `NAME_nodes`.
    """
    path.open("rb").close()
    with opened(path, what=WHAT) as file:
        name, step = _step(file)
        points = _points(step)
        dtype = step["NOE"]["COO"].dtype
        blocks, families = [], []
        for kind, group in step["MAI"].items():
            if kind not in TYPES:
                raise ValueError(f"{path}: elements of type {kind}; linear ones are read ({', '.join(TYPES)}).")
            ours, order = TYPES[kind]
            corners = group["NOD"][()].reshape(len(order), -1).T[:, order].astype(np.int64) - 1
            blocks.append((ours, corners))
            families.append(group["FAM"][()] if "FAM" in group else np.zeros(len(corners), int))
        of_nodes = step["NOE"]["FAM"][()] if "FAM" in step["NOE"] else np.zeros(len(points), int)
        of_elements, groups = dict(_groups(file, name, "ELEME")), dict(_groups(file, name, "NOEUD"))
    if any(len(family) != len(corners) for family, (_, corners) in zip(families, blocks, strict=True)):
        raise ValueError(f"{path}: not {WHAT}, or a damaged one (families of other elements than there are).")
    levels, patches, regions = [DIMENSION.get(kind, 0) for kind, _ in blocks], [], []
    for group, numbers in of_elements.items():
        chosen = [np.isin(family, numbers) for family in families]
        nodes = [
            corners[inside].ravel()
            for (_, corners), level, inside in zip(blocks, levels, chosen, strict=True)
            if level < max(levels) and inside.any()
        ]
        if nodes:
            patches.append(Patch(group, "elements", np.concatenate(nodes)))
        if any(inside.any() for level, inside in zip(levels, chosen, strict=True) if level == max(levels)):
            regions.append(group)
    patches += [Patch(group, "nodes", np.flatnonzero(np.isin(of_nodes, ids))) for group, ids in groups.items()]
    content, notes = StampedPoints(points, stamp_of(path)), tuple(regions_note(regions))
    held = content.held([dtype] * points.shape[1])
    source = Source(path, NAME, content, in_file=content.in_file, held=held, notes=notes)
    return of_grid(path, Grid(points, blocks, {}, {}), source, patches)


def write(path: pathlib.Path, mesh: MeshLike, point_data: Arrays, cell_data: Arrays) -> None:
    """Writes a copy of the file that the mesh was read from."""
    write_points(path, mesh, NAME, _put, WHAT)


def _put(file: Any, points: np.ndarray, _: np.ndarray) -> None:
    coordinates = _step(file)[1]["NOE"]["COO"]
    coordinates[...] = points.T.reshape(coordinates.shape).astype(coordinates.dtype)


def _step(file: Any) -> tuple[str, Any]:
    """Finds the one mesh of a file: its name, and the group of its one step of time."""
    meshes = dict(file["ENS_MAA"].items())
    if len(meshes) != 1:
        raise ValueError(f"{len(meshes)} meshes in the file, one is read")
    ((name, mesh),) = meshes.items()
    steps = [mesh] if "NOE" in mesh else list(mesh.values())
    if len(steps) != 1:
        raise ValueError(f"{len(steps)} steps of time in the file, one is read")
    return name, steps[0]


def _points(step: Any) -> np.ndarray:
    """Reads coordinates (n, d): the file has all x, then all y, then all z."""
    coordinates = step["NOE"]["COO"]
    return coordinates[()].reshape(-1, int(coordinates.attrs["NBR"])).T.astype(float)


def _groups(file: Any, name: str, kind: str) -> Iterator[tuple[str, list[int]]]:
    """Yields the groups of elements or of nodes, and the numbers of their families."""
    families = file["FAS"][name] if "FAS" in file and name in file["FAS"] else {}
    groups: dict[str, list[int]] = {}
    for family in families.get(kind, {}).values():
        for characters in family["GRO"]["NOM"][()] if "GRO" in family else ():
            group = decoded(bytes(np.asarray(characters, np.uint8)).split(b"\0")[0]).strip()
            groups.setdefault(group, []).append(int(family.attrs["NUM"]))
    yield from groups.items()
