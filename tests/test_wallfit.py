"""The default's coarse field follows the body: what the fit is, and what becomes of boundary layers."""

import functools
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, motion
from meshes import circle

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases
from jaxmorph._host.surface.skin import (
    behind_tips,
    beside_tips,
    chords,
    edges,
    sharp_tips,
    thinned,
)


@functools.cache
def airfoil(code):
    """A small C-grid with its plan, the places of its wall nodes, and which are on the upper side."""
    mesh = cases.naca4(code, points=3000, first_cell=1e-6)
    wall = mesh.patch("airfoil")
    columns = (
        mesh.cells["quad"][0, 3] - 1
    )  # nodes come from the lower trailing edge round the nose to the upper one
    along = columns - 2 * wall[0] + 1
    upper = np.zeros(len(wall), dtype=bool)
    upper[along // 2 + 1 : along] = True
    return mesh, jm.prepare(mesh, "airfoil", "farfield", method=None), mesh.points[wall], upper


def up(base, height):
    return np.column_stack([0 * base[:, 0], height])


def with_cells(mesh, method):
    """Prepares the body with its cells: points alone are not fitted."""
    cells = jm.Mesh(mesh.points, {"triangle": mesh.cells})
    return jm.prepare(
        cells, mesh.moving, mesh.fixed, method=method, free=np.arange(len(mesh.points))
    )


def judged(mesh, points):
    report = jm.quality(mesh, points)
    return int(report.inverted), float(report.min_jacobian_ratio)


@pytest.mark.nightly
def test_the_fit_is_the_least_of_its_sum():
    """The sum of squares in the docstring, written out with derivatives of the field by JAX, has no slope at the answer."""
    mesh, ell, mu = body(2), 0.2, 0.15
    method = jm.FittedRBF(
        jm.RBF(reduction=jm.KDTree(2), fixed_reduction=jm.KDTree(1)),
        ell=jnp.asarray(ell),
        mu=jnp.asarray(mu),
    )
    plan = with_cells(mesh, method)
    ids, factors, surface = plan.surface.ids, plan.surface.factors, plan.surface.points
    u = jnp.zeros_like(surface).at[: plan.n_moving].set(motion(mesh.points[mesh.moving]))
    # the affine motion that fits the surface's displacement best takes no part
    terms = np.column_stack([np.ones(len(surface)), surface])
    affine = np.linalg.lstsq(terms, np.asarray(u), rcond=None)[0]
    rest = u - terms @ affine
    first, second = edges(np.asarray(surface), plan.n_moving).T
    middle, along = (surface[first] + surface[second]) / 2, surface[second] - surface[first]
    length = jnp.linalg.norm(along, axis=1)[:, None]
    far = np.linalg.norm(
        np.asarray(middle)[:, None] - np.asarray(surface)[None, plan.n_moving :], axis=2
    ).min(axis=1)
    reach = jnp.minimum(ell, 0.05 * far)

    def total(values):
        field = method.rbf.expansion.field(
            factors.rbf, jnp.concatenate([values, rest[ids.fixed]]), values.dtype
        )
        gradient = jax.vmap(jax.jacfwd(lambda x: field(x, None)))(middle)
        slope = (
            jnp.einsum("eij,ej->ei", gradient, along / length)
            - (rest[second] - rest[first]) / length
        )
        strain = (gradient + gradient.transpose(0, 2, 1)) / 2
        strain = strain - jnp.trace(strain, axis1=1, axis2=2)[:, None, None] * jnp.eye(2)[None] / 2
        miss = jax.vmap(lambda x: field(x, None))(surface[: plan.n_moving]) - rest[: plan.n_moving]
        terms = jnp.sum(miss**2, axis=1).mean(), mu**2 * jnp.sum(slope**2, axis=1).mean()
        return sum(terms) + (2 * reach**2 * jnp.sum(strain**2, axis=(1, 2))).mean()

    fitted = method.field(ids, factors, surface, u)
    values = (
        jax.vmap(lambda x: fitted(x, None))(surface[ids.moving])
        - terms[np.asarray(ids.moving)] @ affine
    )
    slope, at_zero = jax.grad(total)(values), jax.grad(total)(0 * values)
    assert np.abs(slope).max() < 1e-8 * np.abs(at_zero).max()
    assert float(total(values)) < 0.5 * float(total(0 * values))


@pytest.mark.slow
def test_both_lengths_are_differentiable():
    mesh = body(2)
    u, w = motion(mesh.points[mesh.moving]), np.random.default_rng(1).normal(size=mesh.points.shape)
    lengths = jnp.asarray([0.1, 0.07])
    rbf = jm.RBF(reduction=jm.KDTree(2), fixed_reduction=jm.KDTree(1))
    plan = with_cells(mesh, jm.FittedRBF(rbf, ell=lengths[0], mu=lengths[1]))

    @jax.jit
    @jax.value_and_grad
    def objective(lengths):
        other = eqx.tree_at(
            lambda plan: (plan.method.ell, plan.method.mu), plan, (lengths[0], lengths[1])
        )
        return jnp.vdot(w, jm.deform(jm.refit(other, mesh.points), u))

    gradient = objective(lengths)[1]
    for k, step in enumerate(1e-5 * np.eye(2)):
        difference = (objective(lengths + step)[0] - objective(lengths - step)[0]) / 2e-5
        np.testing.assert_allclose(gradient[k], difference, rtol=1e-6)
        assert abs(difference) > 1e-3


@pytest.mark.nightly
def test_grid_lines_stay_at_right_angles_to_a_cambered_wall():
    """10 % of camber turns the wall by up to 22 degrees, and the classic method's grid lines not at all."""
    mesh, plan, base, _ = airfoil("9412")
    u = up(base, 0.4 * base[:, 0] * (1 - base[:, 0]))
    points = jm.deform(plan, u)
    inverted, ratio = judged(mesh, points)
    assert inverted == 0
    assert ratio > 0.75
    assert float(jm.wall_quality(mesh, "airfoil", points).mean_angle) < 4.5
    classic = jm.deform(jm.prepare(mesh, "airfoil", "farfield", method=jm.RBF.classic()), u)
    assert float(jm.wall_quality(mesh, "airfoil", classic).mean_angle) > 9


def test_edges_and_chord_of_a_circle():
    """With faces and without: each node has two edges, and half of the length is the chord."""
    points = np.concatenate([circle(60), 5 * circle(40)])
    lines = np.stack([np.arange(60), np.roll(np.arange(60), -1)], axis=1)
    wall = np.repeat([0, 1], [60, 40])
    for faces in ({"line": lines}, None):
        found = edges(points, 60, faces)
        np.testing.assert_array_equal(found, np.unique(np.sort(lines, axis=1), axis=0))
        ends, share = chords(points, wall, faces)
        span = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        np.testing.assert_allclose(share * span, [np.pi, 5 * np.pi], rtol=2e-2)


def test_edges_of_faces_and_of_an_open_line():
    """A face has all of its sides; the ends of a line have one neighbour each."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.2], [2, 0.5, 0]])
    found = edges(corners, 5, {"quad": np.array([[0, 1, 2, 3]]), "triangle": np.array([[1, 4, 2]])})
    np.testing.assert_array_equal(found, [[0, 1], [0, 3], [1, 2], [1, 4], [2, 3], [2, 4]])
    line = np.array([[0.0, 0], [1, 0.1], [2.1, 0.1], [3.3, 0], [4.6, -0.1]])
    np.testing.assert_array_equal(edges(line, 5), [[0, 1], [1, 2], [2, 3], [3, 4]])


def test_thinned_places_do_not_depend_on_their_order():
    places, order = np.random.default_rng(0).normal(size=(2, 50, 3))
    order = np.argsort(order[:, 0])
    chosen, again = thinned(places, 20), thinned(places[order], 20)
    assert (np.diff(chosen) > 0).all()
    np.testing.assert_array_equal(np.sort(order[again]), chosen)
    assert len(chosen) == 20
    np.testing.assert_array_equal(thinned(places, 50), np.arange(50))


def far_away(radius):
    """A small airfoil with its far field drawn out, in powers of the distance, from 15 chords."""
    mesh = cases.naca0015(points=1500)
    arms = mesh.points - [0.5, 0]
    distance = np.linalg.norm(arms, axis=1, keepdims=True)
    power = np.log(radius) / np.log(15)
    return mesh.moved(arms * np.maximum(distance, 1) ** (power - 1) + np.array([0.5, 0]))


@pytest.mark.nightly
def test_a_bump_leaves_the_far_field_alone():
    """The classic method moves nodes 20 chords away and more by more than the bump's height, the rings by half of it."""
    radius = 500
    mesh = far_away(radius)
    plan = jm.prepare(mesh, "airfoil", "farfield")
    base = mesh.points[np.asarray(plan.moving)]
    bump = up(base, 0.1 * np.sin(np.pi * base[:, 0]) ** 3 * (base[:, 1] > 0))
    is_far = np.linalg.norm(mesh.points, axis=1) > 20
    classic = jm.prepare(mesh, "airfoil", "farfield", method=jm.RBF.classic())
    reached = [
        np.linalg.norm(jm.deform(each, bump) - mesh.points, axis=1)[is_far].max()
        / np.abs(bump).max()
        for each in (plan, classic)
    ]
    assert reached[0] < 0.6 < 1.2 < reached[1]
    assert jm.inspect(plan, bump).overshoot < 1.7
    inverted, ratio = judged(mesh, jm.deform(plan, up(base, np.full(len(base), 0.3 * radius))))
    assert inverted == 0
    assert ratio > 0.3
    surface = np.asarray(plan.surface.points)
    affine = np.array([[0.1, 0.3], [-0.2, 0.05]])
    ids, factors = plan.surface.ids.coarse, plan.surface.factors.coarse
    field = plan.method.coarse.field(
        ids, factors, plan.surface.points, jnp.asarray(surface @ affine)
    )
    moved = jax.vmap(lambda x: field(x, None))(plan.points)
    np.testing.assert_allclose(moved, mesh.points @ affine, atol=1e-9 * radius)


@pytest.mark.slow
def test_a_free_side_is_seen_however_it_is_turned():
    """The outlet is named nowhere: the field is then an interpolation, without edges to be fitted to. So it is of points alone."""
    mesh = faults.channel(columns=24, rows=12)
    z = (mesh.points[:, 0] + 1j * mesh.points[:, 1]) * np.exp(1j * np.deg2rad(30))
    turned = mesh.moved(np.stack([z.real, z.imag], axis=1))
    for each in (mesh, turned):
        for sides, is_free in ((["outer", "inlet"], True), (["outer", "inlet", "outlet"], False)):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of boundary faces in no list
                plan, alone = (
                    jm.prepare(given, each.patch("inner"), each.patch(*sides))
                    for given in (each, each.points)
                )
            assert hasattr(plan.surface.ids.coarse, "edges") != is_free
            assert not hasattr(alone.surface.ids.coarse, "edges")


def wedge(angle, count=9):
    """A closed wall: two straight sides of unit length from a tip at the origin, and a circle that joins them."""
    half, s = np.radians(angle / 2), np.linspace(1, 0, count)[:, None]
    lower, upper = (s * [-np.cos(half), sign * np.sin(half)] for sign in (-1, 1))
    round_about = np.linspace(half, 2 * np.pi - half, count)[1:-1, None]
    back = -np.hstack(
        [
            np.cos(half) + np.sin(half) * np.sin(round_about / 2),
            np.sin(half) * np.cos(round_about / 2),
        ]
    )
    points = np.concatenate([lower, upper[::-1][1:], back])
    ids = np.arange(len(points))
    return points, np.stack([ids, np.roll(ids, -1)], axis=1)


def test_a_source_stands_behind_a_sharp_tip():
    """As far behind it as both nodes are before it; none behind a blunt tip, where another wall is near, or next to a node."""
    points, pairs = wedge(20)
    one = np.ones(len(pairs))
    for length, away in ((0.01, 0.125), (0.3, 0.375)):
        ((tip, *sides),) = behind_tips(sharp_tips(points, pairs), length * one, 0.0, one)
        assert (points[tip] == 0).all()
        np.testing.assert_allclose(np.linalg.norm(points[sides], axis=1), away)
        np.testing.assert_allclose(points[sides].sum(axis=0)[1], 0, atol=1e-15)
    for angle, closest, room in ((70, 0.0, 1.0), (20, 0.2, 1.0), (20, 0.0, 0.1)):
        assert not len(behind_tips(sharp_tips(*wedge(angle)), 0.01 * one, closest, room * one))
    cut = np.concatenate(
        [points, points[:1]]
    )  # the last node of the wall is not joined to its first
    walls = sharp_tips(cut, np.stack([np.arange(len(points)), np.arange(1, len(cut))], axis=1))
    assert len(behind_tips(walls, 0.01 * one, 0.0, one)) == 1


def test_sources_stand_beside_a_sharp_tip():
    """The first nodes at three distances on either side, where farthest points leave a hole; none beside a blunt tip."""
    points, pairs = wedge(20, 2001)
    distance = np.linalg.norm(
        points[beside_tips(sharp_tips(points, pairs), np.ones(len(pairs)))], axis=1
    )
    np.testing.assert_allclose(np.sort(distance), np.repeat([0.002, 0.008, 0.032], 2), atol=5e-4)
    assert not len(beside_tips(sharp_tips(*wedge(70)), np.ones(len(wedge(70)[0]))))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "shape",
    [
        lambda x: 0.061 * np.sin(4 * np.pi * x[:, 0]),
        lambda x: 1.5 * x[:, 1],
        lambda x: 0.4 * x[:, 0] * (1 - x[:, 0]),
    ],
    ids=["waves", "thickness", "camber"],
)
def test_a_finer_sharp_section_keeps_the_cells_at_its_tip(shape):
    """Of 200 wall nodes 84 are sources: without those beside the tip the waves invert a cell there, which classic RBF does not."""
    mesh = faults.sharp_o_grid(around=200, layers=40, first_cell=1e-5)
    base = np.asarray(mesh.points)[mesh.patch("airfoil")]
    u = np.stack([0 * base[:, 0], shape(base)], axis=1)
    default, classic = (
        judged(mesh, jm.deform(jm.prepare(mesh, "airfoil", "farfield", method=method), u))[1]
        for method in (None, jm.RBF.classic())
    )
    assert default > 0.9 * classic > 0.5


@pytest.mark.nightly
def test_a_sharp_blade_turns_in_its_passage():
    """The cell behind the trailing edge, whose corner is nearly straight, no longer decides; what is affine stays so."""
    mesh = faults.cascade(around=160, layers=40, first_cell=1e-3, periodic=True)
    blade = np.asarray(mesh.points)[mesh.patch("blade")]
    plan = jm.prepare(mesh, "blade", ("inlet", "outlet"), periodic=jm.Periodic("lower", "upper"))
    for degrees, least in ((15, 0.733), (41, 1e-9)):
        u = np.asarray(jm.shapes.rotate(blade, np.radians(degrees), about=(0.5, 0))) - blade
        inverted, ratio = judged(mesh, jm.deform(plan, u))
        assert inverted == 0
        assert ratio > least
    sides = mesh.patch("blade", "inlet", "outlet", "lower", "upper")
    matrix = np.array([[1.2, 0.3], [-0.1, 0.9]])
    whole = jm.prepare(mesh, sides, method=jm.FittedRBF())
    assert len(whole.surface.ids.tips) == 1
    np.testing.assert_allclose(
        jm.deform(whole, mesh.points[sides] @ matrix),
        mesh.points @ (matrix + np.eye(2)),
        atol=1e-11,
    )
