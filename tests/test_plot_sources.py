"""Pictures of sources and boxes, and the error on the surface, against SciPy and what the reductions give."""

import functools

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
from runs import refusals
from scipy.spatial import cKDTree

import jaxmorph as jm
from jaxmorph import plot

pytestmark = pytest.mark.usefixtures("closed_figures")


def circle(radius, n, half=False):
    angles = np.linspace(0, np.pi, n) if half else np.linspace(0, 2 * np.pi, n, endpoint=False)
    points = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points[np.abs(points) < 1e-12] = 0
    return points


@functools.cache
def planned(method=None, half=False):
    """Two rings and points between them, or half of each above a symmetry plane: 40 moving, 30 fixed."""
    rings = [circle(radius, n, half) for radius, n in ((1, 40), (6, 30), (2, 20), (4, 20))]
    method = method or jm.SurfaceReconstruction.published(4, 2)
    plane = jm.Plane((0, 1), (0, 0)) if half else ()
    return jm.prepare(
        np.concatenate(rings), np.arange(40), np.arange(40, 70), method=method, symmetry=plane
    )


def drawn(axis, name):
    (line,) = [line for line in axis.lines if name in line.get_label()]
    return np.column_stack([line.get_xdata(), line.get_ydata()])


def ball(n=200):
    points = np.random.default_rng(0).normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_a_plan_shows_its_own_sources():
    plan = planned()
    points = np.asarray(plan.points)
    parts = [(points[:40], jm.KDTree(4)), (points[40:70], jm.KDTree(2))]
    expected = np.concatenate([points[reduction(points)] for points, reduction in parts])
    axis = plot.sources(plan, fixed=True)
    np.testing.assert_array_equal(
        np.sort(drawn(axis, "sources"), axis=0), np.sort(expected, axis=0)
    )
    np.testing.assert_array_equal(drawn(axis, "nodes"), plan.points[:70])
    assert "6 leaves" in axis.get_legend_handles_labels()[1]
    assert len(drawn(plot.sources(plan), "sources")) <= 16


@pytest.mark.nightly
def test_sources_of_a_plan_with_a_symmetry_plane_are_its_own_nodes():
    plan = planned(half=True)
    shown = drawn(plot.sources(plan, fixed=True), "sources")
    distance, nodes = cKDTree(plan.points[:70]).query(shown)
    assert distance.max() == 0
    assert len(np.unique(nodes)) == len(shown)
    wall = np.asarray(plan.points[:40])
    assert cKDTree(shown).query(wall[jm.KDTree(4)(wall)])[0].max() == 0


def test_window_and_given_axis():
    given = plt.subplots()[1]
    assert plot.sources(planned(), window=((-2.0, 2.0), (-1.0, 1.0)), ax=given) is given
    assert given.get_xlim() == (-2, 2)


test_what_is_refused = refusals(
    (lambda: plot.sources(planned(jm.DelaunayGraph())), "no radial basis functions"),
    (lambda: plot.sources(planned(), jm.KDTree(3)), "own reductions"),
    (lambda: plot.sources(planned().points), "need a `reduction`"),
    (lambda: plot.sources(ball(), jm.KDTree(3)), "points in 2-D"),
)
