"""The Delaunay graph: SciPy's linear interpolation where it is unique, the laws of barycentric coordinates where it is not."""

import pathlib

import numpy as np
import pytest
from cases import body, motion
from meshes import circle, lattice, sphere
from runs import over
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph import cases as jm_cases
from jaxmorph._host.package.rounding import morton_order
from jaxmorph._host.surface.graph import graph_of, locate

SHARED = pathlib.Path(__file__).parents[2] / "shared" / "cases"


def weights_of(surface, points, wanted):
    """Barycentric coordinates of the wanted points in the simplices found for them, by NumPy's solver."""
    vertices = locate(graph_of(surface), points, wanted)
    corners = surface[vertices]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
    inner = np.linalg.solve(edges, (points[wanted] - corners[:, 0])[..., None])[..., 0]
    return vertices, np.concatenate([1 - inner.sum(axis=1, keepdims=True), inner], axis=1)


def check_weights(surface, points, wanted, least=-1e-6, precision=1e-13):
    """Every point lies in its simplex, and the weights give it back."""
    vertices, weights = weights_of(surface, points, wanted)
    assert weights.min() >= least
    assert weights.max() <= 1 - 3 * least
    again = np.einsum("wk,wkd->wd", weights, surface[vertices])
    np.testing.assert_allclose(
        again, points[wanted], rtol=0, atol=precision * np.ptp(surface, axis=0).max()
    )


def box(cells, size=(1, 1, 1), growth=1.0):
    """Points of a structured box, and for each of its six sides which lie on it."""
    axes = [np.linspace(0, 1, n + 1) for n in cells]
    if growth > 1:
        axes[-1] = (growth ** np.arange(cells[-1] + 1) - 1) / (growth ** cells[-1] - 1)
    points = lattice(*axes) * np.array(size)[: len(cells)]
    return points, np.concatenate(
        [points == points.min(axis=0), points == points.max(axis=0)], axis=1
    )


@over("dimension", [2], slow=[3])
def test_equals_scipys_linear_interpolation(dimension):
    rng = np.random.default_rng(dimension)
    points = np.concatenate([sphere(60)[:, :dimension] * 3, rng.uniform(-1, 1, (300, dimension))])
    moving, fixed = np.arange(60, 120), np.arange(60)
    u = rng.normal(size=(60, dimension))
    if dimension == 2:
        points[:60] = 3 * np.stack(
            [np.cos(np.arange(60) * 0.1047), np.sin(np.arange(60) * 0.1047)], axis=1
        )
        points[:60] *= 1 + 1e-3 * rng.uniform(size=(60, 1))
    plan = jm.prepare(points, moving, fixed, method=jm.DelaunayGraph())
    values = np.concatenate([u, np.zeros((60, dimension))])
    expected = LinearNDInterpolator(points[np.concatenate([moving, fixed])], values)(points)
    np.testing.assert_allclose(jm.deform(plan, u) - points, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("length", "shift", "allowed"), [(1, 1e6, 2e-7), (1e-6, 0, 1e-13), (1e6, -3e6, 1e-13)]
)
@over("dimension", [3], nightly=[2])
def test_units_and_distance_from_the_origin(dimension, length, shift, allowed):
    """Equal up to what float64 leaves of the coordinates: 1e-10 of a chord at 1e6 chords from the origin, over 4e-3 of height."""
    mesh = body(dimension)
    u = motion(mesh.points[mesh.moving])
    near = (
        jm.deform(jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=jm.DelaunayGraph()), u)
        - mesh.points
    )
    points = mesh.points * length + shift
    moved = (
        jm.deform(
            jm.prepare(points, mesh.moving, mesh.fixed, method=jm.DelaunayGraph()), u * length
        )
        - points
    )
    np.testing.assert_allclose(moved / length, near, rtol=0, atol=allowed)


@pytest.mark.parametrize("shift", [0.0, 1e3, 1e6])
@over(
    "cells size growth",
    [((10, 8, 12), (1, 1, 1), 1), ((8, 8, 20), (100, 1, 0.1), 1.4), ((30, 20), (1, 1), 1.2)],
)
def test_structured_boxes(cells, size, growth, shift):
    """All surface nodes lie in planes, each cell's corners on one sphere."""
    points, sides = box(cells, size, growth)
    boundary = sides.any(axis=1)
    check_weights(
        points[boundary] + shift,
        points + shift,
        np.flatnonzero(~boundary),
        precision=1e-13 + 1e-15 * shift,
    )


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("missing", [(4,), (1, 4), (0, 1, 3, 4), (0, 3)])
def test_sides_of_a_box_without_nodes_of_their_own(missing, turned):
    """Symmetry planes and outlets left to follow: their points lie on the hull, between needles and slivers of rim nodes."""
    points, sides = box((8, 6, 24), growth=1.3)
    surface = np.delete(sides, missing, axis=1).any(axis=1)
    wanted = np.flatnonzero(~surface)
    if turned:
        points = points @ Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix().T
    for shift in (0.0, 1e3):
        check_weights(
            points[surface] + shift, points + shift, wanted, precision=1e-13 + 1e-15 * shift
        )


def test_few_nodes_and_many_points_on_their_edges_and_diagonals():
    for dimension, count in ((2, 31), (3, 13)):
        corners, _ = box((1,) * dimension)
        points, _ = box((count,) * dimension)
        for shift in (0.0, 1e6):
            check_weights(
                corners + shift,
                points + shift,
                np.arange(len(points)),
                precision=1e-13 + 1e-15 * shift,
            )


def test_cospherical_nodes():
    """Meridians and parallels: every facet has four corners on one circle, and the poles are named many times."""
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, 13), np.pi / 10 * np.arange(20), indexing="ij"
    )
    unit = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1
    )
    unit = unit.reshape(-1, 3)
    surface = np.concatenate([unit, 20 * unit])
    points = np.concatenate([unit * r for r in (1.0 + 1e-6, 1.01, 3.0, 15.0)])
    check_weights(surface, points, np.arange(len(points)))


def test_layers_of_a_millionth_over_a_far_field_at_500():
    layers = np.concatenate(
        [circle(120) * r for r in np.concatenate([[1], 1 + np.geomspace(1e-6, 499, 40)])]
    )
    inner = np.arange(120, len(layers) - 120)
    boundary = np.setdiff1d(np.arange(len(layers)), inner)
    check_weights(layers[boundary], layers, inner)
    check_weights(layers[boundary] + 1e4, layers + 1e4, inner, precision=1e-12)


def test_coincident_nodes_follow_themselves_and_points_there_the_first():
    """A wake cut: two nodes at one place, one moving and one fixed, and an interior node there too."""
    mesh = body(2)
    points = np.concatenate(
        [mesh.points, mesh.points[mesh.moving[:3]], mesh.points[mesh.moving[:3]]]
    )
    n = len(mesh.points)
    fixed = np.concatenate([[n, n + 1], mesh.fixed])
    moving = np.concatenate([mesh.moving, [n + 2]])
    u = np.concatenate([motion(mesh.points[mesh.moving]), [[0.5, 0.25]]])
    moved = (
        np.asarray(jm.deform(jm.prepare(points, moving, fixed, method=jm.DelaunayGraph()), u))
        - points
    )
    assert (moved[[n, n + 1]] == 0).all()
    np.testing.assert_allclose(moved[n + 2], [0.5, 0.25], atol=1e-15)
    np.testing.assert_allclose(moved[mesh.moving], u[:-1], atol=1e-15)
    np.testing.assert_allclose(moved[n + 3 :], u[:3], atol=1e-12)


@pytest.mark.parametrize("order", ["as given", "shuffled"])
def test_degenerate_clouds_do_not_depend_on_the_order(order):
    """Where the graph is not unique, the same one is found for the same nodes in any order."""
    points, sides = box((6, 5, 7))
    boundary, inner = np.flatnonzero(sides.any(axis=1)), np.flatnonzero(~sides.any(axis=1))
    rows = (
        np.random.default_rng(0).permutation(len(boundary))
        if order == "shuffled"
        else np.arange(len(boundary))
    )
    vertices = locate(graph_of(points[boundary][rows]), points, inner)
    expected = locate(graph_of(points[boundary]), points, inner)
    assert (np.sort(rows[vertices], axis=1) == np.sort(expected, axis=1)).all()


def test_points_outside_of_the_hull():
    mesh = body(2)
    points = mesh.points.copy()
    points[mesh.inner[[4, 9]]] = [[0.0, 4.7], [-6.0, 0.0]]
    with pytest.raises(ValueError, match=r"^2 of 310 points lie outside") as caught:
        jm.prepare(points, mesh.moving, mesh.fixed, method=jm.DelaunayGraph())
    worst, distance = mesh.inner[9], 6 - np.abs(points[mesh.boundary, 0]).max()
    assert f"node {worst} at (-6, 0)" in str(caught.value)
    assert float(str(caught.value).split("), ")[1].split()[0]) == pytest.approx(distance, rel=0.05)
    with pytest.raises(ValueError, match=r"279 of 310 points lie outside"):
        jm.prepare(mesh.points, mesh.moving, method=jm.DelaunayGraph())


@pytest.mark.parametrize("length", [1.0, 1e3])
@pytest.mark.parametrize("gap", [1e-6, 1e-5])
def test_points_just_outside_of_a_rod(length, gap):
    """The facets of its hull are ten thousand times as long as high; a point beyond one by much less than that is refused."""
    rod = length * box((8, 2, 2), (1, 1e-4, 1e-4))[0]
    points = np.concatenate([rod, [length * np.array([0.33, 0.4e-4, 1e-4 + gap])]])
    with pytest.raises(ValueError, match=r"^1 of 82 points lie outside") as caught:
        locate(graph_of(rod), points, np.array([len(rod)]))
    assert float(str(caught.value).split("), ")[1].split()[0]) == pytest.approx(
        gap * length, rel=0.01
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_surfaces_without_extent(dimension):
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    flat = np.concatenate([rng.normal(size=(30, dimension - 1)), np.zeros((30, 1))], axis=1) @ turn
    points = np.concatenate([flat, [flat.mean(axis=0)]])
    for shift in (0.0, 10.0):
        with pytest.raises(ValueError, match=r"30 surface nodes lie in one (line|plane)"):
            jm.prepare(points + shift, np.arange(30), method=jm.DelaunayGraph())
    with pytest.raises(
        ValueError, match=rf"needs {dimension + 1} distinct surface nodes, got {dimension}"
    ):
        jm.prepare(points, np.arange(dimension), method=jm.DelaunayGraph())


@pytest.mark.parametrize("dimension", [2, 3])
def test_mortons_order_interleaves_the_bits_of_the_coordinates(dimension):
    """Against whole numbers of Python: bit k of axis a is bit k d + a of the key, 30 bits an axis in 2-D, 20 in 3-D."""
    bits = 60 // dimension
    points = np.random.default_rng(0).random((200, dimension))
    points[:2] = [[0], [1]]
    keys = [
        sum(
            (int(x * (2**bits - 1)) >> k & 1) << (k * dimension + a)
            for a, x in enumerate(row)
            for k in range(bits)
        )
        for row in points
    ]
    np.testing.assert_array_equal(morton_order(points), sorted(range(200), key=keys.__getitem__))


def test_mortons_order_keeps_neighbours_together():
    points = np.random.default_rng(5).uniform(size=(4096, 3))
    order = morton_order(points)
    assert (np.sort(order) == np.arange(4096)).all()
    step = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    assert step < 0.2 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    grid, _ = box((3, 3))
    quarter = morton_order(grid)[:4]  # the curve visits one quarter of a square before the next
    assert np.ptp(grid[quarter], axis=0).max() < 0.5


@pytest.mark.parametrize(
    "sides",
    [("x_m", "x_p", "y_m", "y_p", "z_m", "z_p"), ("z_m", "z_p"), ("x_m", "x_p", "z_m", "z_p")],
)
def test_a_real_box_of_tetrahedra(sides):
    """A quarter of its simplices have no volume; with some sides left open hundreds of points lie on the hull."""
    file = SHARED / "brick-tets" / "brick_tets.su2"
    if not file.exists():
        pytest.skip("the shared meshes are not here")
    mesh = pytest.importorskip("jaxmorph.io").read(file)
    surface = mesh.patch(*sides)
    points = np.asarray(mesh.points)
    check_weights(points[surface], points, np.setdiff1d(np.arange(len(points)), surface))


def test_coordinates_in_single_precision():
    """The paper's airfoil: layers, a wake and an outlet whose coordinates were rounded."""
    mesh = jm_cases.naca0015()
    moving, far = mesh.patch("airfoil"), mesh.patch("farfield")
    plan = jm.prepare(mesh.points.astype(np.float32), moving, far, method=jm.DelaunayGraph())
    u = 0.1 * (mesh.points[moving] - [0.25, 0]) @ [[0, 1], [-1, 0]]
    moved = np.asarray(jm.deform(plan, u.astype(np.float32)))
    assert moved.dtype == np.float32
    exact = jm.deform(jm.prepare(mesh.points, moving, far, method=jm.DelaunayGraph()), u)
    np.testing.assert_allclose(moved, exact, atol=2e-5)
    assert int(jm.quality(mesh, moved.astype(float)).inverted) == 0
