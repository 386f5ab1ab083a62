"""Plans: what prepare refuses and in which words, and symmetry planes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few, full, motion

import jaxmorph as jm

GRAPH = jm.DelaunayGraph()


def replaced(values, places, by):
    values = np.array(values)
    values[places] = by
    return values


def test_what_prepare_refuses():
    mesh = body(2)
    p, moving, fixed, n = mesh.points, mesh.moving, mesh.fixed, len(mesh.points)
    refused = {
        r"2 of 310 points are not finite, first node 5\.": (replaced(p, [5, 9], np.nan), moving, fixed),
        r"1 of 310 points are not finite, first node 7\.": (replaced(p, 7, np.inf), moving, fixed),
        r"1 nodes are named more than once in `moving`": (p, np.append(moving, moving[2]), fixed),
        r"2 ids in `moving` are not nodes of the mesh \(0 to 309\), first -1\.": (p, [3, -1, n], fixed),
        r"1 ids in `fixed` are not nodes of the mesh \(0 to 309\), first 310\.": (p, moving, [0, n]),
        r"`moving` must be a list of node ids, not bool .* np\.flatnonzero\(moving\)": (
            p,
            np.isin(np.arange(n), moving),
            fixed,
        ),
        r"`fixed` must be a list of node ids, not bool .* np\.flatnonzero\(fixed\)": (
            p,
            moving,
            np.isin(np.arange(n), fixed),
        ),
        r"`moving` must be a list of node ids, not float64": (p, moving.astype(float), fixed),
        r"`moving` must be a list of node ids, not int64 of shape \(1, 31\)": (p, moving[None], fixed),
        r"`moving` is empty": (p, [], fixed),
        r"`points` has shape \(310, 4\); expected \(n, 2\) or \(n, 3\)": (np.ones((n, 4)), moving, fixed),
        r"`points` has shape \(310,\)": (p[:, 0], moving, fixed),
    }
    for message, arguments in refused.items():
        with pytest.raises(ValueError, match=message):
            jm.prepare(*arguments, method=GRAPH)


def test_shapes_are_compared_at_the_door():
    """A gather beyond the end is clamped in silence: nine rows for ten nodes must not pass, nor any other shape, traced or not."""
    mesh = body(2)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=GRAPH)
    m = len(mesh.moving)
    for shape in ((m - 1, 2), (m + 1, 2), (m, 3), (2 * m,), (1, m, 2), ()):
        text = rf"`u` has shape {shape}; this plan moves {m} points in 2 dimensions\.".replace("(", r"\(").replace(
            ")", r"\)"
        )
        for function in (jm.deform, jax.jit(jm.deform)):
            with pytest.raises(ValueError, match=text):
                function(plan, np.zeros(shape))
    with pytest.raises(ValueError, match=r"`cotangent` has shape \(31, 2\)"):
        jm.pullback(plan, np.zeros((m, 2)), np.zeros((m, 2)))
    with pytest.raises(ValueError, match=r"`points` has shape \(309, 2\); this plan was made for \(310, 2\)"):
        jm.refit(plan, mesh.points[1:])


def test_what_a_plan_says_of_itself():
    mesh = body(2)
    plan = jm.prepare(mesh.points, mesh.moving, np.concatenate([mesh.fixed, mesh.fixed, mesh.moving[:5]]), method=GRAPH)
    assert (np.asarray(plan.moving) == mesh.moving).all()
    assert (np.asarray(plan.fixed) == mesh.fixed).all()  # a node in both moves; one named twice is one
    assert (np.asarray(plan.points) == mesh.points).all()
    assert "310 points in 2-D, 31 moving, 31 fixed" in repr(plan)


def test_numbers_of_other_kinds():
    """Lists, integers, and JAX's own arrays are as good as NumPy's."""
    square = [[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.25]]
    plan = jm.prepare(square, [3], [0, 1, 2], method=GRAPH)
    moved = jm.deform(plan, [[1, 2]])
    again = jm.deform(
        jm.prepare(jnp.asarray(square), jnp.array([3]), jnp.array([0, 1, 2]), method=GRAPH), jnp.array([[1.0, 2.0]])
    )
    assert (moved == again).all()
    assert moved.dtype == np.float64
    integers = jm.prepare(np.array([[0, 0], [2, 0], [0, 2], [2, 2], [1, 1]]), [3], [0, 1, 2], method=GRAPH)
    assert jm.deform(integers, [[1, 1]]).dtype == np.float64


def test_refit_is_prepare_on_points_that_keep_their_graph():
    """Squeezed a little, the mesh has the same ids; the plan's floats are those of the new coordinates."""
    mesh = body(2)
    u, points = motion(mesh.points[mesh.moving]), mesh.points * [1.0, 1 + 1e-7]
    for method in (few(), GRAPH, jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3))):
        refitted = jm.refit(jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=method), points)
        expected = jm.deform(jm.prepare(points, mesh.moving, mesh.fixed, method=method), u)
        np.testing.assert_allclose(jm.deform(refitted, u), expected, rtol=0, atol=1e-12)


def whole_and_part(dimension, planes):
    """A body symmetric in the first `planes` coordinates, whole, and the ids of the part on the positive side."""
    mesh = body(dimension)
    part = mesh.points[(mesh.points[:, :planes] > 0.05).all(axis=1)]
    role = np.zeros(len(mesh.points), int)
    role[mesh.moving], role[mesh.fixed] = 1, 2
    role = role[(mesh.points[:, :planes] > 0.05).all(axis=1)]
    for axis in range(planes):  # a layer of nodes on the plane
        on = part[:: 3 if dimension == 2 else 2].copy()
        on[:, axis] = 0
        part, role = np.concatenate([part, on]), np.concatenate([role, role[:: 3 if dimension == 2 else 2]])
    _, first = np.unique(np.round(part, 9), axis=0, return_index=True)
    part, role = part[np.sort(first)], role[np.sort(first)]
    whole, whole_role, image_of, signs = part, role, np.arange(len(part)), np.ones_like(part)
    for axis in range(planes):
        off = whole[:, axis] != 0
        flip = np.ones(dimension)
        flip[axis] = -1
        whole = np.concatenate([whole, whole[off] * flip])
        whole_role, image_of = np.concatenate([whole_role, whole_role[off]]), np.concatenate([image_of, image_of[off]])
        signs = np.concatenate([signs, signs[off] * flip])
    return part, role, whole, whole_role, image_of, signs


MIRRORED = [(2, 1), (2, 2), (3, 2)]
METHODS = {
    "full": full(jm.ThinPlateSpline(), 1),
    "reconstruction": jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3)),
}


@pytest.mark.parametrize(("dimension", "planes"), MIRRORED)
def test_full_interpolation_equals_that_of_the_whole_mesh(dimension, planes):
    part, role, whole, whole_role, image_of, signs = whole_and_part(dimension, planes)
    assert len(whole) > 2**planes * 0.6 * len(part)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    u = motion(part)
    for axis in range(planes):
        u[part[:, axis] == 0, axis] = 0
    symmetry = [jm.Plane(np.eye(dimension)[axis] * 3, np.zeros(dimension)) for axis in range(planes)]
    moved = jm.deform(jm.prepare(part, moving, fixed, method=METHODS["full"], symmetry=symmetry), u[moving])
    whole_moving = np.flatnonzero(whole_role == 1)
    plan = jm.prepare(whole, whole_moving, np.flatnonzero(whole_role == 2), method=METHODS["full"])
    expected = jm.deform(plan, (u[image_of] * signs)[whole_moving])
    np.testing.assert_allclose(moved, expected[: len(part)], rtol=0, atol=1e-11)


@pytest.mark.parametrize(("name", "dimension", "planes"), [("full", 3, 2), ("reconstruction", 2, 1)])
def test_laws_with_symmetry_planes(name, dimension, planes):
    part, role, *_ = whole_and_part(dimension, planes)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    symmetry = [jm.Plane(np.eye(dimension)[axis], np.zeros(dimension)) for axis in range(planes)]
    plan = jm.prepare(part, moving, fixed, method=METHODS[name], symmetry=symmetry)
    u, rng = motion(part)[moving], np.random.default_rng(0)
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
    v = rng.normal(size=u.shape)
    combined = jm.deform(plan, 2 * u - v) - part
    np.testing.assert_allclose(combined, 2 * (moved - part) - (jm.deform(plan, v) - part), rtol=0, atol=1e-11)
    w = rng.normal(size=part.shape)
    pulled = jm.pullback(plan, u, w)
    np.testing.assert_allclose(np.vdot(pulled, u), np.vdot(w, moved - part), rtol=1e-10)

    @jax.jit
    @jax.value_and_grad
    def objective(points):
        return jnp.sum(w * jm.deform(jm.refit(plan, points), u))

    step = 1e-7 * rng.normal(size=part.shape)
    for axis in range(planes):
        step[part[:, axis] == 0, axis] = 0  # nodes on a plane stay on it
    difference = (objective(part + step)[0] - objective(part - step)[0]) / 2
    np.testing.assert_allclose(np.vdot(objective(part)[1], step), difference, rtol=1e-5, atol=1e-12)


def test_a_marched_symmetric_mesh():
    part, role, *_ = whole_and_part(2, 1)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    plan = jm.prepare(part, moving, fixed, method=METHODS["reconstruction"], symmetry=jm.Plane([1, 0], [0, 0]))
    path = np.stack([motion(part)[moving], 2 * motion(part)[moving]])
    for rebuild in (False, True):
        plans, points = jm.march(plan, path, rebuild=rebuild)
        assert (points[part[:, 0] == 0, 0] == 0).all()
        np.testing.assert_allclose(jm.replay(plans, path), points, rtol=0, atol=1e-12)


def test_a_plane_anywhere():
    """At another place and angle the same mesh moves the same; `Plane.through` finds it from the nodes on it."""
    part, role, *_ = whole_and_part(2, 1)
    moving, fixed = np.flatnonzero(role == 1), np.flatnonzero(role == 2)
    u, on = motion(part)[moving], np.flatnonzero(part[:, 0] == 0)
    straight = jm.deform(jm.prepare(part, moving, fixed, method=METHODS["full"], symmetry=jm.Plane([1, 0], [0, 0])), u)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    points = part @ turn.T + [5.0, -3.0]
    plane = jm.Plane.through(points, on)
    assert abs(plane.normal @ turn[:, 1]) < 1e-14
    moved = jm.deform(jm.prepare(points, moving, fixed, method=METHODS["full"], symmetry=plane), u @ turn.T)
    np.testing.assert_allclose(moved, straight @ turn.T + np.array([5.0, -3.0]), rtol=0, atol=1e-10)
    exact = jm.Plane.through(part + np.array([0.1, 0.0]), on)
    assert (exact.normal == [1, 0]).all()
    assert exact.origin[0] == 0.1


def test_what_is_not_a_symmetry_plane():
    mesh = body(2)
    arguments = (mesh.points, mesh.moving, mesh.fixed)
    for normal, origin in (([0, 0], [0, 0]), ([1, 0], [0, 0, 0]), ([np.nan, 0], [0, 0])):
        with pytest.raises(ValueError, match="a plane needs a normal that is not zero"):
            jm.Plane(normal, origin)
    with pytest.raises(ValueError, match="normal has 3 components; the mesh has 2 dimensions"):
        jm.prepare(*arguments, method=GRAPH, symmetry=jm.Plane([0, 0, 1], [0, 0, 0]))
    with pytest.raises(ValueError, match="at right angles"):
        jm.prepare(*arguments, method=GRAPH, symmetry=[jm.Plane([1, 0], [0, 0]), jm.Plane([1, 1], [0, 0])])
    with pytest.raises(ValueError, match=r"do not lie in one plane: node \d+ at"):
        jm.Plane.through(mesh.points, mesh.moving)
    with pytest.raises(ValueError, match="1 nodes do not determine a plane"):
        jm.Plane.through(mesh.points, mesh.moving[:1])
