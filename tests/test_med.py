"""MED files as gmsh and meshio write them, and gmsh's view of what is written back."""

import meshio
import numpy as np
import pytest
from formats import written
from meshes import bricks, gmsh_session

import jaxmorph as jm
from jaxmorph import io


def box(path):
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


def test_groups_are_patches(tmp_path):
    box(tmp_path / "a.med")
    mesh = io.read(tmp_path / "a.med")
    assert set(mesh.patches) == {"low x", "others", "also"}
    x, y = mesh.points[:, 0], mesh.points[:, 1]
    np.testing.assert_array_equal(mesh.patch("low x"), np.flatnonzero(x == 0))
    np.testing.assert_array_equal(mesh.patch("also"), np.flatnonzero(y == 0))
    np.testing.assert_array_equal(mesh.patch("others"), np.flatnonzero((y == 0) | (x == 2)))
    volumes = np.asarray(jm.quality(mesh).volume)
    assert (volumes > 0).all()
    np.testing.assert_allclose(volumes.sum(), 2, rtol=1e-6)


def test_node_groups_and_other_cells(tmp_path):
    """Hexahedra by meshio, which keeps the order of corners: MED's is turned to VTK's. A group of nodes is a patch."""
    right, mesh = bricks(2), io.read(written(tmp_path, ".med"))
    np.testing.assert_array_equal(mesh.cells["hexahedron"], right.cells["hexahedron"])
    np.testing.assert_array_equal(mesh.patch("floor"), right.patch("floor"))
    assert int(jm.quality(mesh).inverted) == 0


def test_two_dimensions(tmp_path):
    points = np.array([[0.0, 0, 3], [1, 0, 3], [1, 1, 3], [0, 1, 3]])
    meshio.med.write(tmp_path / "a.med", meshio.Mesh(points, [("quad", [[0, 1, 2, 3]])]))
    mesh = io.read(tmp_path / "a.med")
    np.testing.assert_array_equal(mesh.points, points[:, :2])
    assert set(mesh.patches) == {"boundary"}
    io.write(tmp_path / "b.med", mesh.moved(mesh.points * 2))
    expected = points * [2, 2, 1]
    np.testing.assert_array_equal(meshio.med.read(tmp_path / "b.med").points, expected)
    np.testing.assert_array_equal(mesh.in_file_order(mesh.points * 2), expected)


def test_what_is_refused(tmp_path):
    points = np.random.default_rng(0).normal(size=(10, 3))
    meshio.med.write(tmp_path / "b.med", meshio.Mesh(points, [("tetra10", [np.arange(10)])]))
    with pytest.raises(ValueError, match=r"b\.med: elements of type T10; linear ones are read"):
        io.read(tmp_path / "b.med")
