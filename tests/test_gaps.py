"""Walls that nearly touch: generated meshes, how much of a gap is left, and layers that end between walls that have moved."""

import re

import numpy as np
import pytest
from meshes import lattice
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases
from jaxmorph._host.surface import gaps as gaps_module
from jaxmorph._host.surface.gaps import WallGaps, closest, least_share_left


def closing(base, left, lift=0.1):
    """A valve that goes down until a share of its lift is left."""
    return np.broadcast_to([0, (left - 1) * lift], base.shape)


def on_its_seat(method=None):
    mesh = faults.valve()
    plan = jm.prepare(
        mesh, "valve", ("seat", "inlet", "outlet", "top"), symmetry="middle", method=method
    )
    return mesh, plan, mesh.points[mesh.patch("valve")]


def test_a_valve_stands_above_its_seat():
    mesh = faults.valve(lift=0.05, layers=3)
    assert int(jm.quality(mesh).inverted) == 0
    valve, seat = (mesh.points[mesh.patch(name)] for name in ("valve", "seat"))
    assert valve[:, 1].min() - seat[:, 1].max() == pytest.approx(0.05)
    inside = mesh.points[
        (mesh.points[:, 0] == 0.6) & (mesh.points[:, 1] >= 0) & (mesh.points[:, 1] <= 0.05)
    ]
    assert len(inside) == 4
    areas = 1.5 * 1 + 0.5 * 0.6 - 0.7 * 0.15
    assert float(np.sum(jm.quality(mesh).volume)) == pytest.approx(areas)
    assert (mesh.points[mesh.patch("middle"), 0] == 0).all()
    with pytest.raises(ValueError, match=r"a lift from 0 to 0\.5"):
        faults.valve(lift=0)


def test_a_tip_stands_below_its_shroud():
    mesh = faults.blade_tip(gap=0.02, layers=4)
    radius = np.linalg.norm(mesh.points[:, 1:], axis=1)
    assert radius[mesh.patch("blade")].max() == pytest.approx(1.98)
    np.testing.assert_allclose(radius[mesh.patch("shroud")], 2)
    turn = Rotation.from_rotvec([-0.8, 0, 0])
    left, right = (mesh.points[mesh.patch(side)] for side in ("left", "right"))
    images = turn.apply(left)
    assert max(np.abs(right - image[None]).max(axis=1).min() for image in images) < 1e-12
    with pytest.raises(ValueError, match=r"a gap from 0 to 0\.5"):
        faults.blade_tip(gap=1)


def test_gaps_are_distances_to_faces():
    """Two triangles above a third: over its middle, its edge and its corner; in 2-D a node beside a segment and beyond it."""
    floor = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    nodes = np.array([[0.5, 0.5, 0.3], [1, -0.4, 0.3], [-0.3, -0.4, 1.2]])
    wall = np.array([0, 0, 0, 1, 1, 1])
    found = WallGaps(np.concatenate([floor, nodes]), wall, np.array([[0, 1, 2]])).at(np.arange(6))
    np.testing.assert_allclose(found[0][3:], [0.3, 0.5, 1.3])
    assert np.isinf(found[0][:3]).all()
    flat = np.array([[0.0, 0], [1, 0], [0.5, 0.2], [4, 4]])
    wall = np.array([0, 0, 1, 1])
    above = WallGaps(flat, wall, np.array([[0, 1]])).at(np.array([3, 2]))[0]
    np.testing.assert_allclose(above, [5, 0.2])


def test_walls_that_slide_keep_their_gap():
    """A short wall over a long one: along it nothing is lost, towards it as much as the distance says."""
    x = np.arange(11.0)
    points = np.concatenate([np.column_stack([x, 0 * x]), [[2, 1], [3, 1], [4, 1]]])
    faces = np.stack([np.arange(13), np.arange(1, 14)], axis=1)
    wall = np.repeat([0, 1], [11, 3])
    for vector, expected in (([3, 0], 1), ([0, -0.75], 0.25)):
        moved = points + np.where(wall[:, None] == 1, vector, 0.0)
        assert least_share_left(points, moved, wall, faces, 0.0)[0] == pytest.approx(expected)


@pytest.mark.parametrize("d", [2, 3])
def test_the_least_share_of_a_gap_is_that_of_all_rows(d, monkeypatch):
    """Wavy walls that move at random: as measured at every row."""
    monkeypatch.setattr(gaps_module, "MEASURED_FIRST", 3)
    rng = np.random.default_rng(d)
    points = rng.normal(size=(60, d))
    wall = np.repeat([0, 1, 2], 20)
    faces = np.concatenate(
        [20 * k + rng.permutation(20)[: 18 // d * d].reshape(-1, d) for k in range(3)]
    )
    for size in (0.01, 0.3):
        moved = points + size * rng.normal(size=points.shape)
        rows = np.arange(60)
        first = WallGaps(points, wall, faces).at(rows)[0]
        second, nearest = WallGaps(moved, wall, faces).at(rows)
        share = second / np.minimum(first, first[nearest].min(axis=1))
        left, row = least_share_left(points, moved, wall, faces, 0.0)
        assert left == pytest.approx(share.min(), rel=1e-14)
        assert row == share.argmin()
        for below in (0.9, 0.5, 0.1):
            seen = least_share_left(points, moved, wall, faces, 0.0, below)
            assert seen == ((left, row) if left < below else (below, 0))


@pytest.mark.slow
def test_inspect_says_how_much_of_a_gap_is_left():
    mesh, plan, base = on_its_seat(jm.DelaunayGraph())
    for left in (0.5, 0.02):
        seen = jm.inspect(plan, closing(base, left), mesh=mesh)
        assert seen.gap_left == pytest.approx(left)
        told = re.search(r"2 % of the gap between node (\d+) and another wall", str(seen))
        assert (told is not None) == (left == 0.02)
        assert told is None or mesh.points[int(told[1]), 1] in (0, 0.1)
    assert jm.inspect(plan, closing(base, 0.5)).gap_left is None


@pytest.mark.nightly
@pytest.mark.parametrize("case", ["channel", "valve"])
def test_layers_end_between_walls_that_have_moved(case):
    """Gaps that close to 2 % in steps: the layers are laid anew, and no cell is inverted."""
    steps = np.arange(1, 11) / 10
    if case == "valve":
        mesh, plan, base = on_its_seat()
        path = np.stack([closing(base, 0.02**t) for t in steps])
    else:
        mesh = faults.channel(columns=20, rows=12, first_cell=1e-3)
        plan = jm.prepare(mesh, "inner", ("outer", "inlet", "outlet"))
        x = mesh.points[mesh.patch("inner"), 0]
        bump = (4 * x * (1 - x)) ** 4
        path = np.stack([np.column_stack([0 * x, 0.2 * (1 - 0.02**t) * bump]) for t in steps])
    _, points = jm.march(plan, path, rebuild=case == "valve")
    assert int(jm.quality(mesh, points).inverted) == 0
    assert float(jm.quality(mesh, points).min_jacobian_ratio) < 0.02
    assert jm.inspect(plan, path[-1], mesh=mesh).gap_left == pytest.approx(0.02, rel=0.01)


@pytest.mark.slow
def test_a_step_lays_the_layer_anew():
    """A layer far too wide ends half way between walls: where the gap has halved, it ends at half of what it did."""
    across = np.linspace(0, 1, 21)
    x = np.linspace(0, 1, 11)
    points = lattice(x, across)
    moving, fixed = np.flatnonzero(points[:, 1] == 0), np.flatnonzero(points[:, 1] == 1)
    coarse = jm.RBF(reduction=jm.KDTree(1), fixed_reduction=jm.KDTree(1))
    resting = jm.SurfaceReconstruction(coarse, jm.NearWall(width=9.0))
    plan = jm.prepare(points, moving, fixed, method=resting)
    u = np.tile([0, 0.5], (len(moving), 1))
    (_, after), moved = jm.march(plan, np.stack([u, u]))
    chi = np.asarray(after.volume.placed.correction.share)
    height = (np.asarray(moved)[:, 1] - 0.5) / 0.5
    np.testing.assert_allclose(chi[height == 0], 1)
    assert (chi[np.isclose(height, 0.5, atol=0.02)] < 1e-3).all()
    expected = jm.refit(plan, moved).volume.placed.correction.share
    np.testing.assert_allclose(after.volume.placed.correction.share, expected, rtol=0, atol=1e-12)


def test_bodies_are_cut_from_a_box():
    mesh = cases.bodies({"a": (-3.0, -2.0, 0.0, 1.0), "b": (1.0, 3.0, -2.0, -1.0)}, spacing=0.5)
    volume = np.asarray(jm.quality(mesh).volume)
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(16 * 8 - 1 - 2)
    assert np.ptp(mesh.points[mesh.patch("b")], axis=0) == pytest.approx([2, 1])
    assert len(mesh.patch("farfield")) == 2 * (32 + 16)
    with pytest.raises(ValueError, match=r"body 'c' at .* try a smaller spacing"):
        cases.bodies({"c": (0.0, 0.01, 0.0, 1.0)})
    with pytest.raises(ValueError, match="from least to largest"):
        cases.bodies({}, box=(1.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize("d", [2, 3])
def test_of_equally_near_faces_the_first_by_place_is_the_closest(d):
    """Whatever the order of the faces: from the middle of a box, from its nodes, and off its edges."""
    points = lattice(*[[0.0, 1.0]] * d)
    if d == 2:
        faces = np.array([[0, 1], [1, 3], [3, 2], [2, 0]])
    else:
        quads = np.array(
            [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
        )
        faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    x = np.concatenate([np.full((1, d), 0.5), points, points + 0.1 * (2 * points - 1)])
    expected = closest(points[faces], x)
    middles = points[faces].mean(axis=1)
    rng = np.random.default_rng(0)
    for _ in range(5):
        order = rng.permutation(len(faces))
        found = closest(points[faces[order]], x + 1e-17)
        np.testing.assert_array_equal(middles[order[found.face]], middles[expected.face])
        np.testing.assert_allclose(found.distance, expected.distance, rtol=0, atol=1e-15)
