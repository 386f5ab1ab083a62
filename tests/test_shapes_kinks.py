"""Derivatives where a shape has a border, a kink or a foot to find: at ends of boxes, lines and chords, and of second order."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import naca
from oracles import jacobian
from runs import over

from jaxmorph import shapes

STEP = 1e-6


def directional(function, x, inward):
    """Derivative towards the inside by a one-sided difference of second order."""
    f0, f1, f2 = (np.asarray(function(x + k * STEP * inward)) for k in range(3))
    return (-3 * f0 + 4 * f1 - f2) / (2 * STEP)


def check_border(function, x, inward):
    """The derivative at a border is that of the inside, and round-off on either side changes it little."""
    x, inward = np.asarray(x, float), np.asarray(inward, float)
    expected = directional(function, x, inward)
    for place in (x, np.nextafter(x, x - 1), np.nextafter(x, x + 1)):
        slope = jax.jvp(function, (jnp.asarray(place),), (jnp.asarray(inward),))[1]
        np.testing.assert_allclose(slope, expected, atol=2e-8)
    # not a difference of zeros
    assert np.abs(expected - inward).max() > 1e-3


BOXES = {"bernstein": ((3, 4, 3), None), "bspline": ((5, 6, 4), 2)}


@over("name", ["bspline"], nightly=["bernstein"])
def test_the_border_of_a_box_has_the_derivative_of_its_inside(name):
    counts, degree = BOXES[name]
    box = shapes.FreeForm([0.0, 0.0, 0.0], np.eye(3), counts, degree=degree)
    control = 0.1 * np.random.default_rng(0).normal(size=(*counts, 3))
    move = jax.jit(lambda x: box(x, control))
    for axis, end in itertools.product(range(3), (0.0, 1.0)):
        x, inward = np.full((1, 3), 0.37), np.zeros((1, 3))
        x[0, axis], inward[0, axis] = end, 1 - 2 * end
        check_border(move, x, inward)


@pytest.mark.nightly
def test_what_is_far_from_a_box_has_finite_derivatives():
    box = shapes.FreeForm([0.0, 0.0], np.eye(2), (13, 3))
    slope = jax.jacfwd(lambda x: box(x, np.ones((13, 3, 2))))(
        jnp.array([[1e40, 0.5], [-1e40, 1e40]])
    )
    np.testing.assert_array_equal(slope, np.eye(4).reshape(2, 2, 2, 2))


AXIS = shapes.ReferenceAxis([[0.25, 0, 0], [0.45, 1, 0.1], [0.75, 2, 0.2]])
CUBIC = shapes.ReferenceAxis(AXIS.points, cubic=True)
PLANFORM = {
    "twist": np.array([0.3, -0.2, 0.4]),
    "chord": np.array([1.2, 0.8, 0.5]),
    "sweep": np.array([0.1, 0.2, 0.5]),
}


@over(
    "move x inward",
    [
        (lambda x: AXIS(x, PLANFORM), [[0.7, 0, 0.1]], [[0, 1, 0]]),
        (lambda x: shapes.twist(x, 0.5, [0, 0, 0], [0, 1, 0], 2.0), [[0.7, 0, 0.1]], [[0, 1, 0]]),
        (lambda x: shapes.bend(x, 0.5, [0, 0], [1, 0], 2.0), [[2.0, 0.3]], [[-1, 0]]),
        (lambda x: shapes.CST(2)(x, [0.1, 0.2, -0.1, 0.05]), [[1.0, 0.01]], [[-1, 0]]),
    ],
    nightly=[
        (lambda x: AXIS(x, PLANFORM), [[0.7, 2, 0.1]], [[0, -1, 0]]),
        (lambda x: CUBIC(x, PLANFORM), [[0.7, 0, 0.1]], [[0, 1, 0]]),
        (lambda x: shapes.twist(x, 0.5, [0, 0, 0], [0, 1, 0], 2.0), [[0.7, 2, 0.1]], [[0, -1, 0]]),
        (lambda x: shapes.bend(x, 0.5, [0, 0], [1, 0], 2.0), [[0.0, 0.3]], [[1, 0]]),
        (lambda x: shapes.CST(2, (1.0, 1.5))(x, [0.1, 0.2, -0.1, 0.05]), [[0.0, 0.01]], [[1, 0]]),
    ],
)
def test_ends_of_lines_have_the_derivative_of_their_inside(move, x, inward):
    check_border(jax.jit(move), x, inward)


@pytest.mark.nightly
def test_the_whole_naca_family_is_exact_at_its_nodes():
    """555 sections with camber, each with a blunt and a sharp trailing edge; 12 whose nodes have several feet are refused."""
    codes = itertools.product(range(1, 10), range(1, 10), (6, 9, 12, 15, 18, 21, 24))
    every = [(camber / 100, place / 10, thickness / 100) for camber, place, thickness in codes]
    family = [given for given in every if given[0] * given[2] < 1.25 * given[1] ** 2]
    assert (len(every), len(family)) == (567, 555)
    for given in set(every) - set(family):
        with pytest.raises(ValueError, match="bends within the thickness"):
            shapes.NACA4(*given)
    shape, last = shapes.NACA4(0.02, 0.4, 0.12), (0.1015, 0.1036)
    replaced = lambda original: eqx.tree_at(lambda it: it.original, shape, original)  # noqa: E731
    move = jax.jit(jax.vmap(lambda original, x, p: replaced(original)(x, p), (0, 0, None)))
    for edge, other in ((last[0], (0.04, 0.4, 0.15)), (last[1], (0.02, 0.6, 0.09))):
        sections = np.stack([naca(*given, count=41, last=edge) for given in family])
        moved = move(np.array(family), sections, np.array(other))
        expected = np.broadcast_to(naca(*other, count=41, last=edge), moved.shape)
        np.testing.assert_allclose(moved, expected, atol=1e-12)


@pytest.mark.nightly
def test_second_derivatives_of_naca_are_differences_of_the_first():
    shape, x = shapes.NACA4(0.04, 0.4, 0.12), naca(0.04, 0.4, 0.12, count=13)
    x = x[
        (np.abs(x[:, 0] - 0.4) > 0.02) & (x[:, 0] > 0.01)
    ]  # the mean line's second derivative jumps at its crest
    weights = np.random.default_rng(0).normal(size=x.shape)

    def measure(numbers):
        place, parameters = x + numbers[:2][None, :], jnp.array([0.05, 0.45, 0.1]) + numbers[2:]
        return jnp.sum(weights * jnp.sin(3 * shape(place, parameters)))

    start = np.zeros(5)
    differences = jacobian(jax.jit(jax.grad(measure)), start, 1e-4)
    np.testing.assert_allclose(
        jax.jit(jax.hessian(measure))(start), differences, rtol=1e-6, atol=1e-6
    )


@pytest.mark.nightly
def test_round_off_changes_no_station():
    x = naca(0.0, 0.4, 0.12, count=9, last=0.1036)[:-1]
    wall = np.concatenate([np.arange(9)[::-1], np.arange(9, 16)])
    segments = np.stack([wall, np.roll(wall, -1)], axis=1)
    lines = x[[2, 3, 4]] * [1, 0]  # each through two nodes
    stations = shapes.Stations.on(x, segments, lines, [0.0, 1.0])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        noisy = np.nextafter(x, rng.choice([-np.inf, np.inf], x.shape))
        np.testing.assert_array_equal(
            shapes.Stations.on(noisy, segments, lines, [0.0, 1.0]).faces, stations.faces
        )
        with pytest.raises(ValueError, match="1 of 1 lines miss"):
            shapes.Stations.on(
                noisy, segments, [[noisy[8, 0], 0.0]], [0.0, 1.0]
            )  # touches the sharp tail


def test_a_box_turned_by_a_right_angle_is_mirrored():
    turned = np.array([[np.cos(np.pi / 2), 1.0], [-1.0, np.cos(np.pi / 2)]])
    for mirror in (0, 1):
        box = shapes.FreeForm([0.0, 0.0], turned, (3, 3)).linked(mirror=mirror)
        exact = shapes.FreeForm([0.0, 0.0], np.round(turned), (3, 3)).linked(mirror=mirror)
        np.testing.assert_array_equal(box.matrix, exact.matrix)
