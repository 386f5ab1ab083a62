"""`inspect` and `fewest_steps`: what a motion asks for, before and while it is tried."""

import functools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import grid, ring, turn
from runs import over, refusals
from scipy.interpolate import RBFInterpolator
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._advice.inspect import measure_missed


@pytest.fixture(scope="module")
def mesh():
    return cases.naca0015(points=2000)


def rotation(mesh, degrees):
    base = mesh.points[mesh.patch("airfoil")]

    def motion(t):
        return np.asarray(jm.shapes.rotate(base, -np.deg2rad(degrees * t), [0.25, 0])) - base

    return motion


@pytest.mark.nightly
def test_offset_is_what_the_sources_miss(mesh):
    method = jm.SurfaceReconstruction.published(2, 2)
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    u = rotation(mesh, 15)(1)
    found = jm.inspect(jm.prepare(mesh.points, moving, fixed, method=method), u)
    coarse = jm.prepare(mesh.points, moving, fixed, method=method.coarse)
    nodes = np.concatenate([moving, fixed])
    target = np.zeros_like(mesh.points)
    target[moving] = u
    missed = np.linalg.norm(
        (np.asarray(jm.deform(coarse, u)) - mesh.points - target)[nodes], axis=1
    )
    assert found.offset == pytest.approx(missed.max(), rel=1e-9)
    assert not found.warnings
    graph = jm.prepare(
        mesh.points, moving, fixed, method=jm.DelaunayGraph()
    )  # without a correction
    assert jm.inspect(graph, rotation(mesh, 80)(1)).offset == 0


@pytest.mark.slow
def test_a_rotation_by_any_angle_is_no_contradiction(mesh):
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"))
    assert not len(jm.inspect(plan, rotation(mesh, 170)(1)).contradictions)


@pytest.mark.slow
def test_a_wall_sliding_along_a_held_boundary_is(mesh):
    airfoil = mesh.patch("airfoil")
    held = airfoil[np.argsort(mesh.points[airfoil, 0])[:10]]
    moving = np.setdiff1d(airfoil, held)
    plan = jm.prepare(mesh.points, moving, np.concatenate([held, mesh.patch("farfield")]))
    named = jm.Mesh(mesh.points, mesh.cells, {"held": held, "slid": moving})
    found = jm.inspect(plan, np.full((len(moving), 2), [0.5, 0.0]), mesh=named)
    assert len(found.contradictions)
    assert (np.isin(found.contradictions, held).sum(axis=1) == 1).all()
    assert re.search("of 'held' and 'slid'|of 'slid' and 'held'", found.warnings[0])
    assert "`sliding`" in found.warnings[0]


@pytest.mark.nightly
def test_sliding_is_advised_only_where_a_fixed_boundary_touches_the_moving_one():
    """A cylinder made wavy has no boundary beside it, a shaft in its bearing has one that does not touch it."""
    mesh = ring(96, 0.5 * 1.15 ** np.arange(20))
    base = mesh.points[mesh.patch("wall")]
    wavy = base * (0.35 * np.cos(24 * 2 * np.pi * np.arange(96) / 96))[:, None]
    plan = jm.prepare(mesh, "wall", "far")
    for found in (jm.inspect(plan, wavy, mesh=mesh), jm.inspect(plan, wavy)):
        after = np.linalg.norm(np.subtract(*(base + wavy)[found.contradictions.T]), axis=1)
        assert (
            after > 2 * np.linalg.norm(np.subtract(*base[found.contradictions.T]), axis=1)
        ).all()
        (said,) = found.warnings
        assert "sliding" not in said
        assert f"In {len(found.contradictions)} of them both nodes move" in said
    bearing = ring(96, [0.5, 0.505, 0.51])
    turned = np.asarray(jm.shapes.rotate(base, 0.1, [0.0, 0.0])) - base
    found = jm.inspect(jm.prepare(bearing, "wall", "far"), turned, mesh=bearing)
    (said,) = found.warnings
    assert f"{len(found.contradictions)} of them lie across a gap to a fixed wall" in said
    assert "sliding" not in said


@pytest.mark.nightly
def test_a_duct_whose_fixed_ends_are_torn_is_told_to_free_them():
    patches = {
        "walls": lambda ids: np.r_[ids[:, 0], ids[:, -1]],
        "ends": lambda ids: np.r_[ids[0], ids[-1]],
    }
    mesh = grid(np.linspace(0, 3, 31), np.linspace(0, 1, 11), patches=patches)
    walls = mesh.points[mesh.patches["walls"]]
    u = np.stack([0.35 + 0 * walls[:, 0], 0.3 * (walls[:, 1] - 0.5)], axis=1)
    plan = jm.prepare(mesh, "walls", "ends")
    inspection = jm.inspect(plan, u, mesh=mesh)
    assert any("folds" in said for said in inspection.advice)
    assert "Name it in `free` (--free)" in inspection.warnings[0]
    moved = jm.deform(jm.prepare(mesh, "walls", free="ends"), u)
    assert int(jm.quality(mesh, moved).inverted) == 0


@pytest.mark.slow
def test_fewest_steps_are_fewest(mesh):
    method = jm.SurfaceReconstruction.published(4, 4)
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=method)
    motion = rotation(mesh, 90)
    steps = jm.fewest_steps(plan, mesh, motion, max_steps=8)
    assert steps.fraction == 1
    assert int(jm.quality(mesh, steps.points).inverted) == 0
    np.testing.assert_allclose(
        steps.points[plan.moving], plan.points[plan.moving] + motion(1), atol=1e-13
    )
    np.testing.assert_allclose(jm.replay(steps.plans, steps.path), steps.points, atol=1e-13)
    for count in range(1, steps.count):
        path = jnp.stack([motion((j + 1) / count) for j in range(count)])
        report = jm.quality(mesh, jm.march(plan, path)[1])
        assert int(report.inverted) or float(report.min_jacobian_ratio) <= 0.05


def test_an_infeasible_motion_is_reported_with_the_fraction_reached(mesh):
    plan = jm.prepare(
        mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=jm.DelaunayGraph()
    )
    motion = lambda t: np.full((len(plan.moving), 2), [0.0, 40.0 * t])  # noqa: E731  # through the far field
    steps = jm.fewest_steps(plan, mesh, motion, max_steps=1)
    assert 0 < steps.fraction < 15 / 40
    assert int(steps.report.inverted) == 0
    report = jm.quality(mesh, jm.deform(plan, motion(steps.fraction + 2e-3)))
    assert int(report.inverted) or float(report.min_jacobian_ratio) <= 0.05


@pytest.mark.nightly
def test_a_radius_below_the_motion_is_told(mesh):
    base = mesh.points[mesh.patch("airfoil")]
    for method, reach in (
        (jm.CompactRBF(0.3), 0.3),
        (jm.CompactRBF(), None),
        (jm.DelaunayGraph(), np.inf),
    ):
        plan = jm.prepare(mesh, "airfoil", "farfield", method=method)
        assert plan.reach > 0 if reach is None else plan.reach == pytest.approx(reach)
        for share in (0.9, 1.1):
            u = np.full_like(base, [0.0, share * (plan.reach if np.isfinite(plan.reach) else 1.0)])
            told = any("radius" in sentence for sentence in jm.inspect(plan, u).advice)
            assert told == (share > 1 and np.isfinite(plan.reach))


@pytest.mark.nightly
def test_a_mesh_that_steps_tangle_is_improved_when_asked():
    """A store that leaves a wing for the far side: improved, it gets farther, and all that the result says is true."""
    mesh = cases.bodies({"wing": (-2.0, 2.0, 1.0, 1.5), "store": (-0.5, 0.5, 0.0, 0.5)})
    plan = jm.prepare(mesh, "store", ("wing", "farfield"))
    motion = lambda t: np.full((plan.n_moving, 2), [0.0, -3.85 * t])  # noqa: E731
    alone = jm.fewest_steps(plan, mesh, motion, max_steps=2)
    steps = jm.fewest_steps(plan, mesh, motion, max_steps=2, improve=True)
    assert alone.fraction < steps.fraction
    assert alone.improvement is None
    assert steps.improvement is not None
    assert int(jm.quality(mesh, steps.points).inverted) == 0
    again = jm.improve(mesh, jm.replay(steps.plans, steps.path)).points
    np.testing.assert_allclose(steps.points, again, rtol=0, atol=1e-9)
    surface = plan.points[plan.moving] + motion(steps.fraction)
    np.testing.assert_allclose(steps.points[plan.moving], surface, rtol=0, atol=1e-12)


def bump_on_one_side(side):
    """A thin plate, its upper or both sides raised in the middle."""
    mesh = cases.naca0015(points=2000)
    moving = mesh.patch("airfoil")
    x, y = mesh.points[moving].T
    height = 0.1 * np.exp(-(((x - 0.5) / 0.1) ** 2))
    return mesh, np.column_stack([0 * x, np.where((y > 0) | (side == "both"), height, 0)])


FOLLOWS = jm.RBF(reduction=jm.KDTree(32))
"""It carries the motion of one side through a thin body to the other."""


@pytest.mark.parametrize(
    ("method", "least", "most"), [(FOLLOWS, 0.3, 0.9), (jm.DelaunayGraph(), 0, 1e-6)]
)
def test_overshoot_behind_a_bump(method, least, most):
    """Measured once more in a box below the airfoil; graph mapping leaves the other side alone."""
    mesh, u = bump_on_one_side("upper")
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=method)
    found = jm.inspect(plan, u)
    share = np.linalg.norm(np.asarray(jm.deform(plan, u)) - mesh.points, axis=1) / np.abs(u).max()
    inner = np.setdiff1d(np.arange(len(share)), np.concatenate([plan.moving, plan.fixed]))
    x, y = mesh.points[inner].T
    below = (x > 0) & (x < 1) & (y < 0) & (y > -0.9)
    assert least <= found.overshoot_behind <= most
    assert found.overshoot_behind == pytest.approx(share[inner][below].max(), abs=0.15)
    assert found.overshoot == pytest.approx(share[inner].max())


def test_overshoot_where_all_moves_or_nothing():
    mesh, u = bump_on_one_side("both")
    plan = jm.prepare(mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"))
    found = jm.inspect(plan, 0 * u + 0.3)
    assert found.overshoot <= 1.001
    assert found.overshoot_behind == 0
    still = jm.inspect(plan, 0 * u)
    assert (still.overshoot, still.overshoot_behind) == (0, 0)


@pytest.mark.slow
def test_advice_where_the_displacement_is_steep():
    """A wall that turns as a whole has no slope of its own; a narrow bump on a fitted field asks to compare the other method."""
    mesh = cases.naca0015(points=1200)
    base = mesh.points[mesh.patch("airfoil")]
    plan = jm.prepare(mesh, "airfoil", "farfield")
    turned = jm.inspect(plan, np.column_stack([-0.5 * base[:, 1], 0.5 * base[:, 0]]))
    assert turned.slope == pytest.approx(0, abs=1e-9)
    assert turned.advice == ()
    wave = np.column_stack([0 * base[:, 0], 0.2 * np.sin(2 * np.pi * base[:, 0])])
    steep = jm.inspect(plan, wave)
    assert 0.5 < steep.slope < 0.4 * np.pi + 0.4
    assert "compare" in steep.advice[0]
    assert jm.inspect(jm.prepare(mesh, "airfoil", "farfield", method=FOLLOWS), wave).advice == ()


def square():
    """A unit-spaced square of 8 x 8 quads with its sides, and three nodes in its middle, which a motion turns by 95 degrees."""
    mesh = grid(*[np.arange(9.0)] * 2)
    points = np.asarray(mesh.points)
    edges = {
        f"{'xy'[axis]}{end}": np.flatnonzero(points[:, axis] == end)
        for axis in (0, 1)
        for end in (0, 8)
    }
    moving = np.array([39, 40, 41])
    arms = points[moving] - points[40]

    def turned(t):
        c, s = np.cos(np.deg2rad(95) * t), np.sin(np.deg2rad(95) * t)
        return arms @ np.array([[c, s], [-s, c]]) - arms

    return jm.Mesh(points, mesh.cells, edges), moving, turned


@pytest.mark.nightly
def test_improving_keeps_a_surface_inside_of_the_mesh_where_it_was_sent():
    mesh, moving, turned = square()
    plan = jm.prepare(mesh, moving, tuple(mesh.patches))
    steps = jm.fewest_steps(plan, mesh, turned, max_steps=2, improve=True)
    wall = np.asarray(steps.points)[plan.moving]
    np.testing.assert_allclose(wall, mesh.points[moving] + turned(steps.fraction), atol=1e-12)


@pytest.mark.nightly
@pytest.mark.parametrize("by", ["sliding", "periodic", "symmetry"])
def test_improving_lets_the_boundary_of_a_plan_slide_and_repeat(by):
    """As `improve` does when it is told the same: nodes move along the line x = 0, or as their partners on x = 8 do."""
    mesh, moving, turned = square()
    given = {
        "sliding": "x0",
        "symmetry": jm.Plane((1, 0), (0, 0)),
        "periodic": jm.Periodic("x0", "x8"),
    }[by]
    held = ("y0", "y8") if by == "periodic" else ("y0", "y8", "x8")
    plan = jm.prepare(mesh, moving, held, **{by: given})
    steps = jm.fewest_steps(plan, mesh, turned, max_steps=2, improve=True)
    assert steps.fraction == 1
    assert steps.improvement is not None
    start, found = (np.asarray(each) for each in (jm.replay(steps.plans, steps.path), steps.points))
    side, fixed = mesh.patch("x0"), np.append(mesh.patch(*held), moving)
    assert np.abs(found - start)[side].max() > 1e-3
    np.testing.assert_array_equal(found[fixed], start[fixed])
    if by == "periodic":
        np.testing.assert_array_equal(found[side] + [8, 0], found[mesh.patch("x8")])
    else:
        np.testing.assert_array_equal(found[side, 0], 0)
    alone = jm.improve(jm.Boundary(mesh, (), fixed, **{by: given}), start).points
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-9)


@functools.cache
def one_triangle():
    mesh = jm.Mesh(np.array([[0.0, 0], [1, 0], [0, 1]]), {"triangle": [[0, 1, 2]]})
    return jm.prepare(mesh, [0], [1, 2], method=jm.InverseDistance()), mesh


test_a_motion_that_is_none = refusals(
    (
        lambda *case: jm.fewest_steps(*case, lambda t: np.full((1, 2), np.nan)),
        "2 of 2 numbers of `motion.t.` are not finite",
    ),
    (lambda *case: jm.fewest_steps(*case, lambda t: None), "`motion.t.` must be"),
    of=one_triangle,
)


def sleeve(around=80, layers=13):
    """An ellipse with axes 2 and 1 in a round sleeve of radius 1.6."""
    lattice = ring(around, np.linspace(1, 1.6, layers), ("body", "sleeve"))
    share = np.linspace(0, 1, layers)[:, None, None]
    circle = lattice.points[:around]
    points = (1 - share) * circle * [1.0, 0.5] + share * 1.6 * circle
    return jm.Mesh(points.reshape(-1, 2), lattice.cells, lattice.patches)


def channel():
    patches = {
        "body": lambda ids: ids[:, 0],
        "rest": lambda ids: np.r_[ids[0, 1:], ids[-1, 1:], ids[1:-1, -1]],
    }
    return grid(np.linspace(0, 4, 41), np.linspace(0, 1, 11), patches=patches)


def turned(points, degrees):
    return points @ turn(np.radians(degrees), 2).T - points


SHIFT = np.array([0.1, 0.05])
MOTIONS = {
    "sleeve turned by 60 degrees": (sleeve, lambda x: turned(x, 60), "sliding"),
    "sleeve turned by 170 degrees": (sleeve, lambda x: turned(x, 170), "sliding"),
    "sleeve turned and shifted": (sleeve, lambda x: turned(x, 60) + SHIFT, "steps"),
    "channel with a bump of 90 %": (
        channel,
        lambda x: 0.9 * np.exp(-((x[:, :1] - 2) ** 2) / 0.5) * [0, 1],
        "steps",
    ),
}


@over("name", slow=["sleeve turned by 60 degrees"], nightly=[*MOTIONS][1:])
def test_advice_on_folded_cells_cures(name):
    make, motion, kind = MOTIONS[name]
    mesh = make()
    (outer,) = set(mesh.patches) - {"body"}
    plan, x = jm.prepare(mesh, "body", outer), mesh.points[mesh.patches["body"]]
    u = motion(x)
    count = int(jm.quality(mesh, jm.deform(plan, u)).inverted)
    share = jm.largest_step(plan, 0 * u, u, mesh).step
    said = jm.inspect(plan, u, mesh=mesh).advice[0]
    assert count > 0
    assert said.startswith(
        f"one step folds {count} cells, the first after {100 * share:.3g} % of the motion. With "
    )
    if kind == "sliding":
        assert f"With sliding=['{outer}'] in place of `fixed` none folds." in said
        moved = jm.deform(jm.prepare(mesh, "body", sliding=outer), u)
    else:
        found = re.search(
            r"With (\d) steps none folds: `march\(plan, jm.Turn.of\(plan.moving_points, u\).path\((\d)\)\)`",
            said,
        )
        assert found
        count, degrees = int(found[1]), 60 if name.startswith("sleeve") else 0
        assert int(found[2]) == count
        path = [
            turned(x, degrees * k / count) + (u - turned(x, degrees)) * k / count
            for k in range(1, count + 1)
        ]
        np.testing.assert_allclose(jm.Turn.of(x, u).path(count), path, rtol=0, atol=1e-12)
        moved = jm.march(plan, np.stack(path))[1]
    assert int(jm.quality(mesh, moved).inverted) == 0
    assert "folds" not in " ".join(jm.inspect(plan, 0.9 * share * u, mesh=mesh).advice)


@pytest.mark.nightly
def test_advice_where_nothing_cures_says_what_was_tried():
    mesh = sleeve()
    plan = jm.prepare(mesh, "body", "sleeve")
    u = np.tile([0.598, 0.0], (80, 1))
    said = jm.inspect(plan, u, mesh=mesh).advice[0]
    assert said.endswith(
        "2 steps, 4 steps, 8 steps, jm.LinearElasticity(), jm.TorsionalSprings() do not cure it."
    )


def test_a_cylinder_with_flat_ends_is_round_about_its_axis_alone():
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    rim, centre = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), np.array([3, -1, 1])
    along = np.array([0, 0, 2])
    side, end = np.concatenate([rim, rim + along]) + centre, np.concatenate([rim, rim / 2]) + centre
    arms = np.random.default_rng(0).normal(size=(20, 3))
    for vector, holds in (([0, 0, 1.0], True), ([0, 1.0, 0], False)):
        body, (u, half) = (
            arms + centre,
            (Rotation.from_rotvec(np.array(vector) / k).apply(arms) - arms for k in (1, 2)),
        )
        found = jm.Turn.of(body, u)
        np.testing.assert_allclose(found.path(3)[-1], u, atol=1e-12)
        np.testing.assert_allclose(found.path(2)[0], half, atol=1e-12)
        assert [found.keeps(points) for points in (side, end)] == [holds, holds]


def test_a_plate_turns_in_its_plane():
    """Nodes on a line: any spin about the line is as near, and one in space would squeeze the plate on its way."""
    plate = np.linspace([1, 2], [3, 2], 9)
    for degrees in (30, 90, -170):
        path = jm.Turn.of(plate, turned(plate, degrees)).path(4)
        for k, u in enumerate(path, start=1):
            np.testing.assert_allclose(u, turned(plate, degrees * k / 4), rtol=0, atol=1e-13)
    for x, u in (
        (plate, turned(plate, 3)),
        (plate[:1], np.array([[1.0, 2.0]])),
        (0 * plate, plate),
    ):
        np.testing.assert_allclose(
            jm.Turn.of(x, u).path(4), [u / 4, u / 2, 0.75 * u, u], rtol=0, atol=1e-15
        )


def test_single_precision_stays_on_the_way():
    x = ring(12).points[:12]
    at = jm.Turn.of(x.astype(np.float32), turned(x, 90).astype(np.float32)).at(0.5)
    assert at.dtype == np.float32
    np.testing.assert_allclose(at, turned(x, 45), rtol=0, atol=1e-6)


LARGE = {
    "ellipse turned by 90 degrees": (functools.partial(sleeve, 160, 25), lambda x: turned(x, 90)),
    "bump of 95 % of a channel": (
        channel,
        lambda x: 0.95 * np.exp(-((x[:, :1] - 2) ** 2) / 0.5) * [0, 1],
    ),
}


@over("name", slow=[*LARGE][:1], nightly=[*LARGE][1:])
def test_a_large_motion_passes_in_one_call_and_is_differentiated(name):
    make, motion = LARGE[name]
    mesh = make()
    (outer,) = set(mesh.patches) - {"body"}
    plan = jm.prepare(mesh, "body", outer)
    u = motion(np.asarray(plan.moving_points))
    assert int(jm.quality(mesh, jm.deform(plan, u)).inverted) > 20
    steps = jm.fewest_steps(plan, mesh, u, min_jacobian_ratio=0.0)
    assert (steps.fraction, int(steps.report.inverted)) == (1, 0)
    assert 1 < steps.count <= 4
    np.testing.assert_allclose(
        steps.points[plan.moving], plan.moving_points + u, rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(steps.path_to(u), steps.path, rtol=0, atol=1e-15)
    weights, way = np.random.default_rng(0).normal(size=mesh.points.shape), np.cos(3 * u + 1)

    @jax.jit
    def objective(u):
        return jnp.sum(weights * jnp.sin(jm.replay(steps.plans, steps.path_to(u))))

    h = 1e-6
    difference = (objective(u + h * way) - objective(u - h * way)) / (2 * h)
    np.testing.assert_allclose(np.vdot(jax.grad(objective)(u), way), difference, rtol=1e-6)


@pytest.mark.nightly
def test_a_sleeve_slides_where_no_number_of_steps_follows():
    """135 degrees: straight edges cannot follow; the round outer patch turns with the body."""
    mesh = sleeve()
    plan = jm.prepare(mesh, "body", "sleeve")
    u = turned(np.asarray(plan.moving_points), 135)
    assert jm.fewest_steps(plan, mesh, u, max_steps=8, min_jacobian_ratio=0.0).fraction < 0.75
    cure = next(jm.cures(jm.Boundary(mesh, "body", "sleeve"), u))
    assert cure.sliding == ("sleeve",)
    moved = jm.deform(jm.prepare(mesh, "body", sliding=cure.sliding), u)
    assert float(jm.quality(mesh, moved).min_jacobian_ratio) > 0.95


@pytest.mark.parametrize(("count", "some", "d"), [(5000, 60, 3), (90, 1, 3), (500, 100, 2)])
def test_what_sources_miss_is_what_scipys_interpolation_by_distances_misses(count, some, d):
    rng = np.random.default_rng(count)
    points = rng.random((count, d))
    u, rows = np.sin(5 * points), np.sort(rng.choice(count, some, replace=False))
    field = RBFInterpolator(points[rows], u[rows], kernel="linear", degree=0)(points)
    expected = np.linalg.norm(field - u, axis=1).max() / np.linalg.norm(u, axis=1).max()
    np.testing.assert_allclose(measure_missed(points, u, rows), expected, rtol=1e-9)
