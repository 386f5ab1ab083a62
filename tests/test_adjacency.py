"""Equal faces find each other: against a count of sets of nodes."""

import collections

import numpy as np
import pytest

from jaxmorph import cases
from jaxmorph._host.cells import adjacency
from jaxmorph._host.cells.pieces import outer_pieces
from jaxmorph._host.cells.topology import CORNERS, EDGES, FACES, FRAMES
from jaxmorph._quality.distortion import IDEAL

RNG = np.random.default_rng(7)


def faces(count: int, nodes: int, corners: int) -> np.ndarray:
    """Draws faces of distinct nodes; some come twice or more."""
    return np.stack([RNG.choice(nodes, corners, replace=False) for _ in range(count)])


@pytest.mark.parametrize("largest", [0, 2**20, 2**40])
@pytest.mark.parametrize(("nodes", "corners"), [(12, 2), (7, 3), (6, 4), (2, 1)])
def test_twins_and_single_faces(nodes, corners, largest):
    table = faces(60, nodes, corners) + largest
    same = collections.defaultdict(list)
    for row, ids in enumerate(table.tolist()):
        same[frozenset(ids)].append(row)
    columns = adjacency.sorted_columns(adjacency.columns_of(table), 4)
    assert adjacency.is_single(columns).tolist() == [
        len(same[frozenset(ids)]) == 1 for ids in table.tolist()
    ]
    twin = adjacency.twins(columns)
    for ids, rows in same.items():
        expected = rows[::-1] if len(rows) == 2 else [-1] * len(rows)
        assert twin[rows].tolist() == expected, ids


def test_no_faces():
    columns = adjacency.sorted_columns(adjacency.columns_of(np.zeros((0, 3), int)), 4)
    assert len(adjacency.twins(columns)) == len(adjacency.is_single(columns)) == 0


def test_boundary_of_mixed_cells():
    """A pyramid on a hexahedron: all faces but the shared one, each as its cell sees it."""
    cells = {"hexahedron": np.arange(8)[None], "pyramid": np.array([[4, 5, 6, 7, 8]])}
    outer = outer_pieces(cells, 9)
    assert {kind: len(ids) for kind, ids in outer.items()} == {"triangle": 4, "quad": 5}
    assert [4, 5, 6, 7] not in np.sort(outer["quad"], axis=1).tolist()
    wall = outer_pieces(cells, 9, np.array([0, 1, 2, 3, 4, 5]))
    assert wall["triangle"].tolist() == []
    assert np.sort(wall["quad"], axis=1).tolist() == [[0, 1, 2, 3], [0, 1, 4, 5]]


@pytest.mark.parametrize("kind", ["hexahedron", "tetra", "pyramid", "wedge"])
def test_faces_that_are_there_twice_are_dropped_early_or_late(kind):
    """Some cells are left out, and some stand twice: equal to a count of sets of nodes."""
    cells = cases.bricks(kind, cells=3).cells
    chosen = {
        kind: np.concatenate([ids[RNG.random(len(ids)) < 0.7], ids[:2]])
        for kind, ids in cells.items()
    }
    count = collections.Counter(
        frozenset(corner[list(side)].tolist())
        for kind, ids in chosen.items()
        for side in FACES[kind]
        for corner in ids
    )
    outer = outer_pieces(chosen, int(1 + max(ids.max() for ids in chosen.values())))
    found = [frozenset(ids) for faces in outer.values() for ids in faces.tolist()]
    assert len(set(found)) == len(found)
    assert set(found) == {ids for ids, times in count.items() if times == 1}


@pytest.mark.parametrize("kind", IDEAL)
def test_the_tables_of_a_cell_type_are_those_of_its_shape(kind):
    """Faces look outwards and close it, edges are their sides, frames are right-handed and made of edges, each corner has one."""
    points = np.array(IDEAL[kind], dtype=float)
    d, edges = points.shape[1], {frozenset(edge) for edge in EDGES[kind]}
    assert CORNERS[kind] == len(points)
    assert len(edges) == len(EDGES[kind])
    total = np.zeros(d)
    for face in FACES[kind]:
        a, b, c = points[[face[0], face[1], face[-1]]]
        normal = np.array([b[1] - a[1], a[0] - b[0]]) if d == 2 else np.cross(b - a, c - a)
        assert normal @ (a - points.mean(axis=0)) > 0
        assert np.allclose((points[list(face)] - a) @ normal, 0)
        total += normal / (2 if len(face) == 3 else 1)
    np.testing.assert_allclose(total, 0, atol=1e-15)
    sides = [(face[k], face[(k + 1) % len(face)]) for face in FACES[kind] for k in range(len(face))]
    if d == 3:
        assert len(set(sides)) == len(sides) == 2 * len(edges)
    assert {frozenset(side) for side in sides} == edges
    for corner, *ends in FRAMES[kind]:
        assert np.linalg.det(points[ends] - points[corner]) > 0
        assert {frozenset((corner, end)) for end in ends} <= edges
    corners = [frame[0] for frame in FRAMES[kind]]
    expected = {"triangle": [0], "tetra": [0], "pyramid": [0, 1, 2, 3]}.get(
        kind, range(len(points))
    )
    assert sorted(corners) == list(expected)


@pytest.mark.parametrize("kind", IDEAL)
def test_ideal_cells_have_unit_edges_and_square_faces(kind):
    points = np.array(IDEAL[kind], dtype=float)
    lengths = [np.linalg.norm(points[a] - points[b]) for a, b in EDGES[kind]]
    np.testing.assert_allclose(lengths, 1, rtol=1e-14)
    quads = [
        face
        for face in (FACES[kind] if points.shape[1] == 3 else [range(len(points))])
        if len(face) == 4
    ]
    for a, b, c, e in quads:
        np.testing.assert_allclose(
            np.linalg.norm(points[[a, b]] - points[[c, e]], axis=1), 2**0.5, rtol=1e-14
        )
    for corner, *ends in FRAMES[kind]:
        assert np.linalg.det(points[ends] - points[corner]) > 0
