"""Cells that OpenFOAM's `faces`, `owner` and `neighbour` describe, before the points are known.

The points are read afterwards: the tables of the faces, the largest of a mesh, are gone by then.
"""

import dataclasses
import pathlib
from collections.abc import Callable

import numpy as np

from jaxmorph._mesh.exchange import gathered
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
        if self.lowest < 0 or self.highest >= n:
            bad = self.highest if self.highest >= n else self.lowest
            raise ValueError(f"{folder}: a face names node {bad}, but there are points 0 to {n - 1}.")


def topology_of(folder: pathlib.Path, boundary: list[Patch], is_plane: bool) -> Topology:
    """Reads the topology from the files of a folder; of a 2-D case, faces and patches alone."""
    faces = _faces(folder)
    _check_patches(folder / "boundary", boundary, faces)
    ajar = open_cells(faces)
    if len(ajar):
        raise ValueError(f"{folder}: {len(ajar)} cells do not close, first cell {ajar[0]}: a damaged file.")
    cells, ids = ({}, {}) if is_plane else standard_cells(faces)
    own = [patch for patch in boundary if not patch.is_between]
    # patches come before those that refer to them; a view would keep all labels
    empty = [(patch.name, np.zeros(0, faces.labels.dtype)) for patch in own if not patch.refers]
    nodes = gathered([*empty, *((patch.refers or patch.name, faces.nodes(patch.start, patch.end)) for patch in own)])
    between = np.concatenate([np.zeros(0, np.int64), *(patch.faces for patch in boundary if patch.is_between)])
    lowest, highest = int(faces.labels.min(initial=0)), int(faces.labels.max(initial=0))
    is_needed = is_plane or "polyhedron" in ids
    return Topology(cells, ids, nodes, faces.padded(between), lowest, highest, faces if is_needed else None)


def _faces(folder: pathlib.Path) -> Faces:
    labels, starts = load(folder, "faces").faces()
    owner, neighbour = (load(folder, name).numbers("label").ravel() for name in ("owner", "neighbour"))
    if len(owner) != len(starts) - 1 or len(neighbour) > len(owner) or not len(owner):
        counts = f"{len(starts) - 1} faces, {len(owner)} owners and {len(neighbour)} neighbours"
        raise ValueError(f"{folder}: faces, owner and neighbour do not fit together: {counts}.")
    _check_labels(folder, labels, owner, neighbour)
    neighbour = neighbour[neighbour >= 0]
    counts = np.bincount(np.concatenate([owner, neighbour]))
    if counts.min() < 4:
        raise ValueError(f"{folder}: cell {counts.argmin()} has {counts.min()} faces; a cell needs 4 at least.")
    return Faces(labels, starts, owner, neighbour)


def _check_labels(folder: pathlib.Path, labels: np.ndarray, owner: np.ndarray, neighbour: np.ndarray) -> None:
    """Raises `ValueError` for labels that cannot be, before one of them sizes an array.

    Each cell has four faces and each face two cells at most; each node is in three corners of faces
    or more. Outer faces have no neighbour: older versions write -1 for them, at the end of the
    list.
    """
    inner, count = int((neighbour >= 0).sum()), len(owner)

    def refuse(name: str, wrong: np.ndarray, message: Callable[[int], str]) -> None:
        rows = np.flatnonzero(wrong)
        if len(rows):
            raise ValueError(f"{folder / name}: face {rows[0]} {message(rows[0])}.")

    has_no_cell = neighbour < (-1 if len(neighbour) == count else 0)
    has_no_cell[:inner] |= neighbour[:inner] < 0
    refuse("neighbour", has_no_cell, lambda k: f"has the neighbour {neighbour[k]}, which is no cell")
    for name, cells, least in (("owner", owner, 0), ("neighbour", neighbour, -1)):
        refuse(
            name,
            (cells < least) | (cells > count // 2),
            lambda k, cells=cells: f"is of cell {cells[k]}, but {count} faces make {count // 2} cells at most",
        )
    outside = labels[(labels < 0) | (labels >= len(labels))]
    if len(outside):
        raise ValueError(f"{folder / 'faces'}: a face names node {outside[0]}; {len(labels)} corners have fewer nodes.")
    refuse("neighbour", owner[:inner] == neighbour[:inner], lambda k: f"has the cell {owner[k]} on both sides")


def _check_patches(file: pathlib.Path, boundary: list[Patch], faces: Faces) -> None:
    count, inner = len(faces.owner), len(faces.neighbour)
    times = np.zeros(count, dtype=np.int64)
    for patch in boundary:
        if patch.count < 0 or patch.start < 0 or patch.end > count:
            raise ValueError(f"{file}: patch {patch.name!r} is faces {patch.start} to {patch.end - 1} of {count}.")
        times[patch.start : patch.end] += 1
    wrong = np.flatnonzero(times != (np.arange(count) >= inner))
    if wrong.size:
        face, where = int(wrong[0]), "an inner face" if wrong[0] < inner else "an outer face"
        raise ValueError(
            f"{file}: {wrong.size} faces are in the wrong number of patches; face {face}, {where}, is in {times[face]}."
        )
