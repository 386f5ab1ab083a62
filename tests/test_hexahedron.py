"""Boxes between any corners: places in them, weights, derivatives; and a wall's normals."""

import itertools
import math

import jax
import numpy as np
import pytest
from oracles import jacobian
from runs import over, refusals

from jaxmorph import cases, shapes

CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]]
)
BENT = CUBE * [2, 3, 4] + 0.3 * np.random.default_rng(0).normal(size=(8, 3))
LEANING = np.array([[0, 0], [2, 0.1], [1.8, 1], [0.1, 1.2]])


def inside(corners, t):
    """Places in a box of known coordinates: corners weighted by the lengths to the opposite sides."""
    d = corners.shape[1]
    near = {2: [(0, 0), (1, 0), (1, 1), (0, 1)], 3: [tuple(map(int, corner)) for corner in CUBE]}[d]
    shares = [
        np.prod([t[:, a] if bit else 1 - t[:, a] for a, bit in enumerate(bits)], axis=0)
        for bits in near
    ]
    return sum(share[:, None] * corner for share, corner in zip(shares, corners, strict=True))


@over("corners", [LEANING], slow=[BENT], ids=["2-D", "3-D"])
def test_nodes_follow_bernstein_polynomials_of_their_place(corners):
    d, rng = corners.shape[1], np.random.default_rng(1)
    counts = (4, 3, 2)[:d]
    box = shapes.Hexahedron(corners, counts)
    t, control = rng.uniform(size=(40, d)), rng.normal(size=(*counts, d))
    x = inside(corners, t)
    np.testing.assert_allclose(box.coordinates(x), t, atol=1e-12)
    expected = np.zeros_like(x)
    for place in itertools.product(*map(range, counts)):
        weights = [math.comb(n - 1, k) * t[:, a] ** k * (1 - t[:, a]) ** (n - 1 - k)
                   for a, (k, n) in enumerate(zip(place, counts, strict=True))]  # fmt: skip
        expected += np.prod(weights, axis=0)[:, None] * control[place]
    np.testing.assert_allclose(box(x, control) - x, expected, atol=1e-12)
    np.testing.assert_allclose(box.lattice()[(-1,) * d], corners[2 if d == 2 else 6], atol=1e-14)
    np.testing.assert_array_equal(box.given_corners, corners)


@pytest.mark.nightly
def test_a_box_with_parallel_edges_is_free_form():
    rng = np.random.default_rng(2)
    x, control = rng.uniform(-1, 5, (60, 3)), rng.normal(size=(3, 4, 2, 3))
    box = shapes.Hexahedron(CUBE * [2, 3, 4], (3, 4, 2), degree=(2, 2, 1))
    other = shapes.FreeForm([0, 0, 0], np.diag([2.0, 3, 4]), (3, 4, 2), degree=(2, 2, 1))
    np.testing.assert_allclose(box(x, control), other(x, control), atol=1e-13)
    np.testing.assert_array_equal(box(x, box.neutral()), x)
    outside = ((x < 0) | (x > [2, 3, 4])).any(axis=1)
    assert outside.sum() > 10
    np.testing.assert_array_equal(np.asarray(box(x, control))[outside], x[outside])


@pytest.mark.nightly
def test_derivatives_by_positions_are_differences():
    rng, box = np.random.default_rng(3), shapes.Hexahedron(BENT, (3, 2, 2))
    x, control = inside(BENT, rng.uniform(0.1, 0.9, (3, 3))), rng.normal(size=(3, 2, 2, 3))
    way = rng.normal(size=x.shape)
    along = lambda h: box(x + h * way, control)  # noqa: E731
    np.testing.assert_allclose(jax.jacfwd(along)(0.0), jacobian(along, 0.0, 1e-3), atol=1e-8)
    far = np.concatenate([x, 100 * x])
    assert np.isfinite(jax.grad(lambda x: box(x, control).sum())(far)).all()


test_corners_that_are_no_box_are_told = refusals(
    (lambda: shapes.Hexahedron(CUBE[:7], (2, 2, 2)), "shape"),
    (lambda: shapes.Hexahedron(CUBE[[0, 2, 1, 3, 4, 5, 6, 7]], (2, 2, 2)), "inside out"),
    (lambda: shapes.Hexahedron(CUBE * [1, 1, 0], (2, 2, 2)), "flat"),
    (lambda: shapes.Hexahedron(LEANING[[0, 2, 1, 3]], (2, 2)), "inside out"),
)


def test_normals_of_an_airfoil_are_across_its_neighbours():
    mesh = cases.naca0015(points=800)
    nodes, loop = mesh.patch("airfoil"), shapes.wall_loop(mesh, "airfoil")
    x = np.asarray(mesh.points)[loop]
    along = (np.roll(x, -1, axis=0) - np.roll(x, 1, axis=0)) / 2
    expected = np.column_stack([along[:, 1], -along[:, 0]])[np.argsort(loop)]
    np.testing.assert_allclose(shapes.wall_normals(mesh, "airfoil"), expected, atol=1e-15)
    np.testing.assert_array_equal(np.sort(loop), nodes)
