"""Tables of cells of high order: nodes on edges and faces, and nodes that serendipity cells lack."""

import numpy as np
import pytest

from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.topology import CORNERS, EDGES

TYPES = lagrange_types()


@pytest.mark.parametrize("name", TYPES)
def test_nodes_of_edges_and_sides_lie_on_them(name):
    cell = TYPES[name]
    x, p = cell.reference, cell.order
    assert cell.name == name and len(np.unique(cell.lattice, axis=0)) == len(x)
    assert cell.corners == CORNERS[cell.shape]
    for edge, ends in zip(cell.edges, EDGES[cell.shape], strict=True):
        a, b = x[list(ends)]
        assert np.allclose(x[edge], a + np.concatenate([[0, p], np.arange(1, p)])[:, None] / p * (b - a))
    for kind, nodes in cell.sides if cell.dimension == 3 else []:
        side = TYPES[kind]
        a, b, last = x[nodes[[0, 1, side.corners - 1]]]
        assert np.allclose(x[nodes], a + side.reference @ np.stack([b - a, last - a]))


@pytest.mark.parametrize("name", ["quad8", "pyramid13", "wedge15", "hexahedron20", "tetra10", "wedge40"])
def test_completed_cell_is_the_same_cell(name):
    complete, matrix = TYPES[name].completion()
    x, y = TYPES[name].reference, TYPES[complete].reference
    # polynomials that serendipity cells reproduce: of degree 2, and a square times another coordinate
    for f in (lambda x: x[0] ** 2, lambda x: x[-1] ** 2 - x[0] * x[1], lambda x: x[0] ** 2 * x[-1]):
        assert np.allclose(matrix @ [f(at) for at in x], [f(at) for at in y])
