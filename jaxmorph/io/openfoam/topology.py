"""What OpenFOAM's `faces`, `owner` and `neighbour` say of the cells before the points are known.

The points are read afterwards: the tables of the faces, the largest of a mesh, are gone by then.
"""

import dataclasses
import pathlib

import numpy as np

from jaxmorph._mesh.faces import Faces, standard_cells

from .file import Patch, load


@dataclasses.dataclass(frozen=True, eq=False)
class Topology:
    """Cells and their ids by type as `standard_cells` gives them, and the nodes of each patch.

    `lowest` and `highest` are the ends of the nodes' numbers. `faces` is None where cells and patches say it all: not in the
    plane, and not with polyhedra.
    """

    cells: dict[str, np.ndarray]
    ids: dict[str, np.ndarray]
    nodes: dict[str, np.ndarray]
    lowest: int
    highest: int
    faces: Faces | None

    def check(self, folder: pathlib.Path, n: int) -> None:
        """`ValueError` for nodes that are not among `n` points."""
        if self.lowest < 0 or self.highest >= n:
            bad = self.highest if self.highest >= n else self.lowest
            raise ValueError(f"{folder}: a face names node {bad}, but there are points 0 to {n - 1}.")


def topology_of(folder: pathlib.Path, boundary: list[Patch], is_plane: bool) -> Topology:
    """From the files of a folder; of a case in the plane, faces and patches alone."""
    faces = _faces(folder)
    _check(folder, boundary, faces)
    cells, ids = ({}, {}) if is_plane else standard_cells(faces)
    # copies, for a view would keep the labels of all faces
    nodes = {patch.name: faces.nodes(patch.start, patch.start + patch.count).copy() for patch in boundary}
    lowest, highest = int(faces.labels.min(initial=0)), int(faces.labels.max(initial=0))
    is_needed = is_plane or "polyhedron" in ids
    return Topology(cells, ids, nodes, lowest, highest, faces if is_needed else None)


def _faces(folder: pathlib.Path) -> Faces:
    labels, starts = load(folder, "faces").faces()
    owner, neighbour = (load(folder, name).numbers("label").ravel() for name in ("owner", "neighbour"))
    if len(owner) != len(starts) - 1 or len(neighbour) > len(owner) or not len(owner):
        found = f"{len(starts) - 1} faces, {len(owner)} owners and {len(neighbour)} neighbours"
        raise ValueError(f"{folder}: faces, owner and neighbour do not fit together: {found}.")
    cells = np.zeros(1, np.int64)
    if owner.min() >= 0:
        count = max(int(owner.max()), int(neighbour.max(initial=-1))) + 1
        cells = np.bincount(owner, minlength=count) + np.bincount(neighbour[neighbour >= 0], minlength=count)
    if cells.min() < 4:
        raise ValueError(f"{folder}: cell {int(cells.argmin())} has {int(cells.min())} faces; a cell needs 4 at least.")
    return Faces(labels, starts, owner, neighbour)


def _check(folder: pathlib.Path, boundary: list[Patch], faces: Faces) -> None:
    for patch in boundary:
        if patch.count < 0 or patch.start < 0 or patch.start + patch.count > len(faces.owner):
            ends = f"{patch.start} to {patch.start + patch.count - 1}"
            raise ValueError(f"{folder / 'boundary'}: patch {patch.name!r} is faces {ends} of {len(faces.owner)}.")
