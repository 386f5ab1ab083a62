"""Sliding patches: nodes stay on lines, planes, surfaces of revolution and faces, and on the edges between them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import BY_NAME, NAMES, full
from laws import check_linear, check_parts, check_steps
from meshes import blocks, box_with_hole, drum, lattice, ring, turn
from runs import over
from scipy.interpolate import CubicSpline

import jaxmorph as jm
from benchmarks import faults
from jaxmorph._boundary.slide import walls_of_patch
from jaxmorph._boundary.tracks import tracks_of
from jaxmorph._host.cells.pieces import outer_pieces
from jaxmorph._host.surface.gaps import closest
from jaxmorph._kernels.compile import UNTUNED

TPS = full(jm.ThinPlateSpline(), 1)
AXIS = jm.Revolution((0, 0, 3))


def wrung(points, moving, size=0.3):
    """A twist that grows along z, and a bend that does not keep any of the surfaces."""
    p = points[moving]
    turned = np.asarray(jm.shapes.rotate(p, size * p[:, 2], np.zeros(3), [0, 0, 1]))
    return turned - p + 0.1 * size * p[:, 2:] ** 2 * [1, 1, 0]


def check_derivatives(plan, u, rtol=1e-6):
    """Forward and reverse derivatives against differences and each other."""
    rng = np.random.default_rng(0)
    v, w = rng.normal(size=u.shape), rng.normal(size=plan.points.shape)
    push = jax.jit(lambda u: jm.velocity(plan, u, v))
    for at in (u, 0 * u):
        pushed, h = np.asarray(push(jnp.asarray(at))), 1e-6
        difference = (
            np.asarray(jm.deform(plan, at + h * v)) - np.asarray(jm.deform(plan, at - h * v))
        ) / (2 * h)
        np.testing.assert_allclose(pushed, difference, rtol=0, atol=rtol * np.abs(pushed).max())
        np.testing.assert_allclose(
            np.vdot(jm.pullback(plan, at, w), v), np.vdot(w, pushed), rtol=1e-8
        )


@pytest.mark.slow
def test_a_block_in_a_box_of_sliding_sides():
    """A flat patch slides as its plane does."""
    mesh, sides = box_with_hole(), ["left", "right", "bottom", "top"]
    plan = jm.prepare(mesh, "hole", sliding=sides, method=TPS)
    assert plan.is_linear
    block, points = mesh.points[plan.moving], mesh.points
    u = np.asarray(jm.shapes.rotate(block, 0.8, about=(0, 0))) + 0.5 - block
    moved = np.asarray(jm.deform(plan, u))
    for name in sides:
        axis = 0 if name in ("left", "right") else 1
        nodes = mesh.patch(name)
        assert (moved[nodes, axis] == points[nodes, axis]).all()
        assert np.abs(moved - points)[nodes].max() > 0.1
    corners = np.flatnonzero((np.abs(points) == 4).all(axis=1))
    assert set(plan.fixed.tolist()) == set(corners)
    assert (moved[corners] == points[corners]).all()
    assert (moved[plan.moving] == block + u).all()
    held = jm.deform(jm.prepare(mesh, "hole", sides, method=TPS), u)
    assert (
        jm.quality(mesh, moved).min_jacobian_ratio
        > jm.quality(mesh, held).min_jacobian_ratio + 0.05
    )
    check_linear(plan, u)
    named = [
        jm.Slide(mesh.patch(name), jm.Plane.through(points, mesh.patch(name))) for name in sides
    ]
    again = jm.prepare(points, mesh.patch("hole"), sliding=named, method=TPS)
    assert (jm.deform(again, u) == moved).all()
    assert not jm.inspect(plan, 0.1 * u, mesh=mesh).warnings


@pytest.mark.nightly
@pytest.mark.parametrize("shape", ["cylinder", "cone", "bell"])
def test_a_shroud_between_sliding_lids(shape, tmp_path):
    """Nodes stay on the surface, on the lids, and on both at the rim; the hub's ends, which move, stay on the lids."""
    mesh = drum(shape)
    slides = [jm.Slide("shroud", AXIS), "bottom", "top"]
    plan = jm.prepare(mesh, "hub", sliding=slides, method=TPS)
    assert not plan.is_linear
    u = wrung(mesh.points, mesh.patch("hub"))
    moved = np.asarray(jm.deform(plan, u))
    z, r = moved[mesh.patch("shroud"), 2], np.linalg.norm(moved[mesh.patch("shroud"), :2], axis=1)
    knots = np.linspace(0, 1, 5)
    spline = CubicSpline(knots, 2 + 0.3 * np.sin(2 * knots), bc_type="natural")
    expected = {"cylinder": 2 + 0 * z, "cone": 2 + 0.5 * z, "bell": spline(np.clip(z, 0, 1))}[shape]
    np.testing.assert_allclose(r, expected, rtol=0, atol=1e-12)
    for name, level in (("bottom", 0), ("top", 1)):
        np.testing.assert_allclose(moved[mesh.patch(name), 2], level, rtol=0, atol=1e-13)
    assert np.abs(moved - mesh.points)[mesh.patch("shroud")].max() > 0.1
    assert (jm.deform(plan, 0 * u) == mesh.points).all()
    jm.save(tmp_path / "plan.npz", plan)
    assert (jm.deform(jm.load(tmp_path / "plan.npz"), u) == moved).all()
    check_derivatives(plan, u)


@pytest.mark.nightly
def test_the_root_of_a_wing_travels_along_its_body():
    """Nodes of wing and body stay on the body's cylinder, where its others follow; those of the wing go where `u` says."""
    mesh = faults.blade_tip(gap=0.4, layers=3)
    points, wing = np.asarray(mesh.points), mesh.patch("blade")
    is_root = np.linalg.norm(points[wing, 1:], axis=1) < 1 + 1e-9
    body = np.union1d(mesh.patch("hub"), wing[is_root])
    outer = mesh.patch("shroud", "inlet", "outlet", "left", "right")
    slide = jm.Slide(body, jm.Revolution((1, 0, 0)))
    u = np.tile([0.1, 0.05, 0.0], (len(wing), 1))
    plan = jm.prepare(mesh, wing, outer, sliding=slide)
    moved = np.asarray(jm.deform(plan, u))
    np.testing.assert_allclose(np.linalg.norm(moved[body, 1:], axis=1), 1, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        moved[wing[~is_root]], (points[wing] + u)[~is_root], rtol=0, atol=1e-15
    )
    root = points[wing[is_root]] + u[is_root]  # straight to the cylinder
    root[:, 1:] /= np.linalg.norm(root[:, 1:], axis=1, keepdims=True)
    np.testing.assert_allclose(moved[wing[is_root]], root, rtol=0, atol=1e-14)
    report = jm.quality(mesh, moved)
    assert int(report.inverted) == 0
    assert float(report.min_jacobian_ratio) > 0.6
    held = jm.deform(jm.prepare(mesh, wing, np.union1d(outer, mesh.patch("hub"))), u)
    assert int(jm.quality(mesh, held).inverted) > 0


@pytest.mark.nightly
def test_steps_along_a_shroud():
    mesh = drum()
    boundary = jm.Boundary(mesh, "hub", ("bottom", "top"), sliding=jm.Slide("shroud", AXIS))
    plan = jm.prepare(boundary, method=TPS)
    u = wrung(mesh.points, plan.moving)
    for end in check_steps(plan, np.stack([u / 2, u])):
        np.testing.assert_allclose(
            np.linalg.norm(end[mesh.patch("shroud"), :2], axis=1), 2, rtol=0, atol=1e-12
        )
    check_parts(boundary, plan, u, size=40)


def similar(points):
    """Turns, scales and shifts a base: no node has other neighbours, every wall and translation is another one."""
    return 1.3 * points @ turn(0.4, 2).T + np.array([0.3, -0.2])


@pytest.mark.nightly
def test_a_polygon_and_a_circle():
    mesh = ring(16, (1, 1.5, 2), ("inner", "outer"))
    inner = mesh.points[mesh.patch("inner")]
    u = np.asarray(jm.shapes.rotate(inner, 0.3, about=(0, 0))) + 0.1 - inner
    on_faces = jm.prepare(mesh, "inner", sliding="outer", method=TPS)
    moved = np.asarray(jm.deform(on_faces, u))
    polygon = mesh.points[mesh.patch("outer")]
    off = closest(
        np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1), moved[mesh.patch("outer")]
    )[2]
    assert off.max() < 1e-14
    assert np.abs(moved - mesh.points)[mesh.patch("outer")].max() > 0.2
    assert (jm.deform(on_faces, 0 * u) == mesh.points).all()
    check_derivatives(
        on_faces, 0.9 * u, rtol=6e-2
    )  # a kink at each node: there the mean of both sides
    on_circle = jm.prepare(mesh, "inner", sliding=jm.Slide("outer", jm.Revolution()), method=TPS)
    exact = np.asarray(jm.deform(on_circle, u))
    np.testing.assert_allclose(
        np.linalg.norm(exact[mesh.patch("outer")], axis=1), 2, rtol=0, atol=1e-13
    )
    assert np.abs(exact - moved).max() < 0.05
    other = mesh.moved(similar(mesh.points))
    refitted = jm.deform(jm.refit(on_faces, other.points), u)
    fresh = jm.deform(jm.prepare(other, "inner", sliding="outer", method=TPS), u)
    np.testing.assert_allclose(refitted, fresh, rtol=0, atol=1e-13)
    with pytest.raises(
        ValueError,
        match=r"16 of 16 nodes of sliding patches have left their surface at the new base",
    ):
        jm.refit(on_circle, other.points)


def test_sharp_edges_part_a_patch_and_the_apex_of_a_cone_stays():
    """Elsewhere a cone has one normal; a disc has one at its middle, too."""
    mesh, sides = box_with_hole(), ["left", "right", "bottom", "top"]
    around, lines = mesh.patch(*sides), outer_pieces(mesh.cells, len(mesh.points))
    parts = walls_of_patch(jm.Slide("around"), around, mesh.points, lines)
    assert {frozenset(nodes) for _, nodes in parts} == {
        frozenset(mesh.patch(name)) for name in sides
    }
    assert set(tracks_of(parts, (), np.zeros((len(mesh.points), 0), bool), mesh.points)[1]) == set(
        np.flatnonzero((np.abs(mesh.points) == 4).all(axis=1))
    )
    radius, angle = np.meshgrid(np.arange(3) / 2, np.arange(6) * np.pi / 3)
    disc = np.stack([0 * radius, radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(
        -1, 3
    )
    for height, stays in ((1, np.arange(0, 18, 3)), (0, [])):
        points = disc + height * np.linalg.norm(disc, axis=1)[:, None] * np.eye(3)[:1]
        walls = walls_of_patch(
            jm.Slide(np.arange(18), jm.Revolution((1, 0, 0))), np.arange(18), points, None
        )
        np.testing.assert_array_equal(
            tracks_of(walls, (), np.zeros((len(points), 0), bool), points)[1], stays
        )


@pytest.mark.nightly
def test_a_circle_in_single_precision_and_an_ellipse():
    mesh = ring(16, (1, 1.5, 2), ("inner", "outer"))
    outer = mesh.patch("outer")
    single = jm.Mesh(mesh.points.astype(np.float32), mesh.cells, mesh.patches)
    slide = jm.Slide("outer", jm.Revolution())
    [(wall, _)] = walls_of_patch(slide, outer, np.asarray(single.points), None)
    farther = np.array([[3.0, 0.0], [0.0, 1.0]])
    np.testing.assert_allclose(wall.height(jnp.asarray(farther))[0], [1, -1], rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="does not lie on its surface"):
        walls_of_patch(slide, outer, mesh.points * [1, 1.1], None)


@pytest.mark.nightly
def test_a_face_without_area():
    """A pyramid of quads, each of which ends in the pole: one of its triangles has no area."""
    points = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 0.5]])
    quads = np.array([[k, (k + 1) % 4, 4, 4] for k in range(4)])
    [(wall, _)] = walls_of_patch(jm.Slide("pyramid"), np.arange(5), points, {"quad": quads})
    x = jnp.array([[0.05, 0.02, 1.5], [0.6, 0.6, 0.6]])
    place = wall.nearest(x)[0]
    np.testing.assert_allclose(np.abs(place) @ np.array([1, 1, 2]), 1, rtol=0, atol=1e-12)
    assert np.isfinite(jax.grad(lambda x: wall.nearest(x)[0].sum())(x)).all()


@pytest.mark.nightly
def test_a_shroud_of_faces():
    mesh = drum("bell")
    plan = jm.prepare(mesh, "hub", sliding=["shroud", "bottom", "top"], method=TPS)
    u = wrung(mesh.points, plan.moving)
    moved = np.asarray(jm.deform(plan, u))
    for name, level in (("bottom", 0), ("top", 1)):
        np.testing.assert_allclose(moved[mesh.patch(name), 2], level, rtol=0, atol=1e-13)
    exact = jm.prepare(mesh, "hub", sliding=[jm.Slide("shroud", AXIS), "bottom", "top"], method=TPS)
    assert np.abs(moved - jm.deform(exact, u)).max() < 0.1
    assert (jm.deform(plan, 0 * u) == mesh.points).all()


@pytest.mark.nightly
def test_pairs_slide_along_walls_that_repeat_each_other():
    """A ceiling that is steeper at one end than at the other, or slides at one end alone, is no surface of both partners."""
    mesh = box_with_hole()
    x, y = np.asarray(mesh.points).T
    arched = mesh.moved(np.stack([x, y + 0.05 * np.maximum(y, 0) * (1 - (x / 4) ** 2)], axis=1))
    short = jm.Slide(mesh.patch("top")[:-1], jm.Plane((0, 1), (0, 4)))
    told = r"1 periodic pairs slide along walls that do not repeat.* node 8 at \(-4, 4\)"
    ends = jm.Periodic("left", "right")
    for case, slide in ((arched, "top"), (mesh, short)):
        with pytest.raises(ValueError, match=told):
            jm.prepare(case, "hole", "bottom", sliding=slide, periodic=ends, method=TPS)


@functools.cache
def duct():
    """The square with a hole between a floor and a ceiling that slide, and two ends that repeat each other."""
    mesh = box_with_hole(6)
    ends = [mesh.patch(name) for name in ("left", "right")]
    return mesh, ends, {"sliding": ("bottom", "top"), "periodic": jm.Periodic("left", "right")}


@pytest.mark.nightly
def test_flat_sides_follow_the_base_and_a_torn_one_is_refused():
    """Of a stretched base `refit` makes what `prepare` does; it says which node has left a side or the symmetry plane."""
    mesh, boundary = (
        box_with_hole(),
        {"sliding": ["left", "right", "top"], "symmetry": jm.Plane((0, 1), (0, -4))},
    )
    plan, other = jm.prepare(mesh, "hole", method=TPS, **boundary), mesh.moved(mesh.points * [2, 1])
    u = 0.2 * np.sin(other.points[plan.moving] + np.array([0.3, 1.0]))
    moved = np.asarray(jm.deform(jm.refit(plan, other.points), u))
    expected = jm.deform(jm.prepare(other, mesh.patch("hole"), method=TPS, **boundary), u)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-13)
    judged = jm.boundary_quality(jm.refit(plan, other.points), moved)
    assert (judged.off_plane, judged.off_surface, judged.mismatch) == (0, 0, 0)
    told = {
        "top": "nodes of sliding patches have left",
        "bottom": "nodes have left their symmetry plane",
    }
    for side, message in told.items():
        torn = np.array(other.points)
        node = mesh.patch(side)[3]
        torn[node, 1] += 0.25
        with pytest.raises(ValueError, match=rf"{message}.* the worst is node {node} ") as caught:
            jm.refit(plan, torn)
        assert caught.value.nodes[0] == node
        off = jm.boundary_quality(plan, mesh.points + (torn - other.points))
        assert (off.off_plane if side == "bottom" else off.off_surface) == 0.25
        assert f"0.25 off (node {node})" in str(off).replace(" their surface", "")


@pytest.mark.nightly
def test_walls_and_translations_follow_the_base():
    """Of another base `refit` makes what `prepare` does; pairs that match bit for bit go on to."""
    mesh, (left, right), wrapped = duct()
    corners = np.flatnonzero((np.abs(mesh.points) == 3).all(axis=1))
    plan, other = (
        jm.prepare(mesh, "hole", corners, method=TPS, **wrapped),
        mesh.moved(similar(mesh.points)),
    )
    u = 0.2 * np.sin(other.points[plan.moving] + np.array([0.3, 1.0]))
    fresh = jm.prepare(other, "hole", corners, method=TPS, **wrapped)
    expected = np.asarray(jm.deform(fresh, u))
    np.testing.assert_allclose(
        jm.deform(jm.refit(plan, other.points), u), expected, rtol=0, atol=1e-13
    )
    assert np.abs(expected - other.points)[plan.guided].max() > 1e-3
    moved = np.asarray(jm.deform(jm.refit(plan, mesh.points), u))
    np.testing.assert_allclose(moved, jm.deform(plan, u), rtol=0, atol=1e-14)
    assert (moved[right] == moved[left] + np.array([6, 0])).all()
    torn = np.array(mesh.points)
    torn[right[np.abs(torn[right, 1]) < 2], 1] *= 1.1
    with pytest.raises(
        ValueError,
        match=r"2 of 7 periodic pairs do not match after their transform at the new base",
    ):
        jm.refit(plan, torn)


@over("name", slow=["inverse-distance"], nightly=["default", "delaunay", "reduced", "laplacian"])
def test_methods_between_sliding_and_periodic_patches(name):
    """The wrappers keep the laws of the contract, whatever the method: exact or not, on cells or not, linear or not."""
    mesh, (left, right), wrapped = duct()
    points, method = mesh.points, BY_NAME[name].make(1.0)
    corners = np.flatnonzero((np.abs(points) == 3).all(axis=1))[:2]  # something holds the floor
    held = np.concatenate([corners, right[np.isin(points[right, 1], points[corners, 1])]])
    plan = jm.prepare(mesh, mesh.patch("hole"), np.unique(held), method=method, **wrapped)
    assert plan.is_linear is method.linear
    u = 0.2 * np.sin(points[plan.moving] + np.array([0.3, 1.0]))
    moved = np.asarray(jm.deform(plan, u))
    d = moved - points
    np.testing.assert_allclose(d[left], d[right], rtol=0, atol=1e-14)
    for side in ("bottom", "top"):
        assert (d[mesh.patch(side), 1] == 0).all()
    assert np.abs(d[plan.guided]).max() > 1e-3
    if method.exact:
        assert (moved[plan.moving] == points[plan.moving] + u).all()
        assert (d[plan.fixed] == 0).all()
    assert (jm.deform(plan, 0 * u) == points).all()
    check_derivatives(plan, u)


ALIKE = ("few-sources", "thin-plate-1", "notebook's basis", "multiscale-whole")
"""Cases that differ from others by their basis or their numbers alone: one of each method is enough between walls."""


@functools.cache
def quarter():
    """Eight bricks in a quarter of a ring around z, from radius 1 to 2 and z = 0 to 1; its sides repeat each other."""
    axes = np.linspace(1, 2, 3), np.pi / 4 * np.arange(3), np.linspace(0, 1, 3)
    radius, angle, z = lattice(*axes).T
    ids = np.arange(27).reshape(3, 3, 3)
    patches = {"hub": ids[0], "shroud": ids[-1], "first": ids[:, 0], "last": ids[:, -1]}
    patches |= {"low": ids[..., 0], "high": ids[..., -1]}
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    return jm.Mesh(
        points,
        {"hexahedron": blocks(ids)},
        {name: nodes.ravel() for name, nodes in patches.items()},
    )


@functools.partial(jax.jit, compiler_options=UNTUNED)  # most of the time is compilation
def tried(plan, u, w):
    return jm.deform(plan, u), jm.pullback(plan, u, w)


@functools.partial(jax.jit, compiler_options=UNTUNED)
def pushed(plan, u, v):
    return jax.jvp(lambda u: jm.deform(plan, u), (u,), (v,))[1]


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name", [name for name, dimension in NAMES if dimension == 3 and name not in ALIKE]
)
def test_methods_between_a_shroud_lids_and_periodic_sides(name, tmp_path):
    """In 3-D, whatever the method: nodes stay on the cylinder, the planes, and a quarter turn from their partner."""
    mesh, method = quarter(), BY_NAME[name].make(1.0)
    points, hub, first, last = np.asarray(mesh.points), *map(mesh.patch, ("hub", "first", "last"))
    slides = [jm.Slide("shroud", AXIS), "low", "high"]
    plan = jm.prepare(
        mesh,
        "hub",
        method=method,
        sliding=slides,
        periodic=jm.Periodic("first", "last", axis=(0, 0, 1)),
    )
    x, y, z = points[hub].T
    angle, radius = np.arctan2(y, x), 1 + 0.1 * (x**2 * y**2) * z
    turned = angle + 0.2 * z
    target = np.stack(
        [radius * np.cos(turned), radius * np.sin(turned), z + 0.1 * np.sin(np.pi * z)], axis=1
    )
    u = target - points[hub]

    def check_walls(moved, levels):
        np.testing.assert_allclose(
            np.linalg.norm(moved[mesh.patch("shroud"), :2], axis=1), 2, rtol=0, atol=1e-14
        )
        for lid, level in zip(("low", "high"), levels, strict=True):
            np.testing.assert_allclose(moved[mesh.patch(lid), 2], level, rtol=0, atol=1e-15)
        np.testing.assert_allclose(
            moved[last], moved[first] @ turn(np.pi / 2, 3).T, rtol=0, atol=1e-14
        )

    v, w = (
        np.random.default_rng(0).normal(size=u.shape),
        np.random.default_rng(1).normal(size=points.shape),
    )
    moved, nothing, h = np.asarray(tried(plan, u, w)[0]), 0 * u, 1e-5
    check_walls(moved, (0, 1))
    assert np.abs(moved - points)[plan.guided].max() > 0.01
    if method.exact:
        np.testing.assert_allclose(moved[hub], target, rtol=0, atol=1e-14)
    assert int(jm.quality(mesh, moved).inverted) == 0
    for at in (u, nothing):
        ends = [np.asarray(tried(plan, at + step * v, w)[0]) for step in (h, -h)]
        along, pulled = (ends[0] - ends[1]) / (2 * h), tried(plan, at, w)[1]
        size = np.linalg.norm(along) * np.linalg.norm(w)
        np.testing.assert_allclose(np.vdot(pulled, v), np.vdot(w, along), rtol=0, atol=1e-8 * size)
        if name == "delaunay":
            forward = np.asarray(pushed(plan, at, v))
            np.testing.assert_allclose(forward, along, rtol=0, atol=1e-7 * np.abs(forward).max())
            np.testing.assert_allclose(np.vdot(pulled, v), np.vdot(w, forward), rtol=1e-8)
    assert (tried(plan, nothing, w)[0] == points).all()
    if name == "delaunay":
        jm.save(tmp_path / "plan.npz", plan)
        assert (tried(jm.load(tmp_path / "plan.npz"), u, w)[0] == moved).all()
        stretched = points * [1, 1, 1.5]
        higher = jm.refit(plan, stretched)
        assert (tried(higher, nothing, w)[0] == stretched).all()
        check_walls(np.asarray(tried(higher, u, w)[0]), (0, 1.5))
