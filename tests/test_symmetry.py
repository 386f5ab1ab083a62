"""Symmetry planes: a part that moves as the whole would, nodes that stay in their plane, and planes that are none."""

import foam
import numpy as np
import pytest
from cases import body, few, full, motion, whole_and_part
from laws import check_base_derivative, check_linear, check_steps
from meshes import between_half_planes, blocks, capsule, lattice, unit_box
from runs import over, refusals

import jaxmorph as jm
from jaxmorph import io

GRAPH = jm.DelaunayGraph()


METHODS = {
    "full": full(jm.ThinPlateSpline(), 1),
    "reconstruction": jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3)),
    "multiscale": jm.SurfaceReconstruction(few(), jm.Multiscale()),
}


@over("dimension planes", [(2, 1)], slow=[(3, 2)], nightly=[(2, 2)])
def test_full_interpolation_equals_that_of_the_whole_mesh(dimension, planes):
    part, role, whole, whole_role, image_of, signs = whole_and_part(dimension, planes)
    assert len(whole) > 2**planes * 0.6 * len(part)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    u = motion(part)
    for axis in range(planes):
        u[part[:, axis] == 0, axis] = 0
    symmetry = [
        jm.Plane(np.eye(dimension)[axis] * 3, np.zeros(dimension)) for axis in range(planes)
    ]
    moved = jm.deform(
        jm.prepare(part, moving, fixed, method=METHODS["full"], symmetry=symmetry), u[moving]
    )
    whole_moving = np.flatnonzero(whole_role == 1)
    plan = jm.prepare(whole, whole_moving, np.flatnonzero(whole_role == 2), method=METHODS["full"])
    expected = jm.deform(plan, (u[image_of] * signs)[whole_moving])
    np.testing.assert_allclose(moved, expected[: len(part)], rtol=0, atol=1e-11)


def mirrored_motion(x, sectors):
    """A motion that both half planes of a sector mirror, and all their images."""
    angle = np.arctan2(x[:, 1], x[:, 0])[:, None]
    radius = np.hypot(x[:, :1], x[:, 1:2])
    even, odd = np.cos(sectors * angle), np.sin(sectors * angle)
    out = np.hstack([np.cos(angle), np.sin(angle), 0 * angle])
    on = np.hstack([-np.sin(angle), np.cos(angle), 0 * angle])
    along = 0.1 * np.sin(x[:, 2:]) + 0.03 * radius * even
    ways = 0.1 * (1 + even / 2) * np.cos(x[:, 2:]) * out + 0.05 * odd * on
    return radius * ways + along * [0.0, 0.0, 1.0]


@over("degrees method", slow=[(30, "full")], nightly=[(60, "full"), (45, "graph"), (30, "graph")])
def test_a_sector_moves_as_the_whole_body(degrees, method):
    """Two mirrors at 180 / n degrees have 2 n images; nodes stay on both, also on their axis."""
    method = METHODS["full"] if method == "full" else jm.SurfaceReconstruction(METHODS["full"])
    sectors = round(360 / degrees)
    part, whole = capsule(degrees), capsule(degrees, whole=True)
    planes = between_half_planes(degrees)
    plan = jm.prepare(part, "wall", "far", symmetry=planes, method=method)
    every = jm.prepare(whole, "wall", "far", method=method)
    assert len(plan.images.matrices) == sectors
    x = np.asarray(part.points)
    u = mirrored_motion(x[plan.moving], sectors)
    moved = np.asarray(jm.deform(plan, u))
    expected = np.asarray(
        jm.deform(every, mirrored_motion(np.asarray(whole.points)[every.moving], sectors))
    )
    away = np.linalg.norm(x[:, None] - np.asarray(whole.points)[None], axis=2)
    np.testing.assert_allclose(moved, expected[away.argmin(axis=1)], rtol=0, atol=1e-10)
    more = np.asarray(jm.deform(plan, u + 0.05))  # asks for more than the planes allow
    for plane in planes:
        assert np.abs(plane.height(more[plane.holds(x)])).max() < 1e-14
    assert jm.boundary_quality(plan, more).off_plane < 1e-14
    assert (np.abs(more - x).max(axis=0) > 0.01).all()


@pytest.mark.slow
def test_a_wedge_of_openfoam_moves_as_the_whole_body(tmp_path):
    """One layer of cells between two planes at 5 degrees, named as patches of the case."""
    part, whole = capsule(5, 2), capsule(5, 2, whole=True)
    x = np.asarray(part.points)
    cells = [
        *foam.hexahedra(part.cells["hexahedron"]),
        *(foam.cell(foam.WEDGE, *row) for row in np.asarray(part.cells["wedge"]).tolist()),
    ]
    sides = [("wall", "wall", lambda nodes: np.isin(nodes, part.patch("wall")).all())]
    sides += [("far", "patch", lambda nodes: np.isin(nodes, part.patch("far")).all())]
    for name, plane in zip(("front", "back"), between_half_planes(5), strict=True):
        sides.append((name, "symmetry", lambda nodes, plane=plane: plane.holds(x)[nodes].all()))
    mesh = io.read(foam.write_case(tmp_path / "case", x, cells, sides))
    assert io.symmetry(mesh) == ("front", "back")
    method = METHODS["full"]
    plan = jm.prepare(mesh, "wall", "far", symmetry=("front", "back"), method=method)
    every = jm.prepare(whole, "wall", "far", method=method)
    assert len(plan.images.matrices) == 72
    moved = jm.deform(plan, mirrored_motion(x[plan.moving], 72))
    u = mirrored_motion(np.asarray(whole.points)[every.moving], 72)
    away = np.linalg.norm(x[:, None] - np.asarray(whole.points)[None], axis=2)
    expected = np.asarray(jm.deform(every, u))[away.argmin(axis=1)]
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-10)


@pytest.mark.nightly
def test_the_default_moves_a_sector_and_its_cells():
    part = capsule(30)
    plan = jm.prepare(part, "wall", "far", symmetry=between_half_planes(30))
    moved = jm.deform(plan, mirrored_motion(np.asarray(part.points)[plan.moving], 12))
    assert int(jm.quality(part, moved).inverted) == 0


def test_which_angles_of_mirrors_have_images():
    """Also of the mesh beyond 90 degrees, which is not the angle of the two normals."""
    for degrees in (7, 50, 72.1, 120, 135):
        told = rf"two meet at {degrees} degrees: one pair may meet at 180 / n degrees"
        with pytest.raises(ValueError, match=told):
            jm.prepare(capsule(degrees), "wall", "far", symmetry=between_half_planes(degrees))
    springs = jm.SpringAnalogy()
    with pytest.raises(ValueError, match="parallel or at right angles: for others"):
        jm.prepare(capsule(30), "wall", "far", symmetry=between_half_planes(30), method=springs)


@over(
    "name dimension planes",
    slow=[("reconstruction", 2, 1)],
    nightly=[("multiscale", 3, 2), ("full", 3, 2)],
)
def test_laws_with_symmetry_planes(name, dimension, planes):
    part, role, *_ = whole_and_part(dimension, planes)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    symmetry = [jm.Plane(np.eye(dimension)[axis], np.zeros(dimension)) for axis in range(planes)]
    plan = jm.prepare(part, moving, fixed, method=METHODS[name], symmetry=symmetry)
    u = motion(part)[moving]
    moved = np.asarray(jm.deform(plan, u))
    within = u.copy()
    for axis in range(planes):
        on = part[:, axis] == 0
        assert on.sum() >= 4
        assert (moved[on, axis] == 0).all()  # bit for bit, though u asks for more
        within[part[moving, axis] == 0, axis] = 0
        assert (on & (role == 0)).any()
        slid = np.abs(moved - part)[on & (role == 0)].max()
        assert slid > 1e-3
    assert (moved[moving] == part[moving] + within).all()
    assert (moved[fixed] == part[fixed]).all()
    assert (jm.deform(plan, within) == moved).all()
    check_linear(plan, u)

    def in_planes(step):
        for axis in range(planes):
            step[part[:, axis] == 0, axis] = 0
        return step

    check_base_derivative(plan, u, in_planes)


def between_planes(dimension):
    """A round body half way between the planes y = 0 and y = 1, which hold nodes; both ends of the passage are fixed."""
    rng = np.random.default_rng(3)
    axes = [np.linspace(-2, 2, 21), np.linspace(0, 1, 9), np.linspace(-0.5, 0.5, 5)][:dimension]
    grid = lattice(*axes)
    centre = np.array([0, 0.5, 0])[:dimension]
    grid = grid[np.linalg.norm(grid - centre, axis=1) > 0.3]
    directions = rng.normal(size=(24 if dimension == 2 else 80, dimension))
    wall = centre + 0.25 * directions / np.linalg.norm(directions, axis=1)[:, None]
    points = np.concatenate([wall, grid])
    return points, np.arange(len(wall)), np.flatnonzero(np.abs(points[:, 0]) == 2)


@over("dimension", slow=[2], nightly=[3])
def test_two_parallel_planes(dimension):
    """Nodes stay in both planes, and none off a plane moves across it faster than half of its distance."""
    points, moving, fixed = between_planes(dimension)
    planes = [jm.Plane(np.eye(dimension)[1], np.eye(dimension)[1] * y) for y in (0.0, 1.0)]
    plan = jm.prepare(points, moving, fixed, method=METHODS["full"], symmetry=planes)
    u = 0.1 * np.random.default_rng(0).normal(size=dimension) + 0.05 * (
        points[moving] - points[moving].mean(axis=0)
    )
    moved = np.asarray(jm.deform(plan, u))
    on = (points[:, 1] == 0) | (points[:, 1] == 1)
    assert (moved[on, 1] == points[on, 1]).all()
    assert np.abs(moved - points)[on, 0].max() > 0.01
    np.testing.assert_array_equal(moved[moving], points[moving] + u)
    near = np.minimum(points[:, 1], 1 - points[:, 1])
    inside = ~on & (near < 0.2)
    assert (np.abs(moved - points)[inside, 1] < 0.5 * near[inside]).all()


@pytest.mark.nightly
def test_thin_layers_beside_two_parallel_planes():
    """Cells at both walls keep their shape although they move by thousands of their height; the transpose, and pieces."""
    half = np.concatenate([[0], 1e-5 * 2.0 ** np.arange(13), np.linspace(0.1, 0.5, 6)])
    x, y = np.linspace(0, 3, 31), np.concatenate([half, 1 - half[-2::-1]])
    points, quads = lattice(x, y), blocks(np.arange(len(x) * len(y)).reshape(len(x), len(y)))
    inside = np.all(np.abs(points - [1.5, 0.5]) < [0.45, 0.15], axis=1)
    used, number = np.unique(quads[~inside[quads].any(axis=1)], return_inverse=True)
    points = points[used]
    mesh = jm.Mesh(points, {"quad": number.reshape(-1, 4)})
    body = np.flatnonzero(np.all(np.abs(points - [1.5, 0.5]) < [0.6, 0.25], axis=1))
    ends = np.flatnonzero((points[:, 0] == 0) | (points[:, 0] == 3))
    planes, u = (
        [jm.Plane([0, 1], [0, 0]), jm.Plane([0, 1], [0, 1])],
        np.tile([0.05, 0.1], (len(body), 1)),
    )
    boundary = jm.Boundary(mesh, body, ends, symmetry=planes)
    plan = jm.prepare(boundary)
    moved, w = np.asarray(jm.deform(plan, u)), np.random.default_rng(0).normal(size=points.shape)
    assert jm.quality(mesh, moved).min_jacobian_ratio > 0.3
    on = (points[:, 1] == 0) | (points[:, 1] == 1)
    assert (moved[on, 1] == points[on, 1]).all()
    assert np.abs(moved - points)[on, 0].max() > 0.01  # they slide
    assert plan.is_linear
    assert np.vdot(jm.pullback(plan, u, w), u) == pytest.approx(
        np.vdot(w, moved - points), rel=1e-10
    )
    rows = np.arange(0, len(points), 3)
    part = jm.prepare_surface(boundary).attach(points[rows], rows)
    np.testing.assert_allclose(jm.deform(part, u), moved[rows], rtol=0, atol=1e-14)


def half():
    """The right half of a body in 2-D: points, moving and fixed nodes, and those on the plane."""
    part, role, *_ = whole_and_part(2, 1)
    return (
        part,
        np.flatnonzero(role == 1),
        np.flatnonzero(role == 2),
        np.flatnonzero(part[:, 0] == 0),
    )


@pytest.mark.nightly
def test_a_marched_symmetric_mesh():
    part, moving, fixed, _ = half()
    plan = jm.prepare(
        part, moving, fixed, method=METHODS["reconstruction"], symmetry=jm.Plane([1, 0], [0, 0])
    )
    path = np.stack([motion(part)[moving], 2 * motion(part)[moving]])
    for end in check_steps(plan, path):
        assert (end[part[:, 0] == 0, 0] == 0).all()


def test_a_plane_anywhere():
    """At another place and angle the same mesh moves the same; `Plane.through` finds it from the nodes on it."""
    part, moving, fixed, on = half()
    u = motion(part)[moving]
    straight = jm.deform(
        jm.prepare(part, moving, fixed, method=METHODS["full"], symmetry=jm.Plane([1, 0], [0, 0])),
        u,
    )
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    points = part @ turn.T + [5.0, -3.0]
    plane = jm.Plane.through(points, on)
    assert abs(plane.normal @ turn[:, 1]) < 1e-14
    moved = jm.deform(
        jm.prepare(points, moving, fixed, method=METHODS["full"], symmetry=plane), u @ turn.T
    )
    np.testing.assert_allclose(
        moved, straight @ turn.T + np.array([[5.0, -3.0]]), rtol=0, atol=1e-10
    )
    exact = jm.Plane.through(part + np.array([0.1, 0.0]), on)
    assert (exact.normal == [1, 0]).all()
    assert exact.origin[0] == 0.1


@pytest.mark.nightly
def test_a_patch_that_lies_in_several_planes():
    """Front and back, or all sides of a duct, as one patch: the planes one by one. A duct of one cell's width is the hardest."""
    axes = np.linspace(0, 2, 7), np.array([0, 1.0]), np.array([0, 0.5, 1.5])
    points = lattice(*axes)
    ids = np.arange(len(points)).reshape(7, 2, 3)
    cells = blocks(ids)
    front, bottom = (np.isin(points[:, axis], axes[axis][[0, -1]]) for axis in (1, 2))
    sides = {
        "front and back": front,
        "sides": front | bottom,
        "inlet": points[:, 0] == 0,
        "outlet": points[:, 0] == 2,
    }
    mesh = jm.Mesh(
        points,
        {"hexahedron": cells},
        {name: np.flatnonzero(is_on) for name, is_on in sides.items()},
    )
    u = np.tile([0.2, 0, 0], (6, 1))
    one_by_one = [
        jm.Plane(np.eye(3)[axis], point) for axis in (1, 2) for point in ([0, 0, 0], [0, 1, 1.5])
    ]

    def prepare(mesh, planes):
        return jm.prepare(mesh, "inlet", "outlet", symmetry=planes, free="sides", method=jm.RBF())

    for name, planes in (("front and back", one_by_one[:2]), ("sides", one_by_one)):
        moved, expected = jm.deform(prepare(mesh, name), u), jm.deform(prepare(mesh, planes), u)
        np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-12)
    turned = points @ np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]]) + 1 / 3
    planes = prepare(mesh.moved(np.round(turned, 8)), "front and back").images  # as a file has it
    assert planes is not None
    assert [abs(plane.normal @ [0, 0.6, -0.8]) for plane in planes.planes] == pytest.approx(
        [1, 1], abs=1e-7
    )
    slim = points[:, [1, 0, 2]][ids[:2, :, :2].ravel()]
    slim = jm.Mesh(slim, {"hexahedron": [[0, 4, 6, 2, 1, 5, 7, 3]]}, {"all": range(8)})
    with pytest.raises(ValueError, match="do not lie in one plane"):
        jm.prepare(slim, [0], symmetry="all")
    bent = points.copy()
    bent[ids[3, 0, 1], 1] -= 0.01
    with pytest.raises(ValueError, match=r"do not lie in one plane: node \d+ at"):
        prepare(mesh.moved(bent), "front and back")


def whole(*planes):
    mesh = body(2)
    points, symmetry = (
        np.append(mesh.points, [[0, 1.0], [0, 2.0]], axis=0),
        [jm.Plane(*each) for each in planes],
    )
    return lambda: jm.prepare(points, mesh.moving, mesh.fixed, method=GRAPH, symmetry=symmetry)


def upper(normal, shift):
    """The half of a body, with its plane moved by `shift`, or to the nodes next to it."""
    part, moving, fixed, _ = half()
    at = np.sort(part[part[:, 0] != 0, 0])[0] if shift is None else shift
    return lambda: jm.prepare(
        part, moving, fixed, method=GRAPH, symmetry=jm.Plane([normal, 0], [at, 7])
    )


test_what_is_not_a_symmetry_plane = refusals(
    (lambda: jm.Plane([0, 0], [0, 0]), "the normal comes first, and is not zero"),
    (lambda: jm.Plane([1, 0], [0, 0, 0]), "the normal comes first, and is not zero"),
    (whole(([0, 0, 1], [0, 0, 0])), "normal has 3 components; the mesh has 2 dimensions"),
    (whole(([1, 0], [0, 0]), ([1, 1], [0, 0])), "parallel or at right angles"),
    (
        lambda: jm.Plane.through(body(2).points, body(2).moving),
        r"do not lie in one plane: node \d+ at",
    ),
    (lambda: jm.Plane.through(body(2).points, np.array([5])), "1 nodes do not determine a plane"),
    (
        upper(2, -0.01),
        r"holds no node of the mesh: the nearest, node \d+, is 0\.01 away \(tolerance",
    ),
    (upper(1, None), r"nodes on both sides: \d+ of \d+ lie beyond .* \S+ away"),
    (upper(-1, None), r"nodes on both sides: \d+ of \d+ lie beyond .* \S+ away"),
)


def test_nodes_beyond_a_plane_are_counted():
    """On the side that has fewer; the farthest is named."""
    mesh = body(2)
    x = np.append(mesh.points[:, 0], [0, 0])
    beyond, farthest = (x < 0).sum(), x.argmin()
    assert beyond < len(x) / 2
    with pytest.raises(
        ValueError, match=rf"{beyond} of 312 lie beyond it, the farthest is node {farthest} at"
    ):
        whole(([1, 0], [0, 0]))()
    part = whole_and_part(2, 1)[0]
    gap = np.sort(part[part[:, 0] != 0, 0])[0]
    with pytest.raises(
        ValueError, match=rf"{(part[:, 0] == 0).sum()} of {len(part)} lie beyond .* {gap:.3g} away"
    ):
        upper(1, None)()


@pytest.mark.slow
def test_a_symmetry_plane_of_a_float32_mesh():
    """Turned and moved away from the origin, its nodes lie on no plane to better than 1e-7 of their coordinates."""
    part, moving, fixed, on = half()
    u = motion(part)[moving]
    turn, shift = np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([5.0, -3.0])
    points = (part @ turn.T + shift).astype(np.float32)
    plane = jm.Plane(turn[:, 0], shift)
    off = np.abs(plane.height(points))
    assert off[on].max() > 1e-8 * np.ptp(points)
    assert jm.Plane.through(points, on).holds(points)[on].all()
    assert (np.flatnonzero(plane.holds(points)) == on).all()
    exact = jm.deform(
        jm.prepare(part, moving, fixed, method=METHODS["full"], symmetry=jm.Plane([1, 0], [0, 0])),
        u,
    )
    plan = jm.prepare(points, moving, fixed, method=METHODS["full"], symmetry=plane)
    moved = jm.deform(plan, (u @ turn.T).astype(np.float32))
    np.testing.assert_allclose(moved, exact @ turn.T + np.atleast_2d(shift), rtol=0, atol=1e-4)


def test_the_planes_of_a_patch_hold_its_nodes():
    """One side of a box is one plane, two sides that face each other are two."""
    box = unit_box()
    ends = {"both": np.union1d(box.patch("z0"), box.patch("z1"))}
    mesh = jm.Mesh(box.points, box.cells, {**box.patches, **ends})
    (plane,) = jm.Plane.of_patch(mesh, "y1")
    np.testing.assert_allclose([*np.abs(plane.normal), plane.origin[1]], [0, 1, 0, 1], atol=1e-12)
    both = jm.Plane.of_patch(mesh, "both")
    assert sorted(round(float(plane.origin[2]), 9) for plane in both) == [0, 1]
    with pytest.raises(ValueError, match="no patch is called"):
        jm.Plane.of_patch(mesh, "nowhere")
