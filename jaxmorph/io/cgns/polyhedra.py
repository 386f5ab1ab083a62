"""Polyhedra of a CGNS file: sections NGON_n (faces by vertices) and NFACE_n (cells by faces)."""

import dataclasses

import numpy as np

from jaxmorph._mesh.faces import Faces, open_cells, standard_cells
from jaxmorph._mesh.polyhedra import Polyhedra, spread, tetrahedra


@dataclasses.dataclass(frozen=True, eq=False)
class Ragged:
    """Rows of different lengths: all `values`, and where each row begins (one more `start`)."""

    values: np.ndarray
    starts: np.ndarray

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, rows: np.ndarray) -> np.ndarray:
        """Returns the values of some rows, one after the other."""
        return self.values[spread(self.starts[rows], self.starts[rows + 1])[0]]


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Holds cells of one type by their corner ids (k, corners).

    `cell` (k,) is the number of the polyhedral cell that each is, or is a piece of; None for cells
    of other sections.
    """

    kind: str
    corners: np.ndarray
    cell: np.ndarray | None = None


def polyhedra(
    polygons: dict[int, Ragged], cells: list[Ragged], points: np.ndarray, first: int
) -> tuple[list[Block], list[np.ndarray], Polyhedra]:
    """Makes cells by type, others as tetrahedra between own nodes, and outer faces by corners.

    The whole cells come last.

    `polygons` are faces by the number of the first, vertices from 0. `first` is the id of vertex 0,
    `points` are the zone's points. It raises `ValueError` for cells with faces that are not there,
    or that more than two cells have.
    """
    faces = _faces(polygons, cells)
    ajar = open_cells(faces)
    if len(ajar):
        raise ValueError(f"{len(ajar)} cells do not close, first cell {ajar[0]}: NGON_n or NFACE_n are damaged")
    typed, ids = standard_cells(faces)
    cut = ids.pop("polyhedron", np.zeros(0, np.int64))
    blocks = [Block(kind, corners + first, ids[kind]) for kind, corners in typed.items()]
    if len(cut):
        pieces, owner = tetrahedra(faces, cut, points)
        blocks.append(Block("tetra", pieces + first, owner))
    faces, sizes = dataclasses.replace(faces, labels=faces.labels + first), np.diff(faces.starts)
    outer = [np.flatnonzero((faces.neighbour < 0) & (sizes == size)) for size in np.unique(sizes).tolist()]
    outer = [faces.corners(chosen, int(sizes[chosen[0]])) for chosen in outer if len(chosen)]
    return blocks, outer, Polyhedra(faces, cut)


def _faces(polygons: dict[int, Ragged], cells: list[Ragged]) -> Faces:
    """Joins all sections: the faces that cells have, with the cells on both sides.

    It raises `ValueError` for cells with faces that are not there, or that more than two cells
    have.
    """
    begins = np.concatenate([begin + np.arange(len(rows)) for begin, rows in sorted(polygons.items())])
    parts = [rows for _, rows in sorted(polygons.items())]
    labels = np.concatenate([rows.values for rows in parts])
    starts = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(rows.starts) for rows in parts]))])
    used = np.concatenate([rows.values for rows in cells])
    cell = np.repeat(np.arange(sum(map(len, cells))), np.concatenate([np.diff(rows.starts) for rows in cells]))
    face = np.searchsorted(begins, np.abs(used))
    if (face >= len(begins)).any() or (begins[np.minimum(face, len(begins) - 1)] != np.abs(used)).any():
        raise ValueError("NFACE_n names faces that are in no section NGON_n")
    sides = np.full((2, len(begins)), -1)
    sides[(used < 0).astype(int), face] = cell
    if (sides >= 0).sum() != len(used):
        raise ValueError("NFACE_n has faces on the same side of two cells")
    # a face that only a cell behind it has is turned round: its labels are gathered backwards
    turned = (sides[0] < 0) & (sides[1] >= 0)
    rows_of_cells = np.flatnonzero((sides >= 0).any(axis=0))
    rows, which = spread(starts[rows_of_cells], starts[rows_of_cells + 1])
    back = (starts[rows_of_cells] + starts[rows_of_cells + 1] - 1)[which] - rows
    rows = np.where(turned[rows_of_cells][which], back, rows)
    return Faces(
        labels[rows],
        np.concatenate([[0], np.cumsum(np.diff(starts)[rows_of_cells])]),
        np.where(turned, sides[1], sides[0])[rows_of_cells],
        np.where(turned, -1, sides[1])[rows_of_cells],
    )
