"""Cell types: their names, corners, edges and faces, numbered as VTK numbers them."""

from collections.abc import Mapping
from typing import Any

CORNERS = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
"""Number of corners by type; names are meshio's."""

HIGH_ORDER = (
    *("line3", "line4", "line5", "triangle6", "triangle10", "triangle15", "quad8", "quad9", "quad16", "quad25"),
    *("tetra10", "tetra20", "tetra35", "pyramid13", "pyramid14", "pyramid30", "pyramid55"),
    *("wedge15", "wedge18", "wedge40", "wedge75", "hexahedron20", "hexahedron27", "hexahedron64", "hexahedron125"),
)
"""Cell types of order 2 to 4, by meshio's names: the linear type, and the number of nodes."""

SHAPES = {kind: kind for kind in CORNERS} | {kind: kind.rstrip("0123456789") for kind in HIGH_ORDER}
"""The type of the linear cell with the corners of each type."""

NODES = CORNERS | {kind: int(kind.removeprefix(SHAPES[kind])) for kind in HIGH_ORDER}
"""The number of nodes of each type."""

VTK = {"line": 3, "triangle": 5, "quad": 9, "tetra": 10, "hexahedron": 12, "wedge": 13, "pyramid": 14}
"""Numbers of the types in VTK and SU2."""

VTK_QUADRATIC = {
    **{"line3": 21, "line4": 35, "triangle6": 22, "quad8": 23, "quad9": 28, "tetra10": 24, "pyramid13": 27},
    **{"wedge15": 26, "wedge18": 32, "hexahedron20": 25, "hexahedron27": 29},
}
"""VTK's number of each type of order 2, and of lines of order 3. VTK lacks larger pyramids."""

VTK_LAGRANGE = {"line": 68, "triangle": 69, "quad": 70, "tetra": 71, "hexahedron": 72, "wedge": 73}
"""VTK's number of cells of any order, which their number of nodes tells."""

DIMENSION = {"line": 1, "triangle": 2, "quad": 2, "tetra": 3, "pyramid": 3, "wedge": 3, "hexahedron": 3}
DIMENSION |= {kind: DIMENSION[SHAPES[kind]] for kind in HIGH_ORDER}

KNOWN = f"known are {', '.join(CORNERS)}, and of order 2 to 4 {', '.join(HIGH_ORDER)}"
"""The known types, for the end of a message."""

_ALIASES = {"tri": "triangle", "tet": "tetra", "tetrahedron": "tetra", "prism": "wedge", "hex": "hexahedron"}


def canonical_type(name: str) -> str:
    """Returns meshio's name of a cell type. Raises `ValueError` for an unknown type."""
    name = _ALIASES.get(name, name)
    if name not in NODES:
        raise ValueError(f"unknown cell type {name!r}; {KNOWN}.")
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
FACES |= {kind: FACES[SHAPES[kind]] for kind in HIGH_ORDER}
"""Corners of the faces by type (edges of a 2-D cell), counterclockwise as seen from outside."""

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
"""Corners with the ends of their edges, right-handed, for corner Jacobians; a simplex has one."""

SIDE_TYPES = {2: "line", 3: "triangle", 4: "quad"}
"""Types of faces by their number of corners."""


def solid(cells: Mapping[str, Any], dimension: int) -> dict[str, Any]:
    """Selects the cells that fill the space, without boundary elements and empty types."""
    return {kind: ids for kind, ids in cells.items() if DIMENSION[kind] == dimension and len(ids)}
