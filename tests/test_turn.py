"""First grid lines turn with the wall: what the near-wall layer does to them, whatever the coarse field."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases
from jaxmorph._methods.turn import OF_WIDTH, WallTurn, WallTurnIds

INTERPOLATED = jm.SurfaceReconstruction(
    jm.RBF(reduction=jm.KDTree(64, extremes=True)), jm.NearWall()
)


def camber(x, height=0.4):
    return np.column_stack([0 * x[:, 0], height * x[:, 0] * (1 - x[:, 0])])


def bump(x):
    return np.column_stack(
        [0 * x[:, 0], 0.03 * np.exp(-(((x[:, 0] - 0.5) / 0.12) ** 2)) * (x[:, 1] > 0)]
    )


def thicker(x):
    return 0.3 * x * [0, 1]


@functools.cache
def section(code="4412"):
    return cases.naca4(code, points=3000, first_cell=1e-5)


def measured(mesh, plan, u):
    points = jm.deform(plan, u)
    report = jm.quality(mesh, points)
    wall = jm.wall_quality(mesh, "airfoil", points)
    heights = np.percentile(np.asarray(wall.height), [5, 95])
    return int(report.inverted), float(wall.mean_angle), heights


@pytest.mark.parametrize(
    ("motion", "most"),
    [(camber, 3.0), (thicker, 1.2), (bump, 0.4)],
    ids=["camber", "thickness", "bump"],
)
@pytest.mark.parametrize("method", [None, INTERPOLATED], ids=["default", "interpolated"])
def test_right_angles_and_first_heights_stay(method, motion, most):
    """The classic method's first lines do not turn; 2 to 10 times less is left, and heights are kept."""
    mesh = section()
    base = mesh.points[mesh.patch("airfoil")]
    plan = jm.prepare(mesh, "airfoil", "farfield", method=method)
    inverted, angle, (low, high) = measured(mesh, plan, motion(base))
    assert inverted == 0
    assert angle < most
    assert 0.9 < low <= high < 1.12


def test_a_wall_that_turns_takes_its_layer_along():
    """A turn of the whole body leaves angles and heights as they were: nothing is to be added."""
    mesh = section()
    base = mesh.points[mesh.patch("airfoil")]
    angle = np.deg2rad(15)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) - np.eye(2)
    plan = jm.prepare(mesh, "airfoil", "farfield")
    inverted, angle, (low, high) = measured(mesh, plan, (base - [0.25, 0]) @ turn)
    assert inverted == 0
    assert angle < 0.3
    assert 0.99 < low <= high < 1.01


def test_slopes_are_those_of_the_wall():
    """On a circle of radius 2 the displacement u = f(angle) n turns the normal by f' / 2; wanted is that, and nothing of a turn."""
    count, radius = 240, 2.0
    angle = 2 * np.pi * np.arange(count) / count
    points = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lines = np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)
    own = np.arange(count)
    bound = WallTurnIds(
        faces=(jnp.asarray(lines[:, ::-1]),),
        pairs=jnp.asarray(np.concatenate([lines, lines[:, ::-1]])),
        inside=jnp.asarray(own),
        outside=jnp.asarray(own),
        other=jnp.asarray(own),
        wall=jnp.zeros(count, int),
    )
    turn = WallTurn.made(bound, jnp.asarray(points), jnp.ones(count))
    normal = points / radius
    np.testing.assert_allclose(turn.normal, normal, atol=1e-12)
    np.testing.assert_allclose(turn.height, OF_WIDTH, rtol=1e-12)
    tangent = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    none = jnp.zeros_like(points)
    wave = np.cos(3 * angle)[:, None] * normal
    wanted = np.sin(3 * angle)[:, None] * 3 / radius * tangent
    strength = np.asarray(turn.strength)[:, None]
    assert (strength > 0.99).all()
    lacks = turn.turned(bound, jnp.asarray(wave), none, none)
    np.testing.assert_allclose(lacks / strength, wanted, atol=2e-3)
    spin = points @ np.array([[0, 1.0], [-1, 0]])  # an infinitesimal turn, as a coarse field has it
    at_probes = np.asarray(turn.probes) @ np.array([[0, 1.0], [-1, 0]])
    lacks = turn.turned(bound, jnp.asarray(spin), jnp.asarray(spin), jnp.asarray(at_probes))
    np.testing.assert_allclose(lacks, 0, atol=1e-3)
    growth = turn.turned(bound, jnp.asarray(0.1 * points), none, none)
    np.testing.assert_allclose(growth / strength, 0.1 * normal, atol=1e-12)


@pytest.mark.slow
def test_the_layer_ends_before_edges_and_other_walls():
    """Its height falls to nothing at a sharp trailing edge, below a quarter of the half thickness, and below the gap's share."""
    mesh = faults.sharp_o_grid(around=96, layers=24, first_cell=1e-4)
    plan = jm.prepare(mesh, "airfoil", "farfield")
    turn = plan.surface.factors.correction.turn
    x = np.asarray(plan.surface.points)[: plan.n_moving]
    height = np.asarray(turn.height)[: plan.n_moving]
    tail = x[:, 0].argmax()
    assert np.asarray(turn.strength)[tail] == 0
    assert height[np.argsort(-x[:, 0])[:4]].max() < 0.05 * height.max()
    assert (height <= 0.5 * np.abs(x[:, 1]).max()).all()
    held = faults.channel(columns=24, rows=12)
    plan = jm.prepare(held, "inner", ("outer", "inlet", "outlet"))
    factors = plan.surface.factors.correction.turn
    gap = np.linalg.norm(
        np.asarray(plan.surface.points)[: plan.n_moving, None]
        - np.asarray(plan.surface.points)[None, plan.n_moving :],
        axis=2,
    ).min(axis=1)
    assert (np.asarray(factors.height)[: plan.n_moving] <= OF_WIDTH / 2 * gap * (1 + 1e-9)).all()


@pytest.mark.parametrize(
    "changed",
    [
        lambda x: x + 1e-4 * camber(x, 0.4),
        lambda x: x * [1, 1 + 1e-4],
        lambda x: x @ np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]]),
        lambda x: x + 1e4,
    ],
    ids=["camber", "thickness", "turn", "shift"],
)
def test_neighbouring_meshes_move_alike(changed):
    """No choice between fields: a little camber or thickness, a turn or a shift of the whole changes the field by little."""
    mesh = section("0012")
    base = mesh.points[mesh.patch("airfoil")]
    other = mesh.moved(changed(mesh.points))
    matrix = np.linalg.lstsq(
        np.column_stack([np.ones(len(mesh.points)), mesh.points]), other.points, rcond=None
    )[0][1:]
    turn, _ = np.linalg.qr(matrix)
    turn = turn * np.sign(np.sum(turn * matrix, axis=0))
    plans = [jm.prepare(m, "airfoil", "farfield") for m in (mesh, other)]
    for motion in (camber(base, 0.2), bump(base)):
        first, second = (
            np.asarray(jm.deform(p, u)) - np.asarray(p.points)
            for p, u in zip(plans, (motion, motion @ turn), strict=True)
        )
        assert np.abs(first @ turn - second).max() < 1e-2 * np.abs(motion).max()


def split(mesh, name, edge):
    """The mesh of triangles with one more node, in the middle of an edge (two ids) of the wall."""
    triangles = mesh.cells["triangle"]
    (cell,) = np.flatnonzero(np.isin(triangles, edge).sum(axis=1) == 2)
    new = len(mesh.points)
    halves = [np.where(triangles[cell] == end, new, triangles[cell]) for end in edge]
    points = np.concatenate([mesh.points, mesh.points[edge].mean(axis=0)[None]])
    cells = np.concatenate([np.delete(triangles, cell, axis=0), halves])
    return jm.Mesh(
        points,
        {"triangle": cells},
        mesh.patches | {name: np.append(mesh.patches[name], new)},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    [
        (0.02, 0.02),
        *(
            pytest.param(place, marks=pytest.mark.slow)
            for place in [(0.5, 0.06), (0.1, -0.04), (0.95, 0.01)]
        ),
    ],
)
def test_one_more_node_on_the_wall_changes_little(place):
    quads = faults.sharp_o_grid(around=96, layers=16, first_cell=1e-3)
    corners = quads.cells["quad"]
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    mesh = jm.Mesh(quads.points, {"triangle": triangles}, quads.patches)
    wall = mesh.patch("airfoil")
    edges = np.stack([wall, np.roll(wall, -1)], axis=1)
    middle = mesh.points[edges].mean(axis=1)
    edge = edges[np.linalg.norm(middle - place, axis=1).argmin()]
    meshes = (mesh, split(mesh, "airfoil", edge))
    plans = [jm.prepare(m, "airfoil", "farfield") for m in meshes]
    for motion in (lambda x: camber(x, 0.2), bump):
        first, second = (
            np.asarray(jm.deform(plan, motion(np.asarray(plan.moving_points)))) - plan.points
            for plan in plans
        )
        assert np.abs(second[: len(first)] - first).max() < 1e-2 * np.abs(first).max()


@pytest.mark.slow
def test_derivatives_by_the_base_points():
    """Through `refit` the layer's normals, heights and slopes follow the base points."""
    mesh = cases.naca4("0012", points=600, first_cell=1e-3)
    plan = jm.prepare(mesh, "airfoil", "farfield")
    rng = np.random.default_rng(0)
    u = camber(mesh.points[mesh.patch("airfoil")], 0.2)
    weights = rng.normal(size=mesh.points.shape)
    direction = 1e-3 * rng.normal(size=mesh.points.shape)

    @jax.jit
    def objective(t):
        points = mesh.points + t * direction
        return jnp.vdot(weights, jm.deform(jm.refit(plan, points), u) - points)

    slope = jax.grad(objective)(0.0)
    step = 1e-4
    difference = (objective(step) - objective(-step)) / (2 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-5)


def test_points_alone_carry_values_alone():
    """Without faces there is no normal to trust: the layer then carries displacements as before."""
    mesh = section()
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"))
    assert plan.surface.ids.correction.turn is None
    assert plan.volume.placed.correction.rise is None
