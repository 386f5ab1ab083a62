"""Walls of curved cells: their measures, against maps whose derivatives are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import ring

import jaxmorph as jm
from jaxmorph import cases


def wall_of(mesh, patch):
    """The wall of a patch that slides alone, and its nodes."""
    (track,) = jm.Boundary(mesh, (), sliding=patch).tracks
    (wall,) = track.walls
    return wall, track.rows


def bent(x):
    """A quadratic map, which cells of order 2 repeat exactly where they were straight."""
    more = [
        0.1 * x[:, 2] ** 2 + 0.2 * x[:, 0] * x[:, 1] + 0.3 * x[:, 2],
        0.15 * x[:, 0] * x[:, 2] - 0.1 * x[:, 2],
        0.2 * x[:, 0] ** 2 + 0.1 * x[:, 1] * x[:, 2] - 0.1 * x[:, 1] ** 2 + 0.05 * x[:, 2] ** 2,
    ]
    return x + np.stack(more, axis=1)


def slopes(x):
    """The derivative (n, 3, 3) of `bent`."""
    one, (a, b, c) = np.ones(len(x)), x.T
    rows = (
        (one + 0.2 * b, 0.2 * a, 0.2 * c + 0.3),
        (0.15 * c, one, 0.15 * a - 0.1),
        (0.4 * a, 0.1 * c - 0.2 * b, one + 0.1 * b + 0.1 * c),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


@pytest.mark.parametrize(
    ("kind", "order"), [("hexahedron", 2), ("wedge", 2), ("tetra", 2), ("pyramid", 2)]
)
def test_normals_lines_and_heights_are_those_of_the_map(kind, order):
    """The wall turns by the map's inverse transposed, tangents of lines by the map itself, ends go where the map takes them."""
    mesh = jm.elevate(cases.bricks(kind, cells=3), order)
    x, floor = np.asarray(mesh.points), mesh.patch("floor")
    report = jm.wall_quality(mesh, "floor", bent(x))
    np.testing.assert_array_equal(report.nodes, floor)
    matrix = slopes(x[floor])
    normal = np.linalg.inv(matrix).swapaxes(1, 2) @ [0, 0, 1.0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # of the lines that go straight up: where they end, and the angle of their tangent to the normal
    if kind == "hexahedron":
        top = x[floor] + [0, 0, np.diff(np.unique(np.round(x[:, 2], 9)))[0] * order]
        height = np.sum(normal * (bent(top) - bent(x[floor])), axis=1) / (top - x[floor])[:, 2]
        np.testing.assert_allclose(report.height, height, rtol=1e-9)
        tangent = matrix[:, :, 2] / np.linalg.norm(matrix[:, :, 2], axis=1, keepdims=True)
        angle = np.rad2deg(np.arccos(np.clip(np.sum(normal * tangent, axis=1), -1, 1)))
        np.testing.assert_allclose(report.angle, angle, atol=1e-5)
        assert angle.max() > 15
    lines = jm.wall_quality(mesh, "floor", x * [2, 2, 3])  # stretched: along the normal by three
    np.testing.assert_allclose(lines.height, 3, rtol=1e-9)


def circles(n, order):
    """A ring between circles of radius 1 and 2, its nodes on circles."""
    mesh = jm.elevate(ring(n, (1, 1.5, 2), ("wall", "far")), order)
    turn = np.arctan2(mesh.points[:, 1], mesh.points[:, 0]) % (2 * np.pi / n)
    return mesh.moved(mesh.points * (np.cos(turn - np.pi / n) / np.cos(np.pi / n))[:, None])


@pytest.mark.parametrize("order", [2, 3])
def test_the_angle_of_lines_bent_along_a_circle_converges(order):
    """Spirals leave the circle at the angle whose tangent is their turn; linear pieces miss it by the first power."""
    errors, turn = [], 0.8
    for n in (8, 16):
        mesh = circles(n, order)
        z = mesh.points @ [1, 1j]
        z = z * np.exp(1j * turn * (np.abs(z) - 1))
        report = jm.wall_quality(mesh, "wall", np.stack([z.real, z.imag], axis=1))
        assert len(report.nodes) == order * n
        errors.append(np.abs(np.asarray(report.angle) - np.rad2deg(np.arctan(turn))).max())
    assert errors[1] < 3.0 * 2.0 ** (2 - 2 * order)  # degrees
    pieces = jm.Mesh(mesh.points, mesh.linear.cells, mesh.patches)
    straight = jm.wall_quality(pieces, "wall", np.stack([z.real, z.imag], axis=1))
    assert np.abs(np.asarray(straight.angle) - np.rad2deg(np.arctan(turn))).max() > 2 * errors[1]


def test_derivatives_of_the_measures_of_a_curved_wall():
    mesh = circles(8, 3)
    rng = np.random.default_rng(0)
    points = jnp.asarray(mesh.points + 0.01 * rng.normal(size=mesh.points.shape))
    w = rng.normal(size=(2, len(mesh.patch("wall"))))

    def objective(points):
        report = jm.wall_quality(mesh, "wall", points)
        return jnp.sum(w[0] * report.angle) + jnp.sum(w[1] * report.height)

    step = 1e-6 * rng.normal(size=points.shape)
    difference = (objective(points + step) - objective(points - step)) / 2
    np.testing.assert_allclose(
        np.vdot(jax.jit(jax.grad(objective))(points), step), difference, rtol=1e-5
    )
    np.testing.assert_allclose(
        jax.jit(objective)(points), objective(np.asarray(points)), rtol=1e-10
    )


def test_a_wall_without_the_nodes_between_corners_is_told():
    mesh = circles(8, 2)
    with pytest.raises(
        ValueError, match="no cell has a boundary side whose nodes are all among the 8 wall nodes"
    ):
        jm.wall_quality(mesh, np.flatnonzero(np.arange(len(mesh.points)) < 8))


@pytest.mark.nightly
def test_nodes_slide_on_the_polynomials_of_curved_faces():
    """Of order 3 they miss the circle by the fourth power of a face's length; the linear pieces by the second."""
    errors = []
    for n in (6, 12):
        mesh = circles(n, 3)
        wall, nodes = wall_of(mesh, "far")
        assert wall.own.sides is not None
        np.testing.assert_allclose(
            wall.own.closest(jnp.asarray(mesh.points[nodes]))[0], mesh.points[nodes], atol=1e-13
        )
        angle = np.linspace(0, 2 * np.pi, 97)[:-1] + 0.01
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        places, normals = map(np.asarray, wall.own.closest(jnp.asarray(2.02 * circle)))
        errors.append(np.abs(np.linalg.norm(places, axis=1) - 2).max())
        assert np.abs(np.sum(normals * circle, axis=1)).min() > 1 - 4 * (np.pi / n) ** 6
        # the place is the foot of the point: what is left is normal to the polynomial
        off = 2.02 * circle - places
        assert np.abs(off[:, 0] * normals[:, 1] - off[:, 1] * normals[:, 0]).max() < 1e-9
    assert errors[1] < errors[0] / 10
    assert errors[1] < 2 * (np.pi / 12) ** 4 / 10


@pytest.mark.nightly
def test_the_slide_of_a_node_has_the_derivative_of_the_tangent():
    mesh = circles(8, 2)
    wall, nodes = wall_of(mesh, "far")
    x = jnp.asarray(mesh.points[nodes][:3])
    slope = jax.jacfwd(lambda x: wall.own.closest(x)[0])(x)
    for k in range(3):
        normal = np.asarray(wall.own.closest(x)[1])[k]
        np.testing.assert_allclose(slope[k, :, k], np.eye(2) - np.outer(normal, normal), atol=1e-8)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_nodes_slide_on_curved_faces_in_3d(kind):
    """A floor bent by a quadratic map: faces of order 2 are the map of the plane, and the foot of a point lies on it."""
    mesh = jm.elevate(cases.bricks(kind, cells=3), 2)
    plane = np.asarray(mesh.points)
    mesh = mesh.moved(bent(plane))
    wall, _ = wall_of(mesh, "floor")
    assert wall.own.sides is not None
    s = np.random.default_rng(0).uniform(0.05, 0.95, (40, 3)) * [1, 1, 0]
    on = bent(s)
    normal = np.linalg.inv(slopes(s)).swapaxes(1, 2) @ [0, 0, 1.0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    places, normals = map(np.asarray, wall.own.closest(jnp.asarray(on + 0.01 * normal)))
    np.testing.assert_allclose(places, on, atol=1e-10)
    np.testing.assert_allclose(np.abs(np.sum(normals * normal, axis=1)), 1, atol=1e-10)


@pytest.mark.slow
def test_pictures_draw_the_curved_cells():
    """Fills and edges of a ring of order 3 lie on its circles, where chords between the nodes are not; also in 3-D."""
    cells_of = pytest.importorskip("jaxmorph.plot._plane").PlaneCells
    mesh = circles(6, 3)
    cells = cells_of.of(mesh, None)
    np.testing.assert_allclose(
        np.bincount(cells.cell, cells.areas), jm.quality(mesh).volume, rtol=2e-3
    )
    ids, counts, _ = cells.edges(np.arange(len(cells.ids)))
    edges = cells.points[ids]
    assert (cells.steps, len(edges), (counts == 1).sum()) == (12, 12 * (6 * 3 + 12), 12 * 12)
    radius = np.linalg.norm(edges[counts == 1], axis=2)
    chord = 1 - np.cos(np.pi / 18)  # by which a piece between two nodes misses a circle of radius 1
    assert np.abs(radius / np.round(radius) - 1).max() < chord / 2
    outside = pytest.importorskip("jaxmorph.plot._space").outside
    pytest.importorskip("pyvista")
    solid = jm.elevate(cases.bricks("wedge", cells=3), 2)
    plane = np.asarray(solid.points)
    floor = outside(solid, bent(plane), None, ("floor",))
    flat = outside(solid, plane, None, ("floor",))
    np.testing.assert_allclose(floor.points, bent(np.asarray(flat.points, float)), atol=1e-6)
    assert floor.n_cells == 64 * len(np.unique(floor.cell_data["whole"]))
