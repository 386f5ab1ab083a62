"""A smooth surface through the nodes of faces: distances from circles, spheres and cylinders that are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import ball, blocks, lattice, on_circle, ring
from runs import over

import jaxmorph as jm
from jaxmorph._boundary.face_search import FLAT_FACES, SMOOTH_FACES, FaceSearch


def wall(kind, vertices, faces):
    faces = np.asarray(faces, dtype=np.int32)
    return FaceSearch.of(np.arange(len(vertices)), vertices, faces, kind)


def arc(count):
    """Nodes of uneven spacing on an open arc of 2 radians of the unit circle."""
    t = np.linspace(0, 2, count) + 0.6 / count * np.random.default_rng(0).uniform(-1, 1, count)
    lines = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    return on_circle(t), lines, t


def reached(surface, x):
    return map(np.asarray, eqx.filter_jit(surface.closest)(jnp.asarray(x)))


@pytest.mark.nightly
def test_an_arc_is_met_to_the_fourth_order():
    """The chords miss it by the second power of their length; also at the ends, where faces lie on one side."""
    errors = []
    for count in (8, 16, 32):
        vertices, lines, t = arc(count)
        s = np.linspace(t[0], t[-1], 200)
        circle = on_circle(s)
        x = circle * (1 + 0.01 * np.sin(9 * s))[:, None]
        places, normals = reached(wall(SMOOTH_FACES, vertices, lines), x)
        errors.append(np.abs(np.linalg.norm(places, axis=1) - 1).max())
        assert np.abs(np.abs(np.sum(normals * circle, axis=1)) - 1).max() < 1e-4
        chords = next(reached(wall(FLAT_FACES, vertices, lines), x))
        assert errors[-1] < np.abs(np.linalg.norm(chords, axis=1) - 1).max() / 10
        on_nodes = next(reached(wall(SMOOTH_FACES, vertices, lines), vertices))
        np.testing.assert_allclose(on_nodes, vertices, rtol=0, atol=1e-14)
    assert errors[2] < errors[0] / 50


def test_a_plane_stays_a_plane_and_a_thin_plate_its_faces():
    flat = lattice(np.linspace(0, 1, 4), np.linspace(0, 1, 3), [0.0])
    quads = blocks(np.arange(12).reshape(4, 3))
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    x = np.random.default_rng(0).uniform(0.1, 0.9, (20, 3)) * [1, 1, 0.1]
    for parts in (faces, np.concatenate([faces, faces[:, ::-1]])):
        places, normals = reached(wall(SMOOTH_FACES, flat, parts), x)
        np.testing.assert_allclose(places, x * [1, 1, 0], rtol=0, atol=1e-15)
        np.testing.assert_allclose(
            np.abs(normals), np.broadcast_to([0, 0, 1], x.shape), rtol=0, atol=1e-14
        )


@pytest.mark.nightly
def test_spheres_and_cylinders_are_met():
    """Normals are exact on a sphere whatever its triangles; the places are by the fourth power of their length."""
    errors = []
    for count in (100, 400):
        vertices, faces = ball(count)
        x = np.random.default_rng(1).normal(size=(200, 3))
        x /= np.linalg.norm(x, axis=1)[:, None]
        places = next(reached(wall(SMOOTH_FACES, vertices, faces), x))
        errors.append(np.abs(np.linalg.norm(places, axis=1) - 1).max())
        chords = next(reached(wall(FLAT_FACES, vertices, faces), x))
        assert errors[-1] < np.abs(np.linalg.norm(chords, axis=1) - 1).max() / 10
    assert errors[1] < errors[0] / 8
    angle, z = lattice(np.linspace(0, 1.5, 7), np.linspace(0, 1, 4)).T
    quads = blocks(np.arange(28).reshape(7, 4))
    tube = np.stack([np.cos(angle), np.sin(angle), z], axis=1)
    s = np.random.default_rng(2).uniform(0, 1, (100, 2)) * [1.5, 1]
    x = np.stack([np.cos(s[:, 0]), np.sin(s[:, 0]), s[:, 1]], axis=1)
    surface = wall(SMOOTH_FACES, tube, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    places = next(reached(surface, x))
    off, sagitta = np.abs(np.linalg.norm(places[:, :2], axis=1) - 1), 1 - np.cos(0.125)
    inside = (np.abs(s[:, 0] - 0.75) < 0.5) & (
        np.abs(s[:, 1] - 0.5) < 1 / 6
    )  # of the cells at the rims
    assert inside.sum() > 5
    assert off[inside].max() < 0.05 * sagitta
    assert off.max() < sagitta


def slid(order):
    """A ring whose outer nodes have slid along the circle of radius 2, unevenly."""
    mesh = ring(12, (1, 1.5, 2), ("inner", "outer"))
    mesh = jm.elevate(mesh, order) if order > 1 else mesh
    points = np.asarray(mesh.points)
    radius, angle = np.linalg.norm(points, axis=1), np.arctan2(points[:, 1], points[:, 0])
    if order > 1:  # nodes of straight edges go onto their circles
        size = np.array([1, 1.25, 1.5, 1.75, 2])[
            np.abs(radius[:, None] - [1, 1.25, 1.5, 1.75, 2]).argmin(axis=1)
        ]
        points, radius = on_circle(angle) * size[:, None], size
        mesh = mesh.moved(points)
    moved = angle + 0.15 * (radius - 1) * np.sin(2 * angle)
    return mesh, radius, on_circle(moved) * radius[:, None]


@over("order", nightly=[1, 2])
def test_improve_follows_a_circle_given_by_faces_alone(order):
    """Of 12 chords of half angle a, or of as many quadratic arcs: off the circle by the surface's own error, at a minimum.

    In the middle of a chord the surface rises by sin(a)^2 cos(a) / 2, the circle by 1 - cos(a).
    At s of an arc, r^2 = 1 - c^2 s^2 (1 - s^2), where c = 1 - cos(a): least at s^2 = 1 / 2.
    """
    mesh, radius, start = slid(order)
    outer = np.flatnonzero(np.isclose(radius, 2))
    assert set(outer) >= set(mesh.patch("outer"))
    mesh = jm.Mesh(mesh.points, mesh.cells, {"outer": outer})
    result = jm.improve(jm.Boundary(mesh, (), sliding="outer"), start, tolerance=1e-8)
    found = np.linalg.norm(np.asarray(result.points)[outer], axis=1)
    c, s = 1 - np.cos(np.pi / 12), np.sin(np.pi / 12)
    error = c - s**2 * (1 - c) / 2 if order == 1 else 1 - np.sqrt(1 - c**2 / 4)
    assert np.abs(found - 2).max() < 2 * error + 1e-9
    assert float(result.residual) < 1e-4
    np.testing.assert_allclose(result.points, mesh.points, rtol=0, atol=3e-3)
    assert np.abs(np.asarray(result.points) - start)[outer].max() > 0.1


def test_derivatives_across_an_edge_of_the_faces():
    """Where a node passes from a chord of half angle a to one of b, its direction turns by sin(a)^3 + sin(b)^3 at most."""
    vertices, lines, angles = arc(8)
    surface = wall(SMOOTH_FACES, vertices, lines)
    along = vertices[4] - vertices[3]
    places = jax.jit(lambda t: surface.closest((jnp.asarray(vertices[4]) + t * along)[None])[0][0])
    before, after = (jax.jvp(places, (t,), (1.0,))[1] for t in (-1e-6, 1e-6))
    turn = np.sum(np.sin(np.diff(angles[3:6]) / 2) ** 3)
    np.testing.assert_allclose(before, after, rtol=0, atol=turn * np.linalg.norm(along))
    chords = np.diff(vertices[3:6], axis=0)
    units = chords / np.linalg.norm(chords, axis=1)[:, None]
    assert turn < np.linalg.norm(units[1] - units[0]) / 10  # of the chords themselves
