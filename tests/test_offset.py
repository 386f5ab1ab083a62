"""Walls along their normals: closed forms, sides that would meet, derivatives against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import ball, blocks, circle, lattice, naca
from oracles import jacobian
from runs import all_refused, over

import jaxmorph as jm
from jaxmorph import shapes


def ring(count=60):
    ids = np.arange(count)
    return jm.Facets(circle(count), np.column_stack([ids, np.roll(ids, -1)]))


def section(count=31):
    points = naca(1e-12, 0.4, 0.12, count, last=0.1036)
    loop = np.concatenate([points[:count], points[count:][::-1][1:]])[::-1]
    ids = np.arange(len(loop))
    return jm.Facets(loop, np.column_stack([np.roll(ids, -1), ids]))


@over("wall", [ring()], nightly=[jm.Facets(*ball(80))])
def test_a_ball_grows_and_shrinks_no_farther_than_its_middle(wall):
    points = np.asarray(wall.points)
    outward = float(jnp.sum(wall.normals()[0] * points[0]))
    shape = shapes.Offset(wall, np.full(len(points), outward))
    radius = lambda height: np.linalg.norm(np.asarray(shape(points, height)), axis=1)  # noqa: E731
    np.testing.assert_array_equal(shape(points, shape.neutral()), points)
    np.testing.assert_allclose(radius(3.0), 4.0, rtol=1e-12)
    np.testing.assert_allclose(radius(-0.4), 0.6, rtol=1e-12)  # below half of 0.9: all the way
    np.testing.assert_allclose(
        radius(-0.8), 1 - 0.9 * (0.5 + 0.5 * np.tanh(2 * 0.8 / 0.9 - 1)), rtol=1e-9
    )
    assert (radius(-100.0) > 0.0999).all()


@pytest.mark.nightly
def test_the_sides_of_an_airfoil_do_not_meet():
    wall = section()
    points = np.asarray(wall.points)
    inward = -np.sign(float(jnp.sum(wall.normals()[10] * points[10])))
    thin = np.asarray(shapes.Offset(wall, share=0.8)(points, np.full(len(points), 0.2 * inward)))
    assert np.ptp(thin[:, 1]) < 0.5 * np.ptp(points[:, 1])
    x, y = thin.T
    upper = np.argsort(x)[points[np.argsort(x), 1] > 1e-9]
    lower = np.argsort(x)[points[np.argsort(x), 1] < -1e-9]
    where = np.linspace(0.1, 0.95, 30)
    assert (np.interp(where, x[upper], y[upper]) > np.interp(where, x[lower], y[lower])).all()


@pytest.mark.nightly
def test_two_walls_across_a_gap_keep_some_of_it():
    x = np.linspace(0, 1, 21)
    points = np.concatenate([np.column_stack([x, 0 * x]), np.column_stack([x, 0.1 + 0 * x])])
    ids = np.arange(20)
    lower, upper = np.column_stack([ids, ids + 1]), np.column_stack([ids + 22, ids + 21])
    wall = jm.Facets(points, np.concatenate([lower, upper]))
    ahead = np.where(points[:, 1] > 0, -1, 1) * np.asarray(wall.normals())[:, 1]
    moved = np.asarray(shapes.Offset(wall)(points, 5.0 * ahead))
    np.testing.assert_allclose(moved[:21, 1], 0.045, rtol=1e-6)
    np.testing.assert_allclose(moved[21:, 1], 0.055, rtol=1e-6)


@pytest.mark.nightly
def test_heights_are_smoothed_as_a_smoother_does():
    wall, rng = ring(), np.random.default_rng(0)
    heights = 1e-3 * rng.normal(size=60)
    smoothed = shapes.Smoother(np.asarray(wall.points), wall.faces, 0.3).apply(
        np.column_stack([heights, heights])
    )[:, 0]
    moved = shapes.Offset(wall, length=0.3)(wall.points, heights)
    np.testing.assert_allclose(moved, wall.points + smoothed[:, None] * wall.normals(), atol=1e-15)


@pytest.mark.nightly
def test_a_border_stays_in_its_plane():
    half = circle(41)[:21]
    half[[0, -1], 1] = 0
    wall = jm.Facets(half, np.column_stack([np.arange(20), np.arange(1, 21)]))
    sign = float(jnp.sum(wall.normals()[5] * half[5]))
    shape = shapes.Offset(wall, np.full(21, sign), symmetry=jm.Plane([0.0, 1.0], [0.0, 0.0]))
    moved = np.asarray(shape(half, 0.1))
    assert (moved[[0, -1], 1] == 0).all()
    np.testing.assert_allclose(moved[[0, -1], 0], half[[0, -1], 0] * 1.1, rtol=1e-2)


@pytest.mark.slow
def test_derivatives_equal_differences():
    """Also where heights are limited, and with respect to the wall."""
    wall, rng = section(), np.random.default_rng(0)
    shape, heights = (
        shapes.Offset(wall, length=0.05),
        0.05 * np.cos(5 * np.arange(len(wall.points))),
    )
    weights, ways = (
        rng.normal(size=wall.points.shape),
        (rng.normal(size=wall.points.shape), rng.normal(size=heights.shape)),
    )
    value = jax.jit(
        lambda h, k: jnp.sum(weights * shape(wall.points + h * ways[0], heights + k * ways[1]))
    )
    by_wall, by_heights = jax.grad(value, argnums=(0, 1))(0.0, 0.0)
    assert float(by_wall) == pytest.approx(
        float(jacobian(lambda h: value(h, 0.0), 0.0, 4e-8)), rel=1e-6
    )
    assert float(by_heights) == pytest.approx(
        float(jacobian(lambda k: value(0.0, k), 0.0, 8e-5)), rel=1e-8
    )


def test_what_is_refused():
    wall = ring(12)
    all_refused(
        (lambda: shapes.Offset(wall, np.zeros(5)), "`field` has shape"),
        (lambda: shapes.Offset(wall, share=1.5), "`share` must be"),
        (lambda: shapes.Offset(wall)(wall.points, 0.1), "this shape needs"),
    )


@over("wall", [ring()], nightly=[jm.Facets(*ball(40))], ids=["curve", "surface"])
@over("wrong", [0], nightly=[-1, slice(0, 9)], ids=["first", "last", "nine"])
def test_the_sense_of_most_of_the_area_wins(wall, wrong):
    """Faces that are listed the other way round turn no wall inside out, wherever they stand."""
    faces = np.array(wall.faces)
    faces[wrong] = faces[wrong][..., ::-1]
    assert (
        np.sum(np.asarray(jm.Facets(wall.points, faces).normals()) * wall.normals(), axis=1).min()
        > 0.99
    )


def test_a_tie_of_senses_goes_by_place():
    points, faces = np.array([[0, 0], [1, 0], [2, 0.0]]), np.array([[0, 1], [2, 1]])
    up = np.asarray(jm.Facets(points, faces).normals())
    np.testing.assert_array_equal(jm.Facets(points, faces[::-1]).normals(), up)
    np.testing.assert_array_equal(jm.Facets(points[::-1], 2 - faces).normals(), up[::-1])


@pytest.mark.nightly
def test_quads_of_equal_diagonals_are_cut_by_place():
    """On a bent lattice of squares, however nodes, faces and their first corners are numbered."""
    points = lattice(np.arange(5.0), np.arange(6.0))
    height = np.random.default_rng(0).normal(size=30)
    quads = blocks(np.arange(30).reshape(5, 6))
    bent = np.column_stack([points, 0 * height])
    x = np.column_stack([points + 0.5, height])[:12]
    facets = jm.Facets(bent, quads)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        order = rng.permutation(30)
        first = (rng.integers(4, size=20)[:, None] + np.arange(4)) % 4
        turned = np.take_along_axis(quads, first, axis=1)[rng.permutation(20)]
        other = jm.Facets(bent[order], np.argsort(order)[turned])
        lifted = facets.at(bent + height[:, None] * [0, 0, 1])
        again = other.at((bent + height[:, None] * [0, 0, 1])[order])
        np.testing.assert_allclose(again.normals(), np.asarray(lifted.normals())[order], atol=1e-12)
        np.testing.assert_allclose(again.closest(x), lifted.closest(x), atol=1e-12)
