"""Legacy VTK files: VTK itself reads what is written, and what VTK and gmsh write is read."""

import numpy as np
import pytest
from meshes import bricks, gmsh_session

import jaxmorph as jm
from jaxmorph import io

pyvista = pytest.importorskip("pyvista")
TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")


def mixed() -> jm.Mesh:
    """A mesh of every solid type, with patches whose names are awkward."""
    points = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)])
    points = np.concatenate([points, [[0.5, 0.5, 2.0], [0.0, 2.0, 0.0]]])
    cells = {
        "hexahedron": [[0, 1, 4, 3, 6, 7, 10, 9]],
        "wedge": [[1, 2, 4, 7, 8, 10], [2, 5, 4, 8, 11, 10]],
        "pyramid": [[6, 7, 10, 9, 12]],
        "tetra": [[3, 4, 13, 9]],
    }
    return jm.Mesh(points, cells, {"far field": [0, 1], "50%20 \u00e4": [2, 3, 4]})


@pytest.mark.parametrize("dtype", [*TYPES, "?"])
@pytest.mark.parametrize("ending", ["vtk", "vtu"])
def test_vtk_reads_all_arrays_that_are_written(tmp_path, ending, dtype):
    mesh = mixed()
    n, cells = len(mesh.points), 5
    at_points, at_cells = (np.arange(n) % 2).astype(dtype), (np.arange(3 * cells) % 2).astype(dtype).reshape(-1, 3)
    io.write(tmp_path / f"a.{ending}", mesh, point_data={"a b": at_points}, cell_data={"c": at_cells})
    found = pyvista.read(tmp_path / f"a.{ending}")
    np.testing.assert_array_equal(found.points, mesh.points)
    flags = {name: np.flatnonzero(found.point_data[name]).tolist() for name in found.point_data if "patch:" in name}
    assert flags == {"patch:far%20field": [0, 1], "patch:50%2520%20%C3%A4": [2, 3, 4]}
    np.testing.assert_array_equal(found.point_data["a b"], at_points)
    np.testing.assert_array_equal(found.cell_data["c"], at_cells)
    again = io.read(tmp_path / f"a.{ending}")
    assert {name: nodes.tolist() for name, nodes in again.patches.items()} == {
        name: nodes.tolist() for name, nodes in mesh.patches.items()
    }


def test_a_compression_that_is_not_read_is_told(tmp_path):
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(mixed().to_pyvista())
    writer.SetFileName(str(tmp_path / "a.vtu"))
    writer.SetCompressorTypeToLZ4()
    writer.Write()
    with pytest.raises(ValueError, match=r"a\.vtu: compressed by LZ4"):
        io.read(tmp_path / "a.vtu")


@pytest.mark.parametrize("large", [2**31, -(2**31) - 1])
def test_numbers_beyond_four_bytes_keep_their_value(tmp_path, large):
    mesh = bricks(1)
    io.write(tmp_path / "a.vtk", mesh, cell_data={"c": np.array([large])})
    assert pyvista.read(tmp_path / "a.vtk").cell_data["c"].tolist() == [large]


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
def test_what_vtk_writes_is_read_with_all_arrays(tmp_path, version, binary):
    from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter

    mesh, rng = mixed(), np.random.default_rng(0)
    grid = mesh.to_pyvista()
    for dtype in TYPES:
        grid.point_data[f"p {dtype}"] = rng.integers(0, 100, (grid.n_points, 3)).astype(dtype)
        grid.cell_data[dtype] = rng.integers(0, 100, grid.n_cells).astype(dtype)
    grid.cell_data["flag"] = np.arange(grid.n_cells) % 2 == 0
    grid.point_data["mean"] = np.array([np.nan, *range(1, grid.n_points)])
    grid.field_data["names"] = ["a b", "c" * 100]
    grid.point_data.active_scalars_name = "mean"
    writer = vtkUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileVersion(version)
    writer.SetFileName(str(tmp_path / "a.vtk"))
    (writer.SetFileTypeToBinary if binary else writer.SetFileTypeToASCII)()
    writer.Write()
    read = io.read(tmp_path / "a.vtk")
    np.testing.assert_array_equal(read.points, grid.points)
    assert list(read.patches) == list(mesh.patches)
    io.write(tmp_path / "b.vtk", read)
    found = pyvista.read(tmp_path / "b.vtk")
    np.testing.assert_array_equal(found.celltypes, grid.celltypes)
    np.testing.assert_array_equal(found.cell_connectivity, grid.cell_connectivity)
    for name in grid.point_data:
        np.testing.assert_array_equal(found.point_data[name], grid.point_data[name])
    for name in grid.cell_data:
        np.testing.assert_array_equal(found.cell_data[name], np.asarray(grid.cell_data[name]))


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("dimension", [2, 3])
def test_what_gmsh_writes_is_read(tmp_path, dimension, binary):
    with gmsh_session() as gmsh:
        make = gmsh.model.occ.addRectangle if dimension == 2 else gmsh.model.occ.addBox
        make(0, 0, 0, *(1,) * dimension)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        gmsh.model.mesh.generate(dimension)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.write(str(tmp_path / "a.vtk"))
        count = len(gmsh.model.mesh.getElements(dimension)[1][0])
    read, grid = io.read(tmp_path / "a.vtk"), pyvista.read(tmp_path / "a.vtk")
    np.testing.assert_array_equal(read.points, grid.points[:, :dimension])
    (corners,) = read.cells.values()
    assert len(corners) == count
    np.testing.assert_array_equal(corners, grid.cells_dict[5 if dimension == 2 else 10])


def test_strings_that_belong_to_points_are_refused(tmp_path):
    grid = mixed().to_pyvista()
    grid.point_data["label"] = ["x"] * grid.n_points
    grid.save(tmp_path / "a.vtk")
    with pytest.raises(ValueError, match=r"a\.vtk: .*the array label holds strings"):
        io.read(tmp_path / "a.vtk")


@pytest.mark.parametrize("binary", [False, True])
def test_no_damage_of_sizes_is_taken(tmp_path, binary):
    """A number more or less in any section is told."""
    mixed().to_pyvista().save(tmp_path / "a.vtk", binary=binary)
    data = (tmp_path / "a.vtk").read_bytes()
    for word in (b"POINTS ", b"CELLS ", b"CELL_TYPES ", b"POINT_DATA "):
        at = data.index(b"\n" + word) + 1 + len(word)
        end = min(data.index(sign, at) for sign in (b" ", b"\n") if sign in data[at : at + 9])
        for step in (-1, 1):
            count = b"%d" % (int(data[at:end]) + step)
            (tmp_path / "b.vtk").write_bytes(data[:at] + count + data[end:])
            with pytest.raises(ValueError, match=r"b\.vtk: a damaged \.vtk file"):
                io.read(tmp_path / "b.vtk")
