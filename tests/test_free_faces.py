"""Boundary faces that no list names: found, counted as the file has them, refused by the command line, declared free."""

import json
import warnings

import foam
import numpy as np
import pytest
from foam import HEXAHEDRON, PATCHES, mixed, split
from meshes import grid, sides, unit_box

import jaxmorph as jm
from benchmarks import faults
from jaxmorph import io
from jaxmorph._kernels.compile import quickly_compiled
from jaxmorph.cli import main

CHANNEL = ("--moving", "inner", "--fixed", "outer", "inlet", "outlet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A channel whose four patches touch, with a bump for its inner wall, and the same without the name of one patch."""
    folder = tmp_path_factory.mktemp("free")
    mesh = faults.channel(columns=12, rows=8, first_cell=1e-3)
    io.write(folder / "channel.su2", mesh)
    nameless = {name: nodes for name, nodes in mesh.patches.items() if name != "outlet"}
    io.write(folder / "nameless.vtu", jm.Mesh(mesh.points, mesh.cells, nameless))
    inner = mesh.patch("inner")
    lines = [f"{k} {dx!r} {dy!r}\n" for k, (dx, dy) in zip(inner, bump(mesh).tolist(), strict=True)]
    (folder / "bump.dat").write_text("".join(lines))
    return folder


def deform(file, *words):
    motion = ["--displacement", "bump.dat", "--displacement-is", "displacement"]
    return main(["deform", file, f"out.{file[-3:]}", *motion, *words])


def bump(mesh):
    x = np.asarray(mesh.points)[mesh.patch("inner"), 0]
    return np.stack([0 * x, 0.05 * np.sin(np.pi * x) ** 2], axis=1)


@pytest.mark.nightly
def test_the_command_line_prepares_the_mesh_as_python_does(here):
    """Walls that touch are told apart by their faces: without them the result is another one."""
    mesh = io.read("channel.su2")
    names = ("inner", ("outer", "inlet", "outlet"))
    with quickly_compiled():  # as the command line compiles for a small mesh: rounding is the same
        ids = (mesh.patch(*np.atleast_1d(name)) for name in names)
        plan, blind = jm.prepare(mesh, *names), jm.prepare(mesh.points, *ids)
        expected, other = (np.asarray(jm.deform(each, bump(mesh))) for each in (plan, blind))
    assert np.abs(expected - other).max() > 1e-6
    assert deform("channel.su2", *CHANNEL) == 0
    np.testing.assert_allclose(io.read("out.su2").points, expected, rtol=0, atol=1e-15)
    assert deform("channel.su2", *CHANNEL, "--chunk", "30") == 0
    np.testing.assert_allclose(io.read("out.su2").points, expected, rtol=0, atol=1e-14)


def test_a_patch_that_is_not_named_is_an_error_unless_it_is_free(here, capsys):
    flags = ("--moving", "inner", "--fixed", "outer", "--method", "inverse-distance")
    assert deform("channel.su2", *flags) == 2
    error = capsys.readouterr().err
    assert "16 of 40 boundary faces are neither moving" in error
    assert "in patches 'inlet' (8), 'outlet' (8)" in error
    assert "or by --free" in error
    assert len(error.splitlines()) == 1
    assert deform("channel.su2", *flags, "--free", "inlet") == 2
    said = "8 of 40 boundary faces are neither moving, fixed nor on a symmetry plane, in patch 'outlet' (8)"
    assert said in capsys.readouterr().err
    assert (
        deform(
            "channel.su2", *flags, "--free", "inlet", "--free", "out.*", "--save-job", "job.toml"
        )
        == 0
    )
    assert capsys.readouterr().err == ""
    mesh, first = io.read("channel.su2"), np.asarray(io.read("out.su2").points)
    plan = jm.prepare(mesh, "inner", "outer", free=["inlet", "outlet"], method=jm.InverseDistance())
    np.testing.assert_allclose(first, jm.deform(plan, bump(mesh)), rtol=0, atol=1e-15)
    assert 'free = ["inlet", "out.*"]' in (here / "job.toml").read_text()
    assert main(["deform", "--job", "job.toml"]) == 0
    np.testing.assert_array_equal(io.read("out.su2").points, first)
    assert (
        deform("channel.su2", *flags, "--fixed", "inlet", "--free", "outlet") == 0
    )  # beside the first --fixed
    assert deform("channel.su2", *flags, "--free", "side") == 2
    assert "no patch is called 'side'" in capsys.readouterr().err


@pytest.mark.slow
def test_modes_and_sensitivity_refuse_it_too(here, capsys):
    flags = ["--moving", "inner", "--fixed", "outer", "inlet"]
    assert main(["modes", "channel.su2", "all.su2", *flags, "--mode", "bump.dat"]) == 2
    mesh = io.read("channel.su2")
    np.savez("slope.npz", ids=np.arange(len(mesh.points)), sensitivity=np.ones_like(mesh.points))
    assert main(["sensitivity", "channel.su2", "slope.npz", "wall.csv", *flags]) == 2
    assert capsys.readouterr().err.count("in patch 'outlet' (8)") == 2
    assert (
        main(["sensitivity", "channel.su2", "slope.npz", "wall.csv", *flags, "--free", "outlet"])
        == 0
    )


@pytest.mark.filterwarnings("default:.*boundary faces")
def test_faces_that_have_no_name_are_warned_of(here, capsys):
    """Nobody can name them on the command line."""
    flags = ["--moving", "inner", "--fixed", "outer", "inlet", "--method", "inverse-distance"]
    assert deform("nameless.vtu", *flags, "--json") == 0
    (warning,) = json.loads(capsys.readouterr().out)["warnings"]
    assert "8 of 40 boundary faces are neither moving" in warning
    assert "8 of them in no patch" in warning


def test_free_patches_are_not_warned_of_in_python():
    mesh = unit_box()
    names = [name for name in mesh.patches if name not in ("z0", "z1")]
    with pytest.warns(UserWarning, match=r"36 of 54 boundary faces .* 'x0' \(9\)") as caught:
        plan = jm.prepare(mesh, "z1", "z0")
    with (
        pytest.raises(ValueError, match="`motions`"),
        pytest.warns(UserWarning, match="boundary faces") as chosen,
    ):
        jm.compare(jm.Boundary(mesh, "z1", "z0"), np.ones((1, 3)))
    assert {each.filename for each in (*caught, *chosen)} == {__file__}  # the caller's line
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        free = jm.prepare(mesh, "z1", "z0", free=names)
    np.testing.assert_array_equal(free.sources, plan.sources)
    plane = jm.Plane.through(np.asarray(mesh.points), mesh.patch("x0"))
    assert left_of(mesh, "z1", ("z0", "x1", "y0", "y1"), plane).count == 0


def left_of(mesh, moving, fixed, symmetry=()):
    """The faces that no list names."""
    left = jm.Boundary(mesh, moving, fixed, symmetry=symmetry).left
    assert left is not None
    return left


@pytest.mark.parametrize("layers", [1, 2])
def test_a_slab_has_the_free_faces_of_its_plane_mesh(layers):
    """Nodes of a patch that no list names stand in planes or in pairs, but leave the patch along them."""
    steps = np.linspace(0, 1, 5)
    slab = grid(steps, steps, np.linspace(0, 0.3, layers + 1))
    points = np.asarray(slab.points)
    slab = jm.Mesh(
        points, slab.cells, sides(points) | {"roof": np.flatnonzero(points[:, 2] > 0.29)}
    )
    flat = grid(steps, steps)
    flat = jm.Mesh(flat.points, flat.cells, sides(np.asarray(flat.points)))
    pair = jm.Periodic("z0", "roof")
    for fixed in ("x1", ("x1", "y0"), ("x1", "y0", "y1")):
        expected = left_of(flat, "x0", fixed)
        for between in ({"symmetry": ("z0", "roof")}, {"periodic": pair}):
            left = jm.Boundary(slab, "x0", fixed, **between).left
            assert left is not None
            assert left.patches == {name: layers * n for name, n in expected.patches.items()}
        across = {"periodic": pair, "symmetry": ("y0", "y1")}
        left = jm.Boundary(slab, "x0", "x1", **across).left
        assert not left


@pytest.mark.parametrize("shape", [mixed, split])
def test_faces_of_polyhedra_are_those_of_the_file(tmp_path, shape):
    """Whole cells beside pieces of polyhedra share no face with them, and a polygon counts once."""
    points, cells = shape()
    foam.write_case(tmp_path / "case", points, cells, PATCHES)
    mesh = io.read(tmp_path / "case")
    inner, sides = len(foam.polyhedral(cells)[1]), sum(map(len, cells))
    left = left_of(mesh, [0], ())
    assert left.total == left.count == sides - 2 * inner
    on_floor = sum(max(face) < 4 for faces in cells for face in faces)
    assert left.patches["floor"] >= on_floor
    assert left_of(mesh, "floor", "rest").count == 0


def test_front_and_back_of_a_2d_case_are_no_boundary(tmp_path):
    points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1, 2) for x in (0, 1, 2)], float)
    corners = np.array([0, 1, 4, 3, 9, 10, 13, 12])
    cells = [
        [(corners + first)[list(face)].tolist() for face in HEXAHEDRON] for first in (0, 1, 3, 4)
    ]
    sides = [
        ("planes", "empty", lambda face: np.ptp(points[face, 2]) == 0),
        ("floor", "wall", lambda face: not points[face, 1].any()),
        ("rest", "patch", lambda face: True),
    ]
    foam.write_case(tmp_path / "case", points, cells, sides)
    mesh = io.read(tmp_path / "case")
    assert mesh.points.shape == (9, 2)
    assert left_of(mesh, "floor", "rest").count == 0
    left = left_of(mesh, "floor", [])
    assert (left.count, left.total, left.patches) == (6, 8, {"rest": 6})


def test_a_surface_in_3d_has_no_boundary_faces():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], float)
    mesh = jm.Mesh(points, {"triangle": [[0, 1, 2], [1, 3, 2]]})
    assert jm.Boundary(mesh, [0], [3]).left is None


def test_a_part_knows_what_the_whole_knows():
    """Faces off the surface are in no part, but a method that treats free sides otherwise sees that there are some."""
    mesh = unit_box()
    for fixed in ("z0", ("z0", "x0", "x1", "y0", "y1")):
        named = jm.Boundary(mesh, "z1", fixed)
        part = named.part(np.unique(named.nodes))
        assert part.is_open == named.is_open == (fixed == "z0")
        faces, whole = part.surface_faces, named.surface_faces
        assert faces is not None
        assert whole is not None
        np.testing.assert_array_equal(faces["quad"], whole["quad"])


def test_a_surface_alone_has_each_node_once():
    points = np.random.default_rng(0).normal(size=(6, 2))
    alone = jm.Boundary(points, [4, 1], [2]).alone()
    np.testing.assert_array_equal(alone.nodes, [0, 1, 2])
    np.testing.assert_array_equal(alone.points, points[[4, 1, 2]])
