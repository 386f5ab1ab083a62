"""Equal faces find each other: against a count of sets of nodes."""

import collections

import numpy as np
import pytest

from jaxmorph import cases
from jaxmorph._host import pairs
from jaxmorph._host.topology import FACES, boundary_faces

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
    columns = pairs.sorted_columns(pairs.columns_of(table), 4)
    assert pairs.is_single(columns).tolist() == [len(same[frozenset(ids)]) == 1 for ids in table.tolist()]
    twin = pairs.twins(columns)
    for ids, rows in same.items():
        expected = rows[::-1] if len(rows) == 2 else [-1] * len(rows)
        assert twin[rows].tolist() == expected, ids


def test_different_faces_with_one_key(monkeypatch):
    table = faces(60, 7, 3)
    columns = pairs.sorted_columns(pairs.columns_of(table), 3)
    twin, single = pairs.twins(columns), pairs.is_single(columns)
    monkeypatch.setattr(pairs, "_keys", lambda columns: columns[0] % 2)
    assert np.array_equal(pairs.twins(columns), twin)
    assert np.array_equal(pairs.is_single(columns), single)


def test_no_faces():
    columns = pairs.sorted_columns(pairs.columns_of(np.zeros((0, 3), int)), 4)
    assert len(pairs.twins(columns)) == len(pairs.is_single(columns)) == 0


def test_boundary_of_mixed_cells():
    """A pyramid on a hexahedron: all faces but the shared one, each as its cell sees it."""
    cells = {"hexahedron": np.arange(8)[None], "pyramid": np.array([[4, 5, 6, 7, 8]])}
    outer = boundary_faces(cells, 9)
    assert {kind: len(ids) for kind, ids in outer.items()} == {"triangle": 4, "quad": 5}
    assert [4, 5, 6, 7] not in np.sort(outer["quad"], axis=1).tolist()
    wall = boundary_faces(cells, 9, np.array([0, 1, 2, 3, 4, 5]))
    assert wall["triangle"].tolist() == []
    assert np.sort(wall["quad"], axis=1).tolist() == [[0, 1, 2, 3], [0, 1, 4, 5]]


@pytest.mark.parametrize("kind", ["hexahedron", "tetra", "pyramid", "wedge"])
def test_faces_that_are_there_twice_are_dropped_early_or_late(kind):
    """Some cells are left out, and some stand twice: equal to a count of sets of nodes."""
    cells = cases.bricks(kind, cells=3).cells
    chosen = {kind: np.concatenate([ids[RNG.random(len(ids)) < 0.7], ids[:2]]) for kind, ids in cells.items()}
    count = collections.Counter(
        frozenset(corner[list(side)].tolist()) for kind, ids in chosen.items() for side in FACES[kind] for corner in ids
    )
    outer = boundary_faces(chosen, int(1 + max(ids.max() for ids in chosen.values())))
    found = [frozenset(ids) for faces in outer.values() for ids in faces.tolist()]
    assert len(set(found)) == len(found)
    assert set(found) == {ids for ids, times in count.items() if times == 1}
