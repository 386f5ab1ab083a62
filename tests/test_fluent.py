"""Fluent's files: VTK reads the same cells and places; what is written differs in coordinates alone."""

import fluent
import numpy as np
import pytest
from exodus import CELLS
from foam import mixed
from formats import assert_same
from meshes import bricks

import jaxmorph as jm
from jaxmorph import io

FORMS = {
    "text": ("a.msh", {}),
    "turned": ("a.cas", {"is_turned": True}),
    "cuts": ("a.msh", {"cuts": (3, 5), "end": "\r\n"}),
    "double": ("a.cas", {"form": "double"}),
    "float": ("a.msh", {"form": "float", "cuts": (4,)}),
    "h5": ("a.cas.h5", {"form": "h5"}),
    "h5 single": ("a.cas.h5", {"form": "h5", "real": "f4"}),
}


def square() -> jm.Mesh:
    """A pentagon, a triangle and a quadrilateral."""
    points = [[0.0, 0], [1, 0], [1, 0.5], [1, 1], [0, 1], [2, 0], [2, 1], [1.5, 1.5]]
    return jm.Mesh(points, {"quad": [[1, 5, 6, 2]], "triangle": [[2, 6, 3]]}, {"low": [1, 5]})


MESHES = {
    "bricks": bricks(2),
    "solids": jm.Mesh(mixed()[0], CELLS, {"low": [0, 1, 2, 3]}),
    "square": square(),
}


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("form", FORMS)
def test_cells_zones_and_points_come_back(tmp_path, form, mesh):
    name, how = FORMS[form]
    mesh, path = MESHES[mesh], tmp_path / name
    cells = {kind: np.asarray(ids) for kind, ids in mesh.cells.items()}
    patches = {name.replace(" ", "_"): np.asarray(nodes) for name, nodes in mesh.patches.items()}
    fluent.write(path, np.asarray(mesh.points), cells, patches, **how)
    read = io.read(path)
    np.testing.assert_array_equal(
        read.points,
        np.asarray(mesh.points).astype("f4" if "float" in form or "single" in form else "f8"),
    )
    for kind, ids in cells.items():
        assert sorted(map(sorted, read.cells[kind].tolist())) == sorted(map(sorted, ids.tolist()))
    assert not np.asarray(jm.quality(read).is_inverted).any()
    assert set(read.patches) == {*patches, "rest"}
    for patch, kind in read.kinds.items():
        assert kind == ("pressure-far-field" if patch == "rest" else "wall")
    out = tmp_path / f"out.{name.split('.', 1)[1]}"
    io.write(out, read)
    assert out.read_bytes() == path.read_bytes()
    moved = read.moved(np.asarray(read.points) + 0.125)
    io.write(out, moved)
    assert_same(io.read(out), read.moved(io.as_written(out, moved)))


def test_a_polygon_is_told(tmp_path):
    points = np.array([[0.0, 0], [1, 0], [1.5, 1], [0.5, 2], [-0.5, 1]])
    sections = [f"(10 (1 1 5 1 2)({' '.join(map(str, points.ravel()))}))", "(12 (1 1 1 1 0)(7))"]
    edges = " ".join(f"2 {a} {a % 5 + 1} 1 0" for a in range(1, 6))
    (tmp_path / "a.msh").write_text("\n".join([*sections, f"(13 (3 1 5 3 5)({edges}))"]))
    with pytest.raises(
        ValueError, match=r"a\.msh: 1 cells of 5 edges \(first cell 0\) are not read"
    ):
        io.read(tmp_path / "a.msh")


@pytest.mark.parametrize("form", ["text", "cuts", "h5"])
def test_vtk_finds_the_moved_cells(tmp_path, form):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOFLUENTCFF import vtkFLUENTCFFReader
    from vtkmodules.vtkIOGeometry import vtkFLUENTReader

    name, how = FORMS[form]
    fluent.write(
        tmp_path / name,
        np.asarray(MESHES["solids"].points),
        dict(MESHES["solids"].cells),
        {},
        **how,
    )
    mesh = io.read(tmp_path / name)
    out = tmp_path / f"b.{name.split('.', 1)[1]}"
    io.write(out, mesh.moved(np.asarray(mesh.points) * 1.25 + 0.123456789))
    reader = (vtkFLUENTCFFReader if form == "h5" else vtkFLUENTReader)()
    reader.SetFileName(str(out))
    reader.Update()
    blocks = [reader.GetOutput().GetBlock(k) for k in range(reader.GetOutput().GetNumberOfBlocks())]
    grid = next(block for block in blocks if block.GetNumberOfCells() == 4)
    expected = np.asarray(mesh.points) * 1.25 + 0.123456789
    np.testing.assert_array_equal(
        vtk_to_numpy(grid.GetPoints().GetData()), expected.astype("f4")
    )  # VTK's are single
    kinds = np.unique(vtk_to_numpy(grid.GetCellTypes()), return_counts=True)
    assert dict(zip(*map(np.ndarray.tolist, kinds), strict=True)) == {10: 1, 12: 1, 13: 1, 14: 1}


@pytest.mark.parametrize("name", ["a.msh", "a.cas"])
def test_damage_is_told(tmp_path, name):
    path = tmp_path / name
    form = "text" if name == "a.msh" else "double"
    fluent.write(
        path,
        np.asarray(bricks(1).points),
        {"hexahedron": np.asarray(bricks(1).cells["hexahedron"])},
        {},
        form,
    )
    good = path.read_bytes()
    lost = (
        good.replace(b"\n4 1 ", b"\n4 9 ")
        if form == "text"
        else good.replace(b"(13 (0 1 6 0))", b"(13 (0 1 7 0))")
    )
    for damaged in (
        good[: len(good) // 2],
        good.replace(b"(12 (0 1 1 0))", b"(12 (0 1 2 0))"),
        lost,
    ):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=name):
            io.read(path)
    path.write_bytes(good + b"(59 (1 2 3 4)(2 1 2))")
    with pytest.raises(ValueError, match="adapted"):
        io.read(path)
