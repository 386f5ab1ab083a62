"""Exodus files in all forms of netCDF: VTK's reader, which has Exodus's own library, is the judge."""

import exodus
import numpy as np
import pytest
from exodus import CELLS, FORMS, of_vtk, solid
from foam import mixed
from formats import rewritten
from plot3d import box
from plot3d import write as write_plot3d
from runs import runs

import jaxmorph as jm
from jaxmorph import io


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
    patches = {name: places for (what, name), (places, _) in seen.items() if what[0] != "b" or name in ("skin", "tip")}
    assert set(mesh.patches) == {*patches, "none"}
    for name, places in patches.items():
        assert rows(mesh.points[mesh.patch(name)]) == rows(places), name
    assert len(mesh.patches["none"]) == 0
    assert int(jm.quality(mesh).inverted) == 0


@pytest.mark.parametrize("form", FORMS)
def test_two_dimensions(tmp_path, form):
    """Beams at the boundary are a patch, and so are sides; sets of one name, or of none."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0]], float)
    blocks = [("q", "quad", [[0, 1, 2, 3]]), ("", "triangle", [[1, 4, 2]]), ("wall", "line", [[0, 1]])]
    sets = [("wall", [1], [0]), ("", [1, 0], [1, 3])]
    types = exodus.TYPES | {"quad": "QUAD"}
    exodus.write(tmp_path / "a.e", points, blocks, sets, [("", [3])], form=form, types=types)
    mesh = io.read(tmp_path / "a.e")
    found = {name: nodes.tolist() for name, nodes in mesh.patches.items()}
    assert found == {"wall": [0, 1], "wall_sides_10": [1, 4], "sides_20": [0, 2, 3, 4], "nodes_10": [3]}
    np.testing.assert_array_equal(rewritten(tmp_path / "b.e", mesh.moved(points * 3)).points, points * 3)
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


def test_what_is_refused(tmp_path):
    points = mixed()[0]
    for form in FORMS:
        exodus.write(tmp_path / "b.e", points, [("", "tetra", [np.arange(10)])], form=form)
        with pytest.raises(ValueError, match=r"b\.e: elements of type TETRA4 with 10 nodes; linear ones are read"):
            io.read(tmp_path / "b.e")
        solid(tmp_path / "c.e", form=form)
        data = (tmp_path / "c.e").read_bytes()
        (tmp_path / "c.e").write_bytes(data[: len(data) // 2])
        with pytest.raises(ValueError, match=r"c\.e: not an Exodus file, or a damaged one"):
            io.read(tmp_path / "c.e")
        for sets in ([("s", [4], [0])], [("s", [0], [6])]):
            exodus.write(tmp_path / "d.e", points, [("", "hexahedron", CELLS["hexahedron"])], sets, form=form)
            with pytest.raises(ValueError, match=r"side"):
                io.read(tmp_path / "d.e")
        exodus.write(tmp_path / "d.e", points, [("", "tetra", [[0, 1, 2, 12]])], form=form)
        with pytest.raises(ValueError, match=r"d\.e"):
            io.read(tmp_path / "d.e")
