"""Periodic patches: nodes of a pair move alike, a sector moves as the whole wheel would, and pairs that are none."""

import numpy as np
import pytest
from cases import few, full
from laws import check_base_derivative, check_linear, check_parts, check_steps
from meshes import joined, lattice, sector, turn
from runs import over

import jaxmorph as jm
from benchmarks import faults

TPS = full(jm.ThinPlateSpline(), 1)
LOCAL = jm.SurfaceReconstruction(few(), jm.NearWall(width=0.2))


@over("dimension", slow=[2], nightly=[3])
def test_a_sector_moves_as_the_whole_wheel(dimension):
    """The field between all four sectors is known: the one that moves the sides of the quarter is it."""
    points, moving, fixed, sides, u = sector(dimension)
    plan = jm.prepare(
        points, moving, fixed, method=TPS, periodic=joined(dimension, sides, copies=2)
    )
    moved = np.asarray(jm.deform(plan, u))
    everything, all_moving, all_fixed, (first, _), all_u = sector(dimension, whole=True)
    expected = np.asarray(
        jm.deform(jm.prepare(everything, all_moving, all_fixed, method=TPS), all_u)
    )[first]
    np.testing.assert_allclose(moved[sides[0]], expected, rtol=0, atol=1e-11)
    assert np.abs(moved - points)[plan.guided].max() > 1e-3


@over("dimension method", [(2, TPS)], slow=[(3, TPS)], nightly=[(2, LOCAL)])
def test_laws_with_periodic_sides(dimension, method, tmp_path):
    points, moving, fixed, sides, u = sector(dimension)
    plan = jm.prepare(points, moving, fixed, method=method, periodic=joined(dimension, sides))
    moved = np.asarray(jm.deform(plan, u))
    np.testing.assert_allclose(
        moved[sides[1]], moved[sides[0]] @ turn(np.pi / 2, dimension).T, rtol=0, atol=3e-15
    )
    np.testing.assert_allclose(moved[moving], points[moving] + u, rtol=0, atol=1e-16)
    assert (moved[fixed] == points[fixed]).all()
    assert set(plan.guided.tolist()) == set(np.concatenate(sides)) - {*moving, *fixed}
    other = check_linear(plan, u)  # a motion that is not periodic is made so
    first, second = ((points + other)[side] for side in sides)
    np.testing.assert_allclose(second, first @ turn(np.pi / 2, dimension).T, atol=1e-13)
    jm.save(tmp_path / "plan.npz", plan)
    assert (jm.deform(jm.load(tmp_path / "plan.npz"), u) == moved).all()


@over("dimension method", nightly=[(2, LOCAL), (2, TPS), (3, TPS)])
def test_derivatives_by_the_base_with_periodic_sides(dimension, method):
    points, moving, fixed, sides, u = sector(dimension)
    plan = jm.prepare(points, moving, fixed, method=method, periodic=joined(dimension, sides))
    v = np.random.default_rng(0).normal(size=u.shape)

    def alike(step):
        step[sides[1]] = step[sides[0]] @ turn(np.pi / 2, dimension).T
        return step

    check_base_derivative(plan, v, alike)


@pytest.mark.nightly
def test_steps_and_parts_of_a_periodic_mesh():
    points, moving, fixed, sides, u = sector(2)
    boundary = jm.Boundary(points, moving, fixed, periodic=joined(2, sides))
    plan = jm.prepare(boundary, method=TPS)
    for end in check_steps(plan, np.stack([u, 3 * u])):
        np.testing.assert_allclose(
            end[sides[1]], end[sides[0]] @ turn(np.pi / 2, 2).T, rtol=0, atol=1e-14
        )
    check_parts(boundary, plan, u, size=6)


@pytest.mark.nightly
def test_two_directions_and_a_plane():
    """A box repeated along x and y, mirrored in z: corners are in two pairs, and all that repeat each other move alike."""
    axes = np.linspace(0, 1, 5)
    points = lattice(axes, axes, axes)
    centre = np.abs(points - np.array([0.5, 0.5, 0.0])).max(axis=1) <= 0.26
    moving, fixed = np.flatnonzero(centre), np.flatnonzero(points[:, 2] == 1)
    ends = [[np.flatnonzero(points[:, axis] == side) for side in (0, 1)] for axis in range(2)]
    pairs = [jm.Periodic(*ends[0], translation=(1, 0, 0)), jm.Periodic(*ends[1])]
    plane = jm.Plane([0, 0, 1], [0, 0, 0])
    plan = jm.prepare(points, moving, fixed, method=TPS, periodic=pairs, symmetry=plane)
    u = np.broadcast_to([0.05, 0.02, 0.03], (len(moving), 3)).copy()
    u[points[moving, 2] == 0, 2] = 0
    d = np.asarray(jm.deform(plan, u)) - points
    assert np.abs(d[plan.guided]).max() > 1e-3
    for first, second in ends:
        np.testing.assert_allclose(d[first], d[second], rtol=0, atol=1e-15)
    assert (d[points[:, 2] == 0, 2] == 0).all()
    with pytest.raises(ValueError, match="must be parallel to the translation"):
        jm.prepare(
            points,
            moving,
            fixed,
            method=TPS,
            periodic=pairs,
            symmetry=jm.Plane([1, 0, 0], [0, 0, 0]),
        )


@pytest.mark.nightly
def test_a_blade_turns_farther_between_periodic_sides():
    mesh = faults.cascade(around=80, layers=16, first_cell=1e-2, periodic=True)
    blade = np.asarray(mesh.points)[mesh.patch("blade")]
    u = np.asarray(jm.shapes.rotate(blade, np.radians(15), about=(0.5, 0))) - blade
    method, ends = full(jm.WendlandC2(2.0), None), ("inlet", "outlet")
    held = jm.prepare(mesh, "blade", (*ends, "lower", "upper"), method=method)
    plan = jm.prepare(mesh, "blade", ends, method=method, periodic=jm.Periodic("lower", "upper"))
    before, after = (
        jm.quality(mesh, jm.deform(each, u)).min_jacobian_ratio for each in (held, plan)
    )
    assert after > before + 0.1
    assert not jm.inspect(plan, u, mesh=mesh).crossings


@over("method", slow=[jm.RBF.classic(jm.WendlandC2(1.0))], nightly=[jm.CompactRBF(1.0)])
def test_where_an_image_stands_on_a_node_the_node_counts(method):
    """A wall's image falls on another wall, but for the digits of a file: the field is that of places that coincide."""

    def deformed(off):
        points = lattice(*[np.arange(6) / 5] * 2)
        low, high, left = points[:, 1] == 0, points[:, 1] == 1, points[:, 0] < 0.5
        points[high & left, 1] += off
        pairs = jm.Periodic(np.flatnonzero(low & ~left), np.flatnonzero(high & ~left))
        moving, fixed = np.flatnonzero(low & left), np.flatnonzero(high & left)
        plan = jm.prepare(points, moving, fixed, periodic=pairs, method=method)
        u = 0.05 * np.stack([0 * points[moving, 0], np.sin(6 * points[moving, 0])], axis=1)
        return np.asarray(jm.deform(plan, u)) - points

    exact = deformed(0)
    assert 0.04 < np.abs(exact).max() < 0.051
    np.testing.assert_allclose(deformed(3e-12), exact, rtol=0, atol=1e-9)
