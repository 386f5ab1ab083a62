"""Polyhedra of a CGNS file: sections NGON_n (faces by their vertices) and NFACE_n (cells by their faces)."""

import dataclasses

import numpy as np

from jaxmorph._mesh.faces import Faces, standard_cells
from jaxmorph._mesh.polyhedra import spread, tetrahedra


@dataclasses.dataclass(frozen=True, eq=False)
class Ragged:
    """Holds rows of different lengths: `values` of all in a row, and where each begins (one more `start` at the end)."""

    values: np.ndarray
    starts: np.ndarray

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, rows: np.ndarray) -> np.ndarray:
        """Returns the values of some rows, one after the other."""
        return self.values[spread(self.starts[rows], self.starts[rows + 1])[0]]


def polyhedra(
    polygons: dict[int, Ragged], cells: list[Ragged], points: np.ndarray, first: int
) -> tuple[list[tuple[str, np.ndarray]], list[np.ndarray]]:
    """Makes cells by type, those of no type as tetrahedra between their own nodes, and outer faces by their number of corners.

    `polygons` are faces by the number of the first, vertices from 0. `first` is the id of vertex 0, `points` those of
    the zone. It raises `ValueError` for cells with faces that are not there, or that more than two cells have.
    """
    begins = np.concatenate([begin + np.arange(len(rows)) for begin, rows in sorted(polygons.items())])
    each = [rows for _, rows in sorted(polygons.items())]
    labels = np.concatenate([rows.values for rows in each])
    starts = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(rows.starts) for rows in each]))])
    used = np.concatenate([rows.values for rows in cells])
    cell = np.repeat(np.arange(sum(map(len, cells))), np.concatenate([np.diff(rows.starts) for rows in cells]))
    face = np.searchsorted(begins, np.abs(used))
    if (face >= len(begins)).any() or (begins[np.minimum(face, len(begins) - 1)] != np.abs(used)).any():
        raise ValueError("NFACE_n names faces that are in no section NGON_n")
    sides = np.full((2, len(begins)), -1)
    sides[(used < 0).astype(int), face] = cell
    if (sides >= 0).sum() != len(used):
        raise ValueError("NFACE_n has faces on the same side of two cells")
    # a face that only a cell behind it has is turned round
    turned = (sides[0] < 0) & (sides[1] >= 0)
    kept = np.flatnonzero((sides >= 0).any(axis=0))
    rows, which = spread(starts[kept], starts[kept + 1])
    back = (starts[kept] + starts[kept + 1] - 1)[which] - rows
    rows = np.where(turned[kept][which], back, rows)
    sizes = np.diff(starts)[kept]
    faces = Faces(
        labels[rows],
        np.concatenate([[0], np.cumsum(sizes)]),
        np.where(turned, sides[1], sides[0])[kept],
        np.where(turned, -1, sides[1])[kept],
    )
    typed, ids = standard_cells(faces)
    blocks = [(kind, corners + first) for kind, corners in typed.items()]
    if "polyhedron" in ids:
        blocks.append(("tetra", tetrahedra(faces, ids["polyhedron"], points)[0] + first))
    outer = [np.flatnonzero((faces.neighbour < 0) & (sizes == size)) for size in np.unique(sizes).tolist()]
    return blocks, [faces.corners(chosen, int(sizes[chosen[0]])) + first for chosen in outer if len(chosen)]
