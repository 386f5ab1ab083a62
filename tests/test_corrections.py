"""Corrections: boundary layers on walls that are not convex, the nearest node's offset, functions of many scales."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few, motion, moved_by, planned, surface_values, whole_and_part
from meshes import cusped
from oracles import corner_areas
from runs import over, runs
from scipy.spatial.distance import cdist

import jaxmorph as jm
from jaxmorph import cases, shapes
from jaxmorph._host.sources.hierarchy import farthest_first
from jaxmorph._host.surface.neighbours import near_walls
from jaxmorph._methods.corrections import LocalFactors
from jaxmorph._methods.sparse import Reach
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
        *(
            ("cusped", SMALL, True, turn),
            ("cusped", SMALL, True, camber),
            ("6612", SMALL, True, flap_up),
        ),
        *(("9412", SMALL, False, turn), ("4412", WHOLE, False, less_camber)),
    ],
)


@pytest.mark.slow
@pytest.mark.parametrize(("section", "points", "extremes", "motion"), INVERTED)
def test_the_defect_and_the_cure(section, points, extremes, motion):
    own = section == "cusped"
    mesh = (
        c_grid(cusped, points=points, first_cell=1e-6)
        if own
        else cases.naca4(section, points=points)
    )
    moving, fixed = mesh.patch("airfoil"), mesh.patch("farfield")
    path, start = motion(mesh.points[moving]), corner_areas(mesh, mesh.points)
    ratios = []
    for correction in (PUBLISHED, NEAR_WALL):
        method = few_sources(correction, extremes=extremes)
        plans, points = jm.march(jm.prepare(mesh.points, moving, fixed, method=method), path)
        assert 6 <= np.isin(plans[0].sources, moving).sum() <= 12
        np.testing.assert_allclose(
            np.asarray(points)[moving], mesh.points[moving] + path[-1], atol=1e-15
        )
        np.testing.assert_array_equal(np.asarray(points)[fixed], mesh.points[fixed])
        ratios.append((corner_areas(mesh, points) / start).min())
        assert float(jm.quality(mesh, points).min_jacobian_ratio) < ratios[-1] + 0.1
    assert ratios[0] < 0
    assert ratios[1] > 0.7


def passage(gap, columns=60, rows=40, first_cell=1e-5):
    """The channel between two parallel arcs, finest at both: a blade and the next one."""
    x = np.linspace(0, 1, columns + 1)
    delta = np.log(2 * gap / rows / first_cell)
    across = 0.5 + 0.5 * np.tanh(np.linspace(-delta, delta, rows + 1)) / np.tanh(delta)
    y = 0.6 * x * (1 - x) + gap * across[:, None]
    ids = np.arange(y.size).reshape(y.shape)
    quads = np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]], axis=-1).reshape(
        -1, 4
    )
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
    points = np.asarray(
        jm.deform(jm.prepare(mesh.points, moving, method=method), np.column_stack([0 * bump, bump]))
    )
    ratios = corner_areas(mesh, points) / corner_areas(mesh, mesh.points)
    assert 0.1 < ratios.min() < 0.4  # 0.4 is what is left of the gap


@pytest.mark.parametrize("width", [0.1, 0.3])
def test_the_formula_written_out(width):
    """Wendland's C2 between the wall's mean, by Franke and Little's squared weights, and the correction, alone outside."""
    x = np.linspace(0, 1, 21) ** 1.05  # no two nodes are equally near
    wall, lid = np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 1])
    inner = np.column_stack([np.full(40, x[10] + 0.002), np.geomspace(1e-6, 0.9, 40)])
    points, moving, fixed = np.concatenate([wall, lid, inner]), np.arange(21), np.arange(21, 42)
    u = np.random.default_rng(0).normal(size=(21, 2))
    plans = [
        jm.prepare(points, moving, fixed, method=method)
        for method in (PUBLISHED, jm.NearWall(width=width))
    ]
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
    np.testing.assert_allclose(
        moved[below], (chi * wall + (1 - chi) * alone)[below], rtol=0, atol=1e-5
    )
    outside = (chi[:, 0] == 0) & below
    assert outside.any()
    np.testing.assert_allclose(moved[outside], alone[outside], rtol=0, atol=1e-15)


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
    expected = np.flatnonzero(
        is_reached.any(axis=1) & (apart[np.arange(500), first] <= other.min(axis=1))
    )
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
    np.testing.assert_array_equal(
        np.sort(plan.method.control(plan.surface.ids).matched), np.arange(count)
    )
    u = np.random.default_rng(0).normal(size=(len(mesh.moving), 2))
    field = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.RBF.classic())
    np.testing.assert_allclose(field.offset(u), 0, rtol=0, atol=1e-9)  # it takes all of them


def nearest_by_hand(mesh, values, radius):
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
    expected = mesh.points + nearest_by_hand(mesh, values, np.full(len(values), 2.0))
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
    expected = (
        mesh.points
        + coarse
        + nearest_by_hand(mesh, values - coarse[mesh.boundary], np.concatenate(radius))
    )
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_nothing_is_corrected_where_every_node_is_a_source():
    """The radius is zero there: so are weights and derivatives, on the node and off it."""
    nodes = Reach(jnp.zeros(1, int), jnp.ones(1, bool))

    def weight(x, radius, surface):
        return (
            jm.LocalCorrection()
            .place(x, nodes, LocalFactors(radius, jnp.array(True)), surface)
            .weights.sum()
        )

    for x in np.eye(2):
        value, slopes = jax.value_and_grad(weight, (0, 1, 2))(
            jnp.asarray(x), jnp.zeros(1), jnp.asarray([[1.0, 0.0]])
        )
        assert value == 0
        assert all((slope == 0).all() for slope in slopes)


@over("correction", [jm.Multiscale()], nightly=[jm.LocalCorrection(0.5)])
def test_points_beyond_the_hull_of_the_boundary_are_moved(correction):
    """A graph would refuse them."""
    points = np.random.default_rng(0).uniform(-1, 1, (60, 2))
    inner = np.flatnonzero(np.abs(points).max(axis=1) < 0.7)
    plan = jm.prepare(points, inner, method=jm.SurfaceReconstruction(few(1), correction))
    turn = np.asarray(shapes.rotate(jnp.asarray(points), 0.3, (0.0, 0.0))) - points
    np.testing.assert_allclose(jm.deform(plan, turn[inner]), points + turn, rtol=0, atol=1e-10)


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
        left -= (
            wendland(np.linalg.norm(surface - surface[node], axis=1) / gap[node])[:, None]
            * coefficient
        )
        field += (
            wendland(np.linalg.norm(points - surface[node], axis=1) / gap[node])[:, None]
            * coefficient
        )
        before.append(node)


@pytest.mark.parametrize("dimension", [2, pytest.param(3, marks=pytest.mark.nightly)])
def test_as_the_paper_tells_it(dimension):
    mesh = body(dimension)
    plan, coarse_plan = (
        planned(mesh, jm.SurfaceReconstruction(few(), jm.Multiscale())),
        planned(mesh, few()),
    )
    u, values = surface_values(mesh)
    coarse = np.asarray(jm.deform(coarse_plan, u)) - mesh.points
    missed = values - coarse[mesh.boundary]
    order, sources = (
        np.asarray(plan.images.rows),
        np.asarray(coarse_plan.surface.ids),
    )  # a method's rows go by place
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


@over(
    "method",
    slow=[jm.Multiscale()],
    nightly=[jm.Multiscale.whole(1.0, 0.2)],
    ids=["alone", "whole"],
)
def test_mirror_images_move_alike(method):
    """The field of the whole surface, images included, is symmetric: nodes on the plane have no motion across it."""
    part, role, *_ = whole_and_part(2, 1)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    plan = jm.prepare(part, moving, fixed, method=method, symmetry=jm.Plane([1, 0], [0, 0]))
    u = motion(part)[moving]
    u[part[moving, 0] == 0, 0] = 0
    surface = plan.surface
    own = jnp.zeros((len(surface.nodes), 2)).at[: len(moving)].set(u)
    field = plan.method.field(
        surface.ids, surface.factors, surface.points, surface.images.vectors(own)
    )
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
    plan = jm.prepare(
        points, moving, mesh.fixed, method=jm.SurfaceReconstruction(few(), jm.Multiscale())
    )
    moved = np.asarray(jm.deform(plan, u))
    assert (moved[moving] == points[moving] + u).all()
    assert np.isfinite(moved).all()
    assert np.abs(moved - points).max() < 0.2
