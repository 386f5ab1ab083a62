"""The walls that sliding nodes stay on: nearest points in closed form, and by a search over all faces."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import blocks, lattice
from scipy.interpolate import CubicSpline

from jaxmorph._boundary.face_search import FaceSearch
from jaxmorph._boundary.tracks import Track
from jaxmorph._boundary.walls import Flat, OnFaces, Round
from jaxmorph._host.surface.gaps import closest

ROWS = np.arange(12)
AXIS, ORIGIN = np.array([0.6, 0.0, 0.8]), np.array([1.0, -2.0, 0.5])


def cylinder_coordinates(x):
    """Places along the axis, and radii about it."""
    along = (x - ORIGIN) @ AXIS
    return along, np.linalg.norm(x - ORIGIN - along[:, None] * AXIS, axis=1)


def straight(axis, origin, slope, radius):
    return Round(axis, origin, np.array([0, np.inf]), np.array([[0.0], [0.0], [slope], [radius]]))


def start(d):
    return jnp.asarray(np.random.default_rng(d).normal(size=(12, d)) + 2)


def test_a_circle():
    wall, x = straight(np.zeros(2), ORIGIN[:2], 0, 3), start(2)
    projected = np.asarray(Track(ROWS, (wall,)).project(x))
    arm = np.asarray(x) - ORIGIN[:2]
    np.testing.assert_allclose(
        projected, ORIGIN[:2] + 3 * arm / np.linalg.norm(arm, axis=1)[:, None], rtol=1e-14
    )
    np.testing.assert_allclose(
        wall.distance(x), np.abs(np.linalg.norm(arm, axis=1) - 3), rtol=1e-13
    )
    assert not wall.has_end(np.asarray(x)).any()
    assert wall.at(x) is wall


def test_a_cone_is_reached_along_its_normal():
    a, b = -0.28, 0.96
    wall, x = straight(AXIS, ORIGIN, -a / b, 1.5 / b), start(3)
    projected = np.asarray(Track(ROWS, (wall,)).project(x))
    along, radius = cylinder_coordinates(projected)
    np.testing.assert_allclose(a * along + b * radius, 1.5, rtol=1e-13)
    before = np.stack(cylinder_coordinates(np.asarray(x)), axis=1)
    way = np.stack([along, radius], axis=1) - before
    np.testing.assert_allclose(way, (1.5 - before @ [a, b])[:, None] * [a, b], rtol=0, atol=1e-13)


def test_a_profile_and_a_plane_at_once():
    """The profile's cubic is a spline of itself; a node where both walls meet is on both."""
    knots = np.linspace(-1, 6, 8)
    spline = CubicSpline(knots, 2 + 0.01 * knots**3)
    wall = Round(AXIS, ORIGIN, spline.x, spline.c)
    plane = Flat(np.array([0.8, 0.0, -0.6]), ORIGIN + 0.3)
    for walls in ((wall,), (wall, plane)):
        projected = np.asarray(Track(ROWS, walls).project(start(3)))
        along, radius = cylinder_coordinates(projected)
        np.testing.assert_allclose(radius, 2 + 0.01 * along**3, rtol=1e-12)
    np.testing.assert_allclose((projected - ORIGIN - 0.3) @ [0.8, 0.0, -0.6], 0, atol=1e-12)
    ends = ORIGIN + np.array([-1.1, 0.0, 6.1])[:, None] * AXIS
    assert wall.has_end(ends).tolist() == [True, False, True]


def faceted(d):
    """A bent strip: a line of 6 pieces in 2-D, 2 x 3 quads cut into triangles in 3-D."""
    if d == 2:
        t = np.linspace(0, 2, 7)
        vertices, faces = (
            np.stack([t, np.sin(2 * t)], axis=1),
            np.stack([np.arange(6), np.arange(1, 7)], axis=1),
        )
    else:
        s, t = lattice(np.linspace(0, 1, 3), np.linspace(0, 2, 4)).T
        vertices, quads = (
            np.stack([s, t, np.sin(2 * t) + s**2], axis=1),
            blocks(np.arange(12).reshape(3, 4)),
        )
        faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return OnFaces(FaceSearch.of(np.arange(len(vertices)), vertices, faces))


@pytest.mark.parametrize("d", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_faces_are_reached_at_their_nearest_point(d):
    """It is that of a search over all faces, with weights of their corners."""
    wall = faceted(d)
    vertices, faces = np.asarray(wall.own.vertices), np.asarray(wall.own.faces)
    x = np.concatenate(
        [vertices[:7] + 0.1 * np.random.default_rng(0).normal(size=(7, d)), vertices]
    )
    places, normals = (
        np.asarray(each) for each in eqx.filter_jit(wall.own.closest)(jnp.asarray(x))
    )
    chosen, weights, nearest = closest(vertices[faces], x)
    np.testing.assert_allclose(np.linalg.norm(x - places, axis=1), nearest, rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        places, np.einsum("kc,kcd->kd", weights, vertices[faces][chosen]), rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-13)
    assert (np.asarray(wall.at(jnp.asarray(vertices + 5.0)).own.vertices) == vertices + 5.0).all()
    assert wall.has_end(np.stack([vertices[0], vertices[faces[0]].mean(axis=0)])).tolist() == [
        True,
        False,
    ]
    order = np.argsort(wall.renumbered(np.arange(len(vertices))[::-1]).own.nodes)
    assert (order == np.arange(len(vertices))[::-1]).all()
