"""OpenFOAM's `faces`, `owner` and `neighbour`, checked, and the nodes of patches."""

import pathlib
from collections.abc import Callable

import numpy as np

from jaxmorph._mesh.exchange import gathered
from jaxmorph._mesh.faces import Faces, open_cells

from .file import Patch, load


def faces_of(folder: pathlib.Path, boundary: list[Patch], n: int) -> Faces:
    labels, starts = load(folder, "faces").faces()
    owner, neighbour = (load(folder, name).numbers("label").ravel() for name in ("owner", "neighbour"))
    if len(owner) != len(starts) - 1 or len(neighbour) > len(owner) or not len(owner):
        counts = f"{len(starts) - 1} faces, {len(owner)} owners and {len(neighbour)} neighbours"
        raise ValueError(f"{folder}: faces, owner and neighbour do not fit together: {counts}.")
    _check_labels(folder, labels, n, owner, neighbour)
    faces = Faces(labels, starts, owner, neighbour[neighbour >= 0])
    counts = np.bincount(np.concatenate([owner, faces.neighbour]))
    if counts.min() < 4:
        raise ValueError(f"{folder}: cell {counts.argmin()} has {counts.min()} faces; a cell needs 4 at least.")
    _check_patches(folder / "boundary", boundary, faces)
    ajar = open_cells(faces)
    if len(ajar):
        raise ValueError(f"{folder}: {len(ajar)} cells do not close, first cell {ajar[0]}: a damaged file.")
    return faces


def patch_nodes(faces: Faces, boundary: list[Patch]) -> dict[str, np.ndarray]:
    """Lists the nodes of patches that are no sides of parts, copied: views would keep all labels.

    Faces of a `processorCyclic` patch belong to the cyclic patch that it refers to.
    """
    own = [patch for patch in boundary if not patch.is_between]
    empty = [(patch.name, faces.labels[:0]) for patch in own if not patch.refers]
    return gathered([*empty, *((patch.refers or patch.name, faces.nodes(patch.start, patch.end)) for patch in own)])


def sides_of_parts(faces: Faces, boundary: list[Patch]) -> np.ndarray:
    """Lists the corners (k, c) of faces to other parts of a case, -1 behind the last one."""
    chosen = [patch.faces for patch in boundary if patch.is_between]
    return faces.padded(np.concatenate([np.zeros(0, np.int64), *chosen]))


def _check_labels(folder: pathlib.Path, labels: np.ndarray, n: int, owner: np.ndarray, neighbour: np.ndarray) -> None:
    """Raises `ValueError` for labels that cannot be, before one of them sizes an array.

    Each cell has four faces and each face two cells at most. Outer faces have no neighbour: older
    versions write -1 for them, at the end of the list.
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
    if labels.min() < 0 or labels.max() >= n:
        bad = labels.min() if labels.min() < 0 else labels.max()
        raise ValueError(f"{folder / 'faces'}: a face names node {bad}, but there are points 0 to {n - 1}.")
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
