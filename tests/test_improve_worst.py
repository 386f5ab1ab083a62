"""Stiffening: the worst cell of an improved mesh, judged by NumPy alone, and derivatives by differences."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import filled, reflected, unit_grid, with_folds
from oracles import corner_areas, jacobians_inside, samples_inside
from runs import over

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._quality.distortion import IDEAL, Bounds, energy, energy_of_cells, stiffened, target
from jaxmorph._quality.vector import corner_points


def smallest_ratio(mesh, points):
    return (corner_areas(mesh, points) / corner_areas(mesh, mesh.points)).min()


@pytest.mark.parametrize("stiffness", [0.1, 2.0])
def test_the_stiffened_energy_is_the_papers_but_for_a_constant_and_a_factor(stiffness):
    """f / (1 - t f) with f = e + 1 and t = s / (1 + s): two differences of it are in the ratio of those of e / (1 - s e)."""
    e = np.array([0.0, 0.1, 0.3, 0.9 / stiffness])
    t = stiffness / (1 + stiffness)
    theirs, ours = (
        (e + 1) / (1 - t * (e + 1)),
        np.asarray(stiffened(jnp.asarray(e), jnp.ones(4), Bounds(stiffness))),
    )
    np.testing.assert_allclose(
        np.diff(theirs) / np.diff(theirs)[0], np.diff(ours) / np.diff(ours)[0], rtol=1e-10
    )
    assert np.isinf(
        stiffened(jnp.asarray([1 / stiffness, 5 / stiffness]), jnp.ones(2), Bounds(stiffness))
    ).all()
    slope = jax.vmap(jax.grad(lambda e: stiffened(e, jnp.asarray(-1.0), Bounds(0.0))))
    np.testing.assert_allclose(slope(jnp.asarray(e)), 1, rtol=0)


def test_the_stiffened_energy_is_infinite_at_the_bound_on_size():
    """Above the bound it is finite and falls with det T, down to 0 at the target; on and below it is infinite."""
    tau = np.array([0.51, 0.6, 0.9, 1.0])
    values = np.asarray(stiffened(jnp.asarray((1 - tau) ** 2), jnp.asarray(tau), Bounds(0.1, 0.5)))
    expected = (1 - tau) ** 2 / (1 - 0.1 * (1 - tau) ** 2) * tau / (tau - 0.5)
    np.testing.assert_allclose(values, expected, rtol=1e-13)
    below = stiffened(jnp.full(3, 0.2), jnp.asarray([0.5, 0.0, -1.0]), Bounds(0.1, 0.5))
    assert np.isinf(below).all()
    slope = jax.vmap(jax.grad(lambda tau: stiffened(jnp.asarray(0.2), tau, Bounds(0.1, 0.5))))
    assert np.isfinite(slope(jnp.asarray([-1.0, 0.0, 0.5, 0.6]))).all()


@over("kind", ["quad", "tetra"], nightly=[kind for kind in IDEAL if kind not in ("quad", "tetra")])
def test_a_cell_without_stiffness_and_with_none_is_the_same(kind):
    ideal = np.array(IDEAL[kind], dtype=float)
    bent = ideal + 0.05 * np.cos(np.arange(ideal.size)).reshape(ideal.shape)
    x = corner_points(jnp.asarray(bent), np.arange(len(ideal))[None])
    goal = target(kind, corner_points(jnp.asarray(ideal), np.arange(len(ideal))[None]), False)
    plain, none, some = (
        energy_of_cells(kind, x, goal, 1e-3, 0.5, s) for s in (None, Bounds(0.0), Bounds(3.0))
    )
    np.testing.assert_allclose(none, plain, rtol=1e-14)
    assert (np.asarray(some) > np.asarray(plain)).all()
    assert float(energy(jnp.asarray(1.0), jnp.asarray(1.0), 1e-9, 0.5, 2)) == pytest.approx(
        0, abs=1e-12
    )


@functools.cache
def pitched(degrees=120):
    mesh = cases.naca0015(points=400)
    wall, far = mesh.patch("airfoil"), mesh.patch("farfield")
    base, plan = mesh.points[wall], jm.prepare(mesh.points, wall, far)
    return mesh, jm.deform(plan, jm.shapes.rotate(base, -np.deg2rad(degrees), [0.25, 0]) - base)


@pytest.mark.slow
def test_the_worst_cell_of_a_pitched_airfoil_is_raised():
    mesh, points = pitched()
    plain, worst = (jm.improve(mesh, points, worst=each) for each in (False, True))
    assert int(worst.before) > 0
    assert int(worst.after) == int(worst.unproven) == 0
    assert smallest_ratio(mesh, worst.points) > 1.3 * smallest_ratio(mesh, plain.points) > 0
    skewness = [float(jm.quality(mesh, each.points).max_skewness) for each in (plain, worst)]
    assert skewness[1] < skewness[0]
    held = mesh.patch("airfoil", "farfield")
    assert np.array_equal(np.asarray(worst.points)[held], np.asarray(points)[held])
    assert float(worst.energy) > float(plain.energy)  # the mean is the price
    assert "proven to fold nowhere inside" in str(worst)
    assert "at a minimum" in str(worst)


def searched(mesh, points):
    """Improves with `worst`; the derivative of the whole search agrees with central differences."""
    rng = np.random.default_rng(4)
    weights, tangent = rng.normal(size=points.shape), 0.01 * rng.normal(size=points.shape)

    def objective(points):
        result = jm.improve(mesh, points, tolerance=1e-10, worst=True)
        return jnp.sum(jnp.sin(3 * result.points) * weights), result

    both, step = jax.jit(jax.value_and_grad(objective, has_aux=True)), 5e-5  # compiled once
    ahead, behind = (float(both(points + side * tangent)[0][0]) for side in (step, -step))
    (_, result), gradient = both(points)
    np.testing.assert_allclose(np.vdot(gradient, tangent), (ahead - behind) / (2 * step), rtol=1e-4)
    return result


def mixed_cube():
    """Makes eight bricks of the unit cube, four of them as wedges and pyramids that share whole faces: two inner nodes."""
    mesh = unit_grid(2, 3)
    cells = np.asarray(mesh.cells["hexahedron"])
    centres = mesh.points[cells].mean(axis=1)
    column, last = (centres[:, :2] < 0.5).all(axis=1), (centres > 0.5).all(axis=1)
    wedges = np.concatenate(
        [cells[column][:, rows] for rows in ([0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7])]
    )
    faces = [[0, 1, 2, 3], [7, 6, 5, 4], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]]
    pyramids = np.column_stack([cells[last][0][faces], np.full(6, len(mesh.points))])
    kinds = {"hexahedron": cells[~column & ~last], "wedge": wedges, "pyramid": pyramids}
    return jm.Mesh(np.vstack([mesh.points, centres[last]]), kinds)


@pytest.mark.nightly
def test_derivatives_of_the_stiffened_minimum_of_mixed_cells_in_3d():
    """A side is pushed in until the bounds move the inner nodes; on an airfoil the bound was lowered."""
    searched(*pitched())
    mesh = mixed_cube()
    assert np.ptp(jm.quality(mesh).volume[:4]) == pytest.approx(0, abs=1e-15)
    assert float(jm.quality(mesh).volume.sum()) == pytest.approx(1)
    points = np.array(mesh.points)
    points[np.all(points == [0.5, 0.5, 1], axis=1)] -= [0.05, 0.1, 0.3]
    worst = searched(mesh, points)
    assert int(worst.after) == int(worst.unproven) == 0
    inner = np.all((mesh.points > 0.01) & (mesh.points < 0.99), axis=1)
    slope = jax.grad(lambda points: jm.distortion(mesh, points).sum())(worst.points)[inner]
    assert np.abs(slope).min() > 0.01  # not the minimum without bounds


@pytest.mark.nightly
@pytest.mark.parametrize("height", [0.3, 0.5])
def test_it_is_never_worse_than_without(height):
    """A bulge whose worst cell is slanted, not small: a lower bound on its distortion would make others smaller."""
    mesh = unit_grid(4)
    x, y = mesh.points.T
    points = mesh.points + np.stack([0 * x, height * np.sin(np.pi * x) * (1 - y) ** 8], axis=1)
    plain, worst = (jm.improve(mesh, points, worst=each, tolerance=1e-8) for each in (False, True))
    assert smallest_ratio(mesh, worst.points) >= smallest_ratio(mesh, plain.points)
    assert int(worst.after) <= int(plain.after)
    batch = jax.vmap(lambda points: jm.improve(mesh, points, worst=True, tolerance=1e-8).points)
    np.testing.assert_allclose(batch(jnp.stack([points] * 2))[1], worst.points, rtol=0, atol=1e-6)


@pytest.mark.nightly
def test_skewness_is_not_the_price_of_nothing():
    """A layer from 1e-7 on, whose upper cells bulge: no stage raises the ratio by 0.5 %, and all stages skew the cells."""
    mesh = unit_grid(4)
    points = np.array(mesh.points)
    points[:, 1] = np.append(0, np.geomspace(1e-7, 1, 4))[np.rint(4 * points[:, 1]).astype(int)]
    x, y = points.T
    mesh, moved = (
        mesh.moved(points),
        points + np.stack([0 * x, 0.2 * np.sin(np.pi * x) * (1 - y)], axis=1),
    )
    plain, worst = (jm.improve(mesh, moved, worst=each) for each in (False, True))
    assert smallest_ratio(mesh, plain.points) > 0.7
    np.testing.assert_array_equal(worst.points, plain.points)
    assert int(worst.steps) > int(plain.steps)  # stages have run


@pytest.mark.nightly
def test_nodes_of_planes_stay_on_them_and_cells_without_free_nodes_do_not_count():
    mesh = unit_grid(4)
    x, y = mesh.points.T
    points = mesh.points + np.stack([0 * x, 0.4 * np.exp(-((x / 0.3) ** 2)) * (1 - y) ** 4], axis=1)
    left = x == 0
    result = jm.improve(
        jm.Boundary(mesh, (), symmetry=jm.Plane((1, 0), (0, 0))), points, worst=True
    )
    assert (np.asarray(result.points)[left, 0] == 0).all()
    assert int(result.after) == 0
    held = jm.improve(jm.Boundary(mesh, (), fixed=np.arange(len(points))), points, worst=True)
    assert np.array_equal(held.points, points)
    assert float(held.residual) == 0


@pytest.mark.nightly
def test_a_cell_that_is_invalid_from_the_start_is_told_and_judged_by_its_own_margin():
    """A quad with a corner beyond its diagonal, undeformed: inverted by itself, not proven, and no worse."""
    mesh = unit_grid(3)
    points = np.array(mesh.points)
    points[0] = (
        0.8 * points[5] + 0.2 * points[0]
    )  # of the first cell, all other nodes of which stay
    mesh = mesh.moved(points)
    result = jm.improve(jm.Boundary(mesh, (), fixed=np.arange(len(points))), points, worst=True)
    assert int(result.before) == int(result.after) == int(result.lost) == 1
    assert int(result.unproven) == int(result.from_start) == 1
    assert "but for 1 (1 of them as on the undeformed mesh or better)" in str(result)


@over(
    "kind",
    ["triangle"],
    slow=["quad", "tetra"],
    nightly=["pyramid", "wedge", "hexahedron", "triangle6", "quad9"],
)
def test_a_mesh_that_arrives_folded_is_unfolded(kind):
    """Nothing but the folded mesh is known; samples of det J of the cells, as they were before some were turned, decide."""
    mesh, cell = filled(kind), lagrange_types()[kind]
    ids, places = (
        np.asarray(mesh.cells[kind]),
        samples_inside(cell.shape, 2 if cell.order == 1 else 9),
    )

    def folded(points):
        values = jacobians_inside(
            cell.shape, cell.order, cell.lattice, np.asarray(points)[ids], places
        )
        return int((values.min(axis=1) < 0).sum())

    for seed in range(3):
        start = with_folds(mesh, seed=seed)
        assert folded(start) > 0
        result = jm.improve(reflected(mesh.moved(start), seed), start)
        assert int(result.before) > 0
        assert int(result.after) == folded(result.points)
        assert (
            int(result.after) == 0 or cell.order > 1
        )  # pieces of a curved cell are unfolded, its inside may not be
        assert " are now" in str(result)


@pytest.mark.nightly
def test_what_stays_folded_is_counted():
    """All nodes of a triangle in a corner are held, one of them beyond the other two."""
    mesh = filled("triangle", 2)
    points = np.array(mesh.points)
    points[np.argmin(abs(points - [1, 0]).sum(axis=1))] = [0.6, 0.4]
    result = jm.improve(reflected(mesh.moved(points)), points)
    assert int(result.before) == int(result.after) == int(result.lost) == 1
    assert "1 of 8 cells were inverted, 1 are now" in str(result)
