"""Plans: what prepare refuses and in which words, what a plan says of itself, derivatives of whole maps, many calls of one."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import body, few, motion, whole_and_part
from memory import resident
from meshes import bricks
from oracles import jacobian
from runs import over, refusals

import jaxmorph as jm

GRAPH = jm.DelaunayGraph()


def replaced(values, places, by):
    values = np.array(values)
    values[places] = by
    return values


MESH = body(2)
N, P, MOVING, FIXED = len(MESH.points), MESH.points, MESH.moving, MESH.fixed
test_what_prepare_refuses = refusals(
    (
        lambda: prepared(replaced(P, [5, 9], np.nan)),
        r"2 of 310 points are not finite, first node 5\.",
    ),
    (lambda: prepared(replaced(P, 7, np.inf)), r"1 of 310 points are not finite, first node 7\."),
    (
        lambda: prepared(P, np.append(MOVING, MOVING[2])),
        r"1 nodes are named more than once in `moving`",
    ),
    (lambda: prepared(P, [3, -1, N]), r"2 ids in `moving` are not in 0 to 309, first -1\."),
    (lambda: prepared(P, MOVING, [0, N]), r"1 ids in `fixed` are not in 0 to 309, first 310\."),
    (
        lambda: prepared(P, np.isin(np.arange(N), MOVING)),
        r"`moving` must be a list of ids.*bool; .* np\.flatnonzero\(moving",
    ),
    (
        lambda: prepared(P, MOVING, np.isin(np.arange(N), FIXED)),
        r"`fixed` must be .*bool; .* np\.flatnonzero\(fixed\)",
    ),
    (
        lambda: prepared(P, MOVING.astype(float)),
        r"`moving` must be a list of ids, not an array \(31,\) of float64",
    ),
    (
        lambda: prepared(P, MOVING[None]),
        r"`moving` must be a list of ids, not an array \(1, 31\) of int64",
    ),
    (lambda: prepared(P, []), "`moving` is empty"),
    (
        lambda: prepared(np.ones((N, 4))),
        r"`points` has shape \(310, 4\); expected \(any, 2\) or \(any, 3\)",
    ),
    (lambda: prepared(P[:, 0]), r"`points` has shape \(310,\)"),
)


def prepared(points, moving=MOVING, fixed=FIXED):
    return jm.prepare(points, moving, fixed, method=GRAPH)


def test_shapes_are_compared_first():
    """A gather beyond the end is clamped in silence: nine rows for ten nodes must not pass, nor any other shape, traced or not."""
    mesh = body(2)
    plan = jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=GRAPH)
    m = len(mesh.moving)
    for shape in ((m - 1, 2), (m + 1, 2), (m, 3), (2 * m,), (1, m, 2), ()):
        text = re.escape(f"`u` has shape {shape}; this plan moves {m} points in 2 dimensions.")
        for function in (jm.deform, jax.jit(jm.deform)):
            with pytest.raises(ValueError, match=text) as told:
                function(plan, np.zeros(shape))
            assert ("jax.vmap" in str(told.value)) == (len(shape) == 3)
    with pytest.raises(ValueError, match=r"`cotangent` has shape \(31, 2\)"):
        jm.pullback(plan, np.zeros((m, 2)), np.zeros((m, 2)))
    with pytest.raises(
        ValueError, match=r"`points` has shape \(309, 2\); this plan was made for \(310, 2\)"
    ):
        jm.refit(plan, mesh.points[1:])


def test_what_a_plan_says_of_itself():
    mesh = body(2)
    plan = jm.prepare(
        mesh.points,
        mesh.moving,
        np.concatenate([mesh.fixed, mesh.fixed, mesh.moving[:5]]),
        method=GRAPH,
    )
    assert (np.asarray(plan.moving) == mesh.moving).all()
    assert (
        np.asarray(plan.fixed) == mesh.fixed
    ).all()  # a node in both moves; one named twice is one
    assert (np.asarray(plan.points) == mesh.points).all()
    assert "310 points in 2-D, 31 moving, 31 fixed, float64, " in repr(plan)


@pytest.mark.nightly
def test_a_plan_speaks_whatever_its_leaves_are():
    """Error messages, debuggers and progress bars print plans of shapes, of nothing, and stacked ones."""
    mesh = body(2)
    plan = jm.prepare(
        mesh.points,
        mesh.moving,
        mesh.fixed,
        method=jm.SurfaceReconstruction(few(), jm.DelaunayGraph()),
    )
    said = "310 points in 2-D, 31 moving, 31 fixed, float64"
    for other in (jax.eval_shape(lambda: plan), eqx.filter_eval_shape(jm.refit, plan, mesh.points)):
        assert said in repr(other)
    nothing = jax.tree.map(lambda _: None, plan)
    assert "31 moving" in repr(nothing)
    assert "Plan(" in repr(
        eqx.filter_grad(lambda plan: jm.deform(plan, mesh.points[mesh.moving]).sum())(plan)
    )
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), plan, plan)
    assert said in repr(stacked)
    traced = []
    jax.jit(lambda plan: traced.append(repr(plan)))(plan)
    assert said in traced[0]
    assert said in repr(jm.shard(plan, jax.devices()[:1]))


def test_integers_are_floats_of_jaxs_precision():
    plan = jm.prepare(
        np.array([[0, 0], [2, 0], [0, 2], [2, 2], [1, 1]]), [3], [0, 1, 2], method=GRAPH
    )
    assert jm.deform(plan, [[1, 1]]).dtype == np.float64


def test_refit_is_prepare_on_points_that_keep_their_graph():
    """Squeezed a little, the mesh has the same ids; the plan's floats are those of the new coordinates."""
    mesh = body(2)
    u, points = motion(mesh.points[mesh.moving]), mesh.points * [1.0, 1 + 1e-7]
    for method in (few(), GRAPH, jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3))):
        refitted = jm.refit(jm.prepare(mesh.points, mesh.moving, mesh.fixed, method=method), points)
        expected = jm.deform(jm.prepare(points, mesh.moving, mesh.fixed, method=method), u)
        np.testing.assert_allclose(jm.deform(refitted, u), expected, rtol=0, atol=1e-12)


class Counting(jm.AbstractPlacing):
    """A method that counts how often it is connected, and the points it is then asked about."""

    method: jm.AbstractMethod
    asked: list = eqx.field(static=True)

    def connect(self, surface, points):
        self.asked.append(len(points))
        return self.method.connect(surface, points)

    def fit(self, ids, surface, points):
        return self.method.fit(ids, surface, points)

    def place(self, x, ids, factors, surface):
        return self.method.place(x, ids, factors, surface)

    def field(self, ids, factors, surface, u):
        return self.method.field(ids, factors, surface, u)


@over("planes", [0], nightly=[1])
def test_a_coarse_method_is_connected_once(planes):
    """Its mesh points and the surface's mirror images together: one search, one reduction."""
    part, role, *_ = whole_and_part(2, planes) if planes else (body(2).points, np.zeros(310))
    moving, fixed = (
        (np.flatnonzero(role == k) for k in (1, 2)) if planes else (body(2).moving, body(2).fixed)
    )
    symmetry = [jm.Plane([1, 0], [0, 0])] * planes
    asked = []
    method = jm.SurfaceReconstruction(Counting(jm.DelaunayGraph(), asked), jm.DelaunayGraph())
    plan = jm.prepare(part, moving, fixed, method=method, symmetry=symmetry)
    images = len(plan.surface.points) - len(plan.surface.nodes)
    assert asked == [len(part) + images]
    assert (images > 0) == bool(planes)
    u = motion(part)[moving]
    expected = jm.deform(
        jm.prepare(part, moving, fixed, method=jm.DelaunayGraph(), symmetry=symmetry), u
    )
    np.testing.assert_allclose(jm.deform(plan, u), expected, rtol=0, atol=1e-14)


def test_the_transpose_after_refit_has_every_entry():
    """Entry by entry, with an inner node first: the table of the transposed product keeps the weights of all."""
    mesh = body(2)
    order = np.concatenate([mesh.inner[:20], mesh.boundary])
    place = np.full(len(mesh.points), -1)
    place[order] = np.arange(len(order))
    points = mesh.points[order]
    plan = jm.prepare(points, place[mesh.moving], place[mesh.fixed], method=jm.DelaunayGraph())
    again = jm.refit(plan, points @ np.array([[1.1, 0.2], [0.0, 0.9]]))
    rng = np.random.default_rng(0)
    u, w = rng.normal(size=(plan.n_moving, 2)), np.zeros(points.shape)
    for node in range(20):
        w[:] = 0
        w[node] = rng.normal(size=2)
        forward = np.vdot(w, jm.deform(again, u) - again.points)
        np.testing.assert_allclose(
            np.vdot(jm.pullback(again, u, w), u), forward, rtol=1e-10, atol=1e-13
        )


@pytest.mark.slow
@pytest.mark.skipif(not resident(), reason="memory is read as Linux tells it")
def test_a_thousand_calls_leave_nothing_behind():
    mesh = bricks(8)
    points = np.asarray(mesh.points)
    plan = jm.prepare(points, mesh.patch("floor"), np.flatnonzero(points[:, 2] == 1))
    rng = np.random.default_rng(0)
    u, cotangent = 0.01 * rng.normal(size=(plan.n_moving, 3)), rng.normal(size=points.shape)

    def both():
        return np.asarray(jm.deform(plan, u)), np.asarray(jm.pullback(plan, u, cotangent))

    compiled = []

    def listen(event, *_, **__):
        if "backend_compile" in event:
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        jax.clear_caches()
        for _ in range(20):
            first = both()
        assert compiled, "the event of a compilation has another name"
        compiled.clear()
        before = resident()
        for _ in range(1000):
            again = both()
    finally:
        jax.monitoring.clear_event_listeners()
    assert not compiled
    assert resident() - before < 20e6
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


def operator(plan):
    """(n d, m d): the linear map by its columns, each a displaced mesh of its own."""
    m, d = plan.n_moving, plan.points.shape[1]
    moved = jax.jit(jax.vmap(lambda u: jm.deform(plan, u) - plan.points))(
        np.eye(m * d).reshape(-1, m, d)
    )
    return np.asarray(moved).reshape(m * d, -1).T


def check_operator(plan, rows=slice(None, None, 7)):
    """Forward mode, reverse mode and `pullback` give the operator, to 1e-8 in each component."""
    a, u = operator(plan), jnp.zeros((plan.n_moving, plan.points.shape[1]))
    forward = jax.jit(jax.jacfwd(lambda u: jm.deform(plan, u)))(u)
    np.testing.assert_allclose(forward.reshape(a.shape), a, rtol=0, atol=1e-8)
    picked = np.eye(len(a))[rows].reshape(-1, *plan.points.shape)
    reverse = jax.jit(jax.vmap(lambda w: jm.pullback(plan, u, w)))(picked)
    np.testing.assert_allclose(reverse.reshape(len(picked), -1), a[rows], rtol=0, atol=1e-8)
    return a


def check_base(plan, u, places):
    """The gradient by base points: finite everywhere, and that of differences in the components (node, axis) of `places`."""
    w = np.random.default_rng(5).normal(size=plan.points.shape)
    points = np.asarray(plan.points)
    objective = jax.jit(lambda points: jnp.sum(w * jm.deform(jm.refit(plan, points), u)))
    found = np.asarray(jax.jit(jax.grad(objective))(points))
    assert np.isfinite(found).all()
    nodes, axes = np.array(places).T
    expected = jacobian(
        lambda x: objective(jnp.asarray(points).at[nodes, axes].set(x)), points[nodes, axes], 1e-4
    )
    np.testing.assert_allclose(
        found[nodes, axes], expected, rtol=1e-6, atol=1e-6 * np.abs(found).max()
    )


@over("planes", nightly=[1, 2, 3])
def test_symmetry_planes(planes):
    part, role, *_ = whole_and_part(3, planes)
    moving, fixed, inner = (np.flatnonzero(role == k) for k in (1, 2, 0))
    symmetry = [jm.Plane(np.eye(3)[axis], np.zeros(3)) for axis in range(planes)]
    method = jm.SurfaceReconstruction(few(), jm.NearWall(width=0.3))
    plan = jm.prepare(part, moving, fixed, method=method, symmetry=symmetry)
    a = check_operator(plan).reshape(*part.shape, len(moving), 3)
    for axis in range(planes):
        on = part[:, axis] == 0
        assert (a[on, axis] == 0).all()  # what stays in a plane
        assert (a[:, :, on[moving], axis] == 0).all()  # and what leads off it
    off = inner[(part[inner, :planes] != 0).all(axis=1)][::25]
    held = moving[(part[moving, :planes] != 0).all(axis=1)][:2]
    check_base(
        plan,
        motion(part)[moving],
        [(node, axis) for node in (*off[:3], *held) for axis in range(3)],
    )


@pytest.mark.nightly
def test_coincident_nodes():
    """A wall node in two copies that move apart, and an inner node on the wall."""
    mesh = body(2)
    twice, on_wall = mesh.points[mesh.moving[:1]], mesh.points[mesh.moving[5:6]]
    points, n = np.concatenate([mesh.points, twice, on_wall]), len(mesh.points)
    plan = jm.prepare(points, np.append(mesh.moving, n), mesh.fixed)
    a = check_operator(plan).reshape(*points.shape, -1, 2)
    for copy, row in ((mesh.moving[0], 0), (n, len(mesh.moving))):
        np.testing.assert_array_equal(a[copy, :, row], np.eye(2))
    u = motion(points)[np.append(mesh.moving, n)]
    check_base(plan, u, [(node, axis) for node in mesh.inner[::40] for axis in range(2)])
