"""Meshes as MFEM 4.10 wrote them, of every type of cells at once, and a writer of straight ones.

MFEM gave the straight cells below nodes of order 2, and a polynomial of degree 3 moved them: `moved`.
"""

import numpy as np

import jaxmorph as jm

CORNER_PLACES = {
    2: [(0, 0), (1, 0), (1, 1), (0, 1), (2, 0.5), (2, 2)],
    3: [
        *((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
        *((2, 0.5, 0), (2, 0.5, 1), (1.2, 0.5, 2)),
    ],
}
"""Vertices of the straight cells, by dimension."""


def moved(x: np.ndarray) -> np.ndarray:
    """The polynomial that moved the nodes."""
    x, y, *rest = x.T
    if not rest:
        return np.stack([x + 0.1 * y**2 - 0.02 * x * y**2, y + 0.05 * x**3 - 0.1 * x * y], axis=1)
    (z,) = rest
    columns = [
        x + 0.1 * y**2 - 0.02 * x * y * z,
        y + 0.05 * x**3 - 0.1 * x * z,
        z + 0.04 * x * y**2,
    ]
    return np.stack(columns, axis=1)


def straight(mesh: jm.Mesh, name: str) -> str:
    """Text of a straight mesh, version 1.3; its patch of that name becomes a named set of attribute 4."""
    numbers = {
        "line": 1,
        "triangle": 2,
        "quad": 3,
        "tetra": 4,
        "hexahedron": 5,
        "wedge": 6,
        "pyramid": 7,
    }
    faces = [(kind, row) for kind, rows in jm.boundary_faces(mesh).items() for row in rows.tolist()]
    inside = set(np.asarray(mesh.patch(name)).tolist())
    cells = [
        f"1 {numbers[kind]} {' '.join(map(str, row))}"
        for kind, ids in mesh.cells.items()
        for row in ids.tolist()
    ]
    sides = [
        f"{4 if set(row) <= inside else 2} {numbers[kind]} {' '.join(map(str, row))}"
        for kind, row in faces
    ]
    points = np.asarray(mesh.points)
    rows = [" ".join(map(repr, row)) for row in points.tolist()]
    parts = [
        f"MFEM mesh v1.3\n\n# a comment\n\ndimension\n{points.shape[1]}\n\nelements\n{len(cells)}",
        *cells,
        f'\nattribute_sets\n1\n"fluid" 1 1\n\nboundary\n{len(sides)}',
        *sides,
        f'\nboundary_attribute_sets\n1\n"{name}" 1 4\n\nvertices\n{len(points)}\n{points.shape[1]}',
        *rows,
        "\nmfem_mesh_end\n",
    ]
    return "\n".join(parts)


def cells_of(dimension: int, elements: list[str], boundary: list[str], count: int) -> str:
    """Text of cells, of the boundary and of so many vertices, whose places are those of nodes."""
    parts = [f"MFEM mesh v1.0\n\ndimension\n{dimension}\n\nelements\n{len(elements)}", *elements]
    parts += [f"\nboundary\n{len(boundary)}", *boundary, f"\nvertices\n{count}\n\n"]
    return "\n".join(parts)


CELLS = cells_of(
    3,
    ["1 6 1 8 2 5 9 6", "7 5 0 1 2 3 4 5 6 7", "1 4 5 9 6 10"],
    ["3 3 0 3 2 1", "3 2 1 2 8", "5 3 0 1 5 4", "9 2 9 6 10"],
    11,
)
"""Of `SOLID`."""
IN_PLANE = cells_of(
    2,
    ["1 2 1 4 2", "1 3 3 0 1 2", "2 2 4 5 2"],
    ["1 1 0 1", "1 1 1 4", "2 1 4 5", "2 1 5 2", "4 1 3 0"],
    6,
)
"""Of `FLAT` and `TORN`."""
NODES = "nodes\nFiniteElementSpace\nFiniteElementCollection: {}\nVDim: {}\nOrdering: {}\n\n"

FLAT = f"""{IN_PLANE}{NODES.format("H1_2D_P2", 2, 1)}\
0 0 1 0.05 1.08 0.95 0.1 1 2.015 0.8 2.24 2 1.504375 0.38125 1.539375 0.80625 1.02 0.5 0.025 0.5 0.5 0.00625 0.59
0.95625 2.09375 1.4 1.6575 1.44375 0.5225 0.48125
"""
"""Of the numbers of order 4 that MFEM wrote, those at the places of order 2."""
TORN = f"""{IN_PLANE}{NODES.format("L2_T1_2D_P2", 2, 0)}\
1 1.504375 2.015 1.02 1.539375 1.08 0.1 0.025 0 0.59 0.5225 0.5 1.08 1.02 1 2.015 2.09375 2.24 1.539375 1.6575 1.08
0.05 0.38125 0.8 0.5 0.80625 0.95 1 0.5 0 0.95625 0.48125 0.00625 0.95 0.5 0.05 0.8 1.4 2 0.80625 1.44375 0.95
"""
"""The same nodes cell by cell, all x first: the order in which MFEM wrote order 3."""
SOLID = f"""{CELLS}{NODES.format("H1_3D_P2", 3, 1)}\
0 0 0 1 0.05 0 1.1 1.05 0.04 0.1 1 0 0 0 1 1 -0.05 1 1.08 0.95 1.04 0.1 1 1 2.025 0.9 0.02 2.005 0.7 1.02 1.201 0.3464
2.012 1.50625 0.41875 0.00375 1.55625 0.91875 0.03375 1.025 0.55 0.01 1.49875 0.26875 1.00375 1.53375 0.76875 1.03375
1.015 0.45 1.01 1 0 0.5 2.015 0.8 0.52 1.09 1 0.54 0.5 0.00625 0 0.6 1.00625 0.02 0.025 0.5 0 0.5 -0.04375 1 0.59
0.95625 1.02 0.025 0.5 1 0 0 0.5 0.1 1 0.5 1.098 0.15155 1.50275 1.601 0.4648 1.516 1.1315 0.65155 1.52475 1.5025
0.34375 0.50375 1.545 0.84375 0.53375 1.02 0.5 0.51 0.525 0.50625 0.005 0.5 -0.01875 0.5 0.595 0.98125 0.52 0.025 0.5
0.5 0.52 0.45625 1.005 0.5225 0.48125 0.505
"""
