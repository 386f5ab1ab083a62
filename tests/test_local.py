"""The correction of Rendall and Allen: against its formula written out, and its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few, motion, moved_by, planned, surface_values
from runs import over

import jaxmorph as jm
from jaxmorph import shapes
from jaxmorph._methods.corrections import LocalFactors
from jaxmorph._methods.sparse import Reach


def by_hand(mesh, values, radius):
    """Displacements (n, d): each point takes that of its nearest boundary node, times Wendland's function of the distance."""
    apart = np.linalg.norm(mesh.points[:, None] - mesh.points[mesh.boundary][None], axis=2)
    nearest = apart.argmin(axis=1)
    x = np.minimum(apart.min(axis=1) / radius[nearest], 1)
    return ((1 - x) ** 4 * (4 * x + 1))[:, None] * values[nearest]


@over("dimension", [2], nightly=[3])
def test_alone_it_is_its_formula(dimension):
    mesh = body(dimension)
    u, values = surface_values(mesh)
    plan = planned(mesh, jm.LocalCorrection(2.0))
    expected = mesh.points + by_hand(mesh, values, np.full(len(values), 2.0))
    np.testing.assert_allclose(jm.deform(plan, u), expected, rtol=0, atol=1e-12)
    assert plan.reach == pytest.approx(2.0)


def test_it_carries_what_a_reduced_field_misses_as_far_as_the_sources_are_apart():
    mesh = body(2)
    u, values = surface_values(mesh)
    coarse_plan = planned(mesh, few())
    coarse = np.asarray(jm.deform(coarse_plan, u)) - mesh.points
    radius = []
    for wall in (mesh.moving, mesh.fixed):
        own = mesh.points[np.intersect1d(coarse_plan.sources, wall)]
        gaps = np.linalg.norm(mesh.points[wall][:, None] - own[None], axis=2).min(axis=1)
        radius.append(np.full(len(wall), gaps.max()))
    moved = moved_by(mesh, jm.SurfaceReconstruction(few(), jm.LocalCorrection()), u)
    expected = mesh.points + coarse + by_hand(mesh, values - coarse[mesh.boundary], np.concatenate(radius))
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_nothing_is_corrected_where_every_node_is_a_source():
    """The radius is zero there: so are weights and derivatives, on the node and off it."""
    nodes = Reach(jnp.zeros(1, int), jnp.ones(1, bool))

    def weight(x, radius, surface):
        return jm.LocalCorrection().place(x, nodes, LocalFactors(radius, jnp.array(True)), surface).weights.sum()

    for x in np.eye(2):
        value, slopes = jax.value_and_grad(weight, (0, 1, 2))(jnp.asarray(x), jnp.zeros(1), jnp.asarray([[1.0, 0.0]]))
        assert value == 0
        assert all((slope == 0).all() for slope in slopes)


@pytest.mark.nightly
def test_beyond_the_layer_of_near_wall_it_is_what_moves():
    mesh, alone = body(2), jm.LocalCorrection(2.0)
    u = motion(mesh.points[mesh.moving])
    expected, moved = (moved_by(mesh, method, u) for method in (alone, jm.NearWall(alone, width=0.1)))
    apart = np.linalg.norm(mesh.points[:, None] - mesh.points[mesh.boundary][None], axis=2).min(axis=1)
    np.testing.assert_allclose(moved[apart > 0.1], expected[apart > 0.1], rtol=0, atol=1e-14)
    assert np.abs(moved - expected).max() > 1e-4


@over("correction", [jm.Multiscale()], nightly=[jm.LocalCorrection(0.5)])
def test_points_beyond_the_hull_of_the_boundary_are_moved(correction):
    """A graph would refuse them."""
    points = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    inner = np.flatnonzero(np.abs(points).max(axis=1) < 0.7)
    plan = jm.prepare(points, inner, method=jm.SurfaceReconstruction(few(1), correction))
    turn = np.asarray(shapes.rotate(jnp.asarray(points), 0.3, (0.0, 0.0))) - points
    np.testing.assert_allclose(jm.deform(plan, turn[inner]), points + turn, rtol=0, atol=1e-10)
