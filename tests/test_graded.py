"""Sources of the fixed boundary by its distance from the moving one, and sources near a symmetry plane."""

import numpy as np
import pytest
from meshes import circle, on_circle
from runs import over
from scipy.spatial.distance import cdist, pdist

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases


@pytest.mark.parametrize("share", [0.1, 0.25, 0.6])
def test_all_points_are_within_their_share(share):
    """Brute force: the nearest chosen point of each, over its distance from the other boundary."""
    others = 0.5 * circle(400)[::20]
    points = np.concatenate([20.0 * circle(400), 0.8 * circle(400) + np.array([0.1, 0.0])])
    chosen = jm.Graded(share, separation=0.0).beside(points, others)
    away = cdist(points, others)
    apart = cdist(others, others) + 1e9 * np.eye(len(others))
    room = np.maximum(away.min(axis=1), apart.min(axis=1)[away.argmin(axis=1)])
    nearest = cdist(points, points[chosen]).min(axis=1)
    assert (nearest <= share * room * (1 + 1e-12)).all()
    inner = (chosen >= 400).sum()
    assert inner > 0.5 * len(chosen)  # where the boundary is near


def test_a_far_field_keeps_sixteen_however_far_and_fine():
    for radius, count in ((10, 100), (50, 400), (500, 2000)):
        assert len(jm.Graded().beside(radius * circle(count), 0.5 * circle(400)[::10])) == 16


def test_fewer_than_by_boxes_on_a_wing_s_far_field():
    mesh = cases.wing(points=1000, stations=7)
    wall, far = mesh.points[mesh.patch("wing")], mesh.points[mesh.patch("farfield")]
    sources = wall[jm.KDTree(16)(wall)]
    assert 6 < len(jm.Graded().beside(far, sources)) < len(jm.KDTree(16)(far))


def test_limits_order_and_hardly_any_points():
    others = 0.5 * circle(400)[::20]
    points = np.random.default_rng(0).normal(size=(300, 2))
    order = np.random.default_rng(1).permutation(300)
    first, shuffled = (
        jm.Graded().beside(points, others),
        jm.Graded().beside(points[order], others[::-1]),
    )
    assert set(first) == set(order[shuffled])
    assert len(jm.Graded(most=7).beside(points, others)) == 7
    wide = points[jm.Graded(separation=0.1).beside(points, others)]
    assert pdist(wide).min() > 0.1 * np.linalg.norm(np.ptp(points, axis=0))
    for count in (0, 1, 2):
        few = np.arange(2.0 * count).reshape(count, 2)
        assert jm.Graded().beside(few, np.zeros((1, 2))).tolist() == list(range(count))
    assert len(jm.Graded()(3.0 * circle(400))) < 20


def turned_in_steps(mesh, fixed_reduction, degrees):
    """The cascade's blade turned about its middle in five steps: smallest corner Jacobian relative to the one before."""
    method = jm.RBF.classic()
    if fixed_reduction is not None:
        coarse = jm.RBF(reduction=jm.KDTree(64, extremes=True), fixed_reduction=fixed_reduction)
        method = jm.SurfaceReconstruction(coarse)
    plan = jm.prepare(mesh, "blade", ["inlet", "outlet", "upper", "lower"], method=method)
    z = (mesh.points[mesh.patch("blade")] - [0.5, 0.08]) @ np.array([1, 1j])
    steps = [z * (np.exp(1j * np.deg2rad(degrees * k / 5)) - 1) for k in range(1, 6)]
    path = np.stack([np.column_stack([step.real, step.imag]) for step in steps])
    return jm.quality(mesh, jm.march(plan, path)[1])


@pytest.mark.nightly
def test_a_cascade_turns_as_far_as_with_every_source():
    mesh = faults.cascade()
    few, graded, classic = (
        turned_in_steps(mesh, each, -44) for each in (jm.KDTree(16), jm.Graded(), None)
    )
    assert int(few.inverted) > 0
    assert int(classic.inverted) == int(graded.inverted) == 0
    assert float(graded.min_jacobian_ratio) > 0.9 * float(classic.min_jacobian_ratio)


def test_more_leaves_where_another_boundary_is_near():
    wall = 0.5 * circle(400)
    tree = jm.KDTree(2, crowded=9)
    for radius, leaves in ((1.0, 9), (1.49, 9), (1.51, 2), (20.0, 2)):
        assert tree.beside(wall, radius * circle(400)).tolist() == jm.KDTree(leaves)(wall).tolist()
    assert tree(wall).tolist() == jm.KDTree(2)(wall).tolist()


@over(
    "reduction",
    [jm.FarthestPoints(24)],
    nightly=[jm.KDTree(24, extremes=True), jm.KDTree(24, separation=0.02)],
)
def test_a_source_and_its_mirror_image_keep_their_distance(reduction):
    """Half a body, with nodes on the plane and others just above it; all points and images, distances by brute force."""
    angle = np.concatenate(
        [[0, 2e-4, 5e-4, np.pi - 3e-4, np.pi], np.linspace(0.01, np.pi - 0.01, 60)]
    )
    half = on_circle(angle) * [1, 0.4]
    half[np.isin(angle, [0, np.pi]), 1] = 0
    points = np.concatenate([half, 10 * half, [[3.0, 0.0], [2.0, 1.0]]])
    count = len(half)
    method = jm.RBF(reduction=reduction, fixed_reduction=reduction)
    plane = jm.Plane(normal=(0, 1), origin=(0, 0))
    plan = jm.prepare(
        points, np.arange(count), np.arange(count, 2 * count), method=method, symmetry=plane
    )
    sources = np.asarray(plan.surface.points)[np.asarray(plan.surface.ids)]
    assert pdist(sources).min() > min(reduction.closest(half), reduction.closest(10 * half))
    inner = sources[np.linalg.norm(sources, axis=1) < 2]
    assert pdist(inner).min() > reduction.closest(half)
    images = {(round(x, 12), round(-y, 12)) for x, y in inner.tolist()}
    assert images == {(round(x, 12), round(y, 12)) for x, y in inner.tolist()}
    if reduction.separation == 1e-3:  # on the plane, in place of those just above it
        assert {(1.0, 0.0), (-1.0, 0.0)} <= images
