"""The share of the fit in the default's coarse field, which trial motions of the walls choose."""

import functools

import numpy as np
import pytest

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._methods.shares import KEPT, LARGEST, SHARES, motions, share_of


def with_fit(share):
    return jm.SurfaceReconstruction(jm.FittedRBF(share=share))


@functools.cache
def box_in_circle():
    """An O-grid of quads about a rectangle 5 : 1 with right corners."""
    side = np.linspace(-1, 1, 21)
    long, short = np.linspace(-2.5, 2.5, 41), 0.5 * side[::4]
    wall = np.concatenate(
        [
            np.column_stack([long[:-1], 0 * long[:-1] - 0.5]),
            np.column_stack([0 * short[:-1] + 2.5, short[:-1]]),
            np.column_stack([long[:0:-1], 0 * long[1:] + 0.5]),
            np.column_stack([0 * short[1:] - 2.5, short[:0:-1]]),
        ]
    )
    depth = np.concatenate([[0], np.cumsum(0.01 * 1.3 ** np.arange(20))])[:, None, None]
    far = wall / np.linalg.norm(wall, axis=1)[:, None]
    t = depth / depth[-1]
    points = (1 - t) * wall + t * depth[-1] * far
    ids = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    around = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], ids[1:], around[1:], around[:-1]], axis=-1).reshape(-1, 4)
    return jm.Mesh(points.reshape(-1, 2), {"quad": quads}, {"body": ids[0], "far": ids[-1]})


def ratio(mesh, points):
    """The smallest ratio of a corner's Jacobian after the motion to that before."""
    quads = mesh.cells["quad"]
    corners = [quads[:, [k, (k + 1) % 4, (k + 3) % 4]] for k in range(4)]
    now, before = (
        np.concatenate([np.linalg.det(np.asarray(x)[c[:, 1:]] - np.asarray(x)[c[:, :1]]) for c in corners])
        for x in (points, mesh.points)
    )
    return (now / before).min()


def test_a_share_mixes_the_fit_and_least_squares():
    mesh = box_in_circle()
    u = 0.1 * np.sin(mesh.points[mesh.patch("body")])
    fit, plain, mixed = (
        np.asarray(jm.deform(jm.prepare(mesh, "body", "far", method=with_fit(s)), u)) for s in (1, 0, 0.3)
    )
    np.testing.assert_allclose(mixed, 0.3 * fit + 0.7 * plain, atol=1e-13)
    assert np.abs(fit - plain).max() > 1e-3


def test_a_plan_says_its_share():
    plan = jm.prepare(box_in_circle(), "body", "far")
    share = share_of(plan.method)
    assert share in (*SHARES, 0)
    assert share < 1
    assert f"share {share:g} of the fit" in repr(plan)
    assert share_of(jm.prepare(box_in_circle(), "body", "far", method=with_fit(0.7)).method) == pytest.approx(0.7)


@pytest.mark.slow
def test_the_paper_airfoil_keeps_the_whole_fit():
    assert share_of(jm.prepare(cases.naca0015(), "airfoil", "farfield").method) == 1


@pytest.mark.slow
def test_the_share_is_the_largest_that_keeps_enough():
    """The oracle moves the mesh by each trial, and measures its corners."""
    mesh = box_in_circle()
    chosen = share_of(jm.prepare(mesh, "body", "far").method)
    plans = {s: jm.prepare(mesh, "body", "far", method=with_fit(s)) for s in (*SHARES, 0.0)}
    failed = set()
    for u in motions(mesh.points[mesh.patch("body")], np.zeros(len(mesh.patch("body")), int)):
        for sign in (1, -1):
            low, high = 0.0, LARGEST[2]
            if ratio(mesh, jm.deform(plans[0.0], sign * high * u)) < KEPT:
                while high - low > 1e-4 * high:
                    middle = (low + high) / 2
                    is_kept = ratio(mesh, jm.deform(plans[0.0], sign * middle * u)) >= KEPT
                    low, high = (middle, high) if is_kept else (low, middle)
            least = ratio(mesh, jm.deform(plans[0.0], sign * high * u))
            for share, enough in SHARES.items():
                kept = ratio(mesh, jm.deform(plans[share], sign * high * u))
                assert share > chosen or kept > (enough - 0.01) * least
                failed |= {share} if kept < (enough + 0.01) * least else set()
    assert failed >= {share for share in SHARES if share > chosen}


def test_pieces_choose_the_share_of_the_whole():
    mesh = box_in_circle()
    plan = jm.prepare(mesh, "body", "far")
    boundary = jm.Boundary(mesh, "body", "far")
    for chunk in (jm.prepare_surface(boundary).plan, next(jm.prepare_in_chunks(boundary, size=300))[1]):
        assert share_of(chunk.method) == share_of(plan.method)
    alone = jm.Boundary(mesh.points, mesh.patch("body"), mesh.patch("far"))
    half = jm.prepare_surface(alone, faces=jm.boundary_faces(mesh))
    assert share_of(half.plan.method) is None
    pieces = []
    for quads in np.array_split(mesh.cells["quad"], 3):
        nodes, rows = np.unique(quads, return_inverse=True)
        pieces.append((jm.Mesh(mesh.points[nodes], {"quad": rows.reshape(quads.shape)}), nodes))
    assert share_of(half.judged(pieces).plan.method) == share_of(plan.method)


@pytest.mark.parametrize("share", [-0.1, 1.5, np.nan, "half"])
def test_a_share_is_from_zero_to_one(share):
    with pytest.raises(ValueError, match="share"):
        jm.FittedRBF(share=share)
