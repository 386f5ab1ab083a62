"""New cells in the place of worn ones: what stays, what is carried over, and motions that go on."""

import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import circle, gmsh_session, renumbered, turn
from relays import around_sphere, layered, travel
from scipy.spatial import KDTree

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import cases, io, shapes
from jaxmorph.cli import main

pytest.importorskip("gmsh")


@functools.cache
def passing() -> tuple[jm.Mesh, jm.Plan, np.ndarray]:
    """Two bodies in a mesh of quads, and points that the upper one's motion has worn."""
    mesh = cases.bodies(
        {"upper": (-2.0, -1.0, 0.5, 1.5), "lower": (-0.5, 0.5, -1.5, -0.5)},
        box=(-4.0, 4.0, -3.0, 3.0),
    )
    plan = jm.prepare(mesh, "upper", ("lower", "farfield"))
    return mesh, plan, np.asarray(jm.deform(plan, np.tile([1.2, 0.0], (plan.n_moving, 1))))


@functools.cache
def dented(kind: str) -> tuple[jm.Mesh, np.ndarray]:
    """Bricks of a kind, and points that a sine has worn inside."""
    mesh = cases.bricks(kind, cells=5)
    x = np.asarray(mesh.points)
    low, high = x.min(axis=0), x.max(axis=0)
    share = (x - low) / (high - low)
    bump = np.prod(np.sin(np.pi * share), axis=1)
    return mesh, x + 0.26 * (high - low) * bump[:, None]


def made(name: str) -> tuple[jm.Mesh, np.ndarray, jm.Remeshed]:
    if name == "plane":
        mesh, _, points = passing()
        return mesh, points, jm.remesh(mesh, points, target=0.45)
    mesh, points = dented(name)
    return mesh, points, jm.remesh(mesh, points, target=0.4)


made = functools.cache(made)
NAMES = ("plane", "hexahedron", "tetra", "wedge")


def faces_of(mesh: jm.Mesh, of_old: np.ndarray | None = None) -> set[tuple[int, ...]]:
    outer = [ids for ids, _ in mesh.topology.outer().values()]
    return {
        tuple(sorted(face))
        for ids in outer
        for face in (ids if of_old is None else of_old[ids]).tolist()
    }


def volumes(mesh: jm.Mesh) -> np.ndarray:
    return np.abs(np.asarray(jm.quality(mesh).volume))


@pytest.mark.parametrize("name", NAMES)
def test_all_but_worn_cells_stay(name):
    mesh, points, new = made(name)
    assert 0 < new.replaced < 1
    stay = new.of_old >= 0
    np.testing.assert_array_equal(new.mesh.points[new.of_old[stay]], points[stay])
    assert (np.diff(new.of_old[stay]) == 1).all()
    cells = [ids for kind in mesh.cells for ids in np.asarray(mesh.cells[kind])]
    after = [ids for kind in new.mesh.cells for ids in np.asarray(new.mesh.cells[kind])]
    for number, ids in zip(new.cells_of_old, cells, strict=True):
        if number >= 0:
            np.testing.assert_array_equal(after[number], new.of_old[ids])
    assert faces_of(new.mesh) == faces_of(mesh, new.of_old)
    for patch, nodes in mesh.patches.items():
        np.testing.assert_array_equal(new.mesh.patches[patch], new.of_old[np.asarray(nodes)])
    assert jm.quality(new.mesh).inverted == 0
    assert volumes(new.mesh).sum() == pytest.approx(volumes(mesh.moved(points)).sum(), rel=1e-13)


def test_pyramids_stand_on_quads_that_tetrahedra_meet():
    _, _, new = made("hexahedron")
    assert {"hexahedron", "pyramid", "tetra"} == {*new.mesh.cells}
    assert jm.quality(new.mesh).min_jacobian > 0


@pytest.mark.parametrize("name", NAMES)
def test_linear_fields_are_carried_over_exactly(name):
    mesh, points, new = made(name)
    d = points.shape[1]
    slope = np.random.default_rng(0).normal(size=(d, 2))
    for values in (points, 1 + points @ slope, np.ones(len(points))):
        expected = np.asarray(new.mesh.points) if values is points else values
        if values is not points:
            expected = (
                1 + new.mesh.points @ slope if values.ndim == 2 else np.ones(len(new.mesh.points))
            )
        np.testing.assert_allclose(new.transfer(values), expected, rtol=0, atol=1e-13)
    values = np.random.default_rng(1).normal(size=len(points))
    stay = new.of_old >= 0
    np.testing.assert_array_equal(new.transfer(values)[new.of_old[stay]], values[stay])
    before = np.asarray(jm.quality(mesh.moved(points)).centroid)
    after = np.asarray(jm.quality(new.mesh).centroid)
    np.testing.assert_allclose(new.transfer_cells(before), after, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_means_over_cells_keep_their_integral(name):
    mesh, points, new = made(name)
    before = volumes(mesh.moved(points))
    after = volumes(new.mesh)
    ones = new.transfer_cells(np.ones(len(before)), conservative=True)
    np.testing.assert_allclose(ones, 1, rtol=0, atol=1e-13)
    values = np.random.default_rng(2).normal(size=len(before))
    carried = np.asarray(new.transfer_cells(values, conservative=True))
    assert after @ carried == pytest.approx(before @ values, abs=1e-13 * before.sum())


@pytest.mark.parametrize("conservative", [None, False, True])
def test_transfers_have_transposes(conservative):
    _, points, new = made("plane")
    count = len(points) if conservative is None else len(new.cells_of_old)

    def carried(values):
        if conservative is None:
            return new.transfer(values)
        return new.transfer_cells(values, conservative=conservative)

    rng = np.random.default_rng(3)
    values = rng.normal(size=(count, 3))
    after, back = jax.vjp(jax.jit(carried), jnp.asarray(values))
    cotangent = rng.normal(size=after.shape)
    (pulled,) = back(jnp.asarray(cotangent))
    np.testing.assert_allclose(np.vdot(after, cotangent), np.vdot(values, pulled), rtol=1e-12)


def test_a_mesh_with_nothing_to_cure_is_returned():
    mesh, _, points = passing()
    same = jm.remesh(mesh, mesh.points)
    assert same.mesh is mesh
    moved = jm.remesh(mesh, 0.5 * (points + mesh.points), target=0.01)
    np.testing.assert_array_equal(moved.mesh.points, 0.5 * (points + mesh.points))
    assert moved.replaced == 0
    np.testing.assert_array_equal(moved.mesh.cells["quad"], mesh.cells["quad"])
    np.testing.assert_array_equal(moved.transfer(points), points)
    values = np.arange(len(moved.cells_of_old), dtype=float)
    for conservative in (False, True):
        np.testing.assert_array_equal(
            moved.transfer_cells(values, conservative=conservative), values
        )


def test_nodes_to_keep_stay():
    mesh, _, points = passing()
    inner = np.flatnonzero(made("plane")[2].of_old < 0)
    new = jm.remesh(mesh, points, target=0.45, keep=inner[:5])
    assert (new.of_old[inner[:5]] >= 0).all()
    with pytest.raises(ValueError, match="belong to layers at walls"):
        jm.remesh(mesh, points, target=0.45, keep=np.arange(len(points)))


def test_another_numbering_has_the_same_region():
    mesh, points, new = made("plane")
    other, order = renumbered(mesh, 3)
    again = jm.remesh(other, points[order], target=0.45)
    np.testing.assert_array_equal(again.of_old < 0, (new.of_old < 0)[order])
    assert jm.quality(again.mesh).inverted == 0


def test_single_precision_and_small_units():
    mesh, points, new = made("plane")
    small = jm.Mesh((1e-6 * mesh.points).astype(np.float32), mesh.cells, mesh.patches)
    again = jm.remesh(small, (1e-6 * points).astype(np.float32), target=0.45)
    assert again.mesh.points.dtype == np.float32
    assert jm.quality(again.mesh).inverted == 0
    np.testing.assert_array_equal(again.of_old < 0, new.of_old < 0)


def test_what_cannot_be_remeshed_is_refused():
    mesh, _, points = passing()
    with pytest.raises(ValueError, match="curved cells"):
        jm.remesh(jm.elevate(mesh, 2), jm.elevate(mesh, 2).points)
    with pytest.raises(ValueError, match="no cells"):
        jm.remesh(jm.Mesh(mesh.points), points)
    with pytest.raises(ValueError, match="values"):
        made("plane")[2].transfer(np.ones(3))


def test_gmsh_is_named_where_it_is_missing(monkeypatch):
    mesh, _, points = passing()
    monkeypatch.setitem(sys.modules, "gmsh", None)
    monkeypatch.delitem(sys.modules, "jaxmorph._advice.fill", raising=False)
    with pytest.raises(ImportError, match=r"gmsh.*jaxmorph\[remesh\]"):
        jm.remesh(mesh, points, target=0.45)


def test_a_session_of_gmsh_goes_on():
    mesh, _, points = passing()
    with gmsh_session() as gmsh:
        gmsh.model.add("mine")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 3)
        jm.remesh(mesh, points, target=0.45)
        assert gmsh.model.getCurrent() == "mine"
        assert gmsh.option.getNumber("Mesh.MeshSizeMax") == 3
        assert gmsh.view.getTags().size == 0


@pytest.mark.slow
def test_a_relay_goes_on_where_one_plan_ends(tmp_path):
    mesh, plan, _ = passing()
    u = np.tile([3.0, 0.0], (plan.n_moving, 1))
    assert jm.quality(mesh, jm.deform(plan, u)).inverted > 0
    relay = jm.Relay(plan, mesh)
    history = shapes.History(tmp_path / "way.jsonl")
    for share in np.linspace(0, 1, 11)[1:]:
        relay = relay.moved(share * u)
        history.add([share], 0.0, measures=relay.measures)
    assert relay.count == history.column("hand_overs")[-1] > 0
    assert jm.quality(relay.mesh.moved(relay.points)).inverted == 0
    wall = np.asarray(relay.plan.moving)
    np.testing.assert_allclose(
        relay.points[wall], np.asarray(mesh.points)[plan.moving] + u, atol=1e-13
    )
    np.testing.assert_array_equal(wall, relay.mesh.patch("upper"))
    # one mesh: exact derivatives, and constraints of an optimiser
    direction = np.random.default_rng(4).normal(size=u.shape)
    _, slope = jax.jvp(relay.points_at, (jnp.asarray(u),), (jnp.asarray(direction),))
    ends = [np.asarray(relay.points_at(u + step * direction)) for step in (1e-3, -1e-3)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-3, atol=1e-8)
    guard = shapes.MeshGuard(relay.design(lambda share: share[0] * u, min_jacobian_ratio=0.1))
    assert guard.smallest(np.ones(1)) == pytest.approx(relay.measures["jacobian_ratio"])


ROUND = [
    ("channel", (-3.5, 23.5, -4.0, 4.0), [1.0, 1.0], 0.8, 96, 11),
    ("ellipse", (-5.0, 5.0, -5.0, 5.0), [2.0, 1.0], 0.9, 96, 11),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "sides", "axes", "spacing", "count", "layers"), ROUND)
def test_a_body_crosses_a_channel_and_an_ellipse_turns(name, sides, axes, spacing, count, layers):
    """20 diameters in 40 moves; 360 degrees in a box without sliding: layers stay as they are."""
    mesh = layered(0.5 * circle(count) * axes, sides, spacing, layers)
    moving = jm.wall_layers(mesh, "body")
    x = np.asarray(mesh.points)[moving]
    shares = np.arange(1, 41) / 40
    if name == "channel":
        path = [np.tile([20 * share, 0.0], (len(x), 1)) for share in shares]
    else:
        path = [x @ turn(2 * np.pi * share, 2).T - x for share in shares]
    plan = jm.prepare(mesh, moving, "box")
    way = travel(jm.Relay(plan, mesh), mesh.patch("body"), path)
    assert way.inverted == 0
    assert way.heights == pytest.approx((1, 1), abs=1e-9)
    assert way.state.count <= 8
    assert way.gaps.min() >= 4
    assert 0 < max(way.replaced) < 0.3


@pytest.mark.slow
def test_a_valve_that_opens_is_refused_in_one_sentence():
    """From 0.5 % of its lift: the cells that break are layers, which stay."""
    mesh = faults.valve(lift=0.0005, layers=3)
    plan = jm.prepare(
        mesh, "valve", ("seat", "inlet", "outlet", "top"), symmetry="middle", method=jm.RBF()
    )
    path = [np.tile([0.0, 0.01 * k], (plan.n_moving, 1)) for k in range(1, 11)]
    with pytest.raises(ValueError, match=r"^all \d+ worn cells belong to layers at walls[^.]*\.$"):
        travel(jm.Relay(plan, mesh), mesh.patch("valve"), path)


@pytest.mark.nightly
def test_a_sphere_crosses_a_channel():
    mesh = around_sphere(120, ((-3.6, 23.4), (-3.6, 3.6), (-3.6, 3.6)), 1.2)
    moving = jm.wall_layers(mesh, "body")
    plan = jm.prepare(mesh, moving, "box")
    path = [np.tile([0.5 * k, 0.0, 0.0], (len(moving), 1)) for k in range(1, 41)]
    way = travel(jm.Relay(plan, mesh), mesh.patch("body"), path)
    assert way.inverted == 0
    assert way.heights == pytest.approx((1, 1), abs=1e-9)
    assert way.state.count <= 9
    assert max(way.replaced) < 0.45


@pytest.mark.slow
def test_the_command_line_remeshes_where_steps_do_not_cure(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    io.write("bodies.su2", passing()[0])
    motion = ["--moving", "upper", "--translate", "3", "0", "--fixed", "lower", "farfield"]
    assert main(["deform", "bodies.su2", "plain.su2", *motion, "--no-dry-run"]) == 1
    assert main(["deform", "bodies.su2", "new.su2", *motion, "--remesh"]) == 0
    assert "remeshed" in capsys.readouterr().out
    new = io.read("new.su2")
    assert jm.quality(new).inverted == 0
    assert {*new.patches} == {"upper", "lower", "farfield"}
    small = [*motion[:3], "0.1", *motion[4:]]
    assert main(["deform", "bodies.su2", "small.su2", *small, "--remesh"]) == 0
    assert {*io.read("small.su2").cells} == {"quad"}
    assert main(["deform", "bodies.su2", "new.e", *motion, "--remesh"]) == 2


@pytest.mark.slow
def test_layers_go_along_on_the_command_line(tmp_path, monkeypatch, capsys):
    """With motions that keep their shape; else they follow, and it says so."""
    monkeypatch.chdir(tmp_path)
    mesh = layered(0.5 * circle(48), (-3.5, 11.5, -3.0, 3.0), 1.0, 6)
    io.write("a.cgns", mesh)
    nodes = jm.wall_layers(mesh, "body")
    x = np.asarray(mesh.points)[nodes]
    motion = ["--moving", "body", "--fixed", "box", "--translate", "8", "0", "--rotate", "30"]
    gate = ["--min-jacobian-ratio", "0.2", "--no-dry-run"]
    words = ["deform", "a.cgns", "b.cgns", *motion, "--remesh", *gate]
    assert main([*words, "--steps", "16"]) == 0
    said = capsys.readouterr().out
    assert f"{len(nodes) - 48} nodes of layers go along" in said
    assert "of 16" in said
    new = io.read("b.cgns")
    assert jm.quality(new).inverted == 0
    wanted = x @ turn(np.pi / 6, 2).T + [8, 0]
    away, _ = KDTree(np.asarray(new.points)).query(wanted)
    assert away.max() < 1e-12
    assert main([*words, "--scale", "1.01"]) == 0
    assert "layers   follow as other cells do: --scale" in capsys.readouterr().out
