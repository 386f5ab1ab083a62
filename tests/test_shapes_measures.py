"""Measures of walls against closed forms: ellipse, box, sphere; derivatives against differences."""

import jax
import numpy as np
import pytest
from meshes import ball, bricks, write_ring
from oracles import jacobian
from runs import over, refusals
from scipy.spatial import ConvexHull

import jaxmorph as jm
from jaxmorph import cases, shapes

COUNT = 400
ANGLE = 2 * np.pi * np.arange(COUNT) / COUNT
ELLIPSE = np.column_stack([0.5 * np.cos(ANGLE) + 0.5, 0.06 * np.sin(ANGLE)])
LOOP = np.arange(COUNT)
SEGMENTS = np.column_stack([LOOP, np.roll(LOOP, -1)])


BALL, FACES = ball(300)
on = shapes.Stations.on
LINES = shapes.Stations.on(ELLIPSE, SEGMENTS, [[0.25, 0.0], [0.5, 0.0]], [0.0, 1.0])
LINES3 = shapes.Stations.on(BALL, FACES, [[0.1, 0.2, 0.0]], [0.0, 0.1, 1.0])

AXIS = jm.Plane([0, 1], [0, 0])
HALF = ELLIPSE[: COUNT // 2 + 1]  # ends on the axis
ARC = SEGMENTS[: COUNT // 2]

MEASURES = {
    "area of revolution": (
        lambda x: shapes.area_of_revolution(x, ARC, AXIS),
        HALF + np.array([0, 1]),
    ),
    "volume of revolution": (
        lambda x: shapes.volume_of_revolution(x, ARC, AXIS),
        HALF + np.array([0, 1]),
    ),
    "area": (lambda x: shapes.area(x, LOOP), ELLIPSE),
    "centroid": (lambda x: shapes.centroid(x, LOOP), ELLIPSE),
    "chord": (lambda x: shapes.chord(x, 200, [0, 399]), ELLIPSE),
    "thickness": (lambda x: shapes.thickness(x, LINES), ELLIPSE),
    "thickness-3": (lambda x: shapes.thickness(x, LINES3), BALL),
    "volume": (lambda x: shapes.volume(x, FACES), BALL),
}


@over("name", [name for name in MEASURES if name != "thickness-3"], nightly=["thickness-3"])
def test_derivatives_equal_differences(name):
    measure, x = MEASURES[name]
    direction = 0.1 * np.column_stack([np.sin(3 * x[:, k] + k) for k in range(x.shape[1])])
    along = lambda h: measure(x + h * direction)  # noqa: E731
    np.testing.assert_allclose(
        jax.jit(jax.jacfwd(along))(0.0), jacobian(along, 0.0, 2e-4), rtol=1e-7, atol=1e-7
    )


def test_closed_forms_of_an_ellipse():
    """Inscribed polygons have n/(2 pi) sin(2 pi / n) of the ellipse's area."""
    a, b = 0.5, 0.06
    np.testing.assert_allclose(
        shapes.area(ELLIPSE, LOOP), a * b * COUNT / 2 * np.sin(2 * np.pi / COUNT), rtol=1e-13
    )
    np.testing.assert_allclose(
        shapes.area(ELLIPSE, LOOP[::-1]), -shapes.area(ELLIPSE, LOOP), rtol=1e-13
    )
    np.testing.assert_allclose(shapes.centroid(ELLIPSE, LOOP), [0.5, 0], atol=1e-14)
    np.testing.assert_allclose(shapes.chord(ELLIPSE, 200, 0), 1, rtol=1e-14)
    heights = 2 * b * np.sqrt(1 - np.array([0.5, 0]) ** 2)
    np.testing.assert_allclose(shapes.thickness(ELLIPSE, LINES), heights, rtol=1e-4)


def test_volumes_of_boxes_and_balls():
    np.testing.assert_allclose(shapes.volume(BALL, FACES), ConvexHull(BALL).volume, rtol=1e-13)
    half = FACES[(BALL[FACES][:, :, 2] > 0).all(axis=1)]
    with pytest.raises(ValueError, match="the wall is open"):
        shapes.volume(BALL, half)
    with pytest.raises(ValueError, match="does not lie in a plane"):
        shapes.volume(BALL, half, [0, 0, 0])
    mesh = bricks()
    corners = mesh.points * [1.0, 2.0, 3.0]
    outer = np.flatnonzero((mesh.points == 0).any(axis=1) | (mesh.points == 1).any(axis=1))
    whole = type(mesh)(corners, mesh.cells, {"wall": outer})
    faces = list(jm.boundary_faces(whole, "wall").values())
    np.testing.assert_allclose(shapes.volume(corners, faces), 6, rtol=1e-13)
    open_below = [ids[~np.isin(ids, mesh.patches["floor"]).all(axis=1)] for ids in faces]
    np.testing.assert_allclose(shapes.volume(corners, open_below, [0, 0, 0]), 6, rtol=1e-13)


def test_a_wall_that_turns_around_an_axis():
    """Cones, cylinders, a sphere and a torus; whichever way the normal looks, and wherever the axis is."""
    volume, area = shapes.volume_of_revolution, shapes.area_of_revolution
    cone = np.array([[3.0, 0.0], [3.0, 2.0], [0.0, 0.0]])
    sides = np.array([[0, 1], [1, 2]])
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    for normal in ([0.0, 1.0], [0.0, -5.0]):
        axis = jm.Plane(np.array(normal) @ turn, np.array([7.0, 0.0]) @ turn + 1)
        x = cone @ turn + 1
        np.testing.assert_allclose(volume(x, sides, axis), 4 * np.pi, rtol=1e-13)
        np.testing.assert_allclose(volume(x, sides[:, ::-1], axis), -4 * np.pi, rtol=1e-13)
        slant = np.pi * 2 * np.sqrt(13)
        np.testing.assert_allclose(area(x, sides, axis), 4 * np.pi + slant, rtol=1e-13)
    ball = 2 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])[: COUNT // 2 + 1]
    np.testing.assert_allclose(volume(ball, ARC, AXIS), 32 / 3 * np.pi, rtol=1e-4)
    np.testing.assert_allclose(area(ball, ARC, AXIS), 16 * np.pi, rtol=1e-4)
    inner = shapes.area(ELLIPSE, LOOP)
    np.testing.assert_allclose(  # Pappus
        volume(ELLIPSE + np.array([0, 3]), SEGMENTS, AXIS), 2 * np.pi * 3 * inner, rtol=1e-12
    )


def test_a_body_in_a_mesh_has_a_positive_volume_of_revolution():
    mesh = cases.naca0015(points=300)
    upper = mesh.points + np.array([0, 2.0])
    wall = jm.Facets.of(mesh.moved(upper), "airfoil")
    volume = shapes.volume_of_revolution(wall.points, wall.faces, AXIS)
    area = shapes.area(upper, shapes.wall_loop(mesh, "airfoil"))
    np.testing.assert_allclose(volume, 4 * np.pi * area, rtol=1e-6)


def test_the_loop_of_a_patch(tmp_path):
    mesh = write_ring(tmp_path / "ring.su2")
    loop = shapes.wall_loop(mesh, "wall")
    np.testing.assert_allclose(
        shapes.area(mesh.points, loop), 12 * np.sin(2 * np.pi / 24), rtol=1e-13
    )
    with pytest.raises(ValueError, match="is no closed loop: 2 ends"):
        shapes.wall_loop(type(mesh)(mesh.points, mesh.cells, {"part": np.arange(9)}), "part")


def test_thickness_follows_a_moved_wall():
    moved = shapes.scale(ELLIPSE, [1.0, 1.5], [0.0, 0.0])
    np.testing.assert_allclose(
        shapes.thickness(moved, LINES), 1.5 * shapes.thickness(ELLIPSE, LINES), rtol=1e-12
    )


test_bad_input_is_refused = refusals(
    (lambda: shapes.volume_of_revolution(BALL, FACES, AXIS), "a wall in 3-D has a `volume`"),
    (lambda: shapes.area_of_revolution(ELLIPSE, SEGMENTS, AXIS), "both sides of the axis"),
    (lambda: shapes.area_of_revolution(ELLIPSE, FACES, AXIS), r"walls in 2-D have \(k, 2\)"),
    (lambda: shapes.area(BALL, LOOP), "expected"),
    (lambda: shapes.volume(ELLIPSE, FACES), "expected"),
    (
        lambda: on(ELLIPSE, SEGMENTS, [[0.5, 0], [3, 0]], [0, 1]),
        "1 of 2 lines miss the body, first row 1",
    ),
    (lambda: on(ELLIPSE, SEGMENTS, [[0.5, 0]], [0, 0]), "length 0"),
    (lambda: on(ELLIPSE, FACES, [[0.5, 0]], [0, 1]), r"walls in 2-D have \(k, 2\)"),
    (lambda: on(ELLIPSE, SEGMENTS + 1, [[0.5, 0]], [0, 1]), "ids in `faces`"),
    (lambda: shapes.thickness(ELLIPSE[:5], LINES), "are not in 0 to 4"),
    (lambda: shapes.thickness(BALL, LINES), "the stations are in 2-D"),
)
