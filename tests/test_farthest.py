"""Farthest points: even cover of a surface, by Gonzalez's bound and plain distances."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.sources.farthest import farthest


def uneven(dimension, count=600):
    """A curve or a surface whose nodes are a hundred times denser at one end."""
    rng = np.random.default_rng(dimension)
    t = rng.uniform(0, 1, (count, dimension - 1)) ** 3
    return np.column_stack([t, np.sin(3 * t).sum(axis=1)])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("extremes", [False, True])
def test_reach_is_within_twice_the_best(dimension, extremes):
    """k sources and the point farthest from them are k + 1 points that no k discs of half their distance can cover."""
    points = uneven(dimension)
    chosen = jm.FarthestPoints(25, separation=0.0)(points)
    assert len(chosen) == 25
    reach = cdist(points, points[chosen]).min(axis=1)
    far = np.append(chosen, reach.argmax())
    apart = cdist(points[far], points[far])[np.triu_indices(len(far), 1)]
    assert apart.min() >= reach.max() * (1 - 1e-12)
    boxes = jm.KDTree(25, jm.Centre(), separation=0.0)(points)
    assert reach.max() < cdist(points, points[boxes]).min(axis=1).max() / 1.5


def test_each_is_the_farthest_from_those_before():
    points = uneven(3, 80)
    middle = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(middle.argmax())]
    for count in range(2, 20):
        chosen.append(int(cdist(points, points[chosen]).min(axis=1).argmax()))
        assert set(jm.FarthestPoints(count)(points)) == set(chosen)


@pytest.mark.parametrize("extremes", [False, True])
def test_order_does_not_matter(extremes):
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 3), axis=-1).reshape(-1, 3)  # ties everywhere
    reduction = jm.FarthestPoints(40, extremes=extremes)
    for points in (uneven(2), grid):
        order = np.random.default_rng(0).permutation(len(points))
        first, shuffled = reduction(points), reduction(points[order])
        assert (np.diff(first) > 0).all()
        assert set(map(tuple, points[first])) == set(map(tuple, points[order][shuffled]))


def test_separation_ends_it():
    points = uneven(2)
    chosen = jm.FarthestPoints(400, separation=0.05)(points)
    apart = cdist(points[chosen], points[chosen])[np.triu_indices(len(chosen), 1)]
    least = 0.05 * np.linalg.norm(np.ptp(points, axis=0))
    assert apart.min() > least
    assert cdist(points, points[chosen]).min(axis=1).max() <= least
    assert 10 < len(chosen) < 60


def test_extremes_of_a_blunt_edge():
    mesh = cases.naca4("0012", points=3000)
    wall = mesh.points[mesh.patch("airfoil")]
    ends = np.flatnonzero(wall[:, 0] > wall[:, 0].max() - 1e-9)
    corners = ends[[wall[ends, 1].argmin(), wall[ends, 1].argmax()]]
    assert set(corners) <= set(jm.FarthestPoints(12, extremes=True, separation=1e-4)(wall))
    assert not set(corners) <= set(jm.FarthestPoints(12, separation=1e-4)(wall))


def test_hardly_any_points():
    reduction = jm.FarthestPoints(4, extremes=True)
    for count in (0, 1, 2):
        points = np.arange(2.0 * count).reshape(count, 2)
        assert reduction(points).tolist() == list(range(count))
    assert len(jm.FarthestPoints(3)(np.zeros((5, 3)))) == 1
    assert len(jm.FarthestPoints(2, extremes=True)(uneven(2))) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"count": 0}, "`count` must be a whole number of at least 1, not 0"),
        ({"count": 3, "separation": 1.0}, "`separation` must be a real number of 0 or more and below 1"),
    ],
)
def test_what_makes_no_sense(arguments, message):
    with pytest.raises(ValueError, match=message):
        jm.FarthestPoints(**arguments)


def test_points_in_one_place_without_reach():
    np.testing.assert_array_equal(farthest(np.zeros((3, 2)), 2, 0.0, reach=np.zeros(3)), [0])
