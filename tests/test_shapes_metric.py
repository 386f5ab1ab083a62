"""The Sobolev metric of a wall: its norm, symmetry, derivatives, and steps that a finer wall does not multiply."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import ball, circle
from oracles import jacobian
from runs import refusals
from scipy.optimize import minimize

import jaxmorph as jm
from jaxmorph import shapes

AXIS = jm.Plane([0, 1], [0, 0])


def ring(count=40, radius=2.0):
    ids = np.arange(count)
    return jm.Facets(radius * circle(count), np.column_stack([ids, np.roll(ids, -1)]))


def arc(count=30):
    """A half circle whose ends stand on the axis."""
    angle = np.pi * np.arange(count + 1) / count
    ids = np.arange(count)
    points = np.column_stack([np.cos(angle), np.sin(angle)])
    points[[0, -1], 1] = 0
    return jm.Facets(points, np.column_stack([ids, ids + 1]))


def norm_of(wall, h, length):
    """The mean of h^2 + length^2 |grad h|^2, edge by edge or triangle by triangle; masses are lumped."""
    points, faces = np.asarray(wall.points), np.asarray(wall.faces)
    total = mass = 0.0
    for ids in faces:
        sides = points[ids[1:]] - points[ids[0]]
        metric = sides @ sides.T
        size = np.sqrt(np.linalg.det(metric)) / (1 if len(sides) == 1 else 2)
        slope = h[ids[1:]] - h[ids[0]]
        squared = slope @ np.linalg.solve(metric, slope)
        total += size * (np.mean(h[ids] ** 2) + length**2 * squared)
        mass += size
    return total / mass


WALLS = {"ring": ring(), "arc": arc(), "ball": jm.Facets(*ball(200))}


@pytest.mark.parametrize("name", WALLS)
@pytest.mark.parametrize("length", [0.0, 0.7])
def test_the_length_of_the_variables_is_the_sobolev_norm_of_the_heights(name, length):
    wall = WALLS[name]
    metric = shapes.SobolevMetric(wall, length)
    q = np.random.default_rng(0).normal(size=len(wall.points))
    h = np.asarray(metric.heights(q))
    np.testing.assert_allclose(norm_of(wall, h, length), q @ q, rtol=1e-11)
    x = np.asarray(wall.points)
    normals = np.asarray(wall.normals())
    np.testing.assert_allclose(metric(x, q), x + h[:, None] * normals, atol=1e-13)
    np.testing.assert_array_equal(metric(x, metric.neutral()), x)


def test_the_steepest_step_is_the_sobolev_gradient():
    """On a circle a wave's gradient shrinks by 1 + l^2 k^2, with the discrete k."""
    wall, length = ring(), 0.7
    metric = shapes.SobolevMetric(wall, length)
    edge = np.linalg.norm(wall.points[1] - wall.points[0])
    for wave in (0, 1, 5, 20):
        g = np.cos(2 * np.pi * wave * np.arange(40) / 40)
        step = metric.heights(jax.vjp(metric.heights, metric.neutral())[1](jnp.asarray(g))[0])
        factor = 1 + length**2 * (2 - 2 * np.cos(2 * np.pi * wave / 40)) / edge**2
        np.testing.assert_allclose(step, 40 * g / factor, atol=1e-10)  # a mean over 40 nodes


def test_derivatives_batches_and_single_precision():
    wall = WALLS["arc"]
    metric, x = shapes.SobolevMetric(wall, 0.5, symmetry=AXIS, held=[7]), np.asarray(wall.points)
    q, g = np.random.default_rng(0).normal(size=(2, len(x)))
    along = lambda t: metric(x, q + t * g)  # noqa: E731
    np.testing.assert_allclose(
        jax.jacfwd(along)(0.0), jacobian(along, 0.0, 1e-3), rtol=1e-7, atol=1e-9
    )
    back = jax.grad(lambda q: jnp.sum(metric(x, q) ** 2))(jnp.asarray(q))
    slope = jax.jvp(lambda q: jnp.sum(metric(x, q) ** 2), (q,), (g,))[1]
    np.testing.assert_allclose(back @ g, slope, rtol=1e-12)
    both = jax.jit(jax.vmap(lambda q: metric(x, q)))(np.stack([q, g]))
    np.testing.assert_allclose(both[1], metric(x, g), atol=1e-13)
    assert metric(x.astype(np.float32), q).dtype == np.float32
    np.testing.assert_array_equal(np.asarray(metric(x, q))[7], x[7])


def test_the_border_stays_on_its_plane():
    wall = WALLS["arc"]
    leaning = jnp.asarray(wall.points) @ jnp.array([[1.0, 0.0], [0.5, 1.0]])
    wall = jm.Facets(leaning, wall.faces)
    q = np.random.default_rng(0).normal(size=len(wall.points))
    free = np.asarray(shapes.SobolevMetric(wall, 0.5)(wall.points, q))
    kept = np.asarray(shapes.SobolevMetric(wall, 0.5, symmetry=AXIS)(wall.points, q))
    np.testing.assert_array_equal(kept[[0, -1], 1], 0)
    assert np.abs(free[[0, -1], 1]).min() > 1e-3
    np.testing.assert_allclose(kept[1:-1], free[1:-1], atol=1e-14)


def test_nodes_at_one_place_stay_together():
    """A ring that is cut at a node, as a wall at a sharp trailing edge may be, moves as the whole one."""
    whole = ring()
    points = np.concatenate([np.asarray(whole.points), np.asarray(whole.points)[:1]])
    ids = np.arange(40)
    cut = jm.Facets(points, np.column_stack([ids, ids + 1]))
    metric = shapes.SobolevMetric(cut, 0.5)
    q = np.random.default_rng(0).normal(size=40)
    assert metric.neutral().shape == (40,)
    h = np.asarray(metric.heights(q))
    assert h.shape == (41,)
    assert h[40] == h[0]
    np.testing.assert_allclose(norm_of(whole, h[:40], 0.5), q @ q, rtol=1e-11)


def test_heights_do_not_depend_on_the_numbering():
    wall, length = WALLS["ball"], 0.4
    g = np.random.default_rng(0).normal(size=len(wall.points))
    order = np.random.default_rng(1).permutation(len(g))
    place = np.argsort(order)
    other = jm.Facets(np.asarray(wall.points)[order], place[np.asarray(wall.faces)])

    def step(wall, g):
        heights = shapes.SobolevMetric(wall, length).heights
        return np.asarray(heights(jax.vjp(heights, jnp.zeros(len(g)))[1](jnp.asarray(g))[0]))

    np.testing.assert_allclose(step(other, g[order]), step(wall, g)[order], atol=1e-11)


def test_a_finer_wall_takes_no_more_steps():
    """Of a smooth load and a stretched membrane, by BFGS; single nodes' heights need more with every refinement."""

    def steps(count, length):
        wall = ring(count)
        heights = shapes.SobolevMetric(wall, length).heights
        edge = 4 * np.sin(np.pi / count)
        load = np.exp(np.cos(2 * np.pi * np.arange(count) / count))

        @jax.jit
        @jax.value_and_grad
        def energy(q):
            h = heights(q)
            slope = (jnp.roll(h, -1) - h) / edge
            return jnp.mean(0.5 * slope**2 + 0.1 * h**2 - load * h)

        found = minimize(energy, np.zeros(count), jac=True, method="BFGS", options={"gtol": 1e-4})
        return found.nit

    assert steps(96, 1.0) <= steps(24, 1.0) + 1
    assert steps(96, 0.0) > 2 * steps(96, 1.0)


test_bad_input_is_refused = refusals(
    (lambda wall: shapes.SobolevMetric(wall, -1.0), "length"),
    (lambda wall: shapes.SobolevMetric(wall, 0.1, held=[40]), "held"),
    (lambda wall: shapes.SobolevMetric(wall, 0.1).heights(np.zeros(3)), "q"),
    (
        lambda wall: shapes.SobolevMetric(wall, 0.1, symmetry=jm.Plane([0, 1, 0], [0, 0, 0])),
        "the wall is in 2-D, a plane in 3-D",
    ),
    of=lambda: (ring(),),
)
