"""Cells that OpenFOAM's `faces`, `owner` and `neighbour` describe, before the points are known.

The points are read afterwards: the tables of the faces, the largest of a mesh, are gone by then.
"""

import dataclasses
import pathlib

import numpy as np

from jaxmorph._mesh.faces import Faces, open_cells, standard_cells

from .file import Patch, load


@dataclasses.dataclass(frozen=True, eq=False)
class Topology:
    """Cells and their ids by type, as `standard_cells` has them, and each patch's nodes.

    Faces of a `processorCyclic` patch belong to the cyclic patch that it refers to. `between` (k,
    corners) are the faces to other parts of a decomposed case, -1 behind the last corner. `lowest`
    and `highest` are the ends of the nodes' numbers. `faces` is None where cells and patches say it
    all: not in 2-D, and not with polyhedra.
    """

    cells: dict[str, np.ndarray]
    ids: dict[str, np.ndarray]
    nodes: dict[str, np.ndarray]
    between: np.ndarray
    lowest: int
    highest: int
    faces: Faces | None

    def check(self, folder: pathlib.Path, n: int) -> None:
        """Raises `ValueError` for nodes that are not among `n` points."""
        if self.lowest < 0 or self.highest >= n:
            bad = self.highest if self.highest >= n else self.lowest
            raise ValueError(f"{folder}: a face names node {bad}, but there are points 0 to {n - 1}.")


def topology_of(folder: pathlib.Path, boundary: list[Patch], is_plane: bool) -> Topology:
    """Reads the topology from the files of a folder; of a 2-D case, faces and patches alone."""
    faces = _faces(folder)
    _check(folder, boundary, faces)
    ajar = open_cells(faces)
    if len(ajar):
        raise ValueError(
            f"{folder}: {len(ajar)} cells do not close, first cell {ajar[0]}: faces, owner or neighbour are damaged."
        )
    cells, ids = ({}, {}) if is_plane else standard_cells(faces)
    parts: dict[str, list[np.ndarray]] = {
        patch.name: [] for patch in boundary if not (patch.is_between or patch.refers)
    }
    for patch in boundary:
        if not patch.is_between:
            of_faces = faces.nodes(patch.start, patch.start + patch.count)
            parts.setdefault(patch.refers or patch.name, []).append(of_faces)
    nodes = {name: np.concatenate(labels) for name, labels in parts.items()}  # copies: a view would keep all labels
    lowest, highest = int(faces.labels.min(initial=0)), int(faces.labels.max(initial=0))
    is_needed = is_plane or "polyhedron" in ids
    between = _between(faces, boundary)
    return Topology(cells, ids, nodes, between, lowest, highest, faces if is_needed else None)


def _between(faces: Faces, boundary: list[Patch]) -> np.ndarray:
    """Lists the corners (k, c) of the faces to other parts, -1 behind the last one."""
    chosen = [np.arange(patch.start, patch.start + patch.count) for patch in boundary if patch.is_between]
    return faces.padded(np.concatenate([np.zeros(0, np.int64), *chosen]))


def _faces(folder: pathlib.Path) -> Faces:
    labels, starts = load(folder, "faces").faces()
    owner, neighbour = (load(folder, name).numbers("label").ravel() for name in ("owner", "neighbour"))
    if len(owner) != len(starts) - 1 or len(neighbour) > len(owner) or not len(owner):
        counts = f"{len(starts) - 1} faces, {len(owner)} owners and {len(neighbour)} neighbours"
        raise ValueError(f"{folder}: faces, owner and neighbour do not fit together: {counts}.")
    _check_labels(folder, labels, owner, neighbour)
    neighbour = neighbour[neighbour >= 0]
    count = max(int(owner.max()), int(neighbour.max(initial=-1))) + 1
    cells = np.bincount(owner, minlength=count) + np.bincount(neighbour, minlength=count)
    if cells.min() < 4:
        raise ValueError(f"{folder}: cell {int(cells.argmin())} has {int(cells.min())} faces; a cell needs 4 at least.")
    return Faces(labels, starts, owner, neighbour)


def _check_labels(folder: pathlib.Path, labels: np.ndarray, owner: np.ndarray, neighbour: np.ndarray) -> None:
    """Raises `ValueError` for labels that cannot be, before one of them sizes an array.

    Each cell has four faces and each face two cells at most; each node is in three corners of faces
    or more. Outer faces have no neighbour: older versions write -1 for them, at the end of the
    list.
    """
    inner = int((neighbour >= 0).sum())
    if (neighbour[:inner] < 0).any() or (neighbour < -1).any() or (inner < len(neighbour) < len(owner)):
        wrong = int(np.argmax(neighbour < 0))
        raise ValueError(
            f"{folder / 'neighbour'}: face {wrong} has the neighbour {neighbour[wrong]}, which is no cell."
        )
    for name, cells in (("owner", owner), ("neighbour", neighbour)):
        wrong = np.flatnonzero((cells < (0 if name == "owner" else -1)) | (cells > len(owner) // 2))
        if wrong.size:
            raise ValueError(
                f"{folder / name}: face {wrong[0]} is of cell {cells[wrong[0]]}, but {len(owner)} faces make "
                f"{len(owner) // 2} cells at most."
            )
    if labels.min() < 0 or labels.max() >= len(labels):
        bad = labels.min() if labels.min() < 0 else labels.max()
        raise ValueError(
            f"{folder / 'faces'}: a face names node {bad}; {len(labels)} corners of faces have fewer nodes."
        )
    same = np.flatnonzero(owner[:inner] == neighbour[:inner])
    if same.size:
        raise ValueError(f"{folder / 'neighbour'}: face {same[0]} has the cell {owner[same[0]]} on both sides.")


def _check(folder: pathlib.Path, boundary: list[Patch], faces: Faces) -> None:
    """Raises `ValueError` where patches are not the faces after inner ones, each in one."""
    for patch in boundary:
        if patch.count < 0 or patch.start < 0 or patch.start + patch.count > len(faces.owner):
            ends = f"{patch.start} to {patch.start + patch.count - 1}"
            raise ValueError(f"{folder / 'boundary'}: patch {patch.name!r} is faces {ends} of {len(faces.owner)}.")
    inner, faces_of_patches = len(faces.neighbour), np.zeros(len(faces.owner), dtype=np.int64)
    for patch in boundary:
        faces_of_patches[patch.start : patch.start + patch.count] += 1
    wrong = np.flatnonzero(faces_of_patches != (np.arange(len(faces.owner)) >= inner))
    if wrong.size:
        face, patches = int(wrong[0]), int(faces_of_patches[wrong[0]])
        where = "an inner face" if face < inner else "an outer face"
        raise ValueError(
            f"{folder / 'boundary'}: {wrong.size} faces are in the wrong number of patches; face {face}, {where}, is in {patches}."
        )
