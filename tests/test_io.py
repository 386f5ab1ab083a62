"""Files of other programs, through meshio and gmsh's own writer; and what holds for every format."""

import json
import os
import re
import sys

import jax
import meshio
import numpy as np
import pytest
from formats import rewritten
from meshes import bricks, ring
from runs import all_refused

import jaxmorph as jm
from jaxmorph import io

SUFFIXES = [".su2", ".vtu", ".vtk", ".msh"]


def rings() -> jm.Mesh:
    """A ring with a blank in the name of a patch."""
    return ring(12, np.linspace(1, 2, 4), ("wall", "far field"))


def test_a_grid_of_others_keeps_its_arrays_and_its_other_cells(tmp_path):
    mesh = rings()
    points = np.column_stack([mesh.points, np.full(len(mesh.points), 0.5)])
    quads = mesh.cells["quad"]
    blocks = [("quad", quads[:20]), ("line", quads[:12, :2]), ("quad", quads[20:])]
    mark = [np.arange(20.0), np.arange(12.0), np.arange(20.0, 36.0)]
    meshio.write(
        tmp_path / "a.vtu", meshio.Mesh(points, blocks, {"heat": points[:, 0]}, {"mark": mark})
    )
    read = io.read(tmp_path / "a.vtu")
    assert read.points.shape == mesh.points.shape
    np.testing.assert_array_equal(read.cells["quad"], mesh.cells["quad"])
    np.testing.assert_array_equal(read.patch("boundary"), mesh.patch("wall", "far field"))
    io.write(tmp_path / "b.vtu", read.moved(read.points * 2), cell_data={"row": np.arange(36.0)})
    found = meshio.read(tmp_path / "b.vtu")
    np.testing.assert_array_equal(found.points, points * [2, 2, 1])
    np.testing.assert_array_equal(found.point_data["heat"], points[:, 0])
    for values, expected in zip(found.cell_data["mark"], mark, strict=True):
        np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(found.cell_data["row"][1], np.full(12, np.nan))
    np.testing.assert_array_equal(found.cell_data["row"][2], np.arange(20.0, 36.0))


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize("kind", [np.int32, float])
def test_patches_from_numbers_on_the_boundary(tmp_path, suffix, kind):
    mesh = rings()
    points = np.column_stack([mesh.points, np.zeros(len(mesh.points))])
    lines = np.stack([np.arange(12), np.roll(np.arange(12), -1)], axis=1)
    blocks = [("quad", mesh.cells["quad"]), ("line", lines), ("line", lines + 36)]
    numbers = {
        "Marker": [np.zeros(36, kind), np.full(12, 7, kind), np.repeat([8, 9], 6).astype(kind)]
    }
    meshio.write(tmp_path / f"a{suffix}", meshio.Mesh(points, blocks, cell_data=numbers))
    read = io.read(tmp_path / f"a{suffix}")
    assert {name: nodes.tolist() for name, nodes in read.patches.items()} == {
        "Marker_7": [*range(12)], "Marker_8": [*range(36, 43)], "Marker_9": [36, *range(42, 48)]}  # fmt: skip
    at_points = {"marker": np.repeat([1, 0, 5], [12, 24, 12]).astype(kind), "heat": points[:, 0]}
    meshio.write(tmp_path / f"b{suffix}", meshio.Mesh(points, blocks[:1], at_points))
    read = io.read(tmp_path / f"b{suffix}")
    assert {name: nodes.tolist() for name, nodes in read.patches.items()} == {
        "marker_1": [*range(12)], "marker_5": [*range(36, 48)]}  # fmt: skip


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_no_mesh_or_is_cut_is_a_value_error_without_other_words(tmp_path, capfd, suffix):
    io.write(tmp_path / f"a{suffix}", rings())
    whole = (tmp_path / f"a{suffix}").read_bytes()
    cut = [whole[: int(share * len(whole))] for share in (0.2, 0.5, 0.8)]
    for content in (b"", b"# a text\nabout = nothing\n", bytes(range(256)) * 9, *cut):
        (tmp_path / f"b{suffix}").write_bytes(content)
        with pytest.raises(ValueError, match=f"b\\{suffix}"):
            io.read(tmp_path / f"b{suffix}")
    assert capfd.readouterr() == ("", "")


def test_cells_that_are_not_known_are_named(tmp_path):
    points = np.random.default_rng(0).random((6, 3))
    meshio.write(tmp_path / "a.vtu", meshio.Mesh(points, [("polygon", [[0, 1, 2, 3, 4, 5]])]))
    with pytest.raises(ValueError, match="cells of type polygon are not supported"):
        io.read(tmp_path / "a.vtu")
    meshio.write(tmp_path / "b.vtu", meshio.Mesh(points, [("line", [[0, 1]])]))
    with pytest.raises(ValueError, match="no cells of an area or a volume, only line"):
        io.read(tmp_path / "b.vtu")


def test_what_must_not_be_written(tmp_path):
    mesh = rings()
    read, before = rewritten(tmp_path / "a.su2", mesh), (tmp_path / "a.su2").read_bytes()
    (tmp_path / "link.su2").symlink_to(tmp_path / "a.su2")
    for path in (tmp_path / "a.su2", tmp_path / "link.su2", f"{tmp_path}/../{tmp_path.name}/a.su2"):
        with pytest.raises(ValueError, match="the mesh was read from this file"):
            io.write(path, read)
    lost = mesh.moved(np.where(np.arange(48)[:, None] == 5, np.nan, mesh.points))
    shape = r"array 'u' has shape \(3,\); expected one row for each of 48 points"
    all_refused(
        (lambda: io.write(tmp_path / "a.stl", mesh), r"this is a surface, without cells"),
        (lambda: io.write(tmp_path / "no" / "a.su2", mesh), "there is no folder"),
        (
            lambda: io.write(tmp_path / "b.su2", mesh, point_data={"u": mesh.points}),
            "SU2 files hold no arrays",
        ),
        (lambda: io.write(tmp_path / "b.vtu", mesh, point_data={"u": np.zeros(3)}), shape),
        (lambda: io.write(tmp_path / "b.su2", lost), "1 of 48 points are not finite, first node 5"),
    )
    with pytest.raises(FileNotFoundError):
        io.read(tmp_path / "none.vtu")
    assert (tmp_path / "a.su2").read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["a.su2", "link.su2"]


def test_a_mesh_with_a_source_is_a_pytree(tmp_path):
    mesh = rewritten(tmp_path / "a.su2", rings())
    assert jax.tree.unflatten(*reversed(jax.tree.flatten(mesh))).source is mesh.source
    moved = jax.jit(lambda mesh: mesh.moved(mesh.points * 2))(mesh)
    np.testing.assert_array_equal(rewritten(tmp_path / "b.su2", moved).points, 2 * mesh.points)


def test_a_missing_extra_is_named(monkeypatch, tmp_path):
    io.write(tmp_path / "a.vtu", rings())
    monkeypatch.setitem(sys.modules, "vtkmodules.vtkIOXML", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxmorph\[io\]'"):
        io.read(tmp_path / "a.vtu")


@pytest.mark.parametrize(
    "text",
    ["7 1.5 2\n3 -1e-3 .5\n", "id,x,y\n7,1.5,2\n3,-1e-3,.5", '"PointID"; "x"; "y"\r\n7;1.5;2\r\n3;-1e-3;.5\r\n',
     "% bump\n\n7\t1.5\t2  # nose\n3 -0.001 0.5\n"],
)  # fmt: skip
def test_surface_tables(tmp_path, text):
    (tmp_path / "a.dat").write_bytes(text.encode())
    ids, values = io.read_surface(tmp_path / "a.dat", 2)
    assert ids.tolist() == [7, 3]
    assert values.tolist() == [[1.5, 2.0], [-1e-3, 0.5]]


BAD_TABLES = {
    "": "no rows of node id and 2 numbers",
    "1 2 3\n4 5\n": "line 2: a node id and 2 numbers expected, found 2",
    "1 2 3\n\n1 4 5\n": "line 3: node 1 comes a second time",
    "1.5 2 3\n": r"line 1: found \[1.5, 2.0, 3.0\]",
    "id,x,y\n1,2,nan\n": "line 2: found",
    "1 2 x\n": "line 1: found 'x' in place of a number",
}


@pytest.mark.parametrize("text", BAD_TABLES)
def test_bad_surface_tables_say_where(tmp_path, text):
    (tmp_path / "a.dat").write_text(text)
    with pytest.raises(ValueError, match=BAD_TABLES[text]):
        io.read_surface(tmp_path / "a.dat", 2)


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("binary", [False, True])
def test_sections_of_gmsh_are_told_from_words_in_comments(tmp_path, version, binary):
    mesh = rings()
    flat = np.column_stack([mesh.points, np.zeros(len(mesh.points))])
    cells = [(kind, np.asarray(corners)) for kind, corners in mesh.cells.items()]
    meshio.gmsh.write(str(tmp_path / "plain.msh"), meshio.Mesh(flat, cells), version, binary=binary)
    comment = b"$Comments\n$Nodes\n1\n1 7 7 7\n$EndNodes\n$EndComments\n"
    data = (tmp_path / "plain.msh").read_bytes()
    end = data.index(b"$EndMeshFormat\n") + len(b"$EndMeshFormat\n")
    (tmp_path / "a.msh").write_bytes(data[:end] + comment + data[end:])
    read = io.read(tmp_path / "a.msh")
    io.write(tmp_path / "b.msh", read.moved(read.points + 1))
    assert comment in (tmp_path / "b.msh").read_bytes()
    np.testing.assert_array_equal(io.read(tmp_path / "b.msh").points, mesh.points + 1)


@pytest.mark.parametrize(
    ("before", "mark"), [("// a ring\n", ""), ("\n", ""), ("\ufeff", " .* byte order mark")]
)
def test_what_stands_before_the_format_of_a_gmsh_file_is_told(tmp_path, before, mark):
    """Sections of comments may stand there, as meshio has it; anything else is shown."""
    comment = b"$Comments\na ring\n$EndComments\n"
    io.write(tmp_path / "plain.msh", rings())
    data = (tmp_path / "plain.msh").read_bytes()
    (tmp_path / "a.msh").write_bytes(comment + data)
    np.testing.assert_array_equal(io.read(tmp_path / "a.msh").points, rings().points)
    for start, line in ((comment, 4), (b"", 1)):
        (tmp_path / "b.msh").write_bytes(start + before.encode() + data)
        with pytest.raises(
            ValueError,
            match=rf"b\.msh, line {line}: not a \.msh file; \$MeshFormat is .*{mark * (line < 4)}",
        ):
            io.read(tmp_path / "b.msh")


def test_a_block_of_no_elements_is_no_damage(tmp_path):
    mesh = meshio.Mesh(np.eye(3), [("triangle", np.array([[0, 1, 2]]))])
    meshio.gmsh.write(str(tmp_path / "a.msh"), mesh, "2.2", binary=True)
    data = (tmp_path / "a.msh").read_bytes()
    start = data.index(b"$Elements\n1\n") + 12
    (tmp_path / "a.msh").write_bytes(
        data[:start] + np.array([2, 0, 2], "<i4").tobytes() + data[start:]
    )
    np.testing.assert_array_equal(io.read(tmp_path / "a.msh").cells["triangle"], [[0, 1, 2]])


@pytest.mark.parametrize(("version", "line"), [("2.2", 1), ("4.1", 2)])
def test_a_tag_far_beyond_the_number_of_nodes_is_told(tmp_path, version, line):
    """A table as long as the tag would take gigabytes."""
    mesh = meshio.Mesh(np.eye(3), [("triangle", np.array([[0, 1, 2]]))])
    meshio.gmsh.write(str(tmp_path / "a.msh"), mesh, version, binary=False)
    data = (tmp_path / "a.msh").read_bytes()
    (tmp_path / "a.msh").write_bytes(
        re.sub(rb"(\$Nodes\n(?:.+\n){%d})1\b" % line, rb"\g<1>1000000000", data)
    )
    with pytest.raises(
        ValueError, match=r"a\.msh: a triangle names 1, which is none of the 3 nodes"
    ):
        io.read(tmp_path / "a.msh")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_cell_that_stands_twice_is_refused(tmp_path, suffix):
    mesh = rings()
    kind, corners = next(iter(mesh.cells.items()))
    copies = jm.Mesh(
        mesh.points, {**mesh.cells, kind: np.concatenate([corners, corners[2:3, ::-1]])}
    )
    io.write(tmp_path / f"a{suffix}", copies)
    told = rf"a\{suffix}: 2 cells of type {kind} have the nodes of another one, first cell 2 "
    with pytest.raises(ValueError, match=told):
        io.read(tmp_path / f"a{suffix}")


def test_text_of_vtk_that_was_cut_or_counts_wrong_is_refused(tmp_path):
    meshio.write(tmp_path / "a.vtu", rings().to_meshio(), binary=False)
    meshio.vtk.write(tmp_path / "a.vtk", rings().to_meshio(), binary=False)
    np.testing.assert_allclose(io.read(tmp_path / "a.vtu").points, rings().points, rtol=1e-10)
    text = (tmp_path / "a.vtu").read_text()
    (tmp_path / "b.vtu").write_text(re.sub('(Name="connectivity"[^>]*>)', r"\1 0 ", text))
    with pytest.raises(ValueError, match=r"b\.vtu: .*145 numbers are found where there are 144"):
        io.read(tmp_path / "b.vtu")
    whole = (tmp_path / "a.vtk").read_bytes()
    cuts = [whole[: whole.index(word)] for word in (b"FIELD", b"CELL_TYPES", b"POINTS")]
    for text in (*cuts, re.sub(rb"POINT_DATA \d+\n", b"", whole)):
        (tmp_path / "b.vtk").write_bytes(text)
        with pytest.raises(ValueError, match=r"b\.vtk: (a damaged file|no )"):
            io.read(tmp_path / "b.vtk")


def test_gradients_and_sensitivities_are_read_back_as_they_were(tmp_path):
    parameters, gradient = (
        {"a": np.array([1.5, -2.0]), "b": 0.25},
        {"a": np.array([1e-17, np.nan]), "b": 3.0},
    )
    names = jm.shapes.names(parameters)
    for file in ("a.csv", "a.json"):
        io.write_gradient(tmp_path / file, parameters, gradient)
    table = json.loads((tmp_path / "a.json").read_text())
    rows = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert [name for name, *_ in rows] == list(table) == list(names)
    assert (
        [float(value) for _, value, _ in rows]
        == [each["value"] for each in table.values()]
        == [1.5, -2.0, 0.25]
    )
    np.testing.assert_array_equal([float(slope) for *_, slope in rows], [1e-17, np.nan, 3.0])
    assert [each["dJ_dvalue"] for each in table.values()] == [1e-17, None, 3.0]
    with pytest.raises(ValueError, match="a gradient of 1 numbers for 3"):
        io.write_gradient(tmp_path / "a.csv", parameters, {"b": 1.0})
    mesh, rng = bricks(1), np.random.default_rng(0)
    ids, values = rng.permutation(8), rng.normal(size=(8, 3)) * 1e-300
    for file in ("s.csv", "s.npz"):
        io.write_sensitivity(tmp_path / file, ids, values)
        np.testing.assert_array_equal(io.read_sensitivity(tmp_path / file, mesh)[ids], values)
