"""Inner nodes where the distortion of all cells is least: closed forms, differences, and grids that a morph has inverted."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from meshes import blocks, lattice, ring, turn, unit_grid
from runs import over, runs

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.linear.hessians import solve
from jaxmorph._improve.constraints import problem_of
from jaxmorph._quality.distortion import IDEAL, energy, samples, target
from jaxmorph._quality.smooth_quality import positive_part
from jaxmorph._quality.vector import corner_points


def cell(kind, points=None):
    ideal = np.array(IDEAL[kind], dtype=float)
    return jm.Mesh(ideal if points is None else points, {kind: np.arange(len(ideal))[None]})


KINDS = runs(["quad", "tetra"], nightly=[kind for kind in IDEAL if kind not in ("quad", "tetra")])


def mean_energy(mesh, points, softness=0.0, size_weight=0.5, ideal=False):
    """Of the first cell."""
    kind, ids = next(iter(mesh.cells.items()))
    of = target(kind, corner_points(jnp.asarray(mesh.points), ids), ideal)
    squared, tau = samples(kind, corner_points(jnp.asarray(points), ids), of)
    values = of.counts * energy(squared, tau, softness, size_weight, mesh.points.shape[1])
    return float(jnp.sum(values) / jnp.sum(of.counts))


@pytest.mark.parametrize("kind", KINDS)
def test_energy_is_that_of_the_singular_values(kind):
    """Of any linear map from the ideal cell, with sigma from SciPy's side: the mean ratio and the size by themselves."""
    rng = np.random.default_rng(1)
    mesh = cell(kind)
    d = mesh.points.shape[1]
    linear = np.eye(d) + 0.3 * rng.normal(size=(d, d))
    linear *= np.sign(np.linalg.det(linear))
    sigma = np.linalg.svd(linear, compute_uv=False)
    det = sigma.prod() * np.sign(np.linalg.det(linear))
    if det < 0:
        linear, det = linear[:, [1, 0, *range(2, d)]], -det
    moved = mesh.points @ linear.T
    inverse_mean_ratio = (sigma**2).sum() / d / det ** (2 / d)
    for weight, expected in ((0.0, inverse_mean_ratio - 1), (1.0, (det + 1 / det) / 2 - 1)):
        np.testing.assert_allclose(
            mean_energy(mesh, moved, size_weight=weight), expected, rtol=1e-12, atol=1e-13
        )
    np.testing.assert_allclose(
        mean_energy(mesh, 3 * moved @ linear.T, ideal=True, size_weight=0.0) >= 0, True
    )
    np.testing.assert_allclose(mean_energy(mesh, mesh.points, ideal=True), 0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_left_handed_cells_are_their_own_target(kind):
    ideal = np.array(IDEAL[kind], dtype=float)
    mirrored = cell(kind, ideal * np.array([-1, 1, 1])[: ideal.shape[1]])
    for is_ideal in (False, True):
        np.testing.assert_allclose(
            mean_energy(mirrored, mirrored.points, ideal=is_ideal), 0, atol=1e-12
        )


@pytest.mark.parametrize("softness", [0.5, 2.0])
def test_the_positive_part_is_the_positive_root_of_its_equation(softness):
    x = jnp.linspace(-3.0, 3.0, 7)
    found = positive_part(x, softness)
    assert (found > 0).all()
    np.testing.assert_allclose(found * (found - x), np.full(7, softness**2 / 4), rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_inverted_cells_have_a_finite_energy_that_pulls_them_back(kind):
    mesh = cell(kind)
    flat = np.array(mesh.points)
    turned = flat * ([1.0, -0.3] if flat.shape[1] == 2 else [1, 1, -0.3])
    stretch = turned - flat  # away from the ideal cell
    along = [mean_energy(mesh, flat + t * stretch, softness=1e-2) for t in (0.7, 0.9, 1.0)]
    assert np.all(np.isfinite(along))
    assert along[0] < along[1] < along[2]
    assert along[2] > 10


@over("dimension", slow=[2], nightly=[3])
def test_it_finds_scipys_minimum_and_untangles(dimension):
    mesh = unit_grid(3, dimension)
    rng = np.random.default_rng(2)
    inner = np.all((mesh.points > 0.01) & (mesh.points < 0.99), axis=1)
    # one bulge of a side, and inner nodes that are anywhere
    points = mesh.points + 0.15 * np.sin(np.pi * mesh.points[:, :1]) * np.eye(dimension)[1]
    points[inner] += 0.25 * rng.normal(size=points[inner].shape)
    result = jm.improve(mesh, points, tolerance=1e-9)
    assert int(result.before) > 0
    assert int(result.after) == 0
    assert float(result.residual) < 1e-6
    assert np.array_equal(np.asarray(result.points)[~inner], points[~inner])
    assert "0 are now" in str(result)
    distortion, _ = problem_of(jm.Boundary(mesh, ()), mesh, jnp.float64, False, 0.5)
    found = jnp.asarray(result.points)
    sharp = eqx.tree_at(lambda it: it.softness, distortion, jnp.asarray(1e-3))
    value_and_grad = jax.jit(jax.value_and_grad(lambda y: sharp(y.reshape(found.shape), found)))
    oracle = scipy.optimize.minimize(
        lambda y: [np.asarray(part) for part in value_and_grad(y)],
        0.02 * rng.normal(size=found.size),
        jac=True,
        method="L-BFGS-B",
        options={"ftol": 1e-14, "gtol": 1e-8, "maxiter": 2000},
    )
    np.testing.assert_allclose(oracle.fun, value_and_grad(jnp.zeros(found.size))[0], rtol=1e-9)


@pytest.mark.nightly
def test_nodes_slide_in_planes():
    """The lattice is the minimum for ideal squares, and its sides come back to it along themselves, to SciPy's digits."""
    mesh = unit_grid(3)
    regular = np.asarray(mesh.points)
    sides = {
        f"{'xy'[axis]}{end}": np.flatnonzero(regular[:, axis] == end)
        for axis in (0, 1)
        for end in (0, 1)
    }
    mesh = jm.Mesh(regular, mesh.cells, sides)
    corners = np.flatnonzero((np.abs(regular - 0.5) > 0.4).all(axis=1))
    points = regular + 0.08 * np.random.default_rng(3).normal(size=regular.shape)
    points[corners] = regular[corners]
    for name, nodes in sides.items():
        points[nodes, "xy".index(name[0])] = float(name[1])
    plane = jm.Plane((1, 0), (0, 0))
    result = jm.improve(
        jm.Boundary(mesh, (), symmetry=plane, sliding=("x1", "y0", "y1")), points, tolerance=1e-9
    )
    np.testing.assert_allclose(result.points, regular, rtol=0, atol=1e-7)
    for name, nodes in sides.items():
        assert (np.asarray(result.points)[nodes, "xy".index(name[0])] == float(name[1])).all()
    held = np.asarray(
        jm.improve(jm.Boundary(mesh, (), symmetry=plane), points, tolerance=1e-3).points
    )
    assert (held[sides["x1"]] == points[sides["x1"]]).all()
    assert np.abs(held - points)[sides["x0"]].max() > 1e-3


@pytest.mark.nightly
def test_derivatives_with_nodes_that_slide():
    """Against central differences of the whole solve, along a slanted side too; what leads off the side is data."""
    mesh = unit_grid(3)
    base = mesh.points @ np.array([[1.0, 0.3], [0.0, 1.0]])
    sides = {
        name: np.flatnonzero(mesh.points[:, axis] == 0) for name, axis in (("left", 0), ("low", 1))
    }
    mesh = jm.Mesh(base, mesh.cells, sides)
    points = jnp.asarray(base + 0.05 * np.sin(3 * base[:, ::-1]))
    rng = np.random.default_rng(4)
    weights, tangent = rng.normal(size=points.shape), rng.normal(size=points.shape)

    boundary = jm.Boundary(mesh, (), sliding=("left", "low"))

    def objective(points):
        improved = jm.improve(boundary, points, tolerance=1e-10).points
        return jnp.sum(jnp.sin(3 * improved) * weights)

    step = 1e-4
    both = jax.jit(jax.value_and_grad(objective))
    difference = (both(points + step * tangent)[0] - both(points - step * tangent)[0]) / (2 * step)
    np.testing.assert_allclose(np.vdot(both(points)[1], tangent), difference, rtol=1e-6)
    np.testing.assert_allclose(
        jax.jvp(objective, (points,), (jnp.asarray(tangent),))[1], difference, rtol=1e-6
    )


@functools.cache
def quarter():
    """A quarter of a ring of quads from radius 1 to 2, its nodes' radii and angles; the ends repeat each other."""
    radius, angle = lattice(np.linspace(1, 2, 4), np.pi / 8 * np.arange(5)).T
    ids = np.arange(20).reshape(4, 5)
    patches = {"hub": ids[0], "shroud": ids[-1], "first": ids[:, 0], "last": ids[:, -1]}
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    mesh = jm.Mesh(points, {"quad": blocks(ids)}, patches)
    wrapped = {
        "sliding": jm.Slide("shroud", jm.Revolution()),
        "periodic": jm.Periodic("first", "last"),
    }
    return mesh, radius, angle, wrapped


@pytest.mark.nightly
def test_nodes_slide_on_curved_walls_and_pairs_move_alike():
    """The undeformed mesh is its own minimum: nodes that have slid along a circle, or between periodic sides, come back."""
    mesh, radius, angle, wrapped = quarter()
    moved = angle + 0.1 * (radius > 1) * np.cos(4 * angle + radius)
    farther = radius + 0.05 * np.sin(np.pi * radius) * np.cos(4 * angle)
    points = np.stack([farther * np.cos(moved), farther * np.sin(moved)], axis=1)
    result = jm.improve(jm.Boundary(mesh, (), **wrapped), points, tolerance=1e-8)
    assert float(result.residual) < 1e-6
    np.testing.assert_allclose(result.points, mesh.points, rtol=0, atol=1e-6)
    found = np.asarray(result.points)
    np.testing.assert_allclose(
        np.linalg.norm(found[mesh.patch("shroud")], axis=1), 2, rtol=0, atol=1e-14
    )
    first, last = (found[[0, 5, 10, 15]], found[[4, 9, 14, 19]])
    np.testing.assert_allclose(last, first @ turn(np.pi / 2, 2).T, rtol=0, atol=1e-14)
    assert np.array_equal(found[mesh.patch("hub")], points[mesh.patch("hub")])


@pytest.mark.nightly
def test_a_node_at_a_quarter_turn_from_its_start_is_no_minimum():
    """A step in the plane of the start, put back on the circle, ends there at the farthest: its slope vanishes."""
    mesh = ring(16, (1, 1.5, 2), ("inner", "outer"))
    points = mesh.points.copy()
    points[16:] = points[16:] @ turn(np.deg2rad(100), 2).T
    boundary = jm.Boundary(
        mesh, (), fixed=mesh.patch("inner"), sliding=jm.Slide("outer", jm.Revolution())
    )
    result = jm.improve(boundary, points)
    assert float(result.residual) == np.inf
    assert "stopped early" in str(result)


@over("case", [2], nightly=[3, "walls"])
def test_blocks_add_up_to_the_hessian(case):
    """With the walls' curvature in it, and nothing of what is off a wall or follows a partner; the host solves with it."""
    mesh, _, _, wrapped = quarter() if case == "walls" else (unit_grid(3, case), None, None, {})
    n, d = mesh.points.shape
    base, rng = (
        jnp.asarray(mesh.points + 0.05 * np.sin(3 * mesh.points[:, ::-1])),
        np.random.default_rng(0),
    )
    distortion, pairs = problem_of(jm.Boundary(mesh, (), **wrapped), mesh, jnp.float64, False, 0.5)
    ways = eqx.filter_jit(distortion.ways.at)(base)
    distortion, y = (
        eqx.tree_at(lambda it: it.ways, distortion, ways),
        jnp.asarray(0.1 * rng.normal(size=base.shape)),
    )
    dense = np.asarray(jax.jit(jax.hessian(lambda y: distortion(y, base)))(y)).reshape(n * d, -1)
    assert (np.abs(np.asarray(ways.off)).max() > 0.1) == (case == "walls")
    rows = pairs.order[np.repeat(np.arange(n), np.diff(pairs.starts))]

    def whole(blocks):
        data, matrix = np.zeros((len(pairs.columns), d, d)), np.zeros((n, d, n, d))
        np.add.at(data, pairs.block, np.moveaxis(blocks, 2, 0))
        matrix[rows, :, pairs.order[pairs.columns]] = data
        matrix[np.arange(n), :, np.arange(n)] -= ways.off
        return matrix.reshape(n * d, -1)

    exact, convex = (
        np.asarray(eqx.filter_jit(distortion.blocks)(y, base, floor)) for floor in (-jnp.inf, 0.0)
    )
    np.testing.assert_allclose(whole(exact), dense, rtol=0, atol=1e-11)
    if case != "walls":  # nothing but negative curvature of samples is left out
        assert np.linalg.eigvalsh(whole(convex) - dense).min() > -1e-9
        right = rng.normal(size=(n, d))
        found = solve(*pairs, convex, np.ones(n), right)
        np.testing.assert_allclose(
            (whole(convex) + np.eye(n * d)) @ found.ravel(), right.ravel(), atol=1e-9
        )


@pytest.mark.nightly
def test_nodes_slide_on_faces():
    """The corners of 16 faces may be passed; what has slid along the circle comes back to 0.1 % of it, the hub stays."""
    mesh = ring(16, (1, 1.5, 2), ("inner", "outer"))
    points = np.asarray(mesh.points)
    start, angles = np.array(points), 0.3 * np.pi / 8 * np.linspace(0, 1, 16)
    start[32:] = [turn(angle, 2) @ point for angle, point in zip(angles, points[32:], strict=True)]
    result = jm.improve(jm.Boundary(mesh, (), sliding="outer"), start, tolerance=1e-8)
    np.testing.assert_allclose(result.points, points, rtol=0, atol=2e-3)
    assert float(result.residual) < 1e-4  # no edge between faces stops the search
    assert np.array_equal(np.asarray(result.points)[:16], points[:16])


@pytest.mark.nightly
def test_the_undeformed_mesh_is_left_alone_and_keeps_its_boundary_layer():
    mesh = unit_grid(6)
    points = mesh.points.copy()
    points[:, 1] = points[:, 1] ** 6  # first cell 2e-5 thick
    mesh = mesh.moved(points)
    result = jm.improve(mesh, points)
    np.testing.assert_allclose(result.points, points, atol=1e-6)
    np.testing.assert_allclose(jm.improve(mesh, points + 0.2).points, points + 0.2, atol=1e-6)


@pytest.mark.nightly
@pytest.mark.parametrize("order", [1, 2])
def test_what_held_nodes_invert_is_told(order):
    """A corner of the square lies beyond its neighbours on the sides, which are held too: its cell stays inverted."""
    mesh = unit_grid(3) if order == 1 else jm.elevate(unit_grid(3), order)
    points = np.array(mesh.points)
    points[0] = [0.5, 0.5]
    result = jm.improve(mesh, points)
    assert bool(jm.quality(mesh, result.points).is_inverted[0])
    assert (int(result.lost), result.cells) == (1, 9)
    assert "1 stay inverted at a corner with held nodes alone" in str(result)
    points[0] = mesh.points[0]
    points[np.all((points > 0.01) & (points < 0.99), axis=1)] += [0.4, 0]
    mended = jm.improve(mesh, points)
    assert int(mended.before) > 0 == int(mended.after) == int(mended.lost)


@pytest.mark.nightly
def test_ideal_targets_make_a_lattice_regular_again():
    """Their minimum is known: the regular grid, whatever the inner nodes of the undeformed mesh were."""
    regular = unit_grid(3)
    inner = np.all((regular.points > 0.01) & (regular.points < 0.99), axis=1)
    points = regular.points + 0.05 * inner[:, None] * np.random.default_rng(3).normal(
        size=regular.points.shape
    )
    result = jm.improve(regular.moved(points), points, ideal=True, size_weight=0.0, tolerance=1e-9)
    np.testing.assert_allclose(result.points, regular.points, atol=1e-7)
    assert not np.allclose(
        jm.improve(regular.moved(points), points).points, regular.points, atol=1e-3
    )


@pytest.mark.nightly
def test_an_airfoil_beyond_what_graph_mapping_bears():
    mesh = cases.naca0015(points=1500)
    base = mesh.points[mesh.patch("airfoil")]
    plan = jm.prepare(
        mesh.points, mesh.patch("airfoil"), mesh.patch("farfield"), method=jm.DelaunayGraph()
    )
    points = jm.deform(plan, jm.shapes.rotate(base, -np.pi / 2, [0.25, 0]) - base)
    assert int(jm.quality(mesh, points).inverted) > 100
    result = jm.improve(mesh, points)
    assert int(result.after) == 0
    report = jm.quality(mesh, result.points)
    assert float(report.min_jacobian_ratio) > 0.5
    held = mesh.patch("airfoil", "farfield")
    assert np.array_equal(np.asarray(result.points)[held], np.asarray(points)[held])


def test_soft_maximum_of_equal_values_is_theirs_and_sharpens():
    values = np.array([[0.2, 0.5, 0.1], [0.7, 0.7, 0.7]])
    np.testing.assert_allclose(
        jm.soft_maximum(values, 1e4, axis=1), [0.5 - np.log(3) / 1e4, 0.7], rtol=1e-12
    )
    np.testing.assert_allclose(
        jm.soft_maximum(values, 3.0), np.log(np.mean(np.exp(3 * values))) / 3, rtol=1e-12
    )
    np.testing.assert_allclose(jax.grad(jm.soft_maximum)(jnp.ones(4)), 0.25)


@over("kind", ["quad"], nightly=["triangle"])
def test_the_distortion_of_a_stretched_cell(kind):
    """Of a cell twice as large |T|^2 = 8 and det T = 4: half of 1 and half of 17 / 8, less 1; nothing where none has moved."""
    mesh = cell(kind)
    np.testing.assert_allclose(
        jm.distortion(mesh, mesh.points), 0, atol=1e-6
    )  # the square of the softness
    np.testing.assert_allclose(
        jm.distortion(mesh, 2 * mesh.points), 0.5 + 0.5 * 17 / 8 - 1, rtol=1e-6
    )
    with pytest.raises(ValueError, match="not defined"):
        jm.distortion(jm.Mesh(np.zeros((4, 3)), {"triangle": [[0, 1, 2]]}))


@over("row count", [(12, 1)], nightly=[(7, 0)], ids=["across", "beside"])
def test_repeated_points_count_where_they_fold_a_cell(row, count):
    """On an unmoved mesh: a quadrilateral without one side is none that is inverted, one folded onto its diagonal is."""
    mesh = unit_grid(4)
    points = np.array(mesh.points)
    points[row] = points[6]
    mesh = jm.Mesh(points, mesh.cells)
    improved = jm.improve(mesh, points)
    assert (int(improved.before), int(improved.after)) == (count, 0)
    assert int(jm.quality(mesh).inverted) == count
