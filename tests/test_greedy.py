"""The greedy reduction: SciPy judges its sources."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

import jaxmorph as jm


@pytest.fixture(scope="module")
def sphere():
    points = np.random.default_rng(0).normal(size=(400, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


@pytest.fixture(scope="module")
def motions(sphere):
    """Two that bend the sphere, one of them in a small part of it alone."""
    x, _, z = sphere.T
    wide, narrow = [0 * x, np.sin(3 * x), x**2], [0 * x, 0 * x, np.exp(-20 * (1 - z))]
    return np.stack([np.stack(wide, axis=1), np.stack(narrow, axis=1)])


def missed(points, sources, motions):
    values = np.concatenate(list(motions), axis=1)
    spline = RBFInterpolator(points[sources], values[sources], kernel="thin_plate_spline", degree=1)
    return np.abs(spline(points) - values).max()


def test_motions_are_met_better_than_by_boxes(sphere, motions):
    boxes = jm.KDTree(16)(sphere)
    chosen = jm.Greedy(len(boxes), motions)(sphere)
    assert len(chosen) == len(set(chosen)) == len(boxes)
    assert missed(sphere, chosen, motions) < missed(sphere, boxes, motions) / 3


def test_one_by_one_each_source_is_where_those_before_miss_most(sphere, motions):
    before, after = (
        set(jm.Greedy(count, motions, group=0.0, separation=0.0)(sphere)) for count in (20, 21)
    )
    assert before < after
    values, sources = np.concatenate(list(motions), axis=1), sorted(before)
    spline = RBFInterpolator(sphere[sources], values[sources], kernel="thin_plate_spline", degree=1)
    assert {int(np.abs(spline(sphere) - values).max(axis=1).argmax())} == after - before


def test_it_ends_at_the_tolerance(sphere, motions):
    bound = 0.02 * np.abs(motions).max()
    chosen = jm.Greedy(400, motions, tolerance=0.02)(sphere)
    assert len(chosen) < 120
    assert missed(sphere, chosen, motions) <= bound
    assert missed(sphere, jm.Greedy(len(chosen) // 2, motions)(sphere), motions) > bound


def test_order_does_not_matter(sphere, motions):
    order = np.random.default_rng(1).permutation(len(sphere))
    first, again = jm.Greedy(30, motions)(sphere), jm.Greedy(30, motions[:, order])(sphere[order])
    assert set(first) == set(order[again])


def test_a_flat_surface_and_two_points(sphere, motions):
    assert len(jm.Greedy(20, motions)(sphere * [1, 1, 0])) == 20
    assert jm.Greedy(4, np.ones((1, 2, 2)))(np.array([[0.0, 0], [1, 0]])).tolist() == [0, 1]


def test_a_plan_with_it_moves_as_told(sphere, motions):
    far = 4 * sphere[::10]
    points = np.concatenate([sphere, far, 2 * sphere[:50]])
    moving, fixed = np.arange(400), np.arange(400, 440)
    method = jm.SurfaceReconstruction(jm.RBF(reduction=jm.Greedy(40, motions)), jm.DelaunayGraph())
    moved = np.asarray(jm.deform(jm.prepare(points, moving, fixed, method=method), motions[0]))
    np.testing.assert_allclose(moved[moving], sphere + motions[0], atol=1e-15)


def test_a_plan_chooses_by_the_motions_of_its_own_nodes(sphere, motions):
    """Rows of `motions` are those of `moving`, in whatever order a plan lays out its surface."""
    order = np.random.default_rng(1).permutation(400)
    reduction = jm.Greedy(40, motions[:, order])
    points = np.concatenate([sphere[order], 4 * sphere[::10]])
    plan = jm.prepare(
        points, np.arange(400), np.arange(400, 440), method=jm.RBF(reduction=reduction)
    )
    chosen = plan.sources[plan.sources < 400]
    np.testing.assert_array_equal(np.sort(chosen), reduction(sphere[order]))


def test_motions_of_other_points(sphere):
    with pytest.raises(ValueError, match="there are 400 points in 3"):
        jm.Greedy(3, np.ones((1, 7, 3)))(sphere)
