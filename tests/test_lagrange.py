"""Tables of cells of high order: nodes on edges and faces, and nodes that serendipity cells lack."""

import numpy as np
import pytest

from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.pieces import linear_cells, outer_pieces, owned_sides, owners
from jaxmorph._host.cells.topology import CORNERS, DIMENSION, EDGES, FRAMES, NODES, SHAPES

TYPES = lagrange_types()
SIZES = {
    "triangle": 1 / 2,
    "quad": 1,
    "tetra": 1 / 6,
    "pyramid": 1 / 3,
    "wedge": 1 / 2,
    "hexahedron": 1,
}


@pytest.mark.parametrize("name", TYPES)
def test_nodes_of_edges_and_sides_lie_on_them(name):
    cell = TYPES[name]
    x, p = cell.reference, cell.order
    assert cell.name == name
    assert (len(x), cell.shape, cell.dimension) == (NODES[name], SHAPES[name], DIMENSION[name])
    assert len(np.unique(cell.lattice, axis=0)) == len(x)
    assert cell.corners == CORNERS[cell.shape]
    for edge, ends in zip(cell.edges, EDGES[cell.shape], strict=True):
        a, b = x[list(ends)]
        assert np.allclose(
            x[edge], a + np.concatenate([[0, p], np.arange(1, p)])[:, None] / p * (b - a)
        )
    for kind, nodes in cell.sides if cell.dimension == 3 else []:
        side = TYPES[kind]
        a, b, last = x[nodes[[0, 1, side.corners - 1]]]
        assert np.allclose(x[nodes], a + side.reference @ np.stack([b - a, last - a]))


@pytest.mark.parametrize(
    "name", ["quad8", "pyramid13", "wedge15", "hexahedron20", "tetra10", "wedge40"]
)
def test_completed_cell_is_the_same_cell(name):
    complete, matrix = TYPES[name].completion()
    x, y = TYPES[name].reference, TYPES[complete].reference
    # polynomials that serendipity cells reproduce: of degree 2, and a square times another coordinate
    for f in (lambda x: x[0] ** 2, lambda x: x[-1] ** 2 - x[0] * x[1], lambda x: x[0] ** 2 * x[-1]):
        assert np.allclose(matrix @ [f(at) for at in x], [f(at) for at in y])


@pytest.mark.parametrize("name", [name for name in TYPES if TYPES[name].dimension > 1])
def test_pieces_fill_the_cell_and_meet_in_equal_faces(name):
    cell = TYPES[name]
    n = len(cell.lattice)
    cells = linear_cells({name: np.arange(n)[None]})
    jacobians = {kind: _jacobians(kind, cell.reference[ids]) for kind, ids in cells.items()}
    assert min(each.min() for each in jacobians.values()) > 1e-6
    # all pieces are affine images of the reference cells
    assert np.isclose(
        sum(SIZES[kind] * each[:, 0].sum() for kind, each in jacobians.items()), SIZES[cell.shape]
    )
    assert set(np.concatenate([ids.ravel() for ids in cells.values()])) == set(range(n))
    sides = set().union(*(_sets(linear_cells({kind: rows[None]})) for kind, rows in cell.sides))
    if cell.is_complete or cell.dimension == 2:
        assert _sets(outer_pieces(cells, n)) == sides
    whole = {name: np.arange(n)[None]}
    assert _sets(outer_pieces(whole, n)) == sides
    assert _sets({kind: ids for kind, (ids, _) in owned_sides(whole, n).items()}) == {
        frozenset(rows.tolist()) for _, rows in cell.sides
    }
    three = owners({name: np.zeros((3, n), int), "line": np.zeros((2, 2), int)})
    assert np.bincount(np.concatenate(list(three.values()))).tolist() == [
        sum(map(len, cells.values()))
    ] * 3 + [1, 1]


def _jacobians(kind, x):
    frames = np.array(FRAMES[kind])
    return np.linalg.det(x[:, frames[:, 1:]] - x[:, frames[:, :1]])


def _sets(faces):
    return {frozenset(row) for each in faces.values() for row in each.tolist()}
