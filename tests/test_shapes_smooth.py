"""Smoothing along walls: closed forms on circles and tori, symmetry, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import blocks, bricks, circle, lattice
from runs import refusals

from jaxmorph import shapes


def closed(count=40, radius=2.0):
    ids = np.arange(count)
    return radius * circle(count), np.column_stack([ids, np.roll(ids, -1)])


@pytest.mark.parametrize("wave", [0, 1, 5, 20])
def test_waves_on_a_circle_shrink_by_the_discrete_eigenvalue(wave):
    """(M + l^2 K) v = M u on equal segments of length h: u = cos(k a) shrinks by 1 + l^2 (2 - 2 cos(2 pi k / n)) / h^2."""
    points, segments = closed()
    h, length = np.linalg.norm(points[1] - points[0]), 0.7
    u = np.cos(2 * np.pi * wave * np.arange(40) / 40)[:, None] * [[1.0, -2.0]]
    factor = 1 + length**2 * (2 - 2 * np.cos(2 * np.pi * wave / 40)) / h**2
    smoother = shapes.Smoother(points, segments, length)
    np.testing.assert_allclose(smoother.apply(u), u / factor, atol=1e-12)
    np.testing.assert_allclose(smoother.sensitivities(u), u / factor, atol=1e-12)  # equal masses


@pytest.mark.parametrize("size", [3, 4])
def test_waves_on_a_plane_of_squares(size):
    """Linear triangles on a square grid make the five-point Laplacian; four corner triangles of a quad the mean of two of them."""
    n = 12
    points = lattice(np.arange(n + 1.0), np.arange(n + 1.0), [0.0])
    ids = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    quads = blocks(ids)
    faces = quads if size == 4 else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    u = np.cos(np.pi * points[:, 0] / n)[:, None] * [[1.0, 0.5, 0]]  # no slope at the free border
    factor = 1 + 9 * (2 - 2 * np.cos(np.pi / n))
    smoother = shapes.Smoother(points, faces, 3.0)
    if size == 4:
        np.testing.assert_allclose(smoother.apply(u), u / factor, atol=1e-12)
    inner = ids[4:-4, 4:-4].ravel()
    np.testing.assert_allclose(np.asarray(smoother.apply(u))[inner], u[inner] / factor, atol=0.01)


def test_the_transpose_and_derivatives():
    points, segments = closed()
    points = points * [1, 0.3]
    smoother, rng = shapes.Smoother(points, segments, 0.5, held=[0, 7]), np.random.default_rng(0)
    u, g = rng.normal(size=(2, 40, 2))
    smooth, back = np.asarray(smoother.apply(u)), smoother.sensitivities(g)
    np.testing.assert_allclose(np.vdot(smooth, g), np.vdot(u, back), rtol=1e-12)
    np.testing.assert_array_equal(smooth[[0, 7]], 0)
    np.testing.assert_allclose(
        jax.grad(lambda u: jnp.vdot(smoother.apply(u), g))(jnp.asarray(u)), back, atol=1e-13
    )
    np.testing.assert_allclose(
        jax.jvp(smoother.apply, (u,), (g,))[1], smoother.apply(g), atol=1e-13
    )
    several = jax.jit(jax.vmap(smoother.apply))(np.stack([u, g, u - g]))
    np.testing.assert_allclose(several[2], smooth - smoother.apply(g), atol=1e-13)
    np.testing.assert_array_equal(smoother(points, smoother.neutral()), points)
    np.testing.assert_allclose(smoother(points, u), points + smooth, atol=1e-15)


def test_length_zero_changes_nothing_and_constants_stay():
    mesh = bricks()
    for length in (0.0, 0.8):
        smoother = shapes.Smoother.on(mesh, "floor", length)
        np.testing.assert_allclose(smoother.apply(np.ones((16, 3))), 1, atol=1e-13)
    u = np.random.default_rng(0).normal(size=(16, 3))
    np.testing.assert_allclose(shapes.Smoother.on(mesh, "floor", 0.0).apply(u), u, atol=1e-14)


test_bad_input_is_refused = refusals(
    (lambda p, s: shapes.Smoother(p, s + 1, 1.0), "ids in `faces` are not in 0 to 39"),
    (lambda p, s: shapes.Smoother(p, s[:-2], 1.0), "1 nodes are in no face, first row 39"),
    (lambda p, s: shapes.Smoother(p[np.append(0, np.arange(39))], s, 1.0), "1 faces have no size"),
    (lambda p, s: shapes.Smoother(p, np.ones((4, 3), int), 1.0), "have"),
    (lambda p, s: shapes.Smoother(p, s, 1.0).at(p[:3]), "is for positions"),
    of=closed,
)
