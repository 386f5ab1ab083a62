"""Multiscale interpolation: against the substitution written out, its radii, its reach, symmetry, and nodes that coincide."""

import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few, motion, planned, surface_values, whole_and_part
from runs import over

import jaxmorph as jm
from jaxmorph._host.sources.hierarchy import farthest_first


def wendland(x):
    return np.where(x < 1, (1 - x) ** 4 * (4 * x + 1), 0)


def by_hand(surface, sources, values, points):
    """The method as the paper tells it: the node farthest from those before gets a function for what they leave of its value."""
    field, left = np.zeros((len(points), values.shape[1])), values.copy()
    before = list(sources)
    while True:
        gap = np.linalg.norm(surface[:, None] - surface[before], axis=2).min(axis=1)
        node = gap.argmax()
        if gap[node] == 0:
            return field
        coefficient = left[node].copy()
        left -= wendland(np.linalg.norm(surface - surface[node], axis=1) / gap[node])[:, None] * coefficient
        field += wendland(np.linalg.norm(points - surface[node], axis=1) / gap[node])[:, None] * coefficient
        before.append(node)


@pytest.mark.parametrize("dimension", [2, pytest.param(3, marks=pytest.mark.nightly)])
def test_as_the_paper_tells_it(dimension):
    mesh = body(dimension)
    plan, coarse_plan = planned(mesh, jm.SurfaceReconstruction(few(), jm.Multiscale())), planned(mesh, few())
    u, values = surface_values(mesh)
    coarse = np.asarray(jm.deform(coarse_plan, u)) - mesh.points
    missed = values - coarse[mesh.boundary]
    order, sources = np.asarray(plan.images.rows), np.asarray(coarse_plan.surface.ids)  # a method's rows go by place
    missed, surface = missed[order], mesh.points[mesh.boundary][order]
    missed[sources] = 0
    expected = mesh.points + coarse + by_hand(surface, sources, missed, mesh.points)
    np.testing.assert_allclose(jm.deform(plan, u), expected, rtol=0, atol=1e-12)


def test_order_and_radii_on_a_line():
    """Nine nodes between two that are there: halves, quarters, eighths; so are the radii."""
    points = np.column_stack([np.linspace(0, 8, 9), np.zeros(9)])
    order, nearest = farthest_first(points, np.array([0, 8]), np.arange(9))
    radius = np.linalg.norm(points - points[nearest], axis=1)
    assert order[0] == 4
    assert set(order[1:3]) == {2, 6}
    np.testing.assert_array_equal(radius, [0, 1, 2, 1, 4, 1, 2, 1, 0])


def test_the_order_does_not_depend_on_the_unit():
    points = np.random.default_rng(0).normal(size=(60, 3))
    none, own = np.zeros(0, dtype=np.int64), np.arange(60)
    order, nearest = farthest_first(points, none, own)
    for size in (2.0**-20, 2.0**20):
        again = farthest_first(size * points, none, own)
        assert (again[0] == order).all()
        assert (again[1] == nearest).all()


def test_nothing_moves_beyond_the_radii():
    """A bump of one node between sources: points farther from it than from the next node before stay where they are."""
    x = np.linspace(0, 1, 9)
    wall, lid = np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 1])
    rng = np.random.default_rng(0)
    points = np.concatenate([wall, lid, rng.uniform(size=(200, 2)) * [1, 0.4]])
    coarse = jm.RBF(reduction=jm.AllPoints(), fixed_reduction=jm.AllPoints())
    method = jm.SurfaceReconstruction(Every(coarse), jm.Multiscale())
    plan = jm.prepare(points, np.arange(9), np.arange(9, 18), method=method)
    u = np.zeros((9, 2))
    u[3, 1] = 0.1  # the others are sources
    away = np.linalg.norm(points - wall[3], axis=1)
    moved = np.asarray(jm.deform(plan, u)) - points
    near = away < 0.125
    assert 4 < near.sum() < 30
    assert (moved[~near] == 0).all()
    np.testing.assert_allclose(moved[near, 1], 0.1 * wendland(away[near] / 0.125), atol=1e-15)


class Every(jm.AbstractMethod):
    """A coarse field that rests, and whose sources are all nodes of the surface but the fourth."""

    inner: jm.AbstractMethod

    def connect(self, surface, points):
        return self.inner.connect(surface, points)

    def fit(self, ids, surface, points):
        return self.inner.fit(ids, surface, points)

    def field(self, ids, factors, surface, u):
        return self.inner.field(ids, factors, surface, jnp.zeros_like(u))

    def control(self, ids):
        return jm.Control(matched=np.delete(np.sort(np.asarray(ids)), 3))


@over("method", slow=[jm.Multiscale()], nightly=[jm.Multiscale.whole(1.0, 0.2)], ids=["alone", "whole"])
def test_mirror_images_move_alike(method):
    """The field of the whole surface, images included, is symmetric: nodes on the plane have no motion across it."""
    part, role, *_ = whole_and_part(2, 1)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    plan = jm.prepare(part, moving, fixed, method=method, symmetry=jm.Plane([1, 0], [0, 0]))
    u = motion(part)[moving]
    u[part[moving, 0] == 0, 0] = 0
    surface = plan.surface
    own = jnp.zeros((len(surface.nodes), 2)).at[: len(moving)].set(u)
    field = plan.method.field(surface.ids, surface.factors, surface.points, surface.images.vectors(own))
    displacement = np.asarray(field.evaluate(plan.points, plan.volume.placed))
    on = part[:, 0] == 0
    assert (on & (role == 0)).sum() > 3
    assert np.abs(displacement[on & (role == 0), 1]).max() > 1e-3
    np.testing.assert_allclose(displacement[on, 0], 0, atol=1e-14)


@pytest.mark.slow
def test_nodes_that_coincide():
    """A cut of two nodes at each place, which stays closed or opens a little: each goes where it is told."""
    mesh = body(2)
    points = np.concatenate([mesh.points, mesh.points[mesh.moving[:5]]])
    moving = np.concatenate([mesh.moving, len(mesh.points) + np.arange(5)])
    u = motion(points[moving])
    u[-5:] += 1e-3
    plan = jm.prepare(points, moving, mesh.fixed, method=jm.SurfaceReconstruction(few(), jm.Multiscale()))
    moved = np.asarray(jm.deform(plan, u))
    assert (moved[moving] == points[moving] + u).all()
    assert np.isfinite(moved).all()
    assert np.abs(moved - points).max() < 0.2


@pytest.mark.nightly
def test_steps_along_a_path_keep_the_field():
    """A turn in steps: the correction goes on standing on the undeformed mesh, with coefficients that fit it."""
    mesh = body(2)
    plan = planned(mesh, jm.SurfaceReconstruction(few(), jm.Multiscale()))
    u = motion(mesh.points[mesh.moving])
    path = np.stack([0.4 * u, u])
    plans, points = jm.march(plan, path)
    np.testing.assert_allclose(jm.replay(plans, path), points, rtol=0, atol=1e-13)
    correction = plans[1].surface.factors[2]
    np.testing.assert_array_equal(correction.squared, plan.surface.factors[2].squared)
    assert np.isfinite(points).all()
