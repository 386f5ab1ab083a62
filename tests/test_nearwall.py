"""Boundary layers on walls that are not convex: where the published correction inverts cells, and NearWall does not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few
from meshes import cusped
from oracles import corner_areas
from runs import over, runs
from scipy.spatial.distance import cdist

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.surface.neighbours import near_walls
from jaxmorph.cases._meshes import c_grid

PUBLISHED, NEAR_WALL = jm.DelaunayGraph(), jm.NearWall()


def few_sources(correction, *, leaves=2, extremes=True):
    """About ten sources on the wall and six on the far field."""
    coarse = jm.RBF(reduction=jm.KDTree(leaves, extremes=extremes), fixed_reduction=jm.KDTree(2))
    return jm.SurfaceReconstruction(coarse, correction)


def camber(base):
    """A parabola of a tenth of the chord."""
    x = base[:, 0]
    return np.column_stack([0 * x, 0.4 * x * (1 - x)])[None]


def less_camber(base):
    return -camber(base)


def flap_up(base):
    """20 degrees behind 70 % of the chord, gradually from 60 to 80 %."""
    rise = np.clip((base[:, 0] - 0.6) / 0.2, 0, 1)
    return turned(base, 0.7, -20 * rise**2 * (3 - 2 * rise))[None]


def turn(base):
    """45 degrees nose up in three steps."""
    return np.stack([turned(base, 0.25, angle) for angle in (15, 30, 45)])


def turned(base, centre, degrees):
    """Displacements by clockwise angles about a point of the chord."""
    z = (base[:, 0] - centre + 1j * base[:, 1]) * (np.exp(-1j * np.deg2rad(degrees)) - 1)
    return np.column_stack([z.real, z.imag])


SMALL, WHOLE = 12_000, 39_666
INVERTED = runs(
    [("6409", SMALL, True, flap_up)],
    slow=[("cusped", SMALL, True, flap_up)],
    nightly=[
        *(("cusped", SMALL, True, turn), ("cusped", SMALL, True, camber), ("6612", SMALL, True, flap_up)),
        *(("9412", SMALL, False, turn), ("4412", WHOLE, False, less_camber)),
    ],
)


@pytest.mark.parametrize(("section", "points", "extremes", "motion"), INVERTED)
def test_the_defect_and_the_cure(section, points, extremes, motion):
    own = section == "cusped"
    mesh = c_grid(cusped, points=points, first_cell=1e-6) if own else cases.naca4(section, points=points)
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    path, start = motion(mesh.points[moving]), corner_areas(mesh, mesh.points)
    ratios = []
    for correction in (PUBLISHED, NEAR_WALL):
        method = few_sources(correction, extremes=extremes)
        plans, points = jm.march(jm.prepare(mesh.points, moving, fixed, method=method), path)
        assert 6 <= np.isin(plans[0].sources, moving).sum() <= 12
        np.testing.assert_allclose(np.asarray(points)[moving], mesh.points[moving] + path[-1], atol=1e-15)
        np.testing.assert_array_equal(np.asarray(points)[fixed], mesh.points[fixed])
        ratios.append((corner_areas(mesh, points) / start).min())
        assert float(jm.quality(mesh, points).min_jacobian_ratio) < ratios[-1] + 0.1
    assert ratios[0] < 0
    assert ratios[1] > 0.7


@pytest.mark.slow
@pytest.mark.parametrize("points", [SMALL, pytest.param(WHOLE, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("leaves", [1, pytest.param(8, marks=pytest.mark.nightly)])
def test_the_convex_airfoil_does_not_get_worse(leaves, points):
    """Mean and largest skewness of the paper's case, with and without NearWall."""
    mesh = cases.naca0015(points=points)
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    u = turned(mesh.points[moving], 0.25, 15)
    values = []
    for correction in (PUBLISHED, NEAR_WALL):
        plan = jm.prepare(mesh.points, moving, fixed, method=few_sources(correction, leaves=leaves, extremes=False))
        report = jm.quality(mesh, jm.deform(plan, u))
        assert int(report.inverted) == 0
        values.append((float(report.mean_skewness), float(report.max_skewness)))
    np.testing.assert_allclose(values[1], values[0], atol=0.01)


def viscous_wing(span=2.0, stations=13):
    """A swept and tapered wing of hexahedra between two planes, its lower wall concave, its first cell 1e-5 chords."""
    section = cases.naca4("6409", points=2000, first_cell=1e-5)
    n, quads = len(section.points), section.cells["quad"]
    eta = np.linspace(0, 1, stations)[:, None]
    x = (1 - 0.3 * eta) * section.points[:, 0] + 0.5 * eta
    z = (1 - 0.3 * eta) * section.points[:, 1]
    points = np.stack([x, np.broadcast_to(span * eta, x.shape), z], axis=-1).reshape(-1, 3)
    hexahedra = np.concatenate([np.hstack([quads + k * n, quads + (k + 1) * n]) for k in range(stations - 1)])
    ids = {name: section.patch(name) + n * np.arange(stations)[:, None] for name in ("airfoil", "farfield")}
    patches = {name: nodes.ravel() for name, nodes in ids.items()}
    return jm.Mesh(points, {"hexahedron": hexahedra}, patches)


@pytest.mark.slow
def test_viscous_wing():
    """Bending by 30 % of the span and 15 degrees of twist, with about 50 + 20 sources."""
    mesh = viscous_wing()
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    base = mesh.points[moving]
    eta = base[:, 1] / 2
    bend = (0.6 * eta**2)[:, None] * [0, 0, 1]
    arm = base[:, [0, 2]] - np.column_stack([0.25 + 0.425 * eta, 0 * eta])
    twist = np.insert(turned(arm, 0, 15 * eta), 1, 0, axis=1)
    coarse = jm.RBF(reduction=jm.KDTree(8, extremes=True), fixed_reduction=jm.KDTree(4))
    worst = {}
    for correction in (PUBLISHED, NEAR_WALL):
        plan = jm.prepare(mesh.points, moving, fixed, method=jm.SurfaceReconstruction(coarse, correction))
        for name, u in (("bend", bend), ("twist", twist)):
            points = jm.deform(plan, u)
            np.testing.assert_allclose(np.asarray(points)[moving], base + u, atol=1e-15)
            report = jm.quality(mesh, points)
            worst[name, correction is NEAR_WALL] = float(report.min_jacobian_ratio)
            if correction is NEAR_WALL:
                assert int(report.inverted) == 0
    for name in ("bend", "twist"):
        assert worst[name, True] > 0.85
        assert worst[name, True] > worst[name, False] + 0.1


def passage(gap, columns=60, rows=40, first_cell=1e-5):
    """The channel between two parallel arcs, finest at both: a blade and the next one."""
    x = np.linspace(0, 1, columns + 1)
    delta = np.log(2 * gap / rows / first_cell)
    across = 0.5 + 0.5 * np.tanh(np.linspace(-delta, delta, rows + 1)) / np.tanh(delta)
    y = 0.6 * x * (1 - x) + gap * across[:, None]
    ids = np.arange(y.size).reshape(y.shape)
    quads = np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1).reshape(-1, 4)
    points = np.stack([np.broadcast_to(x, y.shape), y], axis=-1).reshape(-1, 2)
    return jm.Mesh(points, {"quad": quads}, {"lower": ids[0], "upper": ids[-1]})


@over("gap width", [(0.08, None)], nightly=[(0.08, 1.0), (0.3, None), (0.3, 1.0)])
def test_layers_of_close_walls_end_between_them(gap, width):
    """A bump on each wall closes the passage by 60 %, though the layers of both would reach across it."""
    mesh = passage(gap)
    lower, upper = mesh.patch("lower"), mesh.patch("upper")
    moving = np.concatenate([lower, upper])
    side = np.repeat([1, -1], len(lower))
    bump = 0.3 * gap * side * np.exp(-(((mesh.points[moving, 0] - 0.5) / 0.1) ** 2))
    coarse = jm.RBF(reduction=jm.KDTree(1, extremes=True))
    method = jm.SurfaceReconstruction(coarse, jm.NearWall(width=width))
    points = np.asarray(jm.deform(jm.prepare(mesh.points, moving, method=method), np.column_stack([0 * bump, bump])))
    ratios = corner_areas(mesh, points) / corner_areas(mesh, mesh.points)
    assert 0.1 < ratios.min() < 0.4  # 0.4 is what is left of the gap


def strip(n=40):
    """Points above a flat wall at y = 0, under a fixed wall at y = 1."""
    x = np.linspace(0, 1, 11)
    wall, lid = np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 1])
    inner = np.column_stack([np.full(n, 0.53), np.geomspace(1e-6, 0.9, n)])
    return np.concatenate([wall, lid, inner]), np.arange(11), np.arange(11, 22)


@pytest.mark.parametrize("width", [0.1, 0.3])
def test_the_formula_written_out(width):
    """Wendland's C2 between the wall's mean, by Franke and Little's squared weights, and the correction, alone outside."""
    x = np.linspace(0, 1, 21) ** 1.05  # no two nodes are equally near
    wall, lid = np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 1])
    inner = np.column_stack([np.full(40, x[10] + 0.002), np.geomspace(1e-6, 0.9, 40)])
    points, moving, fixed = np.concatenate([wall, lid, inner]), np.arange(21), np.arange(21, 42)
    u = np.random.default_rng(0).normal(size=(21, 2))
    plans = [jm.prepare(points, moving, fixed, method=method) for method in (PUBLISHED, jm.NearWall(width=width))]
    alone, moved = (np.asarray(jm.deform(plan, u) - points)[42:] for plan in plans)
    apart, gap = (cdist(points[42:], points[nodes]) for nodes in (moving, fixed))
    order = np.argsort(apart, axis=1)[:, :7]
    near = np.take_along_axis(apart, order, axis=1)
    weights = ((near[:, 6:] - near[:, :6]) / (near[:, 6:] * near[:, :6])) ** 2
    wall = np.einsum("kn,knd->kd", weights / weights.sum(axis=1, keepdims=True), u[order[:, :6]])
    halfway = 2 * near[:, 0] / (near[:, 0] + gap.min(axis=1))
    xi = np.minimum(((near[:, 0] / width) ** 4 + halfway**4) ** 0.25, 1)
    chi = ((1 - xi) ** 4 * (4 * xi + 1))[:, None]
    below = points[42:, 1] < 0.5
    assert ((chi > 0.05) & (chi < 0.95)).sum() > 4
    np.testing.assert_allclose(moved[below], (chi * wall + (1 - chi) * alone)[below], rtol=0, atol=1e-5)
    outside = (chi[:, 0] == 0) & below
    assert outside.any()
    np.testing.assert_allclose(moved[outside], alone[outside], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_derivatives_with_respect_to_displacement_and_base_points():
    points, moving, fixed = strip()
    rng = np.random.default_rng(3)
    u = 0.05 * rng.normal(size=(11, 2))
    plan = jm.prepare(points, moving, fixed, method=NEAR_WALL)

    def move(points, u):
        return jm.deform(jm.refit(plan, points), u)

    # along the wall too; nodes and inner points alike, by less than a tenth of the lowest cell
    dpoints, du = 1e-7 * rng.normal(size=points.shape), 1e-7 * rng.normal(size=u.shape)
    _, derivative = jax.jvp(move, (jnp.asarray(points), jnp.asarray(u)), (jnp.asarray(dpoints), jnp.asarray(du)))
    forward, backward = (np.asarray(move(points + s * dpoints, u + s * du)) for s in (0.01, -0.01))
    np.testing.assert_allclose(derivative, (forward - backward) / 0.02, atol=1e-12)
    cotangent = jnp.asarray(rng.normal(size=points.shape))
    _, transpose = jax.vjp(move, jnp.asarray(points), jnp.asarray(u))
    back = sum(float(jnp.vdot(a, b)) for a, b in zip(transpose(cotangent), (dpoints, du), strict=True))
    assert back == pytest.approx(float(jnp.vdot(derivative, cotangent)), rel=1e-9)


@pytest.mark.nightly
def test_same_field_on_a_mesh_refined_along_the_wall():
    """The layer depends on sources, not on how many nodes the wall has: its blend has no scale of its own."""
    fields = []
    for n in (41, 81):
        x = np.linspace(0, 1, n)
        wall, lid = np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 1])
        points = np.concatenate([wall, lid, [[0.31, 0.05], [0.52, 0.1]]])
        u = np.column_stack([0 * x, 0.05 * np.sin(np.pi * x) ** 2])
        plan = jm.prepare(points, np.arange(n), np.arange(n, 2 * n), method=few_sources(NEAR_WALL, leaves=1))
        fields.append(np.asarray(jm.deform(plan, u) - points)[-2:])
    np.testing.assert_allclose(fields[0], fields[1], atol=1e-3)
    assert np.abs(fields[0]).max() > 0.02


@pytest.mark.slow
def test_a_mesh_of_nothing_but_surface():
    points = np.random.default_rng(0).normal(size=(30, 3))
    u = 0.1 * points[:20] ** 2
    moved = jm.deform(jm.prepare(points, np.arange(20), np.arange(20, 30)), u)
    np.testing.assert_array_equal(moved, points + np.concatenate([u, np.zeros((10, 3))]))


@pytest.mark.parametrize("walls", [3, 20])
def test_the_nearest_nodes_of_two_walls_are_those_of_all_distances(walls):
    """Searched wall by wall, or all walls together where they are many."""
    rng = np.random.default_rng(0)
    surface, points = rng.random((200, 3)), rng.random((500, 3))
    wall = rng.permutation(200) % walls
    reach = np.append(rng.uniform(0.02, 0.2, walls - 1), 0)[wall]
    near, rows = near_walls(surface, wall, reach, points, 4)
    apart = cdist(points, surface)
    is_reached = apart < reach[None]
    first = np.where(is_reached, apart, np.inf).argmin(axis=1)
    other = np.where(wall[first][:, None] != wall[None], apart, np.inf)
    bound = 8 * reach[first]
    expected = np.flatnonzero(is_reached.any(axis=1) & (apart[np.arange(500), first] <= other.min(axis=1)))
    np.testing.assert_array_equal(np.sort(near), expected)
    np.testing.assert_array_equal(rows[:, 0], first[near])
    within = other.min(axis=1) < bound
    np.testing.assert_array_equal(rows[:, -1], np.where(within, other.argmin(axis=1), first)[near])


def test_a_reconstruction_takes_the_displacement_where_its_correction_does():
    """Sources of the correction, not of the coarse field: a layer around it would begin from them."""
    mesh = body(2)
    method = jm.SurfaceReconstruction(few(), jm.RBF.classic())
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=method)
    coarse = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=few())
    count = len(plan.surface_nodes)
    assert len(coarse.sources) < count
    np.testing.assert_array_equal(np.sort(plan.method.control(plan.surface.ids).matched), np.arange(count))
    u = np.random.default_rng(0).normal(size=(len(mesh.moving), 2))
    field = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.RBF.classic())
    np.testing.assert_allclose(field.offset(u), 0, rtol=0, atol=1e-9)  # it takes all of them
