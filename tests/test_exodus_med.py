"""Exodus files in all forms of netCDF, whose judge is VTK with Exodus's own library; MED files of gmsh and meshio."""

import exodus
import meshio
import numpy as np
import pytest
from exodus import CELLS, FORMS, of_vtk, solid
from foam import mixed
from formats import rewritten, written
from meshes import bricks, gmsh_session
from plot3d import box
from plot3d import write as write_plot3d
from runs import runs

import jaxmorph as jm
from jaxmorph import io
from jaxmorph._host.cells.lagrange import PLACES


def rows(places):
    """Places without their order."""
    return sorted(set(map(tuple, places.tolist())))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("is_joined", runs([True], nightly=[False]))
def test_blocks_and_sets_are_those_of_vtk(tmp_path, form, is_joined):
    mesh = io.read(solid(tmp_path / "a.e", form=form, is_joined=is_joined))
    for kind, corners in CELLS.items():
        np.testing.assert_array_equal(mesh.cells[kind], corners)
    seen = of_vtk(tmp_path / "a.e")
    patches = {
        name: places
        for (what, name), (places, _) in seen.items()
        if what[0] != "b" or name in ("skin", "tip")
    }
    assert set(mesh.patches) == {*patches, "none"}
    for name, places in patches.items():
        assert rows(mesh.points[mesh.patch(name)]) == rows(places), name
    assert len(mesh.patches["none"]) == 0
    assert int(jm.quality(mesh).inverted) == 0


@pytest.mark.parametrize("form", FORMS)
def test_two_dimensions(tmp_path, form):
    """Beams at the boundary are a patch, and so are sides; sets of one name, or of none."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0]], float)
    blocks = [
        ("q", "quad", [[0, 1, 2, 3]]),
        ("", "triangle", [[1, 4, 2]]),
        ("wall", "line", [[0, 1]]),
    ]
    sets = [("wall", [1], [0]), ("", [1, 0], [1, 3])]
    types = exodus.TYPES | {"quad": "QUAD"}
    exodus.write(tmp_path / "a.e", points, blocks, sets, [("", [3])], form=form, types=types)
    mesh = io.read(tmp_path / "a.e")
    found = {name: nodes.tolist() for name, nodes in mesh.patches.items()}
    assert found == {
        "wall": [0, 1],
        "wall_sides_10": [1, 4],
        "sides_20": [0, 2, 3, 4],
        "nodes_10": [3],
    }
    np.testing.assert_array_equal(
        rewritten(tmp_path / "b.e", mesh.moved(points * 3)).points, points * 3
    )
    raised = np.pad(points, [(0, 0), (0, 1)], constant_values=7)
    exodus.write(tmp_path / "c.e", raised, blocks[:2], form=form, types=types)
    mesh = io.read(tmp_path / "c.e")
    np.testing.assert_array_equal(mesh.points, points)
    np.testing.assert_array_equal(mesh.in_file_order(points * 2)[:, 2], 7)


def test_one_ending_two_formats(tmp_path):
    """`.g` is Exodus's and PLOT3D's: the first bytes of the file decide, for writing the file that the mesh came from."""
    solid(tmp_path / "a.g")
    write_plot3d(tmp_path / "b.g", box(3, 2, 4), "plain", "<")
    for name, format_name in (("a", "Exodus"), ("b", "PLOT3D")):
        mesh = io.read(tmp_path / f"{name}.g")
        assert mesh.source.format == format_name
        io.write(tmp_path / f"{name}2.g", mesh.moved(mesh.points * 2))
        np.testing.assert_array_equal(io.read(tmp_path / f"{name}2.g").points, mesh.points * 2)


HEX = "01 12 23 30 04 15 26 37 45 56 67 74"
WEDGE = "01 12 20 03 14 25 34 45 53"
PYRAMID = "01 12 23 30 04 14 24 34"
MANUAL = {
    "hexahedron20": ("HEX20", HEX),
    "hexahedron27": ("HEX27", f"{HEX} 01234567 0123 4567 0374 1265 0154 2376"),
    "wedge15": ("WEDGE15", WEDGE),
    "wedge18": ("WEDGE18", f"{WEDGE} 0143 1254 0253"),
    "tetra10": ("TETRA10", "01 12 02 03 13 23"),
    "pyramid13": ("PYRAMID13", PYRAMID),
    "triangle6": ("TRI6", "01 12 02"),
    "quad8": ("QUAD8", "01 12 23 30"),
    "quad9": ("SHELL9", "01 12 23 30 0123"),
}
"""Exodus's types of order 2: their nodes behind the corners are in the middle of these corners."""
SIDES = {
    "hexahedron": "0154 1265 2376 0374 0123 4567",
    "wedge": "0143 1254 0253 012 345",
    "tetra": "013 123 023 012",
    "pyramid": "014 124 234 034 0123",
    "triangle": "01 12 02",
    "quad": "01 12 23 30",
}


@pytest.mark.parametrize("kind", MANUAL)
def test_cells_of_order_2(tmp_path, kind):
    """VTK has each node where its parametric coordinates are in the linear cell, and sides have the nodes between their corners."""
    vtkCommonCore = pytest.importorskip("vtkmodules.vtkCommonCore")
    name, groups = MANUAL[kind]
    shape = kind.rstrip("0123456789")
    corners = (
        np.array(PLACES[shape], float)
        @ np.array([[1, 0.1, 0], [0.2, 1, 0.3], [0, 0.1, 1]])[: len(PLACES[shape][0])]
    )
    middles = [[int(digit) for digit in group] for group in groups.split()]
    nodes = [*([k] for k in range(len(corners))), *middles]
    points = np.array([corners[group].mean(axis=0) for group in nodes])
    is_shell = name.startswith("SHELL")
    sides = [(f"side {k}", [0], [k + 2 * is_shell]) for k in range(len(SIDES[shape].split()))]
    flat = points[:, : 2 if shape in ("triangle", "quad") and not is_shell else 3]
    exodus.write(
        tmp_path / "a.e", flat, [("", kind, [np.arange(len(points))])], sides, types={kind: name}
    )
    mesh = io.read(tmp_path / "a.e")
    for k, side in enumerate(SIDES[shape].split()):
        inside = [
            node for node, group in enumerate(nodes) if set(group) <= {int(digit) for digit in side}
        ]
        assert mesh.patch(f"side {k}").tolist() == inside
    grid, straight = (
        mesh.to_pyvista(),
        jm.Mesh(flat[: len(corners)], {shape: [np.arange(len(corners))]}).to_pyvista(),
    )
    cell, linear = grid.GetCell(0), straight.GetCell(0)
    at = np.array([cell.GetParametricCoords()[k] for k in range(3 * len(points))]).reshape(-1, 3)
    in_cell = np.asarray(grid.points)[[cell.GetPointId(k) for k in range(len(points))]]
    for node, coordinates in zip(in_cell, at, strict=True):
        place = [0.0] * 3
        linear.EvaluateLocation(
            vtkCommonCore.reference(0), coordinates, place, [0.0] * len(corners)
        )
        np.testing.assert_allclose(place, node, atol=1e-12)
    moved = mesh.moved(np.asarray(mesh.points) * 1.25)
    np.testing.assert_array_equal(rewritten(tmp_path / "b.e", moved).points, moved.points)


def test_what_is_refused(tmp_path):
    points = mixed()[0]
    for form in FORMS:
        exodus.write(tmp_path / "b.e", points, [("", "tetra", [np.arange(11)])], form=form)
        with pytest.raises(
            ValueError,
            match=r"b\.e: elements of type TETRA4 with 11 nodes are not read; of order 1 and 2",
        ):
            io.read(tmp_path / "b.e")
        solid(tmp_path / "c.e", form=form)
        data = (tmp_path / "c.e").read_bytes()
        (tmp_path / "c.e").write_bytes(data[: len(data) // 2])
        with pytest.raises(ValueError, match=r"c\.e: not an Exodus file, or a damaged one"):
            io.read(tmp_path / "c.e")
        for sets in ([("s", [4], [0])], [("s", [0], [6])]):
            exodus.write(
                tmp_path / "d.e", points, [("", "hexahedron", CELLS["hexahedron"])], sets, form=form
            )
            with pytest.raises(ValueError, match=r"side"):
                io.read(tmp_path / "d.e")
        exodus.write(tmp_path / "d.e", points, [("", "tetra", [[0, 1, 2, 12]])], form=form)
        with pytest.raises(ValueError, match=r"d\.e"):
            io.read(tmp_path / "d.e")


def med_box(path):
    """A box of tetrahedra with groups, one face in two of them."""
    with gmsh_session() as gmsh:
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.8)
        gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1)
        gmsh.model.occ.synchronize()
        for tag, (dimension, faces, name) in enumerate(
            [(2, [1], "low x"), (2, [2, 3], "others"), (2, [3], "also"), (3, [1], "fluid")], start=1
        ):
            gmsh.model.addPhysicalGroup(dimension, faces, tag, name)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))


def test_groups_of_med_are_patches(tmp_path):
    med_box(tmp_path / "a.med")
    mesh = io.read(tmp_path / "a.med")
    assert set(mesh.patches) == {"low x", "others", "also"}
    x, y = mesh.points[:, 0], mesh.points[:, 1]
    np.testing.assert_array_equal(mesh.patch("low x"), np.flatnonzero(x == 0))
    np.testing.assert_array_equal(mesh.patch("also"), np.flatnonzero(y == 0))
    np.testing.assert_array_equal(mesh.patch("others"), np.flatnonzero((y == 0) | (x == 2)))
    volumes = np.asarray(jm.quality(mesh).volume)
    assert (volumes > 0).all()
    np.testing.assert_allclose(volumes.sum(), 2, rtol=1e-6)


def test_node_groups_and_other_cells_of_med(tmp_path):
    """Hexahedra by meshio, which keeps the order of corners: MED's is turned to VTK's. A group of nodes is a patch."""
    right, mesh = bricks(2), io.read(written(tmp_path, ".med"))
    np.testing.assert_array_equal(mesh.cells["hexahedron"], right.cells["hexahedron"])
    np.testing.assert_array_equal(mesh.patch("floor"), right.patch("floor"))
    assert int(jm.quality(mesh).inverted) == 0


def test_two_dimensions_of_med(tmp_path):
    points = np.array([[0.0, 0, 3], [1, 0, 3], [1, 1, 3], [0, 1, 3]])
    meshio.med.write(tmp_path / "a.med", meshio.Mesh(points, [("quad", [[0, 1, 2, 3]])]))
    mesh = io.read(tmp_path / "a.med")
    np.testing.assert_array_equal(mesh.points, points[:, :2])
    assert set(mesh.patches) == {"boundary"}
    io.write(tmp_path / "b.med", mesh.moved(mesh.points * 2))
    expected = points * [2, 2, 1]
    np.testing.assert_array_equal(meshio.med.read(tmp_path / "b.med").points, expected)
    np.testing.assert_array_equal(mesh.in_file_order(mesh.points * 2), expected)


def test_what_is_refused_of_med(tmp_path):
    points = np.random.default_rng(0).normal(size=(10, 3))
    meshio.med.write(tmp_path / "b.med", meshio.Mesh(points, [("tetra10", [np.arange(10)])]))
    with pytest.raises(ValueError, match=r"b\.med: elements of type T10; linear ones are read"):
        io.read(tmp_path / "b.med")
