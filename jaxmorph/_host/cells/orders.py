"""The order of nodes in each format: corners, then inner nodes of edges, of faces, of the cell."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy import ndarray

from .lagrange import PLACES, inner_places, lagrange_types, lattice
from .topology import SHAPES, numbers_by_name

Sides = Mapping[str, tuple[tuple[int, ...], ...]]  # corners of the edges, or of the faces, by shape


@dataclasses.dataclass(frozen=True, eq=False)
class NodeOrder:
    """Edges and faces in a format's order, if not `EDGES`, `FACES`, and its inner lattice."""

    edges: Sides
    faces: Sides
    inner: Callable[[str, int], ndarray]

    def lattice(self, shape: str, order: int, *, is_complete: bool = True) -> ndarray:
        return lattice(shape, order, is_complete, self.edges, self.faces, self.inner)

    @functools.cache  # noqa: B019
    def places(self, kind: str) -> ndarray:
        """The place (k,) in the format's list of each node of the canonical order."""
        cell = lagrange_types()[kind]
        listed = self.lattice(cell.shape, cell.order, is_complete=cell.is_complete)
        return np.argsort(cell.nodes_at(listed))


def reordered(kind: str, ids: Any, origin: NodeOrder | None, target: NodeOrder | None) -> Any:
    """Brings cell nodes (k, nodes) from one order to another; None is the canonical order."""
    if SHAPES.get(kind, kind) == kind or origin is target:
        return ids
    ids = ids if origin is None else ids[:, origin.places(kind)]
    return ids if target is None else ids[:, np.argsort(target.places(kind))]


def _as_gmsh(shape: str, order: int) -> ndarray:
    """gmsh's inner lattice: the nodes of a cell of the order that is left."""
    if shape == "line":
        return inner_places(shape, order)
    if shape == "wedge":  # at each place in the triangle the ends of the line first
        triangle = _as_gmsh("triangle", order)
        line = inner_places("line", order)
        line = np.concatenate([line[:1], line[1:][::-1]])
        return np.column_stack(
            [np.repeat(triangle, len(line), axis=0), np.tile(line, (len(triangle), 1))]
        )
    left = order - {"triangle": 3, "quad": 2, "tetra": 4, "hexahedron": 2, "pyramid": 3}[shape]
    if left < 0:
        return np.zeros((0, len(PLACES[shape][0])), np.int64)
    return 1 + (
        GMSH.lattice(shape, left) if left else np.zeros((1, len(PLACES[shape][0])), np.int64)
    )


GMSH = NodeOrder(
    numbers_by_name(
        {
            "tetra": "01 12 20 30 32 31",
            "pyramid": "01 03 04 12 14 23 24 34",
            "wedge": "01 02 03 12 14 25 34 35 45",
            "hexahedron": "01 03 04 12 15 23 26 37 45 47 56 67",
        }
    ),
    numbers_by_name(
        {
            "tetra": "021 013 032 312",
            "pyramid": "014 304 124 234 0321",
            "wedge": "021 345 0143 0352 1254",
            "hexahedron": "0321 0154 0473 1265 2376 4567",
        }
    ),
    _as_gmsh,
)
"""gmsh's order: its manual, section "Node ordering"."""

VTK_ORDER = NodeOrder(
    numbers_by_name({"quad": "01 12 32 03", "hexahedron": "01 12 32 03 45 56 76 47 04 15 26 37"}),
    numbers_by_name(
        {
            "tetra": "013 231 032 021",
            "wedge": "012 345 0143 1254 2035",
            "hexahedron": "0374 1265 0154 3267 0123 4567",
        }
    ),
    inner_places,
)
"""The order of VTK's quadratic and Lagrange cells, from VTK 9 on: parametric coordinates."""


def _spirals(shape: str, order: int) -> ndarray:
    """CGNS's inner lattice: layer by layer, each layer of a square in rings."""
    rows = inner_places(shape, order)
    if shape == "quad":
        return _spiral(rows)
    if shape in ("pyramid", "hexahedron"):
        layers = [rows[rows[:, 2] == z] for z in range(1, order)]
        return np.concatenate([rows[:0], *(_spiral(layer) for layer in layers)])
    return rows


def _spiral(square: ndarray) -> ndarray:
    """Orders a square's places in rings inwards, each from its least corner along axis 0."""
    low = 1
    high = square[:, :2].max(initial=0)
    x = square[:, 0]
    y = square[:, 1]
    ring = np.minimum.reduce([x - low, high - x, y - low, high - y])
    size = high - low - 2 * ring
    x = x - low - ring
    y = y - low - ring
    along = np.select([y == 0, x == size, y == size], [x, size + y, 3 * size - x], 4 * size - y)
    return square[np.lexsort((along, ring))]


CGNS_ORDER = NodeOrder(
    numbers_by_name(
        {
            "wedge": "01 12 20 03 14 25 34 45 53",
            "hexahedron": "01 12 23 30 04 15 26 37 45 56 67 74",
        }
    ),
    numbers_by_name(
        {
            "tetra": "012 013 123 203",
            "pyramid": "0123 014 124 234 304",
            "wedge": "012 0143 1254 2035 345",
            "hexahedron": "0123 0154 1265 2376 3047 4567",
        }
    ),
    _spirals,
)
"""CGNS's order: SIDS, section "Unstructured grid element numbering conventions"."""


class _Meshio(NodeOrder):
    def lattice(self, shape: str, order: int, *, is_complete: bool = True) -> ndarray:
        origin = VTK_ORDER if order == 2 and not (shape == "pyramid" and is_complete) else GMSH
        return origin.lattice(shape, order, is_complete=is_complete)


MESHIO = _Meshio({}, {}, inner_places)
"""The order in meshes of meshio. VTK has no pyramid with 14 nodes: that is gmsh's too."""
