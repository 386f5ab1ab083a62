"""Cell types: their names, corners, edges and faces, numbered as VTK numbers them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .pairs import columns_of, is_single, sorted_columns, unpaired

CORNERS = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
"""Number of corners by type; names are meshio's."""

VTK = {"line": 3, "triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "wedge": 13, "pyramid": 14}
"""Numbers of the types in VTK and SU2."""

DIMENSION = {"line": 1, "triangle": 2, "quad": 2, "tetra": 3, "pyramid": 3, "wedge": 3, "hexahedron": 3}

_ALIASES = {"tri": "triangle", "tet": "tetra", "tetrahedron": "tetra", "prism": "wedge", "hex": "hexahedron"}


def canonical_type(name: str) -> str:
    """Returns meshio's name of a cell type. Raises `ValueError` for an unknown type."""
    name = _ALIASES.get(name, name)
    if name not in CORNERS:
        raise ValueError(f"unknown cell type {name!r}; known types are {', '.join(CORNERS)}.")
    return name


def filling(cells: Mapping[str, Any]) -> dict[str, Any]:
    """Selects the cells of the highest dimension; no cells if it is below two."""
    highest = max((DIMENSION[kind] for kind, corners in cells.items() if len(corners)), default=0)
    return {kind: corners for kind, corners in cells.items() if DIMENSION[kind] == highest >= 2}


FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "line": (),
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Faces by type (edges of a 2-D cell), counterclockwise as seen from outside."""

EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "line": ((0, 1),),
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "pyramid": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "hexahedron": (
        *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}

FRAMES: dict[str, tuple[tuple[int, ...], ...]] = {
    "line": ((0, 1),),
    "triangle": ((0, 1, 2),),
    "quad": ((0, 1, 3), (1, 2, 0), (2, 3, 1), (3, 0, 2)),
    "tetra": ((0, 1, 2, 3),),
    "pyramid": ((0, 1, 3, 4), (1, 2, 0, 4), (2, 3, 1, 4), (3, 0, 2, 4)),
    "wedge": ((0, 1, 2, 3), (1, 2, 0, 4), (2, 0, 1, 5), (3, 5, 4, 0), (4, 3, 5, 1), (5, 4, 3, 2)),
    "hexahedron": (
        *((0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7)),
        *((4, 7, 5, 0), (5, 4, 6, 1), (6, 5, 7, 2), (7, 6, 4, 3)),
    ),
}
"""Corners with the ends of their edges, right-handed, by type: there corner Jacobians are taken. A simplex has one."""

SIDE_TYPES = {2: "line", 3: "triangle", 4: "quad"}
"""Types of faces by their number of corners."""


def solid(cells: Mapping[str, Any], dimension: int) -> dict[str, Any]:
    """Selects the cells that fill the space, without boundary elements and empty types."""
    return {kind: ids for kind, ids in cells.items() if DIMENSION[kind] == dimension and len(ids)}


def repeated_cells(corners: np.ndarray) -> np.ndarray:
    """Finds the rows, ascending, of cells (k, corners) with the nodes of another cell in any order."""
    return np.flatnonzero(~is_single(sorted_columns(columns_of(corners), corners.shape[1])))


def boundary_faces(cells: Mapping[str, np.ndarray], n: int, among: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Finds the faces that belong to one cell only (edges of 2-D cells), by type.

    **Arguments:**

    - `cells`: corner ids (k, corners) by type.
    - `n`: number of nodes of the mesh.
    - `among`: node ids. With them, only faces with all nodes among them are returned.

    **Returns:** node ids (f, corners) by type, counterclockwise as seen from outside.
    """
    is_candidate = None
    if among is not None:
        is_candidate = np.zeros(n, bool)
        is_candidate[among] = True
    sides: dict[int, list[list[np.ndarray]]] = {}
    for kind, corners in cells.items():
        nodes = columns_of(corners)
        for side in FACES.get(kind, ()):
            columns = [nodes[corner] for corner in side]
            if is_candidate is not None:
                # The two copies of an inner face pass or fail together: no face becomes single
                # here.
                passes = np.logical_and.reduce([is_candidate[column] for column in columns])
                columns = [column[passes] for column in columns]
            sides.setdefault(len(side), []).append(columns)
    outer = {}
    for size, parts in sorted(sides.items()):
        columns = [np.concatenate(column) for column in zip(*unpaired(parts, n), strict=True)]
        single = is_single(sorted_columns(columns, size))
        outer[SIDE_TYPES[size]] = np.stack([column[single] for column in columns], axis=1).astype(np.int64)
    return outer
