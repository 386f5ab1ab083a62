"""Bodies that move close to a wall on which nodes slide: a wing on a fuselage of faces, a neighbour above an airfoil."""

import numpy as np
import pytest
from meshes import blocks, circle, lattice, on_circle

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases
from jaxmorph._boundary.slide import filled
from jaxmorph._host.cells.pieces import outer_pieces
from jaxmorph._host.surface.gaps import closest

pytestmark = pytest.mark.nightly


def fuselage():
    """A wing on a fuselage that is no surface of revolution: wider than high, and thinner towards its end."""
    mesh = faults.blade_tip(gap=0.4, layers=2)
    x, y, z = np.asarray(mesh.points).T
    patch, on_body = mesh.patch("blade"), np.hypot(y, z) < 1 + 1e-9
    points = np.stack([x, 1.3 * (1 - 0.1 * x) * y, (1 - 0.1 * x - 0.05 * x**2) * z], axis=1)
    patches = {**mesh.patches, "root": patch[on_body[patch]]}
    return jm.Mesh(points, mesh.cells, patches)


def test_a_wing_moves_along_a_fuselage_of_faces():
    """Nodes stay on the fuselage's triangles, also where the wing stood, and the root goes where `u` sends it."""
    mesh = fuselage()
    points, wing, root = np.asarray(mesh.points), mesh.patch("blade"), mesh.patch("root")
    body, outer = mesh.patch("hub", "root"), ("shroud", "inlet", "outlet", "left", "right")
    plan = jm.prepare(mesh, "blade", outer, sliding=jm.Slide(("hub", "root")))
    u = np.tile([0.16, 0.02, 0.0], (len(wing), 1))
    moved = np.asarray(jm.deform(plan, u))
    x, y, z = moved[body].T
    around = np.hypot(y / (1.3 * (1 - 0.1 * x)), z / (1 - 0.1 * x - 0.05 * x**2))
    assert (
        np.abs(around - 1).max() < 5e-3
    )  # a chord across the wing's thickness is 0.002 below the surface
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    quads = outer_pieces(cells, len(points))["quad"]
    quads = quads[np.isin(quads, body).all(axis=1)]
    diagonals = [[0, 1, 2], [0, 2, 3], [1, 2, 3], [1, 3, 0]]
    off = closest(points[np.concatenate([quads[:, each] for each in diagonals])], moved[body])[2]
    stood = (np.abs(x) < 0.26) & (np.abs(y) < 0.11) & (z > 0)
    assert off[~stood].max() < 1e-14
    assert stood.any()
    is_root = np.isin(wing, root)
    np.testing.assert_allclose(
        moved[wing[~is_root]], (points[wing] + u)[~is_root], rtol=0, atol=1e-15
    )
    np.testing.assert_allclose(
        moved[root, :2], (points[root] + [0.16, 0.02, 0])[:, :2], rtol=0, atol=0.01
    )
    held = jm.deform(jm.prepare(mesh, "blade", (*outer, "hub")), u)
    report, before = jm.quality(mesh, moved), jm.quality(mesh, held)
    assert int(report.inverted) == 0
    assert float(report.min_jacobian_ratio) > float(before.min_jacobian_ratio) + 0.3


@pytest.mark.parametrize("hole", [[6, 7, 11, 12], [6, 12]], ids=["square", "two that share a node"])
def test_holes_below_moving_bodies_are_filled(hole):
    """The hole's area is covered once, seen from the same side; in 2-D a gap is bridged."""
    vertices, quads = lattice(*[np.arange(6.0)] * 2, [0.0]), blocks(np.arange(36).reshape(6, 6))
    left, moves = np.delete(quads, hole, axis=0), np.isin(np.arange(36), quads[hole])
    faces = np.concatenate([left[:, :3], left[:, [0, 2, 3]]])
    first, second, third = (vertices[corner] for corner in filled(faces, vertices, moves).T)
    areas = np.cross(second - first, third - first)[:, 2] / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(25)
    assert len(filled(faces, vertices, np.zeros(36, dtype=bool))) == len(faces)
    lines, moves = np.array([[0, 1], [1, 2], [3, 4]]), np.array([False, True, True, True, False])
    assert filled(lines, vertices[[0, 6, 12, 18, 24], :2], moves).tolist() == [
        [0, 1],
        [1, 2],
        [3, 4],
        [2, 3],
    ]


def airfoil():
    """A neighbour, a box of 0.5 by 0.25, a quarter above the upper side of an airfoil: a polyline of 32 pieces."""
    mesh = cases.bodies(
        {"neighbour": (-0.5, 0.0, 0.25, 0.5)}, box=(-2.0, 2.0, 0.0, 2.0), spacing=0.125
    )
    x, y = np.asarray(mesh.points).T
    patches = {"wall": y == 0, "outer": (y == 2) | (np.abs(x) == 2)}
    points = np.stack([x, y + 0.3 * (1 - x**2 / 4) * (1 - y / 2)], axis=1)
    ids = {name: np.flatnonzero(on) for name, on in patches.items()}
    return jm.Mesh(points, mesh.cells, {"neighbour": mesh.patch("neighbour"), **ids})


def test_a_block_behind_a_neighbour_slides_along_an_airfoil():
    """The neighbour goes farther than three gaps along the wall: its nodes go along, and stay on the polyline."""
    mesh = airfoil()
    points, wall = np.asarray(mesh.points), mesh.patch("wall")
    start = points[mesh.patch("neighbour")]
    x = start[:, 0] + 0.9
    u = np.stack([np.full(len(x), 0.9), 0.24 * (start[:, 0] ** 2 - x**2) / 4], axis=1)
    plan = jm.prepare(mesh, "neighbour", "outer", sliding="wall")
    moved = np.asarray(jm.deform(plan, u))
    along = wall[np.argsort(points[wall, 0])]
    expected = np.interp(moved[wall, 0], points[along, 0], points[along, 1])
    np.testing.assert_allclose(moved[wall, 1], expected, rtol=0, atol=1e-14)
    assert (np.diff(moved[along, 0]) > 0).all()
    assert np.abs(moved - points)[wall].max() > 0.8
    assert (moved[along[[0, -1]]] == points[along[[0, -1]]]).all()
    assert int(jm.quality(mesh, moved).inverted) == 0
    held = jm.prepare(mesh, "neighbour", ("outer", "wall"))
    assert int(jm.quality(mesh, jm.deform(held, 0.75 * u)).inverted) > 0


def test_ends_of_a_wall_are_no_holes():
    """Half a ring, a cap of a sphere and a tube keep their open rims, though they move; two gaps of a floor are closed in order."""
    lines = np.stack([np.arange(8), np.arange(1, 9)], axis=1)
    assert (
        len(filled(lines, on_circle(np.linspace(0, np.pi, 9)), np.isin(np.arange(9), [0, 8]))) == 8
    )
    floor = np.stack([np.arange(12.0), 0.2 * np.sin(np.arange(12.0))], axis=1)
    lines = np.stack([np.arange(11), np.arange(1, 12)], axis=1)
    standing = np.isin(np.arange(11), [2, 3, 7])
    closed = filled(lines[~standing], floor, np.isin(np.arange(12), [2, 4, 7, 8]))
    added = {*map(tuple, closed.tolist())} - {*map(tuple, lines[~standing].tolist())}
    assert added == {(2, 4), (7, 8)}
    rim = np.insert(circle(12), 2, 0, axis=1)
    here, after = np.arange(12), np.roll(np.arange(12), -1)
    quads = np.stack([here, after, after + 12, here + 12], axis=1)
    tube = np.concatenate([rim, rim + np.array([0, 0, 3])])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    assert len(filled(faces, tube, np.ones(24, dtype=bool))) == 24
    cap = np.concatenate([rim, [[0, 0, 0.4]]])
    faces = np.stack([here, after, np.full(12, 12)], axis=1)
    assert len(filled(faces, cap, np.arange(13) < 12)) == 12
