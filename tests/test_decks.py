"""Abaqus's decks, I-deas's, Medit's and AFLR's files: places of nodes by label, sets and groups, and what is refused by name."""

import decks
import meshio
import numpy as np
import pytest
from formats import assert_same, floor_of, rewritten
from meshes import bricks, gmsh_session

import jaxmorph as jm
from jaxmorph import io

POINTS = np.asarray(bricks(2).points)
CELLS = np.asarray(bricks(2).cells["hexahedron"])
FLOOR = np.flatnonzero(POINTS[:, 2] == 0)
ROOF = np.flatnonzero(POINTS[:, 2] == 1)


def deck(order: str = "plain") -> decks.Deck:
    return decks.in_order(order, POINTS + 0.1, CELLS, floor_of(CELLS, FLOOR))


@pytest.mark.parametrize("order", decks.ORDERS)
@pytest.mark.parametrize("ending", decks.WRITERS)
def test_each_coordinate_goes_back_to_the_place_of_its_node(tmp_path, ending, order):
    """Whatever copies of nodes stand where in the file: another reader finds what moved, and bytes alone change there."""
    if order in ("falling", "twice") and ending not in decks.LABELLED:
        pytest.skip("nodes have no labels")
    points = np.asarray(bricks(2).points) + 0.1
    corners = np.asarray(bricks(2).cells["hexahedron"])
    faces = floor_of(corners, bricks(2).patch("floor"))
    deck = decks.in_order(order, points, corners, faces)
    path, out = tmp_path / f"in{ending}", tmp_path / f"out{ending}"
    decks.WRITERS[ending](path, deck)
    if order == "twice":
        with pytest.raises(ValueError, match=r"1 numbers of nodes come a second time, first 1"):
            io.read(path)
        return
    mesh = io.read(path)
    np.testing.assert_allclose(mesh.points, deck.points, atol=1e-7 * (ending in decks.SINGLE))
    used = np.asarray(mesh.points)[mesh.cells["hexahedron"]]
    np.testing.assert_allclose(used, points[corners], atol=1e-7)
    np.testing.assert_array_equal(np.unique(used[..., 2][used[..., 2] < 0.2]), used.min())
    assert np.ptp(np.asarray(mesh.points)[next(iter(mesh.patches.values()))][:, 2]) == 0
    io.write(out, mesh)
    assert out.read_bytes() == path.read_bytes()
    moved = mesh.moved(
        np.asarray(mesh.points)
        + 0.01 * np.arange(points.size * len(mesh.points) // len(points)).reshape(-1, 3) / 7
    )
    expected = io.as_written(out, moved)
    np.testing.assert_allclose(expected, moved.points, atol=1e-6 * (ending in decks.SINGLE))
    np.testing.assert_array_equal(rewritten(out, moved).points, expected)
    assert_same(io.read(out), moved.moved(expected))
    found = decks.places(out) if path.suffix in decks.TEXTS else meshio.read(out).points
    np.testing.assert_array_equal(found, expected.astype(found.dtype))


def labels(nodes: np.ndarray) -> str:
    return ", ".join(str(1 + node) for node in nodes) + "\n"


NODES = "*Node\n" + decks.table(np.column_stack([1 + np.arange(27).astype(object), POINTS]), ", ")
SOLIDS = "*Element, type=C3D8\n" + decks.table(np.column_stack([1 + np.arange(8), 1 + CELLS]), ", ")
LOW = [k for k, corners in enumerate(CELLS.tolist(), start=1) if set(corners) & {*FLOOR}]
SETS = f"*Nset, nset=a\n{labels(FLOOR)}*Nset, nset=b\n{labels(ROOF)}*Elset, elset=low\n{labels(np.array(LOW) - 1)}"
SHELLS = "*Element, type=S4, elset=Skin\n" + decks.table(
    np.column_stack([100 + np.arange(4), 1 + floor_of(CELLS, FLOOR)]), ", "
)
SOME = {
    "a set of sets": ("*Nset, nset=c\na, B\n", "c", {*FLOOR, *ROOF}),
    "a set and nodes": ("*Nset, nset=c\na,\n14, 27\n", "c", {*FLOOR, 13, 26}),
    "generated": ("*nset, NSET=c, generate\n2, 10, 4\n20, 21\n", "c", {1, 5, 9, 19, 20}),
    "a set twice": ("*Nset, nset=A\n27\n", "a", {*FLOOR, 26}),
    "of elements": ("*Nset, nset=c, elset=low\n", "c", {*CELLS[np.array(LOW) - 1].ravel()}),
    "shells": (SHELLS, "Skin", {*FLOOR}),
    "faces": ("*Surface, type=ELEMENT, name=c\nlow, S1\n", "c", {*FLOOR}),
    "a face": ("*Surface, name=c\n8, S2\n", "c", {*CELLS[7, 4:]}),
    "whole shells": (f"{SHELLS}*Surface, name=c\nSkin, SPOS\n", "c", {*FLOOR}),
    "a surface of nodes": ("*Surface, type=node, name=c\na, 1.\n27, 1.\n", "c", {*FLOOR, 26}),
    "a surface and a set": (
        "*Surface, name=a\nlow, S2\n",
        "a_surface",
        {*np.flatnonzero(POINTS[:, 2] == 0.5)},
    ),
}


@pytest.mark.parametrize("name", SOME)
def test_sets_and_surfaces_of_abaqus_are_patches(tmp_path, name):
    text, patch, nodes = SOME[name]
    (tmp_path / "a.inp").write_text(NODES + SOLIDS + SETS + text)
    mesh = io.read(tmp_path / "a.inp")
    assert {*mesh.patches[patch].tolist()} == {int(node) for node in nodes}
    assert {*mesh.patches["b"].tolist()} == {*ROOF.tolist()}


def test_what_abaqus_says_beside_the_mesh_is_told(tmp_path):
    more = "*Surface, name=all\nlow,\n*Element, type=MASS, elset=m\n900, 3\n*Nset, nset=c\n1, 99\n*Step\n"
    (tmp_path / "a.inp").write_text("*Heading\nx\n" + NODES + SOLIDS + SETS + more)
    notes = " ".join(io.read(tmp_path / "a.inp").source.notes)
    assert "the surface all, elements MASS, *STEP are not read, and stay in the file" in notes
    assert "1 nodes of the set c are not in the mesh" in notes


def test_one_part_and_its_assembly_are_read(tmp_path):
    text = f"*Heading\n*Part, name=P\n{NODES}{SOLIDS}{SETS}*End Part\n*Assembly, name=A\n"
    text += (
        f"*Instance, name=P-1, part=P\n*End Instance\n*Nset, nset=a, instance=P-1\n{labels(ROOF)}"
    )
    (tmp_path / "a.inp").write_text(text + "*Nset, nset=d\nP-1.b, P-1.1\n*End Assembly\n")
    patches = {name: ids.tolist() for name, ids in io.read(tmp_path / "a.inp").patches.items()}
    assert patches == {"a": [*FLOOR], "b": [*ROOF], "a_assembly": [*ROOF], "d": [0, *ROOF]}


WHOLE = NODES + SOLIDS
PART = f"*Part, name=P\n{WHOLE}*End Part\n"
UNV = "    -1\n  2411\n         1         {0}         1        11\n  0.0  0.0  1.0\n    -1\n"
SYSTEM = "    -1\n  2420\n1\nPart\n3 0 8\nLocal\n1 0 0\n0 1 0\n0 0 1\n10 0 0\n    -1\n"
REFUSED = {
    "two parts.inp": (PART + PART.replace("=P", "=Q"), r"a second \*PART"),
    "moved.inp": (
        PART + "*Assembly\n*Instance, name=a, part=P\n1., 0., 0.\n",
        "an .INSTANCE that is moved",
    ),
    "point.inp": (PART + "*Assembly\n*Node\n99, 1., 0., 0.\n", r"\*NODE of an \*ASSEMBLY"),
    "system.inp": ("*System\n10., 0., 0.\n" + WHOLE, r"line 1: \*SYSTEM changes the mesh"),
    "include.inp": (WHOLE + "*Include, input=a\n", r"\*INCLUDE changes the mesh"),
    "input.inp": ("*Node, input=a\n" + SOLIDS, r"\*NODE changes the mesh"),
    "ngen.inp": (WHOLE + "*Ngen\n1, 9, 1\n", r"\*NGEN changes the mesh"),
    "polar.inp": (WHOLE.replace("*Node", "*Node, System=C"), "SYSTEM: polar"),
    "type.inp": (WHOLE.replace("C3D8", "C3D27"), "elements of type 'C3D27' are not read"),
    "set.inp": (WHOLE + "*Nset, nset=a\nb\n", r"'b' is no number, and no \*NSET before"),
    "row.inp": (WHOLE.replace("3, ", "", 1), r"row\.inp"),
    "ucd.inp": ("27 8 0 0 0\n1 0 0 0\n", "a UCD file of AVS"),
    "node.inp": (
        WHOLE.replace("*Element", "*Element, elset=a").replace("8, ", "80, "),
        "none of the 27 nodes",
    ),
    "local.unv": (SYSTEM + UNV.format(3), "1 nodes are in the system of coordinates 3"),
    "unknown.unv": (UNV.format(7), "1 nodes are in the system of coordinates 7"),
    "old.unv": ("    -1\n    15\n    -1\n", "nodes of dataset 15 are not read"),
    "cut.unv": (UNV.format(1)[:-7], "lines of -1 around each dataset"),
    "text.unv": ("no mesh\n", "lines of -1 around each dataset"),
    "curved.mesh": (
        "MeshVersionFormatted 2\nDimension 3\nVertices 0\nTrianglesP2 0\nEnd\n",
        "curved cells .TrianglesP2. are not read",
    ),
    "cut.mesh": ("MeshVersionFormatted 2\nDimension 3\nVertices 0\n", "no End"),
    "again.mesh": (
        "MeshVersionFormatted 2\nDimension 3\nVertices 0\nVertices 0\nEnd\n",
        "a second Vertices",
    ),
    "a.lr8.ugrid": ("x" * 99, "no Fortran records of this form"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_changes_the_mesh_or_is_none_is_refused_by_name(tmp_path, name):
    text, message = REFUSED[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        io.read(tmp_path / name)


@pytest.mark.parametrize("dataset", [2417, 2430, 2435, 2452, 2467, 2477])
def test_groups_of_ideas_are_patches(tmp_path, dataset):
    """Of nodes and of elements, in the two forms of their members; other datasets are told."""
    decks.unv(tmp_path / "a.unv", deck())
    text = (tmp_path / "a.unv").read_text().partition("    -1\n    -1\n  2467")[0]
    width = 2 if dataset < 2433 else 4
    text += f"    -1\n    -1\n    55\n 1 2 3\n    -1\n    -1\n{dataset:6d}\n"
    for k, (name, kind, ids) in enumerate(
        (("floor", 8, range(1, 5)), ("roof", 7, 1 + ROOF), ("box", 8, range(5, 13))), start=1
    ):
        words = "".join(f"{word:10d}" for each in ids for word in (kind, each, 0, 0)[:width])
        rows = [words[at : at + 80] for at in range(0, len(words), 80)]
        text += "".join(f"{word:10d}" for word in (k, 0, 0, 0, 0, 0, 0, len(ids))) + f"\n{name}\n"
        text += "\n".join(rows) + "\n"
    (tmp_path / "b.unv").write_text(text + "    -1\n")
    mesh = io.read(tmp_path / "b.unv")
    assert {name: ids.tolist() for name, ids in mesh.patches.items()} == {
        "floor": [*FLOOR],
        "roof": [*ROOF],
    }
    assert any("box" in note for note in mesh.source.notes)
    assert "datasets 55 are not read, and stay in the file." in mesh.source.notes


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("is_block", [False, True])
def test_cells_of_gmsh_in_ideas_are_those_of_its_own_file(tmp_path, order, is_block):
    """Tetrahedra or hexahedra, of order 1 and 2: the same nodes in the same order, by their places."""
    with gmsh_session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1.5, 2)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(2, [1, 2], name="side")
        gmsh.model.addPhysicalGroup(3, [1], name="inside")
        if is_block:
            gmsh.model.mesh.setTransfiniteAutomatic()
        gmsh.option.setNumber("Mesh.MeshSizeMin", 1)
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)
        gmsh.option.setNumber("Mesh.SaveGroupsOfElements", 1)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        for ending in ("unv", "msh"):
            gmsh.write(str(tmp_path / f"a.{ending}"))
    found, expected = io.read(tmp_path / "a.unv"), io.read(tmp_path / "a.msh")
    assert [*found.cells] == [*expected.cells]
    for kind, corners in expected.cells.items():
        places = np.asarray(found.points)[found.cells[kind]], np.asarray(expected.points)[corners]
        np.testing.assert_allclose(*places, atol=1e-12)
    assert not np.asarray(jm.quality(found).is_inverted).any()
    assert [len(ids) for ids in found.patches.values()] == [len(expected.patches["side"])]
