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
@pytest.mark.parametrize(
    "reduction", [jm.FarthestPoints(25, separation=0.0), jm.Greedy(25, separation=0.0)]
)
def test_reach_is_within_twice_the_best(dimension, reduction):
    """k sources and the point farthest from them are k + 1 points that no k discs of half their distance can cover."""
    points = uneven(dimension)
    chosen = reduction(points)
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


def test_extremes_of_a_blunt_edge():
    mesh = cases.naca4("0012", points=3000)
    wall = mesh.points[mesh.patch("airfoil")]
    ends = np.flatnonzero(wall[:, 0] > wall[:, 0].max() - 1e-9)
    corners = ends[[wall[ends, 1].argmin(), wall[ends, 1].argmax()]]
    assert set(corners) <= set(jm.FarthestPoints(12, extremes=True, separation=1e-4)(wall))
    assert not set(corners) <= set(jm.FarthestPoints(12, separation=1e-4)(wall))


def test_few_points_in_one_place_and_extremes():
    assert len(jm.FarthestPoints(3)(np.zeros((5, 3)))) == 1
    assert len(jm.FarthestPoints(2, extremes=True)(uneven(2))) == 2
    np.testing.assert_array_equal(farthest(np.zeros((3, 2)), 2, 0.0, reach=np.zeros(3)), [0])
