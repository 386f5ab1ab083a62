"""CAD models: wall nodes follow them, on them to round-off, and their files are targets. Closed forms, OpenCASCADE's own
distances, differences.
"""

import copy
import pathlib
import pickle
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import ball, bricks

import jaxmorph as jm
from jaxmorph import io, shapes
from jaxmorph.cli import main
from jaxmorph.extend import cad_model

cad = pytest.importorskip("OCP.BRepPrimAPI", reason="pip install 'jaxmorph[cad]'")

from cad_models import box, curtain, filleted, meshed, sphere, walled  # noqa: E402
from OCP.BRep import BRep_Builder  # noqa: E402
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex  # noqa: E402
from OCP.BRepExtrema import BRepExtrema_DistShapeShape  # noqa: E402
from OCP.BRepTools import BRepTools  # noqa: E402
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt  # noqa: E402
from OCP.IGESControl import IGESControl_Controller, IGESControl_Writer  # noqa: E402
from OCP.Interface import Interface_Static  # noqa: E402
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer  # noqa: E402
from OCP.TopoDS import TopoDS_Compound  # noqa: E402


def write_step(path, shape, unit="MM"):
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    writer.Transfer(shape, STEPControl_AsIs)
    writer.Write(str(path))
    Interface_Static.SetCVal_s("write.step.unit", "MM")


def cube(count, sizes):
    """The surface of a box in quads."""
    mesh = bricks(count)
    (faces,) = jm.boundary_faces(mesh).values()
    nodes, rows = np.unique(faces, return_inverse=True)
    return walled(np.asarray(mesh.points)[nodes] * sizes, rows.reshape(faces.shape))


def test_a_sphere_follows_its_radius_with_derivatives():
    points, faces = ball(200)
    made = shapes.CAD(sphere, [1.0], walled(points, faces), "wall")
    np.testing.assert_allclose(made([1.5]), 0.5 * points, atol=1e-12)
    np.testing.assert_allclose(made(points, [1.5]), 1.5 * points, atol=1e-12)
    np.testing.assert_allclose(made.at(points)([1.5]), 0.5 * points, atol=1e-12)
    r = jnp.array([1.2])
    np.testing.assert_allclose(jax.jacfwd(made)(r)[:, :, 0], points, atol=1e-6)
    total = jax.jit(jax.grad(lambda r: jnp.sum(made(r) ** 2)))(r)
    np.testing.assert_allclose(total, 2 * 0.2 * len(points), rtol=1e-6)
    many = jax.jit(jax.vmap(made))(jnp.linspace(0.8, 1.5, 8)[:, None])
    np.testing.assert_allclose(many[3], made([0.8 + 0.3]), atol=1e-12)
    assert many.shape == (8, len(points), 3)


def test_numbers_have_names():
    points, faces = ball(200)
    made = shapes.CAD(lambda x: sphere([x["r"]]), {"r": 1.0}, walled(points, faces), "wall")
    assert shapes.names(made.neutral()) == ["r"]
    np.testing.assert_allclose(made({"r": 1.1}), 0.1 * points, atol=1e-12)
    with pytest.raises(ValueError, match="this model takes"):
        made([1.1])


def test_a_box_follows_its_edges():
    sizes = np.array([2.0, 1.5, 1.0])
    mesh = cube(3, sizes)
    made = shapes.CAD(box, sizes, mesh, "wall")
    new = np.array([2.5, 1.2, 1.3])
    np.testing.assert_allclose(made(mesh.points, new), mesh.points / sizes * new, atol=1e-12)
    derivative = jax.jacfwd(made)(jnp.asarray(new))
    exact = np.einsum("mk,kl->mkl", mesh.points / sizes, np.eye(3))
    np.testing.assert_allclose(derivative, exact, atol=1e-6)
    assert np.bincount(made.models.wall.dimension).tolist() == [8, 24, 24]


def test_a_part_of_a_model_and_several_patches_do():
    """Nodes of two patches that share some, on four of a box's faces; any numbering; two at one place."""
    sizes = np.array([2.0, 1.5, 1.0])
    mesh = cube(3, sizes)
    faces = np.asarray(mesh.cells["quad"])
    points = np.asarray(mesh.points)
    kept = faces[(points[faces].mean(axis=1)[:, :2] < [1.9, 1.4]).all(axis=1)]
    nodes, rows = np.unique(kept, return_inverse=True)
    order = np.random.default_rng(0).permutation(len(nodes))
    rows = np.argsort(order)[rows.reshape(kept.shape)]
    points = np.concatenate([points[nodes][order], points[nodes][order][:1]])
    rows[0][rows[0] == 0] = len(nodes)
    patches = {"a": np.unique(rows[:10]), "b": np.unique(rows[10:])}
    assert np.intersect1d(*patches.values()).size
    part = jm.Mesh(points, {"quad": rows}, patches)
    made = shapes.CAD(box, sizes, part, "a", "b")
    new = np.array([2.5, 1.2, 1.3])
    x = points[part.patch("a", "b")]
    np.testing.assert_allclose(made(x, new), x / sizes * new, atol=1e-12)


def test_an_extruded_polynomial_has_its_own_derivatives():
    t, z = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 4)))
    powers = np.stack([3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t)], axis=1)

    def places(x):
        return np.stack([3 * t, powers @ x, z], axis=1)

    ids = np.arange(36).reshape(4, 9)
    corners = [ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]]
    faces = np.stack([corner.ravel() for corner in corners], axis=1)
    x = np.array([0.5, -0.2])
    made = shapes.CAD(curtain, x, walled(places(x), faces), "wall")
    other = np.array([0.7, 0.3])
    np.testing.assert_allclose(places(x) + made(other), places(other), atol=1e-12)
    derivative = jax.jacrev(lambda x: made(x)[::5])(jnp.asarray(other))
    np.testing.assert_allclose(derivative[:, 1], powers[::5], atol=1e-6)
    np.testing.assert_allclose(derivative[:, ::2], 0, atol=1e-6)


def test_faces_beside_a_fillet_are_carried_with_their_border():
    x = np.array([1.0, 0.2])
    mesh = meshed(cad_model(filleted(x)), 3)
    made = shapes.CAD(filleted, x, mesh, "wall")
    new = np.array([1.05, 0.35])
    moved = mesh.points + np.asarray(made(new))
    model = cad_model(filleted(new))
    assert model.closest(moved).distance.max() < 1e-9 * model.size
    wall = made.models.wall
    rows = np.flatnonzero(wall.dimension == 1)
    edge, along, _ = model.nearest_edges(moved[rows])
    assert model.onto_edges(edge, along, moved[rows])[1] == pytest.approx(moved[rows], abs=1e-12)
    first = jm.Facets.of(mesh, "wall")
    before, after = (np.asarray(facets.areas()) for facets in (first, first.at(moved)))
    ratio = np.sum(before * after, axis=1) / np.sum(before**2, axis=1)
    assert ratio.min() > 0.5  # the flat faces lose an eighth of their width, the fillet gains
    derivative = jax.jacfwd(made)(jnp.asarray(new))
    for number, step in enumerate(1e-4 * np.eye(2)):
        difference = (made(new + step) - made(new - step)) / 2e-4
        np.testing.assert_allclose(derivative[:, :, number], difference, atol=1e-6)


@pytest.mark.slow
def test_inner_nodes_move_beside_a_border_that_moves():
    """Without being carried they would stay where the border of the face goes over them."""
    x = np.array([1.0, 0.1])
    mesh = meshed(cad_model(filleted(x)), 4)
    made = shapes.CAD(filleted, x, mesh, "wall")
    wall = made.models.wall
    u = np.asarray(made([1.0, 0.4]))
    assert np.linalg.norm(u[wall.inner], axis=1).max() > 0.1


def test_another_topology_is_told_with_its_numbers():
    x = np.array([1.0, 0.2])
    made = shapes.CAD(filleted, x, meshed(cad_model(filleted(x)), 1), "wall")
    sharp = r"another topology at x = \(1, 0\): the model has 6 faces, not 7 and 12 edges, not 15"
    with pytest.raises(ValueError, match=sharp):
        made([1.0, 0.0])
    with pytest.raises(ValueError, match=sharp):
        jax.grad(lambda x: jnp.sum(made(x)))(jnp.array([1.0, 0.0]))
    with pytest.raises(ValueError, match=r"no model at x = \(1, 1.2\): StdFail_NotDone"):
        made([1.0, 1.2])
    with pytest.warns(UserWarning, match=sharp):
        lost = jax.jit(made)(jnp.array([1.0, 0.0]))
    assert np.isnan(lost).all()
    assert np.isfinite(made(x)).all()


def test_faces_of_another_type_or_order_are_another_topology():
    names = ("surfaces", "edges", "ends", "vertices")
    old = cad_model(box([1.0, 1.0, 1.0])).topology
    assert names == old._fields
    assert old.change(old) is None
    assert (
        old.change(old._replace(surfaces=("Cone", *old.surfaces[1:])))
        == "face 0 is a Cone, not a Plane"
    )
    assert "face 0 has edges" in old.change(old._replace(edges=old.edges[::-1]))
    assert "edge 0 joins vertices" in old.change(old._replace(ends=old.ends[::-1]))


def test_nodes_off_the_model_are_told():
    points, faces = ball(200)
    mesh = walled(points, faces)
    with pytest.raises(
        jm.MeshError,
        match=r"200 of 200 nodes are off the CAD model .* Times 1000 the nodes lie on it",
    ):
        shapes.CAD(sphere, [1000.0], mesh, "wall")
    with pytest.raises(jm.MeshError, match=r"Times 39\.3701 the nodes lie on it"):
        shapes.CAD(sphere, [1 / 0.0254], mesh, "wall")  # in inches
    away = points.copy()
    away[7] *= 1.1
    with pytest.raises(jm.MeshError, match=r"1 of 200 nodes are off .* at most by 0.1, row 7"):
        shapes.CAD(sphere, [1.0], walled(away, faces), "wall")
    assert np.isfinite(
        shapes.CAD(sphere, [1.0], walled(away, faces), "wall", tolerance=0.2)([1.1])
    ).all()


def test_what_is_no_shape_is_refused():
    points, faces = ball(200)
    mesh = walled(points, faces)
    with pytest.raises(
        ValueError, match="no model at x = \\(1\\): ValueError: a shape of OpenCASCADE"
    ):
        shapes.CAD(lambda x: 3, [1.0], mesh, "wall")
    with pytest.raises(ValueError, match="`step` must be above 0"):
        shapes.CAD(sphere, [1.0], mesh, "wall", step=0.0)
    for nonsense in (None, "a", [], [1.0, "a"], [np.nan], [1j]):
        with pytest.raises(ValueError, match="`x0`"):
            shapes.CAD(sphere, nonsense, mesh, "wall")
    for nonsense in ("a", [1.0, 2.0], np.nan, object()):
        with pytest.raises(ValueError, match="`step`"):
            shapes.CAD(sphere, [1.0], mesh, "wall", step=nonsense)
    with pytest.raises(ValueError, match="in 2-D"):
        shapes.CAD(
            sphere, [1.0], jm.Mesh(points[:, :2], {"triangle": faces}, {"wall": [0]}), "wall"
        )


class Wrapped:
    def __init__(self, x):
        self.wrapped = sphere(x)


class Workplane:
    def __init__(self, x):
        self.x = x

    def val(self):
        return Wrapped(self.x)


@pytest.mark.parametrize("build", [Wrapped, Workplane])
def test_objects_that_wrap_a_shape_are_taken(build):
    points, faces = ball(200)
    made = shapes.CAD(lambda x: build(x), [1.0], walled(points, faces), "wall")
    np.testing.assert_allclose(made([1.5]), 0.5 * points, atol=1e-12)


def primitives():
    yield sphere([1.0])
    yield filleted([1.0, 0.2])
    yield cad.BRepPrimAPI_MakeCylinder(1.0, 2.0).Shape()
    yield cad.BRepPrimAPI_MakeCone(1.0, 0.0, 2.0).Shape()
    yield cad.BRepPrimAPI_MakeTorus(1.0, 0.3).Shape()
    yield curtain([1.0, -1.0])


@pytest.mark.parametrize("number", range(6))
def test_closest_places_are_those_of_open_cascade(number):
    """With their derivatives, off seams, poles and edges, where places jump."""
    model = cad_model([*primitives()][number])
    rng = np.random.default_rng(0)
    corners = model.facets.points
    x = corners[rng.integers(0, len(corners), 60)] + 0.03 * model.size * rng.normal(size=(60, 3))
    x = np.concatenate([x, 2 * model.size * rng.normal(size=(20, 3))])
    found = model.closest(x)
    exact = []
    for place in x.tolist():
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*place)).Vertex()
        each = [BRepExtrema_DistShapeShape(vertex, face) for face in model._faces]
        exact.append(min(one.Value() for one in each if one.NbSolution()))
    np.testing.assert_allclose(found.distance, exact, atol=1e-9)
    along = rng.normal(size=x.shape)
    ends = [model.closest(x + step * along).places for step in (1e-6, -1e-6)]
    off = np.abs(np.einsum("mkd,md->mk", found.slopes, along) - (ends[0] - ends[1]) / 2e-6)
    assert np.median(off) < 1e-8
    assert np.mean(off.max(axis=1) < 1e-5) > 0.95


def test_a_model_in_another_unit_is_told(tmp_path):
    points, faces = ball(200)
    BRepTools.Write_s(sphere([1100.0]), str(tmp_path / "a.brep"))
    target = io.read_facets(tmp_path / "a.brep")
    with pytest.raises(ValueError, match=r"another unit\. Scale the CAD model by 0\.001"):
        shapes.Onto(jm.Facets(points, faces), target)
    model = target.model.scaled(0.001)
    x = 1.2 * points
    np.testing.assert_allclose(model.closest(x).places, 1.1 * points, atol=1e-9)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_copies_are_the_same_function(copied, tmp_path):
    points, faces = ball(200)
    wall = shapes.CAD(sphere, [1.0], walled(points, faces), "wall")
    x = jnp.array([1.2])
    other = copied(wall)
    np.testing.assert_array_equal(other(x), wall(x))
    np.testing.assert_array_equal(jax.jacfwd(other)(x), jax.jacfwd(wall)(x))
    BRepTools.Write_s(filleted([2.0, 0.3]), str(tmp_path / "a.brep"))
    target = io.read_facets(tmp_path / "a.brep")
    own = copied(target)
    np.testing.assert_array_equal(own.closest(points), target.closest(points))
    assert own.model.topology == target.model.topology


def test_files_keep_their_numbers(tmp_path):
    size = [1.0, 2.0, 3.0]
    for unit in ("MM", "M", "INCH"):
        shape = box(size)
        scale = {"MM": 1.0, "M": 1e-3, "INCH": 1 / 25.4}[unit]  # the kernel writes millimetres
        write_step(tmp_path / "a.step", shape, unit)
        target = io.read_facets(tmp_path / "a.step")
        np.testing.assert_allclose(
            np.ptp(target.points, axis=0), np.multiply(size, scale), rtol=1e-9
        )
        IGESControl_Controller.Init_s()
        writer = IGESControl_Writer(unit, 0)
        writer.AddShape(shape)
        writer.ComputeModel()
        writer.Write(str(tmp_path / "a.igs"))
        target = io.read_facets(tmp_path / "a.igs")
        np.testing.assert_allclose(
            np.ptp(target.points, axis=0), np.multiply(size, scale), rtol=1e-8
        )
        assert len(target.rim) == 0
        assert len(target.sharp) == 12
    BRepTools.Write_s(box(size), str(tmp_path / "a.brep"))
    np.testing.assert_allclose(np.ptp(io.read_facets(tmp_path / "a.brep").points, axis=0), size)


def test_damaged_files_are_told(tmp_path):
    for name in ("a.step", "a.iges", "a.brep"):
        (tmp_path / name).write_text("nonsense")
        with pytest.raises(ValueError, match=r"damaged|no faces|not a CAD model"):
            io.read_facets(tmp_path / name)
    write_step(tmp_path / "b.step", box([1.0, 1.0, 1.0]))
    with pytest.raises(ValueError, match="surfaces in 3-D"):
        io.read_facets(tmp_path / "b.step", 2)


def test_edges_are_those_at_which_faces_turn(tmp_path):
    write_step(tmp_path / "a.step", filleted([1.0, 0.2]))
    target = io.read_facets(tmp_path / "a.step")
    ends = np.asarray(target.points)[np.asarray(target.sharp)]
    middle = ends.mean(axis=1)
    on = np.isclose(np.asarray(target.points), 0).sum(axis=1)
    assert len(on) == len(target.points)
    # two smooth seams of the fillet are none, its two arcs are
    seam = (np.abs(middle[:, 0] - 0.2) < 1e-9) & (np.abs(middle[:, 1]) < 1e-9)
    assert not (seam & (np.abs(middle[:, 2] - 0.5) < 0.4)).any()
    assert target.model.is_sharp.sum() == 13


def test_distances_from_a_compound_are_exact_and_traced(tmp_path):
    both = TopoDS_Compound()
    builder = BRep_Builder()
    builder.MakeCompound(both)
    builder.Add(both, sphere([1.0]))
    axes = gp_Ax2(gp_Pnt(5.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0))
    builder.Add(both, cad.BRepPrimAPI_MakeCylinder(axes, 1.0, 2.0).Shape())
    write_step(tmp_path / "a.step", both)
    target = io.read_facets(tmp_path / "a.step")
    x = jnp.array([[2.0, 0.3, 0.1], [5.5, 0.2, 1.1], [4.0, 3.0, 1.0]])
    exact = [
        np.linalg.norm(x[0]) - 1,
        1 - np.hypot(0.5, 0.2),
        np.hypot(1.0, 3.0) - 1,
    ]
    np.testing.assert_allclose(target.distance(x), exact, atol=1e-12)
    slope = jax.jit(jax.jacfwd(target.closest))(x)[0, :, 0]
    unit = x[0] / jnp.linalg.norm(x[0])
    np.testing.assert_allclose(
        slope, (np.eye(3) - np.outer(unit, unit)) / np.linalg.norm(x[0]), atol=1e-9
    )
    assert target.at(target.points).model is None


def tube(count, rows, heights):
    """A cylinder of radius 1 in quads, with two rings and a middle on top."""
    angle = np.arange(count) * 2 * np.pi / count
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    levels = [ring + np.array([0, 0, z]) for z in np.linspace(*heights, rows + 1)]
    levels += [ring * [share, share, 1] + [0, 0, heights[1]] for share in (0.66, 0.33)]
    k = np.arange(count)
    quads = [
        np.stack([k, np.roll(k, -1), np.roll(k, -1) + count, k + count], axis=1) + level * count
        for level in range(len(levels) - 1)
    ]
    return jm.Facets(np.concatenate(levels), np.concatenate(quads))


@pytest.mark.slow
def test_a_wall_goes_onto_a_step_file_with_its_edges(tmp_path):
    axes = gp_Ax2(gp_Pnt(0.0, 0.0, -1.2), gp_Dir(0.0, 0.0, 1.0))
    write_step(tmp_path / "a.step", cad.BRepPrimAPI_MakeCylinder(axes, 1.1, 2.4).Shape())
    target = io.read_facets(tmp_path / "a.step")
    wall = tube(16, 3, (0.0, 1.0))
    u = shapes.onto(wall, target, symmetry=jm.Plane([0.0, 0.0, 1.0], np.zeros(3)))
    moved = np.asarray(wall.points + u)
    assert target.model.closest(moved).distance.max() < 1e-9
    np.testing.assert_allclose(moved[:16, 2], 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(moved[:64, :2], axis=1), 1.1, atol=1e-9)
    np.testing.assert_allclose(moved[48:64, 2], 1.2, atol=1e-9)


@pytest.mark.slow
def test_one_core_builds_models_from_traced_code():
    code = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from cad_models import filleted, meshed
from jaxmorph import shapes
from jaxmorph.extend import cad_model
made = shapes.CAD(filleted, [1.0, 0.2], meshed(cad_model(filleted([1.0, 0.2])), 3), "wall")
slope = jax.jit(jax.value_and_grad(lambda x, zeros: jnp.sum(made(x + zeros[:2]) ** 2)))
for step in range(4):
    late = jnp.asarray(np.zeros(20001)[1:])
    assert jnp.isfinite(slope(jnp.array([1.0, 0.2 + 0.01 * step]), late)[1]).all()
"""
    folder = pathlib.Path(__file__).parent
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300, cwd=folder)


@pytest.mark.slow
def test_processes_build_the_models_of_derivatives():
    sizes = np.array([2.0, 1.5, 1.0])
    mesh = cube(2, sizes)
    made = shapes.CAD(box, sizes, mesh, "wall", processes=2)
    exact = np.einsum("mk,kl->mkl", mesh.points / sizes, np.eye(3))
    np.testing.assert_allclose(jax.jacfwd(made)(jnp.asarray(sizes)), exact, atol=1e-6)
    assert pickle.dumps(made.models.wall)
    inner = shapes.CAD(lambda x: box(x), sizes, mesh, "wall", processes=2)
    with pytest.warns(UserWarning, match="does not run in other processes"):
        assert np.isnan(jax.jacfwd(inner)(jnp.asarray(sizes))).all()


@pytest.mark.slow
def test_the_command_line_takes_a_step_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = bricks(3)
    (outer,) = jm.boundary_faces(mesh).values()
    rest = np.setdiff1d(outer, mesh.patch("floor"))
    mesh = jm.Mesh(mesh.points, mesh.cells, {"floor": mesh.patch("floor"), "rest": rest})
    io.write("a.msh", mesh)
    floor = np.asarray(mesh.points)[mesh.patch("floor")]
    write_step(
        "a.step",
        cad.BRepPrimAPI_MakeBox(
            gp_Pnt(-1.0, -1.0, -1.0), gp_Pnt(2.0, 2.0, floor[0, 2] - 0.05)
        ).Shape(),
    )
    code = main(
        ["deform", "a.msh", "b.msh", "--moving", "floor", "--free", "rest", "--onto", "a.step"]
    )
    assert code == 0, capsys.readouterr()
    moved = io.read("b.msh")
    np.testing.assert_allclose(
        np.asarray(moved.points)[mesh.patch("floor"), 2], floor[:, 2] - 0.05, atol=1e-9
    )
