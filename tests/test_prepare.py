"""Calls of `prepare`: a mesh or points, names or ids, and a sentence for each first mistake."""

import functools
import re

import jax
import numpy as np
import pytest
from meshes import lattice, ring, square, unit_box
from runs import over, refusals
from scipy.spatial.transform import Rotation

import jaxmorph as jm
from jaxmorph._mesh import topology
from jaxmorph._plan import prepare


def rings():
    """A ring with the patches `body` and `far`, and `half`, the far nodes with y > 0."""
    mesh = ring(24, np.geomspace(0.5, 4, 7), ("body", "far"))
    far = mesh.patch("far")
    return jm.Mesh(
        mesh.points, mesh.cells, {**mesh.patches, "half": far[mesh.points[far, 1] > -1e-9]}
    )


SURFACES = []


class Seen(jm.DelaunayGraph):
    """Graph mapping that keeps the surface which it was connected to."""

    def connect(self, surface, points):
        SURFACES.append(surface)
        return super().connect(surface, points)


def surface_of(mesh, moving, fixed, symmetry=()):
    jm.prepare(mesh, moving, fixed, method=Seen(), symmetry=symmetry)
    return SURFACES.pop()


def test_names_and_ids_are_one_plan():
    mesh = rings()
    plan = jm.prepare(mesh, "body", ["far"], method=jm.InverseDistance())
    other = jm.prepare(mesh, mesh.patch("body"), mesh.patch("far"), method=jm.InverseDistance())
    u = np.random.default_rng(0).normal(size=(24, 2)) * 1e-2
    assert (np.asarray(plan.moving) == other.moving).all()
    np.testing.assert_allclose(jm.deform(plan, u), jm.deform(other, u), rtol=0, atol=1e-12)


def with_loose(mesh, places):
    """A mesh with nodes of no cell at `places`, the first ones of the list."""
    cells = {kind: np.asarray(corners) + len(places) for kind, corners in mesh.cells.items()}
    patches = {name: np.asarray(nodes) + len(places) for name, nodes in mesh.patches.items()}
    return jm.Mesh(np.concatenate([places, mesh.points]), cells, patches)


@over("planes", slow=["y0 y1"], nightly=["", "y0", "x0 x1 y0 y1"])
def test_nodes_of_no_cell_stay_beside_planes_in_chunks_and_in_steps(planes):
    planes, box = planes.split(), unit_box()
    fixed = [name for name in box.patches if name not in (*planes, "z0")]
    odd = with_loose(box, [[0.5, 0.0, 0.5], [0.5, -9.0, 0.5], [90.0, 1.0, 0.3]])
    u = np.random.default_rng(1).normal(size=(16, 3)) * 0.02
    u[:, :2] *= not planes
    plans = [jm.prepare(mesh, "z0", fixed, symmetry=planes) for mesh in (box, odd)]
    whole, more = (np.asarray(jm.deform(plan, u)) for plan in plans)
    np.testing.assert_allclose(more[3:], whole, rtol=0, atol=1e-12)
    assert (more[:3] == odd.points[:3]).all()
    refit = (
        np.asarray(jm.deform(jm.refit(plans[1], odd.points + 1.0), u)) if not planes else more + 1
    )
    np.testing.assert_allclose(refit, more + 1, rtol=0, atol=1e-12)
    pieces = np.array(odd.points)
    for nodes, plan in jm.prepare_in_chunks(jm.Boundary(odd, "z0", fixed, symmetry=planes), size=3):
        pieces[nodes] = jm.deform(plan, u)
    np.testing.assert_allclose(pieces, more, rtol=0, atol=1e-12)
    for rebuild in (False, True):
        ends = [np.asarray(jm.march(plan, [u / 2, u], rebuild=rebuild)[1]) for plan in plans]
        np.testing.assert_allclose(ends[1][3:], ends[0], rtol=0, atol=1e-12)
        assert (ends[1][:3] == odd.points[:3]).all()


@over("part", ["whole"], slow=["half", "layer"])
def test_a_body_in_a_free_boundary_takes_its_grid_along(part):
    mesh = ring(24, np.linspace(0.5, 1.5, 6), ("body", "overset"))
    quads, symmetry, count = np.asarray(mesh.cells["quad"]), (), len(mesh.points)
    if part == "half":  # the half above a symmetry plane
        quads = quads[(mesh.points[quads, 1] > -1e-9).all(axis=1)]
        symmetry = jm.Plane((0, 1), (0, 0))
        used, quads = np.unique(quads, return_inverse=True)
        patches = {
            name: np.flatnonzero(np.isin(used, nodes)) for name, nodes in mesh.patches.items()
        }
        mesh = jm.Mesh(mesh.points[used], {"quad": quads.reshape(-1, 4)}, patches)
    if part == "layer":  # one layer of cells between two planes
        points = np.concatenate([np.insert(mesh.points, 2, z, axis=1) for z in (0.0, 0.1)])
        patches = {
            name: np.concatenate([nodes, nodes + count]) for name, nodes in mesh.patches.items()
        }
        symmetry = [jm.Plane((0, 0, 1), (0, 0, z)) for z in (0.0, 0.1)]
        mesh = jm.Mesh(
            points, {"hexahedron": np.concatenate([quads, quads + count], axis=1)}, patches
        )
    angle = 0.0 if part == "half" else 1.0
    shift = np.array([0.3, 0.0, 0.0][: mesh.points.shape[1]])
    there = (
        mesh.points @ Rotation.from_rotvec([0, 0, angle]).as_matrix().T[: len(shift), : len(shift)]
        + shift
    )
    u = (there - mesh.points)[mesh.patch("body")]
    plan = jm.prepare(mesh, "body", free="overset", symmetry=symmetry)
    np.testing.assert_allclose(jm.deform(plan, u), there, rtol=0, atol=1e-12)
    chunks = jm.prepare_in_chunks(
        jm.Boundary(mesh, "body", free="overset", symmetry=symmetry), size=40
    )
    for nodes, piece in chunks:
        np.testing.assert_allclose(jm.deform(piece, u), there[nodes], rtol=0, atol=1e-12)


def test_a_channel_between_moving_wall_and_plane_keeps_the_default():
    mesh = square(4)
    plan = jm.prepare(mesh, "wall", symmetry=jm.Plane((0, 1), (0, 1)), free="far")
    assert isinstance(plan.method, jm.SurfaceReconstruction)


def test_boundary_faces_in_no_list_are_told():
    mesh = rings()
    with pytest.warns(UserWarning, match=r"12 of 48 boundary faces are neither .* in patch 'far'"):
        jm.prepare(mesh, "body", "half", method=jm.RBF(fixed_reduction=jm.AllPoints()))


def test_methods_see_the_faces_between_surface_nodes():
    faces = surface_of(rings(), "body", "far").faces
    assert set(faces) == {"line"}
    assert len(faces["line"]) == 48
    assert np.bincount(faces["line"].ravel()).tolist() == [2] * 48
    assert surface_of(rings().points, np.arange(24), np.arange(144, 168)).faces is None


def test_mirror_images_have_faces_too():
    """Of a brick's quarter with two planes: the moving side z = 1 becomes one closed patch of four times its faces."""
    mesh = unit_box()
    surface = surface_of(mesh, "z1", ("z0", "x1", "y1"), ("x0", "y0"))
    faces, points = surface.faces["quad"], surface.points
    moving = faces[(faces < surface.moving).all(axis=1)]
    assert len(moving) == 4 * 9
    centres = points[moving].mean(axis=1)
    expected = lattice(*[np.arange(-2.5, 3)] * 2) / 3
    np.testing.assert_allclose(
        sorted(map(tuple, centres[:, :2].round(9))), sorted(map(tuple, expected.round(9)))
    )
    assert (points[moving][..., 2] == 1).all()
    assert len(np.unique(np.sort(faces, axis=1), axis=0)) == len(faces)


def test_sources_and_offset_of_a_plan():
    mesh = unit_box(4)
    u = np.zeros((25, 3))
    u[:, 2] = 0.05 * np.cos(mesh.points[mesh.patch("z1"), 0] * 7)
    fixed = ("z0", "x1", "y1", "y0")
    plan = jm.prepare(
        mesh, "z1", fixed, method=jm.SurfaceReconstruction.published(2, 2), symmetry="x0"
    )
    assert np.isin(plan.sources, np.concatenate([plan.moving, plan.fixed])).all()
    assert len(np.unique(plan.sources)) == len(plan.sources)
    coarse = jm.prepare(mesh, "z1", fixed, method=plan.method.coarse, symmetry="x0")
    nodes = np.concatenate([plan.moving, plan.fixed])
    target = mesh.points[nodes] + np.concatenate([u, np.zeros((len(plan.fixed), 3))])
    np.testing.assert_allclose(
        plan.offset(u), target - np.asarray(jm.deform(coarse, u))[nodes], atol=1e-12
    )
    np.testing.assert_allclose(
        np.asarray(plan.offset(u))[np.isin(nodes, plan.sources)], 0, atol=1e-12
    )


def test_the_default_and_its_two_neighbours():
    mesh = rings()
    plan = jm.prepare(mesh, "body", "far")
    assert plan.method == jm.SurfaceReconstruction(jm.FittedRBF(), jm.NearWall())
    assert len(plan.surface.ids.coarse.edges) == 24  # the fit follows them
    assert plan.surface.ids.correction.turn is not None  # and first grid lines turn with the wall
    published = jm.SurfaceReconstruction.published(3, 2)
    assert isinstance(published.correction, jm.DelaunayGraph)
    assert published.coarse.reduction == jm.KDTree(3)
    assert published.coarse.fixed_reduction == jm.KDTree(2)
    classic = jm.RBF.classic(jm.WendlandC2(2.0), degree=0)
    assert classic.exact
    assert len(jm.prepare(mesh, "body", "far", method=classic).sources) == 48


MESH = rings()
ring_plan = functools.cache(lambda: jm.prepare(MESH, "body", "far"))
U = np.zeros((24, 2))


test_first_mistakes = refusals(
    (lambda: jm.prepare(MESH.points, "body", "far"), r"prepare\(mesh, \.\.\.\)"),
    (lambda: jm.prepare("mesh.su2", "body", "far"), r"prepare\(mesh, "),
    (lambda: jm.prepare(MESH, "wing", "far"), "this mesh has: 'body'"),
    (
        lambda: jax.grad(lambda x: jm.prepare(MESH.moved(x), "body", "far").points.sum())(
            MESH.points
        ),
        r"ids are found on the host: call `prepare` outside, and `refit\(plan, points\)` inside",
    ),
    (
        lambda: jm.Mesh(MESH.points, patches={"body": MESH.points[:, 0] > 0}),
        "'body' takes ids, whole numbers, not bool; for a mask use np.flatnonzero",
    ),
    (lambda: jm.prepare(MESH, MESH, "far"), "`moving` must be node ids or names"),
    (
        lambda: jm.prepare(np.asarray(MESH.points) * 1e300, MESH.patch("body"), MESH.patch("far")),
        r"168 of 168 points are too far out for float64, first node 0 at .*e\+299: volumes overflow",
    ),
    (lambda: jm.prepare(MESH, "body", "far", method="rbf"), r"method=jm\.RBF\(\)"),
    (lambda: jm.prepare(MESH, "body", "far", method=jm.RBF), r"method=RBF\(\)"),
    (lambda: jm.RBF(jm.WendlandC2), r"basis=WendlandC2\(\)"),
    (lambda: jm.RBF(reduction=64), r"reduction=jm\.KDTree\(64\)"),
    (lambda: jm.prepare(MESH, "body", "far", symmetry=(0, 1)), r"jm\.Plane\(normal=\(0, 1\)"),
    (lambda: jm.quality(MESH.points), r"quality\(mesh, points\)"),
    (
        lambda: jm.fewest_steps(MESH, ring_plan(), lambda t: t),
        r"fewest_steps\(plan, mesh, motion\)",
    ),
    (lambda: jm.compare(jm.Boundary(MESH.points, [0], [1]), U[None]), r"compare\(jm.Boundary"),
    (
        lambda: jm.compare(jm.Boundary(MESH, "body", "far"), np.full((1, 24, 2), np.nan)),
        "48 of 48 numbers of `motions` are not finite",
    ),
    (lambda: jm.compare(jm.Boundary(MESH, "body", "far"), []), r"`motions` has shape \(0,\)"),
    (
        lambda: jm.deform(ring_plan(), 0.1),
        r"`u` must be an array of real numbers \(m, d\), not 0.1. Call deform\(plan, u\)",
    ),
    (lambda: jm.Mesh(np.zeros((3, 2), bool)), "`points` must be an array of real numbers"),
    (lambda: jm.deform(MESH, U), r"deform\(plan, u\)"),
    (
        lambda: jm.shard(ring_plan(), jax.devices()[:1] * 2),
        r"`devices` has .* more than once, among 2",
    ),
)


def test_nothing_is_written_for_arrays_and_folders_that_are_none(tmp_path):
    for value, words in (
        (1j, "array 'a' holds complex128; files hold real numbers"),
        ("x", "'a' holds <U1|of .*<U1"),
    ):
        with pytest.raises(ValueError, match=words):
            jm.io.write(tmp_path / "a.vtu", MESH, point_data={"a": np.full(168, value)})
    for write, name in (
        (jm.io.write, "a.su2"),
        (lambda path, _: jm.save(path, ring_plan()), "a.npz"),
    ):
        with pytest.raises(ValueError, match=rf"no/{re.escape(name)}: there is no folder"):
            write(tmp_path / "no" / name, MESH)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_what_a_mesh_and_its_boundary_know_is_found_once(monkeypatch):
    """Outer faces once a mesh, each plane on all nodes once, the surface once; moved meshes share the topology."""
    mesh, calls = unit_box(), []

    def counted(owner, name, of_interest=lambda *_: True):
        function = getattr(owner, name)

        def counting(*arguments, **options):
            calls.append(name) if of_interest(*arguments) else None
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, counting)

    counted(topology, "owned_sides")
    counted(topology, "_seen_from_outside")
    counted(prepare, "surface_of")
    counted(jm.Plane, "height", lambda plane, points: len(points) == len(mesh.points))
    planes = ("x0", "x1", "y0", "y1")
    for method in (None, jm.RBF()):
        calls.clear()
        jm.prepare(mesh, "z1", "z0", symmetry=planes, method=method)
        assert calls.count("height") == len(planes)
        assert calls.count("surface_of") == 2  # one more for the field that guides nodes
    jm.prepare(mesh.moved(mesh.points + 1), "z1", "z0", symmetry=planes, method=jm.RBF())
    calls.clear()
    again = unit_box()
    jm.prepare(again, "z1", "z0", symmetry=planes)
    jm.quality(again)
    again.moved(again.points + 1).skin()
    assert calls.count("owned_sides") == calls.count("_seen_from_outside") == 1
