"""Large motions of one boundary past another: no cell inverts, and the surface is exact."""

import numpy as np
import pytest
from runs import over

import jaxmorph as jm
from jaxmorph import cases

STORE = {"wing": (-2.0, 2.0, 1.0, 1.5), "store": (-0.5, 0.5, 0.0, 0.5)}
PASSING = {"upper": (-4.0, -3.0, 1.0, 2.0), "lower": (-0.5, 0.5, -2.0, -1.0)}


def least_ratio(mesh, moving, path):
    """The smallest Jacobian ratio at the end of a path on which nothing inverts, and the surface goes where it is sent."""
    nodes = mesh.patch(moving)
    rest = np.setdiff1d(mesh.patch(*mesh.patches), nodes)
    points = np.asarray(jm.march(jm.prepare(mesh, nodes, rest), path)[1])
    np.testing.assert_allclose(points[nodes], mesh.points[nodes] + path[-1], rtol=0, atol=1e-12)
    assert (points[rest] == mesh.points[rest]).all()
    report = jm.quality(mesh, points)
    assert int(report.inverted) == 0
    return float(report.min_jacobian_ratio)


def straight(displacement, steps):
    return np.linspace(0, 1, steps + 1)[1:, None, None] * displacement


@pytest.mark.nightly
def test_a_body_that_is_held_far_away_has_sources_of_its_own():
    """They keep the field from pushing it along once the other body is near: by 0.02 of a step at most."""
    mesh = cases.bodies(PASSING)
    plan = jm.prepare(mesh, "upper", ("lower", "farfield"))
    assert 4 <= np.isin(mesh.patch("lower"), plan.sources).sum() <= 16
    u = np.broadcast_to([0.2, 0.0], (plan.n_moving, 2))
    later = jm.march(plan, straight(np.broadcast_to([3.4, 0.0], u.shape), 17))[0][-1]
    off = np.linalg.norm(np.asarray(later.offset(u)), axis=1)
    assert off[np.isin(np.asarray(later.surface_nodes), mesh.patch("lower"))].max() < 0.02 * 0.2


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("boxes", "moving", "way", "steps", "least"),
    [(PASSING, "upper", (6.0, 0.0), 30, 0.15), (STORE, "store", (0.0, -3.4), 20, 0.05)],
    ids=["passing", "store"],
)
def test_bodies_pass_and_leave(boxes, moving, way, steps, least):
    mesh = cases.bodies(boxes)
    path = straight(np.broadcast_to(way, (len(mesh.patch(moving)), 2)), steps)
    assert least_ratio(mesh, moving, path) > least


@pytest.mark.nightly
def test_horns_of_ice_grow_on_an_airfoil():
    """Two horns, 5 % of the chord high and 2 % wide."""
    mesh = cases.naca0015(points=2000)
    x, y = np.asarray(mesh.points)[mesh.patch("airfoil")].T
    s = np.sign(y) * np.sqrt(np.maximum(x, 0))
    horn = 0.05 * (np.exp(-(((s - 0.12) / 0.03) ** 2)) + 0.6 * np.exp(-(((s + 0.1) / 0.04) ** 2)))
    assert (
        least_ratio(
            mesh, "airfoil", straight(np.stack([-0.8 * horn, 0.6 * np.sign(y) * horn], axis=1), 5)
        )
        > 0.8
    )


@over(
    "degrees centre blend", nightly=[(180.0, 0.25, None), (90.0, 0.7, 0.4)], ids=["pitch", "flap"]
)
def test_a_wide_flap_and_a_half_turn_in_steps(degrees, centre, blend):
    """The flap's angle grows over 0.4 chord around its hinge; the whole airfoil turns on its head."""
    mesh = cases.naca0015(points=1000)
    x, y = np.asarray(mesh.points)[mesh.patch("airfoil")].T
    share = np.ones_like(x) if blend is None else np.clip((x - centre) / blend + 0.5, 0, 1)
    angle = np.deg2rad(degrees) * share**2 * (3 - 2 * share)
    turn = np.exp(-1j * np.linspace(0, 1, 7)[1:, None] * angle[None]) - 1
    path = (x - centre + 1j * y)[None] * turn
    assert least_ratio(mesh, "airfoil", np.stack([path.real, path.imag], axis=-1)) > 0
