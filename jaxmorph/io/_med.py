"""MED files of Salome and Code_Aster, in HDF5: copies with other coordinates."""

import pathlib
import urllib.parse
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmorph._mesh.exchange import PREFIX, Parts

from ._format import Arrays, MeshLike, Source, StampedPoints, stamp_of
from ._meshio import meshio, to_mesh
from .cgns.tree import opened, write_points
from .text.digits import decoded

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
    """Reads points, cells and patches: groups of nodes, and of elements of lower dimension."""
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
        sets: dict[str, Any] = {}
        for group, numbers in _groups(file, name, "ELEME"):
            sets[group] = [np.flatnonzero(np.isin(family, numbers)) for family in families]
        flags = {}
        for group, numbers in _groups(file, name, "NOEUD"):
            flags[PREFIX + urllib.parse.quote(group)] = np.isin(of_nodes, numbers).astype(int)
    if any(len(family) != len(corners) for family, (_, corners) in zip(families, blocks, strict=True)):
        raise ValueError(f"{path}: not {WHAT}, or a damaged one (families of other elements than there are).")
    content = StampedPoints(points, stamp_of(path))
    mesh = meshio.Mesh(points, blocks, point_data=flags, cell_sets=sets)
    held = content.held([dtype] * points.shape[1])
    return to_mesh(path, mesh, Source(path, NAME, content, in_file=content.in_file, held=held))


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
