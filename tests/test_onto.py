"""A wall onto a target: on it to round-off, edges on edges, spacing kept, derivatives against differences."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import ball, circle, naca, turn
from oracles import jacobian
from runs import all_refused
from scipy.spatial import KDTree

import jaxmorph as jm
from jaxmorph import io, shapes
from jaxmorph.cli import main
from jaxmorph.shapes import _onto

Z = [jm.Plane([0, 0, 1], [0, 0, place]) for place in (0.0, 1.0)]


def bumped(x):
    bump = 0.15 * np.exp(-np.sum((x - [0.6, 0.5, 0.62]) ** 2, axis=1) / 0.3)
    return (1 + bump)[:, None] * x * [1.25, 1, 0.9]


@functools.cache
def target(count=700, smooth=False):
    points, faces = ball(count)
    return jm.Facets(bumped(points), faces, smooth=smooth)


@functools.cache
def layered(count=200):
    """A ball in prisms, of which the first are 1e-4 high."""
    points, faces = ball(count)
    radii = 1 + np.append(0, 1e-4 * 2.0 ** np.arange(16))
    first = count * np.arange(len(radii) - 1)[:, None, None]
    prisms = np.concatenate([faces + first, faces + first + count], axis=2).reshape(-1, 6)
    ids = np.arange(count)
    places = (radii[:, None, None] * points).reshape(-1, 3)
    return jm.Mesh(places, {"wedge": prisms}, {"wall": ids, "far": ids + count * (len(radii) - 1)})


def section(camber, thickness, count, chord=1.0):
    """A sharp section as a loop from the nose over the tail, whose number is count - 1."""
    points = naca(camber, 0.4, thickness, count, last=0.1036) * [chord, 1]
    ring = np.concatenate([points[:count], points[count:][::-1][1:]])
    ids = np.arange(len(ring))
    return ring, np.column_stack([ids, np.roll(ids, -1)])


def extruded(ring, edges, heights):
    first = len(ring) * np.arange(len(heights) - 1)[:, None, None]
    quads = np.concatenate([edges + first, edges[:, ::-1] + first + len(ring)], axis=2).reshape(
        -1, 4
    )
    return np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in heights]), quads


def roughness(facets):
    areas = np.asarray(facets.areas())
    unit = areas / np.linalg.norm(areas, axis=1, keepdims=True)
    return np.median(
        np.arccos(np.clip(np.einsum("kd,ked->ke", unit, unit[np.asarray(facets.beside)]), -1, 1))
    )


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_ball_goes_onto_an_ellipsoid_with_a_bump(smooth):
    mesh = layered()
    wall, onto = jm.Facets.of(mesh, "wall"), target(smooth=smooth)
    u = shapes.onto(wall, onto)
    assert float(onto.distance(wall.points + u).max()) < 1e-12
    plan = jm.prepare(mesh, "wall", "far")
    points = jm.deform(plan, u)
    assert int(jm.quality(mesh, points).inverted) == 0
    height = np.asarray(jm.wall_quality(mesh, mesh.patch("wall"), points).height)
    assert height.min() > 0.8
    assert height.max() < 1.2
    sizes = [
        np.linalg.norm(np.asarray(each.areas()), axis=1)
        for each in (wall, wall.at(wall.points + u))
    ]
    nearest = np.linalg.norm(np.asarray(wall.at(onto.closest(wall.points)).areas()), axis=1)
    assert np.ptp(np.log(sizes[1] / sizes[0])) < 0.7 * np.ptp(
        np.log(nearest / sizes[0])
    )  # than closest points alone


@pytest.mark.slow
def test_numbering_sense_and_soup_of_the_target_do_not_matter():
    wall, onto = jm.Facets(*ball(100)), target(300)
    u = shapes.onto(wall, onto)
    rng = np.random.default_rng(0)
    order, faces = rng.permutation(300), np.asarray(onto.faces)
    place = np.argsort(order)
    mixed = np.stack(
        [
            np.roll(row, k)
            for row, k in zip(place[faces], rng.integers(3, size=len(faces)), strict=True)
        ]
    )
    mixed = np.where(rng.integers(2, size=len(mixed))[:, None] == 1, mixed[:, ::-1], mixed)[
        rng.permutation(len(mixed))
    ]
    again = jm.Facets(onto.points[order], mixed)
    soup = jm.Facets(
        onto.points[faces[:, ::-1]].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    )
    for other in (again, soup):
        assert len(other.sharp) == len(other.rim) == 0
        np.testing.assert_allclose(shapes.onto(wall, other), u, atol=1e-9)


@pytest.mark.slow
def test_a_target_elsewhere_is_found_by_a_rigid_motion():
    wall, onto = jm.Facets(*ball(100)), target(300)
    wall = jm.Facets(wall.points * np.array([[1.25, 1.0, 0.9]]), wall.faces)
    away = jm.Facets(onto.points @ turn(0.7, 3).T + np.array([[3.0, -2.0, 1.0]]), onto.faces)
    moved = wall.points + shapes.onto(wall, away)
    assert float(away.distance(moved).max()) < 1e-12
    other = wall.points + shapes.onto(wall, onto)
    back = (moved - np.array([[3.0, -2.0, 1.0]])) @ turn(0.7, 3)
    assert (
        np.linalg.norm(back - other, axis=1).max() < 0.2
    )  # the same nodes, not those of another side


@pytest.mark.slow
def test_the_sharp_edge_of_an_airfoil_goes_onto_the_sharp_edge():
    (ring, edges), (other, segments) = (
        section(1e-12, 0.12, 41),
        section(0.03, 0.14, 101, chord=1.05),
    )
    wall, onto = jm.Facets(ring, edges), jm.Facets(other, segments[:, ::-1])
    assert wall.sharp.tolist() == [[40]]
    x = ring + shapes.onto(wall, onto)
    assert np.abs(x[40] - other[100]).max() < 1e-12
    assert float(onto.distance(x).max()) < 1e-12
    assert (x[:41, 1] >= x[np.r_[0, 79:39:-1], 1]).all()  # each side on its own
    growth = np.linalg.norm(np.asarray(wall.at(x).areas()), axis=1) / np.linalg.norm(
        np.asarray(wall.areas()), axis=1
    )
    assert np.abs(np.log(growth[1:] / growth[:-1])).max() < 0.03  # spacing


def capped(count, heights):
    """An extruded section, open at its first end, with ribs from side to side at its last."""
    ring, edges = section(0.0, 0.12, count)
    points, quads = extruded(ring, edges, heights)
    last = len(points) - len(ring)
    upper = np.arange(count)
    lower = -upper % len(ring)
    ribs = np.stack([upper[:-1], lower[:-1], lower[1:], upper[1:]], axis=1)
    return points, np.concatenate([quads, last + ribs])


def bent(points, by=0.12):
    """By the thickness of the section at the end of the span."""
    return points + np.outer(by * points[:, 2] ** 2, [0, 1, 0])


def test_both_edges_of_a_flat_tip_go_onto_their_own():
    points, quads = capped(25, np.linspace(0, 1, 11))
    other, faces = capped(41, np.linspace(0, 1, 21))
    onto = jm.Facets(bent(other), faces)
    x = points + shapes.onto(jm.Facets(points, quads), onto, symmetry=Z[:1])
    assert float(onto.distance(x).max()) < 1e-12
    assert np.abs(x - bent(points)).max() < 0.03


def test_nodes_of_a_cusp_stay_at_their_stations():
    """Normals of its sides cancel there: which way it looks is noise."""
    points, quads = capped(25, np.linspace(0, 1, 11))
    other, faces = capped(41, np.linspace(0, 1, 21))
    points, other = (
        x * np.column_stack([np.ones(len(x)), 1 - x[:, 0], np.ones(len(x))])
        for x in (points, other)
    )
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(other))
    other[:, 1] += noise * (np.abs(other[:, 2] - 0.5) < 0.49)
    x = points + shapes.onto(jm.Facets(points, quads), jm.Facets(other, faces), symmetry=Z[:1])
    tail = points[:, 0] > 1 - 1e-9
    assert tail.sum() == 11
    assert np.abs(x - points)[tail, 2].max() < 0.02


def test_a_bent_wing_in_inches_from_the_same_origin_is_told():
    points, quads = capped(25, np.linspace(0, 3, 11))
    scan = jm.Facets(bent(points, by=0.09) / 0.0254, quads)
    with pytest.raises(ValueError, match=r"Multiply its points by 0\.0254\.$"):
        shapes.onto(jm.Facets(points, quads), scan, symmetry=Z[:1])


@pytest.mark.slow
def test_curves_that_are_named_go_onto_each_other():
    """The tails as if no angle told them; in 3-D the nose's line too, which is not sharp."""
    (ring, edges), (other, segments) = section(1e-12, 0.12, 25), section(0.03, 0.14, 41, chord=1.05)
    wall, onto = jm.Facets(ring, edges, angle=3.2), jm.Facets(other, segments, angle=3.2)
    assert not len(wall.sharp)
    x = ring + shapes.onto(wall, onto, features=[([24], [40])])
    np.testing.assert_allclose(x[24], other[40], atol=1e-12)
    (points, quads), (places, faces) = (
        extruded(*each, np.linspace(0, 1, 4)) for each in ((ring, edges), (other, segments))
    )
    wall, onto = jm.Facets(points, quads), jm.Facets(places, faces)
    lines = [
        (np.arange(k, len(points), len(ring)), np.arange(j, len(places), len(other)))
        for k, j in ((24, 40), (0, 0))
    ]
    x = points + shapes.onto(wall, onto, symmetry=Z, features=lines)
    for rows, ids in lines:
        assert np.abs(x[rows, :2] - places[ids[0], :2]).max() < 1e-12
        np.testing.assert_allclose(x[rows, 2], points[rows, 2], atol=0.01)
    assert float(onto.distance(x).max()) < 1e-12


@pytest.mark.slow
def test_numbering_of_the_wall_does_not_matter(monkeypatch):
    """Also where the rigid motion is found by a few of the nodes."""
    monkeypatch.setattr(_onto, "SAMPLE", 10)
    points, faces = ball(80)
    order, onto = np.random.default_rng(1).permutation(80), target(300)
    onto = onto.at(onto.points + np.array([[0.0, 2.0, 0.0]]))
    u = shapes.onto(jm.Facets(points, faces), onto)
    mixed = jm.Facets(points[order], np.argsort(order)[faces][::-1, ::-1])
    np.testing.assert_allclose(shapes.onto(mixed, onto), u[order], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("span", [(0, 1), (-0.3, 1.2)])
def test_an_extruded_airfoil_stays_between_its_planes(span):
    (ring, edges), (other, segments) = section(1e-12, 0.12, 25), section(0.03, 0.14, 41, chord=1.05)
    points, quads = extruded(ring, edges, np.linspace(0, 1, 4))
    wall, onto = (
        jm.Facets(points, quads),
        jm.Facets(*extruded(other, segments, np.linspace(*span, 4))),
    )
    x = points + shapes.onto(wall, onto, symmetry=Z)
    tail = np.arange(24, len(points), len(ring))
    assert np.abs(x[tail, :2] - other[40]).max() < 1e-12
    assert float(onto.distance(x).max()) < 1e-12
    for place in (0, 1):
        assert np.abs(x[points[:, 2] == place, 2] - place).max() < 1e-12
    with pytest.raises(ValueError, match=r"ends 0\.2 before the symmetry plane"):
        shapes.onto(wall, jm.Facets(*extruded(other, segments, [0.2, 1])), symmetry=Z)


@pytest.mark.slow
def test_edges_and_corners_of_a_box_go_onto_those_of_a_turned_box():
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    places, faces = refined(cube, sides, 4)
    wall, onto = jm.Facets(places, faces), jm.Facets(cube @ turn(0.1, 3).T * [1.1, 1, 0.9], sides)
    x = places + shapes.onto(wall, onto)
    corner = np.isin(places, (0, 1)).all(axis=1)
    edge = np.isin(places, (0, 1)).sum(axis=1) == 2
    assert (np.unique(wall.sharp).size, edge.sum()) == (edge.sum() + 8, 36)
    ids = (places[corner] @ [4, 2, 1]).astype(int)
    np.testing.assert_allclose(x[corner], np.asarray(onto.points)[ids], atol=1e-12)
    curve = jm.Facets(onto.points, onto.sharp, sides=np.zeros((12, 3)))
    assert float(curve.distance(x[edge]).max()) < 1e-12
    assert float(onto.distance(x).max()) < 1e-12


def refined(corners, quads, count):
    s, t = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1), indexing="ij")
    shares = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1).reshape(-1, 4)
    ids = np.arange((count + 1) ** 2).reshape(count + 1, -1)
    pieces = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1).reshape(
        -1, 4
    )
    points = np.concatenate([shares @ corners[quad] for quad in quads])
    different, place = np.unique(points.round(12), axis=0, return_inverse=True)
    return different, place.ravel()[
        np.concatenate([pieces + k * len(shares) for k in range(len(quads))])
    ]


@pytest.mark.slow
def test_a_scan_with_noise_is_smoothed():
    (ring, edges), rng = section(0.02, 0.12, 41), np.random.default_rng(0)
    half, segments = section(0.02, 0.12, 21)
    points, quads = extruded(ring, edges, np.linspace(0, 1, 7))
    scanned, faces = extruded(half, segments, np.linspace(0, 1, 7))
    noisy = scanned + 0.02 * rng.uniform(-1, 1, scanned.shape) * [1, 1, 0]
    wall, scan = jm.Facets(points, quads), jm.Facets(noisy, faces, angle=3.0)
    x = points + shapes.onto(wall, scan, symmetry=Z, length=0.2)
    assert roughness(wall.at(x)) < 0.2 * roughness(scan)
    truth = jm.Facets(points, quads)
    assert np.sqrt(np.mean(truth.distance(x) ** 2)) < 0.5 * np.sqrt(
        np.mean(truth.distance(noisy) ** 2)
    )
    assert 1e-3 < float(scan.distance(x).max()) < 0.04  # told
    assert np.abs(x[points[:, 2] == 0, 2]).max() < 1e-12


@pytest.mark.slow
def test_derivatives_by_both_surfaces_equal_differences():
    wall, onto, rng = jm.Facets(*ball(60)), target(150, smooth=True), np.random.default_rng(0)
    made = shapes.Onto(wall, onto)
    weights = rng.normal(size=wall.points.shape)
    value = lambda x, points: jnp.sum(weights * made(x, points))  # noqa: E731
    gradients = jax.grad(value, argnums=(0, 1))(wall.points, onto.points)
    ways = [rng.normal(size=gradient.shape) for gradient in gradients]
    moved = (
        lambda h: value(wall.points + h * ways[0], onto.points),
        lambda h: value(wall.points, onto.points + h * ways[1]),
    )
    for along, gradient, way in zip(moved, gradients, ways, strict=True):
        slope = float(jacobian(along, 0.0, 4e-6))
        assert float(jnp.sum(gradient * way)) == pytest.approx(slope, rel=1e-8, abs=1e-8)


@pytest.mark.slow
def test_many_targets_at_once():
    (ring, edges), (other, segments) = section(1e-12, 0.12, 21), section(0.02, 0.14, 41)
    made = shapes.Onto(jm.Facets(ring, edges), jm.Facets(other, segments))
    several = jnp.stack([other, other * np.array([[1.0, 1.2]])])
    together = jax.jit(jax.vmap(lambda points: made(ring, points)))(several)
    for points, moved in zip(several, together, strict=True):
        np.testing.assert_allclose(made(ring, points), moved, atol=1e-12)
        assert float(made.target.at(points).distance(moved).max()) < 1e-12
    with pytest.raises(ValueError, match="is for positions"):
        made(ring[1:])


@pytest.mark.slow
def test_a_function_of_closest_places_is_a_target():
    points, faces = ball(150)
    keep = (points[faces].mean(axis=1)[:, 2] > 0.1).nonzero()[0]
    rows, ids = np.unique(faces[keep], return_inverse=True)
    wall = jm.Facets(points[rows], ids.reshape(-1, 3))
    onto = lambda x: 2 * x / jnp.linalg.norm(x, axis=1, keepdims=True)  # noqa: E731
    moved = wall.points + shapes.onto(wall, onto)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 2, rtol=1e-12)
    half, lines = circle(41)[:21], np.column_stack([np.arange(20), np.arange(1, 21)])
    flat = jm.Plane([0.0, 1.0], [0.0, 0.0])
    half[[0, -1], 1] = 0
    moved = half + shapes.onto(
        jm.Facets(half, lines),
        lambda x: 3 * x / jnp.linalg.norm(x, axis=1, keepdims=True),
        symmetry=flat,
    )
    assert abs(moved[0, 1]) < 1e-12


@pytest.mark.nightly
def test_an_ambiguous_way_is_refused_with_its_place():
    square, faces = refined(
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2, 3]]), 6
    )
    wall = jm.Facets(square, faces)
    small = jm.Facets(square * [0.5, 1, 1] + [0, 0, 0.1], faces)
    with pytest.raises(jm.MeshError, match=r"at node \d+ near \(.*one to one") as caught:
        shapes.onto(wall, small)
    assert (square[caught.value.nodes, 0] > 0.4).all()
    large = jm.Facets(square * [3, 3, 1] - [1, 1, -0.1], faces)
    u = shapes.onto(wall, large)
    np.testing.assert_allclose(u, np.broadcast_to([0, 0, 0.1], u.shape), atol=1e-9)


def test_what_is_refused():
    wall, flat = jm.Facets(*ball(20)), jm.Facets(*section(0.0 + 1e-12, 0.12, 11))
    all_refused(
        (lambda: shapes.Onto(wall, flat), "in 3-D, its target in 2-D"),
        (lambda: shapes.Onto(wall, wall, length=-1.0), "`length` must be"),
        (lambda: jm.Facets(wall.points, np.zeros((0, 3), int)), "expected triangles"),
        (lambda: jm.Facets(wall.points, [[0, 1, 20]]), "not in 0 to 19"),
    )


def test_closest_places_are_those_of_a_dense_cloud():
    points, faces = ball(60)
    facets, x = jm.Facets(points, faces), np.random.default_rng(0).normal(size=(40, 3))
    shares = np.random.default_rng(1).dirichlet([1, 1, 1], 400)
    cloud = np.einsum("sc,kcd->ksd", shares, points[faces]).reshape(-1, 3)
    away = KDTree(cloud).query(x)[0]
    distance = np.asarray(facets.distance(x))
    assert (distance <= away + 1e-12).all()
    assert (away - distance).max() < 0.05


@pytest.mark.slow
def test_the_command_line_moves_a_wall_onto_a_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = jm.cases.naca4("0012", points=1500)
    other = jm.Facets.of(jm.cases.naca4("2412", points=3000), "airfoil")
    np.savez("scan.npz", points=np.asarray(other.points), lines=np.asarray(other.faces))
    io.write("foil.su2", mesh)
    words = [
        "deform",
        "foil.su2",
        "out.su2",
        "--moving",
        "airfoil",
        "--fixed",
        "farfield",
        "--onto",
        "scan.npz",
    ]
    assert main([*words, "--picture", "out.png"]) == 0
    said = capsys.readouterr().out
    assert "distance from scan.npz" in said
    moved = io.read("out.su2")
    assert float(other.distance(moved.points[moved.patch("airfoil")]).max()) < 1e-12
    assert (tmp_path / "out_distance_scan.png").stat().st_size > 1000


@pytest.mark.slow
def test_derivatives_beyond_the_border_of_a_scan_equal_differences():
    """Nodes that nothing draws follow their neighbours; any numbering of the nodes has the same answer."""
    places = np.linspace(0, 1, 41)
    x = np.column_stack([places, 0.05 * np.sin(6 * places)])
    along = np.linspace(-0.2, 0.7, 60)
    scan = np.column_stack([along, 0.03 + 0.06 * np.sin(6 * along)])
    segments = np.column_stack([np.arange(59), np.arange(1, 60)])
    wall, target = jm.Facets(x, segments[:40]), jm.Facets(scan, segments)
    made = shapes.Onto(wall, target, length=0.1)
    rng = np.random.default_rng(0)
    weights = rng.normal(size=x.shape)
    value = lambda x, points: jnp.sum(weights * made(x, points))  # noqa: E731
    gradients = jax.grad(value, argnums=(0, 1))(x, scan)
    ways = [rng.normal(size=gradient.shape) for gradient in gradients]
    moved = (lambda h: value(x + h * ways[0], scan), lambda h: value(x, scan + h * ways[1]))
    for line, gradient, way in zip(moved, gradients, ways, strict=True):
        slope = float(jacobian(line, 0.0, 4e-6))
        assert float(jnp.sum(gradient * way)) == pytest.approx(slope, rel=1e-6)
    order = rng.permutation(41)
    other = jm.Facets(x[order], np.argsort(order)[np.asarray(wall.faces)])
    again = shapes.Onto(other, target, length=0.1)(x[order])
    np.testing.assert_allclose(again, np.asarray(made(x))[order], atol=1e-12)
