"""Cell types: their names, corners, edges and faces, numbered as VTK numbers them."""

CORNERS = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
"""Corners of each type; names are meshio's."""

DIMENSION = {"line": 1, "triangle": 2, "quad": 2, "tetra": 3, "pyramid": 3, "wedge": 3, "hexahedron": 3}

_ALIASES = {"tri": "triangle", "tet": "tetra", "tetrahedron": "tetra", "prism": "wedge", "hex": "hexahedron"}


def canonical_type(name: str) -> str:
    """The name used here for a cell type; raises `ValueError` for one that is not known."""
    name = _ALIASES.get(name, name)
    if name not in CORNERS:
        raise ValueError(f"unknown cell type {name!r}; known are {', '.join(CORNERS)}.")
    return name
