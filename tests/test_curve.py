"""Curving: nodes of high order on the wall, and cells that stay valid where their straight corners say nothing."""

import jax
import jax.numpy as jnp
import meshes
import numpy as np
import pytest
from runs import over, refusals

import jaxmorph as jm
from jaxmorph._host.cells.lagrange import lagrange_types
from jaxmorph._host.cells.topology import CORNERS

TYPES = lagrange_types()


def ring(n: int = 12, layers: int = 3) -> jm.Mesh:
    return meshes.ring(n, np.linspace(1, 2, layers + 1))


def unit(x):
    return x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", ["triangle", "quad", "tetra", "pyramid", "wedge", "hexahedron"])
@pytest.mark.parametrize("order", [2, 3])
def test_elevated_cell_is_the_straight_cell(kind, order):
    cell = TYPES[kind]
    x = cell.reference + 0.05 * np.random.default_rng(1).normal(size=cell.reference.shape)
    mesh = jm.Mesh(x, {kind: np.arange(len(x))[None]}, {"all": np.arange(len(x))})
    high = jm.elevate(mesh, order)
    (name,) = high.cells
    assert (TYPES[name].shape, TYPES[name].order) == (kind, order)
    np.testing.assert_allclose(jm.quality(high).volume, jm.quality(mesh).volume, rtol=1e-12)
    edges = high.points[high.cells[name][0]][
        TYPES[name].edges
    ]  # inner nodes at equal steps of straight edges
    steps = np.arange(1, order)[:, None] / order
    np.testing.assert_allclose(
        edges[:, 2:], edges[:, :1] + steps * (edges[:, 1:2] - edges[:, :1]), atol=1e-14
    )


def test_neighbours_of_all_types_share_the_nodes_of_their_faces():
    """A hexahedron with a pyramid on it, a wedge beside it and a tetrahedron on the pyramid: as many nodes as their union."""
    points = np.array(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
        float,
    )
    points = np.concatenate(
        [points, [(0.5, 0.5, 1.6), (1.7, 0, 0.5), (1.7, 1, 0.5), (1.5, 0.5, 1.7)]]
    )
    cells = {"hexahedron": [range(8)], "pyramid": [[4, 5, 6, 7, 8]]}
    cells |= {"wedge": [[1, 9, 5, 2, 10, 6]], "tetra": [[5, 11, 6, 8]]}
    mesh = jm.Mesh(
        points, {kind: np.array([list(row) for row in rows]) for kind, rows in cells.items()}
    )
    assert not jm.quality(mesh).is_inverted.any()
    high = jm.elevate(mesh, 3)
    assert len(np.unique(np.round(high.points, 9), axis=0)) == len(high.points)
    assert sum(map(len, jm.boundary_faces(high).values())) == 9 * sum(
        map(len, jm.boundary_faces(mesh).values())
    )


@over("order", slow=[3], nightly=[2])
def test_curved_ring_converges_to_the_circle(order):
    errors = []
    for n in (8, 16):
        high = jm.elevate(ring(n), order)
        curved = jm.curve(high, unit, "wall", "far")
        wall = curved.points[high.patch("wall")]
        np.testing.assert_allclose(np.linalg.norm(wall, axis=1), 1, atol=1e-12)
        report = jm.quality(curved)
        assert int(report.inverted) == 0
        outside = n / 2 * np.sin(2 * np.pi / n) * 4  # the outer polygon stays
        errors.append(abs(float(report.volume.sum()) - (outside - np.pi)))
    assert errors[1] < errors[0] / 2 ** (order + 0.8)  # that of straight walls is of order 2


@pytest.mark.nightly
def test_surface_as_places_function_and_mesh():
    high = jm.elevate(ring(), 2)
    nodes = high.patch("wall")
    by_function = jm.curve(high, unit, "wall", "far").points
    by_places = jm.curve(high, unit(high.points[nodes]), "wall", "far").points
    np.testing.assert_array_equal(by_function, by_places)
    lines = jm.Mesh(
        meshes.circle(400),
        {"line": np.stack([np.arange(400), np.roll(np.arange(400), -1)], axis=1)},
    )
    by_mesh = jm.curve(high, lines, "wall", "far").points
    assert np.abs(np.linalg.norm(by_mesh[nodes], axis=1) - 1).max() <= 1.001 * (
        1 - np.cos(np.pi / 400)
    )
    np.testing.assert_allclose(
        by_mesh, by_function, atol=1e-3
    )  # along the wall the normal of a line leads elsewhere


def test_inverted_sees_a_fold_between_corners():
    """An edge bent beyond the opposite one: all corners are as they were, the cell is not."""
    mesh = jm.elevate(
        jm.Mesh(np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)]), {"quad": [[0, 1, 2, 3]]}), 2
    )
    bent = np.array(mesh.points)
    middle = np.flatnonzero(np.isclose(bent, (0.5, 0)).all(axis=1))[0]
    bent[middle, 1] = 0.9
    assert bool(jm.inverted(mesh, bent)[0])
    assert bool(jm.quality(mesh.moved(bent)).is_inverted[0])
    corners = jm.Mesh(bent, {"quad": mesh.cells["quad9"][:, :4]})
    assert not bool(jm.quality(corners).is_inverted[0])
    with pytest.raises(ValueError, match="1 of 1 cell is inverted"):
        jm.quality(mesh, bent).raise_if_inverted()


@over(
    "method",
    slow=[jm.LinearElasticity()],
    nightly=[None, jm.TorsionalSprings(), jm.RBF.classic(jm.WendlandC2(4.0))],
)
def test_methods_move_all_nodes_and_pass_derivatives(method):
    high = jm.curve(jm.elevate(ring(), 3), unit, "wall", "far")
    plan = jm.prepare(high, "wall", "far", method=method)
    wall = high.points[high.patch("wall")]
    u = 0.1 * jnp.stack([jnp.sin(2 * wall[:, 1]), wall[:, 0] ** 2], axis=1)
    moved = jm.deform(plan, u)
    np.testing.assert_allclose(moved[high.patch("wall")], wall + u, atol=1e-10)
    assert int(jm.quality(high, moved).inverted) == 0

    def least(t):
        return jm.quality(high, jm.deform(plan, t * u)).min_jacobian_ratio

    step = 1e-6
    difference = (least(1 + step) - least(1 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(least)(1.0), difference, rtol=1e-5)


def test_report_of_straight_cells_is_that_of_their_corners():
    for kind in ("triangle", "tetra"):
        cell = TYPES[kind]
        x = cell.reference + 0.1 * np.random.default_rng(3).normal(size=cell.reference.shape)
        mesh = jm.Mesh(x, {kind: np.arange(CORNERS[kind])[None]})
        expected, found = jm.quality(mesh), jm.quality(jm.elevate(mesh, 3))
        for name in ("volume", "skewness", "aspect_ratio", "jacobian", "non_orthogonality"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), rtol=1e-9, err_msg=name
            )


@pytest.mark.nightly
def test_wall_and_smooth_measures_of_curved_cells():
    high = jm.curve(jm.elevate(ring(), 2), unit, "wall", "far")
    wall = jm.wall_quality(high, "wall")
    assert set(np.asarray(wall.nodes)) == set(high.patch("wall"))
    np.testing.assert_allclose(wall.height, 1)
    smooth, report = jm.smooth_quality(high, sharpness=2000.0), jm.quality(high)
    np.testing.assert_allclose(smooth.skewness, report.skewness, atol=0.01)
    np.testing.assert_allclose(smooth.aspect_ratio, report.aspect_ratio, rtol=0.01)
    assert jm.distortion(high).shape == (36,)
    np.testing.assert_allclose(jm.distortion(high), 0, atol=1e-6)
    with pytest.raises(ValueError, match="OpenFOAM's measures are for linear cells"):
        jm.face_quality(high)


test_bad_input_is_refused_in_a_sentence = refusals(
    (
        lambda mesh, high: jm.elevate(mesh, 5),
        "`order` is 5; meshes of order 2, 3 and 4 can be made",
    ),
    (lambda mesh, high: jm.elevate(high, 3), "cannot be elevated: linear cells are needed"),
    (
        lambda mesh, high: jm.curve(mesh, unit, "wall", "far"),
        "has linear cells alone, which stay straight",
    ),
    (
        lambda mesh, high: jm.curve(high, lambda x: x + np.array([3.0, 4]), "wall", "far"),
        r"24 of 24 nodes of the wall are farther from the surface .*5 away",
    ),
    (lambda mesh, high: jm.curve(high, np.zeros((3, 2)), "wall", "far"), "surface"),
    (lambda mesh, high: jm.curve(high, lambda x: x * np.nan, "wall", "far"), "surface"),
    of=lambda: (
        ring(),
        jm.elevate(ring(), 2),
    ),
)


@pytest.mark.nightly
def test_a_mesh_that_is_folded_before_it_is_curved_is_told():
    high = jm.elevate(ring(), 2)
    folded = np.array(high.points)
    folded[0] = 1.7 * folded[0]
    with pytest.warns(UserWarning, match=r"of 36 cells are invalid before the wall is curved"):
        jm.curve(high.moved(folded), unit(folded[high.patch("wall")]), "wall", "far")


def of_one_cell(kind, nodes):
    return lambda: jm.Mesh(
        np.random.default_rng(0).normal(size=(nodes, 3)), {kind: np.arange(nodes)[None]}
    )


test_orders_and_cells_that_are_not_known_are_told = refusals(
    (
        of_one_cell("triangle21", 21),
        "unknown cell type 'triangle21'; known are .* and of order 2 to 4 line3",
    ),
    (of_one_cell("hexahedron26", 26), "unknown cell type 'hexahedron26'"),
    (
        of_one_cell("hexahedron27", 26),
        r"cells of type 'hexahedron27' have shape \(1, 26\); expected \(k, 27\)",
    ),
)


def test_a_mesh_that_is_invalid_from_the_start_is_judged_by_its_own_margin():
    """Its folded cell is told, and is no fault of a motion that leaves it as it is."""
    mesh = jm.elevate(ring(), 2)
    folded = np.array(mesh.points)
    folded[mesh.cells["quad9"][0, 4]] *= 1.6  # the middle of an edge, beyond the opposite edge
    start = mesh.moved(folded)
    alone = jm.proof(start)
    assert alone.invalid == 2  # the two cells of this edge
    assert f"{len(start.cells['quad9']) - 2} proven valid, 2 invalid" in str(alone)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    turned = jm.proof(start, folded @ turn.T)
    np.testing.assert_allclose(turned.margin, alone.margin, atol=1e-9)
    np.testing.assert_array_equal(turned.is_invalid, alone.is_invalid)
    assert int(jm.quality(start).inverted) == 2
    relative = jm.quality(start, folded @ turn.T)
    np.testing.assert_allclose(
        relative.jacobian_ratio, 1, rtol=1e-9
    )  # of the places that were sound
    assert int(relative.inverted) == 0


@over(
    "name",
    slow=["default", "laplacian"],
    nightly=[each for each in jm.METHODS if each not in ("default", "laplacian")],
)
def test_every_method_moves_a_p2_cylinder_and_no_cell_folds_on_the_way(name):
    """High-order nodes are points like any others: four motions, proven inside of every cell at every instant."""
    mesh = jm.curve(jm.elevate(ring(16, 4), 2), unit, "wall", "far")
    nodes = mesh.patch("wall")
    wall = np.asarray(mesh.points)[nodes]
    angle = np.arctan2(wall[:, 1], wall[:, 0])
    method = jm.METHODS[name].make(float(np.ptp(wall, axis=0).max()))
    plan = jm.prepare(mesh, "wall", "far", method=method)
    motions = [
        wall @ meshes.turn(np.deg2rad(20), 2).T - wall,
        0 * wall + [0.15, 0.05],
        wall * [0.15, -0.15],
    ]
    motions.append(0.04 * wall * np.cos(4 * angle)[:, None])
    for u in motions:
        points = np.asarray(jm.deform(plan, u))
        np.testing.assert_allclose(points[nodes], wall + u, atol=1e-9)
        report = jm.proof(mesh, points, base=mesh.points if plan.is_linear else None)
        assert report.valid == report.count
        assert report.min_margin > 0.3
