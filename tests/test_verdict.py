"""`jm.judge`: whether a mesh is good, against plain NumPy, and joined over its parts."""

import contextlib
import dataclasses
import pickle

import numpy as np
import pytest
from meshes import blocks, lattice, ring, shaken, with_folds
from oracles import corner_areas
from runs import over, refusals

import jaxmorph as jm

LIMITS = jm.Limits(max_skewness=0.3, max_aspect_ratio=4.0, min_jacobian_ratio=0.4)


def noisy(size: float, seed: int = 0):
    """A ring of quads whose nodes are displaced at random, and the mesh."""
    return ring(), shaken(ring(), size, seed)


def in_two(mesh, points):
    """Two meshes of half of the cells each, with their points and the ids of their cells."""
    (kind, cells), *_ = mesh.cells.items()
    for rows in np.array_split(np.arange(len(cells)), 2):
        nodes = np.unique(np.asarray(cells)[rows])
        part = jm.Mesh(
            np.asarray(mesh.points)[nodes], {kind: np.searchsorted(nodes, np.asarray(cells)[rows])}
        )
        yield part, points[nodes], rows


@pytest.mark.parametrize("size", [0.0, 0.02, 0.2])
def test_counts_are_those_of_numpy_and_ok_is_nothing_beyond(size):
    mesh, points = noisy(size)
    verdict, before, after = (
        jm.judge(mesh, points, LIMITS),
        corner_areas(mesh, mesh.points),
        corner_areas(mesh, points),
    )
    is_inverted = (after / before).min(axis=1) <= 0
    report = jm.quality(mesh, points)
    values = {
        "max_skewness": np.asarray(report.skewness),
        "max_aspect_ratio": np.asarray(report.aspect_ratio),
    }
    values["min_jacobian_ratio"] = np.asarray(report.jacobian_ratio)
    beyond = {name: value > LIMITS.by_name[name] for name, value in values.items()}
    beyond["min_jacobian_ratio"] = (
        values["min_jacobian_ratio"] < LIMITS.by_name["min_jacobian_ratio"]
    )
    assert (verdict.cells, verdict.inverted, verdict.spoilt) == (
        192,
        is_inverted.sum(),
        is_inverted.sum(),
    )
    assert {gate.name: gate.beyond for gate in verdict.gates} == {
        name: rows.sum() for name, rows in beyond.items()
    }
    np.testing.assert_array_equal(
        verdict.bad, np.flatnonzero(is_inverted | np.any(list(beyond.values()), axis=0))
    )
    assert verdict.ok == (not len(verdict.bad))
    assert len(verdict.faults()) == (
        is_inverted.any() + sum(rows.any() for rows in beyond.values())
    )
    if is_inverted.any():
        assert is_inverted[verdict.worst.cell]
    for gate in verdict.gates:
        listed = values[gate.name][[cell.cell for cell in gate.worst]] * (
            1 if gate.name[:3] == "max" else -1
        )
        assert (np.diff(listed) <= 0).all()
        extreme = values[gate.name].max() if gate.name[:3] == "max" else values[gate.name].min()
        assert gate.extreme.value == pytest.approx(extreme, rel=1e-12)


def test_a_motion_is_blamed_for_what_it_inverts_alone():
    """A mesh by itself has its inverted cells; a motion that leaves them, or unfolds them, inverts none."""
    mesh = ring()
    folded = mesh.moved(with_folds(mesh, 3))
    alone = jm.judge(folded)
    assert (
        alone.inverted
        == alone.spoilt
        == (corner_areas(folded, folded.points).min(axis=1) <= 0).sum()
        > 0
    )
    assert not alone.ok
    stays, unfolds = (jm.judge(folded, points) for points in (folded.points, mesh.points))
    folds = jm.judge(mesh, folded.points)
    assert (stays.ok, stays.inverted, stays.spoilt) == (True, alone.inverted, 0)
    assert (unfolds.ok, unfolds.inverted, unfolds.before.inverted) == (True, 0, alone.inverted)
    assert (folds.ok, folds.inverted, folds.before.ok) == (False, alone.inverted, True)
    assert jm.judge(mesh).ok


@over("size", [0.2], slow=[0.02])
def test_parts_joined_equal_the_whole_and_pass_through_pickle(size):
    """But for skewness across the cut, all numbers, places and counts."""
    mesh, points = noisy(size)
    limits = dataclasses.replace(LIMITS, proven=True)
    whole, parts = jm.judge(mesh, points, limits), list(in_two(mesh, points))
    verdicts = [jm.judge(part, moved, limits, part=k) for k, (part, moved, _) in enumerate(parts)]
    joined = jm.Verdict.together([pickle.loads(pickle.dumps(verdict)) for verdict in verdicts])
    assert joined == jm.Verdict.together(verdicts)
    for found, expected in ((joined, whole), (joined.before, whole.before)):
        for name in ("cells", "inverted", "spoilt", "ok"):
            assert getattr(found, name) == getattr(expected, name)
        assert [gate.beyond for gate in found.gates] == [gate.beyond for gate in expected.gates]
        for row, number in found.rows.items():
            if row[1] != "non_orthogonality":
                assert number.value == pytest.approx(expected.rows[row].value, rel=1e-9, abs=1e-9)
    for gate, expected in zip(joined.gates, whole.gates, strict=True):
        cells = [parts[cell.part][2][cell.cell] for cell in gate.worst]
        np.testing.assert_allclose(
            [c.value for c in gate.worst], [c.value for c in expected.worst], rtol=1e-9
        )
        assert size < 0.1 or cells == [cell.cell for cell in expected.worst]


def test_one_verdict_before_serves_several_motions():
    mesh, points = noisy(0.05)
    before = jm.judge(mesh, None, LIMITS)
    assert jm.judge(mesh, points, LIMITS, before=before) == jm.judge(mesh, points, LIMITS)
    assert "before" in str(jm.judge(mesh, points, LIMITS))
    assert max(map(len, jm.judge(mesh, points, LIMITS).table().split("\n"))) <= 80


def test_proven_is_a_limit():
    mesh, points = noisy(0.01)
    verdict = jm.judge(mesh, points, jm.Limits(proven=True))
    (gate,) = verdict.gates
    valid = np.asarray(jm.proof(mesh, points, base=mesh.points).is_valid)
    assert (gate.beyond, verdict.ok) == ((~valid).sum(), bool(valid.all()))


test_what_cannot_be_judged = refusals(
    (lambda mesh: jm.judge(mesh, mesh.points[:-1]), "`points`"),
    (lambda mesh: jm.Limits(max_skewness=np.nan), "`max_skewness` must be a real number"),
    of=lambda: (ring(),),
)


def plate(axis=range(9)):
    """Quads round a hole, the `wall`, in a square whose sides are `far`."""
    points = lattice(np.array(axis, float), np.arange(9.0))
    number = np.arange(81).reshape(9, 9)
    cells = np.delete(blocks(number), 4 * 8 + 4, axis=0)
    patches = {"wall": number[4:6, 4:6].ravel(), "far": number[[0, 8]].ravel()}
    patches["far"] = np.union1d(patches["far"], number[:, [0, 8]])
    return jm.Mesh(points, {"quad": cells}, patches)


def folded_plate():
    """Four quads round one node are folded before any motion."""
    mesh = plate()
    points = np.array(mesh.points)
    points[10] = 2.6
    return mesh.moved(points)


def folded_ring():
    """Two triangles are folded far from the body, in layers that grow outwards."""
    mesh = ring(24, np.append(1, 1 + np.cumsum(0.2 * 1.5 ** np.arange(6))))
    quads = np.asarray(mesh.cells["quad"])
    points = np.array(mesh.points)
    inner = np.setdiff1d(np.arange(len(points)), mesh.patch("wall", "far"))
    node = inner[np.linalg.norm(points[inner], axis=1).argmax()]
    points[node] *= 0.7
    triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    return jm.Mesh(points, {"triangle": triangles}, mesh.patches)


JUDGED = {
    "sound": plate,
    "folded quads": folded_plate,
    "folded triangles": folded_ring,
    "quads collapsed to lines": lambda: plate([0, 1, 1, 3, 4, 5, 6, 7, 8]),
}


@over("kind", ["folded quads"], slow=["sound", "folded triangles", "quads collapsed to lines"])
@over("angle", [2.8], slow=[0.05])
def test_all_that_judge_give_one_answer(kind, angle):
    """What a motion has spoilt is counted by `judge`; it has nothing else to say elsewhere."""
    mesh = JUDGED[kind]()
    boundary = jm.Boundary(mesh, "wall", "far")
    plan = jm.prepare(mesh, "wall", "far", method=jm.DelaunayGraph())
    wall = np.asarray(plan.moving_points)
    u = np.asarray(jm.shapes.rotate(wall, angle, wall.mean(axis=0))) - wall
    moved = jm.deform(plan, u)
    verdict = jm.judge(mesh, moved)
    is_spoilt = verdict.spoilt > 0
    assert is_spoilt == (angle > 1)
    assert verdict.ok != is_spoilt
    assert jm.judge(mesh).ok == (kind == "sound")
    assert bool(verdict.note) == ("folded" in kind)
    report = jm.quality(mesh, moved)
    assert int(report.is_spoilt.sum()) == verdict.spoilt
    with contextlib.nullcontext() if not is_spoilt else pytest.raises(ValueError, match="inverted"):
        report.raise_if_inverted()
    found = jm.inspect(plan, u, mesh=mesh, moved=moved)
    assert (verdict.note in found.advice) == bool(verdict.note)
    folds = [said for said in found.advice if said.startswith("one step folds")]
    assert len(folds) == is_spoilt
    assert all(said.startswith(f"one step folds {verdict.spoilt} cells") for said in folds)
    for cure in jm.cures(boundary, u):
        if "".join(folds).partition(". With ")[2].startswith(f"{cure.steps} steps"):
            path = jm.Turn.of(wall, u).path(cure.steps)
            assert jm.judge(mesh, jm.march(plan, path)[1]).spoilt == 0
    steps = jm.fewest_steps(plan, mesh, u, min_jacobian_ratio=0.0, max_steps=1)
    assert (steps.fraction < 1) == is_spoilt
    assert (jm.largest_step(plan, 0 * u, u, mesh).step < 1) == is_spoilt
    compared = jm.compare(boundary, u[None], {"default": plan.method})
    assert compared.rows[0].inverted == verdict.spoilt
    improved = jm.improve(mesh, moved)
    assert int(improved.before) == verdict.inverted
    assert int(improved.after) == jm.judge(mesh, improved.points).inverted
