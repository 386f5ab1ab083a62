"""Cell types: their names, corners, edges and faces, numbered as VTK numbers them."""

from collections.abc import Mapping
from typing import Any

from numpy import ndarray

Pair = tuple[ndarray, ndarray]
ByType = Mapping[str, ndarray]  # cells or faces (k, nodes) by their type


def pairs_of(words: str) -> dict[str, str]:
    """Reads names in turn: "tri triangle tet tetra" is {"tri": "triangle", "tet": "tetra"}."""
    names = words.split()
    return dict(zip(names[::2], names[1::2], strict=True))


def codes(words: str) -> dict[str, int]:
    """Reads names and numbers in turn: "line 3 triangle 5" is {"line": 3, "triangle": 5}."""
    return {name: int(number) for name, number in pairs_of(words).items()}


def invert_table(table: Mapping[Any, Any]) -> dict[Any, Any]:
    return {value: key for key, value in table.items()}


CORNERS = codes("line 2 triangle 3 quad 4 tetra 4 pyramid 5 wedge 6 hexahedron 8")
"""Number of corners by type; names are meshio's."""

_HIGH = codes(
    "line3 3 line4 4 line5 5 triangle6 6 triangle10 10 triangle15 15 "
    "quad8 8 quad9 9 quad16 16 quad25 25 tetra10 10 tetra20 20 tetra35 35 "
    "pyramid13 13 pyramid14 14 pyramid30 30 pyramid55 55 "
    "wedge15 15 wedge18 18 wedge40 40 wedge75 75 "
    "hexahedron20 20 hexahedron27 27 hexahedron64 64 hexahedron125 125"
)
HIGH_ORDER = tuple(_HIGH)
"""Cell types of order 2 to 4, by meshio's names: the linear type, and the number of nodes."""

SHAPES = {kind: kind for kind in CORNERS} | {kind: kind.rstrip("0123456789") for kind in HIGH_ORDER}
"""The type of the linear cell with the corners of each type."""

NODES = CORNERS | _HIGH
"""Number of nodes by type."""

VTK = codes("line 3 triangle 5 quad 9 tetra 10 hexahedron 12 wedge 13 pyramid 14")
"""Numbers of the types in VTK and SU2."""

VTK_QUADRATIC = codes(
    "line3 21 line4 35 triangle6 22 quad8 23 quad9 28 tetra10 24 pyramid13 27 "
    "wedge15 26 wedge18 32 hexahedron20 25 hexahedron27 29"
)
"""VTK's number of each type of order 2, and of lines of order 3. VTK lacks larger pyramids."""

VTK_LAGRANGE = codes("line 68 triangle 69 quad 70 tetra 71 hexahedron 72 wedge 73")
"""VTK's number of cells of any order, which their number of nodes tells."""

DIMENSION = codes("line 1 triangle 2 quad 2 tetra 3 pyramid 3 wedge 3 hexahedron 3")
DIMENSION |= {kind: DIMENSION[SHAPES[kind]] for kind in HIGH_ORDER}

KNOWN = f"known are {', '.join(CORNERS)}, and of order 2 to 4 {', '.join(HIGH_ORDER)}"

_ALIASES = pairs_of("tri triangle tet tetra tetrahedron tetra prism wedge hex hexahedron")


def canonical_type(name: str) -> str:
    name = _ALIASES.get(name, name)
    if name not in NODES:
        raise ValueError(f"unknown cell type {name!r}; {KNOWN}.")
    return name


def digits(words: str) -> Any:
    """Reads rows of digits: "03 1a" is ((0, 3), (1, 10))."""
    return tuple(tuple(int(digit, 36) for digit in word) for word in words.split())


def numbers_by_name(table: Mapping[str, str]) -> dict[str, Any]:
    return {name: digits(words) for name, words in table.items()}


FACES: dict[str, tuple[tuple[int, ...], ...]] = numbers_by_name(
    {
        "line": "",
        "triangle": "01 12 20",
        "quad": "01 12 23 30",
        "tetra": "013 123 203 021",
        "pyramid": "0321 014 124 234 304",
        "wedge": "021 345 0143 1254 2035",
        "hexahedron": "0321 4567 0154 1265 2376 3047",
    }
)
FACES |= {kind: FACES[SHAPES[kind]] for kind in HIGH_ORDER}
"""Corners of the faces by type (edges of a 2-D cell), counterclockwise as seen from outside."""

EDGES: dict[str, tuple[tuple[int, int], ...]] = numbers_by_name(
    {
        "line": "01",
        "triangle": "01 12 20",
        "quad": "01 12 23 30",
        "tetra": "01 12 20 03 13 23",
        "pyramid": "01 12 23 30 04 14 24 34",
        "wedge": "01 12 20 34 45 53 03 14 25",
        "hexahedron": "01 12 23 30 45 56 67 74 04 15 26 37",
    }
)

FRAMES: dict[str, tuple[tuple[int, ...], ...]] = numbers_by_name(
    {
        "line": "01",
        "triangle": "012",
        "quad": "013 120 231 302",
        "tetra": "0123",
        "pyramid": "0134 1204 2314 3024",
        "wedge": "0123 1204 2015 3540 4351 5432",
        "hexahedron": "0134 1205 2316 3027 4750 5461 6572 7643",
    }
)
"""Corners with the ends of their edges, right-handed, for corner Jacobians; a simplex has one."""

SIDE_TYPES = {2: "line", 3: "triangle", 4: "quad"}


def solid(cells: Mapping[str, Any], dimension: int) -> dict[str, Any]:
    """Selects the cells that fill the space, without boundary elements and empty types."""
    return {kind: ids for kind, ids in cells.items() if DIMENSION[kind] == dimension and len(ids)}
